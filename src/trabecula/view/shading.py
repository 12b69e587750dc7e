"""Light of a point of a surface: plain functions on arrays; the page's march.frag does the same.

1. From the lamp, a soft shadow: a narrow cone through a pyramid of densities gives the length of
   the way through material, tau. Behind it light is left by exp(-sigma tau), per channel, with the
   transport coefficient of a thick medium, sigma = sqrt(3 a (a + s)) (Jensen et al. 2001,
   doi:10.1145/383259.383319, section 2), where a is the absorption times the share that the colour
   does not reflect and s the scattering.
2. The share s / (s + a) of that light goes in and comes out nearby: as much as the lamp sends to a
   point DEPTH below the surface. Soft shadows, lit rims, glowing thin walls.
3. The rest is reflected by Burley's diffuse term (2012, section 5.3), with retro-reflection by
   roughness, and his specular one (section 5.4): GGX distribution, Smith shadowing, Schlick's
   Fresnel.
4. Light from all round by wide cones, more of it between bright walls; and a little from the
   viewer.

Positions, `stretch`, `box` and `plane` are as in `rays`. `pyramid` holds means of the field over
cells of 1, 2, 4, ... voxels, one level after the other (`offsets` and `shapes` say where); beyond
the box and in the cut there is nothing.
"""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import inline
from trabecula.view.rays import is_cut

DEPTH = 1.5
"""Depth below the surface at which light is turned, voxels."""

ENTRY = 0.8
"""The way through material that a cone finds from there to a flat face above, as far as it counts:
voxels.
"""

LEAST = 0.04
"""Share of the light from all round that bounces into the deepest pore."""


@inline
def _density(pyramid, offsets, shapes, level, x, y, z):
    """Interpolate the mean density 0..1 at a level of the pyramid, void outside."""
    size = 1.0 / (1 << level)
    u, v, w = x * size - 0.5, y * size - 0.5, z * size - 0.5
    depth, height, width = shapes[level, 0], shapes[level, 1], shapes[level, 2]
    if u <= -1 or v <= -1 or w <= -1 or u >= width or v >= height or w >= depth:
        return 0.0
    i, j, k = int(np.floor(u)), int(np.floor(v)), int(np.floor(w))
    total = 0.0
    for dk in range(2):
        if 0 <= k + dk < depth:
            fw = w - k if dk else 1 - (w - k)
            for dj in range(2):
                if 0 <= j + dj < height:
                    fv = v - j if dj else 1 - (v - j)
                    row = offsets[level] + ((k + dk) * height + j + dj) * width
                    if i >= 0:
                        total += fw * fv * (1 - (u - i)) * pyramid[row + i]
                    if i + 1 < width:
                        total += fw * fv * (u - i) * pyramid[row + i + 1]
    return total / 255.0


@inline
def openness(pyramid, offsets, shapes, directions, x, y, z, normal, box, plane, stretch):
    """Return the share of the light from all round that reaches a point: wide cones along fixed
    directions, weighted by cosine.
    """
    total, weight = 0.0, 0.0
    for c in range(len(directions)):
        cosine = (
            directions[c, 0] * normal[0]
            + directions[c, 1] * normal[1]
            + directions[c, 2] * normal[2]
        )
        if cosine > 0.05:
            through = 1.0
            for level in range(1, len(offsets)):
                if through <= 0.01:
                    break
                reach = 1.0 * (1 << level)
                px = x + reach * directions[c, 0] / stretch[0]
                py = y + reach * directions[c, 1] / stretch[1]
                pz = z + reach * directions[c, 2] / stretch[2]
                if not is_cut(box, plane, stretch, px, py, pz):
                    through *= 1 - min(
                        1.0, 1.5 * _density(pyramid, offsets, shapes, level, px, py, pz)
                    )
            total += cosine * through
            weight += cosine
    return LEAST + (1 - LEAST) * total / weight


@inline
def way_through(pyramid, offsets, shapes, x, y, z, lamp, box, plane, stretch):
    """Return the length of the way through material from a point to the lamp: a narrow cone, so
    that shadows soften with distance.
    """
    way, reach = 0.0, 1.0
    limit = 1.8 * max(
        shapes[0, 0] * stretch[2], shapes[0, 1] * stretch[1], shapes[0, 2] * stretch[0]
    )
    while reach < limit and way < 12.0:
        level = 0
        while level + 1 < len(offsets) and reach * 0.16 > (1 << level):
            level += 1
        px, py, pz = (
            x + reach * lamp[0] / stretch[0],
            y + reach * lamp[1] / stretch[1],
            z + reach * lamp[2] / stretch[2],
        )
        if (
            px < 0
            or py < 0
            or pz < 0
            or px > shapes[0, 2]
            or py > shapes[0, 1]
            or pz > shapes[0, 0]
        ):
            break
        step = max(0.8, 0.2 * reach)
        if not is_cut(box, plane, stretch, px, py, pz):
            # What a blurred surface leaves beside it is no material.
            way += step * min(
                1.0, max(0.0, (_density(pyramid, offsets, shapes, level, px, py, pz) - 0.2) * 1.8)
            )
        reach += step
    return way


@inline
def diffuse_term(roughness, to_lamp, to_viewer, between):
    """Return Burley's diffuse term over that of Lambert; cosines of the normal with both, and of
    the lamp with the half way.
    """
    grazing = 2 * roughness * between * between - 0.5
    return (1 + grazing * (1 - to_lamp) ** 5) * (1 + grazing * (1 - to_viewer) ** 5)


@inline
def specular_term(roughness, specular, to_lamp, to_viewer, to_half, between):
    """Return Burley's specular term times pi, so that the lamp's strength is that of a white
    surface facing it.
    """
    sharp = max(0.02, roughness * roughness) ** 2
    peak = sharp / (1 + (sharp - 1) * to_half * to_half) ** 2
    base = 0.08 * specular
    fresnel = base + (1 - base) * (1 - between) ** 5
    hidden = (0.5 + roughness / 2) ** 4
    seen = 1 / (to_lamp + np.sqrt(hidden + to_lamp * to_lamp * (1 - hidden)))
    seen /= to_viewer + np.sqrt(hidden + to_viewer * to_viewer * (1 - hidden))
    return peak * fresnel * seen


@inline
def add_reflection(albedo, finish, tint, normal, lights, strength, way, inner, around, out, share):
    """Add to `out` the light that a point sends to the viewer.

    albedo (3,): linear colour. finish (4,): roughness, specular, absorption, scattering. lights (4,
    3): directions to the lamp, to the viewer and half between them, colour of the light from all
    round. strength (3,): of lamp, light from all round and from the viewer. way, inner: lengths
    through material to the lamp from the surface and from DEPTH below. around: openness.
    """
    lamp, viewer, half = lights[0], lights[1], lights[2]
    to_lamp = normal[0] * lamp[0] + normal[1] * lamp[1] + normal[2] * lamp[2]
    to_viewer = max(1e-3, normal[0] * viewer[0] + normal[1] * viewer[1] + normal[2] * viewer[2])
    to_half = max(0.0, normal[0] * half[0] + normal[1] * half[1] + normal[2] * half[2])
    between = lamp[0] * half[0] + lamp[1] * half[1] + lamp[2] * half[2]
    faces, gloss = 0.0, 0.0
    if to_lamp > 0:
        faces = to_lamp * diffuse_term(finish[0], to_lamp, to_viewer, between)
        gloss = to_lamp * specular_term(finish[0], finish[1], to_lamp, to_viewer, to_half, between)
    for c in range(3):
        absorbed = finish[2] * (1 - albedo[c])
        sigma = np.sqrt(3 * absorbed * (absorbed + finish[3]))
        inside = finish[3] / (finish[3] + absorbed) if finish[3] > 0 else 0.0
        left = np.exp(-sigma * way)
        turned = np.exp(-sigma * max(0.0, inner - ENTRY))
        colour = albedo[c] * tint[c]
        # Light between bright walls bounces: occlusion takes less from what reflects more.
        bounced = around * (1 + 0.7 * colour * (1 - around))
        light = strength[0] * ((1 - inside) * faces * left + inside * turned)
        light += (strength[1] * lights[3, c] + strength[2] * to_viewer) * bounced
        out[c] += share * (colour * light + strength[0] * gloss * left)

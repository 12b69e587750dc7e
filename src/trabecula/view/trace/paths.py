"""The path tracer: light from the lamp, the sky and the ground along random paths.

A path starts at the lens and is turned wherever it meets the material or the ground; every
diffuse meeting also asks the lamp directly, and mirrors weigh both ways by their densities (Veach
and Guibas 1995, the balance heuristic). In a translucent material the path walks at random until
it comes out (Chiang et al. 2016). Paths end by chance (Russian roulette), so that no light is lost;
those of more than LONGEST turns, or WALK scatterings, are cut.
"""

from __future__ import annotations

import math

import numpy as np

from trabecula.engine.compile import inline, kernel
from trabecula.engine.random import philox
from trabecula.view.trace.reflection import (
    dielectric,
    dot,
    draw_facet,
    facets,
    fresnel,
    scattering_albedo,
)
from trabecula.view.trace.sampling import anywhere, around, by_cosine, draw, mix, pair
from trabecula.view.trace.space import FAR, leave, meet, normal_at, step_out
from trabecula.view.trace.texture import (
    ABSORPTION,
    METALNESS,
    REFRACTION,
    ROUGHNESS,
    SCATTERING,
    SPECULAR,
    TRANSMISSION,
    WIDTH,
    shade,
    tilt,
)

LONGEST = 24
WALK = 256
OFF = 0.04
"""Edges of a voxel by which paths start off the surface."""

BRIGHTEST = 12.0
"""Radiance of a white surface's light that a path may bring after its first turn: what is above
would be a lone bright pixel.
"""


# Rows of the light, (11, 4), linear colours: the lamp's direction (x, y, z) and the cosine of its
# angular radius; its radiance; the sky's radiance straight up, level and straight down; direction
# and sharpness of a bright part of the sky, and its radiance; up (x, y, z) and the ground's height
# along it; the ground's albedo, below 0 for none; the radiance behind it all; where the ground
# begins to be lit like that, (x, y, z) and radius.
LAMP, BEAM, ZENITH, HORIZON, BELOW, WINDOW, GLOW, UP, GROUND, BEHIND, MIDDLE = range(11)


@inline
def along(light, row, vector):
    """Return the inner product of a vector with a row of the light."""
    return light[row, 0] * vector[0] + light[row, 1] * vector[1] + light[row, 2] * vector[2]


@inline
def sky(light, direction, c):
    """Return the radiance of the sky in a direction, of one colour."""
    height = along(light, UP, direction)
    if height < 0:
        share = min(1.0, -4.0 * height)
        return light[HORIZON, c] + share * (light[BELOW, c] - light[HORIZON, c])
    share = math.sqrt(height)
    radiance = light[HORIZON, c] + share * (light[ZENITH, c] - light[HORIZON, c])
    if light[WINDOW, 3] > 0:
        towards = along(light, WINDOW, direction)
        if towards > 0:
            radiance += light[GLOW, c] * towards ** light[WINDOW, 3]
    return radiance


@inline
def _ground(light, origin, direction):
    """Return the length at which a ray meets the ground, or FAR."""
    if light[GROUND, 0] < 0:
        return FAR
    fall = along(light, UP, direction)
    height = along(light, UP, origin) - light[UP, 3]
    if fall >= -1e-9 or height <= 0:
        return FAR
    return -height / fall


@inline
def _lamp_solid_angle(light):
    return 2.0 * math.pi * (1.0 - light[LAMP, 3])


@inline
def _sees_lamp(field, skip, form, light, point, to):
    """Return whether nothing is in the way from a point in a direction to the lamp."""
    if light[GROUND, 0] >= 0 and along(light, UP, to) <= 0:
        return False
    return meet(field, skip, form, point, to) == FAR


@inline
def label_at(labels, form, drawn, x, y, z):
    """Return the label of most weight around a point, by quadratic B-splines over 3^3 voxels."""
    if labels.size == 1:
        return np.int64(labels[0, 0, 0])
    u, v, w = x * form[0], y * form[1], z * form[2]
    i, j, k = math.floor(u), math.floor(v), math.floor(w)
    fu, fv, fw = u - i, v - j, w - k
    found = np.zeros(27, np.int64)
    weights = np.zeros(27)
    kinds = 0
    for n in range(27):
        a, b, c = n % 3, (n // 3) % 3, n // 9
        weight = _spline(a, fu) * _spline(b, fv) * _spline(c, fw)
        label = np.int64(
            labels[
                min(max(k + c - 1, 0), labels.shape[0] - 1),
                min(max(j + b - 1, 0), labels.shape[1] - 1),
                min(max(i + a - 1, 0), labels.shape[2] - 1),
            ]
        )
        if not drawn[label]:
            continue
        at = 0
        while at < kinds and found[at] != label:
            at += 1
        found[at] = label
        kinds = max(kinds, at + 1)
        weights[at] += weight
    best = 0
    for at in range(1, kinds):
        if weights[at] > weights[best]:
            best = at
    return found[best]


@inline
def _spline(which, f):
    if which == 0:
        return 0.5 * (1 - f) * (1 - f)
    if which == 1:
        return 0.75 - (f - 0.5) * (f - 0.5)
    return 0.5 * f * f


@inline
def _colour_at(values, field, form, linear, x, y, z, out):
    """Write the linear colour of a colour volume at a point, interpolated."""
    u = min(max(x * form[0] - 0.5, 0.0), values.shape[2] - 1.0)
    v = min(max(y * form[1] - 0.5, 0.0), values.shape[1] - 1.0)
    w = min(max(z * form[2] - 0.5, 0.0), values.shape[0] - 1.0)
    i, j, k = int(u), int(v), int(w)
    fu, fv, fw = u - i, v - j, w - k
    for c in range(3):
        out[c] = 0.0
    total = 0.0
    for n in range(8):
        a, b, d = n & 1, (n >> 1) & 1, n >> 2
        z1, y1 = min(k + d, values.shape[0] - 1), min(j + b, values.shape[1] - 1)
        x1 = min(i + a, values.shape[2] - 1)
        weight = (fu if a else 1 - fu) * (fv if b else 1 - fv) * (fw if d else 1 - fw)
        if field[z1, y1, x1] <= 0:  # what is outside of the form has no colour
            weight *= 1e-6
        total += weight
        for c in range(3):
            out[c] += weight * linear[values[z1, y1, x1, c]]
    for c in range(3):
        out[c] /= total


@inline
def _material(space, rows, drawn, linear, point, normal, cut, light, turn, surface):
    """Write what the material is at a point on the surface, and tilt the normal."""
    # a little below the surface: the labels and colours there are the material's
    x, y, z = (point[0] - 0.4 * normal[0], point[1] - 0.4 * normal[1], point[2] - 0.4 * normal[2])
    row = rows[label_at(space.labels, space.form, drawn, x, y, z)]
    lift, fine = along(light, UP, normal), 4 if turn == 0 else 1
    coloured, red, green, blue = space.colours.shape[0] > 0, 0.0, 0.0, 0.0
    if coloured:
        _colour_at(space.colours, space.field, space.form, linear, x, y, z, surface)
        red, green, blue = surface[0], surface[1], surface[2]
    up = -1.0 if cut else lift
    shade(space.rim, space.coarse, row, point[0], point[1], point[2], up, fine, surface)
    if coloured:
        surface[0], surface[1], surface[2] = red, green, blue
    if turn == 0:
        tilt(row, point[0], point[1], point[2], normal)


@inline
def _add_lamp(field, skip, form, light, lamp, point, normal, through, radiance, u, v, to):
    """Add what the lamp sends over a diffuse white surface."""
    solid = _lamp_solid_angle(light)
    if solid <= 0:
        return
    to[0], to[1], to[2] = around(lamp, u, v, lamp[3])
    cosine = dot(normal, to)
    if cosine <= 0 or not _sees_lamp(field, skip, form, light, point, to):
        return
    share = cosine / math.pi * solid
    for c in range(3):
        radiance[c] += through[c] * light[BEAM, c] * share


@inline
def _walk(field, form, point, normal, direction, surface, through, state):
    """Walk at random through a translucent material; return whether the path came out, its point
    and normal written.
    """
    length = surface[SCATTERING]
    red, green, blue = (
        scattering_albedo(surface[0]),
        scattering_albedo(surface[1]),
        scattering_albedo(surface[2]),
    )
    x, y, z = by_cosine(normal, draw(state), draw(state))
    direction[0], direction[1], direction[2] = -x, -y, -z
    for axis in range(3):
        point[axis] -= OFF * normal[axis]
    for number in range(WALK):
        far = -math.log(1.0 - draw(state)) * length
        t = leave(field, form, point, direction, far)
        for axis in range(3):
            point[axis] += t * direction[axis]
        if t < far:
            if number == 0:  # straight through a thin wall: its dye is taken once
                for c in range(3):
                    through[c] *= surface[c]
            normal_at(field, form, point[0], point[1], point[2], normal)
            return True
        through[0] *= red
        through[1] *= green
        through[2] *= blue
        if max(through[0], max(through[1], through[2])) < 0.2:
            if draw(state) > 0.5:
                return False
            for c in range(3):
                through[c] *= 2.0
        x, y, z = anywhere(draw(state), draw(state))
        direction[0], direction[1], direction[2] = x, y, z
    return False


@inline
def _through_glass(field, form, point, normal, direction, surface, through, state):
    """Take a path through a clear material; return whether it came out again."""
    index = surface[REFRACTION]
    longest = 3 * (form[9] - form[6] + form[10] - form[7] + form[11] - form[8])
    alpha = surface[ROUGHNESS] * surface[ROUGHNESS]
    entering = True
    facet, back = np.empty(3), np.empty(3)
    for _ in range(16):
        for axis in range(3):
            back[axis] = -direction[axis]
            facet[axis] = normal[axis] if entering else -normal[axis]
        if alpha > 4e-3:
            x, y, z = draw_facet(facet, back, alpha, draw(state), draw(state))
            facet[0], facet[1], facet[2] = x, y, z
        cosine = max(1e-3, dot(facet, back))
        ratio = 1.0 / index if entering else index
        mirrored, far_side = dielectric(cosine, ratio)
        if draw(state) < mirrored:
            for axis in range(3):
                direction[axis] += 2 * cosine * facet[axis]
            if entering:
                step_out(field, form, point, normal, OFF)
                return True
        else:
            for axis in range(3):
                direction[axis] = (
                    ratio * direction[axis] + (ratio * cosine - far_side) * facet[axis]
                )
            length = math.sqrt(dot(direction, direction))
            for axis in range(3):
                direction[axis] /= length
            if not entering:
                step_out(field, form, point, normal, OFF)
                return True
            entering = False
        for axis in range(3):
            point[axis] -= 2 * OFF * normal[axis]
        t = leave(field, form, point, direction, longest)
        for axis in range(3):
            point[axis] += t * direction[axis]
        for c in range(3):
            through[c] *= math.exp(math.log(max(surface[c], 1e-3)) * t / surface[ABSORPTION])
        normal_at(field, form, point[0], point[1], point[2], normal)
    return False


@inline
def _path(space, rows, drawn, linear, light, origin, direction, number, seed, state, work, radiance,
          first):  # fmt: skip
    """Add the radiance that comes along one path; write what it meets first (8,): normal, albedo,
    1 where it is the material, length.
    """
    through, point, normal, surface, out, to, base, lamp = work
    field, skip, form = space.field, space.skip, space.form
    through[:] = 1.0
    density = -2.0  # of the last turn's direction; -1: the lamp was asked; -2: it was not
    solid = _lamp_solid_angle(light)
    for turn in range(LONGEST):
        t, g = meet(field, skip, form, origin, direction), _ground(light, origin, direction)
        if turn > 0:
            brightest = BRIGHTEST / max(0.05, max(through[0], max(through[1], through[2])))
        else:
            brightest = FAR
        if g < t:
            for axis in range(3):
                point[axis] = origin[axis] + g * direction[axis]
            distance = math.sqrt(
                (point[0] - light[MIDDLE, 0]) ** 2
                + (point[1] - light[MIDDLE, 1]) ** 2
                + (point[2] - light[MIDDLE, 2]) ** 2
            )
            fade = min(max((distance / light[MIDDLE, 3] - 0.6) / 0.4, 0.0), 1.0)
            fade = fade * fade * (3 - 2 * fade)
            if turn == 0:
                first[0], first[1], first[2] = light[UP, 0], light[UP, 1], light[UP, 2]
                first[3], first[4], first[5] = light[GROUND, 0], light[GROUND, 1], light[GROUND, 2]
                first[7] = g
            for c in range(3):
                radiance[c] += through[c] * fade * light[BEHIND, c]
                through[c] *= (1 - fade) * light[GROUND, c]
            if fade >= 1:
                return
            normal[0], normal[1], normal[2] = light[UP, 0], light[UP, 1], light[UP, 2]
            for axis in range(3):
                point[axis] += 1e-3 * normal[axis]
            u, v = pair(seed, number, 3 + 3 * turn) if turn < 3 else (draw(state), draw(state))
            _add_lamp(field, skip, form, light, lamp, point, normal, through, radiance, u, v, to)
            u, v = pair(seed, number, 4 + 3 * turn) if turn < 3 else (draw(state), draw(state))
            x, y, z = by_cosine(normal, u, v)
            density = -1.0
        elif t == FAR:
            if turn == 0:
                first[7] = -1.0
                for c in range(3):
                    radiance[c] += light[BEHIND, c]
                return
            for c in range(3):
                radiance[c] += through[c] * min(sky(light, direction, c), brightest)
            if density != -1.0 and solid > 0 and dot(lamp, direction) >= lamp[3]:
                weight = 1.0 if density == -2.0 else density / (density + 1.0 / solid)
                for c in range(3):
                    radiance[c] += through[c] * weight * min(light[BEAM, c], brightest)
            return
        else:
            for axis in range(3):
                point[axis] = origin[axis] + t * direction[axis]
                out[axis] = -direction[axis]
            cut = normal_at(field, form, point[0], point[1], point[2], normal)
            base[0], base[1], base[2] = normal[0], normal[1], normal[2]
            _material(space, rows, drawn, linear, point, normal, cut, light, turn, surface)
            facing = dot(normal, out)
            if facing < 0.02:  # the smooth normal looks away: bend it back
                for axis in range(3):
                    normal[axis] += (0.03 - facing) * out[axis]
                length = math.sqrt(dot(normal, normal))
                for axis in range(3):
                    normal[axis] /= length
            if turn == 0:
                for axis in range(3):
                    first[axis], first[3 + axis] = normal[axis], surface[axis]
                first[6], first[7] = 1.0, t
            if surface[TRANSMISSION] > 0 and draw(state) < surface[TRANSMISSION]:
                if not _through_glass(field, form, point, base, direction, surface, through, state):
                    return
                x, y, z = direction[0], direction[1], direction[2]
                density = -2.0
            else:
                metal, alpha = surface[METALNESS], max(0.02, surface[ROUGHNESS] ** 2)
                plain = 0.08 * surface[SPECULAR] * (1 - metal)
                facing = max(dot(normal, out), 1e-3)
                mirrored, diffuse = 0.0, 0.0
                for c in range(3):
                    share = fresnel(plain + metal * surface[c], facing)
                    mirrored += share
                    diffuse += (1 - share) * (1 - metal) * surface[c]
                if plain + metal == 0:
                    mirrored = 0.0
                chance = mirrored / max(mirrored + diffuse, 1e-9)
                if 0 < chance < 1:
                    chance = min(max(chance, 0.08), 0.92)
                walks = surface[SCATTERING] > 0
                step_out(field, form, point, base, OFF)
                u, v = pair(seed, number, 3 + 3 * turn) if turn < 3 else (draw(state), draw(state))
                to[0], to[1], to[2] = around(lamp, u, v, lamp[3])
                cosine, straight = dot(normal, to), dot(base, to)
                if (
                    solid > 0
                    and cosine > 0
                    and straight > 0
                    and (chance > 0 or not walks)
                    and _sees_lamp(field, skip, form, light, point, to)
                ):
                    value, drawn_at, between = facets(normal, out, to, alpha)
                    towards = chance * drawn_at
                    if not walks:
                        towards += (1 - chance) * cosine / math.pi
                    weight = cosine * solid / (1.0 + towards * solid)
                    for c in range(3):
                        share = 0.0
                        if chance > 0:
                            share = value * fresnel(plain + metal * surface[c], between)
                        if not walks:
                            kept = (
                                fresnel(plain + metal * surface[c], facing) if chance > 0 else 0.0
                            )
                            share += (1 - kept) * (1 - metal) * surface[c] / math.pi
                        radiance[c] += through[c] * min(light[BEAM, c] * share * weight, brightest)
                u, v = pair(seed, number, 4 + 3 * turn) if turn < 3 else (draw(state), draw(state))
                if turn < 3:
                    lot, _ = pair(seed, number, 5 + 3 * turn)
                else:
                    lot = draw(state)
                if walks and lot >= chance:
                    for c in range(3):
                        kept = fresnel(plain + metal * surface[c], facing) if chance > 0 else 0.0
                        through[c] *= (1 - kept) * (1 - metal) / (1 - chance)
                    for axis in range(3):
                        normal[axis] = base[axis]
                        point[axis] -= 1.5 * OFF * base[axis]
                    if not _walk(field, form, point, normal, to, surface, through, state):
                        return
                    step_out(field, form, point, normal, OFF)
                    _add_lamp(
                        field, skip, form, light, lamp, point, normal, through, radiance, u, v, to
                    )
                    x, y, z = by_cosine(normal, draw(state), draw(state))
                    density = -1.0
                else:
                    if lot < chance:
                        hx, hy, hz = draw_facet(normal, out, alpha, u, v)
                        between = 2 * (hx * out[0] + hy * out[1] + hz * out[2])
                        x, y, z = (
                            between * hx - out[0],
                            between * hy - out[1],
                            between * hz - out[2],
                        )
                    else:
                        x, y, z = by_cosine(normal, u, v)
                    to[0], to[1], to[2] = x, y, z
                    cosine = dot(normal, to)
                    if cosine <= 1e-4 or dot(base, to) <= 1e-4:
                        return
                    value, drawn_at, between = facets(normal, out, to, alpha)
                    density = chance * drawn_at
                    if not walks:
                        density += (1 - chance) * cosine / math.pi
                    if density <= 0:
                        return
                    for c in range(3):
                        share = 0.0
                        if chance > 0:
                            share = value * fresnel(plain + metal * surface[c], between)
                        if not walks:
                            kept = (
                                fresnel(plain + metal * surface[c], facing) if chance > 0 else 0.0
                            )
                            share += (1 - kept) * (1 - metal) * surface[c] / math.pi
                        through[c] *= share * cosine / density
        for axis in range(3):
            origin[axis] = point[axis]
        direction[0], direction[1], direction[2] = x, y, z
        if turn >= 2:
            most = max(through[0], max(through[1], through[2]))
            live = min(0.97 if turn < 5 else 0.8, most)
            if draw(state) >= live:
                return
            for c in range(3):
                through[c] /= live


@kernel
def trace(space, rows, drawn, linear, light, lens, key, start, stop, film, features, top, bottom):
    """Add the samples `start`..`stop` of the rows `top`..`bottom` to a film.

    Parameters
    ----------
    space : Space
    rows : (N, WIDTH) float64
        A material a label.
    drawn : (256,) uint8
        1 for labels that are material.
    linear : (256,) float64
        sRGB to linear light.
    light : (11, 4) float64
        See LAMP and the other rows.
    lens : (6, 3) float64
        Eye; steps to the next pixel and the next row, at unit distance along the axis; middle of
        the upper left pixel, likewise; then (radius of the lens, distance in focus, 1 where rays
        are parallel); the axis.
    key : uint64
    film : (2, H, W, 3) float64
        Sums of the even samples and of the odd ones.
    features : (H, W, 8) float32
        Sums of what paths meet first.
    """
    origin, direction = np.empty(3), np.empty(3)
    work = (
        np.empty(3), np.empty(3), np.empty(3), np.empty(WIDTH), np.empty(3), np.empty(3),
        np.empty(3), light[LAMP].copy(),
    )  # fmt: skip
    radiance, first, state = np.empty(3), np.empty(8), np.empty(1, np.uint64)
    radius, focus, parallel = lens[4, 0], lens[4, 1], lens[4, 2]
    for row in range(top, bottom):
        for column in range(film.shape[2]):
            words = philox(key, row, column, 0, 0)
            seed = (words[0] << np.uint64(32)) | words[1]
            for number in range(start, stop):
                state[0] = mix(seed + np.uint64(number) * np.uint64(0xD1B54A32D192ED03))
                u, v = pair(seed, number, 0)
                right, down = column + _tent(u), row + _tent(v)
                if parallel > 0:
                    for k in range(3):
                        origin[k] = lens[3, k] + right * lens[1, k] + down * lens[2, k]
                        direction[k] = lens[5, k]
                else:
                    for k in range(3):
                        origin[k] = lens[0, k]
                        direction[k] = lens[3, k] + right * lens[1, k] + down * lens[2, k]
                    if radius > 0:
                        u, v = pair(seed, number, 1)
                        _defocus(lens, radius, focus, u, v, origin, direction)
                length = math.sqrt(dot(direction, direction))
                for k in range(3):
                    direction[k] /= length
                radiance[:] = 0.0
                first[:] = 0.0
                _path(
                    space, rows, drawn, linear, light, origin, direction, number, seed, state, work,
                    radiance, first,
                )  # fmt: skip
                for c in range(3):
                    film[number & 1, row, column, c] += radiance[c]
                for c in range(8):
                    features[row, column, c] += first[c]


@inline
def _tent(u):
    """Return a place in a pixel, -1..1, by the tent filter."""
    u = 2.0 * u
    return math.sqrt(u) - 1.0 if u < 1 else 1.0 - math.sqrt(2.0 - u)


@inline
def _defocus(lens, radius, focus, u, v, origin, direction):
    """Start a ray elsewhere on the lens, towards the same point in focus."""
    r, turn = radius * math.sqrt(u), 2 * math.pi * v
    a, b = r * math.cos(turn), r * math.sin(turn)
    step = math.sqrt(dot(lens[1], lens[1]))
    for k in range(3):
        shift = (a * lens[1, k] + b * lens[2, k]) / step
        direction[k] = focus * direction[k] - shift
        origin[k] += shift

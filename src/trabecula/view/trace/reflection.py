"""How a surface sends light on: a mirror of small facets above a diffuse ground.

GGX facets, drawn as they are seen (Walter et al. 2007; Heitz 2018,
https://jcgt.org/published/0007/04/01/), Fresnel's factor after Schlick. Directions point away from
the surface.
"""

from __future__ import annotations

import math

from trabecula.engine.compile import inline
from trabecula.view.trace.sampling import frame


@inline
def dot(a, b):
    """Return the inner product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def fresnel(base, cosine):
    """Return the share that is mirrored at an angle, `base` of it squarely (Schlick 1994)."""
    return base + (1.0 - base) * (1.0 - min(max(cosine, 0.0), 1.0)) ** 5


@inline
def _lambda(cosine, alpha):
    """Return Smith's integral of the facets hidden from a direction."""
    tangent = max(0.0, 1.0 / (cosine * cosine) - 1.0)
    return 0.5 * (math.sqrt(1.0 + alpha * alpha * tangent) - 1.0)


@inline
def facets(normal, out, to, alpha):
    """Return the mirror term without Fresnel's factor, D G / (4 cos cos), the density of its
    draws, and the cosine between a direction and the facet.
    """
    co, ct = dot(normal, out), dot(normal, to)
    if co <= 1e-4 or ct <= 1e-4:
        return 0.0, 0.0, 0.0
    hx, hy, hz = out[0] + to[0], out[1] + to[1], out[2] + to[2]
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    if length < 1e-9:
        return 0.0, 0.0, 0.0
    ch = min((normal[0] * hx + normal[1] * hy + normal[2] * hz) / length, 1.0)
    between = (out[0] * hx + out[1] * hy + out[2] * hz) / length
    sharp = alpha * alpha
    peak = sharp / (math.pi * (ch * ch * (sharp - 1.0) + 1.0) ** 2)
    lo, lt = _lambda(co, alpha), _lambda(ct, alpha)
    value = peak / (1.0 + lo + lt) / (4.0 * co * ct)
    density = peak / (1.0 + lo) / (4.0 * co)
    return value, density, between


@inline
def draw_facet(normal, out, alpha, u, v):
    """Draw the normal of a facet that is seen from a direction."""
    sx, sy, sz, tx, ty, tz = frame(normal)
    x = alpha * (out[0] * sx + out[1] * sy + out[2] * sz)
    y = alpha * (out[0] * tx + out[1] * ty + out[2] * tz)
    z = dot(out, normal)
    length = math.sqrt(x * x + y * y + z * z)
    x, y, z = x / length, y / length, z / length
    flat = x * x + y * y
    ax, ay = (-y / math.sqrt(flat), x / math.sqrt(flat)) if flat > 1e-12 else (1.0, 0.0)
    bx, by, bz = -z * ay, z * ax, x * ay - y * ax
    r, turn = math.sqrt(u), 2 * math.pi * v
    p, q = r * math.cos(turn), r * math.sin(turn)
    share = 0.5 * (1.0 + z)
    q = (1.0 - share) * math.sqrt(max(0.0, 1.0 - p * p)) + share * q
    w = math.sqrt(max(0.0, 1.0 - p * p - q * q))
    hx = alpha * (p * ax + q * bx + w * x)
    hy = alpha * (p * ay + q * by + w * y)
    hz = max(1e-6, q * bz + w * z)
    length = math.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hy, hz = hx / length, hy / length, hz / length
    return (
        hx * sx + hy * tx + hz * normal[0],
        hx * sy + hy * ty + hz * normal[1],
        hx * sz + hy * tz + hz * normal[2],
    )


@inline
def scattering_albedo(albedo):
    """Return the share that one scattering leaves so that a thick body has that albedo (Chiang et
    al. 2016, Practical and controllable subsurface scattering, doi:10.1145/2897839.2927433).
    """
    a = min(max(albedo, 0.0), 0.999)
    return 1.0 - math.exp(-5.09406 * a + 2.61188 * a * a - 4.31805 * a * a * a)


@inline
def dielectric(cosine, ratio):
    """Return the share that a smooth boundary mirrors, and the cosine of what it lets through.

    `ratio` is the refractive index of the near side over that of the far one (Fresnel's equations).
    """
    sine = ratio * ratio * max(0.0, 1.0 - cosine * cosine)
    if sine >= 1.0:
        return 1.0, 0.0
    through = math.sqrt(1.0 - sine)
    across = (ratio * cosine - through) / (ratio * cosine + through)
    along = (cosine - ratio * through) / (cosine + ratio * through)
    return 0.5 * (across * across + along * along), through

"""What a material is at a point: albedo, roughness and the rest, varied by noise and by depth.

A material is a row of numbers, see `material.COLUMNS`; lengths are in smallest voxel edges.
"""

from __future__ import annotations

import math

import numpy as np

from trabecula.engine.compile import inline
from trabecula.view.trace.sampling import mix
from trabecula.view.trace.space import rim_depth

# Columns of a material's row.
ALBEDO, ROUGHNESS, SPECULAR, METALNESS, SCATTERING = 0, 3, 4, 5, 6
TRANSMISSION, REFRACTION, ABSORPTION = 7, 8, 9
GRAIN, GRAIN_SIZE, GRAIN_ALBEDO = 10, 11, 12
VEINS, VEIN_SPACING, VEIN_WIDTH, VEIN_ALBEDO = 15, 16, 17, 18
SPECKS, SPECK_SIZE, SPECK_ALBEDO = 21, 22, 23
BUMP, BUMP_SIZE = 26, 27
UNEVENNESS, PATCH, FLOUR, STOPS, RIM = 28, 29, 30, 31, 32
RIM_STOPS = 6
RIM_ROUGHNESS = RIM + 4 * RIM_STOPS
WIDTH = RIM_ROUGHNESS + 1


@inline
def _corner(i, j, k, x, y, z, seed):
    """Return the part of one corner of a cell in gradient noise: one of 12 slopes."""
    word = mix(
        np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)
        ^ np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F)
        ^ np.uint64(k) * np.uint64(0x165667B19E3779F9)
        ^ np.uint64(seed)
    )
    kind = np.int64(word >> np.uint64(40)) % 12
    a = 1.0 if kind & 1 else -1.0
    b = 1.0 if kind & 2 else -1.0
    if kind < 4:
        return a * x + b * y
    if kind < 8:
        return a * x + b * z
    return a * y + b * z


@inline
def noise(x, y, z, seed):
    """Return gradient noise (Perlin 2002) of about -1..1, its cells of edge 1."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    u, v, w = x - i, y - j, z - k
    i, j, k = np.int64(i), np.int64(j), np.int64(k)
    a = u * u * u * (u * (u * 6 - 15) + 10)
    b = v * v * v * (v * (v * 6 - 15) + 10)
    c = w * w * w * (w * (w * 6 - 15) + 10)
    total = 0.0
    for n in range(8):
        dx, dy, dz = n & 1, (n >> 1) & 1, n >> 2
        weight = (a if dx else 1 - a) * (b if dy else 1 - b) * (c if dz else 1 - c)
        total += weight * _corner(i + dx, j + dy, k + dz, u - dx, v - dy, w - dz, seed)
    return total


@inline
def turbulence(x, y, z, octaves, seed):
    """Return noise summed over octaves, each half as strong and half as large, about -1..1."""
    total, strength, scale = 0.0, 0.5, 1.0
    for n in range(octaves):
        total += strength * noise(x * scale, y * scale, z * scale, seed + n)
        strength *= 0.5
        scale *= 2.03
    return 1.4 * total


@inline
def _ramp(value, low, high):
    t = min(max((value - low) / (high - low), 0.0), 1.0)
    return t * t * (3 - 2 * t)


@inline
def _speck(x, y, z, share):
    """Return the share of a speck that covers a point: a ball in some cells of edge 1."""
    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    covered = 0.0
    for n in range(27):
        a, b, c = i + n % 3 - 1, j + (n // 3) % 3 - 1, k + n // 9 - 1
        word = mix(
            np.uint64(a) * np.uint64(0x9E3779B97F4A7C15)
            ^ np.uint64(b) * np.uint64(0xC2B2AE3D27D4EB4F)
            ^ np.uint64(c) * np.uint64(0x165667B19E3779F9)
        )
        if (word & np.uint64(0xFFFF)) > np.uint64(65535.0 * share):
            continue
        dx = x - a - 0.2 - 0.6 * np.float64((word >> np.uint64(16)) & np.uint64(0xFFFF)) / 65535
        dy = y - b - 0.2 - 0.6 * np.float64((word >> np.uint64(32)) & np.uint64(0xFFFF)) / 65535
        dz = z - c - 0.2 - 0.6 * np.float64(word >> np.uint64(48)) / 65535
        radius = 0.2 + 0.3 * np.float64(mix(word) >> np.uint64(48)) / 65535
        distance = math.sqrt(dx * dx + dy * dy + dz * dz)
        covered = max(covered, 1 - _ramp(distance, radius * 0.85, radius))
    return covered


@inline
def shade(rim, coarse, row, x, y, z, lift, octaves, out):
    """Write the material at a point: the row's first columns, varied by so many octaves of noise;
    `lift` is the normal's share upwards.
    """
    for c in range(10):
        out[c] = row[c]
    if row[GRAIN] > 0:
        s = row[GRAIN_SIZE]
        share = row[GRAIN] * _ramp(turbulence(x / s, y / s, z / s, octaves, 11), -0.5, 0.5)
        for c in range(3):
            out[c] += share * (row[GRAIN_ALBEDO + c] - out[c])
    if row[VEINS] > 0:
        s = row[VEIN_SPACING]
        bend = turbulence(0.7 * x / s, 0.7 * y / s, 0.7 * z / s, octaves, 23)
        v = abs(noise(x / s + 1.3 * bend, y / s - bend, z / s + 0.8 * bend, 31))
        strength = 0.4 + 0.6 * _ramp(noise(0.5 * x / s, 0.5 * y / s, 0.5 * z / s, 37), -0.4, 0.4)
        share = row[VEINS] * strength * (1 - _ramp(v, 0.0, row[VEIN_WIDTH]))
        for c in range(3):
            out[c] += share * (row[VEIN_ALBEDO + c] - out[c])
    if row[SPECKS] > 0:
        s = row[SPECK_SIZE]
        share = _speck(x / s, y / s, z / s, row[SPECKS])
        for c in range(3):
            out[c] += share * (row[SPECK_ALBEDO + c] - out[c])
    stops = int(row[STOPS])
    if stops > 0:
        _crust(rim, coarse, row, stops, x, y, z, lift, octaves, out)


@inline
def _crust(rim, coarse, row, stops, x, y, z, lift, octaves, out):
    """Colour what lies near the outside of the form by its depth."""
    deepest = row[RIM + 4 * (stops - 1)]
    depth = rim_depth(rim, coarse, x, y, z)
    if depth > 2.5 * deepest:
        return
    s = row[PATCH]
    rough = turbulence(x / s, y / s, z / s, octaves, 53)
    depth = max(
        depth * (1 + 0.5 * row[UNEVENNESS] * rough) + 0.45 * row[UNEVENNESS] * deepest * rough, 0.0
    )
    if depth >= deepest:
        return
    n = 1
    while depth > row[RIM + 4 * n]:
        n += 1
    low, high = row[RIM + 4 * (n - 1)], row[RIM + 4 * n]
    t = min(max((depth - low) / max(high - low, 1e-9), 0.0), 1.0)
    for c in range(3):
        a = row[RIM + 4 * (n - 1) + 1 + c]
        b = out[c] if n == stops - 1 else row[RIM + 4 * n + 1 + c]
        out[c] = a + t * (b - a)
    near = 1 - depth / deepest
    out[ROUGHNESS] += near * (row[RIM_ROUGHNESS] - out[ROUGHNESS])
    out[SCATTERING] *= 1 - 0.7 * near
    if row[FLOUR] > 0 and lift > 0:
        dust = turbulence(2.2 * x / s, 2.2 * y / s, 2.2 * z / s, 5, 71)
        share = near * near * _ramp(lift, 0.0, 0.7) * _ramp(dust + row[FLOUR], 0.45, 1.0)
        for c in range(3):
            out[c] += share * (0.84 - out[c])
        out[ROUGHNESS] += share * (1 - out[ROUGHNESS])


@inline
def tilt(row, x, y, z, normal):
    """Tilt a normal by fine roughness."""
    if row[BUMP] <= 0:
        return
    s = row[BUMP_SIZE]
    length = 0.0
    for axis in range(3):
        seed = 101 + 7 * axis
        value = noise(x / s, y / s, z / s, seed) + 0.6 * noise(
            2.3 * x / s, 2.3 * y / s, 2.3 * z / s, seed + 3
        )
        normal[axis] += row[BUMP] * value
        length += normal[axis] ** 2
    length = math.sqrt(length)
    for axis in range(3):
        normal[axis] /= length

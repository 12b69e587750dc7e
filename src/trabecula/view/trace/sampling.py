"""Random numbers of a path: functions of pixel, sample and place in the path, never of the order
of work; and directions drawn with them.

The first dimensions of a path are points of Sobol's (0, 2)-sequence, scrambled by nested uniform
hashes and shuffled for every pair of dimensions (Burley 2020, Practical hash-based Owen scrambling,
https://jcgt.org/published/0009/04/01/): the error of a pixel falls faster than that of chance. What
comes later takes a counter through a mixing function (Steele et al. 2014,
doi:10.1145/2660193.2660195).
"""

from __future__ import annotations

import math

import numpy as np

from trabecula.engine.compile import inline

_LOW = np.uint64(0xFFFFFFFF)
_ONE = np.uint64(1)
SPREAD = 1.0 / 4294967296.0


@inline
def _reverse(x):
    """Reverse the order of 32 bits."""
    x = ((x >> np.uint64(1)) & np.uint64(0x55555555)) | (
        (x & np.uint64(0x55555555)) << np.uint64(1)
    )
    x = ((x >> np.uint64(2)) & np.uint64(0x33333333)) | (
        (x & np.uint64(0x33333333)) << np.uint64(2)
    )
    x = ((x >> np.uint64(4)) & np.uint64(0x0F0F0F0F)) | (
        (x & np.uint64(0x0F0F0F0F)) << np.uint64(4)
    )
    x = ((x >> np.uint64(8)) & np.uint64(0x00FF00FF)) | (
        (x & np.uint64(0x00FF00FF)) << np.uint64(8)
    )
    return ((x >> np.uint64(16)) | (x << np.uint64(16))) & _LOW


@inline
def _permute(x, seed):
    """Permute 32 reversed bits so that each depends on those below it alone (Laine and Karras)."""
    x = (x + seed) & _LOW
    x ^= (x * np.uint64(0x6C50B47C)) & _LOW
    x ^= (x * np.uint64(0xB82F1E52)) & _LOW
    x ^= (x * np.uint64(0xC7AFE638)) & _LOW
    x ^= (x * np.uint64(0x8D22F6E6)) & _LOW
    return x


@inline
def mix(x):
    """Mix 64 bits."""
    x = np.uint64(x)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@inline
def pair(seed, sample, dimension):
    """Return two numbers in 0..1 of one sample of a pixel, in a pair of dimensions."""
    word = mix(np.uint64(seed) + np.uint64(dimension) * np.uint64(0x9E3779B97F4A7C15))
    index = _reverse(_permute(_reverse(np.uint64(sample)), word & _LOW))
    first = _reverse(_permute(index, word >> np.uint64(32)))
    second, column, bits = np.uint64(0), np.uint64(0x80000000), index
    for _ in range(32):
        second ^= column & (np.uint64(0) - (bits & _ONE))  # without a branch: bits are random
        column ^= column >> _ONE
        bits = bits >> _ONE
    second = _reverse(_permute(_reverse(second), mix(word) & _LOW))
    return np.float64(first) * SPREAD, np.float64(second) * SPREAD


@inline
def draw(state):
    """Return the next number in 0..1 of a counter, state (1,) uint64."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    return np.float64(mix(state[0]) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@inline
def frame(n):
    """Return two unit vectors across a unit vector (Duff et al. 2017)."""
    sign = 1.0 if n[2] >= 0 else -1.0
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return (
        1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0],
        b, sign + n[1] * n[1] * a, -n[1],
    )  # fmt: skip


@inline
def around(axis, u, v, least):
    """Draw a direction evenly from the cone about an axis whose cosine is at least `least`."""
    cosine = 1.0 - u * (1.0 - least)
    sine = math.sqrt(max(0.0, 1.0 - cosine * cosine))
    a, b = sine * math.cos(2 * math.pi * v), sine * math.sin(2 * math.pi * v)
    sx, sy, sz, tx, ty, tz = frame(axis)
    return (
        a * sx + b * tx + cosine * axis[0],
        a * sy + b * ty + cosine * axis[1],
        a * sz + b * tz + cosine * axis[2],
    )


@inline
def by_cosine(axis, u, v):
    """Draw a direction about a normal with a density of cosine / pi."""
    return around(axis, 1.0 - math.sqrt(1.0 - u), v, 0.0)


@inline
def anywhere(u, v):
    """Draw a direction evenly from all."""
    z = 1.0 - 2.0 * u
    r = math.sqrt(max(0.0, 1.0 - z * z))
    return r * math.cos(2 * math.pi * v), r * math.sin(2 * math.pi * v), z

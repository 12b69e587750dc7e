"""The case table: closed loops, faces that fit their neighbours, outward triangles."""

from collections import Counter

import numpy as np
import pytest

from trabecula.mesh.table import (
    _FACES,
    EDGES,
    _edges_around,
    _segments,
    case_table,
    loops,
    share_face,
)

MIDDLES = np.array([[(a >> k & 1) + (b >> k & 1) for k in range(3)] for a, b, _ in EDGES]) / 2


def corner(index):
    return np.array([index >> k & 1 for k in range(3)])


@pytest.mark.parametrize("config", range(256))
def test_every_cut_edge_is_in_exactly_one_loop(config):
    cut = [e for e, (a, b, _) in enumerate(EDGES) if (config >> a & 1) != (config >> b & 1)]
    assert sorted(edge for loop in loops(config) for edge in loop) == cut


def test_both_cubes_at_a_face_draw_the_same_segments_in_opposite_directions():
    """Compare the common face of two cubes in all 2**4 states, for the three axes."""
    for axis in range(3):
        upper, lower = _FACES[2 * axis + 1], _FACES[2 * axis]
        assert [c ^ 1 << axis for c in sorted(upper)] == sorted(lower)
        for state in range(16):
            here = sum((state >> k & 1) << c for k, c in enumerate(upper))
            there = sum((state >> k & 1) << (c ^ 1 << axis) for k, c in enumerate(upper))
            shift = np.eye(3)[axis]
            across = {
                tuple(MIDDLES[e] - shift): tuple(MIDDLES[f] - shift)
                for e, f in _segments(here, upper).items()
            }
            back = {
                tuple(MIDDLES[f]): tuple(MIDDLES[e]) for e, f in _segments(there, lower).items()
            }
            assert across == back


def test_no_diagonal_of_a_loop_lies_in_a_face_of_the_cube():
    counts, triangles = case_table()
    for config in range(256):
        faces = triangles[config, : 3 * counts[config]].reshape(-1, 3)
        sides = Counter(
            frozenset(pair) for face in faces for pair in zip(face, np.roll(face, -1), strict=True)
        )
        for pair, uses in sides.items():
            assert uses == 1 or not share_face(*pair)


def test_triangles_face_away_from_the_solid_corners_they_cut_off():
    counts, triangles = case_table()
    for config in range(1, 255):
        faces = triangles[config, : 3 * counts[config]].reshape(-1, 3)
        for face in faces:
            a, b, c = MIDDLES[face]
            normal = np.cross(b - a, c - a)
            assert np.linalg.norm(normal) > 0.1
            # Summed over the three cut edges, the way from the solid to the void end follows the
            # normal.
            ways = [
                (corner(EDGES[e][1]) - corner(EDGES[e][0]))
                * (1 if config >> EDGES[e][0] & 1 else -1)
                for e in face
            ]
            assert normal @ sum(ways) > 0


def test_solid_corners_on_a_diagonal_are_separated_and_void_ones_joined():
    assert len(loops(0b00001001)) == 2  # corners 0 and 3: a diagonal of the lower face
    assert len(loops(0b11110110)) == 1
    assert all(len(_edges_around(face)) == 4 for face in _FACES)

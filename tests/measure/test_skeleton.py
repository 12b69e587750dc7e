"""Skeletons: topology against brute force, lines that are known, and the graph's book-keeping."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import ndimage

import trabecula as tb
from trabecula.measure import components, euler, skeleton_graph, thin
from trabecula.measure.skeleton import simple

FULL = np.ones((3, 3, 3), bool)
FACES = ndimage.generate_binary_structure(3, 1)
EDGES = ndimage.generate_binary_structure(3, 2)

volumes = arrays(bool, array_shapes(min_dims=2, max_dims=3, min_side=1, max_side=9))


def truly_simple(cube: np.ndarray) -> bool:
    """Decide by definition, 26 neighbours inside and 6 outside: one component of each around the
    centre, and neither empty.
    """
    inside, outside = cube.copy(), ~cube & EDGES
    inside[1, 1, 1] = outside[1, 1, 1] = False
    pieces = ndimage.label(outside, FACES)[0]
    beside = set(pieces[FACES & outside])
    return ndimage.label(inside, FULL)[1] == 1 and len(beside) == 1


def number(cube: np.ndarray) -> int:
    return sum(1 << int(k) for k in np.flatnonzero(cube))


@given(arrays(bool, (3, 3, 3)), st.integers(0, 2))
def test_simple_points_by_definition(cube, thinning):
    if thinning:
        cube &= np.random.default_rng(number(cube)).random((3, 3, 3)) < 0.4 / thinning
    cube[1, 1, 1] = True
    other = ~cube
    other[1, 1, 1] = True
    changes = simple.euler_changes()
    assert simple.is_simple(number(cube), changes) == truly_simple(cube)
    assert simple.is_simple_by_faces(number(cube), changes) == truly_simple(other)


@pytest.mark.whole
@given(volumes)
def test_thinning_keeps_the_topology_of_any_volume(solid):
    before = solid.copy()
    lines = thin(solid)
    assert lines.dtype == bool and np.array_equal(solid, before) and np.all(lines <= solid)
    wide = 26 if solid.ndim == 3 else 8
    assert euler(lines, connectivity=wide) == euler(solid, connectivity=wide)
    assert components(lines, connectivity=wide) == components(solid, connectivity=wide)
    outside = [np.pad(~values, 1, constant_values=True) for values in (lines, solid)]
    # with the two above: as many tunnels too
    assert components(outside[0]) == components(outside[1])
    assert np.array_equal(thin(lines), lines)


@given(volumes)
def test_nothing_but_ends_can_be_taken_from_a_skeleton(solid):
    lines = np.pad(thin(solid).reshape((1,) * (3 - solid.ndim) + solid.shape), 1)
    for z, y, x in np.argwhere(lines):
        cube = lines[z - 1 : z + 2, y - 1 : y + 2, x - 1 : x + 2]
        assert cube.sum() <= 2 or not truly_simple(cube)


def test_the_middle_of_a_bar():
    bar = np.zeros((9, 9, 20), bool)
    bar[2:7, 2:7, 2:18] = True
    lines = thin(bar)
    # The second layer is gone all around before its end's turn comes: x is last.
    assert np.argwhere(lines).tolist() == [[4, 4, x] for x in range(3, 17)]
    assert np.array_equal(thin(bar[4]), lines[4])


def ball(radius, hole=0.0):
    z, y, x = np.ogrid[-12:13, -12:13, -12:13]
    far = z * z + y * y + x * x
    return (far <= radius**2) & (far >= hole**2)


# those of whole numbers have a single voxel at every pole
@pytest.mark.parametrize("radius", [2, 3, 5, 7, 7.5, 8, 9])
def test_a_ball_is_a_point(radius):
    middle = np.argwhere(thin(ball(radius))) - 12
    # of what is two wide, two may stay
    assert np.abs(middle).max() <= 1 and np.abs(middle).sum() <= 2


def test_a_shell_stays_a_shell():
    shell = thin(ball(10, hole=5))
    assert euler(shell, connectivity=26) == 2 and components(~shell) == 2
    assert not np.any(shell & ndimage.binary_erosion(shell, EDGES))


def test_a_ring_is_a_cycle_of_its_length():
    z, y, x = np.ogrid[-4:5, -24:25, -24:25]
    ring = (np.hypot(y, x) - 18) ** 2 + z * z <= 9
    graph = skeleton_graph(ring)
    assert (graph.branches, graph.ends, graph.loops, len(graph.joints)) == (1, 0, 1, 0)
    assert graph.kind.tolist() == [3] and graph.span.tolist() == [0]
    # steps of 1, sqrt 2 and sqrt 3 only
    assert graph.length[0] == pytest.approx(2 * np.pi * 18, rel=0.08)
    assert np.array_equal(graph.path(0)[0], graph.path(0)[-1]) and np.all(graph.path(0)[:, 0] == 4)


def lattice(cells: int, edge: int = 9, thick: int = 3) -> np.ndarray:
    side = cells * edge + thick
    on = np.zeros(side, bool)
    for first in range(0, side, edge):
        on[first : first + thick] = True
    z, y, x = on[:, None, None], on[None, :, None], on[None, None, :]
    return np.pad((z & y) | (z & x) | (y & x), 2)


@pytest.mark.parametrize("cells", [1, 2])
def test_a_lattice_has_the_joints_branches_and_loops_of_one(cells):
    graph = skeleton_graph(lattice(cells))
    nodes, edges = (cells + 1) ** 3, 3 * cells * (cells + 1) ** 2
    assert (len(graph.joints), graph.branches, graph.ends) == (nodes, edges, 0)
    assert graph.loops == edges - nodes + 1 and np.all(graph.kind == 2)
    assert graph.length == pytest.approx(graph.span)
    corners = np.array(list(product(range(cells + 1), repeat=3))) * 9 + 3
    assert np.abs(graph.joints - corners).max() < 1  # a corner is rounded off inwards


def test_lengths_are_in_the_unit_of_the_image():
    cross = np.zeros((9, 15, 21), np.uint8)
    cross[4, 7, :] = cross[4, :, 10] = cross[:, 7, 10] = 1
    graph = skeleton_graph(tb.Image(cross, "labels", spacing=(3.0, 2.0, 0.5), unit="um"))
    assert (graph.ends, len(graph.joints), graph.loops) == (6, 1, 0) and graph.unit == "um"
    # The joint is the crossing and its six neighbours, each with four or more: a step before the
    # middle.
    assert sorted(graph.length) == sorted([3 * 3.0] * 2 + [6 * 2.0] * 2 + [9 * 0.5] * 2)
    assert (
        graph.joints.tolist() == [[4, 7, 10]]
        and np.all(graph.kind == 1)
        and np.all(graph.start == -1)
    )


def test_a_span_is_the_straight_line_in_the_unit_of_the_image():
    bow = np.zeros((12, 12), np.uint8)
    bow[1, 1:9] = bow[1:10, 8] = 1
    graph = skeleton_graph(tb.Image(bow, "labels", spacing=(3.0, 2.0), unit="um"))
    first, last = graph.path(0)[0], graph.path(0)[-1]
    assert graph.branches == 1
    assert graph.span[0] == pytest.approx(np.hypot(*(last - first) * (3.0, 2.0)))
    assert graph.span[0] < graph.length[0]


@pytest.mark.whole
@given(volumes)
def test_every_voxel_is_in_one_branch_or_joint(solid):
    graph = skeleton_graph(solid)
    lines = graph.skeleton
    assert np.array_equal(lines, thin(solid))
    near = ndimage.convolve(lines.astype(int), np.ones((3,) * solid.ndim, int), mode="constant") - 1
    joints = np.zeros(lines.shape, int)
    joints[tuple(graph.joint_voxels.T)] = graph.joint_of + 1
    assert np.array_equal(joints > 0, lines & (near > 2))
    assert len(graph.joints) == components(joints > 0, connectivity=26 if solid.ndim == 3 else 8)
    assert graph.ends == np.count_nonzero(lines & (near <= 1))
    seen = np.zeros(lines.shape, int)
    for branch in range(graph.branches):
        path = graph.path(branch)
        inner = path[joints[tuple(path.T)] == 0]
        inner = inner[:-1] if graph.kind[branch] == 3 else inner
        seen[tuple(inner.T)] += 1
        assert np.all(np.abs(np.diff(path, axis=0)).max(axis=1) == 1)
        assert (
            joints[tuple(path[0])] - 1 == graph.start[branch]
            and joints[tuple(path[-1])] - 1 == graph.stop[branch]
        )
        steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
        assert (
            graph.length[branch] == pytest.approx(steps.sum())
            and graph.length[branch] >= graph.span[branch] - 1e-9
        )
    assert np.array_equal(seen, lines & (near <= 2))


def test_phases_and_refusals():
    values = np.zeros((5, 9, 9), np.uint8)
    values[2, 2, 2:7], values[2, 6, 2:7] = 1, 2
    image = tb.Image(values, "labels", phases=("void", "a", "b"))
    assert skeleton_graph(image).branches == 2 and np.array_equal(
        thin(image, phase="a"), values == 1
    )
    empty = skeleton_graph(np.zeros((4, 4), np.uint8))
    assert (empty.branches, empty.ends, empty.loops, empty.joints.shape) == (0, 0, 0, (0, 2))
    with pytest.raises(tb.errors.InputError, match="labels are needed"):
        thin(tb.Image(np.ones((4, 4)), "grey"))
    with pytest.raises(tb.errors.InputError, match="unknown phase"):
        skeleton_graph(values > 0, phase="bone")


def test_real_bone_keeps_its_topology(data):
    import tifffile

    bone = tifffile.imread(data / "trabecular_bone_a.tif")[20:100, 20:100, 20:100] > 0
    graph = skeleton_graph(bone)
    assert euler(graph.skeleton, connectivity=26) == euler(bone, connectivity=26)
    assert components(graph.skeleton, connectivity=26) == components(bone, connectivity=26)
    assert graph.loops > 100 and 3 < np.median(graph.length) < 12

"""Connectivity 18, masks and periodic faces of the counting measures, component sizes,
percolation.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import ndimage, stats

import trabecula as tb
from trabecula import measure
from trabecula.measure.components import component_distance, component_sizes, size_distribution
from trabecula.measure.percolation import percolating_fraction
from trabecula.measure.phases import as_axis, as_mask, as_periodic

volumes = arrays(bool, array_shapes(min_dims=3, max_dims=3, min_side=2, max_side=6))
pictures = arrays(bool, array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=8))
wraps = st.tuples(st.booleans(), st.booleans(), st.booleans())
z, y, x = np.ogrid[-20:21, -20:21, -20:21]
ball = z**2 + y**2 + x**2 < 12.3**2


def roll(inside, shift):
    return np.roll(inside, shift, axis=tuple(range(inside.ndim)))


@pytest.mark.whole
@given(volumes)
def test_18_neighbours_cut_what_meets_in_a_vertex_only(inside):
    # Count the vertices at which exactly two voxels, opposite each other, meet.
    padded = np.pad(inside, 1).astype(int)
    corners = [
        padded[i : i - 1 or None, j : j - 1 or None, k : k - 1 or None]
        for i, j, k in np.ndindex(2, 2, 2)
    ]
    two = sum(corners) == 2
    opposite = sum((corners[i] & corners[7 - i]) for i in range(4)) == 1
    expected = measure.euler(inside, connectivity=26) + np.count_nonzero(two & opposite)
    assert measure.euler(inside, connectivity=18) == expected


def test_euler_of_touching_voxels_in_every_connectivity():
    edge, vertex = np.zeros((2, 2, 2), bool), np.zeros((2, 2, 2), bool)
    edge[0, 0, 0] = edge[0, 1, 1] = vertex[0, 0, 0] = vertex[1, 1, 1] = True
    assert [measure.euler(edge, connectivity=c) for c in (6, 18, 26)] == [2, 1, 1]
    assert [measure.euler(vertex, connectivity=c) for c in (6, 18, 26)] == [2, 2, 1]
    assert [measure.components(vertex, connectivity=c) for c in (6, 18, 26)] == [2, 2, 1]


@pytest.mark.parametrize("connectivity", [6, 18, 26])
def test_euler_of_balls_hollow_balls_and_tori(connectivity):
    hollow = ball & (z**2 + y**2 + x**2 > 36)
    torus = (np.sqrt(y**2 + x**2) - 12) ** 2 + z**2 < 16
    five = np.concatenate([ball] * 5)
    for body, number in [(ball, 1), (hollow, 2), (torus, 0), (five, 5)]:
        assert measure.euler(body, connectivity=connectivity) == number
        assert (
            measure.euler(roll(body, (21, 3, -17)), connectivity=connectivity, periodic=True)
            == number
        )


def test_euler_of_periodic_slabs_rods_and_squares():
    slab, rod = np.zeros((8, 9, 10), bool), np.zeros((8, 9, 10), bool)
    slab[2:5] = True
    rod[2:5, 3:6] = True
    # A slab closed in both its directions is a thick torus, a rod closed in its own a ring: both
    # have none.
    assert measure.euler(slab, periodic=True) == 0 and measure.euler(slab) == 1
    assert (
        measure.euler(rod, periodic=(False, False, True)) == 0
        and measure.euler(rod, periodic=(True, True, False)) == 1
    )
    assert measure.euler(slab[0] | True, periodic=True) == 0


def test_periodic_layers_and_their_densities():
    layers = np.zeros((20, 6, 6), np.uint8)
    layers[np.arange(20) % 10 < 3] = 1
    result = measure.minkowski(layers, periodic=True)
    assert result.volume == pytest.approx(0.3) and result.mean_curvature == pytest.approx(
        0, abs=1e-12
    )
    assert result.surface == pytest.approx(
        4 / 20, rel=0.09
    ) and result.euler_density == pytest.approx(0, abs=1e-12)
    assert measure.specific_surface(layers, periodic=True) == result.surface
    assert measure.chord_length(layers, axis=0, periodic=True) == pytest.approx(3)
    # Over the 19 cubes that do not wrap, half of the outermost layers is missing.
    assert measure.minkowski(layers).volume == pytest.approx((0.5 + 5) / 19)


@pytest.mark.whole
@given(volumes, st.tuples(*[st.integers(0, 5)] * 3))
def test_periodic_figures_do_not_depend_on_the_origin(inside, shift):
    moved = roll(inside, shift)
    for connectivity in (6, 18, 26):
        assert measure.euler(moved, connectivity=connectivity, periodic=True) == measure.euler(
            inside, connectivity=connectivity, periodic=True
        )
        a, b = (
            component_sizes(v, connectivity=connectivity, periodic=True) for v in (inside, moved)
        )
        assert a.tolist() == b.tolist()
    assert measure.specific_surface(moved, periodic=True) == pytest.approx(
        measure.specific_surface(inside, periodic=True), abs=1e-12
    )


@given(volumes, st.permutations([0, 1, 2]), st.sampled_from([0, 1, 2]))
def test_minkowski_does_not_change_with_flips_and_axes(inside, order, axis):
    result = measure.minkowski(inside, connectivity=18)
    for other in (inside.transpose(order), np.flip(inside, axis)):
        turned = measure.minkowski(other, connectivity=18)
        assert turned.volume == pytest.approx(result.volume) and turned.surface == pytest.approx(
            result.surface, abs=2e-3
        )
        assert turned.mean_curvature == pytest.approx(result.mean_curvature, abs=1e-9)
        assert turned.euler_density == pytest.approx(result.euler_density, abs=1e-9)


@given(volumes)
def test_periodic_euler_numbers_of_the_two_sides_are_dual(inside):
    # On a torus, whose own Euler number is 0, open cells of one side and closed cells of the other
    # cancel.
    narrow, wide = (
        measure.euler(side, connectivity=c, periodic=True)
        for side, c in ((~inside, 6), (inside, 26))
    )
    assert narrow == wide


@pytest.mark.whole
@given(volumes, arrays(bool, (6, 6, 6)))
def test_masked_densities_count_the_cubes_inside_the_mask(inside, mask):
    mask = mask[tuple(map(slice, inside.shape))]
    windows = np.lib.stride_tricks.sliding_window_view
    whole = windows(mask, (2, 2, 2)).all(axis=(3, 4, 5))
    if not whole.any():
        with pytest.raises(tb.errors.InputError, match="mask"):
            measure.minkowski(inside, mask=mask)
        return
    result = measure.minkowski(inside, mask=mask)
    cubes = windows(inside, (2, 2, 2))[whole]
    single = [measure.minkowski(cube) for cube in cubes]
    for name in ("volume", "surface", "mean_curvature", "euler_density"):
        assert getattr(result, name) == pytest.approx(
            np.mean([getattr(one, name) for one in single]), abs=1e-9
        )


def test_a_box_as_mask_is_a_crop():
    solid = np.random.default_rng(0).random((12, 11, 10)) < 0.5
    box = (slice(2, 9), slice(1, 9), slice(3, 10))
    mask = np.zeros(solid.shape, bool)
    mask[box] = True
    crop = np.ascontiguousarray(solid[box])
    assert measure.minkowski(solid, mask=mask) == measure.minkowski(crop)
    assert measure.euler(solid, mask=mask) == measure.euler(crop)
    assert measure.porosity(solid, mask=mask) == measure.porosity(crop)
    assert measure.volume_fractions(solid, mask=mask) == measure.volume_fractions(crop)
    assert measure.chord_length(solid, mask=mask) == pytest.approx(measure.chord_length(crop))
    assert measure.percolates(solid, mask=mask, connectivity=6) == measure.percolates(crop)
    assert component_sizes(solid, mask=mask).tolist() == component_sizes(crop).tolist()
    for axis in range(3):
        assert percolating_fraction(solid, axis=axis, mask=mask) == percolating_fraction(
            crop, axis=axis
        )


def periodic_oracle(inside, order, closed):
    """Label by SciPy, on the image three times along every periodic axis: components that are
    copies of each other are one.
    """
    tiled = np.pad(
        inside,
        [(side, side) if wrap else (0, 0) for side, wrap in zip(inside.shape, closed, strict=True)],
        "wrap",
    )
    found, _ = ndimage.label(tiled, ndimage.generate_binary_structure(inside.ndim, order))
    links = {}

    def root(k):
        while links.setdefault(k, k) != k:
            k = links[k]
        return k

    for place in np.argwhere(tiled):
        home = tuple(
            p % side + side * wrap
            for p, side, wrap in zip(place, inside.shape, closed, strict=True)
        )
        links[root(found[tuple(place)])] = root(found[home])
    middle = tuple(
        slice(s, 2 * s) if wrap else slice(None)
        for s, wrap in zip(inside.shape, closed, strict=True)
    )
    return np.vectorize(root, otypes=[int])(found[middle]) * inside


@settings(max_examples=60)
@given(volumes | pictures, wraps, st.sampled_from([0, 1, 2]))
def test_periodic_components_equal_tiled_scipy(inside, closed, rank):
    closed = closed[: inside.ndim]
    connectivity, order = (
        [(6, 1), (18, 2), (26, 3)][rank] if inside.ndim == 3 else [(4, 1), (8, 2), (8, 2)][rank]
    )
    labels, sizes = measure.label_components(inside, connectivity=connectivity, periodic=closed)
    expected = periodic_oracle(inside, order, closed)
    pairs = np.unique(np.stack([labels[inside], expected[inside]]), axis=1)
    assert pairs.shape[1] == len(sizes) == len(np.unique(expected[inside]))
    assert np.array_equal(sizes, np.bincount(labels[inside], minlength=len(sizes) + 1)[1:])
    first = [np.flatnonzero(labels.ravel() == k + 1)[0] for k in range(len(sizes))]
    assert first == sorted(first)


def test_sizes_their_distribution_and_what_floats():
    solid = np.zeros((6, 12, 12), np.uint8)
    solid[:, 2:4, 2:4] = 1  # 24 voxels
    solid[0, 8, :10] = 1  # 10
    solid[3, 6, 6] = solid[5, 11, 11] = 1
    assert component_sizes(solid).tolist() == [24, 10, 1, 1]
    sizes, share = size_distribution(solid)
    assert sizes.tolist() == [1, 10, 24] and share.tolist() == [0.5, 0.75, 1]
    assert measure.floating(solid) == 3 and measure.floating_voxels(solid) == 12
    assert (
        measure.floating(solid, smaller_than=10) == 2
        and measure.floating_voxels(solid, smaller_than=11) == 12
    )
    assert measure.floating(solid, smaller_than=100) == 4
    assert measure.largest_fraction(solid) == pytest.approx(24 / 36)
    with pytest.raises(tb.errors.InputError, match="smaller_than"):
        measure.floating(solid, smaller_than=0)
    empty = np.zeros((4, 4), np.uint8)
    assert component_sizes(empty).size == 0 and size_distribution(empty)[1].size == 0


def test_component_distance_of_known_sets():
    # One piece of 4 of 8 voxels against two of 2: |4 - 2| / 8 for either half of the mass.
    one, two = np.array([[1, 1, 1, 1, 0, 0, 0, 0]]), np.array([[1, 1, 0, 1, 1, 0, 0, 0]])
    assert component_distance(one, two) == pytest.approx(2 / 8)
    assert component_distance(one, two, relative_to="phase") == pytest.approx(1 / 2)
    assert component_distance(one, np.zeros((1, 8), int)) == pytest.approx(4 / 8)
    # The same material, twice as long: the volume of the model is divided out.
    assert component_distance(one, np.array([[1] * 8 + [0] * 8])) == 0
    # Seamless where it repeats: the two ends are one piece.
    assert component_distance(np.array([[1, 0, 1]]), np.array([[1, 1, 0]]), periodic=True) == 0
    with pytest.raises(tb.errors.InputError, match="relative_to"):
        component_distance(one, two, relative_to="box")


@pytest.mark.whole
@given(volumes, volumes, st.sampled_from(["image", "phase"]))
def test_component_distance_equals_scipy_and_is_symmetric(a, b, relative_to):
    def places(inside):
        sizes = measure.label_components(inside)[1]
        return (
            sizes / (inside.size if relative_to == "image" else inside.sum())
            if len(sizes)
            else [0.0]
        )

    distance = component_distance(a, b, relative_to=relative_to)
    assert distance == pytest.approx(stats.wasserstein_distance(places(a), places(b)), abs=1e-12)
    assert distance == pytest.approx(component_distance(b, a, relative_to=relative_to), abs=1e-12)
    assert 0 <= distance <= 1 and component_distance(a, a) == 0


def test_percolating_fraction_and_ways_through_periodic_sides():
    solid = np.zeros((8, 8, 8), np.uint8)
    solid[:, 1, 1] = 1
    solid[2, 4:6, 4:6] = 1
    assert percolating_fraction(solid, axis=0) == pytest.approx(8 / 12)
    assert percolating_fraction(solid, axis=-1) == 0
    assert percolating_fraction(np.zeros((3, 3), np.uint8), axis=0) == 0
    # A rod that leaves at one side and comes back at the other.
    broken = np.zeros((8, 8, 8), np.uint8)
    broken[:4, 0, 3] = broken[3:, 7, 3] = 1
    assert not measure.percolates(broken)["z"] and percolating_fraction(broken, axis=0) == 0
    assert measure.percolates(broken, periodic=(False, True, False)) == {
        "z": True,
        "y": False,
        "x": False,
    }
    assert percolating_fraction(broken, axis=0, periodic=True) == 1
    # Along its own axis a periodic image has end faces all the same.
    assert not measure.percolates(np.eye(2, 6, dtype=np.uint8), periodic=True)["x"]


def test_a_mask_joins_nothing_and_has_end_faces_of_its_own():
    solid, mask = np.ones((6, 6, 6), np.uint8), np.ones((6, 6, 6), bool)
    mask[:, :, 3] = mask[0] = False
    assert measure.components(solid, mask=mask) == 2 and measure.components(solid) == 1
    assert measure.percolates(solid, mask=mask) == {"z": True, "y": True, "x": False}
    assert measure.components(solid, mask=mask, periodic=True) == 1
    assert measure.components(1 - solid, phase="void", mask=mask) == 2


@pytest.mark.parametrize(
    "mask", [np.ones((3, 3), int), np.ones((4, 3), bool), np.zeros((3, 3), bool)]
)
def test_bad_masks_are_refused(mask):
    with pytest.raises(tb.errors.InputError, match="mask"):
        measure.porosity(np.eye(3, dtype=np.uint8), mask=mask)


def test_conversions_of_periodic_axis_and_mask():
    assert as_periodic(True, 3) == (True, True, True) and as_periodic([0, 1], 2) == (False, True)
    assert as_axis(-1, 3) == 2 and as_mask(None, (3, 3)) is None
    with pytest.raises(tb.errors.InputError, match="periodic"):
        as_periodic((True, False), 3)
    with pytest.raises(tb.errors.InputError, match="axis 3"):
        as_axis(3, 3)
    with pytest.raises(tb.errors.InputError, match="6, 18, 26"):
        measure.euler(np.ones((2, 2, 2), bool), connectivity=14)


@pytest.mark.parametrize(("last", "joined"), [((1, 1), 6), ((1, 2), 18), ((2, 2), 26)])
def test_neighbours_across_a_periodic_face(last, joined):
    """They share a face, an edge or a corner there."""
    pair = np.zeros((4, 5, 5), bool)
    pair[0, 1, 1] = pair[(-1, *last)] = True
    for wide in (6, 18, 26):
        sizes = measure.label_components(pair, connectivity=wide, periodic=(True, False, False))[1]
        assert len(sizes) == (1 if wide >= joined else 2)


def test_neighbours_across_two_periodic_faces_at_once():
    pair = np.zeros((4, 5, 5), bool)
    pair[0, 0, 2] = pair[-1, -1, 2] = True
    for wraps, count in (((True, True, False), 1), ((True, False, False), 2)):
        assert len(measure.label_components(pair, connectivity=18, periodic=wraps)[1]) == count

"""Amount, Minkowski functionals, components, thickness: bodies whose values are known, oracles,
invariances.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import ndimage

import trabecula as tb
from trabecula import measure

volumes = arrays(bool, array_shapes(min_dims=3, max_dims=3, min_side=2, max_side=7))
pictures = arrays(bool, array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=9))
z, y, x = np.ogrid[-26:27, -26:27, -26:27]
ball = (z**2 + y**2 + x**2 < 20.3**2).astype(np.uint8)


def cells(inside):
    """List the cells of the closed complex of voxels: those in a voxel, found one by one, as
    doubled coordinates.
    """
    found = set()
    for voxel in np.argwhere(inside):
        found |= {
            tuple(2 * voxel + step) for step in np.array(list(np.ndindex((3,) * inside.ndim))) - 1
        }
    return found


def test_porosity_and_fractions():
    image = tb.Image(
        np.repeat([0, 1, 2], [50, 30, 20]).reshape(10, 10), "labels", phases=("void", "a", "b")
    )
    assert measure.porosity(image) == 0.5 and measure.porosity(image, phase="b") == 0.2
    assert measure.volume_fractions(image) == {"void": 0.5, "a": 0.3, "b": 0.2}


def test_solid_means_all_but_void_and_void_is_a_name():
    values = np.repeat([0, 1, 2], [50, 30, 20]).reshape(10, 10)
    swapped = tb.Image(values, "labels", phases=("a", "void", "b"))
    assert measure.porosity(swapped) == 0.3
    assert measure.two_point(swapped, r_max=1)[0] == pytest.approx(0.7)
    with pytest.raises(tb.errors.InputError, match="void"):
        measure.porosity(tb.Image(values, "labels", phases=("a", "b", "c")))


@pytest.mark.parametrize("stretch", [(1, 1, 1), (2, 1, 0.7)])
def test_ball_has_its_surface_curvature_and_euler_number(stretch):
    radius = 17.0
    body = (
        (z * stretch[0]) ** 2 + (y * stretch[1]) ** 2 + (x * stretch[2]) ** 2 < radius**2
    ).astype(np.uint8)
    image = tb.Image(body, "labels", spacing=stretch, unit="um")
    volume = 52**3 * np.prod(stretch)
    result = measure.minkowski(image)
    assert result.surface * volume == pytest.approx(4 * np.pi * radius**2, rel=0.03)
    assert result.mean_curvature * volume == pytest.approx(4 * np.pi * radius, rel=0.04)
    assert result.euler_density * volume == pytest.approx(1)
    assert (
        measure.specific_surface(image) == result.surface
        and measure.mean_curvature(image) == result.mean_curvature
    )


def test_plane_at_45_degrees_and_along_an_axis():
    flat, tilted = (
        np.zeros((30, 30, 30), np.uint8),
        (np.indices((30, 30, 30))[:2].sum(axis=0) < 29).astype(np.uint8),
    )
    flat[15:] = 1
    assert measure.specific_surface(flat) == pytest.approx(1 / 29, rel=0.09)
    assert measure.specific_surface(tilted) == pytest.approx(np.sqrt(2) / 29, rel=0.09)
    assert measure.mean_curvature(flat) == pytest.approx(0, abs=1e-12)


def test_disc_in_two_dimensions():
    disc = (np.hypot(*np.ogrid[-40:41, -40:41]) < 30).astype(np.uint8)
    result = measure.minkowski(disc)
    assert result.surface * 80**2 == pytest.approx(2 * np.pi * 30, rel=0.03)
    assert result.euler_density * 80**2 == pytest.approx(1)
    assert result.mean_curvature == pytest.approx(2 * np.pi * result.euler_density)


@pytest.mark.parametrize("connectivity", [6, 26])
def test_euler_numbers_of_known_bodies(connectivity):
    torus = (np.sqrt(y**2 + x**2) - 15) ** 2 + z**2 < 36
    shell = (ball == 1) & (z**2 + y**2 + x**2 > 10**2)
    for body, number in [(ball, 1), (torus, 0), (shell, 2), (1 - ball, 2)]:
        assert measure.euler(body.astype(np.uint8), connectivity=connectivity) == number


@pytest.mark.whole
@given(volumes | pictures)
def test_wide_euler_number_counts_cells(inside):
    wide = 26 if inside.ndim == 3 else 8
    dimension = [sum(c % 2 == 0 for c in cell) for cell in cells(inside)]
    assert measure.euler(inside, connectivity=wide) == sum((-1) ** d for d in dimension)


@given(volumes | pictures)
def test_narrow_euler_number_is_the_dual_of_the_wide_one(inside):
    # The open cells of the outside and the closed cells of the inside fill an open box, whose
    # signed count of cells is (-1)^d.
    narrow, wide, sign = (6, 26, 1) if inside.ndim == 3 else (4, 8, -1)
    outside = np.pad(~inside, 1, constant_values=True)
    assert measure.euler(outside, connectivity=narrow) == 1 + sign * measure.euler(
        inside, connectivity=wide
    )


@pytest.mark.whole
@given(volumes, st.permutations([0, 1, 2]))
def test_bodies_apart_add_up_and_axes_do_not_matter(inside, order):
    pair = np.concatenate([inside, np.zeros((2, *inside.shape[1:]), bool), inside])
    for connectivity in (6, 26):
        single = measure.euler(inside, connectivity=connectivity)
        assert measure.euler(pair, connectivity=connectivity) == 2 * single
        assert measure.euler(inside.transpose(order), connectivity=connectivity) == single
    assert measure.specific_surface(inside.transpose(order)) == pytest.approx(
        measure.specific_surface(inside), abs=2e-3
    )


@given(volumes | pictures, st.sampled_from([0, 1, 2]))
def test_components_equal_scipy_in_every_connectivity(inside, rank):
    connectivity, order = (
        [(6, 1), (18, 2), (26, 3)][rank] if inside.ndim == 3 else [(4, 1), (8, 2), (8, 2)][rank]
    )
    labels, sizes = measure.label_components(inside, connectivity=connectivity)
    expected, count = ndimage.label(inside, ndimage.generate_binary_structure(inside.ndim, order))
    assert len(sizes) == count and np.array_equal(
        sizes, np.bincount(expected.ravel(), minlength=1)[1:]
    )
    # The same partition, and each component numbered by its first voxel.
    first = [np.flatnonzero(labels.ravel() == k + 1)[0] for k in range(count)]
    assert first == sorted(first)
    assert len(np.unique(np.stack([labels.ravel(), expected.ravel()]), axis=1).T) == count + (
        not inside.all()
    )


def test_counts_of_loose_parts_and_percolation():
    solid = np.zeros((6, 6, 6), np.uint8)
    solid[:, 2, 2] = 1
    solid[0, 5, :2] = 1
    solid[4, 4, 4] = 1
    assert (
        measure.components(solid) == 3
        and measure.floating(solid) == 2
        and measure.floating_voxels(solid) == 3
    )
    assert measure.largest_fraction(solid) == pytest.approx(6 / 9)
    assert measure.percolates(solid) == {"z": True, "y": False, "x": False}
    assert measure.components(solid, phase="void") == 1
    empty = np.zeros((4, 4), np.uint8)
    assert (
        measure.components(empty) == 0
        and measure.floating(empty) == 0
        and measure.largest_fraction(empty) == 0
    )
    with pytest.raises(tb.errors.InputError, match="6, 18, 26"):
        measure.components(solid, connectivity=8)


@pytest.mark.parametrize("plate", range(2, 9))
def test_thickness_of_a_plate_within_half_a_voxel(plate):
    solid = np.zeros((24, 20, 20), np.uint8)
    solid[7 : 7 + plate] = 1
    assert measure.thickness(solid) == pytest.approx(plate, abs=0.51)
    assert measure.thickness(tb.Image(solid, "labels", spacing=19.5, unit="um")) == pytest.approx(
        19.5 * measure.thickness(solid), rel=1e-5
    )
    assert measure.pore_size(1 - solid) == measure.thickness(solid)


def test_thickness_of_a_ball_a_cylinder_and_both_together():
    assert measure.thickness(ball) == pytest.approx(40.6, abs=0.7)
    rod = np.broadcast_to(np.hypot(y, x) < 8, (53, 53, 53))
    assert measure.thickness(rod) == pytest.approx(16, abs=0.7)
    both = measure.local_thickness(np.concatenate([rod, np.zeros_like(rod[:2]), ball == 1]))
    assert both[26, 26, 26] == pytest.approx(16, abs=0.7) and both[-27, 26, 26] == pytest.approx(
        40.6, abs=0.7
    )
    squeezed = tb.Image(
        (np.hypot(np.hypot(2 * z, y), 0.7 * x) < 16).astype(np.uint8), "labels", spacing=(2, 1, 0.7)
    )
    assert measure.thickness(squeezed) == pytest.approx(32, abs=1)


@settings(max_examples=30)
@given(volumes | pictures, st.sampled_from([1.0, 1.7]))
def test_local_thickness_equals_the_largest_sphere_of_all(inside, first):
    if inside.all():
        with pytest.raises(tb.errors.InputError, match="fills"):
            measure.local_thickness(inside)
        return
    spacing = (first,) + (1.0,) * (inside.ndim - 1)
    radius = ndimage.distance_transform_edt(inside, sampling=spacing)
    points = np.argwhere(inside) * spacing
    expected = np.zeros(inside.shape)
    for centre, own in zip(points, radius[inside], strict=True):
        far = np.sqrt(((points - centre) ** 2).sum(axis=1))
        held = np.zeros(inside.shape)
        held[inside] = np.where(far < own - 1e-6, 2 * own - 0.5, 0)
        expected = np.maximum(expected, held)
    result = measure.local_thickness(tb.Image(inside, "labels", spacing=spacing))
    np.testing.assert_allclose(result, expected, rtol=1e-5, atol=1e-5)


def largest_spheres(inside, region, spacing, periodic):
    """Measure local thickness by trying every sphere on every voxel, its images on a torus
    included.
    """
    margin = [
        (4 * side, 4 * side) if wrap else (0, 0)
        for side, wrap in zip(inside.shape, periodic, strict=True)
    ]
    middle = tuple(
        slice(before, before + side) for (before, _), side in zip(margin, inside.shape, strict=True)
    )
    free = np.pad(inside | ~region, margin, mode="wrap")
    radius = np.where(inside, ndimage.distance_transform_edt(free, sampling=spacing)[middle], 0)
    radius = np.pad(radius, margin, mode="wrap")
    points = (np.argwhere(inside) + [before for before, _ in margin]) * spacing
    best = np.zeros(len(points))
    for centre in np.argwhere(radius > 0):
        own = radius[tuple(centre)]
        far = np.sqrt(((points - centre * spacing) ** 2).sum(axis=1))
        best = np.maximum(best, np.where(far < own - 1e-6, 2 * own - min(spacing) / 2, 0))
    expected = np.zeros(inside.shape)
    expected[inside] = best
    return expected


@pytest.mark.whole
@settings(max_examples=40)
@given(
    arrays(bool, array_shapes(min_dims=2, max_dims=3, min_side=3, max_side=5)),
    arrays(bool, (5, 5, 5), elements=st.sampled_from([True, True, True, False])),
    st.tuples(*[st.booleans()] * 3),
    st.sampled_from([1.0, 1.7]),
)
def test_local_thickness_with_a_mask_and_periodic_faces_tries_every_sphere(
    solid, mask, wraps, first
):
    mask = (
        mask[tuple(map(slice, solid.shape))]
        if solid.ndim == 3
        else mask[0][tuple(map(slice, solid.shape))]
    )
    inside, periodic = solid & mask, wraps[: solid.ndim]
    if not mask.any() or (inside == mask).all():
        return
    spacing = (first,) + (1.0,) * (solid.ndim - 1)
    image = tb.Image(solid, "labels", spacing=spacing)
    result = measure.local_thickness(image, mask=mask, periodic=periodic)
    np.testing.assert_allclose(
        result, largest_spheres(inside, mask, spacing, periodic), rtol=1e-5, atol=1e-5
    )
    mean = float(result[inside].mean()) if inside.any() else 0.0
    assert measure.thickness(image, mask=mask, periodic=periodic) == pytest.approx(mean, rel=1e-5)


def test_thickness_on_a_torus_does_not_depend_on_the_origin_nor_on_threads():
    solid = (
        ndimage.gaussian_filter(
            np.random.default_rng(1).standard_normal((70, 24, 70)), 2, mode="wrap"
        )
        > 0
    )
    with tb.threads(1):
        one = measure.local_thickness(solid, periodic=True)
    moved = measure.local_thickness(np.roll(solid, (9, -5, 33), axis=(0, 1, 2)), periodic=True)
    np.testing.assert_array_equal(np.roll(one, (9, -5, 33), axis=(0, 1, 2)), moved)
    with tb.threads(3):
        assert np.array_equal(one, measure.local_thickness(solid, periodic=True))
        assert np.array_equal(
            measure.local_thickness(solid[:, :, 3:]),
            measure.local_thickness(solid[::-1, :, 3:])[::-1],
        )


def test_a_mask_bounds_no_sphere_and_a_full_one_is_refused():
    slabs = np.zeros((20, 12, 12), np.uint8)
    slabs[5:11] = 1
    mask = np.zeros(slabs.shape, bool)
    mask[:, 4:8, 4:8] = True
    assert (
        measure.thickness(slabs, mask=mask)
        == measure.thickness(slabs)
        == pytest.approx(6, abs=0.51)
    )
    assert measure.pore_size(slabs, periodic=True) == pytest.approx(14, abs=0.51)
    with pytest.raises(tb.errors.InputError, match="mask"):
        measure.local_thickness(slabs, mask=slabs == 1)
    assert measure.thickness(slabs, mask=slabs == 0) == 0


@pytest.mark.slow
def test_thickness_of_voxels_a_million_times_as_deep_as_wide():
    # Spheres larger than the tables of containment tell are all kept.
    solid = np.zeros((5, 7, 9), np.uint8)
    solid[1:4] = 1
    flat = measure.thickness(tb.Image(solid, "labels", spacing=(1e6, 1.0, 1.0)))
    assert flat == pytest.approx(1e6 * measure.thickness(solid), rel=0.2)


def test_thickness_of_a_picture_with_wide_or_narrow_pixels():
    # The tables of spheres follow the pixels, whatever the unit.
    disc = (np.hypot(*np.ogrid[-20:21, -20:21]) < 12).astype(np.uint8)
    plain = measure.thickness(disc)
    for edge in (1e-20, 19.5, 1e20):
        assert measure.thickness(tb.Image(disc, "labels", spacing=edge)) == pytest.approx(
            edge * plain, rel=1e-5
        )


def test_chords_of_layers_and_of_a_ball():
    layers = np.zeros((61, 20, 20), np.uint8)
    layers[np.arange(61) % 10 < 4] = 1
    # 12 crossings in 60 pairs, and 25 of 61 voxels.
    assert measure.chord_length(layers, axis=0) == pytest.approx(2 * 25 / 61 * 60 / 12)
    assert measure.chord_length(layers, axis=1) == float("inf")
    assert measure.chord_length(ball) == pytest.approx(4 / 3 * 20.3, rel=0.03)  # 4 V / S
    assert measure.chord_length(np.zeros((4, 4), np.uint8)) == 0


def test_chords_along_an_axis_count_its_own_edges():
    layers = np.broadcast_to(np.arange(32) % 8 < 3, (4, 4, 32)).astype(np.uint8)
    image = tb.Image(layers, "labels", spacing=(5.0, 2.0, 0.5))
    assert measure.chord_length(image, axis=2, periodic=True) == pytest.approx(3 * 0.5)
    assert measure.chord_length(image, axis=0) == np.inf


def test_no_sphere_is_centred_beyond_the_mask():
    """A strut ends at the rim of the mask: beyond it lies room for larger spheres."""
    strut, mask = np.zeros((9, 21), np.uint8), np.zeros((9, 21), bool)
    mask[:, :10], strut[3:6, :10] = True, 1
    assert measure.local_thickness(strut, mask=mask).max() == pytest.approx(3.5)

"""Distance: known values, SciPy as oracle, threads that do not matter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import ndimage

import trabecula as tb
from trabecula.measure import distance_transform, signed_distance

volumes = arrays(bool, array_shapes(min_dims=2, max_dims=3, min_side=1, max_side=9))


@given(volumes, st.tuples(*[st.sampled_from([0.3, 1.0, 2.5])] * 3))
def test_equals_scipy_with_any_spacing(inside, edges):
    spacing = edges[: inside.ndim]
    if inside.all():
        assert np.isinf(distance_transform(inside, spacing=spacing)).all()
    else:
        expected = ndimage.distance_transform_edt(inside, sampling=spacing)
        np.testing.assert_allclose(distance_transform(inside, spacing=spacing), expected, rtol=1e-5)


def test_squares_are_exact_for_cubic_voxels_far_from_the_only_hole():
    inside = np.ones((60, 70, 80), bool)
    inside[11, 7, 3] = False
    z, y, x = np.ogrid[:60, :70, :80]
    square = (z - 11) ** 2 + (y - 7) ** 2 + (x - 3) ** 2
    assert np.array_equal(np.rint(distance_transform(inside) ** 2), square)
    assert np.array_equal(distance_transform(inside), np.sqrt(square).astype(np.float32))


def test_result_does_not_depend_on_threads():
    inside = np.random.default_rng(0).random((40, 33, 21)) < 0.97
    with tb.threads(1):
        one = distance_transform(inside, spacing=(1, 2, 0.7))
    with tb.threads(3):
        assert np.array_equal(one, distance_transform(inside, spacing=(1, 2, 0.7)))


def test_interface_is_half_an_edge_from_either_side():
    inside = np.zeros((4, 6, 8), bool)
    inside[:, :, 3:] = True
    expected = np.arange(8) - 2.5
    assert np.array_equal(signed_distance(inside), np.broadcast_to(expected, inside.shape))
    assert np.array_equal(
        signed_distance(inside, spacing=2.0), np.broadcast_to(2 * expected, inside.shape)
    )
    assert np.array_equal(
        signed_distance(inside, clip=1.0), np.broadcast_to(expected.clip(-1, 1), inside.shape)
    )


@pytest.mark.whole
@given(volumes)
def test_signed_distance_changes_sign_with_the_sides(inside):
    assert np.array_equal(signed_distance(inside), -signed_distance(~inside))
    assert np.array_equal(signed_distance(inside) > 0, inside)


@pytest.mark.parametrize(
    "bad",
    [
        np.zeros((3, 3, 3)),
        np.full((3, 3), 255, np.uint8),
        np.zeros(4, bool),
        np.zeros((0, 3), bool),
    ],
)
def test_what_is_not_a_boolean_image_is_refused(bad):
    with pytest.raises(tb.errors.InputError):
        distance_transform(bad)


@pytest.mark.parametrize(
    "options", [{"spacing": 0}, {"spacing": (1, 2)}, {"clip": 0}, {"clip": float("nan")}]
)
def test_bad_options_are_refused(options):
    with pytest.raises(tb.errors.InputError):
        signed_distance(np.eye(3, dtype=bool)[None], **options)


@given(volumes, st.tuples(*[st.booleans()] * 3), st.tuples(*[st.sampled_from([0.5, 1.0, 2.5])] * 3))
def test_periodic_distance_equals_scipy_on_tiles(inside, wraps, edges):
    periodic, spacing = wraps[: inside.ndim], edges[: inside.ndim]
    if inside.all():
        assert np.isinf(distance_transform(inside, spacing=spacing, periodic=periodic)).all()
        return
    # Three copies: nothing is further than half a side along a periodic axis.
    margin = [
        (side, side) if wrap else (0, 0) for side, wrap in zip(inside.shape, periodic, strict=True)
    ]
    tiles = ndimage.distance_transform_edt(np.pad(inside, margin, mode="wrap"), sampling=spacing)
    middle = tuple(
        slice(before, before + side) for (before, _), side in zip(margin, inside.shape, strict=True)
    )
    result = distance_transform(inside, spacing=spacing, periodic=periodic)
    np.testing.assert_allclose(result, tiles[middle], rtol=1e-5)


def test_periodic_signed_distance_of_a_slab_that_crosses_the_face():
    inside = np.zeros((3, 4, 8), bool)
    inside[:, :, [0, 1, 6, 7]] = True
    expected = [1.5, 0.5, -0.5, -1.5, -1.5, -0.5, 0.5, 1.5]
    assert np.array_equal(
        signed_distance(inside, periodic=True), np.broadcast_to(expected, inside.shape)
    )
    assert signed_distance(inside, periodic=(True, True, False))[0, 0, 0] == 1.5
    with pytest.raises(tb.errors.InputError, match="periodic"):
        distance_transform(inside, periodic=(True, True))


@pytest.mark.parametrize("hole", [(3, 4), (7, 9), (14, 22)])
def test_one_hole_in_a_torus_is_as_far_as_the_shorter_way_round(hole):
    inside = np.ones((22, 31), bool)
    inside[hole] = False
    away = [np.abs(np.arange(side) - at) for side, at in zip(inside.shape, hole, strict=True)]
    down, across = (np.minimum(a, len(a) - a) for a in away)
    found = distance_transform(inside, periodic=True)
    assert np.allclose(found, np.hypot(down[:, None], across))

"""Local orientation and fabric: stripes, fibres, layers, balls and ellipsoids that point a known
way.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import trabecula as tb
from trabecula.engine.parallel import threads
from trabecula.measure.fabric import anisotropy, fabric
from trabecula.measure.orientation import orientation, structure_tensor

noise = np.random.default_rng(3).integers(0, 256, (24, 24, 24)).astype(np.uint8)


def stripes(degrees, spacing=(1.0, 1.0)):
    y, x = np.indices((70, 80)) * np.reshape(spacing, (2, 1, 1))
    angle = np.deg2rad(degrees)
    values = np.cos(0.7 * (np.cos(angle) * y - np.sin(angle) * x))
    return tb.Image(values.astype(np.float32), "grey", spacing=spacing)


def fibres(direction, spacing=(1.0, 1.0, 1.0)):
    across = np.linalg.svd(np.array([direction], float))[2][1:]
    at = np.indices((30, 32, 34)) * np.reshape(spacing, (3, 1, 1, 1))
    values = sum(np.cos(0.8 * np.tensordot(way, at, 1)) for way in across)
    return tb.Image(values.astype(np.float32), "grey", spacing=spacing)


def ellipsoid(axes, spacing=(1.0, 1.0, 1.0)):
    sides = [int(np.ceil(1.3 * axis / edge)) for axis, edge in zip(axes, spacing, strict=True)]
    grid = np.ogrid[tuple(slice(-side, side + 1) for side in sides)]
    inside = (
        sum((at * edge / axis) ** 2 for at, edge, axis in zip(grid, spacing, axes, strict=True)) < 1
    )
    return tb.Image(inside, "labels", spacing=spacing)


@pytest.mark.parametrize("degrees", [0, 25, 45, 90, 130, 170])
@pytest.mark.parametrize("spacing", [(1, 1), (0.6, 1)])
def test_stripes_peak_at_their_angle(degrees, spacing):
    result = orientation(stripes(degrees, spacing))
    peak = np.argmax(result.shares)
    assert peak * 5 == degrees
    assert result.shares[peak] > 0.8 and result.coherence > 0.95
    assert np.allclose(
        result.directions[peak], [np.sin(np.deg2rad(degrees)), np.cos(np.deg2rad(degrees))]
    )


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 1, 0), (1, 1, 1), (1, 2, -3), (1, -3, 0.5)])
@pytest.mark.parametrize("spacing", [(1, 1, 1), (1.5, 1, 0.8)])
def test_fibres_peak_at_their_axis(direction, spacing):
    result = orientation(fibres(direction, spacing))
    unit = np.array(direction) / np.linalg.norm(direction)
    mean = np.einsum("rs,rsi,rsj->ij", result.shares, result.directions, result.directions)
    # bins are 20 degrees wide
    assert abs(np.linalg.eigh(mean)[1][:, -1] @ unit) > np.cos(np.deg2rad(15))
    assert result.coherence > 0.6


def test_plates_and_flat_images_have_no_axis():
    plates = np.cos(0.7 * np.arange(30))[:, None, None] + np.zeros((30, 30, 30))
    assert orientation(tb.Image(plates, "grey")).coherence < 1e-3
    result = orientation(tb.Image(np.full((9, 9), 7.0), "grey"))
    assert result.coherence == 0 and not result.shares.any()


def test_quarter_turn_in_the_plane_moves_the_bins():
    image = noise[0]
    turned = orientation(tb.Image(np.rot90(image).copy(), "grey")).shares
    assert np.allclose(turned, np.roll(orientation(tb.Image(image, "grey")).shares, 18), atol=1e-4)


def test_quarter_turn_about_z_moves_the_sectors():
    shares = orientation(tb.Image(noise, "grey")).shares
    # y' = -x, x' = y: an axis at angle a comes to a - 90 degrees, three sectors of twelve.
    turned = orientation(tb.Image(np.rot90(noise, axes=(1, 2)).copy(), "grey")).shares
    assert np.allclose(turned, np.roll(shares, -3, axis=1), atol=1e-4)
    assert shares.sum() == pytest.approx(1)


def test_closed_form_agrees_with_numpy():
    tensor = structure_tensor(tb.Image(noise, "grey")).astype(np.float64)
    value, vector = np.linalg.eigh(tensor.transpose(2, 3, 4, 0, 1).reshape(-1, 3, 3))
    weight = (value[:, 1] - value[:, 0]) / value[:, 2]
    result = orientation(tb.Image(noise, "grey"), bins=(4, 1))
    expected = np.bincount(np.minimum((np.abs(vector[:, 0, 0]) * 4).astype(int), 3), weights=weight)
    assert np.allclose(result.shares[:, 0], expected / expected.sum(), atol=1e-4)
    assert result.coherence == pytest.approx(weight.mean(), rel=1e-4)


def test_structure_tensor_of_a_slope():
    at = np.indices((24, 48)) * np.array([2.0, 0.5])[:, None, None]
    tensor = structure_tensor(
        tb.Image(3 * at[0] - 5 * at[1], "grey", spacing=(2.0, 0.5)), sigma=0.5, window=0.5
    )
    middle = tensor[:, :, 11:13, 22:26]
    assert np.allclose(middle, np.array([[9, -15], [-15, 25]])[:, :, None, None], rtol=1e-4)


@pytest.mark.parametrize(
    ("axes", "spacing"),
    [((30, 20, 10), (1, 1, 1)), ((12, 24, 36), (1.5, 1, 1)), ((24, 12, 12), (1, 1, 1))],
)
def test_ellipsoid_has_intercepts_as_its_axes(axes, spacing):
    result = fabric(ellipsoid(axes, spacing))
    longest = sorted(axes, reverse=True)
    assert np.allclose(
        result.lengths / result.lengths[0], np.array(longest) / longest[0], rtol=0.05
    )
    assert result.anisotropy == pytest.approx(1 - (min(axes) / max(axes)) ** 2, abs=0.02)
    assert abs(result.directions[0][np.argmax(axes)]) > 0.999


def test_intercept_length_of_a_ball():
    radius = 20.0
    image = ellipsoid((radius,) * 3)
    result = fabric(image)
    # Margins of two voxels are left out of the volume; a line of length L meets n = S / (2 V) L
    # faces.
    volume = np.prod([side - 4 for side in image.shape])
    assert result.lengths.mean() == pytest.approx(2 * volume / (4 * np.pi * radius**2), rel=0.02)
    assert result.anisotropy < 0.01


def test_layers_at_any_slope_are_wholly_anisotropic():
    normal = np.array([0.5, 0.7, -0.2]) / np.linalg.norm([0.5, 0.7, -0.2])
    values = np.sin(0.5 * np.tensordot(normal, np.indices((40, 40, 40)), 1)) > 0
    result = fabric(values)
    assert result.anisotropy > 0.99 and abs(result.directions[-1] @ normal) > 0.9999
    flat = fabric(np.repeat([0, 1, 0, 1], 6)[:, None, None] * np.ones((24, 10, 10), np.uint8))
    assert flat.anisotropy == 1 and flat.lengths[0] == np.inf


def test_disc_and_ellipse_in_two_dimensions():
    y, x = np.ogrid[-45:46, -45:46]
    assert anisotropy(y**2 + x**2 < 30**2) < 0.01
    result = fabric((y / 36) ** 2 + (x / 18) ** 2 < 1)
    assert (
        result.anisotropy == pytest.approx(0.75, abs=0.02) and abs(result.directions[0][0]) > 0.999
    )


@settings(max_examples=15)
@given(arrays(bool, (7, 7, 7)), st.permutations([0, 1, 2]))
def test_fabric_turns_with_the_volume_and_is_that_of_both_sides(inside, order):
    if len(np.unique(inside[1:-1, 1:-1, 1:-1])) < 2:
        return
    result, turned = fabric(inside), fabric(inside.transpose(order))
    assert 0 <= result.anisotropy <= 1
    assert np.allclose(
        turned.tensor, result.tensor[np.ix_(order, order)], atol=0.05 * np.abs(result.tensor).max()
    )
    assert np.allclose(
        fabric(inside, phase="void").tensor, result.tensor, atol=1e-4 * np.abs(result.tensor).max()
    )


def test_threads_do_not_matter():
    image = tb.Image(noise, "grey")
    with threads(1):
        alone = orientation(image).shares, fabric(noise > 128).tensor
    with threads(3):
        together = orientation(image).shares, fabric(noise > 128).tensor
    assert np.array_equal(alone[0], together[0]) and np.array_equal(alone[1], together[1])


def test_bad_input_is_told():
    for call in (
        lambda: fabric(np.ones((8, 8, 8), np.uint8)),
        lambda: fabric(np.eye(3, dtype=np.uint8)),
        lambda: orientation(tb.Image(noise, "grey"), bins=8),
        lambda: orientation(tb.Image(noise, "grey"), sigma=0.0),
        lambda: orientation(tb.Image(noise % 3, "labels")),
    ):
        with pytest.raises(tb.errors.InputError):
            call()

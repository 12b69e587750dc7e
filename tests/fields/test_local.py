"""Descriptors of every window, compared with the measures of each window alone."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import trabecula as tb
from trabecula.engine import parallel
from trabecula.errors import InputError, UnknownNameError
from trabecula.fields import windowed

NAMES = {2: ["volume_fraction", "porosity", "perimeter", "euler"]}
NAMES[3] = ["volume_fraction", "porosity", "surface", "mean_curvature", "euler"]


def reference(window, name, **options):
    if name == "porosity":
        return tb.measure.porosity(tb.Image(window, "labels"))
    if name == "volume_fraction":
        return np.mean(window != 0)
    found = tb.measure.minkowski(tb.Image(window, "labels", **options.pop("image", {})), **options)
    return (
        found.euler_density
        if name == "euler"
        else found.mean_curvature
        if name == "mean_curvature"
        else found.surface
    )


@pytest.mark.whole
@given(
    arrays.arrays(
        np.uint8,
        arrays.array_shapes(min_dims=2, max_dims=3, min_side=2, max_side=6),
        elements=st.integers(0, 1),
    ),
    st.data(),
)
def test_every_window_is_measured_as_it_would_be_alone(values, data):
    size = data.draw(st.integers(2, min(values.shape)))
    fields = windowed(values, size=size, names=NAMES[values.ndim])
    windows = np.lib.stride_tricks.sliding_window_view(values, (size,) * values.ndim)
    for name, field in fields.items():
        assert field.dtype == np.float32 and field.shape == windows.shape[: values.ndim]
        alone = [reference(windows[at], name) for at in np.ndindex(*field.shape)]
        assert np.allclose(field.ravel(), alone, atol=1e-6), name


@pytest.mark.parametrize("connectivity", [6, 18, 26])
def test_neighbours_and_voxels_that_are_no_cubes(connectivity):
    values = (np.random.default_rng(1).random((5, 6, 7)) < 0.4).astype(np.uint8)
    spacing = (0.5, 1.0, 2.0)
    fields = windowed(
        values, size=4, names=NAMES[3][2:], connectivity=connectivity, spacing=spacing
    )
    for at in [(0, 0, 0), (1, 2, 3)]:
        window = values[tuple(slice(i, i + 4) for i in at)]
        for name, field in fields.items():
            alone = reference(window, name, connectivity=connectivity, image={"spacing": spacing})
            assert field[at] == pytest.approx(alone, rel=1e-6)


def test_phases_by_name():
    values = np.random.default_rng(2).integers(0, 3, (6, 6, 6))
    image = tb.Image(values, "labels", phases=("pore", "void", "binder"))
    names = ["porosity", "volume_fraction", "volume_fraction:pore", "volume_fraction:binder"]
    found = {
        name: float(field[1, 2, 0]) for name, field in windowed(image, size=4, names=names).items()
    }
    window = values[1:5, 2:6, 0:4]
    assert found["porosity"] == pytest.approx(np.mean(window == 1))
    assert found["volume_fraction"] == pytest.approx(np.mean(window != 1))
    assert found["volume_fraction:pore"] == pytest.approx(np.mean(window == 0))
    assert found["volume_fraction:binder"] == pytest.approx(np.mean(window == 2))
    own = windowed(image, size=4, names=["volume_fraction", "surface"], phase="binder")
    assert own["volume_fraction"][1, 2, 0] == pytest.approx(np.mean(window == 2))
    assert own["surface"][1, 2, 0] == pytest.approx(tb.measure.minkowski(window, phase=2).surface)


@pytest.mark.parametrize(
    ("given_", "words"),
    [
        ({"size": 1}, "size=1 is outside 2"),
        ({"size": 9}, "does not fit into"),
        (
            {"size": 3, "names": ["perimeter"]},
            "apparent_stiffness, euler, mean_curvature, porosity",
        ),
        ({"size": 3, "names": ["volume_fraction:glue"]}, "unknown phase 'glue'"),
        ({"size": 3, "connectivity": 8}, "connectivity 8 does not exist in 3-D"),
    ],
)
def test_what_has_no_windows_is_refused(given_, words):
    with pytest.raises((InputError, UnknownNameError), match=words):
        windowed(np.eye(8, dtype=int)[None].repeat(8, 0), **given_)


def test_tiles_change_no_bit(monkeypatch):
    values = np.random.default_rng(3).random((23, 9, 11)) < 0.5
    whole = windowed(values, size=5, names=NAMES[3])

    def scatter(work, length, count, least):
        bounds = [0, 1, 2, length // 2, length]
        for a, b in reversed(list(pairwise(bounds))):
            work(a, b)

    monkeypatch.setattr(parallel, "_run", scatter)
    for name, field in windowed(values, size=5, names=NAMES[3]).items():
        assert np.array_equal(field, whole[name]), name


@pytest.mark.parametrize("shape", [(7, 8, 9), (9, 11)])
def test_two_point_functions_of_windows_are_those_of_their_pairs(shape):
    inside = np.random.default_rng(3).random(shape) < 0.4
    size, lag = 5, 2
    name = f"two_point:{lag}"
    field = windowed(inside.astype(np.uint8), size=size, names=[name])[name]
    assert field.shape == tuple(side - size + 1 for side in shape)
    for at in np.ndindex(*field.shape):
        window = inside[tuple(slice(k, k + size) for k in at)]
        pairs = [
            (window.take(range(lag, size), axis) & window.take(range(size - lag), axis)).mean()
            for axis in range(window.ndim)
        ]
        assert np.isclose(field[at], np.mean(pairs), atol=1e-6)


def test_two_point_functions_of_a_checkerboard():
    board = (np.indices((8, 8, 8)).sum(axis=0) % 2).astype(np.uint8)
    found = windowed(board, size=6, names=["two_point:1", "two_point:2"])
    assert (found["two_point:1"] == 0).all() and np.allclose(found["two_point:2"], 0.5)
    for lag in ("0", "6", "x", "-1"):
        with pytest.raises(tb.errors.InputError, match="two_point:R with R from 1 to 5"):
            windowed(board, size=6, names=[f"two_point:{lag}"])

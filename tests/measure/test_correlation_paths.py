"""Lineal path: segments counted one by one, and structures whose curve is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

import trabecula as tb
from trabecula.measure.correlation import lineal_path


@pytest.mark.whole
@settings(max_examples=40)
@given(
    arrays(bool, array_shapes(min_dims=2, max_dims=3, min_side=4, max_side=8)),
    st.booleans(),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
def test_equals_segments_counted_one_by_one(inside, periodic, masked, seed):
    mask = np.random.default_rng(seed).random(inside.shape) < 0.9
    if not masked:
        mask[:] = True
    hits, fits = np.zeros(4), np.zeros(4)
    for axis in range(inside.ndim):
        lines = [
            np.moveaxis(values, axis, 0).reshape(inside.shape[axis], -1).T
            for values in (inside & mask, mask)
        ]
        for line, allowed in zip(*lines, strict=True):
            for r in range(4):
                for start in range(len(line) if periodic else len(line) - r):
                    segment = np.arange(start, start + r + 1) % len(line)
                    fits[r] += allowed[segment].all()
                    hits[r] += line[segment].all()
    options = {"r_max": 3, "periodic": periodic, "mask": mask if masked else None}
    if not fits.all():
        with pytest.raises(tb.errors.InputError, match="no segment"):
            lineal_path(inside, **options)
        return
    np.testing.assert_allclose(lineal_path(inside, **options), hits / fits, atol=1e-15)


def test_layers_fall_linearly():
    layers = np.zeros((44, 8, 8), np.uint8)
    layers[np.arange(44) % 11 < 6] = 1
    # A segment of r + 1 voxels fits 6 - r times into a layer of 6, once per period of 11; the
    # window holds 4 whole periods.
    assert lineal_path(layers, r_max=6, axis=0).tolist() == pytest.approx(
        [4 * (6 - r) / (44 - r) for r in range(7)]
    )
    assert lineal_path(layers, r_max=6, axis=1).tolist() == pytest.approx([24 / 44] * 7)
    wrapped = lineal_path(layers, r_max=6, axis=0, periodic=True)
    assert wrapped.tolist() == pytest.approx([(6 - r) / 11 for r in range(7)])


def test_independent_voxels_give_powers_of_phi():
    path = lineal_path(np.random.default_rng(1).random((80, 80, 80)) < 0.7, r_max=6)
    np.testing.assert_allclose(path, 0.7 ** np.arange(1, 8), atol=2e-3)


def test_what_does_not_fit_is_refused():
    solid = np.ones((8, 8, 8), bool)
    dots = np.indices(solid.shape).sum(axis=0) % 2 == 0
    for options in [
        {"r_max": 8},
        {"r_max": -1},
        {"r_max": 2, "axis": 3},
        {"r_max": 1, "mask": dots},
    ]:
        with pytest.raises(tb.errors.InputError):
            lineal_path(solid, **options)

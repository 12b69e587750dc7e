"""Shares of pixels are volumes, whatever the pitch."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.engine.lazy_volume import as_slabs
from trabecula.layers.sampling import AxisWeights, LayerSampler


def volume(shape=(8, 12, 10), seed=0):
    values = (np.random.default_rng(seed).random(shape) < 0.4).astype(np.uint8)
    return tb.Image(values, "labels", phases=("void", "solid"))


@pytest.mark.parametrize("pitch", [(1, 1, 1), (2, 3, 5), (4, 1.5, 2.5), (0.5, 0.25, 0.5)])
def test_the_layers_hold_the_volume(pitch):
    image = volume()
    sampler = LayerSampler(as_slabs(image), (1.0, 1.0, 1.0), pitch)
    inside = sum(sampler.shares(k, [1]).sum() for k in range(sampler.shape[0])) * np.prod(pitch)
    # narrower pixels lose half of what lies in the outermost half voxel
    assert inside == pytest.approx(image.values.sum(), rel=1e-5 if min(pitch) >= 1 else 0.15)


def test_pixels_of_the_voxels_are_the_voxels():
    image = volume()
    sampler = LayerSampler(as_slabs(image), (2.0, 3.0, 4.0), (2.0, 3.0, 4.0))
    for k, plane in enumerate(image.values):
        assert (sampler.shares(k, [1])[0] == plane).all()


def test_wide_pixels_hold_means():
    image = volume()
    sampler = LayerSampler(as_slabs(image), (1.0, 1.0, 1.0), (2.0, 3.0, 5.0))
    means = image.values.reshape(4, 2, 4, 3, 2, 5).mean(axis=(1, 3, 5))
    found = np.stack([sampler.shares(k, [1])[0] for k in range(4)])
    assert np.allclose(found, means, atol=1e-6)


def test_narrow_pixels_are_linear_between_centres():
    weights = AxisWeights.over(np.array([0.5, 0.75, 1.5]), 1.0, 1.0)
    line = np.array([0.0, 1.0, 4.0, 0.0])
    found = [
        sum(w * line[f + t] for t, w in enumerate(row) if f + t >= 0)
        for f, row in zip(weights.first, weights.weights, strict=True)
    ]
    assert np.allclose(found, [0.0, 0.25, 1.0])


def test_a_layer_does_not_depend_on_the_chunks_that_are_read():
    image = volume((20, 12, 10))
    slabs = as_slabs(image)
    from dataclasses import replace

    one, other = (
        LayerSampler(replace(slabs, grain=grain), (1.0, 1.0, 1.0), (0.7, 0.8, 1.1))
        for grain in (1, 7)
    )
    for k in range(one.shape[0]):
        assert (one.shares(k, [0, 1]) == other.shares(k, [0, 1])).all()

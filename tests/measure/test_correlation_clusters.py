"""Two-point cluster function: pairs counted one by one, and bodies whose overlap is known."""

import sys
from collections import deque
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

import trabecula as tb
from trabecula.measure.correlation import two_point, two_point_cluster

MODULE = sys.modules[two_point.__module__]  # its name is the function's
FAR = {4: 1, 6: 1, 8: 2, 18: 2, 26: 3}


def flood(inside, connectivity, periodic):
    """Label by visiting neighbours one by one."""
    labels = np.zeros(inside.shape, int)
    steps = [
        step
        for step in product((-1, 0, 1), repeat=inside.ndim)
        if 0 < np.abs(step).sum() <= FAR[connectivity]
    ]
    for number, start in enumerate(map(tuple, np.argwhere(inside)), 1):
        queue = deque([start] if labels[start] == 0 else [])
        while queue:
            here = queue.popleft()
            labels[here] = number
            for there in (np.array(here) + step for step in steps):
                if periodic:
                    there %= inside.shape
                elif np.any(there < 0) or np.any(there >= inside.shape):
                    continue
                if inside[tuple(there)] and not labels[tuple(there)]:
                    labels[tuple(there)] = number
                    queue.append(tuple(there))
    return labels


def count_pairs(labels, r_max, mask, spacing, periodic):
    points = np.argwhere(mask)
    value = labels[tuple(points.T)]
    steps, shape = np.array(spacing) / min(spacing), np.array(labels.shape)
    hits, pairs = np.zeros(r_max + 1), np.zeros(r_max + 1)
    for point, here in zip(points, value, strict=True):
        offset = points - point
        if periodic:
            offset = (offset + shape // 2) % shape - shape // 2
        r = np.floor(np.sqrt(((offset * steps) ** 2).sum(axis=1)) + 0.5).astype(int)
        near = r <= r_max
        np.add.at(pairs, r[near], 1)
        np.add.at(hits, r[near], (here > 0) & (value[near] == here))
    return hits / pairs


@pytest.fixture(params=["one by one", "transformed"])
def way(request, monkeypatch):
    """Return each of the two ways of counting, for every cluster."""
    monkeypatch.setattr(MODULE, "_PAIR", 0.0 if request.param == "one by one" else 1e6)


@pytest.mark.whole
@settings(max_examples=20)
@given(
    arrays(bool, array_shapes(min_dims=2, max_dims=3, min_side=5, max_side=8)),
    st.integers(0, 2),
    st.booleans(),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
@pytest.mark.parametrize("seconds", [0.0, 1e6])
def test_equals_pairs_counted_one_by_one(seconds, inside, neighbours, periodic, masked, seed):
    connectivity = (4, 8, 8)[neighbours] if inside.ndim == 2 else (6, 18, 26)[neighbours]
    mask = np.random.default_rng(seed).random(inside.shape) < 0.9
    if not masked:
        mask[:] = True
    spacing = (1.0, 1.0, 1.25)[: inside.ndim]
    labels = flood(inside & mask, connectivity, periodic)
    options = {"connectivity": connectivity, "periodic": periodic, "mask": mask if masked else None}
    image = tb.Image(inside, "labels", spacing=spacing)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(MODULE, "_PAIR", seconds)
        radial = two_point_cluster(image, r_max=2, **options)
    np.testing.assert_allclose(radial, count_pairs(labels, 2, mask, spacing, periodic), atol=1e-12)
    along = two_point_cluster(image, r_max=2, axis=-1, **options)
    for r in range(3):
        there, fits = np.roll(labels, -r, axis=-1), mask & np.roll(mask, -r, axis=-1)
        stop = inside.shape[-1] - (0 if periodic else r)
        hits = np.sum(((labels == there) & (labels > 0))[..., :stop])
        assert along[r] == pytest.approx(hits / np.sum(fits[..., :stop]), abs=1e-14)


def test_separate_balls_overlap_as_two_spheres_do(way):
    # Balls of radius 8 on a lattice of 20: pairs in one ball, a share of the volume where two such
    # balls overlap.
    radius, side = 8.0, 20
    grid = np.indices((side, side, side)) - (side - 1) / 2
    balls = np.tile((grid**2).sum(axis=0) < radius**2, (2, 2, 2))
    c2 = two_point_cluster(balls, r_max=20, periodic=True)
    x = np.sqrt(sum(np.square(axis) for axis in np.ogrid[-20:21, -20:21, -20:21])) / (2 * radius)
    overlap = np.where(x < 1, 1 - 1.5 * x + 0.5 * x**3, 0)
    bins = (x * 2 * radius + 0.5).astype(int)
    near = bins <= 20
    theory = np.bincount(bins[near], overlap[near]) / np.bincount(bins[near])
    np.testing.assert_allclose(c2 / c2[0], theory, atol=4e-3)
    assert c2[0] == pytest.approx(4 / 3 * np.pi * radius**3 / side**3, rel=0.02)
    assert c2[17:].tolist() == [0, 0, 0, 0]
    assert two_point(balls, r_max=20, periodic=True)[20] > 0.05


def test_layers_hold_only_pairs_of_one_layer(way):
    layers = np.zeros((40, 20, 20), np.uint8)
    layers[np.arange(40) % 10 < 5] = 1
    across = two_point_cluster(layers, r_max=20, axis=0, periodic=True)
    np.testing.assert_allclose(across, np.maximum(0, 5 - np.arange(21)) / 10, atol=1e-15)
    np.testing.assert_allclose(
        two_point_cluster(layers, r_max=10, axis=2, periodic=True), 0.5, atol=1e-15
    )
    radial = two_point_cluster(layers, r_max=10, periodic=True)
    assert radial[0] == 0.5
    assert radial[10] < two_point(layers, r_max=10, periodic=True)[10]


def test_one_cluster_gives_the_two_point_function(way):
    rng = np.random.default_rng(1)
    solid = rng.random((22, 20, 24)) < 0.3
    solid[::2, ::2] = solid[::2, :, ::2] = solid[:, ::2, ::2] = True
    solid &= tb.measure.label_components(solid)[0] == 1
    for options in [{}, {"periodic": True}, {"direction": (1, 1, 0)}, {"axis": 1}]:
        c2 = two_point_cluster(solid, r_max=7, **options)
        np.testing.assert_allclose(c2, two_point(solid, r_max=7, **options), atol=1e-13)


def test_a_cluster_that_crosses_the_faces_is_one_when_they_wrap(way):
    rods = np.zeros((24, 12, 24), np.uint8)
    rods[:3, :, 5:9] = rods[-3:, :, 5:9] = 1
    apart = two_point_cluster(rods, r_max=6, axis=0)
    joined = two_point_cluster(rods, r_max=6, axis=0, periodic=True)
    # Around the face it is a bar of 6 in 24, over a sixth of the section.
    np.testing.assert_allclose(joined, np.maximum(0, 6 - np.arange(7)) / 24 / 6, atol=1e-15)
    np.testing.assert_allclose(
        apart, 2 * np.maximum(0, 3 - np.arange(7)) / (24 - np.arange(7)) / 6, atol=1e-15
    )
    radial = two_point_cluster(rods, r_max=6, periodic=True)
    np.testing.assert_allclose(radial, two_point(rods, r_max=6, periodic=True), atol=1e-13)


@pytest.mark.parametrize("length", range(12, 18))
def test_the_way_round_the_faces_is_found_as_soon_as_it_is_short_enough(way, length):
    # In 20 voxels the ends of a rod of 15 are 14 apart, or 6 the other way round.
    rod = np.zeros((4, 20, 4), np.uint8)
    rod[1, 2 : 2 + length, 1] = 1
    periodic = (False, True, False)
    c2 = two_point_cluster(rod, r_max=6, periodic=periodic)
    np.testing.assert_allclose(c2, two_point(rod, r_max=6, periodic=periodic), atol=1e-13)


def test_never_more_than_two_point_and_more_neighbours_never_fewer_pairs():
    solid = np.random.default_rng(2).random((24, 24, 24)) < 0.25
    curves = [two_point_cluster(solid, r_max=10, connectivity=number) for number in (6, 18, 26)]
    curves.append(two_point(solid, r_max=10))
    for less, more in pairwise(curves):
        assert np.all(less <= more + 1e-12)
        assert less[0] == more[0]
    assert curves[0][3] < 0.5 * curves[3][3]


def test_an_empty_phase_and_wrong_neighbours():
    assert two_point_cluster(np.zeros((8, 8, 8), np.uint8), r_max=3).tolist() == [0, 0, 0, 0]
    with pytest.raises(tb.errors.InputError, match="connectivity 5"):
        two_point_cluster(np.ones((8, 8, 8), bool), r_max=2, connectivity=5)


@pytest.mark.whole
def test_a_real_scan_both_ways_alike(data, monkeypatch):
    electrode = tb.labels(tb.read(data / "electrode_3phase_a.tif").values[:28, :32, :30])
    curves = []
    for seconds in (0.0, MODULE._PAIR, 1e-6):
        monkeypatch.setattr(MODULE, "_PAIR", seconds)
        curves.append(two_point_cluster(electrode, phase=0, r_max=12))
    np.testing.assert_allclose(curves[1], curves[0], atol=1e-13)
    np.testing.assert_allclose(curves[2], curves[0], atol=1e-13)
    assert curves[0][12] < two_point(electrode, phase=0, r_max=12)[12]

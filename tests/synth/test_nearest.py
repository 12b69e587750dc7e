"""Exact nearest neighbours against a search of everything, and the second ordering by how often
each was chosen.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trabecula.engine.parallel import threads
from trabecula.errors import InputError
from trabecula.synth.shared.matching.neighbour_index import build_index
from trabecula.synth.shared.matching.neighbour_search import (
    index_histogram,
    k_nearest,
    rerank,
    usage_factors,
)


def everything(points, queries, k, allowed=None):
    """Oracle: all distances, sorted by distance and then by place."""
    places = np.arange(len(points)) if allowed is None else np.flatnonzero(allowed)
    apart = queries[:, None].astype(np.int64) - points[places][None].astype(np.int64)
    distance = (apart**2).sum(2)
    order = np.argsort(distance, axis=1, kind="stable")[:, :k]
    return places[order], np.take_along_axis(distance, order, 1)


@pytest.mark.whole
@given(
    seed=st.integers(0, 10_000),
    count=st.integers(1, 300),
    depth=st.integers(1, 11),
    k=st.integers(1, 40),
    size=st.sampled_from([1, 3, 50, 32767]),
)
def test_it_finds_what_a_search_of_everything_finds(seed, count, depth, k, size):
    """Small ranges of values make many equals and ties; the whole range of int16 strains float32
    and 32 bits.
    """
    rng = np.random.default_rng(seed)
    points = rng.integers(-size, size + 1, (count, depth)).astype(np.int16)
    queries = rng.integers(-size, size + 1, (7, depth)).astype(np.int16)
    allowed = rng.random(count) < 0.7
    allowed[rng.integers(count)] = True
    for chosen in (None, allowed):
        index, distance = k_nearest(queries, build_index(points, k=k, allowed=chosen))
        wanted, apart = everything(points, queries, k, chosen)
        assert np.array_equal(index, wanted)
        assert np.array_equal(distance, apart)


def test_thousands_of_equals_and_near_ties():
    """Where float32 cannot tell candidates apart, the integers must: distances near 4e9 that differ
    by one.
    """
    rng = np.random.default_rng(1)
    points = np.full((4000, 40), -10_000, np.int16)
    points[1::2, 0] += rng.integers(0, 3, 2000).astype(np.int16)
    queries = np.full((3, 40), 10_000, np.int16)
    index, distance = k_nearest(queries, build_index(points))
    wanted, apart = everything(points, queries, 10)
    assert apart.max() > 2**32
    assert np.array_equal(index, wanted)
    assert np.array_equal(distance, apart)


def test_threads_and_batches_do_not_matter():
    rng = np.random.default_rng(2)
    points = (rng.normal(size=(1500, 9)) * 2000 / np.arange(1, 10)).astype(np.int16)
    queries = points[::8] + np.int16(3)
    among = build_index(points, k=5)
    alone = k_nearest(queries, among)
    with threads(3):
        shared = k_nearest(queries, among)
    pieces = [k_nearest(queries[a : a + 50], among) for a in range(0, len(queries), 50)]
    wanted = everything(points, queries[::9], 5)
    for number in range(2):
        assert np.array_equal(alone[number][::9], wanted[number])
        assert np.array_equal(alone[number], shared[number])
        assert np.array_equal(alone[number], np.concatenate([piece[number] for piece in pieces]))


def test_features_of_a_volume():
    """Every neighbourhood of a field finds itself, and all its exact copies before it, at distance
    0.
    """
    field = np.clip(
        np.random.default_rng(3).normal(size=(1, 14, 13, 12)).cumsum(1) * 60, -127, 127
    ).astype(np.int8)
    windows = np.lib.stride_tricks.sliding_window_view(field[0], (3, 3, 3))
    features = windows.reshape(-1, 27).astype(np.int16)
    index, distance = k_nearest(features[::25], build_index(features, k=3))
    assert np.array_equal(index[:, 0], np.arange(0, len(features), 25))
    assert not distance[:, 0].any()
    wanted, apart = everything(features, features[::50], 3)
    assert np.array_equal(index[::2], wanted)
    assert np.array_equal(distance[::2], apart)


def test_the_callers_arrays_stay():
    points = np.arange(600, dtype=np.int16).reshape(60, 10)
    queries = points[:5].copy()
    before = points.copy()
    k_nearest(queries, build_index(points))
    assert np.array_equal(points, before)
    assert np.array_equal(queries, before[:5])


def test_the_histogram_is_a_share():
    shares = index_histogram(np.array([[0, 2], [2, -1]]), 4)
    assert shares.tolist() == [1 / 3, 0, 2 / 3, 0]
    assert index_histogram(np.full((2, 2), -1), 3).tolist() == [0, 0, 0]


def test_reranking_follows_the_paper():
    """w_d = 1 + weight max(0, H - theta): worked out by hand for N = 4, theta = 1/4."""
    index = np.array([[0, 1, 2], [0, 1, 2], [3, 0, 1]], np.int32)
    distance = np.array([[100, 120, 130], [100, 170, 180], [0, 1, 2]], np.int64)
    histogram = np.array([0.75, 0.25, 0.0, 0.0])
    # index 0 costs 1.5 times as much
    match, apart = rerank(index, distance, usage_factors(histogram, weight=1.0))
    assert match.tolist() == [1, 0, 3]
    assert apart.tolist() == [120, 100, 0]
    match, _ = rerank(index, distance, usage_factors(histogram, weight=2.0))
    assert match.tolist() == [1, 1, 3]
    match, _ = rerank(index, distance, usage_factors(histogram, weight=0.0))
    assert match.tolist() == [0, 0, 3]


def test_reranking_keeps_the_nearer_of_equals():
    index, distance = np.array([[5, 4, 1]], np.int32), np.array([[8, 8, 8]], np.int64)
    assert rerank(index, distance, usage_factors(np.zeros(6)))[0].tolist() == [5]


@given(seed=st.integers(0, 1000), weight=st.floats(0, 100))
def test_no_other_candidate_has_a_smaller_modified_distance(seed, weight):
    rng = np.random.default_rng(seed)
    index = rng.integers(0, 20, (9, 6)).astype(np.int32)
    distance = np.sort(rng.integers(0, 500, (9, 6)), axis=1)
    histogram = index_histogram(rng.integers(0, 20, 40), 20)
    match, apart = rerank(index, distance, usage_factors(histogram, weight=weight))
    modified = distance * (1 + weight * np.maximum(histogram[index] - 0.05, 0))
    assert np.allclose(
        apart * (1 + weight * np.maximum(histogram[match] - 0.05, 0)), modified.min(1), rtol=1e-12
    )


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: build_index(np.zeros((4, 3))), "int16"),
        (lambda: build_index(np.zeros((4, 0), np.int16)), "table"),
        (lambda: build_index(np.zeros((0, 3), np.int16)), "no candidate"),
        (
            lambda: build_index(np.zeros((4, 3), np.int16), allowed=np.zeros(4, bool)),
            "no candidate",
        ),
        (lambda: build_index(np.zeros((4, 3), np.int16), allowed=np.ones(5, bool)), "4 candidates"),
        (lambda: build_index(np.zeros((4, 3), np.int16), k=0), "k=0"),
        (
            lambda: k_nearest(np.zeros((1, 2), np.int16), build_index(np.zeros((4, 3), np.int16))),
            "one basis",
        ),
    ],
)
def test_bad_input_is_told(call, message):
    with pytest.raises(InputError, match=message):
        call()

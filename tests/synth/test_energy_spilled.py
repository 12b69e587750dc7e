"""Exact search, energies and graded targets when arrays lie in scratch files: the same numbers in
slabs of any thickness.
"""

import math
import pickle
from contextlib import contextmanager

import numpy as np
import pytest

import trabecula as tb
from trabecula import fields
from trabecula.engine import memmap
from trabecula.engine.cluster import ReferencedFiles
from trabecula.engine.parallel import threads
from trabecula.synth.shared.box_sums import window_sums
from trabecula.synth.shared.held_fractions import fractions_by_level
from trabecula.synth.shared.matching.grid import Grid, exact_search
from trabecula.synth.shared.matching.neighbour_index import build_index
from trabecula.synth.shared.matching.neighbour_search import (
    index_histogram,
    k_nearest,
    rerank,
    usage_factors,
)
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Candidates, Stack
from trabecula.synth.texture.energy import energy, mismatch, total
from trabecula.synth.texture.graded import (
    average_target,
    guide_grid,
    settle_fractions,
    target_fractions,
)
from trabecula.synth.texture.gradient import GradientVotes, add_votes, empty_votes, fold_votes
from trabecula.synth.texture.method import Texture
from trabecula.synth.texture.poisson import solve_votes

CORNERS, WIDTH, STEP = (5, 6, 7), 4, 2


@pytest.fixture
def spilled(tmp_path, monkeypatch):
    """Where even arrays of a page lie in files, and slabs are thin; in the end nothing is left."""
    monkeypatch.setattr(memmap, "SMALLEST", 1)

    @contextmanager
    def thin():
        with memmap.map_large_arrays(tmp_path / "s", memory=1 << 14, thickest=5):
            yield

    yield thin
    assert not list((tmp_path / "s").iterdir())


def exemplar(seed, shape=(8, 9, 10), channels=2):
    return np.random.default_rng(seed).integers(-127, 128, (channels, *shape)).astype(np.int8)


def sites(seed, grid):
    rng = np.random.default_rng(seed)
    match = rng.integers(0, int(np.prod(CORNERS)), grid).astype(np.int32)
    match[rng.random(grid) < 0.2] = -1
    return match, rng.integers(1, 1000, grid).astype(np.int32)


def covered(grid):
    return tuple((count - 1) * STEP + WIDTH for count in grid)


PLACE = {"shape": CORNERS, "stride": 1, "step": STEP, "width": WIDTH}


def one_round(match, weight, wraps, mu):
    """What a round of energies computes: votes, their solution, and its energy."""
    example = exemplar(1)
    shape = tuple(
        STEP * n if w else c
        for n, w, c in zip(match.shape, wraps, covered(match.shape), strict=True)
    )
    votes = empty_votes(covered(match.shape), channels=2)
    add_votes(votes, example, match, weight, wraps=wraps, **PLACE)
    votes = fold_votes(votes, shape)
    solved = solve_votes(votes, mu=mu, unit=64)
    grown = np.pad(
        solved,
        [(0, 0), *((0, c - s) for c, s in zip(covered(match.shape), shape, strict=True))],
        "wrap",
    )
    squared, slopes = mismatch(grown, example, match, active=weight > 100, **PLACE)
    found = energy(
        squared, slopes, weight, mu=mu, robustness=0.8, reference=50.0, floor=9.0, unit=1 / 64
    )
    return [np.array(part) for part in (*vars(votes).values(), solved, squared, slopes)], found


@pytest.mark.parametrize("wraps", [(False,) * 3, (True, False, True)])
@pytest.mark.parametrize("mu", [0.0, 2.0])
def test_a_round_of_energies_is_the_same(spilled, wraps, mu):
    match, weight = sites(2, (13, 5, 4))
    whole, told = one_round(match, weight, wraps, mu)
    with spilled(), threads(2):
        parts, said = one_round(match, weight, wraps, mu)
    assert said == told
    assert all(np.array_equal(a, b) for a, b in zip(whole, parts, strict=True))


def test_a_guess_is_taken_where_there_are_votes(spilled):
    match, weight = sites(3, (9, 4, 4))
    votes = empty_votes(covered(match.shape), channels=2)
    add_votes(votes, exemplar(1), match, weight, **PLACE)
    guess = exemplar(4, covered(match.shape)).astype(np.float32)
    whole = solve_votes(votes, mu=3.0, unit=64, start=guess, tolerance=1e-5)
    with spilled():
        assert np.array_equal(
            solve_votes(votes, mu=3.0, unit=64, start=guess, tolerance=1e-5), whole
        )
    assert (
        np.abs(whole.astype(int) - solve_votes(votes, mu=3.0, unit=64, tolerance=1e-5)).max() <= 1
    )


@pytest.mark.parametrize("shape", [(5, 4, 6), (5, 9, 6), (2, 9, 13), (5, 9, 13)])
def test_folding_adds_what_lies_beyond_to_where_it_repeats(spilled, shape):
    rng = np.random.default_rng(5)
    votes = GradientVotes(
        rng.integers(-9, 9, (2, 5, 9, 13)).astype(np.int32),
        rng.integers(0, 9, (5, 9, 13)).astype(np.int32),
        rng.integers(-9, 9, (2, 5, 9, 13)).astype(np.int32),
        rng.integers(0, 9, (3, 5, 9, 13)).astype(np.int16),
    )
    at = np.ix_(*(np.arange(side) % period for side, period in zip((5, 9, 13), shape, strict=True)))
    with spilled():
        folded = fold_votes(votes, shape)
        for name, whole in vars(votes).items():
            wanted = np.zeros((*whole.shape[:-3], *shape), whole.dtype)
            np.add.at(wanted, (..., *at), whole)
            assert np.array_equal(getattr(folded, name), wanted), name
        del folded


def test_sites_that_are_not_active_have_no_mismatch():
    match, _ = sites(6, (4, 5, 3))
    state, active = (
        exemplar(7, covered(match.shape)),
        np.random.default_rng(8).random(match.shape) < 0.5,
    )
    every = mismatch(state, exemplar(1), match, **PLACE)
    some = mismatch(state, exemplar(1), match, active=active, **PLACE)
    assert np.array_equal(some, every * active)
    assert every[:, ~active & (match >= 0)].all()


def test_totals_are_rounded_once():
    """Sums in float64, plane by plane, would lose the ones beside 1e16."""
    planes = np.ones((6, 10, 10))
    planes[0, 0, 0], planes[5, 9, 9] = 1e16, -1e16
    assert total(lambda z: planes[z], 6) == math.fsum(planes.ravel()) == 598.0
    assert sum(plane.sum() for plane in planes) != 598.0


def test_the_unit_of_weights_scales_the_weighted_energy():
    rng = np.random.default_rng(9)
    squared, slopes, weights = rng.random((3, 4, 5, 6)) * 100
    settings = {"mu": 0.5, "robustness": 0.8, "reference": 7.0}
    assert energy(squared, slopes, weights, unit=0.25, **settings) == energy(
        squared, slopes, weights / 4, **settings
    )


def searched_grid(mask):
    """A grid of neighbourhoods whose exact search has ties, and sites that are not searched."""
    field = np.clip(
        np.random.default_rng(10).normal(size=(1, 12, 13, 14)).cumsum(1) * 40, -127, 127
    ).astype(np.int8)
    among = Candidates.of(
        Stack.of([field, field[:, ::-1]]), width=4, step=2, variance=0.9, most=8, k=6
    )
    free = np.random.default_rng(11).random((23, 12, 14)) < 0.01 if mask else None
    return Grid.over(Region((23, 12, 14), (False, True, False), free), among)


@pytest.mark.parametrize("mask", [False, True])
def test_exact_matches_are_those_of_the_whole_table(spilled, mask):
    grid = searched_grid(mask)
    rng = np.random.default_rng(12)
    old = rng.choice(grid.candidates.numbers[:40], grid.shape).astype(np.int32)
    noise = rng.integers(-300, 300, (*grid.shape, grid.candidates.features.shape[1]))
    features = (grid.candidates.features[old] + noise).astype(np.int16)
    count = len(grid.candidates.numbers)
    index, distance = k_nearest(features[grid.active], grid.candidates.index)
    shares = index_histogram(old[grid.active], len(grid.candidates.features))
    chosen, apart = rerank(
        index, distance, usage_factors(shares, weight=0.5 * count, theta=1 / count)
    )
    assert (chosen != index[:, 0]).any()
    with spilled(), threads(2):
        match, found = (
            np.array(part) for part in exact_search(grid, old, features, index_penalty=0.5)
        )
    assert np.array_equal(match[grid.active], chosen)
    assert np.array_equal(found[grid.active], apart)
    assert np.array_equal(match[~grid.active], old[~grid.active])
    assert grid.active.all() != mask
    assert not found[~grid.active].any()


class Others:
    """Other processes, as far as work can tell: it comes to them in bytes, and more than once."""

    at_once = 2

    def spread(self, work, bounds):
        packed = ReferencedFiles().dumps(work)
        for start, stop in (*bounds, *bounds):
            pickle.loads(packed)(start, stop)


def test_the_exact_search_can_be_done_by_others(tmp_path):
    pytest.importorskip("cloudpickle")
    grid = searched_grid(True)
    old = np.full(grid.shape, grid.candidates.numbers[3], np.int32)
    features = grid.candidates.features[np.arange(old.size).reshape(old.shape)]
    whole = exact_search(grid, old, features, index_penalty=0.1)
    with memmap.map_large_arrays(tmp_path, memory=1 << 14, thickest=3, workers=Others()):
        made = exact_search(grid, old, features, index_penalty=0.1)
        assert all(np.array_equal(a, b) for a, b in zip(whole, made, strict=True))
    assert (whole[0] != old).any()


def test_a_search_in_high_dimensions_is_prepared_in_pieces():
    """More candidates than are looked at together, the last leaf not full."""
    points = np.random.default_rng(13).normal(size=(9001, 5)) * [3000, 2000, 900, 400, 100]
    points = points.astype(np.int16)
    index, distance = k_nearest(points[::100] + np.int16(7), build_index(points, k=2))
    apart = ((points[::100].astype(np.int64) + 7)[:, None] - points) ** 2
    order = np.argsort(apart.sum(2), axis=1, kind="stable")[:, :2]
    assert np.array_equal(index, order)
    assert np.array_equal(distance, np.take_along_axis(apart.sum(2), order, 1))


@pytest.mark.parametrize("wraps", [(False,) * 3, (True, False, True)])
@pytest.mark.parametrize("width", [5, 40])
def test_windows_are_the_same(spilled, width, wraps):
    values = np.random.default_rng(14).integers(-4096, 4096, (17, 12, 9))
    whole = window_sums(values, width, wraps)
    with spilled(), threads(2):
        assert np.array_equal(window_sums(values, width, wraps), whole)


def graded(mask, wraps):
    """What grading does to a grid and its field."""
    rng = np.random.default_rng(15)
    stack = Stack.of(
        [np.clip(rng.normal(size=(1, 11, 12, 13)).cumsum(2) * 30, -127, 127).astype(np.int8)]
    )
    among = Candidates.of(stack, width=4, step=2, variance=0.9, most=6)
    shape = (21, 10, 12)
    free = rng.random(shape) < 0.7 if mask else None
    grid = Grid.over(Region(shape, wraps, free), among)
    grid, leaning = guide_grid(
        grid, np.linspace(0.2, 0.6, 21 * 120, dtype=np.float32).reshape(shape), 0
    )
    votes = rng.integers(-9000, 9000, (1, *grid.region.shape)).astype(np.int16)
    leaned, last = (
        leaning.shift_field((votes >> 8).astype(np.int8)),
        settle_fractions(votes, leaning),
    )
    parts = leaning.wanted, leaning.counted, grid.guide, leaned, last, grid.candidates.features
    return [np.array(part) for part in parts], (leaning.mean, leaning.width)


@pytest.mark.parametrize(
    ("mask", "wraps"), [(False, (False,) * 3), (True, (False,) * 3), (False, (True, True, False))]
)
def test_grading_is_the_same(spilled, mask, wraps):
    whole, told = graded(mask, wraps)
    with spilled(), threads(2):
        parts, said = graded(mask, wraps)
    assert said == told
    assert all(
        np.array_equal(a, b) and a.dtype == b.dtype for a, b in zip(whole, parts, strict=True)
    )


@pytest.mark.parametrize("mask", [False, True])
@pytest.mark.parametrize("name", ["porosity", "volume_fraction"])
def test_shares_and_their_mean_are_the_same(spilled, name, mask):
    shape = (19, 8, 7)
    asked = np.random.default_rng(16).random(shape, np.float32)
    inside = np.random.default_rng(17).random(shape) < 0.6 if mask else None
    request = tb.Request(shape, target={name: asked}, mask=inside)
    porosity = asked if name == "porosity" else 1 - asked
    with spilled(), threads(2):
        for present, empty, wanted in (((0, 1), 0, 1 - porosity), ((0, 1), 1, porosity)):
            assert np.array_equal(target_fractions(request, present, empty), wanted)
        mean = average_target(request).target["porosity"]
    assert mean == pytest.approx(
        porosity[inside].mean(dtype=np.float64) if mask else porosity.mean(dtype=np.float64)
    )
    assert average_target(request).target == {"porosity": mean}


def test_shares_of_levels_are_the_same(spilled):
    fine = np.random.default_rng(18).integers(-127, 60, (1, 12, 12, 12)).astype(np.int8)
    stacks = [Stack.of([fine]), Stack.of([fine[:, ::2, ::2, ::2] // 2 - 20])]
    shares = np.random.default_rng(19).random((19, 8, 7), np.float32)
    whole = fractions_by_level(shares, stacks)
    assert [level.shape for level in whole] == [(19, 8, 7), (10, 4, 4)]
    with spilled():
        for level, wanted in zip(fractions_by_level(shares, stacks), whole, strict=True):
            assert np.array_equal(level, wanted)
        del level


SETTINGS = {
    "energies": (
        {
            "search": "exact",
            "gradient": 0.5,
            "adaptive": True,
            "histogram": False,
            "neighbourhood": (6, 4),
        },
        {},
    ),
    "a field of targets": (
        {},
        {"target": {"volume_fraction": fields.ramp((28, 22, 24), start=0.12, end=0.3)}},
    ),
}


@pytest.mark.whole
@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize("periodic", [False, True])
def test_the_voxels_are_the_same(bone, spilled, name, periodic):
    settings, asked = SETTINGS[name]
    short = {"levels": 2, "rounds": (2,), "first_rounds": 2, "novelty": 0.0, "step": 2}
    model = Texture.configure(**short, **settings).fit(tb.crop(bone, 24))
    request = tb.Request((28, 22, 24), seed=1, periodic=periodic, **asked)
    whole, told = model.make(request)
    with spilled(), threads(2):
        made, said = model.make(request)
        same = np.array_equal(made, whole)
        del made
    assert same
    assert said == told

"""What a generator's patterns are off on average: learnt, taken back block by block, kept."""

import numpy as np
import pytest

from trabecula.engine.chunking import boxes_of
from trabecula.synth.shared.patterns.bias import PatternBias
from trabecula.synth.shared.patterns.counts import Patterns, cut_out
from trabecula.synth.shared.patterns.excess import kept_cells
from trabecula.synth.shared.patterns.kernels import MARGIN

SIDE = 32
UNIT = 256.0
HERE = np.zeros(3, bool)
EVERYWHERE = np.empty((0, 0, 0), bool)


def field(seed, shape, sigma):
    """A smooth random field of standard deviation 1, that wraps."""
    rates = np.meshgrid(*(np.fft.fftfreq(side) for side in shape), indexing="ij")
    low = np.exp(-2 * np.square(np.pi * sigma) * sum(map(np.square, rates)))
    noise = np.random.default_rng(seed).standard_normal(shape)
    found = np.fft.ifftn(np.fft.fftn(noise) * low).real
    return found / found.std()


def depths(seed, side):
    """Voxels from the interface of blobs that are denser in places, roughly."""
    shape = (side,) * 3
    return 3 * (field(seed, shape, 3) + 0.5 * field(seed + 1, shape, 12) - 0.6)


def rough(seed, side=96):
    """The exemplar: its interface is rough."""
    return (depths(seed, side) + 0.5 * field(seed + 2, (side,) * 3, 1) > 0).astype(np.uint8)


def smooth(seed, bias=None, side=96, cell=None):
    """What a generator makes of the same blobs, changed block by block by a bias."""
    made = depths(seed, side)
    votes = np.clip(made * UNIT, -32000, 32000).astype(np.int16)[None]
    found = (made > 0).astype(np.uint8)
    if bias is None:
        return found
    before = found.copy()
    for n, box in enumerate(boxes_of(before.shape, SIDE)):
        local = cut_out(before, EVERYWHERE, box, HERE)
        inside = tuple(slice(first, last) for first, last in box)
        given = np.uint64(seed + n)
        cells = cell and kept_cells([stop - start for start, stop in box], 2, cell)
        found[inside] = bias.mend(
            local, votes[(0, *inside)][None], given, level=0.0, unit=UNIT, cells=cells
        )
    return found


def off(phases, wanted):
    """All that is off over all that there is to be, where the exemplar is as dense."""
    there = wanted.at(phases.mean())
    return np.abs(Patterns.of(phases, 2).densities - there).sum() / there.sum()


@pytest.fixture(scope="module")
def exemplar():
    return rough(1)


@pytest.fixture(scope="module")
def bias(exemplar):
    return PatternBias.learn([exemplar], 2, lambda given: smooth(3, given), width=SIDE)


@pytest.mark.whole
def test_material_that_it_never_saw_comes_nearer(bias):
    for seed in (11, 12):
        before, after = smooth(seed), smooth(seed, bias)
        assert off(after, bias.wanted) < 0.65 * off(before, bias.wanted)
        for box in boxes_of(before.shape, SIDE):
            inside = tuple(slice(first, last) for first, last in box)
            assert before[inside].sum() == after[inside].sum()


@pytest.mark.whole
def test_parts_keep_their_fractions(bias):
    """Blocks of 32 in cells of 10: the last along an axis holds what remains."""
    first = [0, 10, 20, 30, 32, 42, 52, 62]
    before, after = smooth(11, side=64), smooth(11, bias, side=64, cell=10)
    assert np.mean(before != after) > 0.01
    for axis in range(3):
        before, after = (np.add.reduceat(p.astype(int), first, axis) for p in (before, after))
    np.testing.assert_array_equal(before, after)


def test_samples_go_on_scattering(bias):
    """By half of what they do, or more: a sample that has more interface keeps it."""

    def interfaces(given):
        samples = [smooth(seed, given, side=64) for seed in range(20, 28)]
        return [np.mean(sample[1:] != sample[:-1]) for sample in samples]

    before, after = interfaces(None), interfaces(bias)
    assert np.std(after) > 0.5 * np.std(before)
    assert np.corrcoef(before, after)[0, 1] > 0.8
    assert np.mean(after) > 1.1 * np.mean(before)


def test_a_block_of_no_such_fraction_stays(bias):
    side = SIDE + 2 * MARGIN
    dense = (field(7, (side,) * 3, 3) > -1.2).astype(np.uint8)
    assert dense.mean() > bias.wanted.fraction + 1.5 * bias.wanted.above
    core = dense[(slice(MARGIN, -MARGIN),) * 3].copy()
    votes = np.zeros((1, *core.shape), np.int16)
    found = bias.mend(dense.copy(), votes, np.uint64(1), level=0.0, unit=UNIT)
    np.testing.assert_array_equal(found, core)


def test_the_denser_place_is_held_to_denser_places(bias):
    """Its densities are those of the exemplar's windows of that fraction, so that a dense block is
    not made like a sparse one.
    """
    more = 0.5 * bias.wanted.above
    there, mean = bias.wanted.at(bias.wanted.fraction + more), bias.wanted.own
    longest = slice(17, 34)  # chords of the second phase along z
    lengths = np.arange(1, 18)
    assert lengths @ there[longest] > 1.05 * (lengths @ mean[longest])


@pytest.mark.parametrize("count", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_it_is_kept(count, bias):
    if count == 3:
        exemplar = rough(1) + rough(5)
        bias = PatternBias.learn([exemplar], 3, lambda given: rough(2) + rough(6), width=SIDE)
        assert bias.wanted.slopes is None
    again = PatternBias.from_parts(bias.arrays(), bias.plain())
    assert bias.arrays()["wanted"].shape == (4 - count, bias.wanted.bins.total)
    np.testing.assert_allclose(again.own, bias.own, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(again.slopes, bias.slopes, rtol=1e-6, atol=1e-12)
    assert again.plain() == bias.plain()
    twice = PatternBias.from_parts(again.arrays(), again.plain())
    np.testing.assert_array_equal(twice.own, again.own)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda arrays, plain: arrays.update(off=arrays["off"][:, :-1]),
        lambda arrays, plain: arrays["wanted"].fill(np.nan),
        lambda arrays, plain: plain.update(below=float("inf")),
        lambda arrays, plain: plain.update(phases=3),
    ],
)
def test_damaged_parts_are_refused(bias, spoil):
    arrays, plain = bias.arrays(), bias.plain()
    spoil(arrays, plain)
    with pytest.raises(ValueError, match="damaged"):
        PatternBias.from_parts(arrays, plain)

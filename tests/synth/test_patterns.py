"""Patterns of labels and the flips of single voxels, against plain counts in NumPy."""

from itertools import product

import numpy as np
import pytest
from scipy import ndimage

import trabecula as tb
from trabecula.core.progress import listen, run_of, whole_run
from trabecula.engine.parallel import threads
from trabecula.measure.labelling import label_components
from trabecula.synth.shared.block_bounds import BlockBounds
from trabecula.synth.shared.patterns.balls import FRACTIONS, RADII, STEP
from trabecula.synth.shared.patterns.balls import UNIT as PARTS
from trabecula.synth.shared.patterns.counts import BLOCK, Bins, Patterns
from trabecula.synth.shared.patterns.densities import PatternDensities
from trabecula.synth.shared.patterns.excess import CELL, SHARINGS, excess_of
from trabecula.synth.shared.patterns.flips import FlipRegion, flip_voxels
from trabecula.synth.shared.patterns.kernels import CHORDS, NEIGHBOURS, REACH, STRIDES
from trabecula.synth.shared.patterns.planes import with_euler

UNIT = 1000.0
SMALL = 100  # voxels of a body that stays


def plain_chords(phases, phase, axis, wraps, valid):
    """Chords of a phase that end inside, by their length, and the rooms for them."""
    counts, rooms = np.zeros(CHORDS, int), np.zeros(CHORDS, int)
    lines = np.moveaxis(np.where(valid, phases.astype(int), -1), axis, -1).reshape(
        -1, phases.shape[axis]
    )
    for line in lines:
        side = len(line)

        def at(k, line=line, side=side):
            return line[k % side] if wraps or 0 <= k < side else -1

        for first in range(side):
            ahead = [at(first + k) for k in range(CHORDS + 1)]
            if at(first - 1) < 0 or ahead[0] < 0:
                continue
            inside = next((k for k, there in enumerate(ahead) if there < 0), CHORDS + 1)
            for length in range(1, CHORDS + 1):
                rooms[length - 1] += inside > min(length, REACH)
            if ahead[0] != phase or at(first - 1) == phase:
                continue
            same = next((k for k, there in enumerate(ahead) if there != phase), CHORDS + 1)
            if same > REACH or inside > same:
                counts[min(same, CHORDS) - 1] += 1
    return counts, rooms


def plain_cubes(phases, count, stride, wraps, valid):
    """Cubes of a stride by their code."""
    padded = np.where(valid, phases.astype(int), -1)
    width = [(0, stride)] * 3
    padded = np.pad(padded, width, "wrap") if wraps else np.pad(padded, width, constant_values=-1)
    sides = phases.shape
    code, whole = np.zeros(sides, int), np.ones(sides, bool)
    for n, corner in enumerate(product((0, stride), repeat=3)):
        there = padded[tuple(slice(a, a + side) for a, side in zip(corner, sides, strict=True))]
        code += count**n * there
        whole &= there >= 0
    return np.bincount(code[whole], minlength=count**8), np.count_nonzero(whole)


def plain_neighbours(phases, count, wraps, valid):
    """Voxels of each phase by how many faces, edges and corners they share with their like."""
    padded = np.where(valid, phases.astype(int), -1)
    padded = np.pad(padded, 1, "wrap") if wraps else np.pad(padded, 1, constant_values=-1)
    sides = phases.shape
    kinds, whole = np.zeros((4, *sides), int), valid.copy()
    for corner in product(range(3), repeat=3):
        there = padded[tuple(slice(a, a + side) for a, side in zip(corner, sides, strict=True))]
        kinds[sum(a != 1 for a in corner)] += there == phases
        whole &= there >= 0
    code = (kinds[1] * 13 + kinds[2]) * 9 + kinds[3] + NEIGHBOURS * phases.astype(int)
    return np.bincount(code[whole], minlength=count * NEIGHBOURS), np.count_nonzero(whole)


def plain_balls(phases, phase, radius, wraps, valid):
    """Balls around every fourth voxel of each block by their fraction of a phase, in parts."""
    offsets = np.indices((2 * radius + 1,) * 3).reshape(3, -1).T - radius
    offsets = offsets[np.square(offsets).sum(axis=1) <= radius**2]
    places = [[at for at in range(side) if at % BLOCK % STEP == 0] for side in phases.shape]
    knots = np.rint(FRACTIONS * len(offsets)).astype(int)
    found, rooms = np.zeros(len(knots), int), 0
    for centre in product(*places):
        at = offsets + centre
        if wraps:
            at %= phases.shape
        elif np.any(at < 0) or np.any(at >= phases.shape):
            continue
        at = tuple(at.T)
        if not valid[at].all():
            continue
        full = np.count_nonzero(phases[at] == phase)
        upper = max(1, int(np.searchsorted(knots, full)))
        part = (full - knots[upper - 1]) / (knots[upper] - knots[upper - 1])
        found[upper] += (part := round(PARTS * part))
        found[upper - 1] += PARTS - part
        rooms += PARTS
    return found, rooms


@pytest.mark.whole
@pytest.mark.parametrize("wraps", [False, True])
@pytest.mark.parametrize(("count", "masked"), [(2, False), (2, True), (3, False)])
def test_counts_are_those_of_plain_loops(count, masked, wraps):
    draw = np.random.default_rng(count)
    phases = (draw.random((22, 44, 23)) < 0.2).astype(np.uint8)
    phases[6:14, 5:40, 4:20] = count - 1
    phases[:, 20:, 10] = 1
    valid = draw.random(phases.shape) < 0.97 if masked else np.ones(phases.shape, bool)
    valid[:, 12:] |= masked  # room for balls
    given = {"wraps": [wraps] * 3, "valid": valid if masked else None}
    found = Patterns.of(phases, count, balls=True, **given)
    bins = found.bins
    rooms = found.rooms[bins.rooms]
    for axis, phase in product(range(3), range(count)):
        first = (axis * count + phase) * CHORDS
        own, places = plain_chords(phases, phase, axis, wraps, valid)
        np.testing.assert_array_equal(found.counts[first : first + CHORDS], own)
        np.testing.assert_array_equal(rooms[first : first + CHORDS], places)
    for n, stride in enumerate(STRIDES):
        first = bins.cubes + n * bins.combinations
        own, places = plain_cubes(phases, count, stride, wraps, valid)
        np.testing.assert_array_equal(found.counts[first : first + bins.combinations], own)
        assert rooms[first] == places
    own, places = plain_neighbours(phases, count, wraps, valid)
    np.testing.assert_array_equal(found.counts[bins.neighbours : bins.balls], own)
    assert rooms[bins.neighbours] == places
    first, kinds = bins.balls, range(1, 2) if count == 2 else range(count)
    for radius, phase in product(RADII, kinds):
        own, places = plain_balls(phases, phase, radius, wraps, valid)
        assert own.any()
        np.testing.assert_array_equal(found.counts[first : first + len(own)], own)
        np.testing.assert_array_equal(rooms[first : first + len(own)], places)
        first += len(own)
    assert first == bins.total
    without = Patterns.of(phases, count, **given)
    np.testing.assert_array_equal(without.counts, found.counts[: bins.balls])


@pytest.mark.parametrize("phase", [0, 1, 2])
def test_euler_numbers_are_those_of_the_measure(phase):
    phases = np.random.default_rng(5).integers(0, 3, (24, 24, 24)).astype(np.uint8)
    bins = Bins(3)
    counts = Patterns.of(phases, 3).counts[bins.cubes : bins.cubes + bins.combinations]
    image = tb.Image((phases == phase).astype(np.uint8), "labels")
    for number, connectivity in zip(bins.euler[2 * phase :], (6, 26), strict=False):
        density = tb.measure.euler_density(image, phase=1, connectivity=connectivity)
        assert number @ counts == pytest.approx(density * counts.sum())


def blobs(seed, shape, *, sigma=2.0, count=2):
    """Phases of equal share, and their votes: a smooth random field, or as many."""
    draw = np.random.default_rng(seed)
    rates = [np.fft.fftfreq(side) for side in shape]
    squares = sum(np.square(r) for r in np.meshgrid(*rates, indexing="ij"))
    low = np.exp(-2 * np.square(np.pi * sigma) * squares)
    noise = draw.standard_normal((1 if count == 2 else count, *shape))
    fields = np.fft.ifftn(np.fft.fftn(noise, axes=(1, 2, 3)) * low, axes=(1, 2, 3)).real
    votes = (fields / fields.std() * UNIT * sigma).astype(np.int16)
    phases = (votes[0] > 0) if count == 2 else votes.argmax(axis=0)
    return phases.astype(np.uint8), votes


def grainy(phases, seed, share=0.1):
    """Phases some of whose voxels next to another phase took it: what votes have smoothed away."""
    draw, made = np.random.default_rng(seed), phases.copy()
    for axis in range(3):
        there = np.roll(phases, 1, axis)
        swap = (there != phases) & (draw.random(phases.shape) < share)
        made[swap] = there[swap]
    return made


def learn(exemplar, count=2, balls=True):
    return PatternDensities.of([exemplar], count, balls=balls)


@pytest.fixture(scope="module", params=[2, 3])
def smooth_and_target(request):
    count = request.param
    phases, votes = blobs(0, (64, 50, 72), count=count)
    exemplar, _ = blobs(1, (60, 60, 60), count=count)
    return phases, votes, learn(grainy(exemplar, 2), count)


def misfit(phases, patterns, **given):
    bins = patterns.bins
    found = Patterns.of(phases, bins.phases, balls=bins.with_balls, **given)
    wanted = patterns.own * found.rooms[bins.rooms]
    return np.abs(found.counts - wanted) @ bins.units


@pytest.mark.whole
def test_flips_bring_patterns_nearer_and_keep_fractions(smooth_and_target):
    phases, votes, patterns = smooth_and_target
    made, report = flip_voxels(phases, votes, patterns, FlipRegion(), seed=3, rounds=2, unit=UNIT)
    assert misfit(made, patterns) < 0.65 * misfit(phases, patterns)
    np.testing.assert_array_equal(np.bincount(made.ravel()), np.bincount(phases.ravel()))
    assert report["off_after"] < 0.65 * report["off_before"]
    assert np.count_nonzero(made != phases) <= report["changed"]


@pytest.mark.parametrize("count", [2, 3])
def test_the_change_of_one_block_is_the_change_of_the_counts(monkeypatch, count):
    from trabecula.synth.shared.patterns import flips

    phases, votes = blobs(0, (40, 34, 38), count=count)
    patterns = learn(grainy(phases, 1), count)
    told = []
    own = flips._round

    def keep(phases, bands, *given):
        before = bands[0].off
        made, count = own(phases, bands, *given)
        told.append((made, bands[0].off - before))
        return made, count

    monkeypatch.setattr(flips, "_round", keep)
    flip_voxels(phases, votes, patterns, FlipRegion(), seed=1, rounds=2, unit=UNIT)
    for before, (made, change) in zip((phases, told[0][0]), told, strict=True):
        assert np.any(made != before)
        np.testing.assert_allclose(
            Patterns.of(made, count, balls=True).counts
            - Patterns.of(before, count, balls=True).counts,
            change,
            atol=1e-6,
        )


@pytest.mark.whole
def test_bodies_are_as_wide_as_the_exemplars_by_balls():
    """Of material whose bodies are a third too wide."""
    phases, votes = blobs(0, (60, 60, 60), sigma=4.0)
    exemplar, _ = blobs(1, (80, 80, 80), sigma=3.0)
    off = []
    for balls in (False, True):
        patterns = learn(exemplar, balls=balls)
        given = {"seed": 1, "rounds": 2, "unit": 30 * UNIT}
        made, _ = flip_voxels(phases, votes, patterns, FlipRegion(), **given)
        wanted = Patterns.of(exemplar, 2, balls=True)
        own = slice(wanted.bins.balls, None)
        densities = Patterns.of(made, 2, balls=True).densities
        off.append(np.abs(densities - wanted.densities)[own].sum())
    assert off[1] < 0.8 * off[0]


@pytest.mark.whole
def test_voxels_do_not_depend_on_threads(smooth_and_target):
    phases, votes, patterns = smooth_and_target
    made = []
    for count in (1, 3):
        with threads(count):
            made.append(
                flip_voxels(phases, votes, patterns, FlipRegion(), seed=3, rounds=2, unit=UNIT)[0]
            )
    np.testing.assert_array_equal(*made)
    other, _ = flip_voxels(phases, votes, patterns, FlipRegion(), seed=4, rounds=2, unit=UNIT)
    assert np.any(other != made[0])


@pytest.mark.whole
def test_voxels_that_are_not_free_and_outside_stay(smooth_and_target):
    phases, votes, patterns = smooth_and_target
    valid = np.ones(phases.shape, bool)
    valid[:10] = False
    free = valid.copy()
    free[:, :20] = False
    made, _ = flip_voxels(
        phases, votes, patterns, FlipRegion(free=free, valid=valid), seed=3, rounds=1, unit=UNIT
    )
    np.testing.assert_array_equal(made[~free], phases[~free])
    assert np.any(made != phases)
    count = patterns.bins.phases
    before, after = (np.bincount(one[free], minlength=count) for one in (phases, made))
    np.testing.assert_array_equal(before, after)


def test_beside_fixed_voxels_only_what_is_free_is_mended():
    """Half of the volume is solid and fixed: the other half still comes out as the exemplar."""
    phases, votes = blobs(0, (48, 48, 48))
    patterns = learn(grainy(blobs(1, (60, 60, 60))[0], 2)).without_balls()
    phases[:, :, :24] = 1
    free = np.ones(phases.shape, bool)
    free[:, :, :24] = False
    made, _ = flip_voxels(
        phases, votes, patterns, FlipRegion(free=free), seed=1, rounds=2, unit=UNIT
    )
    far = (slice(None), slice(None), slice(28, None))
    assert misfit(made[far], patterns) < 0.65 * misfit(phases[far], patterns)


@pytest.mark.whole
@pytest.mark.parametrize(("side", "every", "balls"), [(40, 1000, True), (60, 4000, False)])
def test_small_bodies_stay(side, every, balls):
    phases, votes = blobs(0, (side,) * 3, sigma=4.0)
    patterns = learn(grainy(blobs(1, (60, 60, 60))[0], 2, 0.3), balls=balls)
    for phase in (0, 1):
        for at in np.argwhere(phases == phase)[::every]:
            phases[tuple(at)] = 1 - phase  # single voxels: some alone, some at an interface
    made, report = flip_voxels(phases, votes, patterns, FlipRegion(), seed=1, rounds=2, unit=UNIT)
    assert report["changed"] > 1000
    for phase in (0, 1):
        before, after = (label_components(one == phase, connectivity=26) for one in (phases, made))
        small = [
            np.isin(labels, 1 + np.flatnonzero(sizes < SMALL)) for labels, sizes in (before, after)
        ]
        assert small[0].any()
        # two blocks may meet in one
        assert np.count_nonzero(small[0] != small[1]) < (1 if side <= BLOCK else 5)


@pytest.mark.whole
def test_what_votes_are_sure_of_changes_least():
    phases, votes = blobs(0, (60, 60, 60))
    patterns = learn(grainy(blobs(1, (60, 60, 60))[0], 2, 0.2))
    flat, sure = np.zeros_like(votes), votes * 20
    changed = [
        np.count_nonzero(
            flip_voxels(phases, given, patterns, FlipRegion(), seed=1, rounds=1, unit=UNIT)[0]
            != phases
        )
        for given in (flat, sure)
    ]
    assert changed[1] < 0.7 * changed[0]


def test_densities_rise_with_the_fraction_as_in_windows():
    """An exemplar whose left half is denser: what is learnt of it predicts each half."""
    shape = (60, 60, 120)
    _, votes = blobs(0, shape)
    level = np.where(np.arange(120) < 60, -0.6, 0.6) * UNIT
    exemplar = (votes[0] > level).astype(np.uint8)
    learnt = PatternDensities.by_fraction([exemplar], 2, 20)
    np.testing.assert_allclose(learnt.own, learn(exemplar, balls=False).own)
    for half in (slice(0, 60), slice(60, 120)):
        part = np.ascontiguousarray(exemplar[:, :, half])
        own = Patterns.of(part, 2).densities
        off = np.abs(learnt.at(float(part.mean())) - own).sum()
        assert off < 0.35 * np.abs(learnt.own - own).sum()
    np.testing.assert_allclose(learnt.at(learnt.fraction), learnt.own)
    assert learnt.at(0.01) is None
    assert learnt.at(0.99) is None


def test_axes_that_wrap_have_no_face():
    """Rolled around, the same: patterns across the face count, and flips see beyond it."""
    phases, _ = blobs(0, (40, 40, 40))
    rolled = np.roll(phases, (7, 11, 3), (0, 1, 2))
    around = [Patterns.of(one, 2, wraps=[True] * 3) for one in (phases, rolled)]
    np.testing.assert_array_equal(around[0].counts, around[1].counts)
    assert around[0].rooms[0] == phases.size


@pytest.fixture(scope="module")
def exemplar():
    return tb.crop(tb.sample("bone"), 64)


class TestTexture:
    @pytest.mark.whole
    def test_the_default_is_nearer_than_without(self, exemplar):
        found = {}
        for rounds in (0, 2):
            model = tb.method("texture", interface_rounds=rounds).fit(exemplar)
            found[rounds] = model.generate(72, seed=2)
        own = learn(exemplar.values)
        off = {rounds: misfit(made.values, own) for rounds, made in found.items()}
        assert off[2] < 0.6 * off[0]
        assert np.bincount(found[2].values.ravel())[1] == np.bincount(found[0].values.ravel())[1]
        report = found[2].recipe.steps[-1]["report"]["patterns"]
        assert report["off_after"] < report["off_before"]
        assert "patterns" not in found[0].recipe.steps[-1]["report"]

    def test_recipes_of_before_have_none(self):
        from trabecula.synth.texture.config import TextureConfig

        assert TextureConfig().interface_rounds > 0
        assert TextureConfig.recorded({})["interface_rounds"] == 0
        assert TextureConfig().interface_balls
        assert TextureConfig.recorded({})["interface_balls"] is False

    @pytest.mark.whole
    def test_progress_leaves_them_a_third_of_the_run(self, exemplar):
        model, reached = tb.method("texture").fit(exemplar), []

        def hear(label, fraction):
            if label == "matching patterns":
                reached.append(run_of(fraction).reached)

        with listen(hear), whole_run():
            model.generate(72, seed=2)
        assert 0.5 < reached[0] < 0.8 and reached[-1] == pytest.approx(1)

    @pytest.mark.whole
    def test_a_form_keeps_its_outside(self, exemplar):
        at = np.indices((72, 72, 72)) - 36
        ball = np.square(at).sum(axis=0) < 34**2
        made = tb.method("texture").fit(exemplar).generate(72, seed=1, mask=ball)
        assert not made.values[~ball].any()
        share = np.count_nonzero(made.values[ball]) / np.count_nonzero(ball)
        assert share == pytest.approx(float(np.mean(exemplar.values)), abs=1e-4)
        assert "patterns" in made.recipe.steps[-1]["report"]

    @pytest.mark.whole
    def test_a_target_has_the_patterns_of_its_fraction(self, exemplar):
        """Of one number, of a field, and none where the exemplar has no such place."""
        model = tb.method("texture").fit(exemplar)
        own = 1 - float(np.mean(exemplar.values))
        ramp = np.broadcast_to(np.linspace(own - 0.04, own + 0.04, 64, dtype=np.float32), (64,) * 3)
        for porosity, mended in ((own + 0.04, True), (ramp, True), (own - 0.4, False)):
            made = model.generate(64, seed=1, target={"porosity": porosity})
            assert np.mean(made.values == 0) == pytest.approx(np.mean(porosity), abs=1e-3)
            report = made.recipe.steps[-1]["report"]
            told = (report.get("graded") or report)["patterns"]
            assert (told["changed"] > 0) == mended
            assert told.get("left", 0) == (0 if mended else 1)
            if mended:
                assert told["off_after"] < told["off_before"]

    @pytest.mark.slow
    def test_three_phases_need_a_large_exemplar_and_no_target(self, exemplar):
        three = exemplar.values.copy()
        three[exemplar.values == 0] = 2
        three[:, :, ::5] = np.where(exemplar.values[:, :, ::5] == 0, 1, 0)
        image = tb.Image(three, "labels", phases=("solid", "binder", "void"))
        for side, matched in ((64, True), (60, False)):
            model = tb.method("texture").fit(tb.crop(image, side))
            report = model.generate(64, seed=1).recipe.steps[-1]["report"]
            assert ("patterns" in report) == matched


@pytest.mark.parametrize("endless", [False, True])
def test_the_excess_of_cells_is_that_of_the_windows_around_them(endless):
    """Against plain sums; a cell at the end is smaller, one without interface takes no part, and
    the whole has what it has too many.
    """
    rng = np.random.default_rng(5)
    phases = (rng.random((24, 50, 36)) < 0.4).astype(np.uint8)
    phases[:12, 30:] = 0
    fractions = rng.random(phases.shape).astype(np.float32)
    free = rng.random(phases.shape) < 0.7
    found = excess_of(phases, fractions, free, window=20, wraps=(False, endless, False))
    cells = [range(0, side, CELL) for side in phases.shape]
    cross, ends = ndimage.generate_binary_structure(3, 1), [(0, 0), (1, 1), (0, 0)]
    around = np.pad(phases, ends, mode="wrap" if endless else "edge")
    upper = ndimage.maximum_filter(around, footprint=cross, mode="nearest")[:, 1:-1]
    lower = ndimage.minimum_filter(around, footprint=cross, mode="nearest")[:, 1:-1]
    off, room = (
        np.array([one[tuple(slice(a, a + CELL) for a in at)].sum() for at in product(*cells)])
        for one in ((phases - fractions.astype(float)) * free, free & (upper != lower))
    )
    corners = np.array(list(product(*cells)))
    far = np.abs(corners[:, None] - corners)
    if endless:
        far[..., 1] = np.minimum(far[..., 1], 50 - far[..., 1])
    weights = np.maximum(0.0, 1 - far / 20).prod(axis=-1)

    share = np.zeros(len(corners))
    for _ in range(SHARINGS):
        share += weights @ (off - share * room) / np.maximum(1, weights @ room)
    before, after = (np.abs(weights @ (off - one * room)).mean() for one in (0 * share, share))
    assert after < 0.3 * before  # windows lack less
    share += sum(off - share * room) / sum(room)
    assert found[..., 1].ravel() == pytest.approx(share * room, abs=0.51)
    assert (found[..., 0] == -found[..., 1]).all()
    empty = np.count_nonzero(room == 0)
    assert empty == 2 * (2 if endless else 3) * 8  # the last ones have one across the face


@pytest.mark.whole
def test_where_the_target_varies_windows_come_nearer_to_it():
    phases, votes = blobs(0, (80, 60, 60))
    patterns = learn(grainy(blobs(1, (60, 60, 60))[0], 2, 0.2))
    fractions = np.full(phases.shape, phases.mean(), np.float32)
    fractions += np.linspace(-0.01, 0.01, 80, dtype=np.float32)[:, None, None]
    place = FlipRegion(fractions=fractions, window=30)
    made, _ = flip_voxels(phases, votes, patterns, place, seed=1, rounds=2, unit=UNIT)

    def off(labels):
        parts = (labels - fractions).reshape(4, 20, 3, 20, 3, 20).mean(axis=(1, 3, 5))
        return np.abs(parts).mean()

    assert off(made) < 0.8 * off(phases)


@pytest.mark.parametrize("depth", [40, 60])
def test_where_the_target_varies_the_whole_has_its_fraction(depth):
    """Also where a dense end lets voxels go and a sparse one has no interface to gain them, in the
    same block of flips or in another.
    """
    phases, votes = blobs(0, (depth, 40, 40))
    votes[:, depth // 2 :], phases[depth // 2 :] = votes.min(), 0
    patterns = learn(grainy(blobs(1, (60, 60, 60))[0], 2, 0.2))
    fractions = np.full(phases.shape, phases.mean(), np.float32)
    place = FlipRegion(fractions=fractions)
    made, _ = flip_voxels(phases, votes, patterns, place, seed=1, rounds=2, unit=UNIT)
    assert np.count_nonzero(made != phases) > 100
    assert made.mean() == pytest.approx(phases.mean(), abs=2e-4)


@pytest.mark.parametrize("count", [1, 2])
def test_blocks_with_bounds_keep_them(count):
    sides = (5, 4, 7)
    phases, votes = blobs(0, (40, 44, 49))
    rough = grainy(phases, 4)
    there = BlockBounds(*(np.zeros((8, 11, 7), np.int32) for _ in range(2)), sides)
    second = there.excess(rough)[..., 1]
    np.testing.assert_array_equal(
        second, rough.reshape(8, 5, 11, 4, 7, 7).sum(axis=(1, 3, 5), dtype=np.int64)
    )
    bounds = BlockBounds(np.maximum(second - 1, 0), np.minimum(second + 1, 140), sides)
    bounds.least[3, 5, 2], bounds.most[6, 2, 4] = second[3, 5, 2] + 9, second[6, 2, 4] - 9
    patterns = learn(phases, balls=False)
    given = {"seed": 3, "rounds": 3, "unit": UNIT}
    with tb.threads(count):
        made, report = flip_voxels(rough, votes, patterns, FlipRegion(bounds=bounds), **given)
    assert report["off_after"] < 0.8 * report["off_before"]
    found = there.excess(made)[..., 1]
    kept = (found >= bounds.least) & (found <= bounds.most)
    kept[3, 5, 2], kept[6, 2, 4] = found[3, 5, 2] >= second[3, 5, 2], True
    assert kept.all() and found[6, 2, 4] <= second[6, 2, 4]
    assert (found != second).mean() > 0.3
    assert abs(int(found.sum()) - int(second.sum())) < 20


def test_euler_numbers_are_those_asked_for():
    given = learn(grainy(blobs(0, (40, 40, 40))[0], 1), balls=False)
    wanted = given.euler * [0.4, 0.7]
    found = with_euler(given, wanted)
    np.testing.assert_allclose(found.euler, wanted, rtol=1e-6)
    bins = given.bins
    cubes = slice(bins.cubes, bins.cubes + bins.combinations)
    assert found.own[cubes].sum() == pytest.approx(given.own[cubes].sum())
    others = np.ones(bins.total, bool)
    others[cubes] = False
    np.testing.assert_array_equal(found.own[others], given.own[others])


def test_where_the_target_varies_a_block_that_is_to_gain_does():
    """Its cells have little room each: the whole has a price of its own."""
    shape = (40, 40, 80)
    phases, votes = blobs(0, shape)
    patterns = learn(grainy(blobs(1, (60, 60, 60))[0], 2, 0.2))
    ramp = phases.mean() * np.linspace(0.5, 1.5, shape[2]) + 0.03
    place = FlipRegion(fractions=np.broadcast_to(ramp, shape).astype(np.float32))
    made, _ = flip_voxels(phases, votes, patterns, place, seed=1, rounds=2, unit=UNIT)
    assert made.mean() == pytest.approx(ramp.mean(), abs=1e-3)  # .004 less without

"""Sliced rounds and correlation steps: against plain NumPy, against the measures, and against what
is known.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import trabecula as tb
from trabecula.core.seeds import key
from trabecula.measure import coherence
from trabecula.synth.api.registry import recorded_method
from trabecula.synth.shared import novel_schedule
from trabecula.synth.shared.content.fields import FULL, UNIT, phase_fields, quantise
from trabecula.synth.shared.novel_schedule import Start
from trabecula.synth.shared.statistics.pairs import AXES, DIAGONAL, Pairs
from trabecula.synth.shared.statistics.sliced import rotation, transport_neighbourhoods
from trabecula.synth.shared.statistics.slices import Transport, slice_target
from trabecula.synth.shared.statistics.two_point import correlations_of
from trabecula.synth.shared.statistics.two_point_steps import least_squares, misfit, two_point_step
from trabecula.synth.texture.config import TextureConfig

OPEN, AROUND = (False, False, False), (True, True, True)
HARD = 1e-3  # a soft step so narrow that the indicator is that of labels


def smooth(shape, seed, *, channels=1, radius=2):
    """A wrapping random field in int8, smooth over a few voxels."""
    noise = np.random.default_rng(seed).standard_normal((channels, *shape))
    for axis in (1, 2, 3):
        for _ in range(radius):
            noise = noise + np.roll(noise, 1, axis) + np.roll(noise, -1, axis)
    return np.clip(np.rint(noise / noise.std() * 50), -FULL, FULL).astype(np.int8)


@pytest.mark.parametrize("size", [4, 32, 64])
def test_a_rotation_keeps_angles_and_is_whole(size):
    turn = rotation(key(1, "r"), 3, size)
    assert np.array_equal(turn, np.rint(turn))
    assert np.array_equal(turn @ turn.T, size**2 * np.eye(size))
    assert not np.array_equal(turn, rotation(key(1, "r"), 4, size))


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), copies=st.integers(1, 4))
def test_transport_brings_one_column_to_the_other(seed, copies):
    """Where every value has a bin of its own, ours become theirs, rank for rank, in whatever
    numbers they come.
    """
    rng = np.random.default_rng(seed)
    theirs = rng.permutation(1000)[:50]
    ours = rng.permutation(1000)[: 50 * copies]
    rows = ours[:, None].astype(np.float32)
    transport = Transport.between(
        lambda a, b: [rows[a:b]], len(rows), theirs[:, None].astype(np.float32)
    )
    reached = ours + transport.moves(rows)[:, 0]
    assert np.array_equal(np.sort(reached), np.sort(np.repeat(theirs, copies)))
    assert np.array_equal(np.argsort(ours), np.lexsort((ours, reached)))


@pytest.mark.parametrize("periodic", [OPEN, AROUND, (True, False, True)])
def test_a_round_without_strength_gives_back_what_all_components_hold(periodic):
    """Known truth: 4^3 components of neighbourhoods of 4^3 voxels hold everything, so nothing
    changes but by rounding.
    """
    field = smooth((13, 12, 15), 0)
    votes = field.astype(np.int16) * UNIT
    slices = slice_target([field], width=4, variance=1.0, most=64)
    after = transport_neighbourhoods(
        votes, [(0, slices)], key=key(0, "s"), number=1, strength=0.0, periodic=periodic
    )
    assert np.abs(after.astype(int) - votes).max() <= 2 * UNIT


def test_rounds_take_on_the_exemplars_neighbourhoods():
    """From noise: the spread of every component comes to the exemplar's, and so does the two-point
    function.
    """
    exemplar, field = (
        smooth((24, 24, 24), 1),
        np.random.default_rng(2).integers(-90, 91, (1, 20, 24, 28)) * UNIT,
    )
    slices = slice_target([exemplar], width=4)
    field = field.astype(np.int16)
    for number in range(15):
        field = transport_neighbourhoods(field, [(0, slices)], key=key(0, "s"), number=number)
    target = correlations_of([exemplar], softness=40, r_max=6)
    found = misfit(np.rint(field / UNIT).astype(np.int8), target)
    assert abs(field.std() / UNIT / exemplar.std() - 1) < 0.1
    assert np.linalg.norm(found) < 0.06 * np.linalg.norm(target.curves)


def test_only_what_is_free_changes():
    field = smooth((16, 16, 16), 3, channels=2)
    other = smooth((16, 16, 16), 4, channels=2, radius=1)
    free = np.zeros((16, 16, 16), bool)
    free[3:9, 4:12, :] = True
    votes = field.astype(np.int16) * UNIT
    after = transport_neighbourhoods(
        votes, [(0, slice_target([other], width=4))], key=key(0, "s"), number=0, free=free
    )
    assert np.array_equal(after[:, ~free], votes[:, ~free])
    assert np.mean(after[:, free] != votes[:, free]) > 0.9
    target = correlations_of([other], softness=60, r_max=5)
    after = two_point_step(field, target, free=free)
    assert np.array_equal(after[:, ~free], votes[:, ~free])
    assert np.any(after[:, free] != votes[:, free])


@pytest.mark.parametrize("periodic", [OPEN, AROUND])
def test_threads_change_nothing(periodic):
    field, exemplar = smooth((20, 22, 26), 5), smooth((20, 20, 20), 6)
    slices, target = (
        slice_target([exemplar], width=4),
        correlations_of([exemplar], softness=50, r_max=6),
    )
    made = []
    for count in (1, 2, 3):
        with tb.threads(count):
            votes = transport_neighbourhoods(
                field.astype(np.int16) * UNIT,
                [(0, slices)],
                key=key(0, "s"),
                number=0,
                periodic=periodic,
            )
            made.append((votes, two_point_step(field, target, periodic=periodic)))
    for votes, steps in made[1:]:
        assert np.array_equal(votes, made[0][0])
        assert np.array_equal(steps, made[0][1])


def test_two_exemplars_count_as_one_of_both():
    a, b = smooth((16, 16, 16), 7), smooth((16, 16, 16), 8, radius=1)
    pairs = slice_target([a, b], width=3)
    assert len(pairs.features) == 2 * 14**3
    both = correlations_of([a, b], softness=40, r_max=5).curves
    apart = [correlations_of([x], softness=40, r_max=5).curves for x in (a, b)]
    assert np.allclose(both, np.mean(apart, axis=0))


@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (2.0, 1.0, 1.0)])
def test_a_hard_step_gives_the_two_point_function(edges):
    """Over the three directions it is the radial one of the measure; along an axis it is nearer to
    that axis' own.
    """
    field = smooth((14, 17, 20), 9)
    ties = field[0] == 0  # half in, half out
    image = tb.Image((field[0] > 0).astype(np.uint8), "labels", spacing=edges)
    field[0][ties] = -1
    target = correlations_of([field], softness=HARD, r_max=7, edges=edges)
    fits = Pairs(image.shape, 7, edges=edges).fits
    assert np.allclose(
        radial(target.curves[0], fits), tb.measure.two_point(image, r_max=7), atol=1e-6
    )


def radial(curve, fits):
    """The mean over directions of a curve by direction and distance."""
    pairs = fits.reshape(3, -1)
    return (curve.reshape(3, -1) * pairs).sum(axis=0) / pairs.sum(axis=0)


def test_directions_are_told_apart():
    """Layers across z: along z the two-point function falls to nothing and comes back, across it
    stays up.
    """
    layers = np.broadcast_to(
        np.where(np.arange(24) % 8 < 4, 50, -50)[:, None, None], (24, 24, 24)
    ).astype(np.int8)
    along, down, across = (
        correlations_of([layers[None]], softness=HARD, r_max=8).curves[0].reshape(3, -1)
    )
    assert along[4] < 0.15
    assert down[4] > 0.3
    assert np.allclose(down[1:], across[1:], atol=0.02)


def test_the_sign_of_a_tilt_is_told_by_the_diagonals_alone():
    """Layers across y + x, and their mirror image across y - x: along the axes they are the same;
    along a diagonal the two-point function stays up in the one and falls in the other.
    """
    y, x = np.ogrid[:24, :24]
    tilted = np.broadcast_to(np.where((y + x) % 12 < 6, 50, -50), (24, 24, 24)).astype(np.int8)
    mirrored = np.ascontiguousarray(tilted[:, :, ::-1])
    by_axis, by_line = (
        [
            correlations_of([field[None]], softness=HARD, r_max=4, directions=count).curves[0]
            for field in (tilted, mirrored)
        ]
        for count in (AXES, DIAGONAL)
    )
    assert np.allclose(*by_axis, atol=0.02)
    one, other = (curve.reshape(DIAGONAL, -1)[:, 4] for curve in by_line)
    assert np.abs(one - other).max() > 0.25


def test_each_of_the_26_neighbours_shares_its_line_with_the_opposite_one():
    r_max = 2
    pairs = Pairs((9, 9, 9), r_max, directions=DIAGONAL)
    lines: dict[int, list[tuple[int, ...]]] = {}
    for z, y, x in np.ndindex(2, 3, 3):
        if (z, y, x) != (0, 1, 1):
            line = int(pairs.places[z, y + 1, x + 1]) // (r_max + 1)
            lines.setdefault(line, []).append((z, y - 1, x - 1))
    assert sorted(lines) == list(range(DIAGONAL))
    for own in lines.values():  # of a pair in the plane z = 0 both orders are there
        assert len(own) == 1 or own == [(0, -own[1][1], -own[1][2]), own[1]]


def test_misfit_around_and_within_a_mask_is_that_of_the_measure():
    field = smooth((14, 15, 16), 10)
    field[field == 0] = 1
    target = correlations_of([field], softness=HARD, r_max=6)
    image = (field[0] > 0).astype(np.uint8)
    mask = np.zeros(image.shape, bool)
    mask[2:12, 1:14, 4:] = True
    for settings_, pairs, measured in [
        (
            {"periodic": AROUND},
            Pairs(image.shape, 6, AROUND),
            tb.measure.two_point(image, r_max=6, periodic=True),
        ),
        (
            {"free": mask},
            Pairs(image.shape, 6, free=mask),
            tb.measure.two_point(image, r_max=6, mask=mask),
        ),
    ]:
        found = misfit(field, target, **settings_)[0] + target.curves[0]
        assert np.allclose(radial(found, pairs.fits), measured, atol=1e-6)


def test_a_convolution_is_the_weighted_sum_around():
    values = np.random.default_rng(11).random((9, 10, 11)).astype(np.float32)
    pairs = Pairs(values.shape, 2, AROUND)
    # by direction and distance
    weights = np.array([[0.5, -1.0, 0.25], [0.0, 2.0, 0.5], [0.0, 0.75, -0.25]])
    wanted = np.zeros(values.shape)
    for offset in np.ndindex(5, 5, 5):
        shift = np.array(offset) - 2
        length = int(np.sqrt((shift**2).sum()) + 0.5)
        if length <= 2:
            nearest = int(np.argmax(shift**2))  # the first of equals
            wanted += weights[nearest, length] * np.roll(values, tuple(shift), (0, 1, 2))
    assert np.allclose(pairs.convolve(pairs.forward(values), weights.ravel()), wanted, atol=1e-5)


def test_steps_bring_the_two_point_function_to_the_exemplars():
    exemplar, field = smooth((28, 28, 28), 12, radius=2), smooth((30, 32, 36), 13, radius=3)
    target = correlations_of([exemplar], softness=120, r_max=8)
    size = [np.linalg.norm(misfit(field, target))]
    for _ in range(4):
        field = np.clip(np.rint(two_point_step(field, target) / UNIT), -FULL, FULL).astype(np.int8)
        size.append(np.linalg.norm(misfit(field, target)))
    assert size[1] < 0.65 * size[0]
    assert size[-1] < 0.35 * size[0]


def test_a_field_at_its_target_stays_and_debt_moves_the_target():
    field = smooth((20, 20, 20), 14)
    target = correlations_of([field], softness=60, r_max=6)
    assert (
        np.abs(two_point_step(field, target).astype(int) - field.astype(int) * UNIT).max()
        <= UNIT // 8
    )
    debt = np.zeros((1, 3, 7))
    debt[0, :, 1:4] = 2e-3
    debt = debt.reshape(1, -1)
    moved = np.rint(two_point_step(field, target, debt=debt) / UNIT).astype(np.int8)
    assert np.all(misfit(moved, target).reshape(3, 7)[:, 1:4] < -5e-4), (
        "below the target by about the debt"
    )


def test_no_place_is_special_where_axes_wrap():
    field, exemplar = smooth((18, 20, 24), 15), smooth((20, 20, 20), 16, radius=1)
    target = correlations_of([exemplar], softness=60, r_max=6)
    shift = (5, 11, 17)
    there = two_point_step(np.roll(field, shift, (1, 2, 3)), target, periodic=AROUND)
    here = np.roll(two_point_step(field, target, periodic=AROUND), shift, (1, 2, 3))
    assert np.abs(there.astype(int) - here).max() <= 2


@pytest.mark.whole
def test_open_faces_gather_no_phase():
    """What a step adds, averaged over where the faces lie in an endless material, is the same at a
    face and far from it.

    A direction that is cut off at the faces fails this: one phase piles up on them.
    """
    exemplar = quantise(phase_fields(tb.crop(tb.sample("bone"), 32))[0], clip=4.0)
    target = correlations_of([exemplar], softness=60, r_max=10)
    order = np.argsort(np.argsort(smooth((32, 32, 32), 0).ravel()))
    field = np.sort(exemplar.ravel())[order].reshape(1, 32, 32, 32)
    shell = np.ones((32, 32, 32), bool)
    shell[3:-3, 3:-3, 3:-3] = False
    pull = size = 0.0
    for shift in np.random.default_rng(0).integers(0, 32, (24, 3)):
        here = np.roll(field, tuple(shift), (1, 2, 3))
        change = two_point_step(here, target)[0].astype(float) - here[0] * float(UNIT)
        pull += change[shell].mean() - change[~shell].mean()
        size += np.abs(change).mean()
    assert abs(pull) < 0.2 * size, "cut off it is 0.74"


def test_channels_are_corrected_one_by_one():
    exemplar, field = smooth((18, 18, 18), 17, channels=2), smooth((18, 20, 22), 18, channels=2)
    target = correlations_of([exemplar], softness=60, r_max=5)
    both = two_point_step(field, target)
    for c in range(2):
        alone = correlations_of([exemplar[c : c + 1]], softness=60, r_max=5)
        assert np.array_equal(two_point_step(field[c : c + 1], alone)[0], both[c])


def test_nothing_moves_where_there_is_no_interface():
    target = correlations_of([smooth((16, 16, 16), 19)], softness=40, r_max=5)
    full = np.full((1, 12, 12, 12), FULL, np.int8)
    assert np.array_equal(two_point_step(full, target), full.astype(np.int16) * UNIT)


def test_least_squares_are_numpys():
    rng = np.random.default_rng(20)
    changes, excess, weights = rng.standard_normal((4, 12)), rng.standard_normal(12), rng.random(12)
    root = np.sqrt(weights)
    wanted = np.linalg.lstsq((changes * root).T, -excess * root, rcond=None)[0]
    assert np.allclose(least_squares(changes, excess, weights), wanted, rtol=0.02, atol=0.02)


def test_the_layout_is_on_the_level_of_the_structure():
    """Cubes of n voxels in a chessboard have an interface every n voxels along each axis: the
    length is n / 3, apart from the faces; from 6 voxels on the layout is on level 2.
    """
    for edge, level in [(2, 1), (12, 1), (18, 2)]:
        cells = np.indices((72, 72, 72)) // edge
        board = tb.Image((cells.sum(axis=0) % 2).astype(np.uint8), "labels")
        assert novel_schedule.structure_length([board]) == pytest.approx(71 / (3 * (72 / edge - 1)))
        assert novel_schedule.start_of([board], "structure").level == level
        assert novel_schedule.start_of([board], "coarse").level == 2
    assert novel_schedule.start_of([tb.crop(board, 24)], "structure").level == 1


def test_rounds_begin_on_a_coarser_level_where_there_is_room():
    """From 4 voxels of the structure's length on; in 64 voxels wide neighbourhoods would be few,
    and copied whole.
    """
    for edge, level in [(6, 1), (12, 2)]:
        cells = np.indices((96, 96, 96)) // edge
        board = tb.Image((cells.sum(axis=0) % 2).astype(np.uint8), "labels")
        assert novel_schedule.start_of([board], "rounds").level == level
        assert novel_schedule.start_of([tb.crop(board, 64)], "rounds").level == 1


@pytest.mark.whole
def test_rounds_of_fine_structures_begin_with_narrow_neighbourhoods():
    """A wide one would hold several bodies, and copy them together."""
    for edge, width in [(4, 6), (12, 8)]:
        cells = np.indices((64, 64, 64)) // edge
        board = tb.Image((cells.sum(axis=0) % 2).astype(np.uint8), "labels")
        assert novel_schedule.start_of([board], "rounds") == Start(1, width)
        first = novel_schedule.passes(1.0, Start(1, width), "rounds")[0]
        assert (first.level, first.width) == (1, width)
    model = tb.method("texture").fit(tb.crop(tb.sample("cells"), 40))
    assert model.aims[1].candidates[0].basis.width == 6


@pytest.mark.whole
def test_rounds_begin_with_noise():
    image = tb.crop(tb.sample("bone"), 40)
    model = tb.method("texture").fit(image)
    assert model.slices is None
    rounds = model._novel_rounds(tb.Request((40, 40, 40)))
    assert rounds.open_stage(0).rounds == 0
    for novelty, top in ((1.0, 1), (1.0, 2), (0.5, 2)):
        first, *later = novel_schedule.passes(novelty, Start(top), "rounds")
        assert first.level == top and first.width == 8 and not first.carried
        # novelty goes to the first pass alone
        assert first.rounds > later[0].rounds
        assert later == list(novel_schedule.passes(1.0, Start(top), "rounds")[1:])


@pytest.mark.parametrize("top", [1, 2])
def test_leaves_are_searched_from_noise_alone_and_on_coarse_levels(top):
    plain = novel_schedule.passes(1.0, Start(top), "rounds")
    leaves = novel_schedule.passes(1.0, Start(top), "rounds", by_leaves=True)
    assert [p.level for p in leaves] == [p.level for p in plain]
    assert [p.by_leaves for p in leaves] == [p.level > 0 for p in leaves]
    assert all(a.rounds > b.rounds for a, b in zip(leaves, plain, strict=True) if a.level)
    assert [p.width for p in leaves if p.level == 0] == [8, 6]
    for layout in ("structure", "coarse"):
        sliced = novel_schedule.passes(1.0, Start(top), layout, by_leaves=True)
        assert sliced == novel_schedule.passes(1.0, Start(top), layout)


@pytest.mark.slow
def test_material_by_leaves_is_new_and_other_than_by_sweeps():
    image = tb.crop(tb.sample("bone"), 40)
    model = tb.method("texture", search="leaves").fit(image)
    assert model._novel_rounds(tb.Request((48, 48, 48))).schedule[0].by_leaves
    made = model.generate(48, seed=2)
    assert made.values.mean() == pytest.approx(image.values.mean(), abs=1e-4)
    swept = tb.method("texture").fit(image).generate(48, seed=2)
    assert not np.array_equal(made.values, swept.values)
    moved = tb.method("texture", preset="best").fit(image).generate(48, seed=2)
    assert coherence(image, made)[4] < coherence(image, moved)[4] / 2


def test_exemplars_without_an_interface_are_laid_out_on_the_coarsest_level():
    blocks = [tb.Image(np.full((48, 48, 48), label, np.uint8), "labels") for label in (0, 1)]
    assert novel_schedule.structure_length(blocks) == np.inf
    assert novel_schedule.start_of(blocks, "structure").level == 2


def test_a_recipe_of_before_may_name_one_of_two_schedules():
    for schedule in ("short", "long"):
        learned = recorded_method("texture", {"schedule": schedule, "layout": "structure"})
        assert learned.config.layout == "structure"
    assert "schedule" not in TextureConfig.recorded({"schedule": "short"})


def test_the_last_pass_begins_with_the_matches_of_the_one_before():
    last = novel_schedule.passes(1.0, Start(1), "structure")[-1]
    assert last.carried
    assert last.sweeps(0, 2) == 2
    assert not any(part.carried for part in novel_schedule.passes(1.0, Start(1), "structure")[:-1])
    assert not any(part.carried for part in novel_schedule.passes(1.0, Start(2), "coarse"))

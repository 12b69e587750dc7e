"""Words, candidates, periods, components: each against a plain way to the same."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from quilt_lattice import lattice, reference
from scipy import ndimage

import trabecula as tb
from trabecula.synth.quilt.candidates import CandidateDescriptors, CandidatePool, RankedCandidates
from trabecula.synth.quilt.canvas import EMPTY, FIXED, OUT, PatchGrid, near_empty
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.connectivity import (
    CLOSED,
    FINE,
    SOLID,
    VOID,
    ComponentTracker,
    ConnectivityCheck,
    join_rest,
    thin_voxels,
    voxel_classes,
)
from trabecula.synth.quilt.patch_library import PackedLabels, label_bits, mismatches, overlap_query
from trabecula.synth.quilt.period import (
    cell_shifts,
    common_periods,
    period_along,
    positions_in_phase,
)
from trabecula.synth.quilt.run import QuiltRun
from trabecula.synth.quilt.seams import StrutBuilder, cut_in


@given(st.integers(0, 10**6), st.sampled_from([(7, 3, 2), (14, 4, 2), (9, 5, 3), (6, 2, 11)]))
def test_mismatches_are_counted_voxel_by_voxel(seed, sizes):
    patch, overlap, labels = sizes
    rng = np.random.default_rng(seed)
    stack = rng.integers(0, labels, (2, patch + 2, patch + 3, patch + 4)).astype(np.uint8)
    words = PackedLabels.pack(stack, patch=patch, overlap=overlap, planes=label_bits(labels))
    box = rng.integers(0, labels, (patch,) * 3).astype(np.uint8)
    box[rng.random(box.shape) < 0.2] += FIXED
    near = np.zeros(box.shape, bool)
    near[:overlap] = near[:, :, :overlap] = True
    near[:, -2:] |= rng.random((patch, 2, patch)) < 0.5
    query = overlap_query(words, box, near, (stack.shape[2] * stack.shape[3], stack.shape[3]))
    assert query.voxels == near.sum()
    places = [(s, z, y, x) for s in range(2) for z in (0, 2) for y in (0, 3) for x in (0, 4)]
    at = np.array([np.ravel_multi_index(place, stack.shape) for place in places], np.int32)
    plain = [
        int(((stack[s, z : z + patch, y : y + patch, x : x + patch] != box % FIXED) & near).sum())
        for s, z, y, x in places
    ]
    assert mismatches(words, query, at).tolist() == plain


@given(st.integers(0, 10**6), st.integers(1, 5))
def test_a_part_of_a_query_counts_a_part_of_the_voxels(seed, nth):
    rng = np.random.default_rng(seed)
    stack = rng.integers(0, 3, (1, 12, 13, 14)).astype(np.uint8)
    words = PackedLabels.pack(stack, patch=9, overlap=4, planes=label_bits(3))
    near = rng.random((9, 9, 9)) < 0.5
    query = overlap_query(words, stack[0, :9, :9, :9], near, (13 * 14, 14))
    part = query.every_nth(nth)
    at = np.arange(4, dtype=np.int32)
    whole, less = mismatches(words, query, at), mismatches(words, part, at)
    assert part.voxels == sum(int(mask).bit_count() for mask in query.masks[::nth])
    assert np.all(less <= whole) and less[0] == whole[0] == 0
    assert nth > 1 or np.array_equal(less, whole)


def test_exact_continuations_pass_the_sieve():
    """Find, among thousands of candidates, the one that was cut out again by a part of its
    words.
    """
    rng = np.random.default_rng(2)
    blobs = (ndimage.gaussian_filter(rng.random((40, 40, 40)), 1.5) > 0.5).astype(np.uint8)
    run = QuiltRun(
        tb.method("quilt", patch=12, overlap=5, connected="none").fit(blobs).library,
        QuiltConfig(share=1.0),
        asking(),
    )
    at = int(np.ravel_multi_index((0, 9, 14, 21), run.library.stack.shape))
    box = run.library.patch_at(at).copy()
    near = np.zeros(box.shape, bool)
    near[:5] = near[:, :5] = True
    query = overlap_query(run.library.words, box, near, run.library.strides[1:])
    none = (np.empty(0, np.int64), np.empty((0, 3), np.int64))
    asked = run.descriptors.scale_targets({"volume_fraction": 0.5})
    found = run.chooser.ranker.rank(
        query, run.pools.pool((0, 0, 0)), asked, place=0, count=10**6, before=none, without=()
    )
    assert len(found.at) < 29**3 // 4, "most were sifted out"
    assert found.mismatch[found.at == at].tolist()[:1] == [0]


def asking():
    return tb.Request((24, 24, 24), seed=1, target={"volume_fraction": 0.5})


def test_of_the_nearest_the_least_seam_comes_first():
    rng = np.random.default_rng(4)
    blobs = (ndimage.gaussian_filter(rng.random((40, 40, 40)), 1.5) > 0.5).astype(np.uint8)
    model = tb.method("quilt", patch=12, overlap=5, seams=6, tries=10, connected="none").fit(blobs)
    run = QuiltRun(model.library, model.config, asking())
    assert run._lay_or_undo(0) == 1
    place = run._site_at(1, run.grid.corner(1))
    found = run.chooser.ranker.rank(
        place.query, place.pool, place.target, place=1, count=500, before=place.before, without=()
    )
    nearest = np.argsort(found.score, kind="stable")[:10]
    order = [n for n, _ in run.chooser._by_seam(place, found)]
    costs = [
        cut_in(place.old, run.grid.margin, model.library.patch_at(int(found.at[n])))[1]
        for n in order
    ]
    assert set(order[:6]) == set(nearest[:6].tolist()) and set(order) == set(nearest.tolist())
    assert costs[:6] == sorted(costs[:6]) and costs[6:] == sorted(costs[6:])
    assert len(set(costs)) > 2


@given(st.integers(0, 10**6), st.integers(1, 40))
def test_candidates_are_taken_off_from_the_nearest(seed, count):
    score = np.random.default_rng(seed).integers(0, 30, 60)
    ranked = RankedCandidates(np.arange(60), np.zeros(60), np.zeros(60), score.copy(), True)
    first, second = ranked.take_nearest(count), ranked.take_nearest(count)
    assert (
        np.concatenate([first, second]).tolist()
        == np.argsort(score, kind="stable")[: 2 * count].tolist()
    )


def two_stubs():
    """Return a canvas with one box to make; two rods end at it, and a third component is
    elsewhere.
    """
    canvas = np.zeros((9, 9, 15), np.uint8)
    canvas[4, 4, :5] = canvas[4, 4, 10:] = 1
    canvas[2:7, 2:7, 5:10] = EMPTY
    grid = PatchGrid(canvas.shape, (False,) * 3, (5, 5, 5), (5, 5, 5), (2, 2, 5))
    components = ComponentTracker(
        canvas, np.zeros(canvas.shape, np.int32), grid.wraps, voxel_classes("solid", 0, 2)
    )
    old, numbers = np.empty((13, 13, 13), np.uint8), np.empty((13, 13, 13), np.int32)
    grid.read_window(canvas, (2, 2, 5), old, OUT)
    grid.read_window(components.numbers, (2, 2, 5), numbers, 0)
    return components, ConnectivityCheck(old.shape, grid.margin, island=0), old, numbers


def test_a_strut_leads_where_pieces_have_solid():
    components, check, old, numbers = two_stubs()
    new = np.where(old == EMPTY, 0, old).astype(np.uint8)
    assert check.verdict(components, old, new, numbers) == CLOSED
    detour = np.zeros((5, 5, 5), bool)
    detour[2, :3, 0] = detour[2, 0, :] = detour[2, :3, 4] = True
    for share, voxels in ((np.zeros(detour.shape), 5), (detour.astype(float), 9)):
        made = StrutBuilder(void=0, solid=1, radius=0).lay(
            components, check, old, new, numbers, share
        )
        added = np.argwhere(made != new) - 4
        assert len(added) == voxels
        assert ndimage.label(made == 1)[1] == 1
        if voxels == 9:
            assert all(detour[tuple(at)] for at in added)


def test_a_strut_of_some_thickness_stays_in_its_box():
    components, check, old, numbers = two_stubs()
    new = np.where(old == EMPTY, 0, old).astype(np.uint8)
    made = StrutBuilder(void=0, solid=1, radius=2).lay(
        components, check, old, new, numbers, np.zeros((5, 5, 5))
    )
    added = np.argwhere(made != new)
    assert len(added) > 40 and added.min() >= 4 and added.max() < 9


def test_without_a_way_there_is_no_strut():
    components, check, old, numbers = two_stubs()
    old[:, :, 6] = np.where(old[:, :, 6] == EMPTY, FIXED, old[:, :, 6])
    new = np.where(old == EMPTY, 0, old).astype(np.uint8)
    assert (
        StrutBuilder(void=0, solid=1, radius=0).lay(
            components, check, old, new, numbers, np.zeros((5, 5, 5))
        )
        is None
    )


@given(st.integers(0, 10**6), st.integers(1, 3), st.integers(1, 60))
def test_the_nearest_candidates_are_the_nearest(seed, names, count):
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 200, (names, 60)).astype(np.int32)
    values = values[:, np.argsort(values[0], kind="stable")]
    weights, target = rng.integers(1, 9, names), rng.integers(-50, 250, names)
    pool = CandidatePool(np.arange(60, dtype=np.int32), values)
    at, differences = pool.nearest(target, weights, count)
    every = (weights[:, None] * np.abs(values - target[:, None])).sum(axis=0)
    assert len(set(at.tolist())) == count
    assert np.array_equal(differences, every[at])
    assert sorted(differences.tolist()) == sorted(every.tolist())[:count]


def test_descriptors_are_those_of_the_windows_over_their_range():
    image = tb.Image(reference(24), "labels")
    library = (
        tb.method("quilt", patch=8, overlap=2, period="none", connected="none").fit(image).library
    )
    found = CandidateDescriptors.measure(library, ["volume_fraction", "euler"], {"euler": 3})
    assert found.names == ("euler", "volume_fraction"), "the heavier first"
    assert found.weights.tolist() == [768, 256]
    shares = ndimage.uniform_filter(image.values.astype(float), 8, origin=-4)[:17, :17, :17].ravel()
    shares = (shares - shares.min()) / (shares.max() - shares.min())
    assert np.allclose(found.values[1] / 65535, shares, atol=1e-4)


@pytest.mark.whole
@pytest.mark.parametrize("period", [6, 9, 13])
def test_a_period_is_found_and_noise_has_none(period):
    x = np.indices((3 * period + 1, 40, 40))[2]
    layers = ((x % period < period // 2) ^ (np.random.default_rng(0).random(x.shape) < 0.1)).astype(
        np.uint8
    )
    assert period_along(layers, 2) == period
    assert period_along(layers, 1) is None
    assert period_along(tb.sample("bone").values[:48, :48, :48], 2) is None


def test_a_period_that_is_no_whole_number_is_told_from_its_multiples():
    x = np.arange(80)
    bars = np.tile(((x % 7.25) < 3).astype(np.uint8), (4, 4, 1))
    assert period_along(bars, 2) == pytest.approx(7.25, abs=0.1)


def test_exemplars_out_of_step_are_brought_into_step():
    cells = lattice(np.full((40, 40, 40), 0.4))
    stack = [np.ascontiguousarray(part) for part in (cells[:32, :32, :32], cells[3:35, 5:37, 1:33])]
    periods = common_periods(stack)
    assert periods == (8.0, 8.0, 8.0)
    shifts = cell_shifts(stack, periods)
    for key in (0, 8, 20):  # quarters of a voxel
        cell = []
        for labels, shift in zip(stack, shifts, strict=True):
            begin = [positions_in_phase(24, key, int(by), 8.0)[0] for by in shift]
            cell.append(labels[tuple(slice(first, first + 8) for first in begin)])
        assert np.mean(cell[0] != cell[1]) < 0.02, "but for voxels that lie on the surface"


def test_what_is_near_to_be_made():
    box = np.ones((1, 1, 9), np.uint8)
    box[..., 6:] = EMPTY
    assert near_empty(box, 2)[0, 0].tolist() == [False] * 4 + [True] * 2 + [False] * 3


def test_frames_cover_every_voxel_once_or_more():
    for wraps in ((False,) * 3, (True, False, True)):
        grid = PatchGrid((23, 17, 30), wraps, (8, 8, 8), (5, 5, 5), (0, -3, 0))
        seen = np.zeros(grid.shape, int)
        for number in range(int(np.prod(grid.counts))):
            seen[np.ix_(*grid.indices(grid.corner(number)))] += 1
        assert seen.min() >= 1


@settings(max_examples=12)
@given(st.integers(0, 10**6), st.integers(2, 3))
def test_thin_solid_is_what_an_opening_takes_away(seed, size):
    rng = np.random.default_rng(seed)
    window = (ndimage.gaussian_filter(rng.random((12, 12, 12)), 1) > 0.5).astype(np.uint8)
    solid = np.arange(256) == 1
    # What lies beyond the window may be solid.
    beyond = np.pad(window == 1, size, constant_values=True)
    opened = np.zeros(beyond.shape, bool)
    for at in np.ndindex(tuple(side - size + 1 for side in beyond.shape)):
        cube = tuple(slice(first, first + size) for first in at)
        if beyond[cube].all():
            opened[cube] = True
    opened = opened[size:-size, size:-size, size:-size]
    margin = (2, 2, 2)
    inner = (slice(2, -2),) * 3
    assert thin_voxels(window, margin, size, solid) == np.count_nonzero(
        (window[inner] == 1) & ~opened[inner]
    )


def lay_random(seed, connected, density):
    """Lay a volume box by box from random patches, each only if the check accepts it."""
    rng = np.random.default_rng(seed)
    shape, patch, step = (14, 14, 21), (7, 7, 7), (5, 5, 5)
    canvas = np.full(shape, EMPTY, np.uint8)
    grid = PatchGrid(shape, (False,) * 3, patch, step, (0, 0, 0))
    classes = voxel_classes(connected, 0, 2)
    components = ComponentTracker(canvas, np.zeros(canvas.shape, np.int32), grid.wraps, classes)
    window = tuple(side + 2 * m for side, m in zip(patch, grid.margin, strict=True))
    check = ConnectivityCheck(window, grid.margin, island=0)
    inner = tuple(slice(m, -m) for m in grid.margin)
    for number in range(int(np.prod(grid.counts))):
        corner = grid.corner(number)
        old, numbers = np.empty(window, np.uint8), np.empty(window, np.int32)
        grid.read_window(canvas, corner, old, OUT)
        grid.read_window(components.numbers, corner, numbers, 0)
        for _ in range(60):
            new = old.copy()
            labels = (
                ndimage.gaussian_filter(rng.random(patch), 1.2)
                < np.quantile(rng.random(9), density)
            ).astype(np.uint8)
            keep = (old[inner] >= OUT) if rng.random() < 0.5 else old[inner] == EMPTY
            new[inner] = np.where(
                (old[inner] != OUT) & (keep | (rng.random() < 0.3)), labels, old[inner]
            )
            if check.verdict(components, old, new, numbers) == FINE:
                break
        else:
            return None, components
        check.enter(components, old, new, numbers)
        grid.write_box(canvas, corner, new)
        grid.write_box(components.numbers, corner, numbers)
    return canvas, components


@pytest.mark.whole
@settings(max_examples=40)
@given(st.integers(0, 10**6), st.sampled_from(["solid", "void", "both"]), st.floats(0.3, 0.7))
def test_pieces_that_pass_make_one_body(seed, connected, density):
    canvas, components = lay_random(seed, connected, density)
    if canvas is None:
        return  # no random patch was accepted
    if connected in ("solid", "both"):
        assert ndimage.label(canvas == 1)[1] <= 1
    if connected in ("void", "both"):
        pores, count = ndimage.label(canvas == 0)
        faces = np.concatenate(
            [np.unique(pores.take(end, axis)) for axis in range(3) for end in (0, -1)]
        )
        assert set(range(1, count + 1)) <= set(faces.tolist())
    assert components.alive[0, SOLID] == 0 and components.alive[0, VOID] <= 1


def test_random_patches_do_pass_sometimes():
    """Check that the test above is not empty."""
    assert sum(lay_random(seed, "solid", 0.5)[0] is not None for seed in range(12)) >= 3


def test_a_box_goes_on_at_the_other_end_where_the_axis_wraps():
    for wraps, wanted in ((True, [8, 9, 0, 1]), (False, [8, 9])):
        grid = PatchGrid((1, 1, 10), (False, False, wraps), (1, 1, 4), (1, 1, 3), (0, 0, 0))
        assert grid.indices((0, 0, 8))[2].tolist() == wanted


def loose_blocks():
    """Return a canvas with four blocks along a line: known, made, made, made; the second void
    between them is known.
    """
    canvas = np.zeros((5, 7, 40), np.uint8)
    for first in (1, 12, 21, 33):
        canvas[1:4, 2:5, first : first + 5] = 1
    canvas[:, :, 1:6] += FIXED
    canvas[:, :, 17:21] += FIXED
    return canvas


@pytest.mark.parametrize("wraps", [False, True])
def test_components_are_joined_through_made_void_alone(wraps):
    canvas, classes = loose_blocks(), voxel_classes("solid", 0, 2)
    if wraps:  # the last block continues at the first
        canvas[2, 3, 38:] = canvas[2, 3, 0] = 1
    before = canvas.copy()
    told = join_rest(canvas, classes, (False, False, wraps), void=0, patch=8, brush=3, least=10)
    changed = canvas != before
    assert (before[changed] == 0).all() and (canvas % FIXED)[changed].all()
    assert told["join_voxels"] == np.count_nonzero(changed)
    assert changed[:3, 1:4, 6:12].all()  # nine voxels around the first of the shortest ways
    # known void is a wall between the second and the third, which is near the first's other end
    assert told["joins"] == (2 if wraps else 1) and told["loose"] == (0 if wraps else 2 * 45)
    assert changed[:3, 1:4, 26:33].all() == wraps


def test_small_components_and_far_ones_stay():
    canvas, classes = loose_blocks(), voxel_classes("solid", 0, 2)
    canvas[2, 3, 8] = 1  # an island
    told = join_rest(canvas, classes, (False,) * 3, void=0, patch=5, brush=1, least=10)
    assert told == {"joins": 0, "join_voxels": 0, "loose": 3 * 45}
    nothing = np.zeros_like(canvas)
    told = join_rest(nothing, classes, (False,) * 3, void=0, patch=5, brush=1, least=10)
    assert told == {"joins": 0, "join_voxels": 0, "loose": 0} and not nothing.any()

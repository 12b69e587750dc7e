"""Search and vote on planes: squares, views, and how what is seen in several views becomes one
field.
"""

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.seeds import key
from trabecula.engine.parallel import threads
from trabecula.errors import RequestError
from trabecula.synth.chen.method import choose_pixels
from trabecula.synth.shared.content.fields import UNIT
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.content.kinds import content_of
from trabecula.synth.shared.matching.grid import Grid, coherent_search, random_matches
from trabecula.synth.shared.matching.neighbourhoods import SCALE, project
from trabecula.synth.shared.matching.planes import RegionViews, cast_plane_votes
from trabecula.synth.shared.matching.principal_components import principal_basis
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Candidates, Stack, carry_matches
from trabecula.synth.shared.statistics.sliced import transport_neighbourhoods
from trabecula.synth.shared.statistics.slices import slice_target
from trabecula.synth.shared.statistics.two_point import correlations_of
from trabecula.synth.shared.statistics.two_point_steps import misfit

WIDTH = 6


def picture(seed, shape=(26, 30), channels=1):
    """A smooth random picture, one plane deep."""
    raw = np.random.default_rng(seed).normal(size=(channels, 1, *shape))
    for axis in (2, 3):
        for _ in range(3):
            raw = raw + np.roll(raw, 1, axis) + np.roll(raw, -1, axis)
    return np.clip(raw / raw.std() * 50, -127, 127).astype(np.int8)


def candidates(field, step=2, **settings):
    return Candidates.of(
        Stack.of([field]), width=WIDTH, step=step, variance=1.0, most=64, flat=True, **settings
    )


def corners(candidates, match):
    """The first voxel of candidates, along z, y, x of the stack."""
    return [
        cell * stride
        for cell, stride in zip(
            np.unravel_index(match, candidates.shape), candidates.strides, strict=True
        )
    ]


@pytest.mark.parametrize("grain", [1, 2])
def test_features_of_squares_keep_their_distances(grain):
    field = picture(0)
    basis = principal_basis(field, width=WIDTH, variance=1.0, most=64, grain=grain, flat=True)
    assert basis.box == (1, WIDTH, WIDTH)
    assert len(basis.vectors) == (WIDTH // grain) ** 2
    volume = np.concatenate([picture(seed) for seed in range(1, 4)], axis=1)
    features = project(volume, basis, step=2)
    assert features.shape[:3] == (3, 11, 13)
    a, b = volume[0, 0, 4:10, 6:12].astype(int), volume[0, 2, 8:14, 20:26].astype(int)
    if grain == 2:
        a, b = (block.reshape(3, 2, 3, 2).sum((1, 3)) / 2 for block in (a, b))
    apart = features[0, 2, 3].astype(int) - features[2, 4, 10]
    assert np.sqrt((apart**2).sum()) / SCALE == pytest.approx(
        np.sqrt(((a - b) ** 2).sum()), rel=0.02
    )


def test_the_search_finds_a_picture_in_a_stack_of_its_own_planes():
    """Planes that are the picture itself: every match comes to its own place, and stays there from
    plane to plane.
    """
    field = picture(1)
    volume = np.repeat(field, 5, axis=1)
    grid = Grid.over(Region(volume.shape[1:]), candidates(field))
    match = random_matches(grid, key(0, "s"))
    match, distance = coherent_search(
        grid, match, volume, stage=key(0, "s"), first=1, count=12, tries=8, index_penalty=0.0
    )
    assert not distance.any()
    z, y, x = corners(grid.candidates, match)
    assert not z.any()
    assert np.array_equal(y, np.broadcast_to(np.arange(11)[:, None] * 2, match.shape))
    assert np.array_equal(x, np.broadcast_to(np.arange(13) * 2, match.shape))


def test_matches_move_to_the_next_level_with_their_plane():
    fine, coarse = picture(2), picture(3, (13, 15))
    old, new = candidates(coarse), candidates(fine)
    rng = np.random.default_rng(0)
    match = rng.choice(old.numbers, (4, 3, 4)).astype(np.int32)
    moved = carry_matches(match, old, new, (8, 9, 10), factor=2)
    assert np.array_equal(moved[0], moved[1])
    for before, after in zip(
        np.ravel(match), np.ravel(moved[::2, ::2, ::2][:, :3, :4]), strict=True
    ):
        y, x = (int(c) for c in corners(old, before)[1:])
        assert [int(c) for c in corners(new, after)[1:]] == [min(2 * y, 20), min(2 * x, 24)]


def frame_of(pictures, shape, wraps=(False,) * 3, free=None, step=2):
    views = tuple((axis, candidates(field, step)) for axis, field in pictures)
    histograms = tuple(
        Histogram.pool(channel)
        for channel in zip(*(c.stack.histograms for _, c in views), strict=True)
    )
    return RegionViews.over(Region(shape, wraps, free), views, histograms)


@pytest.mark.parametrize("wraps", [(False,) * 3, (True, False, True)])
@pytest.mark.parametrize("trim", [0, 1])
def test_the_vote_of_several_views_is_the_weighted_mean_of_all_squares(wraps, trim):
    rng = np.random.default_rng(4)
    frame = frame_of([(axis, picture(axis, channels=2)) for axis in range(3)], (11, 14, 12), wraps)
    matches = [random_matches(plane.grid, key(5, str(plane.axis))) for plane in frame.grids]
    weights = [rng.integers(0, 1000, match.shape).astype(np.int32) for match in matches]
    factors = [
        rng.integers(1, frame.full + 1, p.grid.candidates.stack.field.shape[1:])
        for p in frame.grids
    ]
    votes = cast_plane_votes(frame, matches, weights, factors=factors, trim=trim)
    shape = frame.region.shape
    above, below = np.zeros((2, *shape)), np.zeros(shape)
    for plane, match, weight, factor in zip(frame.grids, matches, weights, factors, strict=True):
        exemplar = plane.grid.candidates.stack.field[:, 0].astype(float)
        up, down = np.moveaxis(above, 1 + plane.axis, 1), np.moveaxis(below, plane.axis, 0)
        seen, around = plane.grid.region.shape, plane.grid.region.wraps
        _, ys, xs = corners(plane.grid.candidates, match)
        for z, sy, sx in np.ndindex(match.shape):
            for dy, dx in np.ndindex(WIDTH, WIDTH):
                inner = all(
                    trim <= d < WIDTH - trim
                    or (not wrap and ((s == 0 and d < trim) or (s == n - 1 and d >= WIDTH - trim)))
                    for d, s, n, wrap in (
                        (dy, sy, match.shape[1], around[1]),
                        (dx, sx, match.shape[2], around[2]),
                    )
                )
                if not inner:
                    continue
                y, x = int(ys[z, sy, sx]) + dy, int(xs[z, sy, sx]) + dx
                at = (z, (2 * sy + dy) % seen[1], (2 * sx + dx) % seen[2])
                counts = float(weight[z, sy, sx]) * factor[0, y, x]
                up[(slice(None), *at)] += counts * exemplar[:, y, x]
                down[at] += counts
    assert np.abs(votes - 256 * above / np.maximum(below, 1)).max() <= 1  # one is rounded down


def test_the_chosen_pixel_is_the_nearest_of_all_that_lie_on_a_voxel():
    frame = frame_of([(0, picture(1)), (2, picture(2))], (9, 10, 12))
    matches = [random_matches(plane.grid, key(5, str(plane.axis))) for plane in frame.grids]
    weights = [np.ones(match.shape, np.int32) for match in matches]
    mean = cast_plane_votes(frame, matches, weights)
    even = [np.ones(p.grid.candidates.stack.field.shape[1:], np.int32) for p in frame.grids]
    field, sources = choose_pixels(frame, matches, weights, mean, costs=even)
    pixels = np.concatenate([plane.grid.candidates.stack.field.ravel() for plane in frame.grids])
    assert np.array_equal(pixels[sources], field[0])
    lying = [set() for _ in range(field[0].size)]
    first = 0
    for plane, match in zip(frame.grids, matches, strict=True):
        numbers = np.moveaxis(np.arange(field[0].size).reshape(field[0].shape), plane.axis, 0)
        width = plane.grid.candidates.stack.field.shape[3]
        _, ys, xs = corners(plane.grid.candidates, match)
        for z, sy, sx in np.ndindex(match.shape):
            for dy, dx in np.ndindex(WIDTH, WIDTH):
                pixel = first + (int(ys[z, sy, sx]) + dy) * width + int(xs[z, sy, sx]) + dx
                lying[numbers[z, 2 * sy + dy, 2 * sx + dx]].add(pixel)
        first += plane.grid.candidates.stack.field[0].size
    for voxel, (aim, source) in enumerate(zip(mean.ravel(), sources.ravel(), strict=True)):
        nearest = min(abs(256 * int(pixels[pixel]) - int(aim)) for pixel in lying[voxel])
        assert source in lying[voxel]
        assert abs(256 * int(pixels[source]) - int(aim)) == nearest


def test_a_source_that_is_dear_is_avoided():
    frame = frame_of([(0, picture(1)), (1, picture(2))], (9, 10, 12))
    matches = [random_matches(plane.grid, key(5, str(plane.axis))) for plane in frame.grids]
    weights = [np.ones(match.shape, np.int32) for match in matches]
    mean = cast_plane_votes(frame, matches, weights)
    dear = [np.ones(p.grid.candidates.stack.field.shape[1:], np.int32) for p in frame.grids]
    before = choose_pixels(frame, matches, weights, mean, costs=dear)[1]
    half = frame.grids[0].grid.candidates.stack.field[0].size
    dear[0][:] = 10_000
    after = choose_pixels(frame, matches, weights, mean, costs=dear)[1]
    assert np.mean(before < half) > 0.3
    assert np.mean(after < half) < 0.5 * np.mean(before < half)


def test_a_region_is_seen_with_its_axis_first():
    rng = np.random.default_rng(0)
    free = rng.random((3, 4, 5)) < 0.5
    seen = Region((3, 4, 5), (True, False, True), free).view_along(2)
    assert seen.shape == (5, 3, 4)
    assert seen.wraps == (True, True, False)
    assert np.array_equal(seen.free[4, 1, 2], free[1, 2, 4])


def test_only_squares_that_hold_a_free_voxel_are_active():
    free = np.zeros((8, 12, 12), bool)
    free[3, 5, 6] = True
    frame = frame_of([(axis, picture(0)) for axis in range(3)], free.shape, free=free)
    for plane in frame.grids:
        across = np.flatnonzero(plane.grid.active.any(axis=(1, 2)))
        assert across.tolist() == [(3, 5, 6)[plane.axis]]


def test_sliced_rounds_of_one_view_are_those_of_its_planes():
    """A volume of planes, each moved alone: with one view the round is that of flat neighbourhoods,
    turned with its axis.
    """
    exemplar = picture(7)
    slices = slice_target([exemplar], width=4, flat=True)
    field = (np.random.default_rng(1).integers(-90, 91, (1, 10, 12, 14)) * UNIT).astype(np.int16)
    for axis in range(3):
        turned = np.ascontiguousarray(np.moveaxis(field, 1 + axis, 1))
        alone = transport_neighbourhoods(turned, [(0, slices)], key=key(0, "s"), number=3)
        together = transport_neighbourhoods(field, [(axis, slices)], key=key(0, "s"), number=3)
        assert np.array_equal(np.moveaxis(together, 1 + axis, 1), alone)


def test_sliced_rounds_take_on_the_pictures_distribution_in_every_view():
    exemplar = picture(7, (40, 40))
    slices = slice_target([exemplar], width=4, flat=True)
    field = np.random.default_rng(2).integers(-90, 91, (1, 20, 24, 22)).astype(np.int16) * np.int16(
        UNIT
    )
    for number in range(16):
        field = transport_neighbourhoods(
            field,
            [(axis, slices) for axis in range(3)],
            key=key(0, "s"),
            number=number,
            strength=2.0,
        )
    steps = np.clip(np.rint(field / UNIT), -127, 127).astype(np.int8)
    wanted = np.mean(np.abs(np.diff(exemplar.astype(int), axis=3)))
    for axis in range(3):
        assert np.mean(np.abs(np.diff(steps.astype(int), axis=1 + axis))) == pytest.approx(
            wanted, rel=0.3
        )
    assert steps.std() == pytest.approx(exemplar.std(), rel=0.15)


def test_voxels_that_are_not_free_stay_as_they_are():
    exemplar = slice_target([picture(7)], width=4, flat=True)
    field = (np.random.default_rng(1).integers(-90, 91, (1, 10, 12, 14)) * UNIT).astype(np.int16)
    free = np.ones(field.shape[1:], bool)
    free[4, 3:9, 2:11] = False
    moved = transport_neighbourhoods(
        field, [(0, exemplar), (2, exemplar)], key=key(0, "s"), number=1, free=free
    )
    assert np.array_equal(moved[0, ~free], field[0, ~free])
    assert np.mean(moved[0, free] != field[0, free]) > 0.9


def test_threads_do_not_matter_on_planes():
    exemplar = slice_target([picture(7)], width=4, flat=True)
    field = (np.random.default_rng(1).integers(-90, 91, (1, 16, 12, 14)) * UNIT).astype(np.int16)
    made = []
    for count in (1, 3):
        with threads(count):
            made.append(
                transport_neighbourhoods(
                    field, [(0, exemplar), (2, exemplar)], key=key(0, "s"), number=1
                )
            )
    assert np.array_equal(made[0], made[1])


def test_correlations_of_a_picture_are_those_of_its_plane():
    field = picture(3, (30, 30))
    flat = correlations_of([np.moveaxis(field, 1, 2)], softness=60.0, r_max=6)  # seen across y
    bins = flat.held.reshape(3, -1)
    assert bins[0, 1:].all()
    assert bins[2, 1:].all()
    assert not bins[1].any()
    volume = np.repeat(np.moveaxis(field, 1, 2), 9, axis=2)  # the same picture in every plane
    found = misfit(volume, flat)[0].reshape(3, -1)
    assert np.abs(found[1]).max() == 0
    along = correlations_of([volume], softness=60.0, r_max=6)
    assert not np.allclose(along.curves.reshape(3, -1)[1], 0)


def test_a_target_porosity_makes_fields_lean_and_is_met_to_the_voxel():
    rng = np.random.default_rng(0)
    image = tb.Image((rng.random((30, 30)) < 0.6).astype(np.uint8), "labels")
    content = content_of([image] * 3)
    request = tb.Request(12, target={"porosity": 0.3})
    field = np.clip(content.fields(image) * 30, -127, 127).astype(np.int8)
    (leaning,) = content.target_histograms([Histogram.of(field)], request)
    counts = np.diff(leaning.up_to, prepend=0)
    assert counts[leaning.values < 0].sum() / counts.sum() == pytest.approx(0.3, abs=0.01)
    votes = rng.integers(-9000, 9000, (1, 12, 12, 12)).astype(np.int16)
    made = content.to_values(votes, request)
    assert np.count_nonzero(made == 0) == round(0.3 * made.size)
    with pytest.raises(RequestError, match="field"):
        content.to_values(votes, tb.Request(12, target={"porosity": np.full((12, 12, 12), 0.3)}))


def test_pooled_histograms_count_alike():
    few, many = Histogram.of(np.array([1, 1, 2])), Histogram.of(np.repeat([2, 5], 3000))
    pooled = Histogram.pool([few, many])
    shares = np.diff(pooled.up_to, prepend=0) / pooled.up_to[-1]
    assert pooled.values.tolist() == [1, 2, 5]
    assert np.allclose(shares, [1 / 3, 1 / 6 + 1 / 4, 1 / 4], atol=1e-5)

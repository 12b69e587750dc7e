"""What every kind of noise promises, in a loop over them; and each against an oracle or a known
truth.
"""

import tracemalloc

import numpy as np
import pytest
from scipy.spatial import cKDTree

import trabecula as tb
from trabecula.core.recipe import digest
from trabecula.core.seeds import key
from trabecula.errors import InputError, RequestError, UnknownNameError
from trabecula.measure.correlation import two_point
from trabecula.synth.noise import pattern
from trabecula.synth.noise.config import COVARIANCES, KINDS, WALLED, NoiseConfig
from trabecula.synth.noise.covariance import _NAMED
from trabecula.synth.noise.lattice import CELL, VoxelGrid, grid_of, points_of
from trabecula.synth.shared.gaussian.domain import Domain

SHAPE = (34, 30, 37)
LATTICES = sorted(pattern.PATTERNS)


def noise(kind, *, spacing=1.0, **settings):
    """Return a model without an exemplar, its cells six voxels wide."""
    length = {} if kind == "white" else {"length": 6 * spacing}
    return tb.method("noise", **{"kind": kind, **length, **settings}).fit(
        spacing=spacing, unit="um"
    )


def field(kind, shape, *, edge=8.0, spacing=1.0, seed=3, **settings):
    """Return the numbers of a volume or a picture before the cut."""
    flat = len(shape) == 2
    config = NoiseConfig(kind=kind, **settings)
    lattice = pattern.LatticePattern(config, (edge,) * 3, (spacing,) * 3, flat=flat)
    lifted = (1,) * (3 - len(shape)) + tuple(shape)
    found = np.empty(lifted, np.int32)

    def keep(piece, z, plane):
        found[piece][z] = plane

    lattice.each(
        0, Domain(lifted, (False,) * 3, seed, flat), tuple((0, side) for side in lifted), keep
    )
    return found


def test_the_kinds_are_those_of_the_table():
    assert set(KINDS) == {"gaussian", *pattern.PATTERNS}
    assert set(COVARIANCES) == {"auto", *_NAMED}


@pytest.mark.parametrize("kind", KINDS)
def test_any_window_is_a_part_of_the_whole(kind):
    model = noise(kind)
    whole = model.generate(SHAPE, seed=5)
    assert (whole.kind, whole.unit, whole.phases) == ("labels", "um", ("void", "solid"))
    for box in [
        ((0, 10), (5, 30), (3, 4)),
        ((33, 34), (29, 30), (36, 37)),
        ((7, 34), (0, 30), (11, 37)),
    ]:
        assert np.array_equal(
            model.window(SHAPE, box, seed=5), whole.values[tuple(slice(*ends) for ends in box)]
        )
    first, second = (
        model.window(SHAPE, [(a, a + 20), (-9, 4), (60, 80)], seed=5) for a in (-30, -17)
    )
    assert np.array_equal(first[13:], second[:7])
    assert not np.array_equal(model.generate(SHAPE, seed=6).values, whole.values)


@pytest.mark.parametrize("kind", KINDS)
def test_a_repeating_window_goes_round(kind):
    model = noise(kind)
    shape, wraps = (20, 15, 16), (True, False, True)
    whole = model.generate(shape, seed=5, periodic=wraps).values
    box = ((-20, 40), (0, 15), (-5, 27))
    round_ = model.window(shape, box, seed=5, periodic=wraps)
    assert np.array_equal(round_, np.roll(np.tile(whole, (3, 1, 2)), 5, axis=2))


@pytest.mark.parametrize("kind", KINDS)
def test_pictures_have_windows_and_repeat(kind):
    model = noise(kind)
    whole = model.generate((40, 33), seed=2, periodic=True)
    assert whole.shape == (40, 33) and whole.spacing == (1.0, 1.0)
    assert 0.2 < whole.values.mean() < 0.8
    part = model.window((40, 33), [(-10, 50), (5, 12)], seed=2, periodic=True)
    assert np.array_equal(part, np.roll(np.tile(whole.values, (2, 1)), 10, axis=0)[:60, 5:12])


@pytest.mark.whole
@pytest.mark.parametrize("kind", KINDS)
def test_neither_bricks_nor_threads_matter(kind, monkeypatch):
    model = noise(kind)
    whole = model.generate(SHAPE, seed=1).values
    with tb.threads(3):
        assert np.array_equal(model.generate(SHAPE, seed=1).values, whole)
    level = model._field(False).level(0, 0.5)
    monkeypatch.setattr(pattern, "_BRICK", (5, 7, 11))
    monkeypatch.setattr("trabecula.synth.shared.gaussian.field.PIECE", 13)
    pattern.trial_level.cache_clear()
    again = noise(kind)
    assert again._field(False).level(0, 0.5) == level
    assert np.array_equal(again.generate(SHAPE, seed=1).values, whole)


GOLDEN = {
    "gaussian": "b24851b4f91ed30b",
    "perlin": "82f236cfd896b2f3",
    "voronoi": "382cdf2660a74fee",
    "voronoi_cells": "4f2aa9076928abd3",
    "voronoi_edges": "02739c32edec2ccd",
    "white": "c4dfbe8b18d52b74",
    "worley": "c87386bc52e19894",
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_machine_makes_these_voxels(kind):
    """Compare with frozen voxels: the arithmetic has to be the same everywhere."""
    assert (
        digest(noise(kind, porosity=0.6).generate((20, 22, 24), seed=7).values)[:16] == GOLDEN[kind]
    )


@pytest.mark.parametrize("kind", KINDS)
def test_the_porosity_is_exact_where_it_is_asked_for(kind):
    exact = noise(kind, porosity=0.37, exact=True)
    volume = exact.generate((20, 22, 24), seed=1).values
    assert np.count_nonzero(volume == 0) == round(0.37 * volume.size)
    mask = np.zeros((20, 22, 24), bool)
    mask[3:17, 4:20, :13] = True
    inside = exact.generate(None, mask=mask, seed=1).values
    assert (
        np.count_nonzero(inside[mask] == 0) == round(0.37 * mask.sum()) and not inside[~mask].any()
    )
    with pytest.raises(RequestError, match="leave exact out"):
        exact.window(20, [(0, 4)] * 3)


@pytest.mark.whole
@pytest.mark.parametrize("porosity", [0.15, 0.6, 0.92])
@pytest.mark.parametrize("kind", LATTICES)
def test_the_level_of_windows_has_the_porosity_in_the_mean(kind, porosity):
    """Cells of three voxels, so that a window of 60^3 holds 8000 of them; four windows."""
    settings = {} if kind == "white" else {"length": 3.3}
    model = tb.method("noise", kind=kind, porosity=porosity, **settings).fit()
    made = [
        1 - model.window(60, [(200 * i, 200 * i + 60), (0, 60), (0, 60)], seed=1).mean()
        for i in range(4)
    ]
    assert np.mean(made) == pytest.approx(porosity, abs=0.006)


@pytest.mark.parametrize("kind", WALLED)
def test_walls_of_a_regular_lattice_are_as_thick_as_was_asked_for(kind):
    """Known truth: cubes of 8 with walls of 2 leave (6/8)^3; of their edges, where two walls cross,
    the rest is void.
    """
    model = noise(kind, spacing=0.5, length=4.0, thickness=1.0, jitter=0)
    porosity = 1 - model.generate(32, seed=0).values.mean()
    assert porosity == (
        (6 / 8) ** 3 if kind == "voronoi" else 1 - 3 * (2 / 8) ** 2 * (6 / 8) - (2 / 8) ** 3
    )


def test_walls_of_stretched_cells_are_as_thick_along_every_axis():
    made = noise("voronoi", spacing=0.5, length=(4.0, 8.0, 16.0), thickness=1.0, jitter=0).generate(
        64, seed=0
    )
    assert 1 - made.values.mean() == (6 / 8) * (14 / 16) * (30 / 32)


def cells_of(grid, *, seed, margin, jitter=1.0):
    axes = grid.axes()
    points = points_of(axes, key(seed, "noise/points"), jitter=jitter, margin=margin)
    places = np.stack(np.meshgrid(*(axis.at for axis in axes), indexing="ij"), -1)
    return points, places.reshape(-1, 3)


def small_grid(shape, edge=8.0) -> VoxelGrid:
    domain = Domain(shape, (False,) * 3, 3, shape[0] == 1)
    return grid_of(domain, [(0, side) for side in shape], (1 / edge,) * 3, (edge,) * 3)


def test_worley_is_the_distance_to_the_nearest_point():
    """Compare with SciPy's tree of the same points."""
    points, places = cells_of(small_grid((24, 20, 28)), seed=3, margin=3)
    distance, _ = cKDTree(points.place).query(places)
    assert np.array_equal(field("worley", (24, 20, 28)).ravel(), np.rint(distance**2))


@pytest.mark.whole
@pytest.mark.parametrize("shape", [(18, 15, 20), (40, 44)])
def test_walls_are_planes_half_way_between_points(shape):
    """Compare with the planes between a voxel's nearest point and all others, one by one."""
    lifted = (1,) * (3 - len(shape)) + shape
    points, places = cells_of(small_grid(lifted), seed=3, margin=4)
    squares = ((places[:, None] - points.place) ** 2).sum(-1)
    own = squares.argmin(1)
    between = np.linalg.norm(points.place[own][:, None] - points.place, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        planes = (squares - squares.min(1)[:, None]) / (2 * between)
    planes[np.arange(len(own)), own] = np.inf
    nearest = np.sort(planes, axis=1)[:, :2]
    for rank, kind in enumerate(WALLED):
        made = field(kind, shape).ravel() / 1024
        assert np.abs(made - nearest[:, rank]).max() < 0.01, kind


def test_cells_are_whole_and_their_numbers_even():
    made = field("voronoi_cells", (24, 20, 28))
    points, places = cells_of(small_grid((24, 20, 28)), seed=3, margin=3)
    _, own = cKDTree(points.place).query(places)
    assert np.array_equal(made.ravel(), points.word[own])
    many = (
        points_of(
            small_grid((80, 80, 80), 4.0).axes(), key(1, "noise/points"), jitter=1.0, margin=0
        ).word
        / 2**24
    )
    assert abs(many.mean() - 0.5) < 0.01 and abs((many < 0.2).mean() - 0.2) < 0.015


def test_points_lie_in_their_cells_and_fill_them_evenly():
    points = points_of(
        small_grid((80, 80, 80), 4.0).axes(), key(1, "noise/points"), jitter=1.0, margin=0
    )
    cells = np.stack(np.meshgrid(*(np.arange(20),) * 3, indexing="ij"), -1).reshape(-1, 3)
    inside = points.place - cells * CELL
    assert inside.min() >= 0 and inside.max() < CELL
    assert (
        np.abs(inside.mean(0) / CELL - 0.5).max() < 0.01
        and np.abs(inside.std(0) / CELL - 12**-0.5).max() < 0.01
    )
    half = points_of(
        small_grid((80, 80, 80), 4.0).axes(), key(1, "noise/points"), jitter=0.5, margin=0
    )
    assert np.abs((half.place - cells * CELL) / CELL - 0.5).max() <= 0.25


def test_perlin_is_zero_at_corners_and_follows_its_slopes_near_them():
    """Voxels of a hundredth of a cell: beside a corner the noise is the slope there times the way;
    half an octave adds.
    """
    fine = field("perlin", (201, 3, 3), edge=100.0).astype(float) / (1 << 16)
    slope = np.diff(fine, axis=0) * 100
    assert np.abs(slope).max() < 4, "no jumps from cell to cell"
    many = field("perlin", (60, 60, 60), edge=4.0) / (1 << 16)
    assert abs(many.mean()) < 0.01 and 0.15 < many.std() < 0.35 and np.abs(many).max() < 1
    corner = field("perlin", (2, 2, 2), edge=2048.0) / (1 << 16)
    assert np.abs(corner).max() < 0.002
    two = field("perlin", (20, 20, 20), octaves=2, persistence=0.25)
    flat = field("perlin", (20, 20, 20), octaves=2, persistence=0)
    assert np.array_equal(flat, field("perlin", (20, 20, 20)))
    assert 0.1 < (two - flat).std() / flat.std() < 0.4


@pytest.mark.parametrize("kind", LATTICES)
def test_a_finer_grid_shows_the_same_material(kind):
    """Three voxels to one: the middle one of three lies where the coarse one does."""
    if kind == "white":
        pytest.skip("every voxel of white noise is on its own")
    coarse = field(kind, (10, 12, 9), edge=24.0, spacing=3.0)
    fine = field(kind, (30, 36, 27), edge=24.0)
    assert np.array_equal(fine[1::3, 1::3, 1::3], coarse)


@pytest.mark.parametrize("name", sorted(_NAMED))
def test_a_named_covariance_is_that_of_the_field(name):
    """Known truth: at one half and half S2 = 1/4 + arcsin(rho) / (2 pi)."""
    model = tb.method(
        "noise", covariance=name, length=4 if name != "wave" else 10, exact=True
    ).fit()
    made = model.generate(100, seed=1)
    r = np.arange(13)
    rho = _NAMED[name][0](r / model.config.length)
    wanted = 0.25 + np.arcsin(np.minimum(rho, 1)) / (2 * np.pi)
    along = np.mean([two_point(made, r_max=12, axis=axis) for axis in range(3)], axis=0)
    assert np.abs(along - wanted).max() < 0.012


def test_lengths_may_differ_between_axes():
    made = tb.method("noise", length=(3, 6, 12), exact=True).fit().generate((60, 80, 120), seed=1)
    near = [two_point(made, r_max=6, axis=axis)[6] for axis in range(3)]
    wanted = [0.25 + np.arcsin(np.exp(-((6 / length) ** 2))) / (2 * np.pi) for length in (3, 6, 12)]
    assert np.abs(np.subtract(near, wanted)).max() < 0.02


def test_white_noise_is_independent_and_its_grains_are_cubes():
    values = noise("white", porosity=0.3).generate(60, seed=1).values
    for axis in range(3):
        assert two_point(values, r_max=3, axis=axis)[1:] == pytest.approx(0.49, abs=0.01)
    grains = noise("white", length=3.0).generate(30, seed=1).values
    assert np.array_equal(grains, np.kron(grains[::3, ::3, ::3], np.ones((3, 3, 3), np.uint8)))


def test_inverted_noise_has_the_porosity_and_the_other_shape():
    balls = noise("worley", porosity=0.7, length=8.0).generate(48, seed=1).values
    pores = noise("worley", porosity=0.3, length=8.0, invert=True).generate(48, seed=1).values
    assert np.mean(pores != balls) > 0.99, "what was solid is void"


@pytest.mark.whole
@pytest.mark.parametrize("kind", KINDS)
def test_the_forecast_of_memory_holds(kind):
    """With one thread: what several hold at the same moment is up to chance, and the forecast
    counts all of it.
    """
    request = tb.Request((70, 66, 90), seed=1)
    with tb.threads(1):
        model = noise(kind)
        model.generate(16, seed=0)
        plan = model.plan(request)
        again = noise(kind)
        pattern.trial_level.cache_clear()  # its level is still to be found
        tracemalloc.start()
        again.generate(request)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert (
        peak
        <= plan.peak - plan.memory["interpreter and kernels"] - plan.memory["exemplar"]
        <= 3 * peak
    )


def test_an_exemplar_tells_porosity_and_phases():
    rng = np.random.default_rng(0)
    values = (rng.random((24, 24, 24)) < 0.8).astype(np.uint8)
    exemplar = tb.Image(1 - values, "labels", 2.0, "um", ("rock", "void"))
    made = (
        tb.method("noise", kind="worley", length=12, exact=True).fit(exemplar).generate(30, seed=1)
    )
    assert made.spacing == (2.0,) * 3 and made.phases == ("rock", "void")
    assert np.mean(made.values == 1) == pytest.approx(1 - values.mean(), abs=1e-4)
    other = tb.method("noise", porosity=0.6, reach=6, exact=True).fit(exemplar).generate(30, seed=1)
    assert np.mean(other.values == 1) == pytest.approx(0.6, abs=1e-4)


def test_a_picture_teaches_pictures():
    picture = (np.random.default_rng(0).random((64, 64)) < 0.4).astype(np.uint8)
    model = tb.method("noise", reach=8).fit(picture)
    made = model.generate((70, 80), seed=1)
    assert made.shape == (70, 80) and made.values.mean() == pytest.approx(0.4, abs=0.03)
    assert np.array_equal(model.window((70, 80), [(5, 9), (70, 80)], seed=1), made.values[5:9, 70:])
    isotropic = tb.method("noise", reach=8, isotropic=True).fit(picture).generate((70, 80), seed=1)
    assert isotropic.values.mean() == pytest.approx(0.4, abs=0.03)


def test_a_model_without_exemplar_is_saved_and_its_results_are_made_again(tmp_path):
    model = noise("perlin", spacing=0.25, octaves=2)
    made = model.generate((9, 12, 10), seed=4)
    again = tb.load_model(model.save(tmp_path / "one.model"))
    assert np.array_equal(again.generate((9, 12, 10), seed=4).values, made.values)
    tb.write(made, tmp_path / "made.npy")
    assert np.array_equal(tb.rerun(tmp_path / "made.npy").values, made.values)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"porosity": 0}, "one phase alone"),
        ({"porosity": 1.0}, "one phase alone"),
        ({"porosity": 1.2}, "outside 0 .. 1"),
        ({"length": 0}, "above 0"),
        ({"length": (3, 4, 5, 6)}, "4 numbers"),
        ({"length": "ten"}, "should be a number"),
        ({"kind": "perlin", "thickness": 1}, "leave it out of kind='perlin'"),
        ({"kind": "voronoi", "thickness": 1, "porosity": 0.5}, "give one of them"),
        ({"kind": "voronoi", "thickness": 1, "exact": True}, "give one of them"),
        ({"kind": "voronoi", "thickness": -1}, "thickness"),
        ({"invert": True}, "same either way"),
        ({"kind": "white", "covariance": "wave"}, "Gaussian field"),
        ({"kind": "worley", "jitter": 2}, "jitter"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings, words):
    with pytest.raises(InputError, match=words):
        NoiseConfig(**settings)


def test_names_are_suggested():
    with pytest.raises(UnknownNameError, match="did you mean 'voronoi'"):
        NoiseConfig(kind="voronio")
    with pytest.raises(UnknownNameError, match="did you mean 'exponential'"):
        NoiseConfig(covariance="exponental")


@pytest.mark.parametrize(
    ("settings", "spacing", "words"),
    [
        (
            {"kind": "worley", "length": 1.9},
            1.0,
            r"1.9 um is 1.9 voxels, worley noise needs 2 at least",
        ),
        ({"kind": "voronoi", "length": (9, 1, 9)}, 1.0, "needs 2 at least"),
        ({"kind": "perlin", "length": 12, "octaves": 4}, 1.0, "in its last octave"),
        ({"kind": "white", "length": 1}, 2.0, "0.5 voxels"),
        ({"covariance": "exponential", "length": 60}, 1.0, "larger voxels"),
    ],
)
def test_lengths_that_do_not_fit_the_voxels_are_refused(settings, spacing, words):
    with pytest.raises(InputError, match=words):
        tb.method("noise", **settings).fit(spacing=spacing, unit="um")


def test_what_an_exemplar_contradicts_is_refused():
    rng = np.random.default_rng(0)
    three = rng.integers(0, 3, (16, 16, 16))
    for settings in ({"kind": "worley"}, {"porosity": 0.3}):
        with pytest.raises(InputError, match="3 phases"):
            tb.method("noise", **settings).fit(three)
    with pytest.raises(InputError, match="length has no say"):
        tb.method("noise", length=8).fit(rng.integers(0, 2, (16, 16, 16)))
    with pytest.raises(InputError, match="two numbers"):
        tb.method("noise", kind="worley", length=(4, 5)).fit().generate(20, seed=1)

"""A picture and a relative in space: scale, fraction, refusals, targets, the whole method."""

from dataclasses import replace

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError, RequestError
from trabecula.exemplar.views import is_seen_alike, views_of
from trabecula.measure.smooth import gaussian
from trabecula.synth.kopf.relative import SliceStatistics, adapt_relative
from trabecula.synth.kopf.relative_model import _move_target
from trabecula.synth.shared.patterns.planes import PlanePatterns, count_squares
from trabecula.synth.shared.statistics.pairs import DIAGONAL, LINES
from trabecula.synth.shared.statistics.two_point import Correlations

QUICK = {"first_rounds": 2, "rounds": (2,)}


def material(shape, sigma, seed, share=0.3):
    """Return a Gaussian field cut so that `share` of it is solid."""
    smooth = gaussian(np.random.default_rng(seed).normal(size=shape), sigma)
    return tb.Image((smooth > np.quantile(smooth, 1 - share)).astype(np.uint8), "labels")


def balls(shape, radius, count, seed):
    """Return balls that do not touch, placed by chance one after another."""
    rng = np.random.default_rng(seed)
    grid = np.moveaxis(np.indices(shape), 0, -1)
    inside, middles = np.zeros(shape, bool), np.zeros((0, 3))
    for middle in rng.uniform(0, shape, (count, 3)):
        if (((middles - middle) ** 2).sum(axis=1) > (2 * radius + 1.5) ** 2).all():
            middles = np.concatenate([middles, middle[None]])
            inside |= ((grid - middle) ** 2).sum(axis=-1) < radius**2
    return tb.Image(inside.astype(np.uint8), "labels")


@pytest.fixture(scope="module")
def views():
    return views_of([tb.Image(material((3, 96, 96), 2.0, 0).values[1], "labels")], ())


def test_a_relative_gets_the_scale_and_the_fraction_of_the_picture(views):
    assert is_seen_alike(views)
    found = adapt_relative(material((80, 80, 80), 4.0, 1, share=0.4), views, (0, 1))
    np.testing.assert_allclose(found.report["scale"], 0.5, rtol=0.15)
    assert found.image.shape == tuple(round(80 * scale) for scale in found.report["scale"])
    fraction = views[0].image.values.mean()
    assert found.image.values.mean() == pytest.approx(fraction, abs=2e-3)
    assert found.own.lengths[0] == pytest.approx(found.picture.lengths[0], rel=0.1)
    assert found.report["two_point_distance"] < 0.2
    assert found.report["interface_ratio"] == pytest.approx(1, abs=0.15)


def test_pictures_of_several_planes_scale_every_axis_alone():
    """Rows half as long as columns in the pictures: only the axis z of the relative is halved."""
    isotropic = material((48, 96, 96), 2.5, 2).values
    flat = [
        tb.Image(np.ascontiguousarray(isotropic[7]), "labels"),
        tb.Image(
            np.ascontiguousarray(material((48, 9, 96), (1.25, 2.5, 2.5), 3).values[:, 4]), "labels"
        ),
        tb.Image(
            np.ascontiguousarray(material((48, 96, 9), (1.25, 2.5, 2.5), 4).values[:, :, 4]),
            "labels",
        ),
    ]
    found = adapt_relative(tb.Image(isotropic, "labels"), views_of(flat, ()), (0, 1))
    z, y, x = found.report["scale"]
    assert z < 0.7 and abs(y - 1) < 0.3 and abs(x - 1) < 0.3


@pytest.mark.parametrize(
    ("relative", "statistic"),
    [
        (material((40, 40, 40), 2.0, 1, share=0.8), "volume fraction of solid is 0.800"),
        (material((40, 40, 40), 0.0, 1), "correlation length along z"),
        (material((64, 64, 64), (0.6, 5.0, 5.0), 1), "two-point function of the relative along"),
        (material((18, 18, 18), 2.0, 1), "at least 24 voxels"),
        (tb.Image(np.zeros((40, 40, 40), np.uint8), "labels"), "volume fraction"),
        (tb.Image(np.zeros((40, 40, 40), np.uint8), "labels", phases=("air", "rock")), "phases"),
    ],
)
def test_a_relative_that_contradicts_the_picture_is_refused_by_the_statistic(
    views, relative, statistic
):
    with pytest.raises(RequestError, match=statistic):
        adapt_relative(relative, views, (0, 1))


def test_three_phases_and_other_parts_are_refused(views):
    relative = material((40, 40, 40), 2.0, 1)
    with pytest.raises(RequestError, match="3 phases, a relative is for two"):
        adapt_relative(relative, views, (0, 1, 2))
    known = np.ones((40, 40, 40), bool)
    known[0] = False
    with pytest.raises(RequestError, match="like beside fixed"):
        tb.Request(40, like=relative, fixed=relative, known=known)
    with pytest.raises(InputError, match="plain ndarray"):
        tb.Request(40, like=relative.values)
    with pytest.raises(InputError, match="3-D scan of labels"):
        tb.Request(40, like=views[0].image)


@pytest.mark.whole
def test_a_relative_goes_with_a_porosity(views):
    found = adapt_relative(material((80, 80, 80), 4.0, 1, share=0.4), views, (0, 1))
    moved = found.at_fraction(0.2, (0, 1))
    assert moved.image.values.mean() == pytest.approx(0.2, abs=2e-3)
    assert (moved.image.values <= found.image.values).all() and moved.own is found.own
    assert moved.report["fraction"]["asked"] == 0.2
    with pytest.raises(RequestError, match=r"0\.700 is asked for solid, and the picture has"):
        found.at_fraction(0.7, (0, 1))
    model = tb.method("kopf").fit(views[0].image)
    like = material((80, 80, 80), 4.0, 1, share=0.4)
    made = model.generate(40, seed=1, like=like, target={"porosity": 0.75})
    assert tb.measure.porosity(made) == pytest.approx(0.75, abs=1e-4)
    again = model.generate(40, seed=1, like=like)
    assert tb.measure.porosity(again) == pytest.approx(1 - views[0].image.values.mean(), abs=1e-4)


def test_the_target_moves_by_what_the_picture_differs_by():
    """By direction: along an axis its own change, between axes their mean; none beyond reach, and
    little of it near 0.
    """
    change = np.arange(9) * np.array([[0.001], [0.002], [0.004]])
    decay = 0.25**2 + 0.1875 * np.exp(-np.arange(9) / 4)  # a correlation length of 4 voxels
    own = SliceStatistics(0.25, np.tile(decay, (3, 1)), 0.1)
    picture = replace(own, two_point=own.two_point + change)
    near = np.minimum(1, 2 * np.arange(7) / np.mean(picture.lengths))
    curves = np.full((1, DIAGONAL * 7), 0.2)
    target = Correlations(
        curves, 60.0, (1.0,) * 3, np.ones(DIAGONAL * 7, bool), directions=DIAGONAL
    )
    moved = (_move_target(target, 1, own, picture).curves - curves).reshape(DIAGONAL, 7)
    steps = 2 * np.arange(7)  # voxels of the second level
    for way, line in zip(LINES, moved, strict=True):
        slope = np.mean([s for s, step in zip((0.001, 0.002, 0.004), way, strict=True) if step])
        np.testing.assert_allclose(line, near * np.where(steps < 8, slope * steps, 0), atol=1e-12)
    same = _move_target(target, 0, own, own).curves
    np.testing.assert_array_equal(same, curves)


@pytest.mark.whole
def test_what_is_apart_in_the_relative_is_apart_in_the_result():
    """Discs in the picture: the relative says that they are balls, and not rods."""
    relative = balls((48, 48, 48), 4.0, 700, 0)
    picture = tb.Image(np.ascontiguousarray(balls((18, 84, 84), 4.0, 600, 1).values[9]), "labels")
    model = tb.method("kopf", **QUICK).fit(picture)
    made = model.generate(40, seed=1, like=relative)
    assert made.values.sum() == round(picture.values.mean() * 40**3)
    assert tb.measure.largest_fraction(made) < 0.25
    report = made.recipe.steps[-1]["report"]["like"]
    assert report["fraction"]["picture"] == pytest.approx(picture.values.mean())


@pytest.mark.whole
@pytest.mark.parametrize("masked", [False, True])
def test_patterns_come_nearer_to_the_relatives(masked):
    """To the densities that the model aims at, and nothing outside a mask is touched."""
    rng = np.random.default_rng(4)
    blobs = material((64, 64, 64), 3.0, 3)
    rough = np.where(
        gaussian(rng.normal(size=(64,) * 3), 0.7) > 0.25, 1 - blobs.values, blobs.values
    )
    relative = tb.Image(rough.astype(np.uint8), "labels")
    picture = tb.Image(np.ascontiguousarray(relative.values[5]), "labels")
    model = tb.method("kopf", process="none").fit(picture)
    mask = np.zeros((48,) * 3, bool)
    mask[:, 4:40, :30] = True
    request = {"mask": mask} if masked else {}
    made = model.generate(48, seed=1, like=relative, **request)
    report = made.recipe.steps[-1]["report"]["like"]["patterns"]
    assert report["changed"] > 100
    assert report["off_after"] < 0.75 * report["off_before"]
    if masked:
        assert not made.values[~mask].any()


@pytest.mark.whole
@pytest.mark.parametrize("process", ["none", "gaussian"])
def test_planes_beside_a_relative_are_the_pictures(process):
    """Beside a smooth volume the interfaces of a rough picture are rough."""
    rng = np.random.default_rng(4)
    flat = material((3, 96, 96), 2.5, 0).values[1]
    rough = np.where(gaussian(rng.normal(size=flat.shape), 0.7) > 0.65, 1 - flat, flat)
    picture = tb.Image(rough.astype(np.uint8), "labels")
    like = None if process != "none" else material((64, 64, 64), 2.5, 3)
    given = {} if like is None else {"like": like}
    aim = PlanePatterns.of(views_of([picture], ()), (0, 1))
    off = []
    for rounds in (0, 2):
        model = tb.method("kopf", process=process, interface_rounds=rounds).fit(picture)
        made = model.generate(40, seed=1, **given)
        found = [count_squares(plane, 2, 1) for plane in made.values]
        off.append(np.abs(np.mean(found, axis=0) - aim.squares[0][0]).sum())
    assert off[1] < 0.6 * off[0]

"""What pictures show of patterns: counts by hand, the nearest densities that show it, results whose
planes have them.
"""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import trabecula as tb
from trabecula.exemplar.views import views_of
from trabecula.measure.smooth import gaussian
from trabecula.synth.chen.config import ChenConfig
from trabecula.synth.kopf.config import KopfConfig
from trabecula.synth.shared.patterns.counts import Patterns
from trabecula.synth.shared.patterns.densities import PatternDensities
from trabecula.synth.shared.patterns.kernels import STRIDES
from trabecula.synth.shared.patterns.planes import (
    PlanePatterns,
    are_told,
    count_squares,
    with_faces,
)
from trabecula.synth.sliced.config import SlicedConfig

QUICK = {"first_rounds": 4, "rounds": (2, 2)}
SHORT = {"kopf": QUICK, "chen": QUICK, "sliced": {"layout_rounds": 8, "rounds": (2, 2)}}


def blobs(shape, sigma, seed, levels=(0.0,)):
    """Return phases of a smooth field that is cut at levels."""
    field = gaussian(np.random.default_rng(seed).normal(size=shape), sigma)
    return np.digitize(field / field.std(), levels).astype(np.uint8)


def picture(phases, names=()):
    return tb.Image(np.ascontiguousarray(phases), "labels", phases=names)


def faces_of(cubes):
    """Return the faces of densities by corner, first and second across every axis."""
    corners = np.arange(8).reshape(2, 2, 2)
    found = []
    for axis, end in product(range(3), range(2)):
        kept = corners.take(end, axis).ravel()
        found.append(cubes.sum(axis=tuple(n for n in range(8) if n not in kept)))
    return found


def cubes_of(patterns, number=0):
    """Return the densities of the cubes of a stride, by corner, counted with loops' order."""
    bins = patterns.bins
    first = bins.cubes + number * bins.combinations
    return patterns.own[first : first + bins.combinations].reshape((bins.phases,) * 8).transpose()


@pytest.mark.parametrize("stride", STRIDES)
def test_squares_are_counted_row_by_row(stride):
    plane = blobs((11, 14), 1.0, 0, (-0.5, 0.5))
    expected = np.zeros((3,) * 4)
    for y, x in product(range(11 - stride), range(14 - stride)):
        below, right = y + stride, x + stride
        expected[plane[y, x], plane[y, right], plane[below, x], plane[below, right]] += 1
    np.testing.assert_allclose(count_squares(plane, 3, stride), expected / expected.sum())


def test_faces_of_a_volumes_cubes_are_the_squares_of_its_planes():
    """The order of corners is one for cubes and squares."""
    volume = blobs((40, 40, 40), 1.5, 1)
    volume[:, ::5] = 0  # no axis is like another
    densities = PatternDensities.of([volume], 2)
    for number, stride in enumerate(STRIDES):
        faces = faces_of(cubes_of(densities, number))
        for axis in range(3):
            planes = np.moveaxis(volume, axis, 0)[: 40 - stride]
            squares = np.mean([count_squares(p, 2, stride) for p in planes], axis=0)
            np.testing.assert_allclose(faces[2 * axis], squares, atol=1e-12)


def mirrored(seed):
    """Return densities of cubes that mirrors leave as they are: faces at both ends are alike."""
    cubes = np.random.default_rng(seed).random((2,) * 8) + 0.1
    corners = np.arange(8).reshape(2, 2, 2)
    for axis in range(3):
        cubes = cubes + cubes.transpose(np.flip(corners, axis).ravel())
    return cubes / cubes.sum()


def test_the_nearest_cubes_have_the_faces_and_the_means():
    rng = np.random.default_rng(2)
    given = rng.random((2,) * 8) ** 3
    given /= given.sum()
    faces = faces_of(mirrored(3))[::2]
    kept = rng.integers(-4, 4, (2, *given.shape))
    found = with_faces(given, faces, kept)
    for number, face in enumerate(faces_of(found)):
        np.testing.assert_allclose(face, faces[number // 2], atol=1e-6)
    for share in kept:
        assert (share * found).sum() == pytest.approx((share * given).sum(), abs=1e-5)


def test_a_face_that_no_picture_shows_is_free():
    given, asked = mirrored(5), mirrored(6)
    found = with_faces(given, [None, faces_of(asked)[2], None], np.zeros((0, *given.shape), int))
    for number, face in enumerate(faces_of(found)):
        met = np.abs(face - faces_of(asked)[number]).max() < 1e-9
        assert met == (number in (2, 3))


def test_no_other_cubes_with_these_faces_are_nearer():
    """In relative entropy: moved in a direction that changes no face, it rises."""
    given = mirrored(4) ** 2
    given /= given.sum()
    found = with_faces(given, faces_of(mirrored(5))[::2], np.zeros((0, *given.shape), int))

    def entropy(cubes):
        return float((cubes * np.log(cubes / given)).sum())

    signs = np.array([(-1) ** sum(corner) for corner in product(range(2), repeat=8)])
    unseen = signs.reshape((2,) * 8)  # its sum over any corner is nothing
    assert np.abs([face.sum() for face in faces_of(unseen)]).max() == 0
    near = found.min() / 2
    assert min(entropy(found + near * unseen), entropy(found - near * unseen)) > entropy(found)


def test_what_shows_it_already_stays():
    volume = blobs((48, 48, 48), 1.5, 6)
    densities = PatternDensities.of([volume], 2)
    own = [
        np.array([faces_of(cubes_of(densities, n))[2 * axis] for n in range(len(STRIDES))])
        for axis in range(3)
    ]
    chords = Patterns.of(volume, 2).chord_densities
    found = PlanePatterns(2, tuple(chords), tuple(own)).nearest_to(densities)
    np.testing.assert_allclose(found.own, densities.own, atol=3e-3)


@pytest.mark.parametrize("phases", [2, 3])
def test_euler_numbers_and_neighbours_stay(phases):
    """Of three phases, whose joins are in the faces as well, those of the last to the letter."""
    levels = (0.3,) if phases == 2 else (-0.4, 0.4)
    volume = blobs((48, 48, 48), 1.5, 7, levels)
    flat = blobs((3, 96, 96), 1.5 if phases == 3 else 2.5, 8, levels)[1]
    given = PatternDensities.of([volume], phases)
    shown = PlanePatterns.of(views_of([picture(flat)], ()), range(phases))
    found = shown.nearest_to(given)
    euler = [share.reshape((phases,) * 8).transpose() for share in given.bins.euler]
    before, after = (
        np.array([(cubes_of(one) * share).sum() for share in euler]) for one in (given, found)
    )
    np.testing.assert_allclose(after[-2:], before[-2:], atol=2e-5)
    np.testing.assert_allclose(after, before, atol=1e-3)
    last = given.bins.neighbours
    np.testing.assert_array_equal(found.own[last:], given.own[last:])
    for number, face in enumerate(faces_of(cubes_of(found))):
        np.testing.assert_allclose(face, shown.squares[number // 2][0], atol=1e-3)


def test_chords_are_those_of_the_pictures_that_show_the_axis():
    """Of a picture in one plane along its rows and columns; of a material that is alike from all
    sides those of both, along every axis.
    """
    plane = blobs((3, 96, 96), 2.0, 0)[1]
    long = np.ascontiguousarray(np.repeat(plane[:48], 2, axis=0))
    views = [view for view in views_of([picture(long)], ()) if view.across == (1, 2)]
    found = PlanePatterns.of(views, (0, 1))
    shown = Patterns.of(long[None], 2).chord_densities
    assert found.chords[0] is None and found.squares[1] is None
    np.testing.assert_array_equal(found.chords[1], shown[1])
    np.testing.assert_array_equal(found.chords[2], shown[2])
    np.testing.assert_allclose(found.squares[0][0], count_squares(long, 2, 1))
    given = PatternDensities.of([blobs((40, 40, 40), 2.0, 1)], 2)
    chords = [
        one.own[: given.bins.cubes].reshape(3, -1) for one in (found.nearest_to(given), given)
    ]
    np.testing.assert_array_equal(chords[0][0], chords[1][0])
    np.testing.assert_array_equal(chords[0][1:], shown[1:])
    alike = PlanePatterns.of(views_of([picture(plane)], ()), (0, 1))
    both = Patterns.of(plane[None], 2).chord_densities[1:].mean(axis=0)
    for own in alike.chords:
        np.testing.assert_allclose(own, both)
    for own in alike.squares:
        np.testing.assert_allclose(own, own.transpose(0, 1, 3, 2, 4))
        np.testing.assert_allclose(own, own.transpose(0, 2, 1, 4, 3))


def test_small_pictures_and_many_phases_tell_nothing():
    views = views_of([picture(blobs((3, 40, 40), 1.5, 1)[1])], ())
    assert are_told(views, 2)
    assert not are_told(views, 3)  # 1,600 pixels for 81 squares
    large = views_of([picture(blobs((3, 200, 200), 1.5, 1)[1])], ())
    assert are_told(large, 3) and not are_told(large, 4)


@pytest.mark.parametrize(
    "method",
    ["kopf", *(pytest.param(name, marks=pytest.mark.whole) for name in ("chen", "sliced"))],
)
def test_planes_come_nearer_to_the_picture(method):
    """Squares of a material with rough interfaces; the Euler density stays as it was."""
    rough = blobs((3, 80, 80), 1.0, 2)[1]
    given = picture(rough)
    volumes = {
        rounds: tb.method(method, interface_rounds=rounds, **SHORT[method])
        .fit(given)
        .generate(40, seed=1)
        for rounds in (0, 2)
    }
    aim = PlanePatterns.of(views_of([given], ()), (0, 1)).squares[0][0]
    off = {
        rounds: np.mean(
            [
                np.abs(faces_of(cubes_of(PatternDensities.of([made.values], 2)))[2 * axis] - aim)
                for axis in range(3)
            ]
        )
        for rounds, made in volumes.items()
    }
    assert off[2] < 0.5 * off[0]
    assert volumes[2].values.mean() == volumes[0].values.mean()
    report = volumes[2].recipe.steps[-1]["report"]["patterns"]
    assert report["changed"] > 100 and report["off_after"] < report["off_before"]
    euler = [tb.measure.euler_density(made) for made in volumes.values()]
    assert abs(euler[1] - euler[0]) < 0.2 * abs(euler[0])


@pytest.mark.whole
def test_masks_and_known_voxels_are_left_alone():
    given = picture(blobs((3, 80, 80), 1.0, 2)[1])
    mask = np.ones((40, 40, 40), bool)
    mask[:, :8] = False
    known = np.zeros((40, 40, 40), bool)
    known[20] = True
    values = np.where(known, given.values[:40, :40], 0).astype(np.uint8)
    before, made = (
        tb.method("kopf", **QUICK, interface_rounds=rounds)
        .fit(given)
        .generate(40, seed=1, mask=mask, fixed=picture(values), known=known)
        for rounds in (0, 2)
    )
    assert not (made.values[~mask & ~known]).any()
    np.testing.assert_array_equal(made.values[20], values[20])
    assert made.values.sum() == before.values.sum()  # what changes back has no counterpart
    assert made.recipe.steps[-1]["report"]["patterns"]["changed"] > 100


def uneven(side, seed, low=0.3, high=0.6):
    """Return a picture (side, side) whose fraction rises from row to row."""
    plane = gaussian(np.random.default_rng(seed).normal(size=(3, side, side)), 2.0)[1]
    levels = np.quantile(plane, np.linspace(1 - low, 1 - high, side))
    return (plane > levels[:, None]).astype(np.uint8)


def test_denser_windows_tell_of_a_denser_material():
    """Squares and chords are nearer to those of a denser picture of the same process than the
    picture's own, and of its own fraction they are its own.
    """
    given, dense = uneven(400, 1), uneven(400, 2, 0.5, 0.5)
    views = views_of([picture(given)], ())
    own, aim = PlanePatterns.of(views, (0, 1)), PlanePatterns.of(views_of([picture(dense)]), (0, 1))
    same = PlanePatterns.at_fraction(views, (0, 1), float(given.mean()))
    found = PlanePatterns.at_fraction(views, (0, 1), 0.5)
    for axis in range(3):
        np.testing.assert_allclose(same.chords[axis], own.chords[axis])
        np.testing.assert_allclose(same.squares[axis], own.squares[axis])
        np.testing.assert_allclose(found.squares[axis].sum(axis=(1, 2, 3, 4)), 1)
        for before, after, wanted in (
            (own.chords[axis], found.chords[axis], aim.chords[axis]),
            (own.squares[axis], found.squares[axis], aim.squares[axis]),
        ):
            assert np.abs(after - wanted).sum() < 0.5 * np.abs(before - wanted).sum()
    solid = found.squares[0][0][1].sum()  # of the first corner
    assert solid == pytest.approx(0.5, abs=0.01)


def test_windows_tell_of_no_fraction_far_from_theirs():
    views = views_of([picture(uneven(400, 1))], ())
    for fraction, told in ((0.35, True), (0.55, True), (0.15, False), (0.75, False)):
        assert (PlanePatterns.at_fraction(views, (0, 1), fraction) is not None) == told
    small = views_of([picture(uneven(30, 1))], ())  # no window fits
    own = float(small[0].image.values.mean())
    assert PlanePatterns.at_fraction(small, (0, 1), own) is not None
    assert PlanePatterns.at_fraction(small, (0, 1), own + 0.05) is None


def test_a_target_that_windows_tell_of_is_flipped_to():
    given = picture(uneven(96, 2), names=("void", "solid"))
    learned = tb.method("kopf", **QUICK).fit(given)
    near, far = (float((given.values == 0).mean()) + more for more in (0.06, 0.25))
    flipped, left = (
        learned.generate(40, seed=1, target={"porosity": asked}) for asked in (near, far)
    )
    assert tb.measure.porosity(flipped) == pytest.approx(near, abs=1e-3)
    told = flipped.recipe.steps[-1]["report"]["patterns"]
    assert told["off_after"] < 0.8 * told["off_before"]
    assert "patterns" not in left.recipe.steps[-1].get("report", {})
    plain = tb.Request((24,) * 3)
    shown = {
        asked: learned.flips.shown_for(replace(plain, target={"porosity": asked}))
        for asked in (near, far)
    }
    assert shown[near] is not None and shown[far] is None
    assert learned.flips.shown_for(replace(plain, target={"porosity": near})) is shown[near]


def test_a_target_of_three_phases_leaves_voxels_as_they_are():
    phases = blobs((3, 96, 96), 1.5, 3, (-0.4, 0.4))[1]
    given = picture(phases, names=("void", "binder", "solid"))
    learned = tb.method("kopf", **QUICK).fit(given)
    plain = tb.Request((24,) * 3)
    assert learned.flips.shown_for(plain) is not None
    assert learned.flips.shown_for(replace(plain, target={"porosity": 0.4})) is None


@pytest.mark.parametrize("config", [KopfConfig, ChenConfig, SlicedConfig])
def test_older_recipes_have_no_flips(config):
    assert config().interface_rounds > 0
    assert config.recorded({})["interface_rounds"] == 0
    if config is not SlicedConfig:
        assert config.preset("paper")["interface_rounds"] == 0

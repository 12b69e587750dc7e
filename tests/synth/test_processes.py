"""Processes and the one that a picture resembles: distances against plain loops, forms, the choice,
the whole method.
"""

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.seeds import generator
from trabecula.errors import RequestError, UnknownNameError
from trabecula.exemplar.views import views_of
from trabecula.synth.kopf import process_relative, processes
from trabecula.synth.kopf.config import PROCESSES
from trabecula.synth.kopf.nearest_process import Resemblance, rank_processes
from trabecula.synth.kopf.process_relative import choose_process
from trabecula.synth.kopf.slice_figures import slice_figures

SIDE = 12


def middles(side=SIDE):
    """Return the middles of the voxels of a box, (side, side, side, 3)."""
    return np.moveaxis(np.indices((side,) * 3), 0, -1) + 0.5


def around(offset, side=SIDE):
    """Return offsets in a box that repeats."""
    return offset - side * np.rint(offset / side)


def picture_of(name, *, seed=1, fraction=0.3, length=13.0, side=150, at=61):
    """Return a plane of a process made with other random numbers than its own."""
    body = name.removeprefix("void_")
    field = processes._FIELDS[body](side, length, generator(seed, "another"))
    high = field if name == body else -field
    return (high > np.quantile(high, 1 - fraction))[at]


def as_labels(inside):
    """Return a picture of void and solid."""
    return tb.Image(inside.astype(np.uint8), "labels")


def test_every_process_is_a_box_of_numbers_and_its_void_is_the_negative():
    for name in PROCESSES:
        field = processes.process_field(name, 16, 6.0)
        assert field.shape == (16, 16, 16) and field.dtype == np.float32
        assert np.isfinite(field).all() and len(np.unique(field)) > 1000
        np.testing.assert_array_equal(field, processes.process_field(name, 16, 6.0))
        if name.startswith("void_"):
            other = processes.process_field(name.removeprefix("void_"), 16, 6.0)
            np.testing.assert_array_equal(field, -other)


def test_distances_are_those_of_plain_loops():
    draw = np.random.default_rng(0)
    points, radii = draw.random((9, 3)) * SIDE, draw.random(9) * 2
    apart = np.linalg.norm(around(middles()[..., None, :] - points), axis=-1)
    field = np.full((SIDE,) * 3, 5.0, np.float32)
    processes.sphere_distances(points, radii, np.float32(5), field, 0, SIDE)
    nearest = np.where(apart <= radii + 5, apart - radii, 5.0).min(axis=-1)
    np.testing.assert_allclose(field, np.minimum(nearest, 5), atol=1e-5)

    along = draw.standard_normal((3, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    square = np.empty((SIDE,) * 3, np.float32)
    processes.line_distances(points[:3], along, square, 0, SIDE)
    offset = middles()[..., None, :] - points[:3]
    across = offset - (offset * along).sum(axis=-1, keepdims=True) * along
    np.testing.assert_allclose(square, (across**2).sum(axis=-1).min(axis=-1), atol=1e-4)


@pytest.mark.whole
@pytest.mark.parametrize(("side", "count"), [(12, 7), (44, 90)])
def test_edges_and_plates_lie_where_bisecting_planes_do(side, count):
    """The nearest wall and the second nearest, by the distance to the plane half way to each other
    point; every wall a plate: the nearest. In the large box most points are too far to be seen.
    """
    draw = np.random.default_rng(1)
    points = draw.random((count, 3)) * side
    squares = (around(middles(side)[..., None, :] - points, side) ** 2).sum(axis=-1)
    own = squares.argmin(axis=-1)
    apart = np.linalg.norm(around(points[:, None] - points, side), axis=-1)
    lead = squares - squares.min(axis=-1, keepdims=True)
    planes = np.where(np.arange(count) == own[..., None], np.inf, lead / (2 * apart[own] + 1e-300))
    walls = np.sort(planes, axis=-1)
    found = [
        processes.cell_field(points, np.full((count, count), plates), side)
        for plates in (False, True)
    ]
    np.testing.assert_allclose(found[0], walls[..., 1], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found[1], walls[..., 0], rtol=1e-4, atol=1e-4)


def test_points_keep_apart_and_mixed_spheres_do_not_touch():
    draw = np.random.default_rng(2)
    spread = processes._spread_points(60, 10.0, draw)
    chance = draw.random(spread.shape) * 60

    def nearest(points):
        apart = np.linalg.norm(around(points[:, None] - points, 60), axis=-1)
        return (apart + 60 * np.eye(len(points))).min(axis=1)

    assert len(spread) == 216 and (spread >= 0).all() and (spread < 60).all()
    assert nearest(spread).min() > 7.0 > nearest(chance).mean()

    radii = np.sort(draw.random(60) * 6 + 4)[::-1].copy()
    points, tries = np.empty((60, 3)), draw.random((60, 20, 3)) * 60
    placed = processes.place_spheres(tries, radii, 1.0, 60.0, points)
    assert placed[0] and 10 < placed.sum() < 60
    kept, size = points[placed], radii[placed]
    gaps = np.linalg.norm(around(kept[:, None] - kept, 60), axis=-1) - size[:, None] - size
    assert (gaps[~np.eye(len(kept), dtype=bool)] >= 1.0).all()


@pytest.mark.whole
def test_voxels_do_not_depend_on_threads():
    one = []
    for count in (1, 2):
        with tb.threads(count):
            one.append([processes.process_field(name, 40, 9.0) for name in PROCESSES])
    for first, second in zip(*one, strict=True):
        np.testing.assert_array_equal(first, second)


@pytest.mark.whole
def test_figures_in_correlation_lengths_do_not_depend_on_the_scale():
    """A picture and the same one twice as large; discs and holes differ in what they are named."""
    inside = picture_of("overlapping_spheres", length=12.0)
    twice = np.kron(inside, np.ones((2, 2), bool))
    small, large = slice_figures(inside, 4.0), slice_figures(twice, 8.0)
    assert small.keys() == large.keys()
    for name in small:
        assert np.sqrt(np.mean((small[name] - large[name]) ** 2)) < 0.09, name
    swapped = slice_figures(~inside, 4.0)
    np.testing.assert_array_equal(swapped["depth low"], small["depth high"])
    np.testing.assert_array_equal(swapped["number low"], small["number high"])


@pytest.mark.whole
@pytest.mark.parametrize(
    ("name", "fraction"),
    [
        pytest.param("gaussian", 0.4, marks=pytest.mark.slow),
        pytest.param("overlapping_spheres", 0.5, marks=pytest.mark.slow),
        pytest.param("void_mixed_spheres", 0.85, marks=pytest.mark.slow),
        ("struts", 0.2),
        pytest.param("walls", 0.3, marks=pytest.mark.slow),
        pytest.param("packed_spheres", 0.6, marks=pytest.mark.slow),
    ],
)
def test_a_picture_resembles_the_process_that_it_is_of(name, fraction):
    """Other random numbers; of two that look alike in a plane either may come first."""
    ranked = rank_processes(picture_of(name, fraction=fraction, length=16.0))
    own = next(one for one in ranked[:2] if one.name == name)
    assert own.distance < 1.5 and ranked[-1].distance > 2.5
    assert own.length == pytest.approx(16.0, rel=0.2)


@pytest.mark.whole
def test_pictures_that_no_process_is_for_say_why():
    three = tb.Image(np.arange(900, dtype=np.uint8).reshape(30, 30) % 3, "labels")
    told = choose_process(views_of([three]), (0, 1, 2), "auto")
    assert told.relative is None and "two phases" in told.line
    blob = picture_of("gaussian", length=40.0, side=64, at=30)
    told = choose_process(views_of([as_labels(blob)]), (0, 1), "auto")
    assert told.relative is None and "bodies too few" in told.line
    large = np.kron(picture_of("gaussian"), np.ones((4, 4), bool))
    told = choose_process(views_of([as_labels(large)]), (0, 1), "auto")
    assert told.relative is None and "16 is the most" in told.line
    rows = as_labels(np.kron(picture_of("gaussian", length=6.0, side=80), np.ones((1, 4), bool)))
    told = choose_process(views_of([rows]), (0, 1), "auto")
    assert told.relative is None and "alike from all sides" in told.line
    assert choose_process(views_of([rows]), (0, 1), "gaussian").report["process"] == "gaussian"
    with pytest.raises(RequestError, match="process=gaussian: a process is for one picture"):
        choose_process(views_of([rows], ["yx", "zx"]), (0, 1), "gaussian")
    with pytest.raises(UnknownNameError, match="packed_spheres"):
        tb.method("kopf", process="packed_sphere")


@pytest.mark.slow
def test_what_would_fall_apart_or_is_neither_joined_nor_apart_is_passed_over(monkeypatch):
    """Of discs in void a slice cannot tell balls from rods: a body that holds itself is not balls.
    Without a void either will do.
    """
    inside = picture_of("mixed_spheres", fraction=0.2)
    near = [
        Resemblance("mixed_spheres", 0.9, 13.0),
        Resemblance("struts", 1.2, 20.0),
        Resemblance("walls", 2.4, 20.0),
    ]
    monkeypatch.setattr(process_relative, "rank_processes", lambda inside: tuple(near))
    found = choose_process(views_of([as_labels(inside)]), (0, 1), "auto")
    assert found.report["process"] == "struts" and "struts" in found.line
    assert tb.measure.largest_fraction(found.relative) > 0.9
    assert found.relative.values.mean() == pytest.approx(inside.mean(), abs=1e-3)
    both = tb.Image(inside.astype(np.uint8), "labels", phases=("paste", "grain"))
    assert choose_process(views_of([both]), (0, 1), "auto").report["process"] == "mixed_spheres"
    asked = choose_process(views_of([as_labels(inside)]), (0, 1), "walls")
    assert asked.report["process"] == "walls"
    near[0] = Resemblance("gaussian", 0.8, 10.0)
    few = as_labels(picture_of("gaussian", fraction=0.86))  # of its void .4 is in one piece
    assert choose_process(views_of([few]), (0, 1), "auto").report["process"] != "gaussian"
    near[:2] = [Resemblance("mixed_spheres", 0.9, 13.0)]
    told = choose_process(views_of([as_labels(inside)]), (0, 1), "auto")
    assert told.relative is None and "resembles no process" in told.line


@pytest.mark.slow
def test_a_volume_from_one_picture_is_of_the_process_that_it_resembles():
    """Discs of voids: balls that do not meet, where the planes alone join them."""
    inside = picture_of("void_mixed_spheres", fraction=0.85, length=10.0)
    picture = as_labels(inside)
    quick = {"first_rounds": 2, "rounds": (2,)}
    model = tb.method("kopf", process="auto", **quick).fit(picture)
    made = model.generate(40, seed=1, periodic=True)
    report = made.recipe.steps[-1]["report"]["like"]
    assert report["process"] == "void_mixed_spheres"
    assert min(report["distances"], key=report["distances"].get) == "void_mixed_spheres"
    assert made.values.sum() == round(inside.mean() * 40**3)
    assert tb.measure.largest_fraction(made, phase="void") < 0.5
    again = tb.method("kopf", process="auto", **quick).fit(picture)
    np.testing.assert_array_equal(again.generate(40, seed=1, periodic=True).values, made.values)
    assert (model.generate(40, seed=2, periodic=True).values != made.values).any()

    plain = tb.method("kopf", **quick).fit(picture)
    far = {"porosity": 0.03}
    beside = model.generate(24, seed=1, target=far)
    np.testing.assert_array_equal(beside.values, plain.generate(24, seed=1, target=far).values)
    named = tb.method("kopf", process="gaussian", **quick).fit(picture)
    with pytest.raises(RequestError, match="beside a porosity far from the picture's"):
        named.generate(24, target=far)


@pytest.mark.slow
def test_a_process_goes_with_a_porosity():
    picture = as_labels(picture_of("void_mixed_spheres", fraction=0.85, length=10.0))
    model = tb.method("kopf", process="auto").fit(picture)
    surface = []
    for porosity in (0.1, 0.15, 0.22):
        made = model.generate(64, seed=1, target={"porosity": porosity})
        report = made.recipe.steps[-1]["report"]["like"]
        assert report["process"] == "void_mixed_spheres"
        assert report["fraction"]["asked"] == pytest.approx(1 - porosity)
        assert tb.measure.porosity(made) == pytest.approx(porosity, abs=1e-5)
        assert tb.measure.largest_fraction(made, phase="void") < 0.5
        surface.append(tb.measure.specific_surface(made))
    plain = tb.measure.specific_surface(model.generate(64, seed=1))
    assert surface[1] == pytest.approx(plain, rel=0.05)
    assert surface[0] < 0.8 * plain and surface[2] > 1.2 * plain

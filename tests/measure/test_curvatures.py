"""Principal curvatures of forms in closed form; the distribution of the shape index."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.engine.parallel import threads
from trabecula.errors import InputError
from trabecula.measure import curvatures, shape_index
from trabecula.measure.smooth import gaussian

CENTRES = np.linspace(-1, 1, 17)


def places(*sides):
    return np.stack(np.indices(sides), axis=-1) - (np.array(sides) - 1) / 2


def rod(side, radius, way):
    at, along = places(side, side, side), np.array(way) / np.linalg.norm(way)
    return ((at**2).sum(-1) - (at @ along) ** 2 < radius**2).astype(np.uint8)


def random_rods(side, count, *, seed):
    draw = np.random.default_rng(seed)
    at, found = np.stack(np.indices((side,) * 3), axis=-1), np.zeros((side,) * 3, bool)
    for _ in range(count):
        off, way = at - draw.uniform(0, side, 3), draw.standard_normal(3)
        way /= np.linalg.norm(way)
        found |= (off**2).sum(-1) - (off @ way) ** 2 < 4**2
    return found


def mean(values, found):
    return np.average(values, weights=found.area)


@pytest.mark.parametrize("radius", [6, 10, 14])
def test_balls_and_round_pores(radius):
    ball = ((places(41, 41, 41) ** 2).sum(-1) < radius**2).astype(np.uint8)
    found = curvatures(ball)
    assert found.area.sum() == pytest.approx(4 * np.pi * radius**2, rel=0.02)
    assert mean((found.most + found.least) / 2, found) == pytest.approx(1 / radius, rel=0.05)
    assert mean(found.curvedness, found) == pytest.approx(1 / radius, rel=0.08)
    shares = shape_index(ball)
    assert shares[-3:].sum() == pytest.approx(1) and shares.sum() == pytest.approx(1)
    assert np.allclose(shape_index(1 - ball), shares[::-1], atol=1e-6)
    # the void's interface is that of the solid from the other side
    assert np.allclose(shape_index(ball, phase="void"), shares[::-1], atol=1e-6)


@pytest.mark.parametrize("way", [(1, 0, 0), (0, 1, 1), (3, 1, 2)])
def test_rods_in_any_direction(way):
    solid = rod(48, 7, way)
    found = curvatures(solid)
    assert mean(found.most, found) == pytest.approx(1 / 7, rel=0.05)
    assert mean(found.least, found) == pytest.approx(0, abs=0.01)
    assert CENTRES @ shape_index(solid) == pytest.approx(0.5, abs=0.03)
    assert shape_index(solid)[11:14].sum() > 0.97
    assert CENTRES @ shape_index(1 - solid) == pytest.approx(-0.5, abs=0.03)


def test_a_gyroid_is_all_saddles():
    z, y, x = np.moveaxis(places(60, 60, 60), -1, 0) * (2 * np.pi / 30)
    field = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
    shares = shape_index((field > 0).astype(np.uint8))
    assert shares[7:10].sum() > 0.95 and CENTRES @ shares == pytest.approx(0, abs=0.01)


def test_a_torus_has_the_shares_of_its_formula():
    ring, tube = 20.0, 9.0
    at = places(27, 67, 67)
    solid = (np.hypot(at[..., 1], at[..., 2]) - ring) ** 2 + at[..., 0] ** 2 < tube**2
    angle = (np.arange(100_000) + 0.5) * (2 * np.pi / 100_000)
    around = ring + tube * np.cos(angle)
    first, second = 1 / tube, np.cos(angle) / around
    index = np.arctan2(first + second, abs(first - second)) * (2 / np.pi)
    truth = np.histogram(index, 17, (-17 / 16, 17 / 16), weights=around)[0]
    found = np.cumsum(shape_index(solid.astype(np.uint8)) - truth / truth.sum())
    assert np.abs(found).sum() / 8 < 0.03  # by so much of the index the shares would have to move


def test_lengths_follow_the_spacing():
    at = places(25, 49, 49) * (2, 1, 1)
    ball = ((at**2).sum(-1) < 15**2).astype(np.uint8)
    one = curvatures(tb.Image(ball, "labels", spacing=(0.2, 0.1, 0.1), unit="mm"))
    assert one.area.sum() == pytest.approx(4 * np.pi * 1.5**2, rel=0.03)
    assert mean((one.most + one.least) / 2, one) == pytest.approx(1 / 1.5, rel=0.1)
    plain = curvatures(tb.Image(ball, "labels", spacing=(2, 1, 1)))
    assert np.allclose(plain.most, one.most / 10, atol=1e-5)
    assert np.allclose(plain.area, one.area * 100, rtol=1e-5)


def test_fibres_and_the_knots_that_sizes_take_for_them():
    fibres = random_rods(64, 18, seed=4)
    smooth = gaussian(np.random.default_rng(4).standard_normal((64, 64, 64)), 3)
    knots = smooth > np.quantile(smooth, 1 - fibres.mean())
    parts = [fibres[:32], fibres[32:]]
    rods, other, blobs = (shape_index(one.astype(np.uint8)) for one in (*parts, knots))
    assert np.abs(rods - other).sum() < 0.35 * np.abs(rods - blobs).sum()


def test_the_same_bits_with_any_number_of_threads():
    image = np.random.default_rng(0).random((40, 30, 20)) < 0.4
    found = []
    for count in (1, 2, 5):
        with threads(count):
            found.append(curvatures(image.astype(np.uint8)))
    for one in found[1:]:
        assert np.array_equal(one.most, found[0].most)
        assert np.array_equal(one.least, found[0].least)
        assert np.array_equal(one.area, found[0].area)
    assert (found[0].most >= found[0].least).all()


def test_no_interface_and_wrong_images():
    assert shape_index(np.ones((12, 12, 12), np.uint8)).tolist() == [0] * 17
    assert len(curvatures(np.zeros((12, 12, 12), np.uint8)).area) == 0
    with pytest.raises(InputError, match="2-D"):
        shape_index(np.eye(20, dtype=np.uint8))
    with pytest.raises(InputError, match="too thin"):
        shape_index(np.ones((3, 20, 20), np.uint8))
    thin = tb.describe(np.ones((3, 20, 20), np.uint8))
    assert thin["shape_index"] is None


def test_phases_for_themselves_where_there_are_three():
    at = places(40, 40, 40)
    values = np.zeros((40, 40, 40), np.uint8)
    values[(at[..., 1] ** 2 + at[..., 2] ** 2) < 12**2] = 1  # a sheath around a wire
    values[(at[..., 1] ** 2 + at[..., 2] ** 2) < 6**2] = 2
    image = tb.Image(values, "labels", phases=("void", "sheath", "wire"))
    curves = tb.measure.phase_curves(image, r_max=5, cross=False)
    assert curves["shape_index_wire"][12] > 0.9
    assert curves["shape_index_sheath"][[4, 12]].sum() > 0.9  # a channel within, a rod without
    assert "shape_index_void" not in curves  # the solid's, from the other side
    described = tb.describe(image, r_max=5)
    assert described["shape_index"][12] > 0.9
    assert described["phases"]["wire"]["shape_index"] == curves["shape_index_wire"].tolist()
    quick = tb.describe(image, r_max=5, level="quick")
    assert quick["shape_index"] is quick["phases"]["wire"]["shape_index"] is None


@pytest.mark.slow
def test_the_certificate_sees_shapes_that_sizes_do_not():
    rods = random_rods(96, 30, seed=5)
    exemplar, other = rods[:, :, :48].astype(np.uint8), rods[:, :, 48:].astype(np.uint8)
    made = tb.method("noise").fit(exemplar).generate(exemplar.shape, seed=1)
    for image, passes in ((other, True), (made, False)):
        metric = tb.verify(exemplar, image).metrics["shape_index_distance"]
        assert metric.passed is passes and metric.value > 0


@pytest.mark.whole
def test_an_exemplar_whose_interface_is_at_its_faces_alone_is_judged_without_it():
    values = np.ones((48, 48, 48), np.uint8)
    values[0] = values[:, 0] = 0
    found = tb.verify(values, values)
    assert "shape_index_distance" not in found.metrics
    assert found.to_json()

"""`lattice`: known truths of periodic surfaces and struts."""

import itertools

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError, RequestError, UnknownNameError
from trabecula.synth.lattice.config import STRUTS, SURFACES
from trabecula.synth.lattice.method import distance, struts, surface

CELLS = (*SURFACES, *STRUTS)


def made(shape=64, *, target=None, periodic=False, mask=None, **settings):
    parts = {"target": target or {}, "periodic": periodic, "mask": mask}
    return tb.method("lattice", **{"cell_size": 32.0, **settings}).fit().generate(shape, **parts)


@pytest.mark.whole
@pytest.mark.parametrize("phase", ["sheet", "network"])
@pytest.mark.parametrize("cell", CELLS)
def test_the_porosity_is_that_of_the_setting_and_of_the_target(cell, phase):
    for porosity in (0.3, 0.55, 0.8):
        image = made(cell=cell, phase=phase, porosity=porosity)
        assert tb.measure.porosity(image) == pytest.approx(porosity, abs=0.01)
    image = made(cell=cell, phase=phase, target={"porosity": 0.45})
    assert tb.measure.porosity(image) == pytest.approx(0.45, abs=0.01)


# Areas of the minimal surfaces in a cubic cell of edge 1, to four digits, as tabled by Schoen and
# others from their Weierstrass representations; the level sets are near to them.
@pytest.mark.parametrize(
    ("cell", "area", "within"),
    [("gyroid", 3.0915, 0.006), ("schwarz_p", 2.3451, 0.006), ("schwarz_d", 3.8378, 0.006)],
)
def test_a_surface_has_the_area_of_the_minimal_surface(cell, area, within):
    side = 160
    field = surface(cell, np.ix_(*[(np.arange(side) + one) / side for one in (0.61, 0.73, 0.87)]))
    # Of the coarea formula: the integral of |grad f| where |f| < h, over 2 h.
    slope = np.sqrt(sum((np.roll(field, -1, a) - np.roll(field, 1, a)) ** 2 for a in range(3)))
    near = np.abs(field) < 0.05
    found = (slope * side / 2)[near].sum() / side**3 / 0.1
    assert found == pytest.approx(area, rel=within)


def test_a_simple_cubic_lattice_has_the_volume_of_its_cylinders():
    r = 0.12
    u = np.ix_(*[(np.arange(128) + shift) / 128 for shift in (0.61, 0.73, 0.87)])
    fraction = (distance("simple_cubic", u) < r).mean()
    # three cylinders of length 1, of which each pair shares a bicylinder and all a tricylinder
    expected = 3 * np.pi * r**2 - 3 * 16 / 3 * r**3 + 8 * (2 - np.sqrt(2)) * r**3
    assert fraction == pytest.approx(expected, rel=0.005)


@pytest.mark.parametrize(
    ("cell", "count", "length"),
    [
        ("simple_cubic", 3, 1.0),
        ("bcc", 8, np.sqrt(3) / 2),
        ("fcc", 12, np.sqrt(2) / 2),
        ("octet", 24, np.sqrt(2) / 2),
        ("kelvin", 24, np.sqrt(2) / 4),
        ("diamond", 16, np.sqrt(3) / 4),
    ],
)
def test_struts_are_those_of_the_cell_and_their_distance_is_the_nearest_of_all(cell, count, length):
    found = struts(cell)
    assert len(found) == count
    assert [2 * np.linalg.norm(half) for _, half in found] == pytest.approx([length] * count)
    u = np.meshgrid(*[(np.arange(10) + 0.3) / 10] * 3, indexing="ij")
    places, least = np.stack(u, -1).reshape(-1, 3), np.full(1000, np.inf)
    for (middle, half), image in itertools.product(found, itertools.product((-1, 0, 1), repeat=3)):
        away = places - middle - image
        along = np.clip(away @ half / (half @ half), -1, 1)
        least = np.minimum(least, np.linalg.norm(away - along[:, None] * half, axis=1))
    assert distance(cell, u).ravel() == pytest.approx(least, abs=1e-12)


@pytest.mark.whole
@pytest.mark.parametrize("cell", ["gyroid", "schwarz_d", "octet", "kelvin"])
def test_cells_repeat_and_a_periodic_result_fits_itself(cell):
    image = made(64, cell=cell).values
    assert np.array_equal(image[:32], image[32:]) and np.array_equal(image[:, :32], image[:, 32:])
    model = tb.method("lattice", cell=cell, cell_size=20.0).fit()
    whole = model.generate((50, 44, 30), periodic=True).values
    assert np.array_equal(
        model.window((50, 44, 30), ((40, 60), (0, 44), (-10, 20)), periodic=True),
        np.take(np.take(whole, range(40, 60), 0, mode="wrap"), range(-10, 20), 2, mode="wrap"),
    )
    assert np.array_equal(whole[:25], whole[25:])  # 2.5 cells of 20 are 2 of 25, or 3


def test_a_field_of_porosity_is_followed_exactly():
    field = np.broadcast_to(np.linspace(0.3, 0.9, 256, dtype=np.float32), (64, 64, 256))
    image = made((64, 64, 256), target={"porosity": field}).values
    for start in range(0, 256, 32):
        found = 1 - image[..., start : start + 32].mean()
        assert found == pytest.approx(field[0, 0, start : start + 32].mean(), abs=0.02)
    assert 1 - image.mean() == pytest.approx(0.6, abs=0.005)


def test_a_box_with_a_field_is_a_part_of_the_whole_and_ends_with_the_field():
    field = np.broadcast_to(np.linspace(0.3, 0.9, 48, dtype=np.float32), (32, 40, 48))
    model, target = tb.method("lattice", cell="iwp").fit(), {"porosity": field}
    whole = model.generate((32, 40, 48), target=target).values
    part = model.window((32, 40, 48), ((3, 9), (0, 40), (20, 48)), target=target)
    assert np.array_equal(part, whole[3:9, :, 20:48])
    with pytest.raises(InputError, match="leaves the target's field"):
        model.window((32, 40, 48), ((3, 9), (0, 40), (20, 49)), target=target)


def test_formulas_change_the_size_of_cells_and_tear_none():
    """Edges from 12 to 24 along x: walls every half cell, and the porosity stays."""
    formulas = ("z / 24", "y / 24", "X / 12 * log(1 + x / X)")
    graded = made((48, 48, 240), cell="simple_cubic", cell_size=None, coordinates=formulas).values
    profile = graded.mean(axis=(0, 1))
    high = profile > (profile.min() + profile.max()) / 2
    starts, stops = (np.flatnonzero(np.diff(high.astype(int)) == sign) + 1 for sign in (1, -1))
    middles = (starts[: len(stops) - 1] + stops[1:]) / 2
    expected = 240 * (np.exp(12 * np.arange(1, 1 + len(middles)) / 240) - 1)
    assert len(middles) == 13 and middles == pytest.approx(expected, abs=1.5)
    assert 1 - graded.mean() == pytest.approx(0.7, abs=0.02)
    same = made(40, cell_size=None, coordinates=("z / 20", "y / 20", "x / 20"))
    assert np.array_equal(same.values, made(40, cell_size=20.0).values)


def test_a_direction_turns_the_cell():
    upright = made(48, cell="simple_cubic", cell_size=(24.0, 16.0, 16.0)).values
    lying = made(48, cell="simple_cubic", cell_size=(24.0, 16.0, 16.0), direction=(0, 0, 1)).values
    assert lying.mean() == pytest.approx(upright.mean(), abs=0.02)

    def period(values, axis):
        line = values.sum(axis=tuple({0, 1, 2} - {axis})).astype(float)
        spectrum = np.abs(np.fft.rfft(line - line.mean()))
        return 48 / spectrum.argmax()

    assert [period(upright, axis) for axis in range(3)] == [24, 16, 16]
    assert [period(lying, axis) for axis in range(3)] == [16, 16, 24]
    for direction in ((-1, 0, 0), (1, 1, 1)):
        turned = made(64, cell_size=16.0, direction=direction)
        assert tb.measure.porosity(turned) == pytest.approx(0.7, abs=0.02)


def test_struts_hang_together_and_a_sheet_parts_space_in_two():
    assert tb.measure.components(made(cell="octet", porosity=0.8)) == 1
    sheet = made(64, cell="schwarz_p", porosity=0.6)
    assert tb.measure.components(sheet) == 1 and tb.measure.components(sheet, phase="void") == 2


def test_the_size_of_voxels_counts():
    model = tb.method("lattice", cell_size=3.2).fit(spacing=0.1, unit="mm")
    assert np.array_equal(model.generate(40).values, made(40).values)
    assert model.generate(8).spacing == (0.1,) * 3


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"cell": "gyriod"}, "did you mean 'gyroid'"),
        ({"phase": "solid"}, "phase of a lattice"),
        ({"porosity": 1}, "leaves one phase"),
        ({"cell_size": 3.0}, "4 voxels or more"),
        ({"cell_size": [8, 8]}, "along z, y, x"),
        ({"direction": (0, 0, 0)}, "0 along every axis"),
        ({"coordinates": ("z/9", "y/9", "w")}, "'w'"),
        ({"coordinates": ("z/9", "y/9", "x/9"), "cell_size": 9.0}, "leave those out"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings, says):
    with pytest.raises((InputError, UnknownNameError), match=says):
        tb.method("lattice", **settings).fit()


@pytest.mark.parametrize(
    "settings", [{"direction": (1, 1, 1)}, {"coordinates": ("z/9", "y/9", "x/9")}]
)
def test_turned_cells_are_not_periodic(settings):
    with pytest.raises(RequestError, match="without direction and coordinates"):
        tb.method("lattice", **settings).fit().generate(32, periodic=True)


def test_a_box_beyond_all_coordinates_is_refused():
    model = tb.method("lattice").fit()
    for box in (((2**30, 2**30 + 1), (0, 1), (0, 1)), ((0, 1), (0, 1), (-(2**30) - 1, 0))):
        with pytest.raises(InputError, match="farther than"):
            model.window(8, box)

"""A property of windows as a power of their fraction, and fields by it."""

import numpy as np
import pytest

import trabecula as tb
from trabecula import fields
from trabecula.cli.main import main
from trabecula.errors import InputError, UnknownNameError
from trabecula.fields.property_law import fit_law


def plates(shape=(64, 40, 40)):
    """Plates across z, of which more run in the first half: along x a window conducts by its
    fraction."""
    made = np.zeros(shape, np.uint8)
    made[0:64:8] = made[1:32:8] = made[2:16:8] = 1
    return tb.Image(made, "labels", phases=("void", "solid"))


@pytest.fixture(scope="module")
def law():
    return fields.property_law(plates(), "conductivity:x", window=16, count=12)


def test_plates_conduct_by_their_fraction(law):
    assert law.coefficient == pytest.approx(1, rel=1e-3)
    assert law.exponent == pytest.approx(1, abs=1e-3)
    assert law.scatter < 1e-3 and law.blocked == 0
    assert (law.low, law.high) == (0.125, 0.375)


def test_a_void_property_goes_by_the_porosity():
    law = fields.property_law(plates(), "diffusivity:x", window=16, count=12)
    assert law.coefficient == pytest.approx(1, rel=1e-2)
    assert law.exponent == pytest.approx(1, abs=1e-2)
    field = fields.ramp((8, 4, 4), start=0.7, end=0.8)
    assert law.fraction(field).values == pytest.approx(1 - field.values, abs=1e-2)


def test_the_likeliest_power_is_found_whatever_the_scatter():
    """Values about c x^n in pairs above and below it, in proportion to it."""
    x = np.repeat(np.linspace(0.1, 0.4, 20), 2)
    p = 0.8 * x**2.5 * np.tile([0.6, 1.4], 20)
    found = fit_law("stiffness", x, p)
    assert found.exponent == pytest.approx(2.5, abs=1e-6)
    assert found.coefficient == pytest.approx(0.8, rel=1e-6)
    assert found.scatter == pytest.approx(0.4, rel=1e-6)


def test_a_field_beyond_the_windows_is_refused_with_their_range(law):
    with pytest.raises(InputError, match=r"from 0\.05 to 0\.3, the exemplar's windows from 0\.125"):
        law.fraction(fields.ramp((8, 4, 4), start=0.05, end=0.3))


@pytest.mark.parametrize(
    ("made", "name", "kind", "words"),
    [
        (np.ones((30, 30, 30), np.uint8), "stiffness", InputError, "fractions of 1 to 1"),
        (plates(), "conductivity:z", InputError, "have conductivity:z above 0"),
        (plates(), "colour", UnknownNameError, "property"),
        (np.ones((20, 30, 30), np.uint8), "stiffness", InputError, "24 voxels a side"),
    ],
)
def test_what_has_no_law_is_refused(made, name, kind, words):
    with pytest.raises(kind, match=words):
        fields.property_law(made, name, window=None if len(made) < 30 else 14, count=12)


def test_the_command_writes_the_fraction_and_its_recipe_makes_it_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tb.write(plates(), "plates.tif")
    np.save("asked.npy", fields.ramp((8, 4, 4), start=0.15, end=0.3).values)
    words = ["plates.tif", "conductivity:x", "asked.npy", "--window", "16", "--count", "12"]
    assert main(["field", "property", *words, "--out", "fraction.tif"]) == 0
    made = tb.read("fraction.tif")
    assert made.values == pytest.approx(np.load("asked.npy"), abs=1e-3)
    assert (tb.rerun("fraction.tif").values == made.values).all()


class Slotted:
    """Makes plates across z whose fraction is asked for, with a slot through every other one."""

    def generate(self, shape, *, seed, target):
        along = np.asarray(target["volume_fraction"])[:, 0, 0]
        made, owed, number = np.zeros(shape, np.uint8), 0.0, 0
        for z, part in enumerate(along):
            owed += part
            if owed >= 0.5:
                made[z], owed, number = 1, owed - 1, number + 1
                made[z, :, seed::8] = number % 2
        self.shape, self.ends = shape, (along[0], along[-1])
        return tb.Image(made, "labels", phases=("void", "solid"))


def test_the_law_of_a_model_is_that_of_what_it_makes(law):
    model = Slotted()
    own = fields.property_law(plates(), "conductivity:x", window=16, count=12, model=model, seed=7)
    assert model.shape == (80, 32, 32)
    assert model.ends == pytest.approx((0.125, 0.375))
    # half of its plates lead nowhere
    assert own.coefficient * 0.25**own.exponent == pytest.approx(0.5 * 0.25, rel=0.2)
    assert law.coefficient * 0.25**law.exponent == pytest.approx(0.25, rel=0.01)
    assert own.low < 0.16 and own.high > 0.34


@pytest.mark.whole
def test_the_command_takes_the_law_of_a_method(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    tb.write(tb.crop(tb.sample("bone"), 60), "bone.tif")
    np.save("asked.npy", fields.ramp((8, 4, 4), start=0.06, end=0.08).values)
    words = ["field", "property", "bone.tif", "conductivity", "asked.npy"]
    assert main([*words, "--out", "fraction.tif"]) == 0
    first, told = tb.read("fraction.tif").values, capsys.readouterr().err
    assert main([*words, "--method", "texture", "--out", "own.tif"]) == 0
    own, then = tb.read("own.tif").values, capsys.readouterr().err
    assert "conductivity = " in told and told != then
    assert own.mean() > first.mean() + 0.005  # even material conducts less

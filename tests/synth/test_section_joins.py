"""What parallel sections say of how a material is joined: against the disector of `measure`, and in
what methods make.
"""

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.errors import InputError, RequestError
from trabecula.measure.disector import disector_along, disector_euler_density
from trabecula.measure.smooth import gaussian
from trabecula.synth.shared.patterns.sections import SectionEuler

QUICK = {"first_rounds": 4, "rounds": (2, 2), "gap": 2}
SHORT = {"kopf": QUICK, "chen": QUICK, "sliced": {"layout_rounds": 8, "rounds": (2, 2), "gap": 2}}


def blobs(shape, sigma, seed, levels=(0.0,)):
    """Return phases of a smooth field that is cut at levels."""
    field = gaussian(np.random.default_rng(seed).normal(size=shape), sigma)
    return np.digitize(field / field.std(), levels).astype(np.uint8)


def picture(phases):
    return tb.Image(np.ascontiguousarray(phases), "labels")


@pytest.mark.parametrize("levels", [(0.2,), (-0.5, 0.6)])
@pytest.mark.parametrize("gap", [1, 3])
def test_a_volume_is_to_gain_what_its_slices_lack(levels, gap):
    material, made = blobs((30, 40, 40), 2.0, 0, levels), blobs((24, 26, 28), 1.5, 1, levels)
    sections = [picture(material[n]) for n in (4, 4 + gap, 4 + 2 * gap)]
    present = tuple(range(len(levels) + 1))
    found = SectionEuler.of(sections, present, gap)
    euler = np.zeros(2 * len(found.own))
    wanted = found.wanted(made, euler)

    phases = present[1:] if len(present) == 2 else present
    for place, phase in enumerate(phases):
        named = {"phase": phase}
        own = disector_euler_density(sections, gap=gap, **named)
        along = [disector_along(picture(made), gap=gap, axis=n, **named) for n in range(3)]
        assert wanted[2 * place] == pytest.approx(own - np.mean(along))
        assert wanted[2 * place + 1] == wanted[2 * place]


def test_what_is_outside_a_form_says_nothing():
    material = blobs((12, 40, 40), 2.0, 0)
    found = SectionEuler.of([picture(material[4]), picture(material[6])], (0, 1), 2)
    small, large = blobs((20, 20, 20), 1.5, 1), np.zeros((20, 20, 30), np.uint8)
    large[:, :, :20] = small
    valid = np.zeros(large.shape, bool)
    valid[:, :, :20] = True
    euler = np.array([0.01, 0.02])
    np.testing.assert_allclose(found.wanted(large, euler, valid), found.wanted(small, euler))
    large[:, :, 20:] = blobs((20, 20, 10), 1.0, 2)
    np.testing.assert_allclose(found.wanted(large, euler, valid), found.wanted(small, euler))
    nothing = np.zeros(large.shape, bool)
    np.testing.assert_array_equal(found.wanted(large, euler, nothing), euler)
    # as many slices as the gap, along every axis
    np.testing.assert_array_equal(found.wanted(small[:2, :2, :2], euler), euler)


@pytest.mark.whole
@pytest.mark.parametrize("method", sorted(SHORT))
def test_labels_come_to_the_euler_number_of_the_sections(method):
    foam = tb.sample("foam").values
    sections = [picture(foam[48]), picture(foam[50])]
    quick = SHORT[method]
    alone = tb.method(method, **quick | {"gap": 0}).fit(sections[0]).generate(48, seed=1)
    made = tb.method(method, **quick).fit(sections).generate(48, seed=1)

    def along(volume):
        return np.mean([disector_along(volume, gap=2, axis=axis) for axis in range(3)])

    shown, own = disector_euler_density(sections, gap=2), tb.measure.euler_density(alone)
    wanted = own + shown - along(alone)
    assert tb.measure.euler_density(made) == pytest.approx(wanted, abs=0.25 * abs(own - wanted))
    assert abs(along(made) - shown) < 0.9 * abs(along(alone) - shown)
    assert made.recipe.steps[-1]["settings"]["gap"] == 2


def test_beside_a_coarse_scan_sections_say_how_it_is_joined():
    foam = tb.sample("foam").values
    sections = [picture(foam[48]), picture(foam[50])]
    blocks = foam[:32, :32, :32].reshape(8, 4, 8, 4, 8, 4).mean(axis=(1, 3, 5))
    coarse = picture((blocks > 0.5).astype(np.uint8))
    settings = {"preset": "fast", "rounds": (1, 1)}
    alone = tb.method("kopf", **settings).fit(sections[0]).generate(32, coarse=coarse, seed=1)
    made = tb.method("kopf", **settings, gap=2).fit(sections).generate(32, coarse=coarse, seed=1)
    assert np.any(made.values != alone.values)
    again = made.values.reshape(8, 4, 8, 4, 8, 4).mean(axis=(1, 3, 5)) > 0.5
    np.testing.assert_array_equal(again, coarse.values > 0)


def test_where_they_cannot_be_met_a_line_says_so():
    phases = blobs((10, 40, 40), 2.0, 0)
    model = tb.method("kopf", **QUICK).fit([picture(phases[4]), picture(phases[6])])
    said = []
    with listen(lambda label, fraction: said.append(label)):
        model.generate(24, seed=1)
        assert not any("sections" in line for line in said)
        model.generate(tb.Request(24, seed=1, target={"porosity": 0.45}))
    assert any("the sections' Euler number holds for labels" in line for line in said)


def test_few_sections_are_told_to_scatter():
    phases = blobs((12, 40, 40), 2.0, 0)
    sections = [picture(phases[n]) for n in range(0, 12, 2)]
    for count, told in ((2, True), (5, False)):
        said = []
        with listen(lambda label, fraction, said=said: said.append(label)):
            tb.method("kopf", **QUICK).fit(sections[:count])
        assert any("2 sections say scatters," in line for line in said) == told


@pytest.mark.parametrize("method", sorted(SHORT))
def test_settings_that_do_not_go_with_sections_are_named(method):
    with pytest.raises(InputError, match="interface_rounds=0"):
        tb.method(method, gap=2, interface_rounds=0)
    with pytest.raises(InputError, match="parallel sections stand for all planes"):
        tb.method(method, gap=2, views=("yx", "zx"))
    phases = blobs((10, 40, 40), 2.0, 0)
    with pytest.raises(InputError, match="got 1"):
        tb.method(method, gap=2).fit(picture(phases[0]))


def test_sections_are_labels_of_the_same_phases():
    phases = blobs((10, 40, 40), 2.0, 0)
    grey = [tb.Image(100 * phases[n], "grey") for n in (0, 2)]
    with pytest.raises(InputError, match="segment them"):
        tb.method("kopf", gap=2).fit(grey)
    more = phases[2].copy()
    more[:4, :4] = 2
    names = ("a", "b", "c")
    both = [tb.Image(one, "labels", phases=names) for one in (phases[0].copy(), more)]
    with pytest.raises(InputError, match="give one first that shows every phase"):
        tb.method("kopf", gap=2).fit(both)


def test_a_process_or_a_relative_beside_sections_is_refused():
    with pytest.raises(InputError, match="leave out the gap, or the process"):
        tb.method("kopf", gap=2, process="auto")
    phases = blobs((40, 40, 40), 2.0, 0)
    model = tb.method("kopf", **QUICK).fit([picture(phases[4]), picture(phases[6])])
    with pytest.raises(RequestError, match="leave out the gap, or the relative"):
        model.generate(tb.Request(24, seed=1, like=picture(phases)))

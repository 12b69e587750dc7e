"""Contact areas: identities with the specific surface, layers, coated spheres."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import trabecula as tb
from trabecula.errors import InputError
from trabecula.measure import contact, contacts, specific_surface


def random_phases(phases, shape=(9, 8, 7), seed=0):
    names = ("void", "a", "b", "c", "d")[:phases]
    values = np.random.default_rng(seed).integers(0, phases, shape)
    return tb.Image(values, "labels", spacing=(2.0, 1.0, 1.5)[3 - len(shape) :], phases=names)


def coated_sphere(core=10, shell=14, side=40):
    radius = np.sqrt(sum((axis - side / 2 + 0.5) ** 2 for axis in np.indices((side,) * 3)))
    return tb.Image(
        np.where(radius < core, 1, np.where(radius < shell, 2, 0)),
        "labels",
        phases=("void", "core", "shell"),
    )


@pytest.mark.whole
@given(
    phases=st.integers(2, 5), seed=st.integers(0, 99), flat=st.booleans(), periodic=st.booleans()
)
def test_the_contacts_of_a_phase_add_up_to_its_surface(phases, seed, flat, periodic):
    image = random_phases(phases, (9, 8) if flat else (6, 5, 7), seed)
    areas = contacts(image, periodic=periodic)
    assert list(areas) == list(combinations(image.phases, 2))
    for phase in image.phases:
        own = sum(area for pair, area in areas.items() if phase in pair)
        assert own == pytest.approx(
            specific_surface(image, phase=phase, periodic=periodic), rel=1e-12
        )


def test_of_two_phases_the_contact_is_the_surface_and_of_three_half_a_sum():
    two, three = random_phases(2), random_phases(3)
    assert contact(two, first="void", second="a") == specific_surface(two)
    surface = {phase: specific_surface(three, phase=phase) for phase in three.phases}
    half = (surface["void"] + surface["b"] - surface["a"]) / 2
    assert contact(three, first="b", second="void") == pytest.approx(half, rel=1e-12)


def test_layers_touch_their_neighbours_alone():
    values = np.repeat([0, 1, 2, 2], 4)[:, None, None] * np.ones((1, 6, 6), int)
    areas = contacts(values)
    plane = specific_surface((values > 0).astype(int))
    assert areas["void", "solid"] == areas["solid", "phase2"] == pytest.approx(plane)
    assert areas["void", "phase2"] == 0.0


def test_a_coated_sphere_touches_its_coating_and_nothing_else():
    areas = contacts(coated_sphere())
    assert areas["void", "core"] == 0.0
    assert areas["core", "shell"] == pytest.approx(4 * np.pi * 10**2 / 39**3, rel=0.03)
    assert areas["void", "shell"] == pytest.approx(4 * np.pi * 14**2 / 39**3, rel=0.03)


def test_phases_that_never_meet_have_no_contact_at_all():
    checkers = np.indices((8, 8, 8)).sum(axis=0) % 2
    image = tb.Image(checkers, "labels", phases=("void", "a", "b", "c"))
    areas = contacts(image)
    assert areas["void", "a"] > 0.8 and not any(
        area for pair, area in areas.items() if pair != ("void", "a")
    )


def test_a_mask_counts_what_lies_in_it():
    image = random_phases(4, (8, 8, 8))
    mask = np.zeros(image.shape, bool)
    mask[:, :5] = True
    part = tb.Image(image.values[:, :5], "labels", spacing=image.spacing, phases=image.phases)
    assert contacts(image, mask=mask) == contacts(part)
    with pytest.raises(InputError, match="give a thicker one"):
        contacts(image, mask=np.indices(image.shape)[0] == 3)


def test_refusals():
    image = random_phases(3)
    with pytest.raises(InputError, match="give two phases"):
        contact(image, first="a", second=1)
    with pytest.raises(InputError, match="unknown phase"):
        contact(image, first="a", second="z")
    with pytest.raises(InputError, match="labels"):
        contacts(tb.Image(np.zeros((4, 4)), "grey"))

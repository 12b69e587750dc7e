"""Every phase for itself: the public measures of each, told once, and images without a void."""

import json
import pickle

import numpy as np
import pytest
from scipy import ndimage

import trabecula as tb
from trabecula.core.errors import InputError, UnnamedVoidError
from trabecula.measure import (
    chord_length,
    component_sizes,
    contacts,
    cross_correlation,
    describe,
    describe_phases,
    each_phase,
    euler_density,
    lineal_path,
    percolates,
    percolating_fraction,
    phase_curves,
    phase_numbers,
    specific_surface,
    thickness,
    triple_phase_lines,
    two_point,
)

NAMES = ("void", "active", "binder")


def blobs(phases, shape=(24, 26, 28), seed=0):
    rng = np.random.default_rng(seed)
    return np.argmax(
        [ndimage.gaussian_filter(rng.normal(size=shape), 2) for _ in range(phases)], axis=0
    )


@pytest.fixture(scope="module")
def three():
    return tb.Image(blobs(3), "labels", spacing=(2.0, 1.0, 1.0), unit="um", phases=NAMES)


@pytest.fixture(scope="module")
def two():
    return tb.Image(np.minimum(blobs(3), 1), "labels", phases=("void", "solid"))


def test_figures_are_those_of_the_single_measures(three):
    found = describe_phases(three, r_max=6)
    assert found == json.loads(json.dumps(found, allow_nan=False))
    assert list(found["phases"]) == list(NAMES)
    assert sum(figures["fraction"] for figures in found["phases"].values()) == pytest.approx(1)
    for name, figures in found["phases"].items():
        sizes = component_sizes(three, phase=name)
        assert figures["components"] == figures["floating"] + 1 == len(sizes)
        assert figures["floating_voxels"] == sizes[1:].sum()
        assert figures["largest_fraction"] == sizes[0] / sizes.sum()
        assert figures["percolates"] == percolates(three, phase=name)
        for number, axis in enumerate("zyx"):
            assert figures["percolating_fraction"][axis] == percolating_fraction(
                three, axis=number, phase=name
            )
            assert (
                figures["two_point"][axis]
                == two_point(three, r_max=6, axis=number, phase=name).tolist()
            )
        assert figures["two_point"]["radial"] == two_point(three, r_max=6, phase=name).tolist()
        assert figures["lineal_path"] == lineal_path(three, r_max=6, phase=name).tolist()
        assert figures["specific_surface"] == specific_surface(three, phase=name)
        assert figures["euler_density"] == euler_density(three, phase=name)
        assert figures["chord_length"] == pytest.approx(chord_length(three, phase=name), rel=1e-12)
        assert figures["thickness"] == thickness(three, phase=name)


def test_components_are_those_that_scipy_finds(three):
    for label, (_, figures) in enumerate(
        describe_phases(three, level="quick", r_max=2)["phases"].items()
    ):
        numbered, count = ndimage.label(three.values == label)
        sizes = np.bincount(numbered.ravel())[1:]
        assert (
            figures["components"] == count
            and figures["largest_fraction"] == sizes.max() / sizes.sum()
        )


def test_pairs_and_triples(three):
    found = describe_phases(three, level="quick", r_max=6)
    assert list(found["pairs"]) == ["void-active", "void-binder", "active-binder"]
    for pair, area in contacts(three).items():
        told = found["pairs"]["-".join(pair)]
        assert told["contact"] == area
        assert (
            told["cross_correlation"]
            == cross_correlation(three, first=pair[0], second=pair[1], r_max=6).tolist()
        )
    (line,) = triple_phase_lines(three).values()
    assert found["triples"] == {
        "void-active-binder": {"line_density": line.density, "active_share": line.active}
    }
    solid = np.array(describe(three, level="quick", r_max=6)["two_point"]["radial"])
    own = sum(
        np.array(found["phases"][name]["two_point"]["radial"]) for name in ("active", "binder")
    )
    assert found["pairs"]["active-binder"]["cross_correlation"] == pytest.approx(
        (solid - own) / 2, abs=1e-6
    )
    everything = sum(
        np.array(figures["two_point"]["radial"]) for figures in found["phases"].values()
    )
    everything = everything + 2 * sum(
        np.array(pair["cross_correlation"]) for pair in found["pairs"].values()
    )
    assert everything == pytest.approx(np.ones(7), abs=1e-6)


def test_where_the_image_is_periodic_pairs_sum_up_to_the_fraction(three):
    """Check sum_j S_ij(r) = phi_i; without periodic faces it holds for the pairs that fit alone."""
    reach = {"r_max": 8, "periodic": True}
    for name in NAMES:
        pairs = [
            cross_correlation(three, first=name, second=other, **reach)
            for other in NAMES
            if other != name
        ]
        whole = two_point(three, phase=name, **reach) + sum(pairs)
        assert whole == pytest.approx(
            np.full(9, np.mean(three.values == NAMES.index(name))), abs=1e-6
        )


def test_coated_spheres_in_layers():
    """Put cores of phase 1 in shells of phase 2: closed components, of known size."""
    values = np.zeros((30, 30, 60), np.uint8)
    for x in (15, 45):
        radius = np.sqrt(
            sum(
                (axis - at + 0.5) ** 2
                for axis, at in zip(np.indices(values.shape), (15, 15, x), strict=True)
            )
        )
        values[radius < 12], values[radius < 8] = 2, 1
    found = describe_phases(tb.Image(values, "labels", phases=("void", "core", "shell")), r_max=4)
    core, shell = found["phases"]["core"], found["phases"]["shell"]
    assert (
        core["components"] == shell["components"] == 2
        and found["phases"]["void"]["components"] == 1
    )
    assert core["largest_fraction"] == shell["largest_fraction"] == 0.5
    assert not any(core["percolates"].values()) and all(
        found["phases"]["void"]["percolates"].values()
    )
    # The voxels of a sphere's rim lie in smaller spheres, so it comes out thinner than its diameter
    # of 16.
    assert core["thickness"] == pytest.approx(16, abs=2.5) and shell["thickness"] == pytest.approx(
        4, abs=1
    )
    assert found["pairs"]["void-core"]["contact"] == 0.0
    assert found["triples"] == {"void-core-shell": {"line_density": 0.0, "active_share": None}}


def test_what_two_phases_have_in_common_is_told_once(two):
    found = describe_phases(two, r_max=4)
    assert found["pairs"] == {} and found["triples"] == {}
    void, solid = found["phases"]["void"], found["phases"]["solid"]
    common = {"specific_surface", "two_point", "shape_index"}
    assert set(solid) - set(void) == common
    whole = describe(two, r_max=4)
    assert not common & (set(whole["phases"]["void"]) | set(whole["phases"]["solid"]))
    assert whole["phases"]["void"] == void
    assert whole["phases"]["solid"] == {
        name: value for name, value in solid.items() if name in void
    }
    assert void["thickness"] == whole["pore_size"] and solid["thickness"] == whole["thickness"]


@pytest.mark.parametrize(("phases", "times"), [(2, 1), (3, 3)])
def test_components_of_a_phase_are_found_once(three, two, monkeypatch, phases, times):
    calls = []

    def counted(inside, *rest):
        calls.append(int(inside.sum()))
        return original(inside, *rest)

    original = each_phase.mark_components
    monkeypatch.setattr(each_phase, "mark_components", counted)
    describe(two if phases == 2 else three, r_max=2, level="quick")
    assert len(calls) == len(set(calls)) == times


def test_describe_tells_every_phase_beside_the_pooled_solid(three):
    whole, each = describe(three, r_max=5), describe_phases(three, r_max=5)
    assert {name: whole[name] for name in each} == each
    assert whole["components"] == len(component_sizes(three))  # of active and binder together
    assert whole["components"] != whole["phases"]["active"]["components"]
    quick = describe(three, r_max=5, level="quick")
    assert all(figures["thickness"] is None for figures in quick["phases"].values())


def test_without_a_void_every_phase_is_told_and_the_solid_is_not(three):
    named = tb.Image(
        three.values,
        "labels",
        spacing=three.spacing,
        unit="um",
        phases=("pore", "active", "binder"),
    )
    found, same = describe(named, r_max=5), describe(three, r_max=5)
    assert set(found) == set(same) and found == json.loads(json.dumps(found, allow_nan=False))
    assert found["porosity"] is found["two_point"] is found["thickness"] is found["physics"] is None
    assert list(found["phases"].values()) == list(same["phases"].values())
    assert found["fractions"]["pore"] == same["porosity"]
    assert (
        len(found["notes"]) == 1
        and "pore, active, binder" in found["notes"][0]
        and not same["notes"]
    )
    two = tb.Image(np.minimum(three.values, 1), "labels", phases=("pore", "active"))
    assert "two_point" in describe(two, r_max=5)["phases"]["active"]


def test_one_phase_alone(three):
    found = describe_phases(three, phase="binder", r_max=5)
    each = describe_phases(three, r_max=5)
    assert found["phases"] == {"binder": each["phases"]["binder"]} and found["triples"] == {}
    assert found["pairs"] == {
        name: each["pairs"][name] for name in ("void-binder", "active-binder")
    }
    four = tb.Image(blobs(4, (14, 14, 14)), "labels", phases=("a", "b", "c", "d"))
    every = describe_phases(four, level="quick", r_max=2)
    one = describe_phases(four, phase=2, level="quick", r_max=2)
    assert one["pairs"] == {name: every["pairs"][name] for name in ("a-c", "b-c", "c-d")}


def test_a_phase_that_is_named_and_absent():
    image = tb.Image(np.minimum(blobs(2, (12, 12, 12)), 1), "labels", phases=(*NAMES, "binder_2"))
    figures = describe_phases(image, r_max=3)["phases"]["binder_2"]
    assert figures["fraction"] == figures["components"] == figures["largest_fraction"] == 0
    assert figures["thickness"] is None and not any(figures["percolates"].values())


def test_two_dimensions():
    image = tb.Image(blobs(3, (40, 44)), "labels", phases=NAMES)
    found = describe_phases(image, r_max=5)
    assert set(found["phases"]["binder"]["two_point"]) == {"y", "x", "radial"}
    blocks = np.lib.stride_tricks.sliding_window_view(image.values, (2, 2)).reshape(39, 43, 4)
    points = sum(len(set(block)) == 3 for row in blocks.tolist() for block in row)
    assert found["triples"]["void-active-binder"]["line_density"] == pytest.approx(
        points / (39 * 43)
    )


def test_flat_names_for_lists_of_figures(three):
    numbers, told = phase_numbers(three), describe_phases(three, r_max=5)
    assert numbers["largest_fraction_binder"] == told["phases"]["binder"]["largest_fraction"]
    assert numbers["thickness_binder"] == told["phases"]["binder"]["thickness"]
    assert numbers["percolating_fraction_active"] == np.mean(
        list(told["phases"]["active"]["percolating_fraction"].values())
    )
    assert numbers["contact_active_binder"] == told["pairs"]["active-binder"]["contact"]
    assert numbers["triple_line_density"] == told["triples"]["void-active-binder"]["line_density"]
    assert numbers["triple_line_active"] == told["triples"]["void-active-binder"]["active_share"]
    # What `describe` tells of the void, or of the solid phases together.
    assert not {"specific_surface_void", "thickness_void", "mean_curvature_void"} & set(numbers)
    assert not any("thickness" in name for name in phase_numbers(three, level="quick"))
    curves = phase_curves(three, r_max=5)
    assert curves["two_point_binder"].tolist() == told["phases"]["binder"]["two_point"]["radial"]
    assert curves["two_point_binder_z"].tolist() == told["phases"]["binder"]["two_point"]["z"]
    assert curves["lineal_path_void"].tolist() == told["phases"]["void"]["lineal_path"]
    assert (
        curves["cross_active_binder"].tolist()
        == told["pairs"]["active-binder"]["cross_correlation"]
    )
    assert "two_point_void" not in curves
    assert set(curves) - set(phase_curves(three, r_max=5, cross=False)) == {
        *("cross_void_active", "cross_void_binder", "cross_active_binder")
    }


def test_flat_names_of_two_phases_repeat_nothing(two):
    numbers = phase_numbers(two)
    assert set(numbers) == {
        *(
            "euler_density_void",
            "components_void",
            "floating_void",
            "floating_voxels_void",
            "largest_fraction_void",
        ),
        *("percolates_void", "percolating_fraction_void"),
    }
    assert set(phase_curves(two, r_max=5)) == {"lineal_path_void"}
    four = phase_numbers(
        tb.Image(blobs(4, (14, 14, 14)), "labels", phases=("a", "b", "c", "d")), level="quick"
    )
    assert {name for name in four if name.startswith("triple_line_density")} == {
        f"triple_line_density_{three}" for three in ("a_b_c", "a_b_d", "a_c_d", "b_c_d")
    }


def test_refusals(three):
    with pytest.raises(InputError, match="unknown phase 'bindr': did you mean 'binder'"):
        describe_phases(three, phase="bindr")
    with pytest.raises(InputError, match="level"):
        describe_phases(three, level="some")
    with pytest.raises(InputError, match="r_max"):
        describe_phases(three, r_max=0)
    with pytest.raises(InputError, match="labels"):
        describe_phases(tb.Image(np.zeros((4, 4)), "grey"))


def test_a_void_that_is_not_named_is_said_without_options_of_the_command_line():
    values = blobs(3, (12, 12, 12))
    image = tb.Image(values, "labels", phases=("pore", "active", "binder"))
    with pytest.raises(UnnamedVoidError, match="pore, active, binder is named void") as caught:
        specific_surface(image)
    assert "--" not in str(caught.value) and "phase=" in str(caught.value)
    again = pickle.loads(pickle.dumps(caught.value))
    assert str(again) == str(caught.value) and again.phase_helps
    with pytest.raises(UnnamedVoidError) as caught:
        tb.finish.connect(image, phase="active")
    assert not pickle.loads(pickle.dumps(caught.value)).phase_helps and "(phase=" not in str(
        caught.value
    )

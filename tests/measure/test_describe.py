"""`describe`: the words scripts rely on, plain JSON, and units."""

import json

import numpy as np
import pytest

import trabecula as tb
from trabecula.measure import describe, thickness, two_point

WORDS = {
    *(
        "porosity",
        "specific_surface",
        "euler",
        "mean_curvature",
        "components",
        "floating",
        "largest_fraction",
    ),
    *(
        "percolates",
        "two_point",
        "lineal_path",
        "chord_length",
        "pore_size",
        "thickness",
        "anisotropy",
    ),
    *("diffusivity", "permeability", "stiffness"),
}
POWERS = {
    "thickness": 1,
    "pore_size": 1,
    "chord_length": 1,
    "specific_surface": -1,
    "mean_curvature": -2,
}
POWERS |= {"euler_density": -3, "porosity": 0, "components": 0}


@pytest.fixture(scope="module")
def foam() -> tb.Image:
    noise = np.random.default_rng(5).random((30, 32, 34))
    for axis in range(3):
        noise = noise + np.roll(noise, 1, axis) + np.roll(noise, 2, axis)
    return tb.Image(noise > np.median(noise), "labels", spacing=(2.0, 1.0, 1.0), unit="um")


def test_words_and_values(foam):
    result = describe(foam)
    assert set(result) >= WORDS
    assert result == json.loads(json.dumps(result, allow_nan=False))
    assert (
        result["r_max"] == 15
        and len(result["two_point"]["radial"]) == len(result["lineal_path"]) == 16
    )
    assert set(result["two_point"]) == {"z", "y", "x", "radial"} and set(result["percolates"]) == {
        "z",
        "y",
        "x",
    }
    assert result["thickness"] == thickness(foam) and result["unit"] == "um"
    assert result["two_point"]["y"] == two_point(foam, r_max=15, axis=1).tolist()
    assert tb.describe is describe and tb.measure.describe is describe


def test_lengths_follow_the_spacing(foam):
    coarse = tb.Image(foam.values, "labels", spacing=(20.0, 10.0, 10.0), unit="nm")
    fine, large = describe(foam), describe(coarse)
    for name, power in POWERS.items():
        assert large[name] == pytest.approx(fine[name] * 10.0**power, rel=1e-4)


@pytest.mark.parametrize("value", [0, 1])
def test_one_phase_alone_gives_null_and_never_nan(value):
    result = describe(np.full((6, 6, 6), value, np.uint8))
    json.dumps(result, allow_nan=False)
    assert result["porosity"] == 1 - value
    assert result["pore_size" if value == 0 else "thickness"] is None


@pytest.mark.slow
def test_levels(foam):
    quick, usual, full = (
        describe(foam, r_max=4, level=level) for level in ("quick", "default", "full")
    )
    assert set(quick) == set(usual) == set(full)
    assert quick["thickness"] is quick["two_point_cluster"] is usual["diffusivity"] is None
    assert quick["porosity"] == usual["porosity"] == full["porosity"]
    json.dumps(full, allow_nan=False)
    for name in ("diffusivity", "tortuosity", "conductivity", "permeability"):
        assert set(full[name]) == {"z", "y", "x"} and all(
            value > 0 for value in full[name].values()
        )
    assert full["tortuosity"]["z"] == pytest.approx(full["porosity"] / full["diffusivity"]["z"])
    assert np.shape(full["stiffness"]["matrix"]) == (6, 6)
    told = full["physics"]
    assert told["stiffness"]["all"]["converged"] and all(
        told["permeability"][axis]["converged"] for axis in "zyx"
    )
    assert abs(told["diffusivity"]["z"]["halving"]) < 1
    with pytest.raises(tb.errors.UnknownNameError):
        describe(foam, level="most")


@pytest.mark.whole
def test_void_that_does_not_percolate_is_said_to_be_infinitely_tortuous():
    slab = np.zeros((12, 12, 12), np.uint8)
    slab[5] = 1
    result = describe(slab, r_max=3, level="full", box=10)
    assert (
        result["diffusivity"]["z"] == result["permeability"]["z"] == 0
        and result["tortuosity"]["z"] is None
    )
    assert result["tortuosity"]["x"] == pytest.approx(1) and result["conductivity"][
        "x"
    ] == pytest.approx(0.1)
    assert (
        any("along z" in note and "infinite" in note for note in result["notes"])
        and len(result["notes"]) == 1
    )


def test_texture_of_what_holds_no_labels():
    rng = np.random.default_rng(0)
    result = describe(tb.Image(rng.integers(0, 256, (40, 30)).astype(np.uint8), "grey"))
    assert result == json.loads(json.dumps(result, allow_nan=False))
    assert sum(result["ten_bins"]) == pytest.approx(1) and len(result["ten_bins"]) == 10
    assert (
        result["autocorrelation"]["y"][0] == pytest.approx(1)
        and abs(result["autocorrelation"]["x"][3]) < 0.2
    )
    assert abs(result["mean"] - 127.5) < 10 and set(result["autocorrelation"]) == {"y", "x"}


def test_two_dimensions():
    result = describe((np.random.default_rng(0).random((40, 40)) < 0.4).astype(np.uint8))
    assert set(result["percolates"]) == {"y", "x"} and result["r_max"] == 20


def test_refusals():
    with pytest.raises(tb.errors.InputError, match="at least 2 voxels"):
        describe(np.zeros((1, 8, 8), np.uint8))
    with pytest.raises(tb.errors.InputError, match="r_max"):
        describe(np.eye(8, dtype=np.uint8), r_max=0)


@pytest.mark.whole
def test_real_bone(data):
    import tifffile

    result = describe(
        tb.Image(
            tifffile.imread(data / "trabecular_bone_a.tif")[40:120, 40:120, 40:120] > 0,
            "labels",
            spacing=0.05,
            unit="mm",
        ),
        r_max=30,
    )
    assert (
        0.1 < result["thickness"] < 0.4
        and result["largest_fraction"] > 0.9
        and all(result["percolates"].values())
    )


def test_every_value_is_plain_python():
    """Check that no NumPy scalar is left: some versions of `json` refuse them."""
    volume = np.random.default_rng(0).integers(0, 2, (30, 30, 30)).astype(np.uint8)

    def leaves(value):
        if isinstance(value, dict):
            return [leaf for part in value.values() for leaf in leaves(part)]
        if isinstance(value, list):
            return [leaf for part in value for leaf in leaves(part)]
        return [value]

    assert {type(leaf) for leaf in leaves(describe(volume, r_max=5))} <= {
        int,
        float,
        bool,
        str,
        type(None),
    }

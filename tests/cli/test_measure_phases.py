"""`measure --phase`, and advice that names options that the verb has."""

import json

import numpy as np
import pytest
from scipy import ndimage

import trabecula as tb
from commands import attempt, refused, trabecula

NAMES = ("pore", "active", "binder")


@pytest.fixture
def cathode(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(4)
    values = np.argmax(
        [ndimage.gaussian_filter(rng.normal(size=(24, 24, 24)), 2) for _ in NAMES], axis=0
    )
    image = tb.Image(values, "labels", spacing=0.3, unit="um", phases=NAMES)
    tb.write(image, "cathode.zarr")
    np.save("plain.npy", values.astype(np.uint8))
    return image


def test_an_image_without_a_void_is_measured(cathode):
    found = json.loads(
        trabecula(
            "measure", "plain.npy", "--kind", "labels", "--phases", *NAMES, "--quick", "--json"
        ).out
    )
    assert (
        found["porosity"] is None
        and set(found["phases"]) == set(NAMES)
        and len(found["notes"]) == 1
    )
    printed = trabecula("measure", "cathode.zarr", "--quick").out
    assert (
        "pore-active-binder" in printed
        and "No phase of pore, active, binder is named void" in printed
    )


def test_one_phase_or_all(cathode):
    every = json.loads(trabecula("measure", "cathode.zarr", "--phase", "all", "--json").out)
    one = json.loads(trabecula("measure", "cathode.zarr", "--phase", "binder", "--json").out)
    told = tb.measure.describe_phases(cathode)
    assert {name: every[name] for name in told} == told and every["unit"] == "um"
    assert one["phases"] == {"binder": told["phases"]["binder"]} and one["triples"] == {}
    assert set(one["pairs"]) == {"pore-binder", "active-binder"}
    lines = trabecula("measure", "cathode.zarr", "--phase", "all").out.splitlines()
    (heads,) = (line.split() for line in lines if line.startswith("each phase"))
    assert heads == ["each", "phase", *NAMES]
    (largest,) = (line.split() for line in lines if line.startswith("largest_fraction"))
    assert float(largest[3]) == pytest.approx(
        told["phases"]["binder"]["largest_fraction"], rel=1e-5
    )


def test_one_phase_of_what_is_read_in_slabs(cathode):
    long = np.tile(cathode.values, (6, 1, 1))
    tb.write(tb.Image(long, "labels", spacing=0.3, unit="um", phases=NAMES), "long.zarr")
    words = ("measure", "long.zarr", "--quick", "--json", "--phase")
    whole = json.loads(trabecula(*words, "binder").out)
    tight = json.loads(trabecula(*words, "binder", "--memory", "0.0006").out)
    assert tight["phases"] == whole["phases"] and set(tight["pairs"]) == set(whole["pairs"])
    assert any("cross_correlation" in note for note in tight["notes"])
    output = attempt(*words, "bindr", "--memory", "0.0006")
    assert output.status == 2 and "unknown phase 'bindr'" in output.lines[-1]


def test_refusals(cathode):
    assert "did you mean 'binder'" in refused("measure", "cathode.zarr", "--phase", "bindr")
    assert "leave out --full" in refused("measure", "cathode.zarr", "--phase", "binder", "--full")


@pytest.mark.parametrize(
    ("words", "options"),
    [
        (("verify", "cathode.zarr", "cathode.zarr", "--quick"), {"--phases"}),
        (("check", "cathode.zarr"), {"--phase", "--phases"}),
        (
            ("field", "measure", "cathode.zarr", "--size", "8", "--out", "f.npy"),
            {"--phase", "--phases"},
        ),
        (("export", "cathode.zarr", "--out", "part.stl"), {"--phase"}),
        (("finish", "cathode.zarr", "--connect", "--out", "part.zarr"), set()),
        (("finish", "cathode.zarr", "--connect", "--phase", "binder", "--out", "part.zarr"), set()),
    ],
)
def test_advice_on_a_missing_void_names_options_of_the_verb(cathode, words, options):
    message = refused(*words)
    assert "no phase of pore, active, binder is named void" in message
    advised = {word.strip("(),") for word in message.split() if word.startswith(("--", "(--"))}
    assert advised == options
    shown = trabecula_help(words[:2] if words[0] == "field" else words[:1])
    assert all(f"{option} " in shown for option in options)


def trabecula_help(words):
    return attempt(*words, "--help").out


def test_the_advice_helps(cathode):
    trabecula("export", "cathode.zarr", "--out", "part.stl", "--phase", "active")
    trabecula(
        "field", "measure", "cathode.zarr", "--size", "8", "--out", "f.npy", "--phase", "active"
    )
    trabecula(
        "verify", "cathode.zarr", "plain.npy", "--quick", "--phases", "void", "active", "binder"
    )

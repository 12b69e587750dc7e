"""Whatever is typed, and whatever is in a file: a result, or one line and exit status 2. Never a
traceback.
"""

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import trabecula as tb
from commands import SMALL, attempt, contents
from trabecula.cli.main import VERBS

few = settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])

# What a shell can pass: no NUL, and bytes that are no UTF-8 as surrogates.
words = st.text(
    st.characters(exclude_characters="\0", codec="utf-8"), max_size=12
) | st.sampled_from(
    [
        "-",
        "--",
        "-1",
        "0",
        "1e9",
        "nan",
        "inf",
        "--out",
        "--json",
        "--set",
        "1" * 5000,
        "a" * 400,
        "../..",
        "sample:",
        "\udcff",
    ]
)
numbers = st.integers().map(str) | st.floats().map(str) | words


@pytest.fixture(scope="module")
def folder(tmp_path_factory, bone):
    """A folder with a scan and a file made from it."""
    place = tmp_path_factory.mktemp("words")
    np.save(place / "scan.npy", tb.crop(bone, 20).values)
    here = Path.cwd()
    os.chdir(place)
    assert attempt("generate", "scan.npy", "--shape", 12, "--out", "made.npy", *SMALL).status == 0
    yield place
    os.chdir(here)


def told(*line):
    """Run; the exit status is 0, or 2 with one line."""
    output = attempt(*line)
    assert output.status in (0, 2), (line, output)
    if output.status == 2:
        assert len(output.lines) == 1 and output.lines[0].startswith("trabecula: "), (line, output)
        assert output.out == ""
    return output


@pytest.mark.whole
@few
@given(
    st.sampled_from([*VERBS, "generat", ""]).filter(lambda verb: verb not in ("demo", "bench")),
    st.lists(words, max_size=4),
)
def test_any_words_after_a_verb(folder, verb, rest):
    before = contents(folder)
    told(verb, *rest)
    assert contents(folder) == before


@pytest.mark.slow
@few
@given(st.lists(numbers, min_size=1, max_size=3), numbers, numbers, numbers, numbers)
def test_any_values_of_the_options_of_generate(folder, shape, seed, memory, threads, value):
    before = contents(folder)
    options = ("--seed", seed, "--memory", memory, "--threads", threads, "--set", f"clip={value}")
    told("plan", "scan.npy", *SMALL, *options, "--shape", *shape)
    for option in range(0, len(options), 2):
        told("plan", "scan.npy", "--shape", 12, *SMALL, *options[option : option + 2])
    told("plan", "scan.npy", *SMALL, "--shape", *shape)
    assert contents(folder) == before


@pytest.mark.slow
@few
@given(
    numbers,
    st.lists(numbers, min_size=1, max_size=3),
    st.lists(numbers, min_size=1, max_size=3),
    words,
)
def test_any_values_of_the_options_of_reading(folder, threshold, spacing, crop, text):
    told("plan", "scan.npy", "--shape", 12, *SMALL, "--kind", "grey", "--threshold", threshold)
    for option in (
        ["--spacing", *spacing],
        ["--crop", *crop],
        ["--unit", text],
        ["--kind", text],
        ["--phases", text, text + "x"],
    ):
        told("plan", "scan.npy", "--shape", 12, *SMALL, *option)


volumes = arrays.arrays(
    np.uint8,
    arrays.array_shapes(min_dims=2, max_dims=3, min_side=1, max_side=9),
    elements=st.integers(0, 2),
)


@pytest.mark.whole
@few
@given(volumes, volumes)
def test_any_small_volume_is_measured_and_judged_without_nan(folder, values, other):
    def plain(value):
        if isinstance(value, dict):
            return all(map(plain, value.values()))
        if isinstance(value, list):
            return all(map(plain, value))
        return value is None or isinstance(value, (bool, int, str)) or math.isfinite(value)

    try:
        np.save("any.npy", values)
        np.save("other.npy", other)
        output = told("measure", "any.npy", "--json")
        if output.status == 0:
            found = json.loads(output.out)
            assert plain(found) and 0 <= found["porosity"] <= 1
        output = told("verify", "any.npy", "other.npy", "--json")
        if output.status == 0:
            assert plain(json.loads(output.out))
        told("finish", "any.npy", "--connect", "--out", "part.npy")
        told("export", "any.npy", "--out", "part.stl")
    finally:
        for name in ("any.npy", "other.npy", "part.npy", "part.npy.json", "part.stl"):
            (folder / name).unlink(missing_ok=True)


plain_json = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=4,
)


@pytest.mark.whole
@settings(few, max_examples=30)  # two commands each
@given(st.data())
def test_any_change_of_a_recipe_is_told(folder, data):
    """Somewhere in the recipe of a file stands something else, or nothing."""
    sidecar = folder / "made.npy.json"
    whole = sidecar.read_text()
    try:
        changed = json.loads(whole)
        place = changed["trabecula"]["recipe"]
        while True:
            if not place:
                break
            name = data.draw(
                st.sampled_from(sorted(place) if isinstance(place, dict) else range(len(place)))
            )
            if isinstance(place[name], (dict, list)) and data.draw(st.booleans()):
                place = place[name]
            elif data.draw(st.booleans()):
                place[name] = data.draw(plain_json)
                break
            else:
                del place[name]
                break
        sidecar.write_text(json.dumps(changed))
        told("rerun", "made.npy")
        told("measure", "made.npy")
    finally:
        sidecar.write_text(whole)
    assert attempt("rerun", "made.npy").status == 0

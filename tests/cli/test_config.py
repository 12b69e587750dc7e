"""Options from a file: every verb, TOML, JSON and recipes; the command line wins."""

import csv
import json

import numpy as np
import pytest

from commands import refused, trabecula
from trabecula.cli.main import VERBS, _verb_parser, whole_parser


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path.name


NOISE = 'method = "noise"\nshape = 16\nseed = 3\nout = "a.npy"\n'


def test_a_file_stands_for_the_options(here):
    file = write(here / "c.toml", NOISE + "[generate.set]\nporosity = 0.7\n")
    by_file = trabecula("generate", "--config", file)
    words = (
        "--method",
        "noise",
        "--shape",
        16,
        "--seed",
        3,
        "--set",
        "porosity=0.7",
        "--out",
        "b.npy",
    )
    assert by_file.sha256 == trabecula("generate", *words).sha256


def test_the_command_line_wins(here):
    file = write(here / "c.toml", NOISE + "[generate.set]\noctaves = 2\n")
    other = trabecula("generate", "--config", file, "--seed", 4, "--set", "octaves=1", "--json")
    step = json.loads(other.out)["recipe"][0]
    assert step["request"]["seed"] == 4 and step["settings"]["octaves"] == 1
    assert step["request"]["shape"] == [16, 16, 16]


def test_files_and_exemplars_have_names_too(here):
    np.save(here / "x.npy", np.ones((4, 4, 4), np.uint8))
    file = write(here / "c.json", '{"file": "x.npy", "quick": true, "phases": ["void", "solid"]}')
    assert "porosity" in trabecula("measure", "--config", file).out
    # an option that excludes one of the file drops it
    assert "unrecognized" not in trabecula("measure", "--config", file, "--full", "--box", 4).err


@pytest.mark.whole
def test_a_recipe_is_a_file_of_options(here):
    made = trabecula(
        *("generate", "sample:bone", "--crop", 24, "--method", "noise", "--shape", 12),
        *("--seed", 9, "--set", "reach=6", "--periodic", "z", "--out", "a.npy", "--json"),
    )
    found = json.loads(made.out)
    for text in (found, found["recipe"]):
        file = write(here / "r.json", json.dumps(text))
        again = trabecula("generate", "--config", file, "--out", "b.npy")
        assert again.sha256 == found["sha256"]
    other = trabecula("generate", "sample:foam", "--config", file, "--out", "c.npy", "--crop", 24)
    assert other.sha256 != found["sha256"]
    assert "first step is for generate" in refused("measure", "--config", file)


@pytest.mark.parametrize(
    "text, message",
    [
        ("seeed = 3", "did you mean 'seed'"),
        ("quiet = 1", "is a switch"),
        ("seed = [1, 2]", "takes one value, not 2"),
        ('threads = "many"', "threads: invalid int value"),
        ("seed = ", "neither TOML nor JSON"),
        ("config = 'x'", "unknown option 'config'"),
    ],
)
def test_what_a_file_cannot_say_is_refused(here, text, message):
    assert message in refused("generate", "--config", write(here / "c.toml", text))


def test_a_file_that_is_not_there_is_named():
    assert "no.toml: No such file" in refused("samples", "--config", "no.toml")


def test_every_verb_takes_a_file():
    for verb in VERBS:
        options = _verb_parser(whole_parser(), verb)._option_string_actions
        assert "--config" in options, verb


def rows_of(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.whole
def test_figures_as_a_table_have_values_and_units(here):
    found = json.loads(
        trabecula("measure", "sample:bone", "--crop", 24, "--quick", "--csv", "m.csv", "--json").out
    )
    rows = rows_of(here / "m.csv")
    one = {(row["figure"], row["position"]): row for row in rows}
    assert float(one["porosity", ""]["value"]) == found["porosity"]
    assert one["specific_surface", ""]["unit"] == "1/um"
    assert one["euler_density", ""]["unit"] == "1/um^3" and one["porosity", ""]["unit"] == ""
    curve = [float(r["value"]) for r in rows if r["figure"] == "two_point.radial"]
    assert curve == found["two_point"]["radial"]
    assert "should end in .csv" in refused("inspect", "sample:bone", "--csv", "m.txt")


@pytest.mark.whole
def test_a_certificate_as_a_table(here):
    found = json.loads(
        trabecula(
            *("verify", "sample:bone", "sample:bone", "--crop", 32, "--quick", "--r-max", 8),
            *("--csv", "v.csv", "--json"),
        ).out
    )
    rows = {row["figure"]: row for row in rows_of(here / "v.csv")}
    assert set(rows) == set(found["metrics"])
    for name, one in found["metrics"].items():
        assert rows[name]["verdict"] == {True: "pass", False: "fail", None: ""}[one["pass"]]
        if one["real_band"]:
            assert float(rows[name]["real_low"]) == one["real_band"][0]
    assert rows["specific_surface"]["unit"] == "1/um"

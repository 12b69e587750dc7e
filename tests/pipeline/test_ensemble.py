"""Ensembles: what is drawn for members, and their files."""

import json

import numpy as np
import pytest

import trabecula as tb
from commands import refused, trabecula
from trabecula.errors import InputError
from trabecula.pipeline.ensemble import draw_members
from trabecula.pipeline.members import generate_members, member_path

SIDE = (24, 24, 24)


@pytest.fixture(scope="module")
def rock():
    """Cubes of 6 voxels, 4 a side of a member."""
    cells = np.random.default_rng(4).random((8, 8, 8)) < 0.4
    return tb.labels(np.kron(cells, np.ones((6, 6, 6))).astype(np.uint8))


@pytest.fixture(scope="module")
def model(rock):
    return tb.method("texture", preset="fast").fit(rock)


def test_members_have_the_porosities_that_are_drawn_and_spread_0_gives_the_exemplars(model, rock):
    members = draw_members(model, tb.Request(SIDE, seed=3), count=4)
    asked = [request.target["porosity"] for request in members.requests]
    assert [request.seed for request in members.requests] == [3, 4, 5, 6]
    assert len(set(asked)) == 4
    made = list(tb.ensemble(model, SIDE, count=2, seed=3))
    for image, porosity in zip(made, asked, strict=False):
        assert 1 - image.values.mean() == pytest.approx(porosity, abs=1 / image.values.size)
    (plain,) = tb.ensemble(model, SIDE, count=1, seed=3, spread=0)
    np.testing.assert_array_equal(plain.values, model.generate(SIDE, seed=3).values)


def test_a_smaller_member_scatters_more(model):
    spread = {
        side: draw_members(model, tb.Request((side,) * 3), count=2).spread for side in (24, 48)
    }
    small, large = (np.sqrt(spread[side].covariance[0, 0]) for side in (24, 48))
    assert small / large == pytest.approx(8**0.5, rel=0.35)  # of independent cubes


def test_a_form_scatters_as_a_box_of_its_volume(model):
    mask = np.zeros((48, 48, 48), bool)
    mask[:24] = mask[:, :24] = True
    whole = draw_members(model, tb.Request((48,) * 3), count=2).spread.covariance[0, 0]
    part = draw_members(model, tb.Request(None, mask=mask), count=2).spread.covariance[0, 0]
    assert whole < part < 2 * whole


def test_windows_of_unlimited_material_scatter_by_themselves(rock):
    noise = tb.method("noise").fit(rock)
    members = draw_members(noise, tb.Request(SIDE), count=3)
    assert members.spread is None and "scatter by themselves" in members.note
    assert all(not request.target for request in members.requests)


def test_a_picture_does_not_say_how_volumes_scatter(rock):
    picture = tb.Image(rock.values[0], "labels", phases=rock.phases)
    model = tb.method("kopf").fit(picture)
    assert "a picture does not say" in draw_members(model, tb.Request(SIDE), count=2).note


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"count": 0}, "count=0"),
        ({"count": 2, "spread": -1}, "spread=-1"),
        ({"count": 2, "target": {"porosity": 0.5}}, "has a target"),
    ],
)
def test_what_leaves_nothing_to_draw_is_refused(model, given, said):
    with pytest.raises(InputError, match=said):
        tb.ensemble(model, SIDE, **given)


def test_files_of_an_ensemble_are_remade_one_by_one_and_kept_where_they_are_there(
    tmp_path, model, monkeypatch
):
    members = draw_members(model, tb.Request(SIDE, seed=7), count=3)
    pattern = str(tmp_path / "rock-{seed}.npy")
    monkeypatch.setenv("TRABECULA_THREADS", "1")
    first = generate_members(model, members, pattern)
    assert first.manifest == tmp_path / "rock-ensemble.json"
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.npy")}
    lost = member_path(pattern, members.requests[1])
    digest = first.members[1].sha256
    lost.unlink()
    again = generate_members(model, members, pattern)
    assert again.members[1].sha256 == digest
    assert {path for path, time in before.items() if path.stat().st_mtime_ns != time} == {lost}
    told = json.loads(first.manifest.read_text())
    assert [one["seed"] for one in told["members"]] == [7, 8, 9]
    assert told["members"][0]["target"] == dict(members.requests[0].target)
    assert told["fractions"]["solid"]["standard_deviation"] > 0


def test_other_members_in_their_place_are_made_anew(tmp_path, model):
    pattern = str(tmp_path / "{seed}.npy")
    request = tb.Request(SIDE, seed=7)
    plain = generate_members(model, draw_members(model, request, count=1, spread=0), pattern)
    drawn = generate_members(model, draw_members(model, request, count=1), pattern)
    assert plain.members[0].sha256 != drawn.members[0].sha256
    assert tb.read(tmp_path / "7.npy").recipe.steps[-1]["sha256"] == drawn.members[0].sha256


@pytest.mark.whole
def test_processes_change_no_voxel(tmp_path, model):
    members = draw_members(model, tb.Request(SIDE, seed=1), count=2)
    with tb.threads(1):
        alone = generate_members(model, members, str(tmp_path / "alone-{seed}.npy"))
    with tb.threads(2):
        beside = generate_members(model, members, str(tmp_path / "beside-{seed}.npy"))
    assert [one.sha256 for one in alone.members] == [one.sha256 for one in beside.members]


def test_the_command_makes_an_ensemble_whose_members_can_be_made_again(tmp_path):
    words = ["generate", "sample:bone", "--method", "texture", "--preset", "fast", "--crop", 32]
    words += ["--shape", 24, "--seed", 2, "--threads", 1]
    words += ["--count", 2, "--out", tmp_path / "{seed}.npy", "--json"]
    made = json.loads(trabecula(*words).out)
    assert [one["file"] for one in made["members"]] == ["2.npy", "3.npy"]
    again = trabecula("rerun", tmp_path / "3.npy")
    assert made["members"][1]["sha256"] == again.sha256


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--count", 2, "--out", "rock.zarr"], "{seed}"),
        (["--count", 2, "--out", "s3://rock/{seed}.zarr"], "is an address"),
        (["--count", "two", "--out", "{seed}.zarr"], "--count two"),
        (["--spread", 1, "--out", "rock.zarr"], "add --count"),
        (["--count", 2, "--resume", "rock.zarr"], "without --resume"),
    ],
)
def test_options_that_do_not_fit_are_refused_in_one_line(words, said):
    assert said in refused("generate", "sample:bone", "--shape", 24, "--method", "texture", *words)

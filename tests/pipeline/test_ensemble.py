"""Ensembles: what is drawn for members, and their files."""

import json

import numpy as np
import pytest

import trabecula as tb
from commands import refused, trabecula
from trabecula.errors import InputError
from trabecula.io import files
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


def porosities(members):
    return [member.request.target["porosity"] for member in members.members]


@pytest.mark.whole
def test_members_are_the_parts_of_volumes_with_the_porosities_that_are_drawn(model):
    members = draw_members(model, tb.Request(SIDE, seed=3), count=10)
    assert [member.seed for member in members.members] == list(range(3, 13))
    assert [member.request.seed for member in members.members] == [3] * 8 + [11] * 2
    assert len({member.corner for member in members.members[:8]}) == 8
    made = list(tb.ensemble(model, SIDE, count=9, seed=3))
    asked = porosities(members)
    assert len(set(asked)) == 2 and len({image.recipe.steps[-1]["sha256"] for image in made}) == 9
    mean = np.mean([image.values.mean() for image in made[:8]])
    assert 1 - mean == pytest.approx(asked[0], abs=1 / made[0].values.size)
    volume = model.generate(48, seed=3, target={"porosity": asked[0]}).values
    np.testing.assert_array_equal(made[6].values, volume[24:, 24:, :24])
    np.testing.assert_array_equal(made[1].values, volume[:24, :24, 24:])
    first, *_ = tb.ensemble(model, SIDE, count=1, seed=3)
    np.testing.assert_array_equal(first.values, made[0].values)


@pytest.mark.whole
def test_members_by_themselves_have_porosities_of_their_own_and_spread_0_the_exemplars(model):
    members = draw_members(model, tb.Request(SIDE, seed=3), count=4, alone=True)
    asked = porosities(members)
    assert [member.request.seed for member in members.members] == [3, 4, 5, 6]
    assert len(set(asked)) == 4
    made = list(tb.ensemble(model, SIDE, count=2, seed=3, alone=True))
    for image, porosity in zip(made, asked, strict=False):
        assert 1 - image.values.mean() == pytest.approx(porosity, abs=1 / image.values.size)
    (plain,) = tb.ensemble(model, SIDE, count=1, seed=3, spread=0)
    np.testing.assert_array_equal(plain.values, model.generate(SIDE, seed=3).values)


@pytest.mark.parametrize(
    ("given", "spread"), [({"periodic": True}, 1), ({"mask": np.ones(SIDE, bool)}, 1), ({}, 0.5)]
)
def test_what_cannot_be_a_part_is_made_by_itself(model, given, spread):
    members = draw_members(model, tb.Request(SIDE, **given), count=3, spread=spread)
    assert all(member.corner is None and member.shape == SIDE for member in members.members)
    assert len(set(porosities(members))) == 3


def test_a_smaller_member_scatters_more(model):
    spread = {
        side: draw_members(model, tb.Request((side,) * 3), count=2, alone=True).spread
        for side in (24, 48)
    }
    small, large = (np.sqrt(spread[side].covariance[0, 0]) for side in (24, 48))
    assert small / large == pytest.approx(8**0.5, rel=0.35)  # of independent cubes


def test_a_form_scatters_as_a_box_of_its_volume(model):
    mask = np.zeros((48, 48, 48), bool)
    mask[:24] = mask[:, :24] = True
    box = draw_members(model, tb.Request((48,) * 3), count=2, alone=True)
    whole = box.spread.covariance[0, 0]
    part = draw_members(model, tb.Request(None, mask=mask), count=2).spread.covariance[0, 0]
    assert whole < part < 2 * whole


def test_windows_of_unlimited_material_scatter_by_themselves(rock):
    noise = tb.method("noise").fit(rock)
    members = draw_members(noise, tb.Request(SIDE), count=3)
    assert members.spread is None and "scatter by themselves" in members.note
    assert all(not member.request.target for member in members.members)


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


@pytest.mark.parametrize("alone", [False, True])
def test_files_of_an_ensemble_are_remade_one_by_one_and_kept_where_they_are_there(
    tmp_path, model, monkeypatch, alone
):
    members = draw_members(model, tb.Request(SIDE, seed=7), count=3, alone=alone)
    pattern = str(tmp_path / "rock-{seed}.nrrd")
    monkeypatch.setenv("TRABECULA_THREADS", "1")
    first = generate_members(model, members, pattern)
    assert first.manifest == tmp_path / "rock-ensemble.json"
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.nrrd")}
    lost = member_path(pattern, 8)
    digest = first.members[1].sha256
    lost.unlink()
    again = generate_members(model, members, pattern)
    assert again.members[1].sha256 == digest
    assert {path for path, time in before.items() if path.stat().st_mtime_ns != time} == {lost}
    assert sorted(path.name for path in tmp_path.glob("*")) == [
        "rock-7.nrrd", "rock-8.nrrd", "rock-9.nrrd", "rock-ensemble.json",
    ]  # fmt: skip
    told = json.loads(first.manifest.read_text())
    assert [one["seed"] for one in told["members"]] == [7, 8, 9] and told["shape"] == list(SIDE)
    member = members.members[2]
    assert told["members"][2]["target"] == dict(member.request.target)
    volume = {"seed": 7, "shape": [48, 48, 48], "corner": [0, 24, 0]}
    assert told["members"][2]["volume"] == (None if alone else volume)
    assert told["fractions"]["solid"]["standard_deviation"] > 0
    made = tb.read(tmp_path / "rock-9.nrrd")
    assert made.shape == SIDE and made.recipe.steps[-1]["sha256"] == told["members"][2]["sha256"]


def test_a_volume_that_is_there_is_not_made_again(tmp_path, model, monkeypatch):
    members = draw_members(model, tb.Request(SIDE, seed=7), count=2)
    pattern = str(tmp_path / "{seed}.nrrd")
    monkeypatch.setenv("TRABECULA_THREADS", "1")
    write = files.write

    def stop(image, path, **more):
        if str(path).endswith("8.nrrd"):
            raise KeyboardInterrupt
        return write(image, path, **more)

    monkeypatch.setattr(files, "write", stop)
    with pytest.raises(KeyboardInterrupt):
        generate_members(model, members, pattern)
    assert sorted(path.name for path in tmp_path.glob("*")) == ["7-volume.zarr", "7.nrrd"]
    monkeypatch.setattr(files, "write", write)
    monkeypatch.setattr(type(model), "generate", None)
    made = generate_members(model, members, pattern)
    assert [one.path.name for one in made.members] == ["7.nrrd", "8.nrrd"]
    assert not (tmp_path / "7-volume.zarr").exists()


def test_members_in_folders_of_their_own_leave_nothing_else(tmp_path, model):
    members = draw_members(model, tb.Request(SIDE, seed=7), count=2)
    made = generate_members(model, members, str(tmp_path / "{seed}" / "rock.nrrd"))
    assert [one.path.parent.name for one in made.members] == ["7", "8"]
    left = sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*"))
    assert left == ["7", "7/rock.nrrd", "8", "8/rock.nrrd", "ensemble", "ensemble/rock.json"]


def test_other_members_in_their_place_are_made_anew(tmp_path, model):
    pattern = str(tmp_path / "{seed}.npy")
    request = tb.Request(SIDE, seed=7)
    plain = generate_members(model, draw_members(model, request, count=1, spread=0), pattern)
    drawn = generate_members(model, draw_members(model, request, count=1), pattern)
    assert plain.members[0].sha256 != drawn.members[0].sha256
    assert tb.read(tmp_path / "7.npy").recipe.steps[-1]["sha256"] == drawn.members[0].sha256


@pytest.mark.whole
def test_processes_change_no_voxel(tmp_path, model):
    members = draw_members(model, tb.Request(SIDE, seed=1), count=2, alone=True)
    with tb.threads(1):
        alone = generate_members(model, members, str(tmp_path / "alone-{seed}.npy"))
    with tb.threads(2):
        beside = generate_members(model, members, str(tmp_path / "beside-{seed}.npy"))
    assert [one.sha256 for one in alone.members] == [one.sha256 for one in beside.members]


@pytest.mark.whole
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
        (["--alone", "--out", "rock.zarr"], "add --count"),
        (["--count", 2, "--resume", "rock.zarr"], "without --resume"),
    ],
)
def test_options_that_do_not_fit_are_refused_in_one_line(words, said):
    assert said in refused("generate", "sample:bone", "--shape", 24, "--method", "texture", *words)

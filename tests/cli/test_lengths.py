"""Lengths as a user types them: --spacing, --unit, --scale where something is written or held
against millimetres.
"""

import json

import numpy as np
import pytest

import trabecula as tb
from commands import SMALL, refused, trabecula


@pytest.fixture
def place(tmp_path, monkeypatch, bone):
    """Make a volume without a size, a form of a cow's two legs, and the scan that it is filled
    with.
    """
    monkeypatch.chdir(tmp_path)
    tb.write(tb.crop(bone, 28).values, "plain.tif")
    tb.write(tb.Image(tb.crop(bone, 28).values, "labels", 40, "um"), "scan.zarr")
    return tmp_path


def sizes(output):
    return [line for line in output.out.splitlines() if line.startswith("size ")]


def test_export_prints_millimetres(place):
    plain = trabecula("export", "plain.tif", "--out", "x.3mf")
    assert "unit unknown: a length of 1 was written as 1 mm, the part is" in plain.lines[-1]
    found = trabecula(
        "export", "plain.tif", "--spacing", 40, "--unit", "um", "--scale", 10, "--out", "x.stl"
    )
    assert not found.lines and sizes(found) == ["size 11.2 x 11.2 x 11.2 mm (z, y, x)"]
    surface = tb.read_mesh("x.stl")
    assert surface.unit == "mm" and np.ptp(surface.vertices, axis=0) == pytest.approx(
        11.2, rel=1e-5
    )
    other = trabecula(
        "export", "plain.tif", "--spacing", 40, 40, 20, "--unit", "um", "--out", "x.ply"
    )
    assert sizes(other) == ["size 1.12 x 1.12 x 0.56 mm (z, y, x); its coordinates are in um"]


@pytest.mark.whole
def test_export_in_slabs_prints_millimetres(place):
    column = tb.write(
        tb.Image(np.tile(tb.read("plain.tif").values, (16, 1, 1)), "labels"), "column.zarr"
    )
    words = ("export", column, "--spacing", 0.5, "--unit", "mm")
    whole = trabecula(*words, "--out", "whole.stl")
    slabs = trabecula(*words, "--out", "slabs.stl", "--memory", 0.01)
    assert (place / "slabs.stl").read_bytes() == (place / "whole.stl").read_bytes()
    assert (
        sizes(slabs) == sizes(whole) == ["size 224 x 14 x 14 mm (z, y, x)"]
        and "not checked" in slabs.out
    )


def test_finish_declares_lengths(place):
    trabecula(
        "finish",
        "plain.tif",
        "--connect",
        "--thicken",
        90,
        "--spacing",
        40,
        "--unit",
        "um",
        "--out",
        "part.zarr",
    )
    part = tb.read("part.zarr")
    assert (part.spacing, part.unit) == ((40.0,) * 3, "um")
    assert [step["verb"] for step in part.recipe.steps] == ["read", "declare", "finish", "finish"]
    assert np.array_equal(tb.rerun("part.zarr").values, part.values)
    # --like is as the part was before it is made larger; --thicken is a length of the larger part.
    trabecula(
        "finish",
        "scan.zarr",
        "--prune",
        "--like",
        "scan.zarr",
        "--thicken",
        900,
        "--scale",
        10,
        "--out",
        "b.zarr",
    )
    other = tb.read("b.zarr")
    assert (other.spacing, other.unit) == ((400.0,) * 3, "um")
    small = tb.finish.thicken(
        tb.finish.prune(tb.read("scan.zarr"), exemplar=tb.read("scan.zarr")), thickness=90
    )
    assert (
        np.array_equal(other.values, small.values) and other.recipe.steps[-1]["report"]["added"] > 0
    )


def test_finish_in_slabs_declares_the_same(place, monkeypatch):
    words = ("finish", "scan.zarr", "--connect", "--spacing", 20, "--scale", 10)
    trabecula(*words, "--out", "whole.zarr")
    monkeypatch.setattr("trabecula.finish.slabs.in_core_bytes", lambda *words: 1 << 60)
    trabecula(*words, "--out", "slabs.zarr")
    one, other = tb.read("whole.zarr"), tb.read("slabs.zarr")
    assert one.spacing == other.spacing == (200.0,) * 3 and np.array_equal(one.values, other.values)
    assert one.recipe.to_json() == other.recipe.to_json()


def test_connect_takes_a_reach_and_a_size(place):
    solid = np.zeros((12, 12, 60), np.uint8)
    solid[3:9, 3:9, 2:10] = solid[4:8, 4:8, 40:48] = 1
    solid[5, 5, 30:33] = 1
    tb.write(solid, "two.npy")
    for words, joins, removed in (
        ((), 2, 0),
        (("--min-size", 4), 1, 0),  # on the way of the join, so it stays
        (("--min-size", 129), 0, 131),
        (("--reach", 5), 0, 131),
    ):
        trabecula("finish", "two.npy", "--connect", *words, "--out", "one.npy")
        found = tb.read("one.npy").recipe.steps[-1]["report"]
        assert (found["joins"], found["removed"]) == (joins, removed)
    assert "--reach is for --connect" in refused(
        "finish", "two.npy", "--fill", "--reach", 3, "--out", "one.npy"
    )
    assert "--min-size is for --connect" in refused(
        "finish", "two.npy", "--fill", "--min-size", 3, "--out", "one.npy"
    )


def test_check_takes_a_scale_and_names_what_it_has(place):
    words = ("check", "scan.zarr", "--json")
    small, large = (json.loads(trabecula(*words, *more).out) for more in ((), ("--scale", 10)))
    assert np.array(large["checks"]["size"]["extent"]) == pytest.approx(
        10 * np.array(small["checks"]["size"]["extent"])
    )
    told = refused("check", "scan.zarr", "--memory", 1e-5)
    assert "--crop" in told and "--shape" not in told
    for option in ("--crop", "--level", "--memory"):
        assert option in trabecula("check", "--help").out
    tb.write(tb.Image(tb.read("scan.zarr").values, "labels", 3, "nm"), "tiny.zarr")
    assert any(
        "less than 0.1 mm: is nm its unit?" in line
        for line in trabecula("check", "tiny.zarr").lines
    )


def test_out_of_memory_names_options_that_the_verb_has(place, monkeypatch):
    def full(*words, **more):
        raise MemoryError

    monkeypatch.setattr("trabecula.finish.print_check", full)
    assert refused("check", "scan.zarr").startswith("out of memory: keep a smaller box (--crop N)")
    monkeypatch.setattr("trabecula.mesh.surface.mesh", full)
    assert refused("export", "scan.zarr", "--out", "x.stl").startswith(
        "out of memory: give a smaller volume"
    )


@pytest.mark.whole
def test_the_form_comes_from_the_recipe_or_from_mask(place):
    grid = np.indices((26, 26, 26)) - 12.5
    legs = (np.hypot(np.abs(grid[1]) - 7, grid[2]) < 4) | (
        (np.abs(grid[0]) > 8) & (np.abs(grid[2]) < 4)
    )
    tb.write(legs.astype(np.uint8), "legs.tif")
    trabecula("generate", "scan.zarr", "--mask", "legs.tif", *SMALL, "--out", "made.zarr")
    told = trabecula("finish", "made.zarr", "--connect", "--out", "part.zarr")
    assert any("fills a form, which its recipe names" in line for line in told.lines)
    part = tb.read("part.zarr")
    assert not part.values[~legs].any() and part.recipe.steps[-1]["mask"][0]["source"] == "legs.tif"
    assert trabecula("rerun", "part.zarr").sha256 == part.recipe.steps[-1]["sha256"]
    (place / "legs.tif").rename(place / "moved.tif")
    told = trabecula("finish", "made.zarr", "--prune", "--like", "scan.zarr", "--out", "x.zarr")
    assert any("give it with --mask" in line for line in told.lines)
    assert any("give the form (mask, --mask)" in line for line in told.lines)
    trabecula("finish", "made.zarr", "--connect", "--mask", "moved.tif", "--out", "again.zarr")
    assert np.array_equal(tb.read("again.zarr").values, part.values)
    tb.write(np.ones((26, 26, 26), np.uint8), "full.tif")
    assert "other voxels than recorded" in refused(
        "finish", "made.zarr", "--connect", "--mask", "full.tif", "--out", "y.zarr"
    )
    text = refused("finish", "made.zarr", "--floaters", "--mask", "moved.tif", "--out", "y.zarr")
    takers = "--prune, --crust, --connect, --smooth, --thicken, --offset, --manifold and --fill"
    assert f"form for {takers}" in text
    # A volume of another program, which tells nothing of how it was made.
    tb.write(tb.Image(tb.read("made.zarr").values, "labels"), "plain.nrrd")
    trabecula("finish", "plain.nrrd", "--connect", "--mask", "moved.tif", "--out", "other.zarr")
    assert np.array_equal(tb.read("other.zarr").values, part.values)


@pytest.mark.whole
def test_a_crust_is_of_the_form_that_the_recipe_names(place):
    grid = np.indices((26, 26, 26)) - 12.5
    form = (grid**2).sum(axis=0) < 12**2
    tb.write(form.astype(np.uint8), "ball.tif")
    trabecula("generate", "scan.zarr", "--mask", "ball.tif", *SMALL, "--out", "made.zarr")
    words = ("--crust", 80, "--connect", "--smooth", 30, "--thicken", 90)
    trabecula("finish", "made.zarr", *words, "--out", "part.zarr")
    part, made = tb.read("part.zarr"), tb.read("made.zarr")
    steps = part.recipe.steps[-4:]
    assert [step["operation"] for step in steps] == ["add_crust", "connect", "smooth", "thicken"]
    assert all(step["mask"][0]["source"] == "ball.tif" for step in steps)
    whole = tb.finish.add_crust(made, thickness=80, mask=form)
    assert whole.recipe.steps[-1]["sha256"] == steps[0]["sha256"]
    assert not part.values[~form].any()
    assert trabecula("rerun", "part.zarr").sha256 == steps[-1]["sha256"]


@pytest.mark.whole
def test_a_tile_stays_a_tile(place):
    words = ("--periodic", "y", "x", *SMALL, "--shape", 20, 24, 28)
    trabecula("generate", "scan.zarr", *words, "--out", "tile.zarr")
    told = trabecula("finish", "tile.zarr", "--smooth", 40, "--out", "flat.zarr")
    assert any("--periodic finishes it so" in line for line in told.lines)
    words = ("--smooth", 40, "--connect", "--prune", "--periodic", "y", "x")
    told = trabecula("finish", "tile.zarr", *words, "--out", "part.zarr")
    assert not any("--periodic" in line for line in told.lines)
    part, image = tb.read("part.zarr"), tb.read("tile.zarr")
    axes = (False, True, True)
    image = tb.finish.connect(tb.finish.prune(image, periodic=axes), periodic=axes)
    assert np.array_equal(part.values, tb.finish.smooth(image, sigma=40, periodic=axes).values)
    step = part.recipe.steps[-1]
    assert step["settings"]["periodic"] == [False, True, True]
    assert trabecula("rerun", "part.zarr").sha256 == step["sha256"]

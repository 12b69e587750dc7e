"""Forms and flows from the command line: what the issue types, and what is refused."""

import re

import numpy as np
import pytest

import trabecula as tb
from commands import refused, trabecula
from trabecula.measure import porosity
from trabecula.synth.bubbles.config import PRESETS

START = ("generate", "--method", "bubbles")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def loaf(here):
    """Return a closed surface, and the same with a hole."""
    z, y, x = np.indices((24, 28, 40)) - np.array([11.5, 13.5, 19.5])[:, None, None, None]
    inside = (z / 11) ** 2 + (y / 13) ** 2 + (x / 19) ** 2 < 1
    tb.export(tb.Image(inside.astype(np.uint8), "labels"), here / "loaf.ply")
    mesh = tb.read_mesh(here / "loaf.ply")
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces[3:]]
    (here / "open.obj").write_text("\n".join(lines))
    return here


def test_a_mesh_is_filled_with_a_preset_and_made_again(loaf):
    words = (
        "--set",
        "preset=baguette",
        "--set",
        "distance=8",
        "--mask",
        "loaf.ply",
        "--shape",
        48,
        "--seed",
        2,
    )
    made = trabecula(*START, *words, "--out", "crumb.npy")
    crumb, form = tb.read("crumb.npy"), tb.voxelise(tb.read_mesh("loaf.ply"), spacing=1.0)
    assert crumb.shape == (48, 48, 48)
    held = (
        crumb.values.any(axis=(1, 2)).sum(),
        crumb.values.any(axis=(0, 2)).sum(),
        crumb.values.any(axis=(0, 1)).sum(),
    )
    assert max(held) == 48 and np.allclose(
        np.divide(held, held[2]), np.divide(form.shape, form.shape[2]), atol=0.05
    )
    assert trabecula("rerun", "crumb.npy").sha256 == made.sha256
    assert (
        trabecula(*START, "--preset", "baguette", *words[2:], "--out", "again.npy").sha256
        == made.sha256
    )


def test_the_crust_of_a_form_is_solid(loaf):
    trabecula(
        *START,
        "--set",
        "crust=3",
        "--set",
        "distance=8",
        "--mask",
        "loaf.ply",
        "--shape",
        48,
        "--out",
        "a.npy",
    )
    with_crust = tb.read("a.npy").values
    assert with_crust[24, 24, 0:3].all(), "the form fills the shape along x"
    assert 0.3 < porosity(tb.Image(with_crust[18:30, 18:30, 12:36], "labels")) < 0.95


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--mask", "open.obj"), "not watertight, so it has no inside: .* holes"),
        (("--mask", "loaf.ply", "--set", "crust=20"), "the mask has no room"),
        (("--set", "flow=-y, w"), "unknown name in a formula 'w'"),
        (("--set", "flow=-y, __import__('os')"), "unknown function in a formula '__import__'"),
        (("--set", "flow=rol"), "did you mean 'roll'"),
        (("--set", "flow=nowhere.npy"), "nowhere.npy cannot be read"),
        (("--set", "preset=bred"), "did you mean 'bread'"),
    ],
)
def test_what_cannot_be_followed_or_filled_is_refused_in_a_line(loaf, words, told):
    assert re.search(told, refused(*START, *words, "--shape", 24, "--out", "none.npy"))


@pytest.mark.whole
def test_a_field_of_vectors_in_a_file_is_found_again(here):
    field = np.random.default_rng(1).normal(size=(2, 3, 2, 3))
    np.save("field.npy", field)
    words = ("--set", "flow=field.npy", "--set", "randomness=0.4", "--shape", 24)
    made = trabecula(*START, *words, "--out", "a.npy")
    assert trabecula("rerun", "a.npy").sha256 == made.sha256
    np.save("field.npy", -2 * field)
    assert "holds other numbers" in refused("rerun", "a.npy")


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_are_of_no_unit(preset):
    """The same voxels, whatever their edge is said to be."""
    method = tb.method("bubbles", preset=preset, distance=6.0)
    one, other = (
        method.fit().generate(20, seed=3),
        method.fit(spacing=0.25, unit="mm").generate(20, seed=3),
    )
    assert np.array_equal(one.values, other.values) and other.unit == "mm"
    assert 0.05 < one.values.mean() < 0.95

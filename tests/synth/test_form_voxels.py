"""A form that states the size of its voxels: the result has it, or the request is refused, in
Python and on the command line.
"""

import numpy as np
import pytest

import trabecula as tb
from commands import SMALL, refused, trabecula
from trabecula.core.progress import listen
from trabecula.errors import RequestError

QUICK = {"neighbourhood": 4, "first_rounds": 2, "rounds": (1,)}


@pytest.fixture(scope="module")
def scan(bone):
    return tb.crop(bone, 28).values


def model(scan, spacing=1.0, unit="voxel"):
    return tb.method("texture", **QUICK).fit(tb.Image(scan, "labels", spacing, unit))


def ball(side=14):
    grid = np.indices((side,) * 3) - (side - 1) / 2
    return ((grid**2).sum(axis=0) < (side / 2) ** 2).astype(np.uint8)


@pytest.mark.parametrize(
    ("exemplar", "form"),
    [
        ((1.0, "voxel"), (0.5, "mm")),  # the exemplar knows nothing
        ((1.0, "voxel"), ((3, 2, 2), "um")),
        ((1.0, "voxel"), (0.5, "voxel")),
        ((2.0, "voxel"), (2.0, "mm")),
    ],
)
def test_an_exemplar_without_a_size_takes_the_forms(scan, exemplar, form):
    mask = tb.Image(ball(), "labels", *form)
    made = model(scan, *exemplar)
    for image in (made.generate(None, mask=mask), made.generate(tb.Request(None, mask=mask))):
        assert (image.spacing, image.unit) == (mask.spacing, mask.unit)


@pytest.mark.parametrize(
    ("exemplar", "form"),
    [
        ((40.0, "um"), (0.04, "mm")),
        ((40.0, "um"), (np.float32(0.04).item(), "mm")),
        ((40.0, "um"), (40.0, "voxel")),
        ((40.0, "um"), (1.0, "voxel")),  # states nothing
    ],
)
def test_an_exemplar_with_a_size_keeps_its_own(scan, exemplar, form):
    image = model(scan, *exemplar).generate(None, mask=tb.Image(ball(), "labels", *form))
    assert (image.spacing, image.unit) == ((40.0,) * 3, "um")


@pytest.mark.parametrize(
    ("exemplar", "form", "says"),
    [
        (
            (40.0, "um"),
            (0.5, "mm"),
            "mask's voxels are 0.5 x 0.5 x 0.5 mm, the result's 40 x 40 x 40 um",
        ),
        ((40.0, "um"), (40.0, "mm"), "mask's voxels are 40 x 40 x 40 mm"),
        ((40.0, "um"), (0.02, "voxel"), r"read with one by tb.read_mesh\(..., unit=\)"),
        ((40.0, "um"), ((40, 40, 20), "um"), "the result's 40 x 40 x 40 um"),
        ((2.0, "voxel"), (0.5, "mm"), "the result's 2 x 2 x 2 voxel"),
    ],
)
def test_sizes_that_contradict_each_other_are_refused(
    scan, exemplar, form, says, tmp_path, monkeypatch
):
    mask = tb.Image(ball(), "labels", *form)
    made = model(scan, *exemplar)
    for run in (made.generate, made.plan):
        with pytest.raises(RequestError, match=says):
            run(tb.Request(None, mask=mask))
    monkeypatch.chdir(tmp_path)
    tb.write(tb.Image(scan, "labels", *exemplar), "scan.zarr")
    tb.write(mask, "form.zarr")
    with pytest.raises(RequestError, match=says):
        raise RequestError(
            refused("generate", "scan.zarr", "--mask", "form.zarr", *SMALL, "--out", "made.zarr")
        )


@pytest.mark.whole
def test_a_surface_keeps_its_size_in_python_as_on_the_command_line(scan, tmp_path, monkeypatch):
    """A ball of 14 voxels of 40 um, written in millimetres."""
    monkeypatch.chdir(tmp_path)
    tb.export(tb.Image(ball(), "labels", 40, "um"), "ball.stl")
    surface = tb.read_mesh("ball.stl")
    exemplar = model(scan, 40, "um")
    image = exemplar.generate(None, mask=tb.voxelise(surface, spacing=0.04))
    assert (image.shape, image.spacing, image.unit) == ((14,) * 3, (40.0,) * 3, "um")
    with pytest.raises(RequestError, match=r"mask's voxels are 0\.02 x 0\.02 x 0\.02 mm"):
        exemplar.generate(None, mask=tb.voxelise(surface, spacing=0.02))
    plain = model(scan)
    found = plain.generate(None, mask=tb.voxelise(surface, spacing=0.02))
    assert (found.shape, found.spacing, found.unit) == ((28,) * 3, (0.02,) * 3, "mm")
    tb.write(found, "made.zarr")
    tb.write(tb.Image(scan, "labels"), "plain.zarr")
    said = trabecula(
        "generate",
        "plain.zarr",
        "--mask",
        "ball.stl",
        "--mask-scale",
        50,
        *SMALL,
        "--out",
        "on.zarr",
    ).lines
    assert any(
        "ball.stl is in mm, the exemplar in voxel: one mm is taken for one unit" in line
        for line in said
    )


@pytest.mark.whole
def test_the_size_is_written_and_made_again(scan, tmp_path):
    tb.write(tb.Image(scan, "labels"), tmp_path / "scan.zarr")
    tb.write(tb.Image(ball(), "labels", 0.5, "mm"), tmp_path / "form.zarr")
    output = trabecula(
        "generate",
        tmp_path / "scan.zarr",
        "--mask",
        tmp_path / "form.zarr",
        *SMALL,
        "--chunks",
        16,
        "--out",
        tmp_path / "x.zarr",
    )
    image = tb.read(tmp_path / "x.zarr")
    assert (image.spacing, image.unit) == ((0.5,) * 3, "mm")
    again = tb.rerun(tmp_path / "x.zarr")
    assert (again.spacing, again.unit) == (
        (0.5,) * 3,
        "mm",
    ) and output.sha256 == again.recipe.steps[-1]["sha256"]


def test_a_method_without_an_exemplar_takes_the_forms_size():
    mask = tb.Image(ball(), "labels", 0.5, "mm")
    alone = [
        name
        for name in tb.methods()
        if tb.method(name).capabilities.alone and "mask" in tb.method(name).capabilities.honours
    ]
    assert {"bubbles", "noise"} <= set(alone)
    for name in alone:
        image = tb.method(name).fit().generate(None, mask=mask)
        assert (image.spacing, image.unit) == ((0.5,) * 3, "mm")
        with pytest.raises(RequestError, match="the result's 2 x 2 x 2 mm"):
            tb.method(name).fit(spacing=2.0, unit="mm").generate(None, mask=mask)


def test_a_unit_that_is_known_is_no_reason_for_a_word(scan):
    said = []
    with listen(lambda line, fraction: said.append(line) if fraction < 0 else None):
        model(scan, 40, "um").generate(None, mask=tb.Image(ball(), "labels", 40, "um"))
    assert not [line for line in said if "mask" in line]


@pytest.mark.whole
def test_bare_numbers_of_a_surface_are_said(scan, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tb.export(tb.Image(ball(), "labels"), "plain.obj")
    tb.write(tb.Image(scan, "labels", 1, "um"), "scan.zarr")
    words = ("generate", "scan.zarr", "--mask", "plain.obj", *SMALL, "--out", "x.zarr")
    assert any(
        "plain.obj states no unit: its lengths are taken for um" in line
        for line in trabecula(*words).lines
    )
    for more in (("--mask-scale", 1), ("--shape", 14)):
        assert not any("states no unit" in line for line in trabecula(*words, *more).lines)

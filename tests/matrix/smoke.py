"""What must work wherever the package is installed: the command line, every method, the main job.
Minutes; `make test-matrix`.

The name keeps it out of `make test`, whose own tests say more of each. Kernels are compiled where
it runs first, which takes most of its time, so everything is small and is made once.
"""

import importlib.metadata
import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import trabecula as tb
from trabecula.cli.main import VERBS
from trabecula.synth.api.registry import methods

SPECS = methods()
COMMAND = Path(sys.executable).with_name("trabecula")
SMALL = ("--set", "neighbourhood=4", "--set", "first_rounds=2", "--set", "rounds=[1]")


def run(folder, *words):
    """Run the installed command in a process of its own, and return what it printed."""
    done = subprocess.run(
        [COMMAND, *map(str, words)], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_installed_package_is_tested():
    assert "site-packages" in Path(tb.__file__).parts
    assert importlib.metadata.version("trabecula") == tb.__version__


def test_the_command_says_what_it_is(tmp_path):
    assert run(tmp_path, "--version") == f"trabecula {tb.__version__}\n"
    assert all(verb in run(tmp_path, "--help") for verb in VERBS)
    done = subprocess.run(
        [sys.executable, "-m", "trabecula", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout == f"trabecula {tb.__version__}\n"


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_explains_itself(verb, tmp_path):
    assert f"trabecula {verb}" in run(tmp_path, verb, "--help")


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    """Run the main job at a small size, with a scan that comes as TIFF."""
    folder = tmp_path_factory.mktemp("job")
    tb.write(tb.crop(tb.sample("bone"), 48), folder / "scan.tif")
    run(folder, "generate", "scan.tif", "--shape", 28, "--seed", 7, "--out", "bone.zarr", *SMALL)
    run(folder, "verify", "scan.tif", "bone.zarr", "--report", "report.html")
    run(folder, "finish", "bone.zarr", "--connect", "--out", "part.zarr")
    run(folder, "export", "part.zarr", "--out", "part.stl")
    run(folder, "render", "part.zarr", "--out", "part.png", "--size", 96, 64)
    return folder


def test_the_main_job_leaves_its_files(job):
    made, part = tb.read(job / "bone.zarr"), tb.read(job / "part.zarr")
    assert made.shape == part.shape == (28, 28, 28) and made.spacing == (40.0, 40.0, 40.0)
    assert tb.measure.porosity(made) == pytest.approx(
        tb.measure.porosity(tb.read(job / "scan.tif")), abs=0.02
    )
    assert "<html" in (job / "report.html").read_text(encoding="utf-8").lower()
    assert (job / "part.stl").stat().st_size > 10_000 and tb.read(job / "part.png").shape[:2] == (
        64,
        96,
    )


def test_the_recipe_gives_the_same_voxels(job):
    assert np.array_equal(tb.rerun(job / "bone.zarr").values, tb.read(job / "bone.zarr").values)


@pytest.mark.parametrize("name", sorted(SPECS))
def test_every_method_makes_a_volume(name):
    spec = SPECS[name]
    if "learn" in spec.extras and importlib.util.find_spec("torch") is None:
        pytest.skip(f"{name} needs the extra 'learn', which is not installed")
    volume = tb.crop(tb.sample(spec.sample), 32 if spec.stores_exemplar else 64)
    picture = tb.Image(volume.values[16], "labels", volume.spacing[1:], volume.unit, volume.phases)
    exemplar = {"2d": picture, "3d": volume, None: None}[spec.exemplar]
    made = tb.method(name, **spec.trial).fit(exemplar).generate((20, 22, 24), seed=1)
    assert made.shape == (20, 22, 24)
    assert made.spacing == (1.0 if exemplar is None else exemplar.spacing[0],) * 3
    assert 0.02 < made.values.mean() < 0.98

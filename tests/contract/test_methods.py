"""What every method promises, whichever it is: the suite loops over the registry. A new method is tested by being there."""

import dataclasses
import importlib
import os
import platform
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.recipe import digest
from trabecula.engine import tiles
from trabecula.engine.plan import GIB
from trabecula.errors import InputError, MemoryBudgetError, RequestError, UnknownNameError
from trabecula.flow import replay
from trabecula.synth.registry import methods

SPECS = methods()
SHAPE = (34, 30, 37)  # odd and even, no multiple of a step or of a level


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    """A slice, from a file: an array in memory could not be found again by a recipe."""
    volume = tb.crop(tb.sample("bone"), 40)
    path = tmp_path_factory.mktemp("exemplar") / "slice.tif"
    tb.write(tb.Image(volume.values[20], "labels", volume.spacing[1:], volume.unit, volume.phases), path)
    return tb.read(path)


@pytest.fixture(scope="module", params=sorted(SPECS))
def name(request):
    return request.param


@pytest.fixture(scope="module")
def spec(name):
    return SPECS[name]


@pytest.fixture(scope="module")
def exemplar(spec, picture):
    """A small exemplar of the dimensions that a method wants."""
    return picture if spec.exemplar == "2d" else tb.crop(tb.sample("bone"), 40)


@pytest.fixture(scope="module")
def model(name, exemplar):
    return tb.method(name).fit(exemplar)


@pytest.fixture(scope="module")
def material(model):
    return model.generate(SHAPE, seed=5)


def test_the_folder_is_complete(name, spec):
    home = importlib.import_module(f"trabecula.synth.{name}")
    card = (Path(home.__file__).parent / "README.md").read_text(encoding="utf-8")
    assert spec.paper.split("(")[0].split(",")[0] in card, "the card names the paper's first author"
    for heading in ("Where the paper is", "Deviations", "Input", "Cost", "Knobs", "Known failures"):
        assert f"## {heading}" in card, f"the card lacks a section {heading!r}"
    assert spec.exemplar in ("2d", "3d", None)
    assert spec.scaling in ("window", "sweep", "whole")
    assert spec.honours <= {"periodic", "mask", "target", "fixed"}


def test_the_config_is_frozen_and_every_field_is_told(name):
    config = tb.method(name).config
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(config, dataclasses.fields(config)[0].name, 1)
    source = Path(importlib.import_module(type(config).__module__).__file__).read_text(encoding="utf-8")
    for field in dataclasses.fields(config):
        after = source.split(f"    {field.name}: ", 1)[1].split("\n", 1)[1]
        assert after.lstrip().startswith('"""'), f"{field.name} has no docstring below it"


def test_the_result_is_what_was_asked_for(material, exemplar):
    assert material.shape == SHAPE
    assert material.kind == exemplar.kind
    assert material.spacing == (exemplar.spacing[0],) * 3, "its voxels are cubes of the exemplar's size"
    assert (material.unit, material.phases) == (exemplar.unit, exemplar.phases)
    assert set(np.unique(material.values)) <= set(np.unique(exemplar.values))


def test_the_same_seed_gives_the_same_voxels(model, material):
    assert np.array_equal(model.generate(SHAPE, seed=5).values, material.values)
    assert not np.array_equal(model.generate(SHAPE, seed=6).values, material.values)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_threads_do_not_matter(name, exemplar, material, count):
    with tb.threads(count):
        again = tb.method(name).fit(exemplar).generate(SHAPE, seed=5)
    assert np.array_equal(again.values, material.values)


def test_presets_keep_their_promises(name, spec, exemplar):
    """Every preset: the shape asked for, the same voxels for one thread and two, and again from the recipe."""
    for preset in spec.presets:
        small, made = tb.crop(exemplar, 24), []
        for count in (1, 2):
            with tb.threads(count):
                made.append(tb.method(name, preset=preset).fit(small).generate((16, 18, 20), seed=2))
        assert made[0].shape == (16, 18, 20)
        assert np.array_equal(made[0].values, made[1].values)
        assert made[0].recipe.to_json() == made[1].recipe.to_json()


def test_tiles_do_not_matter(name, exemplar, material, monkeypatch):
    """Slabs of random heights, worked in random order."""
    rng = np.random.default_rng(1)

    def shuffled(work, length, count, least):
        cuts = np.unique(rng.integers(0, length + 1, 5))
        bounds = [0, *(int(cut) for cut in cuts if 0 < cut < length), length]
        for i in rng.permutation(len(bounds) - 1):
            work(bounds[i], bounds[i + 1])

    monkeypatch.setattr(tiles, "_run", shuffled)
    assert np.array_equal(tb.method(name).fit(exemplar).generate(SHAPE, seed=5).values, material.values)


DIGEST = """
import trabecula as tb

volume = tb.crop(tb.sample("bone"), 32)
picture = tb.Image(volume.values[16], "labels", volume.spacing[1:], volume.unit, volume.phases)
exemplar, shape = (volume, (26, 30, 33)) if {dimensions!r} == "3d" else (picture, (18, 20, 23))
print(tb.method({name!r}).fit(exemplar).generate(shape, seed=5).recipe.steps[-1]["sha256"])
"""


@pytest.fixture(scope="module")
def old_processor(tmp_path_factory):
    """What makes a process compile for 2008, with no wide instructions in NumPy, BLAS and the C library."""
    return {
        "NUMBA_CPU_NAME": "nehalem",
        "NUMBA_CACHE_DIR": str(tmp_path_factory.getbasetemp() / "nehalem"),
        "OPENBLAS_CORETYPE": "Nehalem",
        "NPY_DISABLE_CPU_FEATURES": " ".join(["AVX2", "FMA3", "AVX512F", "AVX512CD", "AVX512_SKX"]),
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F",
    }


@pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="instruction sets of x86-64")
def test_an_old_processor_makes_the_same_voxels(name, spec, old_processor):
    if spec.extras:
        pytest.skip(f"{name} needs more than the package")
    program = DIGEST.format(name=name, dimensions=spec.exemplar)
    runs = [
        subprocess.run(
            [sys.executable, "-c", program], env={**os.environ, **extra}, capture_output=True, text=True, check=True
        )
        for extra in ({}, old_processor)
    ]
    assert runs[0].stdout == runs[1].stdout != ""


def test_the_recipe_makes_the_same_voxels(material, tmp_path):
    again = replay(material.recipe, folder=tmp_path)
    assert digest(again.values) == digest(material.values) == material.recipe.steps[-1]["sha256"]
    assert again.recipe.to_json() == material.recipe.to_json()


def test_the_exemplar_is_not_written_into(name, exemplar):
    before = exemplar.values.copy()
    tb.method(name).fit(exemplar).generate((16, 16, 16), seed=1)
    assert np.array_equal(exemplar.values, before)


def test_what_a_method_cannot_honour_is_refused_by_name(model, spec):
    parts = {
        "periodic": True,
        "mask": np.ones(SHAPE, bool),
        "target": {"porosity": np.full(SHAPE, 0.5)},
        "fixed": tb.Image(np.zeros(SHAPE, np.uint8), "labels"),
    }
    for part, value in parts.items():
        if part not in spec.honours:
            with pytest.raises(RequestError, match=part):
                known = {"known": np.arange(np.prod(SHAPE)).reshape(SHAPE) == 0} if part == "fixed" else {}
                model.generate(SHAPE, seed=1, **{part: value}, **known)


def test_a_run_over_its_budget_is_refused_before_it_starts(model):
    tracemalloc.start()
    with pytest.raises(MemoryBudgetError, match=r"GiB|TiB"):
        model.generate((4000, 4000, 4000), seed=1, memory=GIB)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20, "memory was taken before the budget was checked"
    tracemalloc.stop()


def test_the_forecast_of_memory_holds(name, spec, exemplar):
    # How long it goes on changes nothing in what it holds.
    model = tb.method(name, preset="fast" if "fast" in spec.presets else None).fit(exemplar)
    request = tb.Request((96, 88, 80), seed=1)
    plan = model.plan(request)
    arrays = plan.peak - plan.memory["interpreter and kernels"] - plan.memory["exemplar"]
    model.generate(tb.Request((16, 16, 16), seed=1))  # so that loading kernels is not counted
    tracemalloc.start()
    model.generate(request)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak <= arrays, "the run takes more than was forecast"
    assert arrays <= 1.5 * peak, "the forecast is far above what the run takes"


def test_the_forecast_of_learning_holds_and_is_kept_to(name, exemplar):
    method = tb.method(name)
    plan = method.plan_fit(exemplar)
    method.fit(exemplar)  # so that loading kernels is not counted
    tracemalloc.start()
    method.fit(exemplar)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak <= plan.peak - plan.memory["interpreter and kernels"] <= 1.5 * peak
    with pytest.raises(MemoryBudgetError, match="smaller crop"):
        method.fit(exemplar, memory=plan.peak - 1)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda image: image.values[0] if image.ndim == 3 else np.stack([image.values] * 30), "exemplar"),
        (lambda image: tb.Image(image.values.astype(np.float32), "grey"), "grey"),
        (lambda image: np.zeros_like(image.values), "one phase"),
        (lambda image: np.resize(image.values, (5,) * image.ndim), "exemplar"),
        (lambda image: image.values.astype(np.float32), "plain array"),
    ],
    ids=["other dimensions", "grey", "one phase", "too small", "float labels"],
)
def test_an_exemplar_that_cannot_be_used_is_refused(name, spec, exemplar, spoil, words):
    if words == "grey" and "grey" in spec.kinds:
        pytest.skip(f"{name} takes grey exemplars")
    with pytest.raises(InputError, match=words):
        tb.method(name).fit(spoil(exemplar))


def test_an_unknown_setting_suggests_the_nearest(name):
    field = dataclasses.fields(tb.method(name).config)[0].name
    with pytest.raises(UnknownNameError, match=field):
        tb.method(name, **{field[:-1] + "_": 1})

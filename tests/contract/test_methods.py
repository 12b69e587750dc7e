"""What every method promises, whichever it is: the suite loops over the registry. A new method is
tested by being there.
"""

import dataclasses
import importlib
import importlib.util
import os
import platform
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.core.recipe import digest
from trabecula.engine import checkpoint, memmap, parallel, store
from trabecula.engine.memory import GIB
from trabecula.errors import (
    FileError,
    InputError,
    MemoryBudgetError,
    NotReproducedError,
    RequestError,
    UnknownNameError,
)
from trabecula.pipeline.demo import generate_to, replay
from trabecula.synth.api.registry import methods

SPECS = methods()
SHAPE = (34, 30, 37)  # odd and even, no multiple of a step or of a level


@pytest.fixture(scope="module")
def picture(tmp_path_factory):
    """A slice, from a file: an array in memory could not be found again by a recipe."""
    volume = tb.crop(tb.sample("bone"), 40)
    path = tmp_path_factory.mktemp("exemplar") / "slice.tif"
    tb.write(
        tb.Image(volume.values[20], "labels", volume.spacing[1:], volume.unit, volume.phases), path
    )
    return tb.read(path)


@pytest.fixture(scope="module", params=sorted(SPECS))
def name(request):
    return request.param


NEEDS = {"learn": "torch"}
"""A module by which it is seen whether an extra is installed."""


@pytest.fixture(scope="module")
def spec(name):
    for extra in SPECS[name].extras:
        if importlib.util.find_spec(NEEDS[extra]) is None:
            pytest.skip(f"{name} needs the extra {extra!r}, which is not installed")
    return SPECS[name]


def fitted(spec, exemplar, *, preset=None, threads=1):
    """A model, learned in seconds; what is kept in a file need not be the same for any number of
    threads.
    """
    with tb.threads(1 if spec.learns else threads):
        return tb.method(spec.name, preset=preset, **spec.trial).fit(exemplar)


@pytest.fixture(scope="module")
def exemplar(spec, picture):
    """A small exemplar of the dimensions that a method wants."""
    return (
        picture if spec.exemplar == "2d" else tb.crop(tb.sample("bone"), 64 if spec.learns else 40)
    )


@pytest.fixture(scope="module")
def model(spec, exemplar):
    return fitted(spec, exemplar)


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
    homes = [kind.__module__ for kind in type(config).__mro__ if dataclasses.is_dataclass(kind)]
    source = "".join(
        Path(importlib.import_module(home).__file__).read_text(encoding="utf-8") for home in homes
    )
    for field in dataclasses.fields(config):
        after = source.split(f"    {field.name}: ", 1)[1].split("\n", 1)[1]
        assert after.lstrip().startswith('"""'), f"{field.name} has no docstring below it"


def test_the_result_is_what_was_asked_for(material, exemplar):
    assert material.shape == SHAPE
    assert material.kind == exemplar.kind
    assert material.spacing == (exemplar.spacing[0],) * 3, (
        "its voxels are cubes of the exemplar's size"
    )
    assert (material.unit, material.phases) == (exemplar.unit, exemplar.phases)
    assert set(np.unique(material.values)) <= set(np.unique(exemplar.values))


def test_the_same_seed_gives_the_same_voxels(model, material):
    assert np.array_equal(model.generate(SHAPE, seed=5).values, material.values)
    assert not np.array_equal(model.generate(SHAPE, seed=6).values, material.values)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_threads_do_not_matter(spec, exemplar, model, material, count):
    learned = model if spec.learns else fitted(spec, exemplar, threads=count)
    with tb.threads(count):
        again = learned.generate(SHAPE, seed=5)
    assert np.array_equal(again.values, material.values)


def test_presets_keep_their_promises(name, spec, exemplar):
    """Every preset: the shape asked for, the same voxels for one thread and two, and again from the
    recipe.
    """
    # Of a method that trains the first alone: each costs a training, which its own tests try in
    # miniature.
    for preset in spec.presets[:1] if spec.learns else spec.presets:
        small, made = exemplar if spec.learns else tb.crop(exemplar, 24), []
        model = fitted(spec, small, preset=preset)
        for count in (1, 2):
            learned = model if spec.learns else fitted(spec, small, preset=preset, threads=count)
            with tb.threads(count):
                made.append(learned.generate((16, 18, 20), seed=2))
        assert made[0].shape == (16, 18, 20)
        assert np.array_equal(made[0].values, made[1].values)
        assert made[0].recipe.to_json() == made[1].recipe.to_json()


def test_tiles_do_not_matter(spec, exemplar, model, material, monkeypatch):
    """Slabs of random heights, worked in random order."""
    rng = np.random.default_rng(1)

    def shuffled(work, length, count, least):
        cuts = np.unique(rng.integers(0, length + 1, 5))
        bounds = [0, *(int(cut) for cut in cuts if 0 < cut < length), length]
        for i in rng.permutation(len(bounds) - 1):
            work(bounds[i], bounds[i + 1])

    monkeypatch.setattr(parallel, "_run", shuffled)
    learned = model if spec.learns else fitted(spec, exemplar)
    assert np.array_equal(learned.generate(SHAPE, seed=5).values, material.values)


BOXES = [((0, 10), (5, 30), (3, 4)), ((20, 34), (0, 30), (30, 37)), ((33, 34), (29, 30), (36, 37))]
FORM = (
    np.hypot.outer(np.arange(-17, 17), np.hypot.outer(np.arange(-15, 15), np.arange(-18, 19))) < 15
)


def test_any_window_is_a_part_of_the_whole(spec, model, material):
    if spec.scaling != "window":
        pytest.skip(f"{spec.name} makes volumes as a whole")
    for box in BOXES:
        part = tuple(slice(*ends) for ends in box)
        assert np.array_equal(model.window(SHAPE, box, seed=5), material.values[part])
        if "mask" in spec.honours:
            whole = model.generate(SHAPE, seed=5, mask=FORM).values
            assert np.array_equal(model.window(SHAPE, box, seed=5, mask=FORM), whole[part])
            assert np.array_equal(whole, np.where(FORM, material.values, 0))
    # And of what lies beyond it: two boxes that overlap.
    one, two = ((-70, 9), (-9, 4), (60, 90)), ((-3, 12), (0, 5), (80, 140))
    first, second = (model.window(SHAPE, box, seed=5) for box in (one, two))
    assert np.array_equal(first[67:, 9:, 20:], second[:12, :4, :10])
    with pytest.raises(InputError, match="holds no voxel"):
        model.window(SHAPE, ((0, 10), (5, 5), (3, 4)))
    with pytest.raises(InputError, match="three pairs"):
        model.window(SHAPE, ((0, 10), (5, 5.5), (3, 4)))


def test_a_repeating_window_goes_round(spec, model):
    if spec.scaling != "window" or "periodic" not in spec.honours:
        pytest.skip(f"{spec.name} has no repeating windows")
    shape = (32, 48, 16)
    whole = model.generate(shape, seed=5, periodic=(True, False, True)).values
    round_ = model.window(
        shape, ((-32, 64), (0, 48), (-5, 27)), seed=5, periodic=(True, False, True)
    )
    assert np.array_equal(round_, np.roll(np.tile(whole, (3, 1, 2)), 5, axis=2))


def test_in_blocks_and_at_once_are_the_same(spec, model, material, tmp_path, monkeypatch):
    monkeypatch.setattr(store, "CHUNK", 16)
    monkeypatch.setattr(memmap, "SMALLEST", 256)
    request = tb.Request(SHAPE, seed=5)
    at_once = generate_to(model, request, tmp_path / "whole.zarr")
    whole = tb.read(tmp_path / "whole.zarr")
    assert at_once.sha256 == material.recipe.steps[-1]["sha256"] and at_once.text == repr(material)
    coarse = tb.read(tmp_path / "whole.zarr", level=1).values
    # Blocks smaller than the volume, of which the last are cut off, and one that holds all; one
    # thread and two.
    for side, count in ((16, 1), (32, 2), (48, 1)):
        with tb.threads(count):
            in_blocks = generate_to(model, request, tmp_path / "blocks.zarr", chunks=side)
        image = tb.read(tmp_path / "blocks.zarr")
        assert np.array_equal(image.values, material.values)
        assert digest(image.values) == in_blocks.sha256 == at_once.sha256
        assert image.recipe.to_json() == material.recipe.to_json() == whole.recipe.to_json()
        assert in_blocks.text == at_once.text == repr(image)
        if side == 16:
            assert np.array_equal(tb.read(tmp_path / "blocks.zarr", level=1).values, coarse)
        assert sorted(entry.name for entry in tmp_path.iterdir()) == ["blocks.zarr", "whole.zarr"]


PARTS = {
    "periodic": lambda exemplar: {"periodic": (True, False, True)},
    "mask": lambda exemplar: {"mask": FORM},
    "target": lambda exemplar: {"target": {"porosity": tb.measure.porosity(exemplar) + 0.02}},
    "fixed": lambda exemplar: {
        "fixed": tb.Image(np.broadcast_to(CORNER, SHAPE).astype(np.uint8), *described(exemplar)),
        "known": np.broadcast_to(np.arange(SHAPE[0])[:, None, None] < 9, SHAPE).copy(),
    },
}
CORNER = (np.add.outer(np.arange(30), np.arange(37)) // 5) % 2


def described(exemplar):
    return exemplar.kind, (exemplar.spacing[0],) * 3, exemplar.unit, exemplar.phases


@pytest.mark.parametrize("part", sorted(PARTS))
def test_parts_of_a_request_in_blocks_and_at_once_are_the_same(
    spec, model, exemplar, part, tmp_path, monkeypatch
):
    if part not in spec.honours or spec.scaling == "window":
        pytest.skip(f"{spec.name} has no such part, or its windows are tested with it")
    monkeypatch.setattr(memmap, "SMALLEST", 256)
    request = tb.Request(SHAPE, seed=5, **PARTS[part](exemplar))
    made = generate_to(model, request, tmp_path / "blocks.zarr", chunks=16)
    assert made.sha256 == digest(model.generate(request).values)


def test_a_run_in_blocks_goes_on_where_it_stopped(spec, model, material, tmp_path, monkeypatch):
    """Interrupted again and again, each time later, until it has ended."""
    monkeypatch.setattr(memmap, "SMALLEST", 256)
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    monkeypatch.setattr(checkpoint, "_SHARE", 0)
    request, path, stops, made = tb.Request(SHAPE, seed=5), tmp_path / "x.zarr", 0, None
    while made is None:
        calls = iter(range(7 + 5 * stops * stops))

        def interrupt(label, done, calls=calls):
            if next(calls, None) is None:
                raise KeyboardInterrupt

        try:
            with listen(interrupt):
                made = generate_to(model, request, path, chunks=16)
        except KeyboardInterrupt:
            stops += 1
    assert made.sha256 == material.recipe.steps[-1]["sha256"]
    assert made.recipe.to_json() == material.recipe.to_json()
    assert stops and [entry.name for entry in tmp_path.iterdir()] == ["x.zarr"]


def test_a_model_from_its_file_makes_the_same_voxels(spec, model, material, tmp_path):
    again = tb.load_model(model.save(tmp_path / "one.model"))
    assert np.array_equal(again.generate(SHAPE, seed=5).values, material.values)
    assert again.sha256 == model.sha256
    if not spec.learns:
        return
    tb.write(again.generate(SHAPE, seed=5), tmp_path / "made.npy")
    assert np.array_equal(tb.rerun(tmp_path / "made.npy").values, material.values)
    (tmp_path / "one.model").rename(tmp_path / "elsewhere.model")
    with pytest.raises(FileError, match=r"needs the model one.model \(SHA-256 .*--model"):
        tb.rerun(tmp_path / "made.npy")
    assert np.array_equal(
        tb.rerun(tmp_path / "made.npy", model=tmp_path / "elsewhere.model").values, material.values
    )
    tb.method("noise", reach=4).fit(tb.crop(tb.sample("bone"), 16)).save(tmp_path / "other.model")
    with pytest.raises(NotReproducedError, match=r"other\.model is another"):
        tb.rerun(tmp_path / "made.npy", model=tmp_path / "other.model")


DIGEST = """
import trabecula as tb

volume = tb.crop(tb.sample("bone"), 32)
picture = tb.Image(volume.values[16], "labels", volume.spacing[1:], volume.unit, volume.phases)
exemplar, shape = (volume, (26, 30, 33)) if {dimensions!r} == "3d" else (picture, (18, 20, 23))
print(tb.method({name!r}).fit(exemplar).generate(shape, seed=5).recipe.steps[-1]["sha256"])
"""


@pytest.fixture(scope="module")
def old_processor(tmp_path_factory):
    """What makes a process compile for 2008, with no wide instructions in NumPy, BLAS and the C
    library.
    """
    return {
        "NUMBA_CPU_NAME": "nehalem",
        "NUMBA_CACHE_DIR": str(tmp_path_factory.getbasetemp() / "nehalem"),
        "OPENBLAS_CORETYPE": "Nehalem",
        "NPY_DISABLE_CPU_FEATURES": " ".join(["AVX2", "FMA3", "AVX512F", "AVX512CD", "AVX512_SKX"]),
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F",
    }


@pytest.mark.skipif(
    platform.machine().lower() not in ("x86_64", "amd64"), reason="instruction sets of x86-64"
)
def test_an_old_processor_makes_the_same_voxels(name, spec, old_processor):
    if spec.extras:
        pytest.skip(f"{name} needs more than the package")
    program = DIGEST.format(name=name, dimensions=spec.exemplar)
    runs = [
        subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, **extra},
            capture_output=True,
            text=True,
            check=True,
        )
        for extra in ({}, old_processor)
    ]
    assert runs[0].stdout == runs[1].stdout != ""


def test_the_recipe_makes_the_same_voxels(spec, material, tmp_path):
    with tb.threads(1 if spec.learns else 2):  # learning is repeated with as many threads as it had
        again = replay(material.recipe, folder=tmp_path)
    assert digest(again.values) == digest(material.values) == material.recipe.steps[-1]["sha256"]
    assert again.recipe.to_json() == material.recipe.to_json()


def test_the_exemplar_is_not_written_into(spec, exemplar):
    before = exemplar.values.copy()
    fitted(spec, exemplar).generate((16, 16, 16), seed=1)
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
                known = (
                    {"known": np.arange(np.prod(SHAPE)).reshape(SHAPE) == 0}
                    if part == "fixed"
                    else {}
                )
                model.generate(SHAPE, seed=1, **{part: value}, **known)


def test_a_run_over_its_budget_is_refused_before_it_starts(model):
    tracemalloc.start()
    with pytest.raises(MemoryBudgetError, match=r"GiB|TiB"):
        model.generate((4000, 4000, 4000), seed=1, memory=GIB)
    assert tracemalloc.get_traced_memory()[1] < 1 << 20, (
        "memory was taken before the budget was checked"
    )
    tracemalloc.stop()


def test_the_forecast_of_memory_holds(name, spec, exemplar):
    # How long it goes on changes nothing in what it holds.
    model = fitted(spec, exemplar, preset="fast" if "fast" in spec.presets else None)
    request = tb.Request((96, 88, 80), seed=1)
    plan = model.plan(request)
    outside = ("interpreter and kernels", "exemplar", "network")  # what tracemalloc does not see
    arrays = plan.peak - sum(plan.memory.get(part, 0) for part in outside)
    model.generate(tb.Request((16, 16, 16), seed=1))  # so that loading kernels is not counted
    tracemalloc.start()
    model.generate(request)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak <= arrays, "the run takes more than was forecast"
    assert arrays <= 1.5 * peak, "the forecast is far above what the run takes"


def test_the_forecast_of_scratch_files_holds(name, spec, exemplar, tmp_path):
    if spec.scaling == "window":
        pytest.skip(f"{name} makes blocks alone")
    model = fitted(spec, exemplar, preset="fast" if "fast" in spec.presets else None)
    request = tb.Request((64, 72, 56), seed=1)
    budget = model.plan_spilled(request, 0).peak + (4 << 20)
    plan = model.plan_spilled(request, budget)
    arrays = plan.peak - sum(plan.memory[part] for part in ("interpreter and kernels", "exemplar"))
    generate_to(model, tb.Request((16, 16, 16), seed=1), tmp_path / "small.zarr", chunks=16)
    tracemalloc.start()
    generate_to(model, request, tmp_path / "x.zarr", memory=budget, chunks=32)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert plan.peak <= budget and plan.disk > np.prod(request.shape)
    assert peak <= arrays, "what is in memory beside the files takes more than was forecast"


def test_the_forecast_of_learning_holds_and_is_kept_to(name, spec, exemplar):
    if spec.learns:
        pytest.skip(
            f"{name} learns in memory that tracemalloc does not see; its own tests measure it"
        )
    method = tb.method(name, **spec.trial)
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
        (
            lambda image: image.values[0] if image.ndim == 3 else np.stack([image.values] * 30),
            "exemplar",
        ),
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
    if spec.flat and np.ndim(getattr(spoil(exemplar), "values", spoil(exemplar))) == 2:
        pytest.skip(f"{name} takes pictures too")
    with pytest.raises(InputError, match=words):
        fitted(spec, spoil(exemplar))


def test_without_an_exemplar_settings_are_enough_or_one_is_asked_for(name, spec, tmp_path):
    method = tb.method(name, **spec.trial)
    if not spec.alone:
        with pytest.raises(InputError, match="no exemplar was given"):
            method.fit()
        return
    model = method.fit(spacing=0.5, unit="mm")
    made = model.generate(SHAPE, seed=5)
    assert (made.shape, made.kind, made.spacing, made.unit) == (
        SHAPE,
        "labels",
        (0.5, 0.5, 0.5),
        "mm",
    )
    assert made.phases == ("void", "solid")
    assert 0 < made.values.mean() < 1
    assert np.array_equal(
        method.fit(spacing=0.5, unit="mm").generate(SHAPE, seed=5).values, made.values
    )
    tb.write(made, tmp_path / "made.npy")
    assert np.array_equal(tb.rerun(tmp_path / "made.npy").values, made.values)
    again = tb.load_model(model.save(tmp_path / "one.model"))
    assert np.array_equal(again.generate(SHAPE, seed=5).values, made.values)
    if spec.scaling == "window":
        assert np.array_equal(
            model.window(SHAPE, BOXES[1], seed=5), made.values[tuple(slice(*e) for e in BOXES[1])]
        )
    if spec.flat:
        picture = model.generate((40, 50), seed=5)
        assert (picture.shape, picture.spacing) == ((40, 50), (0.5, 0.5))


def test_the_voxels_of_an_exemplar_are_its_own(name, exemplar):
    with pytest.raises(InputError, match="those of the exemplar"):
        tb.method(name).fit(exemplar, spacing=0.5)


def test_an_unknown_setting_suggests_the_nearest(name):
    field = dataclasses.fields(tb.method(name).config)[0].name
    with pytest.raises(UnknownNameError, match=field):
        tb.method(name, **{field[:-1] + "_": 1})

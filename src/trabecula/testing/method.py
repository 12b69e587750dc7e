"""The contract of a method: `check_method`, and its checks one by one in `METHOD_CHECKS`."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from copy import copy
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from trabecula.core.errors import (
    FileError,
    InputError,
    MemoryBudgetError,
    NotReproducedError,
    RequestError,
    UnknownNameError,
)
from trabecula.core.image import Image
from trabecula.core.progress import listen
from trabecula.core.recipe import digest
from trabecula.core.request import Request
from trabecula.engine import checkpoint, memmap, parallel, store
from trabecula.engine.memory import GIB
from trabecula.engine.parallel import threads
from trabecula.exemplar.crop import crop
from trabecula.exemplar.samples import sample
from trabecula.io.files import read, write
from trabecula.measure import porosity
from trabecula.pipeline.generate import generate_to
from trabecula.pipeline.replay import replay, rerun
from trabecula.synth.api.method import Method
from trabecula.synth.api.model import Model
from trabecula.synth.api.registry import method, methods, register
from trabecula.synth.api.serialize import load_model
from trabecula.synth.api.windows import WindowModel
from trabecula.testing.method_case import (
    FORM,
    SEED,
    SHAPE,
    VOXEL,
    Check,
    Inapplicable,
    MethodCase,
    raises,
    same,
)
from trabecula.testing.peak import peak_bytes

METHOD_CHECKS: dict[str, Check] = {}
"""Every check of a method by its name."""


def check_method(
    method: str | type[Method],
    *,
    exemplar: Image | None = None,
    small: Image | None = None,
    leave_out: tuple[str, ...] = (),
) -> list[str]:
    """Check that a method keeps the contract.

    Parameters
    ----------
    method : str or type of Method
        The name of a registered method, or a class. Other processes import a class by
        `Capabilities.method`.
    exemplar : Image, optional
        Default: a part of the bone sample with the axes and the kind that the method learns from.
    small : Image, optional
        A smaller one, for presets. Default: the middle of the exemplar, 24 voxels wide.
    leave_out : tuple of str
        Names of `METHOD_CHECKS` that are not made.

    Returns
    -------
    list of str
        Checks that do not apply to the method, each with the reason.

    Raises
    ------
    AssertionError
        With the name of the check and what is wrong.

    Examples
    --------
    >>> from trabecula.testing import check_method, METHOD_CHECKS
    >>> quick = ("unknown setting", "capabilities")
    >>> check_method("noise", leave_out=tuple(set(METHOD_CHECKS) - set(quick)))
    []
    """
    case, inapplicable = MethodCase(method, exemplar=exemplar, small=small), []
    with register_case(case):
        for name, check in METHOD_CHECKS.items():
            if name in leave_out:
                continue
            try:
                check(case)
            except Inapplicable as reason:
                inapplicable.append(f"{name}: {reason}")
            except AssertionError as error:
                raise AssertionError(f"{name}: {error}") from error
    return inapplicable


@contextmanager
def register_case(case: MethodCase) -> Iterator[None]:
    """Let the registry know the method of a case while the block lasts."""
    with ExitStack() as stack:
        if case.capabilities.name not in methods():
            stack.enter_context(register(case.cls))
        yield


def _check(name: str) -> Callable[[Check], Check]:
    """Add a function to the checks."""

    def add(function: Check) -> Check:
        METHOD_CHECKS[name] = function
        return function

    return add


@_check("capabilities")
def _check_capabilities(case: MethodCase) -> None:
    """Check that CAPABILITIES and the classes agree."""
    told, model = case.capabilities, case.model
    boxes = isinstance(model, WindowModel)
    assert boxes == (told.large == "box"), (
        f'large="{told.large}" and a {"WindowModel" if boxes else "Model"}: "box" is for models '
        "derived from WindowModel"
    )
    mapped = type(model).resident_memory is not Model.resident_memory
    assert mapped or told.large != "memmap", (
        'large="memmap" needs the hook resident_memory, the bytes that stay in memory'
    )
    for preset in told.presets:
        case.cls.configure(preset=preset)
    assert case.method().capabilities is told and model.capabilities is told, (
        "method and model should have the same capabilities"
    )


@_check("card")
def _check_card(case: MethodCase) -> None:
    """Check that the folder of a method of this package has its card."""
    module = case.capabilities.method.partition(":")[0]
    if not module.startswith("trabecula.synth."):
        raise Inapplicable("the method is not in this package")
    home = Path(inspect.getfile(importlib.import_module(module))).parent
    card = (home / "README.md").read_text(encoding="utf-8")
    author = case.capabilities.paper.split("(")[0].split(",")[0]
    assert author in card, "the card does not name the paper's first author"
    for heading in ("Where the paper is", "Deviations", "Input", "Cost", "Knobs", "Known failures"):
        assert f"## {heading}" in card, f"the card lacks a section {heading!r}"


@_check("config")
def _check_config(case: MethodCase) -> None:
    """Check that the config is frozen and every field has a docstring."""
    config = case.cls.configure().config
    for field in dataclasses.fields(config):
        with raises(dataclasses.FrozenInstanceError, "", "the config should be frozen"):
            setattr(config, field.name, 1)
    homes = [kind.__module__ for kind in type(config).__mro__ if dataclasses.is_dataclass(kind)]
    source = "".join(inspect.getsource(importlib.import_module(home)) for home in homes)
    for field in dataclasses.fields(config):
        after = source.split(f"    {field.name}: ", 1)[1].split("\n", 1)[1]
        assert after.lstrip().startswith('"""'), f"{field.name} has no docstring below it"


@_check("unknown setting")
def _check_unknown_setting(case: MethodCase) -> None:
    """Check that an unknown setting suggests the nearest."""
    for field in dataclasses.fields(case.cls.configure().config)[:1]:
        with raises(UnknownNameError, field.name, "an unknown setting should be refused"):
            wrong: dict[str, Any] = {field.name[:-1] + "_": 1}
            case.cls.configure(**wrong)


@_check("result")
def _check_result(case: MethodCase) -> None:
    """Check that the result has the shape of the request and the exemplar's kind, voxels and
    phases.
    """
    made, first = case.material, case.exemplar
    assert made.shape == SHAPE, f"{SHAPE} was asked for, got {made.shape}"
    if first is None:
        assert (made.spacing, made.unit) == ((VOXEL[0],) * 3, VOXEL[1]), (
            f"the voxels are {made.spacing} {made.unit}, not those of fit(spacing=, unit=)"
        )
        assert len(np.unique(made.values)) > 1, "the result holds one value only"
        return
    assert made.spacing == (first.spacing[0],) * 3, "its voxels are not of the exemplar's size"
    for name in ("kind", "unit", "phases"):
        found, expected = getattr(made, name), getattr(first, name)
        assert found == expected, f"{name} is {found!r}, the exemplar's is {expected!r}"
    if made.kind == "labels":
        strange = set(np.unique(made.values)) - set(np.unique(first.values))
        assert not strange, f"labels {strange} are not in the exemplar"


@_check("seed")
def _check_seed(case: MethodCase) -> None:
    """Check that the same seed gives the same voxels, and another seed others, unless the method
    is deterministic.
    """
    again = case.model.generate(SHAPE, seed=SEED).values
    same(again, case.material.values, "the same seed gives other voxels")
    other = case.model.generate(SHAPE, seed=SEED + 1).values
    if case.capabilities.deterministic:
        same(other, again, "deterministic, and another seed gives other voxels")
    else:
        assert not np.array_equal(other, again), (
            "another seed gives the same voxels: use the seed, or say deterministic=True"
        )


@_check("threads")
def _check_threads(case: MethodCase) -> None:
    """Check that the number of threads changes no voxel."""
    for count in (1, 3):
        model = case.again(count)
        with threads(count):
            made = model.generate(SHAPE, seed=SEED).values
        same(made, case.material.values, f"{count} threads give other voxels")


@_check("slabs")
def _check_slabs(case: MethodCase) -> None:
    """Check that slabs of random heights, worked on in random order, change no voxel."""
    rng = np.random.default_rng(1)

    def shuffle(work: Callable[[int, int], Any], length: int, count: int, least: int) -> None:
        cuts = np.unique(rng.integers(0, length + 1, 5))
        bounds = [0, *(int(cut) for cut in cuts if 0 < cut < length), length]
        for i in rng.permutation(len(bounds) - 1):
            work(bounds[i], bounds[i + 1])

    with patch.object(parallel, "_run", shuffle):
        made = case.again().generate(SHAPE, seed=SEED).values
    same(made, case.material.values, "other slabs give other voxels")


@_check("presets")
def _check_presets(case: MethodCase) -> None:
    """Check that every preset makes the shape, and the same for one thread and two."""
    # Of a method that trains the first alone: each costs a training, which its own tests try in
    # miniature.
    presets = case.capabilities.presets
    for preset in presets[:1] if case.trains else presets:
        model, made = case.fit(case.small, preset=preset), []
        for count in (1, 2):
            learned = model if case.trains else case.fit(case.small, preset=preset, count=count)
            with threads(count):
                made.append(learned.generate((16, 18, 20), seed=2))
        assert made[0].shape == (16, 18, 20), f"preset {preset} makes {made[0].shape}"
        same(made[1].values, made[0].values, f"preset {preset}: two threads give other voxels")
        assert made[0].recipe.to_json() == made[1].recipe.to_json(), (
            f"preset {preset}: two threads give another recipe"
        )


_BOXES = (((0, 10), (5, 14), (3, 4)), ((16, 26), (0, 14), (30, 37)), ((25, 26), (13, 14), (36, 37)))


@_check("windows")
def _check_windows(case: MethodCase) -> None:
    """Check that any window is a part of the whole, and of the material around it."""
    model = _window_model(case)
    for box in _BOXES:
        part = tuple(slice(*ends) for ends in box)
        found = model.window(SHAPE, box, seed=SEED)
        same(found, case.material.values[part], f"the box {box} is no part of the whole")
        if "mask" in case.capabilities.honours:
            whole = model.generate(SHAPE, seed=SEED, mask=FORM).values
            found = model.window(SHAPE, box, seed=SEED, mask=FORM)
            same(found, whole[part], f"the box {box} of a form is no part of the whole")
            expected = np.where(FORM, case.material.values, model.facts[0].empty_label)
            same(whole, expected, "the form is not the material inside, void outside")
    one, two = ((-70, 9), (-9, 4), (60, 90)), ((-3, 12), (0, 5), (80, 140))
    first, second = (model.window(SHAPE, box, seed=SEED) for box in (one, two))
    same(first[67:, 9:, 20:], second[:12, :4, :10], "boxes that overlap differ")
    with raises(InputError, "holds no voxel", "an empty box should be refused"):
        model.window(SHAPE, ((0, 10), (5, 5), (3, 4)))
    with raises(InputError, "three pairs", "a box of fractions should be refused"):
        model.window(SHAPE, ((0, 10), (5, 5.5), (3, 4)))  # type: ignore[arg-type]


@_check("periodic windows")
def _check_periodic_windows(case: MethodCase) -> None:
    """Check that windows of a periodic request repeat."""
    model = _window_model(case)
    if "periodic" not in case.capabilities.honours:
        raise Inapplicable("the method makes nothing periodic")
    shape, wraps = (32, 48, 16), (True, False, True)
    whole = model.generate(shape, seed=SEED, periodic=wraps).values
    box = ((-32, 64), (0, 48), (-5, 27))
    found = model.window(shape, box, seed=SEED, periodic=wraps)
    expected = np.roll(np.tile(whole, (3, 1, 2)), 5, axis=2)
    same(found, expected, "a window beyond the period does not repeat")


def _window_model(case: MethodCase) -> WindowModel:
    """Return the model, or say that it makes no boxes."""
    if not isinstance(case.model, WindowModel):
        raise Inapplicable("the method makes volumes as a whole")
    return case.model


@_check("blocks")
def _check_blocks(case: MethodCase) -> None:
    """Check that a volume made or streamed in blocks is the one that is made at once."""
    folder, request = case.folder(), case.request()
    with patch.object(store, "CHUNK", 16), patch.object(memmap, "SMALLEST", 256):
        at_once = generate_to(case.model, request, folder / "whole.zarr")
        whole = read(folder / "whole.zarr")
        assert at_once.sha256 == _digest(case) and at_once.text == repr(case.material), (
            "a volume in a store differs from one in memory"
        )
        coarse = read(folder / "whole.zarr", level=1).values
        # Blocks smaller than the volume, of which the last are cut off, and one that holds all; one
        # thread and two.
        for side, count in ((16, 1), (32, 2), (48, 1)):
            what = f"blocks of {side} with {count} threads"
            with threads(count):
                result = generate_to(case.model, request, folder / "blocks.zarr", chunks=side)
            image = read(folder / "blocks.zarr")
            same(image.values, case.material.values, what)
            assert digest(image.values) == result.sha256 == at_once.sha256, f"{what}: digests"
            recipes = [one.recipe.to_json() for one in (image, case.material, whole)]
            assert recipes[0] == recipes[1] == recipes[2], f"{what}: the recipes differ"
            assert result.text == at_once.text == repr(image), f"{what}: {result.text}"
            if side == 16:
                found = read(folder / "blocks.zarr", level=1).values
                same(found, coarse, f"{what}: the coarser level differs")
            left = sorted(entry.name for entry in folder.iterdir())
            assert left == ["blocks.zarr", "whole.zarr"], f"{what}: files are left: {left}"


def _digest(case: MethodCase) -> str:
    """Return the digest of the case's material."""
    return str(case.material.recipe.steps[-1]["sha256"])


def _parts(case: MethodCase) -> dict[str, dict[str, Any]]:
    """Return every part of a request that the method honours, as arguments."""
    told, parts = case.capabilities, dict[str, dict[str, Any]]()
    if "periodic" in told.honours:
        parts["periodic"] = {"periodic": (True, False, True)}
    if "mask" in told.honours:
        parts["mask"] = {"mask": FORM}
    if "target" in told.honours:
        like = case.material if case.exemplar is None else case.exemplar
        parts["target"] = {"target": {"porosity": porosity(like) + 0.02}}
    if "fixed" in told.honours:
        corner = (np.add.outer(np.arange(SHAPE[1]), np.arange(SHAPE[2])) // 5) % 2
        values = np.broadcast_to(corner, SHAPE).astype(case.model.dtype)
        fixed = Image(values, **case.model.fields(case.request()))
        held = np.broadcast_to(np.arange(SHAPE[0])[:, None, None] < 6, SHAPE).copy()
        parts["fixed"] = {"fixed": fixed, "known": held}
    if "coarse" in told.honours:
        solid = case.material.values != case.model.facts[0].empty_label
        most = (solid[::2, ::2].astype(int) + solid[1::2, ::2] + solid[::2, 1::2]) > 1
        coarse = Image(most.astype(np.uint8), "labels", phases=case.material.phases)
        parts["coarse"] = {"coarse": coarse}
    if "like" in told.honours:
        parts["like"] = {"like": case.relative}
    return parts


@_check("parts")
def _check_parts(case: MethodCase) -> None:
    """Check that parts of a request are honoured, with the same voxels in blocks and at once."""
    if case.capabilities.large == "box":
        raise Inapplicable("the windows are checked with them")
    for part, words in _parts(case).items():
        request, path = case.request(**words), case.folder() / "blocks.zarr"
        made = case.model.generate(request)
        if part == "mask" and made.kind == "labels":
            outside = np.unique(made.values[~FORM])
            assert outside.tolist() == [case.model.facts[0].empty_label], (
                f"mask: labels {outside} are outside of the form, where void should be"
            )
        if part == "fixed":
            known, fixed = words["known"], words["fixed"].values
            same(made.values[known], fixed[known], "fixed: known voxels are changed")
        with patch.object(memmap, "SMALLEST", 256):
            result = generate_to(case.model, request, path, chunks=16)
        assert result.sha256 == digest(made.values), f"{part}: blocks give other voxels"


@_check("resume")
def _check_resume(case: MethodCase) -> None:
    """Check that a run that is interrupted again and again, each time later, gives the voxels of
    one that was not.
    """
    folder, stops, result = case.folder(), 0, None
    with (
        patch.object(memmap, "SMALLEST", 256),
        patch.object(checkpoint, "EVERY", 0.0),
        patch.object(checkpoint, "_SHARE", 0),
    ):
        while result is None:
            calls = iter(range(7 + 10 * stops * stops))

            def interrupt(label: str, done: float, calls: Iterator[int] = calls) -> None:
                if next(calls, None) is None:
                    raise KeyboardInterrupt

            try:
                with listen(interrupt):
                    result = generate_to(case.model, case.request(), folder / "x.zarr", chunks=16)
            except KeyboardInterrupt:
                stops += 1
    assert stops, "the run made no progress that could be interrupted"
    assert result.sha256 == _digest(case), "an interruption changes voxels"
    assert result.recipe.to_json() == case.material.recipe.to_json(), "... changes the recipe"
    left = [entry.name for entry in folder.iterdir()]
    assert left == ["x.zarr"], f"files of the interrupted run are left: {left}"


@_check("model file")
def _check_model_file(case: MethodCase) -> None:
    """Check that a model from its file makes the same voxels, and a result finds its model."""
    folder, model = case.folder(), copy(case.model)  # saving gives a model the name of its file
    again = load_model(model.save(folder / "one.model"))
    made = again.generate(SHAPE, seed=SEED)
    same(made.values, case.material.values, "a model from its file makes other voxels")
    assert again.sha256 == model.sha256, "a model from its file has another digest"
    if not case.trains:
        return
    write(made, folder / "made.npy")
    same(rerun(folder / "made.npy").values, made.values, "the recipe gives other voxels")
    (folder / "one.model").rename(folder / "elsewhere.model")
    needs = r"needs the model one.model \(SHA-256 .*--model"
    with raises(FileError, needs, "a recipe without its model should be refused"):
        rerun(folder / "made.npy")
    moved = rerun(folder / "made.npy", model=folder / "elsewhere.model")
    same(moved.values, made.values, "the model in another place gives other voxels")
    method("noise", reach=4).fit(crop(sample("bone"), 16)).save(folder / "other.model")
    with raises(NotReproducedError, r"other\.model is another", "another model should be refused"):
        rerun(folder / "made.npy", model=folder / "other.model")


@_check("recipe")
def _check_recipe(case: MethodCase) -> None:
    """Check that the recipe makes the same voxels."""
    with threads(1 if case.trains else 2):  # learning is repeated with as many threads as it had
        again = replay(case.material.recipe, folder=case.folder())
    same(again.values, case.material.values, "the recipe makes other voxels")
    assert digest(again.values) == _digest(case), "the recipe holds another digest"
    assert again.recipe.to_json() == case.material.recipe.to_json(), "the recipe changes"


_DIGEST = """
import importlib, json, sys
import trabecula as tb
from trabecula.synth.api.registry import register

module, _, name = sys.argv[1].partition(":")
cls, settings = getattr(importlib.import_module(module), name), json.loads(sys.argv[2])
given = sys.argv[3:]
model = cls.configure(**settings).fit(tb.read(given[0]) if given else None)
size = (18, 20, 23) if given and model.facts[0].ndim == 2 else (26, 30, 33)
print(model.generate(size, seed=5).recipe.steps[-1]["sha256"])
"""

_OLD = {
    "NUMBA_CPU_NAME": "nehalem",
    "OPENBLAS_CORETYPE": "Nehalem",
    "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F AVX512CD AVX512_SKX",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-AVX512F",
}
"""Variables with which a process compiles for a processor of 2008, with no wide instructions in
NumPy, BLAS and the C library.
"""


@_check("old processor")
def _check_old_processor(case: MethodCase) -> None:
    """Check that a processor without wide instructions makes the same voxels."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        raise Inapplicable("instruction sets of x86-64")
    if case.capabilities.extras:
        raise Inapplicable("the method needs more than the package")
    folder, given = case.folder(), []
    if case.exemplar is not None:
        small = crop(case.exemplar, [min(side, 32) for side in case.exemplar.shape])
        given = [os.fspath(write(small, folder / "exemplar.npy"))]
    path = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    cache = Path(tempfile.gettempdir()) / "trabecula-old-processor"  # compiled kernels stay
    old = {**_OLD, "NUMBA_CACHE_DIR": os.fspath(cache)}
    settings = json.dumps(dict(case.capabilities.trial))
    command = [sys.executable, "-c", _DIGEST, case.capabilities.method, settings, *given]
    found = []
    for extra in ({}, old):
        env = {**os.environ, **path, **extra}
        run = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
        assert run.returncode == 0, f"another process fails: {run.stderr}"
        found.append(run.stdout)
    assert found[0] == found[1] != "", "an old processor makes other voxels"


@_check("exemplar unchanged")
def _check_exemplar_unchanged(case: MethodCase) -> None:
    """Check that the exemplar is not written into."""
    before = case.need_exemplar().values.copy()
    case.fit().generate((16, 16, 16), seed=1)
    same(case.need_exemplar().values, before, "the exemplar is written into")


@_check("refused parts")
def _check_refused_parts(case: MethodCase) -> None:
    """Check that parts of a request that the method does not honour are refused by name."""
    first = np.arange(np.prod(SHAPE)).reshape(SHAPE) == 0
    parts: dict[str, dict[str, Any]] = {
        "periodic": {"periodic": True},
        "mask": {"mask": np.ones(SHAPE, bool)},
        "target": {"target": {"porosity": np.full(SHAPE, 0.5)}},
        "fixed": {"fixed": Image(np.zeros(SHAPE, np.uint8), "labels"), "known": first},
    }
    halves = np.arange(SHAPE[2]) % 2 * np.ones((SHAPE[0] // 2, SHAPE[1] // 2, 1))
    parts["coarse"] = {"coarse": Image(halves.astype(np.uint8), "labels")}
    parts["like"] = {"like": Image(np.zeros(SHAPE, np.uint8), "labels")}
    for part, words in parts.items():
        if part not in case.capabilities.honours:
            with raises(RequestError, part, f"{part} should be refused"):
                case.model.generate(SHAPE, seed=1, **words)


@_check("budget")
def _check_budget(case: MethodCase) -> None:
    """Check that a run over its budget is refused before it starts."""
    _ = case.model

    def refused() -> None:
        with raises(MemoryBudgetError, "GiB|TiB", "4000^3 voxels should not fit into 1 GiB"):
            case.model.generate((4000, 4000, 4000), seed=1, memory=GIB)

    assert peak_bytes(refused) < 1 << 20, "memory was taken before the budget was checked"


_OUTSIDE = ("interpreter and kernels", "exemplar", "network")  # what tracemalloc does not see


@_check("memory forecast")
def _check_memory(case: MethodCase) -> None:
    """Check that a run takes no more memory than was forecast, and not much less."""
    hook = "box_memory" if case.capabilities.large == "box" else "memory"
    if getattr(type(case.model), hook) is getattr(WindowModel, hook, None):
        raise Inapplicable(f"the model has no hook {hook}")
    if getattr(type(case.model), hook) is getattr(Model, hook, None):
        raise Inapplicable(f"the model has no hook {hook}")
    # Its length changes nothing in what it holds.
    model = case.fast_model
    request = Request((96, 88, 80), seed=1)
    plan = model.plan(request)
    arrays = plan.peak - sum(plan.memory.get(part, 0) for part in _OUTSIDE)
    model.generate(Request((16, 16, 16), seed=1))  # so that loading kernels is not counted
    peak = peak_bytes(lambda: model.generate(request))
    assert peak <= arrays, f"the run takes {peak} bytes, {arrays} were forecast"
    assert arrays <= 1.5 * peak, f"{arrays} bytes are forecast, the run takes {peak}"


@_check("memory-mapped forecast")
def _check_resident_memory(case: MethodCase) -> None:
    """Check that a run in memory-mapped arrays takes no more memory than was forecast."""
    if case.capabilities.large != "memmap":
        raise Inapplicable("the method makes nothing in memory-mapped arrays")
    model, folder = case.fast_model, case.folder()
    request = Request((64, 72, 56), seed=1)
    budget = model.plan_mapped(request, 0).peak + (4 << 20)
    plan = model.plan_mapped(request, budget)
    arrays = plan.peak - sum(plan.memory[part] for part in _OUTSIDE[:2])
    generate_to(model, Request((16, 16, 16), seed=1), folder / "small.zarr", chunks=16)
    path = folder / "x.zarr"
    peak = peak_bytes(lambda: generate_to(model, request, path, memory=budget, chunks=32))
    assert plan.peak <= budget and plan.disk > np.prod(request.shape), f"{plan} for {budget} bytes"
    assert peak <= arrays, f"{peak} bytes are in memory beside the files, {arrays} were forecast"


@_check("learning forecast")
def _check_learning(case: MethodCase) -> None:
    """Check that learning takes no more memory than was forecast, and keeps to its budget."""
    if case.trains:
        raise Inapplicable("the method learns in memory that tracemalloc does not see")
    if case.cls.memory is Method.memory:
        raise Inapplicable("the method has no hook memory")
    exemplar, chosen = case.need_exemplar(), case.method()
    plan = chosen.plan_fit(exemplar)
    chosen.fit(exemplar)  # so that loading kernels is not counted
    peak = peak_bytes(lambda: chosen.fit(exemplar))
    arrays = plan.peak - plan.memory.get("interpreter and kernels", 0)
    assert peak <= arrays <= 1.5 * peak, f"learning takes {peak} bytes, {arrays} were forecast"
    with raises(MemoryBudgetError, "smaller crop", "learning over its budget should be refused"):
        chosen.fit(exemplar, memory=plan.peak - 1)


@_check("refused exemplars")
def _check_refused_exemplars(case: MethodCase) -> None:
    """Check that exemplars that cannot be used are refused with the reason."""
    image, told = case.need_exemplar(), case.capabilities
    other = image.values[0] if image.ndim == 3 else np.stack([image.values] * 30)
    wrong: dict[str, tuple[Any, str]] = {
        "floating labels": (image.values.astype(np.float32), "plain array"),
    }
    if not told.accepts(5 - image.ndim):
        wrong["other dimensions"] = (Image(other, image.kind), "exemplar")
    if "grey" not in told.kinds:
        wrong["grey values"] = (Image(image.values.astype(np.float32), "grey"), "grey")
    if image.kind == "labels":
        wrong["one phase"] = (np.zeros_like(image.values), "one phase")
    for what, (given, words) in wrong.items():
        with raises(InputError, words, f"an exemplar of {what} should be refused"):
            case.fit(given)
    try:
        case.fit(np.resize(image.values, (5,) * image.ndim))
    except InputError as error:
        assert "exemplar" in str(error), f"a small exemplar is refused without a reason: {error}"
    with raises(InputError, "those of the exemplar", "a spacing beside it should be refused"):
        case.method().fit(image, spacing=0.5)


@_check("settings alone")
def _check_alone(case: MethodCase) -> None:
    """Check that the settings alone are enough, or that an exemplar is asked for."""
    told, chosen, folder = case.capabilities, case.method(), case.folder()
    if not told.alone:
        with raises(InputError, "no exemplar was given", "an exemplar should be asked for"):
            chosen.fit()
        return
    model = chosen.fit(spacing=VOXEL[0], unit=VOXEL[1])
    made = model.generate(SHAPE, seed=SEED)
    found = (made.shape, made.kind, made.spacing, made.unit)
    assert found == (SHAPE, "labels", (VOXEL[0],) * 3, VOXEL[1]), f"got {found}"
    assert made.phases == ("void", "solid"), f"the phases are {made.phases}"
    assert 0 < made.values.mean() < 1, "the result has one phase only"
    again = chosen.fit(spacing=VOXEL[0], unit=VOXEL[1]).generate(SHAPE, seed=SEED)
    same(again.values, made.values, "a second model makes other voxels")
    write(made, folder / "made.npy")
    same(rerun(folder / "made.npy").values, made.values, "the recipe makes other voxels")
    loaded = load_model(model.save(folder / "one.model")).generate(SHAPE, seed=SEED)
    same(loaded.values, made.values, "a model from its file makes other voxels")
    if isinstance(model, WindowModel):
        part = tuple(slice(*ends) for ends in _BOXES[1])
        found_box = model.window(SHAPE, _BOXES[1], seed=SEED)
        same(found_box, made.values[part], "a window is no part of the whole")
    if "picture" in told.makes:
        picture = model.generate((40, 50), seed=SEED)
        assert (picture.shape, picture.spacing) == ((40, 50), (VOXEL[0],) * 2), repr(picture)


_SMALL = (16, 18, 20)


def _target_model(case: MethodCase) -> Model:
    """Return a model for targets, or say that the method honours none."""
    if "target" not in case.capabilities.honours:
        raise Inapplicable("the method honours no target")
    return case.fast_model


def _asked(model: Model, shape: tuple[int, ...], target: Mapping[str, Any]) -> Image:
    """Return a result with a target; a method that trains may say that its trial, too short to
    have learnt any, has none like it.
    """
    try:
        return model.generate(shape, seed=1, target=target)
    except RequestError as refusal:
        if model.capabilities.stores_exemplar or "outside of" not in str(refusal):
            raise
        raise Inapplicable(f"the trial is too short: {refusal}") from refusal


@_check("target fraction")
def _check_fraction(case: MethodCase) -> None:
    """Check that a volume fraction is 1 minus the porosity, and is met within .06."""
    model = _target_model(case)
    if "porosity" not in case.capabilities.targets:
        raise Inapplicable("the method honours no porosity")
    # what walls between bubbles leave, or what is near to the exemplar's
    wanted = 0.6 if case.capabilities.alone else 0.75
    targets: tuple[dict[str, float], ...] = ({"porosity": wanted}, {"volume_fraction": 1 - wanted})
    made = [_asked(model, _SMALL, target) for target in targets]
    same(made[1].values, made[0].values, "volume_fraction is not 1 - porosity")
    found = 1 - porosity(made[0])
    assert abs(found - (1 - wanted)) <= 0.06, f"{1 - wanted:g} was asked for, got {found:.3f}"


@_check("refused targets")
def _check_refused_targets(case: MethodCase) -> None:
    """Check that a descriptor that is not honoured is refused by name."""
    model = _target_model(case)
    others = ("surface", "mean_curvature", "euler", "perimeter", "volume_fraction:solid")
    for name in others:
        head = f"{name.partition(':')[0]}:" if ":" in name else name
        if head not in case.capabilities.targets:
            with raises(RequestError, f"cannot honour the target {name}", f"{name}: no refusal"):
                model.plan(Request(_SMALL, target={name: 0.1}))


@_check("target field")
def _check_field(case: MethodCase) -> None:
    """Check that a field of porosity is followed, or refused before the work."""
    model, shape = _target_model(case), (60, 20, 20)
    low, high = model.porosities() or (0.68, 0.9)
    quarter = (high - low) / 4
    refusal: RequestError | None = None
    for first, last in ((0.68, 0.9), (low + quarter, high - quarter)):
        ramp = np.linspace(first, last, 60, dtype=np.float32)[:, None, None]
        try:
            made = _asked(model, shape, {"porosity": np.broadcast_to(ramp, shape)}).values
        except RequestError as error:
            refusal = error
            if "one number" in str(error):
                return
            continue
        assert made[:25].mean() > made[35:].mean(), "the field of porosity is not followed"
        return
    raise AssertionError(f"the refusal gives no advice: {refusal}")

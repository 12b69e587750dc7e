"""`gan` by the paper's recipe at the paper's width, within the minutes that a graphics card is lent
for: profile, training, figures, a model in parts. It runs with NumPy and PyTorch, and says at once
what else it lacks.

    trabecula bench gan_paper --device cuda --minutes 9 --batch 16 --out DIR --state FOLDER

The same command again goes on from the checkpoint in FOLDER, until 40,000 iterations are done.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shutil
import sys
import time
import types
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

NEEDED = ("numpy", "torch")
USEFUL = {
    "numba": "kernels run as plain Python: figures are left out, only the model is made",
    "PIL": "no pictures are drawn",
    "zarr": "not needed here",
    "nibabel": "not needed here",
    "nrrd": "not needed here",
}
"""Packages, and what their want means."""


def _missing() -> list[str]:
    """Return the packages that are not installed."""
    return [name for name in (*NEEDED, *USEFUL) if importlib.util.find_spec(name) is None]


def _stand_in_for_numba() -> None:
    """Let kernels run as plain Python where Numba is not installed."""

    def plain(**_: Any) -> Any:
        return lambda function: function

    event = types.ModuleType("numba.core.event")
    event.Listener = object  # type: ignore[attr-defined]
    event.register = lambda *_: None  # type: ignore[attr-defined]
    core, numba = types.ModuleType("numba.core"), types.ModuleType("numba")
    core.event, numba.core, numba.njit = event, core, plain  # type: ignore[attr-defined]
    sys.modules.update({"numba": numba, "numba.core": core, "numba.core.event": event})


if "numba" in _missing():
    _stand_in_for_numba()

import trabecula as tb  # noqa: E402
from common import asked, pictures, table, tell  # noqa: E402
from trabecula.core.checks import as_number  # noqa: E402
from trabecula.core.errors import InputError, MemoryBudgetError  # noqa: E402
from trabecula.core.progress import listen  # noqa: E402

ITERATIONS = 40_000
PROFILED = 50
PART = 15 << 20
"""Bytes of a part of the model at most."""

PEAK = 798e12
"""Multiplications and additions a second of an H100 in bf16, measured in products of matrices."""

REHEARSAL: dict[str, Any] = {"width": 6, "latent": 10, "batch": 2}
"""Instead of 64, 100 and 100 on a processor: a tenth of the width."""

SIDE = {"cuda": 120, "cpu": 64}
SAMPLES = {"cuda": 10, "cpu": 1}
RESERVE = {"cuda": 80.0, "cpu": 10.0}
"""Seconds of a command for the calibration, the figures and the files."""

LOOKS = 12
"""Evaluations in the minutes of one command."""


def gan_paper() -> None:
    """`--device cuda --minutes M --out DIR [--state FOLDER] [--only EXEMPLAR] [--batch B]`: the
    paper's training on bone for M minutes, resumed by the same command; profile, figures, model in
    parts. With B crops an iteration instead of the paper's 100 more iterations fit into M minutes;
    100 are profiled as well.

    The exemplar is `sample:bone` (96^3) or a file, of which 100^3 are taken. DIR holds
    figures.json, bone.model.1ofN and pictures: at most 8 files of 16 MiB. `--device cpu` rehearses
    it at a tenth of the width.
    """
    start, device = time.monotonic(), (asked("DEVICE") or ["cuda"])[0]
    minutes = _number("minutes", 24.0, high=1e5)
    _check(device, minutes)
    out = pictures() or Path("gan_paper")
    state = Path((asked("STATE") or [os.fspath(out / "state")])[0])
    out.mkdir(parents=True, exist_ok=True)
    state.mkdir(parents=True, exist_ok=True)
    image = _exemplar()
    settings = {**_settings(device), **_stored(state / "settings.json")}
    found = {"device": device, "exemplar": repr(image), "missing": _missing()}
    found["forecast"] = _forecast(settings)
    spent = _seconds_in(state)
    if not spent:
        if asked("BATCH"):
            found["profile of the paper's batch"], _ = _profile(image, settings, minutes)
            settings = {**settings, "batch": int(_number("batch", 100.0, high=512, whole=True))}
        found["profile"], settings = _profile(image, settings, minutes)
        (state / "settings.json").write_text(json.dumps(settings))
        (state / "profile.json").write_text(json.dumps(found["profile"]))
    else:
        tell("resuming", f"{spent:.0f} s of training are done")
        found["profile"] = _stored(state / "profile.json")
    _write(out, found)
    left = 60 * minutes - RESERVE[device] - (time.monotonic() - start)
    fit = max(1, int(max(left, 5.0) / found["profile"]["seconds an iteration"]))
    tell("fit into this command", f"{fit} of {ITERATIONS} iterations")
    model, settings = _train(image, settings, state, (spent + max(left, 5.0)) / 60, fit)
    found["training"] = dict(model.history)
    _save(model, out, state, found)
    if "numba" not in found["missing"]:
        _measure(model.on(device), image, out, found)
    found["seconds"] = round(time.monotonic() - start, 1)
    _write(out, found)
    tabulate(found)
    tell("written", *(f"{path.name} {path.stat().st_size}" for path in sorted(out.glob("*.*"))))


def _check(device: str, minutes: float) -> None:
    """Say at once what is missing, and raise where nothing can run."""
    for name in _missing():
        tell(f"missing: {name}", USEFUL.get(name, "nothing runs without it"))
    lacking = [name for name in NEEDED if name in _missing()]
    if lacking:
        raise InputError(f"gan_paper needs {' and '.join(lacking)}: install them first")
    if device not in SAMPLES or not 0 < minutes < 1e4:
        raise InputError(f"--device {device} --minutes {minutes}: cuda or cpu, and minutes above 0")
    from trabecula.synth.gan.config import GanConfig
    from trabecula.synth.gan.train import find_device

    find_device(GanConfig(device=device))


def _exemplar() -> tb.Image:
    """Return the exemplar: 100^3, as the paper's, or what there is of it."""
    named = asked("ONLY")
    image = tb.read(named[0]) if named else tb.sample("bone")
    return tb.crop(image, min(100, *image.shape))


def _settings(device: str) -> dict[str, Any]:
    small = REHEARSAL if device == "cpu" else {}
    storage = {"device": device, "storage": "float16", "iterations": ITERATIONS}
    return {"preset": "paper", **small, **storage}


def _stored(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text()) if path.is_file() else {}


def _write(out: Path, found: Mapping[str, Any]) -> None:
    """Write what is known so far: a cut leaves it."""
    (out / "figures.json").write_text(json.dumps(found, indent=1, default=float))


def _forecast(settings: Mapping[str, Any]) -> dict[str, float]:
    """Return the arithmetic of the training, and the minutes that an H100 would take for it."""
    from trabecula.synth.gan.config import GanConfig
    from trabecula.synth.gan.forecast import iteration_flops

    plain = {name: value for name, value in settings.items() if name != "preset"}
    once = iteration_flops(GanConfig(**{**GanConfig.preset(settings["preset"]), **plain}))
    least = ITERATIONS * once / PEAK / 60
    tell(
        "forecast",
        f"{once / 1e12:.3g} TFLOP an iteration, {ITERATIONS * once / 1e18:.2g} EFLOP in all: "
        f"{least:.3g} minutes of an H100 at its peak, {4 * least:.3g} at a quarter of it",
    )
    return {"TFLOP an iteration": once / 1e12, "minutes at the peak": least}


def _profile(
    image: tb.Image, settings: dict[str, Any], minutes: float
) -> tuple[dict[str, float], dict[str, Any]]:
    """Take the seconds of an iteration, with half the batch where the card is too small for it."""
    import torch

    from trabecula.synth.gan.forecast import iteration_flops

    while True:
        config = tb.method("gan", **settings).config
        try:
            seconds, taken = _seconds_an_iteration(image, config, 60 * minutes / 5)
            break
        except torch.OutOfMemoryError:
            if config.batch == 1:
                raise
            settings = {**settings, "batch": config.batch // 2}
            torch.cuda.empty_cache()
            tell("the card's memory is too small", f"batch={settings['batch']} from here on")
    speed = iteration_flops(config) / seconds
    found = {
        "iterations": taken,
        "seconds an iteration": seconds,
        "TFLOP/s": speed / 1e12,
        "share of the peak": speed / PEAK,
        "batch": config.batch,
    }
    if config.device == "cuda":
        found["GPU memory at most, GiB"] = torch.cuda.max_memory_allocated() / 2**30
        torch.cuda.empty_cache()
    tell("profile", *(f"{name} {value:.4g}" for name, value in found.items()))
    return found, settings


def _seconds_an_iteration(image: tb.Image, config: Any, most: float) -> tuple[float, int]:
    """Return the seconds of an iteration and how many were taken, within `most` seconds."""
    import torch

    from trabecula.synth.gan.adversarial import AdversarialPair
    from trabecula.synth.gan.crops import exemplar_fields
    from trabecula.synth.gan.losses import CHUNK, TABLE, CandidateTable
    from trabecula.synth.gan.train import find_device

    device = find_device(config)
    fields = exemplar_fields(image, config).on(device)
    pair = AdversarialPair(config, fields.channels, device)
    pair.table = CandidateTable(fields.crops(min(TABLE, 4 * config.batch), 0, 2**40), chunk=CHUNK)
    random = torch.Generator(device).manual_seed(0)
    first = max(1, PROFILED // 10)
    start, taken, mark = time.monotonic(), 0, time.monotonic()
    while taken < PROFILED + first and (taken < 2 or time.monotonic() - start < most):
        # `train_step` reads its losses, which waits for the card
        pair.train_step(fields.crops(config.batch, 0, taken), random, taken, 0.0)
        taken += 1
        if taken == first or (taken == 1 and time.monotonic() - start > most / 4):
            mark, first = time.monotonic(), taken
    return (time.monotonic() - mark) / max(1, taken - first), taken


def _seconds_in(state: Path) -> float:
    """Return the seconds of training that the checkpoint holds, 0 where there is none."""
    from trabecula.synth.gan.log import checkpoint_words

    return float(checkpoint_words(state).get("state", {}).get("seconds", 0.0))


def _train(
    image: tb.Image, settings: dict[str, Any], state: Path, minutes: float, fit: int
) -> tuple[Any, dict[str, Any]]:
    """Train until the minutes are over, with half the batch where the card's memory runs out."""
    looks = min(1000, max(1, round(LOOKS * ITERATIONS / fit)))
    more = {"minutes": minutes, "looks": looks, "run": os.fspath(state)}
    more["checkpoint"] = min(2.0, max(0.05, minutes / 6))
    while True:
        try:
            with listen(lambda label, done: tell(label) if done < 0 else None):
                return tb.method("gan", **settings, **more).fit(image), settings
        except MemoryBudgetError as error:
            batch = tb.method("gan", **settings).config.batch
            if settings["device"] != "cuda" or batch == 1:
                raise
            tell(error)
            settings = {**settings, "batch": batch // 2}
            (state / "settings.json").write_text(json.dumps(settings))


def _save(model: Any, out: Path, state: Path, found: dict[str, Any]) -> None:
    """Write the model in parts, and the curve of the losses."""
    model.save(out / "bone.model", part_bytes=PART)
    found["sha256"] = model.sha256
    if (state / "training.png").is_file():
        shutil.copyfile(state / "training.png", out / "training.png")
    if (state / "metrics.csv").is_file():
        shutil.copyfile(state / "metrics.csv", out / "metrics.csv")
    _write(out, found)


def _measure(model: Any, image: tb.Image, out: Path, found: dict[str, Any]) -> None:
    """Measure samples as table 1 does (on a card of 120^3), and draw the first ones."""
    from by_example import figures
    from trabecula.view.slices import montage

    samples, seconds = [], []
    found["samples"] = []
    for seed in range(SAMPLES[found["device"]]):
        start = time.monotonic()
        samples.append(model.generate(SIDE[found["device"]], seed=seed))
        seconds.append(time.monotonic() - start)
        try:
            found["samples"].append(asdict(figures(image, samples[-1])))
        except tb.errors.TrabeculaError as error:  # one phase alone, early in a training
            found["samples"].append({"not measured": str(error)})
        _write(out, found)
    found["seconds a sample"] = min(seconds)
    measured = [one for one in found["samples"] if "not measured" not in one]
    if measured:
        names = measured[0]
        found["mean"] = {n: sum(one[n] for one in measured) / len(measured) for n in names}
        tell("means", *(f"{name} {value:.4g}" for name, value in found["mean"].items()))
    if "PIL" not in found["missing"]:
        titles = ["exemplar", *(f"seed {seed}" for seed in range(3))]
        montage([image, *samples[:3]], titles[: 1 + len(samples[:3])], out / "slices.png")


def tabulate(found: Mapping[str, Any]) -> None:
    """Print what an iteration takes, and what the samples are like, from figures.json."""
    row = table("crops an iteration", "s", "TFLOP/s", f"minutes for {ITERATIONS:,}")
    for name in ("profile of the paper's batch", "profile"):
        if one := found.get(name):
            seconds, speed = one["seconds an iteration"], one["TFLOP/s"]
            row(
                str(one["batch"]),
                f"{seconds:.3f}",
                f"{speed:.0f}",
                f"{seconds * ITERATIONS / 60:.0f}",
            )
    if not (measured := [one for one in found.get("samples", ()) if "not measured" not in one]):
        return
    row = table("iterations", "porosity error %", "D2", "N_cc / N_f", "largest", "s")

    def told(name: str) -> str:
        values = [one[name] for one in measured]
        return f"{sum(values) / len(values):.2f} ({min(values):.2f} - {max(values):.2f})"

    counts = (round(found["mean"][name]) for name in ("components", "floating"))
    row(
        str(found["training"]["iterations"]),
        told("error"),
        told("distance"),
        "/".join(map(str, counts)),
        told("largest"),
        f"{found['seconds a sample']:.2f}",
    )


def _number(name: str, default: float, *, high: float, whole: bool = False) -> float:
    """Return an option of the command as a number."""
    given = (asked(name.upper()) or [str(default)])[0]
    try:
        value = float(given)
    except ValueError:
        raise InputError(f"--{name} {given} is no number") from None
    return float(as_number(value, name=name, low=1 if whole else 0, high=high, whole=whole))


if __name__ == "__main__":
    try:
        gan_paper()
    except tb.errors.TrabeculaError as error:
        print(f"trabecula: {error}", file=sys.stderr)
        sys.exit(2)

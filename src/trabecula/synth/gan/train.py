"""Training: one loop. Random numbers are functions of seed and iteration, so that a run resumes
where it stopped.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from trabecula.core.errors import InputError, MemoryBudgetError, TrainingError
from trabecula.core.image import Image
from trabecula.core.progress import notify, report
from trabecula.core.seeds import key
from trabecula.engine.parallel import thread_count
from trabecula.synth.gan.adversarial import Players
from trabecula.synth.gan.calibrate import calibration_of
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.data import Fields, fields_of
from trabecula.synth.gan.figures import Figures, trouble_with
from trabecula.synth.gan.loading import network_of
from trabecula.synth.gan.log import TrainingLog
from trabecula.synth.gan.perceptual import Table
from trabecula.synth.gan.resume import kept, left

TABLE, CHUNK = 16, 4
"""Crops that hold the candidates of the structural loss, and how many of them at once."""

_CHECK = 10  # iterations between two glances at whether it is alive
_YOUNG = 0.1  # share of the training after the warm-up in which everything may still look alike
_RESTARTS = 4
_SLOWER = 0.5  # the rate after a restart, times the one before
_LEAST = 0.02  # of the rate, at the end of its decay
_BETTER = 0.98  # an improvement is a figure below this much of the best


@dataclass
class TrainingState:
    """Where a training stands: all of it is plain JSON."""

    iteration: int = 0
    seconds: float = 0.0
    pace: float = 1.0
    restarts: int = 0
    best: float = float("inf")
    stale: int = 0

    def done(self, config: GanConfig) -> float:
        """The share of the training that is done, 0 .. 1: by iterations where they are given, so
        that it repeats exactly.
        """
        late = config.minutes and self.seconds >= 60 * config.minutes
        if late or (config.patience and self.stale >= config.patience):
            return 1.0
        if config.iterations:
            return min(1.0, self.iteration / config.iterations)
        return self.seconds / (60 * config.minutes)

    def rate(self, done: float, config: GanConfig) -> float:
        """The rate as a share of the config's."""
        falling = min(1.0, (1 - done) / config.decay) if config.decay else 1.0
        return self.pace * max(falling, _LEAST)

    def noticed(self, figure: float) -> None:
        """Count looks without improvement."""
        if figure < _BETTER * self.best:
            self.best, self.stale = figure, 0
        else:
            self.stale += 1


def trained(config: GanConfig, image: Image) -> dict[str, Any]:
    """Train on an exemplar.

    Parameters
    ----------
    config : GanConfig
    image : Image
        Labels or grey, at least a crop along every axis.

    Returns
    -------
    state : dict
        "generator": weights by name; "calibration": see `decode`; "training": what there is to
        tell, plain JSON.

    Raises
    ------
    InputError
        The exemplar is smaller than a crop; no such device.
    MemoryBudgetError
        The graphics card has too little memory.
    TrainingError
        It diverged or collapsed again and again.
    """
    check_size(image, config)
    fields = fields_of(image, config).on(device_of(config))
    with _threads(), _memory_told(config):
        return _trained(config, image, fields)


def _trained(config: GanConfig, image: Image, fields: Fields) -> dict[str, Any]:
    players = Players(config, len(fields.values), fields.values.device)
    if config.structural:
        players.table = Table(
            fields.crops(min(TABLE, 4 * config.batch), config.seed, 2**40), chunk=CHUNK
        )
    looks = Evaluator(config, image, fields.values.cpu())
    course = looks.resumed(players)
    good, looked, mark = (replace(course), players.state()), -1.0, time.monotonic()
    while (done := course.done(config)) < 1:
        draw = torch.Generator(players.device).manual_seed(
            int(key(config.seed, f"gan/{course.iteration}")) >> 1
        )
        real = fields.crops(config.batch, config.seed, course.iteration)
        players.paced(course.rate(done, config))
        if done < config.warmup:
            told = players.warm(real, draw)
        else:
            noise = config.noise[0] + (config.noise[1] - config.noise[0]) * done
            told = players.play(real, draw, course.iteration, noise)
        course.iteration += 1
        players.averaged(course.iteration)
        course.seconds, mark = course.seconds + time.monotonic() - mark, time.monotonic()
        if course.iteration % _CHECK == 0:
            grown = done > config.warmup + _YOUNG
            if trouble := trouble_with(players.shown(draw), real, told, grown=grown):
                course = _back(trouble, course, good[0])
                players.restore(good[1])
                continue
        report(_line(course, told), done)
        if done - looked >= 1 / config.looks:
            looked = done
            course.noticed(looks.at(players, course, told))
            good = (replace(course), players.state())
            kept(config, image, good[1], {"course": vars(course), "rows": looks.folder.rows})
    report("training", 1.0)
    return looks.state(players, course)


class Evaluator:
    """What is seen of a training from time to time, and at its end."""

    def __init__(self, config: GanConfig, image: Image, fields: Tensor) -> None:
        self.config, self.image, self.fields = config, image, fields
        self.figures, self.folder = Figures(image, config.seed), TrainingLog(config.run)

    def resumed(self, players: Players) -> TrainingState:
        """Where the same run was left, or its start."""
        found = left(self.config, self.image)
        if found is None:
            return TrainingState()
        course = TrainingState(**found.plain["course"])
        players.restore(found.tensors)
        self.folder.continued(found.plain["rows"])
        notify(f"going on after {course.iteration} iterations")
        return course

    def at(self, players: Players, course: TrainingState, told: dict[str, float]) -> float:
        """Look, keep figures and picture, and return the figure that tells how near it is."""
        seen, middle = self.figures.of(self._ready(players), self.fields)
        self.folder.add(
            {"iteration": course.iteration, "minutes": course.seconds / 60, **told, **seen}, middle
        )
        return seen.get("two_point", seen["distance"])

    def state(self, players: Players, course: TrainingState) -> dict[str, Any]:
        """What a model keeps."""
        self.at(players, course, {})
        names = ("distance", "two_point", "largest", "euler")
        return {
            "generator": {
                name: tensor.cpu() for name, tensor in players.average.state_dict().items()
            },
            "calibration": calibration_of(self._ready(players), self.image, self.config.seed),
            "training": {
                "iterations": course.iteration,
                "minutes": round(course.seconds / 60, 2),
                "threads": thread_count(),
                "device": players.device.type,
                "restarts": course.restarts,
                "seed": self.config.seed,
                "torch": str(torch.__version__),
                "figures": {n: round(v, 5) for n, v in self.folder.rows[-1].items() if n in names},
            },
        }

    def _ready(self, players: Players) -> Any:
        """The averaged maker as it will make material: on the processor, in that arithmetic."""
        weights = {
            name: tensor.cpu().numpy() for name, tensor in players.average.state_dict().items()
        }
        return network_of(self.config, players.channels, weights)


def _back(trouble: str, course: TrainingState, last: TrainingState) -> TrainingState:
    """The course from the last good state on, at a lower rate."""
    if course.restarts >= _RESTARTS:
        raise TrainingError(
            f"the training failed {course.restarts + 1} times ({trouble}): try a lower rate, a higher penalty or another seed"
        )
    pace = course.pace * _SLOWER
    notify(
        f"after {course.iteration} iterations {trouble}: back to {last.iteration}, with the rate times {pace:g}"
    )
    # The clock goes on, or a run that fails again and again would never end.
    return replace(last, seconds=course.seconds, pace=pace, restarts=course.restarts + 1)


def _line(course: TrainingState, told: dict[str, float]) -> str:
    losses = " ".join(
        f"{name} {value:.2f}" for name, value in told.items() if name in ("judge", "maker")
    )
    return f"training {course.iteration}: {losses}"


def check_size(image: Image, config: GanConfig) -> None:
    """Raise where an exemplar is smaller than a crop."""
    if min(image.shape) < config.crop:
        fits = min(image.shape) // config.cell * config.cell
        advice = f", or set crop={fits}" if fits >= config.least_crop else ""
        raise InputError(
            f"the exemplar is {image.shape}, training judges crops of {config.crop} voxels along every axis: give a larger "
            f"exemplar{advice}"
        )


def device_of(config: GanConfig) -> torch.device:
    """Where to train."""
    there = torch.cuda.is_available()
    if config.device == "cuda" and not there:
        raise InputError(
            "device='cuda', but PyTorch finds no GPU: use device='cpu', or install a PyTorch built for it"
        )
    return torch.device("cuda" if there and config.device != "cpu" else "cpu")


@contextmanager
def _threads() -> Iterator[None]:
    """As many threads in PyTorch as the package uses."""
    before = torch.get_num_threads()
    torch.set_num_threads(thread_count())
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def _memory_told(config: GanConfig) -> Iterator[None]:
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise MemoryBudgetError(
            f"the GPU has too little memory for batch={config.batch} at width={config.width}: lower batch first, then width"
        ) from error

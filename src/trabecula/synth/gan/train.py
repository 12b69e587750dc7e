"""Training: one loop, its checkpoints, and what it says where it cannot go on.

Random numbers are functions of seed and iteration, so that a run resumes where it stopped.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import torch

from trabecula.core.errors import InputError, MemoryBudgetError, TrainingError
from trabecula.core.image import Image
from trabecula.core.progress import notify, report
from trabecula.core.seeds import key
from trabecula.engine.parallel import thread_count
from trabecula.synth.gan.adversarial import AdversarialPair
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.crops import TrainingFields, effective_config, fields_of
from trabecula.synth.gan.evaluation import Evaluator, TrainingState, failure
from trabecula.synth.gan.forecast import check_device_memory
from trabecula.synth.gan.log import save_checkpoint
from trabecula.synth.gan.losses import CHUNK, TABLE, CandidateTable
from trabecula.synth.gan.slices import PictureFields

_CHECK = 10  # iterations between two checks for failure
_YOUNG = 0.1  # share of the training after the warm-up in which everything may still look alike
_RESTARTS = 4
_SLOWER = 0.5  # the rate after a restart, times the one before


def train(config: GanConfig, given: Image | Sequence[Image]) -> dict[str, Any]:
    """Train on an exemplar, or on pictures.

    Parameters
    ----------
    config : GanConfig
    given : Image, or sequence of Image
        Labels or grey, at least a crop along every axis: one volume, or pictures for the views of
        the config.

    Returns
    -------
    state : dict
        "generator": arrays by name; "calibration": see `decode`; "training": its history, plain
        JSON.

    Raises
    ------
    InputError
        The exemplar is smaller than a crop; no such device.
    MemoryBudgetError
        The graphics card has too little memory: before the training by the forecast, or in it.
    TrainingError
        It diverged or collapsed again and again.
    """
    images = [given] if isinstance(given, Image) else list(given)
    for image in images:
        check_size(image, config)
    config = effective_config(config, images)
    device = find_device(config)
    check_device_memory(config, images, device)
    fields = fields_of(images, config).on(device)
    with _package_threads():
        return _Training(config, images, fields).run()


class _Training:
    """A training from its start or its checkpoint to its end."""

    def __init__(
        self, config: GanConfig, images: Sequence[Image], fields: TrainingFields | PictureFields
    ) -> None:
        self.config, self.images, self.fields = config, images, fields
        views = fields.views if isinstance(fields, PictureFields) else ()
        self.pair = AdversarialPair(config, fields.channels, fields.device, views, fields.local)
        if config.structural:
            candidates = fields.crops(min(TABLE, 4 * config.batch), config.seed, 2**40)
            self.pair.table = CandidateTable(candidates, chunk=CHUNK)
        self.evaluator = Evaluator(config, images, fields)
        self.state = self.evaluator.resume(self.pair)
        self.good = replace(self.state), self.pair.state()
        self.sound = False  # at the last check
        self.learnt = False  # sound at a check after the first quarter of the warm-up
        self.written = time.monotonic()

    def run(self) -> dict[str, Any]:
        """Train to the end; return the parts of a model."""
        try:
            self._iterate()
            report("training", 1.0)
            result = self.evaluator.result(self.pair, self.state)
        except torch.OutOfMemoryError as error:
            raise MemoryBudgetError(self._explain_memory()) from error
        self._save(self.pair.state())
        return result

    def _iterate(self) -> None:
        config, pair, evaluated, mark = self.config, self.pair, -1.0, time.monotonic()
        while (done := self.state.progress(config)) < 1:
            look = done - evaluated >= 1 / config.looks
            step_losses = self._step(done, look)
            state = self.state
            state.seconds, mark = state.seconds + time.monotonic() - mark, time.monotonic()
            if step_losses is None:
                continue
            report(_progress_line(state, step_losses), done)
            if look:
                evaluated = done
                state.count_stale(self.evaluator.evaluate(pair, state, step_losses))
                tensors = pair.state()
                if self.sound and self.learnt:
                    self.good = replace(state), tensors
                if self._worth_saving():
                    self._save(tensors)
            elif config.run and self._checkpoint_due() and self._worth_saving():
                self._save(pair.state())

    def _checkpoint_due(self) -> bool:
        return time.monotonic() - self.written >= 60 * self.config.checkpoint

    def _worth_saving(self) -> bool:
        """Tell whether to resume from this state: no training recovers from a collapse, in which a
        young network may be for a while; but before it was ever sound there is nothing better.
        """
        return self.sound or not self.learnt

    def _step(self, done: float, look: bool) -> dict[str, float] | None:
        """Make one iteration; return its losses, None where it failed and the state went back."""
        config, pair, state = self.config, self.pair, self.state
        random = torch.Generator(pair.device).manual_seed(
            int(key(config.seed, f"gan/{state.iteration}")) >> 1
        )
        place = config.batch, config.seed, state.iteration
        real, given = self.fields.crops(*place), self.fields.given(*place)
        pair.set_learning_rate(state.rate(done, config))
        if done < config.warmup:
            step_losses = pair.warmup_step(real, random, state.iteration, given=given)
        else:
            noise = config.noise[0] + (config.noise[1] - config.noise[0]) * done
            step_losses = pair.train_step(
                real, random, state.iteration, noise, given=given, shares=look
            )
        state.iteration += 1
        pair.update_ema(state.iteration)
        check = state.iteration % _CHECK == 0
        if look or check:
            made = pair.sample(random, given)
            # Halfway through the warm-up it should make something, and not lose it again.
            warm = done < config.warmup and (self.learnt or done > config.warmup / 2)
            grown = warm or done > config.warmup + _YOUNG
            self.sound = not failure(made, real, step_losses)
            self.learnt |= self.sound and done >= config.warmup / 4
            if check and (found := failure(made, real, step_losses, grown=grown)):
                self.state = _restart(found, state, self.good[0])
                pair.restore(self.good[1])
                return None
        return step_losses

    def _save(self, tensors: Mapping[str, Any], **words: Any) -> None:
        """Write a checkpoint of these tensors and the state."""
        plain = {"state": vars(self.state), "rows": self.evaluator.log.rows, **words}
        save_checkpoint(self.config, self.images, tensors, plain)
        self.written = time.monotonic()

    def _explain_memory(self) -> str:
        """Write the last good state as a checkpoint that a smaller batch resumes; return what to
        lower.
        """
        config = self.config
        torch.cuda.empty_cache()
        self.state = replace(self.good[0], seconds=self.state.seconds)
        self._save(self.good[1], out_of_memory=True)
        advice = (
            f"set batch={config.batch // 2}, then a smaller width"
            if config.batch > 1
            else f"set width={max(2, config.width // 2)}"
        )
        more = (
            f"; with a lower batch the same command resumes after {self.state.iteration} "
            f"iterations from {config.run}"
            if config.run and config.batch > 1
            else "; with --run FOLDER a lower batch would resume from there"
            if not config.run
            else ""
        )
        return (
            f"the GPU has too little memory for batch={config.batch} at width={config.width}: "
            f"{advice}{more}"
        )


def _restart(found: str, state: TrainingState, last: TrainingState) -> TrainingState:
    """Return the last good state with a lower rate."""
    if state.restarts >= _RESTARTS:
        raise TrainingError(
            f"the training failed {state.restarts + 1} times ({found}): try a lower rate, "
            "a higher penalty or another seed"
        )
    pace = state.pace * _SLOWER
    notify(
        f"after {state.iteration} iterations {found}: back to {last.iteration}, "
        f"with the rate times {pace:g}"
    )
    # The clock continues, or a run that fails again and again would never end.
    return replace(last, seconds=state.seconds, pace=pace, restarts=state.restarts + 1)


def _progress_line(state: TrainingState, step_losses: dict[str, float]) -> str:
    losses = " ".join(
        f"{name} {value:.2f}"
        for name, value in step_losses.items()
        if name in ("discriminator", "generator")
    )
    return f"training {state.iteration}: {losses}"


def check_size(image: Image, config: GanConfig) -> None:
    """Raise where an exemplar is smaller than a crop."""
    if min(image.shape) < config.crop:
        fits = min(image.shape) // config.cell * config.cell
        advice = f", or set crop={fits}" if fits >= config.least_crop else ""
        points = "voxels" if image.ndim == 3 else "pixels"
        raise InputError(
            f"the exemplar is {image.shape}, training takes crops of {config.crop} {points} along "
            f"every axis: give a larger exemplar{advice}"
        )


def find_device(config: GanConfig) -> torch.device:
    """Return the device to train on."""
    there = torch.cuda.is_available()
    if config.device == "cuda" and not there:
        raise InputError(
            "device='cuda', but PyTorch finds no GPU: use device='cpu', or install a PyTorch built "
            "for it"
        )
    return torch.device("cuda" if there and config.device != "cpu" else "cpu")


@contextmanager
def _package_threads() -> Iterator[None]:
    """Let PyTorch use as many threads as the package does."""
    before = torch.get_num_threads()
    torch.set_num_threads(thread_count())
    try:
        yield
    finally:
        torch.set_num_threads(before)

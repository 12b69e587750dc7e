"""Training: the exemplar as fields and random crops of them, one loop, and the memory it takes.

Random numbers are functions of seed and iteration, so that a run resumes where it stopped.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from trabecula.core.errors import InputError, MemoryBudgetError, TrainingError
from trabecula.core.image import Image
from trabecula.core.progress import notify, report
from trabecula.core.seeds import generator, key
from trabecula.engine.parallel import thread_count
from trabecula.synth.gan.adversarial import AdversarialPair
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.decode import CELLS
from trabecula.synth.gan.evaluation import SIDE, Evaluator, TrainingState, failure
from trabecula.synth.gan.log import save_checkpoint
from trabecula.synth.gan.losses import CandidateTable
from trabecula.synth.gan.networks import arithmetic, new_discriminator, new_generator
from trabecula.synth.shared.content.fields import phase_fields

_TAIL = 0.001  # share of grey values beyond each end of the range that is stretched over -1 .. 1

Turn = tuple[tuple[int, ...], tuple[int, ...]]
"""Order of the axes 1, 2, 3 of a field, and the axes that are then flipped."""


@dataclass(frozen=True)
class TrainingFields:
    """The fields of an exemplar, and the orientations in which crops are taken.

    Parameters
    ----------
    values : (K, Z, Y, X) float32 tensor
        In -1 .. 1: one channel for two phases, rising into that of the higher label, and for grey;
        else one for each phase.
    turns : tuple
        The orientations that count as alike.
    crop : int
        Edge of a crop, voxels.
    """

    values: Tensor
    turns: tuple[Turn, ...]
    crop: int

    def crops(self, count: int, seed: int, iteration: int) -> Tensor:
        """Return (count, K, crop, crop, crop), random in place and orientation.

        They are a function of seed and iteration alone.
        """
        random = generator(seed, "gan/crops", iteration)
        c = self.crop
        starts = random.integers(0, np.asarray(self.values.shape[1:]) - c + 1, (count, 3)).tolist()
        turns = random.integers(0, len(self.turns), count).tolist()
        parts = []
        for (z, y, x), turn in zip(starts, turns, strict=True):
            order, flipped = self.turns[turn]
            part = self.values[:, z : z + c, y : y + c, x : x + c]
            parts.append(part.permute(0, *order).flip(flipped))
        return torch.stack(parts)

    def on(self, device: torch.device) -> TrainingFields:
        """Return the same on a device."""
        return replace(self, values=self.values.to(device))


def exemplar_fields(image: Image, config: GanConfig) -> TrainingFields:
    """Return the fields of an exemplar."""
    if image.kind == "grey":
        low, high = grey_range(image.values)
        values = np.clip(
            (image.values.astype(np.float32) - low) * np.float32(2 / (high - low)) - 1, -1, 1
        )[None]
    else:
        values, _ = phase_fields(image)
        # A distance counts where an interface is near; tanh keeps it smooth where it saturates.
        clipped = np.clip(values, -config.clip, config.clip)
        values = np.tanh(clipped / 2) if config.clip else np.sign(values)
    values = np.ascontiguousarray(values, np.float32)
    return TrainingFields(torch.from_numpy(values), turns_of(config.orientations), config.crop)


def grey_range(values: np.ndarray) -> tuple[float, float]:
    """Return the grey values at -1 and at 1."""
    low, high = np.quantile(values, [_TAIL, 1 - _TAIL])
    return float(low), float(high)


def turns_of(orientations: str) -> tuple[Turn, ...]:
    """List the orientations of a setting.

    Inverted through a point a material has the same two-point function along every direction;
    mirrored it has the same along the axes.
    """
    orders = list(permutations((1, 2, 3))) if orientations == "all" else [(1, 2, 3)]
    flips: list[tuple[int, ...]] = [()]
    if orientations == "inverted":
        flips.append((1, 2, 3))
    elif orientations in ("mirrors", "all"):
        flips = [
            tuple(axis for axis, on in zip((1, 2, 3), chosen, strict=True) if on)
            for chosen in product((0, 1), repeat=3)
        ]
    return tuple(product(orders, flips))


TABLE, CHUNK = 16, 4
"""Crops that hold the candidates of the structural loss, and how many of them at once."""

_CHECK = 10  # iterations between two checks for failure
_YOUNG = 0.1  # share of the training after the warm-up in which everything may still look alike
_RESTARTS = 4
_SLOWER = 0.5  # the rate after a restart, times the one before
_COPIES = 4  # of the weights: their gradients, two moments and the last good state
# Results of a layer that backpropagation holds: its own, rearranged, and after the activation.
_RESULTS = 5
# Times as much in float32, where a processor lacks bf16: convolutions rearrange more, and the same
# training had peaks between 1.0 and 2.1 GB.
_REARRANGED = 2.6
# Bytes a voxel of the crops in the sliced loss: products along 32 directions at every fourth,
# sorted, with their places.
_SLICED = 24


def train(config: GanConfig, image: Image) -> dict[str, Any]:
    """Train on an exemplar.

    Parameters
    ----------
    config : GanConfig
    image : Image
        Labels or grey, at least a crop along every axis.

    Returns
    -------
    state : dict
        "generator": weights by name; "calibration": see `decode`; "training": its history,
        plain JSON.

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
    fields = exemplar_fields(image, config).on(find_device(config))
    with _package_threads(), _explain_memory(config):
        return _run(config, image, fields)


def _run(config: GanConfig, image: Image, fields: TrainingFields) -> dict[str, Any]:
    pair = AdversarialPair(config, len(fields.values), fields.values.device)
    if config.structural:
        candidates = fields.crops(min(TABLE, 4 * config.batch), config.seed, 2**40)
        pair.table = CandidateTable(candidates, chunk=CHUNK)
    evaluator = Evaluator(config, image, fields.values.cpu())
    state = evaluator.resume(pair)
    good, evaluated, mark = (replace(state), pair.state()), -1.0, time.monotonic()
    while (done := state.progress(config)) < 1:
        random = torch.Generator(pair.device).manual_seed(
            int(key(config.seed, f"gan/{state.iteration}")) >> 1
        )
        real = fields.crops(config.batch, config.seed, state.iteration)
        pair.set_learning_rate(state.rate(done, config))
        if done < config.warmup:
            step_losses = pair.warmup_step(real, random)
        else:
            noise = config.noise[0] + (config.noise[1] - config.noise[0]) * done
            step_losses = pair.train_step(real, random, state.iteration, noise)
        state.iteration += 1
        pair.update_ema(state.iteration)
        state.seconds, mark = state.seconds + time.monotonic() - mark, time.monotonic()
        if state.iteration % _CHECK == 0:
            grown = done > config.warmup + _YOUNG
            if found := failure(pair.sample(random), real, step_losses, grown=grown):
                state = _restart(found, state, good[0])
                pair.restore(good[1])
                continue
        report(_progress_line(state, step_losses), done)
        if done - evaluated >= 1 / config.looks:
            evaluated = done
            state.count_stale(evaluator.evaluate(pair, state, step_losses))
            good = (replace(state), pair.state())
            plain = {"state": vars(state), "rows": evaluator.log.rows}
            save_checkpoint(config, image, good[1], plain)
    report("training", 1.0)
    return evaluator.result(pair, state)


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
        raise InputError(
            f"the exemplar is {image.shape}, training takes crops of {config.crop} voxels along "
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


@contextmanager
def _explain_memory(config: GanConfig) -> Iterator[None]:
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise MemoryBudgetError(
            f"the GPU has too little memory for batch={config.batch} at width={config.width}: "
            "lower batch first, then width"
        ) from error


def training_bytes(config: GanConfig, image: Image) -> dict[str, int]:
    """Forecast the bytes that training takes by purpose, the exemplar itself left out.

    Parameters
    ----------
    config : GanConfig
    image : Image
        The exemplar.
    """
    count = (
        len(set(image.values.ravel()[:: max(1, image.values.size >> 16)].tolist()))
        if image.kind == "labels"
        else 1
    )
    channels = count if count > 2 else 1
    half = 2 if arithmetic(config) == "bf16" else 4
    with torch.device("meta"):  # shapes without numbers
        generator = new_generator(config, channels)
        discriminator = new_discriminator(config, channels)
        cells = config.crop // config.cell + (
            2 * generator.halo if config.generator == "subpixel" else -3
        )
        z = torch.empty(config.batch, generator.latent, cells, cells, cells)
        crop = torch.empty(config.batch, channels, config.crop, config.crop, config.crop)
        held = sum(_layer_results(generator, lambda: generator(z)))
        held += 2 * sum(_layer_results(discriminator, lambda: discriminator(crop)))
        cells = max(SIDE // config.cell, CELLS) + 2 * generator.halo
        tile = torch.empty(1, generator.latent, cells, cells, cells)
        evaluation = max(_layer_results(generator, lambda: generator.cells(tile)))
        networks = (generator, generator, discriminator)
        weights = sum(p.numel() for network in networks for p in network.parameters())
    fields = 4 * channels * image.values.size
    return {
        "weights": 4 * weights * (1 + _COPIES),
        "fields": 3 * fields,
        "crops": (32 + _SLICED) * crop.numel(),
        "results of layers": round(_RESULTS * half * held * (_REARRANGED if half == 4 else 1)),
        "looks": 4 * half * evaluation + 40 * channels * SIDE**3,
    }


def _layer_results(network: nn.Module, run: Callable[[], object]) -> list[int]:
    """Count the numbers that each layer of a network returns."""
    found = []

    def see(module: nn.Module, given: object, result: Tensor) -> None:
        found.append(result.numel())

    hooks = [m.register_forward_hook(see) for m in network.modules() if not list(m.children())]
    run()
    for hook in hooks:
        hook.remove()
    return found

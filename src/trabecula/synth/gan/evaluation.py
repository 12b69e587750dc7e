"""Evaluation of a generator while it trains: failures, and the distance to the exemplar."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from trabecula.core.image import Image
from trabecula.core.progress import notify
from trabecula.core.seeds import key
from trabecula.engine.parallel import thread_count
from trabecula.exemplar.views import views_of
from trabecula.measure import euler_density, largest_fraction, two_point
from trabecula.synth.gan import patterns
from trabecula.synth.gan.adversarial import AdversarialPair
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.crops import TrainingFields
from trabecula.synth.gan.decode import calibrate, decode, measure_response
from trabecula.synth.gan.log import TrainingLog, load_checkpoint
from trabecula.synth.gan.networks import load_generator
from trabecula.synth.gan.slices import PictureFields
from trabecula.synth.shared.content.fields import phases_present

SIDE = 96
"""Voxels along an edge of the volume that is evaluated."""

_LEAST_RATE = 0.02  # of the learning rate, at the end of its decay
_BETTER = 0.98  # an improvement is a figure below this share of the best
_REACH = 30
# of the real crops' standard deviation: less, and far from the middle, is one phase
_LEAST_SPREAD = 0.2
_MIDDLE = 0.5  # a slow start is as narrow, but lies around 0
_DEAD = 0.02  # as the first, wherever it lies
_MOST_ALIKE = 0.95  # correlation of two generated crops: more is one picture


def failure(
    fake: Tensor, real: Tensor, step_losses: dict[str, float], *, grown: bool = True
) -> str:
    """Describe the failure of a batch of generated crops (B, K, Z, Y, X); empty for none.

    A network that has hardly learnt yet (not `grown`) may make one phase, but only finite numbers.
    """
    if not (
        all(np.isfinite(value) for value in step_losses.values())
        and bool(torch.isfinite(fake).all())
    ):
        return "the loss is not a number any more"
    if not grown:
        return ""
    spread = float(fake.std()) / max(float(real.std()), 1e-9)
    if spread < _DEAD or (spread < _LEAST_SPREAD and abs(float(fake.mean())) > _MIDDLE):
        return "it makes one phase only"
    if len(fake) > 1:
        a, b = (crop.flatten() - crop.mean() for crop in fake[:2])
        if float(a @ b) > _MOST_ALIKE * float(a.norm() * b.norm()):
            return "it makes the same again and again"
    return ""


class ExemplarComparison:
    """The exemplar's own figures, to compare a generator's with.

    Parameters
    ----------
    images : sequence of Image
        The exemplar, or the pictures.
    fields : TrainingFields or PictureFields
        Of the same.
    seed : int
        Seed of the training: every evaluation has the same latent.
    """

    def __init__(
        self, images: Sequence[Image], fields: TrainingFields | PictureFields, config: GanConfig
    ) -> None:
        self.images, self.fields, self.seed = images, fields, config.seed
        self.reach = min(_REACH, min(min(image.shape) for image in images) // 2)
        labels = images[0].kind == "labels"
        self.phases = list(phases_present(images)) if labels else []
        parts: list[tuple[int | None, Image, int | None]] = [(None, images[0], None)]
        if images[0].ndim == 2:
            # Along the rows and columns of each plane, as the volume has them along its axes.
            parts = [
                (axis, view.image, place)
                for view in views_of(images, config.views, gap=config.gap)
                for place, axis in enumerate(view.across)
            ]
        self.curves = {
            label: [
                (axis, two_point(image, r_max=self.reach, phase=label, axis=own))
                for axis, image, own in parts
            ]
            for label in self.phases[1:]
        }

    def compare(self, network: Any) -> tuple[dict[str, float], np.ndarray]:
        """Return the figures of a generator, and the middle slice of its volume (values).

        Parameters
        ----------
        network : generator
            Ready for use, on the device of the fields.
        """
        side = SIDE // network.cell + 2 * network.halo
        weight = next(network.parameters())
        random = torch.Generator().manual_seed(int(key(self.seed, "gan/looks")) >> 1)
        with torch.inference_mode():
            z = torch.randn(1, network.latent, side, side, side, generator=random)
            # The exemplar's mean fractions everywhere.
            z = torch.cat([z, torch.zeros(1, network.fractions, side, side, side)], 1)
            z = z.to(weight.device, weight.dtype, memory_format=torch.channels_last_3d)
            field = network.cells(z).float()
            distance = self.fields.distance(field, random)
        few = max(1, network.tiles // 64)
        calibration = calibrate(network, self.images, self.seed, tiles=few)
        values = decode(field[0].cpu().numpy(), calibration)
        found = {"distance": distance}
        if self.curves:
            found |= self._compare_labels(Image(values, "labels", phases=self.images[0].phases))
        return found, values[len(values) // 2]

    def _compare_labels(self, made: Image) -> dict[str, float]:
        distances = []
        for label, parts in self.curves.items():
            for axis, curve in parts:
                other = two_point(made, r_max=self.reach, phase=label, axis=axis)
                distances.append(float(np.linalg.norm(other - curve) / np.linalg.norm(curve)))
        last = made.phases[self.phases[-1]]
        return {
            "two_point": float(np.mean(distances)),
            "largest": float(largest_fraction(made, phase=last)),
            "euler": float(euler_density(made, phase=last)),
        }


@dataclass
class TrainingState:
    """The state of a training beside its tensors: plain JSON."""

    iteration: int = 0
    seconds: float = 0.0
    pace: float = 1.0
    restarts: int = 0
    best: float = float("inf")
    stale: int = 0

    def progress(self, config: GanConfig) -> float:
        """Return the share of the training that is over, 0 .. 1: by iterations where they are
        given, so that it repeats exactly.
        """
        late = config.minutes and self.seconds >= 60 * config.minutes
        if late or (config.patience and self.stale >= config.patience):
            return 1.0
        if config.iterations:
            return min(1.0, self.iteration / config.iterations)
        return self.seconds / (60 * config.minutes)

    def rate(self, done: float, config: GanConfig) -> float:
        """Return the learning rate as a share of the config's."""
        falling = min(1.0, (1 - done) / config.decay) if config.decay else 1.0
        return self.pace * max(falling, _LEAST_RATE)

    def count_stale(self, figure: float) -> None:
        """Count the evaluations without improvement."""
        if figure < _BETTER * self.best:
            self.best, self.stale = figure, 0
        else:
            self.stale += 1


class Evaluator:
    """Evaluations of a training from time to time, and at its end."""

    def __init__(
        self, config: GanConfig, images: Sequence[Image], fields: TrainingFields | PictureFields
    ) -> None:
        self.config, self.images = config, images
        self.comparison = ExemplarComparison(images, fields, config)
        self.log = TrainingLog(config.run)

    def resume(self, pair: AdversarialPair) -> TrainingState:
        """Return the state at the checkpoint of the same run, or at its start."""
        found = load_checkpoint(self.config, self.images)
        if found is None:
            return TrainingState()
        state = TrainingState(**found.plain["state"])
        pair.restore(found.tensors)
        self.log.restore(found.plain["rows"])
        notify(f"resuming after {state.iteration} iterations")
        return state

    def evaluate(
        self, pair: AdversarialPair, state: TrainingState, step_losses: dict[str, float]
    ) -> float:
        """Evaluate and log; return the figure that says how near the generator is."""
        weights = {name: tensor.cpu().numpy() for name, tensor in pair.ema.state_dict().items()}
        network = load_generator(self.config, pair.channels, weights, pair.device)
        found, middle = self.comparison.compare(network)
        clock = {"iteration": state.iteration, "minutes": state.seconds / 60}
        self.log.add({**clock, **step_losses, **found}, middle)
        return found.get("two_point", found["distance"])

    def result(self, pair: AdversarialPair, state: TrainingState) -> dict[str, Any]:
        """Evaluate a last time and return the parts of a model."""
        self.evaluate(pair, state, {})
        names = ("distance", "two_point", "largest", "euler")
        stored = {
            name: round_weights(tensor.cpu().numpy(), self.config.storage)
            for name, tensor in pair.ema.state_dict().items()
        }
        network = load_generator(self.config, pair.channels, stored, pair.device)
        calibration = calibrate(network, self.images, self.config.seed, local=pair.local)
        more: dict[str, Any] = {}
        if pair.local is not None:
            response = measure_response(
                network,
                pair.local,
                calibration,
                self.config.seed,
                drawn=self.images[0].ndim == 2,
            )
            more["fractions"] = replace(pair.local, response=response).to_json()
        side = patterns.LEAST_SIDE if state.iteration < patterns.YOUNG else patterns.SIDE
        bias = patterns.learn_bias(
            network, self.config, self.images[0], calibration, pair.local, side=side
        )
        return {
            "generator": stored,
            "calibration": calibration,
            "bias": bias,
            **more,
            "training": {
                "iterations": state.iteration,
                "minutes": round(state.seconds / 60, 2),
                "threads": thread_count(),
                "device": pair.device.type,
                "restarts": state.restarts,
                "seed": self.config.seed,
                "torch": str(torch.__version__),
                "figures": {n: round(v, 5) for n, v in self.log.rows[-1].items() if n in names},
            },
        }


def round_weights(array: np.ndarray, storage: str) -> np.ndarray:
    """Round float32 weights to a storage; those that float16 cannot hold stay as they are."""
    if storage == "float32" or array.dtype.kind != "f":
        return array
    if array.size and float(abs(array).max()) > float(np.finfo(np.float16).max):
        return array
    return array.astype(np.float16)

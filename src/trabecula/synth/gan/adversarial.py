"""The generator, its exponential moving average and the discriminator, with a training step."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

import torch
from torch import Tensor

from trabecula.core.seeds import key
from trabecula.synth.gan import losses
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.local_fractions import LocalFractions
from trabecula.synth.gan.networks import (
    Score,
    new_discriminator,
    new_generator,
    training_arithmetic,
)
from trabecula.synth.gan.slices import new_slice_discriminator, take_slices

_PENALTY_EVERY = 2  # iterations; its weight makes up for it
_SLICED_EVERY = 2
_WARMUP_FRACTIONS = 0.1  # of the weight of the local fractions, in the warm-up
_WARMUP_RATE = 2.0  # times the learning rate, while the discriminator waits
_RAMP = 0.1  # the moving average forgets the first iterations faster


class AdversarialPair:
    """Generator and discriminator with their optimisers, and the generator's moving average.

    Parameters
    ----------
    config : GanConfig
    channels : int
        Of the fields.
    device : torch.device
    views : sequence of (int, int)
        Of pictures (`PictureFields.views`); none where it learns from a volume.
    local : LocalFractions, optional
        What the generator is given beside the noise, where its config says so.
    """

    def __init__(
        self,
        config: GanConfig,
        channels: int,
        device: torch.device,
        views: Sequence[tuple[int, int]] = (),
        local: LocalFractions | None = None,
    ) -> None:
        self.config, self.channels, self.device = config, channels, device
        self.local = local
        self.axes = [axis for axis, _ in views]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(key(config.seed, "gan/weights")) >> 1)
            generator = new_generator(config, channels)
            discriminator = (
                new_slice_discriminator(config, channels, views)
                if views
                else new_discriminator(config, channels)
            )
        volumes = torch.channels_last_3d
        self.generator = generator.to(device, memory_format=volumes)
        self.discriminator: Any = discriminator.to(
            device, memory_format=torch.channels_last if views else volumes
        )
        self.ema = copy.deepcopy(self.generator).requires_grad_(False)
        betas = (0.5, 0.999) if config.adversarial == "standard" else (0.5, 0.99)
        self.optimisers = [
            torch.optim.Adam(network.parameters(), config.rate, betas)
            for network in (self.generator, self.discriminator)
        ]
        self.table: losses.CandidateTable | None = None

    def autocast(self) -> AbstractContextManager[Any]:
        """Run the networks in the arithmetic of the config."""
        return torch.autocast(
            self.device.type,
            torch.bfloat16,
            enabled=training_arithmetic(self.config, self.device) == "bf16",
        )

    def generate(self, random: torch.Generator, given: Tensor | None = None) -> Tensor:
        """Generate a batch of crops, (B, K, crop, crop, crop) float32.

        Parameters
        ----------
        random : torch.Generator
        given : (B, K, ...) tensor, optional
            Local fractions of their cells and of those in reach (`TrainingFields.given`), of a
            generator that takes them. Default: the mean.
        """
        cells = self.config.crop // self.config.cell
        side = cells + 2 * self.generator.halo if self.config.generator == "subpixel" else cells - 3
        z = torch.randn(
            self.config.batch,
            self.generator.latent,
            side,
            side,
            side,
            generator=random,
            device=self.device,
        )
        count = self.generator.fractions
        if given is None:
            given = torch.zeros(len(z), count, side, side, side, device=self.device)
        z = torch.cat([z, given], 1)
        with self.autocast():
            return self.generator(z.to(memory_format=torch.channels_last_3d)).float()

    def sample(self, random: torch.Generator, given: Tensor | None = None) -> Tensor:
        """Generate a batch of crops without gradients."""
        with torch.no_grad():
            return self.generate(random, given)

    def set_learning_rate(self, factor: float) -> None:
        """Set the learning rates to `factor` times the config's."""
        for optimiser in self.optimisers:
            for group in optimiser.param_groups:
                group["lr"] = self.config.rate * factor

    def seen(self, fake: Tensor, iteration: int) -> Tensor:
        """Return what the discriminator sees of generated crops: the crops, or slices of them."""
        if not self.axes:
            return fake
        return take_slices(fake, self.axes, iteration, gap=self.config.gap)

    def sliced(self, fake: Tensor, real: Tensor, random: torch.Generator) -> Tensor:
        """Return the distance of neighbourhoods, of views a mean."""
        if not self.axes:
            return losses.sliced(fake, real, random)
        views = range(len(self.axes))
        found = [losses.sliced(fake[:, view], real[:, view], random) for view in views]
        return torch.stack(found).mean()

    def warmup_step(
        self,
        real: Tensor,
        random: torch.Generator,
        iteration: int = 0,
        *,
        given: Tensor | None = None,
    ) -> dict[str, float]:
        """Step the generator on the distribution of neighbourhoods, and on the local fractions,
        alone; return the losses.
        """
        fake = self.generate(random, given)
        terms = {"sliced": self.sliced(self.seen(fake, iteration), real, random)}
        terms |= self._obedience(fake, given)
        for group in self.optimisers[0].param_groups:
            group["lr"] *= _WARMUP_RATE
        weight = _WARMUP_FRACTIONS * self.config.fractions
        self._step(
            0, terms["sliced"] + (weight * terms["fractions"] if "fractions" in terms else 0.0)
        )
        parts = {name: term.item() for name, term in terms.items()}
        return {"generator": 0.0, "discriminator": 0.0, **parts}

    def _obedience(self, fake: Tensor, given: Tensor | None) -> dict[str, Tensor]:
        """Return the term of the local fractions, where they are given."""
        if given is None or self.local is None:
            return {}
        return {"fractions": losses.local_fractions(fake, given, self.local)}

    def train_step(
        self,
        real: Tensor,
        random: torch.Generator,
        iteration: int,
        noise: float,
        *,
        given: Tensor | None = None,
        shares: bool = False,
    ) -> dict[str, float]:
        """Step the discriminator, then the generator, on the same crops; return the losses.

        Parameters
        ----------
        real : (B, K, crop, crop, crop) tensor, or of pictures (N, V, K, crop, crop)
        random : torch.Generator
        iteration : int
        noise : float
            Standard deviation of the noise on all crops that the discriminator sees.
        given : (B, K, ...) tensor, optional
            Local fractions of the real crops, which the generated ones are to have as well.
        shares : bool
            Whether to return `gradient_shares` as well; the step is the same.
        """
        config = self.config
        made = self.generate(random, given)
        fake = self.seen(made, iteration)
        noises = [
            noise * torch.randn(real.shape, generator=random, device=self.device) if noise else 0.0
            for _ in range(2)
        ]
        real_noisy = real + noises[0]
        with self.autocast():
            verdicts = self.discriminator(real_noisy)
            fake_verdicts = self.discriminator(fake.detach() + noises[1])
            if config.adversarial == "relativistic":
                loss = losses.relativistic(verdicts, fake_verdicts)
            else:
                loss = losses.standard(verdicts, real=True)
                loss = loss + losses.standard(fake_verdicts, real=False)
            if config.penalty and iteration % _PENALTY_EVERY == 0:
                penalty = losses.gradient_penalty(self.discriminator, real_noisy)
                loss = loss + 0.5 * config.penalty * _PENALTY_EVERY * penalty
        self._step(1, loss)
        self.discriminator.requires_grad_(False)
        with self.autocast():
            terms = self._generator_terms(
                fake + noises[1], real_noisy, [verdict.detach() for verdict in verdicts]
            )
        if config.sliced and iteration % _SLICED_EVERY == 0:
            terms["sliced"] = self.sliced(fake, real, random)
        terms |= self._obedience(made, given)
        weights = {
            "fractions": config.fractions,
            "gram": config.gram,
            "structural": config.structural,
            "sliced": config.sliced * _SLICED_EVERY,
        }
        generator_loss = terms["generator"]
        for name, weight in weights.items():
            if name in terms:
                generator_loss = generator_loss + weight * terms[name]
        parts = {name: term.item() for name, term in terms.items()}
        if shares:
            weights["sliced"] = config.sliced  # as a mean over iterations
            parts |= gradient_shares(terms, weights, made)
        self._step(0, generator_loss)
        self.discriminator.requires_grad_(True)
        return {"discriminator": loss.item(), **parts}

    def _generator_terms(
        self, fake: Tensor, real: Tensor, verdicts: list[Tensor]
    ) -> dict[str, Tensor]:
        """Return the terms of the generator's loss (equation 2 of the paper) without weights."""
        config = self.config
        plain = not (config.gram or config.structural)
        if not plain and not isinstance(self.discriminator, Score):
            raise TypeError("the gram and the structural loss need the paper's discriminator")
        features = [] if plain else self.discriminator.features(fake)
        fake_verdicts = self.discriminator(fake) if plain else self.discriminator.verdicts(features)
        relative = config.adversarial == "relativistic"
        terms = {
            "generator": losses.relativistic(fake_verdicts, verdicts)
            if relative
            else losses.standard(fake_verdicts, real=True)
        }
        if config.gram:
            with torch.no_grad():
                real_features = self.discriminator.features(real)
            terms["gram"] = losses.gram(features, real_features, reduction=config.reduction)
        if config.structural and self.table is not None:
            terms["structural"] = self.table.loss(
                self.discriminator, features, reduction=config.reduction
            )
        return terms

    def _step(self, network: int, loss: Tensor) -> None:
        self.optimisers[network].zero_grad()
        loss.backward()
        self.optimisers[network].step()

    def update_ema(self, iteration: int) -> None:
        """Move the moving average towards the generator."""
        decay = min(self.config.average, 1 - 1 / (1 + _RAMP * iteration))
        with torch.no_grad():
            for old, new in zip(self.ema.parameters(), self.generator.parameters(), strict=True):
                old.lerp_(new, 1 - decay)
            for old, new in zip(self.ema.buffers(), self.generator.buffers(), strict=True):
                old.copy_(new)

    def state(self) -> dict[str, Tensor]:
        """Copy all tensors that the next step starts from, by name."""
        return {name: tensor.detach().clone() for name, tensor in self._tensors()}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Go back to what `state` returned."""
        for network in ("generator", "ema", "discriminator"):
            part = {
                name.removeprefix(f"{network}."): value
                for name, value in state.items()
                if name.startswith(f"{network}.")
            }
            getattr(self, network).load_state_dict(part)
        for number, optimiser in enumerate(self.optimisers):
            for place, parameter in enumerate(optimiser.param_groups[0]["params"]):
                head = f"optimiser{number}.{place}."
                part = {
                    name.removeprefix(head): value.clone()
                    for name, value in state.items()
                    if name.startswith(head)
                }
                if part:
                    optimiser.state[parameter] = part
                else:
                    optimiser.state.pop(parameter, None)

    def _tensors(self) -> Iterator[tuple[str, Tensor]]:
        for network in ("generator", "ema", "discriminator"):
            for name, tensor in getattr(self, network).state_dict().items():
                yield f"{network}.{name}", tensor
        for number, optimiser in enumerate(self.optimisers):
            for place, parameter in enumerate(optimiser.param_groups[0]["params"]):
                for name, tensor in optimiser.state.get(parameter, {}).items():
                    yield f"optimiser{number}.{place}.{name}", tensor


def gradient_shares(
    terms: Mapping[str, Tensor], weights: Mapping[str, float], fake: Tensor
) -> dict[str, float]:
    """Return the length of each weighted term's gradient by the generated crops, over that of the
    adversarial term: "gram_share", "structural_share", "sliced_share", "fractions_share".
    """
    lengths = {
        name: float(torch.autograd.grad(term, fake, retain_graph=True)[0].float().norm())
        for name, term in terms.items()
    }
    against = max(lengths["generator"], 1e-30)
    return {
        f"{name}_share": weights[name] * length / against
        for name, length in lengths.items()
        if name in weights
    }

"""The generator, its exponential moving average and the discriminator, with a training step."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from typing import Any

import torch
from torch import Tensor

from trabecula.core.seeds import key
from trabecula.synth.gan import losses
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.networks import Score, arithmetic, new_discriminator, new_generator

_PENALTY_EVERY = 2  # iterations; its weight makes up for it
_SLICED_EVERY = 2
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
    """

    def __init__(self, config: GanConfig, channels: int, device: torch.device) -> None:
        self.config, self.channels, self.device = config, channels, device
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(int(key(config.seed, "gan/weights")) >> 1)
            networks = new_generator(config, channels), new_discriminator(config, channels)
        self.generator, self.discriminator = (
            network.to(device, memory_format=torch.channels_last_3d) for network in networks
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
            self.device.type, torch.bfloat16, enabled=arithmetic(self.config) == "bf16"
        )

    def generate(self, random: torch.Generator) -> Tensor:
        """Generate a batch of crops, (B, K, crop, crop, crop) float32."""
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
        with self.autocast():
            return self.generator(z.to(memory_format=torch.channels_last_3d)).float()

    def sample(self, random: torch.Generator) -> Tensor:
        """Generate a batch of crops without gradients."""
        with torch.no_grad():
            return self.generate(random)

    def set_learning_rate(self, factor: float) -> None:
        """Set the learning rates to `factor` times the config's."""
        for optimiser in self.optimisers:
            for group in optimiser.param_groups:
                group["lr"] = self.config.rate * factor

    def warmup_step(self, real: Tensor, random: torch.Generator) -> dict[str, float]:
        """Step the generator on the distribution of neighbourhoods alone; return the losses."""
        loss = losses.sliced(self.generate(random), real, random)
        for group in self.optimisers[0].param_groups:
            group["lr"] *= _WARMUP_RATE
        self._step(0, loss)
        return {"generator": 0.0, "discriminator": 0.0, "sliced": loss.item()}

    def train_step(
        self, real: Tensor, random: torch.Generator, iteration: int, noise: float
    ) -> dict[str, float]:
        """Step the discriminator, then the generator, on the same crops; return the losses.

        Parameters
        ----------
        real : (B, K, crop, crop, crop) tensor
        random : torch.Generator
        iteration : int
        noise : float
            Standard deviation of the noise on all crops that the discriminator sees.
        """
        config = self.config
        fake = self.generate(random)
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
            generator_loss, parts = self._generator_loss(
                fake + noises[1], real_noisy, [verdict.detach() for verdict in verdicts]
            )
        if config.sliced and iteration % _SLICED_EVERY == 0:
            term = losses.sliced(fake, real, random)
            generator_loss = generator_loss + config.sliced * _SLICED_EVERY * term
            parts["sliced"] = term.item()
        self._step(0, generator_loss)
        self.discriminator.requires_grad_(True)
        return {"discriminator": loss.item(), **parts}

    def _generator_loss(
        self, fake: Tensor, real: Tensor, verdicts: list[Tensor]
    ) -> tuple[Tensor, dict[str, float]]:
        """Return the generator's loss (equation 2 of the paper) and the values of its parts."""
        config = self.config
        plain = not (config.gram or config.structural)
        if not plain and not isinstance(self.discriminator, Score):
            raise TypeError("the gram and the structural loss need the paper's discriminator")
        features = [] if plain else self.discriminator.features(fake)
        fake_verdicts = self.discriminator(fake) if plain else self.discriminator.verdicts(features)
        relative = config.adversarial == "relativistic"
        loss = (
            losses.relativistic(fake_verdicts, verdicts)
            if relative
            else losses.standard(fake_verdicts, real=True)
        )
        parts = {"generator": loss.item()}
        if config.gram:
            with torch.no_grad():
                real_features = self.discriminator.features(real)
            part = losses.gram(features, real_features)
            loss, parts["gram"] = loss + config.gram * part, part.item()
        if config.structural and self.table is not None:
            part = self.table.loss(self.discriminator, features)
            loss, parts["structural"] = loss + config.structural * part, part.item()
        return loss, parts

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

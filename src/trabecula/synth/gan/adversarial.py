"""The two networks at play: the maker, its average over time and the judge, with their optimisers,
and one step of each.
"""

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
from trabecula.synth.gan.loading import arithmetic
from trabecula.synth.gan.networks import Score, discriminator_of, generator_of
from trabecula.synth.gan.perceptual import Table, gram

_PENALTY_EVERY = 2  # iterations; its weight makes up for it
_SLICED_EVERY = 2
_WARM = 2.0  # times the rate, while nothing is judged
_RAMP = 0.1  # the average forgets the first iterations faster


class Players:
    """Maker, average and judge.

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
            maker, judge = generator_of(config, channels), discriminator_of(config, channels)
        self.maker, self.judge = (
            net.to(device, memory_format=torch.channels_last_3d) for net in (maker, judge)
        )
        self.average = copy.deepcopy(self.maker).requires_grad_(False)
        betas = (0.5, 0.999) if config.adversarial == "standard" else (0.5, 0.99)
        self.optimisers = [
            torch.optim.Adam(net.parameters(), config.rate, betas)
            for net in (self.maker, self.judge)
        ]
        self.table: Table | None = None

    def mixed(self) -> AbstractContextManager[Any]:
        """The arithmetic of the networks."""
        return torch.autocast(
            self.device.type, torch.bfloat16, enabled=arithmetic(self.config) == "bf16"
        )

    def made(self, draw: torch.Generator) -> Tensor:
        """A batch of made crops, (B, K, crop, crop, crop) float32."""
        cells = self.config.crop // self.config.cell
        side = cells + 2 * self.maker.halo if self.config.generator == "subpixel" else cells - 3
        z = torch.randn(
            self.config.batch,
            self.maker.latent,
            side,
            side,
            side,
            generator=draw,
            device=self.device,
        )
        with self.mixed():
            return self.maker(z.to(memory_format=torch.channels_last_3d)).float()

    def shown(self, draw: torch.Generator) -> Tensor:
        """A batch of made crops to look at."""
        with torch.no_grad():
            return self.made(draw)

    def paced(self, pace: float) -> None:
        """Set the rates, `pace` times those of the config."""
        for optimiser in self.optimisers:
            for group in optimiser.param_groups:
                group["lr"] = self.config.rate * pace

    def warm(self, real: Tensor, draw: torch.Generator) -> dict[str, float]:
        """A step of the maker on the distribution of neighbourhoods alone."""
        loss = losses.sliced(self.made(draw), real, draw)
        for group in self.optimisers[0].param_groups:
            group["lr"] *= _WARM
        self._stepped(0, loss)
        return {"maker": 0.0, "judge": 0.0, "sliced": loss.item()}

    def play(
        self, real: Tensor, draw: torch.Generator, iteration: int, noise: float
    ) -> dict[str, float]:
        """A step of the judge, then one of the maker, on the same crops."""
        config = self.config
        made = self.made(draw)
        blurs = [
            noise * torch.randn(real.shape, generator=draw, device=self.device) if noise else 0.0
            for _ in range(2)
        ]
        shown = real + blurs[0]
        with self.mixed():
            verdicts, fooled = self.judge(shown), self.judge(made.detach() + blurs[1])
            if config.adversarial == "relativistic":
                judged = losses.relativistic(verdicts, fooled)
            else:
                judged = losses.standard(verdicts, real=True) + losses.standard(fooled, real=False)
            if config.penalty and iteration % _PENALTY_EVERY == 0:
                penalty = losses.gradient_penalty(self.judge, shown)
                judged = judged + 0.5 * config.penalty * _PENALTY_EVERY * penalty
        self._stepped(1, judged)
        self.judge.requires_grad_(False)
        with self.mixed():
            making, told = self._making(
                made, made + blurs[1], shown, [v.detach() for v in verdicts]
            )
        if config.sliced and iteration % _SLICED_EVERY == 0:
            term = losses.sliced(made, real, draw)
            making, told["sliced"] = making + config.sliced * _SLICED_EVERY * term, term.item()
        self._stepped(0, making)
        self.judge.requires_grad_(True)
        return {"judge": judged.item(), **told}

    def _making(
        self, made: Tensor, seen: Tensor, real: Tensor, verdicts: list[Tensor]
    ) -> tuple[Tensor, dict[str, float]]:
        """What the maker minimises (equation 2), and its parts."""
        config = self.config
        plain = not (config.gram or config.structural)
        if not plain and not isinstance(self.judge, Score):
            raise TypeError("the gram and the structural loss need the paper's discriminator")
        features = [] if plain else self.judge.features(seen)
        fooled = self.judge(seen) if plain else self.judge.judged(features)
        relative = config.adversarial == "relativistic"
        loss = (
            losses.relativistic(fooled, verdicts)
            if relative
            else losses.standard(fooled, real=True)
        )
        told = {"maker": loss.item()}
        if config.gram:
            with torch.no_grad():
                aims = self.judge.features(real)
            part = gram(features, aims)
            loss, told["gram"] = loss + config.gram * part, part.item()
        if config.structural and self.table is not None:
            part = self.table.loss(self.judge, features)
            loss, told["structural"] = loss + config.structural * part, part.item()
        return loss, told

    def _stepped(self, player: int, loss: Tensor) -> None:
        self.optimisers[player].zero_grad()
        loss.backward()
        self.optimisers[player].step()

    def averaged(self, iteration: int) -> None:
        """Let the average follow the maker."""
        kept = min(self.config.average, 1 - 1 / (1 + _RAMP * iteration))
        with torch.no_grad():
            for old, new in zip(self.average.parameters(), self.maker.parameters(), strict=True):
                old.lerp_(new, 1 - kept)
            for old, new in zip(self.average.buffers(), self.maker.buffers(), strict=True):
                old.copy_(new)

    def state(self) -> dict[str, Tensor]:
        """All that the next step starts from, copied, by name."""
        return {name: tensor.detach().clone() for name, tensor in self._tensors()}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Go back to a state."""
        for net in ("maker", "average", "judge"):
            part = {
                name.removeprefix(f"{net}."): value
                for name, value in state.items()
                if name.startswith(f"{net}.")
            }
            getattr(self, net).load_state_dict(part)
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
        for net in ("maker", "average", "judge"):
            for name, tensor in getattr(self, net).state_dict().items():
                yield f"{net}.{name}", tensor
        for number, optimiser in enumerate(self.optimisers):
            for place, parameter in enumerate(optimiser.param_groups[0]["params"]):
                for name, tensor in optimiser.state.get(parameter, {}).items():
                    yield f"optimiser{number}.{place}.{name}", tensor

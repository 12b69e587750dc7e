"""`gan`: fit trains a generator, generate makes any box of what it learnt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.core.optional import need
from trabecula.engine.plan import Plan
from trabecula.synth.base import Method
from trabecula.synth.facts import Facts
from trabecula.synth.gan import SPEC
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.model import PROCESS, GanModel, opened


class Gan(Method):
    """A generative adversarial network."""

    spec = SPEC
    config_type = GanConfig

    def _fit(self, exemplars: Sequence[Image]) -> GanModel:
        need("torch", extra="learn", purpose="method 'gan'")
        from trabecula.synth.gan.train import trained

        return GanModel(self.config, exemplars, trained(self.config, exemplars[0]))

    def _plan_fit(self, exemplars: Sequence[Image]) -> Plan:
        need("torch", extra="learn", purpose="method 'gan'")
        from trabecula.synth.gan.forecast import training_bytes

        return Plan({"interpreter and kernels": PROCESS, **training_bytes(self.config, exemplars[0])})

    def restored(
        self,
        facts: Sequence[Facts],
        arrays: Mapping[str, np.ndarray],
        plain: Mapping[str, Any],
        *,
        history: Mapping[str, Any],
    ) -> GanModel:
        """The model that a file holds (see `Model.learned`)."""
        return opened(self.config, facts, {"generator": arrays, **plain, "training": history})

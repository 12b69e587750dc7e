"""`gan`: fit trains a generator, generate makes any box of what it learnt."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.core.optional import need
from trabecula.engine.memory import Plan
from trabecula.synth.api.exemplar_info import ExemplarInfo
from trabecula.synth.api.method import Method
from trabecula.synth.gan import CAPABILITIES
from trabecula.synth.gan.config import GanConfig
from trabecula.synth.gan.model import PROCESS, GanModel, opened


class Gan(Method):
    """A generative adversarial network."""

    capabilities = CAPABILITIES
    config_type = GanConfig

    def learn(self, exemplars: Sequence[Image]) -> GanModel:
        need("torch", extra="learn", purpose="method 'gan'")
        from trabecula.synth.gan.train import trained

        return GanModel(self.config, exemplars, trained(self.config, exemplars[0]))

    def _plan_fit(self, exemplars: Sequence[Image]) -> Plan:
        need("torch", extra="learn", purpose="method 'gan'")
        from trabecula.synth.gan.forecast import training_bytes

        return Plan(
            {"interpreter and kernels": PROCESS, **training_bytes(self.config, exemplars[0])}
        )

    def from_state(
        self,
        facts: Sequence[ExemplarInfo],
        arrays: Mapping[str, np.ndarray],
        plain: Mapping[str, Any],
        *,
        history: Mapping[str, Any],
    ) -> GanModel:
        """The model that a file holds (see `Model.state`)."""
        return opened(self.config, facts, {"generator": arrays, **plain, "training": history})

"""Settings of `kopf`: the only home of its defaults, beside those of `SolidConfig`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from trabecula.core.errors import InputError
from trabecula.synth.shared.settings import keep_choices, keep_numbers
from trabecula.synth.shared.solid.config import SolidConfig

_BODIES = (
    "sheets",
    "overlapping_spheres",
    "packed_spheres",
    "mixed_spheres",
    "struts",
    "struts_and_plates",
    "walls",
    "fibres",
)

PROCESSES = ("gaussian", "waves", *_BODIES, *(f"void_{name}" for name in _BODIES))
"""Names of the processes (`processes`): of "void_..." the first phase of the picture has the form
that is named, of the others the second."""


@dataclass(frozen=True)
class KopfConfig(SolidConfig):
    """Settings of `kopf`. Voxels are those of the level in question unless said otherwise."""

    reweighting: float = 1.0
    """How strongly a value that is too frequent in the vote before weighs less in the next, by 1 +
    this times its excess share, 0 .. 1000 (the paper: 1)."""

    process: str = "none"
    """Where one picture's third dimension comes from: "none", from its planes alone; "auto", from
    the process whose slices it resembles most (from the planes where it resembles none); or from
    the process of this name. For two phases that are alike from all sides; other settings but
    `interface_rounds` then change nothing."""

    def __post_init__(self) -> None:
        super().__post_init__()
        keep_numbers(self, {"reweighting": (0, 1000)})
        keep_choices(self, {"process": ("none", "auto", *PROCESSES)})
        if self.gap and self.process != "none":
            raise InputError(
                f"process={self.process} says how the material continues across the picture, as "
                "parallel sections do: leave out the gap, or the process"
            )

    @classmethod
    def recorded(cls, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Complete the settings of a recipe or a model that is older than some of them."""
        return {"process": "none", **super().recorded(settings)}


@dataclass(frozen=True)
class RelativeSettings:
    """Settings of the rounds beside a relative in space, which no one is asked for."""

    layout: str = "structure"
    """How new material begins, as of `texture`; of a process "rounds": its bodies come out rounder,
    and with fewer loops between them."""

    clip: float = 4.2
    """Signed distance at which the field saturates, voxels."""

    variance: float = 0.95
    """Share of the neighbourhoods' variance that the principal components keep."""

    components: int = 32
    """At most so many principal components."""

    sweeps: int = 2
    """Search sweeps per round."""

    tries: int = 4
    """Pairs of random candidates per neighbourhood and sweep."""

    index_penalty: float = 0.05
    """How much being chosen too often adds to a distance in the search."""

    robustness: float = 0.8
    """Exponent r of the vote's weights d^(r - 2)."""

    vote_power: float = 1.0
    """Power to which distances are raised before they are averaged."""

    interface_rounds: int = 2
    """Rounds over the voxels of interfaces in the end."""

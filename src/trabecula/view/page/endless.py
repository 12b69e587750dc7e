"""A model that makes material in the page: what the page's worker needs of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.gaussian_random import quantiles
from trabecula.engine.lazy_volume import Slabs
from trabecula.io.units import has_length, to_metres
from trabecula.measure.correlation.two_point import two_point

SIDES = (32, 64, 96, 128)
"""Voxels along an edge of the boxes that the page offers."""

_LARGEST = 2 << 20  # bytes of a model's weights
_FARTHEST = 50  # voxels of the two-point function


@dataclass(frozen=True, eq=False)
class EndlessModel:
    """A model as the page holds it.

    Parameters
    ----------
    settings : dict
        Plain JSON, as `GanModel.browser_parts` gives it.
    weights : (N,) float32
    exemplar : dict
        Plain JSON: "porosity", "s2" from r = 0 on, and the length of a "step"; None where unknown.
    side, seed : int
        Of the first box.
    """

    settings: dict[str, Any]
    weights: np.ndarray
    exemplar: dict[str, Any]
    side: int
    seed: int

    def about(self, number: int) -> dict[str, Any]:
        """Return what the script reads, where the material is volume `number` of the page."""
        network = ("latent", "fractions", "layers", "blurs", "channels")
        keys = (*network, "offsets", "present", "specks")
        model = {key: self.settings[key] for key in keys}
        return {
            "volume": number,
            "name": self.settings["name"],
            "model": {**model, "void": empty_label(self.settings["phases"])},
            "exemplar": self.exemplar,
            "start": {"seed": self.seed, "side": self.side},
        }

    def blocks(self) -> dict[str, np.ndarray]:
        """Return the arrays that the page holds: the weights as bytes, all first bytes before all
        second ones and so on, which pack better; steps of the upper half of the quantiles.
        """
        upper = quantiles()[1 << 15 :]
        return {
            "weights": self.weights.astype("<f4").view(np.uint8).reshape(-1, 4).T.copy(),
            "quantiles": np.diff(upper, prepend=np.int16(0)).astype("<i2"),
        }

    def volume(self, scale: float) -> dict[str, Any]:
        """Return the facts of the volume, which is empty until the page has made it."""
        void = empty_label(self.settings["phases"])
        phases = [
            {"name": name, "visible": label != void, "dark": label == void, "share": ""}
            for label, name in enumerate(self.settings["phases"])
        ]
        return {
            "name": f"{self.settings['name']}, made here",
            "shape": [self.side] * 3,
            "kind": "labels",
            "edges": self.settings["spacing"][::-1],
            "unit": self.settings["unit"],
            "scale": scale,
            "coarse": 1,
            "block": [1, 1, 1],
            "fields": [],
            "field": -1,
            "range": [0, 255],
            "low": 0,
            "high": 0,
            "window": [0, 255],
            "phases": phases,
            "facts": [["Made by", f"gan {self.settings['name']}, in this page"]],
            "figures": [],
            "notes": [],
        }


def as_endless(model: Any, exemplar: Image | Slabs | None, side: int, seed: int) -> EndlessModel:
    """Return the parts of a page that makes the material of a model.

    Parameters
    ----------
    model : trained model of method "gan"
        What `tb.load_model` returns, with the sub-pixel generator and labels.
    exemplar : Image or Slabs, optional
        Whose two-point function is drawn beside, where it is a volume of labels in memory.
    side : int
        One of `SIDES`.
    seed : int
        0 .. 2**53 - 1.

    Raises
    ------
    InputError
        Another model, side or seed.
    """
    if not hasattr(model, "browser_parts"):
        raise InputError(
            f"endless: {type(model).__name__} makes no material in a page: give a trained model of "
            "method 'gan', such as tb.load_model('bone')"
        )
    if side not in SIDES:
        raise InputError(f"side {side!r} is none of {', '.join(map(str, SIDES))} voxels")
    seed = int(as_number(seed, name="seed", low=0, high=2**53 - 1, whole=True))
    settings, weights = model.browser_parts()
    if weights.nbytes > _LARGEST:
        raise InputError(
            f"endless: the model has {weights.nbytes / 1e6:.1f} MB of weights, a page takes "
            f"{_LARGEST / 1e6:.1f}: train it with a smaller width"
        )
    shares, void = settings["shares"], empty_label(settings["phases"])
    reference = {"porosity": shares[void] if shares else None, **_curve(exemplar, settings)}
    return EndlessModel(settings, weights, reference, side, seed)


def empty_label(phases: list[str]) -> int:
    """Return the label of the phase "void", else 0."""
    return phases.index("void") if "void" in phases else 0


def _curve(exemplar: Image | Slabs | None, settings: dict[str, Any]) -> dict[str, Any]:
    """Return the radial two-point function of an exemplar, and the length of its step in the
    model's unit: that of the model's voxels, where the units do not compare.
    """
    if not isinstance(exemplar, Image) or exemplar.kind != "labels" or exemplar.ndim != 3:
        return {"s2": None, "step": 1.0}
    curve = two_point(exemplar, r_max=min(_FARTHEST, min(exemplar.shape) // 2))
    step, units = min(settings["spacing"]), (exemplar.unit, settings["unit"])
    if units[0] == units[1]:
        step = min(exemplar.spacing)
    elif all(map(has_length, units)):
        step = min(exemplar.spacing) * to_metres(units[0]) / to_metres(units[1])
    return {"s2": [round(float(value), 6) for value in curve], "step": float(step)}

"""Materials graded by `texture`: whether they keep the exemplar's figures where a field asks for
its own density, and for less and more.
"""

from __future__ import annotations

import numpy as np

import trabecula as tb
from common import asked, busy, pictures, table
from descriptors import scans
from trabecula.view.slices import montage

SIDE, SHAPE = 96, (96, 96, 128)
RAMPS = {"even": (1.0, 1.0), "ramp": (0.85, 1.15)}
"""Of the exemplar's share of the phase that there is less of, from one end of x to the other."""
SIZE = 48
"""Windows of the fraction."""
FIGURES = ("specific_surface", "thickness", "pore_size", "euler_density")


def graded_materials() -> None:
    """96 x 96 x 128 from 96^3 of every scan of two phases and of two samples, one seed: of the
    exemplar's own porosity everywhere, and along a ramp of its rarer phase from .85 to 1.15 times.

    `off`: mean and greatest distance of the porosity from the field's mean in windows of 48^3, and
    the mean distance of the exemplar's own windows from their mean. Figures are over the
    exemplar's.
    """
    row = table("case", "off, mean", "most", "own", *FIGURES, "parts", "coh(4)", "seconds", wide=34)
    every = {**scans(), "sample:bone": tb.sample("bone"), "sample:foam": tb.sample("foam")}
    for name in (one for one in asked("ONLY") or every if one in every):
        exemplar = tb.crop(every[name], min(SIDE, *every[name].shape))
        if len(exemplar.phases) != 2:
            continue
        own = tb.describe(exemplar)
        void = np.asarray(exemplar.values) == 0
        held = _windows(void.astype(np.float32))
        shown = [tb.crop(exemplar, min(exemplar.shape))]
        model = tb.method("texture").fit(exemplar)
        for kind, ends in RAMPS.items():
            field = _field(float(void.mean()), *ends)
            request = tb.Request(SHAPE, seed=1, target={"porosity": field})
            seconds, made = busy(lambda m=model, r=request: m.generate(r))
            found = tb.describe(made)
            off = np.abs(_windows((np.asarray(made.values) == 0) - field))
            row(
                f"{name}, {kind}",
                f"{off.mean():.3f}",
                f"{off.max():.3f}",
                f"{np.abs(held - held.mean()).mean():.3f}",
                *(f"{_mean(found[key]) / _mean(own[key]):.2f}" for key in FIGURES),
                f"{tb.measure.components(made)}",
                f"{tb.measure.coherence(exemplar, made, k=(4,), samples=500)[4]:.2f}",
                f"{seconds:.1f}",
            )
            shown.append(made)
        folder = pictures()
        if folder:
            middles = [
                tb.Image(np.ascontiguousarray(one.values[len(one.values) // 2]), "labels")
                for one in shown
            ]
            label = "".join(word if word.isalnum() else "-" for word in name)
            tb.write(montage(middles, ["exemplar", *RAMPS]), folder / f"graded-{label}.png")


def _field(porosity: float, low: float, high: float) -> np.ndarray:
    """Return a porosity whose rarer phase goes from `low` to `high` times its share along x."""
    along = np.linspace(low, high, SHAPE[2])
    line = porosity * along if porosity < 0.5 else 1 - (1 - porosity) * along
    return np.ascontiguousarray(np.broadcast_to(line, SHAPE).astype(np.float32))


def _windows(values: np.ndarray) -> np.ndarray:
    """Return the means over windows of SIZE^3, half as far apart."""
    places = [range(0, side - SIZE + 1, SIZE // 2) for side in values.shape]
    return np.array(
        [
            values[z : z + SIZE, y : y + SIZE, x : x + SIZE].mean()
            for z in places[0]
            for y in places[1]
            for x in places[2]
        ]
    )


def _mean(value: object) -> float:
    return float(np.mean(list(value.values()))) if isinstance(value, dict) else float(value)

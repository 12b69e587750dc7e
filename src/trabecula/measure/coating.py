"""Porous coatings: thickness, void and intercepts in sections, and the window of 21 CFR 888.3358.

The figures are those that ASTM F1854-25 names (coating thickness, volume percent void, mean void
intercept length, on digital images of sections across the coating), counted on every voxel instead
of a grid of points and lines. The text of the standard was not at hand: this is no test report by
it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.brief import brief
from trabecula.core.checks import as_number, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.io.units import has_length, to_metres
from trabecula.measure.labelling import label_components
from trabecula.measure.phases import as_axis, check_sides, indicator
from trabecula.measure.thickness import crossings, mean_chord, sphere_diameters

WINDOW = {
    "porosity": (0.3, 0.7),
    "pore_size": (100e-6, 1000e-6),
    "thickness": (500e-6, 1500e-6),
}
"""21 CFR 888.3358(a): "a volume porosity between 30 and 70 percent, an average pore size between
100 and 1,000 microns, interconnecting porosity, and a porous coating thickness between 500 and
1,500 microns"; lengths in metres."""

_DENSE = 0.98  # share of solid from which a layer is substrate


@dataclass(frozen=True)
class Coating:
    """Figures of a porous coating. Lengths are in the image's unit."""

    substrate: int
    """Layers of the substrate in the image."""
    thickness: float
    """Mean over all lines across the coating, from the substrate to the last solid voxel; 0 where a
    line meets none."""
    thickness_spread: float
    """Standard deviation over the lines."""
    void: float
    """Volume share of void, 0..1, between the substrate and the mean thickness."""
    intercept: float
    """Mean void intercept length there, along lines parallel to the substrate; infinite where no
    line crosses."""
    pore_size: float | None
    """Mean diameter of the largest spheres in that void; None without any, or in a picture."""
    connected: float
    """Share of that void which is joined to the tissue's side (through voxels that share faces)."""
    profile: np.ndarray
    """(L,) share of void of every layer, from the substrate up to the highest solid voxel."""
    sections: Mapping[str, np.ndarray]
    """(S,) each: "void", "intercept" and "thickness" of single sections across the coating."""
    unit: str

    __repr__ = brief

    def window(self) -> dict[str, dict[str, Any]]:
        """Compare with the window of 21 CFR 888.3358: value, range and verdict of every figure.

        The rule does not say what an average pore size is: here the mean void intercept length.
        "interconnecting porosity" has no number there: `connected` is given without a verdict, but
        fails where no void is joined to the tissue. Verdicts on lengths are None without a unit.
        """
        known = has_length(self.unit)
        metre = to_metres(self.unit) if known else 1.0
        values = {
            "porosity": self.void,
            "pore_size": self.intercept * metre,
            "thickness": self.thickness * metre,
        }
        found: dict[str, dict[str, Any]] = {}
        for name, (low, high) in WINDOW.items():
            judged = name == "porosity" or known
            scale = 1.0 if name == "porosity" else 1e6
            found[name] = {
                "value": values[name] * scale if judged and np.isfinite(values[name]) else None,
                "range": [low * scale, high * scale],
                "unit": "" if name == "porosity" else "um",
                "inside": bool(low <= values[name] <= high) if judged else None,
            }
        found["interconnecting"] = {
            "value": self.connected,
            "range": None,
            "unit": "",
            "inside": None if self.connected > 0 else False,
        }
        return found

    def to_json(self) -> dict[str, Any]:
        """Return the figures as plain values; of sections mean, standard deviation and number."""

        def plain(value: float | None) -> float | None:
            return float(value) if value is not None and np.isfinite(value) else None

        fields = {
            name: {
                "mean": plain(float(values.mean())),
                "sd": plain(float(values.std(ddof=1))) if len(values) > 1 else None,
                "n": len(values),
            }
            for name, values in self.sections.items()
        }
        return {
            "substrate_layers": self.substrate,
            "thickness": self.thickness,
            "thickness_sd": self.thickness_spread,
            "volume_percent_void": 100 * self.void,
            "mean_void_intercept_length": plain(self.intercept),
            "pore_size": plain(self.pore_size),
            "void_joined_to_tissue": self.connected,
            "sections": fields,
            "void_by_layer": self.profile.tolist(),
            "window_21_cfr_888_3358": self.window(),
        }


def coating(
    image: Image | ArrayLike,
    *,
    axis: int = 0,
    side: int = 0,
    phase: str | int | None = None,
    sections: int = 12,
) -> Coating:
    """Measure a porous coating on a substrate, in a volume or in one section.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
        With the coating flat; the substrate may be there or not.
    axis : int
        Across the coating. 0 is z (y in 2-D); negative counts from the back.
    side : {0, -1}
        Where the substrate is: at the first layer along the axis, or at the last. Its layers are
        those from there on of which 98 % are solid.
    phase : str or int, optional
        The coating and the substrate. Default: "solid", which is every phase but "void".
    sections : int
        Sections, spread evenly along the last of the other axes, that are measured one by one.

    Returns
    -------
    coating : Coating

    Raises
    ------
    InputError
        No such axis, side or phase; no coating above the substrate.

    Examples
    --------
    >>> section = np.zeros((20, 30), np.uint8)
    >>> section[:5] = 1  # the substrate
    >>> section[5:15, ::3] = 1  # ridges, 10 high
    >>> found = coating(section)
    >>> found.substrate, round(found.thickness, 2), round(found.intercept, 2)
    (5, 3.33, 2.04)
    """
    image, solid = indicator(image, phase)
    across = as_axis(axis, image.ndim)
    if not isinstance(side, (int, np.integer)) or side not in (0, -1):
        raise InputError(
            f"side {quote(side)} is no face: give 0 for the first layer, -1 for the last"
        )
    check_sides(image.shape, what="has no coating")
    count = int(as_number(sections, name="sections", low=1, high=10**6, whole=True))
    layers = np.moveaxis(solid, across, 0)
    layers = np.ascontiguousarray(layers[::-1] if side == -1 else layers)
    edges = [image.spacing[across], *np.delete(np.array(image.spacing), across).tolist()]
    shares = layers.reshape(len(layers), -1).mean(axis=1)
    dense = shares >= _DENSE
    base = len(layers) if dense.all() else int(np.argmin(dense))
    above = layers[base:]
    if not above.any():
        raise InputError(
            f"nothing stands above {base} layers of substrate along axis {axis}: give the axis "
            "across the coating, and the side of the substrate"
        )
    heights = _heights(above)
    mean = float(heights.mean())
    body = above[: max(1, round(mean))]
    fraction, intercept = _void(body, edges)
    top = int(heights.max())
    return Coating(
        substrate=base,
        thickness=mean * edges[0],
        thickness_spread=float(heights.std()) * edges[0],
        void=fraction,
        intercept=intercept,
        pore_size=_pore_size(body, edges),
        connected=_joined(above, len(body)),
        profile=1 - above[:top].reshape(top, -1).mean(axis=1),
        sections=_sections(above, body, edges, count),
        unit=image.unit,
    )


def _heights(above: np.ndarray) -> np.ndarray:
    """Return the layers up to the last solid voxel of every line."""
    found = len(above) - np.argmax(above[::-1], axis=0)
    return np.where(above.any(axis=0), found, 0)


def _void(body: np.ndarray, edges: list[float]) -> tuple[float, float]:
    """Return the share of void and its mean intercept along the axes of the substrate."""
    void = ~body
    rates = []
    for axis in range(1, body.ndim):
        crossed, steps = crossings(void, None, axis, False)
        rates.append(crossed / steps / edges[axis] if steps else 0.0)
    fraction = float(void.mean())
    return fraction, mean_chord(fraction, rates)


def _pore_size(body: np.ndarray, edges: list[float]) -> float | None:
    void = ~body
    if body.ndim != 3 or void.all() or not void.any():
        return None
    diameter = sphere_diameters(void, None, tuple(edges), (False,) * 3, what="void")
    return float(diameter[void].mean(dtype=np.float64))


def _joined(above: np.ndarray, height: int) -> float:
    """Return the share of the void of the lowest layers that is joined to the highest layer."""
    void = ~above
    total = int(np.count_nonzero(void[:height]))
    if total == 0:
        return 0.0
    # what stands higher than the image is tissue
    open_ = np.concatenate([void, np.ones((1, *void.shape[1:]), bool)])
    labels = label_components(open_)[0]
    return float(np.count_nonzero(labels[:height] == labels[-1].flat[0]) / total)


def _sections(
    above: np.ndarray, body: np.ndarray, edges: list[float], count: int
) -> dict[str, np.ndarray]:
    """Return the figures of sections along the last axis; of a picture its own."""
    found: dict[str, list[float]] = {"void": [], "intercept": [], "thickness": []}
    if above.ndim == 2:
        parts = [(above, body)]
    else:
        chosen = np.unique(np.linspace(0, above.shape[2] - 1, count).round().astype(int))
        parts = [(above[:, :, k], body[:, :, k]) for k in chosen]
    for whole, low in parts:
        fraction, intercept = _void(low, edges[:2])
        found["void"].append(fraction)
        found["intercept"].append(intercept)
        found["thickness"].append(float(_heights(whole).mean()) * edges[0])
    return {name: np.array(values) for name, values in found.items()}

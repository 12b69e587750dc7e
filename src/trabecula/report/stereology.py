"""Stereology: what a picture implies about the volume that its slices are of.

- Points that are joined within a slice are joined in space. So a phase that percolates in the
  picture, and in every part of it, percolates in the volume along those axes; and where the slices
  of two planes hold more than half of a phase in one component, these components meet, so the
  volume holds at least that share in one. The converse is false: what is apart in every slice may
  be joined above or below, and no picture decides it.
- Where one picture stands for all planes the material is isotropic (that is what it says), so
  S_V = 4 / pi B_A (area per volume from the boundary's length per area: Crofton's formula for plane
  sections; Ohser and Muecklich 2000, "Statistical Analysis of Microstructures in Materials
  Science"), the covariance along the body diagonals, which lie in no slice along the axes, is that
  of the slices, and lines along the three axes cross the interface equally often.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from trabecula.core.image import Image
from trabecula.measure.components import component_sizes
from trabecula.measure.correlation import covariance_form, two_point
from trabecula.measure.fractions import specific_surface
from trabecula.measure.percolation import percolates
from trabecula.report.band import LEAST_COUNT, excess_limit, parts, value_band
from trabecula.report.descriptors import Measurements
from trabecula.report.metrics import VOLUME, Metric
from trabecula.report.planes import DIAGONAL
from trabecula.report.reference import Reference

PHASES = {"": "solid", "_void": "void"}
"""Phases whose connections are judged, by the ending of their figures."""

JOINED = 0.5
"""Share of a phase in one component above which the slices of two planes must meet."""

RANGE = 1.5
"""Range of three draws over that of two, of a normal distribution: 1.69 / 1.13."""


@dataclass(frozen=True)
class Joined:
    """Connections of a phase in a picture.

    Attributes
    ----------
    axes : tuple of str
        Axes of the volume along which the picture and every part of it percolate.
    planes : int
        Planes of the volume whose slices hold more than half of the phase in one component.
    share : tuple of float, optional
        The picture's own share in its largest component, and the least that another sample of the
        image's size has; None where half of the phase may lie elsewhere.
    """

    axes: tuple[str, ...] = ()
    planes: int = 0
    share: tuple[float, float] | None = None

    def union(self, other: Joined) -> Joined:
        """Return what two pictures show together."""
        axes = tuple(axis for axis in "zyx" if axis in self.axes + other.axes)
        shares = [share for share in (self.share, other.share) if share]
        least = min(shares, key=lambda share: share[1]) if shares else None
        return Joined(axes, self.planes + other.planes, least)

    @property
    def implied(self) -> bool:
        """Return whether the picture says that the phase is one component in space."""
        return self.planes > 1 and self.share is not None


def joined_in(
    reference: Reference, planes: Sequence[str], measured: Measurements, shape: Sequence[int]
) -> dict[str, Joined]:
    """Return the connections of the solid and of the void in a picture, by the ending of figures.

    Parameters
    ----------
    reference : Reference
        The picture.
    planes : sequence of str
        Of the volume that it stands for.
    measured : Measurements
        Mean of the volume's slices, for their size.
    shape : sequence of int
        Largest part of the picture, pixels.
    """
    return {
        ending: _joined(
            # Not named, the solid is every phase but the void.
            reference,
            None if phase == "solid" else phase,
            planes,
            measured,
            shape,
        )
        for ending, phase in PHASES.items()
    }


def _joined(
    reference: Reference,
    phase: str | None,
    planes: Sequence[str],
    measured: Measurements,
    shape: Sequence[int],
) -> Joined:
    pictures = [reference.exemplar, *parts(reference.exemplar, shape=shape)]
    if len(pictures) <= LEAST_COUNT:
        return Joined()
    spans = [percolates(each, phase=phase) for each in pictures]
    through = [all(span[axis] for span in spans) for axis in "yx"]  # rows, columns
    axes = {plane[n] for plane in planes for n in range(2) if through[n]}
    if not axes:
        return Joined()
    own, *known = (_largest(each, phase) for each in pictures)
    share = None
    if min(own, *known) > JOINED:
        sizes = reference.sizes_of(measured, "largest_fraction")
        share = (own, min(own, value_band(known, own, sizes)[0]))
    return Joined(tuple(sorted(axes, key="zyx".index)), len(planes) if share else 0, share)


def _largest(image: Image, phase: str | None) -> float:
    sizes = component_sizes(image, phase=phase)
    return float(sizes.max(initial=0) / max(1, sizes.sum()))


def judge_connections(
    joined: Mapping[str, Joined], metrics: Mapping[str, Metric]
) -> dict[str, Metric]:
    """Judge percolation and the largest component of a volume by what its pictures imply; those
    that they imply nothing about keep their values.
    """
    found = {}
    for ending, phase in joined.items():
        name = f"percolates_{VOLUME}{ending}"
        spans = metrics[name].value
        if phase.axes:
            passed = all(spans[axis] for axis in phase.axes)
            found[name] = Metric(spans, None, passed, {axis: True for axis in phase.axes})
        name = f"largest_fraction_{VOLUME}{ending}"
        value = metrics[name].value
        if phase.share and phase.implied and value is not None:
            own, low = phase.share
            found[name] = Metric(value, (low, 1.0), value >= low, own)
    return found


def judge_isotropy(
    reference: Reference, image: Image, slices: Measurements, planes: Mapping[str, Measurements]
) -> dict[str, Metric]:
    """Judge what an isotropic material of the picture's figures has in directions that no slice
    shows, and whether its axes are alike.

    Parameters
    ----------
    reference : Reference
        The picture, which stands for all planes.
    image : Image, (Z, Y, X)
    slices : Measurements
        Mean of the volume's slices.
    planes : dict of str to Measurements
        Of the slices of each plane.
    """
    if max(image.spacing) > min(image.spacing) * (1 + 1e-4) or len(reference.parts) < LEAST_COUNT:
        return {}
    far = len(reference.own.curves[DIAGONAL]) - 1  # k sqrt(2) over three correlation lengths
    own, *known = (
        _apart(part.curves[DIAGONAL], part.curves["two_point"], math.sqrt(2))
        for part in (reference.own, *reference.parts)
    )
    steps = max(1, int(far * math.sqrt(2 / 3)))
    value = _apart(_body_diagonals(image, steps), slices.curves["two_point"], math.sqrt(3))
    limit = excess_limit(known, own, reference.sizes_of(slices, "oblique_covariance"))
    found = {"oblique_covariance": Metric(value, (0.0, limit), value <= limit, own)}
    found |= _judge_surface(reference, image, slices)
    return found | _judge_axes(reference, slices, planes)


def _body_diagonals(image: Image, steps: int) -> np.ndarray:
    """Return S2 along the four body diagonals, mean over them."""
    ways = [(1, *signs) for signs in product((1, -1), repeat=2)]
    far = min(steps, min(image.shape) - 1)
    return np.mean([two_point(image, r_max=far, direction=way) for way in ways], axis=0)


def _apart(curve: np.ndarray, radial: np.ndarray, step: float) -> float:
    """Return the relative l2 between the covariance along diagonals, `step` voxels a sample, and
    the radial one of the same image.
    """
    along, around = covariance_form(curve), covariance_form(radial)
    there = np.interp(step * np.arange(len(along)), np.arange(len(around)), around)
    size = float(np.linalg.norm(there[1:]))
    return float(np.linalg.norm((along - there)[1:])) / size if size > 0 else 0.0


def _judge_surface(reference: Reference, image: Image, slices: Measurements) -> dict[str, Metric]:
    """Judge the area of the interface per volume by the boundary's length per area in slices."""
    factor = 4 / math.pi
    own = reference.own.numbers["specific_surface"]
    known = [part.numbers["specific_surface"] for part in reference.parts]
    low, high = value_band(known, own, reference.sizes_of(slices, "specific_surface"))
    value, edges = specific_surface(image), (factor * low, factor * high)
    passed = edges[0] <= value <= edges[1]
    return {f"specific_surface_{VOLUME}": Metric(value, edges, passed, factor * own)}


def _judge_axes(
    reference: Reference, slices: Measurements, planes: Mapping[str, Measurements]
) -> dict[str, Metric]:
    """Judge the largest difference between the axes in how often lines cross the interface."""
    rates: dict[str, list[float]] = {}
    for plane, measured in planes.items():
        for axis, letter in zip(plane, "yx", strict=True):
            rates.setdefault(axis, []).append(measured.numbers[f"specific_surface_{letter}"])
    value = _range([float(np.mean(rates[axis])) for axis in rates])
    own, *known = (
        _range([each.numbers[f"specific_surface_{letter}"] for letter in "yx"])
        for each in (reference.own, *reference.parts)
    )
    sizes = reference.sizes_of(slices, "axes_apart")
    limit = RANGE * excess_limit(known, own, sizes)
    return {"axes_apart": Metric(value, (0.0, limit), value <= limit, own)}


def _range(values: Sequence[float]) -> float:
    mean = float(np.mean(values))
    return (max(values) - min(values)) / mean if mean > 0 else 0.0


def beyond(
    joined: Mapping[str, Joined], metrics: Mapping[str, Metric], *, sections: bool = False
) -> Iterator[str]:
    """Yield what pictures do not decide about a volume, with the volume's own figures; `sections`
    says whether parallel sections judge the Euler number of the solid.
    """
    for ending, phase in joined.items():
        share = metrics[f"largest_fraction_{VOLUME}{ending}"].value
        if phase.implied or share is None:
            continue
        count = metrics[f"components_{VOLUME}{ending}"].value
        held = math.floor(1000 * share) / 1000  # .9999 is not all of it
        here = f"{held:.3g} of it lies in the largest of {count} components"
        spans = metrics[f"percolates_{VOLUME}{ending}"].value
        through = ", ".join(axis for axis, holds in spans.items() if holds) or "no axis"
        yield (
            f"whether the {PHASES[ending]} is joined in space: what is apart in the picture may be "
            f"joined above or below (here {'it is one component' if count == 1 else here}; it "
            f"percolates along {through})"
        )
    euler = "" if sections else "the Euler number, "
    yield (
        f"figures that only a volume has: the number of components, {euler}sizes of largest "
        "spheres, transport and stiffness; they are reported as in 3-D and not judged"
    )


def implied_notes(joined: Mapping[str, Joined], metrics: Mapping[str, Metric]) -> Iterator[str]:
    """Yield what pictures imply about connections and a volume holds."""
    for ending, phase in joined.items():
        held = metrics[f"percolates_{VOLUME}{ending}"]
        largest = metrics[f"largest_fraction_{VOLUME}{ending}"]
        if not held.passed:
            continue
        text = (
            f"The {PHASES[ending]} percolates in every part of the picture, so it has to in space "
            f"along {', '.join(phase.axes)}, and does"
        )
        if largest.passed:
            assert largest.real_band is not None
            text += (
                f"; its largest component has to hold at least {largest.real_band[0]:.2g} of it, "
                f"and holds {largest.value:.2g}"
            )
        yield f"{text}."


def void_figures(image: Image) -> dict[str, Metric]:
    """Measure components, largest component and percolation of the void."""
    sizes = component_sizes(image, phase="void")
    share = float(sizes.max(initial=0) / sizes.sum()) if len(sizes) else None
    return {
        f"components_{VOLUME}_void": Metric(len(sizes)),
        f"largest_fraction_{VOLUME}_void": Metric(share),
        f"percolates_{VOLUME}_void": Metric(percolates(image, phase="void")),
    }

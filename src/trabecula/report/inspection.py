"""`inspect`: facts of a scan before any work, the method that fits, the scope of a certificate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import check_type
from trabecula.core.image import Image, as_image
from trabecula.engine.lazy_volume import Slabs
from trabecula.exemplar.margins import Margins, crop_margins, find_margins
from trabecula.exemplar.segment import segment
from trabecula.measure.centre_crop import centre_box
from trabecula.measure.components import label_components
from trabecula.measure.fabric import fabric
from trabecula.measure.grey import grey_values
from trabecula.measure.percolation import percolates
from trabecula.measure.thickness import thickness
from trabecula.report.decidability import Decidable, find_decidable
from trabecula.report.inspection_text import origins_of, table
from trabecula.report.recommend import Recommendation, recommend
from trabecula.report.stationarity import Stationarity, find_trends
from trabecula.report.structure import (
    Structure,
    has_bodies,
    measure_structure,
    solid_field,
)

SLAB_BOX = 256
"""Edge of the centre box, voxels, of a volume that does not fit into memory."""
THICK_BOX = {2: 512, 3: 128}
"""Edge of the centre box that thickness and directions are measured in: seconds of work."""


@dataclass(frozen=True)
class Grey:
    """Values of a grey image (of colour: its luminance).

    Attributes
    ----------
    bits : int
        Of a voxel.
    low, high : float
        The range that occurs.
    saturated : float
        Share of the voxels at the lowest or highest value of the type (of real numbers: that
        occurs), 0..1.
    threshold : float or None
        Otsu's; None where there is one value.
    separability : float
        Share of the variance that lies between the two classes, 0..1 (Otsu 1979,
        doi:10.1109/TSMC.1979.4310076, eq. 12). A normal distribution has .64, an even one .75.
    noise : float
        Standard deviation of what neighbours do not have in common, in the image's values.
    """

    bits: int
    low: float
    high: float
    saturated: float
    threshold: float | None
    separability: float
    noise: float


@dataclass(frozen=True)
class Phase:
    """A phase: its fraction, mean thickness (voxels; None where it fills the image), components,
    and where it percolates.
    """

    fraction: float
    thickness: float | None
    components: int
    largest_fraction: float
    percolates: Mapping[str, bool]


@dataclass(frozen=True)
class Inspection:
    """Findings of `inspect`. All but `shape`, `kind`, `margins` and `grey` is of the image without
    its margins.

    Attributes
    ----------
    shape : tuple of int
    kind : str
    spacing, unit
    origin : mapping
        Where kind, phases, spacing and unit come from, in words.
    margins : Margins
    grey : Grey or None
    phases : mapping of str to Phase
        Of a grey image at its threshold; empty of colour.
    structure : Structure
    stationarity : Stationarity
    anisotropy : float or None
        Degree of anisotropy, 0..1 (see `measure.anisotropy`).
    longest : str or None
        The axis that the longest mean intercepts lie nearest to.
    bodies : str or None
        A phase that consists of separate bodies of one shape.
    recommendation : Recommendation
    decidable : Decidable
        The scope of a certificate.
    whole : tuple of int or None
        The shape of a volume of which the centre box alone was inspected.
    """

    shape: tuple[int, ...]
    kind: str
    spacing: tuple[float, ...]
    unit: str
    origin: Mapping[str, str]
    margins: Margins
    grey: Grey | None
    phases: Mapping[str, Phase]
    structure: Structure
    stationarity: Stationarity
    anisotropy: float | None
    longest: str | None
    bodies: str | None
    recommendation: Recommendation
    decidable: Decidable
    whole: tuple[int, ...] | None = None
    fractions: Mapping[str, float] = field(default_factory=dict)
    """Of the phases with the margins."""

    @property
    def sizes(self) -> tuple[float, ...]:
        """Return the sides in correlation lengths."""
        return tuple(
            side / length if length > 0 else float("inf")
            for side, length in zip(self.margins.size, self.structure.lengths, strict=True)
        )

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON; lengths in voxels, None where they are infinite."""
        found = {
            name: getattr(self, name)
            for name in ("kind", "unit", "anisotropy", "longest", "bodies")
        }
        return found | {
            "shape": list(self.shape),
            "whole": None if self.whole is None else list(self.whole),
            "spacing": list(self.spacing),
            "origin": dict(self.origin),
            "margins": self.margins.to_json(),
            "grey": None if self.grey is None else vars(self.grey),
            "fractions_with_margins": dict(self.fractions),
            "phases": {name: vars(phase) for name, phase in self.phases.items()},
            "correlation_lengths": [_finite(length) for length in self.structure.lengths],
            "sizes_in_correlation_lengths": [_finite(size) for size in self.sizes],
            "order": self.structure.order,
            "period": None if self.structure.period is None else list(self.structure.period),
            "stationarity": self.stationarity.to_json(),
            "recommendation": self.recommendation.to_json(),
            "decidable": self.decidable.to_json(),
        }

    def to_table(self) -> str:
        """Return the findings in words, for a terminal: at most 40 lines."""
        return table(self)

    def __str__(self) -> str:
        return self.to_table()


def _finite(number: float) -> float | None:
    return number if np.isfinite(number) else None


def inspect(
    image: Image | Slabs | ArrayLike, *, origin: Mapping[str, str] | None = None
) -> Inspection:
    """Inspect a scan before any work: what it is, what fits it, what can be decided about it.

    Parameters
    ----------
    image : Image, Slabs or array of labels, (Z, Y, X) or (Y, X)
        Labels, grey or colour. Of `Slabs` the centre box of 256 voxels a side is inspected.
    origin : mapping, optional
        Where kind, phases, spacing and unit come from, in words. Default: from the recipe.

    Returns
    -------
    inspection : Inspection
        `print` shows it; `recommendation` has method, preset and settings.

    Raises
    ------
    InputError
        A plain array whose meaning is open.

    Examples
    --------
    >>> from trabecula.exemplar.samples import sample
    >>> inspect(sample("foam")).recommendation.method
    'texture'
    """
    whole = None
    if isinstance(image, Slabs):
        whole, volume = image.shape, image
        image = replace(
            volume.centre([min(side, SLAB_BOX) for side in whole]), recipe=volume.recipe
        )
    image = as_image(image)
    # Of the centre of a larger volume nothing is a margin.
    none = Margins(image.shape, (), None, (0,) * image.ndim, image.shape)
    margins = none if whole else find_margins(image)
    if origin is not None:
        check_type(origin, Mapping, name="origin", advice="give what origins_of returns")
    inner = crop_margins(image) if margins else image
    structure = measure_structure(inner)
    grey = None if image.kind == "labels" else _grey(inner, structure)
    labels = _segment_scan(inner, grey)
    anisotropy, longest = (None, None) if labels is None else _direction(labels)
    stationarity = find_trends(inner, structure.lengths)
    return Inspection(
        shape=image.shape,
        kind=image.kind,
        spacing=image.spacing,
        unit=image.unit,
        origin=origins_of(image) if origin is None else dict(origin),
        margins=margins,
        grey=grey,
        phases={} if labels is None else _phases(labels),
        structure=structure,
        stationarity=stationarity,
        anisotropy=anisotropy,
        longest=longest,
        bodies=None if labels is None else has_bodies(labels),
        recommendation=_recommend_for(inner, labels),
        decidable=find_decidable(
            inner if labels is None else labels, structure.lengths, stationarity
        ),
        whole=whole,
        fractions={} if image.kind != "labels" else _fractions(image),
    )


def _fractions(image: Image) -> dict[str, float]:
    return {
        name: np.count_nonzero(image.values == n) / image.values.size
        for n, name in enumerate(image.phases)
    }


def _segment_scan(image: Image, grey: Grey | None) -> Image | None:
    """Return the image as labels, as methods would take it; None of colour, and of an image of one
    value.
    """
    if image.kind == "grey" and grey is not None and grey.threshold is not None:
        return segment(image)
    return image if image.kind == "labels" else None


def _recommend_for(image: Image, labels: Image | None) -> Recommendation:
    """Choose a method for the labels where there are any: a grey volume is segmented first."""
    if image.kind == "grey" and labels is not None:
        found = recommend(labels)
        threshold = labels.recipe.steps[-1]["threshold"]
        keep = recommend(image)
        other = f"; or --threshold none --method {keep.method} for greys" if keep.method else ""
        return replace(found, reason=f"segmented at {threshold:g}: {found.reason}{other}")
    return recommend(image)


def _grey(image: Image, structure: Structure) -> Grey:
    values = grey_values(image)
    own = image.values
    low, high = float(values.min()), float(values.max())
    ends = np.iinfo(own.dtype) if own.dtype.kind in "iu" else None
    first, last = (ends.min, ends.max) if ends else (own.min(), own.max())
    saturated = np.count_nonzero((own == first) | (own == last)) / own.size
    noise = float(values.std(dtype=np.float64)) * structure.noise**0.5
    threshold, share = (None, 0.0) if low == high else _otsu(image, values)
    return Grey(8 * own.dtype.itemsize, low, high, saturated, threshold, share, noise)


def _otsu(image: Image, values: np.ndarray) -> tuple[float, float]:
    from trabecula.exemplar.segment import otsu

    threshold = otsu(image.values if image.kind == "grey" else values)[0]
    above = values > threshold
    share, total = float(above.mean()), float(values.var(dtype=np.float64))
    if not 0 < share < 1 or total == 0:
        return threshold, 0.0
    apart = float(values[above].mean(dtype=np.float64) - values[~above].mean(dtype=np.float64))
    return threshold, min(1.0, share * (1 - share) * apart**2 / total)


def _phases(image: Image) -> dict[str, Phase]:
    found = {}
    box = centre_box(image.values, THICK_BOX[image.ndim])
    for number, name in enumerate(image.phases):
        inside = image.values == number
        if not inside.any():
            continue
        sizes = label_components(inside)[1]
        part = box == number
        mean = None
        if part.any() and not part.all() and min(part.shape) > 1:
            mean = float(thickness(part.astype(np.uint8)))
        through = percolates(inside.astype(np.uint8))
        share = float(sizes.max() / sizes.sum())
        found[name] = Phase(
            np.count_nonzero(inside) / inside.size, mean, len(sizes), share, through
        )
    return found


def _direction(image: Image) -> tuple[float | None, str | None]:
    """Return the degree of anisotropy, and the axis nearest to the longest mean intercepts."""
    inside = solid_field(image, THICK_BOX[image.ndim])
    if min(inside.shape) < 4 or inside.all() or not inside.any():
        return None, None
    found = fabric(inside.astype(np.uint8))
    return found.anisotropy, "zyx"[int(np.abs(found.directions[0]).argmax()) + 3 - image.ndim]

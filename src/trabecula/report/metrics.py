"""Figures of the certificate: values, verdicts, and the descriptor that a name stands for."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

from trabecula.measure.registry import DESCRIPTORS, GROUPS, REPORTED, Descriptor

VOLUME = "3d"
"""Suffix of what is reported of a volume whose exemplar is a picture."""

_OF_PHASES = ("fraction", "contact", "cross_correlation_distance")
_SIZES = ("small", "medium", "large")
_AXES = {"z": "along z", "y": "along y", "x": "along x", "centre": "from the faces to the centre"}


@dataclass(frozen=True)
class Metric:
    """One figure of the certificate."""

    value: Any
    """Number; for `percolates` one truth value per axis; `None` where it does not exist."""
    real_band: tuple[float, float] | None = None
    """The figure's spread between parts of the exemplar; `None` where the exemplar is too small, or
    no band makes sense."""
    passed: bool | None = None
    """Inside the band; `None` where there is nothing to judge by."""
    exemplar: Any = None
    """The exemplar's own value (0 for a distance to it; a count is scaled to the image's volume).
    """
    symmetry: str | None = None
    """Of `turned_copies`: how the exemplar was mirrored or turned, in words."""

    @property
    def apart(self) -> float | None:
        """Return how far it is from the exemplar's, in units of its band's farther end from that: 1
        at the end; None where there are no such numbers.
        """
        numbers = (self.value, self.exemplar, *(self.real_band or (None,)))
        if not all(isinstance(one, Real) and math.isfinite(one) for one in numbers):
            return None
        value, own, low, high = map(float, numbers)
        width = max(high - own, own - low)
        return abs(value - own) / width if width > 0 else None

    def to_json(self) -> dict[str, Any]:
        """Return value, band and verdict by the names that scripts rely on."""
        found = {
            "value": self.value,
            "real_band": list(self.real_band) if self.real_band else None,
            "pass": self.passed,
        }
        return found | ({"symmetry": self.symmetry} if self.symmetry else {})


def group_verdicts(metrics: Mapping[str, Metric]) -> dict[str, bool | None]:
    """Return the verdict of every group that has a figure, in the order of the groups."""
    members: dict[str, list[Metric]] = {}
    for name, metric in metrics.items():
        members.setdefault(find_descriptor(name).group, []).append(metric)
    return {group: all_passed(members[group]) for group in GROUPS if group in members}


def all_passed(metrics: Iterable[Metric]) -> bool | None:
    """Return the verdict of several figures; None where none is judged."""
    verdicts = [metric.passed for metric in metrics if metric.passed is not None]
    return all(verdicts) if verdicts else None


def find_descriptor(name: str) -> Descriptor:
    """Return the descriptor of a figure, with the title of that figure.

    Suffixes of the name are an axis (`diffusivity_z`), a phase (`fraction_binder`), a window's size
    (`fraction_spread_large`), a pair of phases (`contact_active_binder`), planes
    (`porosity_yx_zx`), the volume beside a picture (`components_3d`), and these one after another.
    """
    stem, suffix = _split(name)
    found = DESCRIPTORS[stem]
    if stem in _OF_PHASES:  # any word may be the name of a phase
        return replace(found, name=name, title=f"{found.title} of {suffix}") if suffix else found
    words = suffix.split("_") if suffix else []
    volume, words = (True, words[1:]) if words[:1] == [VOLUME] else (False, words)
    size, words = (words[0], words[1:]) if words and words[0] in _SIZES else ("", words)
    axis = next((word for word in (*words[:1], *words[-1:]) if word in _AXES), "")
    if axis:
        words = words[1:] if words[0] == axis else words[:-1]
    planes = [word for word in words if len(word) == 2 and set(word) < set("zyx")]
    phase = "_".join(word for word in words if word not in planes)
    of = phase or found.of
    title = found.title + (f", {size} windows" if size else "") + (f" of {of}" if of else "")
    title += f" {_AXES[axis]}" if axis else ""
    title += f" in {' and '.join(planes)}" if planes else ""
    if volume:
        rule = found.rule if found.implied else REPORTED
        return replace(found, name=name, title=f"{title}, in 3-D", rule=rule)
    return replace(found, name=name, title=title)


def stem(name: str) -> str:
    """Return the name of a figure without its suffix: the name of its descriptor."""
    return _split(name)[0]


def in_order(names: Iterable[str]) -> list[str]:
    """Sort names in the order of the registry; those of axes and phases follow their figure, in the
    order given.
    """
    places = {name: place for place, name in enumerate(DESCRIPTORS)}
    return sorted(names, key=lambda name: places[stem(name)])


def _split(name: str) -> tuple[str, str]:
    found = max(
        (
            known
            for known, descriptor in DESCRIPTORS.items()
            if descriptor.group and (name == known or name.startswith(f"{known}_"))
        ),
        key=len,
    )
    return found, name[len(found) + 1 :]

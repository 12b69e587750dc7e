"""The certificate of an ensemble: figures, verdict and reasons, as JSON, text and page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trabecula.report.ensemble_page import ensemble_page, ensemble_summary_html
from trabecula.report.ensemble_tests import Comparison
from trabecula.report.ensemble_text import ensemble_summary, ensemble_table
from trabecula.report.findings import Findings
from trabecula.report.page import Pictures

MOST_OPEN = 0.2
"""Share of figures that are not decided at which an ensemble still passes."""


@dataclass(frozen=True)
class Copying:
    """How far members are from being copies, of each other and of the exemplar."""

    closest: float
    """Of the two most alike: share of voxels that differ, over what independent ones would."""
    pair: tuple[str, str]
    """Their names."""
    among: float | None = None
    """Largest coherence of one member with another; None where it was not examined."""
    exemplar: float | None = None
    """Largest coherence of a member with an exemplar."""
    limit: float | None = None
    """What parts of the exemplar reach by chance."""
    examined: tuple[str, ...] = ()
    """Members that coherence was measured of."""
    faults: tuple[str, ...] = ()
    """What is wrong, in words."""


@dataclass(frozen=True, repr=False)
class EnsembleCertificate(Findings):
    """The findings of `verify_ensemble` about the members of an ensemble."""

    metrics: Mapping[str, Comparison]
    """By name, in the order of the registry."""
    titles: Mapping[str, str]
    """Of the figures, with their units."""
    names: tuple[str, ...]
    """Of the members."""
    shape: tuple[int, ...]
    """Of the members."""
    real: Mapping[str, Any]
    """About the real parts: how many, their shape, how many independent ones they stand for,
    whether they were extrapolated, and how often real material itself fails."""
    copying: Copying
    notes: tuple[str, ...] = ()
    """Facts to know before believing the figures."""
    about: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the exemplars; the level."""

    @property
    def passed(self) -> bool | None:
        """Return the verdict: False where a figure fails or members are copies; None where too few
        figures could be judged; else True.
        """
        if self.failed or self.copying.faults:
            return False
        return None if len(self.undecided) > MOST_OPEN * len(self.metrics) else True

    @property
    def verdict(self) -> str:
        """Return the verdict as a word: "pass", "fail" or "cannot tell"."""
        return {True: "pass", False: "fail", None: "cannot tell"}[self.passed]

    @property
    def failed(self) -> tuple[str, ...]:
        """Return the names of the figures that fail."""
        return tuple(name for name, one in self.metrics.items() if one.faults)

    @property
    def undecided(self) -> tuple[str, ...]:
        """Return the names of the figures that are not decided."""
        return tuple(name for name, one in self.metrics.items() if one.passed is None)

    @property
    def within(self) -> float:
        """Return the share of the figures whose spread is the real one within a quarter, and of
        which no single test has a p value below 0.05.
        """
        return sum(one.within for one in self.metrics.values()) / len(self.metrics)

    @property
    def chance(self) -> float:
        """Return the share of the figures whose spread would be the real one within a quarter, by
        chance of so few members and parts, were the members real material.
        """
        return float(np.mean([one.chance for one in self.metrics.values()]))

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON, under the key "ensemble"."""
        copying = self.copying
        return {
            "ensemble": {
                "members": len(self.names),
                "shape": list(self.shape),
                "verdict": self.verdict,
                "passed": self.passed,
                "failed": list(self.failed),
                "undecided": list(self.undecided),
                "within": self.within,
                "within_of_real": self.chance,
                "metrics": {name: _plain(one) for name, one in self.metrics.items()},
                "real": dict(self.real),
                "diversity": {
                    "closest": copying.closest,
                    "pair": list(copying.pair),
                    "coherence": copying.among,
                },
                "copying": {
                    "coherence": copying.exemplar,
                    "limit": copying.limit,
                    "examined": list(copying.examined),
                    "faults": list(copying.faults),
                },
                "names": list(self.names),
                "level": self.about.get("level"),
                "notes": list(self.notes),
            }
        }

    def __repr__(self) -> str:
        return ensemble_summary(self)

    def _repr_html_(self) -> str:
        return ensemble_summary_html(self)

    def to_table(self) -> str:
        """Return a table for a terminal."""
        return ensemble_table(self)

    def _page(self, pictures: Pictures) -> str:
        return ensemble_page(self, pictures=pictures)


def _plain(one: Comparison) -> dict[str, Any]:
    """Return a figure as plain JSON."""
    return {
        "mean": one.mean,
        "sd": one.deviation,
        "real_mean": one.real_mean,
        "real_sd": one.real_deviation,
        "ratio": one.ratio,
        "ratio_interval": one.ratio_interval and list(one.ratio_interval),
        "shift": one.shift,
        "shift_interval": one.shift_interval and list(one.shift_interval),
        "p": dict(one.p),
        "p_adjusted": dict(one.adjusted),
        "real_band": list(one.band),
        "inside": one.inside,
        "within": one.within,
        "verdict": one.verdict,
        "faults": list(one.faults),
        "reason": one.reason,
        "values": list(one.members),
        "real_values": list(one.real),
    }

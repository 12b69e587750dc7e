"""The certificate: figures, verdict and reasons, as JSON, text and page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trabecula.core.image import Image, describe_fields
from trabecula.report.findings import Findings
from trabecula.report.metrics import Metric, all_passed, group_verdicts
from trabecula.report.page import Pictures, page, summary_html, write_page
from trabecula.report.provenance import methods_text, today
from trabecula.report.summary_text import IN_SPACE, summary, table
from trabecula.report.tables import csv_text, curve_rows, figure_rows


@dataclass(frozen=True, repr=False)
class Certificate(Findings):
    """The findings of `verify` about one image."""

    metrics: Mapping[str, Metric]
    """By name, in the order of the table of figures."""
    notes: tuple[str, ...] = ()
    """Facts to know before believing the figures."""
    name: str = "image"
    curves: Mapping[str, Any] = field(default_factory=dict)
    """By "exemplar", "image", "baseline" and "parts" (a list): the curves that were compared, by
    name.
    """
    about: Mapping[str, Any] = field(default_factory=dict)
    """Shape, spacing, unit, phases and recipe of "exemplar" and "image"; "level"; "physics" of both
    at level "full".
    """
    baseline: Mapping[str, Metric] | None = None
    """The same figures of a thresholded Gaussian field with the exemplar's fraction and two-point
    function: what a method has to beat. `None` where none was made."""
    undecided: tuple[str, ...] = ()
    """Why nothing can be passed even where nothing fails: an exemplar that is too small or not
    stationary, figures that noise passes as well, limits of a picture, parts that were not
    examined."""
    local_fractions: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """By "exemplar" and "image", by axis: a map of the local fraction in the middle plane across
    that axis.
    """
    beyond_picture: tuple[str, ...] = ()
    """What a picture does not decide about a volume, with the volume's own figures; empty where the
    exemplar is no picture."""

    @property
    def passed(self) -> bool | None:
        """Return the verdict: False where a metric failed, None where none did and `undecided` says
        why that proves nothing, else True.
        """
        verdict = all_passed(self.metrics.values())
        return None if verdict and self.undecided else verdict

    @property
    def verdict(self) -> str:
        """Return the verdict as a word: "pass", "fail" or "not decided"."""
        return {True: "pass", False: "fail", None: "not decided"}[self.passed]

    @property
    def failed(self) -> tuple[str, ...]:
        """Return the names of the metrics that failed."""
        return tuple(name for name, metric in self.metrics.items() if metric.passed is False)

    @property
    def by_pictures(self) -> bool:
        """Return whether a volume is judged by pictures, which decide nothing about connections."""
        return "planes" in self.about

    @property
    def groups(self) -> dict[str, bool | None]:
        """Return the verdict of each group of figures that was measured: "two-point", "shape", ...
        None where none was judged; slices that match a picture decide nothing about connections in
        space."""
        found = group_verdicts(self.metrics)
        return {
            name: None if self.by_pictures and name in IN_SPACE and passed else passed
            for name, passed in found.items()
        }

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON: metrics with value, real_band and pass; the verdict, whole and by
        group; the baseline's metrics; notes; of pictures what they do not decide."""
        beyond = {"not_decided_by_picture": list(self.beyond_picture)} if self.by_pictures else {}
        return {
            "metrics": {name: metric.to_json() for name, metric in self.metrics.items()},
            "verdict": self.verdict,
            "passed": self.passed,
            "undecided": list(self.undecided),
            "groups": self.groups,
            "baseline": None
            if self.baseline is None
            else {n: m.to_json() for n, m in self.baseline.items()},
            "level": self.about.get("level"),
            "notes": list(self.notes),
            **beyond,
        }

    def __repr__(self) -> str:
        return summary(self)

    def _repr_html_(self) -> str:
        return summary_html(self)

    def to_table(self) -> str:
        """Return a table for a terminal."""
        return table(self)

    def to_csv(self, path: str | Path | None = None, *, curves: bool = False) -> str:
        """Return the figures as a table, one a row with unit, band and verdict, and write it.

        Parameters
        ----------
        path : path, optional
            A file to write.
        curves : bool
            The curves of exemplar, image, parts and baseline in their place.

        Returns
        -------
        text : str

        Raises
        ------
        FileError
            The file cannot be written.
        """
        text = csv_text(curve_rows(self) if curves else figure_rows([self]))
        if path is not None:
            write_page(text, path)
        return text

    def methods_text(self, *, date: str | None = None) -> str:
        """Return a paragraph for a Methods section with the works that it cites.

        Parameters
        ----------
        date : str, optional
            Of the judgement; today's by default.
        """
        return methods_text([self], date=today() if date is None else date)

    def _page(self, pictures: Pictures) -> str:
        return page([self], pictures=pictures)


def about_image(image: Image) -> dict[str, Any]:
    """Return shape and fields of an image, as plain JSON."""
    return {"shape": list(image.shape), **describe_fields(image)}

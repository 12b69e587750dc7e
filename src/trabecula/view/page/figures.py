"""Key figures of certificates, as rows of text for the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from trabecula.core.errors import InputError

# The first of each group of the certificate's table that a reader looks for; what failed is shown
# besides.
_KEY = (
    "porosity",
    "porosity_error",
    "two_point_distance",
    "two_point_relative",
    "specific_surface",
    "thickness",
    "pore_size",
    "anisotropy",
    "largest_fraction",
    "floating",
    "euler_density",
    "permeability",
    "stiffness",
    "coherence",
)


def figures_of(certificate: Any, count: int) -> list[list[list[str]]]:
    """Rows of (name, value, band, verdict) for every one of `count` images.

    Raises
    ------
    InputError
        Not a certificate, or not as many as there are images (or one less: none for the first).
    """
    if certificate is None:
        return [[] for _ in range(count)]
    one = isinstance(certificate, Mapping) or not isinstance(certificate, Sequence)
    several = [certificate] if one else list(certificate)
    if len(several) == count - 1:
        several.insert(0, None)
    if len(several) != count:
        raise InputError(
            f"{len(several)} certificates for {count} images: give one for each, or for each but the first"
        )
    return [[] if each is None else _rows(each) for each in several]


def _rows(certificate: Any) -> list[list[str]]:
    plain = certificate.to_json() if hasattr(certificate, "to_json") else certificate
    metrics = plain.get("metrics") if isinstance(plain, Mapping) else None
    if not isinstance(metrics, Mapping) or not all(
        isinstance(metric, Mapping) for metric in metrics.values()
    ):
        raise InputError(
            "certificate: give what tb.verify returns, or what `trabecula verify --json` prints"
        )
    shown = [name for name in metrics if name in _KEY or metrics[name].get("pass") is False]
    verdicts = {True: "pass", False: "fail", None: ""}
    return [
        [
            name,
            _number(metrics[name].get("value")),
            _band(metrics[name].get("real_band")),
            verdicts[metrics[name].get("pass")],
        ]
        for name in shown
    ]


def _number(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(map(_number, value))
    return f"{value:.3g}" if isinstance(value, (int, float)) else "-"


def _band(band: Any) -> str:
    return " .. ".join(map(_number, band)) if isinstance(band, Sequence) and band else ""

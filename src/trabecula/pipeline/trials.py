"""Settings by trial: material is made with each of several, and the certificate chooses.

What differs between the trials is settings, never the seed: to keep the best of several seeds would
make every result alike, where the material itself differs from place to place.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from trabecula.core.checks import as_number, check_type
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.core.progress import notify
from trabecula.report.certificate import verify
from trabecula.report.metrics import Metric
from trabecula.synth.api.method import Method

MOST = 3
"""The largest effort."""

_SIDE = 96  # voxels of a trial along every axis, at most
_SEED = 0
_NAMED = 6  # figures that a line lists
_FAR = 3.0  # bands: a figure that is farther off counts as so much


@dataclass(frozen=True)
class Trial:
    """A trial and its certificate.

    Attributes
    ----------
    settings : mapping
        What differs from the settings that were asked for; empty for these themselves; "method"
        for another one.
    outside : tuple of str
        Figures outside the band of the real material.
    decided : int
        Figures that have a band.
    apart : float
        How far figures are from the exemplar's, root mean square: 1 at the ends of their bands.
    """

    settings: Mapping[str, Any]
    outside: tuple[str, ...]
    decided: int
    apart: float = 0.0

    @property
    def named(self) -> str:
        """Return the settings in words."""
        changed = ", ".join(f"{name}={value}" for name, value in self.settings.items())
        return changed or "the settings as they are"

    @property
    def rank(self) -> tuple[int, float]:
        """Return what the best trial has least of: figures out of band, and how far all are off."""
        return len(self.outside), self.apart

    def __str__(self) -> str:
        """Return the trial in a line."""
        apart = f"; all {self.apart:.2f} of their bands off" if self.apart else ""
        return f"{self.named}: {band_line(self.outside, self.decided)}{apart}"


def band_line(outside: Sequence[str], decided: int) -> str:
    """Return how many figures are out of band, and the first of them by name."""
    more = len(outside) - _NAMED
    listed = ", ".join(outside[:_NAMED]) + (f" and {more} more" if more > 0 else "")
    return f"{len(outside)} of {decided} figures out of band{': ' if listed else ''}{listed}"


def choose_settings(
    method: Method,
    exemplar: Image,
    *,
    others: Sequence[Method] = (),
    effort: int = 2,
    memory: int | None = None,
) -> tuple[Method, tuple[Trial, ...]]:
    """Choose the settings of a method for an exemplar by trial, or another method.

    Material of the exemplar's size (96 voxels a side at most) is made with the settings as they
    are, with the method's own alternatives to them, and by the others, one seed each; all are
    verified. What has the fewest figures out of band is kept; of equals what is nearer to the
    exemplar. A setting that is not at its default stays as it is.

    Parameters
    ----------
    method : Method
    exemplar : Image
        Volume or picture that the method learns from.
    others : sequence of Method
        Other methods to try. One that cannot learn from the exemplar is left out, with a line.
    effort : int
        1: no trial. 2 or 3: the method's first alternatives, or all.
    memory : int, optional
        Budget in bytes for every trial. Default: the memory that is available.

    Returns
    -------
    method : Method
    trials : tuple of Trial
        In the order in which they were made.

    Raises
    ------
    InputError
        Without others: the method has no alternatives, or no setting is left to try. What
        `Method.fit` and `verify` raise.
    """
    number = int(as_number(effort, name="effort", low=1, high=MOST, whole=True))
    if number == 1:
        return method, ()
    check_type(method, Method, name="method", advice="give what tb.method returns")
    exemplar = as_image(exemplar)
    own = _alternatives(method, number, needed=not others)
    asked: list[tuple[Method, Mapping[str, Any]]] = [(method, {})]
    asked += [(type(method)(replace(method.config, **one)), one) for one in own]
    asked += [(other, {"method": other.capabilities.name}) for other in others]
    shape = tuple(min(side, _SIDE) for side in exemplar.shape)
    kept, made = [], []
    for count, (one, settings) in enumerate(asked, start=1):
        notify(f"trial {count} of {len(asked)}")
        try:
            model = one.fit(exemplar, memory=memory)
        except InputError as error:
            if "method" not in settings:
                raise
            notify(f"{settings['method']} is not tried: {error}")
            continue
        made.append(model.generate(shape, seed=_SEED, memory=memory))
        kept.append((one, settings))
    trials = tuple(
        Trial(
            settings,
            tuple(name for name, metric in judged.metrics.items() if metric.passed is False),
            sum(metric.passed is not None for metric in judged.metrics.values()),
            _apart(judged.metrics.values()),
        )
        for (_, settings), judged in zip(kept, verify(exemplar, *made), strict=True)
    )
    best = min(range(len(trials)), key=lambda at: trials[at].rank)
    return kept[best][0], trials


def _apart(metrics: Iterable[Metric]) -> float:
    """Return how far judged figures are from the exemplar's, root mean square, each at most `_FAR`
    times its band.
    """
    found = [metric.apart for metric in metrics if metric.passed is not None]
    numbers = [min(one, _FAR) for one in found if one is not None]
    return math.sqrt(sum(one**2 for one in numbers) / len(numbers)) if numbers else 0.0


def _alternatives(method: Method, effort: int, *, needed: bool) -> list[Mapping[str, Any]]:
    """List the alternatives to a method's settings that leave alone what was set; raise where they
    are `needed`, and there is none.
    """
    known = method.capabilities.name
    offered = getattr(method.config, "alternatives", None)
    if offered is None:
        if not needed:
            return []
        raise InputError(f"method {known!r} has no alternatives to try: leave the effort out")
    defaults = vars(method.config_type())
    changed = {name for name, value in vars(method.config).items() if value != defaults[name]}
    left = [settings for settings in offered(effort) if not changed & settings.keys()]
    if needed and not left:
        raise InputError(
            f"{', '.join(sorted(changed))} of method {known!r} are set, and nothing is left to "
            "try: leave these settings out, or the effort"
        )
    return left

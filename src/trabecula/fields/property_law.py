"""The power law between a property and the volume fraction of an exemplar's windows, by which a
field of the property becomes one of the fraction.

Liu and Shapiro 2016, section 3.2: a target property P is replaced by a descriptor D that goes with
it, P = a(D), wherever a can be inverted. Here D is the fraction x of the phase that carries, and
a(x) = c x^n, the law of cellular materials (Gibson, Ashby 1997) and of topology optimisation. It is
fitted to windows of the exemplar, each solved by itself; or to windows of what a model makes of it,
which is more even within a window than the exemplar, or less, and has another law.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, check_name
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, check_labels, with_values
from trabecula.core.progress import track
from trabecula.fields.grid import check_grey, of_image
from trabecula.fields.local import windowed
from trabecula.measure.properties import measure_property

CARRIES = {
    "stiffness": "solid",
    "conductivity": "solid",
    "diffusivity": "void",
    "permeability": "void",
}
"""The phase that carries each property."""

_LEAST = 12  # voxels a side of a window
_FEWEST = 8  # windows that a law is fitted to
_SPAN = 1.1  # largest over least fraction of them
_EXPONENTS = (0.05, 12.0)
_HALVINGS = 60  # of the interval that holds the exponent
_PROBE = 5, 2, 2  # windows a side of what a model makes for its law


class Maker(Protocol):
    """What makes material of a field of the solid's volume fraction: a model."""

    def generate(self, shape: Any, *, seed: Any, target: Any) -> Image:
        """Make it."""
        ...


@dataclass(frozen=True)
class PropertyLaw:
    """A property of windows as a power of the fraction of the phase that carries it.

    Attributes
    ----------
    name : str
        Of the property, with an axis or without.
    coefficient, exponent : float
        c and n of P = c x^n; P in the exemplar's unit of length.
    low, high : float
        Least and largest fraction x of the windows.
    scatter : float
        Standard deviation of the windows about the law, over its value.
    blocked : int
        Windows that nothing spans, whose property is 0; they count.
    fractions, values : (N,) float64
        Of the windows, by rising fraction.
    """

    name: str
    coefficient: float
    exponent: float
    low: float
    high: float
    scatter: float
    blocked: int
    fractions: np.ndarray
    values: np.ndarray

    def __str__(self) -> str:
        """Return the law in a line."""
        phase = CARRIES[self.name.partition(":")[0]]
        return (
            f"{self.name} = {self.coefficient:.4g} x^{self.exponent:.3g}, x the fraction of the "
            f"{phase}, {self.low:.3g} .. {self.high:.3g} in {len(self.values)} windows, which "
            f"scatter by {self.scatter:.0%}; {self.blocked} of them are spanned by nothing"
        )

    def fraction(self, field: Image) -> Image:
        """Return the field of the solid's volume fraction that has a field of the property.

        Parameters
        ----------
        field : Image
            Grey: the property at every voxel, in the exemplar's unit of length.

        Raises
        ------
        InputError
            The field goes beyond what the exemplar's windows have; the message names the range.
        """
        return fraction_for(
            field,
            name=self.name,
            coefficient=self.coefficient,
            exponent=self.exponent,
            low=self.low,
            high=self.high,
        )


def property_law(
    exemplar: Image | ArrayLike,
    name: str,
    *,
    window: int | None = None,
    count: int = 24,
    model: Maker | None = None,
    seed: int = 0,
) -> PropertyLaw:
    """Fit the power law between a property and the volume fraction of an exemplar's windows, or of
    windows that a model makes.

    Parameters
    ----------
    exemplar : Image or array of labels, (Z, Y, X)
        Void and solid.
    name : str
        "stiffness" or "conductivity" of the solid, "diffusivity" or "permeability" of the void,
        each the mean over the axes or along one, as in "stiffness:z" (`measure_property`).
    window : int, optional
        Side of the windows in voxels, 12 to half of the shortest side. Default: a third of it.
        Windows of less than two or three pores a side are softer or stiffer than the material.
    count : int
        Windows that are solved, 8 .. 1000, spread evenly over the fractions that there are.
    model : Model, optional
        Of the exemplar, by a method that takes a field of the volume fraction. It makes 5 x 2 x 2
        windows, along z from the least to the largest fraction of the exemplar's, and the law is
        that of their windows: choose it where the field is for this model.
    seed : int
        Of what the model makes.

    Returns
    -------
    law : PropertyLaw
        Exponent and coefficient are the most likely ones where a window's property scatters about
        its mean in proportion to it (gamma quasi-likelihood, McCullagh, Nelder 1989, chapter 8), so
        that windows without any count as well.

    Raises
    ------
    InputError
        Windows that do not fit, are all of one fraction, or are spanned by nothing.
    UnknownNameError
        No such property or axis.

    Examples
    --------
    >>> plates = np.zeros((64, 40, 40), np.uint8)
    >>> plates[0:64:8] = plates[1:32:8] = plates[2:16:8] = 1
    >>> law = property_law(plates, "conductivity:x", window=16, count=12)
    >>> round(law.coefficient, 2), round(law.exponent, 2)
    (1.0, 1.0)
    """
    image = as_image(exemplar)
    check_labels(image)
    word = str(name).partition(":")[0]
    check_name(word, CARRIES, name="property")
    side = _window(image, window)
    number = int(as_number(count, name="count", low=_FEWEST, high=1000, whole=True))
    if model is not None:
        image = _make_ramp(image, side, model, seed)
    corners, fractions = _choose_windows(image, side, number, void=CARRIES[word] == "void")
    values = np.array(
        [
            measure_property(_cut(image, corner, side), name)
            for corner in track(corners, f"{word} of windows")
        ]
    )
    return fit_law(str(name), fractions, values)


def fraction_for(
    field: Image, *, name: str, coefficient: float, exponent: float, low: float, high: float
) -> Image:
    """Return the solid's volume fraction that has a field of a property, by the power law.

    Parameters
    ----------
    field : Image
        Grey: the property at every voxel.
    name, coefficient, exponent, low, high
        As of `PropertyLaw`.

    Raises
    ------
    InputError
        The field goes beyond the law's range.
    """
    check_grey(field)
    least, most = (coefficient * end**exponent for end in (low, high))
    have = float(field.values.min()), float(field.values.max())
    if have[0] < least * (1 - 1e-6) or have[1] > most * (1 + 1e-6):
        raise InputError(
            f"the field of {name} goes from {have[0]:.4g} to {have[1]:.4g}, the exemplar's windows "
            f"from {least:.4g} to {most:.4g}: rescale it (tb.fields.rescale) or give an exemplar "
            "that is denser or sparser"
        )
    carrying = (np.asarray(field.values, np.float64) / coefficient) ** (1 / exponent)
    solid = CARRIES[name.partition(":")[0]] == "solid"
    settings = {
        "name": name,
        "coefficient": coefficient,
        "exponent": exponent,
        "low": low,
        "high": high,
    }
    return of_image(carrying if solid else 1 - carrying, "fraction_for", settings, field)


def _window(image: Image, window: int | None) -> int:
    """Return the side of the windows, checked."""
    shortest = min(image.shape)
    if image.ndim != 3 or shortest < 2 * _LEAST:
        raise InputError(
            f"the exemplar is {image.shape}: a law needs a volume of {2 * _LEAST} voxels a side"
        )
    if window is None:
        return max(_LEAST, shortest // 3)
    return int(as_number(window, name="window", low=_LEAST, high=shortest // 2, whole=True))


def _make_ramp(exemplar: Image, side: int, model: Maker, seed: int) -> Image:
    """Make windows of every fraction that an exemplar's windows have, along z."""
    found = windowed(exemplar, size=side)["volume_fraction"]
    shape = tuple(count * side for count in _PROBE)
    middles = np.array([side / 2, shape[0] - side / 2])  # of the first and the last window
    along = np.interp(np.arange(shape[0]), middles, [float(found.min()), float(found.max())])
    ramp = np.ascontiguousarray(np.broadcast_to(along[:, None, None], shape), np.float32)
    return model.generate(shape, seed=seed, target={"volume_fraction": ramp})


def _cut(image: Image, corner: Sequence[int], side: int) -> Image:
    """Return a window of an image."""
    box = tuple(slice(first, first + side) for first in corner)
    return with_values(image, np.ascontiguousarray(image.values[box]))


def _choose_windows(
    image: Image, side: int, count: int, *, void: bool
) -> tuple[list[tuple[int, ...]], np.ndarray]:
    """Return the corners of windows spread evenly over the fractions of the phase that carries, and
    those fractions, rising.
    """
    found = windowed(image, size=side)["volume_fraction"].astype(np.float64)
    step = max(1, side // 4)
    grid = np.stack(
        np.meshgrid(*(np.arange(0, n, step) for n in found.shape), indexing="ij"), axis=-1
    ).reshape(-1, 3)
    fractions = found[tuple(grid.T)]
    fractions = 1 - fractions if void else fractions
    order = np.argsort(fractions, kind="stable")
    chosen = order[np.unique(np.linspace(0, len(order) - 1, count).round().astype(int))]
    held = fractions[chosen]
    if len(held) < _FEWEST or not held[-1] > _SPAN * max(held[0], 1e-9):
        raise InputError(
            f"{len(held)} windows of {side} voxels have fractions of {held[0]:.3g} to "
            f"{held[-1]:.3g}: a law needs {_FEWEST} of different ones; choose a smaller window or "
            "a larger exemplar"
        )
    return [tuple(map(int, corner)) for corner in grid[chosen]], held


def fit_law(name: str, fractions: np.ndarray, values: np.ndarray) -> PropertyLaw:
    """Fit the law to windows.

    For an exponent n the likeliest coefficient is the mean of P / x^n, and what is left to minimise
    is log c + n mean(log x), which is convex in n: its slope is bisected.
    """
    held = fractions > 0
    x, p = fractions[held], values[held]
    if np.count_nonzero(p) < _FEWEST:
        raise InputError(
            f"{np.count_nonzero(p)} of {len(values)} windows have {name} above 0, a law needs "
            f"{_FEWEST}: choose a larger window, or one along another axis"
        )
    log_x = np.log(x)
    low, high = _EXPONENTS

    def slope(exponent: float) -> float:
        weights = p * np.exp(-exponent * log_x)
        return float(log_x.mean() - (weights * log_x).sum() / weights.sum())

    if slope(low) > 0:
        raise InputError(
            f"{name} does not rise with the fraction in windows of this exemplar: another "
            "descriptor decides it; choose another property or a larger window"
        )
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if slope(middle) > 0 else (middle, high)
    exponent = (low + high) / 2
    coefficient = float((p * x**-exponent).mean())
    ratios = p / (coefficient * x**exponent)
    return PropertyLaw(
        name=name,
        coefficient=coefficient,
        exponent=exponent,
        low=float(x[0]),
        high=float(x[-1]),
        scatter=math.sqrt(float(((ratios - 1) ** 2).mean())),
        blocked=int(np.count_nonzero(values == 0)),
        fractions=fractions,
        values=values,
    )

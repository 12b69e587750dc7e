"""Relative permeability: the flow of each of two fluids through what it fills.

Drainage or imbibition by morphology says where each fluid is at a radius (`measure.displacement`),
a direct solve how well that conducts. Cortis and Silin 2013 (arXiv:1311.3988) do the
same: capillary equilibrium, each fluid at rest for the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core import progress
from trabecula.core.brief import brief
from trabecula.core.checks import as_number, check_name, quote
from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.measure.displacement import Displacement
from trabecula.measure.drainage import drainage
from trabecula.measure.imbibition import imbibition
from trabecula.measure.phases import as_axis, indicator
from trabecula.measure.transport import Effective, permeability

SATURATIONS = (0.2, 0.4, 0.6, 0.8)
NO_WAY = "does not percolate"


@dataclass(frozen=True)
class RelativePermeability:
    """Relative permeabilities of two fluids in a phase; n saturations."""

    radii: np.ndarray
    """(n,) at which the fluids are as they were solved, in the image's unit and in the order of the
    process."""
    saturation: np.ndarray
    """(n,) of the non-wetting fluid, 0..1: the nearest to what was requested that occurs."""
    nonwetting: tuple[float | None, ...]
    """Permeability to the non-wetting fluid over that of the phase; None where no path of it leads
    from end to end."""
    wetting: tuple[float | None, ...]
    """The same of the wetting fluid."""
    converged: tuple[bool, ...]
    """Whether the solves of both fluids converged: a figure that did not is not to be used."""
    absolute: Effective
    """Permeability of the whole phase."""

    __repr__ = brief

    def to_json(self) -> dict[str, Any]:
        """Return the curves as plain values; "does not percolate" in place of a number."""

        def words(values: tuple[float | None, ...]) -> list[float | str]:
            return [NO_WAY if value is None else value for value in values]

        return {
            "radii": self.radii.tolist(),
            "saturation": self.saturation.tolist(),
            "nonwetting": words(self.nonwetting),
            "wetting": words(self.wetting),
            "converged": list(self.converged),
            "permeability": self.absolute.value,
        }


def relative_permeability(
    image: Image | ArrayLike,
    *,
    axis: int,
    phase: str | int | None = None,
    saturations: Sequence[float] = SATURATIONS,
    process: str = "drainage",
    trapping: bool = False,
    connectivity: int | None = None,
    tolerance: float = 1e-3,
) -> RelativePermeability:
    """Return the relative permeability of two fluids in a phase at some saturations.

    The non-wetting fluid enters at the first layer along the axis and breaks through at the last
    (`drainage`), or goes back (`imbibition`); of every saturation the fluid's own voxels are solved
    (`permeability`), the other fluid is a wall.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    axis : int
        Of the displacement and of the flow. 0 is z (y in 2-D); negative counts from the back.
    phase : str or int, optional
        What holds the fluids. Default: "void".
    saturations : sequence of float, 0..1
        Of the non-wetting fluid. A fluid moves in steps: the nearest state that occurs is taken,
        and each state once. Default: .2, .4, .6, .8.
    process : {"drainage", "imbibition"}
    trapping : bool
        As for `drainage` and `imbibition`: fluid that is cut off stays.
    connectivity : optional
        As for `drainage`.
    tolerance : float, 1e-10 .. 0.1
        Of the solves, as for `permeability`.

    Returns
    -------
    found : RelativePermeability

    Raises
    ------
    InputError
        As `drainage` and `permeability`; no saturation, or one out of range; a phase that does not
        percolate along the axis, so that there is nothing to compare with.
    MemoryBudgetError
        As `permeability`.

    Notes
    -----
    Films thinner than a voxel are not there: a wetting fluid that flows in corners alone does not
    percolate here. Walls that move with the fluid beyond them would raise both figures.

    Examples
    --------
    Two slits, 5 and 9 voxels wide; the oil fills the wider one.

    >>> slits = np.ones((6, 18), np.uint8)
    >>> slits[:, 1:6] = slits[:, 8:17] = 0
    >>> found = relative_permeability(slits, axis=0, saturations=[0.6])
    >>> round(found.nonwetting[0] + found.wetting[0], 6), round(found.nonwetting[0], 2)
    (1.0, 0.85)
    """
    check_name(process, ("drainage", "imbibition"), name="process")
    image, inside = indicator(image, phase, default="void")
    along = as_axis(axis, image.ndim)
    wanted = [as_number(one, name="saturations", low=0, high=1) for one in saturations]
    if not wanted:
        raise InputError("saturations is empty: give some from 0 to 1")
    given: dict[str, Any] = {"inlet": (along, 0), "phase": phase, "trapping": trapping}
    displace = drainage if process == "drainage" else imbibition
    moved = displace(image, connectivity=connectivity, **given)
    absolute = _permeability(image, inside, along, tolerance)
    if absolute.value == 0.0:
        what = "void" if phase is None else f"phase {quote(phase)}"
        raise InputError(
            f"the {what} does not percolate along axis {axis}: nothing flows, whatever the fluid"
        )
    radii, saturation = _states(moved, wanted)
    found: list[tuple[Effective, Effective]] = []
    for radius in progress.track(radii, "relative permeability"):
        oil = moved.radius_map >= np.float32(radius)
        found.append(
            (
                _permeability(image, oil, along, tolerance),
                _permeability(image, inside & ~oil, along, tolerance),
            )
        )

    def share(one: Effective) -> float | None:
        return one.value / absolute.value if one.value else None

    return RelativePermeability(
        radii=radii,
        saturation=saturation,
        nonwetting=tuple(share(oil) for oil, _ in found),
        wetting=tuple(share(water) for _, water in found),
        converged=tuple(a.converged and b.converged and absolute.converged for a, b in found),
        absolute=absolute,
    )


def _states(moved: Displacement, wanted: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the radii whose saturations are nearest to those wanted, in the order of the process,
    and these saturations; infinite radii are no state that flows.
    """
    finite = np.flatnonzero(np.isfinite(moved.radii))
    if len(finite) == 0:
        raise InputError("no fluid moves: the displacement has no state to solve")
    near = np.abs(moved.saturation[finite][None] - np.array(wanted)[:, None]).argmin(axis=1)
    chosen = finite[np.unique(near)]
    return moved.radii[chosen], moved.saturation[chosen]


def _permeability(image: Image, fluid: np.ndarray, axis: int, tolerance: float) -> Effective:
    part = Image(
        (~fluid).astype(np.uint8), "labels", image.spacing, image.unit, phases=("void", "solid")
    )
    return permeability(part, axis=axis, tolerance=tolerance)

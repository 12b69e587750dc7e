"""Transport, stiffness and the pore network at once, with notes on how far the figures can be
trusted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core import progress
from trabecula.core.checks import check_type
from trabecula.core.image import Image, as_image, check_labels
from trabecula.engine.memory import available_memory
from trabecula.engine.parallel import for_slabs, thread_count, threads
from trabecula.measure.centre_crop import box_sides, centre, check_memory
from trabecula.measure.drainage import entry_radius
from trabecula.measure.mechanics import Stiffness, homogenise, stiffness
from trabecula.measure.network import network
from trabecula.measure.percolation import AXES
from trabecula.measure.phases import indicator
from trabecula.measure.transport import Effective, conductivity, diffusivity, permeability, section
from trabecula.measure.transport.conduction import CONDUCTION_BYTES
from trabecula.measure.transport.permeability import FLOW_BYTES

NETWORK = ("entry_radius", "coordination", "throat_radius")
"""What `describe_network` finds, by name."""
PHYSICS = (
    "diffusivity",
    "tortuosity",
    "conductivity",
    "permeability",
    "stiffness",
    *NETWORK,
    "physics",
)
"""What `describe_physics` finds, by name."""


def describe_physics(
    image: Image | ArrayLike,
    *,
    box: int | None = None,
    halving: bool = False,
    tolerance: float | None = None,
) -> dict[str, Any]:
    """Transport through the void and the solid along every axis, the solid's stiffness, and the
    network of pores.

    `diffusivity` is relative to the free one, `conductivity` to the solid's own, Young's moduli in
    `stiffness` to the solid's own; `permeability` is in the square of the image's unit. 0 along an
    axis where nothing spans the image: the tortuosity is infinite there, which is `None` here. 3-D
    images only; `None` for others.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X) or (Y, X)
    box : int, optional
        Edge of the centre box, voxels, that is solved. Default: the whole image.
    halving : bool
        Also solve a small box at half the voxel edge, and report what changes.
    tolerance : float, 1e-10 .. 0.1, optional
        Of all solvers. Default: each one's own.

    Returns
    -------
    found : dict
        `diffusivity`, `tortuosity`, `conductivity` and `permeability` by axis; `stiffness` with its
        `matrix` (6, 6) and `moduli`; `entry_radius` by axis, `coordination` and `throat_radius`
        (`describe_network`); and `physics`, which gives of each `converged`, `imbalance`,
        `iterations` and `halving`. Definitions and sources are those of the functions of these
        names.

    Raises
    ------
    InputError
        Not labels, no phase named "void", or a box that is none.
    MemoryBudgetError
        The solvers would take more memory than there is: give a smaller `box`.
    """
    image = as_image(image)
    check_labels(image)
    check_type(halving, bool, name="halving", advice="give True or False")
    if image.ndim != 3:
        return dict.fromkeys(PHYSICS)
    count = min(thread_count(), _count_solves(image, box, halving))
    carrying = {phase: float(phase != "void") for phase in image.phases}
    settings: dict[str, Any] = {"box": box, "halving": halving}
    settings |= {} if tolerance is None else {"tolerance": tolerance}
    # The longest first, so that threads end together.
    solvers: dict[str, Callable[[int], Effective]] = {
        "permeability": lambda axis: permeability(image, axis=axis, **settings),
        "diffusivity": lambda axis: diffusivity(image, axis=axis, **settings),
        "conductivity": lambda axis: conductivity(
            image, conductivities=carrying, axis=axis, **settings
        ),
    }
    results: dict[str, dict[str, Any]] = {name: {} for name in solvers}
    jobs = [(name, axis) for name in solvers for axis in range(3)]

    def solve(first: int, start: int, stop: int) -> None:
        for name, axis in jobs[first + start : first + stop]:
            results[name][AXES[axis]] = solvers[name](axis)

    with threads(count):
        for first in progress.track(
            range(0, len(jobs), count), "transport", total=-(-len(jobs) // count)
        ):
            for_slabs(partial(solve, first), min(count, len(jobs) - first), least=1)
    for _ in progress.track([None], "stiffness"):
        solid = stiffness(image, **settings)
    for _ in progress.track([None], "pore network"):
        pores = describe_network(image, box=box)
    return _plain(results, solid) | pores


def describe_network(image: Image | ArrayLike, *, box: int | None = None) -> dict[str, Any]:
    """Return figures of the network of pores: `entry_radius` by axis (the largest ball that passes
    through the void), `coordination` (mean number of throats of a pore that no face cuts) and
    `throat_radius` (mean over throats).

    None where there are none: the void is empty or fills the image, no pore is whole, or nothing is
    a throat.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
    box : int, optional
        Edge of the centre box, voxels. Default: the whole image.

    Raises
    ------
    InputError
        Not labels, no phase named "void", a 2-D image, or a box that is none.
    """
    image, void = indicator(image, None, default="void")
    values = centre(void, box_sides(box, image.shape))
    if not values.any() or values.all() or min(values.shape) < 2:
        return dict.fromkeys(NETWORK)
    part = Image(
        (~values).astype(np.uint8), "labels", image.spacing, image.unit, phases=("void", "solid")
    )
    net = network(part)
    whole = net.coordination[net.inside]
    return {
        "entry_radius": entry_radius(part),
        "coordination": float(whole.mean()) if len(whole) else None,
        "throat_radius": float(net.throats.radius.mean()) if len(net.throats) else None,
    }


def physics_notes(found: Mapping[str, Any]) -> list[str]:
    """List the notes on transport and stiffness: what is infinite, and what has not converged."""
    notes = [
        f"The void does not span the image along {axis}: nothing flows, its tortuosity is infinite."
        for axis, value in (found.get("tortuosity") or {}).items()
        if value is None
    ]
    for name, axes in (found.get("physics") or {}).items():
        notes += [
            f"The {name} ({axis}) has not converged: "
            f"{_describe_imbalance(name, result['imbalance'])}."
            for axis, result in axes.items()
            if not result["converged"]
        ]
    return notes


def _describe_imbalance(name: str, imbalance: float | None) -> str:
    if imbalance is None:
        return "no steady flux was found"
    quantity = "stress" if name == "stiffness" else "flux"
    return f"its {quantity} differs by {imbalance:.1%} between sections"


def _plain(results: Mapping[str, Mapping[str, Effective]], solid: Stiffness) -> dict[str, Any]:
    found: dict[str, Any] = {
        name: {axis: finite(results[name][axis].value) for axis in AXES}
        for name in ("diffusivity", "conductivity", "permeability")
    }
    found["tortuosity"] = {
        axis: result.fraction / result.value if result.value else None
        for axis, result in ((axis, results["diffusivity"][axis]) for axis in AXES)
    }
    found["stiffness"] = {"matrix": solid.matrix.tolist(), "moduli": dict(solid.moduli)}
    found["physics"] = {
        name: {axis: _trust(results[name][axis]) for axis in AXES} for name in results
    }
    found["physics"]["stiffness"] = {"all": _trust(solid)}
    return found


def _trust(result: Effective | Stiffness) -> dict[str, Any]:
    return {
        "converged": result.converged,
        "imbalance": finite(result.imbalance),
        "iterations": result.iterations,
        "halving": result.halving,
    }


def _count_solves(image: Image, box: int | None, halving: bool) -> int:
    """Count the solves of transport that fit into memory at once, one at least; forecast all before
    the first begins.
    """
    void = indicator(image, None, default="void")[1]
    void = centre(void, box_sides(box, image.shape))
    split = 3 if halving else 0
    flow = max(
        section.forecast_bytes(void, FLOW_BYTES, split=split),
        section.forecast_bytes(~void, CONDUCTION_BYTES, split=split),
    )
    check_memory(max(flow, homogenise.forecast_bytes(~void, halving=halving)))
    return max(1, available_memory() // flow)


def finite(value: float) -> float | None:
    """Return a number as JSON knows it: `None` where it is infinite."""
    return float(value) if math.isfinite(value) else None

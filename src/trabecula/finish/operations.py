"""The table of operations. The command line, recipes and the run slab by slab read it.

An operation is declared once, here: its function, the options of `trabecula finish`, its memory,
and the function that works in place where it has one.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from trabecula.core.checks import check_name
from trabecula.core.image import Image
from trabecula.finish.closed_pores import fill_trapped, fill_trapped_in_place
from trabecula.finish.connect import connect, connect_in_place
from trabecula.finish.contacts import mend_contacts
from trabecula.finish.crust import add_crust
from trabecula.finish.drain import drain
from trabecula.finish.floaters import remove_floaters, remove_floaters_in_place
from trabecula.finish.offset import offset
from trabecula.finish.prune import prune
from trabecula.finish.smooth import smooth
from trabecula.finish.thicken import thicken


@dataclass(frozen=True)
class Option:
    """An option of `trabecula finish`.

    Parameters
    ----------
    flag : str
        Such as "--smooth".
    help : str
    setting : str, optional
        Keyword of the function that takes the value. Default: a switch without a value.
    metavar : str, optional
    whole : bool
        The value is a whole number.
    """

    flag: str
    help: str
    setting: str | None = None
    metavar: str | None = None
    whole: bool = False

    @property
    def name(self) -> str:
        """Return the attribute of the parsed arguments: "min_size" of "--min-size"."""
        return self.flag.removeprefix("--").replace("-", "_")


@dataclass(frozen=True)
class Operation:
    """An operation on an image of labels. Calling it calls `function`.

    Parameters
    ----------
    name : str
        As a recipe's step names it.
    function : callable
        (image, **settings) -> Image.
    option : Option
        The option that chooses it.
    bytes_per_voxel : int
        Memory of `function`, with the image read and the image written.
    in_place : callable, optional
        (values, image, **settings) -> report, writing into labels (Z, Y, X), which may be a
        memory-mapped array. Default: none, and the whole volume has to be in memory.
    more : tuple of Option
        Options of its further settings.
    inputs : tuple of str
        Keywords of `function` that take another image: "exemplar", "mask".
    """

    name: str
    function: Callable[..., Image]
    option: Option
    bytes_per_voxel: int
    in_place: Callable[..., dict[str, int]] | None = None
    more: tuple[Option, ...] = ()
    inputs: tuple[str, ...] = ()

    def __call__(self, image: Image, **settings: Any) -> Image:
        """Return the image after the operation."""
        return self.function(image, **settings)

    def complete(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Return the settings with the defaults of those that are missing, other images left out.

        Raises
        ------
        UnknownNameError
            No such setting.
        """
        defaults = {
            parameter.name: parameter.default
            for parameter in inspect.signature(self.function).parameters.values()
            if parameter.kind is inspect.Parameter.KEYWORD_ONLY
            and parameter.name not in self.inputs
        }
        for name in settings:
            check_name(name, defaults, name=f"setting of {self.name}")
        return {**defaults, **settings}


_DECLARED = (
    Operation(
        "prune",
        prune,
        Option("--prune", "remove short struts with a free end, extend long ones"),
        bytes_per_voxel=50,
        inputs=("exemplar", "mask"),
    ),
    Operation(
        "add_crust",
        add_crust,
        Option(
            "--crust",
            "closed wall below the surface of the form: thickness, in the image's unit",
            setting="thickness",
            metavar="T",
        ),
        bytes_per_voxel=22,
        inputs=("mask",),
    ),
    Operation(
        "connect",
        connect,
        Option(
            "--connect",
            "join all components but specks, which are removed: one component is left",
        ),
        bytes_per_voxel=10,
        in_place=connect_in_place,
        more=(
            Option(
                "--reach",
                "longest join in voxels; what is farther is removed (default: no limit)",
                setting="reach",
                metavar="N",
                whole=True,
            ),
            Option(
                "--min-size",
                "voxels of the smallest component that is joined (default: more than a speck)",
                setting="min_size",
                metavar="N",
                whole=True,
            ),
        ),
        inputs=("mask",),
    ),
    Operation(
        "smooth",
        smooth,
        Option(
            "--smooth",
            "smooth the surface at the same volume: sigma, in the image's unit",
            setting="sigma",
            metavar="S",
        ),
        bytes_per_voxel=22,
        inputs=("mask",),
    ),
    Operation(
        "thicken",
        thicken,
        Option(
            "--thicken",
            "least thickness of a strut, in the image's unit",
            setting="thickness",
            metavar="T",
        ),
        bytes_per_voxel=22,
        inputs=("mask",),
    ),
    Operation(
        "offset",
        offset,
        Option(
            "--offset",
            "move the surface until the phase has this volume fraction, 0 .. 1: nothing joins or "
            "breaks",
            setting="fraction",
            metavar="F",
        ),
        bytes_per_voxel=37,
        inputs=("mask",),
    ),
    Operation(
        "remove_floaters",
        remove_floaters,
        Option("--floaters", "remove every component but the largest"),
        bytes_per_voxel=5,
        in_place=remove_floaters_in_place,
    ),
    Operation(
        "drain",
        drain,
        Option(
            "--drain",
            "open closed pores by straight holes: their diameter, in the image's unit",
            setting="width",
            metavar="D",
        ),
        bytes_per_voxel=24,
    ),
    Operation(
        "mend_contacts",
        mend_contacts,
        Option(
            "--manifold", "fill voxels where the phase touches itself by an edge or corner alone"
        ),
        bytes_per_voxel=22,
        inputs=("mask",),
    ),
    Operation(
        "fill_trapped",
        fill_trapped,
        Option("--fill", "fill closed pores"),
        bytes_per_voxel=5,
        in_place=fill_trapped_in_place,
        inputs=("mask",),
    ),
)

OPERATIONS: dict[str, Operation] = {operation.name: operation for operation in _DECLARED}
"""By name, in the order in which `trabecula finish` runs them: whole struts first, then the
wall that they end on, one component, its surface, its strength, its volume, and last what these
left loose or closed.
"""

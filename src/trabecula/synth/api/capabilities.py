"""The description of a method that is known without importing it: `Capabilities`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from trabecula.core.checks import check_name

SOURCES = ("volume", "volumes", "picture", "pictures", "settings")
"""Sources that a method can learn from; a plural is several exemplars of one material at once."""

PARTS = ("periodic", "mask", "target", "fixed", "coarse", "like")
"""Parts of a `Request` beyond shape and seed."""

SCALING = {"box": "window", "memmap": "sweep", "memory": "whole"}
"""Ways to make large volumes, with the words of `trabecula methods --json` for them."""


@dataclass(frozen=True)
class Capabilities:
    """Everything that the registry, the contract, the command line and the docs know of a method
    without importing it.

    Parameters
    ----------
    name, summary, paper : str
    method : str
        "module:Class" of the `Method`.
    learns_from : tuple of {"volume", "volumes", "picture", "pictures", "settings"}
        Exemplars that `learn` takes: a 3-D image or several, a 2-D image or several, or none
        ("settings": the settings alone are enough).
    makes : tuple of {"volume", "picture"}
        Results. A method that makes both gives a picture for an exemplar that is a picture.
    kinds : tuple of {"labels", "grey", "colour"}
        Kinds of exemplar.
    honours : frozenset of {"periodic", "mask", "target", "fixed", "coarse", "like"}
        Parts of a `Request` beyond shape and seed; the others are refused by name.
    targets : tuple of str
        Descriptors of a request's target, of a method that honours "target"; "volume_fraction:"
        stands for the fraction of any phase.
    large : {"memory", "memmap", "box"}
        Volumes larger than memory. "box": any box is made alone (`WindowModel`). "memmap": large
        arrays come from `engine.memmap` and can be memory-mapped. "memory": the volume has to fit
        into memory; it is written to a store block by block.
    deterministic : bool
        The seed changes nothing.
    stores_exemplar : bool
        A model's file holds the exemplars. False for a method that trains: its model's file holds
        the state alone, and is needed to make a result again.
    presets : tuple of str
        Names of ready settings.
    extras : tuple of str
        Extras of the package that it needs.
    trial : mapping
        Settings with which tests take seconds where the defaults take minutes.
    sample : str
        Sample of the package whose parts it learns from in tests.

    Raises
    ------
    UnknownNameError
        A word that is none of those above.
    """

    name: str
    summary: str
    paper: str
    method: str
    learns_from: tuple[str, ...]
    makes: tuple[str, ...] = ("volume",)
    kinds: tuple[str, ...] = ("labels",)
    honours: frozenset[str] = frozenset()
    targets: tuple[str, ...] = ("porosity", "volume_fraction")
    large: str = "memory"
    deterministic: bool = False
    stores_exemplar: bool = True
    presets: tuple[str, ...] = ()
    extras: tuple[str, ...] = ()
    trial: Mapping[str, Any] = field(default_factory=dict)
    sample: str = "bone"

    def __post_init__(self) -> None:
        words = {
            "learns_from": (self.learns_from, SOURCES),
            "makes": (self.makes, ("volume", "picture")),
            "honours": (self.honours, PARTS),
            "large": ((self.large,), tuple(SCALING)),
        }
        for name, (given, known) in words.items():
            for word in given:
                check_name(word, known, name=f"word in {name} of method {self.name}")

    @property
    def exemplar(self) -> str | None:
        """Return the usual dimensions of an exemplar, "3d" or "2d"; None where it needs none."""
        if self.accepts(3):
            return "3d"
        return "2d" if self.accepts(2) else None

    @property
    def several(self) -> bool:
        """Tell whether it learns from more than one exemplar at once."""
        return bool({"volumes", "pictures"} & set(self.learns_from))

    @property
    def alone(self) -> bool:
        """Tell whether it makes material from its settings alone, without an exemplar."""
        return "settings" in self.learns_from

    @property
    def scaling(self) -> str:
        """Return "window", "sweep" or "whole", the word of the command line for `large`."""
        return SCALING[self.large]

    def accepts(self, ndim: int) -> bool:
        """Tell whether it learns from exemplars of `ndim` axes."""
        one = {3: "volume", 2: "picture"}.get(ndim, "")
        return bool({one, f"{one}s"} & set(self.learns_from))

    def output_axes(self, exemplar_ndim: int | None) -> tuple[int, ...]:
        """Return the numbers of axes of its results, 3 or 2, the usual one first.

        Parameters
        ----------
        exemplar_ndim : int or None
            Axes of the exemplar; None without one.
        """
        axes = tuple({"volume": 3, "picture": 2}[one] for one in self.makes)
        return (exemplar_ndim,) if exemplar_ndim in axes and len(axes) > 1 else axes

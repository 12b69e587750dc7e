"""What is known of a method without importing it: `Capabilities`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Capabilities:
    """What the registry, the contract tests, the command line and the docs know of a method without
    importing it.

    Parameters
    ----------
    name, summary, paper : str
    exemplar : {"2d", "3d", None}
        What it learns from; None where it needs no exemplar.
    kinds : tuple of str
        Kinds of exemplar that it accepts.
    honours : frozenset of str
        Parts of a `Request` beyond shape and seed: "periodic", "mask", "target", "fixed".
    scaling : {"window", "sweep", "whole"}
        How it runs on volumes larger than memory (DESIGN: big and repeatable).
    target : str
        "module:Class" of the method.
    extras : tuple of str
        Extras of the package that it needs.
    presets : tuple of str
        Names of ready settings.
    several : bool
        Whether it learns from more than one exemplar at once.
    targets : tuple of str
        Descriptors of a request's target that a method that honours "target" knows;
        "volume_fraction:" stands for the share of any phase.
    learns : bool
        Whether a model holds what it learned instead of its exemplars, so that its file is needed
        to make a result again.
    flat : bool
        Whether it also makes pictures: 2-D of 2-D, beside 3-D of 3-D; without an exemplar,
        whichever is asked for.
    alone : bool
        Whether it also makes material from its settings alone, without an exemplar.
    trial : mapping
        Settings with which learning takes seconds where the defaults take minutes, for tests; what
        comes out is of no use.
    """

    name: str
    summary: str
    paper: str
    exemplar: str | None
    kinds: tuple[str, ...]
    scaling: str
    target: str
    honours: frozenset[str] = frozenset()
    extras: tuple[str, ...] = ()
    presets: tuple[str, ...] = ()
    several: bool = False
    targets: tuple[str, ...] = ("porosity", "volume_fraction")
    learns: bool = False
    flat: bool = False
    alone: bool = False
    trial: Mapping[str, Any] = field(default_factory=dict)

"""What the settings and an exemplar, if there is one, come to: which phases, how much of each, and
which field.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.blocks import Box
from trabecula.engine.memory import Stage
from trabecula.synth.api.exemplar_info import ExemplarInfo
from trabecula.synth.noise.config import NoiseConfig
from trabecula.synth.noise.convolve import Use
from trabecula.synth.noise.covariance import Filter
from trabecula.synth.noise.covariance_fit import MOST_REACH, named_filter, named_reach
from trabecula.synth.noise.gaussian import GaussianField
from trabecula.synth.noise.pattern import Lattice
from trabecula.synth.noise.periodic_domain import Domain

_CELL = 10
"""Voxels of a length that is not given."""


class Field(Protocol):
    """What is cut: one field a phase but the last, numbers by voxel."""

    def each(self, number: int, domain: Domain, box: Box, use: Use, *, most: float = ...) -> None:
        """A field in a box: `use(piece, z, plane)` gets it plane by plane; above `most` any number
        above it will do.
        """

    def level(self, number: int, share: float) -> float:
        """Above which the endless field has the share."""

    def stages(self, shape: Sequence[int]) -> tuple[Stage, ...]:
        """Return the stages of making a box (Z, Y, X), with the arrays beside its result."""


@dataclass(frozen=True)
class Phases:
    """Labels in the order in which they are cut out, each where its field is high; the last is what
    remains.

    Attributes
    ----------
    labels : tuple of int
    fractions : tuple of float
    """

    labels: tuple[int, ...]
    fractions: tuple[float, ...]

    def share(self, i: int) -> float:
        """Of a phase, of what the phases before it leave."""
        return self.fractions[i] / sum(self.fractions[i:])


def phases_of(config: NoiseConfig, facts: ExemplarInfo, exemplars: Sequence[Image]) -> Phases:
    """The phases of a model and their shares.

    Raises
    ------
    InputError
        More than two phases where the settings speak of void and solid.
    """
    labels, shares = _present(config, facts, exemplars)
    if len(labels) > 2 and (config.kind != "gaussian" or config.porosity is not None):
        said = f"kind={config.kind!r}" if config.kind != "gaussian" else "porosity"
        raise InputError(
            f"{said} is of void and solid, the exemplar has {len(labels)} phases: merge phases first, or leave it to the "
            "Gaussian field of its covariance"
        )
    void = facts.phases.index("void") if "void" in facts.phases else labels[0]
    if len(labels) == 2 and config.porosity is not None:
        shares = [config.porosity if label == void else 1 - config.porosity for label in labels]
    if config.kind != "gaussian" and (labels[0] != void) != config.invert:
        labels, shares = labels[::-1], shares[::-1]
    return Phases(tuple(labels), tuple(shares))


def _present(
    config: NoiseConfig, facts: ExemplarInfo, exemplars: Sequence[Image]
) -> tuple[list[int], list[float]]:
    if not exemplars:
        porosity = 0.5 if config.porosity is None else config.porosity
        return [0, 1], [porosity, 1 - porosity]
    values = exemplars[0].values
    labels = [int(label) for label in np.unique(values)]
    return labels, [float(share) for share in np.bincount(values.ravel())[labels] / values.size]


def chosen(config: NoiseConfig, facts: ExemplarInfo, filters: list[Filter], *, flat: bool) -> Field:
    """The field that the settings ask for.

    Raises
    ------
    InputError
        Lengths below 2 voxels (white noise: 1), too long for a filter, or not as many as axes; a
        length where that of an exemplar is followed.
    """
    if filters:
        if config.length is not None:
            raise InputError(
                "length has no say where the exemplar's covariance is followed: name a covariance, or leave length out"
            )
        return GaussianField(filters)
    spacing = (facts.spacing[0],) * (3 - facts.ndim) + facts.spacing
    edges = _edges(config, spacing, flat=flat)
    lengths = [edge / voxel for edge, voxel in zip(edges, spacing, strict=True)]
    _check_cells(config, lengths[1:] if flat else lengths, facts.unit)
    if config.kind != "gaussian":
        return Lattice(config, edges, spacing, flat=flat)
    name = "gaussian" if config.covariance == "auto" else config.covariance
    if max(named_reach(name, lengths, flat=flat)) > MOST_REACH:
        raise InputError(
            f"length={config.length} is {max(lengths):.0f} voxels, of which a filter of covariance {name!r} would reach "
            f"{max(named_reach(name, lengths, flat=flat))}, {MOST_REACH} at most: use larger voxels, or a shorter length"
        )
    return GaussianField([named_filter(name, lengths, flat=flat)])


def _edges(config: NoiseConfig, spacing: Sequence[float], *, flat: bool) -> tuple[float, ...]:
    """Lengths along z, y, x; a picture's z stays unused."""
    if config.length is None:
        return ((1 if config.kind == "white" else _CELL) * max(spacing),) * 3
    if not isinstance(config.length, tuple):
        return (config.length,) * 3
    if not flat and len(config.length) == 2:
        raise InputError(
            f"length={config.length} has two numbers, as for a picture: give one, or three (z, y, x)"
        )
    return (config.length[-1],) * (3 - len(config.length)) + config.length


def _check_cells(config: NoiseConfig, lengths: Sequence[float], unit: str) -> None:
    least, finest = (1 if config.kind == "white" else 2), min(lengths)
    if config.kind == "gaussian":
        least = 1
    if config.kind == "perlin":
        finest /= 1 << (config.octaves - 1)
    if finest < least * (1 - 1e-9):
        octave = " in its last octave" if config.kind == "perlin" and config.octaves > 1 else ""
        raise InputError(
            f"length={config.length} {unit} is {finest:.3g} voxels{octave}, {config.kind} noise needs {least} at least: give a "
            "longer length, or smaller voxels (spacing)"
        )

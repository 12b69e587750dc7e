"""Phases, volume fractions and field of a model, and labels by rank for exact fractions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.engine.blocks import Box
from trabecula.engine.memory import Array, Stage, Workspace, within
from trabecula.synth.api.exemplar_info import ExemplarInfo
from trabecula.synth.noise.config import NoiseConfig
from trabecula.synth.noise.covariance import MOST_REACH, covariance_filter, covariance_reach
from trabecula.synth.noise.pattern import LatticePattern
from trabecula.synth.shared.gaussian.domain import Domain, Use, domain_of, lift_box
from trabecula.synth.shared.gaussian.field import GaussianField
from trabecula.synth.shared.gaussian.filters import Filter

_CELL = 10
"""Voxels of a length that is not given."""


class Field(Protocol):
    """Numbers by voxel to be cut at a level: one field a phase but the last."""

    def each(self, number: int, domain: Domain, box: Box, use: Use, *, most: float = ...) -> None:
        """Make a field in a box: `use(piece, z, plane)` gets it plane by plane.

        Above `most` any number above it will do.
        """

    def level(self, number: int, share: float) -> float:
        """Return the level above which the endless field has the share."""

    def stages(self, shape: Sequence[int]) -> tuple[Stage, ...]:
        """Return the stages of making a box (Z, Y, X), with the arrays beside its result."""


@dataclass(frozen=True)
class Phases:
    """Labels and volume fractions in the order of the cuts.

    Each phase is where its field is high within the rest of those before; the last is the
    remainder.

    Attributes
    ----------
    labels : tuple of int
    fractions : tuple of float
    """

    labels: tuple[int, ...]
    fractions: tuple[float, ...]

    def share(self, i: int) -> float:
        """Return the fraction of a phase within the rest of the phases before it."""
        return self.fractions[i] / sum(self.fractions[i:])


def phases_of(config: NoiseConfig, facts: ExemplarInfo, exemplars: Sequence[Image]) -> Phases:
    """Return the phases of a model and their volume fractions.

    Raises
    ------
    InputError
        More than two phases where the settings speak of void and solid.
    """
    labels, shares = _present(config, facts, exemplars)
    if len(labels) > 2 and (config.kind != "gaussian" or config.porosity is not None):
        said = f"kind={config.kind!r}" if config.kind != "gaussian" else "porosity"
        raise InputError(
            f"{said} is of void and solid, the exemplar has {len(labels)} phases: merge phases "
            "first, or leave it to the Gaussian field of its covariance"
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
    """Return the labels and volume fractions of the exemplar, or of the settings."""
    if not exemplars:
        porosity = 0.5 if config.porosity is None else config.porosity
        return [0, 1], [porosity, 1 - porosity]
    values = exemplars[0].values
    labels = [int(label) for label in np.unique(values)]
    return labels, [float(share) for share in np.bincount(values.ravel())[labels] / values.size]


def choose_field(
    config: NoiseConfig, facts: ExemplarInfo, filters: list[Filter], *, flat: bool
) -> Field:
    """Return the field of the settings.

    Raises
    ------
    InputError
        Lengths below 2 voxels (white noise: 1), too long for a filter, or not as many as axes; a
        length where that of an exemplar is followed.
    """
    if filters:
        if config.length is not None:
            raise InputError(
                "length has no say where the exemplar's covariance is followed: name a "
                "covariance, or leave length out"
            )
        return GaussianField(filters)
    spacing = (facts.spacing[0],) * (3 - facts.ndim) + facts.spacing
    edges = _edges(config, spacing, flat=flat)
    lengths = [edge / voxel for edge, voxel in zip(edges, spacing, strict=True)]
    _check_cells(config, lengths[1:] if flat else lengths, facts.unit)
    if config.kind != "gaussian":
        return LatticePattern(config, edges, spacing, flat=flat)
    name = "gaussian" if config.covariance == "auto" else config.covariance
    if max(covariance_reach(name, lengths, flat=flat)) > MOST_REACH:
        raise InputError(
            f"length={config.length} is {max(lengths):.0f} voxels, of which a filter of "
            f"covariance {name!r} would reach {max(covariance_reach(name, lengths, flat=flat))}, "
            f"{MOST_REACH} at most: use larger voxels, or a shorter length"
        )
    if flat and config.cones is not None:
        raise InputError("cones are about the axes of a volume: leave them out of a picture")
    return GaussianField([covariance_filter(name, lengths, flat=flat, cones=config.cones)])


def _edges(config: NoiseConfig, spacing: Sequence[float], *, flat: bool) -> tuple[float, ...]:
    """Return the lengths along z, y, x; a picture's z stays unused."""
    if config.length is None:
        return ((1 if config.kind == "white" else _CELL) * max(spacing),) * 3
    if not isinstance(config.length, tuple):
        return (config.length,) * 3
    if not flat and len(config.length) == 2:
        raise InputError(
            f"length={config.length} has two numbers, as for a picture: give one, or three (z, y, "
            "x)"
        )
    return (config.length[-1],) * (3 - len(config.length)) + config.length


def _check_cells(config: NoiseConfig, lengths: Sequence[float], unit: str) -> None:
    """Raise where a length is too short in voxels."""
    least, finest = (1 if config.kind == "white" else 2), min(lengths)
    if config.kind == "gaussian":
        least = 1
    if config.kind == "perlin":
        finest /= 1 << (config.octaves - 1)
    if finest < least * (1 - 1e-9):
        octave = " in its last octave" if config.kind == "perlin" and config.octaves > 1 else ""
        raise InputError(
            f"length={config.length} {unit} is {finest:.3g} voxels{octave}, {config.kind} noise "
            f"needs {least} at least: give a longer length, or smaller voxels (spacing)"
        )


def label_by_rank(request: Request, field: Field, phases: Phases, *, outside: int) -> np.ndarray:
    """Return the labels of a request, with exact volume fractions in its mask.

    Voxels out of the mask are `outside`.
    """
    domain = domain_of(request)
    work = Workspace(stages_of_ranking(field, domain.shape))
    work.enter("make")
    result = work.full("labels", phases.labels[-1])
    numbers = work.empty("numbers")
    asked = np.ones(1, bool) if request.mask is None else request.mask.reshape(domain.shape)
    count = result.size if request.mask is None else int(np.count_nonzero(request.mask))
    ends = np.rint(np.cumsum(phases.fractions) * count).astype(np.int64)

    def keep(piece: tuple[slice, ...], z: int, plane: np.ndarray) -> None:
        numbers[piece][z] = np.rint(plane)

    for i, label in enumerate(phases.labels[:-1]):
        work.enter("make")
        field.each(i, domain, lift_box(tuple((0, side) for side in request.shape)), keep)
        work.enter("rank")
        work.adopt("left", (result == phases.labels[-1]) & asked)
        _label_highest(work, int(ends[i] - (ends[i - 1] if i else 0)), label)
    if request.mask is not None:
        result[~asked] = outside
    return result[0] if domain.flat else result


def stages_of_ranking(field: Field, shape: tuple[int, ...]) -> tuple[Stage, ...]:
    """Return the stages of `label_by_rank` for a domain (Z, Y, X)."""
    voxels = math.prod(shape)
    held = {"labels": Array(shape, np.uint8), "numbers": Array(shape, np.int32)}
    chosen = {
        "left": Array(shape, bool),
        "found": Array(voxels, np.uint8, at_most=True),
        "values": Array(voxels, np.int32, at_most=True),
        "sorted": Array(voxels, np.int32, at_most=True),
        "chosen": Array(voxels, bool, at_most=True),
    }
    return (
        Stage("make", held),
        *within(held, field.stages(shape)),
        # voxels of one value, as a mask and as indices: white noise has many
        Stage("rank", {**held, **chosen}, 5 * voxels),
    )


def _label_highest(work: Workspace, count: int, label: int) -> None:
    """Label the `count` highest "numbers" among the voxels "left", the first of equal ones."""
    if count == 0:
        return
    labels, left = work["labels"], work["left"]
    values = work.adopt("values", work["numbers"][left])
    level = work.adopt("sorted", np.partition(values, len(values) - count))[len(values) - count]
    chosen = work.adopt("chosen", values > level)
    missing = count - int(np.count_nonzero(chosen))
    chosen[np.flatnonzero(values == level)[:missing]] = True
    found = work.adopt("found", labels[left])
    found[chosen] = label
    labels[left] = found

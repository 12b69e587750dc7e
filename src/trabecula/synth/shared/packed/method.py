"""What methods have in common that find bodies in one of two phases, and place them anew.

Learning chooses the phase; making draws how deep voxels lie in bodies, and takes as many of the
deepest as are wanted.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from functools import cached_property
from math import prod
from typing import Any

import numpy as np

from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image
from trabecula.core.progress import notify
from trabecula.core.request import Request
from trabecula.core.target import porosity_of
from trabecula.engine.parallel import thread_count
from trabecula.synth.api.method import Method, Model
from trabecula.synth.shared.content.fields import phases_present
from trabecula.synth.shared.content.kinds import complete, free_voxels
from trabecula.synth.shared.own_figures import LEAST, OwnFigures, figure_stages, tell_off
from trabecula.synth.shared.packed.depth import deepest_by_share, deepest_share
from trabecula.synth.shared.packed.trials import BOX, Packed

_POOR = 3.0  # spreads: from there on a line says that figures are far off
_PROCESS = 200 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded
_VOXEL = 14  # bytes of a voxel and its share of the margin while a depth is drawn and cut
_CURVES = 256 << 10  # bytes of what figures are held against
_FIELD = 8  # bytes of a voxel more with a target field or a mask


class PackedMethod(Method):
    """A method that finds bodies in one of two phases.

    Attributes
    ----------
    voxel_bytes, more_bytes : int
        What finding bodies takes, by voxel of the exemplar and at least.
    """

    learning_cost = 20.0
    voxel_bytes = 85
    more_bytes = 28 << 20

    def _phases(self, image: Image) -> list[int]:
        """Return the labels that the bodies may be: of the two phases, or of the one that is named.

        Raises
        ------
        InputError
            Another number of phases, or none of that name.
        """
        name, named = self.config.phase, self.capabilities.name
        present = phases_present([image])
        if len(present) != 2:
            raise InputError(
                f"{named} makes material of two phases, the exemplar has {len(present)}: "
                "join those that are no bodies (tb.segment), or use --method texture"
            )
        known = [image.phases[one] for one in present]
        if name is not None and name not in known:
            raise InputError(
                f"phase={name!r} is no phase of the exemplar: it has {', '.join(known)}"
            )
        return [one for one in present if name in (None, image.phases[one])]

    def _measured(self, image: Image) -> OwnFigures | None:
        """Return the figures that trials are held against; None where nothing is to be tried, or
        the exemplar is too small, which is said.
        """
        if self.config.separation is not None and self.config.fillet is not None:
            return None
        found = OwnFigures.of(image, box=BOX)
        if found is None:
            notify(
                f"the exemplar is too small to try separation and fillet ({LEAST} voxels along "
                "every axis): 1 is taken where they are not set"
            )
        return found

    def _say_score(self, packed: Packed, phase: str) -> None:
        """Say where even the nearest of the trials are far from the scan."""
        if (packed.score or 0) > _POOR:
            notify(
                f"{self.capabilities.name} of the {phase} is far from the scan, "
                f"{packed.score:.1f} of its spreads: --method texture may be nearer"
            )

    def memory(self, exemplars: Sequence[Image]) -> Mapping[str, int]:
        """Forecast the bodies of the exemplar, or the trials."""
        shape = exemplars[0].shape
        trial = _VOXEL * prod(min(side, BOX) for side in shape)
        trial += sum(stage.working for stage in figure_stages(shape, shape, box=BOX))
        found = self.more_bytes + self.voxel_bytes * prod(shape)
        return {
            "interpreter and kernels": _PROCESS,
            "bodies or trials": max(found, thread_count() * trial),
        }


class PackedModel(Model):
    """Bodies of one phase that are placed anew.

    Attributes
    ----------
    label : int
        Of the bodies.
    fraction : float
        Of their phase in the exemplar.
    packed : Packed
    """

    label: int
    fraction: float
    packed: Packed

    @property
    @abstractmethod
    def largest(self) -> float:
        """Return the largest radius of a body, edges."""

    @abstractmethod
    def _depth(
        self, request: Request, sides: np.ndarray, share: float
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return how deep voxels lie in bodies that have this share of a box that repeats with
        these sides, edges; and what to report.
        """

    def make(self, request: Request) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Place the bodies, and take as many of the deepest voxels as are wanted."""
        wanted = self._share(request)
        free = free_voxels(request)
        inside = ... if free is None or not np.ndim(wanted) else free
        share = float(np.mean(np.asarray(wanted)[inside]))
        values, report = self._placed(request, wanted, share)
        report |= {
            "phase": self.facts[0].phases[self.label],
            "separation": self.packed.separation,
            "fillet": self.packed.fillet,
        }
        return values, report | self._compare(request, values)

    def _placed(
        self, request: Request, wanted: float | np.ndarray, share: float
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the labels of as many of the deepest voxels as are wanted, everywhere or around
        each, and what to report.
        """
        depth, report = self._depth(request, self._torus(request), share)
        free = free_voxels(request)
        if isinstance(wanted, np.ndarray):
            chosen = deepest_by_share(depth, wanted, free)
        else:
            chosen = deepest_share(depth, share, free)
        return self._labelled(chosen, request), report

    def _labelled(self, chosen: np.ndarray, request: Request) -> np.ndarray:
        """Return the labels of a result, empty outside the mask and as they are where known."""
        other = next(one for one in phases_present(self.exemplars) if one != self.label)
        values = np.where(chosen, np.uint8(self.label), np.uint8(other))
        return complete(values, request, empty=self.facts[0].empty_label)

    def _compare(self, request: Request, values: np.ndarray) -> dict[str, Any]:
        """Tell what is off in a result, and return its figures for the report; none where it is to
        differ from the exemplar.
        """
        if request.asks_for() - {"periodic"} or self._figures is None:
            return {}
        return tell_off(self._figures.compare(self.exemplars[0], values))

    def _figure_bytes(self, request: Request) -> int:
        """Return the bytes that it takes to say what is off, with a copy of the part that is
        measured.
        """
        if request.asks_for() - {"periodic"}:
            return 0
        stages = figure_stages(request.shape, self.exemplars[0].shape, box=BOX)
        copy = prod(min(side, BOX) for side in request.shape)
        return _CURVES + copy + sum(stage.working for stage in stages)

    @cached_property
    def _figures(self) -> OwnFigures | None:
        return OwnFigures.of(self.exemplars[0], box=BOX)

    @property
    def _steps(self) -> np.ndarray:
        """Return the edges of a voxel in units of the smallest."""
        spacing = np.array(self.facts[0].spacing)
        return np.asarray(spacing / spacing.min())

    def _share(self, request: Request) -> float | np.ndarray:
        """Return the share of bodies that is wanted, everywhere or around every place."""
        porosity = porosity_of(request.target)
        if porosity is None:
            return self.fraction
        return porosity if self.label == self.facts[0].empty_label else 1 - porosity

    def _torus(self, request: Request) -> np.ndarray:
        """Return the sides of the box that repeats, edges: with room for the bodies that faces cut
        along axes that do not repeat.
        """
        sides = np.array(request.shape) * self._steps
        return np.asarray(np.where(request.periodic, sides, sides + 2 * self.largest))

    def _check_request(self, request: Request) -> None:
        super()._check_request(request)
        width = 2 * self.largest
        sides = zip("zyx", self._torus(request), request.periodic, strict=True)
        for axis, (name, side, wraps) in enumerate(sides):
            if wraps and side < width:
                raise RequestError(
                    f"the largest body is {width:.0f} voxels wide, and axis {name} repeats after "
                    f"{request.shape[axis]}: ask for a larger shape"
                )

    def memory(self, request: Request) -> Mapping[str, int]:
        """Forecast the depth of the voxels, and the bodies."""
        margin = 2 * np.ceil(3.5 * self.packed.fillet / self._steps)
        voxels = prod(int(side + m) for side, m in zip(request.shape, margin, strict=True))
        more = _FIELD if request.mask is not None or request.target else 0
        drawn = (_VOXEL + more) * voxels + self._body_bytes(self._torus(request))
        return {
            "interpreter and kernels": _PROCESS,
            "exemplar": sum(image.values.nbytes for image in self.exemplars),
            "output": self.output_bytes(request),
            "depth or figures": int(max(drawn, self._figure_bytes(request))),
        }

    @abstractmethod
    def _body_bytes(self, sides: np.ndarray) -> float:
        """Return the bytes of the bodies in a box with these sides, edges."""

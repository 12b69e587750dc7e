"""`texture`: fit keeps the exemplars' pyramid, generate makes the output level by level.

With `novelty` the coarsest level is laid out anew (`novel_layout`), without it starts from random
patches (`exemplar_rounds`); from there both go by rounds of search (nearest neighbourhood of the
exemplar for each of a sparse grid), vote (robust mean of overlapping ones) and histogram matching
(`shared.coarse_to_fine`). The fields
of labels are clipped signed distances, so the last threshold is exact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.exemplar.target import check_target_porosity
from trabecula.synth.api.method import Method, Model
from trabecula.synth.shared.coarse_to_fine import levels_for, levels_that_fit
from trabecula.synth.shared.content.fields import FULL, channels_of, isotropic_scale, quantise
from trabecula.synth.shared.content.kinds import Content, Labels, content_of
from trabecula.synth.shared.matching.principal_components import basis_bytes
from trabecula.synth.shared.matching.region import Region, regions_of
from trabecula.synth.shared.matching.sources import Stack
from trabecula.synth.shared.orient import apply_symmetry, symmetries
from trabecula.synth.shared.pictures import ROOM
from trabecula.synth.shared.pyramid import fit_to, halve
from trabecula.synth.shared.statistics.two_point import Correlations, correlations_at
from trabecula.synth.shared.statistics.two_point_steps import step_bytes, step_slab_bytes
from trabecula.synth.texture import CAPABILITIES, novel_layout
from trabecula.synth.texture.config import TextureConfig
from trabecula.synth.texture.exemplar_rounds import (
    ExemplarRounds,
    Level,
    level_of,
    make_from_patches,
)
from trabecula.synth.texture.forecast import TextureForecast
from trabecula.synth.texture.graded import (
    BEYOND,
    average_target,
    check_phases,
    fractions_by_level,
    target_fractions,
)

_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded


class Texture(Method):
    """3-D exemplar optimisation."""

    capabilities = CAPABILITIES
    config_type = TextureConfig

    def learn(self, exemplars: Sequence[Image]) -> TextureModel:
        width = max(self.config.neighbourhood)
        for exemplar in exemplars:
            if min(exemplar.shape) < width + ROOM:
                raise InputError(
                    f"the exemplar is {exemplar.shape}, a neighbourhood of {width} needs at "
                    f"least {width + ROOM} "
                    "voxels along every axis: give a larger exemplar, or a smaller neighbourhood"
                )
        return TextureModel(self.config, exemplars)

    def memory(self, exemplars: Sequence[Image]) -> Mapping[str, int]:
        """Forecast the principal components, and the finest level's fields and candidates."""
        channels = channels_of(exemplars)
        shapes = [exemplar.shape for exemplar in exemplars]
        distances = exemplars[0].kind == "labels" and self.config.field == "distance"
        turns = len(symmetries(self.config.orientations, spacing=exemplars[0].spacing))
        size = turns * sum(int(np.prod(shape)) for shape in shapes)
        if self.config.novelty_for(distances=distances) and novel_layout.top_for(
            min(min(shape) for shape in shapes)
        ):
            width, halves = novel_layout.WIDTH, 1
            each = 8 + 9 * channels
        else:  # the second level's neighbourhoods are the ones that are described in full
            width, halves = max(self.config.neighbourhood), 2
            each = 14 + 11 * channels
        count = turns * sum(
            int(np.prod([max(1, side // halves - width + 1) for side in shape])) for shape in shapes
        )
        basis = basis_bytes(channels * width**3, count)
        return {"interpreter and kernels": _PROCESS, "fields": size * each, "basis": basis}


class TextureModel(Model):
    """Exemplars as a pyramid of fields with the neighbourhoods of every level."""

    capabilities = CAPABILITIES
    config: TextureConfig

    def __init__(self, config: TextureConfig, exemplars: Sequence[Image]) -> None:
        super().__init__(config, exemplars)
        self.content: Content = content_of(
            exemplars, field=config.field, histogram=config.histogram
        )
        self.novelty = config.novelty_for(distances=self.content.distances)
        turns = symmetries(config.orientations, spacing=exemplars[0].spacing)
        fields = [self.content.fields(exemplar) for exemplar in exemplars]
        smallest = min(min(exemplar.shape) for exemplar in exemplars)
        self.top = novel_layout.top_for(smallest) if self.novelty else 0
        self.stacks, self._own = [], []
        for index in track(
            range(
                max(
                    levels_that_fit(smallest, config.levels, width=max(config.neighbourhood)),
                    self.top + 1,
                )
            ),
            "learning the exemplar",
        ):
            own = [self._quantise(field, index) for field in fields]
            self.stacks.append(
                Stack.of([apply_symmetry(field, turn) for field in own for turn in turns])
            )
            self._own.append(own)
            fields = [halve(field) for field in fields]
        self.learnt: list[Level] | None = None
        self.targets = self._targets() if any(config.corrections) and self.content.distances else []
        if self.top:
            self._learn_new()
        else:
            self.learnt = self._levels()

    @property
    def levels(self) -> list[Level]:
        """Return the neighbourhoods for search and vote from random patches; learnt when first
        needed.
        """
        if self.learnt is None:
            self.learnt = self._levels()
        return self.learnt

    def _levels(self) -> list[Level]:
        smallest = min(min(exemplar.shape) for exemplar in self.exemplars)
        count = levels_that_fit(smallest, self.config.levels, width=max(self.config.neighbourhood))
        stacks = self.stacks[:count]
        return [
            level_of(stack, index, self.config, distances=self.content.distances)
            for index, stack in enumerate(stacks)
        ]

    def _targets(self) -> list[Correlations]:
        """Measure the two-point functions of every level."""
        edges = isotropic_scale(self.exemplars[0].spacing)
        return [
            correlations_at(own, index, edges=edges, clip=self.config.clip)
            for index, own in enumerate(self._own)
        ]

    def _learn_new(self) -> None:
        """Learn the target of material that is not copied."""
        edges = isotropic_scale(self.exemplars[0].spacing)
        schedule = novel_layout.passes(self.novelty, self.top)
        self.aims = [
            novel_layout.aims_of(
                self.stacks[index], self._own[index], index, edges, schedule, self.config
            )
            for index in range(self.top + 1)
        ]
        self.slices = novel_layout.slices_for(self._own[self.top])

    def _quantise(self, field: np.ndarray, index: int) -> np.ndarray:
        """Round a field of level `index` to int8: a distance counts in the voxels of its level, a
        grey value is unchanged.
        """
        if self.content.distances:
            return quantise(field, clip=self.config.clip, unit=2**index)
        return quantise(field, clip=FULL)

    def make(self, request: Request) -> tuple[np.ndarray, dict[str, Any]]:
        if self._makes_new(request):
            schedule = novel_layout.passes(self.novelty, self.top)
            votes = novel_layout.make_novel(self.aims, self.slices, schedule, request, self.config)
            energies: list[dict[str, Any]] = []
        else:
            used = levels_for(request.shape, len(self.levels), width=max(self.config.neighbourhood))
            # No array is held by a name here: the run drops what it no longer needs.
            votes, energies = make_from_patches(
                ExemplarRounds(
                    self.levels[:used],
                    regions_of(request, used, self.content.bounds(request), self._quantise),
                    request,
                    self.config,
                    distances=self.content.distances,
                    targets=self.targets,
                    fractions=self._fractions(request, used),
                )
            )
        votes = fit_to(votes, request.shape)
        if request.target and isinstance(self.content, Labels):
            request = average_target(request)
        return self.content.to_values(votes, request), {"levels": energies} if energies else {}

    def _fractions(self, request: Request, count: int) -> list[np.ndarray]:
        """Return the target's volume fractions on each level; empty where there is none."""
        if not request.target or not isinstance(self.content, Labels):
            return []
        shares = target_fractions(request, self.content.present, self.content.empty)
        return fractions_by_level(shares, self.stacks[:count])

    def _makes_new(self, request: Request) -> bool:
        """Return whether there is room to lay out something new; beside known voxels neighbourhoods
        have to fit them.
        """
        return (
            self.top > 0
            and request.fixed is None
            and not request.target
            and novel_layout.has_room(request.shape, self.top)
        )

    def _check_request(self, request: Request) -> None:
        super()._check_request(request)
        width = min(self.config.neighbourhood)
        if request.mask is not None and not _has_room(request.mask, width):
            raise RequestError(
                f"the mask nowhere has room for a neighbourhood of {width} voxels: voxelise it "
                "at a finer spacing, or "
                "choose a smaller neighbourhood (--set neighbourhood=4)"
            )

    def _check_target(self, request: Request) -> None:
        check_target_porosity(request.target, self.exemplars, mask=request.mask, beyond=BEYOND)
        if request.target and isinstance(self.content, Labels):
            check_phases(self.content.present, self.content.empty)

    def memory(self, request: Request) -> Mapping[str, int]:
        run = self._run(request)
        return {
            "interpreter and kernels": _PROCESS,
            "exemplar": self._exemplar_bytes(),
            "output": run.output,
            "scratch": run.scratch,
        }

    def resident_memory(self, request: Request) -> Mapping[str, int]:
        slab = self._run(request).slab
        if self._makes_new(request):
            slab = max(
                slab,
                novel_layout.slab_bytes(self.aims[0].correlations, self.slices, request, self.top),
            )
        elif self.targets and request.fixed is None:
            shape = Region(request.shape, request.periodic).shape
            slab = max(slab, step_slab_bytes(shape, self.targets[0], request.periodic))
        return {
            "interpreter and kernels": _PROCESS,
            "exemplar": self._exemplar_bytes(),
            "slab": slab,
        }

    def _exemplar_bytes(self) -> int:
        """Return the bytes of the exemplar's fields and neighbourhoods."""
        kept = [c for aim in self.aims for c in aim.candidates] if self.top else []
        kept += [c for level in self.learnt or [] for c in level]
        searched = 3 if self.config.search == "exact" else 1  # prepared for it, in another order
        fields = sum(stack.field.nbytes for stack in self.stacks)
        return fields + sum(searched * c.features.nbytes + 9 * c.allowed.nbytes for c in kept)

    def _run(self, request: Request) -> TextureForecast:
        """Describe a run for its forecast."""
        new, config = self._makes_new(request), self.config
        labels = isinstance(self.content, Labels)
        itemsize = self.dtype.itemsize * (3 if self.facts[0].kind == "colour" else 1)
        if new:
            region = Region(
                novel_layout.torus_shape(request.shape, request.periodic, 0, self.top),
                (True, True, True),
            )
            correlations = self.aims[0].correlations
            step = novel_layout.step_bytes(correlations, request, self.top)
            finest = self.aims[0].candidates
            return TextureForecast(
                request, region, finest, labels, itemsize, repeated=True, correcting=step
            )
        stepped = bool(self.targets) and request.fixed is None and not request.target
        return TextureForecast(
            request,
            Region(request.shape, request.periodic),
            self.levels[0],
            labels,
            itemsize,
            exact=config.search == "exact",
            energetic=config.energetic,
            graded=bool(request.target),
            repeated=config.sweeps > 1,
            correcting=step_bytes(request.shape, self.targets[0], request.periodic)
            if stepped
            else 0,
        )


def _has_room(mask: np.ndarray, width: int) -> bool:
    """Return whether a cube of `width` voxels fits into a mask (one that is thinner along an axis
    may fill that axis).
    """
    reach = [min(width, side) for side in mask.shape]
    deep = np.zeros(mask.shape[1:], np.int32)  # planes up to this one in which a line is inside
    for plane in mask:
        deep = np.where(plane, deep + 1, 0)
        room = deep >= reach[0]
        for axis in (0, 1):
            sums = np.cumsum(room, axis=axis, dtype=np.int32)
            sums = np.concatenate([np.zeros_like(sums.take([0], axis)), sums], axis)
            cells = np.arange(room.shape[axis] - reach[1 + axis] + 1)
            room = (
                sums.take(cells + reach[1 + axis], axis) - sums.take(cells, axis) == reach[1 + axis]
            )
        if room.any():
            return True
    return False

"""The method `mrf`: learn the picture's neighbourhoods at every scale, then relax a volume from
coarse to fine.

1. The pictures become numbered levels (`picture_levels`), decimated by two for every scale; their
   neighbourhoods become the candidates of a Parzen estimate with h_opt (`candidates`).
2. The coarsest scale starts from white noise with the picture's histogram, each finer one from the
   coarser result (`lattice`, `relaxation`).
3. At each scale sweeps visit every site: the density of all levels given the neighbourhoods in the
   slices through it (`density`), the product of the views' densities (`slice_planes`), a new level
   (`site_update`), then the site's temperature or the feedback (`relaxation`,
   `statistics_feedback`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.progress import part_of, track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.core.target import porosity_of
from trabecula.engine.checkpoint import Checkpoint, resume
from trabecula.engine.memory import Stage, Workspace, forecast, resident, within
from trabecula.engine.parallel import for_slabs
from trabecula.exemplar.views import View, is_isotropic, spacing_of
from trabecula.synth.mrf import CAPABILITIES
from trabecula.synth.mrf.candidates import (
    ParzenCandidates,
    candidate_bytes,
    count_scales,
    extract_neighbourhoods,
    learning_bytes,
    prepare_candidates,
    reweight_by_porosity,
)
from trabecula.synth.mrf.config import MrfConfig
from trabecula.synth.mrf.density import STEPS
from trabecula.synth.mrf.lattice import (
    SiteLattice,
    build_lattices,
    lattice_at,
    lattice_stages,
    result_scales,
    torus_shape,
)
from trabecula.synth.mrf.picture_levels import PictureLevels, largest_feature, number_levels
from trabecula.synth.mrf.relaxation import at_scale, relaxation_stages, start_relaxation
from trabecula.synth.mrf.slice_planes import SliceView, oblique_planes, plane_across
from trabecula.synth.mrf.statistics_feedback import PairCouplings, coupled_pairs
from trabecula.synth.shared.content.fields import isotropic_scale
from trabecula.synth.shared.pictures import PictureMethod, PictureModel
from trabecula.synth.shared.statistics.pairs import Pairs

_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded
_SMALL = 200_000  # bytes of what depends neither on the picture nor on the request

# axes of an oblique plane whose steps are diagonals: (rows, columns)
_DIAGONAL = ((False, True), (True, True))


class Mrf(PictureMethod):
    """Maximum-likelihood synthesis from one picture."""

    capabilities = CAPABILITIES
    config_type = MrfConfig

    def _width(self) -> int:
        """Return the width of the neighbourhoods, pixels."""
        return self.config.neighbourhood

    def _learn(self, exemplars: Sequence[Image], views: tuple[View, ...]) -> MrfModel:
        """Learn the pictures."""
        return MrfModel(self.config, exemplars, views)

    def memory(self, exemplars: Sequence[Image]) -> Mapping[str, int]:
        config = self.config
        oblique = _uses_oblique(config, exemplars, three=len(config.views) in (0, 3))
        count = count_scales(exemplars, config)
        kept, peak = learning_bytes(exemplars, count, config, oblique=oblique)
        return {
            "interpreter and kernels": _PROCESS,
            "neighbourhoods": kept,
            "learning": peak - kept,
        }


class MrfModel(PictureModel):
    """Views of the pictures, and their neighbourhoods at every scale."""

    capabilities = CAPABILITIES
    config: MrfConfig

    def __init__(
        self, config: MrfConfig, exemplars: Sequence[Image], views: Sequence[View]
    ) -> None:
        super().__init__(config, exemplars, views)
        # A picture that several views share is learned once.
        images: list[Image] = []
        self.learners: list[int] = []
        for view in self.views:
            known = [n for n, image in enumerate(images) if image is view.image]
            self.learners.append(known[0] if known else len(images))
            images += [] if known else [view.image]
        self.content: PictureLevels = number_levels(
            images,
            full=largest_feature(images[0].kind, config),
            levels=config.levels,
            colours=config.colours,
        )
        self.oblique = _uses_oblique(config, images, three=len(self.views) == 3)
        self.count = count_scales(images, config)
        self.candidate_sets = [
            self._candidates_at(scale, None)
            for scale in track(range(self.count), "learning the exemplar")
        ]

    def _candidates_at(self, scale: int, porosity: float | None) -> list[ParzenCandidates]:
        """Prepare the candidates of each picture at a scale, then those of the first picture along
        diagonals; with a `porosity`, from neighbourhoods redrawn for it.
        """
        config, content = self.config, self.content
        kinds = [(picture, (False, False)) for picture in content.pictures]
        if self.oblique:
            kinds += [(content.pictures[0], diagonal) for diagonal in _DIAGONAL]
        candidate_sets = []
        for picture, diagonal in kinds:
            neighbourhoods = extract_neighbourhoods(
                picture,
                scale=scale,
                width=config.neighbourhood,
                every=config.every,
                diagonal=diagonal,
            )
            if porosity is not None and content.void is not None:
                neighbourhoods = reweight_by_porosity(neighbourhoods, content.void, porosity)
            candidate_sets.append(
                prepare_candidates(
                    neighbourhoods,
                    content,
                    most=config.candidates,
                    bandwidth=config.setting_for("bandwidth", self.content.sort),
                    steps=STEPS if config.relaxation == "icm" else 1,
                    products=config.relaxation == "icm",
                    bins=config.cells,
                )
            )
        return candidate_sets

    def _view_sets(self, candidate_sets: Sequence[ParzenCandidates]) -> list[list[SliceView]]:
        """Return the views along the axes, and for isotropic material those of the oblique planes
        about each axis.
        """
        pairs = zip(self.views, self.learners, strict=True)
        view_sets = [
            [
                SliceView(plane_across(view.axis), candidate_sets[learner], learner)
                for view, learner in pairs
            ]
        ]
        for axis in range(3) if self.oblique else ():
            numbers = [1 + _DIAGONAL.index(plane.diagonal) for plane in oblique_planes(axis)]
            view_sets.append(
                [
                    SliceView(plane, candidate_sets[n], n)
                    for plane, n in zip(oblique_planes(axis), numbers, strict=True)
                ]
            )
        return view_sets

    def _start_couplings(self, scale: int, lattice: SiteLattice) -> PairCouplings | None:
        """Return the couplings of a scale before the first sweep; None without."""
        rate = self.config.setting_for("coupling", self.content.sort)
        if not rate:
            return None
        stride = 2**scale
        pictures = [
            (view.axis, self.content.pictures[learner][::stride, ::stride])
            for view, learner in zip(self.views, self.learners, strict=True)
        ]
        return PairCouplings(
            pictures,
            self.content.features,
            lattice.shape,
            edges=isotropic_scale(spacing_of(self.views)),
            reach=self.config.reach // stride,
            rate=rate,
        )

    def _check_request(self, request: Request) -> None:
        super()._check_request(request)
        width = self.config.neighbourhood
        for axis, side, periodic in zip("zyx", request.shape, request.periodic, strict=True):
            if periodic and side < width:
                raise RequestError(
                    f"{axis} is periodic with {side} voxels, a neighbourhood has {width}: ask for "
                    "more, or for a smaller neighbourhood"
                )
        self._target_porosity(request)

    def _target_porosity(self, request: Request) -> float | None:
        """Return the requested porosity, or None."""
        wanted = porosity_of(request.target)
        if isinstance(wanted, np.ndarray):
            raise RequestError(
                "this method honours one number as target porosity, not a field: give a number"
            )
        return wanted

    def _target_shares(self, porosity: float | None) -> np.ndarray:
        """Return the target shares (L,) of the levels: the pictures', or those with another
        porosity.
        """
        content = self.content
        pictures = [content.pictures[learner] for learner in self.learners]
        counts = np.sum(
            [np.bincount(p.ravel(), minlength=len(content.values)) / p.size for p in pictures],
            axis=0,
        )
        if porosity is not None:
            rest = np.where(content.values == content.empty, 0, counts)
            counts = np.where(
                content.values == content.empty, porosity, (1 - porosity) * rest / rest.sum()
            )
        return np.asarray(counts / counts.sum())

    def make(self, request: Request) -> tuple[np.ndarray, dict[str, Any]]:
        porosity = self._target_porosity(request)
        candidate_sets = (
            self.candidate_sets
            if porosity is None
            else [self._candidates_at(scale, porosity) for scale in range(self.count)]
        )
        count, width = self._scale_count(request), self.config.neighbourhood
        work = Workspace(lattice_stages(request, self.content, count=count, width=width))
        build_lattices(work, request, self.content, count=count, width=width)
        report: list[dict[str, Any]] = []
        strength: np.ndarray | None = None
        begin, state = self._find_checkpoint(count - 1)
        wanted = self._target_shares(porosity)
        # sweeps times voxels, for a progress bar
        costs = [at_scale(self.config.sweeps, n) / 8**n for n in reversed(range(count))]
        for scale in range(begin, -1, -1):
            work.enter(f"relax {scale}")
            with part_of(costs, count - 1 - scale):
                report, strength = self._relax(
                    lattice_at(work, request, scale),
                    None if scale == count - 1 else work[f"levels {scale + 1}"],
                    candidate_sets[scale],
                    wanted,
                    seed=request.seed,
                    scale=scale,
                    before=(report, strength),
                    state=state,
                )
            state = None
        work.enter("values")
        self._fill_values(work.empty("values"), work["levels 0"], request)
        return work.take("values"), {"scales": report, "oblique": self.oblique}

    def _relax(
        self,
        lattice: SiteLattice,
        coarse: np.ndarray | None,
        candidate_sets: Sequence[ParzenCandidates],
        wanted: np.ndarray,
        *,
        seed: int,
        scale: int,
        before: tuple[list[dict[str, Any]], np.ndarray | None],
        state: Checkpoint | None,
    ) -> tuple[list[dict[str, Any]], np.ndarray | None]:
        """Relax one scale; return the report so far and the strength of the couplings, as they were
        `before` from the coarser scale.
        """
        couplings = self._start_couplings(scale, lattice)
        relaxation = start_relaxation(
            lattice,
            coarse,
            self._view_sets(candidate_sets),
            self.content,
            self.config,
            seed=seed,
            scale=scale,
            wanted=wanted,
            couplings=couplings,
        )
        report, strength = before
        if couplings is not None and state is None:
            couplings.start(strength, lattice.levels, lattice.domain)
        report = relaxation.run(report, state)
        return report, None if couplings is None else couplings.strength

    def _fill_values(self, values: np.ndarray, levels: np.ndarray, request: Request) -> None:
        """Convert levels to values; known voxels keep their values, and outside a form the value is
        `empty`.
        """
        table, word = self.content.values, key(request.seed, "mrf/values")
        depth, height, width = request.shape

        def work(first: int, last: int) -> None:
            for z in range(first, last):  # an index of the whole would take 8 bytes a voxel
                plane = levels[z, :height, :width]
                values[z] = (
                    self.content.draw_values(plane, z, word) if self.config.spread else table[plane]
                )
                if request.mask is not None:
                    values[z][~request.mask[z]] = self.content.empty
                if request.fixed is not None and request.known is not None:
                    known = request.known[z]
                    values[z][known] = request.fixed.values[z][known]

        for_slabs(work, depth)

    def _find_checkpoint(self, top: int) -> tuple[int, Checkpoint | None]:
        """Return the scale at which an interrupted run resumes and its checkpoint, or the coarsest
        and None.
        """
        for scale in range(top + 1):
            state = resume(f"scale {scale}")
            if state is not None:
                return scale, state
        return top, None

    def memory(self, request: Request) -> Mapping[str, int]:
        return forecast(self._stages(request), self._constant_bytes(request)).memory

    def resident_memory(self, request: Request) -> Mapping[str, int]:
        return resident(self._stages(request), self._constant_bytes(request))

    def _scale_count(self, request: Request) -> int:
        """Count the scales that a result has room for."""
        width = self.config.neighbourhood
        return result_scales(request.shape, request.periodic, count=self.count, width=width)

    def _stages(self, request: Request) -> tuple[Stage, ...]:
        """Declare all arrays of a request: those of all scales, and beside them of the relaxation
        of each.
        """
        count, masked = self._scale_count(request), request.mask is not None
        width, stages = self.config.neighbourhood, []
        for stage in lattice_stages(request, self.content, count=count, width=width):
            stages.append(stage)
            word, _, number = stage.name.partition(" ")
            if word == "relax":
                views = self._view_sets(self.candidate_sets[int(number)])
                shape = stage.arrays[f"levels {number}"].shape
                pairs = self._pairs(int(number), shape)
                relaxation = relaxation_stages(
                    shape, views, self.content, self.config, masked=masked, pairs=pairs
                )
                stages += within(stage.arrays, relaxation)
        return tuple(stages)

    def _pairs(self, scale: int, shape: tuple[int, ...]) -> Pairs | None:
        """Return the coupled pairs of a scale; None without couplings."""
        if not self.config.setting_for("coupling", self.content.sort):
            return None
        stride = 2**scale
        sides = [side for learner in self.learners for side in self.content.pictures[learner].shape]
        return coupled_pairs(
            shape,
            edges=isotropic_scale(spacing_of(self.views)),
            reach=self.config.reach // stride,
            shortest=-(-min(sides) // stride),
        )

    def _constant_bytes(self, request: Request) -> dict[str, int]:
        """Return the bytes that all stages hold beside their arrays."""
        candidates = [one for scale in self.candidate_sets for one in scale]
        count, width = self._scale_count(request), self.config.neighbourhood
        shape = torus_shape(request.shape, request.periodic, count=count, width=width)
        pairs, levels = self._pairs(0, shape), len(self.content.values)
        blurs = 8 * (4 if self.oblique else 1) * len(self.views) * levels**2
        memory = {
            "interpreter and kernels": _PROCESS,
            "exemplar": candidate_bytes(candidates),
            # bins of offsets, and their weights
            "tables": blurs + _SMALL + (0 if pairs is None else pairs.table_bytes * 3 // 2),
        }
        if request.target:  # the pictures are learned anew
            memory["learning"] = learning_bytes(
                self.exemplars, self.count, self.config, oblique=self.oblique
            )[1]
        return memory


def _uses_oblique(config: MrfConfig, images: Sequence[Image], *, three: bool) -> bool:
    """Return whether oblique planes are used: the setting, or its default."""
    if config.oblique is not None:
        return config.oblique
    return len(images) == 1 and three and config.relaxation == "gibbs" and is_isotropic(images[0])

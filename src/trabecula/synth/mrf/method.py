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
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.core.target import porosity_of
from trabecula.engine import memmap
from trabecula.engine.checkpoint import Checkpoint, resume
from trabecula.engine.parallel import for_slabs, thread_count
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
from trabecula.synth.mrf.lattice import SiteLattice, build_lattices, result_scales, torus_shape
from trabecula.synth.mrf.picture_levels import PictureLevels, largest_feature, number_levels
from trabecula.synth.mrf.relaxation import start_relaxation
from trabecula.synth.mrf.site_update import ROWS_AT_ONCE
from trabecula.synth.mrf.slice_planes import (
    BATCH_OF_BITS,
    BATCH_OF_PRODUCTS,
    SliceView,
    oblique_planes,
    plane_across,
)
from trabecula.synth.mrf.statistics_feedback import PairCouplings
from trabecula.synth.shared.content.fields import isotropic_scale
from trabecula.synth.shared.pictures import PictureMethod, PictureModel
from trabecula.synth.shared.statistics.pairs import Pairs

_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded

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
        lattices = build_lattices(request, self.content, self.count, self.config.neighbourhood)
        top = len(lattices) - 1
        learned: PairCouplings | None = None
        report: list[dict[str, Any]] = []
        begin, state = self._find_checkpoint(top)
        wanted = self._target_shares(porosity)
        for scale in range(begin, -1, -1):
            coarse = lattices[scale + 1].levels if scale < top else None
            couplings = self._start_couplings(scale, lattices[scale])
            relaxation = start_relaxation(
                lattices[scale],
                coarse,
                self._view_sets(candidate_sets[scale]),
                self.content,
                self.config,
                seed=request.seed,
                scale=scale,
                wanted=wanted,
                couplings=couplings,
            )
            del coarse, lattices[scale + 1 :]
            if couplings is not None and state is None:
                couplings.start(learned, lattices[scale].levels, lattices[scale].domain)
            learned = couplings
            report = relaxation.run(report, state)
            state = None
            del relaxation, couplings
        del learned
        return self._to_values(lattices[0].levels, request), {
            "scales": report,
            "oblique": self.oblique,
        }

    def _to_values(self, levels: np.ndarray, request: Request) -> np.ndarray:
        """Convert levels to values; known voxels keep their values, and outside a form the value is
        `empty`.
        """
        table, word = self.content.values, key(request.seed, "mrf/values")
        depth, height, width = request.shape
        values = memmap.empty((*request.shape, *table.shape[1:]), table.dtype)

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
        return values

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
        run = self._run_memory(request)
        return {**self._constant_bytes(request), "output": run.output, "scratch": run.scratch}

    def resident_memory(self, request: Request) -> Mapping[str, int]:
        return {**self._constant_bytes(request), "slab": self._run_memory(request).slab}

    def _constant_bytes(self, request: Request) -> dict[str, int]:
        """Return the bytes that do not depend on the shape."""
        kept = candidate_bytes(
            [candidates for scale in self.candidate_sets for candidates in scale]
        )
        memory = {"interpreter and kernels": _PROCESS, "exemplar": kept}
        if request.target:  # the pictures are learned anew
            memory["learning"] = learning_bytes(
                self.exemplars, self.count, self.config, oblique=self.oblique
            )[1]
        return memory

    def _run_memory(self, request: Request) -> RunMemory:
        """Return the memory of a request."""
        config, width = self.config, self.config.neighbourhood
        count = result_scales(request.shape, request.periodic, count=self.count, width=width)
        shape = torus_shape(request.shape, request.periodic, count=count, width=width)
        kept = [candidates for scale in self.candidate_sets for candidates in scale]
        pairs = self._pairs(shape)
        return RunMemory(
            request, shape, self.content, kept, len(self.views), pairs, config, thread_count()
        )

    def _pairs(self, shape: tuple[int, ...]) -> Pairs | None:
        """Return the pairs of a lattice that can be coupled; None without couplings."""
        if not self.config.setting_for("coupling", self.content.sort):
            return None
        shortest = min(min(picture.shape) for picture in self.content.pictures)
        far = max(1, min(max(self.config.reach, 4), shortest // 2 - 1, min(shape) // 2 - 1))
        return Pairs(shape, far, (True, True, True), isotropic_scale(spacing_of(self.views)))


def _uses_oblique(config: MrfConfig, images: Sequence[Image], *, three: bool) -> bool:
    """Return whether oblique planes are used: the setting, or its default."""
    if config.oblique is not None:
        return config.oblique
    return len(images) == 1 and three and config.relaxation == "gibbs" and is_isotropic(images[0])


_SMALL = 100_000  # bytes of what does not depend on the picture
_OF_A_SITE = 42  # bytes a site while sites in the result are marked

_OF_A_PLANE = 40  # bytes a pixel of what starts a scale plane by plane


@dataclass(frozen=True)
class RunMemory:
    """Memory of a run, from shapes and settings alone; the factors were measured.

    `shape` is that of the finest lattice, `pairs` the coupled pairs (None: none), `threads` the
    number of threads.
    """

    request: Request
    shape: tuple[int, ...]
    content: PictureLevels
    candidate_sets: Sequence[ParzenCandidates]
    views: int
    pairs: Pairs | None
    config: MrfConfig
    threads: int

    @property
    def scratch(self) -> int:
        """Return the bytes of batches of sites in all threads."""
        content = self.content
        around, (levels, channels) = self.config.neighbourhood**2 - 1, content.features.shape
        shares = levels * (24 * self.views + 24) + around * 11
        words = [
            len(candidates.bits)
            for candidates in self.candidate_sets
            if candidates.bits is not None
        ]
        if words:
            return self.threads * BATCH_OF_BITS * (shares + 16 * max(words))
        widest = max(len(candidates.centres) for candidates in self.candidate_sets)
        return self.threads * (
            BATCH_OF_PRODUCTS * (shares + 4 * widest + 4 * around * (channels + 1)) + 5 * widest
        )

    @property
    def output(self) -> int:
        """Return the bytes of the lattices of all scales and of the largest array beside them; the
        scratch memory of sites comes on top.
        """
        beside = (
            *self._site_bytes(),
            self._coupling_bytes() - self.scratch,
            self._value_bytes() - self.scratch,
        )
        return self._lattice_bytes() + max(0, *beside)

    @property
    def slab(self) -> int:
        """Return the bytes of the thinnest slabs where arrays as large as the result are
        memory-mapped.
        """
        _, height, width = self.shape
        levels, each = len(self.content.values), self.content.values[0].nbytes
        sites = _OF_A_SITE * height * width // (self.config.neighbourhood // 2 + 1) ** 2
        plane = (_OF_A_PLANE + 2 * each) * height * width
        if self.request.known is not None and self.content.kind == "colour":
            plane += 80 * height * width + 40 * levels * ROWS_AT_ONCE
        most = self.threads * max(plane, sites + ROWS_AT_ONCE * 4 * levels)
        if self.pairs is not None:
            most = max(most, self.pairs.slab_bytes + self.pairs.lines_bytes)
        return self.scratch + self._table_bytes + 2 * _SMALL + most

    @property
    def _voxels(self) -> int:
        """Count the voxels of the finest lattice."""
        return int(np.prod(self.shape, dtype=np.int64))

    @property
    def _table_bytes(self) -> int:
        """Return the bytes of the pair tables: bins of offsets, and for a while their weights."""
        return 0 if self.pairs is None else self.pairs.table_bytes * 3 // 2

    def _lattice_bytes(self) -> int:
        """Return the bytes held from the first sweep to the last, coarser scales included."""
        levels, channels = self.content.features.shape
        marks = (self.request.mask is not None) + (self.request.known is not None)
        each = (1 + marks) * 8 / 7 + 5 * (self.config.relaxation == "icm")
        if self.pairs is not None:
            each += 9 / 8 * 2 * channels
        return (
            round(self._voxels * each)
            + 8 * 4 * self.views * levels**2
            + self._table_bytes
            + 2 * _SMALL
        )

    def _site_bytes(self) -> tuple[int, int]:
        """Return the bytes of a class of sites with their scores, and of the groups' scores less
        the earlier scratch memory.
        """
        levels, channels = self.content.features.shape
        groups = int(self.content.groups.max()) + 1
        sites = self._voxels // (self.config.neighbourhood // 2 + 1) ** 2
        rows = 4 * levels + self.views * channels * (
            self.config.setting_for("feedback", self.content.sort) > 0
        )
        return (8 + rows) * sites, self.config.shares * (
            rows + 8 * groups + _OF_A_SITE
        ) * sites - self.scratch

    def _coupling_bytes(self) -> int:
        """Return the bytes of the transforms of a field."""
        if self.pairs is None:
            return 0
        return (
            2 * self.pairs.spectrum_bytes
            + self.pairs.kernel_bytes
            + 4 * self._voxels
            + self.pairs.slab_bytes
        )

    def _value_bytes(self) -> int:
        """Return the bytes of the result's values."""
        each = self.content.values[0].nbytes
        return each * int(np.prod(self.request.shape, dtype=np.int64))

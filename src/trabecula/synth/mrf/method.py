"""`mrf`: fit learns the picture's neighbourhoods at every scale, generate relaxes a volume from
coarse to fine.

1. The pictures become numbered levels (`content`), decimated by two for every scale; their
neighbourhoods become the
   candidates of a Parzen estimate with h_opt (`source`).
2. The coarsest scale starts from white noise with the picture's histogram; each finer one from what
it inherits.
3. At each scale sweeps visit every site: the density of all levels given the neighbourhoods in the
slices through it
   (`density`), the views' densities made one, a level chosen (`choose`), the site's temperature or
   the bias learnt (`relax`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from trabecula.engine.memory import Plan
from trabecula.engine.parallel import for_slabs, thread_count
from trabecula.exemplar.views import View, is_isotropic, spacing_of
from trabecula.synth.mrf import CAPABILITIES
from trabecula.synth.mrf.config import MrfConfig
from trabecula.synth.mrf.content import Content, content_of
from trabecula.synth.mrf.couplings import Couplings
from trabecula.synth.mrf.forecast import Run, learning_bytes
from trabecula.synth.mrf.lattice import Lattice
from trabecula.synth.mrf.limits import STEPS, largest_feature, scales_of
from trabecula.synth.mrf.patches import Source, bytes_of, patches_of, source_of
from trabecula.synth.mrf.planes import across, turned
from trabecula.synth.mrf.porosity_reweighting import tilted
from trabecula.synth.mrf.scales import count_of, lattices_of, padded_shape, started
from trabecula.synth.mrf.slice_planes import Face
from trabecula.synth.shared.fields import isotropic_scale
from trabecula.synth.shared.pictures import PictureMethod, PictureModel
from trabecula.synth.shared.statistics.pairs import Pairs

_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded
# along which of a turned plane's axes steps are diagonals
_STRETCHED = ((False, True), (True, True))


class Mrf(PictureMethod):
    """Maximum likelihood from one picture."""

    capabilities = CAPABILITIES
    config_type = MrfConfig

    def _width(self) -> int:
        return self.config.neighbourhood

    def _learn(self, exemplars: Sequence[Image], views: tuple[View, ...]) -> MrfModel:
        return MrfModel(self.config, exemplars, views)

    def memory(self, exemplars: Sequence[Image]) -> Mapping[str, int]:
        config = self.config
        three = len(config.views) in (0, 3)
        turned = (
            _turns(config, exemplars, three=three) if config.oblique is None else config.oblique
        )
        kept, peak = learning_bytes(exemplars, scales_of(exemplars, config), config, turned=turned)
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
        # A picture that several views share is learnt once.
        images: list[Image] = []
        self.learners: list[int] = []
        for view in self.views:
            known = [n for n, image in enumerate(images) if image is view.image]
            self.learners.append(known[0] if known else len(images))
            images += [] if known else [view.image]
        self.content: Content = content_of(
            images,
            full=largest_feature(images[0].kind, config),
            levels=config.levels,
            colours=config.colours,
        )
        three = len(self.views) == 3
        self.oblique = (
            _turns(config, images, three=three) if config.oblique is None else config.oblique
        )
        self.count = scales_of(images, config)
        self.sources = [
            self._learn(scale, None) for scale in track(range(self.count), "learning the exemplar")
        ]

    def _learn(self, scale: int, porosity: float | None) -> list[Source]:
        """What each picture says at a scale, then what the first says along diagonals; its
        neighbourhoods chosen for a `porosity` where one is asked for."""
        config, content = self.config, self.content
        kinds = [(picture, (False, False)) for picture in content.pictures]
        if self.oblique:
            kinds += [(content.pictures[0], stretched) for stretched in _STRETCHED]
        sources = []
        for picture, stretched in kinds:
            patches = patches_of(
                picture,
                scale=scale,
                width=config.neighbourhood,
                every=config.every,
                stretched=stretched,
            )
            if porosity is not None and content.void is not None:
                patches = tilted(patches, content.void, porosity)
            sources.append(
                source_of(
                    patches,
                    content,
                    most=config.candidates,
                    bandwidth=config.bandwidth_of(self.content.sort),
                    steps=STEPS if config.relaxation == "icm" else 1,
                    products=config.relaxation == "icm",
                    bins=config.cells,
                )
            )
        return sources

    def _frames(self, sources: Sequence[Source]) -> list[list[Face]]:
        """The views along the axes, and where the material is alike in all directions those turned
        about each of them.
        """
        pairs = zip(self.views, self.learners, strict=True)
        frames = [[Face(across(view.axis), sources[learner], learner) for view, learner in pairs]]
        for axis in range(3) if self.oblique else ():
            numbers = [1 + _STRETCHED.index(plane.stretched) for plane in turned(axis)]
            frames.append(
                [Face(plane, sources[n], n) for plane, n in zip(turned(axis), numbers, strict=True)]
            )
        return frames

    def _couplings(self, scale: int, lattice: Lattice) -> Couplings | None:
        """The couplings of a scale, which have learnt nothing yet."""
        rate = self.config.coupling_of(self.content.sort)
        if not rate:
            return None
        stride = 2**scale
        pictures = [
            (view.axis, self.content.pictures[learner][::stride, ::stride])
            for view, learner in zip(self.views, self.learners, strict=True)
        ]
        return Couplings(
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
                    f"{axis} is periodic with {side} voxels, a neighbourhood has {width}: ask for more, or for a smaller "
                    "neighbourhood"
                )
        self._porosity(request)

    def _porosity(self, request: Request) -> float | None:
        """The porosity that is asked for."""
        wanted = porosity_of(request.target)
        if isinstance(wanted, np.ndarray):
            raise RequestError(
                "this method honours one number as target porosity, not a field: give a number"
            )
        return wanted

    def _shares(self, porosity: float | None) -> np.ndarray:
        """The shares (L,) of the levels that the result is to have: the pictures', or with another
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
        porosity = self._porosity(request)
        sources = (
            self.sources
            if porosity is None
            else [self._learn(scale, porosity) for scale in range(self.count)]
        )
        lattices = lattices_of(request, self.content, self.count, self.config.neighbourhood)
        top = len(lattices) - 1
        learnt: Couplings | None = None
        told: list[dict[str, Any]] = []
        begin, state = self._resumed(top)
        wanted = self._shares(porosity)
        for scale in range(begin, -1, -1):
            coarse = lattices[scale + 1].levels if scale < top else None
            couplings = self._couplings(scale, lattices[scale])
            relaxation = started(
                lattices[scale],
                coarse,
                self._frames(sources[scale]),
                self.content,
                self.config,
                seed=request.seed,
                scale=scale,
                wanted=wanted,
                couplings=couplings,
            )
            del coarse, lattices[scale + 1 :]
            if couplings is not None and state is None:
                couplings.start(learnt, lattices[scale].levels, lattices[scale].there)
            learnt = couplings
            told = relaxation.run(told, state)
            state = None
            del relaxation, couplings
        del learnt
        return self._delivered(lattices[0].levels, request), {
            "scales": told,
            "oblique": self.oblique,
        }

    def _delivered(self, levels: np.ndarray, request: Request) -> np.ndarray:
        """Levels as values; what is known comes out as it was, and outside a form is nothing."""
        table, word = self.content.values, key(request.seed, "mrf/values")
        depth, height, width = request.shape
        values = memmap.empty((*request.shape, *table.shape[1:]), table.dtype)

        def work(first: int, last: int) -> None:
            for z in range(first, last):  # an index of the whole would take 8 bytes a voxel
                plane = levels[z, :height, :width]
                values[z] = (
                    self.content.drawn(plane, z, word) if self.config.spread else table[plane]
                )
                if request.mask is not None:
                    values[z][~request.mask[z]] = self.content.empty
                if request.fixed is not None and request.known is not None:
                    known = request.known[z]
                    values[z][known] = request.fixed.values[z][known]

        for_slabs(work, depth)
        return values

    def _resumed(self, top: int) -> tuple[int, Checkpoint | None]:
        """The scale at which an interrupted run goes on, and its state; the coarsest, and none."""
        for scale in range(top + 1):
            state = resume(f"scale {scale}")
            if state is not None:
                return scale, state
        return top, None

    def memory(self, request: Request) -> Mapping[str, int]:
        run = self._run(request)
        return {**self._fixed(request), "output": run.output, "scratch": run.scratch}

    def resident_memory(self, request: Request) -> Mapping[str, int]:
        return {**self._fixed(request), "slab": self._run(request).slab}

    def _fixed(self, request: Request) -> dict[str, int]:
        """Bytes that do not depend on the shape."""
        kept = bytes_of([source for scale in self.sources for source in scale])
        memory = {"interpreter and kernels": _PROCESS, "exemplar": kept}
        if request.target:  # the pictures are learnt anew
            memory["learning"] = learning_bytes(
                self.exemplars, self.count, self.config, turned=self.oblique
            )[1]
        return memory

    def _run(self, request: Request) -> Run:
        config, width = self.config, self.config.neighbourhood
        count = count_of(request.shape, request.periodic, count=self.count, width=width)
        shape = padded_shape(request.shape, request.periodic, count=count, width=width)
        kept = [source for scale in self.sources for source in scale]
        pairs = self._pairs(shape)
        return Run(
            request, shape, self.content, kept, len(self.views), pairs, config, thread_count()
        )

    def _pairs(self, shape: tuple[int, ...]) -> Pairs | None:
        """The pairs of a lattice that are coupled at most."""
        if not self.config.coupling_of(self.content.sort):
            return None
        shortest = min(min(picture.shape) for picture in self.content.pictures)
        far = max(1, min(max(self.config.reach, 4), shortest // 2 - 1, min(shape) // 2 - 1))
        return Pairs(shape, far, (True, True, True), isotropic_scale(spacing_of(self.views)))


def _turns(config: MrfConfig, images: Sequence[Image], *, three: bool) -> bool:
    """Whether turned planes go without being asked for."""
    return len(images) == 1 and three and config.relaxation == "gibbs" and is_isotropic(images[0])

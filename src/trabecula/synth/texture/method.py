"""`texture`: fit keeps the exemplars' pyramid, generate makes the output level by level.

With `novelty` the coarsest level is laid out anew (`novel_layout`), without it starts from random
patches (`exemplar_rounds`); from there both go by rounds of search (nearest neighbourhood of the
exemplar for each of a sparse grid), vote (robust mean of overlapping ones) and histogram matching
(`shared.coarse_to_fine`). The fields
of labels are clipped signed distances, so the last threshold is exact. Grey values and colours with
novelty are painted on a structure that is made as labels (`grey_levels`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from typing import Any

import numpy as np

from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image, with_values
from trabecula.core.progress import notify, part_of, track
from trabecula.core.request import Request
from trabecula.core.target import FRAME, frame_of, porosity_of
from trabecula.engine.memory import Array, Stage, forecast, resident, within
from trabecula.exemplar.target import check_target_porosity
from trabecula.synth.api.method import Method, Model
from trabecula.synth.shared import novel_layout
from trabecula.synth.shared.coarse_to_fine import levels_for, levels_that_fit
from trabecula.synth.shared.content.bounds import Bounds
from trabecula.synth.shared.content.fields import (
    FULL,
    channels_of,
    isotropic_scale,
    quantise,
    values_by_phase,
)
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.content.kinds import (
    Content,
    Labels,
    Values,
    complete,
    content_of,
    free_voxels,
)
from trabecula.synth.shared.content.phase_fractions import phases_of
from trabecula.synth.shared.frames import frames_of
from trabecula.synth.shared.held_fractions import (
    HeldFractions,
    fractions_by_level,
    uneven_part,
    window_at,
)
from trabecula.synth.shared.known_part import has_room_beside
from trabecula.synth.shared.local_offset import NARROWEST, window_of
from trabecula.synth.shared.matching.principal_components import basis_bytes
from trabecula.synth.shared.matching.region import Region, has_cube, regions_of
from trabecula.synth.shared.matching.sources import Stack
from trabecula.synth.shared.novel_schedule import (
    Pass,
    Start,
    has_room,
    is_sliced,
    is_whole,
    passes,
    start_of,
    structure_length,
)
from trabecula.synth.shared.orient import apply_symmetry, symmetries
from trabecula.synth.shared.own_figures import (
    BOX,
    SHAPES,
    SMALL_BOX,
    Figure,
    OwnFigures,
    figure_stages,
    tell_off,
)
from trabecula.synth.shared.patterns.counts import LEAST_VOXELS, MOST_PHASES
from trabecula.synth.shared.patterns.densities import PatternDensities
from trabecula.synth.shared.patterns.flips import FlipRegion, pattern_stages
from trabecula.synth.shared.patterns.labels import match_patterns, shares_of
from trabecula.synth.shared.pictures import ROOM
from trabecula.synth.shared.pyramid import fit_to, halve
from trabecula.synth.shared.slabs import make_by_slabs
from trabecula.synth.shared.small_bodies import body_stages, learn_small_bodies, settle_phases
from trabecula.synth.shared.stages import bound_stages, usage_bytes, value_stages
from trabecula.synth.shared.statistics.density_slopes import (
    DensitySlopes,
    density_slopes,
    density_weights,
    weight_for,
)
from trabecula.synth.shared.statistics.slices import SliceTarget
from trabecula.synth.shared.statistics.two_point import Correlations, correlations_at, soft_mean
from trabecula.synth.shared.turned_exemplars import (
    DIRECTIONS,
    TurnedExemplars,
    copied_voxels,
    turn_exemplars,
)
from trabecula.synth.texture import CAPABILITIES
from trabecula.synth.texture.config import TextureConfig
from trabecula.synth.texture.exemplar_rounds import (
    ExemplarRounds,
    Level,
    grid_stages,
    level_of,
    make_from_patches,
    target_of,
)
from trabecula.synth.texture.final_shape import settle_field, settle_shape, shape_stages
from trabecula.synth.texture.graded import (
    BEYOND,
    average_target,
    check_phases,
    target_fractions,
)
from trabecula.synth.texture.grey_beside import KnownLevels
from trabecula.synth.texture.grey_levels import (
    GreyLevels,
    learn_levels,
    trial_bytes,
)
from trabecula.synth.texture.joined import StrutField, strut_field
from trabecula.synth.texture.scan_phases import ScanPhases, find_phases

# of the windows that tell dense places from sparse ones: structure lengths, voxels at least, and
# so many of them along the exemplar's shortest side
_WINDOW, _NARROWEST, _WINDOWS = 2, 8, 6
_PARTS = 4  # windows along it whose patterns tell how these change with density
_LEAST_LEFT = 1e-6  # of a phase
_FINE = 2.0  # voxels of the structure's length below which a graded result is not smoothed
_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded
_OF_A_COPY = 14  # bytes of an exemplar's voxel in a turned copy, which holds half of them
_EACH, _CHANNEL = 52, 14  # bytes of a voxel, and of its channels, while grey values are learnt
_NAMES = {2: ("dark", "bright"), 3: ("dark", "middle", "bright")}
_PAINTED, _PATCHES = "structure, then grey values", "patches of the exemplar"
_NOT_TOLD = "the grey values tell no phases: they are made from patches of the exemplar (novelty 0)"


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
        labels = exemplars[0].kind == "labels"
        turns = len(symmetries(self.config.orientations, spacing=exemplars[0].spacing))
        size = turns * sum(int(np.prod(shape)) for shape in shapes)
        novelty = self.config.novelty_for(labels=labels)
        start = start_of(exemplars, self.config.layout) if novelty else Start(0)
        top = start.level
        if top and not labels:
            fields = [content_of(exemplars, histogram=False).fields(one) for one in exemplars]
            found = segment_scan(exemplars, fields, self.config.scan_phases)
            if found is not None:
                scan, structures = found
                trial = max(trial_bytes(shape, channels, scan.count) for shape in shapes)
                levels = {"fields": size * (_EACH + _CHANNEL * channels), "trial": trial}
                # its candidates are learnt before, and kept
                structure = dict(self.memory(structures))
                structure["fields"] += size * 4 * channels
                levels["interpreter and kernels"] = _PROCESS
                return max(levels, structure, key=lambda held: sum(held.values()))
        if top and labels:
            each = 8 + 9 * channels
            kinds = [(part.width, part.level) for part in _schedule(self.config, novelty, start)]
        else:  # the second level's neighbourhoods are the ones that are described in full
            each = 14 + 11 * channels
            kinds = [(max(self.config.neighbourhood), 1)]
        basis = max(
            basis_bytes(
                channels * width**3,
                turns
                * sum(
                    int(np.prod([max(1, side // 2**level - width + 1) for side in shape]))
                    for shape in shapes
                ),
            )
            for width, level in kinds
        )
        return {"interpreter and kernels": _PROCESS, "fields": size * each, "basis": basis}


def segment_scan(
    exemplars: Sequence[Image], fields: Sequence[np.ndarray], way: str
) -> tuple[ScanPhases, list[Image]] | None:
    """Return the phases that grey values or colours tell (`find_phases`) with the exemplars as
    labels; None where they tell none.
    """
    scan = find_phases(fields, isotropic_scale(exemplars[0].spacing), way=way)
    if scan is None:
        return None
    labels = [
        with_values(
            exemplar,
            scan.structure_of(field),
            recipe=exemplar.recipe,
            kind="labels",
            phases=_NAMES[scan.count],
        )
        for exemplar, field in zip(exemplars, fields, strict=True)
    ]
    return scan, labels


class TextureModel(Model):
    """Exemplars as a pyramid of fields with the neighbourhoods of every level."""

    capabilities = CAPABILITIES
    config: TextureConfig

    copies: TurnedExemplars | None = None
    """What the exemplars are, where they were turned and scaled for a request."""

    def __init__(self, config: TextureConfig, exemplars: Sequence[Image]) -> None:
        super().__init__(config, exemplars)
        held = config.histogram or config.iso_value == "fraction"
        self.content: Content = content_of(exemplars, field=config.field, histogram=held)
        self.novelty = config.novelty_for(labels=exemplars[0].kind == "labels")
        turns = symmetries(config.orientations, spacing=exemplars[0].spacing)
        fields = [self.content.fields(exemplar) for exemplar in exemplars]
        smallest = min(min(exemplar.shape) for exemplar in exemplars)
        self.start = start_of(exemplars, config.layout) if self.novelty else Start(0)
        self.painted: Painted | None = None
        if self.top and not self.content.distances:
            self.painted = self._learn_painted(fields)
            self.start = Start(0)
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
        elif self.painted is None:
            self.learnt = self._levels()

    @property
    def top(self) -> int:
        """Return the level that new material is laid out on; 0: there is none."""
        return self.start.level

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
        schedule = _schedule(self.config, self.novelty, self.start)
        self.aims = [
            novel_layout.aims_of(
                self.stacks[index], self._own[index], index, edges, schedule, self.config
            )
            for index in range(self.top + 1)
        ]
        self.slices = novel_layout.slices_for(self._own[self.top], self.config.layout)
        assert isinstance(self.content, Labels)  # novelty is for labels
        counted = self.content.present if is_whole(self.config.layout) else ()
        self.small = {label: learn_small_bodies(self.exemplars, label) for label in counted}

    def _learn_painted(self, fields: Sequence[np.ndarray]) -> Painted | None:
        """Learn the structure of grey values or colours as labels, and the levels on it; None where
        they tell no phases.
        """
        edges, way = isotropic_scale(self.exemplars[0].spacing), self.config.scan_phases
        found = segment_scan(self.exemplars, fields, way)
        if found is None:
            notify(_NOT_TOLD)
            return None
        scan, labels = found
        if scan.count > 2:
            levels = " and ".join(f"{self._level_of(one):g}" for one in scan.thresholds)
            notify(f"the grey values tell {scan.count} phases, split at {levels}")
        structures = [image.values for image in labels]
        products = way == "found"
        targets = self._histograms_by_phase(structures, scan.count) if products else ()

        def match(votes: np.ndarray, structure: np.ndarray) -> np.ndarray:
            values = self._values_on(votes, structure, Request(structure.shape), targets)
            return self.content.fields(with_values(self.exemplars[0], values))

        return Painted(
            TextureModel(self.config, labels),
            learn_levels(fields, structures, scan, edges, match, products=products),
            targets,
        )

    def _level_of(self, level: float) -> float:
        """Return the grey value, or luminance, of a level of the field, to three digits."""
        assert isinstance(self.content, Values)
        low, high = self.content.low, self.content.high
        return float(f"{low + (level + FULL) * (high - low) / (2 * FULL):.3g}")

    def _histograms_by_phase(
        self, structures: Sequence[np.ndarray], count: int
    ) -> tuple[tuple[Histogram, ...], ...]:
        """Return the histograms of the channels in every phase of the exemplars."""
        channels = 3 if self.exemplars[0].kind == "colour" else 1
        pairs = list(zip(self.exemplars, structures, strict=True))
        pooled = [
            np.concatenate([one.values[at == phase].reshape(-1, channels) for one, at in pairs])
            for phase in range(count)
        ]
        return tuple(tuple(Histogram.of(values) for values in part.T) for part in pooled)

    def _values_on(
        self,
        votes: np.ndarray,
        structure: np.ndarray,
        request: Request,
        targets: Sequence[Sequence[Histogram]],
    ) -> np.ndarray:
        """Return grey values or colours of votes, with the histogram of every phase where there are
        `targets`.
        """
        if not targets:
            return self.content.to_values(votes, request)
        values = values_by_phase(votes, structure, targets, free_voxels(request))
        return complete(values, request, empty=0)

    def _known_levels(self, request: Request) -> KnownLevels | None:
        """Return the grey values or colours of a request that are known."""
        if request.fixed is None or request.known is None:
            return None
        assert isinstance(self.content, Values)
        fields = self.content.fields_of
        return KnownLevels(request.fixed.values, request.known, fields, request.periodic)

    def _structure_request(self, request: Request, known: KnownLevels | None) -> Request:
        """Return what is asked of the structure of grey values or colours."""
        if known is None or self.painted is None or request.fixed is None:
            return replace(request, mask=None)
        scan = self.painted.grey.scan
        labels = with_values(
            request.fixed,
            known.structure(scan),
            recipe=request.fixed.recipe,
            kind="labels",
            phases=_NAMES[scan.count],
        )
        return replace(request, mask=None, fixed=labels)

    def _quantise(self, field: np.ndarray, index: int) -> np.ndarray:
        """Round a field of level `index` to int8: a distance counts in the voxels of its level, a
        grey value is unchanged.
        """
        if self.content.distances:
            return quantise(field, clip=self.config.clip, unit=2**index)
        return quantise(field, clip=FULL)

    def make(self, request: Request) -> tuple[np.ndarray, dict[str, Any]]:
        values, report = self._make(request)
        figures = self._compare(values, request)
        if figures:
            report |= tell_off(figures, self._advice(figures))
        return values, report

    def _advice(self, figures: Mapping[str, Figure]) -> str:
        """Return what may bring shapes nearer that are off, where it was not tried."""
        shapes = any(one.is_off for name, one in figures.items() if name.startswith(SHAPES))
        by_sweeps = self.top and not is_sliced(self.config.layout)
        if not (shapes and by_sweeps and self.config.search == "coherent"):
            return ""
        return (
            "; shapes may come nearer with search=leaves (--effort 2 tries it), those of grains by "
            "--method packing, of fibres by --method fibres"
        )

    def _compare(self, values: np.ndarray, request: Request) -> dict[str, Figure]:
        """Return cheap figures of a result over those of the exemplar; none where the result is to
        differ from it, or is made of several or of grey values.
        """
        if not self._compares(request) or self._own_figures is None:
            return {}
        return self._own_figures.compare(self.exemplars[0], values)

    def _compares(self, request: Request) -> bool:
        alone = len(self.exemplars) == 1 and isinstance(self.content, Labels)
        return alone and not request.asks_for() - {"periodic"}

    def _figure_stages(self, request: Request) -> tuple[Stage, ...]:
        """Declare the comparison of a result with the exemplar."""
        if not self._compares(request):
            return ()
        return figure_stages(request.shape, self.exemplars[0].shape, box=self._figure_box)

    @cached_property
    def _own_figures(self) -> OwnFigures | None:
        """Measure the exemplar and its parts."""
        return OwnFigures.of(self.exemplars[0], box=self._figure_box)

    @property
    def _figure_box(self) -> int:
        return BOX if self.top else SMALL_BOX

    def _make(self, request: Request) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the values of a request and a report, without its figures."""
        report: dict[str, Any] = {}
        if frame_of(request.target) and self.copies is None:
            return self._make_turned(request)
        new = self._makes_new(request)
        if new and self.painted is not None:
            known = self._known_levels(request)
            held = self._structure_request(request, known)
            structure, made = self.painted.structure.make(held)
            votes = self.painted.grey.paint(structure, request, known)
            values = self._values_on(votes, structure, request, self.painted.targets)
            phases = self.painted.grey.scan.count
            return values, {"way": _PAINTED, "phases": phases, **made}
        patterns = self._patterns_for(request) if new and self._matches_patterns(request) else None
        shares = shares_of(patterns)
        with part_of(shares, 0):
            votes = fit_to(self._make_votes(request, report, new=new), request.shape)
        with part_of(shares, 1):
            return self._finish_votes(votes, request, report, new=new)

    def _make_votes(self, request: Request, report: dict[str, Any], *, new: bool) -> np.ndarray:
        """Return the votes that rounds end with; energies are reported."""
        if new:
            return novel_layout.make_novel(
                self._novel_rounds(
                    request, self._regions_around(request), self._held_fractions(request)
                )
            )
        used = levels_for(request.shape, len(self.levels), width=max(self.config.neighbourhood))
        # no array is held by a name here: the run frees what it no longer needs
        votes, energies = make_from_patches(
            ExemplarRounds(
                self.levels[:used],
                regions_of(request, used, self._bounds(request), self._quantise),
                request,
                self.config,
                distances=self.content.distances,
                targets=self.targets,
                fractions=self._fractions(request, used),
                struts=self._struts if request.target else (),
                copies=self.copies,
                window=self._held_width if request.target else NARROWEST,
            )
        )
        if energies:
            report["levels"] = energies
        return votes

    def _finish_votes(
        self, votes: np.ndarray, request: Request, report: dict[str, Any], *, new: bool
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the values that votes end as, and the report with what was done."""
        if self._settles(request, new=new):
            values, report["graded"] = self._settle_shape(votes, request, new=new)
            return values, report
        if new and self.small:
            report["small_bodies"] = self._settle_bodies(votes, request)
        if request.target and isinstance(self.content, Labels):
            request = average_target(request)
        if self.novelty and not new:
            report["way"] = _PATCHES
        values = self.content.to_values(votes, request)
        if new and self._matches_patterns(request):
            values, report["patterns"] = self._match_patterns(values, votes, request)
        return values, report

    def _matches_patterns(self, request: Request) -> bool:
        """Return whether single voxels of new material change phase in the end: where the exemplars
        are large enough to tell their patterns; of three phases not where these are to differ from
        the exemplar's.
        """
        if not isinstance(self.content, Labels) or not self.config.interface_rounds:
            return False
        count = len(self.content.present)
        size = sum(exemplar.values.size for exemplar in self.exemplars)
        few = count <= (2 if request.target else MOST_PHASES)
        return few and size >= LEAST_VOXELS * count**8

    @cached_property
    def _patterns(self) -> PatternDensities:
        """Measure the patterns of the exemplars."""
        return PatternDensities.of(*self._phases(), balls=self.config.interface_balls)

    @cached_property
    def _patterns_by_fraction(self) -> PatternDensities:
        """Measure those of their denser and sparser places as well."""
        phases, count = self._phases()
        shortest = min(min(one.shape) for one in phases)
        width = max(self._window(0), shortest // _PARTS)
        return PatternDensities.by_fraction(phases, count, width)

    def _phases(self) -> tuple[list[np.ndarray], int]:
        """Return the exemplars' phases, counted from 0, and their number."""
        assert isinstance(self.content, Labels)
        present = self.content.present
        return [phases_of(one.values, present) for one in self.exemplars], len(present)

    def _patterns_for(self, request: Request) -> PatternDensities:
        """Return the patterns that flips bring a result to: without balls beside known voxels."""
        patterns = self._patterns_by_fraction if request.target else self._patterns
        return patterns if request.fixed is None else patterns.without_balls()

    def _match_patterns(
        self,
        values: np.ndarray,
        votes: np.ndarray,
        request: Request,
        fractions: np.ndarray | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return labels whose patterns are the exemplar's, or those of its places of such
        fractions, and a report.
        """
        assert isinstance(self.content, Labels)
        graded, free = bool(request.target), free_voxels(request)
        return match_patterns(
            values,
            votes,
            self.content,
            request,
            self._patterns_for(request),
            FlipRegion(request.periodic, free, request.mask, graded, fractions, self._held_width),
            rounds=self.config.interface_rounds,
            clip=self.config.clip,
        )

    def _make_turned(self, request: Request) -> tuple[np.ndarray, dict[str, Any]]:
        """Make material that follows an orientation or a size, from turned and scaled copies."""
        assert isinstance(self.content, Labels)
        frames = frames_of(request.target, DIRECTIONS)
        least = max(self.config.neighbourhood) + ROOM
        copies = turn_exemplars(self.exemplars, frames, least=least)
        model = TextureModel(replace(self.config, novelty=0.0, orientations="none"), copies.images)
        model.copies, model._struts = copies, self._struts
        target = dict(request.target)
        if porosity_of(target) is None:
            own = self.content.fractions[self.content.present.index(self.content.empty)]
            target["porosity"] = float(own)
        values, report = model.make(replace(request, target=target))
        return values, {**report, "copies": len(copies.images)}

    def _novel_rounds(
        self,
        request: Request,
        around: Sequence[Region] = (),
        held: Sequence[HeldFractions] = (),
    ) -> novel_layout.NovelRounds:
        top, steps = self._top_for(request), novel_layout.takes_steps(request, self.config.layout)
        start = replace(self.start, level=top)
        schedule = _schedule(self.config, self.novelty, start, beside=not steps)
        aims, slices = self.aims[: top + 1], self.slices
        if request.target:
            aims, slices = self._at_target(
                average_target(request, free=True) if _is_field(request) else request
            )
        config = self.config
        if self._matches_patterns(request) and not config.vote_power:
            config = replace(config, vote_power=1.0)  # Euler numbers are met in the end
        return novel_layout.NovelRounds(aims, slices, schedule, request, config, around, held)

    def _held_fractions(self, request: Request) -> list[HeldFractions]:
        """Return the fractions that new material holds around every place, finest first; none where
        the target is one number.
        """
        if not _is_field(request):
            return []
        top, mask = self._top_for(request), request.mask
        found = []
        for level, fractions in enumerate(self._fractions(request, top + 1)):
            if level and mask is not None:
                mask = Region(mask.shape, request.periodic, mask).halve().free
            aims, width = self.aims[level], window_at(self._held_width, level)
            mean = soft_mean(aims.histograms[0], aims.correlations.softness)
            uneven = self._uneven[level]
            found.append(HeldFractions(fractions, width, uneven, mean, request.periodic, mask))
        return found

    @cached_property
    def _uneven(self) -> list[np.ndarray]:
        """Measure what every level loses of its two-point functions where windows are even."""
        return [
            uneven_part(own, aims.correlations, window_at(self._held_width, level))
            for level, (own, aims) in enumerate(zip(self._own, self.aims, strict=False))
        ]

    def _top_for(self, request: Request) -> int:
        """Return the level that a request is laid out on. Without steps on the two-point function
        what rounds from noise make on level 2 does not meet known voxels.
        """
        if request.known is None or is_sliced(self.config.layout):
            return self.top
        steps = novel_layout.takes_steps(request, self.config.layout)
        roomy = steps and has_room(request.shape, self.top)
        return self.top if roomy and has_room_beside(request.known, self.top) else min(self.top, 1)

    def _at_target(self, request: Request) -> tuple[list[novel_layout.Aims], SliceTarget | None]:
        """Return the targets of material with a target porosity: those of the exemplar's denser or
        sparser places as far as these go, and from there on values inside a phase become more or
        less frequent.
        """
        assert isinstance(self.content, Labels)
        asked = self.content.fractions_of_target(request)
        assert asked is not None  # the only target there is
        own, slopes = self.content.fractions, self._slopes
        t = weight_for(slopes, float(asked[1] - own[1]))
        reached = np.clip(own + np.array([-1, 1]) * t * slopes[0].fraction, _LEAST_LEFT, 1)
        aims = [
            novel_layout.at_density(one, slope, t)
            for one, slope in zip(self.aims, slopes, strict=True)
        ]
        aims = [
            novel_layout.with_histograms(one, self.content.reweight(one.histograms, reached, asked))
            for one in aims
        ]
        if self.slices is None:
            return aims, None
        coarsest = self._own[self.top]
        weights = [1 + t * g for g in density_weights(coarsest, self._window(self.top))]
        return aims, novel_layout.slices_for(coarsest, self.config.layout, weights)

    @cached_property
    def _slopes(self) -> list[DensitySlopes]:
        """Measure how the targets of every level that is laid out change with density."""
        return [
            density_slopes(own, aims.correlations, width=self._window(level))
            for level, (own, aims) in enumerate(zip(self._own, self.aims, strict=False))
        ]

    def _window(self, level: int) -> int:
        """Return the width of the windows that tell dense places from sparse ones."""
        shortest = min(min(exemplar.shape) for exemplar in self.exemplars)
        width = min(max(_WINDOW * self._length, _NARROWEST), shortest / _WINDOWS)
        return max(round(width / 2**level), 2)

    def _bounds(self, request: Request) -> Bounds | None:
        """Return the bounds that known voxels set to the field."""
        return self.content.bounds(request, least=self.config.beyond_known)

    def _regions_around(self, request: Request) -> list[Region]:
        """Return the regions of new material beside known voxels, finest first; none where nothing
        is known. A mask cuts the result in the end.
        """
        bounds = self._bounds(request)
        if bounds is None:
            return []
        levels = self._top_for(request) + 1
        return regions_of(replace(request, mask=None), levels, bounds, self._quantise)

    @cached_property
    def _struts(self) -> list[StrutField | None]:
        """Measure the solid that is to be one component, on every level; empty where none is."""
        if self.config.connected == "none" or not isinstance(self.content, Labels):
            return []
        upper, clip = self.content.present[0] == self.content.empty, self.config.clip
        found = [strut_field(stack, upper=upper, clip=clip) for stack in self.stacks]
        if found[0] is None and self.config.connected == "solid":
            found[0] = strut_field(self.stacks[0], upper=upper, clip=clip, whole=0.0)
        return found if found[0] is not None else []

    def _settles(self, request: Request, *, new: bool) -> bool:
        """Return whether the last shape is to meet a target around every place: of one number new
        material is alike everywhere.
        """
        by_place = bool(request.target) and self.config.grading != "shift"
        return by_place and (not new or _is_field(request))

    def _settle_shape(
        self, votes: np.ndarray, request: Request, *, new: bool
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the result's values where a target holds around every place, and a report."""
        assert isinstance(self.content, Labels)
        bounds = self._bounds(request)
        region = regions_of(request, 1, bounds, self._quantise)[0]
        fractions = target_fractions(request, self.content.present, self.content.empty)
        struts = self._struts[0] if self._struts else None
        settle = partial(
            settle_field if new else settle_shape,
            *(votes, region, fractions, struts),
            unit=FULL / self.config.clip,
            window=self._held_width,
            smooth=self._length >= _FINE,
        )
        if new:
            place = partial(self._settle_bodies, request=average_target(request, free=True))
            match = self._match_upper if self._matches_patterns(request) else None
            if match is not None:
                match = partial(match, request=request, fractions=fractions)
            upper, report = settle(place=place, match=match)
        else:
            upper, report = settle()
        return self.content.from_upper(upper, request), report

    def _match_upper(
        self, upper: np.ndarray, votes: np.ndarray, request: Request, fractions: np.ndarray
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Do `_match_patterns` where the second phase is marked, (Z, Y, X) bool."""
        assert isinstance(self.content, Labels)
        values = self.content.from_upper(upper, request)
        values, report = self._match_patterns(values, votes, request, fractions)
        second = self.content.present[1]
        return make_by_slabs(lambda a, b: values[a:b] == second, values.shape, bool), report

    def _settle_bodies(self, votes: np.ndarray, request: Request) -> dict[str, Any]:
        """Bring small bodies to their numbers, in votes (C, Z, Y, X); return what was done."""
        assert isinstance(self.content, Labels)
        return settle_phases(votes, self.content, self.small, request, name="texture")

    @property
    def _held_width(self) -> int:
        """Return the width of the windows whose fraction is held, voxels."""
        return window_of(self._length)

    @cached_property
    def _length(self) -> float:
        """Measure the structure's length, voxels."""
        return structure_length(self.exemplars)

    def _fractions(self, request: Request, count: int) -> list[np.ndarray]:
        """Return the target's volume fractions on each level; empty where there is none."""
        if not request.target or not isinstance(self.content, Labels):
            return []
        shares = target_fractions(request, self.content.present, self.content.empty)
        return fractions_by_level(shares, self.stacks[:count])

    def _makes_new(self, request: Request) -> bool:
        """Return whether there is room to lay out something new, beside known voxels as well, and
        no target that holds around every place, or beside known voxels.
        """
        if frame_of(request.target):
            return False
        whole = is_whole(self.config.layout)
        if _is_field(request):
            held = self.config.grading == "held" and not is_sliced(self.config.layout)
            whole = whole and held and isinstance(self.content, Labels)
        laid_out = self if self.painted is None else self.painted.structure
        top = laid_out._top_for(request)
        if not top or not has_room(request.shape, top):
            return False
        if request.known is None:
            return whole or not request.target
        takes = not request.target or (
            _is_field(request) and novel_layout.takes_steps(request, self.config.layout)
        )
        return whole and takes and has_room_beside(request.known, top)

    def _check_request(self, request: Request) -> None:
        super()._check_request(request)
        width = min(self.config.neighbourhood)
        if request.mask is not None and not has_cube(request.mask, width):
            raise RequestError(
                f"the mask nowhere has room for a neighbourhood of {width} voxels: voxelise it "
                "at a finer spacing, or "
                "choose a smaller neighbourhood (--set neighbourhood=4)"
            )

    def _check_target(self, request: Request) -> None:
        check_target_porosity(request.target, self.exemplars, mask=request.mask, beyond=BEYOND)
        if request.target and isinstance(self.content, Labels):
            check_phases(self.content.present, self.content.empty)
        if frame_of(request.target):
            self._check_frame(request)

    def _check_frame(self, request: Request) -> None:
        """Raise where material cannot follow a direction or a size."""
        named = " and ".join(name for name in FRAME if name in request.target)
        if not isinstance(self.content, Labels):
            raise RequestError(
                f"the target {named} is honoured for labels, the exemplar is of grey values or "
                "colours: segment it (tb.segment)"
            )
        if self.config.grading == "shift":
            raise RequestError(f"the target {named} needs grading=held or feedback, it is shift")

    def memory(self, request: Request) -> Mapping[str, int]:
        return forecast(self._stages(request), self._fixed(request)).memory

    def resident_memory(self, request: Request) -> Mapping[str, int]:
        return resident(self._stages(request, mapped=True), self._fixed(request))

    def _stages(self, request: Request, *, mapped: bool = False) -> tuple[Stage, ...]:
        """Declare the arrays of a run that compete for the peak: those of new material, or of the
        finest level; of known voxels before it, and of the result after it.
        """
        distances = self.content.distances
        new = self._makes_new(request)
        if new and self.painted is not None:
            structure, grey = self.painted.structure, self.painted.grey
            shape = request.shape
            held = {"known phases": Array(shape, np.uint8) if request.fixed is not None else None}
            return (
                *within(held, structure._stages(replace(request, mask=None), mapped=mapped)),
                *within(held, grey.stages(request)),
                *within(
                    {**held, "structure": Array(shape, np.uint8)},
                    value_stages(
                        request,
                        shape,
                        grey.channels,
                        nbytes=self.output_bytes(request) + int(np.prod(shape)),
                        distances=False,
                    ),
                ),
            )
        if new:
            rounds = self._novel_rounds(request)
            finest, region = self.aims[0].candidates, Region(rounds.shapes[0], (True,) * 3)
            stages = rounds.stages(mapped=mapped)
            if self.small:
                stages += body_stages(
                    request.shape, len(finest[-1].stack.field), known=request.fixed is not None
                )
            if self._matches_patterns(request):
                stages += pattern_stages(
                    request.shape,
                    len(finest[-1].stack.field),
                    free=free_voxels(request) is not None,
                )
        else:
            region, finest = Region(request.shape, request.periodic), self.levels[0]
            target = target_of(0, request, self.config, self.targets)
            stages = tuple(
                chain.from_iterable(
                    grid_stages(
                        request,
                        region,
                        candidates,
                        self.config,
                        target,
                        refit=number > 0,
                        mapped=mapped,
                    )
                    for number, candidates in enumerate(finest)
                )
            )
        if self._settles(request, new=new):
            known = request.fixed is not None
            stages += shape_stages(request.shape, known=known, masked=request.mask is not None)
        last = finest[-1]
        covered = region.cover(box=last.basis.box, steps=last.steps)
        channels = len(last.stack.field)
        return (
            *bound_stages(request, channels, distances=distances),
            *stages,
            *value_stages(
                request,
                covered.shape,
                channels,
                nbytes=self.output_bytes(request),
                distances=isinstance(self.content, Labels),
            ),
            *self._figure_stages(request),
        )

    def _fixed(self, request: Request) -> dict[str, int]:
        """Return the bytes that do not depend on the request's shape."""
        fixed = self._held()
        if frame_of(request.target):
            frames = frames_of(request.target, DIRECTIONS)
            fixed["turned copies"] = _OF_A_COPY * copied_voxels(self.exemplars, frames)
        return fixed

    def _held(self) -> dict[str, int]:
        """Return the bytes of the model."""
        exact = self.config.search == "exact"
        if self.painted is not None and self.learnt is None:
            fixed = self.painted.structure._held()
            fields = sum(stack.field.nbytes for stack in self.stacks)
            return fixed | {"exemplar": fixed["exemplar"] + fields + self.painted.grey.nbytes}
        kept = [c for aim in self.aims for c in aim.candidates] if self.top else []
        kept += [c for level in self.learnt or [] for c in level]
        searched = 3 if exact else 1  # prepared for it, in another order
        fields = sum(stack.field.nbytes for stack in self.stacks)
        # beside its features a candidate has its number, and a place in a tree and in its making
        each = 24 if self.config.search == "leaves" else 9
        held = sum(searched * c.features.nbytes + each * c.allowed.nbytes for c in kept)
        usage = usage_bytes(kept, exact=exact)
        raised = self.stacks[0].field.nbytes if self.top and self.config.vote_power != 1 else 0
        exemplar = fields + held + raised
        return {"interpreter and kernels": _PROCESS, "exemplar": exemplar} | usage


def _is_field(request: Request) -> bool:
    """Return whether a target varies from place to place."""
    return any(map(np.ndim, request.target.values()))


def _schedule(
    config: TextureConfig, novelty: float, start: Start, *, beside: bool = False
) -> tuple[Pass, ...]:
    """Return the passes of new material."""
    by_leaves = config.search == "leaves"
    return passes(novelty, start, config.layout, by_leaves=by_leaves, beside=beside)


@dataclass(frozen=True)
class Painted:
    """What grey values or colours are made of: the model of their structure as labels, and the
    levels on it, and the histograms of the channels in every phase (none: of all together).
    """

    structure: TextureModel
    grey: GreyLevels
    targets: tuple[tuple[Histogram, ...], ...]

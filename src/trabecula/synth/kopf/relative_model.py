"""From a relative in space to a volume: its neighbourhoods in three dimensions, the picture's
two-point function, interface and fraction.

The rounds are those of new material from a scan (`shared.novel_layout`): a layout by sliced rounds,
then search and vote with cubes, each followed by steps on the two-point function. Their target is
the relative's own soft two-point function, changed by what the picture's differs from it: distances
in a plane are not those in space, so soft functions of the two are not alike, those of 0 and 1 are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.progress import part_of
from trabecula.core.request import Request
from trabecula.engine.memory import Stage
from trabecula.exemplar.views import View
from trabecula.synth.kopf.config import RelativeSettings
from trabecula.synth.kopf.relative import AdaptedRelative, SliceStatistics, adapt_relative
from trabecula.synth.shared import novel_layout
from trabecula.synth.shared.content.fields import quantise
from trabecula.synth.shared.content.kinds import Labels, content_of
from trabecula.synth.shared.content.phase_fractions import phases_of
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Stack
from trabecula.synth.shared.novel_schedule import LEAST, Pass, passes, start_of
from trabecula.synth.shared.patterns.counts import LEAST_VOXELS
from trabecula.synth.shared.patterns.densities import PatternDensities
from trabecula.synth.shared.patterns.flips import FlipRegion, pattern_stages
from trabecula.synth.shared.patterns.labels import match_patterns, shares_of
from trabecula.synth.shared.patterns.planes import PlanePatterns
from trabecula.synth.shared.pyramid import fit_to, halve
from trabecula.synth.shared.small_bodies import (
    SmallBodies,
    body_stages,
    learn_small_bodies,
    settle_phases,
)
from trabecula.synth.shared.stages import value_stages
from trabecula.synth.shared.statistics.pairs import LINES
from trabecula.synth.shared.statistics.slices import SliceTarget
from trabecula.synth.shared.statistics.two_point import Correlations

_LAYOUT_BYTES = 120  # of a voxel of the relative while it is learnt, besides what is kept


@dataclass(frozen=True)
class RelativeModel:
    """What is learnt from a relative and pictures."""

    adapted: AdaptedRelative
    aims: tuple[novel_layout.Aims, ...]
    slices: SliceTarget | None
    schedule: tuple[Pass, ...]
    small: Mapping[int, SmallBodies]
    settings: RelativeSettings
    patterns: PatternDensities | PlanePatterns | None = None

    @classmethod
    def of(
        cls,
        like: Image,
        views: Sequence[View],
        present: Sequence[int],
        process: Mapping[str, Any] | None = None,
        fraction: float | None = None,
        shown: PlanePatterns | None = None,
        rounds: int = 0,
    ) -> RelativeModel:
        """Learn a relative; of that of a `process`, what is to stand in the report as well. With
        another `fraction` of the second phase than in the pictures its interface is shifted, and
        what the picture's statistics differ from its own stays as it was.

        Voxels are flipped in the end, in so many `rounds`, towards the relative's patterns that
        are nearest to those `shown`; of a process towards those that its volume ends with, which
        are nearest to these, since its own bring no figure nearer to a scan's.

        A process keeps its own two-point function. Steps towards the picture's bring it no nearer
        (two slices of Berea, 96^3: relative l2 of the covariance .19 and .18, with them or without)
        and leave fringes, of which loops come (Euler density -226 and -328, without them -134 and
        -174; the scan's is -70).

        Raises
        ------
        RequestError
            As `adapt_relative`, and a fraction that is far from the pictures'.
        """
        adapted = adapt_relative(like, views, present)
        if fraction is not None:
            adapted = adapted.at_fraction(fraction, present)
        settings = RelativeSettings() if process is None else RelativeSettings(layout="rounds")
        if rounds:
            settings = replace(settings, interface_rounds=rounds)
        start = start_of([adapted.image], settings.layout)
        schedule = passes(1.0, start, settings.layout)
        field = content_of([adapted.image]).fields(adapted.image)
        aims = []
        for level in range(start.level + 1):
            own = quantise(field, clip=settings.clip, unit=2**level)
            edges = (1.0, 1.0, 1.0)
            learnt = novel_layout.aims_of(Stack.of([own]), [own], level, edges, schedule, settings)
            aims.append(_aim_at_picture(learnt, level, adapted, curves=process is None))
            field = halve(field)
        small = {label: learn_small_bodies([adapted.image], label) for label in present}
        slices = novel_layout.slices_for([own], settings.layout)
        told = {**adapted.report, **(process or {})}
        patterns: PatternDensities | PlanePatterns | None = None
        if process is not None:
            patterns = shown
        elif adapted.image.values.size >= LEAST_VOXELS * 2**8:
            order = tuple(present)
            patterns = PatternDensities.of([phases_of(adapted.image.values, order)], 2)
            if shown is not None:
                patterns = shown.nearest_to(patterns)
            elif fraction is None:
                patterns = patterns.with_chords(PlanePatterns.of(views, order).chords)
        adapted = replace(adapted, report=told)
        return cls(adapted, tuple(aims), slices, schedule, small, settings, patterns)

    @property
    def top(self) -> int:
        """Return the level that sliced rounds lay out."""
        return len(self.aims) - 1

    def check(self, request: Request) -> None:
        """Raise where a periodic axis is too short to be laid out."""
        least = self._least
        for axis, side, wraps in zip("zyx", request.shape, request.periodic, strict=True):
            if wraps and side < least:
                raise RequestError(
                    f"the shape is {request.shape}, beside a relative a periodic axis has at least "
                    f"{least} voxels: make {axis} longer, or leave it out of periodic"
                )

    @property
    def _least(self) -> int:
        """Return the voxels along an axis that a layout needs."""
        return LEAST * 2**self.top

    def rounds(self, request: Request) -> novel_layout.NovelRounds:
        """Prepare a run, of a longer volume where an axis is too short. A mask cuts the result in
        the end.
        """
        shape = tuple(max(side, self._least) for side in request.shape)
        roomy = replace(request, shape=shape, mask=None)
        return novel_layout.NovelRounds(self.aims, self.slices, self.schedule, roomy, self.settings)

    def make(self, request: Request, content: Labels) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the values of a request, with the fractions of `content`, and a report."""
        shares = shares_of(self.patterns)
        with part_of(shares, 0):
            votes = fit_to(novel_layout.make_novel(self.rounds(request)), request.shape)
        with part_of(shares, 1):
            settled = settle_phases(votes, content, self.small, request, name="kopf")
            values = content.to_values(votes, request)
            report = {**self.adapted.report, "small_bodies": settled}
            if self.patterns is not None:
                values, report["patterns"] = self._match_patterns(values, votes, request, content)
            return values, {"like": report}

    def _match_patterns(
        self, values: np.ndarray, votes: np.ndarray, request: Request, content: Labels
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Return labels with the patterns of relative and pictures, and a report."""
        assert self.patterns is not None
        return match_patterns(
            values,
            votes,
            content,
            request,
            self.patterns,
            FlipRegion(request.periodic, request.mask, request.mask),
            rounds=self.settings.interface_rounds,
            clip=self.settings.clip,
        )

    def stages(self, request: Request, *, nbytes: int, mapped: bool = False) -> tuple[Stage, ...]:
        """Declare the arrays of a run whose result takes `nbytes`."""
        rounds, last = self.rounds(request), self.aims[0].candidates[-1]
        covered = Region(rounds.shapes[0], (True,) * 3).cover(box=last.basis.box, steps=last.steps)
        return (
            *rounds.stages(mapped=mapped),
            *body_stages(request.shape, 1, known=False),
            *self._pattern_stages(request),
            *value_stages(request, covered.shape, 1, nbytes=nbytes, distances=True),
        )

    def _pattern_stages(self, request: Request) -> tuple[Stage, ...]:
        if self.patterns is None:
            return ()
        return pattern_stages(request.shape, 1, free=request.mask is not None)

    @property
    def nbytes(self) -> int:
        """Return the bytes that are held."""
        kept = [candidates for aim in self.aims for candidates in aim.candidates]
        fields = sum(aim.stack.field.nbytes for aim in self.aims)
        held = sum(c.features.nbytes + 9 * c.allowed.nbytes for c in kept)
        return fields + held + (_LAYOUT_BYTES + 4) * self.adapted.image.values.size


def _aim_at_picture(
    aims: novel_layout.Aims, level: int, adapted: AdaptedRelative, *, curves: bool
) -> novel_layout.Aims:
    """Return the targets of a level with the picture's interface, and with its two-point
    function where `curves` are its own.
    """
    moved = aims.correlations
    if curves:
        moved = _move_target(moved, level, adapted.own, adapted.picture)
    share = aims.interface
    if share is not None:
        share = share * (adapted.picture.interface / adapted.own.interface)
    return replace(aims, correlations=moved, interface=share)


def _move_target(
    target: Correlations, level: int, own: SliceStatistics, picture: SliceStatistics
) -> Correlations:
    """Add what the pictures' two-point function is above the relative's, along an axis or on the
    mean of those that a diagonal lies between.

    Below a correlation length less and less of it, and nothing at 0: there it is the interface's,
    of which soft functions see little. Steps that aim at all of it draw fringes and loops (Berea,
    64^3: Euler density 2.5 times that of the relative).
    """
    reach = min(own.two_point.shape[1], picture.two_point.shape[1]) - 1
    change = picture.two_point[:, : reach + 1] - own.two_point[:, : reach + 1]
    change -= change[:, :1] * np.ones(reach + 1)  # the fractions differ by a voxel at most
    change[:, reach] = 0
    distances = np.arange(target.r_max + 1) * 2**level * target.blocks
    share = np.minimum(1, distances / np.mean(picture.lengths))
    along = [share * np.interp(distances, np.arange(reach + 1), line, right=0.0) for line in change]
    rows = [
        np.mean([line for line, step in zip(along, way, strict=True) if step], axis=0)
        for way in LINES
    ]
    return replace(target, curves=target.curves + np.concatenate(rows))

"""New material rather than moved patches: the way of `texture` with `novelty`, and of a picture
beside a relative in space.

It begins with noise on a coarse level. Rounds of search and vote with wide neighbourhoods give it
bodies of the exemplar's shapes, on finer levels a few with narrow ones the exemplar's interfaces.
After each a step on the two-point function keeps what neighbourhoods lose, and a step on long waves
keeps the material as even as the exemplar. All of it on a torus, so that no place is special: an
axis that is not to repeat is cut to its length.

In the layouts of before ("structure", and "coarse" before that) sliced rounds made the coarse level
instead. They copy nothing, and they know neighbourhoods by histograms alone: bodies come out as
those of a random field.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, Protocol

import numpy as np

from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.memory import Array, Stage, Workspace, within
from trabecula.synth.shared.coarse_to_fine import CoarseToFine, RoundStage
from trabecula.synth.shared.content.fields import noise, votes_of
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.held_fractions import HeldFractions, hold_field
from trabecula.synth.shared.known_part import (
    KnownPart,
    hold_move,
    is_a_sample,
    known_stages,
    shares_beside,
)
from trabecula.synth.shared.local_offset import LocalOffset
from trabecula.synth.shared.matching.grid import Grid, coherent_search, random_matches, targets_of
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import cast_votes, match_votes, refine_field
from trabecula.synth.shared.matching.sources import Candidates, Stack, carry_matches
from trabecula.synth.shared.matching.vote_power import (
    lower_votes,
    power_for,
    power_stages,
    raise_distances,
)
from trabecula.synth.shared.novel_schedule import WIDEST, WIDTH, Pass, is_sliced, is_whole
from trabecula.synth.shared.stages import LevelMemory, layout_stages, region_arrays
from trabecula.synth.shared.statistics.density_slopes import DensitySlopes
from trabecula.synth.shared.statistics.euler import euler_densities
from trabecula.synth.shared.statistics.interface import interface_share, share_at, shorten_move
from trabecula.synth.shared.statistics.long_waves import (
    adjust_long_waves,
    long_waves_of,
    wave_stages,
)
from trabecula.synth.shared.statistics.pairs import AXES, DIAGONAL
from trabecula.synth.shared.statistics.sliced import transport_neighbourhoods, transport_stages
from trabecula.synth.shared.statistics.slices import SliceTarget, slice_target
from trabecula.synth.shared.statistics.torus_steps import torus_step, torus_step_stages
from trabecula.synth.shared.statistics.two_point import (
    Correlations,
    Soft,
    correlations_at,
    reweight_target,
    soft_means,
)
from trabecula.synth.shared.statistics.two_point_steps import (
    accumulate_debt,
    step_stages,
    two_point_step,
)

_AROUND = (True, True, True)
_SLICED_WIDTHS = (6, 4)  # of the neighbourhoods of sliced rounds: the first for which there is room
_ROOM = 4
_STRENGTH, _SLICED_STEP = 2.5, 2
_STEP_EVERY = 5  # sliced rounds
# by layout: sliced rounds, and at most so many components of their neighbourhoods
_SLICED = {"coarse": (30, 64), "structure": (20, 32)}


class NovelSettings(Protocol):
    """Settings of a run: the layout ("rounds", "structure" or "coarse"), what is kept of
    neighbourhoods, and how they are searched for and vote.
    """

    @property
    def layout(self) -> str: ...
    @property
    def clip(self) -> float: ...
    @property
    def variance(self) -> float: ...
    @property
    def components(self) -> int: ...
    @property
    def sweeps(self) -> int: ...
    @property
    def tries(self) -> int: ...
    @property
    def index_penalty(self) -> float: ...
    @property
    def robustness(self) -> float: ...
    @property
    def vote_power(self) -> float: ...


@dataclass(frozen=True)
class Aims:
    """Targets of one level, learnt from the exemplars; with an `interface` (C,), the most that
    steps may make of it, and with `euler` (2C,), the Euler densities that votes are to leave.
    """

    stack: Stack
    histograms: tuple[Histogram, ...]
    correlations: Correlations
    candidates: tuple[Candidates, ...]  # one per pass on this level
    interface: np.ndarray | None = None
    euler: np.ndarray | None = None

    def with_targets(self, histograms: tuple[Histogram, ...], correlations: Correlations) -> Aims:
        """Return the targets of material with these histograms and two-point functions."""
        share = self.interface
        if share is not None:
            share = share_at(share, self.correlations, correlations)
        return replace(self, histograms=histograms, correlations=correlations, interface=share)


def aims_of(
    stack: Stack,
    fields: Sequence[np.ndarray],
    level: int,
    edges: tuple[float, ...],
    schedule: Sequence[Pass],
    config: NovelSettings,
) -> Aims:
    """Learn one level; `fields` are the exemplars themselves in int8, without turned copies."""
    whole = is_whole(config.layout)
    correlations = correlations_at(
        fields,
        level,
        edges=edges,
        clip=config.clip,
        directions=DIAGONAL if whole else AXES,
        blocks=2 if whole and level == 0 else 1,
    )
    waves = long_waves_of(fields, level, softness=correlations.softness)
    correlations = replace(correlations, waves=waves)
    made = [
        Candidates.of(
            stack, width=p.width, step=p.step, variance=config.variance, most=config.components
        )
        for p in schedule
        if p.level == level
    ]
    share = interface_share(fields) if whole else None
    choose = whole and level == 0 and not config.vote_power
    euler = euler_densities(fields) if choose else None
    return Aims(stack, stack.histograms, correlations, tuple(made), share, euler)


def with_histograms(aims: Aims, histograms: tuple[Histogram, ...]) -> Aims:
    """Return the targets of one level for material of other volume fractions, whose fields have
    these histograms.
    """
    target = aims.correlations
    reweighted = reweight_target(target, aims.histograms, histograms, softness=target.softness)
    return aims.with_targets(histograms, reweighted)


def at_density(aims: Aims, slopes: DensitySlopes, t: float) -> Aims:
    """Return the targets of one level for places of the exemplar that weigh 1 + t g."""
    histograms = tuple(
        slopes.histogram(own, channel, t) for channel, own in enumerate(aims.histograms)
    )
    found = aims.with_targets(histograms, slopes.correlations(aims.correlations, t))
    euler = None if aims.euler is None else aims.euler + t * slopes.euler
    return replace(found, euler=euler)


def slices_for(
    fields: Sequence[np.ndarray], layout: str, weights: Sequence[np.ndarray] | None = None
) -> SliceTarget | None:
    """Describe the target of the sliced rounds of the coarsest level; None where there are none."""
    if not is_sliced(layout):
        return None
    shortest = min(min(field.shape[1:]) for field in fields)
    fitting = [width for width in _SLICED_WIDTHS if shortest >= width + _ROOM]
    width = fitting[0] if fitting else _SLICED_WIDTHS[-1]
    return slice_target(fields, width=width, most=_SLICED[layout][1], weights=weights)


def torus_shape(request: Request, level: int, top: int) -> tuple[int, ...]:
    """Return the sides of the torus on a level: an open axis is continued to whole voxels of the
    coarsest level, and by a neighbourhood where known voxels at one face would be next to free ones
    at the other.
    """
    return tuple(
        -(-side // 2**level)
        if wraps
        else (-(-side // 2**top) + _margin(request.known, axis, top)) * 2 ** (top - level)
        for axis, (side, wraps) in enumerate(zip(request.shape, request.periodic, strict=True))
    )


def _margin(known: np.ndarray | None, axis: int, top: int) -> int:
    """Return the voxels of level `top` between the two faces of an open axis on the torus."""
    if known is None:
        return 0
    along, reach = np.moveaxis(known, axis, 0), WIDEST * 2**top
    return 0 if along[:reach].all() and along[-reach:].all() else WIDEST


def takes_steps(request: Request, layout: str) -> bool:
    """Return whether there are steps on the two-point function: beside known voxels where the free
    ones are a sample of the material, and not after sliced rounds.
    """
    return request.known is None or (not is_sliced(layout) and is_a_sample(request.known))


@dataclass(frozen=True)
class NovelLayoutStage(RoundStage):
    """Noise on the coarsest level, and sliced rounds where there are any.

    Attributes
    ----------
    aims : Aims
        Of the free voxels.
    region : Region
    moving : (Z, Y, X) bool, optional
        The free voxels, and known ones whose distance is not.
    """

    aims: Aims
    region: Region
    moving: np.ndarray | None


@dataclass(frozen=True)
class PassStage(RoundStage):
    """The rounds of one pass.

    Attributes
    ----------
    number : int
        Of the pass.
    part : Pass
    grid : Grid
    target : Correlations
    interface : (C,) float, optional
        The most that steps may leave.
    euler : (2C,) float, optional
        What votes are to leave.
    stage : uint64
        Key of its random numbers.
    last : bool
        Whether no pass follows.
    offset : LocalOffset, optional
        By which the field is held to fractions, on coarse levels.
    """

    number: int
    part: Pass
    grid: Grid
    target: Correlations
    interface: np.ndarray | None
    euler: np.ndarray | None
    stage: np.uint64
    last: bool
    offset: LocalOffset | None = None


class NovelRounds(CoarseToFine[Any]):
    """A run from noise, on the torus; the state of the layout is its votes.

    Known voxels keep their field on every level, so what is made beside them is matched to the
    exemplar together with them. `around` are the regions that hold them, finest first. `held` are
    the target's fractions around every place, finest first.

    Attributes
    ----------
    debt : (C, bins)
        Misfit of the two-point function that the next steps make up for.
    graded : bool
        Whether the target varies from place to place.
    on_torus : bool
        Whether steps are those on a torus; else the older ones, which know open faces and holes, or
        none.
    """

    def __init__(
        self,
        aims: Sequence[Aims],
        slices: SliceTarget | None,
        schedule: Sequence[Pass],
        request: Request,
        config: NovelSettings,
        around: Sequence[Region] = (),
        held: Sequence[HeldFractions] = (),
    ) -> None:
        self.aims, self.slices = aims, slices
        self.held, self.graded = held, any(map(np.ndim, request.target.values()))
        self.schedule = schedule
        self.request, self.config = request, config
        self.top = len(aims) - 1
        self.shapes = [torus_shape(request, level, self.top) for level in range(self.top + 1)]
        self.regions = (
            [r.continue_on_torus(shape) for r, shape in zip(around, self.shapes, strict=True)]
            if around
            else [Region(shape, _AROUND) for shape in self.shapes]
        )
        unused = [iter(aim.candidates) for aim in aims]
        self.candidates = [next(unused[part.level]) for part in schedule]
        self.debt: np.ndarray | None = None
        # number of a pass, and the means of its soft indicators where fractions are held
        self.means: np.ndarray | None = None
        self.rounds = 0 if slices is None else _SLICED[config.layout][0]
        self.on_torus = is_whole(config.layout) and takes_steps(request, config.layout)
        self._aim: tuple[int, Correlations, np.ndarray | None] | None = None  # of a pass

    @property
    def names(self) -> list[str]:
        """List the names of layout and passes: others than when there were two schedules,
        so that unfinished runs of then begin anew.
        """
        kind = {"structure": "new", "coarse": "novel"}.get(self.config.layout, "noise")
        kind = f"{kind} held" if self.graded else kind
        return [f"{kind} layout", *(f"{kind} pass {n}" for n in range(len(self.schedule)))]

    @property
    def costs(self) -> list[float]:
        """List rounds times voxels of the layout and of the passes."""
        layout = self.rounds * math.prod(self.shapes[self.top])
        return [
            layout,
            *(part.rounds * math.prod(self.shapes[part.level]) for part in self.schedule),
        ]

    def open_stage(self, place: int) -> NovelLayoutStage | PassStage:
        """Prepare the layout, or the grid of a pass."""
        name, number = self.names[place], place - 1
        if place == 0:
            return self._layout_stage(name)
        part = self.schedule[number]
        region, candidates = self.regions[part.level], self.candidates[number]
        targets = self.aims[part.level].histograms
        if not self.graded:
            targets = targets_of(region, targets, width=candidates.basis.width)
        grid = Grid.over(region, candidates, targets)
        offset = None
        if self.graded:
            held = self.held[part.level]
            # on the finest level little would be left to vote for what was shifted
            offset = held.offset(region, shares_beside(region) if part.level else None)
            grid = held.guide(grid, offset)
        later = self.schedule[place:]
        del self.regions[later[0].level + 1 if later else 0 :]
        aims = self.aims[part.level]
        return PassStage(
            name,
            f"level {part.level}",
            part.rounds,
            number,
            part,
            grid,
            aims.correlations,
            None if aims.interface is None else part.roughest * aims.interface,
            aims.euler,
            key(self.request.seed, f"novel/pass {number}"),
            number == len(self.schedule) - 1,
            offset if part.level else None,
        )

    def _layout_stage(self, name: str) -> NovelLayoutStage:
        """Prepare the layout."""
        aims, region = self.aims[self.top], self.regions[self.top]
        if self.request.fixed is not None:
            aims = with_histograms(aims, targets_of(region, aims.histograms, width=WIDTH))
        return NovelLayoutStage(name, "laying out", self.rounds, aims, region, region.unsettled())

    def memory(self, stage: NovelLayoutStage | PassStage) -> Iterable[Stage]:
        """Declare the arrays of the layout, or of a pass."""
        if isinstance(stage, NovelLayoutStage):
            return self._layout_stages()
        return self._pass_stages(stage.number)

    def stages(self, *, mapped: bool = False) -> tuple[Stage, ...]:
        """Declare the arrays of the whole run."""
        passes = (self._pass_stages(number, mapped) for number in range(len(self.schedule)))
        return (*self._layout_stages(), *chain.from_iterable(passes))

    def _layout_stages(self) -> tuple[Stage, ...]:
        aims, shape = self.aims[self.top], self.shapes[self.top]
        volume = (len(aims.stack.field), *shape)
        known = self.request.fixed is not None
        transport: tuple[Stage, ...] = ()
        steps: tuple[Stage, ...] = ()
        if self.slices is not None:
            views = [(0, self.slices)]
            transport = transport_stages(volume, views, step=_SLICED_STEP, known=known)
            steps = (*self._step_stages(shape, aims.correlations, _AROUND), *wave_stages(volume))
        held = region_arrays(replace(self.request, mask=None), shape, len(aims.stack.field))
        return layout_stages(volume, {**held, "moving": held["free"]}, transport, steps)

    def _pass_stages(self, number: int, mapped: bool = False) -> tuple[Stage, ...]:
        part, shape = self.schedule[number], self.shapes[self.schedule[number].level]
        known = self.request.fixed is not None
        level = LevelMemory(
            self.request,
            Region(shape, _AROUND),
            [(0, self.candidates[number])],
            sweeps=part.sweeps(0, self.config.sweeps),
            held={"shares": Array(shape, np.uint8)} if known and part.steps else {},
            votes_rest=False,
            refit=number > 0 and self.schedule[number - 1].level == part.level,
            mapped=mapped,
        )
        target, periodic = self.aims[part.level].correlations, self.request.periodic
        if self.graded:
            guide = Array((*level.grids[0], 1), np.int16, axis=-4)
            held = {**level.held, "guide": guide, "fractions": Array(shape, np.float32)}
            if known and part.level:
                held["offset shares"] = Array(shape, np.uint8)
            level = replace(level, guides=1, held=held)
        if part.steps:
            step = self._step_stages(level.covered.shape, target, periodic)
            if known:
                step = (*step, *known_stages(shape, level.channels, target))
            waves = within({**level.base, **level.votes}, wave_stages(level.volume))
            stages = (*replace(level, correction=step).stages(), *waves)
        else:
            stages = level.stages()
        if self.aims[part.level].euler is None:
            return stages
        weight = {"weight0": Array(level.grids[0], np.int32)}
        tried = power_stages(level.volume, known=known)
        return (*stages, *within({**level.base, **weight}, tried))

    def _step_stages(
        self, shape: Sequence[int], target: Correlations, periodic: Sequence[bool]
    ) -> tuple[Stage, ...]:
        """Declare the arrays of a step on the two-point function."""
        if self.on_torus:
            return torus_step_stages(shape, target)
        return step_stages(shape, target, periodic)

    def enter(self, stage: NovelLayoutStage | PassStage, place: int, before: Workspace) -> None:
        """Start from noise, or refine the field and start from random matches."""
        work, self.debt = self.work, None
        if isinstance(stage, NovelLayoutStage):
            shape = (len(stage.aims.histograms), *stage.region.shape)
            self._open_layout(stage)
            work.adopt("votes", noise(shape, int(key(self.request.seed, "novel/noise"))))
            self._make_votes(stage)
            return
        self._open(stage, "start")
        level, field = self.top if place == 1 else self.schedule[place - 2].level, before["field"]
        for finer in range(level - 1, stage.part.level - 1, -1):
            shape = self.shapes[finer]
            field = refine_field(field, _AROUND, distances=True, shape=shape)
        work.adopt("field", stage.grid.region.clip_to_bounds(field))
        if stage.part.carried:
            old, grid = self.candidates[place - 2], stage.grid
            match = carry_matches(before["match0"], old, grid.candidates, grid.shape, factor=1)
        else:
            match = random_matches(stage.grid, stage.stage)
        work.adopt("match0", match)

    def _open_layout(self, stage: NovelLayoutStage) -> None:
        """Hold the known voxels, and mark those that move."""
        moving = {} if stage.moving is None else {"moving": stage.moving}
        self.open_region("match", stage.region, moving)

    def _open(self, stage: PassStage, name: str) -> None:
        guide = stage.grid.guide
        guides = {} if guide is None else {"guide": guide}
        self.open_region(name, stage.grid.region, {"active0": stage.grid.active, **guides})

    def _make_votes(self, stage: NovelLayoutStage, *, matched: bool = True) -> None:
        """Make the votes those of the field that they make, with the histogram or without."""
        work = self.work
        self.match_field(stage.region, stage.aims.histograms if matched else None)
        work.release("votes")
        work.adopt("votes", votes_of(work["field"]))

    def round(self, stage: NovelLayoutStage | PassStage, number: int) -> None:
        """Do a sliced round of the layout, or a round of a pass."""
        if isinstance(stage, NovelLayoutStage):
            self._lay_out(stage, number)
        else:
            super().round(stage, number)

    def _lay_out(self, stage: NovelLayoutStage, number: int) -> None:
        """Do a sliced round, and a step on the two-point function after every few of them."""
        work, target, free = self.work, stage.aims.correlations, stage.region.free
        assert self.slices is not None
        work.enter("transport")
        work.adopt(
            "moved",
            transport_neighbourhoods(
                work["votes"],
                [(0, self.slices)],
                key=key(self.request.seed, "novel/sliced"),
                number=number,
                step=_SLICED_STEP,
                strength=_STRENGTH,
                free=stage.moving,
                counted=free,
            ),
        )
        work.release("votes")
        work.adopt("votes", work.take("moved"))
        if (number + 1) % _STEP_EVERY == 0:
            self.match_field(stage.region, stage.aims.histograms)
            work.release("votes")
            work.adopt("votes", self._layout_step(target, free))
            _hold_waves(work["votes"], target, stage.region, stage.aims.histograms)
            self._make_votes(stage)
        elif free is not None:
            self._make_votes(stage, matched=False)

    def _layout_step(self, target: Correlations, free: np.ndarray | None) -> np.ndarray:
        """Take a step on the two-point function of the layout's field."""
        if self.on_torus:
            return torus_step(self.work["field"], target)[0]
        return two_point_step(self.work["field"], target, periodic=_AROUND, free=free)

    def leave(self, stage: NovelLayoutStage | PassStage) -> None:
        """Make the field of the layout: noise or a step was the last, so its votes are those of a
        field.
        """
        if isinstance(stage, NovelLayoutStage):
            self.match_field(stage.region, None)

    def search(self, stage: PassStage, number: int) -> None:
        """Find a new match for every site, and what it weighs in the vote."""
        config, work, part = self.config, self.work, stage.part
        work.enter("search0")
        found = coherent_search(
            stage.grid,
            work["match0"],
            work["field"],
            stage=stage.stage,
            first=100 * number + 1,
            count=part.sweeps(number, config.sweeps),
            tries=config.tries,
            index_penalty=config.index_penalty,
            by_leaves=part.by_leaves,
        )
        self.weigh_matches(stage.grid, found, config.robustness)

    def vote(self, stage: PassStage, number: int) -> None:
        """Make the field that the matches vote for."""
        work, grid, trim = self.work, stage.grid, 1 if stage.part.level == 0 else 0
        matched = grid, work["match0"], work["weight0"]
        power = 1.0 if stage.part.level else self.config.vote_power
        if not power and stage.euler is not None:
            work.enter("try powers")
            power = power_for(*matched, stage.euler, trim=trim)
        work.enter("vote")
        voting = raise_distances(grid.candidates.stack.field, power or 1.0)
        votes = cast_votes(*matched, trim=trim, field=voting)
        if grid.region.low is not None:
            lower_votes(votes, power or 1.0)  # the joint goes by distances
        work.adopt("votes", votes)
        self.join_votes(grid.region)
        self.match_field(grid.region, grid.targets)
        self._hold_fractions(stage)

    def _hold_fractions(self, stage: PassStage) -> None:
        """Hold the field to the target's fractions, on coarse levels."""
        if stage.offset is not None:
            hold_field(self.work["field"], stage.offset)
            stage.grid.region.clip_to_bounds(self.work["field"])

    def correct(self, stage: PassStage, number: int) -> None:
        """Take steps on the two-point function, the last with one on long waves."""
        part, grid, work = stage.part, stage.grid, self.work
        beyond = part.beyond if number == part.rounds - 1 else 1.0
        if part.beyond and not self.on_torus:
            work.enter("rest")
            self.debt = accumulate_debt(
                self.debt, work["field"], stage.target, periodic=self.request.periodic
            )
        for step in range(part.steps):
            work.enter("rest")
            target, interface = self._aim_of(stage)
            work.enter("match")
            renew = step == 0 and part.beyond > 0
            votes = work.adopt("votes", self._step(target, beyond, renew))
            if interface is not None:
                shorten_move(work["field"], votes, interface)
            if "shares" in work:
                hold_move(votes, work["field"], work["shares"])
            if step == part.steps - 1 and not self.graded:
                work.enter("waves")
                _hold_waves(votes, stage.target, grid.region, grid.targets)
            del votes
            self.match_field(grid.region, grid.targets)
            self._hold_fractions(stage)

    def _aim_of(self, stage: PassStage) -> tuple[Correlations, np.ndarray | None]:
        """Return the target of steps, and the most interface that they may leave; beside known
        voxels those of all voxels together, where fractions are held those of such material.
        """
        grid = stage.grid
        knows = grid.region.low is not None and self.on_torus
        if not knows and not self.graded:
            return stage.target, stage.interface
        if self._aim is None or self._aim[0] != stage.number:
            if knows:
                target, interface = self._aim_beside(stage)
            else:
                target, interface = self._held_aim(stage, stage.target)[0], stage.interface
            self._aim = stage.number, target, interface
        return self._aim[1:]

    def _aim_beside(self, stage: PassStage) -> tuple[Correlations, np.ndarray | None]:
        """Return what steps aim at beside known voxels; hold the shares of moves there."""
        grid = stage.grid
        free = with_histograms(self.aims[stage.part.level], grid.targets)
        most = None if free.interface is None else stage.part.roughest * free.interface
        target, means = free.correlations, soft_means(grid.targets, free.correlations.softness)
        if self.graded:
            target, means = self._held_aim(stage, target)
        part, shares = KnownPart.of(grid.region, target, means, most)
        self.work.adopt("shares", shares)
        return part.target, part.interface

    def _held_aim(self, stage: PassStage, target: Correlations) -> tuple[Correlations, np.ndarray]:
        """Return a target for material that is held to fractions, and the means of its soft
        indicators: as the field has them at the first step of the pass.
        """
        grid, held = stage.grid, self.held[stage.part.level]
        if self.means is None or self.means[0] != stage.number:
            soft = [Soft.of(one, target.softness, grid.region.free) for one in self.work["field"]]
            means = (float(one.mean_and_moving()[0]) for one in soft)
            self.means = np.array([stage.number, *means])
        return held.aim(target, grid.targets, self.means[1:], grid.region.shape), self.means[1:]

    def _step(self, target: Correlations, beyond: float, renew: bool) -> np.ndarray:
        """Take a step on the two-point function that aims beyond the target by the debt, which the
        field of a vote may `renew`.
        """
        field = self.work["field"]
        if self.on_torus:
            votes, self.debt = torus_step(field, target, debt=self.debt, renew=renew, beyond=beyond)
            return votes
        aim = None if self.debt is None else self.debt * beyond
        return two_point_step(field, target, debt=aim, periodic=self.request.periodic)

    def arrays(self, stage: NovelLayoutStage | PassStage, number: int) -> dict[str, np.ndarray]:
        """Return all that the next round starts from; after the last one the votes as well."""
        if isinstance(stage, NovelLayoutStage):
            return {"votes": self.work["votes"]}
        arrays = {"field": self.work["field"], "match": self.work["match0"]}
        if stage.last and number == stage.rounds - 1:
            arrays["votes"] = self.work["votes"]
        more = {"debt": self.debt, "means": self.means}
        return {**arrays, **{name: one for name, one in more.items() if one is not None}}

    def restore(self, stage: NovelLayoutStage | PassStage, arrays: dict[str, np.ndarray]) -> None:
        """Take over the arrays of a checkpoint."""
        self.debt, self.means = arrays.pop("debt", None), arrays.pop("means", None)
        if isinstance(stage, NovelLayoutStage):
            self._open_layout(stage)
        else:
            self._open(stage, "match")
            self.work.adopt("match0", arrays.pop("match"))
        for name, array in arrays.items():
            self.work.adopt(name, array)


def make_novel(rounds: NovelRounds) -> np.ndarray:
    """Return the last votes (C, Z, Y, X) int16 on the torus; where fractions are held, those of the
    last field.
    """
    rounds.run()
    work = rounds.work
    if rounds.graded:
        work.enter("match")
        work.release("votes")
        work.adopt("votes", votes_of(work["field"]))
    work.enter("deliver")
    return work.take("votes")


def _hold_waves(
    votes: np.ndarray,
    target: Correlations,
    region: Region,
    histograms: tuple[Histogram, ...] | None,
) -> None:
    """Bring the long waves of votes to the exemplars', in place; not beside known voxels, whose own
    they cannot change.
    """
    if region.free is not None:
        return
    assert target.waves is not None  # `aims_of` learns them
    adjust_long_waves(votes, target.waves, lambda made: match_votes(region, made, histograms))

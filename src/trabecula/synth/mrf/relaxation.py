"""Relaxation at one scale: its start, then sweeps over the classes of sites, each class at once.

Within a class no site is another's neighbour, so updating all at once equals updating one after
another. The new level of a site depends on its neighbours, on the learned terms and on a random
number of its own, not on batches, slabs or threads.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from trabecula.core.progress import track
from trabecula.core.seeds import generator, key
from trabecula.engine.checkpoint import Checkpoint, due, offer
from trabecula.engine.compile import kernel
from trabecula.engine.memory import Array, Stage, Workspace, within
from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.synth.mrf.config import MrfConfig
from trabecula.synth.mrf.fraction_control import FractionShifts
from trabecula.synth.mrf.lattice import (
    ALL,
    ClassName,
    SiteClasses,
    SiteLattice,
    marks_or_all,
)
from trabecula.synth.mrf.picture_levels import PictureLevels
from trabecula.synth.mrf.random_order import RandomTurns, draw_turns
from trabecula.synth.mrf.site_update import (
    COLDEST,
    ClassScores,
    SiteClass,
    SweepStep,
    SweepTally,
    choose_levels,
    class_stages,
    coldness,
    count_local,
    row_slices,
    score_class,
)
from trabecula.synth.mrf.slice_planes import SliceView, ViewSet, gather_places, union_offsets
from trabecula.synth.mrf.statistics_feedback import BiasFeedback, PairCouplings, coupling_stages
from trabecula.synth.shared.statistics.pairs import Pairs

T = TypeVar("T")

_ENOUGH = 64  # sites of a turn whose shares say what shifts are needed

# With one update a sweep, voxels at large distances flip together at every sweep.
_PARTS = 4  # of a sweep; before each the field of the couplings is updated


def relaxation_stages(
    shape: Sequence[int],
    view_sets: Sequence[Sequence[SliceView]],
    content: PictureLevels,
    config: MrfConfig,
    *,
    masked: bool,
    pairs: Pairs | None,
) -> tuple[Stage, ...]:
    """Declare the arrays of the relaxation of a lattice beside the lattice; `masked` says whether
    the result has a form, `pairs` are those that are coupled.
    """
    held: dict[str, Array] = {}
    if config.relaxation == "icm":
        held = {"temperature": Array(shape, np.float32), "held": Array(shape, bool)}
    classes = class_stages(shape, view_sets, content, config, masked=masked)
    if config.order == "random":
        held["turn"] = Array(shape, np.uint16)
        classes = (Stage("order", {"priority": Array(shape, np.uint32)}), *classes)
    if pairs is None:
        return within(held, classes)
    coupled = coupling_stages(pairs, content.features.shape[1])
    field = {"field": coupled[-1].arrays["field"]}
    return (*within({**held, **field}, classes), *within(held, coupled))


@dataclass
class Relaxation:
    """The relaxation of one lattice.

    Attributes
    ----------
    view_sets : sequence of sequences of SliceView
        The views along the axes, and those that sweeps use in turn with them.
    wanted : (L,) float64
        Target shares of the levels in the output.
    couplings : PairCouplings, optional
    temperature, held : (Z, Y, X) float32, bool
        Of equation 8, and where it must not change; empty unless the relaxation is "icm".
    work : Workspace
        The arrays of a class of sites (`class_stages`).
    """

    lattice: SiteLattice
    view_sets: Sequence[Sequence[SliceView]]
    content: PictureLevels
    config: MrfConfig
    seed: int
    scale: int
    wanted: np.ndarray
    couplings: PairCouplings | None = None
    temperature: np.ndarray = field(init=False)
    held: np.ndarray = field(init=False)
    work: Workspace = field(init=False)

    def __post_init__(self) -> None:
        config = self.config
        self.work = Workspace(
            relaxation_stages(
                self.lattice.shape,
                self.view_sets,
                self.content,
                config,
                masked=self.lattice.form is not None,
                pairs=None,
            )
        )
        self.work.enter("find sites")
        self.temperature, self.held = np.zeros((0, 0, 0), np.float32), ALL
        if config.relaxation == "icm":
            self.temperature, self.held = self.work.zeros("temperature"), self.work.zeros("held")
        self._feedback = config.setting_for("feedback", self.content.sort)
        self._view_sets = [
            ViewSet(
                slice_views,
                self.lattice,
                self.content,
                width=config.neighbourhood,
                correction=config.correction,
            )
            for slice_views in self.view_sets
        ]
        self._turn = self.work.zeros("turn") if config.order == "random" else None
        self._union = union_offsets(
            [slice_view.plane for slice_view in self.view_sets[0]], config.neighbourhood
        )
        joints = {
            slice_view.learner: slice_view.candidates.joint
            for slice_views in self.view_sets
            for slice_view in slice_views
        }
        self.bias_feedback = BiasFeedback(
            [joints[n] for n in sorted(joints)], len(self.view_sets[0]), rate=self._feedback
        )
        # a turn has few sites
        enough = 1 if config.order == "classes" else _ENOUGH
        self.shifts = FractionShifts(self.content.groups, self.wanted, enough)

    def run(
        self, before: Sequence[dict[str, Any]] = (), state: Checkpoint | None = None
    ) -> list[dict[str, Any]]:
        """Run all sweeps of this scale, from the checkpoint `state` where there is one.

        Returns
        -------
        list of dict
            Reports of the coarser scales (`before`) and of this one: voxels changed in each sweep,
            for icm the fall of the global temperature, and with couplings the misfit of the
            autocorrelation.
        """
        before, begin = list(before), 0
        report: dict[str, Any] = {"scale": self.scale, "changed": []}
        if state is not None:
            begin, (*before, report) = state.number, json.loads(bytes(state.arrays["told"]))
            self._restore(state.arrays)
        steps = self._steps()
        for number in track(range(begin, len(steps)), self.stage, total=len(steps) - begin):
            if self.temperature.size and self._temperature_fall() >= self.config.stop:
                break
            report["changed"].append(self.sweep(steps[number]))
            if self.temperature.size:
                report["fall"] = round(self._temperature_fall(), 4)
            if self.couplings is not None:
                self.couplings.learn(self.lattice.levels, self.lattice.domain)
                report["misfit"] = round(self.couplings.misfit, 4)
            if due():
                packed = np.frombuffer(json.dumps([*before, report]).encode(), np.uint8)
                offer(self.stage, number + 1, told=packed, **self._state())
        return [*before, report]

    @property
    def stage(self) -> str:
        """Return the stage's name."""
        return f"scale {self.scale}"

    def sweep(self, step: SweepStep) -> int:
        """Visit every site that may change, class after class; return the number of changed
        sites.
        """
        view_set = self._view_sets[step.view_set]
        held = self.held if self.config.resynthesis else ALL
        classes, names = self._order(view_set, held, step.number)
        tally = SweepTally(0, self.bias_feedback.empty_tables())
        part = -(-len(names) // _PARTS)
        for number, name in enumerate(names):
            if self.couplings is not None and number and number % part == 0:
                self.couplings.update_field(self.lattice.levels, self.lattice.domain)
            site_class = SiteClass(classes, name, self.temperature, held, self.work)
            if site_class.count:
                tally += self._update_class(site_class, view_set, step)
            self.work.enter("find sites")
        if self._feedback:
            self.bias_feedback.learn(tally.tables)
        return tally.changed

    def _order(
        self, view_set: ViewSet, held: np.ndarray, sweep: int
    ) -> tuple[SiteClasses | RandomTurns, list[ClassName]]:
        """Return the classes of sites that a sweep updates at once, and their order."""
        if self._turn is None:
            names = view_set.classes.names
            drawn = generator(self.seed, f"mrf/{self.scale}/order", sweep).permutation(len(names))
            return view_set.classes, [names[place] for place in drawn]
        self.work.enter("order")
        turns = draw_turns(
            self.lattice,
            view_set.conflicts,
            self.temperature,
            held,
            key=key(self.seed, f"mrf/{self.scale}/turns"),
            sweep=sweep,
            turn=self._turn,
            priority=self.work.empty("priority"),
        )
        self.work.enter("find sites")
        return turns, turns.names

    def _update_class(
        self, site_class: SiteClass, view_set: ViewSet, step: SweepStep
    ) -> SweepTally:
        """Give the sites of a class new levels."""
        config = self.config
        found = score_class(
            site_class,
            view_set,
            heuristic=config.heuristic,
            bias=self.bias_feedback.bias() if self._feedback else [],
            temperature=self.temperature,
            couplings=self.couplings,
            mirrored=step.mirrored,
        )
        shift = np.zeros(len(self.wanted), np.int32)
        if config.shares and len(found.score):
            cold = step.rule == "icm" or step.heat == 0
            heat = step.heat if step.rule == "gibbs" else 1.0  # proposals use the density itself
            cooled = COLDEST if cold else coldness(heat)
            shift = self.shifts.update(site_class, found.score, cooled)
        self.work.enter("choose")
        return site_class.sum_on_planes(
            lambda first, last: self._update_planes(
                site_class, found, shift, view_set, step, first, last
            )
        )

    def _update_planes(
        self,
        site_class: SiteClass,
        found: ClassScores,
        shift: np.ndarray,
        view_set: ViewSet,
        step: SweepStep,
        first: int,
        last: int,
    ) -> SweepTally:
        """Give the sites of a class in the planes first .. last new levels; no other thread reads
        them meanwhile.
        """
        sites, start = site_class.sites(first, last), int(site_class.starts[0][first])
        levels, changed = self.lattice.levels.reshape(-1), 0
        tables = self.bias_feedback.empty_tables()
        for part in row_slices(len(sites)):
            asked, rows = sites[part], slice(start + part.start, start + part.stop)
            present = levels[asked]
            if len(found.chosen):
                chosen = found.chosen[rows]
            else:
                chosen = choose_levels(
                    found.score[rows] + shift, asked, present, step, self.config.proposals
                )
            changed += int(np.count_nonzero(present != chosen))
            levels[asked] = chosen
            if self.temperature.size:
                domain = marks_or_all(self.lattice.domain)
                cool(asked, self._union, domain, self.held, self.config.xi, self.temperature)
            if self._feedback:
                count_local(tables, found.cells[:, rows], view_set, chosen)
        return SweepTally(changed, tables)

    def _steps(self) -> list[SweepStep]:
        """List the sweeps of this scale."""
        config = self.config
        count = at_scale(config.sweeps, self.scale)
        stage = key(self.seed, f"mrf/{self.scale}/{config.relaxation}")
        if config.relaxation == "icm":
            return [SweepStep("icm", 0.0, stage, n) for n in range(count)]
        if config.relaxation == "annealing":
            heats = [1 - n / count for n in range(count)]
        else:
            first = at_scale(config.heat, self.scale)
            last = at_scale(config.final_heat, self.scale)
            heats = [first + (last - first) * n / max(1, count - 1) for n in range(count)]
        polish = config.setting_for("polish", self.content.sort) if self.scale == 0 else 0
        # An isotropic material has an isotropic mirror image: three views that lean one way would
        # confirm each other.
        ways = len(self._view_sets)
        steps = [
            SweepStep(config.relaxation, heat, stage, n, n % ways, ways > 1 and n // ways % 2 > 0)
            for n, heat in enumerate(heats)
        ]
        # The last sweeps use the planes along the axes, in which the result will be looked at.
        return [
            *steps,
            *(
                SweepStep("icm", 0.0, stage, count + n, 0, ways > 1 and n % 2 > 0)
                for n in range(polish)
            ),
        ]

    @property
    def start(self) -> float:
        """Return the temperature at which free voxels begin."""
        return float(np.float32(at_scale(self.config.start, self.scale)))

    def _temperature_fall(self) -> float:
        """Return the share by which the global temperature has fallen since the scale began
        (section V.B).
        """
        temperature, held = self.temperature, self.held
        sums = np.zeros(len(temperature))

        def work(first: int, last: int) -> int:
            for z in range(first, last):
                sums[z] = temperature[z].sum(dtype=np.float64)
            warm = ~held[first:last]
            return int(
                np.count_nonzero(
                    warm if self.lattice.free is None else self.lattice.free[first:last] & warm
                )
            )

        warm = sum_slabs(work, len(temperature))
        return 1 - math.fsum(sums) / (self.start * max(warm, 1))

    def _state(self) -> dict[str, np.ndarray]:
        """Return the arrays of a checkpoint."""
        learned = {} if self.couplings is None else {"strength": self.couplings.strength}
        return {
            "levels": self.lattice.levels,
            "temperature": self.temperature,
            "shift": self.shifts.by_group,
            "fine": self.shifts.by_level,
            **self.bias_feedback.state(),
            **learned,
        }

    def _restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore the arrays of a checkpoint; take out the large ones."""
        _copy(arrays.pop("levels"), self.lattice.levels)
        _copy(arrays.pop("temperature"), self.temperature)
        self.shifts.by_group, self.shifts.by_level = arrays["shift"], arrays["fine"]
        self.bias_feedback.restore(arrays)
        if self.couplings is not None:
            self.couplings.strength = arrays["strength"]
            self.couplings.update_field(self.lattice.levels, self.lattice.domain)


def at_scale(schedule: Sequence[T], scale: int) -> T:
    """Return the entry of a schedule for a scale."""
    return schedule[min(scale, len(schedule) - 1)]


@kernel
def cool(sites, offsets, domain, held, xi, temperature):
    """Update temperatures (equation 8): t = max(0, (xi + sum of t over the neighbours in three
    dimensions) / their number); `held` sites keep theirs.

    Voxels outside the `domain` are no neighbours; without entries all are inside.
    """
    flat, kept = temperature.ravel(), held.ravel()
    places = np.empty((1, len(offsets)), np.int64)
    for s in range(len(sites)):
        if kept[sites[s]]:
            continue
        gather_places(sites[s : s + 1], offsets, temperature.shape, domain, places)
        total, number = np.float64(xi), 0
        for place in places[0]:
            if place >= 0:
                total += flat[place]
                number += 1
        flat[sites[s]] = max(0.0, total / max(number, 1))


def start_relaxation(
    lattice: SiteLattice,
    coarse: np.ndarray | None,
    view_sets: Sequence[Sequence[SliceView]],
    content: PictureLevels,
    config: MrfConfig,
    *,
    seed: int,
    scale: int,
    wanted: np.ndarray,
    couplings: PairCouplings | None,
) -> Relaxation:
    """Start the relaxation of a scale from white noise with the picture's histogram, or from the
    coarser scale.

    `wanted` are the target shares (L,) of the levels in the result, known voxels included.

    `coarse` are the levels of the coarser scale; None on the coarsest. A coarse voxel is copied to
    the first of its eight voxels ("one", 1/8) or to all ("all", 8/8); in both cases only the first
    inherits its temperature of 0.
    """
    marginal = np.sum([slice_view.candidates.marginal for slice_view in view_sets[0]], axis=0)
    # with 8/8 every voxel is overwritten
    if coarse is None or config.upsampling == "one":
        _fill_with_noise(lattice, marginal, seed, scale)
    if coarse is not None:
        _inherit(lattice, coarse, config.upsampling)
    relaxation = Relaxation(
        lattice, view_sets, content, config, seed, scale, _free_shares(lattice, wanted), couplings
    )
    if config.relaxation == "icm":
        _set_temperatures(
            lattice,
            relaxation.temperature,
            relaxation.held,
            inherits=coarse is not None,
            start=relaxation.start,
        )
    return relaxation


def _free_shares(lattice: SiteLattice, wanted: np.ndarray) -> np.ndarray:
    """Return the shares that free voxels need so that they and the known ones together have the
    target shares.
    """
    left, held = lattice.count_known(len(wanted))
    missing = np.maximum(wanted * (left + int(held.sum())) - held, 0)
    return missing / missing.sum() if left and missing.sum() > 0 else wanted


def _fill_with_noise(lattice: SiteLattice, marginal: np.ndarray, seed: int, scale: int) -> None:
    """Draw free voxels from a histogram, each plane with random numbers of its own."""
    ends = np.cumsum(marginal)

    def work(first: int, last: int) -> None:
        for z in range(first, last):
            raw = generator(seed, f"mrf/{scale}/noise", z).bit_generator.random_raw(
                lattice.levels[z].size
            )
            raw %= np.uint64(ends[-1])
            drawn = (
                np.searchsorted(ends, raw, side="right").astype(np.uint8).reshape(lattice.shape[1:])
            )
            _set_free(lattice, slice(z, z + 1), drawn[None])

    for_slabs(work, lattice.shape[0])


def _inherit(lattice: SiteLattice, coarse: np.ndarray, upsampling: str) -> None:
    """Copy the coarser scale to the first of each eight voxels, or to all; voxels that are not free
    stay.
    """

    def work(first: int, last: int) -> None:
        for z in range(first, last):
            if upsampling == "all":
                found = coarse[z // 2].repeat(2, axis=0).repeat(2, axis=1)
                _set_free(
                    lattice, slice(z, z + 1), found[None, : lattice.shape[1], : lattice.shape[2]]
                )
            elif z % 2 == 0:
                _set_free(
                    lattice,
                    (slice(z, z + 1), slice(None, None, 2), slice(None, None, 2)),
                    coarse[None, z // 2],
                )

    for_slabs(work, lattice.shape[0])


def _set_free(lattice: SiteLattice, part: Any, found: np.ndarray) -> None:
    """Set the levels of the free voxels of a part."""
    np.copyto(
        lattice.levels[part], found, where=True if lattice.free is None else lattice.free[part]
    )


def _set_temperatures(
    lattice: SiteLattice,
    temperature: np.ndarray,
    held: np.ndarray,
    *,
    inherits: bool,
    start: float,
) -> None:
    """Set the temperatures at the `start`, and mark the voxels that `inherits` gave a 0: the first
    of every eight.
    """

    def work(first: int, last: int) -> None:
        for z in range(first, last):
            free = np.ones(lattice.shape[1:], bool) if lattice.free is None else lattice.free[z]
            if inherits and z % 2 == 0:
                held[z, ::2, ::2] = free[::2, ::2]
            temperature[z] = np.float32(start) * (free & ~held[z])

    for_slabs(work, lattice.shape[0])


def _copy(kept: np.ndarray, into: np.ndarray) -> None:
    """Copy an array of a checkpoint into one of the run."""

    def copy(first: int, last: int) -> None:
        into[first:last] = kept[first:last]

    for_slabs(copy, len(into))

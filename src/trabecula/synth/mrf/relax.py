"""Relaxation at one scale: sweeps over the classes of sites, each class at once.

Within a class no site is another's neighbour, so that all of them at once is the same as one after another. What a site becomes
depends on its neighbours, on what has been learnt and on a random number of its own; batches, slabs and threads do not matter.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from trabecula.core.progress import track
from trabecula.core.seeds import generator, key
from trabecula.engine.checkpoint import State, due, offer
from trabecula.engine.tiles import for_slabs
from trabecula.synth.mrf import choose
from trabecula.synth.mrf.config import MrfConfig
from trabecula.synth.mrf.content import Content
from trabecula.synth.mrf.couplings import Couplings
from trabecula.synth.mrf.feedback import count
from trabecula.synth.mrf.frame import Face, Frame
from trabecula.synth.mrf.lattice import Lattice, classes_of, sites_of
from trabecula.synth.mrf.planes import union_of
from trabecula.synth.mrf.shares import moved_levels, shifts_for
from trabecula.synth.mrf.steering import Steering, Tables
from trabecula.synth.mrf.tables import POWERS
from trabecula.synth.mrf.temperature import cool

T = TypeVar("T")

# Else all that lies far apart turns over at every sweep.
_PARTS = 4  # of a sweep, before each of which couplings look anew


@dataclass(frozen=True)
class Step:
    """What a sweep does: its rule ("gibbs", "icm", "annealing"), temperature, key and number for random words, which of the
    frames it goes by, and whether it sees the pictures from behind."""

    rule: str
    heat: float
    key: np.uint64
    number: int
    frame: int = 0
    mirrored: bool = False


@dataclass
class Relaxation:
    """The relaxation of one lattice.

    Attributes
    ----------
    frames : sequence of sequences of Face
        The views along the axes, and those that sweeps take in turn with them.
    wanted : (L,) float64
        Shares of the levels that the output is to have.
    couplings : Couplings, optional
    temperature, held : (Z, Y, X) float32, bool
        Of equation 8, and where it is not to change; empty unless the relaxation is "icm".
    """

    lattice: Lattice
    frames: Sequence[Sequence[Face]]
    content: Content
    config: MrfConfig
    seed: int
    scale: int
    wanted: np.ndarray
    couplings: Couplings | None = None
    temperature: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 0), np.float32))
    held: np.ndarray = field(default_factory=lambda: np.zeros((0, 0, 0), bool))

    def __post_init__(self) -> None:
        config = self.config
        self._feedback = config.feedback_of(self.content.sort)
        self._frames = [
            Frame(faces, self.lattice, self.content, width=config.neighbourhood, correction=config.correction)
            for faces in self.frames
        ]
        self._union = union_of([face.plane for face in self.frames[0]], config.neighbourhood)
        joints = {face.learner: face.source.joint for faces in self.frames for face in faces}
        self.steering = Steering([joints[n] for n in sorted(joints)], len(self.frames[0]), rate=self._feedback)
        self._by_group = np.bincount(self.content.groups, self.wanted)
        self.shift = np.zeros(len(self._by_group), np.int64)  # of the groups of levels, and of levels within them
        self.fine = np.zeros(len(self.wanted), np.int64)

    def run(self, before: Sequence[dict[str, Any]] = (), state: State | None = None) -> list[dict[str, Any]]:
        """All sweeps of this scale, from `state` where there is one.

        Returns
        -------
        list of dict
            What there is to tell of the coarser scales (`before`) and of this one: voxels changed in each sweep, for icm how far
            the global temperature had fallen, and how far couplings leave the autocorrelation off.
        """
        before, begin = list(before), 0
        told: dict[str, Any] = {"scale": self.scale, "changed": []}
        if state is not None:
            begin, (*before, told) = state.number, json.loads(bytes(state.arrays["told"]))
            self._restore(state.arrays)
        steps = self._steps()
        for number in track(range(begin, len(steps)), self.stage, total=len(steps) - begin):
            if self.temperature.size and self._fallen() >= self.config.stop:
                break
            told["changed"].append(self.sweep(steps[number]))
            if self.temperature.size:
                told["fall"] = round(self._fallen(), 4)
            if self.couplings is not None:
                self.couplings.learn(self.lattice.levels, self.lattice.there)
                told["misfit"] = round(self.couplings.misfit, 4)
            if due():
                packed = np.frombuffer(json.dumps([*before, told]).encode(), np.uint8)
                offer(self.stage, number + 1, told=packed, **self._state())
        return [*before, told]

    @property
    def stage(self) -> str:
        """Its name among those of a run."""
        return f"scale {self.scale}"

    def sweep(self, step: Step) -> int:
        """Visit every site that is to change, class after class; how many did change."""
        frame = self._frames[step.frame]
        width = self.config.neighbourhood
        names = classes_of(self.lattice, width, turned=frame.turned)
        order = generator(self.seed, f"mrf/{self.scale}/order", step.number).permutation(len(names))
        tables, changed = self.steering.empty_tables(), 0
        part = -(-len(order) // _PARTS)
        for number, place in enumerate(order):
            if self.couplings is not None and number and number % part == 0:
                self.couplings.act(self.lattice.levels, self.lattice.there)
            sites = self._questioned(sites_of(self.lattice, width, names[place]), frame)
            if len(sites):
                changed += self._visit(sites, frame, step, tables)
        if self._feedback:
            self.steering.learn(tables)
        return changed

    def _questioned(self, sites: np.ndarray, frame: Frame) -> np.ndarray:
        """Those of a class whose temperature is not 0, or that were inherited; with complete neighbourhoods first, since only the
        others need weights."""
        if self.temperature.size:
            warm = self.temperature.reshape(-1)[sites] > 0
            sites = sites[warm | self.held.reshape(-1)[sites]] if self.config.resynthesis else sites[warm]
        return sites[np.argsort(~frame.whole[sites], kind="stable")]

    def _visit(self, sites: np.ndarray, frame: Frame, step: Step, tables: Tables) -> int:
        """New levels for the sites of a class, counted into `tables`; how many changed."""
        features, groups = self.content.features, self.content.groups
        chosen = np.empty(len(sites), np.uint8)
        cells = np.empty((len(frame.faces), len(sites), features.shape[1]), np.uint8)
        score = self._scores(sites, frame, chosen, cells, mirrored=step.mirrored)
        if len(score):
            if self.config.shares:
                score += self._shifted(score, sites, step)
            self._choose(score, sites, step, chosen)
        levels = self.lattice.levels.reshape(-1)
        changed = int(np.count_nonzero(levels[sites] != chosen))
        levels[sites] = chosen
        if self.temperature.size:
            cool(sites, self._union, self.lattice.there, self.held, self.config.xi, self.temperature)
        if self._feedback:
            for face, cell in zip(frame.faces, cells, strict=True):
                count(cell, groups, chosen, tables[face.learner])
        return changed

    def _scores(
        self, sites: np.ndarray, frame: Frame, chosen: np.ndarray, cells: np.ndarray, *, mirrored: bool
    ) -> np.ndarray:
        """Scores (S, L) int32 of all levels; none for h1a and h1b, which choose at once."""
        config = self.config
        at_once = config.heuristic in ("h1a", "h1b")
        score = np.empty((0 if at_once else len(sites), len(self.content.features)), np.int32)
        bias = self.steering.bias() if self._feedback else []

        def work(start: int, stop: int) -> None:
            scratch = frame.scratch(stop - start)
            for first in range(start, stop, frame.batch):
                part = slice(first, min(first + frame.batch, stop))
                pulled = np.zeros((part.stop - first, score.shape[1]), np.int64)
                log = frame.densities(
                    sites[part], scratch, self.temperature, pulled, bias, cells[:, part], mirrored=mirrored
                )
                if at_once:
                    choose.of_views(log, self.content.features, config.heuristic == "h1b", chosen[part])
                    continue
                if self.couplings is not None:
                    self.couplings.pull(sites[part], pulled)
                frame.score(log, pulled, config.heuristic, score[part])

        for_slabs(work, len(sites), least=256)
        return score

    def _shifted(self, score: np.ndarray, sites: np.ndarray, step: Step) -> np.ndarray:
        """What has to be added to the scores of the levels (L,) int32 for the wanted shares."""
        counted = score[self.lattice.asked.reshape(-1)[sites]]
        if len(counted):
            cold = step.rule == "icm" or step.heat == 0
            heat = step.heat if step.rule == "gibbs" else 1.0  # proposals go by the density itself
            coldness = choose.COLDEST if cold else choose.coldness(heat)
            groups = self.content.groups
            counted = counted + self.fine.astype(np.int32)
            self.shift = shifts_for(counted, groups, self._by_group, coldness=coldness, start=self.shift)
            shift = (self.shift[groups] + self.fine).astype(np.int32)
            if len(self.shift) < len(self.wanted):
                counted += self.shift[groups].astype(np.int32)
                self.fine = moved_levels(counted, groups, self.wanted, coldness=coldness, shift=self.fine)
            return shift
        return (self.shift[self.content.groups] + self.fine).astype(np.int32)

    def _choose(self, score: np.ndarray, sites: np.ndarray, step: Step, chosen: np.ndarray) -> None:
        """The new levels (S,) uint8."""
        if step.rule == "icm" or (step.rule == "gibbs" and step.heat == 0):
            choose.greatest(score, chosen)
        elif step.rule == "gibbs":
            choose.drawn(score, choose.coldness(step.heat), POWERS, sites, step.key, step.number, chosen)
        else:
            present, tries = self.lattice.levels.reshape(-1)[sites], self.config.proposals
            heat = round(65536 * step.heat)
            choose.proposed(score, heat, POWERS, present, tries, sites, step.key, step.number, chosen)

    def _steps(self) -> list[Step]:
        """Every sweep of this scale."""
        config = self.config
        count = _of_scale(config.sweeps, self.scale)
        stage = key(self.seed, f"mrf/{self.scale}/{config.relaxation}")
        if config.relaxation == "icm":
            return [Step("icm", 0.0, stage, n) for n in range(count)]
        if config.relaxation == "annealing":
            heats = [1 - n / count for n in range(count)]
        else:
            first, last = _of_scale(config.heat, self.scale), _of_scale(config.final_heat, self.scale)
            heats = [first + (last - first) * n / max(1, count - 1) for n in range(count)]
        polish = config.polish_of(self.content.sort) if self.scale == 0 else 0
        # A material that is alike in all directions is so for its mirror image.
        ways = len(self._frames)
        steps = [
            Step(config.relaxation, heat, stage, n, n % ways, ways > 1 and n // ways % 2 > 0)
            for n, heat in enumerate(heats)
        ]
        # The last sweeps go by the planes along the axes, in which the result will be looked at.
        return [*steps, *(Step("icm", 0.0, stage, count + n, 0, ways > 1 and n % 2 > 0) for n in range(polish))]

    def _fallen(self) -> float:
        """By what share the global temperature has fallen since the scale began (section V.B)."""
        start = int(np.count_nonzero(self.lattice.free & ~self.held))
        return 1 - float(self.temperature.sum(dtype=np.float64)) / max(start, 1)

    def _state(self) -> dict[str, np.ndarray]:
        """All that the next sweep starts from."""
        learnt = {} if self.couplings is None else {"strength": self.couplings.strength}
        return {
            "levels": self.lattice.levels,
            "temperature": self.temperature,
            "shift": self.shift,
            "fine": self.fine,
            **self.steering.state(),
            **learnt,
        }

    def _restore(self, arrays: dict[str, np.ndarray]) -> None:
        self.lattice.levels[:] = arrays["levels"]
        self.temperature, self.shift, self.fine = arrays["temperature"], arrays["shift"], arrays["fine"]
        self.steering.restore(arrays)
        if self.couplings is not None:
            self.couplings.strength = arrays["strength"]
            self.couplings.act(self.lattice.levels, self.lattice.there)


def _of_scale(schedule: Sequence[T], scale: int) -> T:
    return schedule[min(scale, len(schedule) - 1)]

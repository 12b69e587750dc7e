"""`kopf`: the loop of `shared.solid` with the soft histogram matching of the paper's weights.

A contribution of an exemplar's pixel weighs less by 1 + sum over channels of max(0, H_S(b) -
H_E(b)), where b is the bin of its value, H_S the histogram of the result so far and H_E that of the
pictures.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.progress import notify, part_of
from trabecula.core.request import Request
from trabecula.engine.compile import kernel
from trabecula.engine.memory import Stage
from trabecula.engine.parallel import sum_slabs
from trabecula.exemplar.views import View
from trabecula.synth.kopf import CAPABILITIES
from trabecula.synth.kopf.coarse_flips import match_picture
from trabecula.synth.kopf.coarse_scan import CoarseScan, check_scan
from trabecula.synth.kopf.config import KopfConfig
from trabecula.synth.kopf.fusion import FusionRounds
from trabecula.synth.kopf.process_relative import ProcessRelative, choose_process
from trabecula.synth.kopf.relative import are_far_apart
from trabecula.synth.kopf.relative_model import RelativeModel
from trabecula.synth.kopf.sharpening import sharpen, sharpening_stages
from trabecula.synth.shared.content.fields import phases_present
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.content.kinds import Labels
from trabecula.synth.shared.matching.planes import RegionViews
from trabecula.synth.shared.patterns.flips import pattern_stages
from trabecula.synth.shared.patterns.labels import shares_of
from trabecula.synth.shared.pyramid import fit_to
from trabecula.synth.shared.slabs import make_by_slabs
from trabecula.synth.shared.solid.method import Solid
from trabecula.synth.shared.solid.model import SolidModel
from trabecula.synth.shared.solid.run import SolidRounds, SolidStage

_BINS = 16


class Kopf(Solid):
    """Solid texture synthesis from 2-D exemplars."""

    capabilities = CAPABILITIES
    config_type = KopfConfig

    def _learn(self, exemplars: Sequence[Image], views: tuple[View, ...]) -> KopfModel:
        return KopfModel(self.config, exemplars, views)


class KopfRounds(SolidRounds):
    """A run with the soft histogram matching of the paper's weights."""

    config: KopfConfig

    def factors(self, stage: SolidStage) -> list[np.ndarray] | None:
        """Return smaller factors for values that are too frequent in the last votes."""
        if not self.config.reweighting:
            return None
        views = stage.views
        excess = histogram_excess(self.work["votes"], views, self.config.reweighting)
        return [
            factors_of(view.grid.candidates.stack.field, excess, views.full) for view in views.grids
        ]


class KopfModel(SolidModel):
    """Pictures as pyramids of fields."""

    capabilities = CAPABILITIES
    rounds_type = KopfRounds
    config: KopfConfig
    _learnt: tuple[Image, float | None, RelativeModel] | None = None
    _chosen: ProcessRelative | None = None

    def make(self, request: Request) -> np.ndarray | tuple[np.ndarray, Mapping[str, Any]]:
        """Make a volume from pictures alone, beside a relative in space, or one that a coarse scan
        lays out.
        """
        relative = self._relative(request)
        if relative is not None:
            assert isinstance(self.content, Labels)  # checked with the relative
            return relative.make(request, self.content)
        beside = self._beside_process(request)
        if self.config.process != "none" and beside:
            notify(f"no process goes with {beside}: the picture's planes alone make the volume")
        if request.coarse is None:
            return super().make(request)
        pictures, present = self._phases()
        line = check_scan(request, pictures, present)
        if line:
            notify(line)
        scan = CoarseScan.of(request, pictures, present)
        values, report = self._fuse(request, scan)
        labels = np.array(present, np.uint8)
        made = make_by_slabs(
            lambda a, b: labels[values[a:b].view(np.uint8)], values.shape, np.uint8
        )
        return made, report

    def _fuse(self, request: Request, scan: CoarseScan) -> tuple[np.ndarray, dict[str, Any]]:
        """Return the second phase (Z, Y, X) bool that a coarse scan lays out, and a report."""
        shown = self.flips.shown_at(scan.material.fraction)
        if shown is None and self.flips.rounds:
            notify(
                "the picture does not tell of material with the scan's fraction "
                f"({scan.material.fraction:.3f}): interfaces stay as they are sharpened"
                + (", and the sections' Euler number is not met" if self.sections else "")
            )
        shares = shares_of(shown)
        with part_of(shares, 0):
            rounds = FusionRounds(self, request, scan)
            rounds.run()
            rounds.work.enter("deliver")
            votes = fit_to(rounds.work.take("votes"), request.shape)[0]
            values, plain, told = sharpen(votes, scan.bounds(0), scan.material)
        report: dict[str, Any] = {"coarse": told}
        if shown is not None:
            with part_of(shares, 1):
                values, report["patterns"] = match_picture(
                    values,
                    plain,
                    votes,
                    scan,
                    shown,
                    self.flips.joined,
                    seed=request.seed,
                    rounds=self.flips.rounds,
                    clip=self.config.clip,
                )
        return values, report

    def _check_request(self, request: Request) -> None:
        super()._check_request(request)
        if request.coarse is not None:
            check_scan(request, *self._phases())
        if request.like is not None and self.sections:
            raise RequestError(
                "a relative says how the material continues across the picture, as parallel "
                "sections do: leave out the gap, or the relative"
            )
        beside = self._beside_process(request)
        if beside and self.config.process not in ("none", "auto"):
            raise RequestError(
                f"process={self.config.process} beside {beside}: a process goes with shape, seed, "
                "periodic axes, a mask and a porosity alone; leave out one of them"
            )
        relative = self._relative(request)
        if relative is not None:
            relative.check(request)

    def _relative(self, request: Request) -> RelativeModel | None:
        """Return what is learnt from the relative of a request, or from a process; None where the
        planes alone make the volume.
        """
        if request.like is not None:
            if self.exemplars[0].kind != "labels":
                raise RequestError(
                    f"the exemplar is {self.exemplars[0].kind}: beside a relative a picture is of "
                    "labels; segment it (--threshold)"
                )
            return self._learn_relative(request, request.like)
        if self.config.process == "none" or self._beside_process(request):
            return None
        chosen = self._process()
        if chosen.relative is None:
            return None
        try:
            return self._learn_relative(request, chosen.relative, chosen.report)
        except RequestError as err:
            if self.config.process != "auto":
                raise
            self._take_process(ProcessRelative(None, f"{err}: its planes alone make the volume"))
            return None

    def _learn_relative(
        self, request: Request, like: Image, process: Mapping[str, Any] | None = None
    ) -> RelativeModel:
        """Return what is learnt from a relative at the fraction of a request; the last one is
        kept.
        """
        known, fraction = self._learnt, self._asked_fraction(request)
        if known is None or known[0] is not like or known[1] != fraction:
            shown, rounds = self.flips.shown_for(request), self.config.interface_rounds
            present = self._phases()[1]
            made = RelativeModel.of(like, self.views, present, process, fraction, shown, rounds)
            known = self._learnt = (like, fraction, made)
        return known[2]

    def _asked_fraction(self, request: Request) -> float | None:
        """Return the fraction of the second of two phases that a request asks for; None where it
        asks for none.
        """
        if not request.target or not isinstance(self.content, Labels):
            return None
        asked = self.content.fractions_of_target(request)
        return None if asked is None or len(asked) != 2 else float(asked[1])

    def _process(self) -> ProcessRelative:
        """Return the process that gives the third dimension, found once."""
        if self._chosen is None:
            present = self._phases()[1] if self.exemplars[0].kind == "labels" else ()
            self._take_process(choose_process(self.views, present, self.config.process))
        assert self._chosen is not None
        return self._chosen

    def _take_process(self, chosen: ProcessRelative) -> None:
        """Keep where the third dimension comes from, and say it."""
        self._chosen = chosen
        notify(chosen.line)

    def _beside_process(self, request: Request) -> str:
        """Name the parts of a request that a process does not go with."""
        beside = sorted(request.asks_for() - {"periodic", "mask", "target"})
        asked = self._asked_fraction(request)
        if asked is not None and isinstance(self.content, Labels):
            own = float(self.content.fractions[1])
            beside += ["a porosity far from the picture's"] if are_far_apart(asked, own) else []
        return ", ".join(beside)

    def _phases(self) -> tuple[list[Image], tuple[int, ...]]:
        """Return the pictures of all views, and the labels that occur in them."""
        pictures = [view.image for view in self.views]
        return pictures, phases_present(pictures)

    def _stages(self, request: Request, *, mapped: bool = False) -> tuple[Stage, ...]:
        relative = self._relative(request)
        if relative is not None:
            nbytes = self.output_bytes(request)
            return relative.stages(request, nbytes=nbytes, mapped=mapped)
        found = super()._stages(request, mapped=mapped)
        if request.coarse is None:
            return found
        found = (*found, *sharpening_stages(request.shape))
        if not self.flips.rounds:
            return found
        return (*found, *pattern_stages(request.shape, 1, free=False, sides=request.blocks))

    def _fixed(self) -> dict[str, int]:
        held = 0 if self._learnt is None else self._learnt[2].nbytes
        return super()._fixed() | ({"relative": held} if held else {})


def histogram_excess(votes: np.ndarray, views: RegionViews, strength: float) -> np.ndarray:
    """Return (C, 16): strength times the share of a bin in votes (C, Z, Y, X) int16 beyond its
    share in the target.
    """
    free = np.empty((0, 0, 0), bool) if views.region.free is None else views.region.free

    def count(start: int, stop: int) -> np.ndarray:
        counts = np.zeros((len(votes), _BINS), np.int64)
        count_bins(votes, free, counts, start, stop)
        return counts

    counts = sum_slabs(count, votes.shape[1])
    own = counts / np.maximum(1, counts.sum(axis=1, keepdims=True))
    return strength * np.maximum(own - np.array([_shares(target) for target in views.targets]), 0)


def factors_of(exemplar: np.ndarray, excess: np.ndarray, full: int) -> np.ndarray:
    """Return the factor (z, y, x) int16 of every voxel of (C, z, y, x) int8: `full` over 1 + the
    excess of its values' bins.
    """
    total = np.ones(exemplar.shape[1:])
    for channel, over in zip(exemplar, excess, strict=True):
        total += over[_bin(channel)]
    return np.maximum(np.rint(full / total), 1).astype(np.int16)


def _shares(target: Histogram) -> np.ndarray:
    counts = np.diff(target.up_to, prepend=0)
    return np.bincount(_bin(target.values), weights=counts, minlength=_BINS) / counts.sum()


def _bin(values: np.ndarray) -> np.ndarray:
    return (values.astype(np.int16) + 128) >> 4


@kernel
def count_bins(votes, free, counts, start, stop):
    """Count the voxels of planes start..stop of (C, Z, Y, X) int16 in each of 16 equal bins, added
    to counts (C, 16).

    Only those that are `free` (Z, Y, X) bool count; empty means all.
    """
    for c in range(votes.shape[0]):
        for z in range(start, stop):
            for y in range(votes.shape[2]):
                for x in range(votes.shape[3]):
                    if free.size == 0 or free[z, y, x]:
                        counts[c, (votes[c, z, y, x] >> 12) + 8] += 1

"""`texture`: fit keeps the exemplar's pyramid, generate optimises the output level by level.

Per level: random patches (coarsest) or the doubled result, then rounds of search (nearest neighbourhood of the exemplar
for each of a sparse grid), vote (robust mean of what overlaps) and histogram matching. The fields are clipped signed
distances, so the last threshold is exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.progress import track
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine.plan import Plan
from trabecula.engine.tiles import for_slabs, thread_count
from trabecula.synth.base import Method, Model
from trabecula.synth.shared.fields import FULL, labels_of, phase_fields, quantise
from trabecula.synth.shared.histogram import match_histogram
from trabecula.synth.shared.neighbourhoods import (
    SCALE,
    Basis,
    basis_bytes,
    block_bytes,
    covered_shape,
    grid_shape,
    principal_basis,
    project,
)
from trabecula.synth.shared.pyramid import double, fit_to, halve
from trabecula.synth.texture import SPEC
from trabecula.synth.texture.config import TextureConfig
from trabecula.synth.texture.kernels import search, start_matches, vote

_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded
_ROOM = 4  # positions that a neighbourhood needs along an axis of the exemplar, at least, on any level
_SPARSE_BELOW = 4  # a coarsest level at less than this scale is too large for neighbourhoods at every voxel
_MANY = 1_000_000  # neighbourhoods of an exemplar above which only every `step`-th is a candidate


@dataclass(frozen=True)
class Level:
    """The exemplar at one resolution: its field, and every candidate neighbourhood as a feature vector."""

    field: np.ndarray  # (C, z, y, x) int8
    sorted_values: np.ndarray  # (C, n) int8, rising
    basis: Basis
    features: np.ndarray  # (N, D) int16
    shape: tuple[int, ...]  # candidates along each axis
    stride: int  # voxels between candidates
    step: int  # voxels between the output's neighbourhoods


@dataclass(frozen=True)
class State:
    """The output at one resolution."""

    match: np.ndarray  # (sz, sy, sx) int32, index of the nearest neighbourhood per site
    votes: np.ndarray  # (C, Z, Y, X) int16, the weighted mean of what overlaps, times 256
    field: np.ndarray  # (C, Z, Y, X) int8, the same with the exemplar's histogram


class Texture(Method):
    """3-D exemplar optimisation."""

    spec = SPEC
    config_type = TextureConfig

    def _fit(self, exemplar: Image) -> TextureModel:
        config: TextureConfig = self.config
        if min(exemplar.shape) < config.neighbourhood + _ROOM:
            raise InputError(
                f"the exemplar is {exemplar.shape}, a neighbourhood of {config.neighbourhood} needs at least "
                f"{config.neighbourhood + _ROOM} voxels along every axis: give a larger exemplar, or a smaller neighbourhood"
            )
        return TextureModel(config, [exemplar])

    def plan_fit(self, exemplar: Image) -> Plan:
        """The principal components, and the finest level's fields and candidates."""
        present = len(np.unique(exemplar.values))
        channels = 1 if present == 2 else present
        fields = exemplar.values.size * (14 + 10 * channels)
        basis = basis_bytes(channels * self.config.neighbourhood**3)
        return Plan({"interpreter and kernels": _PROCESS, "fields": fields, "basis": basis})


class TextureModel(Model):
    """An exemplar as a pyramid of signed distances with the neighbourhoods of every level."""

    spec = SPEC
    config: TextureConfig

    def __init__(self, config: TextureConfig, exemplars: list[Image]) -> None:
        super().__init__(config, exemplars)
        exemplar = exemplars[0]
        count = min(config.levels, _levels_that_fit(exemplar.shape, config.neighbourhood))
        fields, self.present = phase_fields(exemplar)
        pyramid = [fields]
        for _ in range(count - 1):
            pyramid.append(halve(pyramid[-1]))
        self.levels = [
            _level(field, config, scale=2**i, coarsest=i == count - 1)
            for i, field in track(list(enumerate(pyramid)), "learning the exemplar")
        ]
        self.fractions = np.bincount(exemplar.values.ravel())[list(self.present)] / exemplar.values.size

    def _generate(self, request: Request) -> np.ndarray:
        state = None
        for i in reversed(range(len(self.levels))):
            level = self.levels[i]
            shape = tuple(-(-side // 2**i) for side in request.shape)
            grid = grid_shape(shape, width=level.basis.width, step=level.step)
            stage = key(request.seed, f"texture/{i}")
            if state is None:
                match = np.empty(grid, np.int32)
                start_matches(match, len(level.features), stage)
                state = _cast(level, match, np.ones(grid, np.int32), trim=0)
            else:
                state = _refined(self.levels[i + 1], level, state, grid)
            state = self._optimise(level, state, stage, index=i)
        assert state is not None  # there is at least one level
        inside = (slice(None), *(slice(side) for side in request.shape))
        return labels_of(np.ascontiguousarray(state.votes[inside]), self.present, self.fractions)

    def _optimise(self, level: Level, state: State, stage: np.uint64, *, index: int) -> State:
        config = self.config
        coarsest = index == len(self.levels) - 1
        rounds = config.first_rounds if coarsest else config.rounds[min(index, len(config.rounds) - 1)]
        for number in track(range(rounds), f"level {len(self.levels) - index} of {len(self.levels)}"):
            features = project(state.field, level.basis, step=level.step)
            match = state.match
            for sweep in range(config.sweeps):
                match, distance = _sweep(level, match, features, stage, number * config.sweeps + sweep, config)
            weights = _weights(distance, level, config.robustness)
            state = _cast(level, match, weights, trim=config.trim if index == 0 else 0)
        return state

    def _plan(self, request: Request) -> Plan:
        finest = self.levels[0]
        grid = grid_shape(request.shape, width=finest.basis.width, step=finest.step)
        voxels = int(np.prod(covered_shape(grid, width=finest.basis.width, step=finest.step), dtype=np.int64))
        sites = int(np.prod(grid, dtype=np.int64))
        channels, dimensions = len(finest.field), finest.features.shape[1]
        # Two moments compete for the peak: a vote beside the round before, and (several phases) the last choice in float32.
        voting = voxels * (9 * channels + 7) + sites * (2 * dimensions + 20)
        choosing = voxels * (20 * channels + 10) if len(self.present) > 2 else 0
        return Plan(
            memory={
                "interpreter and kernels": _PROCESS,
                "exemplar": sum(level.features.nbytes + level.field.nbytes for level in self.levels),
                "output": max(voting, choosing),
                "scratch": thread_count() * block_bytes(finest.basis, grid) + 16 * len(finest.features),
            },
            disk=int(np.prod(request.shape, dtype=np.int64)),  # uncompressed; most formats take a tenth
        )


def _levels_that_fit(shape: tuple[int, ...], width: int) -> int:
    count = 1
    while min(shape) // 2**count >= width + _ROOM:
        count += 1
    return count


def _level(field: np.ndarray, config: TextureConfig, *, scale: int, coarsest: bool) -> Level:
    values = quantise(field / np.float32(scale), clip=config.clip)
    basis = principal_basis(values, width=config.neighbourhood, variance=config.variance, most=config.components)
    step = 1 if coarsest and scale >= _SPARSE_BELOW else config.step
    positions = np.prod([side - config.neighbourhood + 1 for side in values.shape[1:]])
    stride = step if positions > _MANY else 1
    features = project(values, basis, step=stride)
    ranked = np.sort(values.reshape(len(values), -1), axis=1)
    return Level(
        values, ranked, basis, features.reshape(-1, features.shape[-1]), features.shape[:3], stride=stride, step=step
    )


def _refined(coarse: Level, level: Level, state: State, grid: tuple[int, ...]) -> State:
    """The coarse result on the finer grid: its field doubled (a distance doubles too), its matches moved along."""
    shape = covered_shape(grid, width=level.basis.width, step=level.step)
    farther = np.clip(double(state.field).astype(np.int16) * 2, -FULL, FULL).astype(np.int8)
    doubled = fit_to(farther, shape)
    sites, moved = [], []
    for count, have in zip(grid, state.match.shape, strict=True):
        corner = np.arange(count) * level.step
        site = np.minimum(corner // (2 * coarse.step), have - 1)
        sites.append(site)
        moved.append(corner - 2 * site * coarse.step)
    old = state.match[np.ix_(*sites)]
    fine = [
        np.clip((2 * cell * coarse.stride + offset) // level.stride, 0, side - 1)
        for cell, offset, side in zip(np.unravel_index(old, coarse.shape), np.ix_(*moved), level.shape, strict=True)
    ]
    return State(np.ravel_multi_index(fine, level.shape).astype(np.int32), doubled.astype(np.int16) * 256, doubled)


def _sweep(
    level: Level, old: np.ndarray, features: np.ndarray, stage: np.uint64, sweep: int, config: TextureConfig
) -> tuple[np.ndarray, np.ndarray]:
    """One search sweep: new matches and their distances."""
    match = np.empty_like(old)
    distance = np.empty(old.shape, np.int32)
    penalty = _penalty(old, len(level.features), config.index_penalty)
    ratio = level.step // level.stride

    def work(start: int, stop: int) -> None:
        search(
            features,
            level.features,
            penalty,
            old,
            match,
            distance,
            level.shape,
            ratio,
            stage,
            sweep + 1,
            config.tries,
            start,
            stop,
        )

    for_slabs(work, len(old), least=2)
    return match, distance


def _penalty(match: np.ndarray, count: int, weight: float) -> np.ndarray:
    """w_d = 1 + weight * max(0, H / theta - 1), theta = 1 / |E| (section 4.2), frozen for one sweep."""
    share = np.bincount(match.ravel(), minlength=count).astype(np.float32) * np.float32(count / match.size)
    return np.float32(1) + np.float32(weight) * np.maximum(share - 1, 0)


def _weights(distance: np.ndarray, level: Level, robustness: float) -> np.ndarray:
    """w_p = d^(r - 2) of the neighbourhood distance d (equation 2 without its trace), as integers of 1 .. 1023.

    Through a table over the ratio to the mean, so that no power function is asked for a bit it might round otherwise.
    """
    # One quantum per voxel keeps an exact match from outvoting everything.
    floor = SCALE**2 * level.basis.width**3 * len(level.field)
    mean = int(distance.sum(dtype=np.int64)) // distance.size + floor
    ratio = np.clip((distance.astype(np.int64) + floor) * 256 // mean, 1, 4095)
    table = np.clip(np.rint(255 * (np.arange(4096).clip(1) / 256) ** ((robustness - 2) / 2)), 1, 1023)
    return table.astype(np.int32)[ratio]


def _cast(level: Level, match: np.ndarray, weights: np.ndarray, *, trim: int) -> State:
    """Vote and match the histogram: the matches become a field."""
    votes = _voted(level, match, weights, trim=trim)
    matched = [match_histogram(mean, values) for mean, values in zip(votes, level.sorted_values, strict=True)]
    return State(match, votes, np.stack(matched))


def _voted(level: Level, match: np.ndarray, weights: np.ndarray, *, trim: int) -> np.ndarray:
    width = level.basis.width
    shape = covered_shape(match.shape, width=width, step=level.step)
    total = np.empty((len(level.field) + 1, *shape), np.int32)
    votes = np.empty((len(level.field), *shape), np.int16)

    def work(start: int, stop: int) -> None:
        vote(level.field, match, weights, level.shape, level.stride, level.step, width, trim, total, votes, start, stop)

    for_slabs(work, shape[0])
    return votes

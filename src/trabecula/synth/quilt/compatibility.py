"""(N, D)-compatibility before a run (section 3.4): how near the exemplars can come to a target,
place by place.

D is exact for each place alone: no neighbourhood of the exemplars is nearer to the target. N is
what a neighbourhood like the one asked for finds as its best partner in an overlap, estimated from
the exemplars' own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.request import Request
from trabecula.core.target import OF_A_PHASE
from trabecula.engine.compile import kernel
from trabecula.synth.quilt.bit_packing import mismatches, query_of
from trabecula.synth.quilt.candidate_pools import SCALE, WEIGHT, Descriptors, Pool, Pools
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.local_targets import targets_at
from trabecula.synth.quilt.patch_library import Learnt
from trabecula.synth.quilt.period import phase_key
from trabecula.synth.quilt.windows import Frame

_BINS, _SAMPLES = 16, 6
"""Parts of the most important descriptor's range in which the mismatch is told, and neighbourhoods
asked in each.
"""

_SLACK = 1e-6  # fields are float32


@dataclass(frozen=True)
class Forecast:
    """How near the exemplars can come to a target.

    Attributes
    ----------
    asked : dict of str to (float, float)
        Least and greatest target over all places, by descriptor.
    held : dict of str to (float, float)
        What neighbourhoods of the exemplars have.
    difference : float array, one entry per place along z, y, x
        Weighted difference of the nearest neighbourhood's descriptors from the target, each over
        its range in the exemplars (equation 6): nothing that is made can be nearer. NaN where
        nothing is made.
    mismatch : float array, the same
        Share of differing voxels that a neighbourhood near the target has with its best partner.
    outside : float
        Share of the places whose target no neighbourhood has, 0 .. 1.
    advice : str
        What to do; empty where nothing is wanting.
    """

    asked: Mapping[str, tuple[float, float]]
    held: Mapping[str, tuple[float, float]]
    difference: np.ndarray
    mismatch: np.ndarray
    outside: float
    advice: str

    def to_json(self) -> dict[str, Any]:
        """Ranges, means and maxima as plain JSON."""
        told: dict[str, Any] = {
            "asked": dict(self.asked),
            "held": dict(self.held),
            "outside": self.outside,
        }
        for name, values in (("descriptors", self.difference), ("mismatch", self.mismatch)):
            told[name] = {"mean": float(np.nanmean(values)), "max": float(np.nanmax(values))}
        return {**told, "advice": self.advice}


def held_by(learnt: Learnt, name: str) -> tuple[float, float]:
    """Least and greatest value of a descriptor over all neighbourhoods."""
    fields = [learnt.described(image, name) for image in learnt.images]
    return min(float(field.min()) for field in fields), max(float(field.max()) for field in fields)


def asked_by(request: Request, name: str) -> tuple[float, float]:
    """Least and greatest value of a target, inside the mask."""
    values = np.asarray(request.target[name])
    if request.mask is None or not values.ndim:
        return float(values.min()), float(values.max())
    low, high = np.inf, -np.inf
    # one by one: no copy of the whole is made
    for plane, mask in zip(values, request.mask, strict=True):
        kept = plane[mask]
        low, high = (
            min(low, float(kept.min(initial=np.inf))),
            max(high, float(kept.max(initial=-np.inf))),
        )
    return low, high


def check_held(learnt: Learnt, request: Request, held: dict[str, tuple[float, float]]) -> None:
    """Raise where no part of a target is within what neighbourhoods hold; `held` keeps what was
    measured.

    Raises
    ------
    RequestError
        A target beyond all neighbourhoods; a phase that the exemplars do not have; a functional of
        the other dimension.
    """
    for name in request.target:
        check_named(learnt, name)
        if name not in held:
            held[name] = held_by(learnt, name)
        (least, most), (low, high) = asked_by(request, name), held[name]
        if most < low - _SLACK or least > high + _SLACK:
            raise RequestError(
                f"the target {name} asks for {_range(least, most)}, neighbourhoods of {learnt.measured} voxels of the exemplar "
                f"hold {_range(low, high)}: {_advice(name)}"
            )


def check_named(learnt: Learnt, name: str) -> None:
    """Raise where the exemplars cannot have a descriptor."""
    phases = learnt.images[0].phases
    if name.startswith(OF_A_PHASE) and name[len(OF_A_PHASE) :] not in phases:
        raise RequestError(
            f"the target {name} is of a phase that the exemplar lacks: it has {', '.join(phases)}"
        )
    if name in (("surface", "mean_curvature") if learnt.flat else ("perimeter",)):
        other = "perimeter" if learnt.flat else "surface"
        raise RequestError(
            f"the target {name} is not one of {2 if learnt.flat else 3}-D images: ask for {other}"
        )


def forecast_of(learnt: Learnt, config: QuiltConfig, frame: Frame, request: Request) -> Forecast:
    """The forecast of a request; see `Forecast`."""
    if not request.target:
        raise RequestError(
            "a forecast needs a target to compare the exemplar with: give one, such as volume_fraction"
        )
    described = Descriptors.of(learnt, list(request.target), config.weights)
    pools = Pools(learnt, described, request.seed)
    target = {
        name: np.reshape(t, frame.shape) if np.ndim(t) else t for name, t in request.target.items()
    }
    mask = None if request.mask is None else request.mask.reshape(frame.shape)
    difference = np.full(frame.counts, np.nan)
    mismatch = np.full(frame.counts, np.nan)
    partners = _partners(learnt, config, pools.of((0, 0, 0)), described)
    outside = total = 0
    for number in range(difference.size):
        corner = frame.corner(number)
        if mask is not None and not mask[np.ix_(*frame.indices(corner))].any():
            continue
        asked = described.scaled(targets_at(target, frame, corner, learnt.middle, mask))
        pool = pools.of(phase_key(corner, learnt.periods))
        difference.flat[number] = least_difference(pool.values, described.weights, asked) / (
            SCALE * WEIGHT
        )
        mismatch.flat[number] = partners[
            min(max(int(asked[0]) * _BINS // (SCALE + 1), 0), _BINS - 1)
        ]
        outside += bool(((asked < 0) | (asked > SCALE)).any())
        total += 1
    asked_for = {name: asked_by(request, name) for name in request.target}
    held = {
        name: (float(described.low[k]), float(described.high[k]))
        for k, name in enumerate(described.names)
    }
    share = outside / max(total, 1)
    return Forecast(asked_for, held, difference, mismatch, share, _told(asked_for, held))


def _partners(
    learnt: Learnt, config: QuiltConfig, pool: Pool, described: Descriptors
) -> np.ndarray:
    """(_BINS,) the mismatch with the best partner elsewhere, by the most important descriptor."""
    found = np.full(_BINS, np.nan)
    near = np.zeros(learnt.box, np.bool_)
    for axis, side in enumerate(learnt.box):
        if side > 1:
            near[(slice(None),) * axis + (slice(learnt.overlap),)] = True
    for part in range(_BINS):
        low, high = np.searchsorted(
            pool.values[0], [part * (SCALE + 1) // _BINS, (part + 1) * (SCALE + 1) // _BINS]
        )
        shares = []
        for n in np.linspace(low, high - 1, min(_SAMPLES, high - low)).astype(int):
            query = query_of(learnt.words, learnt.piece(int(pool.at[n])), near, learnt.strides[1:])
            at, _ = pool.nearest(
                pool.values[:, n].astype(np.int64),
                described.weights,
                config.candidates or len(pool.at),
            )
            own = _apart(learnt, at, int(pool.at[n]))
            if own.any():
                shares.append(int(mismatches(learnt.words, query, at[own]).min()) / query.voxels)
        if shares:
            found[part] = np.mean(shares)
    known = np.flatnonzero(~np.isnan(found))
    return np.interp(np.arange(_BINS), known, found[known]) if len(known) else found


def _apart(learnt: Learnt, at: np.ndarray, own: int) -> np.ndarray:
    """Which patches share no voxel with one."""
    places = np.array(np.unravel_index(at, learnt.stack.shape))
    here = np.array(np.unravel_index(own, learnt.stack.shape))[:, None]
    away = np.abs(places - here)
    return (away[0] > 0) | (away[1:] >= learnt.patch).any(axis=0)


@kernel
def least_difference(values, weights, target):
    """The weighted difference of the candidate nearest to a target (equation 6), whole numbers."""
    least = np.int64(1) << 62
    for n in range(values.shape[1]):
        total = np.int64(0)
        for k in range(len(target)):
            total += weights[k] * abs(np.int64(values[k, n]) - target[k])
        least = min(least, total)
    return least


def _told(asked: Mapping[str, tuple[float, float]], held: Mapping[str, tuple[float, float]]) -> str:
    beyond = [
        f"{name} asks for {_range(*asked[name])}, the exemplar holds {_range(*held[name])}: {_advice(name)}"
        for name in asked
        if asked[name][0] < held[name][0] - _SLACK or asked[name][1] > held[name][1] + _SLACK
    ]
    if beyond:
        return "; ".join(beyond)
    return ""


def _range(low: float, high: float) -> str:
    return f"{low:.4g}" if low == high else f"{low:.4g} .. {high:.4g}"


def _advice(name: str) -> str:
    thicken = (
        ", or thicken it (finish.thicken)"
        if name.partition(":")[0] in ("volume_fraction", "porosity")
        else ""
    )
    return f"bring the field in, add an exemplar that holds it{thicken}"

"""(N, D)-compatibility (section 3.4): a forecast of how near the exemplars can come to a target,
and a record of how near each place came.

In the forecast D is exact for each place alone: no patch of the exemplars is nearer to the target.
N is the mismatch of a patch near the target with its best partner in an overlap, estimated from the
exemplars' own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.progress import part
from trabecula.core.request import Request
from trabecula.core.target import OF_A_PHASE, densities_of, is_apparent
from trabecula.engine import memmap
from trabecula.engine.compile import kernel
from trabecula.synth.quilt.candidates import (
    SCALE,
    WEIGHT,
    CandidateDescriptors,
    CandidatePool,
    CandidatePools,
)
from trabecula.synth.quilt.canvas import PatchGrid, targets_at
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.patch_library import PatchLibrary, mismatches, overlap_query
from trabecula.synth.quilt.period import phase_key

_BINS, _SAMPLES = 16, 6
"""Parts of the most important descriptor's range, and patches sampled in each for the mismatch."""

_SLACK = 1e-6  # fields are float32

_SOLVING = 0.9  # of the first run with an apparent property


@dataclass(frozen=True)
class CompatibilityForecast:
    """Forecast of how near the exemplars can come to a target.

    Attributes
    ----------
    asked : dict of str to (float, float)
        Least and greatest target over all places, by descriptor.
    held : dict of str to (float, float)
        Least and greatest value of the exemplars' patches.
    difference : float array, one entry per place along z, y, x
        Weighted difference of the nearest neighbourhood's descriptors from the target, each over
        its range in the exemplars (equation 6): a lower bound. NaN where nothing is made.
    mismatch : float array, the same
        Share of differing voxels of a patch near the target with its best partner.
    outside : float
        Share of the places with a target beyond all patches, 0 .. 1.
    advice : str
        Advice; empty where all targets are within range.
    """

    asked: Mapping[str, tuple[float, float]]
    held: Mapping[str, tuple[float, float]]
    difference: np.ndarray
    mismatch: np.ndarray
    outside: float
    advice: str

    def to_json(self) -> dict[str, Any]:
        """Return ranges, means and maxima as plain JSON."""
        summary: dict[str, Any] = {
            "asked": dict(self.asked),
            "held": dict(self.held),
            "outside": self.outside,
        }
        for name, values in (("descriptors", self.difference), ("mismatch", self.mismatch)):
            summary[name] = {"mean": float(np.nanmean(values)), "max": float(np.nanmax(values))}
        return {**summary, "advice": self.advice}


def descriptor_range(library: PatchLibrary, name: str) -> tuple[float, float]:
    """Return the least and greatest value of a descriptor over all patches."""
    fields = [library.describe_patches(number, name) for number in range(len(library.images))]
    return min(float(field.min()) for field in fields), max(float(field.max()) for field in fields)


def target_range(request: Request, name: str) -> tuple[float, float]:
    """Return the least and greatest value of a target, inside the mask."""
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


def check_targets(
    library: PatchLibrary, request: Request, held: dict[str, tuple[float, float]]
) -> None:
    """Raise where no part of a target is within the range of the patches; `held` caches the ranges.

    Raises
    ------
    RequestError
        A target beyond all patches; a phase that the exemplars lack; a functional of the other
        dimension.
    """
    for name in densities_of(request.target):
        check_descriptor(library, name)
        if name not in held:
            with part(0.0, _SOLVING if is_apparent(name) else 0.0):
                held[name] = descriptor_range(library, name)
        (least, most), (low, high) = target_range(request, name), held[name]
        if most < low - _SLACK or least > high + _SLACK:
            raise RequestError(
                f"the target {name} asks for {_range(least, most)}, neighbourhoods of "
                f"{library.descriptor_size} voxels of the exemplar hold {_range(low, high)}: "
                f"{_advice(name)}"
            )


def check_descriptor(library: PatchLibrary, name: str) -> None:
    """Raise where the exemplars cannot have a descriptor."""
    phases = library.images[0].phases
    if name.startswith(OF_A_PHASE) and name[len(OF_A_PHASE) :] not in phases:
        raise RequestError(
            f"the target {name} is of a phase that the exemplar lacks: it has {', '.join(phases)}"
        )
    if library.flat and is_apparent(name):
        raise RequestError(f"the target {name} is one of volumes, the exemplar is 2-D")
    if name in (("surface", "mean_curvature") if library.flat else ("perimeter",)):
        other = "perimeter" if library.flat else "surface"
        raise RequestError(
            f"the target {name} is not one of {2 if library.flat else 3}-D images: ask for {other}"
        )


def forecast_compatibility(
    library: PatchLibrary, config: QuiltConfig, grid: PatchGrid, request: Request
) -> CompatibilityForecast:
    """Forecast the compatibility of a request; see `CompatibilityForecast`."""
    if not request.target:
        raise RequestError(
            "a forecast needs a target to compare the exemplar with: give one, such as "
            "volume_fraction"
        )
    descriptors = CandidateDescriptors.measure(library, list(request.target), config.weights)
    pools = CandidatePools(library, descriptors, request.seed)
    target = {
        name: np.reshape(t, grid.shape) if np.ndim(t) else t for name, t in request.target.items()
    }
    mask = None if request.mask is None else request.mask.reshape(grid.shape)
    difference = np.full(grid.counts, np.nan)
    mismatch = np.full(grid.counts, np.nan)
    partners = _partner_mismatch(library, config, pools.pool((0, 0, 0)), descriptors)
    outside = total = 0
    for number in range(difference.size):
        corner = grid.corner(number)
        if mask is not None and not mask[np.ix_(*grid.indices(corner))].any():
            continue
        asked = descriptors.scale_targets(
            targets_at(target, grid, corner, library.descriptor_centre, mask)
        )
        pool = pools.pool(phase_key(corner, library.periods))
        difference.flat[number] = least_difference(pool.values, descriptors.weights, asked) / (
            SCALE * WEIGHT
        )
        mismatch.flat[number] = partners[
            min(max(int(asked[0]) * _BINS // (SCALE + 1), 0), _BINS - 1)
        ]
        outside += bool(((asked < 0) | (asked > SCALE)).any())
        total += 1
    asked_for = {name: target_range(request, name) for name in request.target}
    held = {
        name: (float(descriptors.low[k]), float(descriptors.high[k]))
        for k, name in enumerate(descriptors.names)
    }
    share = outside / max(total, 1)
    return CompatibilityForecast(
        asked_for, held, difference, mismatch, share, _advise(asked_for, held)
    )


def _partner_mismatch(
    library: PatchLibrary,
    config: QuiltConfig,
    pool: CandidatePool,
    descriptors: CandidateDescriptors,
) -> np.ndarray:
    """Estimate the mismatch with the best partner elsewhere, by the most important descriptor,
    (_BINS,).
    """
    found = np.full(_BINS, np.nan)
    near = np.zeros(library.box, np.bool_)
    for axis, side in enumerate(library.box):
        if side > 1:
            near[(slice(None),) * axis + (slice(library.overlap),)] = True
    for level in range(_BINS):
        low, high = np.searchsorted(
            pool.values[0], [level * (SCALE + 1) // _BINS, (level + 1) * (SCALE + 1) // _BINS]
        )
        shares = []
        for n in np.linspace(low, high - 1, min(_SAMPLES, high - low)).astype(int):
            query = overlap_query(
                library.words, library.patch_at(int(pool.at[n])), near, library.strides[1:]
            )
            at, _ = pool.nearest(
                pool.values[:, n].astype(np.int64),
                descriptors.weights,
                config.candidates or len(pool.at),
            )
            own = _disjoint(library, at, int(pool.at[n]))
            if own.any():
                shares.append(int(mismatches(library.words, query, at[own]).min()) / query.voxels)
        if shares:
            found[level] = np.mean(shares)
    known = np.flatnonzero(~np.isnan(found))
    return np.interp(np.arange(_BINS), known, found[known]) if len(known) else found


def _disjoint(library: PatchLibrary, at: np.ndarray, own: int) -> np.ndarray:
    """Mark the patches that share no voxel with one."""
    places = np.array(np.unravel_index(at, library.stack.shape))
    here = np.array(np.unravel_index(own, library.stack.shape))[:, None]
    away = np.abs(places - here)
    return (away[0] > 0) | (away[1:] >= library.patch).any(axis=0)


@kernel
def least_difference(values, weights, target):
    """Return the weighted difference of the candidate nearest to a target (equation 6), in whole
    numbers.
    """
    least = np.int64(1) << 62
    for n in range(values.shape[1]):
        total = np.int64(0)
        for k in range(len(target)):
            total += weights[k] * abs(np.int64(values[k, n]) - target[k])
        least = min(least, total)
    return least


def _advise(
    asked: Mapping[str, tuple[float, float]], held: Mapping[str, tuple[float, float]]
) -> str:
    """Return advice on every target beyond the exemplars; empty where there is none."""
    beyond = [
        f"{name} asks for {_range(*asked[name])}, the exemplar holds {_range(*held[name])}: "
        f"{_advice(name)}"
        for name in asked
        if asked[name][0] < held[name][0] - _SLACK or asked[name][1] > held[name][1] + _SLACK
    ]
    if beyond:
        return "; ".join(beyond)
    return ""


def _range(low: float, high: float) -> str:
    """Format a range."""
    return f"{low:.4g}" if low == high else f"{low:.4g} .. {high:.4g}"


def _advice(name: str) -> str:
    """Return advice on one descriptor."""
    thicken = (
        ", or thicken it (finish.thicken)"
        if name.partition(":")[0] in ("volume_fraction", "porosity")
        else ""
    )
    return f"bring the field in, add an exemplar that holds it{thicken}"


_WORST = 5  # places that gave way, in the summary

RECORDS: dict[str, Any] = {
    "mismatch": np.float64,
    "difference": np.float64,
    "tried": np.int32,
    "strut": np.int32,
    "gave_way": np.uint8,
}
"""Arrays of the record of all places, one entry each."""

REASONS = ("", "connectivity", "feature size")
"""Reasons why a place gave way; `PlacementTrace.gave_way` has the position."""


class PlacementTrace:
    """Record of every place.

    Parameters
    ----------
    grid : PatchGrid
    records : mapping of str to ndarray
        Arrays as declared in `RECORDS`, one entry per place; they are overwritten.

    Attributes
    ----------
    grid : PatchGrid
        Where places are: entry (k, j, i) is the k-th along z, and so on.
    mismatch : float array, one entry per place along z, y, x
        Share of the overlap's voxels that differ from the chosen patch: d_N, 0 .. 1; NaN without an
        overlap.
    difference : float array, the same
        Weighted difference of the patch's descriptors from the target, each over its range in the
        exemplars: d_D; NaN without a target.
    tried : int32 array, the same
        Candidates that were cut in and judged; 0 where nothing was to be made.
    strut : int32 array, the same
        Voxels of struts, laid where no patch kept the structure connected.
    gave_way : uint8 array, the same
        Reason why the place gave way, as its position in `REASONS`.
    taken_back : int
        Patches that were taken back.
    painted : int
        Voxels of islands that were painted over in the end.
    joined : dict of str to int
        What `connectivity.join_rest` reports; empty where it had nothing to do.
    """

    mismatch: np.ndarray
    difference: np.ndarray
    tried: np.ndarray
    strut: np.ndarray
    gave_way: np.ndarray

    def __init__(self, grid: PatchGrid, records: Mapping[str, np.ndarray]) -> None:
        self.grid = grid
        for name, dtype in RECORDS.items():
            for layer in _layers(records[name]):
                layer[...] = np.nan if dtype is np.float64 else 0
            setattr(self, name, records[name])
        self.taken_back = self.painted = 0
        self.joined: dict[str, int] = {}

    def add(
        self, number: int, mismatch: float, difference: float, tried: int, strut: int, gave_way: str
    ) -> None:
        """Record a place."""
        at = np.unravel_index(number, self.grid.counts)
        self.mismatch[at], self.difference[at] = mismatch, difference
        self.tried[at], self.strut[at], self.gave_way[at] = tried, strut, REASONS.index(gave_way)

    def drop(self, number: int) -> None:
        """Forget a place whose patch is taken back."""
        self.add(number, math.nan, math.nan, 0, 0, "")
        self.taken_back += 1

    def summary(self) -> dict[str, Any]:
        """Return means and maxima, and the places that gave way, as plain JSON."""
        distances = {
            "mismatch": _mean_and_max(self.mismatch),
            "descriptors": _mean_and_max(self.difference),
        }
        summary: dict[str, Any] = {
            "places": _count_nonzero(self.tried),
            "taken_back": self.taken_back,
            "painted": self.painted,
            **{name: found for name, found in distances.items() if found},
            "struts": _count_nonzero(self.strut),
            "strut_voxels": sum(int(layer.sum(dtype=np.int64)) for layer in _layers(self.strut)),
            "gave_way": _count_nonzero(self.gave_way),
            **self.joined,
        }
        if summary["gave_way"]:
            summary["gave_way_at"] = list(self._first_gave_way())
        return summary

    def gave_way_in(self, reason: str) -> int:
        """Count the places that gave way for a reason."""
        number = REASONS.index(reason)
        return sum(int(np.count_nonzero(layer == number)) for layer in _layers(self.gave_way))

    def _first_gave_way(self) -> Iterator[dict[str, Any]]:
        """Yield the first places that gave way."""
        left = _WORST
        for z, layer in enumerate(_layers(self.gave_way)):
            for at in np.argwhere(layer)[:left]:
                number = int(np.ravel_multi_index((z, *at), self.grid.counts))
                yield {"voxel": list(self.grid.corner(number)), "in": REASONS[layer[tuple(at)]]}
                left -= 1
            if not left:
                return

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of a checkpoint."""
        held = {name: getattr(self, name) for name in RECORDS}
        return {**held, "taken_back": np.array(self.taken_back)}

    def load_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Restore the arrays of a checkpoint."""
        for name in RECORDS:
            setattr(self, name, arrays[name])
        self.taken_back = int(arrays["taken_back"])


def _layers(values: np.ndarray) -> Iterator[np.ndarray]:
    """Yield layer by layer, so that not all is in memory at once."""
    for layer in values:
        yield layer
        memmap.release_pages()


def _count_nonzero(values: np.ndarray) -> int:
    """Count the entries that are not 0."""
    return sum(int(np.count_nonzero(layer)) for layer in _layers(values))


def _mean_and_max(values: np.ndarray) -> dict[str, float]:
    """Return mean and maximum without NaN; empty where all are NaN."""
    sums, most, count = [], -math.inf, 0
    for layer in _layers(values):
        known = layer[~np.isnan(layer)]
        sums.append(float(known.sum()))
        most = max(most, float(known.max(initial=-math.inf)))
        count += len(known)
    return {"mean": _round6(math.fsum(sums) / count), "max": _round6(most)} if count else {}


def _round6(value: float) -> float:
    """Round to 6 decimals."""
    return round(float(value), 6)

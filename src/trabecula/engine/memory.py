"""Memory of a run: declared once, forecast from the declaration, allocated from it, and checked
against a budget before the run starts.

How a method declares its memory
--------------------------------
A method lists the *stages* of its work, and for each stage the large arrays that exist together:

    def _stages(self, shape):
        levels = Array(shape, np.uint8)
        votes = Array((self.channels, *shape), np.int16)
        match = Array(self.grid(shape), np.int32)
        return (
            Stage("search", {"votes": votes, "match": match}, working=threads * bytes_of_a_search),
            Stage("deliver", {"votes": votes, "levels": levels}),
        )

The run allocates from this list and nowhere else, by the same names:

    work = Workspace(self._stages(request.shape))
    work.enter("search")
    votes, match = work.zeros("votes"), work.empty("match")
    ...
    work.enter("deliver")       # frees "match", which this stage does not hold
    return fill(work.empty("levels"), work["votes"])

The forecast is the same list without data. `forecast(stages, fixed)` names the arrays of the stage
that holds the most; its `memory` is what the hook `Model.memory` returns. `resident(stages, fixed)`
counts what stays in memory when the arrays are files: the hook `Model.resident_memory`.

- `working` counts the temporaries of all threads. An array that grows with the volume is declared.
- A function that returns a new array is no obstacle: `work.adopt("votes", votes_of(...))` checks
  its shape and dtype against the declaration, so code and forecast cannot disagree.
- Free an array by entering a stage that does not hold it, or by `release`; a local name that still
  refers to it keeps it alive. `check_releases` (in tests) raises where this happens.
- A step with large arrays of its own declares its own stages and makes its own `Workspace`; the
  caller's forecast counts them beside its arrays: `within(held, step_stages)`.
- Coarse to fine: one `Workspace` a level. `take` hands the result to the next level, which declares
  it among its arrays and calls `adopt`.
- Arrays whose size depends on the data are declared with an upper bound,
  `Array(..., at_most=True)`.
- Sizes that do not grow with the request (interpreter, kernels, exemplar) go into `fixed`.

The worked example is `synth.noise`. Tests hold: real <= forecast <= 1.5 real.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.checks import as_number
from trabecula.core.errors import MemoryBudgetError
from trabecula.engine import memmap
from trabecula.engine.parallel import thread_count

GIB = 1 << 30


@dataclass(frozen=True)
class Plan:
    """Forecast of a run.

    Attributes
    ----------
    memory : dict of str to int
        Bytes, by what they are for; their sum is the peak.
    disk : int
        Bytes of the result.
    scratch : int
        Bytes of memory-mapped files while the run lasts.
    seconds : float, optional
    """

    memory: dict[str, int] = field(default_factory=dict)
    disk: int = 0
    scratch: int = 0
    seconds: float | None = None

    def __repr__(self) -> str:
        parts = [f"{format_bytes(self.peak)} of memory", f"{format_bytes(self.disk)} on disk"]
        parts += [f"{format_bytes(self.scratch)} of scratch files"] if self.scratch else []
        parts += [] if self.seconds is None else [f"about {self.seconds:.0f} s"]
        largest = sorted(self.memory.items(), key=lambda item: -item[1])[:3]
        most = ", ".join(f"{name} {format_bytes(count)}" for name, count in largest)
        return f"<Plan {', '.join(parts)}{f'; most memory: {most}' if most else ''}>"

    @property
    def peak(self) -> int:
        """Return the peak memory in bytes."""
        return sum(self.memory.values())

    def to_json(self) -> dict[str, Any]:
        """Return the forecast as plain JSON."""
        return {**asdict(self), "peak": self.peak}


@dataclass(frozen=True)
class Array:
    """Shape and type of a large array.

    Attributes
    ----------
    shape : tuple of int
    dtype : numpy.dtype
    axis : int
        Axis along which slabs are cut; of fewer axes than that the first.
    at_most : bool
        The real array may have fewer elements, in any shape.
    """

    shape: tuple[int, ...]
    dtype: np.dtype
    axis: int
    at_most: bool

    def __init__(
        self,
        shape: Sequence[int] | int,
        dtype: Any,
        *,
        axis: int = -3,
        at_most: bool = False,
    ) -> None:
        sides = (shape,) if isinstance(shape, int) else shape
        object.__setattr__(self, "shape", tuple(int(side) for side in sides))
        object.__setattr__(self, "dtype", np.dtype(dtype))
        object.__setattr__(self, "axis", axis if len(self.shape) >= -axis else 0)
        object.__setattr__(self, "at_most", at_most)

    @property
    def nbytes(self) -> int:
        """Return the size in bytes."""
        return self.dtype.itemsize * math.prod(self.shape)

    @property
    def plane(self) -> int:
        """Return the bytes of one plane across the slab axis."""
        return -(-self.nbytes // max(1, self.shape[self.axis])) if self.shape else self.nbytes

    def check(self, array: np.ndarray, *, name: str) -> None:
        """Raise `ValueError` where an array is not as declared."""
        fits = array.nbytes <= self.nbytes if self.at_most else array.shape == self.shape
        if not fits or array.dtype != self.dtype:
            raise ValueError(
                f"array {name!r} is {array.dtype} of shape {array.shape}, declared as "
                f"{self.dtype} of shape {self.shape}{' at most' if self.at_most else ''}"
            )


@dataclass(frozen=True)
class Stage:
    """A part of a run, and the large arrays that exist together while it lasts.

    Attributes
    ----------
    name : str
    arrays : mapping of str to Array
        By name. An entry None is left out.
    working : int
        Bytes of the temporaries of all threads beside them.
    planes : int
        Planes of every array that a thread touches for the thinnest slab: 1, and the halo.
    """

    name: str
    arrays: Mapping[str, Array]
    working: int = 0
    planes: int = 1

    def __init__(
        self,
        name: str,
        arrays: Mapping[str, Array | None],
        working: float = 0,
        planes: int = 1,
    ) -> None:
        object.__setattr__(self, "name", name)
        object.__setattr__(
            self, "arrays", {key: array for key, array in arrays.items() if array is not None}
        )
        object.__setattr__(self, "working", int(working))
        object.__setattr__(self, "planes", planes)

    @property
    def nbytes(self) -> int:
        """Return the bytes of all arrays."""
        return sum(array.nbytes for array in self.arrays.values())

    @property
    def peak(self) -> int:
        """Return the bytes of all arrays and of the temporaries."""
        return self.nbytes + self.working

    @property
    def slab(self) -> int:
        """Return the bytes that stay in memory where the arrays are memory-mapped: the temporaries,
        and the pages of the thinnest slab of each thread.
        """
        pages = sum(
            min(array.nbytes, thread_count() * self.planes * array.plane)
            for array in self.arrays.values()
        )
        return self.working + pages


def within(held: Mapping[str, Array | None], stages: Iterable[Stage]) -> tuple[Stage, ...]:
    """Return the stages of a step that runs while other arrays are held.

    An array of the same name and declaration is the same array, and counted once.

    Raises
    ------
    ValueError
        An array of the same name and another declaration.
    """
    outer = {name: array for name, array in held.items() if array is not None}
    found = []
    for stage in stages:
        for name in outer.keys() & stage.arrays.keys():
            if outer[name] != stage.arrays[name]:
                raise ValueError(f"two different arrays are declared as {name!r}")
        found.append(
            Stage(stage.name, {**outer, **stage.arrays}, stage.working, stage.planes),
        )
    return tuple(found)


def forecast(stages: Iterable[Stage], fixed: Mapping[str, int], *, disk: int = 0) -> Plan:
    """Return the forecast of a run in memory: `fixed` bytes, and the stage with the highest peak.

    Parameters
    ----------
    stages : iterable of Stage
    fixed : mapping of str to int
        Bytes held by all stages, by what they are for.
    disk : int
        Bytes of the result.

    Examples
    --------
    >>> votes, field = Array((10, 8, 8), np.int16), Array((10, 8, 8), np.int8)
    >>> stages = [Stage("vote", {"votes": votes, "field": field}), Stage("end", {"votes": votes})]
    >>> forecast(stages, {"exemplar": 100}).memory
    {'exemplar': 100, 'votes': 1280, 'field': 640}
    """
    highest = max(stages, key=lambda stage: stage.peak)
    arrays = {name: array.nbytes for name, array in highest.arrays.items()}
    working = {"working": highest.working} if highest.working else {}
    return Plan({**fixed, **arrays, **working}, disk=disk)


def resident(stages: Iterable[Stage], fixed: Mapping[str, int]) -> dict[str, int]:
    """Return the bytes that stay in memory where the arrays are memory-mapped: `fixed`, and "slab"
    (temporaries, and the thinnest slabs of all threads).
    """
    return {**fixed, "slab": max(stage.slab for stage in stages)}


def forecast_mapped(
    stages: Iterable[Stage], fixed: Mapping[str, int], *, budget: int, disk: int = 0
) -> Plan:
    """Return the forecast of a run whose arrays are memory-mapped files, within a budget.

    Parameters
    ----------
    stages, fixed, disk :
        As of `forecast`.
    budget : int
        Bytes of memory that may be used.

    Returns
    -------
    Plan
        Its memory: `fixed` and "slab" as of `resident`, and "pages" (the bytes of the files that
        may be resident besides).
    """
    every = list(stages)
    least = resident(every, fixed)
    files = max(stage.nbytes for stage in every)
    pages = max(0, min(budget - sum(least.values()), files))
    return Plan({**least, "pages": pages}, disk=disk, scratch=files + disk)


class Workspace:
    """The large arrays of a run, allocated as its stages declare them.

    They are in memory, or in files where large arrays are memory-mapped (`engine.memmap`).

    Parameters
    ----------
    stages : sequence of Stage
        With one name each. A run may enter them in any order, and more than once.

    Attributes
    ----------
    peak : int
        Most bytes that its arrays took together so far.
    """

    def __init__(self, stages: Iterable[Stage]) -> None:
        self._stages = {stage.name: stage for stage in stages}
        self._stage: Stage | None = None
        self._arrays: dict[str, np.ndarray] = {}
        self.peak = 0

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    def __getitem__(self, name: str) -> np.ndarray:
        self._declaration(name)
        if name not in self._arrays:
            raise LookupError(f"array {name!r} is not allocated")
        return self._arrays[name]

    def enter(self, name: str) -> None:
        """Begin a stage; free the arrays that it does not hold."""
        stage = self._stages[name]
        for other in [one for one in self._arrays if one not in stage.arrays]:
            self.release(other)
        for other, array in self._arrays.items():
            stage.arrays[other].check(array, name=other)
        self._stage = stage

    def empty(self, name: str) -> np.ndarray:
        """Return a new array of undefined values, as declared."""
        declared = self._vacant(name)
        return self._hold(name, memmap.empty(declared.shape, declared.dtype))

    def zeros(self, name: str) -> np.ndarray:
        """Return a new array of zeros, as declared."""
        declared = self._vacant(name)
        if memmap.is_active():
            return self._hold(name, memmap.zeros(declared.shape, declared.dtype))
        return self._hold(name, np.zeros(declared.shape, declared.dtype))

    def full(self, name: str, value: Any) -> np.ndarray:
        """Return a new array filled with a value, as declared."""
        array = self.empty(name)
        array[...] = value
        return array

    def adopt(self, name: str, array: np.ndarray) -> np.ndarray:
        """Hold an array that was made elsewhere; return it.

        Raises
        ------
        ValueError
            It is not as declared.
        """
        self._vacant(name).check(array, name=name)
        return self._hold(name, array)

    def take(self, name: str) -> np.ndarray:
        """Return an array and hold it no longer: it is the caller's."""
        array = self[name]
        del self._arrays[name]
        return array

    def release(self, name: str) -> None:
        """Free an array."""
        reference = _reference(self._arrays.pop(name))
        if _checking.get() and reference is not None and reference() is not None:
            raise AssertionError(f"array {name!r} is released, and something still refers to it")

    def _declaration(self, name: str) -> Array:
        if self._stage is None or name not in self._stage.arrays:
            stage = "no stage" if self._stage is None else f"stage {self._stage.name!r}"
            raise LookupError(f"{stage} declares no array {name!r}")
        return self._stage.arrays[name]

    def _vacant(self, name: str) -> Array:
        declared = self._declaration(name)
        if name in self._arrays:
            raise ValueError(
                f"array {name!r} is there already: release it, or declare a second one"
            )
        return declared

    def _hold(self, name: str, array: np.ndarray) -> np.ndarray:
        self._arrays[name] = array
        self.peak = max(self.peak, sum(one.nbytes for one in self._arrays.values()))
        return array


_checking: ContextVar[bool] = ContextVar("trabecula_check_releases", default=False)


@contextmanager
def check_releases() -> Iterator[None]:
    """Raise `AssertionError` inside the block where an array outlives its release."""
    token = _checking.set(True)
    try:
        yield
    finally:
        _checking.reset(token)


def _reference(array: np.ndarray) -> Callable[[], Any] | None:
    """Return a weak reference to the owner of an array's memory; None where it has none."""
    owner: Any = array
    while isinstance(owner, np.ndarray) and owner.base is not None:
        owner = owner.base
    try:
        return weakref.ref(owner)
    except TypeError:
        return None


def available_memory() -> int:
    """Return the bytes that this process may still take: the machine's available memory, or what
    the limit of its control group leaves where that is less.
    """
    import psutil  # 20 ms, for those who ask

    free, limit = int(psutil.virtual_memory().available), _cgroup_available()
    return free if limit is None else min(free, limit)


def as_budget(memory: int) -> int:
    """Return a budget of bytes that a caller gave."""
    return int(as_number(memory, name="memory", low=0, high=2**63))


def check_budget(
    plan: Plan,
    *,
    budget: int | None = None,
    advice: str | Callable[[int], str] = "ask for a smaller --shape",
) -> None:
    """Raise `MemoryBudgetError` where the plan's peak exceeds the budget (default: what is
    available).

    Parameters
    ----------
    plan : Plan
    budget : int, optional
        Bytes.
    advice : str, or function of the bytes that may be used that gives one
        What the user can change, as an imperative.
    """
    limit = available_memory() if budget is None else as_budget(budget)
    if plan.peak > limit:
        raise MemoryBudgetError(
            f"this run needs about {format_bytes(plan.peak)} of memory, {format_bytes(limit)} may "
            f"be used: {advice if isinstance(advice, str) else advice(limit)}, or raise --memory"
        )


def largest_within(
    shape: Sequence[int], peak_of: Callable[[tuple[int, ...]], int], budget: int
) -> tuple[int, ...] | None:
    """Return the largest shape of the proportions of `shape`, and not above it, whose peak is
    within a budget; None where there is none.

    Parameters
    ----------
    shape : sequence of int
    peak_of : shape -> bytes
        Never less for a larger shape. A ValueError says that a shape is too small to be made.
    budget : int
        Bytes.

    Examples
    --------
    >>> largest_within((100, 200), lambda shape: 8 * shape[0] * shape[1], 80_000)
    (70, 140)
    """

    def scale(side: int) -> tuple[int, ...]:
        return tuple(max(1, length * side // max(shape)) for length in shape)

    low, high = 0, max(shape)
    while low < high:
        middle = (low + high + 1) // 2
        try:
            fits = peak_of(scale(middle)) <= budget
        except ValueError:
            fits = True
        low, high = (middle, high) if fits else (low, middle - 1)
    try:
        return scale(low) if low and peak_of(scale(low)) <= budget else None
    except ValueError:
        return None


def format_bytes(count: float) -> str:
    """Return a count of bytes as text, such as "3.2 GiB"."""
    for unit in ("B", "KiB", "MiB", "GiB", "TiB"):
        if count < 1024 or unit == "TiB":
            return f"{count:.0f} {unit}" if unit == "B" or count >= 100 else f"{count:.1f} {unit}"
        count /= 1024
    raise AssertionError


def _cgroup_available() -> int | None:
    """Return what the limit of a Linux control group (a container) leaves; None without one."""
    try:
        limit = Path("/sys/fs/cgroup/memory.max").read_text().strip()
        if limit == "max":
            return None
        return max(0, int(limit) - int(Path("/sys/fs/cgroup/memory.current").read_text()))
    except (OSError, ValueError):
        return None

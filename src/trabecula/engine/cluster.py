"""Blocks and slabs computed by the workers of a Dask cluster: processes of this machine, or a
cluster that the user has.

Only work leaves this process: what makes the blocks is sent once, the blocks go from the workers
straight into the store, which they reach by the same path. A block that was lost with its worker is
made again by another; one that is in the store is not, since a worker looks there first.
"""

from __future__ import annotations

import io
import logging
import pickle
import platform
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any, TypeVar

import numpy as np

from trabecula.core.errors import ClusterError, InputError
from trabecula.core.optional import need
from trabecula.core.recipe import versions
from trabecula.engine import memmap, store
from trabecula.engine.blocks import StoredVolume, do_task
from trabecula.engine.chunking import Box, Task
from trabecula.engine.parallel import one_blas_thread, thread_count, threads
from trabecula.engine.storage import Location

T = TypeVar("T")

_WAIT = 10.0
"""Seconds for a scheduler to answer, and for its first worker to be there."""

_WORKER = 96 << 20
"""Bytes that a worker takes beside what it makes."""

_LARGE = 1 << 20
"""Bytes of an array in memory that is sent by a file: once, not with every piece of work."""


class ReferencedFiles:
    """The files of the arrays that work was sent with."""

    def __init__(self) -> None:
        self._copies: dict[int, tuple[Any, np.ndarray]] = {}

    def dumps(self, work: Callable[..., object]) -> bytes:
        """Return work as bytes that `pickle.loads` reads in a process which sees the scratch
        folder.
        """
        import cloudpickle  # comes with Dask

        places = self

        class Pickler(cloudpickle.Pickler):
            def reducer_override(self, sent: Any) -> Any:
                if type(sent) is np.ndarray:
                    place = places.file_of(sent)
                    if place is not None:
                        return memmap.open_file, (place,)
                return super().reducer_override(sent)

        buffer = io.BytesIO()
        Pickler(buffer).dump(work)
        return buffer.getvalue()

    def file_of(self, array: np.ndarray) -> memmap.MappedFile | None:
        """Return the file of an array; None for one that is better sent itself."""
        place = memmap.file_of(array)
        if place is not None or array.nbytes < _LARGE or array.dtype.hasobject:
            return place
        number = id(array)
        if number not in self._copies:
            copy = memmap.empty(array.shape, array.dtype)
            copy[...] = array
            # The number is another array's as soon as this one is gone.
            self._copies[number] = (
                weakref.ref(array, lambda _: self._copies.pop(number, None)),
                copy,
            )
        return memmap.file_of(self._copies[number][1])


@dataclass(frozen=True)
class Cluster:
    """The address of a Dask scheduler, or a number of local workers.

    Parameters
    ----------
    scheduler : str, optional
        Address of a Dask scheduler, such as "tcp://10.0.0.1:8786".
    workers : int, optional
        Instead of it: processes of this machine.

    Raises
    ------
    InputError
        Both or none, no address, or no worker.
    """

    scheduler: str | None = None
    workers: int | None = None

    def __post_init__(self) -> None:
        if (self.scheduler is None) == (self.workers is None):
            raise InputError(
                "give either the address of a scheduler (--scheduler), or a number of workers "
                "(--workers)"
            )
        if self.workers is not None and not 1 <= self.workers <= 4096:
            raise InputError(f"--workers {self.workers} should be from 1 to 4096")
        if self.scheduler is not None and "://" not in self.scheduler:
            raise InputError(
                f"--scheduler {self.scheduler} is no address: write tcp://HOST:PORT, as the "
                "scheduler shows it"
            )


class Workers:
    """The workers of a running cluster (see `blocks.BlockWorkers`, `memmap.MappedWorkers`).

    Attributes
    ----------
    at_once : int
        Blocks that they make at the same time.
    memory : int or None
        Bytes that one block may take; None where no worker has a limit.
    """

    def __init__(self, client: Any, *, each: int | None, memory: int | None) -> None:
        self._client, self._each = client, each
        self._places = ReferencedFiles()
        known = client.scheduler_info(n_workers=-1)["workers"].values()
        self.at_once = sum(worker["nthreads"] for worker in known)
        limits = [
            worker["memory_limit"] // worker["nthreads"]
            for worker in known
            if worker["memory_limit"]
        ]
        given = [] if memory is None else [memory // self.at_once]
        self.memory = min(limits + given) - _WORKER if limits or given else None

    def make(
        self,
        volume: StoredVolume,
        part: Location,
        tasks: Sequence[Task],
        sources: Sequence[Sequence[int]],
    ) -> Iterator[None]:
        """Run the tasks, each after those at the places in the list that are its sources; yield
        once after each.
        """
        job = _Job(str(part), volume.identity, volume.labels, self._each, versions())
        # By a task and not by scatter: what a lost worker alone held is then sent again.
        make = self._client.submit(_identity, volume.make, pure=False)
        futures: list[Any] = []
        for task, before in zip(tasks, sources, strict=True):
            futures.append(
                self._client.submit(
                    _make_box, task, job, make, [futures[n] for n in before], pure=False
                )
            )
        yield from self._wait_for(futures)

    def spread(self, work: Callable[[int, int], object], bounds: Sequence[tuple[int, int]]) -> None:
        """Call `work` on slabs, in any order, and return when all are done; memory-mapped arrays
        are sent as file names.
        """
        futures: list[Any] = []
        packed = self._client.submit(_identity, self._places.dumps(work), pure=False)
        for start, stop in bounds:
            futures.append(
                self._client.submit(
                    _work_on_slab, packed, start, stop, self._each, versions(), pure=False
                )
            )
        for _ in self._wait_for(futures):
            pass

    def _wait_for(self, futures: list[Any]) -> Iterator[None]:
        """Yield as futures end, and cancel the rest where one fails."""
        from distributed import as_completed

        waiting = as_completed(futures, loop=self._client.loop)
        futures.clear()  # so that nobody asks for what is done, and in a file, a second time
        try:
            for future in waiting:
                _check(future)
                yield
        except BaseException:
            self._client.cancel([future for future in getattr(waiting, "futures", ())])
            raise


@dataclass(frozen=True)
class _Job:
    part: str
    identity: str
    labels: bool
    threads: int | None
    versions: dict[str, str]


def _identity(sent: T) -> T:
    return sent


def _work_on_slab(
    packed: bytes, start: int, stop: int, each: int | None, wanted: dict[str, str]
) -> None:
    """Run work on a slab of memory-mapped arrays, in a worker."""
    _check_versions(wanted)
    try:
        work = pickle.loads(packed)
    except FileNotFoundError as error:
        raise ClusterError(
            f"the worker on {platform.node()} does not see {error.filename}: choose a --scratch "
            "that all workers reach by the same path, where each sees at once what another writes "
            "(a parallel file system; NFS is not enough)"
        ) from error
    with threads(thread_count() if each is None else each), one_blas_thread():
        work(start, stop)


def _check_versions(wanted: dict[str, str]) -> None:
    have = versions()
    differ = [name for name in ("trabecula", "numpy") if have[name] != wanted[name]]
    if differ:
        raise ClusterError(
            f"the worker on {platform.node()} has {differ[0]} {have[differ[0]]}, this process "
            f"{wanted[differ[0]]}: install the same on both, or their voxels may differ"
        )


def _make_box(
    task: Task, job: _Job, make: Callable[[Box], np.ndarray], before: Sequence[None]
) -> None:
    """Make a box and write it, in a worker."""
    _check_versions(job.versions)
    opened = store.open_unfinished(job.part)
    if opened is None or opened.identity != job.identity:
        raise ClusterError(
            f"the worker on {platform.node()} does not see {job.part}, or cannot write there: "
            "choose an --out that all workers reach by the same path"
        )
    if not opened.missing(task.level, task.box):
        return
    with threads(thread_count() if job.threads is None else job.threads):
        do_task(task, opened, make, labels=job.labels)


def _check(future: Any) -> None:
    from distributed import KilledWorker

    try:
        future.result()
    except KilledWorker as error:
        raise ClusterError(
            "workers died one after another at the same block: out of memory? give --memory for "
            "smaller blocks, or larger workers; the blocks that are finished stay, and generate "
            "--resume resumes the run"
        ) from error
    except ModuleNotFoundError as error:
        raise ClusterError(
            f"a worker lacks {error.name}: install there what is installed here, trabecula among it"
        ) from error


def _connect(dask: Any, address: Any, wait: float) -> Any:
    """Return a client. It is made in a thread, since Dask waits for ever where something else takes
    the call and says nothing.
    """
    answer: SimpleQueue[Any] = SimpleQueue()

    def connect() -> None:
        try:
            answer.put(dask.Client(address, timeout=wait, set_as_default=False))
        except Exception as error:  # noqa: BLE001 (it is raised below)
            answer.put(error)

    Thread(target=connect, daemon=True).start()
    try:
        found = answer.get(timeout=2 * wait)
    except Empty:
        raise TimeoutError from None
    if isinstance(found, Exception):
        raise found
    return found


@contextmanager
def workers_of(
    cluster: Cluster, *, memory: int | None = None, wait: float = _WAIT
) -> Iterator[Workers]:
    """Yield the workers of a cluster; those of this machine are started and ended with the block.

    Parameters
    ----------
    cluster : Cluster
    memory : int, optional
        Bytes that all of them may take together.
    wait : float
        Seconds for the scheduler to answer, and for its first worker to be there.

    Raises
    ------
    ClusterError
        The scheduler does not answer, or it has no worker.
    MissingExtraError
        Dask is not installed.
    """
    dask = need("distributed", extra="cluster", purpose="making blocks on workers")
    # what matters comes as an exception
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        each, address = None, cluster.scheduler
        if cluster.workers is not None:
            each = max(1, thread_count() // cluster.workers)
            local = {
                "processes": True,
                "threads_per_worker": 1,
                "memory_limit": 0,
                "dashboard_address": "127.0.0.1:0",
            }
            address = stack.enter_context(
                dask.LocalCluster(n_workers=cluster.workers, silence_logs=logging.CRITICAL, **local)
            )
        try:
            client = stack.enter_context(_connect(dask, address, wait))
            client.wait_for_workers(1, timeout=wait)
        except (OSError, ValueError) as error:  # a timeout is an OSError
            raise ClusterError(
                f"no answer from a scheduler at {cluster.scheduler} with a worker within {wait:g} "
                "s: check the address, and that scheduler and workers are running (dask scheduler, "
                "dask worker)"
            ) from error
        yield Workers(client, each=each, memory=memory)

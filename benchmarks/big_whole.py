"""Methods that make a volume as a whole, in memory and in scratch files: what the files cost, and
what stays resident.

`--side N` makes all of one size, `--methods NAME ...` takes some. Every run is a process of its
own.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import trabecula as tb
from big import Ran, command, place
from common import table

SHARE = 0.4
"""Of what a run in memory is forecast to take, what one in scratch files is allowed."""
RUNS = 2
"""Of which the better counts."""
_LEAST = 32  # voxels a side of a run whose seconds are those of starting and learning


@dataclass(frozen=True)
class Case:
    """A method with what it is given: a volume, or where it is for pictures one section of it."""

    method: str
    side: int
    words: tuple[str, ...] = ()
    flat: bool = False

    @property
    def title(self) -> str:
        """The method, and its preset where it has one here."""
        return " ".join((self.method, *self.words[1:]))


CASES = (
    Case("texture", 256, ("--preset", "fast")),
    Case("texture", 128),
    Case("quilt", 128),
    Case("kopf", 128, flat=True),
    Case("chen", 96, flat=True),
    Case("mrf", 96, flat=True),
    Case("sliced", 96, flat=True),
)


def big_whole() -> None:
    """In memory and in scratch files, one thread: seconds of the processor beyond those of 32^3,
    peaks, allowances, digests.

    `over` is what scratch files cost beyond memory. A run in them is allowed 0.4 of the forecast of
    the one in memory (or what it needs at least); its peak is of the whole process, the interpreter
    and what it learnt included.
    """
    heads = (
        "in memory s",
        "in files s",
        "over",
        "peak MiB",
        "in files MiB",
        "allowed MiB",
        "/ allowed",
        "/ forecast",
        "same",
    )
    row = table("", *heads, wide=24)
    for case in _chosen():
        with place() as folder:
            row(f"{case.title}, {case.side}^3", *_measured(case, folder))


def _chosen() -> Iterator[Case]:
    only = os.environ.get("TRABECULA_BENCH_METHODS", "").split(";")
    side = os.environ.get("TRABECULA_BENCH_SIDE", "").split(";")[0]
    for case in CASES:
        if only == [""] or case.method in only:
            yield Case(case.method, int(side) if side else case.side, case.words, case.flat)


def _measured(case: Case, folder: Path) -> list[str]:
    """The cells of a row."""
    asked = (
        *_exemplar(case, folder),
        "--method",
        case.method,
        *case.words,
        "--seed",
        1,
        "--out",
        folder / "x.zarr",
    )
    sized = (*asked, "--shape", case.side)
    least = _best(*asked, "--shape", _LEAST)
    whole = _best(*sized)
    most = command("plan", *sized).found["peak"]
    allowed = SHARE * most
    forecast = None
    while forecast is None:
        cut = (*sized, "--chunks", 128, "--memory", f"{allowed / 2**30:.4f}")
        try:
            forecast = command("plan", *cut).found["peak"]
        except SystemExit:
            if allowed > 2 * most:  # it is not too little
                raise
            allowed *= 1.1
    spilled = _best(*cut)
    seconds = [max(ran.busy - least.busy, 0.01) for ran in (whole, spilled)]
    return [
        f"{seconds[0]:.1f}",
        f"{seconds[1]:.1f}",
        f"{seconds[1] / seconds[0] - 1:+.0%}",
        f"{whole.peak / 2**20:.0f}",
        f"{spilled.peak / 2**20:.0f}",
        f"{allowed / 2**20:.0f}",
        f"{spilled.peak / allowed:.2f}",
        f"{spilled.peak / forecast:.2f}",
        "yes" if spilled.found["sha256"] == whole.found["sha256"] else "NO",
    ]


def _exemplar(case: Case, folder: Path) -> tuple[object, ...]:
    """What the command says of it."""
    if not case.flat:
        return ("sample:bone",)
    bone = tb.sample("bone")
    section = tb.Image(
        bone.values[len(bone.values) // 2], "labels", bone.spacing[1:], bone.unit, bone.phases
    )
    tb.write(section, folder / "section.tif")
    return (folder / "section.tif",)


def _best(*words: object) -> Ran:
    """The best of `RUNS`."""
    return min((command("generate", *words) for _ in range(RUNS)), key=lambda ran: ran.busy)

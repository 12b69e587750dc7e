"""The zoo: error rates of the certificate, of real parts of scans and of fakes that are wrong in
one way each.

Frozen: scans, parts, fakes and seeds stay as they are. The exemplar is the first corner of a scan,
at most 128 voxels a side; real parts are cubes of 64 voxels (48 of small scans) of the same scan
that share no voxel with it.
"""

from __future__ import annotations

import os
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np

import trabecula as tb
from common import table
from descriptors import scans
from fakes import CHANGES, COPIES, MOSAICS, cut
from trabecula.report.certificate import Judge
from trabecula.report.verdict import Certificate

LARGEST = 128
SIDE, SMALL_SIDE = 64, 48
MOST, SEARCHED, EACH = 9, 3, 2
"""Real parts of a scan, those of them that copies are searched in, and changes of a kind."""
MEMBERS = 8
MATERIALS = (
    "bone a", "bone b", "bone with cortex", "Berea", "NMC", "cement, Otsu", "soil, Otsu",
    "cathode, coarse", "polymer fibres, Otsu", "foam sample",
)  # fmt: skip
REAL, REAL_ENSEMBLE, COLLAPSED = "real part", "real ensemble", "collapsed ensemble"
KINDS = (REAL, *COPIES, *MOSAICS, *CHANGES, REAL_ENSEMBLE, COLLAPSED)

Counts = dict[str, Counter[str]]


def zoo() -> None:
    """Verdicts of the certificate on real held-out parts and on fakes, by material.

    Pass / fail / cannot tell at level "default", and the figures that fail first.
    """
    chosen = os.environ.get("TRABECULA_BENCH_ONLY", "").split(";")
    found = {
        name: judge(name, scan)
        for name, scan in materials().items()
        if chosen == [""] or name in chosen
    }
    show(found)


def materials() -> dict[str, tb.Image]:
    """Return the scans of the zoo, where they are."""
    known = scans() | {f"{name} sample": tb.sample(name) for name in tb.samples()}
    return {name: known[name] for name in MATERIALS if name in known}


def judge(name: str, scan: tb.Image) -> Counts:
    """Return the verdicts of one material by kind, and the first figures that failed.

    Changes are made to the first two real parts that do not fail, so that what fails is the change;
    where all fail, to the first. Copies are searched for in copies, and in some of the real parts,
    since that takes most of the time.
    """
    exemplar, inside, outside = split(scan)
    counts: Counts = defaultdict(Counter)
    judge_by = Judge(exemplar, [cut(inside, (0, 0, 0), (inside.shape[0] - 3,) * 3)])
    sound = []
    for number, part in enumerate(outside):
        certificate = judge_by.certificate(part, REAL, copying=number < SEARCHED)
        note(counts[REAL], certificate)
        sound += [part] if not certificate.failed else []
    for kind, image in copies(exemplar, inside, outside):
        note(counts[kind], judge_by.certificate(image, kind))
    for kind, image in changes(exemplar, (sound or outside)[:EACH]):
        note(counts[kind], judge_by.certificate(image, kind, copying=False))
    for kind, members in {REAL_ENSEMBLE: outside, COLLAPSED: outside[:1] * MEMBERS}.items():
        if len(members) >= MEMBERS:
            verdict = tb.verify_ensemble(exemplar, members, level="quick").verdict
            counts[kind][verdict] += 1
    print(f"{name}: {len(outside)} real parts, exemplar {exemplar.shape}", flush=True)
    for kind, counter in counts.items():
        print("   ", kind, dict(counter), flush=True)
    print("   ", *certificate.undecided, sep="\n    ", flush=True)
    return counts


def note(counter: Counter[str], certificate: Certificate) -> None:
    """Count a verdict, and the first figure that failed."""
    counter[certificate.verdict.replace("not decided", "cannot tell")] += 1
    if certificate.failed:
        counter[f"first: {certificate.failed[0]}"] += 1


def split(scan: tb.Image) -> tuple[tb.Image, tb.Image, list[tb.Image]]:
    """Return the exemplar, a part that it holds, and parts of the same size that it does not."""
    side = SIDE if max(scan.shape) >= 2 * SIDE else SMALL_SIDE
    shape = [min(LARGEST, length) for length in scan.shape]
    longest = int(np.argmax(scan.shape))
    shape[longest] = min(shape[longest], scan.shape[longest] - side)
    corners = [corner for corner in product(*(places(length, side) for length in scan.shape))]
    beyond = [
        corner for corner in corners if any(a >= b for a, b in zip(corner, shape, strict=True))
    ]
    beyond = (
        [beyond[n * (len(beyond) - 1) // (MOST - 1)] for n in range(MOST)]
        if len(beyond) > MOST
        else beyond
    )
    middle = tuple((length - side) // 2 for length in shape)
    return (
        cut(scan, (0,) * 3, tuple(shape)),
        cut(scan, middle, (side,) * 3),
        [cut(scan, corner, (side,) * 3) for corner in beyond],
    )


def places(length: int, side: int) -> list[int]:
    """Return where cubes begin that lie side by side as far apart as they fit."""
    count = length // side
    return [n * (length - side) // max(1, count - 1) for n in range(count)]


def copies(
    exemplar: tb.Image, inside: tb.Image, outside: Sequence[tb.Image]
) -> Iterator[tuple[str, tb.Image]]:
    """Yield copies of a part of the exemplar, and mosaics of it and of another part."""
    for kind, make in COPIES.items():
        yield kind, make(exemplar, inside, 1)
    for kind, join in MOSAICS.items():
        yield kind, join(exemplar, inside, outside[0])


def changes(exemplar: tb.Image, parts: Sequence[tb.Image]) -> Iterator[tuple[str, tb.Image]]:
    """Yield parts that are wrong in one way."""
    for kind, make in CHANGES.items():
        for seed, part in enumerate(parts):
            yield kind, make(exemplar, part, seed)


def show(found: Mapping[str, Counts]) -> None:
    """Print the table: pass / fail / cannot tell of every kind by material and in sum."""
    row = table("kind", *found, "all", "failed", "first that fails", wide=30)
    for kind in KINDS:
        counters = {name: counts[kind] for name, counts in found.items()}
        total = sum(counters.values(), Counter())
        judged = sum(total[verdict] for verdict in ("pass", "fail", "cannot tell"))
        first = Counter({key: n for key, n in total.items() if key.startswith("first: ")})
        row(
            kind,
            *map(cell, counters.values()),
            cell(total),
            f"{total['fail'] / judged:.0%}" if judged else "-",
            ", ".join(key.removeprefix("first: ") for key, _ in first.most_common(2)),
        )


def cell(counter: Counter[str]) -> str:
    """Return pass / fail / cannot tell."""
    counts = [counter[verdict] for verdict in ("pass", "fail", "cannot tell")]
    return "/".join(map(str, counts)) if sum(counts) else "-"

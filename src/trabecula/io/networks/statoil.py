"""The Statoil format of networks: PREFIX_link1.dat, _link2.dat, _node1.dat and _node2.dat.

Columns as in Dong 2007 (PhD thesis, Imperial College London, "Micro-CT imaging and pore network
extraction", appendix) and as `openpnm.io.network_from_statoil` reads them; SI units, numbers from
1, fluids flow along x from the inlet (-1) to the outlet (0):

- link1: throat, its two pores, radius, shape factor, total length
- link2: throat, its two pores, lengths of the first pore, the second and the throat, volume, clay
- node1: pore, x, y, z, coordination, the pores beside it, inlet, outlet, the throats to those
- node2: pore, volume, radius, shape factor, clay

Faces across y and z are walls. A throat has no volume of its own here: pores hold all of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from trabecula.core.errors import InputError
from trabecula.engine.files import replacing

_INLET, _OUTLET = -1, 0


def write(tables: Mapping[str, np.ndarray], path: Path) -> list[Path]:
    """Write the four files; `path` is PREFIX.dat, which itself is not written."""
    if "throat.conns" not in tables or "pore.shape_factor" not in tables:
        raise InputError("Statoil files hold pores and throats: write another format of bodies")
    place = {name: values for name, values in tables.items()}
    own = int(np.count_nonzero(place["pore.internal"]))
    ends = place["throat.conns"]
    other = np.where(ends[:, 1] < own, ends[:, 1] + 1, -2)
    for label, number in (("pore.xmin", _INLET), ("pore.xmax", _OUTLET)):
        other = np.where(place[label][ends[:, 1]], number, other)
    throats = np.flatnonzero((other != -2) & ~place["throat.periodic"])
    pairs = np.stack([ends[throats, 0] + 1, other[throats]], axis=1)
    # the reservoir comes first, as in the files of the format's authors
    pairs = np.where((pairs[:, 1] < 1)[:, None], pairs[:, ::-1], pairs)
    names = [path.with_name(f"{path.stem}_{part}.dat") for part in _PARTS]
    with ExitStack() as stack:
        files = [stack.enter_context(replacing(name)) for name in names]
        for (_, lines), file in zip(_PARTS.items(), files, strict=True):
            file.write_text("".join(lines(place, own, throats, pairs)), encoding="ascii")
    return names


def _link1(
    place: Mapping[str, np.ndarray], own: int, throats: np.ndarray, pairs: np.ndarray
) -> list[str]:
    radius = place["throat.inscribed_diameter"][throats] / 2
    shape, length = place["throat.shape_factor"][throats], place["throat.total_length"][throats]
    return [f"{len(throats)}\n"] + [
        f"{k + 1} {pairs[k, 0]} {pairs[k, 1]} {radius[k]:.6e} {shape[k]:.6e} {length[k]:.6e}\n"
        for k in range(len(throats))
    ]


def _link2(
    place: Mapping[str, np.ndarray], own: int, throats: np.ndarray, pairs: np.ndarray
) -> list[str]:
    first, middle, second = (
        place[f"throat.conduit_lengths.{part}"][throats] for part in ("pore1", "throat", "pore2")
    )
    turned = pairs[:, 0] < 1
    first, second = np.where(turned, second, first), np.where(turned, first, second)
    return [
        f"{k + 1} {pairs[k, 0]} {pairs[k, 1]} {first[k]:.6e} {second[k]:.6e} {middle[k]:.6e} "
        "0.000000e+00 0.000000e+00\n"
        for k in range(len(throats))
    ]


def _node1(
    place: Mapping[str, np.ndarray], own: int, throats: np.ndarray, pairs: np.ndarray
) -> list[str]:
    at = place["pore.coords"][:own]
    sides = place["pore.coords"].max(axis=0) - np.minimum(place["pore.coords"].min(axis=0), 0.0)
    beside: list[list[tuple[int, int]]] = [[] for _ in range(own)]
    for k, (a, b) in enumerate(pairs.tolist()):
        for one, two in ((a, b), (b, a)):
            if one > 0:
                beside[one - 1].append((two, k + 1))
    lines = [f"{own} {sides[0]:.6e} {sides[1]:.6e} {sides[2]:.6e}\n"]
    for k, links in enumerate(beside):
        near = [pore for pore, _ in links]
        words = [
            *near,
            int(_INLET in near),
            int(_OUTLET in near),
            *(throat for _, throat in links),
        ]
        lines.append(
            f"{k + 1} {at[k, 0]:.6e} {at[k, 1]:.6e} {at[k, 2]:.6e} {len(links)} "
            + " ".join(map(str, words))
            + "\n"
        )
    return lines


def _node2(
    place: Mapping[str, np.ndarray], own: int, throats: np.ndarray, pairs: np.ndarray
) -> list[str]:
    radius = place["pore.inscribed_diameter"] / 2
    volume, shape = place["pore.volume"], place["pore.shape_factor"]
    return [
        f"{k + 1} {volume[k]:.6e} {radius[k]:.6e} {shape[k]:.6e} 0.000000e+00\n" for k in range(own)
    ]


_PARTS = {"link1": _link1, "link2": _link2, "node1": _node1, "node2": _node2}

"""`quilt`: the cases of Liu and Shapiro (2016), and bone graded to a part's loads.

`TRABECULA_BENCH_OUT` names a folder for the pictures.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

import trabecula as tb
from common import busy, pictures, table
from descriptors import scans
from graded_lattice import PERIOD, gentle, lattice, reference
from trabecula import fields
from trabecula.testing.peak import peak_bytes
from trabecula.view.slices import montage

PATCH, OVERLAP = 14, 4
CELLS = {"size": PERIOD, "step": PATCH - OVERLAP, "first": (PATCH - PERIOD) // 2}
"""Where a lattice's volume fraction is compared: one cell in the middle of every neighbourhood."""

TURNED = "48 turns"
LIKE: dict[str, Any] = {"preset": "paper", "alpha": 0.5, "seams": 4, "connected": "none"}
"""Like for like: every window in step with a place is looked at, none is turned; section 4.3 prints
no alpha for lattices (4.1: .9, for bone). That they come out in one piece is measured."""

WAYS: dict[str, dict[str, Any]] = {
    "no turns": LIKE,
    TURNED: {"patch": PATCH, "overlap": OVERLAP, "orientations": "all"},
}
"""Ways to make a lattice; the paper turns nothing."""

PAPER_2 = {
    "figure 7": (0.1004, 0.0128, 0.1450, 0.0334),
    "figure 8, type 1": (0.1700, 0.0163, 0.1253, 0.0416),
    "figure 8, type 2": (0.1378, 0.0247, 0.1327, 0.0402),
    "figure 9": (0.1481, 0.0152, 0.1791, 0.0391),
}
"""Table 2: volume fraction max, mean; neighbourhood mismatch max, mean."""

PAPER_1 = {
    "own": (0.2342, 0.0178, 0.1958, 0.0121, 0.3878, 0.0467),
    "filled": (0.3562, 0.0236, 0.2167, 0.0177, 0.4286, 0.052),
}
"""Table 1: area, perimeter, Euler number, each max and mean, rescaled to 0 .. 1."""


def graded_lattice() -> None:
    """Table 2: lattice graded to a cantilever of 300 x 160 x 80 and to a wheel, s = 14, o = 4, from
    80^3, without turned copies and with them; the cantilever also by the paper's preset as it is,
    with alpha .9, and with windows in any phase of the lattice, of a part of the field.

    `frac`: difference of the volume fraction from the field, in the cell amid every neighbourhood;
    `mism`: share of an overlap that differs. `paper` is its table 2, of another lattice.
    """
    row = table(
        "case",
        "frac max",
        "frac mean",
        "mism max",
        "mism mean",
        "parts",
        "gave way",
        "seconds",
        wide=34,
    )
    cantilever = fields.resample(fields.simp("cantilever"), (160, 80, 300))
    wheel = fields.resample(fields.simp("wheel"), (100, 200, 200))
    part = np.ascontiguousarray(cantilever.values[:, 28:52, :150])
    cases: list[tuple[str, tuple[str, ...], Any, bool]] = [
        ("cantilever", ("figure 7", "figure 8, type 1"), cantilever, False),
        ("type 2 (frames)", ("figure 8, type 2",), cantilever, True),
        ("wheel", ("figure 9",), wheel, False),
    ]
    runs: list[tuple[str, tuple[str, ...], Any, dict[str, Any], bool]] = [
        ("cantilever, paper's preset", (), cantilever, {**LIKE, "alpha": 0.9}, False),
        ("a part of it, in step", (), part, LIKE, False),
        ("a part of it, any phase", (), part, {**LIKE, "period": "none"}, False),
    ]
    runs += [
        (f"{name}, {way}", figures, field, settings, frames)
        for name, figures, field, frames in cases
        for way, settings in WAYS.items()
    ]
    for name, figures, field, settings, frames in runs:
        sample = reference if name.endswith(TURNED) else gentle
        model = tb.method("quilt", **settings).fit(sample(frames=frames))
        model.generate(32, seed=1, target={"volume_fraction": 0.5})  # kernels
        request = tb.Request(field.shape, seed=1, target={"volume_fraction": field})
        seconds, made = busy(lambda model=model, request=request: model.generate(request))
        told = report(made)
        off = errors(made.values, np.asarray(getattr(field, "values", field)), **CELLS)
        cells = (off.max(), off.mean(), told["mismatch"]["max"], told["mismatch"]["mean"])
        row(
            name,
            *(f"{value:.4f}" for value in cells),
            tb.measure.components(made),
            told["gave_way"],
            f"{seconds:.1f}",
        )
        for figure in figures if name.endswith(TURNED) else ():
            row(
                f"  paper, {figure}",
                *(f"{value:.4f}" for value in PAPER_2[figure]),
                "-",
                "-",
                "5400",
            )
        show(made, f"graded-{name.replace(', ', '-').replace(' ', '-')}")
    procedural = lattice(np.asarray(cantilever.values))
    off = errors(procedural.values, np.asarray(cantilever.values), **CELLS)
    row(
        "the procedure itself",
        f"{off.max():.4f}",
        f"{off.mean():.4f}",
        "",
        "",
        tb.measure.components(procedural),
        "",
        "",
    )


def graded_cells() -> None:
    """Figure 8: pieces of the size of a cell, chosen by volume fraction and Euler number: one or
    the other dual cell.

    The paper's frame has -4, its node 1; windows of 10^3 of ours, whose faces cut struts, hold what
    `held` says (at a volume fraction within .02 of the one asked for).
    """
    row = table(
        "asked for", "Euler of pieces", "held", "fraction off", "mismatch mean", "parts", wide=26
    )
    both = [reference(60), reference(60, frames=True)]
    found = [
        fields.windowed(sample, size=PERIOD, names=["volume_fraction", "euler"]) for sample in both
    ]
    near = [np.abs(one["volume_fraction"] - 0.45) < 0.02 for one in found]
    euler_of = (
        np.concatenate([one["euler"][n] for one, n in zip(found, near, strict=True)])
        * (PERIOD - 1) ** 3
    )
    held = f"{euler_of.min():.1f}..{euler_of.max():.1f}"
    for name, euler in (("type 1, +1", 1.0), ("type 2, -3", -3.0)):
        target = {"volume_fraction": 0.45, "euler": euler / (PERIOD - 1) ** 3}
        settings = {"patch": PERIOD, "overlap": 1, "period": "none", "orientations": "mirrors"}
        method = tb.method("quilt", **settings, weights={"euler": 4.0}, alpha=0.3)
        made = method.fit(both).generate((45, 45, 45), seed=1, target=target)
        windows = (
            fields.windowed(made, size=PERIOD, names=["euler"])["euler"][::9, ::9, ::9]
            * (PERIOD - 1) ** 3
        )
        told = report(made)
        off = abs(float(made.values.mean()) - 0.45)
        cells = (f"{windows.mean():.2f}", held, f"{off:.4f}", f"{told['mismatch']['mean']:.4f}")
        row(name, *cells, tb.measure.components(made))
        show(made, f"graded-cell-{name[5]}")


def graded_section() -> None:
    """Figures 5 and 6, table 1: a section of bone made from its own fields and without, and a
    removed region made again.

    Differences from the section's own functionals over the region that was made, each over its
    range in the section.
    """
    section, names = bone_section(), ("volume_fraction", "perimeter", "euler")
    size = 25
    own = {name: fields.measure(section, name, size=size) for name in names}
    row = table(
        "case",
        "area max",
        "mean",
        "perim max",
        "mean",
        "Euler max",
        "mean",
        "same voxels",
        "seconds",
        wide=30,
    )
    known = np.ones(section.shape, bool)
    high, wide = section.shape
    known[high // 3 : 2 * high // 3, wide // 3 : 2 * wide // 3] = False
    filled = {name: fields.fill(field, known) for name, field in own.items()}
    cases: list[tuple[str, Mapping[str, Any], dict[str, Any]]] = [
        ("5e, without fields", {}, {}),
        ("5f, with its own fields", own, {}),
        ("6e, repair, its own fields", own, {"fixed": section, "known": known}),
        ("6f, repair, fields filled in", filled, {"fixed": section, "known": known}),
    ]
    shown = [section]
    for name, target, parts in cases:
        method = tb.method(
            "quilt", patch=size, overlap=8, share=1.0, candidates=1 << 20, connected="none"
        )
        model = method.fit(section if not parts else without(section, known))
        seconds, made = busy(
            lambda m=model, t=target, p=parts: m.generate(section.shape, seed=1, target=t, **p)
        )
        region = ~known if parts else np.ones(section.shape, bool)
        cells = []
        for field in names:
            made_field, held = fields.measure(made, field, size=size).values, own[field].values
            off = np.abs(made_field - held)[region] / np.ptp(held)
            cells += [f"{off.max():.4f}", f"{off.mean():.4f}"]
        same = np.mean(made.values[region] == section.values[region])
        row(name, *cells, f"{same:.3f}", f"{seconds:.1f}")
        shown.append(made)
    for name, cells in PAPER_1.items():
        row(f"  paper, repair, {name}", *(f"{value:.4f}" for value in cells), "-", "-")
    folder = pictures()
    if folder:
        tb.write(
            montage(shown, ["section", *(name for name, *_ in cases)]),
            folder / "graded-section.png",
        )


def graded_bone() -> None:
    """Bone graded to a cantilever's loads, by `quilt` and by `texture`, beside the field.

    `frac`: differences of the volume fraction in windows of 20^3 from the field; `largest`: share
    of the solid in one body; `struts`: voxels that no piece had, over the solid's.
    """
    step = 12
    row = table(
        "method",
        "frac max",
        "frac mean",
        "parts",
        "largest",
        "struts",
        "gave way",
        "seconds",
        wide=20,
    )
    bone, field = bone_scan(), bone_field()
    for name, settings in (
        ("quilt", {"patch": 20}),
        ("quilt", {"patch": 16, "overlap": 6}),
        ("texture", {}),
    ):
        model = tb.method(name, **settings).fit(bone)
        model.generate((32, 32, 48), seed=1)
        request = tb.Request(field.shape, seed=1, target={"volume_fraction": field})
        seconds, made = busy(lambda model=model, request=request: model.generate(request))
        off = errors(made.values, np.asarray(field.values), size=20, step=step)
        parts, largest = tb.measure.components(made), tb.measure.largest_fraction(made)
        told = report(made) if name == "quilt" else {"strut_voxels": 0, "gave_way": ""}
        share = told["strut_voxels"] / int(np.count_nonzero(made.values))
        label = f"{name} {settings.get('patch', '')}"
        cells = (
            f"{off.max():.3f}",
            f"{off.mean():.4f}",
            parts,
            f"{largest:.4f}",
            f"{share:.4f}",
            told["gave_way"],
        )
        row(label, *cells, f"{seconds:.1f}")
        show(made, f"graded-bone-{label.strip().replace(' ', '-')}")


def graded_seams() -> None:
    """Along the seams of graded bone: shares of differing voxels from a neighbourhood to its
    nearest in the sample.

    A voxel is on a seam where what its neighbour was taken from lies elsewhere in the sample.
    Beside it parts of the scan that the sample does not hold: what its own spread is.
    """
    row = table("interfaces of", "size", "voxels", "mean", "median", "q 90", "q 99", wide=34)
    bone, scan, field = bone_scan(), whole_scan(), bone_field()
    request = tb.Request(field.shape, seed=1, target={"volume_fraction": field})
    images: list[tuple[str, tb.Image]] = []
    for name, settings in (("quilt", {}), ("quilt, first that fits", {"seams": 1})):
        images.append((name, tb.method("quilt", patch=20, **settings).fit(bone).generate(request)))
    images.append(("texture", tb.method("texture").fit(bone).generate(request)))
    for name, values in (
        ("held out, a", scan.values[:48, :96, 10:190]),
        ("held out, b", scan.values[-48:, -96:, 10:190]),
    ):
        images.append((name, replace(bone, values=np.ascontiguousarray(values))))
    for name, image in images:
        for size in (9, 5):
            taken = tb.measure.sources(bone, image, size=size)
            counted = ~np.isnan(taken.distance)
            seam = on_seams(taken) & counted
            held = name.startswith("held")
            for label, where in (
                ((name, counted),)
                if held
                else ((f"{name}: seams", seam), (f"{name}: rest", counted & ~seam))
            ):
                off = taken.distance[where]
                row(
                    label,
                    size,
                    off.size,
                    *(
                        f"{value:.3f}"
                        for value in (off.mean(), *np.quantile(off, [0.5, 0.9, 0.99]))
                    ),
                )


def on_seams(taken: Any) -> np.ndarray:
    """Voxels whose neighbour by a face was taken from elsewhere in the exemplar."""
    away = taken.position - np.moveaxis(np.indices(taken.distance.shape), 0, -1)
    known, found = taken.position[..., 0] >= 0, np.zeros(taken.distance.shape, bool)
    for axis in range(3):
        after, before = (
            tuple(part if a == axis else slice(None) for a in range(3))
            for part in (slice(1, None), slice(-1))
        )
        differ = (away[after] != away[before]).any(axis=-1) & known[after] & known[before]
        found[after] |= differ
        found[before] |= differ
    return found


def graded_speed() -> None:
    """Seconds of one thread, kernels loaded, and bytes that one voxel more of the output costs at
    the peak.
    """
    row = table("case", "seconds", "per place, ms", "bytes/voxel", wide=36)
    bone = bone_scan()
    for name, exemplar, shape, settings in (
        (
            "lattice 80^3 -> 300 x 160 x 80, 14/4",
            reference(),
            (300, 160, 80),
            {"patch": PATCH, "overlap": OVERLAP},
        ),
        ("bone 96^3 -> 128^3, 20/8", bone, (128, 128, 128), {"patch": 20}),
        ("bone 96^3 -> 128^3, 20/8, fast", bone, (128, 128, 128), {"patch": 20, "preset": "fast"}),
        ("bone 96^3, any pieces", bone, (128, 128, 128), {"patch": 20, "connected": "none"}),
    ):
        model = tb.method("quilt", **settings).fit(exemplar)
        low, high = 0.35 if exemplar is not bone else 0.1, 0.8 if exemplar is not bone else 0.22
        field = fields.ramp(shape, start=low, end=high)
        model.generate((40, 40, 40), seed=1)
        request = tb.Request(shape, seed=1, target={"volume_fraction": field})
        seconds, made = busy(lambda model=model, request=request: model.generate(request))
        places = report(made)["places"]
        small, large = (
            (shape[0] // 2, shape[1] // 2, side) for side in (shape[2] // 4, shape[2] // 2)
        )
        taken = []
        for part in (small, large):
            asked = tb.Request(part, seed=1, target={"volume_fraction": (low + high) / 2})
            taken.append(peak_bytes(lambda model=model, asked=asked: model.generate(asked)))
        more = (taken[1] - taken[0]) / (np.prod(large) - np.prod(small))
        row(name, f"{seconds:.2f}", f"{1000 * seconds / places:.2f}", f"{more:.1f}")


def report(made: tb.Image) -> dict[str, Any]:
    """What the run tells of itself."""
    return made.recipe.steps[-1]["report"]


def errors(
    values: np.ndarray, field: np.ndarray, *, size: int, step: int, first: int = 0
) -> np.ndarray:
    """Differences of the volume fraction in windows, one every `step` voxels, from the field in
    their middles.
    """
    found = []
    for place in np.ndindex(tuple((side - first - size) // step + 1 for side in values.shape)):
        corner = [first + at * step for at in place]
        box = tuple(slice(at, at + size) for at in corner)
        found.append(
            abs(
                float(values[box].mean())
                - float(field[tuple(at + (size - 1) // 2 for at in corner)])
            )
        )
    return np.array(found)


def bone_scan(side: int = 96) -> tb.Image:
    """A crop of bone with a dense shell, or of the package's sample where no scans are."""
    return tb.crop(whole_scan(), side)


def bone_field() -> Any:
    """The density of a cantilever, 96 x 48 x 180, brought into what windows of 20^3 of that bone
    hold.
    """
    low, high = np.quantile(fields.windowed(bone_scan(), size=20)["volume_fraction"], [0.05, 0.95])
    density = fields.simp("cantilever", low=0.3, high=0.85)
    return fields.resample(fields.rescale(density, low=float(low), high=float(high)), (96, 48, 180))


def bone_section() -> tb.Image:
    """A section through that bone."""
    scan = whole_scan()
    middle = scan.shape[0] // 2
    return tb.Image(scan.values[middle], "labels", scan.spacing[1:], scan.unit, scan.phases)


def whole_scan() -> tb.Image:
    """The scan that both are of."""
    found = scans()
    return found.get("bone with cortex", found.get("bone a", found.get("bone", tb.sample("bone"))))


def without(section: tb.Image, known: np.ndarray) -> list[tb.Image]:
    """The four parts of a section around a region that is gone."""
    gone = np.argwhere(~known)
    (top, left), (bottom, right) = gone.min(axis=0), gone.max(axis=0) + 1
    parts = (
        section.values[:top],
        section.values[bottom:],
        section.values[:, :left],
        section.values[:, right:],
    )
    return [
        tb.Image(
            np.ascontiguousarray(part), "labels", section.spacing, section.unit, section.phases
        )
        for part in parts
    ]


def show(made: tb.Image, name: str) -> None:
    """A still of a volume, where pictures are wanted."""
    folder = pictures()
    if folder:
        tb.write(tb.render(made, size=(900, 700)), folder / f"{name}.png")

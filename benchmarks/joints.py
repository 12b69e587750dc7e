"""How visible the joint between known voxels and what `texture` makes beside them is."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import trabecula as tb
from common import SCANS as FOLDER
from common import asked, busy, pictures, table
from descriptors import GREY, scans
from forms import FORMS, made_form
from texture import judged, out_of_band, reference_of
from trabecula.view.slices import montage

SIDE, EXEMPLAR = 100, 96
HOLE = slice(26, 74)
HELD = 40
"""Planes that an extension continues."""
SCANS = ("bone a", "bone with cortex", "Berea", "NMC")
SEEDS = (1, 2)
BODIES = ("beads", "cemented grains", "suspension", "soil, Otsu", "cement, Otsu")
SETTINGS: dict[str, dict[str, float]] = {"default": {}, "patches": {"novelty": 0}}


def texture_joints() -> None:
    """A hole of 48^3 in 100^3 of a scan, filled from 96^3 at its other end; 60 planes added to 40
    of the same; and 60 planes added to 40 of the exemplar itself.

    `joint` is the share of voxels that change their phase across the joint, over that between
    neighbours within what was made; `next` the same for the three planes beyond it. The scan's own
    are of the same places. *graded* is to have the exemplar's porosity at the joint, and a fifth
    less solid at the other end.
    """
    row = table(
        "scan, case", "seed", "joint", "next", "made", "Euler", "coh(4)", "seconds", wide=36
    )
    every = scans()
    for name in (one for one in asked("ONLY") or SCANS if one in every):
        scan = every[name]
        corner = [edge - SIDE for edge in scan.shape]
        host = tb.crop(scan, SIDE, corner=corner)
        apart, beside = tb.crop(scan, EXEMPLAR, corner=(0, 0, 0)), _beside(scan, corner)
        for case, known, exemplar in (
            ("hole", _hole(), apart),
            ("extension", _held(), apart),
            ("continuation", _held(), beside),
        ):
            own = _told(exemplar.values, "exemplar")
            row(f"{name}, {case}, the exemplar", "", "", "", *own[2:], "", "")
            row(f"{name}, {case}, the scan", "", *_told(host.values, case), "", "")
            ways = [(words, settings, {}) for words, settings in SETTINGS.items()]
            if case == "continuation":
                ways.append(("graded", {}, {"porosity": _ramp(exemplar)}))
            for words, settings, target in ways:
                model = tb.method("texture", **settings).fit(exemplar)
                for seed in SEEDS:
                    request = tb.Request(
                        host.shape, seed=seed, fixed=host, known=known, target=target
                    )
                    seconds, made = busy(lambda m=model, r=request: m.generate(r))
                    new = made.values[(HOLE,) * 3] if case == "hole" else made.values[HELD:]
                    copied = tb.measure.coherence(exemplar, new, k=(4,), samples=300)[4]
                    told = (*_told(made.values, case), f"{copied:.3f}", f"{seconds:.1f}")
                    row(f"{name}, {case}, {words}", seed, *told)


def texture_grey_joints() -> None:
    """The same of grey scans: a hole of 48^3 in 100^3, and 60 planes added to 40.

    `joint` is the mean step between neighbours across the joint, over that within what was made.
    The rest is at the exemplar's threshold: the share of its darker phase, Euler density over the
    exemplar's, and what is copied.
    """
    heads = ("seed", "joint", "darker", "Euler", "coh(4)", "seconds")
    row = table("scan, case", *heads, wide=36)
    for name, scan in _grey_scans():
        host = tb.crop(scan, SIDE, corner=[edge - SIDE for edge in scan.shape])
        exemplar = tb.crop(scan, min(EXEMPLAR, *scan.shape), corner=(0, 0, 0))
        solid = tb.segment(exemplar)
        threshold = solid.recipe.steps[-1]["threshold"]
        models = {
            words: tb.method("texture", **settings).fit(exemplar)
            for words, settings in SETTINGS.items()
        }
        shown = {"the scan": host}
        for case, known in (("hole", _hole()), ("extension", _held())):
            row(f"{name}, {case}, the scan", "", _grey_joint(host, case), "", "", "", "")
            for words, model in models.items():
                for seed in SEEDS:
                    request = tb.Request(host.shape, seed=seed, fixed=host, known=known)
                    seconds, made = busy(lambda m=model, r=request: m.generate(r))
                    part = made.values[(HOLE,) * 3] if case == "hole" else made.values[HELD:]
                    labels = tb.segment(
                        tb.Image(np.ascontiguousarray(part), "grey", scan.spacing, scan.unit),
                        threshold,
                    )
                    loops = tb.measure.euler_density(labels) / tb.measure.euler_density(solid)
                    copied = tb.measure.coherence(solid, labels.values, k=(4,), samples=300)[4]
                    row(
                        f"{name}, {case}, {words}",
                        seed,
                        _grey_joint(made, case),
                        f"{np.mean(labels.values == 0):.3f}",
                        f"{loops:.2f}",
                        f"{copied:.3f}",
                        f"{seconds:.1f}",
                    )
                shown[f"{case}, {words}"] = made
        if folder := pictures():
            montage(list(shown.values()), list(shown), folder / f"texture-grey-joint-{name}.png")


def _grey_scans() -> Iterator[tuple[str, tb.Image]]:
    for name, (file, edge, unit) in GREY.items():
        if (FOLDER / file).is_file() and name in (asked("ONLY") or GREY):
            yield name, tb.read(FOLDER / file, spacing=edge, unit=unit, kind="grey")


def _grey_joint(image: tb.Image, case: str) -> str:
    """The mean step across the joint, over that of the voxels that are made."""
    values = np.asarray(image.values, np.float32)
    if case != "hole":
        steps = np.abs(np.diff(values, axis=0)).mean(axis=(1, 2))
        return f"{steps[HELD - 1] / steps[HELD:].mean():.2f}"
    joint, inside = [], []
    for axis in range(3):
        turned = np.moveaxis(values, axis, 0)[:, HOLE, HOLE]
        steps = np.abs(np.diff(turned, axis=0)).mean(axis=(1, 2))
        joint += [steps[HOLE.start - 1], steps[HOLE.stop - 1]]
        inside.append(steps[HOLE.start : HOLE.stop - 1].mean())
    return f"{np.mean(joint) / np.mean(inside):.2f}"


def packing_joints() -> None:
    """A hole of 48^3 in 100^3 of materials of bodies, and 60 planes added to 40 of the same, by
    `texture` and by `packing` from 96^3 at the other end.

    `joint`, `next` and `made` as in `texture_joints`; thickness of the solid and Euler density of
    what was made over the exemplar's; figures of `verify` out of band; bodies, and those of them
    that stand.
    """
    heads = ("joint", "next", "made", "Euler", "thickness", "out", "of", "bodies", "seconds")
    row = table("material, case", "seed", *heads, wide=36)
    for name in (one for one in asked("ONLY") or BODIES if one in FORMS or one in scans()):
        scan = tb.Image(made_form(name), "labels") if name in FORMS else scans()[name]
        host = tb.crop(scan, SIDE, corner=[edge - SIDE for edge in scan.shape])
        exemplar = tb.crop(scan, EXEMPLAR, corner=(0, 0, 0))
        reference, models = reference_of(exemplar), {}
        thickness = tb.measure.thickness(exemplar)
        for method in ("texture", "packing"):
            models[method] = tb.method(method).fit(exemplar)
        for case, known in (("hole", _hole()), ("extension", _held())):

            def figures(image: tb.Image, case=case, reference=reference, own=thickness):
                part = _part(image, case)
                off = out_of_band(judged(reference, part))
                wide = f"{tb.measure.thickness(part) / own:.2f}"
                return (*_told(image.values, case), wide, *off)

            own = _told(exemplar.values, "exemplar")[2:]
            row(f"{name}, {case}, the exemplar", "", "", "", *own, "1.00", "", "", "", "")
            row(f"{name}, {case}, the scan", "", *figures(host), "", "")
            for method, model in models.items():
                for seed in SEEDS:
                    request = tb.Request(host.shape, seed=seed, fixed=host, known=known)
                    seconds, made = busy(lambda m=model, r=request: m.generate(r))
                    told = made.recipe.steps[-1].get("report", {})
                    bodies = f"{told.get('bodies', '')} {told.get('standing', '')}"
                    row(f"{name}, {case}, {method}", seed, *figures(made), bodies, f"{seconds:.1f}")


def _part(image: tb.Image, case: str) -> tb.Image:
    """Return what was made."""
    values = image.values[(HOLE,) * 3] if case == "hole" else image.values[HELD:]
    fields = {"phases": image.phases, "spacing": image.spacing, "unit": image.unit}
    return tb.Image(np.ascontiguousarray(values), "labels", **fields)


def _beside(scan: tb.Image, corner: list[int]) -> tb.Image:
    """Return the part of a scan that ends where an extension begins, two voxels narrower a side."""
    first = max(corner[0] + HELD - EXEMPLAR, 0)
    size = (corner[0] + HELD - first, EXEMPLAR, EXEMPLAR)
    return tb.crop(scan, size, corner=(first, corner[1] + 2, corner[2] + 2))


def _ramp(exemplar: tb.Image) -> np.ndarray:
    solid = float(np.mean(exemplar.values > 0))
    along = np.interp(np.arange(SIDE), (HELD, SIDE - 1), (1 - solid, 1 - 0.8 * solid))
    return np.ascontiguousarray(
        np.broadcast_to(along[:, None, None], (SIDE,) * 3).astype(np.float32)
    )


def _hole() -> np.ndarray:
    known = np.ones((SIDE,) * 3, bool)
    known[HOLE, HOLE, HOLE] = False
    return known


def _held() -> np.ndarray:
    known = np.zeros((SIDE,) * 3, bool)
    known[:HELD] = True
    return known


def _told(values: np.ndarray, case: str) -> tuple[str, ...]:
    solid = np.asarray(values) > 0
    if case == "exemplar":
        return _figures(solid, 0, 0)
    if case != "hole":
        made = solid[HELD:]
        changes = np.mean(np.diff(solid, axis=0), axis=(1, 2))
        joint, near = changes[HELD - 1], changes[HELD : HELD + 3].mean()
    else:
        made = solid[(HOLE,) * 3]
        sides = [_across_faces(solid, axis) for axis in range(3)]
        joint, near = np.mean([side[0] for side in sides]), np.mean([side[1] for side in sides])
    return _figures(made, joint, near)


def _figures(made: np.ndarray, joint: float, near: float) -> tuple[str, ...]:
    inside = np.mean([np.mean(np.diff(made, axis=axis)) for axis in range(3)])
    euler = tb.measure.euler_density(tb.Image(np.ascontiguousarray(made, np.uint8), "labels"))
    return f"{joint / inside:.2f}", f"{near / inside:.2f}", f"{inside:.4f}", f"{1e6 * euler:.0f}"


def _across_faces(solid: np.ndarray, axis: int) -> tuple[float, float]:
    """The share of changes across the two faces of the hole, and in the three planes inside."""
    turned = np.moveaxis(solid, axis, 0)[:, HOLE, HOLE]
    changes = np.mean(np.diff(turned, axis=0), axis=(1, 2))
    first, last = HOLE.start - 1, HOLE.stop - 1
    near = (*changes[first + 1 : first + 4], *changes[last - 3 : last])
    return float(changes[[first, last]].mean()), float(np.mean(near))

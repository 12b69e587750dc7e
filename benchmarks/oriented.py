"""Material that follows a field of directions, and parts of it under their loads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

import trabecula as tb
from common import SCANS, asked, busy, pictures, table
from descriptors import scans
from trabecula import fields

SHAPE = (96, 64, 64)
WINDOW = 32

FIELDS: dict[str, tuple[str, str, str]] = {
    "one direction": ("0", "1", "1"),
    "turns by 90 degrees": ("cos(pi / 2 * z / Z)", "sin(pi / 2 * z / Z)", "0"),
    "fan": ("0", "y + 60", "x - X / 2"),
    "radial": ("0", "y - Y / 2", "x - X / 2"),
}

MATERIALS: dict[str, dict[str, Any]] = {
    "noise": {"length": (24, 6, 6), "exact": True},
    "lattice": {"cell": "gyroid", "cell_size": (30, 12, 12)},
    "bubbles": {"distance": 14, "randomness": 0.2, "thickness": 0.1},
}

SCANNED: dict[str, dict[str, Any]] = {
    "texture": {},
    "quilt": {"patch": 16, "overlap": 6, "weights": {"orientation": 2.0}},
}
"""Methods that turn a scan: bone b, 96^3, of which 12.7 % is solid."""


def oriented() -> None:
    """Fabric beside the field of directions, by windows of 32^3: mean and largest angle, and the
    volume fraction beside the .4 that was asked for, of bone its own; seconds of the processor.
    """
    row = table("method", "field", "angle", "largest", "fraction off", "parts", "seconds")
    bone = tb.crop(scans()["bone b"], 96) if "bone b" in scans() else tb.sample("bone")
    for name in asked("METHODS") or [*MATERIALS, *SCANNED]:
        if name in SCANNED:
            model, fraction = tb.method(name, **SCANNED[name]).fit(bone), float(bone.values.mean())
        else:
            model, fraction = tb.method(name, **MATERIALS[name]).fit(spacing=1.0), 0.4
        for what, formulas in FIELDS.items():
            ways = fields.direction_formula(SHAPE, formulas)
            target = {"orientation": ways, "volume_fraction": fraction}
            try:
                seconds, made = busy(lambda m=model, t=target: m.generate(SHAPE, target=t))
            except tb.errors.RequestError as error:
                row(name, what, str(error)[:44], *"---", "-")
                continue
            off = fields.direction_errors(made, ways, size=WINDOW)
            angles = f"{np.nanmean(off):.1f}", f"{np.nanmax(off):.1f}"
            off = f"{abs(made.values.mean() - fraction):.4f}"
            row(name, what, *angles, off, tb.measure.components(made), f"{seconds:.1f}")
            show(made, f"oriented-{name}-{what.split()[0]}")


@dataclass(frozen=True)
class Part:
    """A form under its loads."""

    case: dict[str, Any]
    mask: Callable[[], np.ndarray]
    """Elements, (Z, Y, X) bool."""
    pads: tuple[tuple[slice, ...], ...] = ()
    """Where it is held and pushed: voxels that are solid, as of any machine's part."""


def _bracket() -> np.ndarray:
    """A plate that is held above and an arm that is pressed down at its end."""
    form = np.zeros((28, 10, 28), bool)
    form[:, :, :10] = True
    form[:10] = True
    return form


def _spot() -> np.ndarray:
    """The organic form, its longest side 30 elements, y up in the file turned to z."""
    from trabecula.mesh.files import read_mesh
    from trabecula.mesh.voxels import voxelise

    surface = read_mesh(SCANS / "mesh_spot.ply")
    edge = float(np.ptp(surface.vertices, axis=0).max()) / 30
    form = np.asarray(voxelise(surface, spacing=edge).values > 0)
    # of z, y, x of the file y is up
    return np.ascontiguousarray(form.transpose(1, 0, 2))


_WHOLE, _END, _ARM = slice(None), slice(-3, None), slice(0, 20)
_ALL, _FIRST, _LAST = (0.0, 1.0), (0.0, 0.0), (1.0, 1.0)

PARTS = {
    "cantilever": Part(
        {
            "shape": (16, 8, 30),
            "supports": [{"box": [_ALL, _ALL, _FIRST]}],
            "loads": [{"box": [_ALL, _ALL, _LAST], "force": (-1, 0, 0)}],
        },
        lambda: np.ones((16, 8, 30), bool),
        ((_WHOLE, _WHOLE, slice(0, 3)), (_WHOLE, _WHOLE, _END)),
    ),
    "bracket": Part(
        {
            "shape": (28, 10, 28),
            "supports": [{"box": [_LAST, _ALL, (0.0, 0.36)]}],
            "loads": [{"box": [(0.0, 0.36), _ALL, _LAST], "force": (-1, 0, 0)}],
        },
        _bracket,
        ((_END, _WHOLE, _ARM), (_ARM, _WHOLE, _END)),
    ),
    "spot": Part(
        {
            "shape": (30, 30, 30),
            "supports": [{"box": [(0.0, 0.06), _ALL, _ALL]}],
            "loads": [{"box": [(0.55, 1.0), _ALL, _ALL], "normal": (1, 0, 0), "force": (-1, 0, 0)}],
        },
        _spot,
        ((slice(0, 4), _WHOLE, _WHOLE),),
    ),
}

LONG, ROUND = (12, 4, 4), 12 ** (1 / 3) * 4 ** (2 / 3)
"""Lengths of the covariance: three to one, and alike, of the same volume."""


SPINODAL = {"low": 0.25, "high": 0.65, "volume": 0.4, "penalty": 1.0}
BONE = {"low": 0.12, "high": 0.36, "volume": 0.22, "penalty": 1.0}
"""Bounds and mean of the solid's fraction in a design."""

FINER, FINER_BONE = 2, 3
"""Voxels an element along an axis."""


def design() -> None:
    """Stiffness per mass of spinodal material that follows density and direction of a design, over
    that of material without a direction (lengths alike, of the same volume), and of the same long
    material that points one way everywhere.

    Solid is .25 to .65 by the design, .4 in the mean, and all where the part is held or pushed;
    twice as many voxels as elements along an axis. Parts are made one component in the end
    (`finish.connect`); `joined`: share of the solid that joins fill, `loose`: share that no support
    holds.
    """
    row = table(*_COLUMNS)
    for name in asked("ONLY") or PARTS:
        part, whole = DesignedPart.of(PARTS[name], SPINODAL, FINER), 0.0
        for material, length, direction in (
            ("no direction", ROUND, None),
            ("one direction", LONG, part.axis),
            ("follows the stress", LONG, part.ways),
        ):
            model = tb.method("noise", length=length, exact=True).fit(spacing=1.0)
            whole = _put_under_load(row, name, material, part, model, direction, 1, whole)


def design_bone() -> None:
    """The same of bone b, 96^3, by `quilt` and `texture`, of `asked("METHODS")` (quilt), two seeds:
    solid .12 to .36 by the design, .22 in the mean; three times as many voxels as elements.
    """
    row = table(*_COLUMNS)
    bone = tb.crop(scans()["bone b"], 96) if "bone b" in scans() else tb.sample("bone")
    for method in asked("METHODS") or ["quilt"]:
        model = tb.method(method, **SCANNED[method]).fit(bone)
        for name in asked("ONLY") or PARTS:
            part = DesignedPart.of(PARTS[name], BONE, FINER_BONE)
            for seed in (1, 2):
                whole = 0.0
                for material, direction in (
                    ("no direction", None),
                    ("one direction", part.axis),
                    ("follows the stress", part.ways),
                ):
                    words = f"{name}, {method} {seed}"
                    whole = _put_under_load(
                        row, words, material, part, model, direction, seed, whole
                    )


_COLUMNS = (
    *("part", "material", "compliance", "solid", "joined", "loose", "per mass", "ratio", "seconds"),
)


@dataclass(frozen=True)
class DesignedPart:
    """A form with the fraction and the directions of its stiffest design, on voxels."""

    case: Any
    form: np.ndarray
    wanted: np.ndarray
    ways: np.ndarray
    axis: np.ndarray
    """Unit vector along the longest side."""

    @classmethod
    def of(cls, part: Part, limits: dict[str, float], finer: int) -> DesignedPart:
        """Design a part, with so many voxels an element."""
        mask, case = part.mask(), fields.case(part.case)
        density = fields.simp(case, shape=mask.shape, mask=mask, **limits)
        stress = fields.principal_stress(density, case, mask=mask)
        ways = fields.smooth_directions(stress.direction, sigma=1.0, weights=np.abs(stress.stress))
        form = mask.repeat(finer, 0).repeat(finer, 1).repeat(finer, 2)
        ways = fields.resample_directions(fields.continue_directions(ways), form.shape)
        wanted = fields.resample(density, form.shape).values
        # Outside of the form the density is 0, which linear interpolation would carry inside.
        wanted = np.where(form, np.clip(wanted, limits["low"], 1), limits["low"])
        for pad in part.pads:
            wanted[tuple(_scaled(one, finer / 2) for one in pad)] = 1
        return cls(case, form, wanted, ways.values, np.eye(3)[int(np.argmax(form.shape))])


def _scaled(part: slice, factor: float) -> slice:
    """Return a slice of so many times the voxels."""
    first, last = (None if end is None else round(end * factor) for end in (part.start, part.stop))
    return slice(first, last)


def _put_under_load(
    row: Callable[..., None],
    name: str,
    material: str,
    part: DesignedPart,
    model: tb.Model,
    direction: np.ndarray | None,
    seed: int,
    whole: float,
) -> float:
    """Make a part, solve it, and write its row; return the stiffness per mass to compare with."""
    solid = part.form & (part.wanted >= 1)
    wanted = np.where(solid, part.wanted[~solid].max(), part.wanted)
    target: dict[str, Any] = {"volume_fraction": wanted}
    target |= {} if direction is None else {"orientation": direction}
    made = model.generate(part.form.shape, seed=seed, target=target, mask=part.form)
    label = made.phases.index("solid")
    made = tb.Image(np.where(solid, label, made.values), "labels", phases=made.phases)
    made = tb.finish.connect(made, mask=part.form)
    joined = made.recipe.steps[-1]["report"]["added"] / np.count_nonzero(made.values == label)
    try:
        seconds, found = busy(lambda: fields.part_stress(made, part.case, mask=part.form))
    except tb.errors.InputError as error:
        row(name, material, str(error)[:40], *"-----", "-")
        return whole
    told = found.recipe.steps[-1]["report"]
    compliance = told["compliance"][0] / told["solid_compliance"][0]
    stiffness = 1 / (compliance * told["fraction"])
    whole = whole or stiffness
    row(
        name,
        material,
        f"{compliance:.2f}",
        f"{told['fraction']:.3f}",
        f"{joined:.4f}",
        f"{told['loose']:.4f}",
        f"{stiffness:.4f}",
        f"{stiffness / whole:.2f}",
        f"{seconds:.0f}",
    )
    show(made, f"design-{name}-{material.split()[0]}", field=found)
    return whole


def show(made: tb.Image, name: str, **options: Any) -> None:
    """Save a still where pictures are asked for."""
    folder = pictures()
    if folder:
        tb.render(made, folder / f"{name}.png", size=(640, 480), cut="none", **options)

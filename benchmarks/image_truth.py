"""From the middle slice of a scan to a volume, beside the scan itself: what one picture is enough
for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

import trabecula as tb
from common import asked, busy, table
from descriptors import scans
from image import draw, made, makers, side_of
from trabecula.core.checks import check_name
from trabecula.exemplar.views import PLANES, take_slices
from trabecula.measure.correlation import axis_preference, covariance_form, two_point
from trabecula.measure.correlation.axis_preference import two_point_diagonal

SCANS = ("Berea", "bone a", "NMC", "cement, Otsu", "cathode, coarse")
SEVERAL = ("bone a",)
"""Scans that differ by direction: made from one picture a plane as well."""

RELATIVES = {"bone a": "bone b"}
"""Scans of similar materials; of another scan the relative is the part of it behind the picture."""

BEHIND = 8
"""Planes between the picture and that part."""

REACH = 32
BOX = 64
"""Permeability is that of a centre box of so many voxels a side, mean of the axes."""

FLOOR = 8
"""Real slices whose covariance is compared with the scan's."""


@dataclass(frozen=True)
class Truth:
    """A scan, and its covariances: radial, along every axis, along the diagonals of faces."""

    scan: tb.Image
    curves: Mapping[str, np.ndarray]
    figures: Mapping[str, float]

    @classmethod
    def of(cls, scan: tb.Image, side: int) -> Truth:
        """Of a whole scan; counts and transport of its centre, as large as what is made."""
        return cls(
            scan, curves(scan), figures(tb.crop(scan, [min(side, have) for have in scan.shape]))
        )

    def errors(self, found: Mapping[str, np.ndarray]) -> list[float]:
        """Radial, the worst axis, the diagonals: relative l2 of the covariance."""
        off = {name: relative(curve, self.curves[name]) for name, curve in found.items()}
        return [off["radial"], max(off[axis] for axis in "zyx"), off["diagonal"]]


def curves(image: tb.Image) -> dict[str, np.ndarray]:
    """The covariances of the solid."""
    found = {
        "radial": two_point(image, r_max=REACH),
        "diagonal": two_point_diagonal(image, r_max=REACH),
    }
    found |= {name: two_point(image, r_max=REACH, axis=axis) for axis, name in enumerate("zyx")}
    return {name: covariance_form(curve) for name, curve in found.items()}


def figures(image: tb.Image) -> dict[str, float]:
    """What a picture does not show."""
    box = tb.crop(image, [min(BOX, side) for side in image.shape])
    return {
        "porosity": tb.measure.porosity(image),
        "Euler": tb.measure.euler_density(image) * 1e6,
        "pores": tb.measure.components(image, phase="void"),
        "largest pore": tb.measure.largest_fraction(image, phase="void"),
        "largest solid": tb.measure.largest_fraction(image),
        "thickness": tb.measure.thickness(image),
        "pore size": tb.measure.pore_size(image),
        "k": float(np.mean([tb.measure.permeability(box, axis=axis).value for axis in range(3)])),
    }


def image_truth() -> None:
    """96^3 from the middle slice of a scan by every method, beside the scan: S2, what only a volume
    shows, preferred axes.

    S2 errors are of the covariance over r = 0 .. 32, relative l2 to the whole scan's: radial, along
    the worst axis, along the diagonals of faces. `floor` is the mean of real slices, the picture's
    own beside it. Euler is per 1e6 voxels, k the permeability in voxels^2 of the centre 64^3, mean
    of the axes. `axes` is `axis_preference`. The scan's rows are of its first and last 96^3. Of a
    scan that differs by direction, rows with `3 views` are made from the middle slices of all
    planes. `kopf, like` has a relative in space: another scan (bone b for bone a), or the part of
    the same scan behind the picture.
    """
    side = side_of(96)
    heads = ("S2 radial", "S2 worst axis", "S2 diagonal", "axes", *figures_heads(), "s")
    row = table("scan, method", *heads, wide=30)
    for name, scan in chosen_scans(SCANS).items():
        plain = tb.Image(scan.values, "labels", phases=scan.phases)
        truth = Truth.of(plain, side)
        middle = [take_slices(plain, plane, 1)[0] for plane in PLANES]
        _tell_floor(name, truth, middle[0])
        _real_rows(row, name, truth, side)
        volumes = {"the scan": tb.crop(plain, min(side, *plain.shape))}
        for words, images in (("", middle[:1]), *((", 3 views", middle),) * (name in SEVERAL)):
            for method, seconds, volume in made(images, side):
                if isinstance(volume, str):
                    print(f"{name}: {method}{words}: {volume}")
                elif method != "gaussian" or not words:  # it knows the first picture alone
                    volumes[method + words] = volume
                    _row(row, f"{name}: {method}{words}", truth, volume, f"{seconds:.1f}")
            if "kopf" in makers("labels"):
                seconds, volume = _made_like(name, plain, images, side)
                volumes["kopf, like" + words] = volume
                _row(row, f"{name}: kopf, like{words}", truth, volume, f"{seconds:.1f}")
        draw(f"truth {name}", middle[: 3 if name in SEVERAL else 1], volumes)


def _made_like(
    name: str, scan: tb.Image, images: Sequence[tb.Image], side: int
) -> tuple[float, tb.Image]:
    """Seconds, and a volume from pictures beside a relative."""
    other = scans().get(RELATIVES.get(name, ""))
    values = scan.values[len(scan.values) // 2 + BEHIND :] if other is None else other.values
    relative = tb.Image(np.ascontiguousarray(values), "labels", phases=scan.phases)
    model = tb.method("kopf").fit(list(images))
    return busy(lambda: model.generate(side, seed=0, like=relative))


def figures_heads() -> Sequence[str]:
    """The names of `figures`."""
    return (
        "porosity",
        "Euler",
        "pores",
        "largest pore",
        "largest solid",
        "thickness",
        "pore size",
        "k",
    )


def chosen_scans(names: Sequence[str]) -> dict[str, tb.Image]:
    """The scans that were asked for, or those of the names."""
    found = scans()
    for name in asked("ONLY"):
        check_name(name, found, name="scan")
    wanted = asked("ONLY") or names
    return {name: found[name] for name in wanted if name in found} or dict(list(found.items())[:1])


def _tell_floor(name: str, truth: Truth, picture: tb.Image) -> None:
    values, phases = truth.scan.values, truth.scan.phases
    places = [(2 * n + 1) * len(values) // (2 * FLOOR) for n in range(FLOOR)]
    slices = [
        tb.Image(np.ascontiguousarray(values[place]), "labels", phases=phases) for place in places
    ]
    lines = [covariance_form(two_point(each, r_max=REACH)) for each in (picture, *slices)]
    own, *others = (relative(line, truth.curves["radial"]) for line in lines)
    floor = np.mean(others)
    print(
        f"{name}: S2 radial of real slices {floor:.3f} (1.5 times: {1.5 * floor:.3f}), "
        f"of the picture itself {own:.3f}"
    )


def _real_rows(row, name: str, truth: Truth, side: int) -> None:
    sides = [min(side, have) for have in truth.scan.shape]
    for words, corner in (
        ("first", [0, 0, 0]),
        ("last", [h - s for h, s in zip(truth.scan.shape, sides, strict=True)]),
    ):
        _row(
            row,
            f"{name}: {words} {sides[0]}",
            truth,
            tb.crop(truth.scan, sides, corner=corner),
            "-",
        )


def _row(row, words: str, truth: Truth, volume: tb.Image, seconds: str) -> None:
    errors = [f"{error:.3f}" for error in truth.errors(curves(volume))]
    told = [f"{value:.4g}" for value in figures(volume).values()]
    row(words, *errors, f"{axis_preference(volume, r_max=REACH):.3f}", *told, seconds)


def relative(curve: np.ndarray, reference: np.ndarray) -> float:
    return float(np.linalg.norm(curve - reference) / np.linalg.norm(reference))

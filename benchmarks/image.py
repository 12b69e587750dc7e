"""Methods that learn from pictures: how like the picture the slices of their volumes are, as the
2014 paper compares.

Every method of the registry that learns from pictures is in the tables. Of a long table a part can
be run: `--only`, `--methods` (a preset after a colon: `mrf:fast`) and `--side` of `trabecula
bench`, or TRABECULA_BENCH_ONLY, _METHODS and _SIDE, whose words are parted by semicolons.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import trabecula as tb
from common import LEVEL, SCANS, asked, busy, pictures, table
from trabecula.core.checks import check_name
from trabecula.core.errors import TrabeculaError
from trabecula.exemplar.views import take_slices
from trabecula.measure.correlation import covariance_form, two_point
from trabecula.measure.correlation.axis_preference import preference, two_point_diagonal
from trabecula.measure.grey import autocorrelation, histogram, kullback_leibler
from trabecula.measure.orientation import orientation
from trabecula.report.planes import SlicePlane, slice_planes
from trabecula.synth.api.registry import methods

LAGS = 32
REACH = 40

CROP = 192
"""Pixels a side of the centre of a picture that is learnt from."""

PICTURES = {
    "sandstone": ("micrograph_sandstone.png",),
    "ceramics": ("micrograph_ceramics.png",),
    "copolymer": ("micrograph_copolymer.png",),
    "composite": ("micrograph_composite.png",),
    "sofc": ("sofc_anode_2d.png",),
    "rods": ("separator_rods_2d.png",),
    "speckles": ("separator_speckles_2d.png",),
    "separator pair": ("separator_rods_2d.png", "separator_speckles_2d.png"),
    "gravel": ("tex_gravel.png",),
    "brick": ("tex_brick.png",),
    "grey sandstone": ("sandstone_grey_slice.png",),
    "bread 2": ("bread_baguette2.png",),
    "bread 8": ("bread_baguette8.png",),
}

Maker = Callable[[Sequence[tb.Image], int, int], tb.Image]
"""Pictures, side and seed to a volume."""


@dataclass(frozen=True)
class Likeness:
    """What the slices of a volume differ from their picture by: the smaller, the more alike."""

    histogram: float
    """Kullback-Leibler divergence, of labels between fractions; mean over channels."""
    autocorrelation: float
    """l2 norm of the difference over 32 x 32 lags, per root of their number."""
    orientation: float
    """Kullback-Leibler divergence of the local orientations."""
    covariance: float | None
    """Of labels: l2 of the difference of the radial covariance over that of the picture, mean over
    phases.
    """
    preference: float | None
    """Of labels: `axis_preference` of the slices, less that of the picture."""

    @property
    def three(self) -> tuple[float, float, float]:
        """The paper's."""
        return self.histogram, self.autocorrelation, self.orientation

    def cells(self) -> list[str]:
        """The cells of a row."""
        more = [
            "-" if value is None else f"{value:.3f}" for value in (self.covariance, self.preference)
        ]
        return [f"{value:.4f}" for value in self.three] + more


def side_of(default: int) -> int:
    """Voxels a side of the volumes that are made."""
    return int((asked("SIDE") or [str(default)])[0])


def exemplars() -> dict[str, list[tb.Image]]:
    """Pictures by name, their centres; a slice of the sample where the folder of pictures is not
    here.
    """
    if not SCANS.is_dir():
        return {"sample": [tb.Image(tb.sample("foam").values[48], "labels")]}
    wanted = asked("ONLY") or list(PICTURES)
    found = {}
    for name in wanted:
        check_name(name, PICTURES, name="picture")
        images = [tb.read(SCANS / file) for file in PICTURES[name]]
        found[name] = [tb.crop(image, min(CROP, *image.shape)) for image in images]
    return found


def makers(kind: str) -> dict[str, Maker]:
    """Every method that learns from pictures of a kind, as named or with its defaults, and for
    labels the Gaussian field.
    """
    known = {
        name: spec
        for name, spec in methods().items()
        if spec.exemplar == "2d" and kind in spec.kinds
    }
    found: dict[str, Maker] = {}
    for word in asked("METHODS") or [*known, "gaussian"]:
        name, _, preset = word.partition(":")
        check_name(name, [*methods(), "gaussian"], name="method")
        if name == "gaussian" and kind == "labels":
            found[word] = _gaussian
        elif name in known:
            found[word] = _maker(name, preset or None)
    return found


def _maker(name: str, preset: str | None) -> Maker:
    def make(images: Sequence[tb.Image], side: int, seed: int) -> tb.Image:
        learner = tb.method(name, preset=preset)
        return learner.fit(list(images) if len(images) > 1 else images[0]).generate(side, seed=seed)

    return make


def _gaussian(images: Sequence[tb.Image], side: int, seed: int) -> tb.Image:
    """The baseline: of the first picture, every direction alike."""
    flat = tb.Image(images[0].values[None], "labels", phases=images[0].phases)
    return tb.method("noise", isotropic=True, exact=True).fit(flat).generate(side, seed=seed)


def shown(picture: tb.Image) -> tb.Image:
    """Labels as the grey levels of a picture of them, since textures are of grey levels."""
    if picture.kind != "labels":
        return picture
    step = 255 // (len(picture.phases) - 1)
    return tb.Image(picture.values * np.uint8(step), "grey")


def likeness(face: SlicePlane, slices: Sequence[tb.Image]) -> Likeness:
    """Of slices, or of other pictures, to the picture of a face."""
    own, others = shown(face.picture), [shown(each) for each in slices]
    reach = min(LAGS, *(min(each.shape) - 1 for each in others))
    rho = np.mean([autocorrelation(each, lags=reach) for each in others], axis=0) - autocorrelation(
        own, lags=reach
    )
    shares = np.mean([histogram(each) for each in slices], axis=0)
    ways = np.mean([orientation(each).shares for each in others], axis=0)
    labels = face.picture.kind == "labels"
    return Likeness(
        kullback_leibler(shares, histogram(face.picture)),
        float(np.sqrt(np.mean(rho**2))),
        # nothing is left but one value
        kullback_leibler(ways, orientation(own).shares) if ways.any() else math.inf,
        _covariance_error(face.picture, slices) if labels else None,
        _preference(slices) - _preference([face.picture]) if labels else None,
    )


def _preference(slices: Sequence[tb.Image]) -> float:
    """`axis_preference` of several pictures as one."""
    reach = min(LAGS, *(min(each.shape) // 2 for each in slices))
    axial = np.mean(
        [two_point(each, r_max=reach, axis=axis) for each in slices for axis in range(2)], axis=0
    )
    return preference(
        axial, np.mean([two_point_diagonal(each, r_max=reach) for each in slices], axis=0)
    )


def _covariance_error(picture: tb.Image, slices: Sequence[tb.Image]) -> float:
    reach = min(REACH, *(min(each.shape) // 2 for each in (picture, *slices)))
    errors = []
    for phase in range(len(picture.phases)) if len(picture.phases) > 2 else (1,):
        own = covariance_form(two_point(picture, r_max=reach, phase=phase))
        mean = covariance_form(
            np.mean([two_point(each, r_max=reach, phase=phase) for each in slices], axis=0)
        )
        errors.append(np.linalg.norm(mean - own) / np.linalg.norm(own))
    return float(np.mean(errors))


def likeness_of_volume(images: Sequence[tb.Image], volume: tb.Image) -> Likeness:
    """Mean over the pictures, each with the slices of its planes."""
    found = [
        likeness(face, [each for plane in face.planes for each in take_slices(volume, plane)])
        for face in slice_planes(images)
    ]
    return _mean(found)


def own_spread(images: Sequence[tb.Image]) -> Likeness:
    """How far the halves of a picture are from each other: what there is to reach."""
    found = []
    for image in images:
        for axis, side in enumerate(image.shape):
            halves = [
                tb.Image(np.ascontiguousarray(part), image.kind, phases=image.phases)
                for part in (
                    image.values.take(range(side // 2), axis),
                    image.values.take(range(side // 2, side), axis),
                )
            ]
            found += [
                likeness(SlicePlane(here, (), ""), [there])
                for here, there in (halves, halves[::-1])
            ]
    return _mean(found)


def _mean(found: Sequence[Likeness]) -> Likeness:
    first = found[0]
    means = {
        name: float(np.mean([getattr(one, name) for one in found]))
        for name in ("histogram", "autocorrelation", "orientation")
    }
    both = {
        name: None
        if getattr(first, name) is None
        else float(np.mean([getattr(one, name) for one in found]))
        for name in ("covariance", "preference")
    }
    return Likeness(**means, **both)


def oblique(volume: tb.Image) -> tb.Image:
    """The plane through the middle that holds the z axis and the diagonal of y and x, the nearest
    voxels of it.
    """
    side = min(volume.shape[1:])
    steps = np.rint(np.arange(int(side * np.sqrt(2))) / np.sqrt(2)).astype(int).clip(0, side - 1)
    return tb.Image(
        np.ascontiguousarray(volume.values[:, steps, steps]), volume.kind, phases=volume.phases
    )


def draw(name: str, images: Sequence[tb.Image], volumes: dict[str, tb.Image]) -> None:
    """The pictures, and of every volume three slices and an oblique one, where pictures are asked
    for.
    """
    folder = pictures()
    if folder is None:
        return
    from PIL import Image as Pillow

    rows = [[_pixels(image) for image in images]]
    for volume in volumes.values():
        planes = [take_slices(volume, plane, 1)[0] for plane in ("yx", "zx", "zy")]
        rows.append([_pixels(plane) for plane in (*planes, oblique(volume))])
    gap = 6
    width = max(sum(pixels.shape[1] + gap for pixels in row) for row in rows)
    sheet = np.full(
        (sum(max(p.shape[0] for p in row) + gap for row in rows), width, 3), 160, np.uint8
    )
    top = 0
    for row in rows:
        left = 0
        for pixels in row:
            sheet[top : top + pixels.shape[0], left : left + pixels.shape[1]] = pixels
            left += pixels.shape[1] + gap
        top += max(pixels.shape[0] for pixels in row) + gap
    path = Path(folder) / f"image-{name.replace(' ', '-').replace(',', '')}.png"
    Pillow.fromarray(sheet).save(path)
    print(f"(drawn: {path}, rows: the picture, {', '.join(volumes)}; planes yx, zx, zy, oblique)")


def _pixels(image: tb.Image, *, zoom: int = 2) -> np.ndarray:
    values = shown(image).values
    values = (
        values
        if image.kind == "colour"
        else np.repeat(values.astype(np.uint8)[..., None], 3, axis=-1)
    )
    return values.repeat(zoom, axis=0).repeat(zoom, axis=1)


def made(
    images: Sequence[tb.Image], side: int, *, seed: int = 0
) -> Iterator[tuple[str, float, tb.Image | str]]:
    """Name, processor seconds and volume of every method, or why there is none."""
    for name, make in makers(images[0].kind).items():
        try:
            seconds, volume = busy(lambda make=make: make(images, side, seed))
        except TrabeculaError as error:
            yield name, 0.0, str(error)
        else:
            yield name, seconds, volume


def image_likeness() -> None:
    """Every picture, 64^3 by every method: the measures of the 2014 paper's figure 10, over slices
    of the views.

    `real` is how far the halves of the picture are from each other. For labels also the
    covariance's error, and how much more than the picture the slices prefer the axes. Seconds are
    the processor's, learning and compiling included. Last, of how many pictures `mrf` is ahead of
    the others, or level with them (0.002), in the three measures together and in each.
    """
    side = side_of(64)
    row = table(
        "picture, method", "histogram", "autocorr.", "orientation", "S2 cov", "axes", "s", wide=34
    )
    ahead: dict[str, list[bool]] = defaultdict(list)
    for name, images in exemplars().items():
        row(f"{name}: real", *own_spread(images).cells(), "-")
        found, volumes = {}, {}
        for method, seconds, volume in made(images, side):
            if isinstance(volume, str):
                print(f"{name}: {method}: {volume}")
                continue
            found[method], volumes[method] = likeness_of_volume(images, volume), volume
            row(f"{name}: {method}", *found[method].cells(), f"{seconds:.1f}")
        draw(name, images, volumes)
        for method, here in found.items():
            if method.startswith("mrf"):
                continue
            for rival in (word for word in found if word.startswith("mrf")):
                better = [
                    a < b + LEVEL for a, b in zip(found[rival].three, here.three, strict=True)
                ]
                ahead[f"{rival} ahead of {method}"].append(all(better))
                for measure, won in zip(
                    ("histogram", "autocorrelation", "orientation"), better, strict=True
                ):
                    ahead[f"{rival} ahead of {method} in {measure}"].append(won)
    for words, won in ahead.items():
        print(f"{words}: {sum(won)} of {len(won)}")

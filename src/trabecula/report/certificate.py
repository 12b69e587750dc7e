"""The certificate: every descriptor of an image against the exemplar, and against what the exemplar's own parts
differ by.

The *real band* of a figure is what equal parts of the exemplar (halves along every axis that is long enough, eight
octants as a rule) say that one more such part would have, 19 times in 20. A result inside it is no further from the
exemplar than the exemplar is from itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core import progress
from trabecula.core.checks import check_name
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, describe_fields
from trabecula.measure.amount import porosity
from trabecula.measure.copying import diversity
from trabecula.measure.correlation import decay_length
from trabecula.measure.describe import LEVELS
from trabecula.measure.physics import physics_notes
from trabecula.report.band import LEAST_PART, parts
from trabecula.report.baseline import gaussian_field
from trabecula.report.metric import Certificate, Metric
from trabecula.report.reference import Reference
from trabecula.report.sticks import LabelStick, Measured, Stick, TextureStick

LONG_RANGE = 6
"""An exemplar shorter than this many correlation lengths holds too little of its material to judge by."""


@overload
def verify(
    exemplar: Image | ArrayLike,
    image: Image | ArrayLike,
    /,
    *,
    r_max: int = ...,
    names: Sequence[str] | None = ...,
    level: str = ...,
    box: int | None = ...,
) -> Certificate: ...


@overload
def verify(
    exemplar: Image | ArrayLike,
    /,
    *images: Image | ArrayLike,
    r_max: int = ...,
    names: Sequence[str] | None = ...,
    level: str = ...,
    box: int | None = ...,
) -> list[Certificate]: ...


def verify(
    exemplar: Image | ArrayLike,
    /,
    *images: Image | ArrayLike,
    r_max: int = 50,
    names: Sequence[str] | None = None,
    level: str = "default",
    box: int | None = None,
) -> Certificate | list[Certificate]:
    """Judge whether images are of the same material as the exemplar.

    Parameters
    ----------
    exemplar, *images : Image or array of labels, (Z, Y, X) or (Y, X)
        Of the same phases, spacing and unit; sizes may differ. Or all grey, or all colour: then their textures are
        compared.
    r_max : int
        Largest distance of the curves in voxels; lowered to half the smallest side of either image, and to what fits
        into a part of the exemplar.
    names : sequence of str, optional
        What to call the images.
    level : {"quick", "default", "full"}
        "quick" leaves out thickness, pore size, directions, clusters, copying and the baseline; "full" adds transport
        and stiffness.
    box : int, optional
        At level "full": edge of the centre box, voxels, that transport and stiffness are solved in.

    Returns
    -------
    certificate : Certificate, or a list of them for several images

    Raises
    ------
    InputError
        No image; kinds, phases, spacing, unit or dimensions that do not correspond; an exemplar of one phase only; an
        unknown level.

    Notes
    -----
    Distances to the exemplar: `porosity_error` = abs(phi - phi_e) / phi_e; over the radial S2 of the solid,
    `two_point_distance` = the l2 norm of the difference for r = 1 .. r_max, `two_point_relative` = the norm over
    that of the exemplar for r = 0 .. r_max, `two_point_covariance` = the same of (S2 - phi^2) / (phi - phi^2),
    `two_point_axial` = the largest of that along an axis; `lineal_path_distance` and `two_point_cluster_distance` =
    relative l2 of these curves; `component_distance` = the Wasserstein distance of the component sizes.

    A figure passes inside its band: the bootstrap prediction interval (95 %) of the parts of the exemplar, widened by
    the exemplar's own value; a distance up to the 95 % of the parts' distances to the whole. The band of `components`,
    `floating` and `floating_voxels` is scaled to the image's volume; these, `largest_fraction` and
    `percolating_fraction` fail on one side only, since fewer loose parts than the exemplar has are no fault.
    `percolates` fails along an axis where the exemplar percolates and the image does not. `coherence` is the share of
    voxels whose source in the exemplar moves along over 4 voxels; its band is that of parts of the exemplar searched
    in other parts.

    The baseline is a thresholded Gaussian field with the exemplar's fraction and two-point function (`noise`): where
    it passes as well, a figure says little.
    """
    exemplar = as_image(exemplar, name="exemplar")
    check_name(level, LEVELS, name="level")
    if not images:
        raise InputError("verify needs an image to compare with the exemplar: verify(exemplar, image)")
    if r_max < 1:
        raise InputError(f"r_max {r_max} must be at least 1 voxel")
    if exemplar.kind == "labels" and not 0 < porosity(exemplar) < 1:
        raise InputError("the exemplar is all void or holds none: there is nothing to compare; check its threshold")
    others = [as_image(image, name=f"image {n}") for n, image in enumerate(images, start=1)]
    names = _names(names, len(others))
    for image, name in zip(others, names, strict=True):
        _check_corresponds(exemplar, image, name)
    reach = min(r_max, *(min(image.shape) // 2 for image in (exemplar, *others)))
    fits = min((min(part.shape) - 1 for part in parts(exemplar)), default=reach)
    reach = max(1, min(reach, fits))
    stick = _stick(exemplar, reach, level, box)
    thorough = level != "quick" and exemplar.kind == "labels"
    reference = Reference(exemplar, stick, copying=thorough)
    baseline = _baseline(reference, reach) if thorough else None
    found = [
        _certificate(reference, image, name, level, baseline)
        for image, name in progress.track(list(zip(others, names, strict=True)), "comparing")
    ]
    found = _with_diversity(found, others) if thorough else found
    return found[0] if len(found) == 1 else found


def _names(names: Sequence[str] | None, count: int) -> Sequence[str]:
    if names is None:
        return ["image"] if count == 1 else [f"image {n + 1}" for n in range(count)]
    if len(names) != count:
        raise InputError(f"{len(names)} names for {count} images: give one for each")
    return names


def _check_corresponds(exemplar: Image, image: Image, name: str) -> None:
    if image.kind != exemplar.kind:
        raise InputError(
            f"{name} is {image.kind}, the exemplar {exemplar.kind}: segment the one that is not labels (tb.segment, or "
            "--threshold), or give both as grey (--threshold none)"
        )
    if image.ndim != exemplar.ndim:
        raise InputError(f"{name} is {image.ndim}-D, the exemplar {exemplar.ndim}-D: compare images of equal dimension")
    if set(image.phases) != set(exemplar.phases):
        raise InputError(
            f"phases do not correspond: {name} has {', '.join(image.phases)}, the exemplar "
            f"{', '.join(exemplar.phases)}; give both the same names (tb.Image(..., phases=...))"
        )
    if image.unit != exemplar.unit or not np.allclose(image.spacing, exemplar.spacing, rtol=1e-4):
        raise InputError(
            f"voxels do not correspond: {name} has {_voxel(image)}, the exemplar {_voxel(exemplar)}; give both their "
            "spacing, or resample one"
        )


def _voxel(image: Image) -> str:
    return f"{' x '.join(f'{edge:g}' for edge in image.spacing)} {image.unit}"


def _stick(exemplar: Image, r_max: int, level: str, box: int | None) -> Stick:
    if exemplar.kind != "labels":
        return TextureStick(exemplar, lags=min(r_max, 32))
    return LabelStick(r_max=r_max, level=level, box=box)


def _baseline(reference: Reference, r_max: int) -> tuple[dict[str, Metric], Measured]:
    """Without transport and stiffness, which would take as long as those of an image, and no copy by its making."""
    field = gaussian_field(reference.exemplar)
    measured = LabelStick(r_max=r_max, level="default").measure(field)
    return reference.judge(field, measured, copying=False), measured


def _certificate(
    reference: Reference, image: Image, name: str, level: str, baseline: tuple[dict[str, Metric], Measured] | None
) -> Certificate:
    measured = reference.measure(image)
    metrics = reference.judge(image, measured)
    curves = {"exemplar": reference.own.curves, "image": measured.curves, "parts": [p.curves for p in reference.parts]}
    about = {"exemplar": _about(reference.exemplar), "image": _about(image), "level": level}
    if measured.details:
        about["physics"] = {"exemplar": reference.own.details, "image": measured.details}
    if baseline:
        curves["baseline"] = baseline[1].curves
    notes = (*_notes(reference), *_image_notes(reference.exemplar, image, metrics, measured))
    return Certificate(metrics, notes, name, curves, about, baseline[0] if baseline else None)


def _about(image: Image) -> dict[str, Any]:
    return {"shape": list(image.shape), **describe_fields(image)}


def _notes(reference: Reference) -> Iterable[str]:
    exemplar, count = reference.exemplar, len(reference.parts)
    if count == 0:
        yield (
            f"The exemplar ({_size(exemplar)}) is too small for parts of {LEAST_PART} voxels a side: no band says what "
            "real material differs by, so nothing is judged."
        )
    elif count < 4:
        yield f"The band comes from {count} parts of the exemplar only: it is narrower than the material's own spread."
    if exemplar.kind == "labels":
        yield from _range_note(exemplar, reference.own)
    if reference.own.details and reference.parts:
        yield (
            f"Transport and stiffness of the parts are those of boxes of at most {_size(reference.parts[0])} voxels: cut "
            "struts bear nothing, so the band of stiffness lies low."
        )
    bare = [
        f"{end} {axis}"
        for n, axis in enumerate("zyx"[3 - exemplar.ndim :])
        for end, at in (("first", 0), ("last", -1))
        if np.ptp(exemplar.values.take(at, axis=n)) == 0
    ]
    if bare:
        yield (
            f"The outermost slices of the exemplar hold one phase alone ({', '.join(bare)}): a margin of the scan? "
            "Crop them, or they count as material and hide percolation."
        )


def _range_note(exemplar: Image, own: Measured) -> Iterable[str]:
    length = decay_length(own.curves["two_point"])
    shortest = min(np.array(exemplar.shape) * np.array(exemplar.spacing)) / min(exemplar.spacing)
    if shortest < LONG_RANGE * length:
        reach = f"over {length:.0f} voxels" if np.isfinite(length) else "further than the curves run"
        yield (
            f"The exemplar is correlated {reach}, its shortest side is {shortest:.0f}: it holds too little of the "
            "material to say what is typical; bands are wide, and a larger scan may differ from all of this."
        )


def _image_notes(exemplar: Image, image: Image, metrics: Mapping[str, Metric], measured: Measured) -> Iterable[str]:
    if np.prod(image.shape) < np.prod(exemplar.shape) / 8:
        yield "The image is smaller than an eighth of the exemplar: it may leave the band by chance."
    if exemplar.kind != "labels":
        return
    floating = metrics["floating"]
    if floating.exemplar > 10 and floating.value < floating.exemplar / 10:
        yield (
            f"The exemplar has {floating.exemplar:.0f} floating parts in this volume, the image {floating.value}. "
            "Specks change mean curvature, Euler number and pore size: to leave them out, verify against "
            "finish.connect(exemplar, reach=0)."
        )
    broken = [axis for axis, holds in metrics["percolates"].value.items() if not holds]
    if broken:
        yield f"The solid does not span the image along {', '.join(broken)}."
    yield from physics_notes(measured.details)


def _size(image: Image | Measured) -> str:
    return " x ".join(map(str, image.shape))


def _with_diversity(certificates: list[Certificate], images: Sequence[Image]) -> list[Certificate]:
    """Where several images are of one shape: how far they are from being one and the same."""
    alike = [n for n, image in enumerate(images) if image.shape == images[0].shape]
    if len(alike) < 2:
        return certificates
    try:
        apart = diversity([images[n] for n in alike])
    except InputError:  # too small, or too plain, to look for shifted copies
        return certificates
    others = ~np.eye(len(alike), dtype=bool)
    note = (
        f"Of the {len(alike)} images of one shape the two most alike differ in {apart.distance[others].min():.0%} of what "
        f"independent ones would, and at most {np.nanmax(apart.coherence):.0%} of one image's voxels continue a piece of "
        "another."
    )
    return [replace(one, notes=(*one.notes, note)) if n in alike else one for n, one in enumerate(certificates)]

"""The certificate: every descriptor of an image against the exemplar, and against the spread
between the exemplar's own parts.

The *real band* of a figure is where another sample of the material, as large as the image, would
lie 99 times in 100. Equal parts of the exemplar say it (halves along every axis that is long
enough, eight octants as a rule), extrapolated to the image's size; `report.band` has the formulas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast, overload

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, check_name, check_type
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.engine.lazy_volume import Slabs
from trabecula.engine.parallel import do_together, map_items
from trabecula.measure.blockwise import images_at_once, names_without_slabs
from trabecula.measure.copying import diversity
from trabecula.measure.copying.pair import ExemplarTrees
from trabecula.measure.disector import GAP
from trabecula.measure.fractions import porosity
from trabecula.measure.registry import LEVELS
from trabecula.report.band import parts
from trabecula.report.baseline import gaussian_field
from trabecula.report.compatibility import check_corresponds, check_pictures, check_same_kind
from trabecula.report.decidability import exemplar_reasons, level_reasons
from trabecula.report.descriptors import (
    DescriptorSet,
    LabelDescriptors,
    Measurements,
    TextureDescriptors,
)
from trabecula.report.evenness import Windows, choose_windows, local_fractions
from trabecula.report.metrics import Metric
from trabecula.report.notes import exemplar_notes, image_notes
from trabecula.report.rates import rates_note
from trabecula.report.reference import Reference, search_copies
from trabecula.report.slicewise import judge_volumes
from trabecula.report.verdict import Certificate, about_image

Exemplar = Image | ArrayLike | list[Image] | tuple[Image, ...]


@overload
def verify(
    exemplar: Exemplar,
    image: Image | Slabs | ArrayLike,
    /,
    *,
    r_max: int = ...,
    names: Sequence[str] | None = ...,
    level: str = ...,
    box: int | None = ...,
    views: Sequence[str] = ...,
    gap: int = ...,
    memory: int | None = ...,
) -> Certificate: ...


@overload
def verify(
    exemplar: Exemplar,
    /,
    *images: Image | Slabs | ArrayLike,
    r_max: int = ...,
    names: Sequence[str] | None = ...,
    level: str = ...,
    box: int | None = ...,
    views: Sequence[str] = ...,
    gap: int = ...,
    memory: int | None = ...,
) -> list[Certificate]: ...


def verify(
    exemplar: Exemplar,
    /,
    *images: Image | Slabs | ArrayLike,
    r_max: int = 50,
    names: Sequence[str] | None = None,
    level: str = "default",
    box: int | None = None,
    views: Sequence[str] = (),
    gap: int = 0,
    memory: int | None = None,
) -> Certificate | list[Certificate]:
    """Judge whether images are of the same material as the exemplar.

    Parameters
    ----------
    exemplar, *images : Image or array of labels, (Z, Y, X) or (Y, X)
        Of the same phases, spacing and unit; sizes may differ. Or all grey, or all colour: then
        their textures are compared. Volumes may be held against a picture, or against a list of two
        or three Images, one for each view. A volume given as `Slabs` is never in memory as a whole;
        then all is judged at level "quick".
    r_max : int
        Largest distance of the curves in voxels; lowered to half the smallest side of either image,
        and to what fits into a part of the exemplar.
    names : sequence of str, optional
        What to call the images.
    level : {"quick", "default", "full"}
        "quick" leaves out thickness, pore size, directions, clusters, copying and the baseline;
        "full" adds transport and stiffness.
    box : int, optional
        At level "full": edge of the centre box, voxels, that transport and stiffness are solved in.
    views : sequence of str
        Of pictures: the planes of a volume that each is, "yx" (seen across z), "zx", "zy", or
        turned "xy", "xz", "yz", as in the methods that learn from pictures.
    gap : int
        Of pictures of labels: voxels from one to the next of parallel sections, of a material that
        is alike from all sides. The first stands for all planes; together they say the Euler number
        (`measure.disector_euler_density`). 0: they are pictures of different planes.
    memory : int, optional
        Bytes that the measures of `Slabs` may use. Default: what is available.

    Returns
    -------
    certificate : Certificate, or a list of them for several images

    Raises
    ------
    InputError
        No image; kinds, phases, spacing, unit or dimensions that do not correspond; an exemplar of
        one phase only; an unknown level.

    Notes
    -----
    Distances to the exemplar: `porosity_error` = abs(phi - phi_e) / phi_e; over the radial S2 of
    the solid for r = 1 .. r_max, `two_point_distance` = the l2 norm of the difference,
    `two_point_relative` = that over the norm of the exemplar's (Zhang, Chen, Wang, Wang 2017, table
    1; D2 of Zhang et al. 2021 is 100 times this); `two_point_covariance` = the relative norm of (S2
    - phi^2) / (phi - phi^2), r = 0 .. r_max, and `two_point_covariance_z` the same of S2 along z;
    `lineal_path_distance` (of the void with `_void`, along an axis with `_z`),
    `two_point_cluster_distance` = relative l2 of these curves; `component_distance` = the
    Wasserstein distance of the component sizes.

    A figure passes inside its band. The bands of `components`, `floating` and `floating_voxels` are
    scaled to the image's volume; these, `largest_fraction` and `percolating_fraction` fail on one
    side only, since fewer loose parts than the exemplar has are no fault. `percolates` fails along
    an axis where the exemplar percolates and the image does not; of an image smaller than the
    exemplar, where all parts of the exemplar percolate as well. `coherence` is the share of voxels
    whose source in the exemplar moves along over 4 voxels; its band is that of parts of the
    exemplar searched in other parts. `turned_copies` is the share of voxels whose neighbourhood
    recurs in the exemplar mirrored or turned (see `measure.turned_copies`).

    Evenness: over all windows of three sizes (see `measure.evenness`), the standard deviation and
    the extremes of the local fraction (`fraction_spread_large`, `fraction_lowest_large`, ...), of
    the local surface and of its direction, and the change of the local fraction along every axis
    and from the faces to the centre (`fraction_trend_centre`).

    There are three verdicts. Where a figure fails, the image fails. Where none fails, the image
    passes, unless `Certificate.undecided` says why that proves nothing: the exemplar is too small
    or not stationary, noise passes every figure as well, copying was not examined, or the exemplar
    is a picture and connections in space cannot be seen.

    Of a volume held against a picture, slices are measured, eight a plane: figures are their means,
    distances along an axis and `axis_preference` those of the worst plane. Parts of the picture are
    then no larger than the slices. `axis_preference` compares lines along the axes with lines along
    diagonals (see `measure.axis_preference`), over three correlation lengths; `coherence` is that
    of a slice a plane, halfway to the middle. Names that end with a plane (`porosity_zx`) are of
    that plane, or of those planes that one of several pictures is for; names with `_3d` are of the
    volume itself and are not judged.

    The baseline is a thresholded Gaussian field with the exemplar's fraction and two-point function
    (`noise`): where it passes as well, a figure says little.
    """
    several = isinstance(exemplar, (list, tuple)) and _are_images(exemplar)
    pictures: list[Any] = list(cast(Sequence, exemplar)) if several else [exemplar]
    exemplars = [as_image(picture, name="exemplar") for picture in pictures]
    exemplar = exemplars[0]
    check_name(level, LEVELS, name="level")
    if not images:
        raise InputError(
            "verify needs an image to compare with the exemplar: verify(exemplar, image)"
        )
    if r_max < 1:
        raise InputError(f"r_max {r_max} must be at least 1 voxel")
    for picture in exemplars:
        if picture.kind == "labels" and not 0 < porosity(picture) < 1:
            raise InputError(
                "the exemplar is all void or holds none: there is nothing to compare; check its "
                "threshold"
            )
    check_pictures(exemplars)
    others = [_as_image(image, name=f"image {n}") for n, image in enumerate(images, start=1)]
    names = _names(names, len(others))
    check_type(views, Sequence, name="views", advice="give names of planes")
    gap = int(as_number(gap, name="gap", low=0, high=GAP, whole=True))
    level, slab_note = _level_for(others, names, level)
    if (
        len(exemplars) > 1
        or views
        or gap
        or (exemplar.ndim == 2 and any(image.ndim == 3 for image in others))
    ):
        for image, name in zip(others, names, strict=True):
            check_same_kind(exemplar, image, name)
        if slab_note:
            raise InputError(
                f"{slab_note} A volume held against pictures has to fit into memory: give a crop "
                "of it"
            )
        found = judge_volumes(
            exemplars, others, names, views=views, gap=gap, r_max=r_max, level=level, box=box
        )
        return found[0] if len(found) == 1 else found
    for image, name in zip(others, names, strict=True):
        check_corresponds(exemplar, image, name)
    judge = Judge(exemplar, others, r_max=r_max, level=level, box=box, memory=memory)
    found = map_items(
        lambda pair: judge.certificate(*pair),
        list(zip(others, names, strict=True)),
        "comparing",
        most=judge.most,
    )
    found = _add_diversity(found, others) if judge.thorough else found
    found = [replace(one, notes=(*one.notes, slab_note)) for one in found] if slab_note else found
    return found[0] if len(found) == 1 else found


class Judge:
    """An exemplar that was measured, and its baseline; `verify` judges every image by one.

    Parameters
    ----------
    exemplar : Image
    images : sequence of Image or Slabs
        All that are to be judged: the smallest limits curves and windows.
    r_max, level, box, memory
        As of `verify`.
    """

    def __init__(
        self,
        exemplar: Image,
        images: Sequence[Image],
        *,
        r_max: int = 50,
        level: str = "default",
        box: int | None = None,
        memory: int | None = None,
    ) -> None:
        self.level = level
        self.thorough = level != "quick" and exemplar.kind == "labels"
        reach = min(r_max, *(min(image.shape) // 2 for image in (exemplar, *images)))
        fits = min((min(part.shape) - 1 for part in parts(exemplar)), default=reach)
        reach = max(1, min(reach, fits))
        windows = choose_windows(exemplar, images)
        descriptors = _choose_descriptors(exemplar, reach, level, windows, box, memory)
        self.most = images_at_once([each.shape for each in (exemplar, *images)], level)
        self.reference, field = do_together(
            "measuring the exemplar",
            lambda: Reference(exemplar, descriptors, copying=self.thorough, most=self.most),
            lambda: _measure_baseline(exemplar, windows, reach) if self.thorough else None,
            most=self.most,
        )
        self.trees = ExemplarTrees()
        self.baseline = field and (self.reference.judge(field, None), field)

    def certificate(self, image: Image, name: str, *, copying: bool | None = None) -> Certificate:
        """Judge an image; `copying` False leaves out the search for copies, most of the time."""
        reference = self.reference
        search = reference.copying if copying is None else copying
        measured, copies = do_together(
            f"measuring {name}",
            lambda: reference.measure(image),
            lambda: search_copies(reference.exemplar, image, trees=self.trees) if search else None,
            most=self.most,
        )
        return self._certificate(image, name, measured, reference.judge(measured, copies))

    def _certificate(
        self, image: Image, name: str, measured: Measurements, metrics: dict[str, Metric]
    ) -> Certificate:
        reference, level, baseline = self.reference, self.level, self.baseline
        curves = {
            "exemplar": reference.own.curves,
            "image": measured.curves,
            "parts": [p.curves for p in reference.parts],
        }
        about = {
            "exemplar": about_image(reference.exemplar),
            "image": about_image(image),
            "level": level,
        }
        if measured.details:
            about["physics"] = {"exemplar": reference.own.details, "image": measured.details}
        if baseline:
            curves["baseline"] = baseline[1].curves
        notes = (
            *exemplar_notes(reference),
            *image_notes(reference.exemplar, image, metrics, measured),
            *rates_note(reference.exemplar, image, level),
        )
        noise = baseline[0] if baseline else None
        reasons = (*exemplar_reasons(reference), *level_reasons(reference, level, noise, metrics))
        maps = {
            who: local_fractions(each)
            for who, each in (("exemplar", reference.own), ("image", measured))
            if each.cells
        }
        return Certificate(metrics, notes, name, curves, about, noise, reasons, maps)


def _as_image(image: Image | Slabs | ArrayLike, *, name: str) -> Image:
    """Return an Image; slabs stand for one wherever its values are not needed."""
    return cast(Image, image) if isinstance(image, Slabs) else as_image(image, name=name)


def _level_for(images: Sequence[Any], names: Sequence[str], level: str) -> tuple[str, str | None]:
    """Return the level at which images are measured, lower where one is in slabs, and a note."""
    large = [name for image, name in zip(images, names, strict=True) if isinstance(image, Slabs)]
    if not large:
        return level, None
    left_out = ""
    if level != "quick":
        left_out = f": {', '.join(names_without_slabs())}, copying and the baseline were left out"
    return (
        "quick",
        f'Measured slab by slab, at level "quick", for the size of {", ".join(large)}{left_out}.',
    )


def _names(names: Sequence[str] | None, count: int) -> Sequence[str]:
    if names is None:
        return ["image"] if count == 1 else [f"image {n + 1}" for n in range(count)]
    check_type(names, Sequence, name="names", advice="give a list of them")
    if len(names) != count:
        raise InputError(f"{len(names)} names for {count} images: give one for each")
    return names


def _are_images(given: Sequence[Any]) -> bool:
    return bool(given) and all(isinstance(each, Image) for each in given)


def _choose_descriptors(
    exemplar: Image,
    r_max: int,
    level: str,
    windows: Windows | None,
    box: int | None,
    memory: int | None,
) -> DescriptorSet:
    if exemplar.kind != "labels":
        return TextureDescriptors(exemplar, lags=min(r_max, 32), windows=windows)
    return LabelDescriptors(r_max=r_max, level=level, windows=windows, box=box, memory=memory)


def _measure_baseline(exemplar: Image, windows: Windows | None, r_max: int) -> Measurements:
    """Measure the baseline, without transport and stiffness, which take as long as those of an
    image; it is no copy by its making.
    """
    field = gaussian_field(exemplar)
    fits = windows if windows and min(field.shape) >= min(exemplar.shape) else None
    return LabelDescriptors(r_max=r_max, level="default", windows=fits).measure(field)


def _add_diversity(certificates: list[Certificate], images: Sequence[Image]) -> list[Certificate]:
    """Add a note where several images are of one shape: how far they are from being the same."""
    alike = [n for n, image in enumerate(images) if image.shape == images[0].shape]
    if len(alike) < 2:
        return certificates
    try:
        apart = diversity([images[n] for n in alike])
    except InputError:  # too small, or too plain, to look for shifted copies
        return certificates
    others = ~np.eye(len(alike), dtype=bool)
    note = (
        f"Of the {len(alike)} images of one shape the two most alike differ in "
        f"{apart.distance[others].min():.0%} of what independent ones would, and at most "
        f"{np.nanmax(apart.coherence):.0%} of one image's voxels continue a patch of another."
    )
    return [
        replace(one, notes=(*one.notes, note)) if n in alike else one
        for n, one in enumerate(certificates)
    ]

"""Files that the steps start from: exemplars, results to compare, forms to fill, measured parts."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from trabecula.core.checks import as_path_text, as_shape, check_name
from trabecula.core.errors import InputError
from trabecula.core.image import Image, declare_fields, default_phases
from trabecula.core.progress import notify, silence
from trabecula.engine.lazy_volume import Slabs
from trabecula.exemplar.crop import crop as cut_box
from trabecula.exemplar.fetch import fetch
from trabecula.exemplar.margins import crop_margins, find_margins
from trabecula.exemplar.place import as_slab, block, place
from trabecula.exemplar.samples import sample
from trabecula.exemplar.segment import segment
from trabecula.exemplar.views import as_axis, spacing_of, views_of
from trabecula.io import files
from trabecula.io.lazy import open_slabs, slabs_if_large
from trabecula.io.units import has_length, to_metres
from trabecula.mesh.files import read_mesh
from trabecula.mesh.formats import READABLE as SURFACES
from trabecula.mesh.voxels import fit_mesh, scale_mesh, voxelise

SAMPLE_PREFIX = "sample:"
DATA_PREFIX = "data:"


def load(
    source: str | os.PathLike[str],
    *,
    crop: int | Sequence[int] | str | None = None,
    threshold: float | Sequence[float] | str | None = None,
    **reading: Any,
) -> Image:
    """Load an image from a file, from `sample:NAME` or `data:NAME` (see `fetch`), and segment and
    crop it.

    Parameters
    ----------
    source : path or str
    crop : int, sequence of int or "auto", optional
        Size of a central box to keep, voxels; "auto" removes margins without material (see
        `crop_margins`).
    threshold : float, pair of float, "otsu", "dual", "auto" or "none", optional
        Segment a grey image (see `segment`). "auto" is Otsu's, and leaves an image that is not grey
        as it is; "none" leaves a grey one grey.
    **reading
        kind, spacing, unit, phases: as in `read`. Where a grey image is segmented, `phases` names
        the two labels.

    Raises
    ------
    InputError
        A threshold for an image that is not grey; a spacing, unit or phases for a sample or a data
        set.
    FileError, UnknownNameError
        As `read`.
    """
    name = as_path_text(source)
    phases = reading.pop("phases", None)
    if name.startswith((SAMPLE_PREFIX, DATA_PREFIX)) and (reading or phases):
        raise InputError(f"{name} comes with its spacing, unit and phases: give none")
    if name.startswith(SAMPLE_PREFIX):
        image = sample(name.removeprefix(SAMPLE_PREFIX))
    elif name.startswith(DATA_PREFIX):
        image = fetch(name.removeprefix(DATA_PREFIX))
    else:
        image = (
            files.read(name, **reading)
            if phases is None
            else _read_with_phases(name, phases, reading)
        )
    if isinstance(crop, str):
        check_name(crop, ("auto",), name="crop")
        image = _crop_margins(image, name)  # before the threshold is found: a frame is no phase
    if image.kind == "grey" and threshold not in (None, "none"):
        image = segment(
            image, "otsu" if threshold == "auto" else threshold, phases=phases or ("void", "solid")
        )
        found = image.recipe.steps[-1]["threshold"]
        if isinstance(threshold, str):
            notify(f"{name} is grey: threshold {found} found (--threshold chooses another)")
    elif threshold not in (None, "auto", "none"):
        raise InputError(
            f"{name} holds {image.kind}, a threshold is for grey images: leave --threshold out, "
            "or give --kind grey"
        )
    # Cropped after the threshold is found, so that it is the whole scan's and the same for every
    # crop of it.
    if isinstance(crop, str):
        return _crop_margins(image, name, again=True)
    return image if crop is None else cut_box(image, crop)


def _crop_margins(image: Image, name: str, *, again: bool = False) -> Image:
    """Crop the margins and report them; that there are none is not reported `again`."""
    margins = find_margins(image)
    if margins:
        size = " x ".join(map(str, margins.size))
        notify(f"{name}: {margins}; cropped to {size} at {margins.corner}")
        return crop_margins(image)
    if not again:
        notify(f"{name} has no margins to crop")
    return image


def _read_with_phases(name: str, phases: Sequence[str], reading: Mapping[str, Any]) -> Image:
    """Read a file; one that is grey without names, which are for the labels of its threshold."""
    plain = files.read(name, **reading)
    return plain if plain.kind == "grey" else files.read(name, phases=phases, **reading)


def load_like(
    source: str | os.PathLike[str],
    exemplar: Image,
    *,
    threshold: float | Sequence[float] | str = "auto",
    spacing: Callable[[], Sequence[float]] | None = None,
) -> Image:
    """Load a result to be compared with an exemplar.

    A grey result is segmented where the exemplar has phases. One whose file states no spacing or no
    names of phases (another program's, a plain array) takes the exemplar's.

    Parameters
    ----------
    source : path or str
    exemplar : Image
    threshold : optional
        As of `load`.
    spacing : callable, optional
        Returns the voxel edges (z, y, x) of a volume whose exemplar is a picture; called for no
        other.
    """
    image = load(source, threshold="none")
    if image.kind == "grey" and exemplar.kind == "labels":
        image = load(source, threshold=threshold)
    new = _find_unstated(image, exemplar, spacing)
    return declare_fields(image, **new) if new else image


def slabs_like_if_large(
    source: str | os.PathLike[str],
    exemplar: Image,
    *,
    need: Callable[[tuple[int, ...]], int],
    memory: int | None = None,
) -> Slabs | None:
    """Open a large result to be compared with an exemplar (see `slabs_if_large`, `load_like`)."""
    volume = slabs_if_large(source, need=need, memory=memory)
    if volume is None:
        return None
    new = _find_unstated(volume, exemplar, None)
    return open_slabs(source, **new) if new else volume


def _find_unstated(
    image: Image | Slabs, exemplar: Image, spacing: Callable[[], Sequence[float]] | None
) -> dict[str, Any]:
    """Return the fields of the exemplar that a result's file does not state."""
    given: dict[str, Any] = {}
    if image.unit == "voxel" and image.ndim == exemplar.ndim:
        given |= {"spacing": exemplar.spacing, "unit": exemplar.unit}
    elif image.unit == "voxel" and image.ndim == 3 and spacing is not None:
        given |= {"spacing": tuple(spacing()), "unit": exemplar.unit}
    if image.phases == default_phases(len(image.phases)) and len(exemplar.phases) >= len(
        image.phases
    ):
        given |= {"phases": exemplar.phases}
    return {name: value for name, value in given.items() if value != getattr(image, name)}


def voxels_of(
    exemplars: Sequence[Image], views: Sequence[str] = (), *, gap: int = 0
) -> tuple[float, ...]:
    """Return the edges of a result's voxels along z, y, x: those of an exemplar volume, or of the
    views that pictures show; `views` and `gap` as of `views_of`.

    Raises
    ------
    InputError
        As `views_of`.
    """
    if exemplars[0].ndim == 3:
        return exemplars[0].spacing
    with silence():  # the method reports on the views itself
        return spacing_of(views_of(exemplars, views, gap=gap))


def load_mask(
    source: str | os.PathLike[str],
    exemplar: Image,
    *,
    shape: Sequence[int] | None = None,
    scale: float | None = None,
    spacing: Sequence[float] | None = None,
) -> Image:
    """Load a form to fill, for `Request.mask`: a closed surface, voxelised at the exemplar's voxel
    size, or a volume as it is.

    Parameters
    ----------
    source : path
        A surface (the suffixes of `read_mesh`), or a volume of labels in which everything but
        void is filled.
    exemplar : Image, (Z, Y, X) or (Y, X)
        Its voxels are the mask's.
    shape : sequence of int, optional
        Of a surface: the voxels that it is put into, scaled so that it just fits where no `scale`
        is given. Default: as many as it needs.
    scale : float, optional
        Factor on the surface's coordinates, which are lengths in the unit that its file states,
        else in the exemplar's.
    spacing : three floats, optional
        Edges of the mask's voxels. Default: the exemplar's; of a picture, those of `voxels_of`.

    Raises
    ------
    InputError
        A surface that is not watertight or does not fit; a grey volume; a scale for a volume.
    FileError
        As `read` and `read_mesh`.
    """
    if Path(source).suffix.lower() not in SURFACES:
        if scale is not None:
            raise InputError(
                f"{os.fspath(source)} is a volume: a scale is for a surface ({', '.join(SURFACES)})"
            )
        return load(source)
    surface = read_mesh(source)
    edges = voxels_of([exemplar]) if spacing is None else spacing
    stated = surface.unit
    if scale is None and shape is not None:
        surface = fit_mesh(surface, shape=shape, spacing=edges, unit=exemplar.unit)
    else:
        both = has_length(surface.unit) and has_length(exemplar.unit)
        factor = to_metres(surface.unit) / to_metres(exemplar.unit) if both else 1.0
        surface = scale_mesh(
            surface, (1.0 if scale is None else scale) * factor, unit=exemplar.unit
        )
    form = voxelise(surface, spacing=edges, shape=shape)
    if scale is not None or shape is None:
        _report_units(os.fspath(source), stated, exemplar.unit, scale)
    return form


def _report_units(source: str, unit: str, wanted: str, scale: float | None) -> None:
    """Report how a surface's lengths are read where its unit and the exemplar's leave it open."""
    if has_length(unit) and not has_length(wanted):
        notify(
            f"{source} is in {unit}, the exemplar in {wanted}: one {unit} is taken for one unit of "
            "the exemplar's spacing; give its spacing and unit (--spacing, --unit), or a factor "
            "(--mask-scale)"
        )
    elif not has_length(unit) and scale is None:
        notify(
            f"{source} states no unit: its lengths are taken for {wanted}, as the exemplar's are; "
            "--mask-scale is a factor on them, --shape makes it fit"
        )


def load_fixed(
    source: str | os.PathLike[str],
    exemplar: Image,
    *,
    shape: Sequence[int] | None = None,
    corner: Sequence[int] | None = None,
    known: str | os.PathLike[str] | None = None,
    view: str = "yx",
    spacing: Sequence[float] | None = None,
) -> tuple[Image, Image]:
    """Load a measured part, for `Request.fixed`, and where it is known, for `Request.known`.

    Parameters
    ----------
    source : path or str
        A scan, or a picture, which is one slice. A grey one is cut at the exemplar's threshold;
        what its file does not state (spacing, unit, names of the phases) is taken from the
        exemplar.
    exemplar : Image
    shape : sequence of int, optional
        Voxels to be made in all; needed with `corner`.
    corner : sequence of int, optional
        Place of the scan's first voxel in `shape`; the whole scan is known, all around it is made.
        A picture is cropped where it reaches beyond the shape.
    known : path, optional
        Instead of a corner, for a scan of the whole shape: a volume of labels, of which all but
        void is known.
    view : str
        Of a picture: the axes along its rows and columns, as in `place`.
    spacing : three floats, optional
        Edges of the result's voxels. Default: the exemplar's; of a picture, those of `voxels_of`.

    Raises
    ------
    InputError
        Neither corner nor known, or both; a scan that is not inside the shape; as `load`.
    """
    if (corner is None) == (known is None):
        raise InputError(
            "a fixed scan needs the place where it is known: give either a volume of what is known "
            "(--known), or the corner of the whole scan in the shape (--at)"
        )
    edges = voxels_of([exemplar]) if spacing is None else tuple(spacing)
    cuts = [step for step in exemplar.recipe.steps if step["verb"] == "segment"]
    level = cuts[-1]["threshold"] if cuts else "auto"
    scan = load_like(source, exemplar, threshold=level, spacing=lambda: edges)
    if known is not None:
        return scan, load(known)
    if shape is None or corner is None:
        raise InputError("a scan at a corner needs the shape around it: give --shape")
    if scan.ndim == 2:
        return _place_slice(scan, exemplar, as_shape(shape), corner, view, edges)
    return place(scan, shape, corner=corner), block(scan.shape, shape, corner=corner)


def load_coarse(source: str | os.PathLike[str], exemplar: Image) -> Image:
    """Load a low-resolution scan, for `Request.coarse`: labels, or grey values as they are.

    Where its file names no phases it has the exemplar's.

    Raises
    ------
    FileError, UnknownNameError
        As `load`.
    """
    scan = load(source, threshold="none")
    new = _find_unstated(scan, exemplar, None) if scan.kind == "labels" else {}
    return declare_fields(scan, phases=new["phases"]) if "phases" in new else scan


def load_relative(source: str | os.PathLike[str], exemplar: Image) -> Image:
    """Load a scan of a similar material, for `Request.like`; a grey one is segmented where the
    exemplar has phases.

    Where its file names no phases it has the exemplar's.

    Raises
    ------
    FileError, UnknownNameError
        As `load`.
    """
    scan = load(source, threshold="auto" if exemplar.kind == "labels" else "none")
    new = _find_unstated(scan, exemplar, None) if scan.kind == "labels" else {}
    return declare_fields(scan, phases=new["phases"]) if "phases" in new else scan


def refined_shape(scan: Image, spacing: Sequence[float], unit: str) -> tuple[int, ...]:
    """Return the voxels of a size that a low-resolution scan holds along each axis.

    Raises
    ------
    InputError
        A size is not stated.
    """
    if "voxel" in (scan.unit, unit) or scan.unit != unit:
        raise InputError(
            f"the size of the result is not given, and does not follow from voxels of "
            f"{scan.spacing} {scan.unit} in the coarse scan and {tuple(spacing)} {unit} in the "
            "result: add --shape, a whole multiple of "
            f"{' '.join(map(str, scan.shape))}"
        )
    sides = zip(scan.shape, scan.spacing, spacing, strict=True)
    return tuple(round(side * edge / fine) for side, edge, fine in sides)


def _place_slice(
    picture: Image,
    exemplar: Image,
    shape: tuple[int, ...],
    corner: Sequence[int],
    view: str,
    edges: Sequence[float],
) -> tuple[Image, Image]:
    """Place a picture in the plane of two axes, as far as it is inside the shape."""
    if picture.unit == "voxel" and exemplar.ndim == 3:
        inside = (
            tuple(edges["zyx".index(axis)] for axis in view)
            if set(view) < set("zyx")
            else picture.spacing
        )
        picture = declare_fields(picture, spacing=inside, unit=exemplar.unit)
    slab = as_slab(picture, view)
    room = [max(1, side - start) for side, start in zip(shape, corner, strict=False)]
    if any(have > free for have, free in zip(slab.shape, room, strict=False)) and len(room) == 3:
        sides = [min(picture.shape[n], room["zyx".index(axis)]) for n, axis in enumerate(view)]
        notify(
            f"the fixed picture is {picture.shape}: its first {sides[0]} x {sides[1]} pixels lie "
            "in the shape"
        )
        picture = cut_box(picture, sides, corner=(0, 0))
        slab = as_slab(picture, view)
    across = edges[as_axis(view)]
    return place(picture, shape, corner=corner, plane=view, across=across), block(
        slab.shape, shape, corner=corner
    )

"""The request to a model: `Request`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.brief import brief
from trabecula.core.checks import as_seed, as_shape, quote
from trabecula.core.directions import check_poles
from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image
from trabecula.core.recipe import Recipe
from trabecula.core.target import Target, as_target, is_field, origins_of

_AXES = "zyx"
_IMAGES = ("mask", "fixed", "known", "coarse", "like")


@dataclass(frozen=True, eq=False)
class Request:
    """A volume or picture to generate. Methods declare which fields beyond `shape` and `seed` they
    honour.

    Parameters
    ----------
    shape : int or sequence of int, optional
        Voxels along z, y, x; one number means a cube, two a picture (y, x), of which all arrays
        then have two axes. None takes the mask's.
    seed : int
        0 .. 2**63 - 1. The same request gives the same voxels.
    periodic : bool or sequence of bool
        Axes along which the result repeats without a seam.
    mask : (Z, Y, X) bool array or Image of labels, optional
        The form to fill; outside it the result is void. Of an Image, everything but the phase
        "void" (label 0 where none has that name) is filled. Kept as a bool array. Where an Image
        states a spacing or a unit, the result's voxels are of that size: of an exemplar that states
        another the request is refused, one that states none takes it.
    target : mapping of str to float or (Z, Y, X) float array or grey Image
        Descriptors to have, by name: one number for the whole result, or a field of what each place
        is to have around it, inside the mask where there is one. "porosity" is the share of the
        phase "void" (label 0 where none has that name), "volume_fraction" what remains to 1,
        "volume_fraction:PHASE" the share of a phase, all 0 .. 1; "surface", "mean_curvature" and
        "euler" are densities of the Minkowski functionals of the solid, per voxel; of pictures
        "perimeter" and "euler"; "two_point:R" the two-point function of the solid at R voxels,
        averaged over the axes; "apparent_conductivity" and "apparent_stiffness" of the solid and
        "apparent_diffusivity" of the void are those of windows of the size that the method says,
        by themselves, relative to what carries them, the mean over the axes or along one, as in
        "apparent_stiffness:z". "orientation" is the direction that the exemplar's principal
        fabric direction (the longest mean intercept) is turned to: a vector (z, y, x), or a field
        (Z, Y, X, 3) of them, sign and length free; "size" the factor on its lengths, 0.25 .. 4.
        Methods say which they honour. Fields are kept as float32 arrays.
    fixed : Image, (Z, Y, X), optional
        Measured voxels that must come out unchanged, where `known` says so; what it holds elsewhere
        does not matter.
    known : (Z, Y, X) bool array or Image of labels, optional
        Where `fixed` holds measured voxels: some, but not all. Needed with `fixed`. Kept as a bool
        array.
    coarse : Image of labels or grey, (Z / a, Y / b, X / c), optional
        A scan of the same place at a low resolution, a x b x c voxels of the result in each of its
        own: down-sampled, the result is to be this scan. It stands beside shape and seed alone.
    like : Image of labels, (Z, Y, X), optional
        A scan of a similar material, of any size: what pictures do not show is taken from it. It
        stands beside shape, seed, periodic axes, a mask and a target porosity alone.

    Attributes
    ----------
    origins : mapping of str to Recipe
        How mask, fixed, known, coarse and like came to be, for the recipe of the result; fields of
        `target` as "target.NAME".
    voxel : (tuple of float, str), optional
        Spacing and unit of a mask that is an Image and states them.

    Raises
    ------
    InputError
        A mask, a fixed image, known voxels or a target of another shape or type; a mask without a
        voxel; nothing known, or nothing left to make; a target out of range.
    UnknownNameError
        A descriptor that cannot be a target.
    RequestError
        Parts that contradict each other: known voxels at both ends of a periodic axis; a shape that
        is no whole multiple of a coarse scan's, or another part beside one or beside `like`.

    Examples
    --------
    >>> import numpy as np, trabecula as tb
    >>> line = np.arange(-9, 10)
    >>> ball = np.hypot.outer(line, np.hypot.outer(line, line)) < 9
    >>> request = tb.Request(None, mask=ball, seed=7)
    >>> request.shape, sorted(request.asks_for())
    ((19, 19, 19), ['mask'])
    """

    shape: tuple[int, ...]
    seed: int = 0
    periodic: tuple[bool, ...] = (False, False, False)
    mask: np.ndarray | None = None
    target: Mapping[str, Target] = field(default_factory=dict)
    fixed: Image | None = None
    known: np.ndarray | None = None
    coarse: Image | None = None
    like: Image | None = None
    origins: Mapping[str, Recipe] = field(init=False, repr=False, default_factory=dict)
    voxel: tuple[tuple[float, ...], str] | None = field(init=False, default=None)

    __repr__ = brief

    def __post_init__(self) -> None:
        origins = {name: _origin(getattr(self, name)) for name in _IMAGES}
        origins |= {f"target.{name}": recipe for name, recipe in origins_of(self.target).items()}
        object.__setattr__(
            self,
            "origins",
            {name: recipe for name, recipe in origins.items() if recipe is not None},
        )
        object.__setattr__(self, "voxel", _voxel_of(self.mask))
        object.__setattr__(self, "mask", _as_region(self.mask, name="mask"))
        object.__setattr__(self, "known", _as_region(self.known, name="known"))
        if self.shape is None:
            if self.mask is None:
                raise InputError(
                    "the request has no shape: give voxels along z, y, x, or a mask whose shape is "
                    "taken"
                )
            object.__setattr__(self, "shape", self.mask.shape)
        object.__setattr__(
            self, "shape", as_shape(self.shape, ndim=2 if np.shape(self.shape) == (2,) else 3)
        )
        object.__setattr__(self, "seed", as_seed(self.seed))
        object.__setattr__(self, "periodic", _as_periodic(self.periodic, len(self.shape)))
        object.__setattr__(self, "target", as_target(self.target, self.shape))
        _check_mask(self.mask, self.shape)
        if "orientation" in self.target:
            poles = np.asarray(self.target["orientation"])
            check_poles(poles, self.mask, name="the target orientation")
        _check_fixed(self)
        _check_coarse(self)
        _check_like(self)

    def asks_for(self) -> frozenset[str]:
        """Return the optional parts of the request that are in use."""
        used = {"periodic": any(self.periodic), "mask": self.mask is not None}
        used |= {"target": bool(self.target), "fixed": self.fixed is not None}
        used |= {"coarse": self.coarse is not None, "like": self.like is not None}
        return frozenset(name for name, asked in used.items() if asked)

    @property
    def is_tied(self) -> bool:
        """Return whether a part of the request is tied to its shape: voxels or a field."""
        fields = any(is_field(name, value) for name, value in self.target.items())
        held = (self.mask, self.fixed, self.coarse)
        return fields or any(part is not None for part in held)

    @property
    def blocks(self) -> tuple[int, ...]:
        """Return the voxels of the result in one of the coarse scan's, along each axis; 1 without
        one.
        """
        if self.coarse is None:
            return (1,) * len(self.shape)
        return tuple(s // c for s, c in zip(self.shape, self.coarse.shape, strict=True))

    def to_json(self) -> dict[str, Any]:
        """Return the request as a result's recipe holds it: plain values, and for its arrays their
        recipes.
        """
        plain: dict[str, Any] = {
            "shape": list(self.shape),
            "seed": self.seed,
            "periodic": list(self.periodic),
        }
        made = {name: recipe.to_json() for name, recipe in self.origins.items()}
        if self.target:
            plain["target"] = {
                name: made.pop(f"target.{name}")
                if f"target.{name}" in made
                else _plain(value)  # not of a field: a list of its values takes much memory
                for name, value in self.target.items()
            }
        return {**plain, **made}


def check_exemplar(
    request: Request, exemplar: Image, *, spacing: Sequence[float] | None = None
) -> None:
    """Raise where the fixed voxels or the coarse scan of a request are not of the exemplar's
    material.

    Parameters
    ----------
    request : Request
    exemplar : Image
    spacing : three floats, optional
        Of the result's voxels. Default: the exemplar's, of a picture none (nothing is compared).

    Raises
    ------
    RequestError
        Another kind, other phases or other voxels than the exemplar's.
    """
    _check_coarse_scan(request, exemplar, spacing or exemplar.spacing)
    fixed = request.fixed
    if fixed is None or request.known is None:
        return
    if fixed.kind != exemplar.kind:
        raise RequestError(
            f"the fixed voxels are {fixed.kind}, the exemplar is {exemplar.kind}: segment both "
            "alike, or neither"
        )
    edges = spacing or (exemplar.spacing if exemplar.ndim == 3 else fixed.spacing)
    if fixed.unit != exemplar.unit or not np.allclose(fixed.spacing, edges, rtol=1e-6):
        raise RequestError(
            f"the fixed voxels are {fixed.spacing} {fixed.unit}, the result's {tuple(edges)} "
            f"{exemplar.unit}: give the spacing of both, or resample one"
        )
    if fixed.kind != "labels":
        return
    if fixed.phases[: len(exemplar.phases)] != exemplar.phases[: len(fixed.phases)]:
        raise RequestError(
            f"the fixed voxels are of {', '.join(fixed.phases)}, the exemplar of "
            f"{', '.join(exemplar.phases)}: name the phases of both alike, in the same order "
            "(--phases)"
        )
    present = np.bincount(exemplar.values.ravel(), minlength=len(fixed.phases)) > 0
    held = np.zeros(256, np.bool_)
    # plane by plane: no copy of the whole is made
    for values, known in zip(fixed.values, request.known, strict=True):
        held[values[known]] = True
    strange = [label for label in np.flatnonzero(held) if not present[label]]
    if strange:
        names = ", ".join(fixed.phases[label] for label in strange)
        raise RequestError(
            f"the fixed voxels hold the phase {names}, which the exemplar lacks: give an exemplar "
            "with it"
        )


def _check_coarse_scan(request: Request, exemplar: Image, spacing: Sequence[float]) -> None:
    coarse = request.coarse
    if coarse is None:
        return
    if exemplar.kind != "labels":
        raise RequestError(
            f"the exemplar is {exemplar.kind}: a coarse scan is refined from a picture of labels; "
            "segment it (--threshold)"
        )
    if coarse.kind == "labels" and coarse.phases != exemplar.phases:
        raise RequestError(
            f"the coarse scan is of {', '.join(coarse.phases)}, the exemplar of "
            f"{', '.join(exemplar.phases)}: name the phases of both alike, in the same order "
            "(--phases)"
        )
    if "voxel" in (coarse.unit, exemplar.unit) or len(spacing) != coarse.ndim:
        return
    wanted = tuple(n * edge for n, edge in zip(request.blocks, spacing, strict=True))
    if coarse.unit != exemplar.unit or not np.allclose(coarse.spacing, wanted, rtol=1e-3):
        raise RequestError(
            f"the coarse scan's voxels are {coarse.spacing} {coarse.unit}; {request.shape} voxels "
            f"of {tuple(spacing)} {exemplar.unit} make it {wanted}: ask for the shape that agrees, "
            "or give the spacing of both"
        )


def _plain(value: Target) -> Any:
    """Return a number as it is, and one direction as a list."""
    return value.tolist() if isinstance(value, np.ndarray) else value


def _origin(part: Image | ArrayLike | None) -> Recipe | None:
    """Return the recipe of a part; an array in memory is known by its digest."""
    if part is None or isinstance(part, Image):
        return None if part is None else part.recipe or Recipe().then("array", part.values)
    array = np.asarray(part)
    return Recipe().then("array", array.view(np.uint8) if array.dtype == bool else array)


def _voxel_of(part: Image | ArrayLike | None) -> tuple[tuple[float, ...], str] | None:
    if not isinstance(part, Image) or (
        part.unit == "voxel" and all(edge == 1 for edge in part.spacing)
    ):
        return None
    return part.spacing, part.unit


def _as_region(region: Image | ArrayLike | None, *, name: str) -> np.ndarray | None:
    if region is None:
        return None
    if isinstance(region, Image):
        if region.kind != "labels":
            raise InputError(
                f"the {name} is {region.kind}: give labels (segment it first), or a boolean array"
            )
        return region.values != (region.phases.index("void") if "void" in region.phases else 0)
    array = np.asarray(region)
    if array.dtype != bool or array.ndim not in (2, 3):
        raise InputError(
            f"the {name} is {array.dtype} of shape {array.shape}: give a boolean array (z, y, x), "
            "such as volume > 0"
        )
    return array


def _check_mask(mask: np.ndarray | None, shape: tuple[int, ...]) -> None:
    if mask is None:
        return
    if mask.shape != shape:
        raise InputError(
            f"the mask has shape {mask.shape}, the request {shape}: give one of them, or make them "
            "equal"
        )
    if not mask.any():
        raise InputError("the mask holds no voxel: mark with True what is to be filled")


def _check_fixed(request: Request) -> None:
    fixed, known = request.fixed, request.known
    shape = request.shape
    if fixed is None and known is None:
        return
    if fixed is None:
        raise RequestError("known voxels without an image of them: give fixed as well")
    if known is None:
        raise RequestError(
            "fixed voxels need known, a boolean array that is True where they were measured "
            "(--known)"
        )
    if not isinstance(fixed, Image):
        raise InputError(
            f"fixed is a plain {type(fixed).__name__}: give an Image (tb.Image(array, "
            "kind='labels'))"
        )
    for name, have in (("fixed", fixed.shape), ("known", known.shape)):
        if have != shape:
            raise InputError(
                f"{name} has shape {have}, the request {shape}: place it in the larger one first "
                "(--at)"
            )
    asked = known if request.mask is None else known[request.mask]
    if not asked.any():
        where = "" if request.mask is None else " inside the mask"
        raise InputError(
            f"no voxel{where} is known: mark with True what was measured, or leave fixed out"
        )
    if asked.all():
        raise InputError(
            "every voxel is known, nothing is left to make: mark with False what is to be made"
        )
    for axis, wraps in enumerate(request.periodic):
        if wraps and known.take(0, axis).any() and known.take(-1, axis).any():
            raise RequestError(
                "periodic with a fixed border: known voxels lie at both ends of "
                f"{_AXES[axis - len(shape)]}, where the result would have to go on from one to the "
                "other; leave that axis out of periodic, or one end unknown"
            )


def _check_coarse(request: Request) -> None:
    coarse, shape = request.coarse, request.shape
    if coarse is None:
        return
    if not isinstance(coarse, Image):
        raise InputError(
            f"coarse is a plain {type(coarse).__name__}: give an Image (tb.Image(array, "
            "kind='labels'), or kind='grey')"
        )
    if coarse.kind == "colour" or coarse.ndim != len(shape):
        raise InputError(
            f"the coarse scan is {coarse.kind} of shape {coarse.shape}, the request is for "
            f"{shape}: give labels or grey values along the same axes"
        )
    beside = sorted(request.asks_for() - {"coarse"})
    if beside:
        raise RequestError(
            f"coarse beside {', '.join(beside)}: a coarse scan goes with shape and seed alone; "
            f"leave out {beside[0]}"
        )
    times = [max(1, round(s / c)) for s, c in zip(shape, coarse.shape, strict=True)]
    nearest = tuple(n * c for n, c in zip(times, coarse.shape, strict=True))
    if nearest != shape:
        raise RequestError(
            f"the shape {shape} is no whole multiple of the coarse scan's {coarse.shape}: the "
            f"nearest is {nearest} ({' x '.join(map(str, times))} voxels in one)"
        )
    if max(times) == 1:
        raise RequestError(
            f"the coarse scan is {coarse.shape}, as many voxels as the request: ask for a multiple "
            f"of it, such as {tuple(2 * side for side in shape)}"
        )
    if (coarse.values == coarse.values.flat[0]).all():
        raise InputError(
            "the coarse scan holds one value only, and no interface to refine: give one of both "
            "phases (of a grey scan --threshold none keeps its values)"
        )


def _check_like(request: Request) -> None:
    like = request.like
    if like is None:
        return
    if not isinstance(like, Image):
        raise InputError(
            f"like is a plain {type(like).__name__}: give an Image (tb.Image(array, kind='labels'))"
        )
    if like.kind != "labels" or like.ndim != 3:
        raise InputError(
            f"the relative is {like.kind} of shape {like.shape}: give a 3-D scan of labels "
            "(a grey one is segmented with tb.segment)"
        )
    beside = sorted(request.asks_for() - {"like", "periodic", "mask", "target"})
    if beside:
        raise RequestError(
            f"like beside {', '.join(beside)}: a relative goes with shape, seed, periodic axes, a "
            f"mask and a porosity alone; leave out {beside[0]}"
        )


def _as_periodic(value: bool | Sequence[bool], ndim: int) -> tuple[bool, ...]:
    try:
        axes = (
            (bool(value),) * ndim
            if isinstance(value, (bool, np.bool_))
            else tuple(bool(axis) for axis in value)
        )
    except (TypeError, ValueError):
        raise InputError(
            f"periodic is {quote(value)}: give True or False, or one of them for each axis"
        ) from None
    if ndim == 2 and len(axes) == 3 and (all(axes) or not axes[0]):
        axes = axes[1:]
    if len(axes) != ndim:
        raise InputError(
            f"periodic takes one truth value or {'three' if ndim == 3 else 'two'} "
            f"({_AXES[-ndim:]}): got {quote(value)}"
        )
    return axes

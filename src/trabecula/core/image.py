"""The one noun: `Image`, values with what they mean.

Axes are `(z, y, x)` or `(y, x)`, colour last. Index 0 along an axis is the voxel whose *corner*
is at the origin; a voxel's edge along an axis is `spacing` of that axis, in `unit`.

An image is taken for an array wherever one is expected (`np.asarray(image)` are its values, not
copied) and is sliced like one. What is computed from it by operators, NumPy, or an array's own
methods (`image > 3`, `image.mean()`) is a plain array or number: only a slice is an image again.
`image == other` of two images asks whether they are the same object.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import ArrayLike, DTypeLike

from trabecula.core import display, indexing
from trabecula.core.checks import as_spacing, check_finite, check_name, quote
from trabecula.core.errors import InputError
from trabecula.core.recipe import Recipe

KINDS = ("labels", "grey", "colour")
MAX_PHASES = 16
_OF_ARRAYS = frozenset(
    (
        *(
            "T",
            "all",
            "any",
            "argmax",
            "argmin",
            "argsort",
            "astype",
            "clip",
            "copy",
            "cumsum",
            "flags",
            "flat",
            "flatten",
        ),
        *(
            "itemsize",
            "max",
            "mean",
            "min",
            "nbytes",
            "nonzero",
            "prod",
            "ravel",
            "repeat",
            "reshape",
            "round",
            "size",
        ),
        *(
            "squeeze",
            "std",
            "strides",
            "sum",
            "swapaxes",
            "take",
            "tobytes",
            "tolist",
            "transpose",
            "var",
        ),
    )
)
"""Attributes of arrays that code written for them reads; none of it changes the values."""


@dataclass(frozen=True, eq=False)
class Image(NDArrayOperatorsMixin):
    """A 2-D or 3-D image of a material.

    Parameters
    ----------
    values : array, (Z, Y, X) or (Y, X); colour (..., 3)
        Labels `0..n-1` (any integer or bool; kept as uint8), grey (any real), or uint8 RGB. Not
        copied unless converted; do not write into it afterwards.
    kind : {"labels", "grey", "colour"}
        Given, never guessed from a shape.
    spacing : float or sequence of float, optional
        Edge of a voxel along every axis, in `unit`. Default 1.0.
    unit : str, optional
        "voxel" (default), "mm", "um", "nm", "m", ...
    phases : sequence of str, optional
        Names of the labels. Default: ("void", "solid"), then "phase2", "phase3", ...
    recipe : Recipe, optional
        How the image came to be.

    Raises
    ------
    InputError
        Wrong dimensions, empty, NaN or infinite, labels that are not integers or not `0..n-1`, bad
        spacing, phase names that do not fit.

    Examples
    --------
    >>> import numpy as np, trabecula as tb
    >>> scan = tb.Image(np.zeros((40, 50, 60)), "grey", spacing=2.0, unit="um")
    >>> np.asarray(scan).mean()
    np.float64(0.0)
    >>> scan[10:20, :, ::2]
    <Image 10x50x30 grey, voxel 2x2x4 um>
    >>> scan[10]
    <Image 50x60 grey, voxel 2x2 um>
    """

    values: np.ndarray
    kind: str
    spacing: tuple[float, ...] = ()
    unit: str = "voxel"
    phases: tuple[str, ...] = ()
    recipe: Recipe = field(default_factory=Recipe)

    def __post_init__(self) -> None:
        check_name(self.kind, KINDS, name="kind of image")
        values = _real_array(self.values)
        ndim = values.ndim - (self.kind == "colour")
        if ndim not in (2, 3):
            raise InputError(
                f"an image of kind {self.kind!r} has 2 or 3 axes (colour one more): got shape "
                f"{values.shape}"
            )
        if values.size == 0:
            raise InputError(f"the image is empty: shape {values.shape}")
        check_finite(values, name="the image")
        object.__setattr__(self, "spacing", as_spacing(_none_if_empty(self.spacing), ndim=ndim))
        object.__setattr__(self, "values", _as_values(values, self.kind))
        object.__setattr__(self, "phases", _as_phases(self.values, self.kind, self.phases))

    @property
    def ndim(self) -> int:
        """Return the number of spatial axes, 2 or 3."""
        return len(self.spacing)

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the voxels along every spatial axis (colour left out; `np.asarray(image).shape`
        has it).
        """
        return self.values.shape[: self.ndim]

    @property
    def dtype(self) -> np.dtype:
        """Return the type of the values."""
        return self.values.dtype

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> np.ndarray:
        """Return the values, as NumPy asks for them (`np.asarray(image)`); copied where `copy` or
        another type needs it.
        """
        return np.array(self.values, dtype=dtype, copy=copy)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Any:
        """Return what NumPy's function makes of the values: an array, which has no spacing."""
        if any(isinstance(out, Image) for out in options.get("out", ())):
            raise InputError(
                "an Image does not change: compute a new array, and make an Image of it (tb.Image)"
            )
        return getattr(ufunc, method)(
            *(one.values if isinstance(one, Image) else one for one in inputs), **options
        )

    def __eq__(self, other: object) -> Any:
        """Return whether both images are the same object; of numbers and arrays, which values are
        equal.
        """
        if isinstance(other, Image) or other is None or isinstance(other, str):
            return self is other
        return np.equal(self, other)  # type: ignore[call-overload]

    def __ne__(self, other: object) -> Any:
        """Return the opposite of `==`."""
        equal = self == other
        return not equal if isinstance(equal, bool) else np.logical_not(equal)

    __hash__ = object.__hash__

    if not TYPE_CHECKING:  # a checker would take any attribute for granted

        def __getattr__(self, name: str) -> Any:
            """Return an attribute of the array, of those that code written for arrays asks for."""
            if name in _OF_ARRAYS:
                return getattr(self.values, name)
            raise AttributeError(
                f"{type(self).__name__!r} object has no attribute {name!r}", name=name, obj=self
            )

    def __len__(self) -> int:
        """Return the voxels along the first axis."""
        return self.shape[0]

    def __iter__(self) -> Iterator[Image]:
        """Yield the slices of a volume along z."""
        return (self[place] for place in range(len(self)))

    def __getitem__(self, key: Any) -> Image:
        """Return a part of the image: slices keep an axis, a number drops it, a step makes its
        voxels longer.

        The values are not copied. The recipe has one more step, where there is a recipe.

        Raises
        ------
        InputError
            As `core.indexing.read_index`: among others a mask or a list, which are asked of
            `image.values`.
        """
        index = indexing.read_index(key, shape=self.shape)
        values = self.values[index]
        pairs = [
            (item, edge)
            for item, edge in zip(index, self.spacing, strict=True)
            if isinstance(item, slice)
        ]
        recipe = self.recipe and self.recipe.then("slice", values, index=indexing.to_json(index))
        return replace(
            self,
            values=values,
            spacing=tuple(edge * abs(item.step) for item, edge in pairs),
            recipe=recipe,
        )

    def __repr__(self) -> str:
        return outline(self.shape, self.kind, self.spacing, self.unit, self.phases)

    def _repr_html_(self) -> str | None:
        return display.as_html(self)


def outline(
    shape: Sequence[int], kind: str, spacing: Sequence[float], unit: str, phases: Sequence[str]
) -> str:
    """Return an image in a line, whether or not its values are in memory."""
    size = "x".join(map(str, shape))
    edge = "x".join(f"{s:g}" for s in spacing)
    names = f", phases {'/'.join(phases)}" if phases else ""
    return f"<Image {size} {kind}, voxel {edge} {unit}{names}>"


def _real_array(values: ArrayLike) -> np.ndarray:
    if isinstance(values, Image):  # as an array it would lose its spacing and names without a word
        raise InputError(
            "an Image is given where its values are wanted: use it as it is, or give image.values"
        )
    try:
        array = np.asarray(values)
    except ValueError:
        raise InputError(
            "the rows of the image differ in length: give an array of equal sides"
        ) from None
    if array.dtype.kind not in "biufc":
        raise InputError(f"the image holds {array.dtype} values: numbers are needed")
    return array


def _none_if_empty(spacing: float | Sequence[float] | None) -> float | Sequence[float] | None:
    """Return None where the spacing was left out: the field's default is (), and 0 is a mistake to
    report.
    """
    return None if np.size(spacing) == 0 else spacing  # type: ignore[arg-type]


def _as_values(values: np.ndarray, kind: str) -> np.ndarray:
    if kind == "colour":
        if values.shape[-1] != 3 or values.dtype != np.uint8:
            alpha = values.shape[-1] == 4
            advice = ": leave the fourth, alpha, out (form=alpha > 0 of a still says where it is)"
            raise InputError(
                f"colour is uint8 with 3 channels last: got {values.dtype}, shape {values.shape}"
                + (advice if alpha else "")
            )
        return values
    if kind == "grey":
        if values.dtype == bool:
            raise InputError("a boolean array is labels, not grey: pass kind='labels'")
        return values
    if not (values.dtype == bool or np.issubdtype(values.dtype, np.integer)):
        raise InputError(
            f"labels must be integers, got {values.dtype}: segment a grey image (tb.segment), or "
            "convert with values.astype(np.uint8) if these are labels"
        )
    low, high = int(values.min()), int(values.max())
    if low < 0 or high >= MAX_PHASES:
        raise InputError(
            f"labels run from 0 to at most {MAX_PHASES - 1}, got {low}..{high}: use "
            "tb.labels(array) to number the levels of a 0/255 volume, or kind='grey'"
        )
    return values.astype(np.uint8, copy=False)


def _as_phases(values: np.ndarray, kind: str, phases: Sequence[str]) -> tuple[str, ...]:
    phases = () if phases is None else phases
    if not isinstance(phases, str | Sequence | np.ndarray):
        raise InputError(
            f"phases={quote(phases)}: give one name per label, such as ('void', 'solid')"
        )
    if kind != "labels":
        if len(phases):
            raise InputError(f"phases name labels; an image of kind {kind!r} has none")
        return ()
    count = int(values.max()) + 1
    if isinstance(phases, str):
        raise InputError(
            f"phases={quote(phases)} is one text: give one name per label, such as ('void', "
            "'solid')"
        )
    if not len(phases):
        return default_phases(max(2, count))
    phases = [str(name) for name in phases]
    if len(phases) < max(count, 2) or len(set(phases)) != len(phases):
        raise InputError(
            f"phases {tuple(phases)} must name at least {max(count, 2)} labels, each name once"
        )
    return tuple(phases)


def default_phases(count: int) -> tuple[str, ...]:
    """Return names for `count` labels when none are given."""
    return ("void", "solid", *(f"phase{i}" for i in range(2, count)))[:count]


def labels(values: ArrayLike, **fields: Any) -> Image:
    """Return an Image of labels from an array of few levels, such as 0/255: the levels, in rising
    order, become 0..n-1.

    Raises
    ------
    InputError
        More than 16 levels (a grey image: segment it), NaN, or levels that are not whole numbers.
    """
    array = _real_array(values)
    if array.size == 0:
        raise InputError(f"the array is empty: shape {array.shape}")
    check_finite(array, name="the array")
    levels = distinct_levels(array, limit=MAX_PHASES)
    if levels is None:
        raise InputError(
            f"the array has more than {MAX_PHASES} levels: it is grey; segment it (tb.segment)"
        )
    if np.any(levels != np.round(levels)):
        raise InputError(
            f"labels are whole numbers, the array holds {levels[levels != np.round(levels)][0]}: "
            "segment it (tb.segment)"
        )
    # a table: ten times faster than a search, and an eighth of its memory
    if array.dtype in (np.uint8, np.uint16):
        table = np.searchsorted(levels, np.arange(int(levels[-1]) + 1)).astype(np.uint8)
        return Image(table[array], "labels", **fields)
    return Image(np.searchsorted(levels, array).astype(np.uint8), "labels", **fields)


def distinct_levels(values: np.ndarray, *, limit: int) -> np.ndarray | None:
    """Return the sorted distinct values, or None where there are more than `limit` (found without
    sorting the whole array).
    """
    if values.dtype == bool:
        values = values.view(np.uint8)
    flat = values.ravel()
    small = values.dtype in (np.uint8, np.uint16)
    levels = np.unique(flat[:65536])
    # In parts, since bincount widens its input to 8 bytes a voxel.
    for start in range(65536, flat.size, 1 << 22):
        if len(levels) > limit:
            return None
        piece = flat[start : start + (1 << 22)]
        levels = np.union1d(
            levels, np.flatnonzero(np.bincount(piece)).astype(piece.dtype) if small else piece
        )
    return levels if len(levels) <= limit else None


def as_image(value: Image | ArrayLike, *, name: str = "image") -> Image:
    """Return an Image as it is, and an array of bool or of labels `0..n-1` as an Image of labels;
    other arrays need a kind first.

    Raises
    ------
    InputError
        The array is floating or has levels such as 0/255: only its owner knows what they mean.
    """
    if isinstance(value, Image):
        return value
    array = np.asarray(value)
    if array.dtype == bool or (
        np.issubdtype(array.dtype, np.integer)
        and array.size
        and array.min() >= 0
        and array.max() < MAX_PHASES
    ):
        return Image(array, "labels")
    raise InputError(
        f"{name} is a plain array of {array.dtype} whose meaning is open: pass tb.Image(array, "
        "kind='grey'), or tb.labels(array) for a volume of few levels such as 0/255"
    )


def check_labels(image: Image, *, name: str = "image") -> None:
    """Raise where the image is not of kind "labels"."""
    if image.kind != "labels":
        raise InputError(
            f"{name} is {image.kind}, labels are needed: segment it first (tb.segment, or "
            "--threshold)"
        )


def phase_index(image: Image, phase: str | int | None, *, default: str) -> int:
    """Return the label of a phase given by name or number; `None` means the phase named `default`.

    An image without a phase of that name has no default: the caller has to say which phase is
    meant.
    """
    if phase is None:
        phase = default
    if isinstance(phase, str):
        check_name(phase, image.phases, name="phase")
        return image.phases.index(phase)
    if isinstance(phase, bool) or not isinstance(phase, int | np.integer):
        raise InputError(
            f"phase {quote(phase)} is neither a name nor a number: the image has "
            f"{', '.join(image.phases)}"
        )
    if not 0 <= int(phase) < len(image.phases):
        raise InputError(f"phase {phase} does not exist: the image has 0..{len(image.phases) - 1}")
    return int(phase)


def with_values(
    image: Image, values: np.ndarray, *, recipe: Recipe | None = None, **changes: Any
) -> Image:
    """Return the same image with other values (and, where given, another recipe)."""
    return replace(
        image, values=values, recipe=image.recipe if recipe is None else recipe, **changes
    )


def declare_fields(image: Image, **fields: Any) -> Image:
    """Return the same voxels with a spacing, a unit or names of phases that their file does not
    state, as a step of the recipe.
    """
    recipe = image.recipe.then("declare", image.values, fields=fields)
    return replace(image, recipe=recipe, **fields)


def describe_fields(image: Image) -> Mapping[str, Any]:
    """Return the fields beside the values, as plain JSON (for metadata of files)."""
    return {
        "kind": image.kind,
        "spacing": list(image.spacing),
        "unit": image.unit,
        "phases": list(image.phases),
        "recipe": image.recipe.to_json(),
    }

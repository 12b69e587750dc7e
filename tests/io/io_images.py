"""Images of every sort, and what it means that two are the same."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from trabecula.core.image import Image
from trabecula.core.recipe import Recipe

VOLUMES = (".tif", ".zarr", ".npy", ".mhd", ".mha", ".nrrd", ".nii", ".nii.gz", ".vti")
UNITS = ("voxel", "nm", "um", "mm", "cm", "m", "inch")
GREYS = (
    "uint8",
    "int8",
    "uint16",
    "int16",
    "uint32",
    "int32",
    "uint64",
    "int64",
    "float32",
    "float64",
)
EDGES = st.floats(1e-6, 1e6, allow_subnormal=False)


@st.composite
def images(draw, *, ndim=(2, 3), kinds=("labels", "grey", "colour"), greys=GREYS):
    """Draw an Image of any kind, type, anisotropic spacing and unit, with a recipe of its own."""
    axes = draw(st.sampled_from(ndim))
    shape = tuple(draw(st.integers(1, 6)) for _ in range(axes))
    spacing = tuple(draw(EDGES) for _ in range(axes))
    kind = draw(st.sampled_from(kinds))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    phases: tuple[str, ...] = ()
    if kind == "labels":
        phases = tuple(
            draw(st.lists(st.text(min_size=1, max_size=8), min_size=2, max_size=16, unique=True))
        )
        values = rng.integers(0, len(phases), shape).astype(np.uint8)
    elif kind == "colour":
        values = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    else:
        dtype = np.dtype(draw(st.sampled_from(greys)))
        values = (
            rng.normal(0, 50, shape).astype(dtype)
            if dtype.kind == "f"
            else _integers(rng, dtype, shape)
        )
    recipe = Recipe().then(
        "made", values, seed=draw(st.integers(0, 2**63)), note=draw(st.text(max_size=900))
    )
    return Image(
        values,
        kind,
        spacing=spacing,
        unit=draw(st.sampled_from(UNITS)),
        phases=phases,
        recipe=recipe,
    )


def _integers(rng, dtype, shape):
    limits = np.iinfo(dtype)
    return rng.integers(limits.min, limits.max, shape, dtype=dtype, endpoint=True)


def same(one: Image, other: Image) -> None:
    """Check that nothing differs."""
    assert one.values.dtype == other.values.dtype
    np.testing.assert_array_equal(one.values, other.values)
    assert (one.kind, one.spacing, one.unit, one.phases) == (
        other.kind,
        other.spacing,
        other.unit,
        other.phases,
    )
    assert one.recipe == other.recipe


def grey_ramp(dtype="uint16"):
    """Make a volume whose voxels and axes all differ: z steps 100, y steps 10, x steps 1."""
    z, y, x = np.ogrid[:3, :4, :5]
    return Image((100 * z + 10 * y + x).astype(dtype), "grey", spacing=(2.5, 0.1, 0.3), unit="um")

"""Fields of an image's own descriptors and orientations."""

import numpy as np
import pytest

import trabecula as tb
from trabecula import fields
from trabecula.pipeline.replay import replay


@pytest.mark.parametrize("size", [4, 5])
def test_the_window_lies_around_the_voxel(size):
    values = np.random.default_rng(0).random((9, 10, 11)) < 0.4
    image = tb.Image(values, "labels", spacing=2.0, unit="um")
    field = fields.measure(image, "surface", size=size)
    assert (field.kind, field.shape, field.spacing, field.unit) == (
        "grey",
        (9, 10, 11),
        (2.0,) * 3,
        "um",
    )
    windows = fields.windowed(image, size=size, names=["surface"])["surface"]
    first = (size - 1) // 2
    assert field.values[4, 5, 6] == windows[4 - first, 5 - first, 6 - first]
    assert np.all(field.values[: first + 1, 5, 6] == field.values[first, 5, 6]), (
        "the nearest whole window at a face"
    )


def test_densities_are_per_voxel_whatever_the_spacing():
    values = np.random.default_rng(0).random((6, 7, 8)) < 0.4
    near, far = (tb.Image(values, "labels", spacing=edge) for edge in (1.0, 40.0))
    assert np.array_equal(
        fields.measure(near, "euler", size=3).values, fields.measure(far, "euler", size=3).values
    )


def test_stripes_point_along_themselves():
    z, y, _ = np.indices((16, 16, 16))
    fibres = (
        (np.hypot((z + y) % 8 - 4, (z - y) % 8 - 4) * 20).astype(np.uint8),
        np.array([0, 0, 1]),
    )
    layers = (((y % 8) * 20).astype(np.uint8)[0], np.array([0, 1]))
    for values, along in (fibres, layers):
        vectors, clarity = fields.directions(tb.Image(values, "grey"))
        assert vectors.shape == (len(along), *values.shape) and clarity.shape == values.shape
        inside = (slice(4, -4),) * values.ndim
        assert np.median(np.abs(np.tensordot(along, vectors, 1)[inside])) > 0.999
        assert np.median(clarity[inside]) > 0.5
        assert np.allclose(np.linalg.norm(vectors, axis=0), 1, atol=1e-5)


def test_plain_places_have_no_direction():
    vectors, clarity = fields.directions(tb.Image(np.full((6, 6, 6), 7.0), "grey"))
    assert not vectors.any() and not clarity.any()


@pytest.mark.whole
def test_a_field_is_made_again_from_its_recipe(tmp_path, bone):
    image = tb.crop(bone, 20)
    for made in (
        fields.measure(image, "porosity", size=5),
        fields.rescale(
            fields.resample(fields.measure(image, size=5), (8, 9, 10)), low=0.1, high=0.2
        ),
        fields.ramp((4, 5, 6), start=0.1, end=0.3, spacing=2, unit="um"),
        fields.radial((6, 6), inside=0, outside=1),
        fields.formula((4, 4, 4), "z * Y + sin(x)"),
        fields.interpolate((5, 5), [(0.5, 0.5), (3, 3)], [0.1, 0.7]),
        fields.simp("cantilever", (4, 2, 6), rounds=3),
    ):
        path = tb.write(made, tmp_path / "field.tif")
        again = tb.read(path)
        assert np.array_equal(again.values, made.values) and again.spacing == made.spacing
        assert np.array_equal(replay(again.recipe, folder=tmp_path).values, made.values), (
            made.recipe.steps[-1]["make"]
        )

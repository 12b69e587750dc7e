"""Slabs or the whole: the same figures, wherever the cuts are."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import trabecula as tb
from trabecula.engine.lazy_volume import Slabs, as_slabs, depth_within
from trabecula.engine.memory import Plan
from trabecula.measure import component_sizes, describe, percolating_fraction
from trabecula.measure.blockwise import (
    count_slabs,
    describe_slabs,
    forecast,
    images_at_once,
    names_without_slabs,
)
from trabecula.measure.labelling import label_components
from trabecula.measure.streaming import ComponentTally, ConfigurationCounts

SHAPES = st.tuples(st.integers(2, 9), st.integers(2, 7), st.integers(2, 7))


@st.composite
def volumes(draw, phases=2):
    """Draw labels of any shape and probability: all is solid as often as all is void."""
    shape = draw(SHAPES)
    share = draw(st.sampled_from([0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0]))
    noise = np.random.default_rng(draw(st.integers(0, 2**32))).random(shape)
    return np.where(noise < share, draw(st.integers(1, phases - 1)), 0).astype(np.uint8)


def smooth_noise(shape, width):
    noise = np.random.default_rng(5).random(shape)
    for axis in range(3):
        noise = sum(np.roll(noise, step, axis) for step in range(width))
    return noise


def in_pieces(volume, tally, depth):
    for slab in volume.slabs(depth):
        tally.add(slab.values.astype(bool))
    return tally


NAMES = [
    ("void", "solid"),
    ("void", "solid", "binder"),
    ("pore", "void", "binder", "other"),
    ("pore", "solid"),
    ("pore", "solid", "binder"),
]


@pytest.mark.whole
@settings(max_examples=80)
@given(
    values=volumes(phases=2),
    extra=st.integers(0, 2**32),
    names=st.sampled_from(NAMES),
    depth=st.integers(1, 9),
    r_max=st.integers(1, 8),
    wide=st.booleans(),
)
def test_slabs_describe_a_volume_as_the_whole_does(values, extra, names, depth, r_max, wide):
    further = np.random.default_rng(extra).integers(1, len(names), values.shape)
    labels = np.where(values > 0, further, 0)
    image = tb.Image(labels, "labels", spacing=(2.0, 1.0, 1.5) if wide else 1.0, phases=names)
    whole = describe(image, r_max=r_max, level="quick")
    slabs = describe_slabs(as_slabs(image), r_max=r_max, depth=depth, level="quick")
    if len(names) > 2:  # what slabs cannot tell
        assert any("cross_correlation, triples" in note for note in slabs["notes"])
        slabs["notes"] = [note for note in slabs["notes"] if "triples" not in note]
        whole["triples"] = None
        for pair in whole["pairs"].values():
            pair["cross_correlation"] = None
    assert slabs == whole


@settings(max_examples=60)
@given(values=volumes(), depth=st.integers(1, 9), connectivity=st.sampled_from([6, 18, 26]))
def test_components_of_slabs_are_those_of_the_whole(values, depth, connectivity):
    found = in_pieces(
        as_slabs(tb.Image(values, "labels")), ComponentTally(connectivity), depth
    ).result()
    assert found.sizes().tolist() == component_sizes(values, connectivity=connectivity).tolist()
    assert found.components == len(found.sizes()) and found.voxels == values.sum()
    for axis in range(3):
        share = percolating_fraction(values, axis=axis, connectivity=connectivity)
        assert found.through(axis) / max(1, found.voxels) == share


def test_a_spiral_that_closes_in_the_last_plane_is_one_component():
    values = np.zeros((9, 8, 8), np.uint8)
    values[:, ::2, ::2] = 1  # sixteen columns, which nothing but the last plane joins
    volume = as_slabs(tb.Image(values, "labels"))
    assert in_pieces(volume, ComponentTally(), 2).result().components == 16
    values = values.copy()
    values[-1] = 1
    joined = in_pieces(as_slabs(tb.Image(values, "labels")), ComponentTally(), 2).result()
    assert joined.components == 1 and joined.through(0) == joined.through(2) == values.sum()


def test_memory_of_components_is_that_of_a_plane_however_many_there_are():
    rng = np.random.default_rng(3)
    pieces = ComponentTally()
    for _ in range(40):
        pieces.add(rng.random((4, 16, 16)) < 0.2)
    kept = len(pieces._sizes) + len(pieces._closed)
    assert kept < 200 < pieces.result().components


@pytest.mark.whole
@given(arrays(bool, SHAPES), st.integers(1, 9))
def test_the_cubes_of_an_object_are_those_with_a_margin_around_it(inside, depth):
    from trabecula.measure.configurations import count_cubes

    cubes = in_pieces(as_slabs(tb.Image(inside, "labels")), ConfigurationCounts(), depth)
    assert cubes.object().tolist() == count_cubes(np.pad(inside, 1), None).tolist()
    assert cubes.inside().tolist() == count_cubes(inside, None).tolist()


def test_only_what_is_asked_for_is_read():
    seen = []
    values = np.random.default_rng(0).integers(0, 2, (20, 9, 8)).astype(np.uint8)

    def read(box):
        seen.append(box)
        return values[tuple(slice(*side) for side in box)]

    volume = Slabs(values.shape, read, (1.0,) * 3, "voxel", ("void", "solid"))
    assert describe_slabs(volume, depth=6, level="quick")["porosity"] == np.mean(values == 0)
    assert [box[0] for box in seen] == [(0, 6), (6, 12), (12, 18), (18, 20)]
    seen.clear()
    assert np.array_equal(volume.centre((4, 4, 8)).values, values[8:12, 2:6])
    assert seen == [((8, 12), (2, 6), (0, 8))]
    with pytest.raises(tb.errors.InputError, match="inside"):
        volume.centre((4, 4, 9))


def test_what_slabs_cannot_tell_is_left_out_by_name():
    values = np.random.default_rng(1).integers(0, 2, (12, 12, 12)).astype(np.uint8)
    volume = as_slabs(tb.Image(values, "labels"))
    found = describe_slabs(volume, depth=5)
    assert set(found) == set(describe(values))
    assert all(
        found[name] is None and any(name in note for note in found["notes"])
        for name in names_without_slabs()
        if name not in ("thickness", "pore_size")
    )
    with pytest.raises(tb.errors.InputError, match="depth"):
        describe_slabs(volume, depth=0)
    with pytest.raises(tb.errors.InputError, match="--box"):
        describe_slabs(volume, level="full")


@pytest.mark.parametrize("depth", [2, 7, 40])
@pytest.mark.parametrize("names", [("void", "solid"), ("void", "solid", "binder"), ("a", "b")])
def test_diameters_of_slabs_are_those_of_the_whole(depth, names, monkeypatch):
    monkeypatch.setattr("trabecula.measure.slab_diameters._FIRST", 4)
    field = smooth_noise((40, 12, 11), 4)
    labels = np.digitize(field, np.quantile(field, [0.6, 0.85][: len(names) - 1]))
    image = tb.Image(labels.astype(np.uint8), "labels", spacing=(1.5, 1.0, 2.0), phases=names)
    whole, slabs = describe(image), describe_slabs(as_slabs(image), depth=depth)
    pairs = [(whole[name], slabs[name]) for name in ("thickness", "pore_size")]
    both = whole["phases"], slabs["phases"]
    pairs += [tuple(found[name].get("thickness") for found in both) for name in names]
    assert sum(before is not None for before, _ in pairs) >= 2
    for before, after in pairs:
        assert after == (None if before is None else pytest.approx(before, rel=1e-6))


def test_diameters_need_the_largest_sphere_in_memory():
    layers = np.zeros((60, 8, 8), np.uint8)
    layers[np.arange(60) % 30 > 0] = 1
    image = tb.Image(layers, "labels")
    few = 32 * 64 * 20  # bytes of 20 planes
    found = describe_slabs(as_slabs(image), depth=4, r_max=1, memory=few)
    assert found["thickness"] is None and "thickness" in " ".join(found["notes"])
    assert describe_slabs(as_slabs(image), depth=4)["thickness"] == describe(image)["thickness"]


@pytest.mark.whole
def test_transport_is_that_of_the_box_in_the_middle(bone):
    values = bone.values[:20, :20, :20]
    image = tb.Image(values, "labels", spacing=bone.spacing, unit=bone.unit)
    found = describe_slabs(as_slabs(image), depth=7, level="full", box=10)
    assert found["conductivity"] == describe(image, level="full", box=10)["conductivity"]


def test_the_deepest_slab_that_fits_is_taken_and_none_is_refused():
    volume = Slabs(
        (1000, 10, 10), lambda box: np.zeros(0), (1.0,) * 3, "voxel", ("void", "solid"), grain=128
    )

    def depth(budget):
        return depth_within(
            volume, lambda planes: Plan({"slab": 100 * planes}), memory=budget, advice="crop it"
        )

    assert [depth(100 * most) for most in (1000, 999, 600, 300, 130, 127, 5)] == [
        1000,
        512,
        512,
        256,
        128,
        64,
        4,
    ]
    with pytest.raises(tb.errors.MemoryBudgetError, match="crop it"):
        depth(99)


@pytest.mark.parametrize("smooth", [True, False])
def test_the_forecast_bounds_what_a_pass_takes(smooth):
    noise = np.random.default_rng(7).random((96, 64, 60))
    for axis in range(3 * smooth):
        noise = noise + np.roll(noise, 1, axis) + np.roll(noise, 2, axis)
    volume = as_slabs(tb.Image(noise > np.median(noise), "labels"))
    count_slabs(volume, r_max=20, depth=32)  # kernels are loaded
    tracemalloc.start()
    count_slabs(volume, r_max=20, depth=32)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < forecast(volume, r_max=20, depth=32).peak < 2.5 * peak


@pytest.mark.whole
def test_the_forecast_bounds_a_pass_of_every_phase():
    noise = np.random.default_rng(8).random((96, 64, 60))
    for axis in range(3):
        noise = noise + np.roll(noise, 1, axis) + np.roll(noise, 2, axis)
    labels = np.digitize(noise, np.quantile(noise, [0.3, 0.6])).astype(np.uint8)
    volume = as_slabs(tb.Image(labels, "labels", phases=("void", "a", "b")))
    tracemalloc.start()
    count_slabs(volume, r_max=20, depth=32, phases=True)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < forecast(volume, r_max=20, depth=32, phases=True).peak < 2.5 * peak


def test_a_slab_with_a_label_that_has_no_name_is_refused():
    volume = Slabs(
        (4, 3, 3),
        lambda box: np.full((1, 3, 3), 5, np.uint8),
        (1.0,) * 3,
        "voxel",
        ("void", "solid"),
    )
    with pytest.raises(tb.errors.InputError, match="phases"):
        describe_slabs(volume, depth=1)


@given(arrays(bool, SHAPES), st.integers(1, 9))
def test_slabs_of_an_image_are_its_planes(inside, depth):
    image = tb.Image(inside, "labels")
    slabs = list(as_slabs(image).slabs(depth))
    assert np.array_equal(np.concatenate([slab.values for slab in slabs]), image.values)
    assert {len(slab.values) for slab in slabs[:-1]} <= {depth}
    assert (
        len(label_components(inside)[1])
        == in_pieces(as_slabs(image), ComponentTally(), depth).result().components
    )


def test_large_images_are_described_one_after_the_other():
    """On many threads several large ones would take as many times what one takes."""
    assert images_at_once([(64, 64, 64)], "default") == 31
    assert images_at_once([(64, 64, 64), (160, 160, 160)], "default") == 2
    assert images_at_once([(200, 200, 200)], "quick") == 1
    assert images_at_once([(1024, 1024, 1024)], "default") == 1
    assert images_at_once([(16, 16, 16)], "full") == 1

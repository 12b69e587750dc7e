"""Fields, crops, and how fields become values again."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

torch = pytest.importorskip("torch", reason="method gan needs the extra 'learn'")

import trabecula as tb  # noqa: E402
from trabecula.synth.gan.config import GanConfig  # noqa: E402
from trabecula.synth.gan.crops import exemplar_fields, turns_of  # noqa: E402
from trabecula.synth.gan.decode import (  # noqa: E402
    balance_offsets,
    calibrate,
    decode,
    held_out_field,
)
from trabecula.synth.gan.networks import new_generator  # noqa: E402

CONFIG = GanConfig(crop=40, width=2)


def image_of(levels, seed=0, side=44):
    return tb.Image(
        np.random.default_rng(seed).integers(0, levels, (side,) * 3).astype(np.uint8), "labels"
    )


def test_a_field_of_two_phases_rises_into_the_higher_label():
    image = image_of(2)
    field = exemplar_fields(image, CONFIG).values
    assert field.shape == (1, 44, 44, 44)
    assert np.array_equal(field[0].numpy() > 0, image.values == 1)
    assert float(field.abs().max()) < 1


def test_without_a_clip_a_field_is_a_sign():
    image = image_of(2)
    field = exemplar_fields(image, GanConfig(crop=40, clip=0)).values
    assert np.array_equal(field[0].numpy(), np.where(image.values == 1, 1, -1))


def test_three_phases_have_a_channel_each_that_is_positive_inside():
    image = image_of(3)
    field = exemplar_fields(image, CONFIG).values
    assert np.array_equal(field.argmax(0).numpy(), image.values)
    assert np.array_equal((field > 0).numpy(), np.arange(3)[:, None, None, None] == image.values)


def test_grey_is_stretched_between_its_tails():
    values = np.random.default_rng(0).normal(100, 20, (44,) * 3).astype(np.float32)
    field = exemplar_fields(tb.Image(values, "grey"), CONFIG).values[0].numpy()
    assert (field.min(), field.max()) == (-1, 1)
    inside = np.abs(field) < 1
    assert 0.995 < inside.mean() < 1
    line = np.polyfit(values[inside], field[inside], 1)
    assert np.abs(np.polyval(line, values[inside]) - field[inside]).max() < 1e-4


def test_crops_are_a_function_of_seed_and_iteration():
    fields = exemplar_fields(image_of(2, side=60), CONFIG)
    first = fields.crops(3, 1, 5)
    assert first.shape == (3, 1, 40, 40, 40)
    assert torch.equal(fields.crops(3, 1, 5), first)
    assert not torch.equal(fields.crops(3, 1, 6), first)
    assert not torch.equal(fields.crops(3, 2, 5), first)


def test_every_orientation_of_a_crop_occurs_and_no_other():
    whole = exemplar_fields(image_of(2, side=40), GanConfig(crop=40, orientations="mirrors"))
    wanted = {
        whole.values.permute(0, *order).flip(flips).numpy().tobytes()
        for order, flips in whole.turns
    }
    seen = {
        crop.numpy().tobytes() for iteration in range(20) for crop in whole.crops(4, 0, iteration)
    }
    assert seen == wanted
    assert len(wanted) == 8


@pytest.mark.parametrize(
    ("name", "count"), [("none", 1), ("inverted", 2), ("mirrors", 8), ("all", 48)]
)
def test_orientations_are_distinct_and_keep_what_they_promise(name, count):
    turns = turns_of(name)
    oblique = torch.arange(27.0).reshape(1, 3, 3, 3)
    copies = [oblique.permute(0, *order).flip(flips) for order, flips in turns]
    assert len({copy.numpy().tobytes() for copy in copies}) == len(turns) == count
    if name == "inverted":  # pairs of voxels stay pairs along the same direction
        step = (copies[1][0, 1:, 1:, 1:] - copies[1][0, :-1, :-1, :-1]).abs()
        assert torch.equal(step, (oblique[0, 1:, 1:, 1:] - oblique[0, :-1, :-1, :-1]).abs())


@given(st.lists(st.floats(0.05, 1), min_size=3, max_size=5), st.integers(0, 100))
def test_balanced_offsets_give_the_fractions(weights, seed):
    fractions = np.array(weights) / sum(weights)
    field = np.random.default_rng(seed).normal(size=(len(weights), 4000)).astype(np.float32)
    share = (
        np.bincount(
            (field + np.float32(balance_offsets(field, fractions))[:, None]).argmax(0),
            minlength=len(weights),
        )
        / 4000
    )
    assert np.abs(share - fractions).max() < 5e-3


@pytest.fixture(scope="module")
def network():
    with torch.random.fork_rng():
        torch.manual_seed(1)
        return {k: new_generator(GanConfig(width=4), k).eval() for k in (1, 3)}


def test_labels_come_out_in_the_exemplars_fractions(network):
    rng = np.random.default_rng(3)
    for levels, part in (([0, 2], [0.8, 0.2]), ([0, 1, 2], [0.5, 0.3, 0.2])):
        image = tb.Image(rng.choice(levels, (40,) * 3, p=part).astype(np.uint8), "labels")
        maker = network[1 if len(levels) == 2 else 3]
        field = held_out_field(maker, 0, 2)
        found = decode(field[:, None, None], calibrate(maker, image, 0, tiles=2))
        for label in levels:
            assert abs((found == label).mean() - (image.values == label).mean()) < 2e-3
        assert set(np.unique(found)) == set(levels)


def test_grey_values_come_out_in_the_exemplars_histogram(network):
    image = tb.Image(
        np.random.default_rng(4).gamma(2, 30, (40,) * 3).clip(0, 255).astype(np.uint8), "grey"
    )
    field = held_out_field(network[1], 0, 2)
    found = decode(field[:, None, None], calibrate(network[1], image, 0, tiles=2))
    assert found.dtype == np.uint8
    for share in (0.01, 0.1, 0.5, 0.9, 0.99):
        assert abs(np.quantile(found, share) - np.quantile(image.values, share)) <= 1


def test_decoding_looks_at_one_voxel_at_a_time():
    field = np.random.default_rng(5).normal(size=(3, 4, 5, 6)).astype(np.float32)
    calibration = {"kind": "labels", "present": [0, 1, 2], "offsets": [0.1, -0.2, 0.1]}
    whole = decode(field, calibration)
    assert np.array_equal(whole[1:3, 2:, :4], decode(field[:, 1:3, 2:, :4], calibration))
    assert np.array_equal(
        whole, (field + np.float32([0.1, -0.2, 0.1])[:, None, None, None]).argmax(0)
    )

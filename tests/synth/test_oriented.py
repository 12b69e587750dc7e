"""Material that is turned and scaled by a field: known directions, known sizes, and refusals."""

import numpy as np
import pytest

import trabecula as tb
from trabecula import fields
from trabecula.core.errors import RequestError
from trabecula.core.recipe import Recipe
from trabecula.pipeline.replay import replay
from trabecula.synth.lattice.mapping import cell_map
from trabecula.synth.noise.turned import TurnedField, principal_axis
from trabecula.synth.shared.frames import frames_of, turn_onto

SHAPE = (48, 32, 32)


def turning(shape=SHAPE):
    """From z to y over the length."""
    return fields.direction_formula(shape, ("cos(pi/2*z/Z)", "sin(pi/2*z/Z)", "0"))


def spinodal(**settings):
    return tb.method("noise", length=(15, 4, 4), exact=True, **settings).fit(spacing=1.0)


def test_a_turn_takes_an_axis_to_a_direction_the_shortest_way():
    for end in ([0, 0.6, 0.8], [-1, 0, 0], [1, 0, 0], [-0.6, 0, 0.8]):
        turn = turn_onto(np.array([1.0, 0, 0]), np.array(end, float))
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(turn) == pytest.approx(1)
        assert abs(turn[:, 0] @ end) == pytest.approx(1)
        assert np.trace(turn) >= 1 - 1e-9  # by 90 degrees at most


def test_every_direction_has_a_frame_and_few_stay_as_they_are():
    target = {"orientation": np.array([0, 0.6, 0.8])}
    assert frames_of(target, 60).directions.tolist() == [[0, 0.6, 0.8]]
    ways = np.random.default_rng(0).normal(size=(8, 8, 8, 3))
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    frames = frames_of(
        {"orientation": ways, "size": np.geomspace(0.5, 2, 512).reshape(8, 8, 8)}, 60
    )
    total = sum(
        frames.weights(n, ways, np.geomspace(0.5, 2, 512).reshape(8, 8, 8))
        for n in range(frames.count)
    )
    assert total.min() > 0
    assert frames.sizes[[0, -1]].tolist() == pytest.approx([0.5, 2])


@pytest.mark.whole
def test_noise_follows_a_direction_that_turns_at_the_fraction_asked():
    model, ways = spinodal(), turning()
    made = model.generate(SHAPE, seed=2, target={"orientation": ways, "volume_fraction": 0.4})
    assert made.values.mean() == pytest.approx(0.4, abs=1e-3)
    assert np.nanmean(fields.direction_errors(made, ways, size=16)) < 20
    wrong = fields.direction_formula(SHAPE, ("cos(pi/2*z/Z)", "-sin(pi/2*z/Z)", "0"))
    assert np.nanmean(fields.direction_errors(made, wrong, size=16)) > 30


def test_the_longest_length_is_the_axis_of_noise():
    model = tb.method("noise", length=(4, 12, 4)).fit(spacing=1.0)
    assert abs(principal_axis(model._filter())[1]) > 0.999
    columns = tb.method("noise", length=12, covariance="wave", cones=(0, 25, 25)).fit(spacing=1.0)
    assert abs(principal_axis(columns._filter())[0]) > 0.99


def test_a_turned_filter_has_its_axis_on_the_direction():
    part = tb.method("noise", length=(12, 4, 4)).fit(spacing=1.0)._filter()
    request = tb.Request(8, target={"orientation": (3, 0, 4)})
    turned = TurnedField(part, request).field.filters[0]
    assert abs(principal_axis(turned) @ [0.6, 0, 0.8]) > 0.999


def test_noise_of_one_direction_is_that_of_its_lengths():
    turned = spinodal().generate(24, seed=1, target={"orientation": (0, 0, 1)})
    along = tb.method("noise", length=(4, 4, 15), exact=True).fit(spacing=1.0)
    assert np.mean(turned.values == along.generate(24, seed=1).values) > 0.97


@pytest.mark.whole
def test_a_block_of_turned_noise_is_that_of_the_whole():
    model = tb.method("noise", length=(12, 4, 4)).fit(spacing=1.0)
    ways = turning((24, 16, 16)).values
    porosity = fields.ramp((24, 16, 16), start=0.3, end=0.8)
    target = {"orientation": ways, "porosity": porosity, "size": 0.8}
    request = tb.Request((24, 16, 16), seed=3, target=target)
    whole = model.generate(request).values
    part = model.window(request, ((5, 20), (0, 9), (3, 16)))
    assert np.array_equal(part, whole[5:20, 0:9, 3:16])


@pytest.mark.whole
def test_a_size_makes_noise_coarser():
    model = tb.method("noise", length=4, porosity=0.5).fit(spacing=1.0)
    fine, coarse = (
        tb.measure.specific_surface(model.generate(32, seed=1, target={"size": size}))
        for size in (1.0, 2.0)
    )
    assert fine / coarse == pytest.approx(2, rel=0.1)


@pytest.mark.parametrize(
    ("settings", "target", "words"),
    [
        ({"length": 8}, {"orientation": (0, 0, 1)}, "this one has none"),
        ({"kind": "worley"}, {"porosity": 0.5}, "Gaussian fields of two phases"),
        ({"length": (30, 6, 6)}, {"size": 4.0}, "reach 240 voxels, 100 at most"),
    ],
)
def test_what_noise_cannot_turn_is_refused(settings, target, words):
    with pytest.raises(RequestError, match=words):
        tb.method("noise", **settings).fit(spacing=1.0).generate(16, target=target)


def test_cones_need_a_named_covariance():
    for settings in ({}, {"kind": "perlin"}):
        with pytest.raises(tb.errors.InputError, match="a covariance, such as 'wave'"):
            tb.method("noise", cones=(0, 30, 30), **settings)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_cells_of_one_direction_are_turned_and_nothing_else(axis):
    way = np.eye(3)[axis] * 0.8 + np.eye(3)[(axis + 1) % 3] * 0.6
    found = cell_map(way, 1.5, (20, 24, 28), np.array([20.0, 10.0, 10.0]), None)
    assert found.report["angle"] < 0.01 and found.report["edges"] == [1.0, 1.0]
    place = np.meshgrid(*(np.arange(8.0, 12.0),) * 3, indexing="ij", sparse=True)
    u = found.at(tuple(place))
    step = [np.gradient(one) for one in u]
    assert step[0][axis].mean() == pytest.approx(0.8 / 30) or step[0][axis].mean() < 0
    np.testing.assert_allclose(
        np.linalg.norm([[s.mean() for s in one] for one in step], axis=1), [1 / 30, 1 / 15, 1 / 15]
    )


@pytest.mark.whole
def test_a_lattice_follows_a_direction_that_turns_and_its_recipe_replays(tmp_path):
    ways = turning()
    np.save(tmp_path / "ways.npy", ways.values)
    model = tb.method("lattice", cell_size=(20, 8, 8)).fit(spacing=1.0)
    target = {
        "orientation": fields.read_directions(tmp_path / "ways.npy"),
        "volume_fraction": 0.4,
    }
    made = model.generate(SHAPE, target=target)
    assert np.nanmean(fields.direction_errors(made, ways, size=16)) < 12
    assert made.values.mean() == pytest.approx(0.4, abs=0.01)
    assert made.recipe.steps[-1]["report"]["cells"]["angle"] < 2
    again = replay(Recipe.from_json(made.recipe.to_json()), folder=tmp_path)
    assert np.array_equal(again.values, made.values)


def test_cells_that_would_be_torn_are_refused():
    ways = fields.direction_formula((24, 25, 25), ("0", "y-Y/2+.3", "x-X/2+.3"))
    with pytest.raises(RequestError, match="cells cannot follow this field"):
        tb.method("lattice", cell_size=(16, 8, 8)).fit(spacing=1.0).generate(
            (24, 25, 25), target={"orientation": ways}
        )


@pytest.mark.parametrize(
    ("settings", "parts", "words"),
    [
        ({"direction": (1, 1, 0)}, {}, "give one of them"),
        ({}, {"periodic": True}, "leave periodic out"),
        ({"cell_size": 5}, {"size": 0.5}, "cells of 2.5 voxels"),
    ],
)
def test_what_contradicts_the_cells_field_is_refused(settings, parts, words):
    target = {"orientation": (0, 0, 1), "size": parts.pop("size", 1.0)}
    with pytest.raises(RequestError, match=words):
        tb.method("lattice", **settings).fit(spacing=1.0).generate(16, target=target, **parts)


@pytest.mark.whole
def test_bubbles_follow_a_direction_and_a_size():
    model = tb.method("bubbles", distance=10, randomness=0.2).fit(spacing=1.0)
    made = model.generate(SHAPE, seed=1, target={"orientation": turning(), "porosity": 0.5})
    assert np.nanmean(fields.direction_errors(made, turning(), size=16)) < 8
    assert made.values.mean() == pytest.approx(0.5, abs=1e-3)
    sizes = np.ones((64, 40, 40), np.float32)
    sizes[32:] = 2
    plain = tb.method("bubbles", distance=8).fit(spacing=1.0)
    made = plain.generate(sizes.shape, seed=1, target={"size": sizes, "porosity": 0.5})
    small, large = (tb.measure.pore_size(made[part]) for part in (slice(0, 28), slice(36, 64)))
    assert 1.6 < large / small < 2.4
    whole = plain.generate((20, 20, 20), seed=1, target={"size": 1.0, "porosity": 0.5})
    same = plain.generate((20, 20, 20), seed=1, target={"porosity": 0.5})
    assert np.array_equal(whole.values, same.values)


def test_round_bubbles_have_no_direction():
    with pytest.raises(RequestError, match="set randomness below 1"):
        tb.method("bubbles").fit(spacing=1.0).generate(16, target={"orientation": (0, 0, 1)})


@pytest.mark.whole
def test_a_method_without_it_refuses_by_name():
    picture = tb.Image(tb.sample("bone").values[16, :32, :32], "labels")
    model = tb.method("kopf", levels=1).fit(picture)
    with pytest.raises(RequestError, match="cannot honour the target orientation, size"):
        model.generate(24, target={"orientation": (0, 0, 1), "size": 2.0})


def test_a_form_too_thin_for_the_size_is_refused():
    mask = np.zeros((16, 16, 16), bool)
    mask[:, :, 6:9] = True
    for name in ("lattice", "bubbles"):
        with pytest.raises(RequestError, match=r"too thin: it is 4\.0 voxels thick at most"):
            tb.method(name).fit(spacing=1.0).generate(16, target={"size": 1.5}, mask=mask)


def test_fractions_that_are_more_than_all_contradict():
    field = np.full((8, 8, 8), 0.5, np.float32)
    field[1, 2, 3] = 0.8
    for target in (
        {"volume_fraction:a": field, "volume_fraction:b": 0.4},
        {"volume_fraction:a": field, "porosity": 0.4},
    ):
        with pytest.raises(tb.errors.InputError, match=r"contradict .* z y x 1 2 3"):
            tb.Request(8, target=target)
    tb.Request(8, target={"volume_fraction:a": 0.6, "porosity": 0.4, "volume_fraction:void": 0.4})

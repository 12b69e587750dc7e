"""The end of a generator's material: patterns as in the exemplar. Weights are untrained."""

from functools import partial
from itertools import product

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError
from trabecula.synth.shared.patterns.counts import Patterns

torch = pytest.importorskip("torch", reason="gan needs the extra 'learn', which is not installed")

from test_window import BONE, untrained  # noqa: E402

from trabecula.synth.api.serialize import load_model  # noqa: E402
from trabecula.synth.gan import method, patterns  # noqa: E402
from trabecula.synth.gan.config import GanConfig  # noqa: E402

_THREE = ("void", "a", "b")


@pytest.fixture(scope="module", autouse=True)
def little():
    """Compare little material: nothing here is judged by its densities."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(method, "learn_bias", partial(patterns.learn_bias, side=64))
        yield


@pytest.fixture(scope="module")
def plain():
    return untrained(specks=2)


@pytest.fixture(scope="module")
def exemplar(plain):
    """Rougher than what the model makes, as dense."""
    made = plain.generate(72, seed=5).values
    grains = np.random.default_rng(0).random(made.shape)
    return tb.Image(np.where(grains < 0.03, 1 - made, made), "labels", phases=BONE.phases)


@pytest.fixture(scope="module")
def matched(plain, exemplar):
    return plain.matched_to(exemplar)


@pytest.fixture(scope="module", params=[0, 2])
def before_and_after(request, plain, matched, exemplar):
    """Return a model and what it is matched to the exemplar, without specks or with them."""
    if request.param:
        return plain, matched
    without = untrained(specks=0)
    return without, without.matched_to(exemplar)


def test_a_box_is_what_the_whole_has_there(before_and_after):
    _, model = before_and_after
    whole = model.window(10, ((20, 80), (-40, 30), (50, 72)), seed=2)
    one = model.window(10, ((60, 70), (-3, 5), (63, 66)), seed=2)
    assert np.array_equal(one, whole[40:50, 37:45, 13:16])


def test_only_interfaces_change_and_no_tile_its_fraction(before_and_after):
    box = ((0, 64), (64, 128), (0, 64))
    before, after = (model.window(10, box, seed=4) for model in before_and_after)
    changed = before != after
    assert 0.005 < changed.mean() < 0.2
    assert before.sum() == after.sum()
    near = np.zeros(before.shape, bool)
    for axis, step in product(range(3), (-1, 1)):
        near |= np.roll(before, step, axis) != before
    inside = (slice(1, -1),) * 3  # beyond a face of the box nothing was looked at
    assert not (changed & ~near)[inside].any()


def test_patterns_come_nearer_to_the_exemplars(plain, matched, exemplar):
    wanted = Patterns.of(exemplar.values, 2).densities
    off = [
        np.abs(Patterns.of(model.generate(64, seed=9).values, 2).densities - wanted).sum()
        for model in (plain, matched)
    ]
    assert off[1] < 0.8 * off[0]


def test_an_axis_repeats(matched):
    shape, periodic = (30, 24, 72), (False, True, True)
    whole = matched.generate(shape, seed=1, periodic=periodic).values
    box = ((3, 30), (-20, 50), (60, 80))
    beyond = matched.window(shape, box, seed=1, periodic=periodic)
    places = np.ix_(*(np.arange(a, b) % side for (a, b), side in zip(box, shape, strict=True)))
    assert np.array_equal(beyond, whole[places])


def test_three_phases_of_other_labels():
    plain = untrained(
        tb.Image(BONE.values + (BONE.values[::-1] & BONE.values), "labels", phases=_THREE),
        calibration={"kind": "labels", "present": [0, 1, 2], "offsets": [0.0, 0.0, 0.0]},
        specks=0,
    )
    values = plain.generate(72, seed=5).values
    values[np.random.default_rng(0).random(values.shape) < 0.02] = 1
    exemplar = tb.Image(values, "labels", phases=_THREE)
    model = plain.matched_to(exemplar)
    before, after = (m.window(10, ((0, 64),) * 3, seed=3) for m in (plain, model))
    assert (before != after).any()
    assert np.bincount(before.ravel()).tolist() == np.bincount(after.ravel()).tolist()


def test_a_file_keeps_them(matched, tmp_path):
    again = load_model(matched.save(tmp_path / "x.model"))
    made = again.generate(40, seed=6).values
    assert np.array_equal(
        made, load_model(again.save(tmp_path / "y.model")).generate(40, seed=6).values
    )
    assert (tmp_path / "x.model").read_bytes() == (tmp_path / "y.model").read_bytes()
    assert again.config.interface_rounds == 1


def test_a_model_of_before_has_none():
    assert GanConfig.recorded({})["interface_rounds"] == 0
    assert untrained().bias is None


def test_what_tells_no_patterns_is_refused(plain, exemplar):
    with pytest.raises(InputError, match="at least 9216 voxels"):
        plain.matched_to(tb.crop(exemplar, 20))
    grey = tb.Image(exemplar.values * np.uint8(200), "grey")
    with pytest.raises(InputError, match=r"labels \[0, 1\]"):
        plain.matched_to(grey)
    one = tb.Image(np.zeros((40,) * 3, np.uint8), "labels", phases=BONE.phases)
    with pytest.raises(InputError, match=r"labels \[0, 1\]"):
        plain.matched_to(one)


def test_beside_a_field_boxes_agree_and_windows_come_nearer_to_it():
    model = tb.load_model("bone")
    along = np.linspace(0.76, 0.9, 130, dtype=np.float32)
    field = np.ascontiguousarray(np.broadcast_to(along[:, None, None], (130, 60, 60)))
    request = tb.Request(field.shape, seed=1, target={"porosity": field})
    whole = model.generate(request).values
    part = model.make_box(request, ((50, 100), (10, 60), (0, 40)))
    assert np.array_equal(part, whole[50:100, 10:60, :40])

    def off(values):
        void = (values == 0)[:120] - field[:120]
        return np.abs(void.reshape(6, 20, 3, 20, 3, 20).mean(axis=(1, 3, 5))).mean()

    assert off(whole) < 0.95 * off(model.unmatched().generate(request).values)

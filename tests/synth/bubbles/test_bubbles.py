"""The method: porosity to the voxel, forms and rooms, what is refused."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError, RequestError
from trabecula.synth.bubbles import porosity_level
from trabecula.synth.bubbles.config import BubblesConfig
from trabecula.synth.bubbles.growth import Growth
from trabecula.synth.bubbles.growth_law import law_of

BALL = (
    np.hypot.outer(np.arange(-20, 20), np.hypot.outer(np.arange(-20, 20), np.arange(-20, 20))) < 19
)


def porosity_of(image, mask=None):
    return np.mean((image.values == 0)[... if mask is None else mask])


@pytest.mark.parametrize(
    ("shape", "more"),
    [
        ((40, 44, 38), {}),
        ((90, 120), {}),
        ((40, 40, 40), {"periodic": True}),
        ((40, 40, 40), {"mask": BALL}),
    ],
    ids=["volume", "picture", "periodic", "mask"],
)
@pytest.mark.parametrize("asked", [0.05, 0.62])
def test_porosity_comes_out_to_the_voxel(shape, more, asked):
    made = tb.method("bubbles", distance=9.0, porosity=asked).fit().generate(shape, seed=1, **more)
    mask = more.get("mask", np.ones(shape, bool))
    assert abs(porosity_of(made, mask) - asked) <= 1 / mask.sum()


def test_porosity_is_that_of_the_crumb():
    model = tb.method("bubbles", distance=8.0, porosity=0.5, crust=3.0).fit()
    made = model.generate((40, 40, 40), seed=1, mask=BALL)
    room = model._growth(tb.Request((40, 40, 40), seed=1, mask=BALL)).room(((0, 40),) * 3)
    assert (made.values[BALL & ~room] == 1).all(), "the crust is solid"
    assert porosity_of(made, room & BALL) == pytest.approx(0.5, abs=1e-4)


@pytest.mark.whole
def test_scattered_blocks_tell_the_level_of_what_is_large(monkeypatch):
    """Both ways of counting, of one picture: 1.4 million voxels, of which 1 in 20 is looked at."""
    model, request = (
        tb.method("bubbles", distance=12.0, porosity=0.6).fit(),
        tb.Request((1200, 1200), seed=3),
    )
    assert porosity_of(model.generate(request)) == pytest.approx(0.6, abs=1e-6)
    monkeypatch.setattr(porosity_level, "COUNTED", 1 << 16)
    monkeypatch.setattr(porosity_level, "_FEWEST", 1 << 14)
    monkeypatch.setattr(porosity_level, "_MOST", 1 << 14)
    near = tb.method("bubbles", distance=12.0, porosity=0.6).fit().generate(request)
    assert porosity_of(near) != 0.6
    assert porosity_of(near) == pytest.approx(0.6, abs=0.004)


def test_a_field_of_porosity_is_followed():
    shape = (32, 30, 96)
    field = np.broadcast_to(np.linspace(0.1, 0.7, 96, dtype=np.float32), shape)
    model = tb.method("bubbles", distance=7.0, thickness=0.03).fit()
    made = model.generate(shape, seed=1, target={"porosity": field})
    found = [(made.values[..., at : at + 16] == 0).mean() for at in range(0, 96, 16)]
    assert np.allclose(found, np.linspace(0.15, 0.65, 6), atol=0.05)
    part = model.window(shape, ((0, 9), (3, 30), (40, 71)), seed=1, target={"porosity": field})
    assert np.array_equal(part, made.values[0:9, 3:30, 40:71])
    with pytest.raises(InputError, match="nothing says what it is there"):
        model.window(shape, ((0, 9), (3, 30), (40, 97)), seed=1, target={"porosity": field})


def test_a_porosity_that_walls_forbid_is_refused_with_the_most():
    model = tb.method("bubbles", distance=10.0, separation=3.0).fit()
    with pytest.raises(
        RequestError, match=r"porosity 0\.9 is out of reach, 0\.\d+ is the most"
    ) as refusal:
        model.generate((40, 40, 40), seed=1, target={"porosity": 0.9})
    most = float(str(refusal.value).split("reach, ")[1].split(" ")[0])
    full = porosity_of(model.generate((40, 40, 40), seed=1))
    assert most == pytest.approx(full, abs=1e-4)
    made = model.generate((40, 40, 40), seed=1, target={"porosity": full})
    assert porosity_of(made) == pytest.approx(full, abs=1e-4)


@pytest.mark.parametrize("field", [{"growth": "particles"}, {}], ids=["particles", "fronts"])
def test_no_void_at_all_can_be_asked_for(field):
    made = tb.method("bubbles", porosity=0.0, **field).fit().generate((20, 20, 20), seed=1)
    assert (made.values == 1).all()


@pytest.mark.parametrize(
    ("settings", "spacing", "words"),
    [
        ({"density": 3.0}, 1.0, "3 bubbles a voxel"),
        ({"density": 0.5}, 2.0, "4 bubbles a voxel of edge 2"),
    ],
)
def test_more_bubbles_than_voxels_are_refused(settings, spacing, words):
    with pytest.raises(InputError, match=words):
        tb.method("bubbles", **settings).fit(spacing=spacing).plan(tb.Request((20, 20, 20)))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"spread": 0.9}, "spread=0.9 is outside 0 .. 0.6"),
        ({"randomness": 0.0}, "randomness"),
        ({"separation": -1.0}, "separation"),
        ({"density": float("nan")}, "density"),
        ({"porosity": 1.2}, "porosity=1.2"),
        ({"time": 0.5, "porosity": 0.5}, "give one of them"),
        ({"growth": "frost"}, "did you mean 'fronts'"),
    ],
)
def test_settings_out_of_range_are_refused(settings, words):
    with pytest.raises(InputError, match=words):
        tb.method("bubbles", **settings)


def test_an_exemplar_of_three_phases_is_refused():
    values = np.random.default_rng(0).integers(0, 3, (20, 20, 20)).astype(np.uint8)
    with pytest.raises(InputError, match="two phases"):
        tb.method("bubbles").fit(tb.Image(values, "labels", phases=("void", "binder", "solid")))


def test_particles_start_where_fronts_do_and_are_made_whole():
    shape = (30, 40)
    model = tb.method("bubbles", growth="particles", distance=8.0, separation=1.0).fit()
    made = model.generate(shape, seed=1)
    growth = model._growth(tb.Request(shape, seed=1))
    places = growth.world(((0, 1), (0, 30), (0, 40)))[1][1]
    voxels = np.floor(places).astype(int)[:, 1:]
    voxels = voxels[((voxels >= 0) & (voxels < shape)).all(1)]
    assert len(voxels) > 10
    assert (made.values[tuple(voxels.T)] == 0).mean() > 0.9, (
        "but for those that start within the separation of others"
    )
    assert made.recipe.steps[-1]["report"]["alive"] == 0, "at fullness all are dead"
    with pytest.raises(RequestError, match="set growth to fronts"):
        model.window(shape, ((0, 9), (0, 9)), seed=1)


def test_porosity_and_size_do_not_depend_on_the_grid():
    """One material at two spacings, seeds apart: the difference is within what seeds make."""
    found = {}
    for spacing, side in ((1.0, 40), (0.5, 80)):
        made = [
            tb.method("bubbles", density=8.0**-3, separation=1.2)
            .fit(spacing=spacing)
            .generate((side,) * 3, seed=seed)
            for seed in range(6)
        ]
        found[spacing] = np.array([porosity_of(one) for one in made])
    assert np.abs(found[1.0] - found[0.5]).max() < 0.01, "of one seed"
    assert found[0.5].std() > np.abs(found[1.0] - found[0.5]).max() / 3


def test_bubbles_stay_where_they_are_when_the_volume_grows():
    model = tb.method("bubbles", porosity=None).fit()
    small, large = (model.generate(shape, seed=9).values for shape in ((20, 20, 20), (33, 40, 29)))
    assert np.array_equal(small, large[:20, :20, :20])


def test_the_law_is_one_of_lengths():
    fine, coarse = (
        law_of(BubblesConfig(density=0.001, separation=2.0), spacing, 3) for spacing in (0.5, 1.0)
    )
    assert (fine.apart, fine.wall) == (20, 4)
    assert (coarse.apart, coarse.wall) == (10, 2)
    assert Growth(fine, 1, (0, 0, 0), (1, 1, 1), None).law.latest == 32


def test_unevenness_is_drawn_by_the_seed():
    law = law_of(BubblesConfig(roughness=1.0), 1.0, 3)
    shifts = [np.zeros((4, 4, 4, 3), np.float32) for _ in range(3)]
    for seed, drawn in zip((1, 1, 2), shifts, strict=True):
        growth = Growth(law, seed, (0, 0, 0), (8, 8, 8), None)
        growth._set_shifts(drawn, np.zeros(3, np.int64), np.full(3, 4))
    assert np.array_equal(shifts[0], shifts[1]) and 0 < np.abs(shifts[0]).max() <= law.shift
    assert np.mean(shifts[0] != shifts[2]) > 0.9

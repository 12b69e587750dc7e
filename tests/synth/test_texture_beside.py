"""New material of `texture` beside known voxels: they stay, it joins them, and none is copied."""

import numpy as np
import pytest
from texture_runs import check_in_files, check_memory, resume_after_search

import trabecula as tb
from trabecula.synth.shared import novel_layout
from trabecula.synth.shared.known_part import has_room_beside

SHAPE = (48, 32, 33)
HELD = 24  # planes
WHOLE = ("rounds", "structure")  # layouts on the level of the structure


def known_planes(shape, planes):
    known = np.zeros(shape, bool)
    known[:planes] = True
    return known


@pytest.fixture(scope="module")
def bone():
    return tb.sample("bone")


@pytest.fixture(scope="module")
def model(bone):
    return tb.method("texture", sweeps=1, tries=2).fit(tb.crop(bone, 40, corner=(56, 56, 56)))


@pytest.fixture(scope="module")
def request_(bone):
    piece = tb.crop(bone, SHAPE, corner=(0, 0, 0))
    return tb.Request(SHAPE, seed=3, fixed=piece, known=known_planes(SHAPE, HELD))


@pytest.fixture(scope="module")
def made(model, request_, tmp_path_factory):
    values, report = check_in_files(model, request_, tmp_path_factory.mktemp("files"))
    assert "small_bodies" in report
    return values


@pytest.mark.whole
def test_known_voxels_stay_and_what_joins_them_is_not_copied(model, request_, made):
    assert np.array_equal(made[:HELD], request_.fixed.values[:HELD])
    (exemplar,) = model.exemplars
    copied = tb.measure.coherence(exemplar, made[HELD:], k=4, samples=300)[4]
    assert copied < 0.2
    changes = np.mean(made[1:] != made[:-1], axis=(1, 2))
    assert changes[HELD - 1] < 1.5 * changes.mean()  # 1.6 to 2.2 by plain votes


@pytest.mark.whole
@pytest.mark.parametrize("call", [3, 10])
def test_interrupted_it_resumes_bit_for_bit(call, model, request_, made, tmp_path, monkeypatch):
    again = resume_after_search(call, model, request_, tmp_path / "a.part", monkeypatch)
    assert np.array_equal(again, made)


def test_thin_gaps_and_single_slices_have_no_layout():
    """A layout needs 8 coarse voxels, and slices are not seen on its level."""
    assert has_room_beside(known_planes((40, 32, 32), 24), 1)
    assert not has_room_beside(known_planes((40, 32, 32), 25), 1)
    assert not has_room_beside(known_planes((40, 32, 32), 24), 2)
    assert not has_room_beside(known_planes((40, 32, 32), 1), 1)


def test_known_voxels_at_one_face_are_not_next_to_free_ones_at_the_other():
    """On the torus an open axis is continued where a neighbourhood would hold both."""
    fixed = tb.Image(np.zeros(SHAPE, np.uint8), "labels")
    request = tb.Request(SHAPE, fixed=fixed, known=known_planes(SHAPE, HELD))
    assert novel_layout.torus_shape(request, 0, 1) == (64, 48, 50)
    hole = np.ones((64, 64, 64), bool)
    hole[20:44, 20:44, 20:44] = False
    fixed = tb.Image(np.zeros(hole.shape, np.uint8), "labels")
    assert novel_layout.torus_shape(tb.Request(64, fixed=fixed, known=hole), 0, 1) == (64,) * 3


@pytest.mark.whole
def test_memory_is_forecast(model, request_, made):
    check_memory(model, request_)


@pytest.mark.slow
def test_where_little_is_free_known_voxels_are_met_from_level_1_on():
    """Without steps what rounds from noise make on level 2 did not meet them: joints showed."""
    shape = (128, 64, 64)
    cells = (np.indices((128, 96, 96)) // 12).sum(axis=0) % 2
    board = tb.crop(tb.Image(cells.astype(np.uint8), "labels"), 96)
    piece = tb.Image(np.ascontiguousarray(cells[:, :64, :64], np.uint8), "labels")
    models = {layout: tb.method("texture", layout=layout).fit(board) for layout in WHOLE}
    for planes, layout, levels, steps in (
        (48, "rounds", [2, 1, 0, 0], True),
        (92, "rounds", [1, 0, 0], False),
        (48, "structure", [1, 0, 0], False),
    ):
        model = models[layout]
        beside = tb.Request(shape, fixed=piece, known=known_planes(shape, planes))
        rounds = model._novel_rounds(beside, model._regions_around(beside))
        assert [part.level for part in rounds.schedule] == levels
        assert any(part.steps for part in rounds.schedule) == steps
    plain = tb.method("texture", novelty=0).fit(board)
    assert plain._top_for(beside) == 0


@pytest.mark.whole
@pytest.mark.parametrize(
    ("settings", "target", "most"),
    [({"novelty": 0}, {}, 2.3), ({}, {"porosity": 0.75}, 1.4)],
    ids=["patches", "graded"],
)
def test_joints_of_patches_and_of_graded_material_hardly_show(settings, target, most, bone):
    """Changes across the joint over those within what was made: before 4.6 and 3.0, 2.0 and 1.0
    now.
    """
    shape, held = (64, 48, 48), 32
    piece = tb.crop(bone, shape, corner=(0, 0, 0))
    if target:
        target = {"porosity": np.full(shape, target["porosity"], np.float32)}
    learned = tb.method("texture", **settings).fit(tb.crop(bone, 48, corner=(48, 48, 48)))
    known = known_planes(shape, held)
    made = learned.generate(tb.Request(shape, seed=2, fixed=piece, known=known, target=target))
    changes = np.mean(made.values[1:] != made.values[:-1], axis=(1, 2))
    assert np.array_equal(made.values[:held], piece.values[:held])
    assert changes[held - 1] < most * changes[held:].mean()


@pytest.mark.whole
def test_beside_known_voxels_a_field_is_held_and_nothing_is_copied(bone):
    """What is made has the field's mean, whatever the known voxels have; before the whole had it,
    and patches of a seventh of its places were the exemplar's.
    """
    shape, held = (64, 48, 48), 24
    piece = tb.crop(bone, shape, corner=(0, 0, 0))
    ramp = np.linspace(0.9, 0.78, shape[0], dtype=np.float32)[:, None, None] + np.zeros(shape)
    exemplar = tb.crop(bone, 48, corner=(48, 48, 48))
    request = tb.Request(
        shape,
        seed=2,
        fixed=piece,
        known=known_planes(shape, held),
        target={"porosity": ramp.astype(np.float32)},
    )
    made = tb.method("texture").fit(exemplar).generate(request)
    assert np.array_equal(made.values[:held], piece.values[:held])
    void = made.values[held:] == 0
    assert void.mean() == pytest.approx(ramp[held:].mean(), abs=0.003)
    for part in (slice(0, 20), slice(20, 40)):
        assert void[part].mean() == pytest.approx(ramp[held:][part].mean(), abs=0.02)
    assert tb.measure.coherence(exemplar, made.values[held:], k=(4,))[4] < 0.12


@pytest.mark.slow
def test_a_field_beside_known_voxels_resumes_and_its_memory_is_forecast(
    bone, tmp_path, monkeypatch
):
    shape = (40, 32, 32)
    ramp = np.linspace(0.9, 0.78, shape[0], dtype=np.float32)[:, None, None] + np.zeros(shape)
    request = tb.Request(
        shape,
        seed=3,
        fixed=tb.crop(bone, shape, corner=(0, 0, 0)),
        known=known_planes(shape, 14),
        target={"porosity": ramp.astype(np.float32)},
    )
    model = tb.method("texture", sweeps=1, tries=2).fit(tb.crop(bone, 40))
    folder = tmp_path / "files"
    folder.mkdir()
    values, report = check_in_files(model, request, folder)
    assert "way" not in report
    check_memory(model, request)
    again = resume_after_search(6, model, request, tmp_path / "a.part", monkeypatch)
    assert np.array_equal(again, values)

"""Search and vote on planes in scratch files, and interrupted: the same voxels, slab by slab and
from the last state.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine import checkpoint, memmap
from trabecula.engine.memory import check_releases
from trabecula.engine.parallel import threads
from trabecula.synth.chen.method import choose_pixels
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.matching.grid import random_matches
from trabecula.synth.shared.matching.planes import RegionViews, cast_plane_votes
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Candidates, Stack
from trabecula.synth.shared.slabs import put_axis_first, restore_axis_order

SHAPE = (24, 22, 23)
QUICK = {
    # two levels
    "kopf": {"neighbourhood": 4, "rounds": 2, "first_rounds": 3, "sweeps": (1, 2), "tries": 1},
    "chen": {"neighbourhood": 4, "rounds": 2, "first_rounds": 3, "sweeps": (1, 2), "tries": 1},
    "sliced": {"layout_rounds": 3, "rounds": (2, 2), "corrections": (1,), "sweeps": 1, "tries": 1},
}


def smooth(seed, side=40):
    field = np.random.default_rng(seed).random((side, side))
    for _ in range(3):
        field = (field + np.roll(field, 1, 0) + np.roll(field, 1, 1)) / 3
    return field


LABELS = tb.Image((smooth(0) > 0.52).astype(np.uint8), "labels")
THREE = tb.Image(np.digitize(smooth(1), [0.45, 0.55]).astype(np.uint8), "labels")
GREY = tb.Image((smooth(2) * 1000).astype(np.uint16), "grey")
COLOUR = tb.Image(np.stack([smooth(s) * 255 for s in range(3)], axis=-1).astype(np.uint8), "colour")


def fixed(image):
    known = np.zeros(SHAPE, bool)
    known[11] = True
    values = np.zeros((*SHAPE, *image.values.shape[2:]), image.values.dtype)
    values[11] = image.values[: SHAPE[1], : SHAPE[2]]
    return {"fixed": tb.Image(values, image.kind), "known": known}


def cylinder():
    grid = np.indices(SHAPE)
    return {"mask": (grid[1] - 11) ** 2 + (grid[2] - 11) ** 2 < 100}


CASES = [
    ("kopf", LABELS, {}, {}),
    (
        "kopf",
        LABELS,
        {"reweighting": 0, "neighbourhood": 6, "step": 3},
        {"periodic": (True, False, True)},
    ),
    ("kopf", THREE, {}, cylinder()),
    ("kopf", GREY, {"search": "exact"}, fixed(GREY)),
    ("kopf", LABELS, {"views": ("zx", "zy"), "histogram": False}, fixed(LABELS)),
    ("chen", LABELS, {}, {"target": {"porosity": 0.6}}),
    ("chen", LABELS, {"discrete": False}, {"periodic": (False, True, False)}),
    ("chen", COLOUR, {}, fixed(COLOUR) | cylinder()),
    ("sliced", LABELS, {}, {}),
    ("sliced", THREE, {"specks": 0}, {"periodic": (True, False, True)}),
    ("sliced", LABELS, {"levels": 2}, fixed(LABELS) | cylinder()),
]


def values_of(made):
    """Return what a model makes without the report that labels come with."""
    return made[0] if isinstance(made, tuple) else made


@pytest.fixture
def small_arrays_too(monkeypatch):
    monkeypatch.setattr(memmap, "SMALLEST", 512)


@pytest.mark.whole
@pytest.mark.parametrize(("name", "image", "options", "parts"), CASES)
def test_scratch_files_do_not_matter(name, image, options, parts, tmp_path, small_arrays_too):
    model = tb.method(name, **(QUICK[name] | options)).fit(image)
    request = Request(SHAPE, seed=2, **parts)
    with check_releases():
        whole = values_of(model.make(request))
    with memmap.map_large_arrays(tmp_path, memory=1 << 16, thickest=7):
        made = values_of(model.make(request))
        assert memmap.file_of(made) is not None, "held in memory as a whole"
        assert np.array_equal(made, whole)
        del made
    assert not list(tmp_path.iterdir()), "files of arrays that nobody needs"


class StoppedError(Exception):
    """Somebody had enough."""


@pytest.mark.whole
@pytest.mark.parametrize(
    ("name", "image", "parts", "when"),
    [
        *(("kopf", LABELS, {}, when) for when in (2, 3, 4)),
        ("chen", LABELS, {}, 3),
        ("chen", GREY, {}, 4),
        *(("sliced", LABELS, {}, when) for when in (2, 3, 4)),
        ("sliced", LABELS, fixed(LABELS), 5),
    ],
)
def test_an_interrupted_run_goes_on_to_the_same_voxels(
    name, image, parts, when, tmp_path, monkeypatch
):
    """Stopped after any round: those before it are not made again."""
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    monkeypatch.setattr(checkpoint, "_SHARE", 0)
    model = tb.method(name, **QUICK[name]).fit(image)
    rounds = []

    def made(stop=None):
        rounds.clear()

        def listener(label, done):
            if 0 < done <= 1 and ("level" in label or "laying" in label):
                rounds.append(label)
                if len(rounds) == stop:
                    raise StoppedError

        with listen(listener), checkpoint.kept_at(tmp_path / "state"):
            return model.generate(SHAPE, seed=4, **parts).values

    whole = made()
    total = len(rounds)
    with pytest.raises(StoppedError):
        made(stop=when)
    assert (tmp_path / "state").exists()
    assert np.array_equal(made(), whole)
    assert len(rounds) == total - when
    assert not (tmp_path / "state").exists()


@pytest.mark.parametrize("axis", [0, 1, 2])
@given(
    values=hnp.arrays(np.int16, st.tuples(*[st.integers(1, 3)] * 1, *[st.integers(1, 7)] * 3)),
    thick=st.integers(1, 4),
)
@settings(max_examples=15, deadline=None)
def test_turned_arrays_come_back(axis, values, thick, tmp_path_factory):
    with memmap.map_large_arrays(tmp_path_factory.mktemp("turned"), memory=1 << 20, thickest=thick):
        seen = put_axis_first(values, axis)
        assert np.array_equal(seen, np.moveaxis(values, 1 + axis, 1))
        assert seen.flags.c_contiguous
        twice = values.copy()
        restore_axis_order(seen, axis, twice, add=True)
        assert np.array_equal(twice, values * 2)
        restore_axis_order(seen, axis, twice)
        assert np.array_equal(twice, values)


@pytest.mark.parametrize("wraps", [(False,) * 3, (True, False, True), (True, True, True)])
@pytest.mark.parametrize("thick", [1, 3])
def test_what_planes_say_does_not_depend_on_slabs(wraps, thick, tmp_path):
    """Thinner than a neighbourhood, and of a volume that wraps within one."""
    rng = np.random.default_rng(3)
    pictures = [rng.integers(-90, 91, (2, 1, 17 + n, 20)).astype(np.int8) for n in range(3)]
    views = [
        (axis, Candidates.of(Stack.of([p]), width=6, step=2, variance=0.9, most=8, flat=True))
        for axis, p in enumerate(pictures)
    ]
    histograms = tuple(Histogram.of(channel) for channel in pictures[0])
    frame = RegionViews.over(Region((9, 14, 12), wraps), views, histograms)
    matches = [random_matches(plane.grid, key(1, str(plane.axis))) for plane in frame.grids]
    weights = [rng.integers(0, 1000, match.shape).astype(np.int32) for match in matches]
    dear = [
        rng.integers(1, 9, plane.grid.candidates.stack.field.shape[1:]).astype(np.int32)
        for plane in frame.grids
    ]

    def said():
        votes = cast_plane_votes(frame, matches, weights, trim=1)
        return votes, *choose_pixels(frame, matches, weights, votes, costs=dear, trim=1)

    whole = said()
    with threads(2), memmap.map_large_arrays(tmp_path, memory=1 << 20, thickest=thick):
        for ours, theirs in zip(said(), whole, strict=True):
            assert np.array_equal(ours, theirs)


def test_a_field_itself_is_what_pixels_come_near_to():
    picture = np.random.default_rng(1).integers(-90, 91, (1, 1, 20, 20)).astype(np.int8)
    candidates = Candidates.of(
        Stack.of([picture]), width=6, step=2, variance=0.9, most=8, flat=True
    )
    frame = RegionViews.over(
        Region((8, 10, 12)), [(0, candidates), (2, candidates)], (Histogram.of(picture),)
    )
    matches = [random_matches(plane.grid, key(1, str(plane.axis))) for plane in frame.grids]
    weights = [np.ones(match.shape, np.int32) for match in matches]
    dear = [np.ones(picture.shape[1:], np.int32)] * 2
    field = np.random.default_rng(2).integers(-90, 91, (1, *frame.region.shape)).astype(np.int8)
    near, of_field = choose_pixels(frame, matches, weights, field, costs=dear)
    same, of_votes = choose_pixels(
        frame, matches, weights, field.astype(np.int16) * 256, costs=dear
    )
    assert np.array_equal(near, same)
    assert np.array_equal(of_field, of_votes)

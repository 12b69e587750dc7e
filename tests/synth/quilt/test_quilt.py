"""`quilt` as a whole: what it promises of fields, seams, connectivity, given voxels, and what it
refuses.
"""

import numpy as np
import pytest
from quilt_lattice import lattice, reference
from scipy import ndimage

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.engine import checkpoint
from trabecula.errors import InputError, RequestError
from trabecula.measure.labelling import label_components
from trabecula.synth.api.registry import recorded_method
from trabecula.synth.quilt.method import _gave_way_text
from trabecula.synth.quilt.patch_library import remove_unconnected

CELL = dict(patch=11, overlap=3, orientations="all")


@pytest.fixture(scope="module")
def cells():
    return tb.Image(reference(), "labels")


@pytest.fixture(scope="module")
def model(cells):
    return tb.method("quilt", **CELL).fit(cells)


@pytest.fixture(scope="module")
def section():
    """Return a picture of three phases: layers of a binder around grains."""
    rng = np.random.default_rng(3)
    field = ndimage.gaussian_filter(rng.random((90, 90)), 3)
    low, high = np.quantile(field, [0.45, 0.6])
    return tb.Image(
        (field > low).astype(np.uint8) + (field > high),
        "labels",
        phases=("void", "binder", "solid"),
    )


def ramp(shape, low, high):
    return np.broadcast_to(np.linspace(low, high, shape[0], dtype=np.float32)[:, None, None], shape)


def report(image):
    return image.recipe.steps[-1]["report"]


def windows(values, size=8, step=8):
    return [
        tuple(slice(at, at + size) for at in (z, y, x))
        for z in range(0, values.shape[0] - size + 1, step)
        for y in range(0, values.shape[1] - size + 1, step)
        for x in range(0, values.shape[2] - size + 1, step)
    ]


@pytest.mark.whole
def test_a_lattice_follows_its_field_in_step_and_in_one_piece(cells, model):
    field = ramp((64, 40, 32), 0.4, 0.65)
    made = model.generate(field.shape, seed=1, target={"volume_fraction": field})
    assert model.periods == (8.0, 8.0, 8.0)
    errors = [abs(made.values[box].mean() - field[box].mean()) for box in windows(made.values)]
    assert np.mean(errors) < 0.04 and np.max(errors) < 0.16
    assert ndimage.label(made.values)[1] == 1
    # Nodes of the lattice, where the reference is solid, are solid everywhere; its hollows are
    # hollow.
    phases = [np.indices(made.shape)[axis] % 8 for axis in range(3)]
    node = np.all([np.abs(phase - 3.5) < 1 for phase in phases], axis=0)
    hollow = np.all([np.abs((phase + 4) % 8 - 3.5) < 1 for phase in phases], axis=0)
    reference_node = np.all(
        [np.abs(np.indices(cells.shape)[axis] % 8 - 3.5) < 1 for axis in range(3)], axis=0
    )
    assert made.values[node].mean() == cells.values[reference_node].mean() == 1.0
    assert made.values[hollow].mean() < 0.02
    assert report(made)["gave_way"] == 0 and report(made)["mismatch"]["mean"] < 0.06


def test_porosity_asks_for_the_same_as_volume_fraction(model):
    field = ramp((24, 24, 24), 0.4, 0.6)
    one = model.generate(field.shape, seed=2, target={"volume_fraction": field})
    other = model.generate(field.shape, seed=2, target={"porosity": 1 - field})
    assert abs(float(one.values.mean()) - float(other.values.mean())) < 0.01


def test_all_neighbourhoods_with_their_own_fields_give_the_section_again(section):
    """Check figure 5: with the fields of the exemplar itself the patches find their own places;
    without, they do not.
    """
    from trabecula.fields.local import windowed

    model = tb.method(
        "quilt", patch=17, overlap=6, share=1.0, candidates=1 << 20, connected="none", alpha=0.5
    ).fit(section)
    own = {}
    for name in ("volume_fraction:binder", "volume_fraction:solid", "perimeter", "euler"):
        field = windowed(section, size=17, names=[name])[name]
        own[name] = np.pad(field, [(8, 8), (8, 8)], mode="edge")
    made = model.generate(section.shape, seed=1, target=own)
    free = model.generate(section.shape, seed=1)
    same = np.mean(made.values == section.values)
    assert same > 0.75 > np.mean(free.values == section.values)


@pytest.mark.whole
def test_repair_keeps_what_was_measured_and_continues_it():
    bone = tb.crop(tb.sample("bone"), 56)
    known = np.ones(bone.shape, bool)
    known[18:40, 18:40, 18:40] = False
    model = tb.method("quilt", patch=14, overlap=5).fit(tb.sample("bone"))
    made = model.generate(
        bone.shape,
        fixed=bone,
        known=known,
        seed=1,
        target={"volume_fraction": float(bone.values.mean())},
    )
    assert np.array_equal(made.values[known], bone.values[known])
    hole = made.values[18:40, 18:40, 18:40]
    assert abs(hole.mean() - bone.values.mean()) < 0.08
    # Across the rim neighbours differ hardly more often than they do in the material.
    rim = np.mean(made.values[17, 18:40, 18:40] != hole[0])
    inside = np.mean(bone.values[1:] != bone.values[:-1])
    assert rim < 3 * inside


def test_repair_in_two_dimensions(section):
    known = np.ones(section.shape, bool)
    known[30:60, 35:62] = False
    model = tb.method("quilt", patch=13, overlap=5, connected="none").fit(section)
    made = model.generate(section.shape, fixed=section, known=known, seed=1)
    assert np.array_equal(made.values[known], section.values[known])
    assert set(np.unique(made.values[30:60, 35:62])) == {0, 1, 2}


def test_a_form_is_filled_and_nothing_else(model):
    z, y, x = np.indices((40, 40, 40)) - 19.5
    ball = z**2 + y**2 + x**2 < 19**2
    made = model.generate(None, mask=ball, seed=1, target={"volume_fraction": 0.5})
    assert not made.values[~ball].any()
    assert abs(made.values[ball].mean() - 0.5) < 0.03
    assert label_components(made.values == 1)[1].size == 1


def test_a_tile_repeats_without_a_seam(model):
    made = model.generate((32, 32, 32), periodic=True, seed=1, target={"volume_fraction": 0.45})
    inside = np.mean([np.mean(np.diff(made.values, axis=axis) != 0) for axis in range(3)])
    for axis in range(3):
        assert np.mean(made.values.take(0, axis) != made.values.take(-1, axis)) < 1.5 * inside
    assert label_components(made.values == 1, periodic=True)[1].size == 1


@pytest.mark.whole
@pytest.mark.parametrize("connected", ["solid", "void", "both"])
def test_what_is_to_hang_together_does(connected):
    rng = np.random.default_rng(5)
    blobs = (ndimage.gaussian_filter(rng.random((48, 48, 48)), 1.6) > 0.5).astype(np.uint8)
    made = (
        tb.method("quilt", patch=12, overlap=5, connected=connected).fit(blobs).generate(40, seed=3)
    )
    assert report(made)["gave_way"] == 0
    if connected != "void":
        assert label_components(made.values == 1)[1].size == 1
    if connected != "solid":
        labels, sizes = label_components(made.values == 0)
        faces = np.concatenate(
            [np.unique(labels.take(end, axis)) for axis in range(3) for end in (0, -1)]
        )
        assert set(range(1, sizes.size + 1)) <= set(faces.tolist())


def bars():
    """Return bars side by side: no two of them can be connected."""
    values = np.zeros((36, 36, 36), np.uint8)
    for z, y in ((4, 5), (6, 20), (16, 12), (18, 29), (28, 4), (30, 22)):
        values[z : z + 5, y : y + 5] = 1
    return values


BARS = dict(patch=14, overlap=4, period="none", tries=3)


@pytest.mark.whole
def test_where_no_piece_fits_struts_make_one_body():
    made = tb.method("quilt", **BARS).fit(bars()).generate(40, seed=1)
    summary = report(made)
    assert summary["gave_way"] == 0 and summary["struts"] > 0
    assert 0 < summary["strut_voxels"] < 0.1 * made.values.sum()
    assert ndimage.label(made.values)[1] == 1


@pytest.mark.whole
@pytest.mark.parametrize("seed", range(2))
def test_sparse_bone_is_one_piece(seed):
    model = tb.method("quilt", patch=14, overlap=5, candidates=500).fit(
        tb.crop(tb.sample("bone"), 48)
    )
    made = model.generate(
        (40, 40, 48), seed=seed, target={"volume_fraction": ramp((40, 40, 48), 0.1, 0.25)}
    )
    assert report(made)["gave_way"] == 0
    assert ndimage.label(made.values)[1] == 1


@pytest.mark.whole
def test_where_there_is_no_path_it_says_so():
    """Check a wall of given void: its two sides can never be connected."""
    wall = np.zeros((30, 30, 44), bool)
    wall[:, :, 20:24] = True
    summary = []
    with listen(lambda line, done: summary.append(line)):
        request = dict(fixed=tb.Image(np.zeros(wall.shape, np.uint8), "labels"), known=wall, seed=1)
        made = tb.method("quilt", **BARS).fit(bars()).generate(wall.shape, **request)
    assert not made.values[wall].any()
    assert made.values[:, :, :20].any() and made.values[:, :, 24:].any()
    assert report(made)["gave_way"] > 0
    assert report(made)["gave_way_at"][0]["in"] == "connectivity"
    assert report(made)["loose"] > 0
    (line,) = (line for line in summary if "gave way in connectivity" in line)
    assert "connect the solid but for" in line and "finish.connect" in line


def arms():
    """Return a form whose arms part before bars in them meet."""
    form = np.zeros((34, 14, 30), bool)
    form[:6] = form[:, :, :12] = form[:, :, -12:] = True
    return form


def test_what_gave_way_is_joined_in_the_end():
    form, summary, made = arms(), [], {}
    for joins in (False, True):
        model = tb.method("quilt", **BARS, joins=joins).fit(bars())
        with listen(lambda line, done: summary.append(line)):
            made[joins] = model.generate(form.shape, seed=1, mask=form)
    before, after = made[False].values, made[True].values
    assert ndimage.label(before)[1] > 1 == ndimage.label(after)[1]
    told = report(made[True])
    assert told["gave_way"] == report(made[False])["gave_way"] > 0
    assert told["joins"] > 0 == told["loose"] and "joins" not in report(made[False])
    assert told["join_voxels"] == np.count_nonzero(before != after) < 0.15 * after.sum()
    assert (after >= before).all() and not after[~form].any()
    assert any(line.endswith("connect the solid") for line in summary)


@pytest.mark.parametrize(
    ("told", "end"),
    [
        ({}, "(finish.connect)"),
        ({"joins": 0, "join_voxels": 0, "loose": 0}, "the solid is one component all the same"),
        ({"joins": 2, "join_voxels": 9, "loose": 0}, "2 joins of 9 voxels connect the solid"),
        ({"joins": 2, "join_voxels": 9, "loose": 50}, "(finish.connect)"),
    ],
)
def test_a_line_says_what_became_of_places_that_gave_way(told, end):
    at = {"voxel": [0, 4, 8], "in": "connectivity"}
    line = _gave_way_text({"places": 30, "gave_way": 1, "gave_way_at": [at], **told})
    assert line.startswith("1 of 30 places gave way in connectivity") and line.endswith(end)
    assert ("but for 50 voxels" in line) == (told.get("loose") == 50)


def test_a_recipe_of_before_joins_nothing():
    assert not recorded_method("quilt", {"patch": 14}).config.joins
    assert tb.method("quilt").config.joins


def thin(made):
    """Count voxels in no 2-cube of solid; beyond the volume may be solid."""
    beyond = np.pad(made == 1, 1, constant_values=True)
    opened = np.zeros(beyond.shape, bool)
    for at in np.ndindex(tuple(side - 1 for side in beyond.shape)):
        cube = tuple(slice(first, first + 2) for first in at)
        if beyond[cube].all():
            opened[cube] = True
    return np.count_nonzero((made == 1) & ~opened[1:-1, 1:-1, 1:-1])


@pytest.mark.whole
def test_seams_leave_nothing_thin():
    """Check blocks of two voxels: patches that meet at odd distances leave slivers unless they are
    rejected.
    """
    blocks = reference(20).repeat(2, axis=0).repeat(2, axis=1).repeat(2, axis=2)
    made = {}
    for size in (1, 2):
        method = tb.method(
            "quilt",
            patch=11,
            overlap=4,
            period="none",
            connected="none",
            alpha=0.0,
            feature=size,
            tries=300,
        )
        made[size] = method.fit(blocks).generate(26, seed=1, target={"volume_fraction": 0.5})
    assert report(made[2])["gave_way"] == 0
    assert thin(made[2].values) == 0 < thin(made[1].values)


def test_two_exemplars_hold_more_than_one():
    thin, thick = (
        tb.Image(lattice(np.full((32, 32, 32), share)), "labels") for share in (0.35, 0.65)
    )
    with pytest.raises(RequestError, match="hold"):
        tb.method("quilt").fit(thin).generate(24, target={"volume_fraction": 0.65})
    made = (
        tb.method("quilt")
        .fit([thin, thick])
        .generate((48, 16, 16), target={"volume_fraction": ramp((48, 16, 16), 0.3, 0.7)})
    )
    assert made.values[:8].mean() < 0.45 and made.values[-8:].mean() > 0.55


def test_floating_solid_is_not_quilted():
    values = np.zeros((20, 20, 20), np.uint8)
    values[8:12] = 1
    values[3, 3, 3] = values[0, 0, 0] = 1
    found = remove_unconnected(tb.Image(values, "labels"), "solid")
    assert found[3, 3, 3] == 0 and found[0, 0, 0] == 1 and found[8:12].all()


def test_a_forecast_tells_what_is_out_of_reach(model):
    field = ramp((40, 24, 24), 0.5, 0.95)
    summary = model.forecast(tb.Request(field.shape, target={"volume_fraction": field}))
    low, high = summary.held["volume_fraction"]
    assert 0.25 < low < 0.45 and 0.65 < high < 0.85
    assert summary.asked["volume_fraction"] == (pytest.approx(0.5), pytest.approx(0.95))
    assert 0.2 < summary.outside < 0.7 and "volume_fraction asks for 0.5 .. 0.95" in summary.advice
    # Along the ramp the difference is none as far as the exemplar reaches, then what is missing
    # over its range.
    along = summary.difference[:, 0, 0]
    assert along[0] < 0.01 and along[-1] == pytest.approx(
        (field[-5:].mean() - high) / (high - low), abs=0.1
    )
    assert summary.to_json()["descriptors"]["max"] == pytest.approx(np.nanmax(summary.difference))
    assert model.forecast(tb.Request(24, target={"volume_fraction": 0.5})).advice == ""


def test_a_run_that_was_cut_off_goes_on(model, tmp_path, monkeypatch):
    field = ramp((40, 24, 24), 0.4, 0.7)
    request = tb.Request(field.shape, seed=4, target={"volume_fraction": field})
    whole = model.generate(request).values
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    stop = iter(range(100))

    def broken(*arguments, **arrays):
        offered(*arguments, **arrays)
        if next(stop) == 0:
            raise KeyboardInterrupt

    offered = checkpoint.offer
    monkeypatch.setattr(checkpoint, "offer", broken)
    with pytest.raises(KeyboardInterrupt), checkpoint.kept_at(tmp_path / "part"):
        model.generate(request)
    monkeypatch.setattr(checkpoint, "offer", offered)
    with checkpoint.kept_at(tmp_path / "part"):
        again = model.generate(request)
    assert np.array_equal(again.values, whole)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"patch": 8, "overlap": 8}, "not smaller than patch"),
        ({"patch": 41}, "needs at least 42"),
        ({"patch": 3}, "4 .. 64"),
        ({"weights": {"euler": -1}}, "weight of euler"),
        ({"connected": "bones"}, "connected"),
    ],
)
def test_settings_that_do_not_fit(cells, settings, words):
    with pytest.raises(InputError, match=words):
        tb.method("quilt", **settings).fit(cells)


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"target": {"volume_fraction": np.full((20, 20, 21), 0.5)}}, "shape"),
        ({"target": {"volume_fraction": np.full((20, 20, 20), np.nan)}}, "NaN"),
        ({"target": {"volume_fraction": 0.95}}, "hold 0"),
        ({"target": {"perimeter": 0.1}}, "perimeter"),
        ({"target": {"volume_fraction:binder": 0.1}}, "binder"),
        ({"periodic": True, "shape": 12}, "at least"),
        (
            {"mask": np.arange(20)[:, None, None] % 10 + np.zeros((20, 20, 20)) < 5},
            "2 connected components",
        ),
        ({"shape": (20, 20)}, "give 3 numbers"),
    ],
)
def test_requests_that_cannot_be_met_say_why(model, parts, words):
    shape = parts.pop("shape", 20) if isinstance(parts, dict) else 20
    with pytest.raises(InputError, match=words):
        model.generate(shape, seed=1, **parts)


def test_a_picture_asks_for_a_pictures_shape(section):
    with pytest.raises(RequestError, match="give 2 numbers"):
        tb.method("quilt", connected="none").fit(section).generate(20, seed=1)


def test_patches_are_chosen_by_their_two_point_function():
    fine, coarse = (np.indices((32, 32)).sum(axis=0) // width % 2 for width in (2, 6))
    sample = tb.Image(np.concatenate([fine, coarse], axis=1).astype(np.uint8), "labels")
    model = tb.method("quilt", patch=10, overlap=3, connected="none", period="none").fit(sample)
    far = tb.fields.windowed(sample, size=10, names=["two_point:2"])["two_point:2"]
    made = [
        model.generate((31, 31), seed=1, target={"volume_fraction": 0.5, "two_point:2": value})
        for value in (float(far.min()), float(far.max()))
    ]
    low, high = (
        tb.fields.windowed(one, size=10, names=["two_point:2"])["two_point:2"].mean()
        for one in made
    )
    assert low < 0.1 and high > 0.25


def plates():
    """Return plates along z beside plates across it, of one volume fraction."""
    z, y, x = np.indices((24, 24, 48))
    return tb.Image(np.where(x < 24, y // 2 % 2, z // 2 % 2).astype(np.uint8), "labels")


@pytest.mark.parametrize(
    "name", ["apparent_conductivity:z", "apparent_diffusivity:z", "apparent_stiffness:z"]
)
def test_patches_are_chosen_by_their_apparent_properties(name):
    model = tb.method("quilt", patch=8, overlap=2, connected="none", period="none").fit(plates())
    values = model.library.describe_patches(0, name)
    made = [
        model.generate(20, seed=1, target={"volume_fraction": 0.5, name: float(value)})
        for value in (values.min(), values.max())
    ]
    low, high = (tb.fields.windowed(one, size=8, names=[name])[name].mean() for one in made)
    assert low < 0.1 and high > 0.35


def test_turned_copies_have_the_apparent_properties_that_they_are_measured_to_have():
    values = (np.random.default_rng(1).random((9, 10, 11)) < 0.6).astype(np.uint8)
    config = dict(patch=8, overlap=2, connected="none", orientations="all")
    library = tb.method("quilt", **config).fit(tb.Image(values, "labels")).library
    for name in ("apparent_conductivity:z", "apparent_conductivity:x", "apparent_conductivity"):
        for number in (0, 5, 17, 30, 47):
            found = tb.fields.windowed(library.images[number], size=8, names=[name])[name]
            assert np.allclose(library.describe_patches(number, name), found, atol=2e-3)
    assert len(library.apparent) == 4  # each axis of the exemplar once, and the mean


def test_apparent_properties_beside_turned_material_are_refused(cells, section):
    model = tb.method("quilt", patch=11, overlap=3).fit(cells)
    target = {"apparent_stiffness:z": 0.1, "orientation": (0, 0, 1)}
    with pytest.raises(RequestError, match="ask for it without orientation and size"):
        model.generate(20, seed=1, target=target)
    flat = tb.method("quilt", connected="none").fit(section)
    with pytest.raises(RequestError, match="is one of volumes, the exemplar is 2-D"):
        flat.generate((40, 40), seed=1, target={"apparent_conductivity": 0.1})


def test_methods_without_windows_refuse_apparent_properties():
    model = tb.method("texture", preset="fast").fit(tb.crop(tb.sample("bone"), 40))
    with pytest.raises(RequestError, match="cannot honour the target apparent_stiffness:z"):
        model.generate(20, seed=1, target={"apparent_stiffness:z": 0.1})

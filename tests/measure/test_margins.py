"""Margins without material: what is found, and what is material although it looks bare."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.exemplar.margins import crop_margins, find_margins, margin_note
from trabecula.measure.smooth import gaussian

SIDE = 64
Z = np.arange(SIDE)[:, None, None]


def field(seed=0, *, shape=(SIDE,) * 3, sigma=2.0, fraction=0.4):
    """Return a Gaussian field cut at a level: material without margins."""
    noise = (
        np.random.default_rng(seed)
        .normal(size=tuple(side + 32 for side in shape))
        .astype(np.float32)
    )
    lifted = noise if noise.ndim == 3 else noise[None]
    smooth = gaussian(lifted, np.array([sigma if noise.ndim == 3 else 0.0, sigma, sigma]))
    smooth = smooth if noise.ndim == 3 else smooth[0]
    smooth = smooth[tuple(slice(16, 16 + side) for side in shape)]
    return (smooth > np.quantile(smooth, 1 - fraction)).astype(np.uint8)


def grey(labels, seed=1):
    noise = np.random.default_rng(seed).normal(0, 10, labels.shape)
    return (60 + 100.0 * labels + noise).clip(0, 255).astype(np.uint8)


def image(values):
    return tb.Image(values, "labels")


@pytest.mark.parametrize("planes", [1, 2, 6, 12])
@pytest.mark.parametrize("value", [0, 1])
@pytest.mark.parametrize(("axis", "end"), [(0, "first"), (1, "last"), (2, "first")])
def test_blank_planes_are_found(planes, value, axis, end):
    values = field()
    np.moveaxis(values, axis, 0)[slice(planes) if end == "first" else slice(-planes, None)] = value
    (face,) = find_margins(image(values)).faces
    assert (face.axis, face.end, face.planes, face.blank) == ("zyx"[axis], end, planes, True)
    assert face.value == ("void", "solid")[value]


@pytest.mark.whole
def test_material_has_none():
    for seed in range(6):
        for sigma in (0.7, 2.0, 4.0):
            for fraction in (0.05, 0.2, 0.5, 0.9):
                assert not find_margins(image(field(seed, sigma=sigma, fraction=fraction)))
                picture = field(seed, shape=(160, 120), sigma=sigma, fraction=fraction)
                assert not find_margins(image(picture))
                assert not find_margins(tb.Image(grey(picture), "grey"))


def test_layers_ramps_lattices_and_walls_are_material():
    layers = np.broadcast_to(Z // 8 % 2, (SIDE,) * 3).astype(np.uint8)
    assert not find_margins(image(layers))
    voids = field()
    for first in (0, 20, 44):
        voids[first : first + 4] = 0
    assert not find_margins(image(voids))
    walls = np.zeros((SIDE,) * 3, np.uint8)
    walls[::9] = walls[:, ::9] = walls[:, :, ::9] = 1
    assert not find_margins(image(walls))
    noise = np.random.default_rng(0).normal(size=(SIDE,) * 3).astype(np.float32)
    for steepness in (16, 12):  # with blank planes at its ends where it is steep
        ramp = gaussian(noise, np.full(3, 2.0)) * 8 > (Z - 32) / steepness
        assert ramp[-1].mean() < 0.02 < 0.98 < ramp[0].mean()
        assert not find_margins(image(ramp.astype(np.uint8)))


@pytest.mark.whole
@pytest.mark.parametrize("name", ["bone", "foam"])
def test_samples_have_none(name):
    assert not find_margins(tb.sample(name)) and margin_note(tb.sample(name)) is None


def test_a_rough_surface_in_air():
    noise = np.random.default_rng(3).normal(size=(1, SIDE, SIDE)).astype(np.float32)
    height = 18 + 40 * gaussian(noise, np.array([0.0, 4.0, 4.0]))[0]
    values = np.where(height < Z, field(), 0).astype(np.uint8)
    (face,) = find_margins(image(values)).faces
    assert face.end == "first" and face.planes >= np.argmax(values.any(axis=(1, 2))) > 4


def test_one_body_on_blank_ground_is_not_called_material():
    ball = np.hypot(*np.meshgrid(np.arange(SIDE) - 20, np.arange(SIDE) - 44)) < 8
    assert not find_margins(image(ball.astype(np.uint8)))


def test_a_round_field_of_view():
    y, x = np.mgrid[:SIDE, :SIDE] - (SIDE - 1) / 2
    values = field()
    values[:, np.hypot(y, x) > SIDE / 2] = 0
    found = find_margins(image(values))
    assert found.round_axis == "z" and found.size[0] == SIDE
    kept = crop_margins(image(values))
    assert not find_margins(kept) and kept.shape[1] == kept.shape[2] == pytest.approx(
        SIDE / np.sqrt(2), abs=4
    )
    padded = find_margins(image(np.pad(values, 5)))
    assert padded.round_axis == "z" and padded.corner[0] == 5 and min(padded.corner[1:]) >= 5 + 9
    assert (
        find_margins(
            tb.Image(np.where(np.hypot(y, x) > SIDE / 2, 0, grey(field())), "grey")
        ).round_axis
        == "z"
    )


def test_grey_frames_and_noise():
    values = grey(field())
    assert not find_margins(tb.Image(values, "grey"))
    values[:, -2:] = 0
    # air
    values[:3] = (60 + np.random.default_rng(0).normal(0, 5, values[:3].shape)).astype(np.uint8)
    found = {
        (face.axis, face.end): face.planes for face in find_margins(tb.Image(values, "grey")).faces
    }
    assert found == {("z", "first"): 3, ("y", "last"): 2}


def test_a_bar_below_a_micrograph():
    picture = grey(field(shape=(140, 160)))
    bar = np.zeros((20, 160), np.uint8)
    bar[5:15, 10:60:3] = 255
    for kind, values in (
        ("grey", np.r_[picture, bar]),
        ("colour", np.repeat(np.r_[picture, bar][..., None], 3, -1)),
    ):
        (face,) = find_margins(tb.Image(values, kind)).faces
        assert (face.axis, face.end, face.planes, face.blank) == ("y", "last", 20, False)
        assert (
            str(find_margins(tb.Image(values, kind)))
            == "the last 20 lines along y are unlike all others"
        )
        assert crop_margins(tb.Image(values, kind)).shape == (140, 160)


def test_the_note_says_what_it_does_to_the_porosity():
    values = np.pad(field(), 1)
    note = margin_note(image(values))
    with_them, without = (values == 0).mean(), (values[1:-1, 1:-1, 1:-1] == 0).mean()
    assert note == (
        "the first and the last plane along z, y, x hold void alone: crop them (--crop auto, "
        "tb.crop_margins), or they "
        f"count as material; porosity {with_them:.3f} with them, {without:.3f} without"
    )


def test_of_phases_without_void():
    values = field() + field(5, fraction=0.1) * 2
    values[-2:] = 2
    found = tb.Image(values, "labels", phases=("pore", "active", "binder", "both"))
    assert "the last 2 planes along z hold binder alone" in margin_note(found)
    assert "fraction of pore" in margin_note(found)


def test_more_than_a_third_is_no_margin():
    values = field()
    values[: SIDE // 2] = 0
    assert not any(face.axis == "z" for face in find_margins(image(values)).faces)


def test_the_crop_is_recorded_and_the_rest_stays():
    scan = tb.Image(np.pad(field(), 2), "labels", (3, 2, 1), "um", ("marrow", "bone"))
    kept = crop_margins(scan)
    np.testing.assert_array_equal(kept.values, field())
    assert (kept.spacing, kept.unit, kept.phases) == (scan.spacing, scan.unit, scan.phases)
    step = kept.recipe.steps[-1]
    assert (step["verb"], step["size"], step["corner"]) == ("crop", [SIDE] * 3, [2] * 3)
    assert crop_margins(kept) is kept


def test_small_and_uniform_images():
    assert not find_margins(np.zeros((8, 8), np.uint8))
    assert not find_margins(np.zeros((40, 40, 40), np.uint8))
    assert not find_margins(np.random.default_rng(0).integers(0, 2, (3, 40, 40)))
    assert not find_margins(tb.Image(np.full((40, 40), 7.0), "grey"))


@pytest.mark.parametrize("name", ["a", "b", "cortex_a"])
def test_bone_scans_have_six_blank_planes(data, name):
    found = find_margins(tb.read(data / f"trabecular_bone_{name}.tif"))
    assert found.size == (199,) * 3 and found.corner == (1,) * 3 and len(found.faces) == 6


@pytest.mark.parametrize(
    "file",
    [
        *(
            "berea_sandstone_a.tif",
            "nmc_electrode_a.tif",
            "cement_air_voids.tif",
            "electrode_3phase_a.tif",
        ),
        *(
            "battery_cathode_lowres.tif",
            "fibre_composite_weave.tif",
            "polymer_fibres.tif",
            "soil_sand_a.tif",
        ),
        *(
            "trabecular_bone_grey_lhdl.tif",
            "tex_brick.png",
            "tex_gravel.png",
            "bread_baguette2.png",
        ),
        *(
            "micrograph_sandstone.png",
            "micrograph_composite.png",
            "sofc_anode_2d.png",
            "sandstone_grey_slice.png",
        ),
    ],
)
def test_these_scans_have_none(data, file):
    assert not find_margins(tb.read(data / file))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("shape", [(40, 1, 30), (40, 30, 1), (40, 2)])
def test_planes_of_one_voxel_have_quarters(shape):
    from trabecula.measure.margins import _quarters

    values = np.random.default_rng(4).integers(0, 2, shape).astype(np.uint8)
    for label in (0, None):
        assert np.isfinite(_quarters(values, 0, label)).all()

"""Stills: what is drawn, where, in which light; the same bytes every time."""

import numpy as np
import pytest
from PIL import Image as Pillow

import trabecula as tb
from trabecula.core.errors import InputError, MemoryBudgetError, UnknownNameError
from trabecula.engine.parallel import threads
from trabecula.view.looks import LOOKS, phase_colours, to_linear, to_srgb
from trabecula.view.scene import _as_drawable, place_camera, viewer_direction

BACKGROUND = np.array(LOOKS["bone"].background)
SMALL = (160, 120)


def foam(side=24, seed=0):
    noise = np.random.default_rng(seed).normal(size=(side,) * 3)
    for axis in range(3):
        noise = sum(np.roll(noise, shift, axis) for shift in range(-2, 3))
    return noise > 0


def material_mask(still):
    """Return (H, W) bool: the material, without the scale bar below it."""
    mask = np.abs(still.values.astype(int) - BACKGROUND).max(axis=-1) > 12
    mask[-max(30, still.shape[0] // 8) :, : still.shape[1] // 2] = False
    return mask


def extent(mask):
    rows, columns = np.nonzero(mask)
    return np.ptp(rows) + 1, np.ptp(columns) + 1


def test_an_empty_volume_is_background_and_scale_bar_alone():
    still = tb.render(np.zeros((20, 20, 20), bool), size=SMALL)
    assert still.kind == "colour" and still.shape == (120, 160)
    assert not material_mask(still).any()
    assert (still.values[-30:, :60] != BACKGROUND).any()


def test_a_porous_volume_fills_its_silhouette_with_light_and_shade():
    still = tb.render(foam(), size=SMALL)
    mask = material_mask(still)
    assert 0.2 < mask.mean() < 0.7
    assert still.values[mask].std() > 15
    assert still.values[mask].min(axis=0).max() > 15  # nothing is black


def test_faces_of_a_solid_cube_are_flat_and_lit_from_above():
    still = tb.render(np.ones((30, 30, 30), bool), size=(300, 300), cut="none", camera=(45, 35))
    values = still.values.astype(float)
    top, left, right = values[60:80, 140:160], values[170:190, 80:100], values[170:190, 200:220]
    for face in (top, left, right):
        assert face.std(axis=(0, 1)).max() < 2
        assert np.abs(face.mean(axis=(0, 1)) - BACKGROUND).max() > 25
    assert top.mean() > left.mean() + 10 > right.mean() + 20


def test_a_cut_face_through_pores_is_as_flat_as_the_solid():
    """Use the normal of the face: the gradient there would shade it speckled or black."""
    solid = foam(24, seed=5)
    # no light from within
    still = tb.render(solid, size=(240, 240), cut="none", camera=(0, 0), look="stone")
    voxels = solid[::-1, 0, :]  # looking along y, z up
    inner = np.zeros_like(voxels)
    inner[1:-1, 1:-1] = True
    for axis in (0, 1):
        for step in (-1, 0, 1):
            inner &= np.roll(voxels, step, axis)
    mask = material_mask(still)
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    across = (columns[-1] - columns[0] + 1) / 24
    k, i = np.nonzero(inner)
    at_row, at_column = (
        (rows[0] + (k + 0.5) * across).astype(int),
        (columns[0] + (i + 0.5) * across).astype(int),
    )
    assert len(k) > 20
    face = still.values[at_row, at_column].astype(float)
    assert face.std(axis=0).max() < 2


def test_the_corner_is_cut_towards_the_viewer_and_shows_the_inside():
    solid = np.ones((30, 30, 30), np.uint8)
    solid[10:20, 10:20, 10:20] = 2
    whole, opened = (
        tb.render(solid, size=SMALL, cut=cut, camera=(45, 30)).values.astype(int)
        for cut in ("none", "corner")
    )

    def blue(values):
        return np.sum(values[..., 2] > values[..., 0] + 15)

    assert blue(whole) == 0 and blue(opened) > 50
    back = tb.render(solid, size=SMALL, camera=(225, 30)).values.astype(int)
    # the block looks the same from the other side
    np.testing.assert_allclose(back, opened, atol=12)


@pytest.mark.parametrize(
    ("cut", "rows", "columns"),
    [("z=0.25", 0.25, 1), (["x=0.75", "z=0.5"], 0.5, 0.75), ("plane=90,0,0.6", 1, 0.6)],
)
def test_planes_take_away_what_lies_beyond_them(cut, rows, columns):
    cube = np.ones((24, 24, 24), bool)
    whole, left = (
        extent(material_mask(tb.render(cube, size=(200, 200), cut=each, camera=(0, 0))))
        for each in ("none", cut)
    )
    assert left[0] == pytest.approx(rows * whole[0], abs=2) and left[1] == pytest.approx(
        columns * whole[1], abs=2
    )


def test_a_free_plane_shows_a_flat_face_of_its_own():
    cube = np.ones((30, 30, 30), bool)
    still = tb.render(cube, size=(240, 240), cut="plane=20,30,0.5", camera=(20, 30)).values.astype(
        float
    )
    face = still[100:130, 100:140]  # it faces the viewer
    assert face.std(axis=(0, 1)).max() < 2
    turned = tb.render(
        cube, size=(240, 240), cut=["plane=20,30,0.7", "corner"], camera=(20, 30)
    ).values.astype(float)
    assert np.abs(turned - still).mean() > 1


def test_light_goes_through_a_thin_wall_of_bread_and_not_of_stone():
    def below(thick, look):
        """Return the brightness of the underside's middle, which the lamp does not reach."""
        size, box = (160, 160), np.array([24.0, 24.0, thick])
        still = tb.render(
            np.ones((thick, 24, 24), bool), size=size, cut="none", camera=(0, -12), look=look
        )
        camera = place_camera((0, -12), box, size, margin=8, foot=19)
        offset = np.array([12.0, 12.0, 0.0]) - camera.corner
        column, row = (
            round(float(way @ offset / camera.pixel)) for way in (camera.right, -camera.up)
        )
        return still.values[row - 2 : row + 3, column - 2 : column + 3].mean()

    assert below(2, "bread") > below(24, "bread") + 8
    assert below(2, "stone") == pytest.approx(below(24, "stone"), abs=2)


def test_the_rougher_the_surface_the_wider_and_weaker_its_highlight():
    from trabecula.view import shading

    term = shading.specular_term.py_func
    squarely, aside = (
        np.array([term(rough, 0.5, 0.9, 0.9, to_half, 0.9) for rough in (0.3, 0.6, 0.9)])
        for to_half in (1.0, 0.8)
    )
    assert (np.diff(squarely) < 0).all() and (np.diff(aside / squarely) > 0).all()


def test_no_more_light_is_reflected_than_falls_in():
    """Sum the diffuse and specular terms over all directions to a viewer, light falling in at 30
    degrees.
    """
    from trabecula.view import shading

    lamp = np.array([0.5, 0, np.sqrt(0.75)])
    up, round_ = np.meshgrid((np.arange(40) + 0.5) / 40, np.arange(60) * np.pi / 30)
    flat = np.sqrt(1 - up**2)
    for rough in (0.3, 0.6, 1.0):
        total = 0.0
        for x, y, z in zip(
            (flat * np.cos(round_)).ravel(),
            (flat * np.sin(round_)).ravel(),
            up.ravel(),
            strict=True,
        ):
            half = lamp + np.array([x, y, z])
            half /= np.linalg.norm(half)
            between = float(lamp @ half)
            sent = shading.specular_term.py_func(rough, 1.0, lamp[2], z, half[2], between)
            total += z * sent
        # Schlick's base of 0.08, and a little more at grazing angles
        assert 0.02 < 2 * total / up.size < 0.12


def test_a_turntable_turns_once_and_keeps_its_scale(tmp_path):
    post = np.zeros((16, 16, 16), bool)
    post[:, 1:5, 1:5] = True
    path = tb.view.still.turntable(
        post, tmp_path / "turn.gif", frames=4, seconds=2, size=(80, 64), cut="none", camera=(0, 0)
    )
    with Pillow.open(path) as moving:
        assert moving.n_frames == 4 and moving.info["duration"] == 500 and moving.info["loop"] == 0
        frames = []
        for k in range(4):
            moving.seek(k)
            frames.append(
                np.abs(np.asarray(moving.convert("RGB")).astype(int) - BACKGROUND).max(axis=-1)[:40]
                > 40
            )
    middles = [np.nonzero(frame)[1].mean() - 39.5 for frame in frames]
    assert middles[0] < -5 and middles[1] < -5 and middles[2] > 5 and middles[3] > 5
    assert len({extent(frame)[0] for frame in frames}) == 1


def test_the_camera_turns_around_z():
    post = np.zeros((24, 24, 24), bool)
    post[:, 2:8, 2:8] = True  # low x, low y: front left of a viewer at -y

    def middle(azimuth):
        return (
            np.nonzero(
                material_mask(tb.render(post, size=(120, 120), cut="none", camera=(azimuth, 0)))
            )[1].mean()
            - 59.5
        )

    assert middle(0) < -20 and middle(90) < -20 and middle(180) > 20 and middle(270) > 20
    lid = np.zeros((24, 24, 24), bool)
    lid[18:] = True
    rows = np.nonzero(material_mask(tb.render(lid, size=(120, 120), cut="none", camera=(0, 0))))[0]
    assert rows.max() < 60  # high z is up


def test_spacing_stretches_the_picture():
    block = np.ones((20, 20, 20), bool)
    plain = extent(material_mask(tb.render(block, size=(200, 200), cut="none", camera=(0, 0))))
    tall = extent(
        material_mask(
            tb.render(
                tb.Image(block, "labels", spacing=(2, 1, 1)),
                size=(200, 200),
                cut="none",
                camera=(0, 0),
            )
        )
    )
    assert plain[0] == pytest.approx(plain[1], abs=2)
    assert tall[0] == pytest.approx(2 * tall[1], abs=3)


def test_a_pixel_has_the_length_that_the_image_says():
    image = tb.Image(np.ones((20, 30, 40), bool), "labels", spacing=(3.0, 2.0, 1.5), unit="um")
    still = tb.render(image, size=(200, 160), cut="none", camera=(0, 0))
    rows, columns = extent(material_mask(still))
    assert still.unit == "um"
    assert columns * still.spacing[1] == pytest.approx(60, abs=2 * still.spacing[1])
    assert rows * still.spacing[0] == pytest.approx(60, abs=2 * still.spacing[0])


def test_a_ball_keeps_its_size_and_is_round():
    ball = sum((axis - 19.5) ** 2 for axis in np.indices((40,) * 3)) < 15.0**2
    still = tb.render(ball, size=(200, 200), cut="none", camera=(20, 30))
    mask = material_mask(still)
    assert mask.sum() * still.spacing[0] ** 2 == pytest.approx(np.pi * 15**2, rel=0.03)
    assert extent(mask)[0] == pytest.approx(extent(mask)[1], abs=2)
    # Smooth normals: along the lit side neighbouring pixels differ by little (a staircase would
    # jump).
    row = still.values[100, 80:120].astype(int).sum(axis=-1)
    assert np.abs(np.diff(row)).max() < 25


def test_the_same_voxels_give_the_same_bytes_for_any_number_of_threads(tmp_path):
    pictures = []
    for index, count in enumerate((1, 2, 1)):
        with threads(count):
            tb.render(foam(), tmp_path / f"{index}.png", size=SMALL)
        pictures.append((tmp_path / f"{index}.png").read_bytes())
    assert pictures[0] == pictures[1] == pictures[2]


def test_the_file_holds_the_picture_and_its_recipe(tmp_path):
    still = tb.render(foam(), tmp_path / "still.png", size=SMALL, look="stone", camera=(10, 20))
    with Pillow.open(tmp_path / "still.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), still.values)
    read = tb.read(tmp_path / "still.png")
    assert read.kind == "colour" and read.recipe.to_json() == still.recipe.to_json()
    step = read.recipe.to_json()[-1]
    assert (step["verb"], step["look"], step["camera"]) == ("render", "stone", [10, 20])


def test_phases_have_their_colours_and_can_be_chosen():
    values = np.zeros((20, 20, 20), np.uint8)
    values[:, :, :10], values[:, :, 10:] = 1, 2
    both = tb.render(values, size=(120, 120), cut="none", camera=(0, 0)).values.astype(int)
    assert both[60, 30, 0] > both[60, 30, 2] + 15 and both[60, 90, 2] > both[60, 90, 0] + 15
    one = material_mask(
        tb.render(values, size=(120, 120), cut="none", camera=(0, 0), phase="phase2")
    )
    assert not one[:, :55].any() and one[60, 90]


def test_no_phase_is_void_by_its_number():
    image = tb.Image(np.zeros((8, 8, 8), np.uint8), "labels", phases=("grain", "void"))
    assert material_mask(tb.render(image, size=SMALL)).any()


def test_every_look_differs_and_phases_of_a_look_do():
    stills = {name: tb.render(foam(), size=(64, 48), look=name).values for name in LOOKS}
    assert len({picture.tobytes() for picture in stills.values()}) == len(LOOKS)
    image = tb.Image(np.arange(8, dtype=np.uint8).reshape(2, 2, 2), "labels")
    for look in LOOKS.values():
        colours = phase_colours(image, look).astype(int)
        apart = np.abs(colours[:, None] - colours).sum(axis=-1) + 1000 * np.eye(8)
        assert apart.min() > 40


def test_grey_needs_its_threshold():
    grey = tb.Image(foam().astype(np.float32) * 7 + 1, "grey")
    with pytest.raises(InputError, match="threshold"):
        tb.render(grey)
    labels = tb.render(foam(), size=SMALL).values
    np.testing.assert_array_equal(tb.render(grey, size=SMALL, threshold=4).values, labels)


def test_colours_go_to_linear_light_and_back():
    values = np.arange(256)
    np.testing.assert_array_equal(to_srgb(to_linear(values)), values)


def test_the_whole_box_is_in_the_picture_from_everywhere():
    extent_ = np.array([30.0, 20.0, 50.0])
    for azimuth in range(0, 360, 25):
        for elevation in (-90, -30, 0, 45, 90):
            camera = place_camera((azimuth, elevation), extent_, (300, 200), margin=10, foot=12)
            np.testing.assert_allclose(np.cross(camera.right, camera.up), camera.viewer, atol=1e-12)
            for corner in np.ndindex(2, 2, 2):
                offset = np.array(corner) * extent_ - camera.corner
                column, row = (
                    offset @ camera.right / camera.pixel,
                    -(offset @ camera.up) / camera.pixel,
                )
                assert 9 <= column <= 290 and 9 <= row <= 178


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"look": "bones"}, "did you mean 'bone'"),
        ({"cut": "corners"}, "did you mean 'corner'"),
        ({"cut": ["x=0.5", "corners"]}, "did you mean 'corner'"),
        ({"phase": "sold"}, "did you mean 'solid'"),
    ],
)
def test_an_unknown_name_suggests_the_nearest(options, message):
    with pytest.raises(UnknownNameError, match=message):
        tb.render(foam(8), **options)


@pytest.mark.parametrize(
    ("image", "options", "message"),
    [
        (np.ones((4, 4), bool), {}, "needs a volume"),
        (tb.Image(np.zeros((4, 4, 4, 3), np.uint8), "colour"), {"phase": 1}, "has its own"),
        (np.ones((4, 4, 4), bool), {"size": (8, 600)}, "16..8192"),
        (np.ones((4, 4, 4), bool), {"camera": (0, 91)}, "elevation"),
        (np.ones((4, 4, 4), bool), {"camera": "front"}, "azimuth"),
        (np.ones((4, 4, 4), bool), {"threshold": 1}, "for grey"),
        (np.ones((4, 4, 4), bool), {"phase": []}, "phase is empty"),
        (np.ones((4, 4, 4), bool), {"cut": "x=1.5"}, "a share 0..1"),
        (np.ones((4, 4, 4), bool), {"cut": "plane=30"}, "plane=AZ,EL"),
        (np.ones((4, 4, 4), bool), {"cut": "corner=1"}, "write corner"),
        (np.ones((4, 4, 4), bool), {"cut": ["none", "x"]}, "none alone"),
        (np.ones((4, 4, 4), bool), {"cut": []}, "none alone"),
    ],
)
def test_what_cannot_be_drawn_is_refused(image, options, message):
    with pytest.raises(InputError, match=message):
        tb.render(image, **options)


def test_another_suffix_than_png_is_refused_and_leaves_nothing(tmp_path):
    with pytest.raises(InputError, match=r"\.png"):
        tb.render(foam(8), tmp_path / "still.jpg", size=SMALL)
    assert not list(tmp_path.iterdir())


def test_a_volume_beyond_memory_is_refused(monkeypatch):
    monkeypatch.setattr("trabecula.engine.memory.available_memory", lambda: 1000)
    with pytest.raises(MemoryBudgetError, match="render a crop"):
        tb.render(foam(8))


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 30, 30), (3, 5, 70)])
def test_thin_volumes_are_drawn(shape):
    assert material_mask(tb.render(np.ones(shape, bool), size=SMALL)).any()


def test_azimuth_carries_the_viewer_to_the_right():
    """From (0, 0) the viewer looks along y, x to the right; a quarter turn on he is at x."""
    assert np.allclose(viewer_direction(0, 0), (0, -1, 0))
    assert np.allclose(viewer_direction(90, 0), (1, 0, 0))
    assert np.allclose(viewer_direction(90, 90), (0, 0, 1))


def test_what_lies_at_the_threshold_is_drawn():
    grey = tb.Image(np.array([[[4, 5, 6]]]), "grey")
    assert _as_drawable(grey, 5).values.tolist() == [[[0, 1, 1]]]


@pytest.mark.whole
def test_a_field_colours_what_is_drawn():
    """A ramp along x: dark to the left, yellow to the right; every other volume is unchanged."""
    cube = tb.Image(np.ones((24, 24, 24), bool), "labels", unit="um")
    field = tb.fields.ramp((24, 24, 24), axis="x", start=-3, end=5)
    given = {"size": (320, 240), "cut": "none", "camera": (0, 0)}
    still = tb.render(cube, field=field, **given)
    across = still.values[80:120].astype(float).mean(axis=0)
    inside = np.abs(across - BACKGROUND).max(axis=1) > 40
    left, right = across[inside][4], across[inside][-5]
    assert left[2] > left[1] and right[0] > right[2] + 60 and right[1] > left[1] + 60
    legend = still.values[-60:, 200:]
    assert len(np.unique(legend.reshape(-1, 3), axis=0)) > 40
    plain = tb.render(cube, **given)
    assert "field" not in plain.recipe.steps[-1]
    clipped = tb.render(cube, field=field, limits=(5, 6), **given)
    flat = clipped.values[80:120, 100:200].reshape(-1, 3)
    assert flat.std(axis=0).max() < 2  # all in the first colour
    for wrong in (cube, tb.fields.ramp((24, 24, 12), start=0, end=1)):
        with pytest.raises(InputError, match="grey Image of the volume's shape"):
            tb.render(cube, field=wrong)
    with pytest.raises(InputError, match="do not rise"):
        tb.render(cube, field=field, limits=(1, 1))

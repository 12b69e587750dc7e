"""Traced stills: smooth surfaces, energy, known shading, the same picture every time."""

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Pillow

import trabecula as tb
from trabecula.core.errors import InputError, UnknownNameError
from trabecula.engine.parallel import threads
from trabecula.view.colours import form_of
from trabecula.view.looks import to_linear
from trabecula.view.scene import make_cut, viewer_direction
from trabecula.view.trace import photograph
from trabecula.view.trace.film import average_noise, develop
from trabecula.view.trace.framing import frame_camera, kept_blocks
from trabecula.view.trace.material import (
    TRACED,
    PhaseMaterial,
    find_traced,
    material_rows,
    plain_look,
)
from trabecula.view.trace.rim import rim_depths
from trabecula.view.trace.space import BLOCK, FURTHEST, find_blocks, spread_blocks
from trabecula.view.trace.surface import STEPS, smooth_surface

SMALL = (48, 36)
SOLID = np.zeros(256, np.uint8)
SOLID[1] = 1


def ball(side=40, radius=15.0):
    places = np.indices((side,) * 3) - (side - 1) / 2
    return (np.sqrt((places**2).sum(axis=0)) < radius).astype(np.uint8)


def foam(side=24, seed=0):
    noise = np.random.default_rng(seed).normal(size=(side,) * 3)
    for axis in range(3):
        noise = sum(np.roll(noise, shift, axis) for shift in range(-2, 3))
    return (noise > 0).astype(np.uint8)


def uniform_light(radiance=1.0):
    """Return a sky of one radiance all round, no lamp, no ground."""
    light = np.zeros((11, 4))
    light[0] = 0, 0, 1, 1
    light[2:5, :3] = radiance
    light[7] = 0, 0, 1, -1e9
    light[8, :3] = -1
    light[10, 3] = 1e9
    return light


def exposed(labels, material, light, *, samples=16, size=SMALL, angles=(30.0, 25.0), lens=20.0):
    """Return the mean radiance, the features and the framing of a picture in that light."""
    stretch = np.ones(3)
    cut = make_cut(("none",), labels.shape[::-1], stretch, viewer_direction(*angles))
    space = photograph.prepare_space(labels, [1], stretch, cut)
    points, kept = kept_blocks(space.skip, stretch, cut)
    framing = frame_camera(points, kept, angles, "z", size, lens=lens, aperture=0.0, focus=0.3)
    rows = np.repeat(material.row(framing.extent)[None], 2, axis=0)
    halves, features = photograph.expose(space, rows, [1], light, framing.lens, size, samples)
    return halves.mean(axis=0), features, framing


def test_smoothing_moves_no_voxel_to_the_other_side():
    labels = foam()
    assert np.array_equal(smooth_surface(labels, SOLID) > 0, labels > 0)


def test_a_slanting_wall_of_two_voxels_keeps_its_thickness():
    z, _, x = np.indices((24, 24, 40))
    wall = (np.abs(z - 8 - 0.2 * x) < 1).astype(np.uint8)
    field = smooth_surface(wall, SOLID) / STEPS
    # along z between voxel middles the field is linear: lengths above zero
    column = field[:, 12, 6:34]
    below, above = column[:-1], column[1:]
    share = np.where((below > 0) & (above > 0), 1.0, 0.0)
    mixed = (below > 0) != (above > 0)
    share[mixed] = np.maximum(below, above)[mixed] / np.abs(above - below)[mixed]
    thick = share.sum(axis=0)
    assert thick.min() > 1.2 and thick.mean() == pytest.approx(2.0, abs=0.4)


def test_a_balls_normals_are_smooth_and_its_radius_stays():
    labels = ball(48, 18.0)
    field = smooth_surface(labels, SOLID).astype(float)
    gradient = np.stack(np.gradient(field), axis=-1)
    places = np.indices(labels.shape) - 23.5
    radius = np.sqrt((places**2).sum(axis=0))
    near = np.abs(radius - 18) < 0.4
    outward = np.moveaxis(places, 0, -1)[near] / radius[near][:, None]
    slope = -gradient[near] / np.linalg.norm(gradient[near], axis=1)[:, None]
    angle = np.degrees(np.arccos(np.clip((slope * outward).sum(axis=1), -1, 1)))
    assert np.sqrt(np.mean(angle**2)) < 3  # of the voxels themselves it is some 25 degrees
    line = field[24, 24, 24:]
    at = np.flatnonzero(line < 0)[0]
    edge = at - 1 + line[at - 1] / (line[at - 1] - line[at]) + 0.5
    assert edge == pytest.approx(18, abs=0.4)


def test_blocks_know_how_far_the_next_material_is():
    field = np.full((40, 30, 50), -1, np.int16)
    field[3, 4, 5] = field[33, 20, 44] = 1
    skip = np.empty((10, 8, 13), np.uint8)
    find_blocks(field, skip)
    held = np.argwhere(skip == 0)
    assert [3 // BLOCK, 4 // BLOCK, 5 // BLOCK] in held.tolist() and len(held) >= 2
    spread_blocks(skip)
    places = np.indices(skip.shape).reshape(3, -1).T
    expected = np.abs(places[:, None] - held).max(axis=-1).min(axis=1)
    assert np.array_equal(skip.ravel(), np.minimum(expected, FURTHEST))


@pytest.mark.whole
@pytest.mark.parametrize(
    ("material", "least"),
    [
        (PhaseMaterial(albedo=(255, 255, 255), specular=0.0), 0.985),
        (PhaseMaterial(albedo=(255, 255, 255), specular=0.0, scattering_depth=0.06), 0.96),
        (PhaseMaterial(albedo=(255, 255, 255), specular=0.8, roughness=0.4), 0.96),
        (PhaseMaterial(albedo=(255, 255, 255), metalness=1.0, roughness=0.3), 0.93),
        (PhaseMaterial(albedo=(255, 255, 255), transmission=1.0, roughness=0.0), 0.93),
    ],
)
def test_a_white_furnace_shows_no_difference_between_material_and_sky(material, least):
    """Nothing that reflects, mirrors or lets through all light can be seen in even light; what is
    lost is light between facets, and paths that are cut.
    """
    light, features, _ = exposed(ball(20, 8.0), material, uniform_light(), size=(24, 18))
    inside = features[..., 6] > 0.99
    assert inside.sum() > 30
    assert least < light[inside].mean() < 1.02


@pytest.mark.whole
def test_a_thick_translucent_body_has_its_albedo():
    block = np.ones((24, 24, 24), np.uint8)
    material = PhaseMaterial(albedo=(188, 188, 188), specular=0.0, scattering_depth=0.02)
    light, features, _ = exposed(block, material, uniform_light(), samples=64, size=(16, 12))
    inside = features[..., 6] > 0.99
    assert light[inside].mean() == pytest.approx(float(to_linear(188)), rel=0.06)


@pytest.mark.whole
def test_a_matt_ball_has_the_light_of_lamberts_law():
    """Albedo times irradiance over pi times the cosine with the lamp, where that shines."""
    lamp = np.array([-0.75, -0.2, 0.6])
    lamp /= np.linalg.norm(lamp)
    least = math.cos(math.radians(0.5))
    light = uniform_light(0.0)
    light[0] = *lamp, least
    light[1, :3] = 1 / (2 * math.pi * (1 - least))  # irradiance 1
    size = (60, 60)
    material = PhaseMaterial(albedo=(188, 188, 188), specular=0.0)
    seen, _, framing = exposed(ball(64, 26.0), material, light, size=size)
    eye, right, down, corner = framing.lens[:4]
    rows, columns = np.indices(size[::-1])
    ways = corner + columns[..., None] * right + rows[..., None] * down
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    offset = eye - 32.0
    half = ways @ offset
    root = half**2 - offset @ offset + 26.0**2
    at = offset + (-half - np.sqrt(np.maximum(root, 0)))[..., None] * ways
    cosine = (at / 26.0) @ lamp
    sure = (root > 60) & (cosine > 0.2)
    expected = float(to_linear(188)) / math.pi * cosine[sure]
    found = seen[sure].mean(axis=-1)
    assert sure.sum() > 300
    assert found.mean() == pytest.approx(expected.mean(), rel=0.02)
    assert np.sqrt(np.mean((found / expected - 1) ** 2)) < 0.06
    dark = (root > 60) & (cosine < -0.1)
    assert seen[dark].max() < 1e-6


@pytest.mark.whole
def test_the_same_picture_for_any_number_of_threads():
    pictures = []
    for count in (1, 3, 1):
        with threads(count):
            still = tb.render(foam(), look="bread", quality="draft", size=(32, 24), samples=5)
            pictures.append(still.values)
    assert np.array_equal(pictures[0], pictures[1]) and np.array_equal(pictures[0], pictures[2])


@pytest.mark.whole
def test_more_paths_make_less_noise_and_the_filter_less_still():
    labels, noise, light = ball(24, 10.0), [], photograph.LIGHTS["window"]
    for samples in (4, 64):
        sky = uniform_light(0.3)
        sky[0], sky[1, :3] = (0.6, 0, 0.8, math.cos(math.radians(light.size))), 8.0
        stretch, angles = np.ones(3), (30.0, 25.0)
        cut = make_cut(("none",), labels.shape, stretch, viewer_direction(*angles))
        space = photograph.prepare_space(labels, [1], stretch, cut)
        framing = frame_camera(
            *kept_blocks(space.skip, stretch, cut), angles, "z", SMALL,
            lens=20.0, aperture=0.0, focus=0.3,
        )  # fmt: skip
        rows = material_rows(TRACED["clay"], ("void", "solid"), framing.extent)
        halves, features = photograph.expose(space, rows, [1], sky, framing.lens, SMALL, samples)
        noise.append(np.std(halves[0] - halves[1]))
        filtered = average_noise(halves, features)
        assert np.std(filtered[0] - filtered[1]) < 0.8 * noise[-1]
        assert filtered.mean() == pytest.approx(halves.mean(), rel=0.02)
    assert noise[1] < noise[0] / 3


@pytest.mark.whole
def test_memory_is_at_most_four_times_the_volume():
    for side in (128, 192, 256, 512, 1024):
        held = photograph.forecast_traced((side,) * 3, (800, 600)).memory
        beside = sum(count for name, count in held.items() if name != "film")
        assert side**3 + beside <= 4 * side**3
    labels = foam(40)
    stretch, cut = np.ones(3), make_cut(("none",), (40,) * 3, np.ones(3), np.array([0, -1.0, 0]))
    space = photograph.prepare_space(labels, [1], stretch, cut)
    arrays = {"field": space.field, "blocks": space.skip}
    held = photograph.forecast_traced(labels.shape, SMALL).memory
    assert all(array.nbytes <= held[name] for name, array in arrays.items())


def test_the_depth_below_the_outside_grows_inwards_and_ignores_small_pores():
    z, y, x = np.indices((48, 48, 48)) - 23.5
    form = np.sqrt(z**2 + y**2 + x**2) < 20
    field = np.where(form, 1, -1).astype(np.int16)
    whole, _ = rim_depths(field, np.ones(3), 4.0)
    assert whole[24, 24, 24] == pytest.approx(20, abs=2)
    assert whole[24, 24, 6] == pytest.approx(2.5, abs=1.5)
    field[22:26, 22:26, :] = -1  # a pore through all of it
    pierced, _ = rim_depths(field, np.ones(3), 4.0)
    assert pierced[24, 24, 24] == pytest.approx(whole[24, 24, 24], abs=2)
    cut, _ = rim_depths(field[:, :, 24:], np.ones(3), 4.0)
    assert cut[24, 24, 0] > 15  # a face of the volume is no outside


@pytest.mark.whole
def test_a_small_part_of_a_box_fills_the_picture():
    box = np.zeros((60, 60, 60), np.uint8)
    box[5:15, 40:50, 20:30] = 1
    still = tb.render(box, quality="draft", size=SMALL, samples=2, cut="none", look="stone")
    ground = np.median(still.values[:4].reshape(-1, 3), axis=0)
    apart = np.abs(still.values - ground).max(axis=-1) > 30
    assert apart.mean() > 0.2


@pytest.mark.whole
def test_the_axis_that_points_up_is_up_in_both_kinds_of_stills():
    post = np.zeros((24, 24, 24), np.uint8)
    post[10:14, :, 10:14] = 1
    post[6:18, 18:, 6:18] = 1  # a head at high y
    for given in ({}, {"quality": "draft", "samples": 2, "ground": False}):
        still = tb.render(
            post, up="y", camera=(0, 0), cut="none", size=SMALL, look="stone", **given
        ).values.astype(int)
        mask = np.abs(still - still[1, 1]).max(axis=-1) > 25
        rows = np.flatnonzero(mask[:28, 12:36].any(axis=1))
        wide = mask[:, 12:36].sum(axis=1)
        assert wide[rows[0] + 1] > 1.5 * wide[rows[0] + 14]


@pytest.mark.whole
def test_a_colour_volume_takes_its_own_colours_and_its_mask():
    values = np.zeros((20, 20, 20, 3), np.uint8)
    values[4:16, 4:16, 4:10], values[4:16, 4:16, 10:16] = (200, 30, 30), (30, 30, 200)
    form = values.any(axis=-1)
    volume = tb.Image(values, "colour")
    for given in ({}, {"quality": "draft", "samples": 4}):
        still = tb.render(volume, form=form, camera=(0, 0), cut="none", size=(96, 72), **given)
        seen = still.values.astype(int)
        red, blue = (np.argwhere(seen[..., a] > seen[..., 2 - a] + 60) for a in (0, 2))
        assert len(red) > 60 and len(blue) > 60
        assert red[:, 1].max() <= blue[:, 1].min() + 1
        dark = seen[:50].max(axis=-1) < 25
        assert not dark.any()  # outside of the form nothing is drawn
    made = tb.Image(
        values,
        "colour",
        recipe=tb.Image(form, "labels").recipe.then(
            "generate", values, request={"mask": [{"verb": "array"}]}
        ),
    )
    drawn = tb.render(made, camera=(0, 0), cut="none", size=SMALL)
    given = tb.render(volume, form=form, camera=(0, 0), cut="none", size=SMALL)
    assert np.array_equal(drawn.values, given.values)


@pytest.mark.whole
def test_black_inside_a_coloured_form_stays():
    values = np.zeros((12, 12, 12, 3), np.uint8)
    values[2:10, 2:10, 2:10] = 200
    values[5:7, 5:7, 5:7] = 0
    image = tb.Image(values, "colour")
    recipe = image.recipe.then("generate", values, request={"mask": [{"verb": "array"}]})
    inside = form_of(tb.Image(values, "colour", recipe=recipe), None)
    assert inside.sum() == 8**3
    assert form_of(image, None).all()


def lamp_light(direction, width, irradiance):
    """Return a lamp alone, of an angular radius in degrees."""
    light = uniform_light(0.0)
    least = math.cos(math.radians(width))
    light[0] = *(np.array(direction) / np.linalg.norm(direction)), least
    light[1, :3] = irradiance / (2 * math.pi * (1 - least))
    return light


@pytest.mark.whole
def test_every_path_to_the_lamp_brings_the_same_light():
    """A thick translucent block shows the same light as a matt one: albedo times irradiance over
    pi; and the lamp that is asked brings what a sky of the same radiance would.
    """
    block = np.ones((24, 24, 24), np.uint8)
    lamp, seen = lamp_light((0, 0, 1), 20, 1.0), []
    for depth in (0.0, 0.02):
        material = PhaseMaterial(albedo=(188, 188, 188), specular=0.0, scattering_depth=depth)
        light, features, _ = exposed(
            block, material, lamp, samples=64, size=(16, 12), angles=(0.0, 89.0)
        )
        seen.append(light[features[..., 6] > 0.99].mean())
    mean = (1 + math.cos(math.radians(20))) / 2  # of the cosine over the lamp
    assert seen[0] == pytest.approx(mean * float(to_linear(188)) / math.pi, rel=0.02)
    assert seen[1] == pytest.approx(seen[0], rel=0.1)


@pytest.mark.whole
def test_clear_material_mirrors_and_bends_light():
    """A clear plate in a sky that is bright above alone: seen from above at a slant it shows
    Fresnel's share of it, and what is below through it.
    """
    plate = np.ones((6, 40, 40), np.uint8)
    light = uniform_light(0.0)
    light[2:4, :3] = 1.0  # zenith and horizon; nothing comes from below
    material = PhaseMaterial(
        albedo=(255, 255, 255), transmission=1.0, roughness=0.0, refraction=1.5
    )
    seen, features, _ = exposed(
        plate, material, light, samples=144, size=(24, 18), angles=(0.0, 40.0), lens=2.0
    )
    top = (features[..., 6] > 0.999) & (features[..., 2] > 0.999)
    cosine = math.sin(math.radians(40))
    through = math.sqrt(1 - (1 - cosine**2) / 1.5**2)
    across = ((cosine - 1.5 * through) / (cosine + 1.5 * through)) ** 2
    along = ((1.5 * cosine - through) / (1.5 * cosine + through)) ** 2
    mirrored = (across + along) / 2
    both = 2 * mirrored / (1 + mirrored)  # of both faces, to and fro
    middle = seen[7:10, 10:14]
    assert top[7:10, 10:14].all()
    assert mirrored * 0.9 < middle.mean() < both * 1.1


@pytest.mark.parametrize(
    ("image", "options", "message"),
    [
        (np.zeros((8, 8, 8), np.uint8), {}, "nothing of what is drawn"),
        (foam(8), {"phase": "void", "cut": "x=0"}, "cut leaves nothing"),
        (foam(8), {"samples": 1}, "samples"),
        (foam(8), {"lens": 170}, "lens"),
        (foam(8), {"form": foam(8)}, "form is of a colour volume"),
        (foam(8), {"look": "no.toml"}, "cannot be read"),
        (foam(8), {"look": {"roughness": 3}}, "roughness"),
        (foam(8), {"look": {"albedo": "red"}}, "red, green, blue"),
        (foam(8), {"look": {"rim": [[0.1, [0, 0, 0]]]}}, "from 0 rising"),
        (tb.Image(np.ones((8, 8, 8, 3), np.uint8), "colour"), {"threshold": 3}, "has its own"),
        (
            tb.Image(np.ones((8, 8, 8, 3), np.uint8), "colour"),
            {"form": np.zeros((8, 8, 8), bool)},
            "is empty",
        ),
        (
            tb.Image(np.ones((8, 8, 8, 3), np.uint8), "colour"),
            {"form": np.zeros((8, 8, 7), bool)},
            "has shape",
        ),
    ],
)
def test_what_cannot_be_traced_is_refused(image, options, message):
    with pytest.raises(InputError, match=message):
        tb.render(image, **{"quality": "draft", "size": SMALL, **options})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"quality": "drafty"}, "did you mean 'draft'"),
        ({"look": {"albido": [1, 2, 3]}}, "did you mean 'albedo'"),
        ({"look": {"light": "windows"}}, "did you mean 'window'"),
        ({"up": "w"}, "up"),
    ],
)
def test_unknown_words_of_a_traced_still_suggest_the_nearest(options, message):
    with pytest.raises(UnknownNameError, match=message):
        tb.render(foam(8), **{"quality": "draft", "size": SMALL, **options})


def test_a_colour_volume_with_alpha_is_told_what_to_do():
    with pytest.raises(InputError, match="alpha"):
        tb.Image(np.zeros((4, 4, 4, 4), np.uint8), "colour")


def test_settings_of_traced_stills_are_refused_by_quick_ones():
    with pytest.raises(InputError, match="quality="):
        tb.render(foam(8), size=SMALL, exposure=1)


@pytest.mark.whole
def test_a_look_of_ones_own_comes_from_a_file(tmp_path):
    path = tmp_path / "brass.toml"
    path.write_text(
        'base = "copper"\nalbedo = [230, 190, 110]\nroughness = 0.2\n[void]\nroughness = 0.9\n'
    )
    look = find_traced(path)
    assert look.materials[0].albedo == (230, 190, 110) and look.materials[0].metalness == 1
    assert look.void.roughness == 0.9 and look.light == TRACED["copper"].light
    still = tb.render(foam(12), quality="draft", size=SMALL, samples=2, look=path)
    step = still.recipe.to_json()[-1]
    assert step["look"]["roughness"] == 0.2 and step["noise"] > 0
    assert plain_look(path).solid == (230, 190, 110)


@pytest.mark.whole
def test_every_look_can_be_drawn_quick_and_traced():
    for name in TRACED:
        assert plain_look(name).solid != (0, 0, 0)
        row = TRACED[name].materials[0].row(100.0)
        assert np.isfinite(row).all() and row[:3].max() <= 1


def test_the_film_keeps_order_and_black():
    light = np.repeat(np.linspace(0, 40, 200)[:, None, None], 3, axis=2)
    shown = develop(light, 0.0)
    assert shown[0].max() == 0 and (np.diff(shown[:, 0, 0]) >= 0).all() and shown.max() <= 1
    assert develop(light[20:21], 1.0).mean() > develop(light[20:21], 0.0).mean()


@pytest.mark.whole
def test_a_lens_blurs_what_is_not_in_focus():
    still = {}
    for focus in (0.0, 1.0):
        labels = np.zeros((20, 60, 20), np.uint8)
        labels[:, :6, :], labels[:, -6:, :] = 1, 1
        labels[::4, :6] = 0
        picture = tb.render(
            labels, quality="draft", samples=16, size=SMALL, cut="none", camera=(0, 0),
            aperture=0.3, focus=focus, look="clay", ground=False,
        ).values.astype(int)  # fmt: skip
        still[focus] = np.abs(np.diff(picture[8:28, 20:28].mean(axis=-1), axis=0)).mean()
    assert still[0.0] > 1.3 * still[1.0]


GOLDEN = Path(__file__).with_name("traced.png")
LOOKS_SHOWN = ("bread", "foam", "glass")


def golden_strip():
    """Return the stills of the golden picture, beside one another."""
    stills = [
        tb.render(foam(20, seed=2), look=look, quality="fine", samples=8, size=(64, 48)).values
        for look in LOOKS_SHOWN
    ]
    return np.concatenate(stills, axis=1)


@pytest.mark.whole
def test_pictures_stay_as_they_were():
    """Allow for other libraries of mathematics: a few paths may turn elsewhere. `python
    tests/view/test_traced.py` draws the golden picture anew.
    """
    with Pillow.open(GOLDEN) as picture:
        expected = np.asarray(picture.convert("RGB")).astype(int)
    apart = np.abs(golden_strip().astype(int) - expected)
    assert apart.mean() < 1.5 and np.quantile(apart, 0.99) < 30


if __name__ == "__main__":
    Pillow.fromarray(golden_strip()).save(GOLDEN, optimize=True)

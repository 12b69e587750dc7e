"""Learning from pictures: what is judged of a volume, which picture judges it, what is refused."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="method gan needs the extra 'learn'")

import trabecula as tb  # noqa: E402
from trabecula.cli.method_choice import check_fits  # noqa: E402
from trabecula.errors import InputError  # noqa: E402
from trabecula.exemplar.views import views_of  # noqa: E402
from trabecula.synth.gan import losses  # noqa: E402
from trabecula.synth.gan.adversarial import AdversarialPair  # noqa: E402
from trabecula.synth.gan.config import GanConfig  # noqa: E402
from trabecula.synth.gan.crops import effective_config, picture_fields  # noqa: E402
from trabecula.synth.gan.networks import (  # noqa: E402
    Subpixel,
    depth_to_space,
    space_to_depth,
)
from trabecula.synth.gan.orientations import oriented, turns_of  # noqa: E402
from trabecula.synth.gan.slices import (  # noqa: E402
    STEP,
    PictureFields,
    numbered_views,
    take_slices,
)

TINY = {"crop": 40, "batch": 1, "width": 2, "latent": 2, "minutes": 0.0, "looks": 1}


@pytest.fixture(autouse=True)
def few_tiles(monkeypatch):
    monkeypatch.setattr(Subpixel, "tiles", 2)


def picture(seed, spacing=(1.0, 1.0)):
    values = np.random.default_rng(seed).integers(0, 2, (8, 9)).repeat(6, 0).repeat(6, 1)
    return tb.Image(values.astype(np.uint8), "labels", spacing=spacing, unit="um")


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_slices_lie_across_their_axis_and_move_on(axis):
    c, others = 8, [a for a in range(3) if a != axis]
    place = torch.stack(torch.meshgrid(*(torch.arange(c),) * 3, indexing="ij"))[None]  # K = 3
    for iteration in (0, 1, STEP + 1):
        slices = take_slices(place, [axis], iteration)
        assert slices.shape == (c // STEP, 1, 3, c, c)
        assert slices[:, 0, axis, 0, 0].tolist() == [iteration % STEP, iteration % STEP + STEP]
        rows, columns = (slices[0, 0, other] for other in others)
        assert rows[:, 0].tolist() == columns[0].tolist() == list(range(c))


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_pairs_of_slices_lie_a_gap_apart(axis):
    c, gap = 12, 3
    place = torch.stack(torch.meshgrid(*(torch.arange(c),) * 3, indexing="ij"))[None]  # K = 3
    for iteration in (0, 2, STEP + 1):
        first = list(range(iteration % STEP, c - gap, STEP))
        pairs = take_slices(place, [axis], iteration, gap=gap)
        assert pairs.shape == (len(first), 1, 6, c, c)
        assert pairs[:, 0, axis, 0, 0].tolist() == first
        assert pairs[:, 0, 3 + axis, 0, 0].tolist() == [at + gap for at in first]
        others = [a for a in range(3) if a != axis]
        assert torch.equal(pairs[:, 0, others], pairs[:, 0, [3 + other for other in others]])


def test_crops_of_sections_are_pairs_of_neighbours_in_either_order():
    rows = torch.arange(44.0)[:, None].expand(44, 48)
    pictures = tuple((rows + 100 * n)[None] for n in range(3))
    views = ((0, 0), (1, 0), (2, 0))
    fields = PictureFields(pictures, views, turns_of("all", axes=2), 40, gap=5)
    found = set()
    for iteration in range(20):
        crops = fields.crops(2, 0, iteration)
        assert crops.shape == (2 * len(range(iteration % STEP, 35, STEP)), 3, 2, 40, 40)
        apart = (crops[:, :, 1] - crops[:, :, 0]).flatten(2)
        assert torch.equal(apart[..., :1].expand_as(apart), apart), "one place, one orientation"
        found |= set(apart.unique().tolist())
        assert fields.crops(2, 0, iteration).equal(crops)
    assert found == {-100.0, 100.0}


def test_sections_are_alike_from_all_sides_and_their_pairs_are_judged():
    sections = [picture(seed) for seed in range(3)]
    config = effective_config(GanConfig(**TINY, iterations=1, gap=4), sections)
    assert config.orientations == "all"
    fields = picture_fields(sections, config)
    assert (len(fields.pictures), fields.gap, fields.channels) == (3, 4, 1)
    assert fields.views == ((0, 0), (1, 0), (2, 0))
    pair = AdversarialPair(config, 1, torch.device("cpu"), fields.views)
    assert len(pair.discriminator.judges) == 1
    made, crops = pair.sample(torch.Generator().manual_seed(0)), fields.crops(1, 0, 3)
    assert pair.seen(made, 3).shape == crops.shape
    assert all(torch.isfinite(verdict).all() for verdict in pair.discriminator(crops))


@pytest.mark.whole
def test_a_volume_is_made_from_sections(tmp_path):
    sections = [picture(seed, (2.0, 2.0)) for seed in range(4)]
    model = tb.method("gan", **TINY, iterations=2, warmup=0.5, gap=3).fit(sections)
    made = model.generate(40, seed=1)
    assert made.spacing == (2.0,) * 3
    again = tb.load_model(model.save(tmp_path / "sections.model"))
    assert again.config.gap == 3
    assert np.array_equal(again.generate(40, seed=1).values, made.values)


def test_four_pixels_become_channels():
    x = torch.arange(16.0).reshape(1, 1, 4, 4)
    assert space_to_depth(x)[0, :, 0, 0].tolist() == [0.0, 1.0, 4.0, 5.0]
    volume = torch.randn(2, 8, 3, 3, 3)
    assert torch.equal(space_to_depth(depth_to_space(volume)), volume)


def test_one_picture_judges_all_planes_and_a_turned_one_is_another():
    one, two = picture(0), picture(1)
    assert numbered_views(views_of([one]))[1] == ((0, 0), (1, 0), (2, 0))
    assert numbered_views(views_of([one, two]))[1] == ((0, 0), (1, 0), (2, 1))
    different, views = numbered_views(views_of([one], ["yx", "xz"]))
    assert views == ((0, 0), (1, 1))
    assert np.array_equal(different[1].image.values, one.values.T)


def test_crops_of_a_view_come_from_its_picture():
    pictures = tuple(torch.full((1, 44, 48), value) for value in (2.0, 3.0))
    fields = PictureFields(pictures, ((0, 0), (1, 0), (2, 1)), turns_of("all", axes=2), 40)
    crops = fields.crops(2, 0, 0)
    assert crops.shape == (2 * 40 // STEP, 3, 1, 40, 40)
    assert [crops[:, view].unique().tolist() for view in range(3)] == [[2.0], [2.0], [3.0]]


def test_the_turns_of_a_picture_are_the_symmetries_of_the_square():
    corner = torch.arange(4.0).reshape(1, 2, 2)
    for name, count in (("none", 1), ("inverted", 2), ("mirrors", 4), ("all", 8)):
        turned = {tuple(oriented(corner, t).flatten().tolist()) for t in turns_of(name, axes=2)}
        assert len(turned) == count


def test_pictures_have_no_distances_and_one_of_all_planes_is_alike_from_all_sides():
    config = GanConfig()
    found = effective_config(config, [picture(0)])
    assert (found.clip, found.orientations) == (0, "all")
    assert effective_config(config, [picture(0), picture(1)]).orientations == "inverted"
    two = effective_config(GanConfig(views=("yx", "zx")), [picture(0)])
    assert two.orientations == "inverted"
    mirrors = effective_config(GanConfig(orientations="mirrors"), [picture(0)])
    assert mirrors.orientations == "mirrors"
    fields = picture_fields([picture(0)], GanConfig(crop=40))
    assert len(fields.turns) == 8
    assert set(fields.pictures[0].unique().tolist()) == {-1.0, 1.0}


def test_generated_crops_are_given_fractions_that_pictures_tell():
    values = np.kron(picture(0).values, np.ones((2, 2), np.uint8))
    large = tb.Image(values, "labels")
    fields = picture_fields([large], GanConfig(crop=48))
    assert fields.local.mean[0] == pytest.approx(values.mean())
    given = fields.given(2, 0, 5)
    assert given.shape == (2, 1, 12, 12, 12)
    assert torch.equal(given, fields.given(2, 0, 5))
    assert not torch.equal(given, fields.given(2, 0, 6))
    assert not torch.equal(given[0], given[1])
    assert fields.given(1, 0, 5).shape == (1, 1, 12, 12, 12)
    assert picture_fields([large], GanConfig(crop=48, fractions=0)).given(2, 0, 5) is None
    assert picture_fields([picture(0)], GanConfig(crop=40)).given(2, 0, 5) is None  # 48 x 54


@pytest.mark.parametrize("warm", [False, True])
def test_volumes_are_held_to_the_fractions_and_slices_of_them_are_judged(warm):
    large = tb.Image(np.kron(picture(0).values, np.ones((2, 2), np.uint8)), "labels")
    config = GanConfig(**{**TINY, "crop": 48}, iterations=1, precision="float32")
    config = effective_config(config, [large])
    fields = picture_fields([large], config)
    pair = AdversarialPair(config, 1, torch.device("cpu"), fields.views, fields.local)
    given, random = fields.given(1, 0, 0), torch.Generator().manual_seed(5)
    made = pair.sample(torch.Generator().manual_seed(5), given)
    wanted = float(losses.local_fractions(made, given, fields.local))
    crops = fields.crops(1, 0, 0)
    if warm:
        found = pair.warmup_step(crops, random, 0, given=given)
    else:
        found = pair.train_step(crops, random, 0, 0.1, given=given, shares=True)
        assert found["fractions_share"] > 0
    assert found["fractions"] == pytest.approx(wanted, rel=1e-4)


def test_each_picture_has_a_discriminator_and_both_networks_learn():
    config = GanConfig(**TINY, iterations=1, precision="float32")
    fields = picture_fields([picture(0), picture(1)], config)
    pair = AdversarialPair(config, 1, torch.device("cpu"), fields.views)
    assert len(pair.discriminator.judges) == 2
    before = pair.state()
    pair.train_step(fields.crops(1, 0, 0), torch.Generator().manual_seed(0), 0, 0.1)
    after = pair.state()
    for part in ("generator.", "discriminator.judges.0", "discriminator.judges.1"):
        names = [name for name in before if name.startswith(part) and name.endswith("weight")]
        assert names and all(not torch.equal(before[name], after[name]) for name in names)


@pytest.mark.whole
def test_a_volume_is_made_from_pictures_with_their_voxels(tmp_path):
    pictures = [picture(0, (2.0, 3.0)), picture(1, (2.0, 3.0)), picture(2, (2.0, 2.0))]
    method = tb.method("gan", **TINY, iterations=2, warmup=0.5, views=("yx", "zx", "zy"))
    model = method.fit(pictures)
    made = model.generate((40, 24, 33), seed=1)
    assert (made.shape, made.spacing, made.unit) == ((40, 24, 33), (2.0, 2.0, 3.0), "um")
    again = tb.load_model(model.save(tmp_path / "pictures.model"))
    assert again.generate((40, 24, 33), seed=1).spacing == made.spacing
    assert np.array_equal(again.generate((40, 24, 33), seed=1).values, made.values)


def test_the_command_line_lets_pictures_pass():
    method = tb.method("gan", **TINY, iterations=1)
    check_fits(method, [picture(0)])
    colour = tb.Image(np.zeros((64, 64, 3), np.uint8), "colour")
    with pytest.raises(InputError, match="use --method"):
        check_fits(method, [colour])


def test_exemplars_that_do_not_go_together_are_refused():
    volume = tb.crop(tb.sample("bone"), 48)
    flat = tb.Image(volume.values[0], "labels", phases=volume.phases)
    method = tb.method("gan", **TINY, iterations=1)
    with pytest.raises(InputError, match="one volume, got 2"):
        method.fit([volume, volume])
    with pytest.raises(InputError, match="not from both"):
        method.fit([volume, flat])
    with pytest.raises(InputError, match="judges volumes"):
        tb.method("gan", preset="3dgan").fit(flat)
    with pytest.raises(InputError, match="two or more pictures"):
        tb.method("gan", gap=3, minutes=0, iterations=1).fit(flat)
    with pytest.raises(InputError, match="less than half a crop"):
        tb.method("gan", gap=20, crop=40)
    with pytest.raises(InputError, match="stand for all planes"):
        tb.method("gan", gap=3, views=("yx", "zx"))
    with pytest.raises(InputError, match="crops of 64 pixels"):
        tb.method("gan", minutes=0, iterations=1).fit(flat)

"""Local fractions: the exemplar's, a random field like them, and a target in their place."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="method gan needs the extra 'learn'")

import trabecula as tb  # noqa: E402
from trabecula.core.seeds import key  # noqa: E402
from trabecula.errors import RequestError  # noqa: E402
from trabecula.synth.api.exemplar_info import exemplar_info  # noqa: E402
from trabecula.synth.gan import losses  # noqa: E402
from trabecula.synth.gan.config import GanConfig  # noqa: E402
from trabecula.synth.gan.crops import effective_config, exemplar_fields  # noqa: E402
from trabecula.synth.gan.decode import rising_part  # noqa: E402
from trabecula.synth.gan.local_fractions import LocalFractions, cell_means  # noqa: E402
from trabecula.synth.gan.method import GanModel  # noqa: E402
from trabecula.synth.gan.networks import new_generator  # noqa: E402

BONE = tb.sample("bone")
KEY = key(3, "gan/fractions")
ENDLESS = (0, 0, 0)


def smooth_field(shape, seed=0, reach=2):
    """Return a field (1, *shape) of mean 0.3, correlated over a few cells."""
    found = np.random.default_rng(seed).standard_normal(shape)
    for axis in range(3):
        found = sum(np.roll(found, step, axis) for step in range(-reach, reach + 1))
    return (0.3 + 0.1 * found / found.std())[None]


@pytest.fixture(scope="module")
def local():
    return LocalFractions.of(smooth_field((40, 40, 40)))


def average_around(cells):
    """Return the binomial means over 5 x 5 x 5 cells, which two at every end do not have."""
    weights = [np.array([1, 4, 6, 4, 1]) / 16] * 3
    kernel = np.multiply.outer(np.multiply.outer(*weights[:2]), weights[2])
    windows = np.lib.stride_tricks.sliding_window_view(cells, (5, 5, 5), (-3, -2, -1))
    return (windows * kernel).sum((-3, -2, -1))


def test_fractions_around_cells_are_binomial_means():
    shares = np.random.default_rng(0).random((2, 3, 64, 56, 72)).astype(np.float32)
    cells = shares.reshape(2, 3, 8, 8, 7, 8, 9, 8).mean((3, 5, 7))
    found = losses.fractions_around(torch.from_numpy(shares)).numpy()
    assert found.shape == (2, 3, 4, 3, 5)
    assert np.allclose(average_around(cells), found, atol=1e-6)


@pytest.mark.parametrize("orientations", ["none", "inverted", "all"])
def test_what_is_given_are_the_fractions_of_the_crops(orientations):
    """The term is nothing where a field has them, in whatever orientation."""
    fields = exemplar_fields(BONE, GanConfig(orientations=orientations, clip=0))
    crops, given = fields.crops(3, 0, 7), fields.given(3, 0, 7)
    assert given.shape == (3, 1, 14, 14, 14)
    assert float(losses.local_fractions(4 * crops, given, fields.local)) < 1e-6
    other = fields.given(3, 0, 8)
    assert float(losses.local_fractions(crops, other, fields.local)) > 0.1


def test_three_phases_are_given_three_fractions():
    values = np.random.default_rng(1).integers(0, 3, (64, 64, 64)).astype(np.uint8)
    fields = exemplar_fields(tb.Image(values, "labels"), GanConfig(clip=0))
    assert fields.shares.shape == (3, 144, 144, 144)
    crops, given = fields.crops(1, 0, 0), fields.given(1, 0, 0)
    assert float(losses.local_fractions(4 * crops, given, fields.local)) < 1e-6
    drawn = fields.local.draw(KEY, (0, 0, 0), (6, 6, 6), ENDLESS)
    shares = fields.local.mean[:, None, None, None] + np.moveaxis(
        np.moveaxis(drawn, 0, -1) * fields.local.deviation, -1, 0
    )
    assert np.allclose(shares.sum(0), 1, atol=0.01)


@pytest.mark.parametrize(
    "exemplar",
    [
        tb.crop(BONE, 60),
        tb.Image(np.eye(64, 60, dtype=np.uint8), "labels"),
        tb.Image(np.random.default_rng(0).random((64, 64, 64)).astype(np.float32), "grey"),
    ],
    ids=["small", "picture", "grey"],
)
def test_what_has_no_local_fractions_learns_without(exemplar):
    assert effective_config(GanConfig(), [exemplar]).fractions == 0


def test_a_crop_that_holds_no_cell_with_all_around_it_learns_without():
    small, whole = GanConfig(crop=32, discriminator="score"), GanConfig(crop=40)
    assert effective_config(small, [tb.crop(BONE, 64)]).fractions == 0
    assert effective_config(whole, [tb.crop(BONE, 64)]).fractions == 1


def test_drawn_fractions_are_as_the_exemplars(local):
    drawn = local.draw(KEY, (0, 0, 0), (80, 80, 80), ENDLESS)[0]
    learnt = (smooth_field((40, 40, 40))[0] - local.mean[0]) / local.deviation[0]
    assert drawn.mean() == pytest.approx(0, abs=0.1)
    assert drawn.std() == pytest.approx(1, abs=0.1)
    for axis in range(3):
        for lag in (1, 2, 3, 5):
            pairs = [
                (
                    np.take(field, range(field.shape[axis] - lag), axis)
                    * np.take(field, range(lag, field.shape[axis]), axis)
                ).mean()
                for field in (drawn, learnt)
            ]
            assert pairs[0] == pytest.approx(pairs[1], abs=0.12), (axis, lag)


def test_drawn_fractions_are_those_of_their_place(local):
    whole = local.draw(KEY, (-3, 0, 5), (12, 9, 10), ENDLESS)
    part = local.draw(KEY, (2, 4, 6), (5, 3, 4), ENDLESS)
    assert np.array_equal(part, whole[:, 5:10, 4:7, 1:5])
    assert not np.array_equal(local.draw(key(4, "x"), (-3, 0, 5), (12, 9, 10), ENDLESS), whole)


def test_drawn_fractions_repeat_after_a_period(local):
    found = local.draw(KEY, (0, 0, 0), (8, 20, 4), (4, 10, 0))
    assert np.array_equal(found[:, :4], found[:, 4:])
    assert np.array_equal(found[:, :, :10], found[:, :, 10:])


def test_a_description_is_read_as_it_was_written(local):
    again = LocalFractions.from_json(local.to_json())
    sides = (4, 4, 4)
    assert np.array_equal(
        again.draw(KEY, sides, sides, ENDLESS), local.draw(KEY, sides, sides, ENDLESS)
    )
    with pytest.raises(ValueError, match="damaged"):
        LocalFractions.from_json({**local.to_json(), "levels": [[0.0]]})


def test_what_is_the_same_everywhere_is_given_as_that():
    cubes = np.indices((64, 64, 64)) // 8
    values = (cubes.sum(0) % 3).astype(np.uint8)
    local = exemplar_fields(tb.Image(values, "labels"), GanConfig(clip=0)).local
    assert np.isfinite(local.draw(KEY, (0, 0, 0), (4, 4, 4), ENDLESS)).all()


def thresholded(shape, seed):
    """Return an isotropic material of correlated noise, a third of it solid, as (1, *shape)."""
    noise = np.fft.rfftn(np.random.default_rng(seed).standard_normal(shape))
    far = [np.fft.fftfreq(side) for side in shape[:-1]] + [np.fft.rfftfreq(shape[-1])]
    square = sum(part**2 for part in np.meshgrid(*far, indexing="ij"))
    field = np.fft.irfftn(noise * np.exp(-square * 6.0**2 * 2 * np.pi**2), shape, (0, 1, 2))
    return (field > np.quantile(field, 2 / 3))[None]


def test_pictures_tell_how_fractions_vary_in_space():
    """Windows of pictures vary more than those of the volume, since nothing is averaged across."""
    volume = thresholded((160, 160, 160), seed=2)
    around = losses.fractions_around(torch.from_numpy(volume)[None].float())[0].numpy()
    flat = LocalFractions.of_pictures([volume[:, z] for z in range(0, 160, 20)])
    assert flat.mean[0] == pytest.approx(1 / 3, abs=0.03)
    assert flat.deviation[0] == pytest.approx(around.std(), rel=0.25)
    windows = np.array([[average_flat(volume[0, z])] for z in range(0, 160, 20)])
    assert windows.std() > 1.2 * flat.deviation[0]
    drawn = flat.draw(KEY, (0, 0, 0), (40, 40, 40), ENDLESS)[0]
    for lag in (1, 2):
        standard = (around[0] - around.mean()) / around.std()
        wanted = (standard[lag:] * standard[:-lag]).mean()
        assert (drawn[lag:] * drawn[:-lag]).mean() == pytest.approx(wanted, abs=0.15)


def average_flat(picture):
    """Return the binomial means over 5 x 5 cells of a picture."""
    sides = [side // 8 for side in picture.shape]
    cells = picture.reshape(sides[0], 8, sides[1], 8).mean((1, 3))
    line = np.array([1, 4, 6, 4, 1]) / 16
    windows = np.lib.stride_tricks.sliding_window_view(cells, (5, 5))
    return (windows * np.multiply.outer(line, line)).sum((-2, -1))


def test_a_picture_of_regular_cells_still_gives_a_spread():
    """A covariance that sums to nothing over a window would divide by nothing."""
    rows, columns = np.indices((96, 96)) // 4
    flat = LocalFractions.of_pictures([((rows + columns) % 2)[None]])
    assert flat.deviation[0] >= 1e-7
    assert np.isfinite(flat.draw(KEY, (0, 0, 0), (3, 3, 3), ENDLESS)).all()


def test_three_phases_of_pictures_add_up():
    labels = np.random.default_rng(3).integers(0, 3, (12, 12)).repeat(8, 0).repeat(8, 1)
    shares = np.stack([labels == k for k in range(3)])
    local = LocalFractions.of_pictures([shares, shares[:, ::-1]])
    drawn = local.draw(KEY, (0, 0, 0), (6, 6, 6), ENDLESS)
    assert len(local.mean) == 3 and local.mean.sum() == pytest.approx(1)
    assert drawn.shape == (3, 6, 6, 6)


def test_cells_take_the_mean_of_what_counts_in_them():
    field = np.zeros((5, 4, 12))
    field[:, :, :4], field[4] = 1, 3
    found = cell_means(field, 4)
    assert found.shape == (2, 1, 3)
    assert found[0, 0].tolist() == [1, 0, 0]
    assert found[1, 0].tolist() == [3, 3, 3]
    inside = np.zeros(field.shape, bool)
    inside[:2, :, :3] = True
    assert cell_means(field, 4, inside=inside).tolist() == [[[1, 1, 1]], [[1, 1, 1]]]


def obedient_model(exemplar=BONE, *, specks=0):
    """Return a model whose cells are solid where it is given more than the mean, else void."""
    config = GanConfig(width=2, latent=2, specks=specks, smoothing=0, precision="float32")
    network = new_generator(config, 1)
    with torch.no_grad():
        for place, layer in enumerate(network.layers):
            middle = layer.weight.shape[-1] // 2 if place % 2 == 0 else 0
            layer.weight.zero_()
            layer.bias.zero_()
            kinds = layer.weight.shape[0] // (8 if place % 2 else 1)
            source = config.latent if place == 0 else 0  # the local fraction follows the noise
            layer.weight[::kinds, source, middle, middle, middle] = 1
    local = exemplar_fields(exemplar, config).local
    response = np.array([[0.1, 0.3], [0.0, 1.0]])  # what is asked for is twice as strong
    return GanModel(
        config,
        [exemplar_info(exemplar)],
        {
            "generator": network.state_dict(),
            "calibration": {"kind": "labels", "present": [0, 1], "offsets": [0.0]},
            "fractions": replace(local, response=response).to_json(),
        },
    )


def test_a_target_takes_the_place_of_the_drawn_fractions():
    model = obedient_model()
    mean = model.local.mean[0]
    turn = 1 - (mean - 0.1) / 0.2  # the porosity at which the mean is asked for
    field = np.full((48, 24, 24), turn - 0.05, np.float32)
    field[24:] = turn + 0.05
    made = model.generate((48, 24, 24), target={"porosity": field}).values
    assert made[:16].all() and not made[32:].any()  # doubling moves a cell by 6 voxels
    fraction = model.generate((48, 24, 24), target={"volume_fraction": 1 - field}).values
    assert np.array_equal(fraction, made)
    box = model.window((48, 24, 24), ((20, 28), (3, 9), (0, 24)), target={"porosity": field})
    assert np.array_equal(box, made[20:28, 3:9])


def what_is_given(monkeypatch):
    """Return the list of what gives cells their fractions, one of each request of 32 x 40 x 48."""
    asked = []
    monkeypatch.setattr(
        "trabecula.synth.gan.method.make_tiles",
        lambda *_, given, **__: asked.append(given) or np.zeros((32, 40, 48), np.uint8),
    )
    return asked


def test_fractions_vary_around_a_target_of_one_number(monkeypatch):
    """What is drawn is shifted, as far as the response reaches, until its mean is what was asked
    for: by it, in the whole box or in the mask alone.
    """
    model, asked = obedient_model(), what_is_given(monkeypatch)
    mean, deviation = model.local.mean[0], model.local.deviation[0]
    drawn = model.local.draw(key(2, "gan/fractions"), (0, 0, 0), (4, 5, 6), ENDLESS)[0]
    inside = np.zeros((32, 40, 48), bool)
    inside[:16], inside[16:20] = True, True  # 16 .. 20 is half of a cell
    weights = {"whole": np.ones(4), "mask": np.array([1, 1, 0.5, 0])}
    for word, mask in (("whole", None), ("mask", inside)):
        for porosity in (0.3, 0.5, 0.8):
            model.generate((32, 40, 48), seed=2, target={"porosity": porosity}, mask=mask)
            found = asked[-1]((0, 0, 0), (4, 5, 6))[0]
            made = np.interp(mean + deviation * found, [0.1, 0.3], [0, 1]).mean((1, 2))
            assert 1 - np.average(made, weights=weights[word]) == pytest.approx(porosity, abs=1e-5)
            free = np.abs(mean + deviation * found - 0.2) < 0.0999
            assert np.ptp((found - drawn)[free]) < 1e-5
            assert found.std() > 0.1
    for porosity in (0, 1):  # at an end nothing can vary
        model.generate((32, 40, 48), seed=2, target={"porosity": porosity})
        found = mean + deviation * asked[-1]((0, 0, 0), (4, 5, 6))
        assert found == pytest.approx(np.full(found.shape, (0.3, 0.1)[porosity]), abs=1e-5)


def test_what_learnt_from_a_picture_varies_around_its_target(monkeypatch):
    """It has seen no place of an even fraction: what is drawn stays, but for its mean."""
    model, asked = obedient_model(), what_is_given(monkeypatch)
    flat = tb.Image(BONE.values[0], "labels", phases=BONE.phases)
    model.facts, model.parts["spacing"] = [exemplar_info(flat)], [1.0] * 3
    porosity = 1 - (model.local.mean[0] - 0.1) / 0.2  # where the mean is asked for
    model.generate((32, 40, 48), seed=2, target={"porosity": porosity})
    found = asked[0]((0, 0, 0), (4, 5, 6))
    drawn = model.local.draw(key(2, "gan/fractions"), (0, 0, 0), (4, 5, 6), ENDLESS)
    assert found == pytest.approx(drawn - drawn.mean(), abs=1e-5)
    assert asked[0]((-1, 0, 0), (1, 1, 1)) == pytest.approx(found[:, :1, :1, :1])
    model.local.response[:] = [[0.1, 0.3], [0.15, 0.3]]
    with pytest.raises(RequestError, match="learn from a picture that has such places"):
        model.generate(24, target={"porosity": 0.9})


def test_without_a_target_the_fractions_are_drawn():
    made = obedient_model().generate(128, seed=1).values
    cells = made.reshape(16, 8, 16, 8, 16, 8).mean((1, 3, 5))
    assert set(np.unique(cells)) == {0, 1}
    assert 0.2 < cells.mean() < 0.8


def test_a_porosity_beyond_what_is_made_is_refused():
    model = obedient_model()
    model.local.response[:] = [[0.1, 0.3], [0.15, 0.3]]
    with pytest.raises(RequestError, match=r"outside of 0\.7 \.\. 0\.85"):
        model.generate(24, target={"porosity": 0.9})
    inside = np.zeros((24, 24, 24), bool)
    inside[:12] = True
    field = np.where(inside, 0.8, 0.2).astype(np.float32)
    model.generate(24, target={"porosity": field}, mask=inside)
    with pytest.raises(RequestError, match=r"0\.2 \.\. 0\.8"):
        model.generate(24, target={"porosity": field})


def test_a_model_without_local_fractions_takes_no_porosity():
    old = obedient_model()
    config = replace(old.config, fractions=0.0)
    parts = {
        "generator": new_generator(config, 1).state_dict(),
        "calibration": old.calibration,
    }
    model = GanModel(config, old.facts, parts)
    with pytest.raises(RequestError, match="learnt no local fractions"):
        model.generate(24, target={"porosity": 0.8})


@pytest.mark.parametrize(("name", "asked"), [("bone", (0.75, 0.83, 0.9)), ("berea", (0.15, 0.3))])
def test_shipped_models_make_the_porosity_that_is_asked_for(name, asked):
    """Flips keep fractions, and are left out: they take most of the time."""
    model = tb.load_model(name).unmatched()
    for porosity in asked:
        made = [model.generate(96, seed=seed, target={"porosity": porosity}) for seed in (1, 2)]
        found = np.mean([tb.measure.porosity(one) for one in made])
        assert found == pytest.approx(porosity, abs=0.015)


def test_samples_of_shipped_bone_scatter_as_parts_of_its_scan_do():
    """By the scan's covariance, windows of 64^3 have a porosity with a standard deviation of .033;
    a model without local fractions had .011.
    """
    model = tb.load_model("bone").unmatched()
    far = [((200 * i, 200 * i + 64), (0, 64), (0, 64)) for i in range(24)]
    found = [1 - model.window(64, box, seed=5).mean() for box in far]
    assert 0.02 < np.std(found) < 0.05


def test_shipped_bone_varies_around_a_porosity_as_its_scan_does():
    """Boxes of 32^3 of the scan have fractions with a standard deviation of .054; with the same
    fraction given everywhere it was .013.
    """
    model = tb.load_model("bone").unmatched()
    sizes = []
    for seed in (1, 2):
        made = model.generate(128, seed=seed, target={"porosity": 0.832}).values
        sizes.append(made.reshape(4, 32, 4, 32, 4, 32).mean((1, 3, 5)).std())
    assert np.mean(sizes) == pytest.approx(0.054, rel=0.2)


def test_a_field_of_porosity_is_followed_by_shipped_bone():
    ramp = np.linspace(0.75, 0.92, 128, dtype=np.float32)[:, None, None]
    field = np.broadcast_to(ramp, (128, 96, 96))
    made = tb.load_model("bone").generate((128, 96, 96), seed=1, target={"porosity": field})
    thirds = [1 - part.mean() for part in np.split(made.values[:126], 3)]
    assert thirds == pytest.approx([0.778, 0.834, 0.890], abs=0.025)


def test_only_what_rises_around_the_mean_can_be_asked_for():
    """A generator from six sections of Berea turned back where it was given little solid."""
    asked = np.linspace(0.6, 0.94, 9)
    made = [0.856, 0.840, 0.826, 0.814, 0.811, 0.820, 0.845, 0.893, 0.946]
    found = rising_part(np.stack([asked, made]), 6)
    assert found.tolist() == [asked[4:].tolist(), made[4:]]
    assert rising_part(np.stack([asked, asked]), 4).shape == (2, 9)
    bent = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.6, 0.7, 0.8]
    assert rising_part(np.stack([asked, bent]), 4)[1].tolist() == bent[:6]
    assert rising_part(np.stack([asked, bent]), 7)[1].tolist() == bent[6:]
    assert rising_part(np.stack([asked, asked[::-1]]), 4).shape == (2, 1)

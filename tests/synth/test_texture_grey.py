"""`texture` of scans: the structure is made as labels, then grey values or colours on it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from texture_runs import StoppedError, check_in_files, write_every_checkpoint

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.engine import checkpoint, memmap
from trabecula.engine.memory import forecast
from trabecula.measure.correlation import two_point
from trabecula.synth.shared import tiles
from trabecula.synth.texture import grey_levels
from trabecula.synth.texture.grey_beside import KnownLevels
from trabecula.synth.texture.scan_phases import find_phases
from trabecula.testing.peak import peak_bytes

SHAPE = (40, 36, 44)


def scan(values, *, seed=0, blur=1.0, grain=8.0, fine=0.7):
    """A scan of two phases: levels 60 and 160, blurred, with grain that is correlated over `fine`
    voxels.
    """
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(values.shape), fine)
    levels = 60 + 100 * ndimage.gaussian_filter(values.astype(float), blur)
    return np.clip(np.rint(levels + grain * noise / noise.std()), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def bone():
    return tb.crop(tb.sample("bone"), 48)


@pytest.fixture(scope="module")
def grey(bone):
    return tb.Image(scan(bone.values), "grey", bone.spacing, bone.unit)


@pytest.fixture(scope="module")
def model(grey):
    return tb.method("texture").fit(grey)


@pytest.fixture(scope="module")
def made(model):
    return model.generate(64, seed=1)


@pytest.fixture(scope="module")
def colour(grey):
    values = grey.values
    tint = np.stack([values, 255 - values, 90 + values // 4], axis=-1)
    return tb.Image(tint, "colour", grey.spacing, grey.unit)


def spectrum(values, bands=8):
    """Power of the middle cube of 48 voxels by frequency."""
    low = [(side - 48) // 2 for side in values.shape]
    part = values[tuple(slice(a, a + 48) for a in low)].astype(float)
    for axis in range(3):
        window = np.hanning(50)[1:-1].reshape([-1 if a == axis else 1 for a in range(3)])
        part = (part - part.mean()) * window
    squares = [np.fft.fftfreq(48) ** 2 for _ in range(3)]
    frequency = np.sqrt(sum(np.ix_(*squares)))
    place = np.minimum((frequency / 0.5 * bands).astype(int), bands)
    power = np.bincount(place.ravel(), (np.abs(np.fft.fftn(part)) ** 2).ravel())
    return power[:bands] / np.bincount(place.ravel())[:bands]


def iso(values, level=110):
    return tb.Image((np.asarray(values) > level).astype(np.uint8), "labels")


def two_point_error(image, exemplar):
    ours, own = (two_point(one, r_max=16)[1:] for one in (image, exemplar))
    return np.linalg.norm(ours - own) / np.linalg.norm(own)


@pytest.mark.whole
def test_the_histogram_is_the_scans(grey, made):
    shares = [np.bincount(one.values.ravel(), minlength=256) for one in (grey, made)]
    ends = [np.cumsum(share) / share.sum() for share in shares]
    assert np.abs(ends[0] - ends[1]).max() < 0.003


@pytest.mark.whole
def test_the_spectrum_is_the_scans(grey, made):
    """The grain, which fills the last bands, and the blur, which empties those before."""
    ratio = spectrum(made.values) / spectrum(grey.values)
    assert np.all((ratio[2:] > 0.7) & (ratio[2:] < 1.4)), ratio


@pytest.mark.whole
def test_the_iso_surface_is_that_of_labels(grey, model, made):
    """At the scan's threshold the result is what the segmented scan gives, to the voxel."""
    solid = tb.segment(grey)
    labels = tb.method("texture").fit(solid).generate(64, seed=1)
    level = solid.recipe.steps[-1]["threshold"]
    assert np.array_equal(made.values > level, labels.values)
    assert two_point_error(iso(made.values, level), solid) < 0.1


@pytest.mark.whole
def test_no_grain_is_copied(grey, made):
    """Grain of the result is found nowhere in the scan: neighbourhoods of 4^3 voxels in the dark
    phase differ from all of the scan's more than copies would.
    """

    def windows(values):
        cubes = np.lib.stride_tricks.sliding_window_view(values.astype(np.float32), (4, 4, 4))
        cubes = cubes.reshape(-1, 64)
        return cubes[cubes.max(axis=1) < 100]

    theirs = windows(grey.values)[::3]
    ours = windows(made.values)[::97][:200]
    distances = ((ours[:, None] - theirs[None]) ** 2).mean(axis=-1).min(axis=1)
    assert np.mean(distances < 4) < 0.01, "the grain has a variance of 64"


@pytest.mark.whole
def test_threads_files_and_interruptions_change_nothing(model, tmp_path, monkeypatch):
    monkeypatch.setattr(memmap, "SMALLEST", 64)
    monkeypatch.setattr(tiles, "TILE", 16)
    request = tb.Request(SHAPE, seed=3, periodic=(False, True, False))
    at_once, report = check_in_files(model, request, tmp_path)
    assert report["way"] == "structure, then grey values"

    monkeypatch.setattr(tiles, "TILE", 64)
    write_every_checkpoint(monkeypatch)

    def stop(label, done):
        if label == "level 0" and done > 0:
            raise StoppedError

    with pytest.raises(StoppedError), listen(stop), checkpoint.kept_at(tmp_path / "x.part"):
        model.compute(request)
    with checkpoint.kept_at(tmp_path / "x.part"):
        resumed, _ = model.compute(request)
    assert np.array_equal(resumed, at_once), "neither the cut into tiles nor a stop shows"


@pytest.mark.whole
def test_a_periodic_axis_joins_without_a_seam(model):
    values = model.generate((32, 32, 40), seed=2, periodic=(False, False, True)).values.astype(
        float
    )
    steps = np.abs(np.diff(values, axis=2, append=values[:, :, :1])).mean(axis=(0, 1))
    assert steps[-1] < 1.25 * steps[:-1].mean()


@pytest.mark.whole
def test_a_form_is_filled(model):
    z, y, x = np.indices(SHAPE)
    form = (z - 20) ** 2 + (y - 18) ** 2 + (x - 22) ** 2 < 16**2
    values = model.generate(SHAPE, seed=2, mask=form).values
    assert not values[~form].any() and np.all(values[form] > 0)


def piece(image, shape=SHAPE, planes=16):
    """The first planes of a scan in a larger volume, and where they are known."""
    known = np.zeros(shape, bool)
    known[:planes] = True
    values = np.zeros((*shape, *image.values.shape[3:]), np.uint8)
    values[:planes] = image.values[:planes, : shape[1], : shape[2]]
    return tb.Image(values, image.kind, image.spacing, image.unit), known


@pytest.mark.whole
@pytest.mark.parametrize("kind", ["grey", "colour"])
def test_beside_fixed_voxels_grey_values_are_new(kind, request, grey):
    exemplar = request.getfixturevalue(kind)
    fixed, known = piece(exemplar)
    made = tb.method("texture").fit(exemplar).generate(SHAPE, seed=2, fixed=fixed, known=known)
    assert np.array_equal(made.values[known], fixed.values[known])
    assert made.recipe.to_json()[-1]["report"]["way"] == "structure, then grey values"
    levels = made.values.reshape(*SHAPE, -1)[..., 0].astype(float)
    steps = np.abs(np.diff(levels, axis=0)).mean(axis=(1, 2))
    assert 0.75 * steps[20:].mean() < steps[15] < 1.3 * steps[20:].mean()
    own = grey.values[:, : SHAPE[1], : SHAPE[2]].astype(float)
    assert np.abs(levels[16:] - own[16 : SHAPE[0]]).mean() > 15, "not the scan's own continuation"


@pytest.mark.slow
def test_beside_fixed_voxels_threads_files_and_tiles_change_nothing(
    model, grey, tmp_path, monkeypatch
):
    fixed, known = piece(grey)
    monkeypatch.setattr(memmap, "SMALLEST", 64)
    monkeypatch.setattr(tiles, "TILE", 16)
    request = tb.Request(SHAPE, seed=3, fixed=fixed, known=known)
    at_once, _ = check_in_files(model, request, tmp_path)
    monkeypatch.setattr(tiles, "TILE", 64)
    assert np.array_equal(model.compute(request)[0], at_once)


@pytest.mark.whole
def test_in_a_hole_and_a_form_beside_fixed_voxels(model, grey):
    known = np.ones((48, 48, 48), bool)
    known[8:40, 8:40, 8:40] = False
    form = np.indices(known.shape)[0] < 44
    made = model.generate(known.shape, seed=2, fixed=grey, known=known, mask=form)
    assert made.recipe.to_json()[-1]["report"]["way"] == "structure, then grey values"
    assert np.array_equal(made.values[known], grey.values[known])
    hole = made.values[8:40, 8:40, 8:40]
    assert np.all(hole > 0)
    assert abs(np.mean(hole > 110) - np.mean(grey.values > 110)) < 0.06


def test_known_levels_tell_the_structure_as_the_scan_does(model, grey):
    """Of a scan that is smoothed for it: next to the joint no value beyond it plays a part."""
    scan_phases = replace(model.painted.grey.scan, smooth=1.0)
    fields = model.content.fields_of
    whole = scan_phases.structure_of(fields(grey.values))
    known = np.zeros(grey.shape, bool)
    known[:30, 5:] = True
    values = np.where(known, grey.values, 255)
    found = KnownLevels(values, known, fields, (False,) * 3).structure(scan_phases)
    inner = (slice(30 - scan_phases.reach), slice(5 + scan_phases.reach, None))
    np.testing.assert_array_equal(found[inner], whole[inner])
    beside = (29, slice(6, None))
    assert np.mean(found[beside] != whole[beside]) < 0.06


def test_what_known_levels_have_more_fades_beyond_the_joint():
    known = np.zeros((20, 12, 80), bool)
    known[..., :40] = True
    values = np.where(known, 20.0, -99.0).astype(np.float32)
    levels = np.full((1, *known.shape), 10.0, np.float32)
    sigmas = [(s, s, s) for s in (4.0, 2.0, 1.0)]
    beside = KnownLevels(values, known, lambda part: part[None], (False, False, False))
    beside.continue_in(levels, sigmas)
    line = levels[0, 10, 6]
    assert np.all(line[:40] == 20)
    assert 18 < line[40] < 20
    assert np.all(np.diff(line[40:56]) <= 1e-4)
    np.testing.assert_allclose(line[70:], 10, atol=1e-4)


@pytest.mark.whole
def test_noise_alone_tells_no_structure():
    noise = ndimage.gaussian_filter(np.random.default_rng(1).standard_normal((32, 32, 32)), 1.5)
    image = tb.Image((128 + 400 * noise).clip(0, 255).astype(np.uint8), "grey")
    lines = []
    with listen(lambda line, done: lines.append(line)):
        model = tb.method("texture").fit(image)
    assert model.painted is None
    assert any("tell no phases" in line for line in lines)
    plain = tb.method("texture", novelty=0.0).fit(image)
    assert np.array_equal(model.generate(32).values, plain.generate(32).values)


@pytest.mark.whole
def test_novelty_0_is_the_former_way(grey):
    model = tb.method("texture", novelty=0.0).fit(grey)
    assert model.painted is None
    assert "report" not in model.generate(24).recipe.to_json()[-1]


@pytest.mark.whole
def test_colours_agree_on_their_channels(colour):
    made = tb.method("texture").fit(colour).generate(SHAPE, seed=1).values.astype(int)
    assert made.shape == (*SHAPE, 3)
    assert np.mean(np.abs(made[..., 0] + made[..., 1] - 255) <= 4) > 0.98
    for channel in range(3):
        ends = np.percentile(made[..., channel], [5, 50, 95])
        assert np.allclose(ends, np.percentile(colour.values[..., channel], [5, 50, 95]), atol=3)


@pytest.mark.whole
def test_a_voxel_that_is_not_a_cube_is_smoothed_by_its_edges(bone):
    """Known truth: a scan blurred by one unit along every axis has the same weights in voxels of
    another shape.
    """
    values = bone.values.repeat(2, axis=0)[:48]
    blurred = ndimage.gaussian_filter(60 + 100.0 * values, (2.0, 1.0, 1.0))
    image = tb.Image(np.rint(blurred).astype(np.uint8), "grey", (1.0, 2.0, 2.0), "um")
    field = blurred[None].astype(np.float32)
    structure = find_phases([field], (0.63, 1.26, 1.26)).structure_of(field)
    wide, even = (
        grey_levels._fit_weights([field], [structure], 2, edges, products=False)
        for edges in ((0.63, 1.26, 1.26), (1.0, 1.0, 1.0))
    )

    def rest(weights, edges):
        parts = grey_levels._gaussians(structure, 2, edges)
        return float((field[0] - grey_levels._expected(weights[0], parts)).std())

    assert rest(wide, (0.63, 1.26, 1.26)) < rest(even, (1.0, 1.0, 1.0))
    assert tb.method("texture").fit(image).painted is not None


@pytest.mark.whole
def test_the_forecasts_hold(model, grey, colour):
    request = tb.Request((48, 48, 48), seed=1)
    grey_levels, structure = model.painted.grey, np.zeros(request.shape, np.uint8)
    structure[:20] = 1
    arrays = forecast(grey_levels.stages(request), {}).peak
    peak = peak_bytes(lambda: grey_levels.paint(structure, request)) + structure.nbytes
    assert peak <= arrays <= 1.5 * peak
    for exemplar in (grey, colour):
        method = tb.method("texture")
        plan = method.plan_fit(exemplar)
        arrays = plan.peak - plan.memory["interpreter and kernels"]
        peak = peak_bytes(lambda method=method, exemplar=exemplar: method.fit(exemplar))
        assert peak <= arrays <= 1.5 * peak, exemplar.kind


def test_the_forecast_beside_fixed_voxels_holds(model, grey):
    fixed, known = piece(grey)
    request = tb.Request(SHAPE, seed=1, fixed=fixed, known=known)
    levels, structure = model.painted.grey, np.zeros(SHAPE, np.uint8)
    beside = KnownLevels(fixed.values, known, model.content.fields_of, request.periodic)
    arrays = forecast(levels.stages(request), {}).peak
    peak = peak_bytes(lambda: levels.paint(structure, request, beside)) + structure.nbytes
    assert peak <= arrays <= 1.5 * peak

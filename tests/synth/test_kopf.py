"""`kopf`: known pictures, requests, and what its weights do."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError, RequestError
from trabecula.measure.correlation import covariance_form, two_point
from trabecula.synth.kopf.config import KopfConfig
from trabecula.synth.kopf.method import factors_of, histogram_excess
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.matching.planes import RegionViews
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sources import Candidates, Stack

QUICK = {"rounds": (3, 5), "first_rounds": 10, "sweeps": (1, 2), "tries": 4}


@pytest.fixture(scope="module")
def bone():
    volume = tb.crop(tb.sample("bone"), 64)
    return tb.Image(volume.values[32], "labels", volume.spacing[1:], volume.unit, volume.phases)


@pytest.fixture(scope="module")
def model(bone):
    return tb.method("kopf", **QUICK).fit(bone)


def stripes(shape=(48, 48), period=12):
    return (np.arange(shape[0])[:, None] // (period // 2) % 2 * np.ones(shape, int)).astype(
        np.uint8
    )


def test_stripes_in_two_views_become_layers():
    """Rows of one phase seen across y and across x: planes of one phase across z."""
    material = (
        tb.method("kopf", views=("zx", "zy"), corrections=0, **QUICK)
        .fit(stripes())
        .generate((40, 24, 24), seed=2)
    )
    along = [np.mean(np.diff(material.values.astype(int), axis=axis) != 0) for axis in range(3)]
    assert max(along[1:]) < 0.4 * along[0]


@pytest.mark.whole
def test_two_pictures_are_seen_in_their_own_views():
    """Discs across x, stripes along x across y and z: rods along x."""
    y, x = np.indices((48, 48)) % 12 - 5.5
    discs = (y**2 + x**2 < 16).astype(np.uint8)
    rods = (np.abs(y) < 2).astype(np.uint8)
    material = tb.method("kopf", corrections=0, **QUICK).fit(
        [tb.Image(rods, "labels"), tb.Image(discs, "labels")]
    )
    made = material.generate(36, seed=1).values
    along = [np.mean(np.diff(made.astype(int), axis=axis) != 0) for axis in range(3)]
    assert along[2] < 0.4 * min(along[:2])


def test_distances_count_in_the_voxels_of_their_level():
    """Across a straight edge the field rises by one step a voxel, however coarse the level."""
    model = tb.method("kopf", corrections=0, orientations="none").fit(stripes((96, 96), 96))
    slopes = []
    for level in model.levels[:3]:
        across = level.views[0][1].stack.field[0, 0, :, 5].astype(int)
        slopes.append(np.abs(np.diff(across)).max())
    assert len(slopes) == 3 and np.ptp(slopes) <= 1, slopes


@pytest.mark.slow
def test_fractions_are_the_pictures_or_the_targets(bone, model):
    made = model.generate(30, seed=1)
    assert np.count_nonzero(made.values) == round(made.values.size * bone.values.mean())
    porosity = tb.measure.porosity(bone) - 0.06
    made = model.generate(30, seed=1, target={"porosity": porosity})
    assert tb.measure.porosity(made) == pytest.approx(porosity, abs=1e-4)


def test_a_porosity_of_grey_is_refused():
    grey = tb.Image(np.random.default_rng(0).normal(size=(24, 24)).astype(np.float32), "grey")
    with pytest.raises(RequestError, match="porosity"):
        tb.method("kopf", **QUICK).fit(grey).generate(16, target={"porosity": 0.3})


@pytest.mark.whole
def test_the_picture_as_middle_slice_stays_and_is_gone_on_from(bone, model):
    shape = (33, 48, 48)
    known = np.zeros(shape, bool)
    known[16] = True
    values = np.zeros(shape, np.uint8)
    values[16] = bone.values[:48, :48]
    fixed = tb.Image(values, "labels", (bone.spacing[0],) * 3, bone.unit, bone.phases)
    made = model.generate(shape, seed=4, fixed=fixed, known=known).values
    assert np.array_equal(made[16], bone.values[:48, :48])
    joint = np.mean(made[[15, 17]] != made[16])
    apart = model.generate(shape, seed=4).values
    assert joint < 0.6 * np.mean(apart[[15, 17]] != made[16]), "no better than an independent slice"


@pytest.mark.whole
def test_a_form_is_filled_and_nothing_lies_outside(bone, model):
    z, y, x = np.indices((34, 34, 34)) - 17
    ball = z**2 + y**2 + x**2 < 15**2
    part = model.generate(ball.shape, seed=1, mask=ball).values
    assert not part[~ball].any()
    assert np.count_nonzero(part) == round(np.count_nonzero(ball) * bone.values.mean())


@pytest.mark.slow
def test_a_periodic_tile_joins_its_other_end(model):
    made = model.generate((40, 36, 36), seed=3, periodic=(True, False, False)).values.astype(int)
    inside = np.mean(np.diff(made, axis=0) != 0)
    assert np.mean(made[0] != made[-1]) < 2 * inside
    opened = model.generate((40, 36, 36), seed=3).values
    assert np.mean(opened[0] != opened[-1]) > 2 * inside


@pytest.mark.slow
def test_a_material_alike_in_all_directions_has_no_axes(bone, model):
    """Steps in the two-point function: the three axes and the diagonals agree within what one
    realisation scatters.
    """
    made = tb.method("kopf").fit(bone).generate(64, seed=0).values == 0
    phi = made.mean()

    def covariance(offset):
        here = tuple(slice(max(0, -o), 64 - max(0, o)) for o in offset)
        there = tuple(slice(max(0, o), 64 - max(0, -o)) for o in offset)
        return (np.mean(made[here] & made[there]) - phi**2) / (phi - phi**2)

    axes = [covariance(o) for o in ((5, 0, 0), (0, 5, 0), (0, 0, 5))]
    # 5.2 voxels long
    oblique = [covariance(o) for o in ((3, 3, 3), (3, -3, 3), (3, 3, -3), (-3, 3, 3))]
    assert abs(np.mean(axes) - np.mean(oblique)) < 0.12


def test_too_frequent_values_weigh_less():
    """Half of the result lies in a bin that holds a quarter of the picture: its pixels weigh 1 / (1
    + 1 / 4).
    """
    picture = np.repeat(np.array([-100, -40, 40, 100], np.int8), 64).reshape(1, 1, 16, 16)
    candidates = Candidates.of(
        Stack.of([picture]), width=8, step=2, variance=0.9, most=8, flat=True
    )
    field = np.repeat(np.array([-100, -40, 40, 40], np.int8), 16**3 // 4).reshape(1, 16, 16, 16)
    frame = RegionViews.over(Region((16, 16, 16)), [(0, candidates)], (Histogram.of(picture),))
    excess = histogram_excess(field.astype(np.int16) * 256, frame, 1.0)
    assert excess.sum() == pytest.approx(0.25)
    factors = factors_of(picture, excess, 200)[0]
    assert np.unique(factors[picture[0, 0] == 40]).tolist() == [160]
    assert np.unique(factors[picture[0, 0] != 40]).tolist() == [200]


def test_the_weights_bring_the_histogram_nearer_to_the_pictures():
    """Section 3.2 of the paper: without histogram matching, votes forget the rare values."""
    values = np.random.default_rng(0).random((30, 30)) ** 3 * 250
    picture, apart = tb.Image(values.astype(np.uint8), "grey"), []
    for strength in (0.0, 10.0):
        method = tb.method("kopf", histogram=False, reweighting=strength, corrections=0, **QUICK)
        made = method.fit(picture).generate(20, seed=1).values
        shares = [
            np.bincount(v.ravel() >> 4, minlength=16) / v.size for v in (made, picture.values)
        ]
        apart.append(np.abs(shares[0] - shares[1]).sum())
    assert apart[1] < 0.93 * apart[0]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("neighbourhood", 3),
        ("step", 5),
        ("rounds", ()),
        ("trim", 4),
        ("search", "tree"),
        ("histogram", 1),
        ("views", ("yx", "xy")),
    ],
)
def test_settings_out_of_range_are_refused(name, value):
    with pytest.raises(InputError, match=name.rstrip("s")):
        KopfConfig(**{name: value})


def test_a_picture_of_one_value_or_too_small_is_refused():
    with pytest.raises(InputError, match="one value"):
        tb.method("kopf").fit(tb.Image(np.full((30, 30), 7, np.uint8), "grey"))
    with pytest.raises(InputError, match="at least 12"):
        tb.method("kopf").fit(stripes((11, 40)))


@pytest.mark.slow
def test_berea_from_one_slice(data):
    """The covariance of the scan comes out of a slice about as well as the slice itself has it
    (0.13).
    """
    scan = tb.labels(tb.read(data / "berea_sandstone_a.tif").values)
    material = tb.method("kopf").fit(tb.Image(scan.values[100], "labels")).generate(72, seed=1)
    wanted, found = (
        covariance_form(two_point(image, r_max=24, phase=0)) for image in (scan, material)
    )
    assert np.linalg.norm(found - wanted) < 0.3 * np.linalg.norm(wanted[1:])
    assert tb.measure.largest_fraction(material, phase=0) > 0.5

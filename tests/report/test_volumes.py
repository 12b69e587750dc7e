"""Volumes held against a picture, or against one for each view."""

import numpy as np
import pytest

import trabecula as tb
from commands import refused, trabecula
from trabecula.errors import InputError, UnknownNameError
from trabecula.exemplar.views import take_slices
from trabecula.measure import covariance_form, describe, largest_fraction, two_point
from trabecula.report import verify
from trabecula.report.band import LEAST_PART, parts
from trabecula.report.metrics import find_descriptor
from trabecula.report.planes import slice_planes
from trabecula.report.stereology import Joined
from trabecula.report.summary_text import sentences


def smooth(seed: int, shape, *, share: float = 0.35, widths=(3, 3, 3)) -> np.ndarray:
    """Return a Gaussian field, cut: isotropic where the widths are equal."""
    noise = np.fft.rfftn(np.random.default_rng(seed).standard_normal(shape))
    for axis, width in enumerate(widths[-len(shape) :]):
        waves = (np.fft.rfftfreq if axis == len(shape) - 1 else np.fft.fftfreq)(shape[axis])
        damped = np.exp(-((np.pi * waves * width) ** 2))
        noise = noise * damped.reshape([-1 if a == axis else 1 for a in range(len(shape))])
    field = np.fft.irfftn(noise, shape, axes=tuple(range(len(shape))))
    return (field > np.quantile(field, 1 - share)).astype(np.uint8)


def labels(values, **fields) -> tb.Image:
    return tb.Image(np.ascontiguousarray(values), "labels", **fields)


@pytest.fixture(scope="module")
def picture() -> tb.Image:
    return labels(smooth(10, (8, 112, 112))[4])


@pytest.fixture(scope="module")
def volume() -> tb.Image:
    return labels(smooth(101, (48, 48, 48)))


@pytest.fixture(scope="module")
def certificate(picture, volume):
    return verify(picture, volume)


@pytest.mark.whole
def test_the_same_material_fails_nowhere_and_no_picture_decides_what_lies_in_space(certificate):
    assert certificate.failed == () and certificate.verdict == "not decided"
    assert any("connections in space" in reason for reason in certificate.undecided)
    assert certificate.groups["connectivity"] is None and certificate.groups["two-point"] is True
    assert (
        certificate.metrics["two_point_covariance"].passed
        and certificate.metrics["coherence"].passed
    )


@pytest.mark.whole
def test_figures_are_means_over_slices_of_every_plane(picture, volume, certificate):
    slices = [each for plane in ("yx", "zx", "zy") for each in take_slices(volume, plane)]
    assert len(slices) == 24
    metrics = certificate.metrics
    assert metrics["porosity"].value == pytest.approx(
        np.mean([tb.measure.porosity(each) for each in slices])
    )
    assert metrics["porosity_zx"].value == pytest.approx(
        np.mean([tb.measure.porosity(each) for each in slices[8:16]])
    )
    assert metrics["components"].value == pytest.approx(
        np.mean([tb.measure.components(each) for each in slices])
    )
    reach = 20
    curve = np.mean([two_point(each, r_max=reach) for each in slices], axis=0)
    form, own = covariance_form(curve), covariance_form(two_point(picture, r_max=reach))
    found = verify(picture, volume, r_max=reach, level="quick").metrics["two_point_covariance"]
    assert found.value == pytest.approx(np.linalg.norm(form - own) / np.linalg.norm(own))


@pytest.mark.whole
def test_what_only_a_volume_has_is_told_and_not_judged(volume, certificate):
    numbers = describe(volume)
    for name in (
        "components",
        "largest_fraction",
        "percolates",
        "euler_density",
        "thickness",
        "pore_size",
    ):
        metric = certificate.metrics[f"{name}_3d"]
        assert metric.value == numbers[name] and metric.passed is None and metric.real_band is None
    assert certificate.metrics["largest_fraction_3d_void"].value == largest_fraction(
        volume, phase="void"
    )
    assert find_descriptor("percolates_3d_void").title == "Percolates of void, in 3-D"
    assert find_descriptor("porosity_yx_zx").title == "Porosity in yx and zx"
    assert any("not judged" in note for note in certificate.notes)


@pytest.fixture(scope="module")
def joined():
    """Return a picture of a solid that is one component in every part, and a volume of it."""
    return labels(smooth(18, (8, 112, 112), share=0.75)[4]), smooth(208, (48, 48, 48), share=0.75)


@pytest.mark.whole
def test_connections_that_slices_imply_are_judged(joined):
    picture, values = joined
    found = verify(picture, labels(values), level="quick")
    solid, largest = (found.metrics[f"{name}_3d"] for name in ("percolates", "largest_fraction"))
    assert solid.passed is True and largest.passed is True and largest.real_band[0] > 0.8
    assert any("so it has to in space along z, y, x, and does" in note for note in found.notes)
    assert not any("the solid is joined" in text for text in found.beyond_picture)
    assert any("the void is joined" in text for text in found.beyond_picture)
    assert found.metrics["percolates_3d_void"].passed is None
    assert found.groups["connectivity"] is None, "a pass of the solid is none of the void"


@pytest.mark.whole
def test_a_volume_that_is_cut_fails_what_slices_imply(joined):
    picture, values = joined
    cut = values.copy()
    cut[24] = 0  # a void plane: seven of eight slices of it show nothing of the sort
    found = verify(picture, labels(cut), level="quick")
    assert {"percolates_3d", "largest_fraction_3d"} <= set(found.failed)
    assert found.metrics["percolates_3d"].value == {"z": False, "y": True, "x": True}
    assert found.metrics["largest_fraction_3d"].value < 0.6
    (said,) = (text for text in sentences(found) if text.startswith("Connectivity"))
    assert "BROKEN" in said and "in 3-D" in said.split(";")[0], "what slices imply comes first"


@pytest.mark.whole
def test_what_is_apart_in_the_picture_is_not_decided_by_it():
    """Take disks: balls that touch nowhere, rods, or one network have the same slices."""
    spots = labels(smooth(30, (8, 112, 112), share=0.2)[4])
    found = verify(spots, labels(smooth(31, (48, 48, 48), share=0.2)), level="quick")
    assert found.metrics["largest_fraction_3d"].passed is None
    assert found.metrics["percolates_3d"].passed is None
    text, output = found.beyond_picture[0], found.to_table()
    assert "whether the solid is joined in space" in text and "percolates along z, y, x)" in text
    assert output.startswith("image: NOT DECIDED BY THIS PICTURE")
    assert output.split("\n")[1].startswith("Not decided by this picture: whether the solid")
    assert "[Connectivity: not decided by this picture]" in output
    assert (
        "not decided by this picture" in repr(found)
        and "connectivity" not in output.split("Matches real material in: ")[1].split(".")[0]
    )
    for html in (found.to_html(), found._repr_html_()):
        assert "not decided by this picture" in html and "Not decided by this picture" in html
    assert found.to_json()["not_decided_by_picture"] == list(found.beyond_picture)
    assert found.to_json()["groups"]["connectivity"] is None


@pytest.mark.whole
def test_isotropy_is_judged_in_directions_that_no_slice_shows(joined):
    picture, values = joined
    good = verify(picture, labels(values), level="quick").metrics
    names = ("axes_apart", "oblique_covariance", "specific_surface_3d")
    assert all(good[name].passed for name in names)
    flat = tb.measure.specific_surface(labels(values))
    assert good["specific_surface_3d"].value == flat
    in_slices = good["specific_surface"]
    assert good["specific_surface_3d"].exemplar == pytest.approx(in_slices.exemplar * 4 / np.pi)
    long = labels(smooth(3, (48, 48, 48), share=0.75, widths=(3, 3, 7)))
    assert verify(picture, long, level="quick").metrics["axes_apart"].passed is False
    made = rods(0)
    like = labels(smooth(4, (8, 128, 128), share=made.mean(), widths=(5, 5, 5))[4])
    assert verify(like, labels(made), level="quick").metrics["oblique_covariance"].passed is False
    views = verify(picture, labels(values), level="quick", views=["yx", "zx"]).metrics
    assert not set(names) & set(views), "a picture of two planes says nothing of the third"


@pytest.mark.whole
def test_the_solid_of_three_phases_is_all_but_the_void():
    field = smooth(18, (8, 112, 112), share=0.75)[4]
    half = np.arange(112) // 8 % 2
    made = smooth(208, (48, 48, 48), share=0.75)
    three, phases = field * (1 + half[:, None] * half), ("void", "a", "b")
    picture = labels(three.astype(np.uint8), phases=phases)
    volume = labels(made * (1 + half[:48]).astype(np.uint8), phases=phases)
    found = verify(picture, volume, level="quick").metrics
    alone = verify(labels(field), labels(made), level="quick").metrics
    for name in ("percolates_3d", "largest_fraction_3d"):
        assert found[name].value == alone[name].value
        assert found[name].passed == alone[name].passed is True


def test_joined_planes_and_shares():
    both = Joined(("y",), 1, (0.9, 0.8)).union(Joined(("z",), 1, (0.95, 0.7)))
    assert both == Joined(("z", "y"), 2, (0.95, 0.7)) and both.implied
    assert not Joined(("y", "x"), 1, (0.99, 0.9)).implied, "layers meet nowhere"
    assert not Joined(("z", "y", "x"), 0, None).implied


@pytest.mark.whole
def test_curves_fit_into_the_parts_of_a_picture():
    """Thirds of 96 pixels are 32, less than half of a side: curves of 47 do not fit."""
    picture = labels(smooth(0, (96, 96)))
    assert verify(picture, labels(smooth(1, (64, 64, 64))), level="quick").metrics


@pytest.mark.whole
def test_level_full_tells_of_transport(picture):
    metrics = verify(picture, labels(smooth(2, (24, 24, 24))), level="full", box=16).metrics
    assert metrics["permeability_3d"].passed is None and metrics["permeability_3d_z"].value >= 0
    assert find_descriptor("permeability_3d_z").title.endswith("along z, in 3-D")


def rods(seed: int, side: int = 48) -> np.ndarray:
    """Return bars along the three axes, none oblique."""
    rng, values = np.random.default_rng(seed), np.zeros((side,) * 3, np.uint8)
    for n in range(40):
        size = np.full(3, 6)
        size[n % 3] = 40
        first = rng.integers(-10, side, 3)
        values[tuple(slice(max(0, a), a + s) for a, s in zip(first, size, strict=True))] = 1
    return values


@pytest.mark.whole
def test_rods_along_the_axes_are_caught_by_a_number(picture):
    made = rods(0)
    like = labels(smooth(4, (8, 128, 128), share=made.mean(), widths=(5, 5, 5))[4])
    metric = verify(like, labels(made), level="quick").metrics["axis_preference"]
    assert metric.passed is False and metric.value > metric.real_band[1]


def test_rows_and_columns_lie_as_the_plane_says():
    volume = labels(np.arange(24).reshape(2, 3, 4) % 7, spacing=(3, 2, 1), unit="um")
    for plane in ("yx", "zx", "zy", "xy", "xz", "yz"):
        rows, columns = ("zyx".index(axis) for axis in plane)
        (found,) = take_slices(volume, plane, 1)
        across = ({0, 1, 2} - {rows, columns}).pop()
        middle = volume.values.take(volume.shape[across] // 2, across)
        assert np.array_equal(found.values, middle if rows < columns else middle.T)
        assert found.spacing == (volume.spacing[rows], volume.spacing[columns])


def test_slices_are_spread_evenly():
    volume = labels((np.arange(12) % 12)[:, None, None] * np.ones((1, 4, 4), int))
    assert [int(each.values[0, 0]) for each in take_slices(volume, "yx", 3)] == [2, 6, 10]
    assert len(take_slices(volume, "zx", 9)) == 4


@pytest.mark.whole
def test_two_views_of_a_material_that_is_longer_along_an_axis():
    """Take cells three times as long along x: pictures (z, y) and (z, x) or (y, x) differ."""
    grown = labels(smooth(6, (48, 48, 48), widths=(3, 3, 9)))
    long = labels(smooth(7, (8, 128, 128), widths=(3, 3, 9))[4])
    across = labels(smooth(8, (8, 128, 128))[4])
    right = verify([long, across], grown, level="quick")
    names = [f"two_point_covariance_{axis}" for axis in "yx"]
    assert all(
        right.metrics[f"{name}_{planes}"].passed for name in names for planes in ("yx_zx", "zy")
    )
    turned = verify(
        [long, across], labels(grown.values.swapaxes(0, 2)), level="quick", views=["xy", "yz"]
    )
    assert "two_point_covariance_x_xy" in turned.metrics and "porosity_yz" in turned.metrics
    wrong = verify([long, across], labels(grown.values.swapaxes(0, 2)), level="quick")
    assert any(wrong.metrics[f"{name}_yx_zx"].passed is False for name in names)
    assert set(wrong.about["planes"]) == {"yx_zx", "zy"}
    alone = verify(across, grown, level="quick").metrics
    assert (
        any(alone[name].passed is False for name in names)
        and alone["two_point_covariance_zy"].passed
    )


@pytest.mark.whole
def test_broken_is_said_of_slices_too(picture):
    specks = (np.random.default_rng(0).random((48, 48, 48)) < 0.35).astype(np.uint8)
    for exemplar in (picture, [picture, picture]):
        said = " ".join(sentences(verify(exemplar, labels(specks), level="quick")))
        assert "Connectivity: BROKEN" in said


@pytest.mark.whole
def test_a_turned_picture_is_the_picture_turned():
    grown = labels(smooth(6, (48, 48, 48), widths=(3, 3, 9)))
    long = labels(smooth(7, (8, 128, 128), widths=(3, 3, 9))[4])
    plain = verify(long, grown, views=["yx", "zx"], level="quick")
    turned = verify(labels(long.values.T), grown, views=["xy", "xz"], level="quick")
    for name in ("two_point_covariance", "lineal_path_distance"):
        assert plain.metrics[name].value == pytest.approx(turned.metrics[name].value)
        rows, columns = (plain.metrics[f"{name}_{axis}"].value for axis in "yx")
        assert [turned.metrics[f"{name}_{axis}"].value for axis in "xy"] == pytest.approx(
            [rows, columns]
        )


@pytest.mark.whole
def test_a_stack_of_the_picture_is_a_copy(picture):
    stack = labels(np.repeat(picture.values[None, :64, :64], 64, axis=0))
    found = verify(picture, stack)
    assert found.metrics["coherence"].value > 1 / 3 and found.metrics["coherence"].passed is False


@pytest.mark.whole
def test_grey_and_colour_by_their_texture():
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (40, 40, 40)).astype(np.uint8)
    picture = tb.Image(rng.integers(0, 256, (96, 96)).astype(np.uint8), "grey")
    good = verify(picture, tb.Image(noise, "grey"))
    assert good.metrics["histogram_divergence"].passed and good.metrics["mean_zx"].passed
    assert not any(name.endswith("_3d") for name in good.metrics)
    cloud = sum(smooth(n, (4, 96, 96), widths=(4, 4, 4))[2] * np.uint8(40) for n in range(5))
    bars = sum(rods(n, 48) * np.uint8(40) for n in range(5))
    assert (
        verify(tb.Image(cloud, "grey"), tb.Image(bars, "grey")).metrics["texture_preference"].passed
        is False
    )
    colour = tb.Image(np.stack([picture.values] * 3, -1), "colour")
    assert verify(colour, tb.Image(np.stack([noise] * 3, -1), "colour")).metrics["mean"].passed


def test_parts_are_as_large_as_slices():
    picture = labels(smooth(0, (100, 130)))
    assert {part.shape for part in parts(picture, shape=(64, 64), share=2)} == {(50, 64)}
    assert {part.shape for part in parts(picture)} == {(33, 43)}
    tiles = list(parts(picture, shape=(30, 40)))
    assert len(tiles) == 3 * 3 and {tile.shape for tile in tiles} == {(30, 40)}
    assert {part.shape for part in parts(picture, shape=(2, 2))} == {(LEAST_PART, LEAST_PART)}
    starts = {(0, 0), (35, 45), (70, 90)}
    assert all(
        any(np.array_equal(tile.values, picture.values[y : y + 30, x : x + 40]) for tile in tiles)
        for y, x in starts
    )


def test_faces():
    picture = labels(np.eye(32, dtype=int))
    assert [(face.planes, face.suffix) for face in slice_planes([picture])] == [
        (("yx", "zx", "zy"), "")
    ]
    two = slice_planes([picture, picture])
    assert [(face.planes, face.suffix) for face in two] == [
        (("yx", "zx"), "yx_zx"),
        (("zy",), "zy"),
    ]
    assert [face.planes for face in slice_planes([picture, picture], ["xz", "yx"])] == [
        ("xz",),
        ("yx",),
    ]


def test_what_does_not_go_together_is_refused(picture, volume):
    with pytest.raises(InputError, match="a picture as well"):
        verify(picture, volume, picture)
    with pytest.raises(UnknownNameError, match="view"):
        verify(picture, volume, views=["ab"])
    with pytest.raises(InputError, match="one for each"):
        verify([picture, picture], volume, views=["yx", "zx", "zy"])
    with pytest.raises(InputError, match="voxels do not correspond"):
        verify(picture, labels(volume.values, spacing=2.0, unit="um"))
    with pytest.raises(InputError, match="give one volume, or pictures"):
        verify([volume, picture], volume)
    with pytest.raises(InputError, match="agree in kind and phases"):
        verify([picture, tb.Image(picture.values, "labels", phases=("void", "ice"))], volume)
    with pytest.raises(InputError, match="is grey, the exemplar labels"):
        verify(picture, tb.Image(volume.values * 9.0, "grey"))
    with pytest.raises(InputError, match="2-D, the exemplar 3-D"):
        verify(volume, picture)


def test_a_picture_too_small_for_parts_judges_nothing(volume):
    found = verify(labels(smooth(0, (40, 40))), volume, level="quick")
    assert found.passed is None and any("too small" in reason for reason in found.undecided)


@pytest.mark.whole
def test_the_command_line_and_the_page(tmp_path, monkeypatch, picture, volume):
    monkeypatch.chdir(tmp_path)
    tb.write(labels(picture.values, spacing=4.0, unit="um"), "picture.tif")
    np.save("volume.npy", volume.values)  # states no spacing: takes that of the views
    output = trabecula("verify", "picture.tif", "volume.npy", "--quick", "--report", "page.html")
    assert "volume.npy: NOT DECIDED BY THIS PICTURE" in output.out and "porosity_zx" in output.out
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 2, "slices of both, and a still of the volume"
    words = ("--pictures", "picture.tif", "--views", "yx,zx", "--quick")
    assert "two_point_covariance_zx" in trabecula("verify", "picture.tif", "volume.npy", *words).out
    assert "one for each" in refused(
        "verify",
        "picture.tif",
        "volume.npy",
        "--pictures",
        "picture.tif",
        "--views",
        "zx",
        "zy",
        "yx",
    )

"""Trends of fraction, direction and size: gradings are found, stationary material has none."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.cli.main import main
from trabecula.measure.smooth import gaussian
from trabecula.report.stationarity import _as_errors, find_trends
from trabecula.report.structure import lengths_along_axes, measure_structure
from trabecula.report.trend_text import trend_note
from trabecula.report.window_fields import mean_of_windows, surface_of_windows

SIDE = 72


def found(image):
    """What changes, and along which axes."""
    trends = find_trends(image, lengths_along_axes(image)).trends
    return {(trend.what, trend.name) for trend in trends if trend.found}


def graded_in_size(fine=2.0, coarse=4.0, seed=0):
    """A Gaussian field whose length grows along z, at one fraction in every slice."""
    noise = np.random.default_rng(seed).standard_normal((SIDE,) * 3).astype(np.float32)
    one, other = (gaussian(noise, length) for length in (fine, coarse))
    share = np.linspace(0, 1, SIDE)[:, None, None]
    mixed = (1 - share) * one / one.std() + share * other / other.std()
    level = np.quantile(mixed, 0.6, axis=(1, 2), keepdims=True)
    return tb.Image((mixed > level).astype(np.uint8), "labels")


def turning(degrees, seed=0, count=420, first=0.0):
    """Ellipsoids three times as long as wide, in planes across z, turning along z from `first`."""
    rng, inside = np.random.default_rng(seed), np.zeros((SIDE,) * 3, bool)
    z, y, x = np.ogrid[:SIDE, :SIDE, :SIDE]
    for centre in rng.uniform(-6, SIDE + 6, (count, 3)):
        turn = np.deg2rad(first + degrees * centre[0] / SIDE)
        box = tuple(slice(max(0, int(c - 10)), int(c + 11)) for c in centre)
        dz, dy, dx = z[box[0]] - centre[0], y[:, box[1]] - centre[1], x[..., box[2]] - centre[2]
        along = dy * np.sin(turn) + dx * np.cos(turn)
        across = dy * np.cos(turn) - dx * np.sin(turn)
        inside[box] |= (along / 9) ** 2 + (across / 3) ** 2 + (dz / 3) ** 2 <= 1
    return tb.Image(inside.astype(np.uint8), "labels")


def test_size_that_grows_at_one_fraction_is_found_as_size_alone():
    image = graded_in_size()
    assert found(image) == {("size", "z")}
    (trend,) = (
        each for each in find_trends(image, lengths_along_axes(image)).surest if each.what == "size"
    )
    assert trend.start < trend.end
    # mean chords of the solid at the ends, from faces along the axes: 2 p V over the faces
    for end, part in ((trend.start, image.values[:12]), (trend.end, image.values[-12:])):
        faces = sum(np.count_nonzero(np.diff(part.astype(int), axis=axis)) for axis in range(3))
        assert end == pytest.approx(3 * 2 * part.mean() * part.size / faces, rel=0.2)


def test_direction_that_turns_is_found_as_direction_along_its_axis():
    assert found(turning(0)) == set()
    assert ("direction", "z") in found(turning(45))
    assert {what for what, _ in found(turning(45))} == {"direction"}
    axes = turning(45).values.transpose(1, 2, 0)
    turned = tb.Image(np.ascontiguousarray(axes), "labels")
    assert ("direction", "x") in found(turned)


def test_a_direction_between_two_axes_is_seen_by_the_products():
    """From +45 to -45 degrees both axes keep their share: only their product changes."""
    image = turning(90, first=-45.0)
    _, tensor = surface_of_windows(image.values > 0, (SIDE // 3, SIDE, SIDE))
    low, high = tensor[0, 0, 0], tensor[-1, 0, 0]
    assert np.allclose(np.diag(low), np.diag(high), atol=0.03)
    assert low[1, 2] - high[1, 2] > 0.2 or high[1, 2] - low[1, 2] > 0.2
    assert ("direction", "z") in found(image)


def test_every_phase_of_several_is_tested():
    """The binder grows where the void shrinks; the third phase does not change."""
    rng = np.random.default_rng(0)
    share = np.linspace(0.1, 0.4, SIDE // 3)[:, None, None]
    cells = rng.random((SIDE // 3,) * 3)
    values = np.where(cells < 0.5, 1, np.where(cells < 0.5 + share, 2, 0)).astype(np.uint8)
    values = values.repeat(3, 0).repeat(3, 1).repeat(3, 2)
    image = tb.Image(values, "labels", phases=("void", "active", "binder"))
    changing = {what for what, _ in found(image)}
    assert {"fraction of binder", "fraction of void"} <= changing
    assert "fraction of active" not in changing


@pytest.mark.whole
def test_stationary_material_has_no_trend():
    for seed in range(12):
        made = tb.method("noise", covariance="gaussian", length=3.0, porosity=0.7).fit()
        assert found(made.generate(64, seed=seed)) == set()


def test_surface_and_tensor_of_a_plane_and_of_a_slope():
    slab = np.zeros((24, 24, 24), bool)
    slab[:, 9:15] = True
    surface, tensor = surface_of_windows(slab, (24, 24, 24))
    assert surface.ravel() == pytest.approx(2 / 23)  # two faces through 23 layers of cubes
    assert np.allclose(tensor, np.diag([0, 1, 0]))
    y, x = np.mgrid[:32, :32]
    surface, tensor = surface_of_windows(y > x, (16, 16))
    assert np.allclose(tensor[0, 0], [[0.5, -0.5], [-0.5, 0.5]])
    assert surface[0, 0] * 16 * 16 == pytest.approx(16 * np.sqrt(2), rel=0.1)
    assert np.allclose(tensor[0, 1], np.eye(2) / 2)  # nothing there


def test_windows_tile_the_middle():
    values = np.arange(7.0)[:, None] * np.ones((7, 5))
    assert mean_of_windows(values, (2, 5)).ravel() == pytest.approx([0.5, 2.5, 4.5])


def test_a_ratio_of_variances_as_a_normal_deviation():
    """As many draws of Fisher's F exceed a ratio as normal numbers exceed its deviation."""
    rng = np.random.default_rng(0)
    for upper, lower in ((5, 40), (2, 100), (5, 400)):
        draws = rng.chisquare(upper, 10**6) / upper / (rng.chisquare(lower, 10**6) / lower)
        for tail, deviation in ((0.1587, 1), (0.02275, 2), (0.00135, 3)):
            ratio = float(np.quantile(draws, 1 - tail))
            assert _as_errors(ratio, upper, lower) == pytest.approx(deviation, abs=0.06)


def test_lengths_from_lines_are_those_of_the_covariance():
    image = turning(0)
    assert lengths_along_axes(image) == pytest.approx(measure_structure(image).lengths, rel=0.02)
    grey = tb.Image(image.values + np.random.default_rng(0).normal(0, 0.2, image.shape), "grey")
    assert lengths_along_axes(grey) == pytest.approx(measure_structure(grey).lengths, rel=0.05)


@pytest.mark.whole
def test_commands_warn_in_one_line(tmp_path, capsys):
    tb.write(graded_in_size(), tmp_path / "graded.tif")
    tb.write(turning(0), tmp_path / "even.tif")
    line = "not stationary: its size changes along z"
    graded, even = str(tmp_path / "graded.tif"), str(tmp_path / "even.tif")
    for words, expected in (
        (["measure", even, "--quick"], 0),
        (["measure", graded, "--quick"], 1),
        (["fit", graded, "--method", "noise", "--out", str(tmp_path / "model")], 1),
        (["generate", graded, "--method", "noise", "--shape", "16", "--out", f"{graded}.npy"], 1),
    ):
        assert main(words) == 0
        said = capsys.readouterr().err
        assert said.count(line) == said.count("not stationary") == expected, (words, said)
        assert expected == 0 or ("--crop" in said and "tb.fields.measure" in said)


@pytest.mark.whole
def test_a_certificate_says_which_trend_leaves_it_undecided():
    image = graded_in_size()
    found = tb.verify(image, image, level="quick")
    assert any("its size changes along z" in reason for reason in found.undecided)


def test_a_note_on_a_picture_offers_no_field():
    values = (np.random.default_rng(0).random((160, 160)) < np.linspace(0.2, 0.6, 160)).astype(
        np.uint8
    )
    note = trend_note(tb.Image(values, "labels"))
    assert "fraction of solid runs" in note and note.endswith("crop an even part (--crop)")

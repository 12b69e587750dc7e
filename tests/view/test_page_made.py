"""What goes into a page: voxels that come out again, what is too large, what stands beside; without
a browser.
"""

import base64
import gzip
import json
import re

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.errors import InputError, UnknownNameError
from trabecula.view.looks import LOOKS
from trabecula.view.page import fitting


def noise(shape, levels=2, seed=0):
    return np.random.default_rng(seed).integers(0, levels, shape).astype(np.uint8)


def page_data(page):
    return json.loads(
        re.search(r'<script type="application/json" id="page">(.*?)</script>', page.html)[1]
    )


def voxels(page, index=0):
    packed = re.search(rf'id="voxels-{index}">([^<]*)<', page.html)[1]
    return np.frombuffer(gzip.decompress(base64.b64decode(packed)), np.uint8)


def test_the_voxels_of_a_page_are_those_of_the_images():
    labels, colour = noise((5, 6, 7), 3), noise((4, 3, 2, 3), 256)
    page = tb.view(tb.Image(labels, "labels", (3, 2, 1), "um"), tb.Image(colour, "colour", 2, "um"))
    np.testing.assert_array_equal(voxels(page, 0), labels.ravel())
    np.testing.assert_array_equal(voxels(page, 1), colour.ravel())
    first, second = page_data(page)["volumes"]
    assert (
        first["shape"] == [5, 6, 7] and first["edges"] == [1, 2, 3] and second["kind"] == "colour"
    )
    assert [phase["visible"] for phase in first["phases"]] == [False, True, True]


def test_a_picture_is_one_slice():
    page = tb.view(noise((8, 9)))
    assert page_data(page)["volumes"][0]["shape"] == [1, 8, 9]


def test_the_same_images_give_the_same_page():
    assert tb.view(noise((9, 9, 9))).html == tb.view(noise((9, 9, 9))).html


def test_greys_are_spread_over_bytes_and_their_range_is_told():
    values = np.linspace(-3, 5, 4096).reshape(16, 16, 16)
    page = tb.view(tb.Image(values, "grey"))
    about = page_data(page)["volumes"][0]
    assert about["range"] == pytest.approx([-3, 5], abs=0.02)
    shown = about["range"][0] + voxels(page) / 255 * (about["range"][1] - about["range"][0])
    np.testing.assert_allclose(shown, values.ravel(), atol=0.04)
    assert about["low"] < 128 < about["high"]  # Otsu's threshold of an even spread is its middle
    flat = page_data(tb.view(tb.Image(np.full((4, 4, 4), 2.5), "grey")))["volumes"][0]
    assert flat["range"][0] < flat["range"][1]


def test_a_grey_volume_that_does_not_pack_is_shown_in_fewer_greys():
    values = noise((24, 24, 24), 256)
    page = tb.view(tb.Image(values, "grey"))
    assert np.abs(voxels(page).astype(int) - values.ravel()).max() <= 2
    assert (
        "64 greys" in page.html
        and len(page.html) - len(tb.view(values[0] % 2).html) < 1.25 * values.size
    )


def test_what_is_too_large_is_taken_together_in_blocks_and_the_page_says_so(monkeypatch):
    monkeypatch.setattr(fitting, "LARGEST", 300)
    labels = np.zeros((12, 12, 13), np.uint8)
    labels[6:, :, :] = 2
    labels[:6, :6, :] = 1
    page = tb.view(tb.Image(labels, "labels", (1, 1, 2), "um"))
    about = page_data(page)["volumes"][0]
    assert about["shape"] == [6, 6, 6] and about["edges"] == [4, 2, 2] and about["coarse"] == 2
    np.testing.assert_array_equal(voxels(page).reshape(6, 6, 6), labels[::2, ::2, :12:2])
    assert "too large" in about["notes"][0] and "12 x 12 x 13" in str(about["facts"])
    grey = np.arange(12**3, dtype=np.float32).reshape(12, 12, 12)
    fit = fitting.fit_volume(tb.Image(grey, "grey"))
    blocks = grey.reshape(6, 2, 6, 2, 6, 2).mean(axis=(1, 3, 5))
    low, high = fit.range
    np.testing.assert_allclose(
        low + fit.values / 255 * (high - low), np.clip(blocks, low, high), atol=(high - low) / 400
    )


def test_the_most_frequent_label_of_a_block_is_drawn(monkeypatch):
    monkeypatch.setattr(fitting, "LARGEST", 1)
    values = np.array([0, 1, 1, 2, 2, 2, 0, 2], np.uint8).reshape(2, 2, 2)
    assert fitting.fit_volume(tb.Image(values, "labels")).values.ravel().tolist() == [2]


def test_a_thin_volume_is_taken_together_along_its_long_axes_alone(monkeypatch):
    monkeypatch.setattr(fitting, "LONGEST", 10)
    fit = fitting.fit_volume(tb.Image(noise((1, 40, 20)), "labels"))
    assert fit.block == (1, 4, 4) and fit.values.shape == (1, 10, 5)


def test_images_are_aligned_where_their_units_are_lengths():
    small = noise((4, 4, 4))
    um, mm = tb.Image(small, "labels", 5, "um"), tb.Image(small, "labels", 0.01, "mm")
    about = page_data(tb.view(um, mm))
    assert about["aligned"]
    lengths = [volume["edges"][0] * volume["scale"] for volume in about["volumes"]]
    assert lengths == pytest.approx([5e-6, 1e-5])
    apart = page_data(tb.view(um, small))
    assert not apart["aligned"] and "no common unit" in apart["volumes"][0]["notes"][0]


def test_the_looks_of_the_page_are_those_of_stills():
    table = page_data(tb.view(noise((4, 4, 4))))["table"]
    assert set(table["looks"]) == set(LOOKS)
    for name, look in LOOKS.items():
        assert (
            tuple(table["looks"][name]["solid"]) == look.solid
            and table["looks"][name]["roughness"] == look.roughness
        )
        assert table["looks"][name]["absorption"] == look.absorption
    assert sum(table["blur"]) + sum(table["blur"][:2]) == 256


def test_key_figures_stand_beside_the_image_that_they_are_of():
    metrics = {
        "porosity": {"value": 0.5, "real_band": [0.4, 0.6], "pass": True},
        "percolates": {"value": [True, False, True], "real_band": None, "pass": False},
        "mean_curvature": {"value": 1.0, "real_band": None, "pass": None},
    }
    small = noise((4, 4, 4))
    exemplar, result = page_data(tb.view(small, small, certificate={"metrics": metrics}))["volumes"]
    assert exemplar["figures"] == []
    assert result["figures"] == [
        ["porosity", "0.5", "0.4 .. 0.6", "pass"],
        ["percolates", "yes, no, yes", "", "fail"],
    ]


@pytest.mark.whole
def test_a_real_certificate_is_taken(bone):
    part = tb.crop(bone, 40)
    verdict = tb.verify(bone, part, level="quick")
    rows = page_data(tb.view(part, certificate=verdict))["volumes"][0]["figures"]
    assert sorted(row[0] for row in rows if row[0].startswith("porosity")) == [
        "porosity",
        "porosity_error",
    ]
    assert rows[0][3] in ("pass", "fail", "")


@pytest.mark.whole
def test_where_it_came_from_stands_beside(bone):
    made = tb.Image(
        noise((4, 4, 4)),
        "labels",
        recipe=tb.Recipe(({"verb": "generate", "method": "noise", "seed": 3},)),
    )
    assert ["Made by", "noise, seed 3"] in page_data(tb.view(made))["volumes"][0]["facts"]


def test_no_name_gets_out_of_its_place():
    name = '</title></script><img src=x onerror="alert(1)">{style}'
    page = tb.view(noise((4, 4, 4)), names=[name])
    assert "<img" not in page.html and page.html.count("<style>") == 1
    assert page_data(page)["volumes"][0]["name"] == name
    assert "<img" not in page._repr_html_()


def test_a_name_that_is_no_text_is_shown_all_the_same(tmp_path):
    page = tb.view(noise((4, 4, 4)), names=["scan-\udcff.tif"])
    assert "scan-?.tif" in page.save(tmp_path / "a.html").read_text(encoding="utf-8")


def test_the_policy_lets_only_this_script_and_style_run():
    html = tb.view(noise((4, 4, 4))).html
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', html)[1]
    assert policy.startswith("default-src 'none'; script-src 'sha256-") and "unsafe" not in policy
    assert not re.search(r'(?:src|href)="(?!data:,)', html) and not re.search(
        r"\son\w+=", html.split("<script>")[0]
    )


@pytest.mark.whole
def test_a_200_cube_fits_its_megabytes():
    z, y, x = np.ogrid[:100, :100, :100]
    shape = (np.sin(z / 5) + np.sin(y / 6) + np.sin(x / 4) > 0).astype(np.uint8)
    assert len(tb.view(np.tile(shape, (2, 2, 2))).html) < 3e6
    assert len(tb.view(noise((200, 200, 200))).html) < 3e6  # nothing packs worse


@pytest.mark.parametrize(
    ("images", "options", "message"),
    [
        (0, {}, "1 to 6 images, got 0"),
        (7, {}, "1 to 6 images, got 7"),
        (1, {"names": ["a", "b"]}, "1 images and 2 names"),
        (1, {"height": 10}, "200..4000"),
        (2, {"certificate": [{}] * 4}, "4 certificates for 2 images"),
        (1, {"certificate": {"porosity": 1}}, "what tb.verify returns"),
        (1, {"certificate": 3}, "what tb.verify returns"),
    ],
)
def test_what_cannot_be_shown_is_refused(images, options, message):
    with pytest.raises(InputError, match=message):
        tb.view(*[np.ones((2, 2, 2), bool)] * images, **options)


def test_an_unknown_look_suggests_the_nearest():
    with pytest.raises(UnknownNameError, match="did you mean 'stone'"):
        tb.view(np.ones((2, 2, 2), bool), look="ston")


def test_a_page_is_saved_whole_and_as_html_alone(tmp_path):
    page = tb.view(noise((4, 4, 4)), title="mine")
    assert page.save(tmp_path / "a.html").read_text(encoding="utf-8") == page.html
    with pytest.raises(InputError, match=r"\.html"):
        page.save(tmp_path / "a.png")
    assert [path.name for path in tmp_path.iterdir()] == ["a.html"]


def test_a_notebook_shows_the_page_in_a_frame_without_rights():
    shown = tb.view(noise((4, 4, 4)), height=300)._repr_html_()
    assert 'height="300"' in shown and 'sandbox="allow-scripts allow-downloads"' in shown
    assert "<script" not in shown  # all of it is inside the attribute


def test_a_notebook_shows_an_image_as_slices_and_a_still():
    values = noise((12, 10, 8))
    shown = tb.Image(values, "labels", 5, "um")._repr_html_()
    pictures = re.findall(r"base64,([^\"]*)", shown)
    assert len(pictures) == 2 and "voxel 5x5x5 um" in shown
    assert all(base64.b64decode(picture).startswith(b"\x89PNG") for picture in pictures)
    assert len(re.findall("base64,", tb.Image(values, "grey")._repr_html_())) == 1
    assert len(re.findall("base64,", tb.Image(values[0], "labels")._repr_html_())) == 1


def test_the_core_draws_nothing_by_itself(monkeypatch):
    monkeypatch.setattr("trabecula.core.display.html", None)
    assert tb.Image(noise((4, 4)), "labels")._repr_html_() is None

"""The page and the table: self-contained, well-formed, honest about the verdict."""

import base64
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from scipy import ndimage

import trabecula as tb
from trabecula.measure.registry import DESCRIPTORS, GROUPS
from trabecula.report import page, verify
from trabecula.report.metrics import find_descriptor, in_order
from trabecula.report.plot import curve_plot, place_plot, ticks

PNG = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
)
VOID_TAGS = {"meta", "img", "br"}


class Nesting(HTMLParser):
    """Fails where tags do not close in order."""

    def __init__(self):
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag, attrs):
        if tag not in VOID_TAGS:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def certificate():
    rng = np.random.default_rng(0)
    smooth = [ndimage.gaussian_filter(rng.normal(size=(48,) * 3), 1.5, mode="wrap") for _ in "ab"]
    exemplar, image = (
        tb.Image(field > level, "labels", spacing=2.0, unit="um")
        for field, level in zip(smooth, (0.0, 0.1), strict=True)
    )
    return verify(exemplar, image, names=["<worse & worse>"])


@pytest.fixture(scope="module")
def quick():
    rng = np.random.default_rng(1)
    volumes = [(rng.random((50, 50, 50)) < p).astype(np.uint8) for p in (0.5, 0.5, 0.3)]
    return verify(*volumes, names=["one", "two"], level="quick")


@pytest.mark.whole
def test_page_is_one_self_contained_file(certificate, tmp_path):
    path = tmp_path / "deep" / "certificate.html"
    html = certificate.to_html(path, pictures=[("a slice", PNG), ("of a file", _file(tmp_path))])
    assert path.read_text(encoding="utf-8") == html
    assert not re.search(r"https?:|<script|<link|url\((?!#)|@import", html)
    assert html.count(base64.b64encode(PNG).decode()) == 2
    parser = Nesting()
    parser.feed(html)
    assert parser.open == []
    assert "<worse" not in html and "&lt;worse &amp; worse&gt;" in html


def test_page_says_the_verdict_and_every_figure(certificate):
    html = certificate.to_html()
    assert certificate.passed is False and "FAIL" in html.split("<h2>")[0]
    for name in certificate.metrics:
        assert f"<code>{name}</code>" in html
    figures = html.split("<h2>Figures</h2>")[1].split("</table>")[0]
    assert figures.count('class="n FAIL"') == len(certificate.failed)
    assert all(GROUPS[group] in html.split("<h2>")[0] for group in certificate.groups)
    assert "Gaussian field" in figures


@pytest.mark.whole
def test_several_images_stand_in_one_table_and_one_set_of_curves(quick):
    html = page(quick)
    assert html.count('<div class="verdict') == 2 and html.count("<h2>Figures</h2>") == 1
    assert html.count("Two-point function, radial</text>") == 1
    svg = html.split("Two-point function, radial</text>")[1].split("</svg>")[0]
    assert 'class="line1"' in svg and 'class="line2"' in svg and 'class="baseline"' not in svg
    assert re.search(r'class="mark"[^>]*>2<', html)


def test_nothing_of_nothing():
    with pytest.raises(tb.errors.InputError, match="at least one"):
        page([])


def test_pictures_that_cannot_be_shown(certificate, tmp_path):
    with pytest.raises(tb.errors.FileError, match="picture"):
        certificate.to_html(pictures=[("gone", tmp_path / "gone.png")])
    with pytest.raises(tb.errors.InputError, match="PNG"):
        certificate.to_html(pictures=[("not one", b"GIF89a")])


def test_nothing_is_left_of_a_page_that_cannot_be_written(certificate, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(tb.errors.FileError):
        certificate.to_html(tmp_path / "file" / "page.html")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_table_holds_a_line_for_every_metric(certificate):
    lines = certificate.to_table().splitlines()
    assert lines[0].startswith("<worse & worse>: FAIL")
    verdicts = {
        line.split()[0]: line.split()[-1]
        for line in lines
        if line.split()[:1] and line.split()[0] in certificate.metrics
    }
    words = {True: "pass", False: "FAIL", None: "-"}
    assert verdicts == {name: words[metric.passed] for name, metric in certificate.metrics.items()}


def test_ticks_are_round_and_inside():
    assert ticks(0, 1) == [0, 0.2, 0.4, 0.6, 0.8, 1.0]
    assert ticks(0, 0.17) == [0, 0.05, 0.1, 0.15]
    assert ticks(-0.3, 50) == [0, 20, 40] or ticks(-0.3, 50)[0] >= -0.3
    assert ticks(2, 2) == [2]


def test_curves_keep_inside_their_frame():
    svg = curve_plot(
        {"a": [1.0, -0.5, 0.2], "b": [0.0, 2.0, 0.1]},
        title="t",
        x_label="r",
        band=([0, 0, 0], [1, 3, 1]),
    )
    coordinates = [tuple(map(float, pair.split(","))) for pair in re.findall(r"[\d.]+,[\d.]+", svg)]
    assert len(coordinates) == 12
    assert all(48 <= x <= 368 and 26 <= y <= 212 for x, y in coordinates)


@pytest.mark.parametrize(
    ("value", "shape"), [(0.5, "circle"), (99.0, "polygon"), (-99.0, "polygon"), (None, None)]
)
def test_place_is_a_dot_inside_and_an_arrow_beyond(value, shape):
    marks = re.findall(r'<(\w+) class="dot"', place_plot([value], (0.0, 1.0), 0.4))
    assert marks == ([shape] if shape else [])


def _file(folder):
    (folder / "slice.png").write_bytes(PNG)
    return folder / "slice.png"


def test_figures_of_axes_and_phases_know_their_own():
    assert (
        find_descriptor("diffusivity_z").title.endswith("along z")
        and find_descriptor("diffusivity_z").group == "physics"
    )
    assert find_descriptor("fraction_binder_2").title == "Fraction of binder_2"
    assert in_order(["coherence", "permeability_x", "porosity", "permeability"]) == [
        *("porosity", "permeability_x", "permeability", "coherence")
    ]
    assert {one.group for one in DESCRIPTORS.values()} == {"", *GROUPS}

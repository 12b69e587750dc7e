"""A certificate printed to PDF by a browser."""

import base64
import re
import zlib

import pytest
from chromium import MISSING, Chromium, find_browser

import trabecula as tb
from trabecula.report import page

pytestmark = [
    pytest.mark.skipif(find_browser() is None, reason=MISSING),
    pytest.mark.whole,
]


def test_a_certificate_prints_on_a4_without_what_is_for_the_screen(tmp_path):
    exemplar = tb.crop(tb.sample("bone"), 32)
    made = tb.method("noise", reach=6).fit(exemplar).generate(32, seed=11)
    certificate = tb.verify(exemplar, made, level="quick", r_max=8)
    place = tmp_path / "report.html"
    place.write_text(page([certificate], date="2031-05-06"), encoding="utf-8")
    browser = Chromium()
    try:
        shown = browser.open(place.as_uri())
        found = browser.call(
            "Page.printToPDF", shown.session, preferCSSPageSize=True, printBackground=True
        )
    finally:
        browser.close()
    pdf = base64.b64decode(found["data"])
    assert pdf.startswith(b"%PDF-")
    sheets = re.findall(rb"/Type /Page\b", pdf)
    box = re.search(rb"/MediaBox \[([\d. ]+)\]", pdf)[1].split()
    # A4 in points
    assert [round(float(side)) for side in box[2:]] == [595, 842]
    assert 2 <= len(sheets) <= 8
    drawn = [
        zlib.decompress(part)
        for part in re.findall(rb"/FlateDecode.*?>>\s*stream\r?\n(.*?)\r?\nendstream", pdf, re.S)
        if part[:1] == b"x"
    ]
    assert sum(b" Tf" in one for one in drawn) == len(sheets)  # text on every sheet

"""Draw the picture strip of the README, docs/images/strip.png: exemplar, result, certificate, part.

    python docs/build.py strip

All of it is made from sample:bone. The certificate is its page as headless Chromium shows it.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import trabecula as tb
from trabecula.pipeline.certificate_page import write_page

_PANEL, _GAP, _TITLE = (300, 270), 8, 26
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_SEED = 7


def draw(path: Path) -> None:
    """Make the material and the part, and draw the four panels beside each other."""
    exemplar = tb.sample("bone")
    model = tb.method("texture").fit(exemplar)
    material = tb.finish.connect(model.generate(120, seed=_SEED))
    part = tb.finish.connect(model.generate(_ring(), mask=_ring_mask(), seed=_SEED))
    verdict = tb.verify(exemplar, material, names=["material"])
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        tb.render(exemplar, place / "exemplar.png", look="bone", size=(600, 540))
        tb.render(material, place / "material.png", look="bone", size=(600, 540))
        tb.render(part, place / "part.png", look="bone", size=(600, 540), camera=(32, 45))
        write_page(place / "report.html", exemplar, [material], [verdict])
        _photograph(place / "report.html", place / "certificate.png")
        titles = {
            "exemplar": "1  the exemplar, sample:bone",
            "material": "2  more of it: new, in one piece",
            "certificate": "3  the certificate",
            "part": "4  a part: a form filled with it",
        }
        panels = [(Image.open(place / f"{name}.png"), title) for name, title in titles.items()]
        strip = _compose(panels)
    path.parent.mkdir(parents=True, exist_ok=True)
    strip.quantize(128, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size // 1000} kB; certificate: {verdict.verdict}")


def _ring() -> tuple[int, int, int]:
    return 60, 160, 160


def _ring_mask() -> np.ndarray:
    """Return a torus, lying flat."""
    shape = _ring()
    z, y, x = (i - (n - 1) / 2 for i, n in zip(np.indices(shape), shape, strict=True))
    return np.hypot(np.hypot(y, x) - 52, z) < 27


def _photograph(page: Path, out: Path) -> None:
    """Photograph the head of a page with the browser at hand."""
    browser = next(filter(None, map(shutil.which, _BROWSERS)), None)
    if browser is None:
        raise SystemExit("the strip needs Chromium: apt-get install chromium")
    words = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--no-first-run"]
    words += ["--disable-background-networking", f"--user-data-dir={page.parent / 'browser'}"]
    words += [f"--screenshot={out}", "--window-size=780,702", page.as_uri()]
    subprocess.run([browser, *words], check=True, capture_output=True)


def _compose(panels: list[tuple[Image.Image, str]]) -> Image.Image:
    wide, high = _PANEL
    size = (len(panels) * (wide + _GAP) - _GAP, high + _TITLE)
    strip = Image.new("RGB", size, "white")
    pen, font = ImageDraw.Draw(strip), ImageFont.load_default(15)
    for place, (picture, title) in enumerate(panels):
        left = place * (wide + _GAP)
        small = picture.convert("RGB").resize(_PANEL, Image.Resampling.LANCZOS)
        strip.paste(small, (left, _TITLE))
        pen.rectangle((left, _TITLE, left + wide - 1, _TITLE + high - 1), outline="#c9c6bd")
        pen.text((left + 2, 3), title, fill="#1c1b19", font=font)
    return strip

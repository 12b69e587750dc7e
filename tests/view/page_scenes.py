"""Small scenes of the page, and their pictures as they should be.

`python tests/view/page_scenes.py` draws them again into tests/view/golden.
"""

import base64
import io
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image as Pillow

import trabecula as tb

GOLDEN = Path(__file__).parent / "golden"
WINDOW = (240, 260)
SHARP = (
    "new Promise((done) => { const wait = () => "
    "(app.passes >= 4 ? done(app.frames) : setTimeout(wait, 20)); wait(); })"
)
READY = (
    "window.trabecula.ready.then((app) => "
    f"{{ window.app = app; return app.drawing ? {SHARP} : 0; }})"
)


def nested(side=24):
    """A ball in a shell, and a rod through both."""
    z, y, x = np.mgrid[:side, :side, :side] - side / 2 + 0.5
    far = np.sqrt(z**2 + y**2 + x**2)
    labels = np.where(far < side / 5, 2, np.where(far < side / 2.4, 1, 0))
    labels[(np.abs(z) < side / 10) & (np.abs(y) < side / 10)] = 2
    return tb.Image(labels.astype(np.uint8), "labels", 2, "um", ("void", "shell", "core"))


def helix(side=24):
    """Lines (z, y, x, speed) that wind about the x axis."""
    t = np.linspace(0, 1, 60)
    turns = (2 * np.pi * (2 * t + k / 3) for k in range(3))
    middle, far = side / 2, 0.42 * side
    return [
        np.stack([middle + far * np.sin(w), middle + far * np.cos(w), side * t, t], axis=1)
        for w in turns
    ]


def ramp(side=24):
    """A grey volume, brighter along x, and waves in it."""
    z, y, x = np.mgrid[:side, :side, :side] / side
    values = 255 * np.clip(0.8 * x + 0.2 * np.sin(12 * z) * np.sin(12 * y), 0, 1)
    return tb.Image(values.astype(np.uint8), "grey", 1, "um")


SCENES = {
    "surface": (lambda: tb.view(nested(), look="bone"), ""),
    "opacity": (
        lambda: tb.view(nested(), look="foam"),
        "app.setCut('none'); app.volumes[0].phases[1].opacity = 0.4; app.volumes[0].dirty = true",
    ),
    "lines": (lambda: tb.view(nested(), look="stone", streamlines=helix()), ""),
    "cloud": (
        lambda: tb.view(ramp(), look="bread"),
        "app.volumes[0].opacity = 0.4; app.volumes[0].dirty = true",
    ),
}


def draw(browser, name, folder):
    """Return (H, W, 3) uint8: the picture of a scene, once it is sharp; and the page's errors."""
    make, script = SCENES[name]
    path = make().save(Path(folder) / f"{name}.html")
    tab = browser.open(path.as_uri(), size=WINDOW)
    tab.run(READY)
    tab.run(f"{script}; app.cameras[0].zoom = 1.7; app.redraw()")
    tab.run(SHARP)
    picture, errors = canvas(tab), tab.errors
    tab.close()
    return picture, errors


def canvas(tab):
    """Return (H, W, 3) uint8: the picture of a page."""
    data = tab.run("document.getElementById('picture').toDataURL().split(',')[1]")
    return np.asarray(Pillow.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))


def main():
    import chromium

    browser = chromium.Chromium()
    try:
        with tempfile.TemporaryDirectory() as folder:
            for name in sys.argv[1:] or SCENES:
                picture = Pillow.fromarray(draw(browser, name, folder)[0])
                picture.save(GOLDEN / f"{name}.png", optimize=True)
    finally:
        browser.close()


if __name__ == "__main__":
    main()

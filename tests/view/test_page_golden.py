"""Small pictures of the page against those that were kept, drawn by the software rasteriser."""

import chromium
import numpy as np
import page_scenes
import pytest
from PIL import Image as Pillow

pytestmark = [
    pytest.mark.skipif(chromium.find_browser() is None, reason=chromium.MISSING),
    pytest.mark.whole,
]

# Rasterisers differ in rounding alone: of what is drawn the mean difference of a channel, 0..255,
# and the share of pixels that are further off, as along rims.
MEAN, FAR, SHARE = 2.0, 24, 0.02


@pytest.mark.parametrize("name", page_scenes.SCENES)
def test_a_scene_looks_as_it_did(browser, tmp_path, name):
    kept = np.asarray(Pillow.open(page_scenes.GOLDEN / f"{name}.png").convert("RGB")).astype(int)
    picture, errors = page_scenes.draw(browser, name, tmp_path)
    assert errors == [] and picture.shape == kept.shape
    off = np.abs(picture - kept).max(axis=-1)
    drawn = np.abs(kept - kept[0, 0]).max(axis=-1) > 12
    assert drawn.mean() > 0.05
    assert off[drawn].mean() < MEAN
    assert (off > FAR).sum() < SHARE * drawn.sum()


def linear(picture):
    value = picture / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def test_a_translucent_phase_takes_light_by_the_law_of_beer(browser, tmp_path):
    # seen along y: 10 voxels of the translucent phase before an opaque one
    values = np.zeros((24, 24, 24), np.uint8)
    values[:, 2:12], values[:, 12:22] = 1, 2
    image = page_scenes.tb.Image(values, "labels", 1, "um", ("void", "veil", "wall"))
    path = page_scenes.tb.view(image).save(tmp_path / "page.html")
    tab = browser.open(path.as_uri(), size=page_scenes.WINDOW)
    tab.run(page_scenes.READY)
    tab.run("app.setCut('none'); app.homeAngles.azimuth = app.homeAngles.elevation = 0; app.home()")

    def middle(script):
        tab.run(f"{script}; app.volumes[0].dirty = true; app.redraw()")
        tab.run(page_scenes.SHARP)
        picture = page_scenes.canvas(tab)
        height, width = picture.shape[0] // 2 - 8, picture.shape[1] // 2
        return linear(picture[height - 3 : height + 3, width - 3 : width + 3].mean(axis=(0, 1)))

    wall = middle("app.volumes[0].phases[1].visible = false")
    found = []
    for opacity in (0.3, 0.5):
        seen = middle(
            f"Object.assign(app.volumes[0].phases[1], {{visible: true, opacity: {opacity}}})"
        )
        left = np.exp(-10 * (0.02 + 0.6 * opacity**2))
        found.append((seen - left * wall) / (1 - left))  # the phase's own light
    tab.close()
    np.testing.assert_allclose(found[0], found[1], rtol=0.1)
    assert np.abs(found[0] - wall).max() > 0.05

"""The page in a real browser: what is drawn, what moves it, and that it asks nothing of the
network.
"""

import base64
import io
import json

import chromium
import numpy as np
import pytest
from page_scenes import READY, SHARP
from PIL import Image as Pillow

import trabecula as tb
from trabecula.view.page.server import PageServer

pytestmark = pytest.mark.skipif(chromium.find_browser() is None, reason=chromium.MISSING)

WINDOW = (280, 220)


def foam(side=24, seed=0):
    noise = np.random.default_rng(seed).normal(size=(side,) * 3)
    for axis in range(3):
        noise = sum(np.roll(noise, shift, axis) for shift in range(-2, 3))
    return tb.Image((noise > 0).astype(np.uint8), "labels", 20, "um")


@pytest.fixture
def show(browser, tmp_path):
    """Open a page of some images from a file; everything that went wrong in it fails the test at
    its end.
    """
    tabs = []

    def open_page(*images, size=WINDOW, before="", **options):
        path = tb.view(*images, **options).save(tmp_path / "page.html")
        tabs.append(browser.open(path.as_uri(), size=size, before=before))
        tabs[-1].run(READY)
        return tabs[-1]

    yield open_page
    for tab in tabs:
        assert tab.errors == []
        assert all(url.startswith(("file:", "data:", "blob:")) for url in tab.requests)
        tab.close()


def canvas(tab):
    """Return (H, W, 3): the picture alone, once it is sharp."""
    tab.run(SHARP)
    data = tab.run("document.getElementById('picture').toDataURL().split(',')[1]")
    return np.asarray(Pillow.open(io.BytesIO(base64.b64decode(data))).convert("RGB")).astype(int)


def stage(tab):
    return tab.run(
        "[document.getElementById('stage').clientWidth, "
        "document.getElementById('stage').clientHeight]"
    )


def apart(one, other):
    """Return the mean difference of two pictures, 0..255."""
    return np.abs(one - other).mean()


def middle_of(tab, selector):
    return tab.run(
        f"(() => {{ const r = document.querySelector('{selector}').getBoundingClientRect();"
        "return [r.x + r.width / 2, r.y + r.height / 2]; })()"
    )


@pytest.mark.whole
@pytest.mark.parametrize(
    ("look", "cut"), [("bone", "corner"), ("bread", "none"), ("stone", "plane=60,10,0.4")]
)
def test_page_and_still_are_one_picture(show, look, cut):
    image = foam(32)
    tab = show(image, look=look)
    if cut == "none":
        tab.run("app.setCut('none')")
    elif cut != "corner":
        tab.run(
            "Object.assign(app.cut, {free: true, azimuth: 60, elevation: 10, offset: 0.4}); "
            "app.setCut('none')"
        )
    page = canvas(tab)
    still = tb.render(image, size=stage(tab), look=look, cut=cut).values.astype(int)
    # the still's scale bar is in the picture, the page's lies over it
    rows = slice(0, -max(30, len(still) // 8))
    page, still = page[rows], still[rows]
    assert (np.abs(still - still[0, 0]).max(axis=-1) > 12).mean() > 0.1
    assert apart(page, still) < 1.5
    assert (np.abs(page - still).max(axis=-1) > 24).mean() < 0.01


@pytest.mark.whole
@pytest.mark.parametrize("opacity", [1, 0.5])
def test_what_is_skipped_would_not_have_been_seen(show, opacity):
    values = np.zeros((40, 40, 40), bool)
    values[4:9, 30:35, 5:20], values[20:22, :, 22:24] = True, True
    tab = show(values)
    tab.run(
        f"app.setCut('none'); app.volumes[0].phases[1].opacity = {opacity}; "
        "app.volumes[0].dirty = true; "
        "app.redraw()"
    )
    canvas(tab)
    shown = (
        f"(app.paint(1, 0, {{skip: {word}}}), "
        "document.getElementById('picture').toDataURL().split(',')[1])"
        for word in ("true", "false")
    )
    skipped, all_steps = (
        np.asarray(Pillow.open(io.BytesIO(base64.b64decode(tab.run(words)))).convert("RGB")).astype(
            int
        )
        for words in shown
    )
    assert skipped.std() > 1 and apart(skipped, all_steps) < 0.2
    counts = [
        tab.run(f"app.measure({{frames: 1, skip: {word}}}).samples") for word in ("true", "false")
    ]
    assert counts[0] < 0.5 * counts[1]


def test_phases_are_drawn_in_their_colours_as_in_a_still(show):
    values = foam(24).values.copy()
    values[:, :, 12:] *= 2
    image = tb.Image(values, "labels")
    tab = show(image)
    page, still = canvas(tab)[:-40], tb.render(image, size=stage(tab)).values.astype(int)[:-40]
    assert apart(page, still) < 1.5
    tab.run("app.volumes[0].phases[2].visible = false; app.volumes[0].dirty = true; app.redraw()")
    assert (
        apart(
            canvas(tab)[:-40],
            tb.render(image, size=stage(tab), phase="solid").values.astype(int)[:-40],
        )
        < 1.5
    )


@pytest.mark.whole
def test_a_dragged_handle_moves_its_plane_and_the_slider_follows(show):
    tab = show(foam())
    before = canvas(tab)
    x, y = middle_of(tab, "[data-grip=z]")
    tab.drag((x, y), (x, y - 30))
    assert apart(canvas(tab), before) > 1
    assert tab.run("app.cut.at[2]") > 0.55
    assert tab.run("Number(document.querySelector('input[name=z]').value)") == pytest.approx(
        tab.run("app.cut.at[2]"), abs=0.005
    )
    assert tab.run("app.cut.at.slice(0, 2)") == [0.5, 0.5]


@pytest.mark.whole
def test_the_free_plane_is_tilted_and_shifted_by_its_handles(show):
    tab = show(foam(), size=(400, 300))
    tab.run("document.querySelector('input[name=\"Free plane\"]').click()")
    before, azimuth = canvas(tab), tab.run("app.cut.azimuth")
    x, y = middle_of(tab, "[data-grip=tilt]")
    tab.drag((x, y), (x, y - 25))
    tilted = canvas(tab)
    assert apart(tilted, before) > 1 and tab.run("app.cut.elevation") > 30
    assert tab.run("Number(document.querySelector('input[name=Lift]').value)") > 30
    x, y = middle_of(tab, "[data-grip=plane]")
    tab.drag((x, y), (x + 20, y - 10))
    assert apart(canvas(tab), tilted) > 1 and tab.run("app.cut.offset") > 0.55
    assert tab.run("app.cut.azimuth") == pytest.approx(azimuth, abs=20)


@pytest.mark.whole
def test_sliders_and_keys_do_what_the_mouse_does(show):
    tab = show(foam())
    before = canvas(tab)
    tab.run(
        "const s = document.querySelector('input[name=x]'); s.value = 0.8; s.dispatchEvent(new "
        "Event('input'))"
    )
    cut = canvas(tab)
    assert apart(cut, before) > 1 and tab.run("app.cut.at[0]") == 0.8
    tab.run("document.getElementById('picture').focus()")
    tab.press("ArrowLeft")
    assert tab.run("app.cameras[0].azimuth") != 32 and apart(canvas(tab), cut) > 1
    tab.press("0")
    assert apart(canvas(tab), cut) == 0
    tab.press("c")
    assert tab.run("app.cut.mode") == "planes"


@pytest.mark.whole
def test_mouse_wheel_and_touch_turn_move_and_zoom(show):
    tab = show(foam())
    x, y = 30, middle_of(tab, "#picture")[1]
    tab.drag((x, y), (x + 40, y))
    assert tab.run("app.cameras[0].azimuth") == pytest.approx(32 - 0.4 * 40)
    tab.mouse("mouseWheel", x, y, button="none", deltaX=0, deltaY=-200)
    assert tab.run("app.cameras[0].zoom") > 1.2
    tab.run("app.home()")
    tab.resize(*WINDOW, touch=True)
    tab.fingers("touchStart", (60, y), (120, y))
    tab.fingers("touchMove", (40, y), (160, y))
    tab.fingers("touchEnd")
    assert tab.run("app.cameras[0].zoom") == pytest.approx(2, rel=0.1)
    assert abs(tab.run("app.cameras[0].pan[0]")) > 0


@pytest.mark.whole
def test_looks_change_the_picture_and_come_from_the_table(show):
    tab = show(foam())
    pictures = []
    for name in ("bone", "foam", "bread", "sponge", "stone"):
        tab.run(
            f"{{ const s = document.querySelector('select[name=Look]'); s.value = '{name}'; "
            f"s.onchange(); }}"
        )
        pictures.append(canvas(tab))
    gaps = [apart(one, other) for k, one in enumerate(pictures) for other in pictures[:k]]
    assert min(gaps) > 1


@pytest.mark.whole
def test_linked_cameras_turn_together_and_lengths_are_one_scale(show):
    coarse = tb.Image(np.ones((10, 10, 10), np.uint8), "labels", 0.04, "mm")
    fine = tb.Image(np.ones((20, 20, 20), np.uint8), "labels", 10, "um")
    tab = show(coarse, fine, names=["coarse", "fine"])
    drawn = np.abs(canvas(tab) - canvas(tab)[0, 0]).max(axis=-1) > 12
    wide = [
        np.ptp(np.flatnonzero(half.any(axis=0))) + 1 for half in np.array_split(drawn, 2, axis=1)
    ]
    assert wide[0] == pytest.approx(2 * wide[1], abs=4)  # 400 um beside 200 um
    tab.run("app.cameras[1].azimuth = 80; app.redraw()")
    assert tab.run("app.cameras[0].azimuth") == 80
    tab.run("app.link(false); app.cameras[1].azimuth = 10; app.redraw()")
    assert tab.run("app.cameras.map((camera) => camera.azimuth)") == [80, 10]


def test_volumes_without_a_common_unit_say_so(show):
    tab = show(foam(12), np.ones((12, 12, 12), bool))
    assert "no common unit" in tab.run("document.getElementById('panel').textContent")


@pytest.mark.whole
def test_grey_follows_its_transfer_function(show):
    ramp = np.broadcast_to(np.linspace(0, 250, 24).astype(np.uint8), (24, 24, 24))
    tab = show(tb.Image(ramp, "grey"), size=(400, 360))
    tab.run("app.setCut('none'); app.homeAngles.azimuth = app.homeAngles.elevation = 0; app.home()")

    def share(low):
        tab.run(
            f"Object.assign(app.volumes[0], {{low: {low}, high: {low}, dirty: true}}); app.redraw()"
        )
        picture = canvas(tab)
        return (np.abs(picture - picture[0, 0]).max(axis=-1) > 8).mean()

    shares = [share(low) for low in (0, 64, 128, 192)]
    assert np.diff(shares) == pytest.approx([-shares[0] / 4] * 3, rel=0.25)
    solid = canvas(tab)
    tab.run(
        "document.querySelector('input[name=Opacity]').value = 0.3; "
        "document.querySelector('input[name=Opacity]').oninput()"
    )
    assert apart(canvas(tab), solid) > 1


@pytest.mark.whole
def test_colour_is_shown_as_it_is(show):
    values = np.zeros((16, 16, 16, 3), np.uint8)
    values[..., :8, :] = (220, 30, 30)
    values[..., 8:, :] = (30, 30, 220)
    tab = show(tb.Image(values, "colour"))
    tab.run("app.setCut('none'); app.homeAngles.azimuth = app.homeAngles.elevation = 0; app.home()")
    picture = canvas(tab)
    (height, width), red, blue = picture.shape[:2], picture[..., 0], picture[..., 2]
    assert (red > blue + 60)[height // 2, width // 2 - 20] and (blue > red + 60)[
        height // 2, width // 2 + 20
    ]


@pytest.mark.whole
def test_the_screenshot_is_a_picture_of_the_stage(show):
    tab = show(foam(), names=["a foam"])
    data = tab.run(
        "app.screenshot(false).then((blob) => blob.arrayBuffer())"
        ".then((bytes) => btoa(String.fromCharCode(...new Uint8Array(bytes))))"
    )
    shot = np.asarray(Pillow.open(io.BytesIO(base64.b64decode(data))).convert("RGB")).astype(int)
    assert list(shot.shape[1::-1]) == stage(tab)
    picture = canvas(tab)
    assert apart(shot[40:-50], picture[40:-50]) < 0.5
    assert apart(shot[-50:], picture[-50:]) > 0.5  # the scale bar


@pytest.mark.whole
def test_slices_show_the_voxels(show):
    values = np.zeros((6, 7, 8), np.uint8)
    values[3, 2, 5] = 1
    tab = show(values)
    tab.run(
        "document.querySelectorAll('#slices input')[0].value = 3; "
        "document.querySelectorAll('#slices input')[0].oninput()"
    )
    pixels = tab.run(
        "(() => { const c = document.querySelector('#slices canvas');"
        "return [c.width, c.height, [...c.getContext('2d').getImageData(0, 0, c.width, "
        "c.height).data]]; })()"
    )
    image = np.array(pixels[2]).reshape(pixels[1], pixels[0], 4)
    assert image.shape == (7, 8, 4)
    bright = image[..., 0] > 128
    assert bright.sum() == 1 and bright[2, 5]


@pytest.mark.whole
def test_without_webgl_there_are_slices_and_a_plain_message(show):
    context = "HTMLCanvasElement.prototype.getContext"
    missing = f"{context} = new Proxy({context}, {{apply(f, c, a) "
    missing += "{ return a[0] === 'webgl2' ? null : Reflect.apply(f, c, a); }})"
    tab = show(foam(), before=missing)
    assert "no WebGL 2" in tab.run("document.getElementById('message').innerText")
    assert tab.run("document.querySelectorAll('#slices canvas').length") == 3
    assert tab.run("document.querySelector('#slices canvas').width") == 24
    assert tab.run("document.getElementById('stage').offsetParent") is None


def test_a_damaged_page_says_so(browser, tmp_path):
    html = tb.view(foam(12)).html
    (tmp_path / "damaged.html").write_text(
        html.replace('"shape": [12, 12, 12]', '"shape": [12, 12, 13]')
    )
    tab = browser.open((tmp_path / "damaged.html").as_uri(), size=WINDOW)
    tab.run("window.trabecula.ready.catch(() => 0)")
    assert "the page is damaged: 1728 of 1872 bytes" in tab.run(
        "document.getElementById('message').innerText"
    )
    tab.close()


@pytest.mark.whole
def test_names_and_figures_stand_beside_and_are_text(show):
    metrics = {
        "porosity": {"value": 0.51234, "real_band": [0.4, 0.6], "pass": True},
        "floating": {"value": 3, "pass": False},
    }
    tab = show(
        foam(12), names=["</script><b>x"], certificate=json.loads(json.dumps({"metrics": metrics}))
    )
    text = tab.run("document.getElementById('panel').innerText")
    assert "0.512" in text and "0.4 .. 0.6" in text and "fail" in text
    assert tab.run("document.querySelector('.name').textContent") == "</script><b>x"
    assert tab.run("document.querySelectorAll('b').length") == 0


@pytest.mark.whole
def test_the_served_page_is_drawn_and_loads_nothing_else(browser):
    import threading

    with PageServer(tb.view(foam(12)).html) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        tab = browser.open(server.url, size=WINDOW)
        tab.run(READY)
        assert canvas(tab).std() > 10
        assert tab.run("location.href") == f"http://127.0.0.1:{server.server_port}/"
        assert all(
            url.startswith((f"http://127.0.0.1:{server.server_port}/", "data:"))
            for url in tab.requests
        )
        tab.go("Page.reload")  # the token is spent, the cookie is not
        tab.run(READY)
        assert tab.errors == []
        tab.close()
        server.shutdown()


@pytest.mark.whole
def test_the_probe_reads_local_thickness_and_the_slices_are_linked(show):
    image = foam(20)
    tab = show(image, size=(300, 560))
    for phase in ("solid", "void"):
        thick = tb.measure.local_thickness(image, phase=phase)
        for z, y, x in np.argwhere(thick > 0)[::731]:
            said = tab.run(f"app.reading(0, [{x}, {y}, {z}])")
            assert f"{phase} (label" in said and f"at z, y, x {z}, {y}, {x}" in said
            assert float(said.split("thickness ")[1].split()[0]) == pytest.approx(
                thick[z, y, x], rel=1e-3
            )
    # a press on the slice across z sets y and x, which the other slices follow
    place = tab.run(
        "(() => { const r = document.querySelector('#slices canvas').getBoundingClientRect();"
        "return [r.x + r.width * 0.125, r.y + r.height * 0.825]; })()"
    )
    tab.mouse("mousePressed", *place)
    tab.mouse("mouseReleased", *place)
    assert tab.run("app.focusVoxel()") == [2, 16, 10]
    assert tab.run("[...document.querySelectorAll('#slices input')].map((i) => i.value)") == [
        "10", "16", "2",
    ]  # fmt: skip
    assert "at z, y, x 10, 16, 2" in tab.run("document.getElementById('probe').textContent")


@pytest.mark.whole
def test_the_tape_measures_between_two_presses(show):
    tab = show(tb.Image(np.ones((10, 10, 10), np.uint8), "labels", 2, "mm"), size=(620, 500))
    tab.run(
        "app.setCut('none'); app.homeAngles.azimuth = app.homeAngles.elevation = 0; app.home(); "
        "document.getElementById('tape').click()"
    )
    canvas(tab)
    x, y = middle_of(tab, "#picture")
    pixel = tab.run("app.cells[0].pixel")
    for place in ((x - 40, y), (x + 40, y + 30)):
        tab.mouse("mousePressed", *place)
        tab.mouse("mouseReleased", *place)
    assert tab.run("app.tape.length()") == pytest.approx(50 * np.sqrt(3.56) * pixel, rel=0.25)
    assert tab.run("app.tape.length()") == pytest.approx(np.hypot(80, 30) * pixel, rel=0.03)
    assert "mm" in tab.run("document.querySelector('.tape text').textContent")


@pytest.mark.whole
def test_the_address_brings_the_same_picture_and_names_what_it_does_not_know(show, browser):
    tab = show(foam())
    first = canvas(tab)
    assert tab.run("location.hash") == ""
    tab.run(
        "app.cameras[0].azimuth = 70; app.cut.at = [0.25, 0.5, 0.75]; app.setLook('stone'); "
        "app.volumes[0].phases[1].colour = [200, 60, 60]; app.redraw()"
    )
    picture = canvas(tab)
    assert apart(picture, first) > 1
    tab.run("new Promise((done) => setTimeout(done, 50))")
    words = tab.run("location.hash")
    assert "look=stone" in words and "at=0.25,0.5,0.75" in words
    again = browser.open(tab.run("location.href") + "&nonsense=1&camera0=1,2", size=WINDOW)
    again.run(READY)
    assert apart(canvas(again), picture) == 0
    said = again.run("document.getElementById('message').innerText")
    assert "nonsense" in said
    assert again.errors == []
    again.close()


@pytest.mark.whole
def test_a_field_colours_as_in_a_still_and_a_lost_card_comes_back(show):
    image = foam(24)
    field = tb.Image(tb.measure.local_thickness(image), "grey", 20, "um")
    tab = show(image, fields={"thickness": field})
    page = canvas(tab)
    still = tb.render(image, size=stage(tab), field=field).values.astype(int)
    assert apart(page[:-60], still[:-60]) < 1.5
    assert "thickness" in tab.run("document.querySelector('.legend').textContent")
    tab.run("window.card = app.drawing.gl.getExtension('WEBGL_lose_context'); card.loseContext()")
    wait = "new Promise((done) => setTimeout(done, 100))"
    tab.run(wait)
    assert "graphics card" in tab.run("document.getElementById('message').innerText")
    tab.run(f"card.restoreContext(); {wait}")
    assert apart(canvas(tab), page) == 0
    assert tab.run("document.getElementById('message').hidden")


@pytest.mark.whole
def test_finer_voxels_come_from_the_server_where_one_zooms_in(browser, monkeypatch):
    import threading

    from trabecula.view.page import fitting

    monkeypatch.setattr(fitting, "LARGEST", 16**3)
    grid = np.mgrid[:32, :32, :32]
    wall = np.abs(grid[2] + 0.3 * grid[1] - 20) < 1.2
    image = tb.Image(wall.astype(np.uint8), "labels")
    page = tb.view(image)
    with PageServer(page.live.html, boxes=page.live.boxes) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        tab = browser.open(server.url, size=(260, 300))
        tab.run(READY)
        tab.run("app.setCut('none'); app.volumes[0].detail = false; app.takeDetail(0, null)")
        coarse = canvas(tab)
        tab.run("app.volumes[0].detail = true; app.volumes[0].asked = null; app.redraw()")
        tab.run(
            "new Promise((done) => { const wait = () => "
            "(app.volumes[0].fine ? done(0) : setTimeout(wait, 20)); wait(); })"
        )
        fine, still = canvas(tab), tb.render(image, size=stage(tab), cut="none").values.astype(int)
        drawn = [(np.abs(one - one[0, 0]).max(axis=-1) > 12)[:-40] for one in (coarse, fine, still)]
        assert drawn[0].mean() > 0.5 * drawn[2].mean()
        assert (drawn[1] != drawn[2]).mean() < 0.7 * (drawn[0] != drawn[2]).mean()
        assert tab.errors == []
        tab.close()
        server.shutdown()


@pytest.mark.whole
def test_the_refined_light_is_like_the_quick_one_but_softer(show):
    tab = show(foam(16), size=(180, 220))
    quick = canvas(tab)
    tab.run("app.rest = 'refined'; app.redraw()")
    tab.run(
        "new Promise((done) => { const wait = () => "
        "(app.passes >= app.passesAtRest ? done(0) : setTimeout(wait, 50)); wait(); })"
    )
    refined = canvas(tab)
    ground = np.abs(quick - quick[0, 0]).max(axis=-1) > 12
    assert np.abs(refined[~ground] - quick[~ground]).mean() < 2
    assert 1 < np.abs(refined[ground] - quick[ground]).mean() < 45
    assert refined[ground].mean() == pytest.approx(quick[ground].mean(), rel=0.15)
    assert "rest=refined" in tab.run("location.hash")

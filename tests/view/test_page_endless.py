"""Endless material in the page: the scripts against Python, what a page holds, and a browser."""

import chromium
import numpy as np
import pytest

import trabecula as tb
from page_scripts import MISSING, find_node, run_scripts
from trabecula.core.errors import InputError
from trabecula.core.seeds import key
from trabecula.engine.gaussian_random import normal_cells, quantiles
from trabecula.synth.gan.decode import remove_specks
from trabecula.synth.gan.local_fractions import LocalFractions
from trabecula.view.page.endless import as_endless

nodes = pytest.mark.skipif(find_node() is None, reason=MISSING)


class SmallModel:
    """A generator of random weights, small enough to run in a moment."""

    def __init__(self, specks=1, phases=("void", "solid"), seed=3):
        channels = 1 if len(phases) == 2 else len(phases)
        sizes = ((16, 8, 3), (64, 16, 2), (8, 8, 3), (32, 8, 2), (4, 4, 3), (8 * channels, 4, 3))
        chance = np.random.default_rng(seed)
        parts = []
        for out, into, edge in sizes:
            taps = into * edge**3
            parts += [np.zeros(out), chance.normal(0, (1.8 / taps) ** 0.5, out * taps)]
        self.weights = np.concatenate(parts).astype(np.float32)
        self.settings = {
            "name": "small", "spacing": [2.0, 2.0, 2.0], "unit": "um", "phases": list(phases),
            "shares": [1 / len(phases)] * len(phases), "latent": 8,
            "fractions": None, "layers": [list(size) for size in sizes],
            "blurs": 1, "channels": channels, "offsets": [0.0] * channels,
            "present": list(range(len(phases))), "specks": specks,
        }  # fmt: skip

    def browser_parts(self):
        return self.settings, self.weights


@nodes
def test_latent_numbers_are_pythons_to_the_bit(tmp_path):
    corner, shape, seed = (-3, 5, 2**20), (10, 3, 4, 5), 123456789012
    own = np.empty(shape, np.float32)
    stage = key(seed, "gan/latent")
    normal_cells(own, stage, np.array(corner, np.int64), np.zeros(3, np.int64), quantiles())
    steps = as_endless(SmallModel(), None, 32, 0).blocks()["quantiles"]
    found = run_scripts(
        tmp_path,
        ["philox.js", "convolution.js", "network.js", "maker.js"],
        """
        const cells = new Float32Array(600), key = seedKey(given.seed, "gan/latent");
        const table = quantileTable([...array("steps", Int16Array)]);
        normalCells(cells, 10, [3, 4, 5], key, given.corner, table);
        write("cells", cells);
        console.log(JSON.stringify(key));
        """,
        given={"seed": seed, "corner": corner},
        arrays={"steps": steps},
    )
    assert found == [int(stage) & 0xFFFFFFFF, int(stage) >> 32]
    np.testing.assert_array_equal(np.fromfile(tmp_path / "cells", np.float32), own.ravel())


@nodes
def test_local_fractions_are_pythons_to_the_bit(tmp_path):
    shares = np.random.default_rng(0).random((2, 9, 10, 11))
    local = LocalFractions.of(shares)
    corner, sides, seed = (-3, 5, 2**20), (3, 4, 5), 123456789012
    own = local.draw(key(seed, "gan/fractions"), corner, sides, (0, 0, 0))
    steps = as_endless(SmallModel(), None, 32, 0).blocks()["quantiles"]
    run_scripts(
        tmp_path,
        ("philox.js", "convolution.js", "network.js", "maker.js"),
        """
        const table = quantileTable([...array("steps", Int16Array)]);
        const key = seedKey(given.seed, "gan/fractions");
        write("drawn", localFractions(given.local, given.sides, key, given.corner, table));
        console.log("null");
        """,
        given={"local": local.page_parts(), "sides": sides, "corner": corner, "seed": seed},
        arrays={"steps": steps},
    )
    found = np.fromfile(tmp_path / "drawn", np.float32).reshape(own.shape)
    assert np.array_equal(found, own) and own.std() > 0.3


@nodes
def test_specks_and_the_two_point_function_are_pythons(tmp_path):
    labels = np.random.default_rng(1).integers(0, 3, (20, 20, 20)).astype(np.uint8)
    smooth = np.random.default_rng(2).random((20, 20, 20)) < 0.5
    for axis in range(3):
        smooth = smooth | np.roll(smooth, 1, axis)
    found = run_scripts(
        tmp_path,
        ["network.js", "maker.js"],
        """
        const labels = array("labels", Uint8Array);
        const smooth = array("smooth", Uint8Array), inside = (label) => label > 0;
        write("two", Float64Array.from(radialTwoPoint(smooth, 20, inside, 8)));
        clearSpecks(labels, 20, 2);
        write("cleared", labels);
        console.log(1);
        """,
        arrays={"labels": labels, "smooth": smooth.astype(np.uint8)},
    )
    assert found == 1
    cleared = np.fromfile(tmp_path / "cleared", np.uint8).reshape(labels.shape)
    np.testing.assert_array_equal(cleared, remove_specks(labels, 2))
    assert (cleared != labels).any()
    own = tb.measure.two_point(smooth, r_max=8)
    np.testing.assert_allclose(np.fromfile(tmp_path / "two", np.float64), own, atol=2e-3)


def test_what_makes_no_material_in_a_page_is_refused():
    noise = tb.method("noise").fit(np.random.default_rng(0).random((16, 16, 16)) < 0.5)
    with pytest.raises(InputError, match=r"makes no material in a page.*method 'gan'"):
        tb.view(endless=noise)
    with pytest.raises(InputError, match=r"side 50 is none of 32, 64, 96, 128"):
        tb.view(endless=SmallModel(), side=50)
    with pytest.raises(InputError, match="seed"):
        tb.view(endless=SmallModel(), seed=2**53)
    with pytest.raises(InputError, match="1 to 6 images, got 0"):
        tb.view()


def test_the_exemplars_curve_is_in_the_models_unit():
    image = tb.Image(np.random.default_rng(0).integers(0, 2, (12, 12, 12)), "labels", 0.004, "mm")
    curve = as_endless(SmallModel(), image, 32, 0).exemplar
    assert curve["step"] == pytest.approx(4)  # um
    np.testing.assert_allclose(curve["s2"], tb.measure.two_point(image, r_max=6), atol=1e-6)
    assert curve["porosity"] == 0.5


@pytest.mark.whole
@pytest.mark.skipif(chromium.find_browser() is None, reason=chromium.MISSING)
def test_the_page_makes_material_and_the_dial_sets_its_porosity(browser, tmp_path):
    image = tb.Image(np.random.default_rng(0).integers(0, 2, (12, 12, 12)), "labels", 4, "um")
    model = SmallModel(phases=("void", "one", "two"), specks=0)
    path = tb.view(image, endless=model, side=32).save(tmp_path / "page.html")
    tab = browser.open(path.as_uri(), size=(240, 260))
    idle = (
        "new Promise((done) => { const wait = () => (app.endless.busy ? setTimeout(wait, 10) : "
        "done(0)); wait(); })"
    )
    tab.run("window.trabecula.ready.then((app) => { window.app = app; })")
    tab.run(idle)
    hash_of = "app.volumes[1].voxels.reduce((sum, label, i) => (31 * sum + label + i) % 1e9, 0)"
    first, porosity = tab.run(hash_of), tab.run("app.endless.porosity")
    assert 0.02 < porosity < 0.98 and tab.run("app.endless.curve.length") == 17
    assert tab.run("app.endless.curve[0]") == pytest.approx(1 - porosity)
    assert "seed=0" in tab.run("app.endless.command.textContent")
    tab.run("document.querySelector('[name=new-seed]').click()")
    tab.run(idle)
    assert tab.run(hash_of) != first
    tab.run(
        "(() => { const dial = document.querySelector('input[name=Porosity]'); dial.value = 0.7; "
        "dial.oninput(); })()"
    )
    tab.run(idle)
    assert tab.run("app.endless.porosity") == pytest.approx(0.7, abs=2e-3)
    assert "of this page alone" in tab.run("app.endless.command.textContent")
    assert "made=" in tab.run("location.hash")
    tab.run("location.hash = 'made=0,64,-1,0,0,-16'")
    tab.run("new Promise((done) => setTimeout(done, 50))")
    tab.run(idle)
    assert tab.run("app.volumes[1].voxels.length") == 64**3
    tab.run("location.hash = 'made=0,32,-1,0,0,0'")
    tab.run("new Promise((done) => setTimeout(done, 50))")
    tab.run(idle)
    assert tab.run(hash_of) == first
    assert tab.run("document.getElementById('message').hidden")
    assert tab.errors == []
    assert all(url.startswith(("file:", "data:", "blob:")) for url in tab.requests)
    tab.close()

"""The plugin in napari itself, without a screen (`make test-napari`)."""

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import trabecula as tb
from trabecula.io.formats import suffixes
from trabecula.io.readers import READERS

os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
MANIFEST = Path(tb.__file__).parent / "napari" / "napari.yaml"


def test_the_package_is_imported_without_napari():
    code = "import sys, trabecula as tb, trabecula.cli.main, trabecula.fields; tb.read; tb.view;"
    code += "assert not {'napari', 'magicgui', 'qtpy', 'trabecula.napari'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_manifest_names_every_suffix_that_is_read():
    text = MANIFEST.read_text(encoding="utf-8")
    known = [*suffixes(), *(suffix for one in READERS for suffix in one.suffixes)]
    assert all(f'- "*{suffix}"\n' in text for suffix in known)


napari = pytest.importorskip("napari", reason="napari is not installed: make test-napari")


def register():
    """Let napari know the plugin of this source tree, whether it is installed or not."""
    from npe2 import PluginManager, PluginManifest

    manager = PluginManager.instance()
    if "trabecula" not in manager._manifests:
        manager.register(PluginManifest.from_file(MANIFEST))


@pytest.fixture
def viewer():
    register()
    made = napari.Viewer(show=False)
    yield made
    made.close()


@pytest.fixture
def model():
    """Return a viewer without a window: pictures need OpenGL, which is not on every machine."""
    from napari.components import ViewerModel

    register()
    return ViewerModel()


def wait_for(panel):
    """Run napari's loop until the panel's work has ended, which enables its button again."""
    from qtpy.QtWidgets import QApplication

    while not button(panel).enabled:
        QApplication.processEvents()
        time.sleep(0.01)


def panel_of(viewer, name):
    found = viewer.window.add_plugin_dock_widget("trabecula", name)[1]
    return found


def part(panel, label):
    return next(one for one in panel if one.label == label)


def text_of(panel):
    return panel[-1].value


def button(panel):
    return next(one for one in panel if type(one).__name__ == "PushButton")


def test_npe2_validates_the_manifest():
    from npe2 import PluginManifest

    manifest = PluginManifest.from_file(MANIFEST)
    manifest.validate_imports()
    assert [one.display_name for one in manifest.contributions.widgets] == [
        "Inspect", "Generate", "Certificate",
    ]  # fmt: skip


@pytest.mark.parametrize("kind", ["labels", "grey", "colour"])
def test_files_open_as_layers_and_are_saved_again(tmp_path, model, kind):
    values = np.random.default_rng(1).integers(0, 3, (6, 7, 8)).astype(np.uint8)
    if kind == "colour":
        values = values[..., None].repeat(3, -1) * 80
    phases = ("void", "soft", "hard") if kind == "labels" else ()
    image = tb.Image(values, kind, (3.0, 2.0, 1.0), "um", phases)
    tb.write(image, tmp_path / "one.zarr")
    (layer,) = model.open(str(tmp_path / "one.zarr"), plugin="trabecula")
    assert type(layer).__name__ == ("Labels" if kind == "labels" else "Image")
    assert tuple(layer.scale) == (3.0, 2.0, 1.0)
    assert str(layer.units[0]) == "micrometer"
    saved = layer.save(str(tmp_path / "two.zarr"), plugin="trabecula")
    back = tb.read(saved[0])
    assert np.array_equal(back.values, values)
    assert (back.kind, back.spacing, back.unit) == (kind, (3.0, 2.0, 1.0), "um")
    assert back.phases == phases
    original = tb.read(tmp_path / "one.zarr").recipe.to_json()
    assert back.recipe.to_json()[: len(original)] == original


def test_a_recipe_stays_with_voxels_that_nobody_painted(tmp_path, model):
    from trabecula.napari.layers import layer_image

    model.open_sample("trabecula", "bone")
    layer = model.layers[-1]
    assert layer_image(layer).recipe.to_json() == tb.sample("bone").recipe.to_json()
    layer.data[0, 0, 0] ^= 1
    assert layer_image(layer).recipe.steps[0]["verb"] == "array"
    layer.data[0, 0, 0] ^= 1
    (path,) = layer.save(str(tmp_path / "bone.stl"), plugin="trabecula")
    assert Path(path).stat().st_size > 10_000


def test_other_files_are_left_to_other_plugins(tmp_path):
    from trabecula.napari.files import get_reader

    (tmp_path / "x.czi").write_bytes(b"1")
    (tmp_path / "folder").mkdir()
    assert get_reader(str(tmp_path / "x.czi")) is None
    assert get_reader(str(tmp_path / "folder")) is None
    assert get_reader([str(tmp_path / "a.tif"), str(tmp_path / "b.tif")]) is not None


@pytest.mark.whole
def test_the_panels_inspect_generate_and_certify(tmp_path, viewer):
    """As a user does: a sample, its inspection, material like it, its certificate and page."""
    viewer.open_sample("trabecula", "bone")
    inspect = panel_of(viewer, "Inspect")
    button(inspect).changed.emit(True)
    assert not button(inspect).enabled  # the work runs beside napari
    wait_for(inspect)
    assert "porosity" in text_of(inspect) or "solid" in text_of(inspect)
    assert button(inspect).enabled
    generate = panel_of(viewer, "Generate")
    part(generate, "method").value = "noise"
    for axis in "zyx":
        part(generate, axis).value = 32
    part(generate, "seed").value = 5
    button(generate).changed.emit(True)
    wait_for(generate)
    made = viewer.layers[-1]
    assert made.name == "bone 5" and made.data.shape == (32, 32, 32)
    own = tb.method("noise").fit(tb.sample("bone")).generate((32, 32, 32), seed=5)
    assert np.array_equal(made.data, own.values)
    assert tuple(made.scale) == tb.sample("bone").spacing
    certificate = panel_of(viewer, "Certificate")
    part(certificate, "exemplar").value = viewer.layers["bone"]
    part(certificate, "result").value = made
    part(certificate, "level").value = "quick"
    part(certificate, "page").value = tmp_path / "page.html"
    button(certificate).changed.emit(True)
    wait_for(certificate)
    assert "figures" in text_of(certificate) and "written" in text_of(certificate)
    assert (tmp_path / "page.html").stat().st_size > 10_000


@pytest.mark.whole
def test_a_panel_says_what_is_wrong_and_goes_on(viewer):
    generate = panel_of(viewer, "Generate")
    button(generate).changed.emit(True)
    assert "no layer" in text_of(generate)
    viewer.add_labels(np.zeros((8, 8, 8), np.uint8), name="empty")
    part(generate, "exemplar").reset_choices()
    part(generate, "exemplar").value = viewer.layers["empty"]
    part(generate, "method").value = "noise"
    button(generate).changed.emit(True)
    wait_for(generate)
    assert "phase" in text_of(generate) and "report" not in text_of(generate)
    assert button(generate).enabled
    viewer.add_points(np.zeros((1, 3)), name="points")
    part(generate, "exemplar").reset_choices()
    part(generate, "exemplar").value = viewer.layers["points"]
    button(generate).changed.emit(True)
    assert "choose a Labels or an Image layer" in text_of(generate)

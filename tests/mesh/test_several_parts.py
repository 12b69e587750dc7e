"""Several phases as parts of one 3MF, each with its material."""

import xml.etree.ElementTree as ElementTree
import zipfile

import numpy as np
import pytest

import trabecula as tb
from trabecula.mesh.check import check

CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"


def halves():
    values = np.zeros((12, 10, 10), np.uint8)
    values[2:6, 2:8, 2:8], values[6:10, 2:8, 2:8] = 1, 2
    return tb.Image(values, "labels", 0.5, unit="mm", phases=("void", "steel", "rubber"))


def test_every_part_is_an_object_with_a_material(tmp_path):
    path = tb.export(halves(), tmp_path / "a.3mf", phase=["steel", "rubber"])
    with zipfile.ZipFile(path) as package:
        model = ElementTree.fromstring(package.read("3D/3dmodel.model"))
    names = [base.get("name") for base in model.iter(f"{CORE}base")]
    objects = list(model.iter(f"{CORE}object"))
    assert names == ["steel", "rubber"] == [one.get("name") for one in objects]
    assert [one.get("pindex") for one in objects] == ["0", "1"]
    materials = next(model.iter(f"{CORE}basematerials")).get("id")
    assert {one.get("pid") for one in objects} == {materials}
    assert materials not in {one.get("id") for one in objects}
    assert len(list(model.iter(f"{CORE}item"))) == 2


@pytest.mark.whole
def test_they_are_read_at_their_places(tmp_path):
    path = tb.export(halves(), tmp_path / "a.3mf", phase=["steel", "rubber"], tolerance=0.2)
    found = check(tb.read_mesh(path))
    assert found.watertight and found.components == 2
    assert found.volume == pytest.approx(2 * 4 * 6 * 6 * 0.125, rel=0.1)
    assert found.bounds[1][2] == pytest.approx(5.0, abs=0.1)


def test_other_formats_hold_one_part(tmp_path):
    with pytest.raises(tb.errors.InputError, match="holds one"):
        tb.export(halves(), tmp_path / "a.stl", phase=["steel", "rubber"])
    with pytest.raises(tb.errors.InputError, match="as surfaces"):
        tb.export(halves(), tmp_path / "a.3mf", phase=["steel", "rubber"], beams=True)
    with pytest.raises(tb.errors.InputError, match="empty"):
        empty = tb.Image(halves().values.clip(0, 1), "labels", phases=("void", "steel", "rubber"))
        tb.export(empty, tmp_path / "a.3mf", phase=["steel", "rubber"])

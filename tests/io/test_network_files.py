"""Files of networks and bodies, read back by their own rules; OpenPNM reads them in tests/peers."""

import csv
import json
from xml.etree import ElementTree

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import FileError, InputError, UnknownNameError


def rooms():
    """Two rooms joined along x by a duct, open at the far end of x alone; edges of 2, 2, 5 um."""
    values = np.ones((9, 9, 20), np.uint8)
    values[1:8, 1:8, 1:8] = values[1:8, 1:8, 11:18] = values[3:6, 3:6, 8:11] = 0
    values[3:6, 3:6, 18:] = 0
    return tb.Image(values, "labels", (2.0, 2.0, 2.5), "um", phases=("void", "solid"))


NET = tb.measure.network(rooms())


def test_tables_have_the_names_of_openpnm_in_metres():
    found = NET.to_openpnm()
    pores = len(found["pore.coords"])
    assert pores == 3 and found["pore.internal"].tolist() == [True, True, False]
    assert found["pore.xmax"].tolist() == [False, False, True]
    assert found["pore.touches_xmax"].tolist() == [False, True, False]
    assert not found["pore.xmin"].any() and not found["pore.zmax"].any()
    # x first, the places of voxel centres
    assert found["pore.coords"][0] == pytest.approx([4 * 2.5e-6, 4 * 2e-6, 4 * 2e-6])
    assert found["pore.coords"][2, 0] == pytest.approx(19.5 * 2.5e-6)
    assert found["throat.conns"].tolist() == [[0, 1], [1, 2]]
    assert (found["throat.conns"][:, 0] < found["throat.conns"][:, 1]).all()
    volume = (rooms().values == 0).sum() * 10e-18
    assert found["pore.volume"].sum() == pytest.approx(volume)
    assert found["throat.cross_sectional_area"] == pytest.approx([36e-12, 36e-12])
    parts = [found[f"throat.conduit_lengths.{one}"] for one in ("pore1", "throat", "pore2")]
    assert sum(parts) == pytest.approx(found["throat.total_length"])
    lengths = {name: len(values) for name, values in found.items()}
    assert {lengths[name] for name in lengths if name.startswith("pore.")} == {3}
    assert {lengths[name] for name in lengths if name.startswith("throat.")} == {2}


def test_arrays_lists_and_columns_hold_the_same(tmp_path):
    tables = NET.to_openpnm()
    for suffix in ("npz", "json", "csv"):
        assert NET.write(tmp_path / f"net.{suffix}") == [tmp_path / f"net.{suffix}"]
    arrays = dict(np.load(tmp_path / "net.npz"))
    lists = json.loads((tmp_path / "net.json").read_text())
    rows = list(csv.DictReader((tmp_path / "net.csv").open()))
    assert list(arrays) == list(lists) == list(tables)
    for name, values in tables.items():
        assert np.array_equal(arrays[name], values) and np.array_equal(lists[name], values)
    x = [float(row["pore.coords[0]"]) for row in rows if row["pore.coords[0]"]]
    assert x == tables["pore.coords"][:, 0].tolist()
    ends = [int(row["throat.conns[1]"]) for row in rows if row["throat.conns[1]"]]
    assert ends == tables["throat.conns"][:, 1].tolist()
    assert [row["pore.internal"] for row in rows] == ["True", "True", "False"]


def test_vtp_is_points_and_lines(tmp_path):
    NET.write(tmp_path / "net.vtp")
    piece = ElementTree.parse(tmp_path / "net.vtp").getroot().find("PolyData/Piece")
    assert piece.get("NumberOfPoints") == "3" and piece.get("NumberOfLines") == "2"
    lines = {one.get("Name"): one.text.split() for one in piece.find("Lines")}
    assert lines == {"connectivity": ["0", "1", "1", "2"], "offsets": ["2", "4"]}
    points = piece.find("Points/DataArray")
    assert points.get("NumberOfComponents") == "3"
    assert np.array(points.text.split(), float) == pytest.approx(
        NET.to_openpnm()["pore.coords"].ravel()
    )
    area = next(
        one for one in piece.find("CellData") if one.get("Name") == "throat.cross_sectional_area"
    )
    # vertices come first
    assert np.array(area.text.split(), float) == pytest.approx([0, 0, 0, 36e-12, 36e-12])


def test_statoil_is_four_files_along_x(tmp_path):
    found = NET.write(tmp_path / "rock.dat")
    assert [path.name for path in found] == [
        f"rock_{part}.dat" for part in ("link1", "link2", "node1", "node2")
    ]
    link1, link2, node1, node2 = (
        [line.split() for line in path.read_text().splitlines()] for path in found
    )
    assert link1[0] == ["2"] and [line[:3] for line in link1[1:]] == [
        ["1", "1", "2"],
        ["2", "0", "2"],
    ]
    assert [line[:3] for line in link2] == [line[:3] for line in link1[1:]]
    for one, two in zip(link1[1:], link2, strict=True):
        assert float(one[5]) == pytest.approx(sum(map(float, two[3:6])), rel=1e-5)
        assert 0 < float(one[4]) <= 1 / (4 * np.pi) + 1e-6
    assert float(link2[1][3]) == 0.0  # the reservoir has no length
    assert node1[0][0] == "2"
    assert node1[1][4:] == ["1", "2", "0", "0", "1"]
    assert node1[2][4:] == ["2", "1", "0", "0", "1", "1", "2"]
    assert float(node2[0][1]) == pytest.approx(NET.volume[0] * 1e-18)
    assert float(node2[0][2]) == pytest.approx(NET.radius[0] * 1e-6)


def test_throats_across_a_period_are_marked_and_those_to_oneself_left_out(tmp_path):
    values = np.ones((6, 9, 24), np.uint8)
    values[:, 2:7, 2:9] = values[:, 2:7, 14:21] = 0  # two ducts along z
    values[1:4, 3:6] = 0  # a duct along x, through both and the face
    net = tb.measure.network(values, periodic=True)
    found = net.to_openpnm()
    own = net.throats.pores
    assert (own[:, 0] == own[:, 1]).any()
    ends = found["throat.conns"]
    assert len(ends) == np.count_nonzero(own[:, 0] != own[:, 1]) and len(ends) >= 2
    assert (ends[:, 0] != ends[:, 1]).all()
    assert found["throat.periodic"].sum() >= 1 and not found["throat.periodic"].all()
    net.write(tmp_path / "a.dat")
    first = int((tmp_path / "a_link1.dat").read_text().split()[0])
    assert first == np.count_nonzero(~found["throat.periodic"])


def test_bodies_are_written_too(tmp_path):
    bodies = tb.measure.bodies(rooms(), phase="void")
    for suffix in ("npz", "csv", "json", "vtp"):
        bodies.write(tmp_path / f"b.{suffix}")
    arrays = dict(np.load(tmp_path / "b.npz"))
    assert arrays["body.volume"].sum() == pytest.approx((rooms().values == 0).sum() * 1e-17)
    assert arrays["contact.conns"].tolist() == [[0, 1]]
    assert arrays["contact.area"] == pytest.approx([36e-12])
    assert arrays["body.longest_axis"].shape == (2, 3)
    with pytest.raises(InputError, match="pores and throats"):
        bodies.write(tmp_path / "b.dat")


def test_another_suffix_and_no_place_are_refused(tmp_path):
    with pytest.raises(UnknownNameError, match=r"\.npz"):
        NET.write(tmp_path / "net.pnm")
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError):
        NET.write(tmp_path / "file" / "net.csv")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]

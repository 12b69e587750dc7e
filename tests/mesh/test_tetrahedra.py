"""Tetrahedra fill what they should, once, share their nodes, and have no flat angles."""

import re

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import trabecula as tb
from commands import refused, trabecula
from trabecula.errors import InputError, UnknownNameError
from trabecula.mesh.tetrahedra.lattice import lattice
from trabecula.mesh.tetrahedra.quality import dihedral_angles, volumes

SPACING = 0.5


def ball(side=20, radius=7.0):
    away = np.linalg.norm(np.indices((side,) * 3) - (side - 1) / 2, axis=0)
    return (away < radius).astype(np.uint8)


def three(side=24, seed=0):
    """Return three phases that meet in lines and points."""
    rng = np.random.default_rng(seed)
    places = rng.random((9, 3)) * side
    away = [
        np.linalg.norm(np.moveaxis(np.indices((side,) * 3), 0, -1) - p, axis=-1) for p in places
    ]
    return (np.argmin(away, axis=0) % 3).astype(np.uint8)


def image(values, phases=("void", "a", "b")):
    return tb.Image(values, "labels", (SPACING,) * 3, "mm", phases[: values.max() + 1])


def faces_of(cells):
    """Return every face of every tetrahedron once, and how many tetrahedra have it."""
    corners = [cells[:, [n for n in range(4) if n != m]] for m in range(4)]
    return np.unique(np.sort(np.concatenate(corners), axis=1), axis=0, return_counts=True)


def outside(faces, points, extent):
    """Return which faces lie on a face of the box."""
    found = np.zeros(len(faces), bool)
    for axis in range(3):
        place = points[faces][..., axis]
        found |= (np.abs(place) < 1e-9).all(axis=1)
        found |= (np.abs(place - extent[axis]) < 1e-9).all(axis=1)
    return found


def test_the_lattice_fills_its_box():
    made = lattice(np.array([3.0, 4.0, 5.0]), 1.0)
    assert volumes(made.points, made.cells).min() > 0
    assert volumes(made.points, made.cells).sum() == pytest.approx(60)
    angles = dihedral_angles(made.points, made.cells)
    assert angles.min() == pytest.approx(45) and angles.max() == pytest.approx(90)
    faces, count = faces_of(made.cells)
    assert count.max() == 2
    np.testing.assert_array_equal(count == 1, outside(faces, made.points, (3, 4, 5)))


def test_angles_of_a_known_tetrahedron():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    found = dihedral_angles(points, np.array([[0, 1, 2, 3], [1, 0, 2, 3]]))
    np.testing.assert_allclose(found, [[np.degrees(np.arccos(1 / 3**0.5)), 90], [0, 180]])


@pytest.mark.parametrize("edge", [pytest.param(1, marks=pytest.mark.whole), 1.7, 3])
def test_phases_fill_the_box_and_share_their_nodes(edge):
    values = three()
    mesh = tb.tetrahedra(image(values), edge=edge, phases=["void", "a", "b"])
    assert volumes(mesh.points, mesh.cells).min() > 0
    assert sum(mesh.volume.values()) == pytest.approx((24 * SPACING) ** 3)
    faces, count = faces_of(mesh.cells)
    assert count.max() == 2
    np.testing.assert_array_equal(count == 1, outside(faces, mesh.points, mesh.extent))
    assert mesh.angles.least > 4 and mesh.angles.largest < 172
    assert mesh.angles.hundredth > 18
    for label, phase in enumerate(mesh.phases):
        voxels = np.count_nonzero(values == label) * SPACING**3
        assert mesh.volume[phase] == pytest.approx(voxels, rel=0.01)


def test_no_tetrahedron_is_flat_where_a_cut_lattice_is_cut_again():
    rng = np.random.default_rng(0)
    one, other = (gaussian_filter(rng.random((40, 40, 40)), 3, mode="wrap") for _ in range(2))
    values = (one > np.quantile(one, 0.6)).astype(np.uint8)
    values[(other > np.quantile(other, 0.7)) & (values == 0)] = 2
    mesh = tb.tetrahedra(image(values), edge=2)
    assert mesh.angles.least > 5 and mesh.angles.largest < 170


def test_a_ball_is_round():
    mesh = tb.tetrahedra(ball(), edge=1)
    faces, count = faces_of(mesh.cells)
    surface = mesh.points[np.unique(faces[count == 1])]
    radius = np.linalg.norm(surface - 10, axis=1)
    assert radius.std() < 0.12 and abs(radius.mean() - 7) < 0.15
    corners = mesh.points[faces[count == 1]]
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(sides, axis=1).sum() / 2
    assert area == pytest.approx(4 * np.pi * 49, rel=0.03)  # voxels have half as much again


def test_nodes_lie_where_voxels_do():
    values = np.zeros((12, 14, 16), np.uint8)
    values[2:6, 3:9, 4:12] = 1
    mesh = tb.tetrahedra(image(values), edge=1)
    low, high = mesh.points.min(axis=0) / SPACING, mesh.points.max(axis=0) / SPACING
    np.testing.assert_allclose(low, (4, 3, 2), atol=0.5)  # x, y, z
    np.testing.assert_allclose(high, (12, 9, 6), atol=0.5)
    assert all(len(nodes) == 0 for nodes in mesh.face_nodes().values())


def test_a_block_is_the_lattice():
    mesh = tb.tetrahedra(np.ones((6, 6, 6), np.uint8))
    assert mesh.volume == {"solid": pytest.approx(216)}
    assert len(mesh.face_nodes()["z_low"]) == 4**2 + 3**2


def test_the_same_for_any_number_of_threads():
    values = image(three())
    found = []
    for count in (1, 2):
        with tb.threads(count):
            found.append(tb.tetrahedra(values))
    np.testing.assert_array_equal(found[0].points, found[1].points)
    np.testing.assert_array_equal(found[0].cells, found[1].cells)


def test_phases_that_are_left_out_shape_the_others():
    values = image(three())
    both, one = tb.tetrahedra(values), tb.tetrahedra(values, phases="a")
    assert set(one.volume) == {"a"} and set(both.volume) == {"a", "b"}
    assert one.volume["a"] == pytest.approx(both.volume["a"], rel=0.01)


@pytest.mark.parametrize(
    ("values", "options", "says"),
    [
        (np.ones((8, 8), np.uint8), {}, "need a volume"),
        (np.zeros((8, 8, 8), np.uint8), {}, "every voxel is void"),
        (ball(8, 3), {"edge": 9}, "longer than the image"),
        (ball(8, 3), {"edge": 0.1}, "edge"),
        (ball(8, 3), {"phases": "c"}, "'c'"),
        (tb.Image(ball(8, 3), "labels", (1.0, 1.0, 2.0)), {}, "no cubes"),
    ],
)
def test_what_cannot_be_meshed_is_refused(values, options, says):
    with pytest.raises((InputError, UnknownNameError), match=says):
        tb.tetrahedra(values, **options)


def test_files_hold_nodes_cells_and_phases(tmp_path):
    values = image(three(16))
    mesh = tb.tetrahedra(values)
    for suffix in (".vtu", ".msh", ".inp"):
        tb.export(values, tmp_path / f"a{suffix}", tetrahedra=2)
    raw = (tmp_path / "a.msh").read_bytes()
    assert b'3\n3 1 "void"\n3 2 "a"\n3 3 "b"\n' in raw
    nodes = raw.split(b"$Nodes\n")[1]
    count, nodes = nodes.split(b"\n", 1)
    kind = np.dtype([("number", "<i4"), ("place", "<f8", 3)])
    found = np.frombuffer(nodes[: int(count) * kind.itemsize], kind)
    np.testing.assert_allclose(found["place"], mesh.points)
    cells = raw.split(b"$Elements\n")[1].split(b"\n", 1)[1]
    assert np.frombuffer(cells[:12], "<i4").tolist() == [4, len(mesh.cells), 2]
    rows = np.frombuffer(cells[12 : 12 + 28 * len(mesh.cells)], "<i4").reshape(-1, 7)
    np.testing.assert_array_equal(rows[:, 3:], mesh.cells + 1)
    np.testing.assert_array_equal(rows[:, 1], mesh.labels + 1)
    text = (tmp_path / "a.inp").read_text()
    parts = re.findall(r"ELSET=[AB]\n([\d, \n]+)", text)
    assert sum(part.count("\n") for part in parts) == len(mesh.cells)
    assert "*NSET, NSET=Z_LOW" in text
    head = (tmp_path / "a.vtu").read_bytes()[:4000]
    assert f'NumberOfCells="{len(mesh.cells)}"'.encode() in head


@pytest.mark.whole
def test_the_command_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tb.write(image(ball()), "ball.zarr")
    out = trabecula("export", "ball.zarr", "--out", "ball.inp", "--tetrahedra").out
    assert "tetrahedra" in out and "volume of a" in out and "dihedral angles" in out
    finer = trabecula("export", "ball.zarr", "--out", "ball.msh", "--tetrahedra", 1.5).out
    assert int(finer.split()[1]) > int(out.split()[1])
    words = ("export", "ball.zarr", "--tetrahedra")
    assert "holds no tetrahedra" in refused(*words, "--out", "ball.stl")
    assert "is for bricks" in refused(*words, "--out", "b.inp", "--case", "shear")
    assert "give one number" in refused(*words, "x", "--out", "b.inp")

"""Beams along a skeleton: straight rods exactly, foams nearly, plates not."""

import xml.etree.ElementTree as ElementTree
import zipfile

import numpy as np
import pytest

import trabecula as tb
from trabecula.mesh.beam_file import write_beams
from trabecula.mesh.beams import (
    BeamLattice,
    beam_lattice,
    compare_beams,
    rasterise_beams,
    simplify,
)
from trabecula.mesh.threemf import BEAMS


def cross(side=41, radius=4):
    """Three rods that meet in the middle."""
    z, y, x = np.indices((side,) * 3) - side // 2
    rods = [a**2 + b**2 <= radius**2 for a, b in ((y, x), (z, x), (z, y))]
    return tb.Image(np.any(rods, axis=0).astype(np.uint8), "labels", 1.0, unit="um")


def test_three_rods_are_six_beams_of_their_radius():
    lattice = beam_lattice(cross(), tolerance=1.0)
    assert len(lattice.beams) <= 8
    found = compare_beams(cross(), lattice)
    assert found["overlap"] > 0.9 and found["components"] == [1, 1]
    assert found["volume"] == pytest.approx(1, abs=0.02)
    assert np.median(lattice.radii) == pytest.approx(4, abs=0.4)


def test_voxels_need_not_be_cubes():
    flat = tb.Image(cross().values[::2].copy(), "labels", (2.0, 1.0, 1.0), unit="um")
    lattice = beam_lattice(flat)
    assert compare_beams(flat, lattice)["overlap"] > 0.85
    assert np.allclose(np.median(lattice.vertices, axis=0), 20.5, atol=1.5)


@pytest.mark.whole
def test_a_foam_keeps_its_volume_and_its_connection():
    foam = tb.crop(tb.sample("foam"), 48)
    found = compare_beams(foam, beam_lattice(foam))
    assert found["volume"] == pytest.approx(1, abs=0.02)
    assert found["overlap"] > 0.7 and found["distance_mean"] < 1.5


def test_a_plate_is_told_to_be_none():
    plate = np.zeros((30, 60, 60), np.uint8)
    plate[13:17] = 1
    assert compare_beams(plate, beam_lattice(plate))["overlap"] < 0.5


def test_a_ball_alone_is_a_ball():
    z, y, x = np.indices((21, 21, 21)) - 10
    ball = (z**2 + y**2 + x**2 <= 36).astype(np.uint8)
    assert compare_beams(ball, beam_lattice(ball))["overlap"] > 0.9


def test_a_beam_holds_its_cone():
    lattice = BeamLattice(
        np.array([[5.0, 10, 10], [25.0, 10, 10]]), np.array([[0, 1]]), np.array([[2.0, 4.0]])
    )
    made = rasterise_beams(lattice, (20, 20, 40), (1, 1, 1))
    cone = np.pi * 20 / 3 * (4 + 8 + 16) + 2 / 3 * np.pi * (8 + 64)
    assert made.sum() == pytest.approx(cone, rel=0.03)
    assert made[10, 10, 1:28].sum() > 24 and not made[10, 16, 3]


def test_lines_keep_the_points_that_matter():
    line = np.array([[0, 0], [1, 0.1], [2, 0], [3, 3], [4, 6.0]])
    assert simplify(line, np.ones(2), 0.5).tolist() == [0, 2, 4]
    assert simplify(line, np.ones(2), 0.0).tolist() == [0, 1, 2, 4]


def test_the_file_holds_the_beams_and_is_no_surface(tmp_path):
    lattice = beam_lattice(cross())
    path = write_beams(lattice, tmp_path / "part.3mf")
    with zipfile.ZipFile(path) as package:
        model = ElementTree.fromstring(package.read("3D/3dmodel.model"))
    assert model.get("requiredextensions") == "b" and model.get("unit") == "micron"
    beams = list(model.iter(f"{BEAMS}beam"))
    assert len(beams) == len(lattice.beams)
    radii = np.array([[float(beam.get(name)) for name in ("r1", "r2")] for beam in beams])
    assert np.allclose(radii, lattice.radii, rtol=1e-5)
    with pytest.raises(tb.errors.FileError, match="beams and no triangles"):
        tb.read_mesh(path)


def test_export_writes_beams_as_3mf_alone(tmp_path):
    assert tb.export(cross(), tmp_path / "part.3mf", beams=True).stat().st_size < 5000
    with pytest.raises(tb.errors.InputError, match="3mf"):
        tb.export(cross(), tmp_path / "part.stl", beams=True)
    with pytest.raises(tb.errors.InputError, match="empty"):
        beam_lattice(np.zeros((4, 4, 4), np.uint8))
    with pytest.raises(tb.errors.InputError, match="3 axes"):
        beam_lattice(np.ones((4, 4), np.uint8))

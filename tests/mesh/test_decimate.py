"""Fewer triangles, closed as before, and nowhere farther than the tolerance."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.mesh.check import check
from trabecula.mesh.decimate import decimate, surface_distance
from trabecula.mesh.triangle_grid import distances_to, triangle_grid

pytestmark = pytest.mark.whole  # to compile what removes edges takes ten seconds


def euler(mesh):
    return len(mesh.vertices) - len(mesh.faces) // 2


def foam(side=40):
    return tb.mesh(tb.crop(tb.sample("foam"), side).values)


def ball(radius=14):
    z, y, x = np.indices((2 * radius + 5,) * 3) - radius - 2
    return tb.mesh((z**2 + y**2 + x**2 <= radius**2).astype(np.uint8))


@pytest.fixture(scope="module")
def pair():
    surface = foam()
    return surface, decimate(surface, 0.5)


def test_a_foam_keeps_its_topology_and_its_place(pair):
    surface, fewer = pair
    before, after = check(surface), check(fewer)
    assert after.watertight and after.degenerate_faces == 0
    assert after.components == before.components and euler(fewer) == euler(surface)
    assert len(fewer.faces) < len(surface.faces) / 7
    assert after.volume == pytest.approx(before.volume, rel=0.015)
    off = surface_distance(surface, fewer, spacing=0.25)
    assert max(off.there, off.back) < 0.52 and 0 < off.mean < 0.15


@pytest.mark.slow
def test_a_tighter_tolerance_keeps_more(pair):
    surface, fewer = pair
    close = decimate(surface, 0.2)
    assert len(fewer.faces) < len(close.faces) < len(surface.faces) / 2
    off = surface_distance(surface, close, spacing=0.25)
    assert max(off.there, off.back) < 0.22


def test_flat_faces_take_few_triangles():
    block = tb.mesh(np.ones((12, 20, 30), np.uint8), smooth=0)
    fewer = decimate(block, 0.3)
    assert len(fewer.faces) < 100
    assert check(fewer).volume == pytest.approx(check(block).volume, rel=0.01)


def test_nothing_leaves_the_box_of_the_surface(pair):
    surface, fewer = pair
    for whole, part in ((surface.vertices.min(axis=0), -1), (surface.vertices.max(axis=0), 1)):
        end = fewer.vertices.max(axis=0) if part > 0 else fewer.vertices.min(axis=0)
        assert np.allclose(end, whole, atol=1e-5)


def test_a_ball_stays_round():
    surface = ball()
    fewer = decimate(surface, 0.5)
    radii = np.linalg.norm(fewer.vertices - surface.vertices.mean(axis=0), axis=1)
    assert radii.std() < 0.3 and len(fewer.faces) < len(surface.faces) / 8


def test_it_comes_out_alike_again(pair):
    again = decimate(pair[0], 0.5)
    assert (again.vertices == pair[1].vertices).all() and (again.faces == pair[1].faces).all()


def test_the_smallest_solids_stay():
    voxel = np.zeros((3, 3, 3), np.uint8)
    voxel[1, 1, 1] = 1
    fewer = decimate(tb.mesh(voxel, smooth=0), 0.5)
    assert check(fewer).watertight and len(fewer.faces) >= 4


def test_the_scale_does_not_matter():
    surface = foam(24)
    large = tb.mesh(tb.Image(tb.crop(tb.sample("foam"), 24).values, "labels", (32.0,) * 3))
    one, other = decimate(surface, 0.5), decimate(large, 16.0)
    assert (one.faces == other.faces).all()


def test_distances_are_those_of_all_triangles():
    surface = ball(5)
    points = np.random.default_rng(0).uniform(-4, 18, (200, 3))
    grid = triangle_grid(surface.vertices.astype(float), surface.faces, 0.8)
    found = distances_to(grid, points)
    corners = surface.vertices[surface.faces].astype(float)
    weights = np.array([[i, j, 12 - i - j] for i in range(13) for j in range(13 - i)]) / 12
    samples = (weights @ corners).reshape(-1, 3)
    near = np.sqrt(((points[:, None] - samples) ** 2).sum(axis=2).min(axis=1))
    assert (found <= near + 1e-9).all() and (near - found).max() < 0.06


def test_open_surfaces_and_tolerances_of_nothing_are_refused(tmp_path):
    surface = ball(5)
    from trabecula.mesh.base import Mesh

    with pytest.raises(tb.errors.InputError, match="not closed"):
        decimate(Mesh(surface.vertices, surface.faces[1:]), 0.5)
    for bad in (0, -1, float("nan")):
        with pytest.raises(tb.errors.InputError, match="tolerance"):
            decimate(surface, bad)
    solid = np.ones((4, 4, 4), np.uint8)
    with pytest.raises(tb.errors.InputError, match="voxels"):
        tb.export(solid, tmp_path / "a.npy", tolerance=0.5)
    few = tb.export(solid, tmp_path / "a.stl", tolerance=0.5)
    assert few.stat().st_size < tb.export(solid, tmp_path / "b.stl").stat().st_size

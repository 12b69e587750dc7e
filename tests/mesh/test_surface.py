"""Surfaces: known volumes, closed for every volume, in the image's unit."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import ndimage

import trabecula as tb
from trabecula.core.errors import InputError, MemoryBudgetError, UnknownNameError
from trabecula.mesh.base import Mesh
from trabecula.mesh.check import check


def ball(radius, size):
    centre = (size - 1) / 2
    return sum((axis - centre) ** 2 for axis in np.indices((size,) * 3)) < radius**2


def oracle(mesh):
    return trimesh.Trimesh(mesh.vertices.astype(float), mesh.faces, process=False)


@pytest.mark.parametrize("radius", [12.3, 20.3])
def test_ball_has_the_volume_and_the_area_of_a_ball(radius):
    found = check(tb.mesh(ball(radius, 46)))
    assert found.volume == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.01)
    assert found.area == pytest.approx(4 * np.pi * radius**2, rel=0.03)
    assert found.components == 1 and found.watertight


def test_smoothing_brings_the_normals_to_those_of_the_ball():
    def deviation(rounds):
        surface = oracle(tb.mesh(ball(15.2, 34), smooth=rounds))
        radial = surface.triangles_center - 17
        radial /= np.linalg.norm(radial, axis=1)[:, None]
        return np.degrees(
            np.arccos(np.clip(np.sum(radial * surface.face_normals, axis=1), -1, 1))
        ).mean()

    assert deviation(0) > 15
    assert deviation(None) < 8


def test_one_voxel_is_an_octahedron():
    mesh = tb.mesh(np.ones((1, 1, 1), np.uint8), phase=1, smooth=0)
    found = check(mesh)
    assert (found.vertices, found.faces) == (6, 8)
    assert found.volume == pytest.approx(1 / 6)
    assert found.bounds == ((0, 0, 0), (1, 1, 1))


def test_a_full_block_is_a_closed_box_with_flat_faces():
    found = check(tb.mesh(np.ones((9, 12, 15), bool)))
    assert found.watertight and found.components == 1
    assert found.bounds == ((0, 0, 0), (15, 12, 9))  # x, y, z
    # edges are bevelled by half a voxel
    assert found.volume == pytest.approx(9 * 12 * 15, rel=0.03)
    mesh = tb.mesh(np.ones((9, 12, 15), bool))
    normals = oracle(mesh).face_normals
    flat = np.abs(normals).max(axis=1) > 1 - 1e-6
    assert oracle(mesh).area_faces[flat].sum() > 0.8 * found.area


def test_axes_are_x_y_z_in_the_images_unit():
    values = np.zeros((8, 9, 10), np.uint8)
    values[1:3, 2:6, 3:9] = 1
    mesh = tb.mesh(tb.Image(values, "labels", spacing=(5.0, 2.0, 0.5), unit="um"), smooth=0)
    found = check(mesh)
    assert mesh.unit == found.unit == "um"
    np.testing.assert_allclose(
        found.bounds, [(3 * 0.5, 2 * 2.0, 1 * 5.0), (9 * 0.5, 6 * 2.0, 3 * 5.0)]
    )


def test_spacing_only_stretches():
    solid = ball(6.2, 16)
    plain, stretched = (
        tb.mesh(solid),
        tb.mesh(tb.Image(solid, "labels", spacing=(3.0, 2.0, 0.5), unit="mm")),
    )
    np.testing.assert_allclose(
        stretched.vertices, plain.vertices * np.float32([0.5, 2.0, 3.0]), rtol=1e-6
    )
    np.testing.assert_array_equal(stretched.faces, plain.faces)


@settings(max_examples=60, deadline=None)
@given(
    arrays(bool, array_shapes(min_dims=3, max_dims=3, min_side=1, max_side=7)),
    st.sampled_from([0, 3]),
)
def test_any_volume_gives_a_closed_surface(solid, rounds):
    if not solid.any():
        return
    mesh = tb.mesh(solid, smooth=rounds)
    surface = oracle(mesh)
    assert surface.is_watertight and surface.is_winding_consistent
    assert check(mesh).watertight and surface.volume > 0
    if not rounds:
        assert check(mesh).degenerate_faces == 0


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_noise_is_closed_and_its_parts_are_the_6_connected_ones(share):
    solid = np.random.default_rng(3).random((24, 25, 26)) < share
    mesh = tb.mesh(solid)
    surface = oracle(mesh)
    assert surface.is_watertight and surface.is_winding_consistent and surface.volume > 0
    # Every part has one outside; a cavity (void, joined over edges: 18-connected) adds an inside.
    parts = ndimage.label(solid)[1]
    voids = ndimage.label(
        np.pad(~solid, 1, constant_values=True), ndimage.generate_binary_structure(3, 2)
    )[1]
    assert check(mesh).components == parts + voids - 1
    # no vertex without a ring of faces
    np.testing.assert_array_equal(np.bincount(mesh.faces.ravel()) > 2, True)


def test_a_real_scan_is_closed(data):
    import tifffile

    solid = tifffile.imread(data / "trabecular_bone_a.tif")[:80, :80, :80] > 0
    found = check(tb.mesh(solid))
    assert found.watertight
    assert found.volume == pytest.approx(solid.sum(), rel=0.05)


def test_the_phase_can_be_chosen_and_the_default_is_all_but_void():
    values = np.zeros((6, 6, 6), np.uint8)
    values[:, :, :2], values[:, :, 2:4] = 1, 2
    assert check(tb.mesh(values, smooth=0)).bounds[1][0] == 4
    assert check(tb.mesh(values, phase="phase2", smooth=0)).bounds[0][0] == 2
    assert check(tb.mesh(values, phase=0, smooth=0)).bounds == ((4, 0, 0), (6, 6, 6))


def test_the_recipe_grows_by_one_step():
    mesh = tb.mesh(np.ones((3, 3, 3), bool), smooth=2)
    step = mesh.recipe.to_json()[-1]
    assert (step["verb"], step["smooth"]) == ("mesh", 2)
    assert (
        step["sha256"] == tb.mesh(np.ones((3, 3, 3), bool), smooth=2).recipe.to_json()[-1]["sha256"]
    )


@pytest.mark.parametrize(
    ("image", "options", "message"),
    [
        (np.zeros((4, 4, 4), np.uint8), {}, "nothing to export"),
        (np.ones((4, 4), np.uint8), {}, "needs a volume"),
        (tb.Image(np.ones((4, 4, 4)), "grey"), {}, "labels are needed"),
        (np.ones((4, 4, 4), np.uint8), {"smooth": -1}, "rounds"),
        (np.ones((4, 4, 4), np.uint8), {"smooth": 2.5}, "rounds"),
    ],
)
def test_what_has_no_surface_is_refused(image, options, message):
    with pytest.raises(InputError, match=message):
        tb.mesh(image, **options)


def test_an_unknown_phase_suggests_the_nearest():
    with pytest.raises(UnknownNameError, match="did you mean 'solid'"):
        tb.mesh(np.ones((4, 4, 4), bool), phase="sold")


def test_a_surface_beyond_memory_is_refused(monkeypatch):
    monkeypatch.setattr("trabecula.engine.memory.available_memory", lambda: 1000)
    with pytest.raises(MemoryBudgetError, match="mesh a crop"):
        tb.mesh(ball(4.0, 10))


def test_check_finds_holes_flips_and_flat_faces():
    mesh = tb.mesh(ball(4.2, 10))
    assert check(Mesh(mesh.vertices, mesh.faces[1:])).open_edges == 3
    flipped = mesh.faces.copy()
    flipped[0] = flipped[0, ::-1]
    assert check(Mesh(mesh.vertices, flipped)).twisted_edges == 3
    doubled = np.concatenate([mesh.faces, mesh.faces[:1]])
    assert check(Mesh(mesh.vertices, doubled)).crowded_edges == 3
    flat = np.concatenate([mesh.faces, [[0, 0, 1]]])
    assert check(Mesh(mesh.vertices, flat)).degenerate_faces == 1
    assert not any(
        check(Mesh(mesh.vertices, f)).watertight for f in (mesh.faces[1:], flipped, doubled, flat)
    )
    surface = oracle(mesh)
    assert check(mesh).volume == pytest.approx(surface.volume) and check(
        mesh
    ).area == pytest.approx(surface.area)


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((3, 2)), np.zeros((1, 3), int), "vertices"),
        (np.zeros((3, 3)), np.zeros((1, 3)), "faces"),
        (np.zeros((3, 3)), np.array([[0, 1, 3]]), "0..2"),
        (np.full((3, 3), np.nan), np.array([[0, 1, 2]]), "NaN"),
    ],
)
def test_a_damaged_mesh_is_refused(vertices, faces, message):
    with pytest.raises(InputError, match=message):
        Mesh(vertices, faces)


@pytest.mark.whole
def test_the_room_can_be_called_by_its_name_whoever_came_first():
    import subprocess
    import sys

    code = (
        "import trabecula.mesh.files, trabecula as tb, numpy as np; "
        "tb.mesh(np.ones((1, 1, 1), bool)).faces[7]"
    )
    subprocess.run([sys.executable, "-c", code], check=True)

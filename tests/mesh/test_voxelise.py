"""Voxelise: known volumes, an oracle, and rays that meet edges and vertices."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import trabecula as tb
from trabecula.errors import InputError, MemoryBudgetError
from trabecula.mesh.base import Mesh
from trabecula.mesh.files import read_mesh
from trabecula.mesh.voxels import fit_mesh, scale_mesh, voxelise


def of(surface, **fields):
    return Mesh(np.asarray(surface.vertices, float), np.asarray(surface.faces), **fields)


def rotate(surface, seed=0):
    surface.apply_transform(
        trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3))
    )
    return surface


def volume(image):
    return float(image.values.sum() * np.prod(image.spacing))


TETRAHEDRON = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])


@pytest.mark.parametrize("spacing", [0.02, (0.02, 0.02, 0.04), (0.03, 0.015, 0.02)])
@pytest.mark.parametrize(
    "surface",
    [
        lambda: trimesh.creation.icosphere(4, radius=1.3),
        lambda: rotate(trimesh.creation.torus(1.2, 0.6)),
        lambda: rotate(trimesh.creation.box((2.0, 2.3, 2.7))),
    ],
    ids=["ball", "torus", "box"],
)
def test_the_volume_is_the_meshs(surface, spacing):
    surface = surface()
    assert volume(voxelise(of(surface), spacing=spacing)) == pytest.approx(surface.volume, rel=1e-3)


def test_a_ball_is_the_voxels_nearer_than_its_radius():
    ball = of(trimesh.creation.icosphere(5, radius=10.0))
    found = voxelise(ball, spacing=(2, 1, 1), shape=(12, 24, 24)).values
    z, y, x = np.meshgrid(
        *((np.arange(n) + 0.5 - n / 2) * edge for n, edge in ((12, 2), (24, 1), (24, 1))),
        indexing="ij",
    )
    radius = np.sqrt(z**2 + y**2 + x**2)
    assert np.array_equal(found[radius < 9.98], np.ones((radius < 9.98).sum()))
    assert not found[radius > 10].any()


@pytest.mark.parametrize("spacing", [1, (2, 1, 0.5)])
def test_voxels_come_back_from_their_own_surface(spacing):
    solid = np.random.default_rng(1).random((9, 10, 11)) < 0.5
    image = tb.Image(solid, "labels", spacing=spacing, unit="um")
    surface = tb.mesh(image, smooth=0)
    again = voxelise(surface, spacing=spacing, shape=solid.shape, origin=(0, 0, 0))
    assert (
        np.array_equal(again.values, solid)
        and again.spacing == image.spacing
        and again.unit == "um"
    )


@pytest.mark.parametrize("shift", [0.0, 0.5, 0.25])
def test_rays_along_edges_and_through_vertices(shift):
    """Check an octahedron and a box with vertices and edges on the very lines of the rays."""
    axes = np.vstack([np.eye(3), -np.eye(3)])
    faces = [
        [a, b, c] if np.linalg.det(axes[[a, b, c]]) > 0 else [a, c, b]
        for a in (0, 3)
        for b in (1, 4)
        for c in (2, 5)
    ]
    octahedron = Mesh(axes * 4.0 + 5.0 + shift, np.array(faces))
    found = voxelise(octahedron, spacing=1, shape=(11, 11, 11), origin=(0, 0, 0)).values
    distance = np.abs(np.indices((11, 11, 11)) + 0.5 - 5.0 - shift).sum(axis=0)
    assert found[distance < 4 - 1e-9].all() and not found[distance > 4 + 1e-9].any()
    box = of(trimesh.creation.box(bounds=np.array([[1, 2, 3], [4, 6, 8]]) + shift))
    found = voxelise(box, spacing=1, shape=(10, 10, 10), origin=(0, 0, 0)).values
    assert found.sum() == 3 * 4 * 5 and np.ptp(np.nonzero(found), axis=1).tolist() == [4, 3, 2]


@given(st.integers(0, 10**6), st.integers(1, 12), st.booleans())
def test_no_ray_leaks_however_vertices_lie(seed, count, whole):
    """Check tetrahedra with vertices on the grid of rays, thin ones and flat ones.

    No winding is left in the last voxels, and the solid angle agrees in all voxels off the surface.
    """
    rng = np.random.default_rng(seed)
    points = rng.integers(0, 17, (count, 4, 3)) / 2 if whole else rng.random((count, 4, 3)) * 8
    faces = (TETRAHEDRON[None] + 4 * np.arange(count)[:, None, None]).reshape(-1, 3)
    flipped = np.linalg.det(points[:, 1:] - points[:, :1]) < 0
    points[flipped] = points[flipped][:, [0, 2, 1, 3]]
    mesh = Mesh(points.reshape(-1, 3), faces)
    try:
        found = voxelise(mesh, spacing=1, shape=(8, 8, 10), origin=(0, 0, 0)).values == 1
    except InputError as error:
        assert "no voxel lies inside" in str(error)
        found = np.zeros((8, 8, 10), bool)
    assert not found[:, :, 8:].any()
    centres = np.indices(found.shape).reshape(3, -1).T[:, ::-1] + 0.5
    inside, near = np.zeros(len(centres), bool), np.zeros(len(centres), bool)
    for corners in points:
        sides = corners[1:] - corners[0]
        if abs(np.linalg.det(sides)) < 1e-9:
            near |= True  # flat: its plane may pass anywhere
            continue
        weights = (centres - corners[0]) @ np.linalg.inv(sides)
        weights = np.column_stack([weights, 1 - weights.sum(axis=1)])
        inside |= (weights > 1e-9).all(axis=1)
        near |= (np.abs(weights) <= 1e-9).any(axis=1) & (weights >= -1e-9).all(axis=1)
    assert np.array_equal(found.ravel()[~near], inside[~near])


def test_parts_that_overlap_are_joined_and_cavities_stay_empty():
    outer, inner = trimesh.creation.icosphere(3, radius=10), trimesh.creation.icosphere(3, radius=5)
    both = of(
        trimesh.util.concatenate(
            [outer, trimesh.creation.icosphere(3, radius=10).apply_translation((6, 0, 0))]
        )
    )
    wide = voxelise(both, spacing=0.5)
    union = (2 * 4 / 3 * np.pi * 1000) - np.pi / 12 * (4 * 10 + 6) * (2 * 10 - 6) ** 2
    assert volume(wide) == pytest.approx(union, rel=0.01)
    inner.invert()
    hollow = voxelise(of(trimesh.util.concatenate([outer, inner])), spacing=0.5)
    assert volume(hollow) == pytest.approx(outer.volume + inner.volume, rel=0.005)
    assert hollow.values[tuple(side // 2 for side in hollow.shape)] == 0
    outer.invert()
    assert volume(voxelise(of(outer), spacing=0.5)) == pytest.approx(-outer.volume, rel=0.005)


def test_the_form_lies_in_the_middle_with_the_margin_asked_for():
    box = of(trimesh.creation.box((4, 6, 8)).apply_translation((100, -50, 7)))
    assert voxelise(box, spacing=1).values.all() and voxelise(box, spacing=1).shape == (8, 6, 4)
    wide = voxelise(box, spacing=(2, 1, 0.5), margin=3)
    assert (
        wide.shape == (4 + 6, 6 + 6, 8 + 6)
        and wide.values[3:-3, 3:-3, 3:-3].all()
        and wide.values.sum() == 4 * 6 * 8
    )
    placed = voxelise(box, spacing=1, shape=(10, 10, 10))
    assert placed.values[1:9, 2:8, 3:7].all() and placed.values.sum() == 192


def test_scaling_to_a_box_keeps_proportions():
    box = of(trimesh.creation.box((2, 3, 4)))
    image = voxelise(
        fit_mesh(box, shape=(40, 60, 10), spacing=(1, 1, 2)), spacing=(1, 1, 2), shape=(40, 60, 10)
    )
    extents = np.ptp(np.nonzero(image.values), axis=1) + 1
    assert extents.tolist() == [40, 30, 10] and image.values.sum() == 40 * 30 * 10
    double = scale_mesh(box, 2, unit="mm")
    assert double.unit == "mm" and volume(voxelise(double, spacing=0.5)) == 8 * 24
    assert [step["verb"] for step in voxelise(double, spacing=0.5).recipe.steps[0]["mesh"]] == [
        "scale"
    ]


def test_split_vertices_are_welded():
    """Weld vertices at equal positions, as at the seams of a texture or in a soup of triangles."""
    ball = trimesh.creation.icosphere(3)
    soup = Mesh(
        np.asarray(ball.triangles, float).reshape(-1, 3),
        np.arange(3 * len(ball.faces)).reshape(-1, 3),
    )
    assert np.array_equal(
        voxelise(soup, spacing=0.1).values, voxelise(of(ball), spacing=0.1).values
    )


def test_threads_do_not_matter():
    torus = of(rotate(trimesh.creation.torus(1.2, 0.6)))
    alone = voxelise(torus, spacing=0.04).values
    with tb.threads(3):
        assert np.array_equal(voxelise(torus, spacing=0.04).values, alone)


def with_hole(surface):
    return Mesh(np.asarray(surface.vertices, float), np.asarray(surface.faces)[2:])


def with_twist(surface):
    faces = np.array(surface.faces)
    faces[5] = faces[5][::-1]
    return Mesh(np.asarray(surface.vertices, float), faces)


@pytest.mark.parametrize(
    ("mesh", "options", "says"),
    [
        (
            with_hole(trimesh.creation.box()),
            {},
            r"not watertight.*4 edges of one face only \(holes\) of 17; fill the holes",
        ),
        (
            with_twist(trimesh.creation.icosphere(2)),
            {},
            "3 edges whose two faces disagree on which side is outside",
        ),
        (of(trimesh.creation.box()), {"spacing": 3}, "no voxel lies inside|needs"),
        (
            of(trimesh.creation.box((9, 9, 9))),
            {"shape": 8},
            r"needs 9 x 9 x 9 voxels, the shape is \(8, 8, 8\)",
        ),
        (of(trimesh.creation.box()), {"shape": 8, "margin": 2}, "a shape or a margin, not both"),
        (of(trimesh.creation.box()), {"margin": -1}, "margin=-1 is outside"),
        (of(trimesh.creation.box()), {"spacing": 0}, "must be positive"),
        (of(trimesh.creation.box()), {"origin": (0, 0)}, "three finite numbers"),
        (of(trimesh.creation.box()), {"shape": 4, "origin": (50, 50, 50)}, "no voxel lies inside"),
        (Mesh(np.zeros((3, 3)), np.zeros((0, 3), int)), {}, "no faces"),
    ],
)
def test_refusals(mesh, options, says):
    if options == {"spacing": 3}:
        mesh = Mesh(mesh.vertices + 0.1, mesh.faces)
        options = {"spacing": 3, "origin": (0, 0, 0)}
        says = "no voxel lies inside"
    with pytest.raises(InputError, match=says):
        voxelise(mesh, **{"spacing": 1, **options})


def test_too_many_voxels_are_refused_before_they_are_made():
    with pytest.raises(MemoryBudgetError, match="use larger voxels"):
        voxelise(of(trimesh.creation.box()), spacing=1e-4)


def winding_number(mesh, points):
    """Return the solid angle of the surface over 4 pi (van Oosterom and Strackee 1983)."""
    a, b, c = (mesh.vertices[mesh.faces[:, k]][None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=2) for side in (a, b, c))
    dot = lambda u, v: (u * v).sum(axis=2)  # noqa: E731
    top = dot(a, np.cross(b, c))
    bottom = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
    return np.arctan2(top, bottom).sum(axis=1) / (2 * np.pi)


@pytest.mark.whole
@pytest.mark.parametrize("name", ["mesh_bunny.ply", "mesh_spot.ply"])
def test_real_meshes_agree_with_a_second_opinion(data, name):
    mesh = fit_mesh(read_mesh(data / name), shape=64, spacing=1)
    image = voxelise(mesh, spacing=1, shape=64)
    assert image.values.sum() == pytest.approx(
        trimesh.Trimesh(mesh.vertices, mesh.faces).volume, rel=2e-3
    )
    low = np.array(image.recipe.steps[0]["origin"])
    picked = np.random.default_rng(0).integers(0, 64, (400, 3))
    number = winding_number(mesh, (picked + 0.5 + low)[:, ::-1])
    np.testing.assert_allclose(number, image.values[tuple(picked.T)], atol=1e-6)
    assert 20 < image.values[tuple(picked.T)].sum() < 380

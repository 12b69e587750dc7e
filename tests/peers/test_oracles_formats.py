"""Files of every format by other packages' code, both ways; each test is skipped by name where its
package is not installed. The table of all oracles is docs/guide/oracles.md.
"""

import numpy as np
import pytest

import trabecula as tb

RNG = np.random.default_rng(23)
SPACING = (2.5, 0.25, 0.5)
GREY = tb.Image(RNG.integers(0, 60_000, (5, 6, 7)).astype(np.uint16), "grey", SPACING, "mm")
PICTURE = tb.Image(RNG.integers(0, 256, (6, 7)).astype(np.uint8), "grey", (0.5, 0.25), "mm")
COLOUR = tb.Image(RNG.integers(0, 256, (6, 7, 3)).astype(np.uint8), "colour")
PART = tb.Image(np.pad(np.ones((4, 5, 6), np.uint8), 1), "labels", SPACING, "mm")
AREA = 2 * (4 * 2.5 * 5 * 0.25 + 4 * 2.5 * 6 * 0.5 + 5 * 0.25 * 6 * 0.5)


@pytest.mark.parametrize("suffix", [".tif", ".mha", ".mhd", ".nrrd", ".nii", ".nii.gz"])
def test_itk_reads_and_writes_volumes(suffix, tmp_path):
    itk = pytest.importorskip("SimpleITK")
    path = str(tb.write(GREY, tmp_path / f"x{suffix}"))
    theirs = itk.ReadImage(path)
    np.testing.assert_array_equal(itk.GetArrayFromImage(theirs), GREY.values)
    if suffix != ".tif":  # ITK takes no spacing along z from a TIFF
        assert theirs.GetSpacing() == pytest.approx(SPACING[::-1])
    made = itk.GetImageFromArray(GREY.values)
    made.SetSpacing(SPACING[::-1])
    itk.WriteImage(made, str(tmp_path / f"y{suffix}"), useCompression=True)
    ours = tb.read(tmp_path / f"y{suffix}", kind="grey")
    np.testing.assert_array_equal(ours.values, GREY.values)
    if suffix != ".tif":
        assert ours.spacing == pytest.approx(SPACING)


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".tif", ".jpg"])
def test_itk_reads_and_writes_pictures(suffix, tmp_path):
    itk = pytest.importorskip("SimpleITK")
    close = {"atol": 16} if suffix == ".jpg" else {"atol": 0}
    smooth = tb.Image(np.add.outer(np.arange(16), np.arange(24)).astype(np.uint8) * 4, "grey")
    for image in (smooth, *((COLOUR,) if suffix != ".jpg" else ())):
        theirs = itk.GetArrayFromImage(itk.ReadImage(str(tb.write(image, tmp_path / f"x{suffix}"))))
        if theirs.ndim > image.values.ndim:  # a BMP of greys is a palette, which ITK reads as RGB
            theirs = theirs[..., 0]
        np.testing.assert_allclose(theirs, image.values, **close)
        made = itk.GetImageFromArray(image.values, isVector=image.kind == "colour")
        itk.WriteImage(made, str(tmp_path / f"y{suffix}"))
        ours = tb.read(tmp_path / f"y{suffix}", kind=image.kind)
        np.testing.assert_allclose(ours.values, image.values, **close)


def test_itk_reads_a_folder_of_slices(tmp_path):
    itk = pytest.importorskip("SimpleITK")
    tb.write(GREY, f"{tmp_path}/x/")
    names = sorted(str(name) for name in (tmp_path / "x").glob("*.png"))
    theirs = itk.GetArrayFromImage(itk.ReadImage(names))
    np.testing.assert_array_equal(theirs, GREY.values)


def test_pyvista_reads_and_writes_vti(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    theirs = pyvista.read(tb.write(GREY, tmp_path / "x.vti"))
    assert theirs.spacing == pytest.approx(SPACING[::-1])
    values = np.asarray(theirs.cell_data["grey"]).reshape(GREY.shape)
    np.testing.assert_array_equal(values, GREY.values)
    grid = pyvista.ImageData(dimensions=[side + 1 for side in GREY.shape[::-1]])
    grid.spacing = SPACING[::-1]
    grid.cell_data["grey"] = GREY.values.ravel()
    grid.save(tmp_path / "y.vti")
    ours = tb.read(tmp_path / "y.vti")
    np.testing.assert_array_equal(ours.values, GREY.values)
    assert ours.spacing == pytest.approx(SPACING)


def test_ome_zarr_reads_a_store(tmp_path):
    reader = pytest.importorskip("ome_zarr.reader")
    location = pytest.importorskip("ome_zarr.io")
    path = tb.write(GREY, tmp_path / "x.zarr")
    (node, *_) = reader.Reader(location.parse_url(path))()
    np.testing.assert_array_equal(np.asarray(node.data[0]), GREY.values)
    assert [axis["name"] for axis in node.metadata["axes"]] == ["z", "y", "x"]
    scale = node.metadata["coordinateTransformations"][0][0]["scale"]
    assert scale == pytest.approx(SPACING)


@pytest.mark.parametrize("kind", ["labels", "grey", "colour", "picture"])
def test_ome_zarr_models_validates_a_store(kind, tmp_path):
    """Of every kind, with coarser levels beside the voxels: the schema of OME-Zarr 0.5."""
    models = pytest.importorskip("ome_zarr_models")
    zarr = pytest.importorskip("zarr")
    rng = np.random.default_rng(2)
    image = {
        "labels": tb.Image(rng.integers(0, 2, (20, 21, 22)), "labels", SPACING, "um"),
        "grey": tb.Image(GREY.values, "grey", SPACING, "um"),
        "colour": tb.Image(rng.integers(0, 255, (5, 6, 7, 3), np.uint8), "colour", SPACING, "um"),
        "picture": tb.Image(rng.random((8, 9)), "grey", SPACING[1:], "um"),
    }[kind]
    path = tb.write(image, tmp_path / "x.zarr")
    found = models.open_ome_zarr(zarr.open_group(path, mode="r"), version="0.5")
    assert type(found).__name__ == "Image"
    (multiscale,) = found.attributes.ome.multiscales
    axes = [(axis.name, axis.type, axis.unit) for axis in multiscale.axes]
    space = [(name, "space", "micrometer") for name in "zyx"[-image.ndim :]]
    assert axes == [("c", "channel", None)] * (kind == "colour") + space


def test_tifffile_and_imageio_read_a_stack(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    imageio = pytest.importorskip("imageio.v3")
    path = tb.write(GREY, tmp_path / "x.tif")
    np.testing.assert_array_equal(tifffile.imread(path), GREY.values)
    np.testing.assert_array_equal(imageio.imread(path, plugin="pillow", index=...), GREY.values)


def test_numpy_reads_npy(tmp_path):
    np.testing.assert_array_equal(np.load(tb.write(GREY, tmp_path / "x.npy")), GREY.values)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_meshio_reads_and_writes_surfaces(suffix, tmp_path):
    meshio = pytest.importorskip("meshio")
    theirs = meshio.read(tb.export(PART, tmp_path / f"x{suffix}"))
    ours = tb.read_mesh(tmp_path / f"x{suffix}", unit="mm")
    triangles = theirs.get_cells_type("triangle")
    assert area(theirs.points, triangles) == pytest.approx(area(ours.vertices, ours.faces))
    assert area(theirs.points, triangles) == pytest.approx(AREA, rel=0.15)  # corners are cut
    meshio.write(tmp_path / f"y{suffix}", theirs)
    back = tb.read_mesh(tmp_path / f"y{suffix}", unit="mm")
    assert len(back.faces) == len(triangles)
    assert area(back.vertices, back.faces) == pytest.approx(area(theirs.points, triangles))


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_vtk_reads_surfaces(suffix, tmp_path):
    pyvista = pytest.importorskip("pyvista")
    theirs = pyvista.read(tb.export(PART, tmp_path / f"x{suffix}"))
    assert theirs.area == pytest.approx(AREA, rel=0.15)
    assert theirs.triangulate().clean().is_manifold


def solid_part():
    """Return a part of two phases, its share by label, and the volume of a voxel."""
    values = PART.values + (np.indices(PART.shape).sum(0) % 3 == 0) * PART.values
    values = values[1:, :, :-1]  # two faces are cut
    part = tb.Image(values, "labels", PART.spacing, PART.unit, phases=("void", "a", "b"))
    return part, np.bincount(values.ravel(), minlength=3), float(np.prod(PART.spacing))


@pytest.mark.parametrize("suffix", [".inp", ".vtu"])
def test_meshio_reads_bricks(suffix, tmp_path):
    meshio = pytest.importorskip("meshio")
    part, counts, _ = solid_part()
    theirs = meshio.read(tb.export(part, tmp_path / f"x{suffix}"))
    bricks = theirs.get_cells_type("hexahedron")
    assert len(bricks) == counts[1:].sum()
    edges = theirs.points[bricks[:, [1, 3, 4]]] - theirs.points[bricks[:, :1]]
    np.testing.assert_allclose(np.linalg.det(edges), np.prod(part.spacing), rtol=1e-6)
    if suffix == ".inp":
        sets = theirs.cell_sets_dict
        found = [len(sets[name]["hexahedron"]) for name in ("A", "B")]
        assert {"X_HIGH", "Z_LOW"} == set(theirs.point_sets)
    else:
        found = [
            np.count_nonzero(theirs.cell_data_dict["phase"]["hexahedron"] == n) for n in (1, 2)
        ]
    assert found == counts[1:].tolist()


def test_others_read_tetrahedra(tmp_path):
    meshio = pytest.importorskip("meshio")
    pytest.importorskip("gmsh")
    part = tb.Image(solid_part()[0].values, "labels", phases=("void", "a", "b"))
    ours = tb.tetrahedra(part)
    for suffix in (".vtu", ".msh", ".inp"):
        theirs = meshio.read(tb.export(part, tmp_path / f"x{suffix}", tetrahedra=2))
        sides = theirs.points[theirs.get_cells_type("tetra")]
        sizes = np.linalg.det(sides[:, 1:] - sides[:, :1]) / 6
        assert sizes.min() > 0 and sizes.sum() == pytest.approx(sum(ours.volume.values()), rel=1e-6)
    nodes, groups = read_by_gmsh(tmp_path / "x.msh")
    assert nodes == len(ours.points) and groups == [(3, 2), (3, 3)]


def test_others_read_bricks_of_gmsh(tmp_path):
    meshio = pytest.importorskip("meshio")
    pytest.importorskip("gmsh")
    part, counts, voxel = solid_part()
    theirs = meshio.read(tb.export(part, tmp_path / "x.msh"))
    bricks = theirs.get_cells_type("hexahedron")
    edges = theirs.points[bricks[:, [1, 3, 4]]] - theirs.points[bricks[:, :1]]
    np.testing.assert_allclose(np.linalg.det(edges), voxel, rtol=1e-6)
    physical = theirs.cell_data_dict["gmsh:physical"]["hexahedron"]
    assert [np.count_nonzero(physical == 1 + n) for n in (1, 2)] == counts[1:].tolist()
    nodes, groups = read_by_gmsh(tmp_path / "x.msh")
    assert nodes == len(theirs.points) and groups == [(3, 2), (3, 3)]


def read_by_gmsh(path):
    """Return the number of nodes and the physical groups that Gmsh finds."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.open(str(path))
    found = len(gmsh.model.mesh.getNodes()[0]), gmsh.model.getPhysicalGroups()
    gmsh.finalize()
    return found


def test_vtk_reads_bricks(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    part, counts, voxel = solid_part()
    theirs = pyvista.read(tb.export(part, tmp_path / "x.vtu"))
    assert theirs.volume == pytest.approx(counts[1:].sum() * voxel)
    for label in (1, 2):
        one = theirs.threshold([label - 0.5, label + 0.5], scalars="phase")
        assert one.volume == pytest.approx(counts[label] * voxel)


def test_vtk_reads_an_openfoam_mesh(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    part, counts, voxel = solid_part()
    case = tb.export(part, tmp_path / "x.foam", phase=["void", "a", "b"])
    theirs = pyvista.OpenFOAMReader(str(case / "case.foam")).read()["internalMesh"]
    assert theirs.n_cells == counts.sum()
    metres = {"mm": 1e-3, "um": 1e-6}[part.unit]
    assert theirs.volume == pytest.approx(counts.sum() * voxel * metres**3, rel=1e-4)


def test_lib3mf_reads_a_part(tmp_path):
    lib3mf = pytest.importorskip("lib3mf")
    wrapper = lib3mf.get_wrapper()
    model = wrapper.CreateModel()
    reader = model.QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(tb.export(PART, tmp_path / "x.3mf")))
    assert reader.GetWarningCount() == 0
    assert model.GetUnit() == lib3mf.ModelUnit.MilliMeter
    meshes = model.GetMeshObjects()
    assert meshes.MoveNext()
    mesh = meshes.GetCurrentMeshObject()
    ours = tb.read_mesh(tmp_path / "x.3mf")
    assert mesh.GetTriangleCount() == len(ours.faces) and mesh.IsManifoldAndOriented()
    points = np.array([vertex.Coordinates[:] for vertex in mesh.GetVertices()])
    np.testing.assert_allclose(points, ours.vertices, atol=1e-5)


def test_lib3mf_reads_beams_and_several_parts(tmp_path):
    lib3mf = pytest.importorskip("lib3mf")
    from trabecula.mesh.beam_file import write_beams
    from trabecula.mesh.beams import beam_lattice

    foam = tb.Image(tb.crop(tb.sample("foam"), 32).values, "labels", 0.5, unit="mm")
    lattice = beam_lattice(foam)
    values = np.zeros((12, 10, 10), np.uint8)
    values[2:6, 2:8, 2:8], values[6:10, 2:8, 2:8] = 1, 2
    two = tb.Image(values, "labels", 0.5, unit="mm", phases=("void", "steel", "rubber"))
    files = (
        write_beams(lattice, tmp_path / "beams.3mf"),
        tb.export(two, tmp_path / "two.3mf", phase=["steel", "rubber"]),
    )
    found = []
    for path in files:
        model = lib3mf.get_wrapper().CreateModel()
        reader = model.QueryReader("3mf")
        reader.SetStrictModeActive(True)
        reader.ReadFromFile(str(path))
        assert reader.GetWarningCount() == 0
        meshes = model.GetMeshObjects()
        while meshes.MoveNext():
            found.append(meshes.GetCurrentMeshObject())
    beams = found[0].BeamLattice()
    assert beams.GetBeamCount() == len(lattice.beams)
    radii = np.array([beams.GetBeam(n).Radii[:] for n in range(beams.GetBeamCount())])
    np.testing.assert_allclose(radii, lattice.radii, rtol=1e-4)
    assert [one.GetName() for one in found[1:]] == ["steel", "rubber"]
    assert all(one.IsManifoldAndOriented() for one in found[1:])


def test_lib3mf_writes_a_part(tmp_path):
    lib3mf = pytest.importorskip("lib3mf")
    wrapper = lib3mf.get_wrapper()
    source = wrapper.CreateModel()
    source.QueryReader("3mf").ReadFromFile(str(tb.export(PART, tmp_path / "x.3mf")))
    source.QueryWriter("3mf").WriteToFile(str(tmp_path / "y.3mf"))
    ours, back = (tb.read_mesh(tmp_path / f"{name}.3mf") for name in "xy")
    assert back.unit == "mm" and len(back.faces) == len(ours.faces)
    np.testing.assert_allclose(back.vertices, ours.vertices, atol=1e-5)


def area(points, triangles):
    """Return the area of triangles."""
    a, b, c = (np.asarray(points, float)[triangles[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def test_vtk_reads_a_network(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    values = np.ones((9, 9, 20), np.uint8)
    values[1:8, 1:8, 1:8] = values[1:8, 1:8, 11:18] = values[3:6, 3:6, 8:11] = 0
    net = tb.measure.network(tb.Image(values, "labels", 2.0, "um"))
    net.write(tmp_path / "net.vtp")
    found = pyvista.read(tmp_path / "net.vtp")
    assert found.n_points == 2 and found.n_lines == 1
    assert found.points == pytest.approx(net.centres[:, ::-1] * 1e-6)
    assert found.cell_data["throat.cross_sectional_area"] == pytest.approx([0, 0, 36e-12])
    assert found.point_data["pore.volume"].sum() == pytest.approx(net.volume.sum() * 1e-18)

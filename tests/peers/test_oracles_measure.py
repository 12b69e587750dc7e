"""Descriptors and solvers against other packages' code; each test is skipped by name where its
package is not installed. The table of all oracles is docs/guide/oracles.md.
"""

import numpy as np
import pytest
from scipy import ndimage, signal, stats

import trabecula as tb

RNG = np.random.default_rng(17)


def blobs(shape, width=2.0, share=0.5):
    """Return a smooth random phase, which other packages and this one see alike."""
    field = ndimage.gaussian_filter(RNG.normal(size=shape), width)
    return (field > np.quantile(field, 1 - share)).astype(np.uint8)


VOLUME = blobs((32, 28, 30))
IMAGE = tb.Image(VOLUME, "labels", 2.0, "um")
THREE = np.argmax([ndimage.gaussian_filter(RNG.normal(size=(30, 28, 26)), 2) for _ in range(3)], 0)
THREE = tb.Image(THREE.astype(np.uint8), "labels", phases=("void", "a", "b"))
GREY = tb.Image(ndimage.gaussian_filter(RNG.normal(size=(24, 26, 28)), 1.5), "grey")
PICTURE = tb.Image(RNG.integers(0, 256, (40, 50)).astype(np.uint8), "grey")


def pair_counts(first, second):
    """Return the pairs at every offset, by scipy's correlation of whole arrays."""
    return signal.correlate(second.astype(float), first.astype(float), mode="full", method="fft")


def pairs_along(first, second, axis, r_max):
    """Return the mean product of the pairs along an axis, at distances 0 .. r_max."""
    where = [slice(side - 1, side) for side in first.shape]
    where[axis] = slice(first.shape[axis] - 1, first.shape[axis] + r_max)
    counts, fits = pair_counts(first, second), pair_counts(*2 * [np.ones(first.shape)])
    return (counts / fits)[tuple(where)].ravel()


def radial_pairs(parts, r_max):
    """Return the share of pairs in one part, by the distance that their offset rounds to."""
    shape = parts[0].shape
    offsets = np.indices([2 * side - 1 for side in shape])
    offsets = offsets - np.array(shape).reshape(-1, 1, 1, 1) + 1
    length = np.rint(np.sqrt((offsets**2).sum(axis=0))).astype(int).ravel()
    counts = sum(pair_counts(part, part) for part in parts).ravel()
    fits = pair_counts(*2 * [np.ones(shape)]).ravel()
    total, all_ = (np.bincount(length, one)[: r_max + 1] for one in (counts, fits))
    return total / all_


def test_fractions_are_porespys():
    metrics = pytest.importorskip("porespy").metrics
    assert tb.measure.porosity(IMAGE) == pytest.approx(metrics.porosity(VOLUME == 0), abs=1e-12)
    shares = np.bincount(THREE.values.ravel()) / THREE.values.size
    assert list(tb.measure.volume_fractions(THREE).values()) == pytest.approx(list(shares))
    found = tb.measure.phase_numbers(THREE, level="quick")
    each = [found[f"fraction_{name}"] for name in THREE.phases]
    assert each == pytest.approx(list(shares))


@pytest.mark.parametrize("axis", range(3))
def test_two_point_and_cross_correlation_are_scipys(axis):
    expected = pairs_along(VOLUME, VOLUME, axis, 8)
    np.testing.assert_allclose(tb.measure.two_point(IMAGE, r_max=8, axis=axis), expected, atol=1e-9)
    first, second = THREE.values == 1, THREE.values == 2
    both = (pairs_along(first, second, axis, 6) + pairs_along(second, first, axis, 6)) / 2
    found = tb.measure.cross_correlation(THREE, first="a", second="b", r_max=6, axis=axis)
    np.testing.assert_allclose(found, both, atol=1e-9)


def test_radial_curves_are_sums_of_scipys_correlations():
    labelled, count = ndimage.label(VOLUME)
    clusters = [labelled == one for one in range(1, count + 1)]
    found = tb.measure.two_point(IMAGE, r_max=8)
    np.testing.assert_allclose(found, radial_pairs([VOLUME], 8), atol=1e-6)
    found = tb.measure.two_point_cluster(IMAGE, r_max=5)
    np.testing.assert_allclose(found, radial_pairs(clusters, 5), atol=1e-6)


@pytest.mark.parametrize("axis", range(3))
def test_lineal_path_is_a_minimum_along_lines(axis):
    expected = []
    for length in range(6):
        lines = np.lib.stride_tricks.sliding_window_view(VOLUME, length + 1, axis=axis)
        expected.append(lines.min(axis=-1).mean())
    found = tb.measure.lineal_path(IMAGE, r_max=5, axis=axis)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def mesh_of(field):
    """Return scikit-image's surface of where a field is positive, as trimesh takes it."""
    measure = pytest.importorskip("skimage.measure")
    trimesh = pytest.importorskip("trimesh")
    vertices, faces, *_ = measure.marching_cubes(np.pad(field, 2, constant_values=-1.0), 0.0)
    return trimesh.Trimesh(vertices, faces)


def test_surface_and_curvature_are_those_of_a_mesh():
    field = ndimage.gaussian_filter(RNG.normal(size=(40, 40, 40)), 3)
    # Round outside: sections across the axes alone would take a flat rim for less than it is.
    place = np.indices(field.shape) - 19.5
    field = field / field.std() - np.clip(np.sqrt((place**2).sum(axis=0)) - 12, 0, None)
    surface = mesh_of(field)
    solid = np.pad(field > 0, 2)
    ours = tb.measure.minkowski(solid.astype(np.uint8))
    cubes = np.prod(np.array(solid.shape) - 1)
    assert ours.surface * cubes == pytest.approx(surface.area, rel=0.03)
    curvature = abs(surface.integral_mean_curvature)
    assert abs(ours.mean_curvature) * cubes == pytest.approx(curvature, rel=0.15)


@pytest.mark.parametrize(("ours", "theirs"), [(6, 1), (26, 3)])
def test_euler_number_is_skimages(ours, theirs):
    measure = pytest.importorskip("skimage.measure")
    expected = measure.euler_number(VOLUME, connectivity=theirs)
    assert tb.measure.euler(IMAGE, connectivity=ours) == expected
    padded = np.pad(VOLUME, 1)
    density = tb.measure.euler_density(padded, connectivity=ours)
    assert density * np.prod(np.array(padded.shape) - 1) == pytest.approx(expected)


def test_surface_of_a_sphere_is_skimages_mesh():
    measure = pytest.importorskip("skimage.measure")
    grid = np.indices((40, 40, 40)) - 19.5
    distance = np.sqrt((grid**2).sum(axis=0))
    vertices, faces, *_ = measure.marching_cubes(14 - distance, 0.0)
    area = measure.mesh_surface_area(vertices, faces)
    ball = (distance < 14).astype(np.uint8)
    ours = tb.measure.specific_surface(ball) * 39**3
    assert ours == pytest.approx(area, rel=0.02)


def test_contacts_are_half_the_sum_of_surfaces_of_meshes():
    fields = [ndimage.gaussian_filter(RNG.normal(size=(40, 40, 40)), 3) for _ in range(3)]
    rim = np.pad(np.zeros((34,) * 3), 3, constant_values=1.0)
    fields[0] = np.where(rim > 0, 1.0, fields[0])
    values = np.argmax(fields, axis=0).astype(np.uint8)
    void, first, second = fields
    area = [
        mesh_of(field).area
        for field in (
            first - np.maximum(void, second),
            second - np.maximum(void, first),
            np.maximum(first, second) - void,
        )
    ]
    image = tb.Image(values, "labels", phases=("void", "a", "b"))
    found = tb.measure.contact(image, first="a", second="b") * 39**3
    assert found == pytest.approx((area[0] + area[1] - area[2]) / 2, rel=0.05)


def test_chords_are_those_that_ndimage_labels():
    lengths = []
    for axis in range(3):
        along = np.zeros((3, 3, 3))
        along[tuple(slice(None) if k == axis else 1 for k in range(3))] = 1
        labelled, count = ndimage.label(VOLUME, along)
        sizes = np.bincount(labelled.ravel())[1:]
        edge = [labelled.take(0, axis), labelled.take(-1, axis)]
        cut = len(np.unique(np.concatenate([face[face > 0] for face in edge])))
        # A chord that a face cuts off has one end inside: it counts as half of one.
        lengths.append(2 * sizes.sum() / (2 * count - cut))
        ours = tb.measure.chord_length(IMAGE, axis=axis) / 2
        side = VOLUME.shape[axis]
        assert ours == pytest.approx(lengths[-1] * (side - 1) / side, rel=0.03)


def test_thickness_is_porespys():
    filters = pytest.importorskip("porespy").filters
    solid = VOLUME.astype(bool)
    theirs = 2 * filters.local_thickness(solid, sizes=60)[solid].mean()
    # Their spheres end at voxel centres and have 60 sizes; ours reach the interface.
    assert tb.measure.thickness(IMAGE) / 2 == pytest.approx(theirs, rel=0.12, abs=0.5)
    pores = 2 * filters.local_thickness(~solid, sizes=60)[~solid].mean()
    assert tb.measure.pore_size(IMAGE) / 2 == pytest.approx(pores, rel=0.12, abs=0.5)


def test_components_are_skimages():
    measure = pytest.importorskip("skimage.measure")
    solid = blobs((26, 24, 28), 1.0, 0.3)
    labelled, count = measure.label(solid, connectivity=1, return_num=True)
    sizes = np.sort(np.bincount(labelled.ravel())[1:])
    assert tb.measure.components(solid) == count
    assert tb.measure.floating(solid) == count - 1
    assert tb.measure.floating_voxels(solid) == sizes[:-1].sum()
    assert tb.measure.largest_fraction(solid) == pytest.approx(sizes[-1] / sizes.sum())
    for axis in range(3):
        both = np.intersect1d(labelled.take(0, axis), labelled.take(-1, axis))
        joined = np.isin(labelled, both[both > 0]).sum() / solid.sum()
        assert tb.measure.percolates(solid)["zyx"[axis]] == bool(joined)
        assert tb.measure.percolating_fraction(solid, axis=axis) == pytest.approx(joined)


def test_percolation_is_porespys():
    filters = pytest.importorskip("porespy").filters
    pores = blobs((24, 24, 24), 1.5, 0.4).astype(bool)
    for axis in range(3):
        trimmed = filters.trim_nonpercolating_paths(
            pores,
            inlets=_face(pores.shape, axis, 0),
            outlets=_face(pores.shape, axis, -1),
        )
        share = tb.measure.percolating_fraction(pores.astype(np.uint8), axis=axis)
        assert share == pytest.approx(trimmed.sum() / pores.sum())


def _face(shape, axis, index):
    face = np.zeros(shape, bool)
    face[tuple(index if k == axis else slice(None) for k in range(3))] = True
    return face


def test_grey_histograms_are_numpys_and_their_divergence_scipys():
    counts, _ = np.histogram(PICTURE.values, bins=256, range=(0, 256))
    np.testing.assert_allclose(tb.measure.histogram(PICTURE), counts / counts.sum())
    edges = [*range(0, 226, 25), 256]
    tens = np.histogram(PICTURE.values, bins=edges)[0] / PICTURE.values.size
    np.testing.assert_allclose(tb.measure.ten_bins(PICTURE), tens)
    p, q = RNG.random(64), RNG.random(64)
    assert tb.measure.kullback_leibler(p, q, floor=0) == pytest.approx(stats.entropy(p, q))
    found = tb.measure.describe_texture(PICTURE)
    assert found["mean"] == pytest.approx(PICTURE.values.mean())
    assert found["standard_deviation"] == pytest.approx(PICTURE.values.std())


def test_autocorrelation_is_scipys():
    field = GREY.values - GREY.values.mean()
    found = tb.measure.autocorrelation(GREY, lags=6)
    for axis in range(3):
        expected = pairs_along(field, field, axis, 6)
        line = found[tuple(slice(6, None) if k == axis else 6 for k in range(3))]
        np.testing.assert_allclose(line, expected / expected[0], atol=1e-5)


def test_structure_tensor_is_skimages():
    feature = pytest.importorskip("skimage.feature")
    smooth = ndimage.gaussian_filter(GREY.values, 1.0, mode="nearest")
    theirs = feature.structure_tensor(smooth, sigma=2.0, mode="nearest")
    ours = tb.measure.structure_tensor(GREY, sigma=1.0, window=2.0)
    middle = (slice(9, -9),) * 3
    pairs = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
    ours = np.array([ours[pair][middle] for pair in pairs])
    theirs = np.array([tensor[middle] for tensor in theirs])
    # They take Sobel's slopes (in units of 8), we central differences of the same smooth field.
    assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.99


def test_windows_are_means_of_ndimage():
    found = tb.measure.evenness(IMAGE, windows=[16.0])
    edge = round(found.fraction[0].edge / 2)
    means = ndimage.uniform_filter(VOLUME.astype(float), edge, mode="constant")
    low = edge // 2
    inside = tuple(slice(low, low + (side - edge) // 2 * 2 + 1, 2) for side in VOLUME.shape)
    windows = means[inside]
    assert found.fraction[0].deviation == pytest.approx(windows.std(), rel=0.15)
    assert found.fraction[0].lowest == pytest.approx(windows.min(), abs=0.03)
    assert found.fraction[0].highest == pytest.approx(windows.max(), abs=0.03)
    for axis, name in enumerate("zyx"):
        profile = VOLUME.mean(axis=tuple(k for k in range(3) if k != axis))
        places = np.linspace(-0.5, 0.5, len(profile))
        slope = stats.linregress(places, profile).slope
        assert found.trend[name] == pytest.approx(slope, abs=0.05)


def test_mid_axis_is_near_skimages_skeleton():
    morphology = pytest.importorskip("skimage.morphology")
    solid = blobs((40, 40, 40), 3.0, 0.4)
    skeleton = morphology.skeletonize(solid.astype(bool))
    ours = tb.measure.thin(tb.Image(solid, "labels"))
    ours = np.asarray(ours).astype(bool)
    near = ndimage.distance_transform_edt(~skeleton)[ours]
    assert near.mean() < 1.5


def test_diffusivity_is_taufactors():
    taufactor = pytest.importorskip("taufactor")
    pytest.importorskip("torch")
    pores = blobs((24, 24, 24), 2.5, 0.6)
    solver = taufactor.Solver(pores, device="cpu")
    solver.solve(verbose=False, conv_crit=1e-4)
    tau = float(np.ravel(solver.tau)[0])
    image = tb.Image(1 - pores, "labels")
    # Both put one voxel's conductance between neighbours and fixed values on the end faces.
    found = tb.measure.tortuosity(image, axis=0).value
    assert found == pytest.approx(tau, rel=0.01)
    share = float(np.ravel(solver.D_eff)[0])
    assert tb.measure.diffusivity(image, axis=0).value == pytest.approx(share, rel=0.01)
    weak = {"void": 1.0, "solid": 0.0}
    found = tb.measure.conductivity(image, axis=0, conductivities=weak).value
    assert found == pytest.approx(share, rel=0.01)


def berea(data, side):
    """Return a corner of the sandstone, edges of 5 um."""
    values = (tb.read(data / "berea_sandstone_a.tif").values[(slice(side),) * 3] != 0).astype(
        np.uint8
    )
    return tb.Image(values, "labels", 5.0, "um", phases=("void", "solid"))


def test_networks_are_near_porespys(data):
    networks = pytest.importorskip("porespy").networks
    image = berea(data, 100)
    theirs = networks.snow2(image.values == 0, boundary_width=3).network
    ours = tb.measure.network(image)
    inner = ~theirs["pore.boundary"]
    between = inner[theirs["throat.conns"]].all(axis=1)
    assert len(ours) == pytest.approx(inner.sum(), rel=0.15)
    assert len(ours.throats) == pytest.approx(between.sum(), rel=0.15)
    # they leave out what reaches no face, so the figures are of the pores of all components there
    joined = np.bincount(theirs["throat.conns"][between].ravel(), minlength=len(inner))[inner]
    own = ours.coordination[ours.coordination > 0]
    assert own.mean() == pytest.approx(joined[joined > 0].mean(), rel=0.15)
    wide = theirs["throat.inscribed_diameter"][between].mean() / 2
    assert ours.throats.radius.mean() / 5 == pytest.approx(wide, rel=0.3)


def test_openpnm_reads_a_network_and_solves_the_same(data, tmp_path):
    openpnm = pytest.importorskip("openpnm")
    image = berea(data, 80)
    ours = tb.measure.network(image)
    for name in ("net.npz", "net.csv", "net.dat"):
        ours.write(tmp_path / name)
    arrays = openpnm.io.network_from_porespy(dict(np.load(tmp_path / "net.npz")))
    columns = openpnm.io.network_from_csv(str(tmp_path / "net.csv"))
    for net in (arrays, columns):
        assert len(net["pore.coords"]) == len(ours) + len(ours.openings)
        alone = openpnm.utils.check_network_health(net)["disconnected_pores"]
        openpnm.topotools.trim(network=net, pores=alone)
        fluid = openpnm.phase.Phase(network=net)
        fluid["pore.viscosity"] = 1e-3
        fluid["throat.viscosity"] = 1e-3
        fluid.add_model(
            propname="throat.hydraulic_conductance",
            model=openpnm.models.physics.hydraulic_conductance.generic_hydraulic,
        )
        for axis, name in enumerate("zyx"):
            flow = openpnm.algorithms.StokesFlow(network=net, phase=fluid)
            flow.set_value_BC(pores=net.pores(f"{name}min"), values=1.0)
            flow.set_value_BC(pores=net.pores(f"{name}max"), values=0.0)
            flow.run()
            through = abs(float(flow.rate(pores=net.pores(f"{name}min"))[0]))
            own = ours.permeability(axis).value * 1e-12
            assert through * 1e-3 / (80 * 5e-6) == pytest.approx(own, rel=1e-6)
    rock = openpnm.io.network_from_statoil(str(tmp_path), "net")
    assert len(rock["pore.coords"]) == len(ours)
    assert len(rock["throat.conns"]) == len(ours.throats)
    assert rock["pore.volume"] == pytest.approx(ours.volume * 1e-18, rel=1e-5)
    assert rock["pore.inlets"].sum() == (ours.openings.face == 4).sum()
    assert rock["pore.outlets"].sum() == (ours.openings.face == 5).sum()


def test_bodies_have_skimages_moments():
    measure = pytest.importorskip("skimage.measure")
    ours = tb.measure.bodies(IMAGE)
    theirs = measure.regionprops(ours.regions)
    assert len(theirs) == len(ours)
    for k, one in enumerate(theirs):
        assert ours.volume[k] == one.area * 8
        assert ours.centroid[k] == pytest.approx(2 * np.array(one.centroid))
        if one.area > 20:  # they take voxels for points: a voxel's own moment is 1 / 12
            values = np.linalg.eigvalsh(one.inertia_tensor)
            spread = values.sum() / 2 - values + 1 / 12
            assert np.sort((ours.axes[k] / 2) ** 2 / 20) == pytest.approx(np.sort(spread))

"""An image goes as it is into the packages of the field; each test is skipped by name where its
package is not installed.
"""

import numpy as np
import pytest

import trabecula as tb

SCAN = tb.Image(
    np.random.default_rng(5).random((10, 12, 14)).astype(np.float32),
    "grey",
    spacing=(2.0, 1.0, 0.5),
    unit="um",
)
PORES = tb.Image(
    np.asarray(SCAN) < 0.6, "labels", spacing=SCAN.spacing, unit="um", phases=("solid", "pore")
)


def test_porespy():
    metrics = pytest.importorskip("porespy").metrics
    filters = pytest.importorskip("porespy").filters
    assert metrics.porosity(PORES) == pytest.approx(tb.measure.porosity(PORES, phase="pore"))
    assert np.array_equal(
        metrics.two_point_correlation(PORES).probability,
        metrics.two_point_correlation(PORES.values).probability,
    )
    for function in (
        filters.local_thickness,
        filters.porosimetry,
        filters.find_disconnected_voxels,
    ):
        assert np.array_equal(function(PORES == 1), function(PORES.values == 1))


def test_skimage():
    filters = pytest.importorskip("skimage.filters")
    measure = pytest.importorskip("skimage.measure")
    transform = pytest.importorskip("skimage.transform")
    assert filters.threshold_otsu(SCAN) == filters.threshold_otsu(SCAN.values)
    assert np.array_equal(filters.gaussian(SCAN, 1), filters.gaussian(SCAN.values, 1))
    assert np.array_equal(measure.label(PORES), measure.label(PORES.values))
    assert measure.euler_number(PORES, connectivity=3) == measure.euler_number(
        PORES.values, connectivity=3
    )
    vertices, *_ = measure.marching_cubes(np.asarray(SCAN), 0.5, spacing=SCAN.spacing)
    assert vertices.max(axis=0) == pytest.approx([18.0, 11.0, 6.5], abs=0.5)
    assert transform.rescale(SCAN[0], 0.5).shape == (6, 7)


def test_pyvista():
    pyvista = pytest.importorskip("pyvista")
    grid = pyvista.ImageData(
        dimensions=[side + 1 for side in SCAN.shape[::-1]], spacing=SCAN.spacing[::-1]
    )
    grid.cell_data["grey"] = np.asarray(SCAN).ravel()  # x is fastest in both
    assert grid.n_cells == SCAN.values.size and grid.bounds[1::2] == pytest.approx(
        (7.0, 12.0, 20.0)
    )
    again = np.asarray(grid.cell_data["grey"]).reshape(SCAN.shape)
    assert np.array_equal(again, SCAN)
    wrapped = pyvista.wrap(np.asarray(SCAN))
    assert wrapped.dimensions == SCAN.shape


def test_xarray():
    xarray = pytest.importorskip("xarray")
    places = {
        axis: np.arange(side) * edge
        for axis, side, edge in zip("zyx", SCAN.shape, SCAN.spacing, strict=True)
    }
    array = xarray.DataArray(SCAN, dims=("z", "y", "x"), coords=places)
    assert array.dtype == SCAN.dtype and array.shape == SCAN.shape
    assert np.array_equal(array.sel(x=3.0), SCAN[..., 6])
    assert array.mean().item() == pytest.approx(np.mean(SCAN))


def test_dask():
    dask = pytest.importorskip("dask.array")
    blocks = dask.from_array(SCAN, chunks=5)
    assert (
        blocks.shape == SCAN.shape and blocks.dtype == SCAN.dtype and blocks.numblocks == (2, 3, 3)
    )
    assert np.array_equal(blocks.compute(), SCAN.values)
    assert np.array_equal(blocks[3, ::2].compute(), SCAN[3, ::2].values)
    assert (dask.asarray(PORES) == 1).mean().compute() == pytest.approx(np.asarray(PORES).mean())


def test_matplotlib():
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    shown = pyplot.imshow(SCAN[3])
    assert np.array_equal(shown.get_array(), SCAN.values[3])
    counts, *_ = pyplot.hist(np.ravel(SCAN), bins=4)
    pyplot.close("all")
    assert counts.sum() == SCAN.values.size


def test_scipy():
    ndimage = pytest.importorskip("scipy.ndimage")
    assert np.array_equal(ndimage.median_filter(SCAN, 3), ndimage.median_filter(SCAN.values, 3))
    assert ndimage.label(PORES)[1] == ndimage.label(PORES.values)[1]
    distances = ndimage.distance_transform_edt(PORES, sampling=PORES.spacing)
    assert distances.max() > 0 and distances.shape == PORES.shape

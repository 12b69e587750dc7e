"""`tessellation`: closed cells of known sections, exact diagrams, and what is refused."""

from types import SimpleNamespace

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.errors import InputError, RequestError
from trabecula.measure.closed_cells import wall_phase
from trabecula.measure.labelling import label_components
from trabecula.measure.plane_cells import plane_cells
from trabecula.report.cell_sections import judge_cells
from trabecula.report.recommend import recommend
from trabecula.synth.tessellation.grains import grow_grains
from trabecula.synth.tessellation.laguerre import Diagram, PointGrid
from trabecula.synth.tessellation.sections import SectionFigures, Shape, draw_boundaries

FAST = {"volume_spread": 0.3, "lloyd_steps": 2, "rounding": 0.0}


@pytest.fixture(scope="module")
def picture():
    walls = tb.method("noise", kind="voronoi", thickness=1.6, length=9.0).fit()
    volume = walls.generate((8, 96, 96), seed=2)
    return tb.Image(volume.values[4], "labels", phases=("void", "solid"))


@pytest.fixture(scope="module")
def model(picture):
    return tb.method("tessellation", **FAST).fit(picture)


@pytest.fixture(scope="module")
def made(model):
    return model.generate((30, 33, 36), seed=3)


def _diagram():
    random = np.random.default_rng(0)
    sides = np.array([20.0, 33.0, 27.0])
    return Diagram(random.random((30, 3)) * sides, random.random(30) * 40 - 40, sides)


def test_cells_and_face_distances_are_those_of_a_search_of_all_seeds():
    diagram = _diagram()
    grid = diagram.points((11, 13, 12))
    owner = diagram.cells(grid)
    points = np.stack(np.meshgrid(*grid, indexing="ij"), -1).reshape(-1, 1, 3)
    apart = points - diagram.seeds
    apart -= diagram.sides * np.round(apart / diagram.sides)
    power = (apart**2).sum(-1) - diagram.weights
    own = power.argmin(1)
    assert (owner.ravel() == own).all()
    distance = diagram.face_distance(grid, owner, diagram.neighbours((60, 99, 81)), 0.0)
    here = apart[np.arange(len(own)), own]
    far = np.linalg.norm(apart - here[:, None], axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        faces = (power - power.min(1)[:, None]) / (2 * far)
    faces[np.arange(len(own)), own] = np.inf
    # a face smaller than the points of `neighbours` are apart may be missed, at a corner
    assert np.mean(np.abs(faces.min(1) - distance.ravel()) < 1e-4) > 0.995


def test_corners_are_rounded_by_the_radius():
    # four columns: their faces are the planes y = 0, 8 and x = 0, 8
    seeds = np.array([[2.0, y, x] for y in (4.0, 12.0) for x in (4.0, 12.0)])
    diagram = Diagram(seeds, np.zeros(4), np.array([4.0, 16.0, 16.0]))
    at = PointGrid(np.array([2.0]), np.array([7.0, 4.0]), np.array([7.0, 4.0]))
    touching = diagram.neighbours((8, 32, 32))
    sharp = diagram.face_distance(at, diagram.cells(at), touching, 0.0)[0]
    assert sharp.tolist() == [[1.0, 1.0], [1.0, 4.0]]
    rounded = diagram.face_distance(at, diagram.cells(at), touching, 3.0)[0]
    # two faces at 1: 3 - sqrt(2^2 + 2^2), and the diagonal neighbour's plane at sqrt(2)
    corner = 3 - np.sqrt(4 + 4 + (3 - np.sqrt(2)) ** 2)
    assert rounded[0, 0] == pytest.approx(corner)
    assert rounded[0, 1] == pytest.approx(1.0)
    assert rounded[1, 1] == pytest.approx(4.0)


@pytest.mark.whole
def test_grains_have_the_volumes_that_were_drawn():
    diagram, error = grow_grains(1, (40, 40, 40), 1 / 512, spread=0.6, lloyd_steps=2)
    volumes = np.sort(diagram.moments((80, 80, 80))[:, 0]) / 8
    assert error < 0.02
    assert len(volumes) == 125
    assert np.log(volumes).std() == pytest.approx(0.6 * 0.88, abs=0.04)  # without tails
    other, _ = grow_grains(2, (40, 40, 40), 1 / 512, spread=0.6, lloyd_steps=2)
    assert not np.array_equal(diagram.seeds, other.seeds)


@pytest.mark.whole
def test_moves_to_the_centroids_make_cells_rounder():
    def surface(steps):
        diagram, _ = grow_grains(1, (40, 40, 40), 1 / 512, spread=0.2, lloyd_steps=steps)
        owner = diagram.cells(diagram.points((40, 40, 40)))
        return sum(np.count_nonzero(owner != np.roll(owner, 1, axis)) for axis in range(3))

    assert surface(8) < 0.95 * surface(0)


@pytest.mark.whole
def test_boundaries_are_closed_and_have_the_pictures_fraction(model, made, picture):
    grains = model.grains((30, 33, 36), seed=3)
    interior = made.values == made.phases.index("void")
    for axis in range(3):
        first = tuple(slice(None, -1) if n == axis else slice(None) for n in range(3))
        second = tuple(slice(1, None) if n == axis else slice(None) for n in range(3))
        joined = interior[first] & interior[second]
        assert (grains[first] == grains[second])[joined].all()
    assert abs(interior.mean() - np.mean(picture.values == 0)) < 1e-4


def test_boundaries_thinner_than_a_voxel_are_closed_still():
    owner = np.zeros((6, 6, 6), np.int32)
    owner[:, 3:] = 1
    depth = np.abs(np.arange(6) - 2.6).astype(np.float32)[None, :, None] * np.ones((6, 6, 6))
    walls = draw_boundaries(owner, depth.astype(np.float32), 0.0)
    assert (walls.any(axis=1)).all()
    assert walls.sum() == 36


@pytest.mark.whole
def test_sections_are_like_the_picture(made, picture):
    own = plane_cells(picture)
    cuts = [np.take(made.values, at, axis) for axis in range(3) for at in (3, 15, 27)]
    found = [
        plane_cells(tb.Image(np.ascontiguousarray(cut), "labels", phases=made.phases))
        for cut in cuts
    ]
    assert np.mean([c.triple_points for c in found]) == pytest.approx(own.triple_points, rel=0.15)
    assert np.mean([c.boundary_length for c in found]) == pytest.approx(
        own.boundary_length, rel=0.08
    )
    assert np.mean([c.mean_neighbours for c in found]) == pytest.approx(6, abs=0.4)


@pytest.mark.whole
def test_cells_follow_their_lengths_in_pictures_of_two_planes(picture):
    wide = tb.Image(np.repeat(picture.values, 2, axis=1), "labels", phases=picture.phases)
    model = tb.method("tessellation", views=("yx", "zx"), **FAST).fit(wide)
    z, y, x = model.learned.stretch
    assert z == pytest.approx(y)
    assert x / y == pytest.approx(2, rel=0.15)
    values = model.generate(40, seed=1).values == 1
    crossings = [np.count_nonzero(np.diff(values, axis=axis)) for axis in range(3)]
    assert crossings[1] / crossings[2] == pytest.approx(2, rel=0.3)


@pytest.mark.whole
def test_phases_go_to_whole_cells_by_their_fractions(picture):
    labels = plane_cells(picture, boundary="solid").labels
    values = np.where(picture.values == 1, 1, np.where(labels % 4 == 0, 2, 0)).astype(np.uint8)
    mixed = tb.Image(values, "labels", phases=("void", "solid", "other"))
    model = tb.method("tessellation", boundary="solid", **FAST).fit(mixed)
    made = model.generate(36, seed=1)
    share = np.mean(made.values == 2) / np.mean(made.values != 1)
    assert share == pytest.approx(np.mean(values == 2) / np.mean(values != 1), abs=0.06)
    grains = model.grains(36, seed=1)
    inner = made.values != 1
    for grain in np.unique(grains)[:40]:
        assert len(np.unique(made.values[inner & (grains == grain)])) <= 1


def test_a_saved_model_gives_the_same_voxels(model, made, tmp_path):
    again = tb.load_model(model.save(tmp_path / "cells.tbm"))
    assert again.learned == model.learned
    assert np.array_equal(again.generate((30, 33, 36), seed=3).values, made.values)


@pytest.mark.whole
def test_the_certificate_judges_cells_of_slices(picture, made):
    metrics = tb.verify(picture, made, level="quick").metrics
    names = [name for name in metrics if name.startswith("cell_")]
    assert len(names) == 5
    assert all(metrics[name].passed for name in ("cell_triple_points", "cell_boundary_length"))
    coarse = tb.method("tessellation", **FAST).fit(
        tb.Image(
            np.kron(picture.values[:48, :48], np.ones((2, 2), np.uint8)),
            "labels",
            phases=picture.phases,
        )
    )
    wrong = tb.verify(picture, coarse.generate(32, seed=1), level="quick").metrics
    assert wrong["cell_boundary_length"].passed is False


@pytest.mark.whole
def test_islands_and_open_walls_are_no_cells_to_judge_by():
    sample = tb.sample("bone")
    plain = tb.Image(sample.values[40], "labels", sample.spacing[1:], sample.unit, sample.phases)
    assert judge_cells(SimpleNamespace(exemplar=plain), ("yx",), sample, None) == {}


def test_pictures_without_cells_are_refused():
    blank = np.zeros((64, 64), np.uint8)
    blank[20:24] = 1
    with pytest.raises(InputError, match=r"no cells found|larger than a third"):
        tb.method("tessellation", **FAST).fit(tb.Image(blank, "labels"))
    large = np.zeros((64, 64), np.uint8)
    large[::4] = large[:, ::4] = 1
    large[8:52, 8:52] = 0
    with pytest.raises(InputError, match="larger than a third"):
        tb.method("tessellation", boundary="solid", **FAST).fit(
            tb.Image(large, "labels", phases=("void", "solid"))
        )
    with pytest.raises(InputError, match="no phase of the exemplar"):
        tb.method("tessellation", boundary="glass").fit(tb.Image(large, "labels"))


def test_settings_are_checked_by_name(model):
    with pytest.raises(InputError, match="lloyd_steps"):
        tb.method("tessellation", lloyd_steps=-1)
    with pytest.raises(InputError, match="volume_spread"):
        tb.method("tessellation", volume_spread=2.0)
    with pytest.raises(RequestError, match="fixed"):
        model.generate(16, fixed=np.zeros((16, 16, 16), bool))


@pytest.fixture(scope="module")
def foam():
    """A closed-cell foam in space: walls of three voxels between the cells of random seeds."""
    diagram, _ = grow_grains(4, (56, 64, 72), 1 / 2000, spread=0.3, lloyd_steps=1)
    grid = PointGrid(*(np.arange(side) + 0.5 for side in (56, 64, 72)))
    owner = diagram.cells(grid)
    depth = diagram.face_distance(grid, owner, diagram.neighbours((28, 32, 36)), 0.0)
    walls = draw_boundaries(owner, depth, 0.3)
    return tb.Image(walls.astype(np.uint8), "labels", (2.0, 2.0, 2.0), "um", ("void", "solid"))


@pytest.fixture(scope="module")
def foam_model(foam):
    return tb.method("tessellation", volume_spread=0.3, lloyd_steps=1).fit(foam)


@pytest.mark.whole
def test_a_scan_gives_cells_of_its_sizes_with_closed_walls(foam, foam_model):
    made = foam_model.generate((60, 60, 60), seed=2)
    assert (made.spacing, made.unit) == (foam.spacing, "um")
    assert foam_model.learned.boundary == 1
    assert foam_model.learned.shape.rounding == 0
    assert foam_model.learned.shape.density == pytest.approx(1 / 2000, rel=0.15)
    assert np.mean(made.values) == pytest.approx(np.mean(foam.values), abs=1e-4)
    _, sizes = label_components(made.values == 0, connectivity=6)
    assert len(sizes) > 60
    assert sizes.max() < 0.06 * sizes.sum()
    figures = made.recipe.steps[-1]["report"]["figures"]
    assert figures["thickness"]["ratio"] == pytest.approx(1, abs=0.05)
    assert figures["surface"]["ratio"] == pytest.approx(1, abs=0.05)


def test_a_scan_stands_alone_and_has_no_planes(foam):
    with pytest.raises(InputError, match="one volume, or from pictures"):
        tb.method("tessellation").fit([foam, foam])
    with pytest.raises(InputError, match="planes of pictures"):
        tb.method("tessellation", views=("yx", "zx")).fit(foam)


@pytest.mark.whole
def test_a_saved_model_of_a_scan_gives_the_same_voxels(foam_model, tmp_path):
    again = tb.load_model(foam_model.save(tmp_path / "foam.tbm"))
    made = [one.generate((20, 24, 28), seed=5).values for one in (foam_model, again)]
    assert np.array_equal(*made)


@pytest.mark.whole
def test_cells_of_a_stretched_scan_are_stretched(foam):
    wide = tb.Image(np.repeat(foam.values, 2, axis=2), "labels", phases=foam.phases)
    z, y, x = tb.method("tessellation", **FAST).fit(wide).learned.stretch
    assert x / z == pytest.approx(2, rel=0.1)
    assert y / z == pytest.approx(1, rel=0.1)


@pytest.mark.whole
def test_walls_are_as_thick_as_a_target_says(foam_model):
    made = foam_model.generate((40, 40, 60), seed=1, target={"porosity": 0.55})
    assert np.mean(made.values == 0) == pytest.approx(0.55, abs=1e-4)
    ramp = np.broadcast_to(np.linspace(0.5, 0.8, 60, dtype=np.float32), (40, 40, 60))
    made = foam_model.generate((40, 40, 60), seed=1, target={"porosity": ramp})
    assert np.mean(made.values == 0) == pytest.approx(ramp.mean(), abs=1e-3)
    thirds = (made.values == 0).reshape(40, 40, 3, 20).mean(axis=(0, 1, 3))
    assert thirds == pytest.approx(ramp[0, 0].reshape(3, 20).mean(axis=1), abs=0.02)
    mask = np.zeros((40, 40, 60), bool)
    mask[:20] = True
    made = foam_model.generate((40, 40, 60), seed=1, target={"porosity": ramp}, mask=mask)
    assert np.mean(made.values[mask] == 0) == pytest.approx(ramp[mask].mean(), abs=1e-3)


@pytest.mark.whole
def test_a_target_of_walls_that_are_void(foam):
    swapped = tb.Image(1 - foam.values, "labels", phases=("void", "solid"))
    model = tb.method("tessellation", **FAST).fit(swapped)
    made = model.generate(40, seed=1, target={"porosity": 0.35})
    assert np.mean(made.values == 0) == pytest.approx(0.35, abs=1e-4)
    least, most = model.porosities()
    assert 0.05 < least < 0.2
    assert most == 1


def test_walls_thinner_than_a_voxel_are_refused(foam_model):
    least, most = foam_model.porosities()
    assert least == 0
    assert 0.8 < most < 0.95
    made = foam_model.generate((40, 40, 40), seed=1, target={"porosity": most - 0.01})
    assert np.mean(made.values == 0) == pytest.approx(most - 0.01, abs=0.01)
    _, sizes = label_components(made.values == 0, connectivity=6)
    assert sizes.max() < 0.15 * sizes.sum()
    with pytest.raises(RequestError, match="thinner than a voxel"):
        foam_model.generate((40, 40, 40), seed=1, target={"porosity": most + 0.01})


@pytest.mark.whole
def test_a_target_is_refused_where_cells_are_of_several_phases(foam):
    labels, _ = label_components(foam.values == 0, connectivity=6)
    three = np.where(foam.values == 1, 1, np.where(labels % 3 == 0, 2, 0)).astype(np.uint8)
    image = tb.Image(three, "labels", phases=("void", "solid", "other"))
    model = tb.method("tessellation", **FAST).fit(image)
    assert model.learned.interiors == (0, 2)
    made = model.generate(56, seed=1)
    share = np.mean(made.values == 2) / np.mean(made.values != 1)
    assert share == pytest.approx(np.mean(three == 2) / np.mean(three != 1), abs=0.1)
    with pytest.raises(RequestError, match="leave the target out"):
        model.generate(16, target={"porosity": 0.5})


@pytest.mark.parametrize("swap", [False, True])
def test_closed_cells_are_known_by_their_even_walls(foam, swap):
    values = 1 - foam.values if swap else foam.values
    phases = ("void", "solid")
    image = tb.Image(values, "labels", phases=phases)
    assert wall_phase(image) == int(not swap)
    found = recommend(image)
    assert found.method == "tessellation"
    assert f"{phases[int(not swap)]} is walls" in found.reason
    assert recommend(image, graded=["porosity"]).method == "tessellation"
    assert recommend(image, graded=["orientation"]).method == "quilt"


@pytest.mark.whole
def test_matrices_between_balls_and_open_cells_are_no_walls():
    at = np.stack(np.indices((64,) * 3), -1) % 16 - 7.5
    balls = np.linalg.norm(at, axis=-1) < 7.4
    for image in (
        tb.Image((~balls).astype(np.uint8), "labels", phases=("void", "solid")),
        tb.sample("foam"),
        tb.sample("bone"),
    ):
        assert wall_phase(image) is None


@pytest.mark.whole
def test_sections_tell_sizes_apart():
    from trabecula.synth.tessellation.sections import _Trial

    picture = SectionFigures(0.004, np.ones(9), 1.5, 1.3, 0.3, 1.3)
    trial = _Trial(picture, 80.0, 0.75, 0.0003)
    even, varied = (trial.figures(Shape(0.0003, spread, 1, 0.0, 0.3, 0.0)) for spread in (0.0, 1.0))
    assert varied.sizes[-1] - varied.sizes[0] > 1.2 * (even.sizes[-1] - even.sizes[0])
    assert even.difference(even) == 0
    assert even.difference(varied) > 0.03

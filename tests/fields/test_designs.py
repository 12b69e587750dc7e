"""Parts under loads: places, load cases, solid regions, keep-outs, and where stress goes."""

import json

import numpy as np
import pytest

import trabecula as tb
from commands import refused, trabecula
from trabecula import fields
from trabecula.errors import InputError
from trabecula.fields.topology.cases import case, to_json
from trabecula.fields.topology.displacements import solve_displacements
from trabecula.fields.topology.elements import ElementGrid, _rigid_rows
from trabecula.fields.topology.places import EVERYWHERE, PartNodes, Place
from trabecula.mesh.base import Mesh
from trabecula.mesh.files import write_mesh
from trabecula.mesh.voxels import mark_surface
from trabecula.pipeline.designs import load_part

ALL = [[0, 1], [0, 1], [0, 1]]
FLOOR = {"box": [[0, 0], [0, 1], [0, 1]]}
PRESS = {"box": [[1, 1], [0, 1], [0, 1]], "force": [-1, 0, 0]}
BLOCK = {"shape": [8, 8, 8], "supports": [FLOOR], "loads": [PRESS], "volume": 0.4, "low": 0.1}


@pytest.fixture(scope="module")
def ball():
    line = np.arange(24) - 11.5
    return np.hypot.outer(line, np.hypot.outer(line, line)) < 11


def test_a_normal_picks_the_cap_that_faces_it(ball):
    part = PartNodes(ball)
    for way in ((1, 0, 0), (0, -1, 0), (0, 2, 2)):
        picked = np.argwhere(part.pick(EVERYWHERE, Place(normal=way, within=40.0))) - 12.0
        unit = np.array(way) / np.linalg.norm(way)
        angles = np.degrees(np.arccos(picked @ unit / np.linalg.norm(picked, axis=1)))
        assert angles.max() < 46, "a little more, since the surface has steps"
        share = len(picked) / np.count_nonzero(part.pick(EVERYWHERE, Place(normal=way, within=180)))
        assert share == pytest.approx((1 - np.cos(np.radians(40))) / 2, abs=0.02)


def test_a_plane_picks_the_nodes_on_it(ball):
    part = PartNodes(ball)
    flat = part.pick(EVERYWHERE, Place(through=(0.5, 0, 0), across=(1, 0, 0)))
    assert set(np.nonzero(flat)[0]) == {12} and flat[12].sum() == part.present[12].sum()
    tilted = np.argwhere(part.pick(EVERYWHERE, Place(through=(0.5,) * 3, across=(1, 1, 0)))) - 12
    assert np.abs(tilted[:, 0] + tilted[:, 1]).max() <= 1 and len(tilted) > 300


def test_a_painted_mesh_picks_what_it_lies_on(tmp_path):
    whole = np.ones((6, 7, 8), np.uint8)
    surface = tb.mesh(np.pad(whole, 1), smooth=0)
    top = surface.faces[(surface.vertices[surface.faces][:, :, 2] > 6.99).all(axis=1)]
    painted = Mesh(surface.vertices, top)
    marked = mark_surface(painted, spacing=1.0, shape=(6, 7, 8), origin=(1, 1, 1))
    assert np.array_equal(marked, np.arange(6)[:, None, None] + np.zeros((6, 7, 8)) == 5)
    with pytest.raises(InputError, match="outside of the part"):
        mark_surface(painted, spacing=1.0, shape=(6, 7, 8), origin=(40, 1, 1))
    part = PartNodes(whole > 0, {"top.stl": marked})
    picked = part.pick(EVERYWHERE, Place(mesh="top.stl"))
    assert set(np.nonzero(picked)[0]) == {5, 6}, "both layers of nodes of the elements"
    with pytest.raises(InputError, match=r"names the mesh 'low.stl', which was not given"):
        part.pick(EVERYWHERE, Place(mesh="low.stl"))


def test_cases_with_places_are_read_back():
    plain = {
        **BLOCK,
        "supports": [{"normal": [-1, 0, 0], "within": 20}],
        "load_cases": [
            {"loads": [{"plane": {"through": [1, 0, 0], "normal": [1, 0, 0]}, "force": [0, 1, 0]}]},
            {"loads": [{"mesh": "grip.stl", "force": [0, 0, 1]}], "weight": 2},
        ],
        "solid": [{"normal": [1, 0, 0], "depth": 2}],
        "keep_out": [{"box": [[0.5, 1], [0, 0.2], [0, 1]]}],
    }
    found = case(plain)
    assert case(to_json(found)) == found
    assert [one.weight for one in found.alone] == [1.0, 1.0, 2.0]
    assert found.supports[0].place.within == 20 and found.solid[0].depth == 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"supports": [{"normal": [0, 0, 0]}]}, "a normal is not 0 0 0"),
        ({"supports": [{"normal": [1, 0, 0], "within": 0}]}, "angle above 0"),
        ({"loads": [{"plane": {"through": [0, 0, 0]}, "force": [1, 0, 0]}]}, "cannot be read"),
        ({"load_cases": [{"loads": [PRESS], "weight": 0}]}, "a weight is above 0"),
        ({"solid": [{"normal": [1, 0, 0], "depth": 0}]}, "depth of a region is at least 1"),
        ({"keep_out": [{"box": ALL}]}, "keeps out the whole part"),
        ({"solid": [{"box": [[0, 0.6], [0, 1], [0, 1]]}]}, "solid regions take 0.625 of the part"),
        ({"loads": [{"mesh": "x.stl", "force": [1, 0, 0]}]}, "names the mesh"),
        ({"supports": [{"normal": [1, 0, 0], "within": 5, "box": FLOOR["box"]}]}, "holds no elem"),
    ],
)
def test_places_that_cannot_be_are_refused(change, words):
    with pytest.raises(InputError, match=words):
        fields.simp({**BLOCK, **change})


def test_solid_regions_are_dense_and_keep_outs_are_left_out():
    given = {
        **BLOCK,
        "solid": [{"normal": [1, 0, 0], "within": 60}],
        "keep_out": [{"box": [[0.25, 0.75], [0, 0.5], [0, 1]]}],
    }
    values = fields.simp(given, rounds=6).values
    out = np.zeros((8, 8, 8), bool)
    out[2:6, :4] = True
    assert np.all(values[7] == np.float32(0.85)) and np.all(values[out] == np.float32(0.1))
    assert values[~out].mean() == pytest.approx(0.4, abs=1e-4)


@pytest.mark.whole
def test_load_cases_act_one_by_one():
    """Two loads that would cancel each other ask for what either asks for."""
    pull = {"box": [[1, 1], [0, 1], [0, 1]], "force": [0, 1, 0]}
    push = {**pull, "force": [0, -1, 0]}
    alone = fields.simp({**BLOCK, "loads": [pull]}, rounds=5)
    rest = {key: value for key, value in BLOCK.items() if key != "loads"}
    both = fields.simp({**rest, "load_cases": [{"loads": [pull]}, {"loads": [push]}]}, rounds=5)
    assert np.allclose(both.values, alone.values, atol=1e-3)
    first, second = (one.recipe.steps[-1]["report"]["compliance"] for one in (alone, both))
    assert np.allclose(second, 2 * np.array(first), rtol=1e-3)
    with pytest.raises(InputError, match="pushes nothing"):
        fields.simp({**BLOCK, "loads": [pull, push]})


def test_a_form_takes_few_steps():
    """Nodes outside of the part are not held on coarser grids: else an arch takes 115 steps."""
    z, x = np.ogrid[:24, :48]
    radius = np.hypot(z + 0.5, x - 23.5)
    arch = np.repeat(((radius < 23) & (radius > 15))[:, None], 9, axis=1)
    foot = {"box": [[0, 0], [0, 1], [0, 0.5]]}
    other = {"box": [[0, 0], [0, 1], [0.5, 1]], "force": [0, 0, 1]}
    given = case({"shape": arch.shape, "supports": [foot], "loads": [other]})
    grid = ElementGrid.of(given, arch, edges=(1.0,) * 3, poisson=0.3)
    density = np.where(arch, 0.5, 0.0)
    solve_displacements(grid, density, np.zeros_like(grid.load), tolerance=1e-4, most=30)


def test_a_finished_part_is_computed_back(tmp_path):
    """Struts carry what their section lets them; what hangs loose does not count."""
    part = np.zeros((8, 8, 8), np.uint8)
    part[:, 1:3, 1:3] = part[:, 5:7, 5:7] = 1
    part[4, 1, 4] = 1
    column = {"shape": [8, 8, 8], "supports": [FLOOR], "loads": [PRESS]}
    field = fields.part_stress(part, column, poisson=0.0)
    report = field.recipe.steps[-1]["report"]
    assert report["loose"] == pytest.approx(1 / part.sum())
    assert field.values[4, 1, 4] == 0 and field.values[part == 0].max() == 0
    # the force of 1 over eight voxels' faces, even at the middle of a column
    assert field.values[4][part[4] * field.values[4] > 0] == pytest.approx(1 / 8, rel=0.03)
    # columns of an eighth of the section: about eight times as compliant as solid throughout
    assert report["compliance"][0] / report["solid_compliance"][0] == pytest.approx(8, rel=0.15)
    assert 0 < len(report["weakest"]) <= 10 and report["99 %"] <= report["largest"]
    thin = part.copy()
    thin[4, 5:7, 6] = 0  # a notch
    notched = fields.part_stress(thin, column, poisson=0.0).recipe.steps[-1]["report"]
    assert notched["weakest"][0][0] in (3, 4, 5) and notched["largest"] > 1.5 * report["99 %"]
    image = tb.Image(part, "labels", phases=("void", "solid"))
    tb.write(image, tmp_path / "part.tif")
    (tmp_path / "case.json").write_text(json.dumps(column))
    done = trabecula(
        "field", "stress", tmp_path / "part.tif", tmp_path / "case.json", "--out",
        tmp_path / "stress.tif",
    )  # fmt: skip
    assert "times as compliant as solid throughout" in done.err
    assert "held by nothing" in done.err
    made = tb.read(tmp_path / "stress.tif")
    assert np.array_equal(tb.rerun(tmp_path / "stress.tif").values, made.values)


def test_a_part_that_its_case_does_not_meet_is_refused():
    part = np.zeros((8, 8, 8), np.uint8)
    part[:3] = 1
    column = {"shape": [8, 8, 8], "supports": [FLOOR], "loads": [PRESS]}
    with pytest.raises(InputError, match="meets no solid that is held"):
        fields.part_stress(part, column)
    with pytest.raises(InputError, match="meet no solid"):
        fields.part_stress(part[::-1], column)
    with pytest.raises(InputError, match="2-D"):
        fields.part_stress(part[0], column)


@pytest.mark.whole
def test_normals_of_a_finished_part_are_its_forms(ball):
    """A ball full of holes is held where the ball's surface faces down, not at its holes."""
    holes = ball.copy()
    holes[2:-2:4, 2:-2:4, 2:-2:4] = False
    given = {"shape": [24] * 3, "supports": [{"normal": [-1, 0, 0]}],
             "loads": [{"normal": [1, 0, 0], "force": [-1, 0, 0]}]}  # fmt: skip
    meant = PartNodes(holes, form=ball).pick(EVERYWHERE, Place(normal=(-1, 0, 0)))
    assert np.nonzero(meant)[0].max() < 6
    field = fields.part_stress(holes.astype(np.uint8), given, mask=ball)
    assert field.values[holes].min() > 0
    part = PartNodes(holes, form=ball)
    grid = ElementGrid.of(case(given), part, edges=(1.0,) * 3, poisson=0.3)
    density, start = holes.astype(float), np.zeros_like(grid.load)
    u = solve_displacements(grid, density, start, tolerance=1e-4, most=100)
    wanted = float((density * grid.energy(u)).sum())
    report = field.recipe.steps[-1]["report"]
    assert report["compliance"] == pytest.approx([wanted], rel=1e-3)


@pytest.mark.whole
def test_many_elements_start_from_half_as_many(monkeypatch):
    usual = fields.simp("cantilever", (16, 8, 30))
    monkeypatch.setattr("trabecula.fields.topology.optimise._MANY", 1000)
    quick = fields.simp("cantilever", (16, 8, 30))
    first, second = (one.recipe.steps[-1]["report"]["compliance"] for one in (usual, quick))
    assert len(second) < len(first)
    assert second[-1] == pytest.approx(first[-1], rel=2e-3)
    assert np.abs(usual.values - quick.values).mean() < 0.01


def test_stress_follows_a_beam():
    """Bending: the flanges are pulled and pressed along the beam, the one as the other."""
    beam = {
        "shape": [8, 4, 32],
        "supports": [{"box": [[0, 1], [0, 1], [0, 0]]}],
        "loads": [{"box": [[0, 1], [0, 1], [1, 1]], "force": [-1, 0, 0]}],
    }
    found = fields.principal_stress(np.full((8, 4, 32), 1.0), beam)
    middle = slice(6, 26)
    assert np.abs(found.direction[[0, -1], :, middle, 2]).min() > 0.98
    assert found.stress[-1, :, middle].min() > 0 > found.stress[0, :, middle].max()
    assert np.allclose(found.stress[0], -found.stress[-1], rtol=0.02, atol=0.02)
    # bending moment over section modulus, at the middle of the outer layer
    moment, inertia = 32 - (np.arange(32) + 0.5), 4 * 8**3 / 12
    assert np.allclose(
        found.stress[-1].mean(axis=0)[middle], (3.5 * moment / inertia)[middle], rtol=0.03
    )
    assert np.allclose(np.linalg.norm(found.direction, axis=-1), 1, atol=1e-5)
    assert found.compliance[0] > 0


@pytest.mark.whole
def test_a_part_of_the_users_own(tmp_path, ball):
    tb.export(tb.Image(np.pad(ball, 1).astype(np.uint8), "labels"), tmp_path / "ball.stl")
    given = {**BLOCK, "supports": [{"normal": [-1, 0, 0]}], "volume": 0.3,
             "loads": [{"normal": [1, 0, 0], "force": [-1, 0, 0]}]}  # fmt: skip
    (tmp_path / "case.json").write_text(json.dumps(given))
    out, ways = tmp_path / "density.tif", tmp_path / "ways.npy"
    words = ["field", "simp", tmp_path / "case.json", "--mask", tmp_path / "ball.stl"]
    trabecula(*words, "--elements", 10, "--out", out, "--directions", ways)
    density, directions = tb.read(out), np.load(ways)
    assert density.shape == (10, 10, 10) and directions.shape == (10, 10, 10, 3)
    inside = np.linalg.norm(directions, axis=-1) > 0.5
    assert 0.45 < inside.mean() < 0.6, "a ball in its box: pi / 6"
    assert density.values[inside].mean() == pytest.approx(0.3, abs=2e-3)
    assert np.abs(directions[3:7, 4:6, 4:6, 0]).min() > 0.95, "pressed from top to bottom"
    assert np.array_equal(tb.rerun(out).values, density.values)
    assert "one number" in refused(*words, "--elements", 12, 12, 12, "--out", out)
    assert "says how large" in refused(*words, "--spacing", 2, "--out", out)
    assert "written as .npy" in refused(*words, "--out", out, "--directions", "x.tif")


def test_painted_meshes_of_a_case_lie_beside_it(tmp_path, ball):
    surface = tb.mesh(np.pad(ball, 1).astype(np.uint8))
    tb.export(tb.Image(np.pad(ball, 1).astype(np.uint8), "labels"), tmp_path / "ball.stl")
    high = surface.vertices[:, 2] > surface.vertices[:, 2].max() - 3
    painted = Mesh(surface.vertices, surface.faces[high[surface.faces].all(axis=1)])
    write_mesh(painted, tmp_path / "top.stl")
    given = case({**BLOCK, "supports": [{"normal": [-1, 0, 0]}],
                  "loads": [{"mesh": "top.stl", "force": [-1, 0, 0]}]})  # fmt: skip
    part = load_part(tmp_path / "ball.stl", given, elements=12, folders=[tmp_path])
    marked = part.marks["top.stl"]
    assert marked.any() and np.nonzero(marked)[0].min() >= 9
    field = fields.simp(given, part.image.shape, mask=part.image, marks=part.marks, rounds=2)
    assert "marks" in field.recipe.steps[-1]["settings"]
    with pytest.raises(InputError, match="is a volume, whose voxels are the elements"):
        tb.write(part.image, tmp_path / "part.tif")
        load_part(tmp_path / "part.tif", given, folders=[tmp_path])


@pytest.mark.parametrize(
    ("supports", "how"),
    [
        ([{"box": [(0, 0), (0, 1), (0, 0)]}], "turning about y"),
        ([{"box": [(0, 1), (0, 1), (0, 0)], "axes": "yx"}], "moving along z"),
    ],
)
def test_a_case_that_does_not_hold_the_part_says_how_it_moves(supports, how):
    loads = [{"box": [(0, 1), (0, 1), (1, 1)], "force": (-1, 0, 0)}]
    with pytest.raises(InputError, match=f"does not hold the part: .* {how}"):
        fields.simp({"shape": (3, 3, 6), "supports": supports, "loads": loads})


def test_loads_along_what_is_held_need_no_more_supports():
    supports = [{"box": [(0, 0), (0, 1), (0, 1)], "axes": "z"}]
    loads = [{"box": [(1, 1), (0, 1), (0, 1)], "force": (-1, 0, 0)}]
    found = fields.simp({"shape": (3, 3, 3), "supports": supports, "loads": loads})
    assert found.shape == (3, 3, 3)


def test_rigid_rotations_move_no_place_nearer():
    places = np.random.default_rng(0).normal(size=(20, 3))
    motions = np.stack([_rigid_rows(places, axis) for axis in range(3)], axis=1)
    np.testing.assert_allclose(np.einsum("na,nam->nm", places, motions[..., 3:]), 0, atol=1e-12)

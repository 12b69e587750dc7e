"""Topology optimisation: mechanics against an assemble matrix, optimality against its
conditions.
"""

import json
import tracemalloc

import numpy as np
import pytest
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from trabecula import fields, progress
from trabecula.engine import parallel
from trabecula.errors import FileError, InputError, MemoryBudgetError, UnknownNameError
from trabecula.fields.topology.cases import CASES, Case, Load, Support, case, to_json
from trabecula.fields.topology.displacements import DensitySystem, solve_displacements
from trabecula.fields.topology.elements import ElementGrid
from trabecula.fields.topology.optimise import ELEMENT_BYTES, DensityFilter
from trabecula.fields.topology.places import nodes_of
from trabecula.measure.mechanics.elements import CORNERS

END = ((0.0, 1.0), (0.0, 1.0), (0.0, 0.0))
OTHER = ((0.0, 1.0), (0.0, 1.0), (1.0, 1.0))


def report(field):
    return field.recipe.steps[-1]["report"]["compliance"]


def assemble(grid, density):
    """Assemble the matrix, row and column 3 node + component."""
    number = np.arange(grid.free[..., 0].size).reshape(grid.free.shape[:3])
    rows, columns, entries = [], [], []
    for at in np.argwhere(grid.inside):
        nodes = np.array([number[tuple(at + corner)] for corner in CORNERS])
        index = (3 * nodes[:, None] + np.arange(3)).ravel()
        rows.append(np.repeat(index, 24))
        columns.append(np.tile(index, 24))
        entries.append((density[tuple(at)] * grid.stiffness).ravel())
    size = 3 * number.size
    return coo_matrix(
        (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))), (size, size)
    ).tocsr()


def test_displacements_are_those_of_the_assembled_matrix():
    inside = np.ones((3, 4, 5), bool)
    inside[2, :, 3:] = False
    density = np.where(inside, np.random.default_rng(0).uniform(0.3, 0.85, inside.shape), 0)
    grid = ElementGrid.of(CASES["cantilever"], inside, edges=(1, 1.5, 0.8), poisson=0.3)
    u = solve_displacements(grid, density, np.zeros_like(grid.load), tolerance=1e-9, most=5000)
    free = grid.free.ravel()
    matrix = assemble(grid, density)
    expected = np.zeros(free.size)
    expected[free] = spsolve(matrix[free][:, free].tocsc(), grid.load.ravel()[free])
    assert np.allclose(u.ravel(), expected, atol=1e-6 * np.abs(expected).max())
    assert (density * grid.energy(u)).sum() == pytest.approx(
        float(grid.load.ravel() @ expected), rel=1e-6
    )


def test_a_bar_that_is_pulled_stretches_as_hooke_says():
    pulled = Case("bar", "", (3, 3, 12), (Support(END),), (Load(OTHER, (0.0, 0.0, 1.0)),))
    grid = ElementGrid.of(pulled, np.ones((3, 3, 12), bool), edges=(1.0, 1.0, 1.0), poisson=0.0)
    nodes = np.ones((4, 4))
    nodes[[0, -1]] /= 2
    nodes[:, [0, -1]] /= 2
    grid.load[:, :, -1, 2] = nodes / 9  # an even traction: half at the rim, a quarter at a corner
    u = solve_displacements(
        grid, np.full((3, 3, 12), 0.5), np.zeros_like(grid.load), tolerance=1e-10, most=1000
    )
    assert np.allclose(u[:, :, :, 2], np.arange(13) / (9 * 0.5), atol=1e-6)


@pytest.mark.whole
def test_the_cantilever_keeps_bounds_and_volume_and_is_stiffer():
    field = fields.simp("cantilever")
    values = field.values
    assert values.shape == (16, 8, 30)
    assert (
        values.min() >= 0.3 - 1e-6
        and values.max() <= 0.85 + 1e-6
        and values.mean() == pytest.approx(0.5, abs=1e-4)
    )
    compliance = report(field)
    assert compliance[-1] < 0.7 * compliance[0]
    assert np.allclose(values, values[:, ::-1], atol=0.01), "the load is symmetric across y"
    assert values[0, :, :5].mean() > 0.8 > 0.5 > values[6:10, :, 15:25].mean(), (
        "flanges are dense, the core is open"
    )


@pytest.mark.whole
def test_no_other_density_of_that_volume_is_stiffer():
    """Check that what is between the bounds gains alike everywhere: penalty 1 without a filter is
    convex.
    """
    field = fields.simp("cantilever", (6, 3, 10), radius=0, tolerance=1e-7, rounds=400)
    density = field.values.astype(float)
    grid = ElementGrid.of(
        CASES["cantilever"], np.ones(density.shape, bool), edges=(1.0,) * 3, poisson=0.3
    )
    u = solve_displacements(grid, density, np.zeros_like(grid.load), tolerance=1e-8, most=5000)
    gain = grid.energy(u)
    between = (density > 0.32) & (density < 0.83)
    price = np.median(gain[between])
    assert np.all(np.abs(gain[between] / price - 1) < 0.05)
    assert np.all(gain[density > 0.8499] > 0.95 * price) and np.all(
        gain[density < 0.3001] < 1.05 * price
    )


@pytest.mark.slow
def test_penalty_drives_densities_to_the_bounds():
    soft, hard = (
        fields.simp("cantilever", (8, 4, 15), low=0.01, high=1, penalty=p, rounds=60).values
        for p in (1, 3)
    )
    middling = [np.mean((values > 0.2) & (values < 0.8)) for values in (soft, hard)]
    assert middling[1] < 0.75 * middling[0]


def test_slopes_go_back_through_the_filter():
    inside = np.random.default_rng(1).random((5, 6, 4)) < 0.8
    smooth = DensityFilter(inside, 2.5)
    a, b = (np.where(inside, np.random.default_rng(k).random(inside.shape), 0) for k in (2, 3))
    assert (smooth(a) * b).sum() == pytest.approx((a * smooth.back(b)).sum())
    assert np.allclose(smooth(inside.astype(float)), inside)


def test_a_wheel_is_symmetric_and_dense_at_its_feet():
    values = fields.simp("wheel", (8, 12, 12)).values
    assert np.allclose(values, values.transpose(0, 2, 1), atol=0.02) and np.allclose(
        values, values[:, ::-1], atol=0.02
    )
    assert values[0, 0, 0] > 0.8 and values[0, 6, 6] > 0.8 and values[-1, 0, 0] < 0.35


@pytest.mark.whole
def test_a_mask_is_left_alone_and_the_rest_carries():
    mask = np.ones((8, 4, 15), bool)
    mask[3:5, :, 5:10] = False
    values = fields.simp("cantilever", (8, 4, 15), mask=mask).values
    assert np.all(values[~mask] == np.float32(0.3)) and values[mask].mean() == pytest.approx(
        0.5, abs=1e-4
    )


@pytest.mark.whole
def test_threads_change_no_bit(monkeypatch):
    whole = fields.simp("cantilever", (9, 3, 8), rounds=4).values

    def scatter(work, length, count, least):
        for a in reversed(range(length)):
            work(a, a + 1)

    monkeypatch.setattr(parallel, "_run", scatter)
    assert np.array_equal(fields.simp("cantilever", (9, 3, 8), rounds=4).values, whole)


def test_cases_are_data(tmp_path):
    path = tmp_path / "beam.json"
    path.write_text(json.dumps(to_json(CASES["wheel"])))
    assert case(path) == case(to_json(CASES["wheel"])) == CASES["wheel"]
    assert nodes_of(((0, 0), (0.5, 0.5), (0, 1)), (2, 3, 4)).sum() == 5, (
        "the nearest node where none lies in the box"
    )


@pytest.mark.parametrize(
    ("given_", "words"),
    [
        ({"of": "cantilver"}, "did you mean 'cantilever'"),
        ({"of": "missing.json"}, "there is no file missing.json"),
        ({"of": {"shape": (2, 2, 2)}}, "needs shape, supports and loads"),
        ({"of": {"shape": (2, 2, 2), "supports": [{}], "loads": []}}, "a support has box and axes"),
        (
            {
                "of": {
                    "shape": (2, 2, 2),
                    "supports": [],
                    "loads": [{"box": OTHER, "force": (1, 0, 0)}],
                }
            },
            "holds no element",
        ),
        ({"of": {"shape": (2, 2, 2), "supports": [{"box": END}], "loads": []}}, "pushes nothing"),
        ({"of": "cantilever", "volume": 0.2}, "outside the bounds"),
        ({"of": "cantilever", "penalty": 0.5}, "penalty=0.5 is outside"),
        ({"of": "cantilever", "mask": np.ones((2, 2, 2), bool)}, "boolean array of shape"),
        ({"of": "cantilever", "memory": 1000}, "fewer elements"),
    ],
)
def test_what_cannot_be_optimised_is_refused(given_, words):
    with pytest.raises((InputError, UnknownNameError, FileError, MemoryBudgetError), match=words):
        fields.simp(**given_)


def test_a_part_that_is_hinged_finds_no_balance():
    hinge = Case(
        "hinge",
        "",
        (2, 2, 4),
        (Support(((0.0, 0.0), (0.0, 1.0), (0.0, 0.0))),),
        (Load(OTHER, (-1.0, 0.0, 0.0)),),
    )
    with pytest.raises(InputError, match="turning about y"):
        fields.simp(hinge, rounds=1)


@pytest.mark.parametrize("shape", [(16, 8, 30), (9, 5, 11)])
def test_few_steps_are_enough_and_the_preconditioner_is_symmetric(shape):
    grid = ElementGrid.of(CASES["cantilever"], np.ones(shape, bool), edges=(1.0,) * 3, poisson=0.3)
    rng = np.random.default_rng(0)
    density = rng.uniform(0.3, 0.85, shape)
    solve_displacements(
        grid, density, np.zeros_like(grid.load), tolerance=1e-4, most=20
    )  # else it raises
    precondition = DensitySystem(grid, density).precondition
    a, b = (np.where(grid.free, rng.standard_normal(grid.load.shape), 0) for _ in range(2))
    ab, ba = ((precondition(one) * other).sum() for one, other in ((a, b), (b, a)))
    assert ab == pytest.approx(ba, rel=1e-9) and (precondition(a) * a).sum() > 0


@pytest.mark.whole
def test_memory_stays_below_what_is_checked():
    shape = (16, 12, 30)
    fields.simp("cantilever", (4, 2, 6), rounds=2)
    tracemalloc.start()
    fields.simp("cantilever", shape, rounds=3)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < ELEMENT_BYTES * np.prod(shape) * 1.1


def test_a_load_is_shared_by_the_nodes_that_it_meets():
    inside = np.ones((3, 4, 5), bool)
    grid = ElementGrid.of(case("cantilever"), inside, edges=(1.0,) * 3, poisson=0.3)
    wanted = np.sum([push.force for push in case("cantilever").loads], axis=0)
    assert grid.load.sum(axis=(0, 1, 2)) == pytest.approx(wanted)


@pytest.mark.whole
def test_progress_rises_once_over_all_grids(monkeypatch):
    """The rounds of a grid end when the compliance hardly changes: a share of the most that are
    allowed said hours where minutes were left.
    """
    monkeypatch.setattr("trabecula.fields.topology.optimise._MANY", 500)
    seen = []
    with progress(lambda label, done: seen.append((label, done.run.reached))):
        fields.simp("cantilever", (16, 8, 30))
    reached = [done for _, done in seen]
    assert reached == sorted(reached) and reached[0] == 0 and reached[-1] == 1
    fine = [done for label, done in seen if label == "optimising 16 x 8 x 30 elements"]
    assert fine[0] == pytest.approx(0.125) and len(fine) > 2
    assert any(0.2 < done < 1 for done in fine)
    assert any(label == "optimising 8 x 4 x 15 elements" for label, _ in seen)

"""Bricks for solvers: counts, places, sets, load cases, and a solve by other code."""

import re
from itertools import product

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import splu

import trabecula as tb
from commands import refused, trabecula
from trabecula.core.progress import listen
from trabecula.engine.lazy_volume import as_slabs
from trabecula.errors import InputError, MemoryBudgetError, UnknownNameError
from trabecula.measure.percolation import wrapping_components
from trabecula.mesh.bricks.abaqus import set_names
from trabecula.mesh.bricks.export import export_bricks
from trabecula.mesh.bricks.grid import CORNERS
from trabecula.mesh.bricks.selection import choose_phases

SPACING = (2.0, 1.5, 1.0)


def blob(side: int = 12, share: float = 0.5, seed: int = 0) -> np.ndarray:
    """Return a periodic random field, cut."""
    noise = np.random.default_rng(seed).standard_normal((side,) * 3)
    field = gaussian_filter(noise, 1.2, mode="wrap")
    return (field > np.quantile(field, 1 - share)).astype(np.uint8)


def image(values, **fields) -> tb.Image:
    return tb.Image(np.asarray(values, np.uint8), "labels", **{"spacing": SPACING, **fields})


class Deck:
    """An Abaqus deck, read by its keywords."""

    def __init__(self, path) -> None:
        self.nodes, self.bricks, self.phase = {}, {}, {}
        self.sets, self.equations, self.held, self.pulled = {}, [], [], []
        self.elastic = {}
        keyword, options, material = "", {}, ""
        lines = iter(path.read_text().splitlines())
        for line in lines:
            if line.startswith("**"):
                continue
            if line.startswith("*"):
                keyword, *rest = (word.strip() for word in line[1:].split(","))
                options = dict(word.split("=") for word in rest if "=" in word)
                material = options.get("NAME", material)
                continue
            words = [word.strip() for word in line.rstrip(",").split(",")]
            if keyword == "NODE":
                self.nodes[int(words[0])] = tuple(map(float, words[1:]))
            elif keyword == "ELEMENT":
                self.bricks[int(words[0])] = tuple(map(int, words[1:]))
                self.phase[int(words[0])] = options["ELSET"]
            elif keyword == "NSET":
                self.sets.setdefault(options["NSET"], []).extend(map(int, words))
            elif keyword == "ELASTIC":
                self.elastic[material] = tuple(map(float, words))
            elif keyword == "EQUATION":
                terms = []
                while len(terms) < 3 * int(words[0]):
                    terms += [word.strip() for word in next(lines).rstrip(",").split(",")]
                triples = zip(terms[::3], terms[1::3], terms[2::3], strict=True)
                self.equations.append([(int(n), int(d), float(f)) for n, d, f in triples])
            elif keyword == "BOUNDARY":
                first, last = int(words[1]), int(words[2])
                value = float(words[3])
                where = self.sets.get(words[0]) or [int(words[0])]
                self.held += [(n, d, value) for n in where for d in range(first, last + 1)]
            elif keyword == "CLOAD":
                self.pulled.append((int(words[0]), int(words[1]), float(words[2])))

    def solve(self):
        """Return displacements and forces at nodes, {(node, dof): number}: trilinear bricks with
        2x2x2 points, assembled and solved by SciPy."""
        place = {n: k for k, n in enumerate(self.nodes)}
        stiff = {}
        rows, columns, values = [], [], []
        for number, nodes in self.bricks.items():
            edges = np.subtract(self.nodes[nodes[6]], self.nodes[nodes[0]])
            key = (self.phase[number], tuple(np.round(edges, 9)))
            if key not in stiff:
                stiff[key] = brick_matrix(edges, *self.elastic[self.phase[number]])
            dofs = [3 * place[n] + d for n in nodes for d in range(3)]
            rows += np.repeat(dofs, 24).tolist()
            columns += dofs * 24
            values += stiff[key].ravel().tolist()
        size = 3 * len(place)
        matrix = coo_matrix((values, (rows, columns)), (size, size)).tocsr()
        at = {(n, d): 3 * place[n] + d - 1 for n in place for d in (1, 2, 3)}
        # u = T free + fixed: the first term of an equation depends on the others
        fixed, known = np.zeros(size), set()
        for n, d, value in self.held:
            fixed[at[n, d]] = value
            known.add(at[n, d])
        gone = {at[terms[0][0], terms[0][1]] for terms in self.equations}
        assert len(gone) == len(self.equations) and not gone & known
        free = [dof for dof in range(size) if dof not in known and dof not in gone]
        column = {dof: k for k, dof in enumerate(free)}
        entries = [(dof, column[dof], 1.0) for dof in free]
        for (n, d, factor), *others in self.equations:
            for m, e, other in others:
                assert at[m, e] not in gone, "a partner depends on none"
                weight = -other / factor
                if at[m, e] in known:
                    fixed[at[n, d]] += weight * fixed[at[m, e]]
                else:
                    entries.append((at[n, d], column[at[m, e]], weight))
        r, c, v = zip(*entries, strict=True)
        turn = coo_matrix((v, (r, c)), (size, len(free))).tocsr()
        load = np.zeros(size)
        for n, d, force in self.pulled:
            load[at[n, d]] += force
        reduced = (turn.T @ matrix @ turn).tocsc()
        factors = splu(reduced, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        pivots = np.abs(factors.U.diagonal())
        assert pivots.min() > 1e-9 * pivots.max(), "the load case leaves a motion free"
        u = turn @ factors.solve(turn.T @ (load - matrix @ fixed)) + fixed
        force = matrix @ u
        return {key: u[dof] for key, dof in at.items()}, {k: force[dof] for k, dof in at.items()}


def brick_matrix(edges, young, poisson):
    """Return the stiffness of a brick, (24, 24), by 2x2x2 points."""
    lame = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
    shear = young / (2 * (1 + poisson))
    elastic = np.diag([2 * shear] * 3 + [shear] * 3)
    elastic[:3, :3] += lame
    signs = 2.0 * CORNERS[:, ::-1] - 1  # x, y, z
    found = np.zeros((24, 24))
    for point in product((-1, 1), repeat=3):
        at = np.array(point) / np.sqrt(3)
        slopes = np.empty((8, 3))
        for axis in range(3):
            others = [a for a in range(3) if a != axis]
            slopes[:, axis] = signs[:, axis] / 4 / edges[axis]
            for a in others:
                slopes[:, axis] *= 1 + signs[:, a] * at[a]
        strain = np.zeros((6, 24))
        for n, (gx, gy, gz) in enumerate(slopes):
            strain[:, 3 * n : 3 * n + 3] = [
                [gx, 0, 0],
                [0, gy, 0],
                [0, 0, gz],
                [gy, gx, 0],
                [0, gz, gy],
                [gz, 0, gx],
            ]
        found += strain.T @ elastic @ strain * np.prod(edges) / 8
    return found


def test_nodes_and_bricks_are_where_the_voxels_are(tmp_path):
    values = blob(6)
    found = export_bricks(image(values), tmp_path / "a.inp")
    deck = Deck(tmp_path / "a.inp")
    solid = np.argwhere(values)
    assert found.bricks == {"solid": len(solid)} and len(deck.bricks) == len(solid)
    corners = np.unique((solid[:, None] + CORNERS).reshape(-1, 3), axis=0)
    assert found.nodes == len(deck.nodes) == len(corners), "nodes that no brick has are not written"
    assert found.volume == pytest.approx(len(solid) * np.prod(SPACING))
    assert list(deck.nodes) == list(range(1, found.nodes + 1))
    for place, nodes in zip(solid, deck.bricks.values(), strict=True):
        points = np.array([deck.nodes[n] for n in nodes])
        assert np.allclose(points, ((place + CORNERS) * SPACING)[:, ::-1])
        edges = points[[1, 3, 4]] - points[0]
        assert np.linalg.det(edges) == pytest.approx(np.prod(SPACING)), "not inside out"


def test_phases_are_sets_and_only_those_asked_for(tmp_path):
    values = np.arange(27).reshape(3, 3, 3) % 3
    rock = image(values, phases=("void", "grain", "2 b/c"))
    both = export_bricks(rock, tmp_path / "a.inp", moduli={"grain": (7.0, 0.2)})
    deck = Deck(tmp_path / "a.inp")
    assert both.bricks == {"grain": 9, "2 b/c": 9}
    assert list(deck.phase.values()).count("GRAIN") == list(deck.phase.values()).count("P_2_B_C")
    assert deck.elastic == {"GRAIN": (7.0, 0.2), "P_2_B_C": (1.0, 0.3)}
    # numbers follow the voxels, not the phases
    kinds = {"GRAIN": 1, "P_2_B_C": 2}
    assert [kinds[deck.phase[n]] for n in sorted(deck.phase)] == values[values > 0].tolist()
    one = export_bricks(rock, tmp_path / "a.inp", phases="grain")
    assert one.bricks == {"grain": 9}
    assert export_bricks(rock, tmp_path / "a.inp", phases=[2, "void"]).bricks == {
        "2 b/c": 9,
        "void": 9,
    }
    assert set_names(("a b", "a_b", "EALL", "x_low")) == ["A_B", "A_B_2", "EALL_2", "X_LOW_2"]


def test_sets_of_nodes_are_the_faces(tmp_path):
    export_bricks(image(blob(6)), tmp_path / "a.inp")
    deck = Deck(tmp_path / "a.inp")
    points = {n: np.array(point) for n, point in deck.nodes.items()}
    for axis, letter in enumerate("XYZ"):
        side = 6 * SPACING[2 - axis]
        for end, at in (("LOW", 0.0), ("HIGH", side)):
            wanted = {n for n, point in points.items() if point[axis] == pytest.approx(at)}
            assert set(deck.sets[f"{letter}_{end}"]) == wanted and wanted


def test_contacts_by_an_edge_or_a_node(tmp_path):
    def contacts(*voxels):
        values = np.zeros((4, 4, 4))
        for voxel in voxels:
            values[voxel] = 1
        found = export_bricks(image(values), tmp_path / "a.vtu")
        return found.edge_contacts, found.node_contacts

    assert contacts((1, 1, 1), (1, 1, 2)) == (0, 0)
    for other in ((1, 2, 2), (2, 1, 2), (2, 2, 1), (0, 1, 2)):
        assert contacts((1, 1, 1), other) == (1, 0)
    assert contacts((1, 1, 1), (2, 2, 2)) == (0, 1)
    assert contacts((0, 0, 0), (1, 1, 1), (3, 3, 3), (2, 2, 2)) == (0, 3)
    assert contacts((1, 1, 1), (1, 2, 2), (1, 1, 2)) == (0, 0)
    assert contacts((1, 1, 1), (2, 2, 2), (1, 1, 2), (1, 2, 2)) == (0, 0)


def test_what_is_read_in_slabs_is_the_same_file(tmp_path):
    rock = image(blob(18))
    whole = export_bricks(rock, tmp_path / "whole.inp", case="periodic")
    slabs = as_slabs(rock)
    grid = choose_phases(slabs, None)
    assert sum(1 for _ in grid.layers()) == 18
    again = export_bricks(slabs, tmp_path / "slabs.inp", case="periodic")
    assert whole == again
    assert (tmp_path / "whole.inp").read_bytes() == (tmp_path / "slabs.inp").read_bytes()


def modulus(path):
    """Return what the comments of a deck say that the solution means."""
    deck = Deck(path)
    moved, force = deck.solve()
    head = path.read_text()[:900]
    match = re.search(r"modulus = (\S+) x (\S+) / displacement U(\d)", head)
    if match:
        ((node, dof, _),) = deck.pulled
        assert dof == int(match[3])
        return float(match[1]) * float(match[2]) / moved[node, dof]
    area, strain = map(float, re.search(r"force / \((\S+) x (\S+)\)", head).groups())
    dof, name = re.search(r"RF(\d) of the set (\w+)", head).groups()
    return abs(sum(force[n, int(dof)] for n in deck.sets[name])) / area / strain


@pytest.mark.whole
@pytest.mark.parametrize("axis", ["z", "y", "x"])
def test_the_periodic_case_gives_the_modulus_of_measure_stiffness(tmp_path, axis):
    rock = image(blob(12))
    found = export_bricks(rock, tmp_path / "a.inp", case="periodic", axis=axis)
    own = tb.measure.stiffness(rock, tolerance=1e-5).moduli[axis]
    assert modulus(tmp_path / "a.inp") == pytest.approx(own, rel=1e-3)
    assert found.pairs == len(Deck(tmp_path / "a.inp").equations) / 3


@pytest.mark.whole
@pytest.mark.parametrize("seed", [9, 16, 39, 92, 99, 127])
def test_whatever_repeats_is_held_and_nothing_else(tmp_path, seed):
    """Sparse fields in which components repeat along one, two or three directions, or hold together
    across the faces by edges alone: none is loose, and none is stiffened by what holds it.
    """
    rng = np.random.default_rng(seed)
    width, share = rng.choice([0.6, 0.9, 1.2]), rng.uniform(0.15, 0.5)
    noise = rng.standard_normal((7, 7, 7))
    field = gaussian_filter(noise, width, mode=rng.choice(["wrap", "nearest"]))
    rock, axis = image(field > np.quantile(field, 1 - share)), "zyx"[seed % 3]
    export_bricks(rock, tmp_path / "a.inp", case="periodic", axis=axis)
    own = tb.measure.stiffness(rock, tolerance=1e-5).moduli[axis]
    assert modulus(tmp_path / "a.inp") == pytest.approx(own, rel=2e-3)


def notices(rock, path, **options):
    """Return what an export says while it runs."""
    said = []
    with listen(lambda label, fraction: said.append(label)):
        export_bricks(rock, path, **options)
    return " ".join(said)


def test_bricks_that_hang_on_edges_are_named(tmp_path):
    values = np.zeros((4, 4, 4))
    values[:, 0, 0] = values[:, 1, 1] = 1
    for case in ("compression", "periodic"):
        assert "as by hinges" in notices(image(values), tmp_path / "a.inp", case=case)
    values[:, 0, 1] = 1
    assert "hinges" not in notices(image(values), tmp_path / "a.inp", case="compression")


def test_fibres_are_held_but_not_stressed(tmp_path):
    """A column between faces, one that repeats, and two that touch nowhere: E is their share."""
    values = np.zeros((4, 6, 6))
    values[:, 1:3, 1:3] = values[:, 4:5, 3:5] = 1
    for case in ("compression", "periodic"):
        export_bricks(image(values), tmp_path / "a.inp", case=case, moduli=(10.0, 0.3))
        assert modulus(tmp_path / "a.inp") == pytest.approx(10 * 6 / 36)
    plates = np.zeros((4, 6, 6))
    plates[:, :, 1:3] = 1
    export_bricks(image(plates), tmp_path / "a.inp", case="periodic", axis="y")
    assert modulus(tmp_path / "a.inp") == pytest.approx(1 / 3)


def test_a_full_block_has_the_moduli_of_its_material(tmp_path):
    block = image(np.ones((3, 3, 3)))
    for case, wanted in (("compression", 8.0), ("periodic", 8.0)):
        export_bricks(block, tmp_path / "a.inp", case=case, moduli=(8.0, 0.25), axis="y")
        assert modulus(tmp_path / "a.inp") == pytest.approx(wanted)
    export_bricks(image(np.ones((2, 9, 9))), tmp_path / "a.inp", case="shear", moduli=(8.0, 0.0))
    assert modulus(tmp_path / "a.inp") == pytest.approx(4.0, rel=0.2)  # its sides are free


@pytest.mark.whole
def test_compression_of_two_phases_lies_between_its_bounds(tmp_path):
    values = 1 + blob(8)
    rock = image(values, phases=("void", "soft", "hard"))
    given = {"soft": (1.0, 0.3), "hard": (3.0, 0.3)}
    export_bricks(rock, tmp_path / "a.inp", case="compression", moduli=given)
    share = (values == 2).mean()
    assert 1 / (share / 3 + 1 - share) < modulus(tmp_path / "a.inp") < 3 * share + 1 - share


def test_pairs_are_one_period_apart_and_none_is_missing(tmp_path):
    values = blob(6)
    export_bricks(image(values), tmp_path / "a.inp", case="periodic")
    deck = Deck(tmp_path / "a.inp")
    sides = 6 * np.array(SPACING)[::-1]
    references = [deck.sets[f"REF_{axis}"][0] for axis in "XYZ"]
    for terms in deck.equations:
        (node, dof, one), (partner, same, minus), *periods = terms
        assert one == 1 and minus == -1 and dof == same
        apart = np.subtract(deck.nodes[node], deck.nodes[partner]) / sides
        found = np.zeros(3)
        for reference, along, factor in periods:
            assert along == dof
            found[references.index(reference)] = -factor
        assert np.allclose(apart, found) and np.any(found)
    mine = {n: np.array(deck.nodes[n]) for n in deck.nodes if n not in references}
    classes = {tuple(np.round(np.mod(point, sides), 6)) for point in mine.values()}
    assert len(deck.equations) / 3 == len(mine) - len(classes)


def test_loads_reach_what_is_joined_by_faces(tmp_path):
    values = np.zeros((4, 5, 5))
    values[:, 1, 1] = 1
    values[:2, 3, 3] = 1  # a cut strut
    values[2, 2, 2] = 1  # beside the column, by an edge
    found = export_bricks(image(values), tmp_path / "a.inp", case="compression")
    assert found.bricks == {"solid": 4} and found.left_out == 3 and found.edge_contacts == 0
    assert export_bricks(image(values), tmp_path / "a.inp").left_out == 0


def test_periods_of_components():
    inside = np.zeros((4, 4, 4), bool)
    inside[:, 0, 0] = True  # along z
    inside[1, 2, :] = True  # along x
    labels, periods = wrapping_components(inside)
    assert [np.abs(periods[labels[place]]).tolist() for place in ((0, 0, 0), (1, 2, 1))] == [
        [[1, 0, 0]],
        [[0, 0, 1]],
    ]
    inside[1, :, 0] = True  # and along y, which joins them
    labels, periods = wrapping_components(inside)
    assert len(periods) == 1 and np.linalg.matrix_rank(*periods.values()) == 3
    helix = np.zeros((5, 7, 8), bool)  # two ways, each of which leads into the other
    helix[0, 0, :3] = helix[0, :4, 2] = helix[0, 3, 2:] = True
    helix[:3, 3, 0] = helix[2, :4, 0] = helix[2, 0, :6] = helix[:3, 0, 5] = helix[0, 0, 5:] = True
    (gaps,) = wrapping_components(helix)[1].values()
    assert np.abs(gaps).tolist() == [[0, 0, 2]]
    across = np.zeros((4, 4, 4), bool)
    across[1, 0, [0, 3]] = True  # over a face, but not around
    assert wrapping_components(across)[1] == {}


def test_a_vtu_holds_points_cells_and_phases(tmp_path):
    values = np.arange(60).reshape(3, 4, 5) % 3
    rock = image(values, phases=("void", "grain", "a--b"), unit="um")
    found = export_bricks(rock, tmp_path / "a.vtu")
    raw = (tmp_path / "a.vtu").read_bytes()
    head, data = raw.split(b'<AppendedData encoding="raw">\n   _')
    assert b"--" not in head.split(b"<!--")[1].split(b"-->")[0], "no comment in XML holds it"
    starts = [int(number) for number in re.findall(rb'offset="(\d+)"', head)]
    types = ("<f8", "<i4", "<i8", "u1", "<i4", "u1")

    def block(n):
        size = int(np.frombuffer(data[starts[n] : starts[n] + 8], "<u8")[0])
        return np.frombuffer(data[starts[n] + 8 : starts[n] + 8 + size], types[n])

    points, cells = block(0).reshape(-1, 3), block(1).reshape(-1, 8)
    assert len(points) == found.nodes and len(cells) == sum(found.bricks.values()) == 40
    place = np.argwhere(values > 0)
    assert np.allclose(points[cells], ((place[:, None] + CORNERS) * SPACING)[..., ::-1])
    assert block(2).tolist() == list(range(8, 8 * 40 + 1, 8)) and set(block(3)) == {12}
    assert block(4).tolist() == (1 + values[values > 0]).tolist(), "MFEM's attributes begin at 1"
    assert block(5).tolist() == values[values > 0].tolist()


def foam_list(path):
    """Read a list of OpenFOAM: the numbers of every row."""
    text = path.read_text().split("}", 1)[1]
    count, rows = text.split("(", 1)[0].strip(), text.split("(", 1)[1].rsplit(")", 1)[0]
    found = [[float(n) for n in re.findall(r"[-+.\de]+", row)] for row in rows.strip().split("\n")]
    found = [row for row in found if row]
    assert len(found) == int(count)
    return found


def test_a_polymesh_is_closed_and_in_the_order_of_its_owners(tmp_path):
    values = blob(8, 0.4)
    found = export_bricks(image(values, unit="mm"), tmp_path / "a.foam", axis="y")
    mesh = tmp_path / "a.foam" / "constant" / "polyMesh"
    points = np.array(foam_list(mesh / "points"))
    faces = np.array(foam_list(mesh / "faces"), int)[:, 1:]
    owner, neighbour = (
        np.array(foam_list(mesh / name), int).ravel() for name in ("owner", "neighbour")
    )
    cells, inner = found.bricks["void"], len(neighbour)
    assert len(points) == found.nodes and owner.max() == cells - 1
    assert (owner[:inner] < neighbour).all()
    pairs = list(zip(owner[:inner], neighbour, strict=True))
    assert pairs == sorted(set(pairs)), "in the order that solvers ask for, each once"
    corners = points[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0])
    total = np.zeros((cells, 3))
    np.add.at(total, owner, area)
    np.subtract.at(total, neighbour, area[:inner])
    assert np.abs(total).max() < 1e-12 * np.abs(area).max(), "every cell is closed, normals outward"
    middle = corners.mean(axis=1)
    volume = np.zeros(cells)
    flux = np.einsum("ij,ij->i", area, middle) / 3
    np.add.at(volume, owner, flux)
    np.subtract.at(volume, neighbour, flux[:inner])
    assert np.allclose(volume, np.prod(SPACING) * 1e-9), "in metres"
    text = (mesh / "boundary").read_text()
    entries = re.findall(r"(\w+)\n\s+{\n\s+type (\w+);\s+nFaces (\d+);\s+startFace (\d+)", text)
    patches = {name: (kind, int(count), int(start)) for name, kind, count, start in entries}
    assert [patches["inlet"][0], patches["walls"][0], patches["side_x_low"][0]] == [
        "patch",
        "wall",
        "symmetryPlane",
    ]
    at = inner
    for kind, count, start in patches.values():
        assert start == at and kind
        at += count
    assert at == len(faces)
    for name, axis, place in (("inlet", 1, 0.0), ("outlet", 1, 12e-3), ("side_z_high", 2, 16e-3)):
        _, count, start = patches[name]
        assert count and np.allclose(corners[start : start + count, :, axis], place)
    # of the voxels that are cells: faces on the box, and to voxels that are none
    walls = sum(np.count_nonzero(np.diff(values, axis=axis)) for axis in range(3))
    assert found.left_out == 0 and patches["walls"][1] == walls
    assert not list(mesh.glob("*.*")), "nothing beside the five files"
    for name in ("0/U", "0/p", "system/controlDict", "system/fvSolution", "case.foam"):
        assert (tmp_path / "a.foam" / name).exists()


def test_a_flow_has_the_pores_that_lead_from_end_to_end(tmp_path):
    values = np.ones((4, 6, 6))
    values[:, 1, 1] = values[1, 4, 4] = values[:2, 4, 1] = 0
    found = export_bricks(image(values, unit="um"), tmp_path / "a.foam")
    assert found.bricks == {"void": 4} and found.left_out == 3
    control = (tmp_path / "a.foam" / "system" / "controlDict").read_text()
    nu, drop, length, area = 1e-6, 1e-3 * 1e-12 / 1e-18 * 8e-6, 8e-6, 9e-6 * 6e-6
    factor = float(re.search(r"= Q \* (\S+) m2", control)[1])
    assert factor == pytest.approx(nu * length / (area * drop))
    assert max(map(len, control.splitlines())) < 130


def test_what_cannot_be_written_is_refused(tmp_path):
    rock = image(blob(6))
    with pytest.raises(InputError, match="no voxel is 'solid'"):
        export_bricks(image(np.zeros((3, 3, 3))), tmp_path / "a.inp")
    with pytest.raises(InputError, match=r"holds no load case 'shear': write \.inp"):
        export_bricks(rock, tmp_path / "a.vtu", case="shear")
    with pytest.raises(UnknownNameError, match="case"):
        export_bricks(rock, tmp_path / "a.inp", case="torsion")
    with pytest.raises(UnknownNameError, match="axis"):
        export_bricks(rock, tmp_path / "a.inp", axis="w")
    with pytest.raises(InputError, match="give 3 axes"):
        export_bricks(np.ones((4, 4), np.uint8), tmp_path / "a.inp")
    with pytest.raises(UnknownNameError, match="phase of the moduli"):
        export_bricks(rock, tmp_path / "a.inp", moduli={"bone": (1, 0.3)})
    with pytest.raises(InputError, match="Poisson's ratio of solid"):
        export_bricks(rock, tmp_path / "a.inp", moduli=(1.0, 0.5))
    with pytest.raises(MemoryBudgetError, match="export a crop"):
        export_bricks(rock, tmp_path / "a.inp", case="shear", memory=100)
    apart = np.zeros((5, 5, 5))
    apart[:2] = 1
    with pytest.raises(InputError, match=r"does not percolate along z.*choose --axis y or x"):
        export_bricks(image(apart), tmp_path / "a.inp", case="compression")
    with pytest.raises(InputError, match="does not meet itself across the faces along z"):
        export_bricks(image(apart), tmp_path / "a.inp", case="periodic")
    with pytest.raises(InputError, match=r"'void' does not percolate along z.*finish --connect"):
        export_bricks(image(np.pad(np.zeros((2, 2, 2)), 1, constant_values=1)), tmp_path / "a.foam")
    assert list(tmp_path.iterdir()) == [], "nothing is left of what was refused"


def test_too_many_bricks_for_the_format(tmp_path, monkeypatch):
    from dataclasses import replace

    from trabecula.mesh.bricks import formats

    small = replace(formats.FORMATS[".inp"], most=10)
    monkeypatch.setitem(formats.FORMATS, ".inp", small)
    with pytest.raises(InputError, match=r"bricks are more than the 10 that \.inp counts"):
        export_bricks(image(blob(6)), tmp_path / "a.inp")


@pytest.mark.whole
def test_the_command_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    tb.write(image(blob(10), unit="mm"), "rock.zarr")
    out = trabecula("export", "rock.zarr", "--out", "rock.inp", "--case", "compression").out
    assert "rock.inp: " in out and "nodes, bricks: " in out and "mm^3" in out
    assert "bricks touch by an edge alone at" in out
    words = ("--case", "periodic", "--axis", "x", "--moduli", "solid=17000,0.3", "--strain", "0.02")
    found = trabecula("export", "rock.zarr", "--out", "rock.inp", *words)
    assert "nodes depend on their partners" in found.out and "was not made periodic" in found.err
    assert "17000, 0.3" in (tmp_path / "rock.inp").read_text()
    out = trabecula("export", "rock.zarr", "--out", "r.vtu", "--phase", "solid", "void").out
    assert "500 solid, 500 void" in out
    assert "void" in trabecula("export", "rock.zarr", "--out", "r.foam", "--axis", "y").out
    assert "is for bricks" in refused("export", "rock.zarr", "--out", "r.stl", "--case", "shear")
    assert "r.stl holds one" in refused(
        "export", "rock.zarr", "--out", "r.stl", "--phase", "solid", "void"
    )
    assert "NAME=E,NU" in refused("export", "rock.zarr", "--out", "r.inp", "--moduli", "solid=3")
    path = tb.export(tb.read("rock.zarr"), "again.inp", case="periodic", axis="x", scale=2)
    assert "21, " in path.read_text()
    with pytest.raises(InputError, match="strain is for bricks"):
        tb.export(tb.read("rock.zarr"), "again.stl", strain=0.1)


def test_a_result_that_was_made_periodic_needs_no_notice(tmp_path):
    made = tb.method("noise", kind="gaussian").fit(image(blob(24), spacing=(1, 1, 1)))
    for periodic in (True, False):
        tile = made.generate(16, seed=1, periodic=periodic)
        said = notices(tile, tmp_path / "a.inp", case="periodic")
        assert ("was not made periodic" in said) is not periodic

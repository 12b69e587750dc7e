"""Prune: short stubs are removed, long ones grown, and nothing else changes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.finish.branches import cell_perimeters
from trabecula.finish.prune import prune
from trabecula.measure import components, euler, skeleton_graph, thickness

SIDE, THICK = 16, 3


def lattice(cells: int = 2, thick: int = THICK) -> np.ndarray:
    """Return struts along the edges of cubes, with void around."""
    on = np.zeros(cells * SIDE + thick, bool)
    for first in range(0, len(on), SIDE):
        on[first : first + thick] = True
    z, y, x = on[:, None, None], on[None, :, None], on[None, None, :]
    return np.pad((z & y) | (z & x) | (y & x), 6).astype(np.uint8)


def report(image):
    return image.recipe.steps[-1]["report"]


MIDDLE = slice(6 + SIDE, 6 + SIDE + THICK)  # of the struts that cross in the centre of two cells
ALONG = 6 + SIDE + SIDE // 2 + 1  # half-way along a strut


def with_stub(length: int, solid: np.ndarray | None = None, at: int = ALONG) -> np.ndarray:
    """Add a stub on a strut along z, which sticks into a cell along x."""
    solid = lattice() if solid is None else solid.copy()
    solid[at - 1 : at + 2, MIDDLE, MIDDLE.stop : MIDDLE.stop + length] = 1
    return solid


@pytest.mark.parametrize("length", [4, 5, 6])
def test_a_short_stub_is_removed_and_nothing_else(length):
    # The perimeter of its cell is 4 x 16, and theta times that about 7.
    part = prune(with_stub(length))
    left = np.flatnonzero(part.values != lattice())
    # what lies in the strut's own sphere stays
    assert len(left) <= 10 and np.all(part.values >= lattice())
    assert (
        report(part)["ends_before"] == report(part)["removed"] == 1
        and report(part)["ends_after"] == 0
    )
    assert report(part)["removed_voxels"] == 9 * length - len(left) and report(part)["added"] == 0


@pytest.mark.parametrize("length", [10, 11, 12])
def test_a_long_stub_is_grown_to_the_next_strut(length):
    # Between the struts that bound a cell lies a hole; a strut across it has to be there to be met.
    solid = lattice()
    solid[ALONG - 5 : ALONG + 6, MIDDLE, MIDDLE.stop + SIDE - THICK : MIDDLE.stop + SIDE] = 1
    stub = with_stub(length, solid)
    part = prune(stub)
    assert np.all(part.values >= stub) and components(part) == 1
    assert (report(part)["grown"], report(part)["removed"], report(part)["ends_after"]) == (1, 0, 0)
    assert (
        euler(part) == euler(stub) - 1
        and euler(part, connectivity=26) == euler(stub, connectivity=26) - 1
    )
    new = np.argwhere(part.values > stub)
    # straight on, no thicker than the stub
    assert np.all(np.abs(new[:, :2] - [ALONG, MIDDLE.start + 1]) <= 1)
    assert set(new[:, 2]) == set(range(MIDDLE.stop + length, MIDDLE.stop + SIDE - THICK))


def test_where_nothing_is_ahead_it_stays():
    outwards = np.pad(lattice(), ((0, 0), (0, 0), (14, 0)))
    first = slice(6, 6 + THICK)
    outwards[6 + SIDE // 2 : 9 + SIDE // 2, first, 8:20] = 1
    part = prune(outwards)
    assert np.array_equal(part.values, outwards)
    assert (report(part)["ends_before"], report(part)["left"], report(part)["grown"]) == (1, 1, 0)


def test_theta_is_the_dial():
    stub = with_stub(6)
    assert report(prune(stub, theta=0.0))["removed"] == 0
    assert report(prune(with_stub(11), theta=0.5))["removed"] == 1


def test_cells_of_a_lattice_have_its_perimeter():
    graph = skeleton_graph(lattice())
    perimeters = cell_perimeters(graph, list(range(len(graph.joints))))
    assert perimeters == pytest.approx(4 * SIDE, abs=3)  # corners are rounded off
    tree = np.zeros((9, 9, 9), np.uint8)
    tree[4, 4, :] = tree[4, :, 4] = 1
    assert np.isinf(cell_perimeters(skeleton_graph(tree), [0])).all()


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_the_shortest_loop_by_taking_edges_away(seed):
    """Find the shortest loop by brute force: over a joint's branches, the branch and the way back
    without it.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra

    from trabecula.finish.branches import _shortest_loop

    rng = np.random.default_rng(seed)
    nodes, pairs = 8, rng.integers(0, 8, (14, 2))
    lengths = rng.integers(1, 30, 14).astype(float)
    edges = [[] for _ in range(nodes)]
    for number, ((a, b), length) in enumerate(zip(pairs.tolist(), lengths, strict=True)):
        edges[a].append((b, length, number))
        if a != b:
            edges[b].append((a, length, number))
    best = np.inf
    for other, length, number in edges[0]:
        ways = np.full((nodes, nodes), np.inf)
        for n, (a, b) in enumerate(pairs):
            if n != number and a != b:
                ways[a, b] = ways[b, a] = min(ways[a, b], lengths[n])
        graph = csr_array(np.where(np.isinf(ways), 0, ways))
        best = min(best, length + (0 if other == 0 else dijkstra(graph, indices=0)[other]))
    assert _shortest_loop(0, edges) == best


def test_a_cut_strut_is_mended():
    whole = lattice()
    cut = whole.copy()
    cut[ALONG - 2 : ALONG + 3, MIDDLE, MIDDLE] = 0
    assert euler(cut) == euler(whole) + 1
    part = prune(cut, theta=0)
    assert (
        euler(part) == euler(whole)
        and report(part)["grown"] == 1
        and report(part)["ends_before"] == 2
    )
    assert np.all(part.values >= cut) and np.all(part.values <= ndimage.binary_dilation(whole))


def test_no_more_are_treated_than_the_exemplar_has_too_few_of():
    two = with_stub(5, with_stub(4, at=ALONG - SIDE))
    assert report(prune(two, exemplar=two))["ends_before"] == 2
    assert np.array_equal(prune(two, exemplar=two).values, two)
    one = prune(two, exemplar=with_stub(5))
    assert (
        report(one)["ends_exemplar"]
        == report(one)["ends_allowed"]
        == report(one)["ends_after"]
        == 1
    )
    assert one.values[ALONG, MIDDLE.start + 1, MIDDLE.stop + 4] == 1  # the shortest goes first
    none = prune(two, exemplar=lattice())
    assert report(none)["removed"] == 2 and report(none)["ends_after"] == 0


def test_longer_ones_than_any_of_the_exemplar_are_treated_first():
    two = with_stub(6, with_stub(4, at=ALONG - SIDE))
    one = prune(two, exemplar=with_stub(4))
    assert one.values[ALONG - SIDE, MIDDLE.start + 1, MIDDLE.stop + 3] == 1
    assert one.values[ALONG, MIDDLE.start + 1, MIDDLE.stop + 5] == 0


@pytest.mark.parametrize("thick", [3, 5])
def test_what_is_grown_is_copied_from_the_exemplar(thick):
    whole = lattice()
    cut = whole.copy()
    cut[ALONG - 2 : ALONG + 3, MIDDLE, MIDDLE] = 0
    new = prune(cut, exemplar=lattice(thick=thick), theta=0).values > cut
    cross_section = new[ALONG].sum()
    # Never thinner than the stub, never more than 1.5 times as thick.
    assert cross_section <= 9 if thick == 3 else 9 < cross_section <= 25


def test_plates_rough_surfaces_and_faces_are_left_alone():
    plate = np.zeros((24, 40, 40), np.uint8)
    plate[10:13, 8:32, 8:32] = 1
    plate[13, ::3, ::3] = plate[12, ::3, ::3]
    assert report(prune(plate))["ends_before"] == 0
    through = lattice(3)[12:-12, 12:-12, 12:-12]  # every strut at the faces is cut
    assert skeleton_graph(through).ends > 20 and report(prune(through))["ends_before"] == 0


def test_images_of_two_axes():
    frame = np.zeros((40, 60), np.uint8)
    frame[5:35, 5:55] = 1
    frame[8:32, 8:52] = 0
    short, long = frame.copy(), frame.copy()
    short[8:12, 29:31] = 1
    long[8:27, 29:31] = 1
    removed = prune(short)
    assert removed.values.shape == frame.shape and report(removed)["removed"] == 1
    assert np.count_nonzero(removed.values != frame) <= 2
    assert (
        np.all(prune(long).values[27:32, 28:32].any(axis=1)) and report(prune(long))["grown"] == 1
    )
    assert euler(prune(long)) == euler(frame) - 1


def test_lengths_follow_the_spacing():
    stub = with_stub(6)
    fine = prune(tb.Image(stub, "labels", spacing=0.02, unit="mm"))
    assert np.array_equal(fine.values, prune(stub).values) and fine.unit == "mm"
    # Voxels four times as long along x: the stub is as long as others are that are grown.
    flat = prune(tb.Image(stub, "labels", spacing=(1.0, 1.0, 4.0)), theta=0.15)
    assert report(flat)["removed"] == 0


def test_several_phases_keep_their_labels():
    stub = with_stub(5)
    stub[:, :, MIDDLE.stop :] *= 2
    stub[1, 1, 1] = 3
    image = tb.Image(stub, "labels", phases=("void", "a", "b", "c"))
    part = prune(image)
    assert part.phases == image.phases and report(part)["removed"] == 1
    kept = part.values == stub
    assert (
        np.all(part.values[~kept] == 0) and np.all(stub[~kept] == 2) and part.values[1, 1, 1] == 3
    )


def test_one_phase_does_not_grow_through_another():
    cut = lattice()
    cut[ALONG - 2 : ALONG + 3, MIDDLE, MIDDLE] = 0
    cut[ALONG, MIDDLE, MIDDLE] = 2
    image = tb.Image(cut, "labels", phases=("void", "a", "b"))
    part = prune(image, phase="a", theta=0)
    assert np.array_equal(part.values, cut) and report(part)["left"] == 2


def test_pores_can_be_pruned():
    part = prune(1 - with_stub(5), phase="void")
    assert report(part)["removed"] == 1 and np.array_equal(
        part.values, 1 - prune(with_stub(5)).values
    )


def test_the_recipe_replays():
    exemplar = tb.Image(lattice(), "labels")
    part = prune(with_stub(5), exemplar=exemplar, theta=0.2)
    step = part.recipe.steps[-1]
    assert (
        step["verb"] == "finish"
        and step["operation"] == "prune"
        and step["settings"] == {"phase": None, "theta": 0.2, "periodic": False}
    )
    assert step["exemplars"][0][0]["verb"] == "array"
    assert prune(with_stub(5), exemplar=exemplar, **step["settings"]).recipe.steps[-1] == step


def test_the_file_reruns_with_its_exemplar(tmp_path):
    tb.write(tb.Image(with_stub(5, with_stub(4, at=ALONG - SIDE)), "labels"), tmp_path / "two.tif")
    tb.write(tb.Image(with_stub(5), "labels"), tmp_path / "one.tif")
    part = prune(tb.read(tmp_path / "two.tif"), exemplar=tb.read(tmp_path / "one.tif"))
    assert report(part)["removed"] == report(part)["ends_allowed"] == 1
    tb.write(part, tmp_path / "part.tif")
    assert np.array_equal(tb.rerun(tmp_path / "part.tif").values, part.values)


def test_two_ends_that_face_each_other_are_joined_once():
    cut = lattice()
    cut[ALONG - 1 : ALONG + 2, MIDDLE, MIDDLE] = 0
    assert (
        report(prune(cut, theta=0))["ends_before"] == 2
        and report(prune(cut, theta=0))["grown"] == 1
    )


def test_an_exemplar_without_a_unit_has_the_voxels_of_the_image():
    part = tb.Image(with_stub(5), "labels", spacing=20.0, unit="um")
    same = prune(part, exemplar=with_stub(5))
    assert report(same)["ends_allowed"] == 1 and np.array_equal(same.values, part.values)
    with pytest.raises(tb.errors.InputError, match="one unit"):
        prune(part, exemplar=tb.Image(with_stub(5), "labels", spacing=0.02, unit="mm"))


def test_refusals():
    stub = with_stub(5)
    with pytest.raises(tb.errors.InputError, match="nothing to prune"):
        prune(np.zeros((4, 4, 4), np.uint8))
    with pytest.raises(tb.errors.InputError, match="theta"):
        prune(stub, theta=-1)
    with pytest.raises(tb.errors.InputError, match="axes"):
        prune(stub, exemplar=stub[10])
    with pytest.raises(tb.errors.InputError, match="nothing of the phase"):
        prune(stub, exemplar=np.zeros((9, 9, 9), np.uint8))
    assert np.all(prune(np.ones((9, 9, 9), np.uint8)).values == 1)


def noise(seed: int, smooth: float) -> np.ndarray:
    field = ndimage.gaussian_filter(np.random.default_rng(seed).random((30, 30, 30)), smooth)
    return (field > np.quantile(field, 0.75)).astype(np.uint8)


@pytest.mark.whole
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.8, 1.3]), st.sampled_from([0.0, 0.11, 10.0]))
@settings(max_examples=20)
def test_topology_of_any_volume(seed, smooth, theta):
    solid = noise(seed, smooth)
    before = solid.copy()
    part = prune(solid, theta=theta)
    changes = report(part)
    assert np.array_equal(solid, before)
    assert part.values.sum() == solid.sum() + changes["added"] - changes["removed_voxels"]
    for near in (6, 26):
        assert components(part, connectivity=near) <= components(solid, connectivity=near)
        if changes["grown"]:
            assert euler(part, connectivity=near) < euler(solid, connectivity=near)
    if not changes["grown"]:
        assert euler(part, connectivity=26) == euler(solid, connectivity=26)


@pytest.mark.whole
def test_real_bone(data):
    import tifffile

    bone = tifffile.imread(data / "trabecular_bone_a.tif")[40:130, 40:130, 40:130] > 0
    part = prune(bone)
    changes = report(part)
    assert (
        changes["left"] == changes["ends_after"] < changes["ends_before"]
        and changes["removed_voxels"] < 0.01 * bone.sum()
    )
    assert thickness(part) == pytest.approx(thickness(bone), rel=0.01)


def with_stubs(count: int) -> np.ndarray:
    """Return a lattice with short stubs, each in a cell of its own."""
    solid = lattice(4)
    starts = [6 + SIDE * k for k in range(1, 4)]
    places = [
        (z - SIDE // 2 + 1, y, x) for z in starts for y in starts for x in starts if x < starts[-1]
    ]
    for z, y, x in places[:count]:
        solid[z - 1 : z + 2, y : y + THICK, x + THICK : x + THICK + 5] = 1
    return solid


@pytest.mark.whole
def test_a_form_is_pruned_as_a_box_of_its_size():
    """Count the same free ends in a form, whatever its box: 4 of the exemplar's, 12 here."""
    material, exemplar = with_stubs(12), with_stubs(4)
    box = prune(material, exemplar=exemplar)
    assert (
        report(box)["removed"] == 8
        and report(box)["ends_allowed"] == report(box)["ends_after"] == 4
    )
    room = [(40, 30), (30, 40), (50, 20)]
    inside = np.pad(np.ones(material.shape, bool), room)
    form = prune(np.pad(material, room), exemplar=exemplar, mask=inside)
    assert np.array_equal(form.values, np.pad(box.values, room))
    assert report(form) == report(box)
    # The volume of the box around it has room for all of them.
    assert report(prune(np.pad(material, room), exemplar=exemplar))["removed"] == 0


def test_what_the_surface_of_a_form_cuts_is_no_free_end():
    """Cut a lattice by a ball: the cut struts are many, the stub inside of it is one."""
    solid = with_stub(5, lattice(4), at=6 + SIDE * 2 + SIDE // 2 + 1)
    grid = np.indices(solid.shape) - (np.array(solid.shape) - 1)[:, None, None, None] / 2
    ball = (grid**2).sum(axis=0) < 30.5**2
    cut = np.where(ball, solid, 0).astype(np.uint8)
    whole, part = prune(cut), prune(cut, mask=ball)
    assert report(whole)["ends_before"] > 10
    assert (report(part)["ends_before"], report(part)["removed"], report(part)["ends_after"]) == (
        1,
        1,
        0,
    )
    assert np.array_equal(part.values, prune(solid).values * ball)


def test_nothing_is_grown_out_of_a_form():
    solid = lattice()
    solid[ALONG - 5 : ALONG + 6, MIDDLE, MIDDLE.stop + SIDE - THICK : MIDDLE.stop + SIDE] = 1
    stub = with_stub(10, solid)
    form = np.ones(stub.shape, bool)
    form[
        ALONG - 3 : ALONG + 4,
        MIDDLE.start - 3 : MIDDLE.stop + 3,
        MIDDLE.stop + 11 : MIDDLE.stop + 12,
    ] = False
    assert report(prune(stub))["grown"] == 1
    assert report(prune(stub, mask=form))["grown"] == 0


@pytest.mark.whole
def test_a_form_is_recorded_and_a_missing_one_is_said():
    material = tb.Image(with_stubs(2), "labels")
    inside = tb.Image(np.ones(material.shape, np.uint8), "labels")
    step = prune(material, mask=inside).recipe.steps[-1]
    assert step["mask"][0]["verb"] == "array" and "mask" not in step["settings"]
    request = {"shape": list(material.shape), "mask": [{"verb": "array"}]}
    filled = tb.Image(
        material.values,
        "labels",
        recipe=tb.Recipe().then("generate", material.values, request=request),
    )
    said = []
    with listen(lambda line, fraction: said.append(line) if fraction < 0 else None):
        prune(material)
        prune(filled, mask=inside)
        assert not said
        prune(filled)
    assert len(said) == 1 and "give the form (mask, --mask)" in said[0]


def test_voxels_taken_for_alike_are_said():
    said = []
    with listen(lambda line, fraction: said.append(line) if fraction < 0 else None):
        prune(
            tb.Image(with_stubs(2), "labels"), exemplar=tb.Image(with_stubs(1), "labels", 25, "um")
        )
    assert len(said) == 1 and "the image is in voxel, the exemplar in um" in said[0]

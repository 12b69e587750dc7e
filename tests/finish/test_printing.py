"""The print check: each fault alone in a part, and each limit."""

import json

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError, UnknownNameError
from trabecula.finish import fill_trapped, print_check, print_layers, thicken
from trabecula.finish.forms import as_form
from trabecula.finish.printers import PRINTERS


def block(side=24):
    """Return a cube of 12 mm on the plate."""
    return np.ones((side, side, side), bool)


def verdicts(solid, printer="sls", spacing=0.5, unit="mm", **limits):
    found = print_check(
        tb.Image(solid, "labels", spacing=spacing, unit=unit), printer=printer, **limits
    )
    return {finding.name: finding.verdict for finding in found.findings}


def figures(solid, name, printer="sls", spacing=0.5, **limits):
    found = print_check(
        tb.Image(solid, "labels", spacing=spacing, unit="mm"), printer=printer, **limits
    )
    return next(finding.figures for finding in found.findings if finding.name == name)


def worst(found):
    return {name: verdict for name, verdict in found.items() if verdict != "pass"}


@pytest.mark.parametrize("printer", PRINTERS)
def test_a_solid_cube_passes(printer):
    found = verdicts(block(), printer)
    assert worst(found) == {}
    extra = {"sls": {"trapped", "passage"}, "sla": {"trapped", "passage", "cups", "islands"}}
    extra["fdm"] = {"islands", "overhangs", "bridges"}
    extra["slm"] = extra["sls"] | extra["fdm"]
    assert set(found) == {"size", "surface", "pieces", "walls", "gaps", "estimate"} | extra[printer]


def test_the_box_may_be_met_by_turning_about_the_vertical():
    beam = np.ones((4, 4, 40), bool)
    for box, fits in (
        ((2, 2, 20), True),
        ((2, 20, 2), True),
        ((20, 2, 2), False),
        ((2, 2, 19.9), False),
    ):
        assert verdicts(beam, box=box)["size"] == ("pass" if fits else "refuse")
    # The part counts, not the empty image around it.
    assert figures(np.pad(beam, 5), "size")["extent"] == [2, 2, 20]


def test_a_part_may_not_be_laid_down_to_fit():
    pillar = np.ones((40, 4, 4), bool)  # 20 mm high
    assert verdicts(pillar, box=(19.9, 30, 30))["size"] == "refuse"
    assert verdicts(pillar, box=(20, 2, 2))["size"] == "pass"


def test_a_layer_holds_by_edges_too():
    """In a layer, voxels that share an edge across the corner are fused: neither is an island."""
    solid = np.zeros((2, 4, 4), bool)
    solid[:, 1, 1] = solid[1, 2, 2] = True
    assert print_layers.find_islands(solid)[0] == 0
    solid[1, 2, 2], solid[1, 3, 3] = False, True
    assert print_layers.find_islands(solid)[0] == 1


def test_lengths_are_those_of_the_unit():
    for unit, factor in (("mm", 1), ("um", 1000), ("cm", 0.1), ("inch", 1 / 25.4)):
        image = tb.Image(block(), "labels", spacing=0.5 * factor, unit=unit)
        assert print_check(image).findings[0].figures["extent"] == pytest.approx(
            [12, 12, 12], abs=1e-5
        )
    with pytest.raises(
        InputError, match=r"unit is 'voxel', which is no length.*--spacing 19\.5 --unit um"
    ):
        print_check(block())


def test_voxels_that_touch_in_an_edge_or_a_corner():
    edge, corner = np.zeros((2, 20, 20, 20), bool)
    edge[:10, :10, :], edge[10:, 10:, :] = True, True
    corner[:10, :10, :10], corner[10:, 10:, 10:] = True, True
    assert verdicts(edge)["surface"] == verdicts(corner)["surface"] == "warn"
    assert figures(edge, "surface") == {"edges": 20, "corners": 0}
    assert figures(corner, "surface") == {"edges": 0, "corners": 1}


def test_mass_and_time_are_those_of_the_volume():
    block = np.ones((20, 10, 10), np.uint8)
    found = figures(block, "estimate", "sla", layer=0.05, density=1.2, pause=9)
    assert found["volume"] == 250 and found["mass"] == pytest.approx(0.3)
    assert found["layers"] == 200 and found["hours"] == pytest.approx(0.5)
    laid = figures(block, "estimate", "fdm", layer=0.5, pause=0.001, speed=2.5)
    assert laid["hours"] == pytest.approx(100 / 3600, rel=1e-3)


@pytest.mark.parametrize(
    ("printer", "says"), [("sls", "warn"), ("sla", "refuse"), ("fdm", "refuse")]
)
def test_loose_pieces(printer, says):
    part = np.pad(block(), ((0, 0), (0, 0), (0, 20)))
    part[:4, 4:10, 34:40] = True
    assert verdicts(part, printer)["pieces"] == says
    assert figures(part, "pieces") == {"pieces": 2, "loose_volume": 4 * 6 * 6 / 8}


def test_struts_and_walls():
    part = np.pad(block(), ((0, 0), (0, 0), (0, 24)))
    part[:4, 10:12, 24:] = True  # 2 voxels wide, 1 mm
    assert verdicts(part, wall=0.5)["walls"] == "pass"
    assert verdicts(part, wall=1.6)["walls"] == "refuse"
    found = figures(part, "walls", wall=1.6)
    assert found["thin_share"] == pytest.approx(4 * 2 * 24 / part.sum(), rel=0.15)
    assert found["thinnest"] == pytest.approx(1, abs=0.26) and found["wall"] == 1.6
    few = part.copy()
    few[:, :, 30:] = False
    assert verdicts(few, wall=1.6)["walls"] == "warn"
    thick = thicken(tb.Image(part, "labels", spacing=0.5, unit="mm"), thickness=1.6)
    assert print_check(thick, wall=1.6).findings[3].verdict == "pass"


def test_narrow_pores_and_wide_ones():
    part = block()
    part[:, 8:12, 8:12] = False  # 2 mm, right through
    assert worst(verdicts(part)) == {}
    assert verdicts(part, gap=3)["gaps"] == "warn"
    assert figures(part, "gaps", gap=3)["narrow_share"] > 0.9


def test_voxels_too_coarse_for_the_limit_are_told():
    part = np.pad(block(), ((0, 0), (0, 0), (0, 24)))
    part[:4, 10:12, 24:] = True
    assert verdicts(part, spacing=0.5, wall=0.7)["walls"] == "warn"
    assert verdicts(part, spacing=0.5, wall=0.5)["walls"] == "pass", (
        "two voxels are thicker, whatever the error"
    )
    assert verdicts(block(), spacing=0.5, wall=0.7)["walls"] == "pass", (
        "nothing is anywhere near it"
    )
    assert verdicts(~part, spacing=0.5, gap=0.7, wall=0.1)["gaps"] == "warn"


def test_trapped_powder():
    part = block()
    part[8:16, 8:16, 8:16] = False
    assert verdicts(part)["trapped"] == verdicts(part, "sla")["trapped"] == "refuse"
    assert figures(part, "trapped") == {"pores": 1, "volume": 64.0}
    assert "trapped" not in verdicts(part, "fdm")
    filled = fill_trapped(tb.Image(part, "labels", spacing=0.5, unit="mm"))
    assert print_check(filled).verdict == "pass"
    part[8:16, 8:16, 8:] = False  # opened to the side, as wide as it is
    assert worst(verdicts(part)) == {}
    small = np.pad(part, 0)
    small[20, 4, 4] = False
    assert verdicts(small)["trapped"] == "warn"


def test_a_pore_behind_a_narrow_hole_is_hard_to_clear():
    part = block(40)
    part[8:32, 8:32, 8:32] = False
    part[18:21, 18:21, 32:] = False  # 1.5 mm
    assert verdicts(part, passage=1.4)["passage"] == "pass"
    assert (
        verdicts(part, passage=2)["passage"] == "warn"
        and figures(part, "passage", passage=2)["far_share"] > 0.9
    )
    assert verdicts(part, passage=2)["trapped"] == "pass"


def test_cups_are_what_only_the_next_layer_opens():
    cup = block()
    cup[4:, 4:20, 4:20] = False
    # Up to the last layer the bowl is closed below and at its sides.
    assert print_layers.largest_cup(cup) == 20 * 16 * 16
    assert verdicts(cup, "sla")["cups"] == "warn" and figures(cup, "cups", "sla")["volume"] == 640
    assert verdicts(cup, "sla", cup=650)["cups"] == "pass"
    assert print_layers.largest_cup(cup[::-1]) == 0, (
        "a bell opens downwards: it is open from its first layer on"
    )
    drained = cup.copy()
    drained[4:6, 20:, 10:12] = False
    assert print_layers.largest_cup(drained) <= 16 * 16 * 2
    late = cup.copy()
    late[14, 20:, 10] = False  # a drain ten layers up: until then it is a cup
    assert 10 * 16 * 16 <= print_layers.largest_cup(late) <= 11 * 16 * 16


def test_what_starts_in_the_air():
    part = block()
    part[:10, 2:22, 12:22] = False
    assert verdicts(part, "fdm", bridge=100)["islands"] == "pass", "a ceiling is held at its side"
    part[:, 9:, 9:] = False
    part[12, 14:18, 14:18] = True
    for printer, says in (("fdm", "refuse"), ("sla", "warn")):
        assert verdicts(part, printer)["islands"] == says
    assert figures(part, "islands", "fdm") == {"islands": 1, "volume": 2.0}


@pytest.mark.parametrize(("slope", "angle"), [(0.5, 26.6), (0.8, 38.7), (1.25, 51.3), (2, 63.4)])
def test_a_slope_is_measured_at_its_angle(slope, angle):
    """Measure a wedge whose lower side leans out by `slope` voxels for every voxel up."""
    z, _, x = np.indices((30, 30, 90))
    wedge = x < 15 + slope * z
    for limit in (angle - 6, angle + 6):
        down, leaning = print_layers.overhang_area(wedge, (1.0, 1.0, 1.0), limit)
        assert leaning / down == pytest.approx(1.0 if limit < angle else 0.0, abs=0.15)
    area, _ = print_layers.overhang_area(wedge[:, 8:-8], (1.0, 1.0, 1.0), 45)
    assert area == pytest.approx(14 * 29 * np.hypot(1, slope), rel=0.12)


def test_a_ball_hangs_over_by_its_cap():
    """Measure the lower half of a ball: the share beyond 45 degrees is 1 - cos 45."""
    z, y, x = np.indices((64, 64, 64)) - 31.5
    _, leaning = print_layers.overhang_area(z**2 + y**2 + x**2 < 30**2, (1.0,) * 3, 45)
    cap = 2 * np.pi * 30**2 * (1 - np.sqrt(0.5))
    assert leaning == pytest.approx(cap, rel=0.1)


def test_voxels_that_are_not_cubes_lean_as_they_do_in_space():
    z, _, x = np.indices((40, 20, 100))
    # 26.6 degrees from the vertical: 0.5 along x for every 1 along z
    wedge = x * 0.5 < 6 + 0.5 * 2 * z
    for limit in (20, 33):
        down, leaning = print_layers.overhang_area(wedge, (2.0, 1.0, 0.5), limit)
        assert leaning / down == pytest.approx(1.0 if limit == 20 else 0.0, abs=0.15)


def test_bridges_and_overhangs():
    gate = block(40)
    gate[:20, :, 8:32] = False  # a span of 12 mm
    found = verdicts(gate, "fdm", spacing=0.5)
    assert (
        found["bridges"] == "warn" and found["overhangs"] == "warn" and found["islands"] == "pass"
    )
    assert figures(gate, "bridges", "fdm")["span"] == pytest.approx(12, abs=1)
    assert figures(gate, "overhangs", "fdm")["share"] > 0.9
    assert verdicts(gate, "fdm", bridge=13)["bridges"] == "pass"
    table = gate[::-1]
    assert worst(verdicts(table, "fdm")) == {}


def test_the_verdict_is_the_worst_and_plain_json():
    part = np.pad(block(), ((0, 0), (0, 0), (0, 24)))
    part[:4, 10:12, 24:] = True
    found = print_check(tb.Image(part, "labels", spacing=0.5, unit="mm"), printer="fdm", wall=1.6)
    plain = json.loads(json.dumps(found.to_json(), allow_nan=False))
    assert found.verdict == plain["verdict"] == plain["checks"]["walls"]["verdict"] == "refuse"
    assert plain["printer"]["wall"] == 1.6 and "passage" not in plain["printer"]
    assert (
        found.to_table().splitlines()[-1] == "fdm: refuse"
        and "thinner than 1.6 mm" in found.to_table()
    )


@pytest.mark.parametrize("printer", PRINTERS)
def test_a_part_of_one_voxel(printer):
    assert verdicts(np.ones((1, 1, 1), bool), printer, wall=2)["walls"] == "refuse"


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"printer": "slz"}, "unknown printer 'slz': did you mean"),
        ({"wal": 1}, "unknown limit of sls 'wal': did you mean 'wall'"),
        ({"bridge": 1}, "unknown limit of sls 'bridge'"),
        ({"wall": 0}, "wall=0 is outside"),
        ({"wall": "thin"}, "wall='thin' should be a number"),
        ({"box": (1, 2)}, "box=\\(1, 2\\) should be one number of millimetres, or three"),
        ({"printer": "fdm", "overhang": 91}, "overhang=91 is outside"),
    ],
)
def test_refusals(options, says):
    with pytest.raises((InputError, UnknownNameError), match=says):
        print_check(tb.Image(block(4), "labels", spacing=0.5, unit="mm"), **options)
    with pytest.raises(InputError, match="needs a volume"):
        print_check(tb.Image(np.eye(4, dtype=int), "labels", spacing=0.5, unit="mm"))
    with pytest.raises(InputError, match="nothing to print"):
        print_check(tb.Image(np.zeros((4, 4, 4), int), "labels", spacing=0.5, unit="mm"))


def rough(seed, shape=(26, 31, 22)):
    """Return a part with large pores behind narrow necks."""
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(np.random.default_rng(seed).random(shape), 2.2)
    return noise > np.quantile(noise, 0.62)


@pytest.mark.parametrize("passage", [0.6, 1.5, 3.0, 4.0, 5.5, 6.0, 9.0])
@pytest.mark.parametrize("spacing", [0.5, (0.5, 0.3, 0.7)])
def test_the_passage_does_not_depend_on_the_room_around(passage, spacing):
    """Compare the far share with one of a margin of a whole passage and more."""
    from trabecula.finish.printers import Part
    from trabecula.finish.printing import check_passage
    from trabecula.measure import label_components
    from trabecula.measure.distance import distance_transform

    edges = (spacing,) * 3 if isinstance(spacing, float) else spacing
    for seed in range(3):
        solid = rough(seed)
        solid = solid[tuple(slice(axis.min(), axis.max() + 1) for axis in np.nonzero(solid))]
        margin = [(int(np.ceil(passage / edge)) + 5,) * 2 for edge in edges]
        void = np.pad(~solid, margin, constant_values=True)
        wide = distance_transform(void, spacing=edges) - min(edges) / 2 >= passage / 2 * (1 - 1e-6)
        ways, pores = (label_components(where)[0] for where in (wide, void))
        far = (distance_transform(ways != ways[0, 0, 0], spacing=edges) > 1.5 * passage) & (
            pores == pores[0, 0, 0]
        )
        found = check_passage(Part(solid, np.pad(solid, 1), edges), passage).figures["far_share"]
        assert found == pytest.approx(far.sum() / (~solid).sum(), abs=1e-6)


@pytest.mark.parametrize("printer", PRINTERS)
@pytest.mark.parametrize(("spacing", "unit"), [(1.0, "nm"), (1.0, "um"), (0.5, "mm"), (0.5, "m")])
def test_memory_is_that_of_the_part_whatever_its_unit(printer, spacing, unit):
    """Check a passage of a million voxels of a nanometre: a margin would hold 10**18 of them."""
    import tracemalloc

    image = tb.Image(rough(1), "labels", spacing=spacing, unit=unit)
    print_check(image, printer=printer)  # kernels
    tracemalloc.start()
    try:
        found = print_check(image, printer=printer)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 400 * image.values.size
    # Nothing is trapped beyond the reach of a passage that is larger than the part.
    assert unit in ("mm", "m") or all(
        finding.verdict == "pass" for finding in found.findings if finding.name == "passage"
    )


def test_the_budget_of_a_check_names_what_check_has():
    with pytest.raises(
        tb.errors.MemoryBudgetError,
        match=r"check a crop \(--crop N\), or a coarser level .* or raise --memory",
    ):
        print_check(tb.Image(rough(1), "labels", 0.5, "mm"), memory=1 << 16)


def test_an_island_is_no_bridge():
    solid = np.zeros((3, 12, 12), bool)
    solid[0], solid[2, 2:9, 2:9] = True, True
    assert print_layers.longest_reach(solid, (1.0, 1.0, 1.0)) == 0


def test_a_dimple_of_one_layer_holds_nothing_when_the_next_is_printed():
    block = np.ones((4, 6, 6), bool)
    block[3, 2:4, 2:4] = False
    assert print_layers.largest_cup(block) == 0
    block[2, 2:4, 2:4] = False
    assert print_layers.largest_cup(block) == 8


def test_a_form_is_all_but_the_void():
    form = tb.Image(np.array([[[0, 1, 2]]]), "labels", phases=("bone", "void", "binder"))
    assert as_form(form, (1, 1, 3)).tolist() == [[[True, False, True]]]

"""`texture`: forms, periodic and fixed parts of a request, several exemplars, grey and colour."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError, RequestError
from trabecula.synth.shared.content.fields import FULL
from trabecula.synth.shared.matching import sources
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.rounds import refine_field
from trabecula.synth.shared.matching.sources import Candidates, Stack, carry_matches
from trabecula.synth.shared.pyramid import halve

QUICK = {"novelty": 0, "rounds": (2, 3), "first_rounds": 8, "sweeps": 1, "tries": 2}


@pytest.fixture(scope="module")
def bone():
    return tb.crop(tb.sample("bone"), 48)


@pytest.fixture(scope="module")
def model(bone):
    return tb.method("texture", novelty=0).fit(bone)


@pytest.fixture(scope="module")
def new(bone):
    return tb.method("texture", novelty=1).fit(bone)


def labels(values, like):
    return tb.Image(values, "labels", like.spacing, like.unit, like.phases)


def misfit(exemplar, image):
    """Distance of every voxel's neighbourhood to the nearest in the exemplar; NaN where none was
    looked for.
    """
    distance = tb.measure.sources(exemplar, image).distance.astype(float)
    return np.where(distance < 0, np.nan, distance)


@pytest.mark.whole
@pytest.mark.parametrize("novelty", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_a_periodic_tile_repeats_without_a_seam(bone, novelty):
    side, margin = 56, 16
    model = tb.method("texture", novelty=novelty).fit(bone)
    tile = model.generate(side, seed=3, periodic=(True, False, True))
    around = np.pad(tile.values, [(margin, margin), (0, 0), (margin, margin)], mode="wrap")
    found = misfit(bone, labels(around, bone))
    z, _, x = np.indices(around.shape)
    joint = np.isin(z, (margin - 1, margin, margin + side - 1, margin + side))
    joint |= np.isin(x, (margin - 1, margin, margin + side - 1, margin + side))
    assert np.nanmean(found[joint]) <= 1.1 * np.nanmean(found[~joint])
    steps = np.mean(np.diff(tile.values.astype(int), axis=0) != 0)
    assert np.mean(tile.values[0] != tile.values[-1]) < 2 * steps


@pytest.mark.whole
def test_a_form_is_filled_and_nothing_lies_outside(bone, model, new):
    z, y, x = np.indices((60, 50, 56))
    ball = (z - 30) ** 2 + (y - 25) ** 2 + (x - 28) ** 2 < 23**2
    for made in (model, new):
        part = made.generate(ball.shape, seed=1, mask=ball).values
        assert not part[~ball].any()
        assert np.count_nonzero(part) == round(np.count_nonzero(ball) * bone.values.mean())


@pytest.mark.whole
def test_material_is_flush_to_the_surface_of_its_form(model):
    """A slab: the share of solid in its outermost planes is that within, over six seeds (their mean
    scatters by a tenth).
    """
    slab = np.zeros((60, 40, 40), bool)
    slab[15:45] = True
    profile = np.mean(
        [model.generate(slab.shape, seed=s, mask=slab).values.mean(axis=(1, 2)) for s in range(6)],
        axis=0,
    )
    rim = np.concatenate([profile[15:18], profile[42:45]])
    assert rim.mean() == pytest.approx(profile[20:40].mean(), rel=0.25)


@pytest.mark.whole
def test_a_form_without_room_for_a_neighbourhood_is_refused(model):
    sheet = np.zeros((40, 40, 40), bool)
    sheet[20:25] = True
    with pytest.raises(RequestError, match="room for a neighbourhood of 8"):
        model.generate(40, mask=sheet)


@pytest.mark.whole
def test_fixed_voxels_stay_and_what_is_made_joins_them(bone):
    whole = tb.sample("bone")
    bone, scan = (
        labels(whole.values[46:, 46:, 46:], bone),
        labels(whole.values[:50, :50, :50], bone),
    )
    model = tb.method("texture", novelty=0).fit(bone)
    known = np.ones(scan.shape, bool)
    known[13:37, 13:37, 13:37] = False
    repaired = model.generate(scan.shape, seed=3, fixed=scan, known=known)
    assert np.array_equal(repaired.values[known], scan.values[known])
    assert not np.array_equal(repaired.values, scan.values)
    pasted = np.where(known, scan.values, model.generate(scan.shape, seed=3).values)

    face = np.zeros((2, 50, 50), bool)
    face[:, 13:37, 13:37] = True

    def steps(values):
        """Share of neighbouring voxels that differ across the faces of the hole."""
        turned = [np.moveaxis(values, axis, 0) for axis in range(3)]
        return np.mean([np.mean(v[[12, 36]] != v[[13, 37]], where=face) for v in turned])

    real, joint, cut = (steps(values) for values in (scan.values, repaired.values, pasted))
    assert joint <= 1.3 * real
    assert cut > 2 * real
    # Nor are neighbourhoods on the joint farther from the exemplar's than those of the scan itself.
    shell = np.zeros(scan.shape, bool)
    shell[11:39, 11:39, 11:39] = True
    shell[15:35, 15:35, 15:35] = False
    assert np.nanmean(misfit(bone, repaired)[shell]) <= 1.1 * np.nanmean(misfit(bone, scan)[shell])


@pytest.mark.whole
def test_fixed_voxels_of_a_phase_that_the_exemplar_lacks_are_refused(model):
    strange = tb.Image(
        np.full((40, 40, 40), 2, np.uint8), "labels", phases=("void", "bone", "cement")
    )
    known = np.zeros((40, 40, 40), bool)
    known[:10] = True
    with pytest.raises(RequestError):
        model.generate(40, fixed=strange, known=known)


def test_several_exemplars_are_one_list_of_neighbourhoods(monkeypatch):
    rng = np.random.default_rng(0)
    fields = [
        rng.integers(-9, 9, (1, *shape)).astype(np.int8)
        for shape in ((14, 12, 16), (12, 15, 13), (20, 12, 12))
    ]
    coarse = [
        rng.integers(-9, 9, (1, *((s + 1) // 2 for s in field.shape[1:]))).astype(np.int8)
        for field in fields
    ]
    stacks = [Stack.of(coarse), Stack.of(fields)]
    old, new = (Candidates.of(stack, width=4, step=2, variance=0.9, most=8) for stack in stacks)
    assert new.allowed.sum() == sum(np.prod([s - 3 for s in field.shape[1:]]) for field in fields)
    for number in rng.choice(new.numbers, 20):
        z, y, x = (int(c) for c in corners(new, number))
        volume = int(np.searchsorted(stacks[1].starts, z, side="right")) - 1
        local = z - int(stacks[1].starts[volume])
        block = stacks[1].field[:, z : z + 4, y : y + 4, x : x + 4]
        assert np.array_equal(block, fields[volume][:, local : local + 4, y : y + 4, x : x + 4])
    match = rng.choice(old.numbers, (3, 4, 5)).astype(np.int32)
    narrow = Candidates.of(stacks[0], width=5, step=1, variance=0.9, most=8)
    monkeypatch.setattr(sources, "_MANY", 0)
    sparse = Candidates.of(stacks[1], width=4, step=2, variance=0.9, most=8)
    assert sparse.stride == 2
    for factor, there in ((2, new), (1, narrow), (2, sparse)):
        moved = carry_matches(match, old, there, (7, 8, 9), factor=factor)
        assert there.allowed[moved].all()
        assert np.array_equal(moved, carried_over(match, old, there, (7, 8, 9), factor))


def corners(candidates, match):
    """The first voxel of each candidate in the stack."""
    cells = np.unravel_index(match, candidates.shape)
    return [cell * stride for cell, stride in zip(cells, candidates.strides, strict=True)]


def carried_over(match, old, new, grid, factor):
    """Site by site: the corner that belongs there, moved into the same volume and onto the grid of
    candidates.
    """
    moved = np.empty(grid, int)
    for place in np.ndindex(grid):
        corner = np.array(place) * new.steps
        site = np.minimum(corner // (factor * np.array(old.steps)), np.array(match.shape) - 1)
        first = np.array(corners(old, match[tuple(site)]))
        volume = max(n for n, start in enumerate(old.stack.starts) if start <= first[0])
        first[0] -= old.stack.starts[volume]
        wanted = factor * (first - site * old.steps) + corner
        wanted = np.clip(wanted, 0, new.stack.sides[volume] - new.basis.box)
        cell = wanted // new.strides
        cell[0] = (wanted[0] + new.stack.starts[volume]) // new.strides[0]
        # A stride that does not divide a volume's start: the cell before it belongs to the volume
        # below.
        cell[0] = max(cell[0], -(-new.stack.starts[volume] // new.strides[0]))
        moved[place] = np.ravel_multi_index(tuple(cell), new.shape)
    return moved


def test_two_exemplars_both_lend_their_structures():
    """One with layers across z, one with layers across y: the result holds both, no third kind."""
    z, y, _ = np.indices((40, 40, 40))
    across_z, across_y = ((z // 5 % 2).astype(np.uint8), (y // 5 % 2).astype(np.uint8))
    material = tb.method("texture", **QUICK).fit([across_z, across_y]).generate(64, seed=0).values
    faces = [np.mean(np.diff(material.astype(int), axis=axis) != 0) for axis in range(3)]
    assert faces[0] > 0.02
    assert faces[1] > 0.02
    assert faces[2] < 0.5 * min(faces[:2])


def test_exemplars_that_differ_are_refused(bone):
    other = tb.Image(
        bone.values,
        "labels",
        spacing=(2 * s for s in bone.spacing),
        unit=bone.unit,
        phases=bone.phases,
    )
    with pytest.raises(InputError, match="agree in spacing"):
        tb.method("texture").fit([bone, other])
    with pytest.raises(InputError, match="one exemplar"):
        tb.method("noise").fit([bone, bone])


@pytest.mark.whole
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_grey_comes_out_with_its_whole_histogram(bone, dtype):
    rng = np.random.default_rng(0)
    smooth = bone.values[:32, :32, :32] * 160.0 + rng.normal(40, 12, (32, 32, 32))
    values = smooth.clip(0, 255).astype(dtype) * (dtype(7) if dtype == np.uint16 else dtype(1))
    grey = tb.Image(values, "grey")
    made = tb.method("texture", **QUICK).fit(grey).generate(40, seed=1)
    assert made.values.dtype == dtype
    places = np.linspace(0.01, 0.99, 50)
    wanted, found = np.quantile(values, places), np.quantile(made.values, places)
    assert np.abs(found - wanted).max() <= 0.02 * float(np.ptp(values))
    # Grain: a mean of neighbourhoods would lose the noise within the void.
    assert (
        np.abs(np.diff(made.values.astype(float), axis=2)).mean()
        > 0.6 * np.abs(np.diff(values.astype(float), axis=2)).mean()
    )


@pytest.mark.whole
def test_colours_stay_the_exemplars(bone):
    solid = bone.values[:32, :32, :32, None].astype(bool)
    values = np.where(solid, np.array([230, 210, 160]), np.array([120, 30, 20])).astype(np.uint8)
    made = tb.method("texture", **QUICK).fit(tb.Image(values, "colour")).generate(36, seed=2)
    assert made.kind == "colour"
    assert made.values.shape == (36, 36, 36, 3)
    near = (
        np.abs(made.values[..., None, :].astype(int) - np.array([[230, 210, 160], [120, 30, 20]]))
        .max(-1)
        .min(-1)
    )
    assert np.mean(near == 0) > 0.97, "channels agree on the colour"


@pytest.mark.parametrize("wraps", [(False,) * 3, (True, False, True)])
def test_a_site_is_active_where_its_neighbourhood_holds_a_free_voxel(wraps):
    rng = np.random.default_rng(4)
    free = rng.random((13, 14, 15)) < 0.004
    region = Region(free.shape, wraps, free)
    cubes = {"box": (6,) * 3, "steps": (2,) * 3}
    grid = region.grid(**cubes)
    covered = region.cover(**cubes)
    active = covered.active(grid, **cubes)
    for site in np.ndindex(grid):
        cells = [
            np.arange(s * 2, s * 2 + 6) % side if wrap else np.arange(s * 2, s * 2 + 6)
            for s, side, wrap in zip(site, covered.shape, wraps, strict=True)
        ]
        assert active[site] == covered.free[np.ix_(*cells)].any()


@pytest.mark.whole
def test_rounds_by_energy_tell_their_trace(bone):
    """Equation (1) falls, the last round of a level changes it by less than the tolerance, and the
    recipe tells so.
    """
    exemplar = tb.crop(bone, 32)
    method = tb.method(
        "texture", gradient=0.5, adaptive=True, tolerance=0.01, first_rounds=12, rounds=(12,)
    )
    levels = method.fit(exemplar).generate(36, seed=1).recipe.steps[-1]["report"]["levels"]
    assert [level["level"] for level in levels] == sorted(
        (level["level"] for level in levels), reverse=True
    )
    for level in levels:
        robust = [round_["robust"] for round_ in level["energy"]]
        assert robust[-1] < robust[0]
        if len(robust) < 12:
            assert abs(robust[-1] - robust[-2]) <= 0.01 * robust[-2]


@pytest.mark.whole
@pytest.mark.parametrize(
    "settings", [{"search": "exact"}, {"gradient": 0.3}, {"search": "exact", "adaptive": True}]
)
def test_the_papers_pieces_honour_every_part(bone, settings):
    exemplar = tb.crop(bone, 28)
    model = tb.method("texture", first_rounds=4, rounds=(2,), **settings).fit(exemplar)
    form = np.ones((30, 30, 30), bool)
    form[:, :, 20:] = False
    known = np.zeros((30, 30, 30), bool)
    known[:12, 4:26] = True
    scan = labels(bone.values[:30, :30, :30], bone)
    made = model.generate(
        30, seed=2, mask=form, fixed=scan, known=known, periodic=(False, True, False)
    ).values
    assert np.array_equal(made[known], scan.values[known])
    assert not made[~form & ~known].any()
    share = made[form & ~known].mean()
    assert 0.5 * exemplar.values.mean() < share < 2 * exemplar.values.mean()


@pytest.mark.whole
def test_the_exact_search_finds_nearer_neighbourhoods_than_the_coherent_one(bone):
    exemplar = tb.crop(bone, 28)
    fits = {}
    for search in ("coherent", "exact"):
        model = tb.method(
            "texture", search=search, novelty=0, levels=1, first_rounds=6, tolerance=1e-9
        ).fit(exemplar)
        trace = model.generate(36, seed=3).recipe.steps[-1]["report"]["levels"][0]["energy"]
        fits[search] = trace[1]["squares"]
    assert fits["exact"] < fits["coherent"]


@pytest.mark.whole
def test_mirrored_copies_are_learnt_from():
    """Teeth that all rise to the right: the interface lies along one diagonal, and with mirrors
    along both.
    """
    y, x = np.indices((32, 32))
    teeth = np.zeros((32, 32, 32), np.uint8)
    teeth[:] = (x % 8) > (y % 8)

    def leaning(values):
        along = np.mean(values[:, 1:, 1:] != values[:, :-1, :-1])
        across = np.mean(values[:, 1:, :-1] != values[:, :-1, 1:])
        return across / along

    models = {
        which: tb.method("texture", orientations=which, **QUICK).fit(teeth)
        for which in ("none", "mirrors")
    }
    assert len(models["mirrors"].stacks[0].starts) == 8
    leans = {which: leaning(model.generate(48, seed=1).values) for which, model in models.items()}
    assert leaning(teeth) > 2
    assert leans["none"] > 1.6
    assert 0.7 < leans["mirrors"] < 1.4


@pytest.mark.whole
def test_new_material_copies_no_more_than_an_independent_sample_does(bone):
    """The dial's ends. Parts of a real scan have coherence(4) of .03 to .08 with each other."""
    exemplar = labels(bone.values[:, :, :40], bone)
    copied = {}
    for novelty in (0, 1):
        made = tb.method("texture", novelty=novelty).fit(exemplar).generate(64, seed=1)
        copied[novelty] = tb.measure.coherence(exemplar, made, k=4, samples=300)[4]
        assert tb.measure.largest_fraction(made) > 0.97
    assert copied[0] > 0.3
    assert copied[1] < 0.15


def test_novelty_goes_with_labels_and_our_search_alone(bone):
    for settings in (
        {"search": "exact"},
        {"gradient": 0.1},
        {"field": "indicator"},
        {"histogram": False},
    ):
        with pytest.raises(InputError, match="novelty=0"):
            tb.method("texture", novelty=0.5, **settings).fit(bone)
        assert tb.method("texture", **settings).config.novelty_for(labels=True) == 0
    grey = tb.Image(bone.values * np.uint8(90), "grey")
    with pytest.raises(InputError, match="novelty"):
        tb.method("texture", novelty=0.5, layout="coarse").fit(grey)
    coarse = tb.method("texture", layout="coarse").config
    assert (coarse.novelty_for(labels=True), coarse.novelty_for(labels=False)) == (1, 0)


def test_distances_count_in_the_voxels_of_their_level(bone):
    """A distance halves with the resolution, and doubles again when the field is refined."""
    model = tb.method("texture", novelty=0.0, levels=2, clip=10.0).fit(bone)
    field = model.content.fields(bone)
    for index in range(2):
        wanted = np.rint(np.clip(field / 2**index, -10, 10) * (FULL / 10))
        found = model.levels[index][0].stack.field
        assert np.abs(found - wanted).max() <= 1
        field = halve(field)
    ramp = np.broadcast_to(np.arange(-20, 20, dtype=np.int8)[:, None, None], (1, 40, 3, 3))
    fine = refine_field(ramp, (False,) * 3, distances=True)[0, :, 2, 2]
    assert np.abs(fine - (2 * (np.arange(80) / 2 - 20.25))).max() <= 1.5
    grey = refine_field(ramp, (False,) * 3, distances=False)[0, :, 2, 2]
    assert np.abs(grey - (np.arange(80) / 2 - 20.25)).max() <= 1

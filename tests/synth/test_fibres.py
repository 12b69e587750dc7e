"""`fibres`: directions, thicknesses and places of fibres against what is known of them, and what is
refused.
"""

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.errors import InputError, RequestError
from trabecula.synth.fibres.laying import Laid, _averaged, _drawn_ways, draw_fibres, lay
from trabecula.synth.fibres.strands import Strands, find_strands

SIDE = 72
CUBE = np.ones(3)
ALONG_X = np.array([[0.0, 0.0, 1.0]])


def cylinders(through, ways, radii, side=SIDE):
    """Return a volume of labels with endless straight cylinders."""
    at = np.stack(np.indices((side,) * 3), -1).astype(float)
    inside = np.zeros((side,) * 3, bool)
    for place, way, radius in zip(through, ways, radii, strict=True):
        off = at - place
        inside |= (off**2).sum(-1) - (off @ (way / np.linalg.norm(way))) ** 2 < radius**2
    return tb.Image(inside.astype(np.uint8), "labels")


def strands_of(*radii, directions=ALONG_X, fraction=0.2):
    return Strands(np.asarray(directions), np.array(radii, float), fraction, 1.0)


def laid_of(strands, side=60, seed=0, **settings):
    given = {"separation": 1.0, "bend": 0.0, "share": strands.fraction, "length": 1.0} | settings
    return lay(strands, (float(side),) * 3, seed=seed, quiet=True, **given)


@pytest.fixture(scope="module")
def felt():
    """Fibres of one thickness, most of them near a plane across z."""
    draw = np.random.default_rng(0)
    angles = draw.uniform(0, np.pi, 26)
    ways = np.stack([draw.normal(0, 0.1, 26), np.cos(angles), np.sin(angles)], axis=1)
    return cylinders(draw.uniform(0, SIDE, (26, 3)), ways, np.full(26, 2.6))


@pytest.fixture(scope="module")
def model(felt):
    return tb.method("fibres", separation=0.4, fillet=0.0, bend=0.0).fit(felt)


def test_directions_and_thickness_of_a_cylinder_are_found():
    way = np.array([0.4, 0.5, 0.77])
    found = find_strands(cylinders([(36, 36, 36)], [way], [3.0]), 1)
    cosine = np.abs(found.directions @ (way / np.linalg.norm(way)))
    assert np.quantile(cosine, 0.1) > np.cos(np.radians(5))
    assert found.radii.mean() == pytest.approx(3, abs=0.25)
    assert found.clarity > 0.6


def test_voxels_are_three_times_as_long_along_z_and_the_cylinder_is_still_round():
    at = np.stack(np.indices((24, 72, 72)), -1) * (3.0, 1.0, 1.0)
    off = at - (36, 36, 36)
    inside = (off**2).sum(-1) - off[..., 2] ** 2 < 6.0**2
    image = tb.Image(inside.astype(np.uint8), "labels", spacing=(3.0, 1.0, 1.0))
    found = find_strands(image, 1)
    assert np.median(np.abs(found.directions[:, 2])) > 0.99
    assert found.radii.mean() == pytest.approx(6, abs=0.8)


@pytest.mark.whole
def test_noise_of_voxels_is_no_difference_between_fibres_and_two_sizes_are():
    draw = np.random.default_rng(2)
    cells = np.stack(np.indices((5, 5)), -1).reshape(-1, 2) * 14 + 8
    through = np.concatenate([np.zeros((25, 1)), cells], axis=1)
    ways = np.concatenate([np.ones((25, 1)), draw.normal(0, 0.04, (25, 2))], axis=1)
    one = find_strands(cylinders(through, ways, np.full(25, 3.0)), 1)
    two = find_strands(cylinders(through, ways, np.where(np.arange(25) % 2, 2.0, 4.5)), 1)
    assert one.radii.std() < 0.2
    assert two.radii.std() > 0.7
    assert two.weights[two.radii < 3].sum() == pytest.approx(0.5, abs=0.15)


def test_two_sizes_differ_along_the_longer_edges_of_voxels_too():
    at = np.stack(np.indices((40, 72, 72)), -1) * (3.0, 1.0, 1.0)
    inside = np.zeros(at.shape[:3], bool)
    for number, (y, x) in enumerate(np.ndindex(3, 3)):
        off = at[..., 1:] - (12 + 24 * y, 12 + 24 * x)
        inside |= (off**2).sum(-1) < (8.0 if number % 2 else 4.0) ** 2
    image = tb.Image(inside.astype(np.uint8), "labels", spacing=(3.0, 1.0, 1.0))
    assert find_strands(image, 1).radii.std() > 1


def test_as_much_is_laid_as_is_asked_for_in_chains_of_even_steps():
    strands = strands_of(2.0, 3.0, directions=np.eye(3), fraction=0.15)
    made = laid_of(strands, side=80, separation=0.8)
    steps = np.linalg.norm(np.diff(made.places, axis=1), axis=2)
    length = steps.sum(axis=1)
    assert (np.pi * made.radii**2 * length).sum() == pytest.approx(0.15 * 80**3, rel=0.12)
    np.testing.assert_allclose(steps, 0.8 * strands.weights @ strands.radii, rtol=0.5)
    assert made.lacking < 0.01
    assert np.bincount(np.searchsorted([2.0, 3.0], made.radii)).min() > 0.2 * len(made.radii)


@pytest.mark.parametrize("separation", [0.5, 1.0])
def test_fibres_keep_their_distance_and_pass_through_each_other_where_none_is_asked_for(separation):
    ways = np.random.default_rng(1).standard_normal((50, 3))
    strands = strands_of(2.5, directions=ways / np.linalg.norm(ways, axis=1, keepdims=True))

    def nearest(made):
        flat = made.places.reshape(-1, 3)
        owner = np.repeat(np.arange(len(made.radii)), made.places.shape[1])
        off = flat[:, None] - flat
        off -= made.sides * np.rint(off / made.sides)
        length = np.sqrt((off**2).sum(-1))
        length[owner[:, None] == owner] = np.inf
        return np.quantile(length.min(axis=1), 0.02)

    kept = nearest(laid_of(strands, side=50, separation=separation))
    free = nearest(laid_of(strands, side=50, separation=0.0))
    assert kept > 0.8 * 2 * 2.5 * separation
    assert free < 1.5


def test_straight_fibres_are_straight_and_others_wander_about_their_direction():
    straight = laid_of(strands_of(2.0, fraction=0.05), separation=0.0)
    way = np.diff(straight.places, axis=1)
    np.testing.assert_allclose(np.abs(way[..., 2]), np.linalg.norm(way, axis=2))
    bent = np.diff(laid_of(strands_of(2.0, fraction=0.05), separation=0.0, bend=0.4).places, axis=1)
    bent /= np.linalg.norm(bent, axis=2, keepdims=True)
    across = np.sqrt((bent[..., :2] ** 2).sum(-1).mean())
    assert across == pytest.approx(0.5, abs=0.12)
    turn = np.arccos(np.clip((bent[:, 1:] * bent[:, :-1]).sum(-1), -1, 1))
    assert np.median(turn) < 0.25


def test_moves_are_means_over_a_window_and_not_too_far():
    moves = np.zeros((2, 20, 3))
    moves[0, 10] = (0, 0.9, 0)
    moves[1] = (0, 0, 9.0)
    found = _averaged(moves, 5)
    np.testing.assert_allclose(found[0, 6:15, 1], 0.036 * np.array([1, 2, 3, 4, 5, 4, 3, 2, 1]))
    np.testing.assert_allclose(found[0, :6], 0, atol=1e-12)
    np.testing.assert_allclose(found[0, 15:], 0, atol=1e-12)
    np.testing.assert_allclose(found[1], np.broadcast_to((0, 0, 0.5), (20, 3)))


def test_few_directions_that_are_drawn_have_the_moments_of_all():
    ways = np.random.default_rng(0).standard_normal((3000, 3)) * (0.3, 1.0, 0.6)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    every = ways.T @ ways / len(ways)
    off = []
    for seed in range(8):
        few = _drawn_ways(ways, 60, np.random.default_rng(seed))
        off.append(np.abs(few.T @ few / 60 - every).max())
    assert np.mean(off) < 0.035
    assert len(np.unique(few, axis=0)) == 60


def test_a_drawn_fibre_is_as_deep_as_its_radius_less_the_distance_to_its_axis():
    places = np.array([[[12.0, 12.0, 6.0], [12.0, 12.0, 12.0], [12.0, 12.0, 18.0]]])
    laid = Laid(places, np.array([3.0]), np.full(3, 24.0), 0.0)
    depth = draw_fibres(laid, (24, 24, 24), CUBE, 0.0)
    at = np.stack(np.indices((24, 24, 24)), -1) + 0.5
    nearest = np.stack(
        [np.full_like(at[..., 2], 12), np.full_like(at[..., 2], 12), np.clip(at[..., 2], 6, 18)], -1
    )
    length = np.sqrt(((at - nearest) ** 2).sum(-1))
    near = length < 5
    np.testing.assert_allclose(depth[near], 3 - length[near], atol=1e-5)
    assert depth.min() == -4.5


def test_a_part_of_the_box_is_drawn_as_in_the_whole_with_a_fillet_too():
    made = laid_of(strands_of(2.0, directions=np.eye(3)), side=32, bend=0.2)
    for fillet in (0.0, 1.2):
        whole = draw_fibres(made, (64, 32, 32), CUBE, fillet)
        np.testing.assert_array_equal(whole[:32], whole[32:])
        part = draw_fibres(made, (20, 9, 13), CUBE, fillet)
        np.testing.assert_array_equal(part, whole[:20, :9, :13])


@pytest.mark.whole
def test_what_is_laid_has_the_directions_shapes_and_fraction_of_the_felt(felt, model):
    made = model.generate(SIDE, seed=1)
    assert abs(int(made.values.sum()) - round(float(felt.values.mean()) * SIDE**3)) <= 1
    shares = [tb.measure.shape_index(one, phase=1) for one in (felt, made)]
    assert np.linalg.norm(shares[0] - shares[1]) < 0.3 * np.linalg.norm(shares[0])
    assert tb.measure.thickness(made) == pytest.approx(tb.measure.thickness(felt), rel=0.1)
    tensors = [find_strands(one, 1).directions for one in (felt, made)]
    moments = [ways.T @ ways / len(ways) for ways in tensors]
    np.testing.assert_allclose(moments[1][0, 0], moments[0][0, 0], atol=0.04)


@pytest.mark.whole
def test_a_target_has_more_or_fewer_fibres_and_its_fraction(model):
    counts = {}
    for porosity in (0.8, 0.9):
        made = model.generate(48, seed=1, target={"porosity": porosity})
        assert (made.values == 0).mean() == pytest.approx(porosity, abs=1e-4)
        counts[porosity] = made.recipe.to_json()[-1]["report"]["fibres"]
    assert counts[0.8] > 1.5 * counts[0.9]


@pytest.mark.whole
def test_bends_are_tried_as_long_as_they_help(felt, monkeypatch):
    from trabecula.synth.fibres import method as module
    from trabecula.synth.shared.packed.trials import Packed

    scores, tried = iter([2.0, 1.5, 1.7]), []

    def chosen(self, image, label, figures, strands, bend, separations=module._SEPARATIONS):
        tried.append((bend, separations))
        return Packed(0.4, 0.5, next(scores))

    monkeypatch.setattr(module.Fibres, "_chosen", chosen)
    found = tb.method("fibres").fit(felt)
    assert [bend for bend, _ in tried] == [0.0, 0.1, 0.25]
    assert tried[1][1] == (0.6, 0.4)
    assert found.bend == 0.1


@pytest.mark.whole
def test_what_is_no_fibre_is_refused_with_a_way_out(felt, model):
    with pytest.raises(InputError, match="no phase of the exemplar is of long fibres"):
        tb.method("fibres").fit(tb.sample("foam"))
    with pytest.raises(InputError, match="no phase of the exemplar: it has"):
        tb.method("fibres", phase="wool").fit(felt)
    with pytest.raises(RequestError, match="repeats after 4"):
        model.generate((4, 32, 32), periodic=(True, False, False))
    for name, value in (("bend", 2.0), ("separation", -1.0), ("length", 0.0)):
        with pytest.raises(InputError, match=name):
            tb.method("fibres", **{name: value})


@pytest.mark.whole
def test_what_is_off_is_said(felt):
    told = []
    thick = tb.method("fibres", separation=0.0, fillet=3.0, bend=0.9).fit(felt)
    with tb.progress(lambda label, fraction: told.append(label)):
        made = thick.generate(48, seed=1)
    assert any("off beyond the exemplar's own spread" in line for line in told)
    assert made.recipe.to_json()[-1]["report"]["figures"]["thickness"]["off"]

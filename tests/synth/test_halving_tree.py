"""The tree of halves: its leaves, where a neighbourhood would be in it, and the search there."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.seeds import key
from trabecula.synth.shared.matching.grid import Grid, coherent_search, random_matches
from trabecula.synth.shared.matching.grid import features_of as features_of_sites
from trabecula.synth.shared.matching.halving_tree import build_tree, find_leaf
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.matching.sweeps import search_leaves

GRID = (3, 4, 5)


def features_of(count, depth=9, seed=0, spread=1000):
    """Features that are longest along the first components, as principal ones are."""
    rng = np.random.default_rng(seed)
    return (rng.normal(size=(count, depth)) * spread / (1 + np.arange(depth))).astype(np.int16)


def leaves_of(tree):
    return [tree.order[a:b] for a, b in zip(tree.starts[:-1], tree.starts[1:], strict=True)]


def walked(row, tree):
    """The leaf of one feature vector, branch by branch."""
    place, depth = 0, (len(tree.axes) + 1).bit_length() - 1
    for level in range(depth):
        branch = 2**level - 1 + place
        place = 2 * place + int(row[tree.axes[branch]] >= tree.cuts[branch])
    return place


@pytest.mark.parametrize("count", [1, 15, 16, 31, 32, 33, 500, 1024])
def test_every_candidate_is_in_one_leaf_of_16_to_32(count):
    numbers = np.arange(3, 3 + 2 * count, 2)
    tree = build_tree(features_of(3 + 2 * count), numbers)
    assert np.array_equal(np.sort(tree.order), numbers)
    sizes = [len(leaf) for leaf in leaves_of(tree)]
    assert max(sizes) <= 32
    assert min(sizes) >= min(16, count)
    assert max(sizes) - min(sizes) <= 1
    assert len(tree.axes) == len(tree.cuts) == len(sizes) - 1


def test_a_candidate_is_found_in_its_leaf():
    features = features_of(700)
    tree = build_tree(features, np.arange(700))
    at = np.empty(700, int)
    for place, leaf in enumerate(leaves_of(tree)):
        at[leaf] = place
    rows = features[None, None]
    found = [find_leaf(rows, (0, 0, n), tree.axes, tree.cuts) for n in range(700)]
    assert found == [walked(row, tree) for row in features]
    # but for those that equal a cut, which may be on either side of it
    assert np.mean(np.array(found) == at) > 0.95


def test_halves_lie_on_their_sides_of_the_cut_of_the_widest_feature():
    features = features_of(64)
    tree = build_tree(features, np.arange(64))
    assert tree.axes[0] == features.astype(float).var(0).argmax()
    left = tree.order[: tree.starts[2]]
    right = tree.order[tree.starts[2] :]
    values = features[:, tree.axes[0]]
    assert len(left) == len(right) == 32
    assert values[left].max() <= tree.cuts[0] == values[right].min()


def test_equals_are_halved_too():
    """A phase that saturates has thousands of equals: no leaf grows with them."""
    features = np.zeros((400, 4), np.int16)
    features[350:] = features_of(50, 4)
    tree = build_tree(features, np.arange(400))
    assert max(len(leaf) for leaf in leaves_of(tree)) <= 32


def test_the_search_finds_what_numpy_finds_in_the_leaf():
    exemplar, sites = features_of(300, seed=1), features_of(60, seed=2).reshape(*GRID, 9)
    rng = np.random.default_rng(3)
    penalty = (1 + rng.random(300)).astype(np.float32)
    penalty[::7] = np.inf
    allowed = np.flatnonzero(np.isfinite(penalty))
    old = rng.choice(allowed, GRID).astype(np.int32)
    active = rng.random(GRID) < 0.8
    tree = build_tree(exemplar, allowed)
    match = np.full(GRID, -1, np.int32)
    search_leaves(sites[1:], 1, exemplar, penalty, tree, active, old, match, 1, 3)

    assert (match[0] == -1).all()  # not of its planes
    moved = 0
    for site in np.ndindex(2, *GRID[1:]):
        z, y, x = site[0] + 1, site[1], site[2]
        own = old[z, y, x]
        if not active[z, y, x]:
            assert match[z, y, x] == own
            continue
        row = sites[z, y, x]
        among = [own, *leaves_of(tree)[walked(row, tree)]]
        apart = ((row.astype(int) - exemplar[among].astype(int)) ** 2).sum(1)
        cost = apart.astype(np.float32) * penalty[among]
        assert match[z, y, x] == among[int(cost.argmin())]
        moved += match[z, y, x] != own
    assert moved > 10


@pytest.mark.whole
def test_a_search_by_leaves_is_nearer_than_one_by_sweeps_alone():
    """From random matches, on a field that the exemplar does not hold."""
    image = tb.crop(tb.sample("bone"), 48)
    model = tb.method("texture").fit(image)
    candidates = model.aims[1].candidates[0]
    field = model.aims[1].stack.field[:, ::-1, :, ::-1].copy()
    grid = Grid.over(Region(field.shape[1:], (True,) * 3), candidates)
    start = random_matches(grid, key(0, "start"))
    apart = {
        by_leaves: coherent_search(
            grid,
            start,
            field,
            stage=key(0, "search"),
            first=1,
            count=2,
            tries=4,
            index_penalty=0.0,
            by_leaves=by_leaves,
        )
        for by_leaves in (False, True)
    }
    for match, distance in apart.values():
        own = candidates.features[match].astype(int) - features_of_sites(grid, field)
        assert np.array_equal((own**2).sum(-1), distance)
    assert apart[True][1].mean() < 0.8 * apart[False][1].mean()

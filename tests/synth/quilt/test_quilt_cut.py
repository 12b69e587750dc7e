"""The seam against SciPy's maximum flow on the same graph, built here from its definition."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import maximum_flow

from trabecula.synth.quilt.canvas import EMPTY, FIXED, OUT
from trabecula.synth.quilt.seams import ALL, LEAST, MOST, _fill_path, cut_in

MARGIN = 1
HUGE = 10**6


def scene(seed, shape, *, labels=2, held=0.0):
    """Return a window whose lower corner region is made, and a patch for its box."""
    rng = np.random.default_rng(seed)
    margin = tuple(0 if side == 1 else MARGIN for side in shape)
    window = np.full(
        tuple(side + 2 * m for side, m in zip(shape, margin, strict=True)), EMPTY, np.uint8
    )
    overlap = rng.integers(1, max(shape) // 2 + 1)
    at = np.indices(window.shape)
    made = np.zeros(window.shape, bool)
    for axis in range(3):
        made |= (
            (at[axis] < overlap + margin[axis])
            & (shape[axis] > 1)
            & bool(rng.integers(0, 2) or axis == 2)
        )
    window[made] = rng.integers(0, labels, made.sum())
    window[made & (rng.random(window.shape) < held)] += FIXED
    window[~made & (rng.random(window.shape) < 0.1)] = OUT
    return window, margin, rng.integers(0, labels, shape).astype(np.uint8)


def edges(window, margin, patch):
    """List pairs (p, q, cost) of the box's voxels, with the terminals "old" and "new"."""
    differs = {}
    inside = [tuple(np.array(p) + margin) for p in np.ndindex(patch.shape)]
    for p in inside:
        if window[p] < OUT:
            differs[p] = int(window[p] % FIXED != patch[tuple(np.array(p) - margin)])
    box = set(inside)
    found = []
    for p in differs:
        if window[p] >= FIXED:
            found.append(("old", p, HUGE))
        for axis in range(3):
            for sign in (-1, 1):
                q = tuple(at + sign * (axis == a) for a, at in enumerate(p))
                if not all(0 <= at < side for at, side in zip(q, window.shape, strict=True)):
                    continue
                if q in differs:
                    found.append((p, q, differs[p] + differs[q]))
                elif q in box and window[q] == EMPTY:
                    found.append((p, "new", 2 * differs[p]))
                elif q not in box and window[q] < OUT:
                    found.append(("old", p, 2 * differs[p]))
    return found


def best_cut(found):
    names = {
        name: n
        for n, name in enumerate(
            dict.fromkeys([e for pair in found for e in pair[:2]] + ["old", "new"])
        )
    }
    rows, columns, costs = (
        [names[p] for p, _, _ in found],
        [names[q] for _, q, _ in found],
        [c for *_, c in found],
    )
    graph = coo_array((costs, (rows, columns)), shape=(len(names),) * 2, dtype=np.int32).tocsr()
    return maximum_flow(graph, names["old"], names["new"]).flow_value


def cost_of(found, made, window, patch, margin):
    """Return the cost of a result's seam where its sides can be distinguished: where old and new
    agree, either side counts.
    """
    side = {"old": 0, "new": 1}
    for p in {e for pair in found for e in pair[:2] if isinstance(e, tuple)}:
        old, new = window[p] % FIXED, patch[tuple(np.array(p) - margin)]
        side[p] = None if old == new else int(made[p] % FIXED == new)
    return sum(c for p, q, c in found if side[p] == 0 and side[q] == 1)


@pytest.mark.whole
@given(
    st.integers(0, 10**6),
    st.sampled_from([(5, 6, 7), (1, 8, 9), (4, 4, 4)]),
    st.sampled_from([2, 4]),
    st.sampled_from([0.0, 0.3]),
)
def test_the_cut_is_as_cheap_as_a_reference_solvers(seed, shape, labels, held):
    window, margin, patch = scene(seed, shape, labels=labels, held=held)
    made, cost = cut_in(window, margin, patch)
    found = edges(window, margin, patch)
    assert cost == best_cut(found)
    assert cost_of(found, made, window, patch, margin) <= cost
    assert cut_in(window, margin, patch, keep=MOST)[1] == cost


@given(st.integers(0, 10**6))
def test_given_voxels_stay_and_what_is_not_made_is_the_pieces(seed):
    window, margin, patch = scene(seed, (5, 5, 6), held=0.3)
    box = tuple(slice(MARGIN, -MARGIN) for _ in range(3))
    for keep in (LEAST, MOST, ALL):
        made, _ = cut_in(window, margin, patch, keep=keep)
        held = (window >= FIXED) & (window < OUT)
        assert np.array_equal(made[held], window[held])
        empty = window[box] == EMPTY
        assert np.array_equal(made[box][empty], patch[empty])
        assert np.all(made[window == OUT] == OUT)
        outside = np.ones(window.shape, bool)
        outside[box] = False
        assert np.array_equal(made[outside], window[outside])


def test_of_two_equal_cuts_the_least_or_the_most_is_kept():
    """Check old and new that differ everywhere in an overlap of three columns: every straight cut
    costs the same.
    """
    window = np.full((1, 3, 8), EMPTY, np.uint8)
    window[:, :, :4] = 1  # one column before the box, three in it
    patch = np.zeros((1, 3, 6), np.uint8)
    counts = {}
    for keep in (LEAST, MOST, ALL):
        made, cost = cut_in(window, (0, 0, 1), patch, keep=keep)
        counts[keep] = int((made[:, :, 1:7] == 1).sum())
        assert cost == (6 if keep != ALL else -1)
    assert counts == {LEAST: 0, MOST: 9, ALL: 9}


def test_a_seam_goes_where_old_and_new_agree():
    window = np.full((1, 5, 9), EMPTY, np.uint8)
    window[:, :, :5] = [1, 1, 1, 0, 0]
    made, cost = cut_in(window, (0, 0, 1), np.zeros((1, 5, 7), np.uint8))
    assert cost == 0
    assert made[0, 2].tolist() == [1, 1, 1, 0, 0, 0, 0, 0, EMPTY]


def test_a_strut_goes_around_measured_voxels():
    window = np.zeros((5, 5, 5), np.uint8)
    window[2, 1, 2] = window[2, 2, 3] = FIXED
    leaders = np.zeros(window.shape, np.int32)
    leaders[2, 2, 0] = 7
    line = 5 * (5 * 2 + 2) + np.arange(5)
    came = np.full(window.size, -1, np.int32)
    came[line[1:]] = line[:-1]
    before = window.copy()
    _fill_path(window, leaders, 7, line[-1], came, (1, 1, 1), 1, 1)
    assert np.array_equal(window[before == FIXED], before[before == FIXED])
    assert window[2, 2, 1] == window[2, 2, 2] == window[1, 2, 2] == window[2, 3, 2] == 1
    assert not window[2, 2, 4], "the margin belongs to other boxes"

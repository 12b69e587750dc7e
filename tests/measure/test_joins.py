"""The cheapest paths between components: their cost is that of a spanning tree by Dijkstra."""

import heapq

import numpy as np
import pytest

from trabecula.measure.joins import cheapest_joins
from trabecula.measure.labelling import joined_across, label_components
from trabecula.measure.runs import INSIDE, runs_of


def distances_from(start, cost, wraps):
    """Return the cost of the cheapest way from marked voxels to every other, the last one counted,
    where marked ones cost nothing.
    """
    far = np.where(start, 0, 1 << 30)
    heap = [(0, tuple(at)) for at in np.argwhere(start)]
    while heap:
        length, at = heapq.heappop(heap)
        if length > far[at]:
            continue
        for axis in range(3):
            for step in (-1, 1):
                beside = list(at)
                beside[axis] += step
                if wraps[axis]:
                    beside[axis] %= cost.shape[axis]
                elif not 0 <= beside[axis] < cost.shape[axis]:
                    continue
                more = length + cost[tuple(beside)]
                if more < far[tuple(beside)]:
                    far[tuple(beside)] = more
                    heapq.heappush(heap, (int(more), tuple(beside)))
    return far


def tree_cost(labels, cost, wraps):
    """Return the cost of the minimum spanning tree of components, by Prim."""
    count = int(labels.max())
    free = np.where(labels > 0, 0, cost)
    apart = np.array(
        [
            [
                distances_from(labels == k, free, wraps)[labels == m].min()
                for m in range(1, count + 1)
            ]
            for k in range(1, count + 1)
        ]
    )
    inside, total = {0}, 0
    while len(inside) < count:
        length, new = min((apart[a, b], b) for a in inside for b in range(count) if b not in inside)
        inside.add(new)
        total += length
    return total


@pytest.mark.whole
@pytest.mark.parametrize("wraps", [(False,) * 3, (True, False, True)])
@pytest.mark.parametrize("seed", range(4))
def test_the_joins_cost_what_a_spanning_tree_costs(seed, wraps):
    rng = np.random.default_rng(seed)
    solid = rng.random((7, 8, 9)) < 0.04
    cost = rng.integers(1, 20, solid.shape).astype(np.uint8)
    runs = joined_across(runs_of(solid.view(np.uint8), INSIDE, 6), 6, wraps)
    worth = np.ones(len(runs.sizes), bool)
    paths = cheapest_joins(solid.view(np.uint8), runs, worth, 0, None, wraps, cost)
    labels, _ = label_components(solid, periodic=wraps)
    filled = solid.copy()
    spent = 0
    for path in paths:
        assert solid[tuple(path[0] % solid.shape)]
        for at in path[1:]:
            spent += int(cost[tuple(at % solid.shape)])
            filled[tuple(at % solid.shape)] = True
    assert len(paths) == labels.max() - 1
    assert spent == tree_cost(labels, cost, wraps)
    assert len(label_components(filled, periodic=wraps)[1]) == 1


def test_a_dear_way_is_gone_around():
    solid = np.zeros((1, 5, 7), np.uint8)
    solid[0, 2, 0] = solid[0, 2, 6] = 1
    cost = np.full(solid.shape, 1, np.uint8)
    cost[0, 1:4, 3] = 100
    runs = runs_of(solid, INSIDE, 6)
    (path,) = cheapest_joins(solid, runs, np.ones(2, bool), 0, None, (False,) * 3, cost)
    assert {tuple(at) for at in path.tolist()} & {(0, 0, 3), (0, 4, 3)}
    (line,) = cheapest_joins(solid, runs, np.ones(2, bool), 0)
    assert [at[2] for at in line.tolist()] == list(range(6))

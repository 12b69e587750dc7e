"""Tasks: all of every level, each once, none before what it is made from."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trabecula.engine.chunking import below, cells_of, slices_of, sources_of, tasks_of
from trabecula.engine.multiscale import shapes_of

SIDES = st.lists(st.integers(1, 40), min_size=2, max_size=3)


@pytest.mark.whole
@given(SIDES, st.integers(1, 3), st.sampled_from([3, 4, 8]))
def test_all_is_made_once_and_in_an_order_that_works(shape, blocks, chunk):
    shapes = shapes_of(shape, 2 * chunk)
    made = [np.zeros(sides, int) for sides in shapes]
    edges = {"side": blocks * chunk, "chunk": chunk}
    tasks = tasks_of(shapes, **edges)
    for place, ((level, box), sources) in enumerate(
        zip(tasks, sources_of(tasks, shapes, **edges), strict=True)
    ):
        if level:
            region = slices_of(below(box, shapes[level - 1]))
            assert made[level - 1][region].all(), "something that it is made from is missing"
            told = np.zeros(shapes[level - 1], bool)
            for source in sources:
                assert source < place and tasks[source].level == level - 1
                told[slices_of(tasks[source].box)] = True
            assert told[region].all(), "something that it is made from is not among its sources"
        else:
            assert sources == []
        made[level][slices_of(box)] += 1
    assert all((one == 1).all() for one in made)


def test_what_is_there_already_is_no_source():
    shapes, edges = [(16, 1), (8, 1)], {"side": 2, "chunk": 2}
    tasks = [task for task in tasks_of(shapes, **edges) if task.level or task.box[0][0] >= 8]
    assert sources_of(tasks, shapes, **edges) == [[], [], [], [], [2, 3], [], [], [5, 6]]


def test_coarser_cubes_follow_as_soon_as_they_can():
    order = [(level, box[0]) for level, box in tasks_of([(16, 1), (8, 1), (4, 1)], side=2, chunk=2)]
    coarse = [place for place, (level, _) in enumerate(order) if level]
    assert coarse == [2, 5, 6, 9, 12, 13], (
        "a cube of level 1 after two blocks, one of level 2 after two of those"
    )


@pytest.mark.whole
@given(SIDES, st.integers(1, 9), st.data())
def test_the_cells_that_a_box_meets(shape, side, data):
    box = tuple(tuple(sorted((data.draw(st.integers(0, n - 1)), n))) for n in shape)
    met = {
        tuple(voxel[axis] // side * side for axis in range(len(shape)))
        for voxel in np.ndindex(*shape)
        if all(first <= place < last for place, (first, last) in zip(voxel, box, strict=True))
    }
    assert sorted(met) == sorted(cells_of(box, side))


def test_the_box_below_ends_with_its_level():
    assert below(((0, 3), (2, 3)), (5, 6)) == ((0, 5), (4, 6))

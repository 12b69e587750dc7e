"""Triple-phase lines: straight ones, rings, what is active, and edges counted otherwise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import trabecula as tb
from trabecula.errors import InputError
from trabecula.measure import (
    triple_phase_active_share,
    triple_phase_line_density,
    triple_phase_lines,
)
from trabecula.measure.triple_lines import REACH

NAMES = ("void", "a", "b")


def sectors(side, direction, offset, angles=(120, 120, 120)):
    """Return three phases around a line through the middle, and the length of the line in the
    volume.
    """
    along = np.array(direction, float) / np.linalg.norm(direction)
    first = np.cross(along, [0.31, 0.52, 0.8])
    first /= np.linalg.norm(first)
    second = np.cross(along, first)
    middle = side / 2 + np.array(offset)
    place = np.stack(np.indices((side,) * 3), -1) + 0.5 - middle
    angle = np.degrees(np.arctan2(place @ second, place @ first)) % 360
    walls = np.sort([-middle / along, (side - middle) / along], axis=0)
    length = walls[1].min() - walls[0].max()
    return np.digitize(angle, np.cumsum(angles)[:2]), length


def oracle(values):
    """Count triple edges and sum their chords, edge by edge in Python."""
    leaving = {}
    for axis in range(3):
        across = [other for other in range(3) if other != axis]
        for low in np.ndindex(*(side - (other != axis) for other, side in enumerate(values.shape))):
            box = tuple(slice(at, at + (1 if other == axis else 2)) for other, at in enumerate(low))
            if len(np.unique(values[box])) == 3:
                start = tuple(at + (other in across) for other, at in enumerate(low))
                end = tuple(at + (other == axis) for other, at in enumerate(start))
                leaving.setdefault(start, []).append(end)
                leaving.setdefault(end, []).append(start)

    def follow(behind, at):
        for step in range(REACH):
            if len(leaving[at]) != 2:
                return at, step
            behind, at = at, next(other for other in leaving[at] if other != behind)
        return at, REACH

    total = edges = 0
    for start, ends in leaving.items():
        for end in ends:
            if start < end:
                (far, ahead), (near, before) = follow(start, end), follow(end, start)
                total += np.linalg.norm(np.subtract(far, near)) / (ahead + before + 1)
                edges += 1
    return edges, total


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_straight_line_along_an_axis_is_exact(axis):
    quarters = np.zeros((8, 7, 6), np.uint8)
    quarters[4:] = 1
    quarters[4:, :, 3:] = 2
    edges = {0: 2.0, 1: 1.0, 2: 0.5}
    values = np.moveaxis(quarters, 1, axis)
    spacing = tuple(edges[other] for other in range(3))
    image = tb.Image(values, "labels", spacing=spacing)
    area = np.prod(
        [(values.shape[other] - 1) * spacing[other] for other in range(3) if other != axis]
    )
    assert triple_phase_line_density(image) == pytest.approx(1 / area, rel=1e-12)
    assert triple_phase_active_share(image, axis=axis) == 1.0


def test_lines_of_random_direction_are_three_percent_high():
    rng = np.random.default_rng(3)
    side, ratios = 32, []
    for _ in range(25):
        values, length = sectors(side, rng.normal(size=3), rng.uniform(-1, 1, 3))
        ratios.append(triple_phase_line_density(values) * side * (side - 1) ** 2 / length)
    assert np.mean(ratios) == pytest.approx(1.03, abs=0.02)
    assert min(ratios) > 0.95 and max(ratios) < 1.12


def test_a_sphere_halfway_in_an_interface_has_a_ring_around_it():
    z, y, x = np.indices((32, 40, 40)) + 0.5
    values = np.where(z < 16, 0, 2)
    values[(z - 16) ** 2 + (y - 20.3) ** 2 + (x - 19.6) ** 2 < 12**2] = 1
    found = triple_phase_lines(values)[("void", "solid", "phase2")]
    assert found.density * (31 * 39 * 40) == pytest.approx(2 * np.pi * 12, rel=0.04)
    assert found.active == 0.0  # the sphere touches no face


@given(seed=st.integers(0, 200), shape=st.tuples(*[st.integers(2, 6)] * 3), phases=st.just(3))
def test_chords_are_those_of_chains_followed_edge_by_edge(seed, shape, phases):
    values = np.random.default_rng(seed).choice(phases, shape, p=[0.6, 0.25, 0.15])
    image = tb.Image(values, "labels", phases=NAMES)
    if len(set(shape)) > 1:
        side = min(shape)
        image = tb.Image(values[:side, :side, :side], "labels", phases=NAMES)
    side = image.shape[0]
    _, total = oracle(image.values)
    # In a cube the edges along every axis have the same room.
    assert triple_phase_line_density(image) * side * (side - 1) ** 2 == pytest.approx(total)


def test_every_thread_count_gives_the_same_density():
    from trabecula.engine.parallel import threads

    values = np.random.default_rng(1).integers(0, 3, (40, 20, 20))
    with threads(1):
        one = triple_phase_lines(values)
    with threads(3):
        assert triple_phase_lines(values) == one


def test_triple_points_of_a_picture():
    stripes = np.indices((9, 12)).sum(axis=0) % 3  # every 2x2 block holds all three
    image = tb.Image(stripes, "labels", spacing=0.5)
    assert triple_phase_line_density(image) == pytest.approx(4.0)
    # Diagonal stripes, neighbours sharing a side: none connects anything.
    assert triple_phase_active_share(image) == 0.0


def test_the_active_share_is_that_of_lines_whose_three_phases_percolate():
    """Set a pillar from face to face and an island, both in the interface of two phases that
    percolate.
    """
    grounds = np.zeros((24, 24, 40), np.uint8)
    grounds[:, 12:] = 2
    pillar, island = grounds.copy(), grounds.copy()
    pillar[:, 8:16, 4:12] = 1
    island[6:14, 8:16, 24:32] = 1
    both = np.where(island == 1, island, pillar)
    line, ring = triple_phase_line_density(pillar), triple_phase_line_density(island)
    assert triple_phase_line_density(both) == pytest.approx(line + ring)
    assert triple_phase_active_share(pillar) == 1.0 and triple_phase_active_share(island) == 0.0
    assert triple_phase_active_share(both) == pytest.approx(line / (line + ring))
    # The pillar stands along z, so nothing is active for those who ask for x.
    assert triple_phase_active_share(both, axis=0) == pytest.approx(line / (line + ring))
    assert triple_phase_active_share(both, axis=2) == 0.0


def test_where_four_phases_meet_lie_two_lines():
    values = np.zeros((5, 6, 6), np.uint8)
    values[:, 3:], values[:, :, 3:] = 1, values[:, :, 3:] + 2
    values[:, 3:, 3:] = 3
    image = tb.Image(values, "labels", phases=("void", "a", "b", "c", "d"))
    found = triple_phase_lines(image)
    assert next(iter(found)) == ("void", "a", "b") and len(found) == 10
    for names, line in found.items():
        assert line.density == pytest.approx(0.0 if "d" in names else 0.5 / 25) and (
            line.active is None
        ) == ("d" in names)
    assert triple_phase_line_density(image) == pytest.approx(2 / 25)
    assert triple_phase_line_density(image, phases=("c", 0, "a")) == pytest.approx(0.5 / 25)
    assert triple_phase_active_share(image, phases=("c", "void", "d")) is None


def test_two_phases_have_no_lines():
    values = np.random.default_rng(0).integers(0, 2, (6, 6, 6))
    assert triple_phase_lines(values) == {} and triple_phase_line_density(values) == 0.0
    assert triple_phase_active_share(values) is None


def test_refusals():
    values = np.random.default_rng(0).integers(0, 3, (6, 6, 6))
    for phases in (("void", "solid"), ("void", "solid", "solid"), "abc"):
        with pytest.raises(InputError, match="three different phases"):
            triple_phase_line_density(values, phases=phases)
    with pytest.raises(InputError, match="at least 2 voxels"):
        triple_phase_line_density(values[:1])
    with pytest.raises(InputError, match="axis 5"):
        triple_phase_lines(values, axis=5)

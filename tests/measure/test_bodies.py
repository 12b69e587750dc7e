"""Bodies whose sizes, axes and contacts are known."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.measure import bodies


def ellipsoids(shape, *each):
    """Return ellipsoids of (centre, half axes, rotation)."""
    at = np.stack(np.indices(shape), axis=-1).astype(float)
    solid = np.zeros(shape, bool)
    for centre, half, turn in each:
        solid |= (((at - centre) @ np.array(turn).T / half) ** 2).sum(axis=-1) < 1
    return solid.astype(np.uint8)


def test_an_ellipsoid_has_its_axes_and_directions():
    c, s = np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    values = ellipsoids((44, 44, 30), ((21.3, 22.1, 14.6), (18, 11, 7), turn))
    found = bodies(tb.Image(values, "labels", 2.0, "um"))
    assert len(found) == 1 and len(found.contacts) == 0 and found.inside.all()
    assert found.axes[0] == pytest.approx([72, 44, 28], rel=0.01)
    assert abs(found.directions[0] @ turn.T) == pytest.approx(np.eye(3), abs=0.02)
    assert found.centroid[0] == pytest.approx([42.6, 44.2, 29.2], abs=0.1)
    assert found.volume[0] == pytest.approx(4 / 3 * np.pi * 18 * 11 * 7 * 8, rel=0.01)
    assert found.elongation[0] == pytest.approx(11 / 18, rel=0.02)
    assert found.flatness[0] == pytest.approx(7 / 11, rel=0.02)
    p = 1.6075  # Thomsen's surface, right within 1.1 %
    powers = [(a * b) ** p for a, b in ((18, 11), (18, 7), (11, 7))]
    surface = 4 * np.pi * (sum(powers) / 3) ** (1 / p) * 4
    assert found.surface[0] == pytest.approx(surface, rel=0.04)
    assert found.orientation[0, 0] == pytest.approx(c**2, abs=0.02)
    assert np.trace(found.orientation) == pytest.approx(1)


def test_balls_that_touch_are_two_with_a_known_contact():
    values = ellipsoids(
        (34, 34, 60),
        ((16, 16, 18), (12, 12, 12), np.eye(3)),
        ((16, 16, 40), (12, 12, 12), np.eye(3)),
    )
    found = bodies(values)
    assert len(found) == 2 and found.contacts.tolist() == [[0, 1]]
    assert found.contact_area[0] == pytest.approx(np.pi * (12**2 - 11**2), rel=0.06)
    assert abs(found.contact_direction[0]).tolist() == [0, 0, 1]
    assert found.sphericity == pytest.approx(0.98, abs=0.04)
    assert found.inscribed_radius == pytest.approx(12, abs=0.6)
    whole = bodies(values, separate=False)
    assert len(whole) == 1 and whole.volume[0] == found.volume.sum() == values.sum()


def test_a_ball_across_the_faces_is_one_where_they_repeat():
    ball = ellipsoids((24, 24, 24), ((12, 12, 12), (9, 9, 9), np.eye(3)))
    split = np.roll(ball, (12, 12, 12), (0, 1, 2))
    found = bodies(split, periodic=True)
    whole = bodies(ball)
    assert len(found) == 1 and len(found.contacts) == 0 and found.inside.all()
    assert found.axes[0] == pytest.approx(whole.axes[0])
    assert found.surface[0] == pytest.approx(whole.surface[0])
    assert found.centroid[0] % 24 == pytest.approx([0, 0, 0], abs=1e-9)
    assert len(bodies(split)) == 8 and not bodies(split).inside.any()


def test_a_packing_has_its_coordination():
    at = np.stack(np.indices((40, 40, 40)), axis=-1) + 0.5
    off = (at + 10) % 20 - 10
    values = ((off**2).sum(axis=-1) < 10.4**2).astype(np.uint8)
    found = bodies(values, periodic=True)
    assert len(found) == 8 and (found.coordination == 6).all()
    assert found.equivalent_diameter == pytest.approx(np.cbrt(6 / np.pi * values.mean() * 8000))
    summary = found.summary()
    assert summary["bodies"] == 8 and summary["contacts"] == 24
    assert summary["coordination"] == 6 and summary["inside"] == 8


def test_figures_are_of_whole_bodies():
    values = ellipsoids(
        (30, 30, 60), ((15, 15, 14), (9, 9, 9), np.eye(3)), ((15, 15, 59), (5, 5, 5), np.eye(3))
    )
    found = bodies(values)
    assert found.inside.tolist() == [True, False]
    assert found.touches[1].tolist() == [False] * 5 + [True]
    assert found.summary()["equivalent_diameter"] == found.equivalent_diameter[0]

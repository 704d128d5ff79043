"""Distances between the solids of a cell, against geometry done by hand."""

import numpy as np
import pytest

from mbcacq.geometry import se3
from mbcacq.plan.clearance import Pair, Posture
from mbcacq.plan.collision import _box, _capsule

FRAMES = np.tile(np.eye(4), (2, 1, 1))


def capsule(start, end, radius):
    return _capsule("capsule", 0, np.eye(4), np.array(start, float), np.array(end, float), radius)


def box(low, high, T=None):
    return _box("box", 0, np.eye(4) if T is None else T, np.array(low, float), np.array(high, float))


LONG = capsule((0, 0, -100), (0, 0, 100), 20)
TABLE = box((-500, -500, -50), (500, 500, 0))
TURNED = box((-10, -10, -10), (10, 10, 10), se3.from_abc(np.array([0, 0, 30.0]), np.radians([45.0, 0, 0])))


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        (LONG, capsule((50, -100, 30), (50, 100, 30), 10), 50 - 20 - 10),  # crossing lines
        (LONG, capsule((30, 0, 0), (30, 0, 200), 10), 0),  # side by side, touching
        (LONG, capsule((0, 0, 150), (0, 0, 300), 5), 50 - 20 - 5),  # end to end
        (LONG, capsule((5, -100, 0), (5, 100, 0), 10), 5 - 20 - 10),  # into each other
        (capsule((0, 0, 60), (80, 0, 40), 15), TABLE, 40 - 15),  # the lower end over a table
        (capsule((0, 0, 10), (80, 0, 10), 15), TABLE, 10 - 15),
        (capsule((0, 0, -10), (80, 0, -10), 15), TABLE, -10 - 15),  # the line itself below the surface
        (TURNED, TABLE, 30 - 10),
        (box((0, 0, 7), (10, 10, 20)), TABLE, 7),
        (box((0, 0, -3), (10, 10, 20)), TABLE, -3),  # the way out is upwards
        (box((510, 510, 510), (520, 520, 520)), box((490, 490, 490), (500, 500, 500)), 10 * np.sqrt(3)),  # corner to corner
    ],
)
def test_distance_and_depth_are_those_of_the_solids(a, b, expected):
    posture = Posture(FRAMES)
    for one, other in ((a, b), (b, a)):
        assert posture.distance(Pair(one, other, np.zeros(1))) == pytest.approx(expected, abs=1e-6)


def test_the_same_solid_in_one_place_twice_overlaps():
    posture = Posture(FRAMES)
    for body in (LONG, TABLE, TURNED):
        assert posture.distance(Pair(body, body, np.zeros(1))) < -10

"""A recording of a simulated arm, described wrongly: the mistake is named, and a right description is left alone."""

from dataclasses import replace

import numpy as np
import pytest

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.description import wrong_descriptions
from mbcacq.errors import CalibrationError
from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import Artefact, Cell, RobotModel, Station
from mbcacq.model.observations import Observations
from mbcacq.workflow.diagnose import diagnose

POSES = 24
ROWS = np.array(  # theta deg, d, a, alpha deg: an arm with offsets at the shoulder and the elbow
    [[0, 400, 25, -90], [0, 0, 455, 0], [-90, 0, 35, -90], [0, 420, 0, 90], [0, 0, 0, -90], [180, 80, 0, 180]], dtype=float
)
SIGN = np.array([-1.0, 1, 1, -1, 1, -1])


def frames(q):
    """Flange poses by plain products of Denavit-Hartenberg matrices."""
    out = np.tile(np.eye(4), (len(q), 1, 1))
    for (theta, d, a, alpha), sign, column in zip(ROWS, SIGN, q.T, strict=True):
        angle, ca, sa = sign * column + np.radians(theta), np.cos(np.radians(alpha)), np.sin(np.radians(alpha))
        c, s, o = np.cos(angle), np.sin(angle), np.zeros(len(q))
        rows = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [o, o + sa, o + ca, o + d], [o, o, o, o + 1]]
        out = out @ np.moveaxis(np.array(rows), -1, 0)
    return out


@pytest.fixture(scope="module")
def tracked():
    """A tracker that follows a target with orientation, 0.02 mm of noise."""
    rng = np.random.default_rng(5)
    q = np.radians([0, -80, 90, 0, 20, 0] + rng.uniform(-60, 60, (POSES, 6)))
    base = se3.transform(se3.rotation_exp(np.array([0.1, -0.2, 2.0])), np.array([2500.0, -700, 300]))
    tool = se3.transform(se3.rotation_exp(np.array([0.3, 0.5, -0.8])), np.array([60.0, 30, 90]))
    target = se3.inverse(base) @ frames(q) @ tool
    chain = Chain(SIGN, *(np.radians(c) if k in (0, 3) else c for k, c in enumerate(ROWS.T)), np.zeros(6))
    robot = RobotModel("arm", chain, np.tile([-3.2, 3.2], (6, 1)), np.zeros(6), np.zeros((6, 3)))
    artefact = Artefact("t", "target", (1,), np.zeros((1, 3)), np.zeros(1))
    cell = Cell(robot, np.eye(4), (artefact,), (Station("1", "t"),), measurement="target_in_base")
    numbers = np.arange(POSES)
    xyz = target[:, :3, 3] + rng.normal(0, 0.02, (POSES, 3))
    return Observations(cell, numbers, np.zeros(POSES, int), q, numbers, np.zeros(POSES, int), xyz, rotation=target[:, :3, :3])


def test_rows_are_shifted_before_some_of_them_are_chosen(tracked):
    """Of 130 poses 60 are fitted; a shift among those would be a shift by two rows."""
    rng = np.random.default_rng(8)
    q = np.radians([0, -80, 90, 0, 20, 0] + rng.uniform(-60, 60, (130, 6)))
    target = se3.inverse(se3.transform(se3.rotation_exp(np.array([0.1, -0.2, 2.0])), np.array([2500.0, -700, 300]))) @ frames(q)
    numbers = np.arange(130)
    many = Observations(tracked.cell, numbers, np.zeros(130, int), np.roll(q, 3, axis=0), numbers, np.zeros(130, int), target[:, :3, 3])
    assert wrong_descriptions(many)[0].what == "each measurement belonging to the pose 3 rows on"


MISTAKES = [
    (lambda o: replace(o, q=o.q * [1, 1, 1, -1, 1, 1]), "A4 reversed"),
    (lambda o: replace(o, q=np.radians(o.q)), "the angles read as radians, not degrees (are the columns q1_rad .. and not q1_deg ..?)"),
    (lambda o: replace(o, q=o.q[:, [0, 2, 1, 3, 4, 5]]), "the columns of A2 and A3 exchanged"),
    (lambda o: replace(o, q=o.q - [0, np.pi / 2, 0, 0, 0, 0]), "+90° added to A2"),
]


@pytest.mark.parametrize(("mistake", "undone"), MISTAKES, ids=[undone for _, undone in MISTAKES])
def test_the_mistake_is_named_with_the_residual_before_and_after(tracked, mistake, undone):
    found = wrong_descriptions(mistake(tracked))
    assert [f.what for f in found] == [undone]
    assert found[0].after_mm < 0.1 < 2.0 < found[0].before_mm
    assert str(found[0]).startswith(f"with {undone} the residual falls from ")


def test_a_right_description_is_left_alone(tracked):
    assert wrong_descriptions(tracked) == ()


@pytest.mark.parametrize("ask", [calibrate, diagnose])
def test_who_is_refused_a_recording_is_told_the_likely_slip(tracked, ask):
    turned = replace(tracked, q=tracked.q + [0, 0, np.pi / 2, 0, 0, 0])

    with pytest.raises(CalibrationError, match=r"90° added to A3 the residual falls"):
        ask(turned)

"""The world's arm against the vendor's own geometry and against the textbook product of link matrices."""

import numpy as np
import pytest
from mbcacq_fakes.world.arm import Masses, TrueArm, paper_errors
from scipy.linalg import expm

# KUKA KR 10 R1100-2, kuka_agilus_support: axis lines at zero in $ROBROOT, and flange poses (tool0) at joint angles in deg.
DIRECTION = np.array([[0, 0, -1], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]], dtype=float)
POINT = np.array([[0, 0, 208], [25, 90.7, 400], [585, 86.5, 400], [781, 0, 425], [1100, 50.5, 425], [1161.5, 0, 425]], dtype=float)
FLANGE = {
    (0, 0, 0, 0, 0, 0): (1190.0, 0.0, 425.0),
    (0, -90, 90, 0, 0, 0): (630.0, 0.0, 985.0),
    (0, -90, 90, 0, 90, 0): (540.0, 0.0, 895.0),
    (10, -80, 95, 20, 40, 30): (664.943, -137.339, 771.995),
    (-35, -60, 70, -15, 55, -100): (689.422, 506.032, 741.072),
}
SIGN = np.array([-1.0, 1, 1, -1, 1, -1])
ROWS = np.array(
    [[0, 400, 25, -90, 0], [0, 0, 560, 0, 0], [-90, 0, 25, -90, 0], [0, 515, 0, 90, 0], [0, 0, 0, -90, 0], [180, 90, 0, 0, 0]], dtype=float
)
ROWS[:, [0, 3, 4]] = np.radians(ROWS[:, [0, 3, 4]])
MASSES = Masses(
    np.array([8.416, 17.837, 6.075, 5.162, 1.613, 0.734]),
    np.array(
        [
            [-18.59, 85.41, 16.27],
            [-368.84, -4.65, 15.49],
            [-12.49, -18.25, 43.86],
            [1.32, -178.02, 8.61],
            [-0.78, -24.04, 9.32],
            [0, 0, -16.74],
        ]
    ),
    0.0,
    np.zeros(3),
    np.array([0, 0, -1.0]),
)


@pytest.fixture(scope="module")
def arm():
    return TrueArm.from_rows(SIGN, ROWS)


def test_axis_lines_are_the_vendors(arm):
    np.testing.assert_allclose(arm.axis, DIRECTION, atol=1e-12)
    np.testing.assert_allclose(np.cross(POINT - arm.point, DIRECTION), 0, atol=1e-9)


@pytest.mark.parametrize("angles", FLANGE)
def test_flange_where_the_vendor_puts_it(arm, angles):
    np.testing.assert_allclose(arm.flange(np.radians([angles]))[0, :3, 3], FLANGE[angles], atol=6e-4)


def test_motion_is_the_matrix_exponential_of_the_vendors_screws(arm):
    q = np.radians([31.0, -77.0, 95.0, -140.0, 66.0, 211.0])
    T = np.eye(4)
    for w, p, angle in zip(DIRECTION, POINT, q, strict=True):
        twist = np.zeros((4, 4))
        twist[:3, :3] = np.cross(np.eye(3), w)
        twist[:3, 3] = -np.cross(w, p)
        T = T @ expm(angle * twist)
    np.testing.assert_allclose(arm.flange(q[None])[0], T @ arm.flange(np.zeros((1, 6)))[0], atol=1e-9)


def test_table_1_arm_is_the_product_of_its_link_matrices():
    """H_i = Rz Tz Tx Rx Ry with Table 1 added, written out; the world's arm gets there by screws."""

    def rot(axis, angle):
        c, s = np.cos(angle), np.sin(angle)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        T = np.eye(4)
        T[i, i], T[i, j], T[j, i], T[j, j] = c, -s, s, c
        return T

    def shift(axis, mm):
        T = np.eye(4)
        T[axis, 3] = mm
        return T

    rows = ROWS + paper_errors()
    rng = np.random.default_rng(5)
    q = rng.uniform(-2, 2, (20, 6))
    expected = []
    for angles in q:
        T = np.eye(4)
        for s, angle, (theta, d, a, alpha, beta) in zip(SIGN, angles, rows, strict=True):
            T = T @ rot(2, s * angle + theta) @ shift(2, d) @ shift(0, a) @ rot(0, alpha) @ rot(1, beta)
        expected.append(T)
    np.testing.assert_allclose(TrueArm.from_rows(SIGN, rows).flange(q), expected, atol=1e-9)
    assert np.degrees(paper_errors()[0, 0]) == pytest.approx(0.021)
    assert np.degrees(paper_errors()[1, 4]) == pytest.approx(0.008)
    assert paper_errors()[5, 1] == 0.102


def test_gravity_moments_of_the_outstretched_arm(arm):
    """All axes at zero, no tool: 140 N m about A2, 32 N m about A3, computed from the vendor's inertial data; positive A2 lowers the arm."""
    torque = MASSES.torque(arm, np.zeros((1, 6)))[0]
    assert torque[1] == pytest.approx(140, abs=0.5)
    assert torque[2] == pytest.approx(32, abs=0.5)
    assert torque[0] == pytest.approx(0, abs=1e-6)


def test_a_displaced_frame_carries_everything_behind_it(arm):
    q = np.radians([[10.0, -80.0, 95.0, 20.0, 40.0, 30.0]])
    moved = np.zeros((1, 7, 6))
    moved[0, 3, 2] = 0.5  # 0.5 mm along z of link 3's frame
    before, after = arm.frames(q), arm.frames(q, moved)
    np.testing.assert_allclose(after[0, :3], before[0, :3], atol=1e-12)
    step = 0.5 * before[0, 3, :3, 2]
    np.testing.assert_allclose(after[0, 3:, :3, 3] - before[0, 3:, :3, 3], np.tile(step, (4, 1)), atol=1e-9)

"""Chains with prismatic joints, external axes and joints that follow others, against lines in space and complex steps."""

import numpy as np
import pytest
from test_chain import KR10

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.geometry.chain_from_axes import carried, chain_from_axes
from mbcacq.geometry.dynamics import nominal_parameters, regressor
from mbcacq.geometry.gravity import gravity_torque
from mbcacq.geometry.link_shapes import arm_outline, link_radii
from mbcacq.geometry.numerical_inverse import NumericalInverse

DOWN = np.array([0.0, 0, -1])
TRACK = np.array([1.0, 0.02, 0.01]) / np.linalg.norm([1.0, 0.02, 0.01])
# Seen from the table: the turn about its z, the tilt about -y, then the track that carries the arm.
LINES = np.array([[0, 0, -1.0], [0, -1.0, 0], TRACK])
POINTS = np.array([[1500.0, 300, 200], [1500, 300, 500], [7, 8, 9]])
CELL = carried(KR10, LINES, POINTS, (2,), 2)
STANFORD = chain_from_axes(
    np.array([[0, 0, 1.0], [0, 1, 0], [0, 0, 1], [0, 0, 1], [0, 1, 0], [0, 0, 1]]),
    np.array([[0, 0, 0.0], [0, 150, 400], [0, 0, 0], [0, 150, 400], [0, 150, 900], [0, 150, 900]]),
    se3.transform(np.eye(3), np.array([0, 150.0, 1000])),
    (2,),
).chain


def positions(chain, count, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (count, chain.n)) * chain.by_kind(2.0, 800.0)


def test_external_axes_move_as_lines_in_space():
    """Product of exponentials of the external axes, then the arm by itself."""
    q = positions(CELL, 8)
    for row in q:
        expected = KR10.flange(row[None, 3:])[0]
        for k in (2, 1, 0):
            turn = np.concatenate([np.cross(POINTS[k], LINES[k]), LINES[k]])
            expected = se3.exp(row[k] * (np.concatenate([LINES[k], np.zeros(3)]) if k == 2 else turn)) @ expected
        np.testing.assert_allclose(CELL.flange(row[None])[0], expected, atol=1e-9)


@pytest.mark.parametrize("chain", [CELL, STANFORD], ids=["cell", "stanford"])
def test_derivatives_equal_complex_steps(chain):
    """The imaginary part of the flange at a step of 1e-30 i is the derivative, to rounding."""
    q, step = positions(chain, 4, 1), 1e-30
    frames = chain.frames(q)
    point = np.array([20.0, -30, 40, 1])

    def moved(twist):
        at = frames[:, -1] @ point
        return twist[:, :3] + np.cross(twist[:, 3:], at[:, :3])

    joints, parameters = chain.joint_twists(frames), chain.parameter_twists(frames, q)
    np.testing.assert_array_equal(chain.of_joints(parameters), joints)
    for i in range(chain.n):
        there = chain.flange(q + 1j * step * np.eye(chain.n)[i])
        np.testing.assert_allclose((there @ point).imag[:, :3] / step, moved(joints[:, i]), rtol=1e-12, atol=1e-9)
        for k in range(5):
            error = np.zeros((chain.n, 5), dtype=complex)
            error[i, k] = 1j * step
            there = chain.with_errors(error).flange(q.astype(complex))
            np.testing.assert_allclose((there @ point).imag[:, :3] / step, moved(parameters[:, i, k]), rtol=1e-12, atol=1e-9)


def test_a_chain_has_four_parameters_a_turn_and_two_a_slide():
    """Less six that an unknown base takes; a track's direction in the arm's base are two angles."""
    for chain in (KR10, CELL, STANFORD):
        slides = len(chain.sliding)
        assert np.count_nonzero(~chain.redundant()) == 4 * (chain.n - slides) + 2 * slides - 6
    track = carried(KR10, np.array([[1.0, 0, 0]]), np.zeros((1, 3)), (0,), 0)
    assert np.argwhere(~track.redundant()[:2]).tolist() == [[0, 3], [1, 0], [1, 2], [1, 3]]  # alpha_1; theta_2, a_2, alpha_2


def test_gravity_pulls_along_a_slide_and_is_the_gradient_of_potential_energy():
    chain, rng, step = STANFORD, np.random.default_rng(4), 1e-5
    mass, com, q = rng.uniform(1, 20, 6), rng.normal(0, 100, (6, 3)), positions(STANFORD, 3, 2)

    def energy(at):  # mJ
        frames = chain.frames(at)
        return 9.80665 * np.sum(mass * se3.apply(frames[:, 1:], com[None])[..., 2], axis=1)

    torque = gravity_torque(chain, chain.frames(q), mass, com, 0.0, np.zeros(3), DOWN)
    for joint in range(6):
        shift = step * np.eye(6)[joint]
        slope = (energy(q + shift) - energy(q - shift)) / (2 * step)  # mJ/mm is N, mJ/rad a thousandth of N m
        np.testing.assert_allclose(torque[:, joint], -slope * (1.0 if joint == 2 else 1e-3), rtol=1e-4, atol=1e-4)
    zero = np.zeros_like(q)
    hold = np.einsum("tjlk,lk->tj", regressor(chain, q, zero, zero, DOWN), nominal_parameters(mass, com))
    np.testing.assert_allclose(hold, -torque, atol=1e-9)


def test_gravity_stays_with_the_floor_where_the_base_is_a_table_that_tilts():
    """The torques of the arm are those of the arm alone, however the table stands; the table's axes carry none of it."""
    rng = np.random.default_rng(5)
    mass, com, q = rng.uniform(1, 20, 6), rng.normal(0, 100, (6, 3)), positions(CELL, 4, 3)
    none = np.zeros(3)
    whole = gravity_torque(CELL, CELL.frames(q), np.r_[none, mass], np.vstack([np.zeros((3, 3)), com]), 0.0, none, DOWN)
    alone = gravity_torque(KR10, KR10.frames(q[:, 3:]), mass, com, 0.0, none, DOWN)
    np.testing.assert_allclose(whole[:, 3:], alone, atol=1e-9)
    assert not whole[:, :2].any()


def test_drives_give_the_power_that_kinetic_energy_takes():
    """Without gravity the work of all drives, N mm and N m rad, is what the energy of the masses rises by."""
    chain, rng = STANFORD, np.random.default_rng(6)
    mass, com = rng.uniform(1, 20, 6), rng.normal(0, 100, (6, 3))
    q, qd, qdd = positions(chain, 3, 7), positions(chain, 3, 8), positions(chain, 3, 9)

    def kinetic(h):  # J
        def place(t):
            return se3.apply(chain.frames(q + qd * t + qdd * t * t / 2)[:, 1:], com[None])

        speed = (place(h + 1e-4) - place(h - 1e-4)) / 2e-4
        return 0.5e-6 * np.sum(mass[:, None] * speed**2, axis=(1, 2))

    drive = np.einsum("tjlk,lk->tj", regressor(chain, q, qd, qdd, np.zeros(3)), nominal_parameters(mass, com))
    power = np.sum(drive * qd * chain.by_kind(1.0, 1e-3), axis=1)
    np.testing.assert_allclose(power, (kinetic(1e-3) - kinetic(-1e-3)) / 2e-3, rtol=1e-3, atol=1e-2)


def test_the_numerical_inverse_moves_slides_within_their_limits():
    limits = np.where(STANFORD.prismatic[:, None], [0.0, 700.0], [-3.0, 3.0])
    q = np.random.default_rng(3).uniform(0.9 * limits[:, 0], 0.9 * limits[:, 1], (6, 6))
    target = STANFORD.flange(q)
    found = NumericalInverse(STANFORD, limits).solutions(target)
    for T, postures in zip(target, found, strict=True):
        assert len(postures) >= 2
        np.testing.assert_allclose(STANFORD.flange(postures), np.broadcast_to(T, (len(postures), 4, 4)), atol=1e-5)
        assert ((limits[:, 0] - 1e-9 <= postures) & (postures <= limits[:, 1] + 1e-9)).all()


def test_a_joint_that_follows_another_adds_to_its_motion():
    """A parallelogram: the third joint turns back what the second turns, so that the orientation does not change."""
    three = Chain(np.ones(3), np.zeros(3), np.zeros(3), np.array([0, 500.0, 100]), np.array([-np.pi / 2, 0, 0]), np.zeros(3))
    chain = Chain(three.sign, *three.rows.T, follows=((2, 1, -1.0),))
    q = np.array([[0.3, 0.7, 0.0]])
    np.testing.assert_allclose(chain.flange(q), three.flange(np.array([[0.3, 0.7, -0.7]])), atol=1e-12)
    frames = chain.frames(q)
    there = chain.flange(q + 1j * 1e-30 * np.eye(3)[1])[0, :3, 3].imag / 1e-30
    twist = chain.joint_twists(frames)[0, 1]
    np.testing.assert_allclose(twist[:3] + np.cross(twist[3:], frames[0, -1, :3, 3]), there, atol=1e-9)
    np.testing.assert_allclose(twist[3:], 0, atol=1e-12)


def test_the_foot_of_an_arm_stands_while_a_table_turns():
    """One turning table, then two links of 400 and 300 mm: the foot is drawn at zero, the table not at all."""
    rows = np.array([[0, 0, 0, 0, 0], [0, 400, 0, 0, 0], [0, 0, 300, 0, 0]], dtype=float)
    chain = Chain(np.ones(3), *rows.T, floor=1)
    for turned in (0.0, 0.7):
        drawn = arm_outline(chain, np.array([turned, 0.3, 0.0]), of_foot=True)
        np.testing.assert_allclose(drawn[[0, -1]], [[0, 0, 0], [300 * np.cos(0.3), 300 * np.sin(0.3), 400]], atol=1e-9)
    assert len(drawn) == 3 * len(link_radii(chain)) == 6

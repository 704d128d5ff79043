"""The MD-H chain against independent kinematics and against differences."""

import numpy as np
import pytest

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.geometry.gravity import gravity_torque

# KR 10 R1100-2: a1 25, c1 400, c2 560, c3 515, forearm offset 25, c4 90 (mm).
KR10 = Chain(
    np.array([-1.0, 1, 1, -1, 1, -1]),
    np.radians([0.0, 0, -90, 0, 0, 180]),
    np.array([400.0, 0, 0, 515, 0, 90]),
    np.array([25.0, 560, 25, 0, 0, 0]),
    np.radians([-90.0, 0, -90, 90, -90, 180]),
    np.zeros(6),
)
# Axis points (mm) and directions with all axes at zero, as the manufacturer's description gives them.
POINTS = np.array([[0, 0, 208], [25, 90.7, 400], [585, 86.5, 400], [781, 0, 425], [1100, 50.5, 425], [1161.5, 0, 425.0]])
AXES = np.array([[0, 0, -1.0], [0, 1, 0], [0, 1, 0], [-1, 0, 0], [0, 1, 0], [-1, 0, 0]])


def flange_by_exponentials(q):
    """Product of exponentials: no Denavit-Hartenberg parameter in it."""
    T = np.eye(4)
    for axis, point, angle in zip(AXES, POINTS, q, strict=True):
        T = T @ se3.exp(angle * np.concatenate([np.cross(point, axis), axis]))
    zero = np.eye(4)
    zero[:3, 3] = [1190, 0, 425]
    return T @ zero


@pytest.mark.parametrize(
    ("q_deg", "xyz"),
    [
        ([0, 0, 0, 0, 0, 0], [1190.0, 0.0, 425.0]),
        ([0, -90, 90, 0, 0, 0], [630.0, 0.0, 985.0]),
        ([0, -90, 90, 0, 90, 0], [540.0, 0.0, 895.0]),
        ([10, -80, 95, 20, 40, 30], [664.943, -137.339, 771.995]),
    ],
)
def test_flange_position_as_the_manufacturer_gives_it(q_deg, xyz):
    np.testing.assert_allclose(KR10.flange(np.radians([q_deg]))[0, :3, 3], xyz, atol=6e-4)


def test_chain_turns_like_the_product_of_exponentials():
    q = np.random.default_rng(1).uniform(-2, 2, (20, 6))
    for angles, T in zip(q, KR10.flange(q), strict=True):
        other = flange_by_exponentials(angles)
        np.testing.assert_allclose(T[:3, 3], other[:3, 3], atol=1e-9)
    tool = np.linalg.inv(flange_by_exponentials(q[0])[:3, :3]) @ KR10.flange(q[:1])[0, :3, :3]
    for angles, T in zip(q, KR10.flange(q), strict=True):
        np.testing.assert_allclose(T[:3, :3], flange_by_exponentials(angles)[:3, :3] @ tool, atol=1e-12)


def test_parameter_twists_equal_differences():
    rng = np.random.default_rng(2)
    q, chain, step = rng.uniform(-2, 2, (5, 6)), KR10.with_errors(rng.normal(0, 0.01, (6, 5))), 1e-6
    frames = chain.frames(q)
    twists = chain.parameter_twists(frames, q)
    point = rng.normal(0, 200, 3)
    for link in range(6):
        for parameter in range(5):
            error = np.zeros((6, 5))
            error[link, parameter] = step
            moved = (chain.with_errors(error).flange(q) - chain.with_errors(-error).flange(q)) / (2 * step)
            base = se3.apply(frames[:, -1], point)
            twist = twists[:, link, parameter]
            expected = twist[:, :3] + np.cross(twist[:, 3:], base)
            np.testing.assert_allclose(moved[:, :3, :3] @ point + moved[:, :3, 3], expected, rtol=1e-6, atol=1e-4)


def test_joint_twists_equal_differences():
    q, step = np.random.default_rng(3).uniform(-2, 2, (4, 6)), 1e-6
    twists = KR10.joint_twists(KR10.frames(q))
    for joint in range(6):
        shift = step * np.eye(6)[joint]
        moved = (KR10.flange(q + shift)[:, :3, 3] - KR10.flange(q - shift)[:, :3, 3]) / (2 * step)
        tip = KR10.flange(q)[:, :3, 3]
        np.testing.assert_allclose(moved, twists[:, joint, :3] + np.cross(twists[:, joint, 3:], tip), atol=1e-4)


def test_displacements_act_where_they_say():
    """A base displacement moves the flange from outside, a mount displacement from inside."""
    q, twist = np.zeros((1, 6)), np.array([1.0, 2.0, 3.0, 0.1, -0.2, 0.3])
    displacement = np.zeros((1, 7, 6))
    displacement[0, 0] = twist
    np.testing.assert_allclose(KR10.frames(q, displacement)[0, -1], se3.exp(twist) @ KR10.flange(q)[0], atol=1e-10)
    displacement = np.zeros((1, 7, 6))
    displacement[0, 6] = twist
    np.testing.assert_allclose(KR10.frames(q, displacement)[0, -1], KR10.flange(q)[0] @ se3.exp(twist), atol=1e-10)


def test_only_axes_two_and_three_are_parallel():
    assert KR10.parallel_next().tolist() == [False, True, False, False, False, False]


def test_gravity_torque_of_a_horizontal_arm():
    """With all axes at zero the arm lies horizontally: torque about A2 is weight times lever, in the lowering sense."""
    mass, com = np.zeros(6), np.zeros((6, 3))
    torque = gravity_torque(KR10, KR10.frames(np.zeros((1, 6))), mass, com, 2.0, np.zeros(3), np.array([0, 0, -1.0]))[0]
    assert torque[1] == pytest.approx(2.0 * 9.80665 * (1190 - 25) * 1e-3)
    assert torque[2] == pytest.approx(2.0 * 9.80665 * (1190 - 585) * 1e-3)
    assert torque[0] == pytest.approx(0.0, abs=1e-9)


def test_gravity_torque_is_the_gradient_of_potential_energy():
    rng = np.random.default_rng(4)
    mass, com, q, step = rng.uniform(1, 20, 6), rng.normal(0, 100, (6, 3)), rng.uniform(-2, 2, (3, 6)), 1e-6
    gravity = np.array([0.1, -0.2, -1.0]) / np.linalg.norm([0.1, -0.2, -1.0])
    payload = (3.0, np.array([10.0, -5, 80]))

    def energy(angles):
        frames = KR10.frames(angles)
        centres = se3.apply(frames[:, 1:], com[None])
        load = se3.apply(frames[:, -1], np.broadcast_to(payload[1], (len(angles), 3)))
        return -9.80665e-3 * ((mass[:, None] * centres).sum(1) + payload[0] * load) @ gravity

    torque = gravity_torque(KR10, KR10.frames(q), mass, com, *payload, gravity)
    for joint in range(6):
        shift = step * np.eye(6)[joint]
        slope = (energy(q + shift) - energy(q - shift)) / (2 * step)
        np.testing.assert_allclose(torque[:, joint], -slope, rtol=1e-5, atol=1e-5)

"""Injected effects of the arm against physics that is worked out another way."""

import numpy as np
import pytest
from elastic_cell import ARM, HAND_EYE, MASSES, ROWS, SIGN, act, cell, moments, spread_q
from mbcacq_fakes.world.arm import STANDARD_GRAVITY


def test_joint_compliance_is_the_equilibrium_that_mujoco_finds():
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is a development dependency")
    q = spread_q(12)
    stiffness = np.array([4e5, 2.5e5, 3e5, 5e4, 4e4, 3e4])
    model = mujoco.MjModel.from_xml_string(_mjcf(stiffness))
    data, expected = mujoco.MjData(model), []
    for commanded in q:
        model.qpos_spring[:] = commanded
        angles = commanded.copy()
        for _ in range(20):  # springs about the commanded angles hold the weight: 0 = -bias + K (commanded - q)
            data.qpos[:] = angles
            mujoco.mj_forward(model, data)
            angles = commanded - data.qfrc_bias / stiffness
        expected.append(angles - commanded)
    at = moments(q)
    total = np.zeros_like(q)
    for i, k in enumerate(stiffness):
        total += act("joint_compliance", at, where=f"A{i + 1}", compliance_rad_per_Nm=1 / k)[1].joint
    # each axis alone: the axes' windings change each other's torque only in second order
    np.testing.assert_allclose(total, expected, atol=2e-3 * np.abs(expected).max())


def _mjcf(stiffness):
    """The same arm for MuJoCo: nested bodies (m, kg) with a hinge along z of the frame before each link."""
    from scipy.spatial.transform import Rotation

    def frame(a, d, alpha, theta):
        turn = Rotation.from_euler("Z", theta) * Rotation.from_euler("X", alpha)
        move = Rotation.from_euler("Z", theta).apply([a, 0, 0]) + [0, 0, d]
        x, y, z, w = turn.as_quat()
        return f'pos="{move[0] / 1e3} {move[1] / 1e3} {move[2] / 1e3}" quat="{w} {x} {y} {z}"'

    inner = (
        f'<inertial pos="{" ".join(str(v / 1e3) for v in MASSES.payload_com)}" mass="{MASSES.payload_mass}" diaginertia="1e-3 1e-3 1e-3"/>'
    )
    text = f'<body name="tool">{inner}</body>'
    for i in reversed(range(6)):
        theta, d, a, alpha, _ = ROWS[i]
        com = " ".join(str(v / 1e3) for v in MASSES.com[i])
        link = (
            f'<body {frame(a, d, alpha, theta)}><inertial pos="{com}" mass="{MASSES.mass[i]}" diaginertia="1e-2 1e-2 1e-2"/>{text}</body>'
        )
        # A carrier without weight turns about z; the link's own frame hangs behind it.
        text = (
            f'<body><joint type="hinge" axis="0 0 {SIGN[i]}"/><inertial pos="0 0 0" mass="1e-9" diaginertia="1e-9 1e-9 1e-9"/>{link}</body>'
        )
    return (
        f'<mujoco><compiler angle="radian" boundmass="0" boundinertia="0"/><option gravity="0 0 -{STANDARD_GRAVITY}"/>'
        f"<worldbody>{text}</worldbody></mujoco>"
    )


def test_an_elastic_arm_sags():
    q = np.zeros((1, 6))
    _, moved = act("joint_compliance", moments(q), where=["A2"], compliance_rad_per_Nm=2e-6)
    drop = ARM.flange(q + moved.joint)[0, 2, 3] - ARM.flange(q)[0, 2, 3]
    # 165 N m about A2 (arm 140, tool 2.5 kg at 1235 mm less the flange's reach) over 1165 mm
    torque = 140.0 + 2.5 * STANDARD_GRAVITY * (1190 + 70 - 25) * 1e-3
    assert drop == pytest.approx(-2e-6 * torque * (1190 - 25), rel=0.01)


def test_base_tilts_towards_the_arm_in_proportion_to_the_moment():
    q = np.radians([[0.0, -45, 45, 0, 0, 0], [90.0, -45, 45, 0, 0, 0]])
    _, moved = act("base_compliance", moments(q), compliance_rad_per_Nm=1e-6)
    tilt = moved.frame[:, 0, 3:]
    weight, lever = 0.0, 0.0
    frames = ARM.frames(q[:1])[0]
    for mass, com, T in zip(MASSES.mass, MASSES.com, frames[1:], strict=True):
        weight, lever = weight + mass, lever + mass * (T[:3, :3] @ com + T[:3, 3])[0]
    lever += MASSES.payload_mass * (frames[-1][:3, :3] @ MASSES.payload_com + frames[-1][:3, 3])[0]
    assert tilt[0, 1] == pytest.approx(1e-6 * lever * 1e-3 * STANDARD_GRAVITY, rel=1e-3)  # leans forward: turns about +y
    assert tilt[1, 0] == pytest.approx(tilt[0, 1], rel=1e-2)  # A1 by +90 deg is clockwise: the arm points to -y, so about +x


def test_mount_sags_along_gravity_whatever_the_attitude():
    q = spread_q(20)
    effect, moved = act("mount_compliance", moments(q), kind="shift")
    down = np.einsum("pij,pj->pi", ARM.flange(q)[:, :3, :3], moved.frame[:, 6, :3])
    np.testing.assert_allclose(down, np.tile([0, 0, -effect.shift * 2.5 * STANDARD_GRAVITY], (20, 1)), atol=1e-12)
    _, tilted = act("mount_compliance", moments(q), kind="tilt")
    np.testing.assert_allclose(
        np.einsum("pi,i->p", tilted.frame[:, 6, 3:], MASSES.payload_com), 0, atol=1e-9
    )  # about an axis across the lever
    assert not tilted.frame[:, 6, :3].any()


def test_transmission_error_has_the_stated_orders_and_amplitudes():
    turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    q = np.tile(turn[:, None], (1, 6))
    _, moved = act("gear_transmission_error", moments(q), where="A4", order=[2, 50], amplitude_deg=[0.02, 0.005], phase_deg=[30, -90])
    assert not np.delete(moved.joint, 3, axis=1).any()
    lines = np.fft.rfft(np.degrees(moved.joint[:, 3])) / len(turn) * 2
    assert abs(lines[2]) == pytest.approx(0.02, rel=1e-3)
    assert abs(lines[50]) == pytest.approx(0.005, rel=1e-3)
    assert np.degrees(np.angle(lines[2])) == pytest.approx(30 - 90, abs=0.1)  # a sine is a cosine 90 deg late
    assert np.sort(np.abs(lines))[-3] < 1e-5


def test_backlash_depends_on_where_the_joint_came_from_and_nothing_else():
    q = spread_q(40)
    direction = np.sign(np.diff(np.vstack([q[:1] - 0.1, q]), axis=0))
    _, moved = act("backlash", moments(q, direction), where="A5", width_deg=0.02)
    np.testing.assert_allclose(np.degrees(moved.joint[:, 4]), -0.01 * direction[:, 4], atol=1e-12)


def test_backlash_remembers_while_the_joint_stands():
    """A joint that did not move keeps the side it was on; this is a state, not a function of the last command."""
    q = np.zeros((4, 6))
    q[1:, 1] = 0.5
    direction = np.zeros((4, 6))
    direction[0, 1], direction[1, 1] = 1, 1
    _, moved = act("backlash", moments(q, direction), where="A2", width_deg=0.02)
    np.testing.assert_allclose(np.degrees(moved.joint[1:, 1]), -0.01)


def test_scale_coupling_and_step():
    q = spread_q(60)
    at = moments(q)
    np.testing.assert_allclose(act("joint_scale", at, where="A2", ratio=2e-4)[1].joint[:, 1], 2e-4 * q[:, 1], rtol=1e-9)
    moved = act("wrist_coupling", at, where=["A4", "A5"], ratio=-3e-4)[1].joint
    np.testing.assert_allclose(moved[:, 4], -3e-4 * q[:, 3])
    assert not moved[:, [0, 1, 2, 3, 5]].any()
    step = np.degrees(act("joint_step", at, where="A6", at_pose=25, step_deg=0.03)[1].joint[:, 5])
    np.testing.assert_allclose(step, [0.0] * 25 + [0.03] * 35)


def test_a_step_counts_poses_not_exposures():
    q = np.repeat(spread_q(4), 3, axis=0)
    at = moments(q)
    at.arrival[:] = np.repeat([5, 9, 12, 20], 3)  # the arm also came to rest in between, where nothing was exposed
    step = act("joint_step", at, where="A1", at_pose=2, step_deg=0.1)[1].joint[:, 0]
    np.testing.assert_allclose(np.degrees(step), [0] * 6 + [0.1] * 6)


def test_a_link_grows_along_itself_with_its_temperature():
    q = spread_q(30)
    robot = 21 + 8 * -np.expm1(-np.arange(30) / 10)
    effect, moved = act("thermal_growth", moments(q, robot=robot), where="link2", growth_mm_per_K=0.015)
    frames, grown = ARM.frames(q), ARM.frames(q, moved.frame)
    length = [np.linalg.norm(f[:, 2, :3, 3] - f[:, 1, :3, 3], axis=1) for f in (frames, grown)]
    np.testing.assert_allclose(length[1] - length[0], 0.015 * (robot - robot[0]), atol=1e-9)
    np.testing.assert_allclose(grown[:, :, :3, :3], frames[:, :, :3, :3], atol=1e-12)
    slow = act("thermal_growth", moments(q, robot=robot), where="link2", growth_mm_per_K=0.015, lag_s=80.0)[1]
    assert np.all(np.linalg.norm(slow.frame[1:, 2], axis=1) < np.linalg.norm(moved.frame[1:, 2], axis=1))


def test_a_warm_bracket_turns_the_zero_of_its_joint():
    robot = np.linspace(21.0, 29.0, 9)
    effect, moved = act("thermal_zero_shift", moments(spread_q(9), robot=robot), where="A3", bracket_mm=6.0)
    np.testing.assert_allclose(moved.joint[:, 2], effect.truth()["zero_rad_per_K"] * (robot - 21.0), rtol=1e-6, atol=1e-15)
    assert not np.delete(moved.joint, 2, axis=1).any()


def test_a_wrong_payload_shows_only_through_elasticity():
    q = spread_q(25)
    at = moments(q)
    rigid = act("payload", at, mass_kg=6.0, com_mm=[0, 0, 150], compliance_rad_per_Nm=0.0)[1]
    assert not rigid.joint.any()
    heavy = act("payload", at, mass_kg=6.0, com_mm=[10, -5, 70], compliance_rad_per_Nm=2e-6)[1].joint
    light = act("payload", at, mass_kg=2.5, com_mm=[10, -5, 70], compliance_rad_per_Nm=2e-6)[1].joint
    load = ARM.flange(q)
    lever = np.einsum("pij,j->pi", load[:, :3, :3], [10, -5, 70]) + load[:, :3, 3] - ARM.frames(q)[:, 1, :3, 3]
    extra = np.einsum("pi,pi->p", ARM.frames(q)[:, 1, :3, 2], np.cross(lever, [0, 0, -3.5 * STANDARD_GRAVITY])) * 1e-3
    np.testing.assert_allclose((heavy - light)[:, 1], 2e-6 * extra, rtol=2e-3, atol=1e-9)


def test_latency_needs_motion():
    q = spread_q(5)
    still = act("exposure_latency", moments(q), latency_s=0.01)[1]
    assert not still.joint.any()
    at = moments(q)
    at.velocity[:] = 0.2
    np.testing.assert_allclose(act("exposure_latency", at, latency_s=0.01)[1].joint, 0.002)


def test_mount_shift_moves_the_scanner_once():
    q = spread_q(10)
    moved = act("mount_shift", moments(q), at_pose=4, translation_mm=[0.1, 0, 0], rotation_deg=[0, 0, 0.02])[1]
    before = ARM.frames(q)[:, -1] @ HAND_EYE
    after = ARM.frames(q, moved.frame)[:, -1] @ HAND_EYE
    np.testing.assert_allclose(after[:4], before[:4])
    step = np.einsum("pji,pj->pi", ARM.flange(q)[:, :3, :3], after[:, :3, 3] - before[:, :3, 3])
    lever = HAND_EYE[:3, 3]
    np.testing.assert_allclose(step[4:], np.tile([0.1 - np.radians(0.02) * lever[1], np.radians(0.02) * lever[0], 0], (6, 1)), atol=1e-6)


def test_strength_scales_and_seed_decides():
    q = spread_q(30)
    weak, strong = (act("joint_scale", moments(q), strength=s, seed=7)[1].joint for s in (0.5, 2.0))
    np.testing.assert_allclose(strong, 4 * weak, rtol=1e-6)
    other = act("joint_scale", moments(q), strength=2.0, seed=8)[0].truth()
    assert other != act("joint_scale", moments(q), strength=2.0, seed=7, facts=cell(q))[0].truth()

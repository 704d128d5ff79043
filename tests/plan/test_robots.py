"""The shipped arms against their published forward kinematics, reach and gravity moments."""

import ast
import json

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from plan_folder import PLANS, ROOT

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.geometry.gravity import gravity_torque
from mbcacq.geometry.numerical_inverse import NumericalInverse, with_full_turns
from mbcacq.model.cell_schema import RobotSpec
from mbcacq.plan.inverse_kinematics import OrthoParallelInverse, inverse_kinematics

MODELS = ROOT.parent / "shared" / "facts" / "kuka_models.json"
ARMS = sorted(path.stem for path in (PLANS / "robots").glob("kr*.yaml"))


def robot(name):
    return RobotSpec.model_validate(yaml.safe_load((PLANS / "robots" / f"{name}.yaml").read_text())).model()


# X and Z (mm) of the flange with the upper arm upright and the forearm level, A = (0, -90, 90, 0, 0, 0): a1 + c3 + c4, c1 + c2 + z-off
UPRIGHT = {
    "kr6_r700_sixx": (470, 750),
    "kr6_r900_sixx": (525, 890),
    "kr10_r1100_sixx": (620, 995),
    "kr6_r900_2": (535, 880),
    "kr10_r900_2": (535, 880),
    "kr10_r1100_2": (630, 985),
    "kr16_r1610_2": (968, 1450),
    "kr16_r2010_2": (1173, 1650),
    "kr20_r1810_2": (1173, 1450),
    "kr70_r2100": (1395, 1515),
    "kr120_r2700_2": (1765, 1910),
    "kr150_r3100_2": (1965, 2110),
    "kr210_r2700_2": (1765, 1910),
    "kr300_r2700_2": (1790, 1910),
}


@pytest.mark.parametrize("name", ARMS)
def test_upright_arm_agrees_with_its_drawing_in_reach_and_directions(name):
    chain = robot(name).chain
    T = chain.flange(np.radians([[0, -90, 90, 0, 0, 0.0]]))[0]
    assert T[:3, 3] == pytest.approx([UPRIGHT[name][0], 0, UPRIGHT[name][1]], abs=2e-3)
    assert T[:3, 2] == pytest.approx([1, 0, 0], abs=1e-9)  # the flange's z points away from the arm
    turned = chain.flange(np.radians([[10, -90, 90, 0, 0, 0], [0, -80, 90, 0, 0, 0], [0, -90, 100, 0, 0, 0], [0, -90, 90, 0, 10, 0.0]]))[
        :, :3, 3
    ]
    assert turned[0, 1] < -50  # A1 clockwise, seen from above
    assert (turned[1:, 2] < T[2, 3] - 10).all()  # A2, A3 and A5 downwards


@pytest.mark.parametrize("name", ARMS)
def test_forward_kinematics_of_the_published_model(name):
    if not MODELS.exists():
        pytest.skip("the collection of published arm models is not beside this checkout")
    models = json.loads(MODELS.read_text())
    table = models.get(name) or models["exp:" + name.replace("_", "")]
    arm = robot(name)
    for angles, frame in table["fk_tool0"].items():
        expected = se3.from_abc(np.array(frame[:3]), np.radians(frame[3:]))
        found = arm.chain.flange(np.radians([ast.literal_eval(angles)]))[0]
        assert found[:3, 3] == pytest.approx(expected[:3, 3], abs=0.02)
        assert found[:3, :3] == pytest.approx(expected[:3, :3], abs=3e-5)
    assert np.degrees(arm.limits) == pytest.approx(np.array(table["limits_deg"]), abs=0.01)


# N m about A2 and A3, all axes 0, no tool, from the links' published centres of gravity in the base frame
MOMENTS = {
    "kr6_r900_2": (108, 26),
    "kr10_r1100_2": (140, 32),
    "kr16_r1610_2": (674, 126),
    "kr20_r1810_2": (721, 159),
    "kr120_r2700_2": (4975, 1071),
    "kr70_r2100": (2038, 510),
}


@pytest.mark.parametrize("name", MOMENTS)
def test_gravity_moments_of_the_stretched_arm(name):
    arm = robot(name)
    torque = gravity_torque(arm.chain, arm.chain.frames(np.zeros((1, 6))), arm.mass, arm.com, 0.0, np.zeros(3), arm.gravity)[0]
    assert torque[1] == pytest.approx(MOMENTS[name][0], rel=0.005)
    assert torque[2] == pytest.approx(MOMENTS[name][1], rel=0.02)
    assert torque[0] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("name", ARMS)
def test_inverse_kinematics_inverts_forward_kinematics(name):
    """Every posture within the limits is among the solutions of its own flange pose, and every solution leads there."""
    arm = robot(name)
    solver = inverse_kinematics(arm)
    q = np.random.default_rng(4).uniform(arm.limits[:, 0], arm.limits[:, 1], (60, 6))
    q = q[np.abs(q[:, 4]) > 0.01]  # a straight wrist has no single answer
    T = arm.chain.flange(q)
    for posture, pose, found in zip(q, T, solver.solutions(T), strict=True):
        assert np.abs(found - posture).max(axis=1).min() < 1e-6
        assert arm.chain.flange(found) == pytest.approx(np.broadcast_to(pose, (len(found), 4, 4)), abs=1e-6)
        assert (found >= arm.limits[:, 0]).all()
        assert (found <= arm.limits[:, 1]).all()


@given(base=st.tuples(*[st.floats(-500, 500)] * 3), turn=st.tuples(*[st.floats(-3, 3)] * 3))
def test_out_of_reach_has_no_solution(base, turn):
    arm = robot("kr10_r1100_2")
    direction = np.array(base) + 1e-3
    far = se3.from_abc(direction / np.linalg.norm(direction) * 1600, np.array(turn))
    assert len(inverse_kinematics(arm).solutions(far[None])[0]) == 0


def test_arms_that_the_closed_form_does_not_fit_are_named():
    spec = yaml.safe_load((PLANS / "robots" / "kr10_r1100_2.yaml").read_text())

    def refused(link, **changes):
        links = [dict(x) for x in spec["links"]]
        links[link].update(changes)
        with pytest.raises(ConfigError) as error:
            OrthoParallelInverse.of(RobotSpec.model_validate({**spec, "links": links}).model())
        return str(error.value)

    assert "axes 4, 5 and 6 do not meet" in refused(4, d_mm=60)
    assert "axes 2 and 3 are not parallel" in refused(1, alpha_deg=90)
    assert "axes 1 and 2 are not perpendicular" in refused(0, alpha_deg=-80)
    short = RobotSpec.model_validate({**spec, "links": spec["links"][:5]}).model()
    with pytest.raises(ConfigError, match="it has 5 axes, not 6"):
        OrthoParallelInverse.of(short)


# The flange in mm at the given angles (deg), from the makers' drawings: UR arms stretched along -x, Panda bent as in its data sheet's
# table, iiwa and CRX upright.
DRAWN = {
    "ur10": ((0, 0, 0, 0, 0, 0), (-612 - 572.3, -163.941 - 92.2, 127.3 - 115.7)),
    "ur10e": ((0, 0, 0, 0, 0, 0), (-612.7 - 571.55, -174.15 - 116.55, 180.7 - 119.85)),
    "panda": ((0, 0, 0, 0, 0, 0, 0), (88, 0, 333 + 316 + 384 - 107)),
    "iiwa14": ((0, 0, 0, 0, 0, 0, 0), (0, 0, 360 + 420 + 400 + 126)),
    "crx10ia": ((0, 0, 0, 0, 0, 0), (540 + 160, -150, 245 + 540)),
}


@pytest.mark.parametrize("name", DRAWN)
def test_arms_of_other_makers_agree_with_their_drawings(name):
    angles, flange = DRAWN[name]
    arm = robot(name)
    assert arm.chain.flange(np.radians([angles]))[0, :3, 3] == pytest.approx(flange, abs=1e-6)
    assert arm.speed is not None


@pytest.mark.parametrize("name", DRAWN)
def test_arms_of_other_makers_reach_what_they_reached(name):
    """A pose taken at random joint angles is reached again, within the limits, and where six axes do it, by those very angles too."""
    arm = robot(name)
    q = np.random.default_rng(3).uniform(arm.limits[:, 0], arm.limits[:, 1], (12, arm.n))
    T = arm.chain.flange(q)
    for posture, pose, found in zip(q, T, inverse_kinematics(arm).solutions(T), strict=True):
        assert len(found)
        assert arm.chain.flange(found) == pytest.approx(np.broadcast_to(pose, (len(found), 4, 4)), abs=1e-5)
        assert ((found >= arm.limits[:, 0]) & (found <= arm.limits[:, 1])).all()
        if arm.n == 6:
            assert np.abs(found - posture).max(axis=1).min() < 1e-5


def test_every_posture_of_a_ur_arm_is_found():
    """A UR reaches a pose in the middle of its reach by two shoulders, two elbows and two wrists: eight ways."""
    arm = robot("ur10")
    found = NumericalInverse(arm.chain, arm.limits).branches(arm.chain.flange(np.radians([[20, -70, 80, -100, 60, 30]])))[0]
    assert len(found) == 8
    frames = arm.chain.frames(found)
    shoulder = np.sign(np.einsum("pi,pi->p", frames[:, 1, :3, 0], frames[:, 5, :3, 3]))
    kinds = {(s, np.sign(np.sin(q[2])), np.sign(np.sin(q[4]))) for s, q in zip(shoulder, found, strict=True)}
    assert len(kinds) == 8


def test_seven_axes_reach_one_pose_with_different_elbows():
    arm = robot("panda")
    T = arm.chain.flange(np.radians([[0, 20, 10, -110, 0, 130, 40]]))
    found = NumericalInverse(arm.chain, arm.limits).branches(T)[0]
    elbows = arm.chain.frames(found)[:, 4, :3, 3]
    assert np.linalg.norm(elbows - elbows.mean(axis=0), axis=1).max() > 100
    assert arm.chain.flange(found) == pytest.approx(np.broadcast_to(T[0], (len(found), 4, 4)), abs=1e-5)


def test_full_turns_within_the_limits_are_all_there():
    found = with_full_turns(np.radians([[10.0, 50.0]]), np.radians([-360, -170]), np.radians([360, 170.0]))
    assert np.degrees(found).round(6).tolist() == [[-350, 50], [10, 50]]
    assert len(with_full_turns(np.radians([[10.0, 175.0]]), np.radians([-360, -170]), np.radians([360, 170.0]))) == 0

"""The exported MuJoCo model holds the effects that bodies and hinges can express: at rest it stands where the effects say."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import EffectTerm
from mbcacq.effects.functions import DescribedPart, linear, of
from mbcacq.effects.learnt_range import LearntRange
from mbcacq.exports.mjcf import expressed_effects, mjcf
from mbcacq.geometry import se3
from mbcacq.model import shipped
from mbcacq.model.cell_schema import RobotSpec


def effect(name, where, cause, parts, value):
    one = np.array([value])
    return EffectTerm(
        name=name,
        where=where,
        depends_on=cause,
        parts=tuple(parts),
        names=("c",),
        units=("",),
        coefficients=one,
        std=0.01 * one,
        sigma=np.array([np.inf]),
        typical=one,
    )


def compliance(axis, value):
    cause = f"gravity_torque_{axis + 1}"
    return effect("joint_compliance", (f"A{axis + 1}",), cause, [DescribedPart("joint", axis, 0, (linear(cause),))], value)


TILT = [DescribedPart("frame", 0, 3 + k, (linear(f"gravity_moment_0_{a}"),)) for k, a in enumerate("xyz")]
GEAR = [DescribedPart("joint", 0, 0, (of("q1", "sin", 2.0),))]


@pytest.fixture
def learnt():
    robot = RobotSpec.model_validate(yaml.safe_load(shipped.robot_file("kr10_r1100_2").read_text())).model()
    terms = (
        compliance(1, 2e-6),
        compliance(2, 3e-6),
        effect("base_compliance", ("base",), "gravity_torque_2", TILT, 2e-7),
        effect("joint_scale", ("A1",), "q1", [DescribedPart("joint", 0, 0, (linear("q1"),))], 3e-4),
        effect("wrist_coupling", ("A4", "A6"), "q4", [DescribedPart("joint", 5, 0, (linear("q4"),))], -2e-4),
    )
    return EffectModel(robot, terms)


def at_rest(mujoco, text, q):
    """(4, 4) mm of the scanner where every spring is in balance with the weight and every tied hinge follows its angle."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    for k, angle in enumerate(q):
        data.joint(f"joint_{k + 1}").qpos = angle
    for e in range(model.neq):
        data.qpos[model.jnt_qposadr[model.eq_obj1id[e]]] = model.eq_data[e, 1] * data.qpos[model.jnt_qposadr[model.eq_obj2id[e]]]
    springs = [j for j in range(model.njnt) if np.max(model.jnt_stiffness[j]) > 0]
    for _ in range(4):
        mujoco.mj_forward(model, data)
        for j in springs:
            data.qpos[model.jnt_qposadr[j]] = -data.qfrc_bias[model.jnt_dofadr[j]] / np.max(model.jnt_stiffness[j])
    mujoco.mj_forward(model, data)
    site = data.site("scanner")
    return se3.transform(site.xmat.reshape(3, 3), 1e3 * site.xpos)


def test_what_was_learnt_over_a_part_of_the_range_is_no_constraint_between_hinges(learnt):
    """A constraint would go on as far as the joint turns, the effect does not."""
    *others, scale, coupling = learnt.terms
    known = LearntRange.of("q1", np.radians(np.arange(-30.0, 31.0)), counts_turns=True)
    held = replace(scale, ranges={"q1": known}, clamped=("q1",))
    found = expressed_effects(replace(learnt, terms=(*others, held, coupling)))
    assert found.left == ["joint_scale at A1"]
    assert set(found.ratio) == {(5, 3)}


def test_at_rest_it_stands_where_the_effects_say(learnt):
    mujoco = pytest.importorskip("mujoco")
    chain = learnt.robot.chain
    chain = chain.with_errors(np.random.default_rng(2).standard_normal((6, 5)) * [1e-3, 0.3, 0.3, 1e-3, 1e-3])
    T_flange_scanner = se3.from_abc(np.array([1.0, 2, 265]), np.radians([90, 0, 180.0]))
    text = mjcf(chain, T_flange_scanner, "arm", (), learnt)
    for q in np.radians([[70.0, -70, 100, 60, 40, -50], [-90.0, -10, 40, -100, 60, 20]]):
        expected = (learnt.frames(chain, q[None])[0, -1] @ T_flange_scanner)[:3, 3]
        rigid = (chain.flange(q[None])[0] @ T_flange_scanner)[:3, 3]
        assert np.linalg.norm(expected - rigid) > 0.3
        assert at_rest(mujoco, text, q)[:3, 3] == pytest.approx(expected, abs=2e-3)


def test_what_a_model_of_hinges_cannot_express_is_named(learnt):
    more = EffectModel(learnt.robot, (*learnt.terms, effect("gear_transmission_error", ("A1",), "q1", GEAR, 1e-4)))
    assert expressed_effects(more).left == ["gear_transmission_error at A1"]
    assert set(expressed_effects(more).compliance) == {1, 2}


def test_the_exported_arm_is_imported_again_with_its_six_axes(learnt, tmp_path):
    pytest.importorskip("mujoco")
    from mbcacq.model.robot_import import import_robot

    (tmp_path / "arm.xml").write_text(mjcf(learnt.robot.chain, np.eye(4), "arm", (), learnt))
    found = import_robot(tmp_path / "arm.xml", base="base", flange="flange")
    assert found.joints == tuple(f"joint_{k}" for k in range(1, 7))
    arm = RobotSpec.model_validate(yaml.safe_load(found.text)).model()
    q = np.radians([[10.0, -60, 80, 20, 30, 40]])
    made = found.T_given_base @ arm.chain.flange(q) @ found.T_flange_given
    assert made == pytest.approx(learnt.robot.chain.flange(q), abs=1e-6)
    assert arm.mass[1:4] == pytest.approx(learnt.robot.mass[1:4], rel=1e-5)


def test_masses_are_called_placeholders_where_nobody_knows_them(learnt):
    mujoco = pytest.importorskip("mujoco")

    def numbers(effects):
        model = mujoco.MjModel.from_xml_string(mjcf(learnt.robot.chain, np.eye(4), "arm", (), effects))
        return {model.numeric(k).name: model.numeric(k).data[0] for k in range(model.nnumeric)}

    assert numbers(None) == {"placeholder_mass_kg": 1.0}
    assert numbers(learnt) == {}

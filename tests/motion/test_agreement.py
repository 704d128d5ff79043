"""A parameter that was found both in the poses of a run and in its motion."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

from mbcacq.diagnosis.effect_found import EffectFound
from mbcacq.diagnosis.findings import ComparedEffect, ComparedSet, EvidenceSummary, GivenEvidence, NotSeparable
from mbcacq.diagnosis.motion.combine import PosesAndMotion
from mbcacq.diagnosis.motion.result import ChannelEvidence, MotionDiagnosis
from mbcacq.diagnosis.result import Diagnosis, FitFigures, FitSummary, HeldOutFigures
from mbcacq.effects.effect import ParameterEstimate, number
from mbcacq.errors import ConfigError

FIT = FitSummary(FitFigures(0.1, 0.05, 4.0, 1.0), HeldOutFigures(0.1, 0.05, 4.0, 1.0, "station"), 0.05)


def of_poses(*effects, not_separable=()):
    """effects: name, locations and parameters."""
    found = tuple(EffectFound(name=n, where=w, parameters=p, p_value=0.0, held_out_gain=1.0) for n, w, p in effects)
    return Diagnosis(verdict="explained", mismatch=(), effects=found, fit=FIT, not_separable=not_separable)


def poses(value, std):
    return of_poses(("joint_compliance", ("A2",), {"A2.compliance_rad_per_Nm": number(value, std)}))


def both(poses, motion):
    return PosesAndMotion(poses, motion)


COMPARED = {"name": "joint_compliance", "where": ["A2"], "parameters": {"com_mm": {"value": [1.0, 2.0], "std": [0.1, 0.2]}}, "tried": True}
COMPARED |= {"prior": {}, "log_prior": -2.0}
SETS = [{"effects": [COMPARED], "log_odds": 0.0}, {"effects": [], "log_odds": -30.0}]
EVIDENCE = {"poses": 0, "log_e_value": 30.0, "least_log_e_value": 4.6, "sets": SETS, "untried": []}


def motion(value=4.2e-6, std=1e-7, named=True):
    error = {"before_rms": 0.03, "after_rms": 0.002, "before_chi2_dof": 200.0, "after_chi2_dof": None}
    channel = {"channel": "q_joint", "at": "A2", "unit": "deg", "noise_floor": 1e-4, "train": error, "held_out": error}
    channel |= {"refused_rms": None}
    unknown = {"name": "unknown", "where": ["A2"], "channel": "q_joint", "depends_on": "q2", "parameters": {}, "p_value": 1e-9}
    unknown |= {"held_out_gain": 0.1, "shape": {"x": [0.0, 1.0], "y": [0.2, 0.3]}, "alternatives": []}
    step = {"adds": ["A2.compliance_rad_per_Nm"], "held_out_before_rms": {"A2": 0.03}, "held_out_after_rms": {"A2": 0.002}}
    effect = {"name": "joint_compliance", "where": ["A2"], "depends_on": "tau2", "channel": "q_joint"}
    effect |= {"parameters": {"A2.compliance_rad_per_Nm": {"value": value, "std": std}}, "p_value": 1e-12, "held_out_gain": 0.8}
    effect |= {
        "held_out_gain_here": 0.9,
        "alternatives": [{"name": "backlash", "where": ["A2"], "held_out_gain": 0.2, "odds": 0.1}],
        "steps": [step],
        "notes": [],
        "trend": "",
    }
    mean = {"before_chi2_dof": 200.0, "after_chi2_dof": None}
    return {
        "format": "mbcacq-diagnosis/3",
        "verdict": "partly_explained",
        "mismatch": [{"at": "A2", "channel": "q_joint", "depends_on": "tau2", "share": 0.8, "p_value": 1e-12}],
        "effects": [effect, unknown] if named else [unknown],
        "fit": {"train": mean, "held_out": mean | {"split": "trajectory"}, "channels": [channel]},
        "not_separable": [{"effects": ["payload:mount", "arm"], "correlation": 0.98, "odds": None}],
        "advice": [{"reason": "move A2 further", "poses_deg": [[0.0, -90.0]]}],
        "inertial": [
            {"body": "link1", "mass_kg": 3.0, "first_moment_kg_mm": [1.0, 0.0, 0.0], "tensor_kg_m2": [0.1, 0.0, 0.0, 0.1, 0.0, 0.1]}
        ],
        "suspicions": [],
        "evidence": [{"channel": "q_joint", "evidence": EVIDENCE}],
    }


def test_two_measurements_of_one_compliance():
    found = both(poses(4.0e-6, 1e-7), MotionDiagnosis.from_json(motion())).agreement
    assert [(a.parameter, a.agrees) for a in found] == [("A2.compliance_rad_per_Nm", True)]
    assert abs(found[0].sigmas - 1.414) < 1e-3
    assert not both(poses(4.0e-6, 1e-8), MotionDiagnosis.from_json(motion(std=1e-8))).agreement[0].agrees
    assert both(poses(4.0e-6, 1e-8), MotionDiagnosis.from_json(motion(named=False))).agreement == []


def test_combined_json_has_both_diagnoses_and_the_agreement():
    content = both(poses(4.0e-6, 1e-7), MotionDiagnosis.from_json(motion())).to_json()
    assert content["motion"] == motion()
    assert content["agreement"][0]["poses"] == {"value": 4.0e-6, "std": 1e-7}
    assert content["agreement"][0]["motion"] == {"value": 4.2e-6, "std": 1e-7}
    assert content["together"]["verdict"] == "partly_explained"


def test_poses_and_motion_are_read_from_json_as_they_were_written():
    written = both(poses(4.0e-6, 1e-7), MotionDiagnosis.from_json(motion()))
    content = json.loads(json.dumps(written.poses.to_json() | written.to_json(), allow_nan=False))
    assert PosesAndMotion.of_json(content).to_json() == written.to_json()


def test_a_contradiction_is_the_verdict_on_the_run():
    assert both(poses(4.0e-6, 1e-8), MotionDiagnosis.from_json(motion(std=1e-8))).verdict == "cannot_tell"


def test_diagnosis_of_motion_goes_through_json_and_pickle_unchanged():
    diagnosis = MotionDiagnosis.from_json(motion())
    assert json.loads(json.dumps(diagnosis.to_json(), allow_nan=False)) == motion()
    assert pickle.loads(pickle.dumps(diagnosis)).to_json() == motion()
    assert [e.name for e in diagnosis.named_effects] == ["joint_compliance"]


def test_version_1_of_a_motion_stays_readable():
    old = {key: content for key, content in motion().items() if key != "evidence"} | {"format": "mbcacq-diagnosis/1"}
    del old["effects"][0]["alternatives"][0]["odds"]
    now = motion() | {"evidence": []}
    now["effects"][0]["alternatives"][0]["odds"] = None
    assert MotionDiagnosis.from_json(old).to_json() == now


def test_diagnosis_of_motion_shows_its_effects_in_a_notebook():
    diagnosis = MotionDiagnosis.from_json(motion())
    assert "joint_compliance at A2 (q_joint)" in repr(diagnosis)
    assert "<td>joint_compliance</td><td>A2 (q_joint)</td>" in diagnosis._repr_html_()


def test_a_diagnosis_of_poses_is_no_diagnosis_of_motion():
    with pytest.raises(ConfigError, match="not the diagnosis of a motion"):
        MotionDiagnosis.from_json({"format": "mbcacq-diagnosis/1", "fit": {"train": {}, "held_out": {}}})


def in_poses(name, where, **parameters):
    return name, tuple(where), {key.replace("__", "."): ParameterEstimate(v, s) for key, (v, s) in parameters.items()}


def in_motion(name, where, **parameters):
    content = motion()
    estimates = {key.replace("__", "."): {"value": v, "std": s} for key, (v, s) in parameters.items()}
    content["effects"] = [content["effects"][0] | {"name": name, "where": where, "parameters": estimates}]
    return MotionDiagnosis.from_json(content)


def test_a_tool_of_12_kg_in_the_poses_contradicts_one_of_15_kg_in_the_motion():
    tool = in_poses("payload", ["mount"], mass_kg=(12.0, 0.5), com_mm=((0.0, 0.0, 90.0), (5.0, 5.0, 5.0)))
    found = in_motion("payload", ["mount"], mass_kg=(15.0, 0.2), com_mm=([3.0, -4.0, 95.0], [5.0, 5.0, 5.0]))
    assert [(a.parameter, a.agrees) for a in both(of_poses(tool), found).agreement] == [("mass_kg", False), ("com_mm", True)]
    text = both(of_poses(tool), found).in_words("", "")
    assert text.startswith(
        "Poses and motion contradict each other on payload at mount, mass: 12.0 ± 1.0 kg by the poses and 15.00 ± 0.40 kg"
    )


def test_a_balancer_s_torque_is_compared_by_the_angle_to_which_the_gear_gives_way():
    balancer = in_poses("gravity_compensator", ["A2"], A2__preload_deg=(-0.0344, 0.001), A2__zero_deg=(-90.0, 1.0))
    soft = in_poses("joint_compliance", ["A2"], A2__compliance_rad_per_Nm=(2e-7, 2e-9))
    torque = {"A2__preload_Nm": (3000.0, 30.0), "A2__zero_deg": (-95.0, 1.0)}
    found = {a.parameter: a for a in both(of_poses(balancer, soft), in_motion("gravity_compensator", ["A2"], **torque)).agreement}
    assert found["A2.preload_deg"].agrees
    assert found["A2.preload_deg"].motion.value == pytest.approx(-3000 * 2e-7 * 57.29578)
    assert not found["A2.zero_deg"].agrees  # 5 deg apart, 1.4 deg uncertain


def test_couplings_are_compared_where_they_join_the_same_joints():
    found = in_motion("wrist_coupling", ["A4", "A6"], ratio=(3e-4, 1e-5))
    alike, elsewhere = (in_poses("wrist_coupling", ["A4", at], ratio=(r, 1e-5)) for at, r in (("A6", 3.1e-4), ("A5", 9e-4)))
    assert [a.agrees for a in both(of_poses(alike), found).agreement] == [True]
    assert both(of_poses(elsewhere), found).agreement == []


def test_of_several_orders_those_of_one_order_are_compared():
    many = {"A4__order": ((60.0, 2.0), (0.1, 0.1)), "A4__phase_deg": ((10.0, 179.0), (2.0, 2.0))}
    one = {"A4__order": (2.05, 0.1), "A4__phase_deg": (-179.5, 2.0)}
    name = "gear_transmission_error"
    found = both(of_poses(in_poses(name, ["A4"], **many)), in_motion(name, ["A4"], **one)).agreement
    assert [(a.parameter, a.poses.value, a.agrees) for a in found] == [("A4.order", 2.0, True), ("A4.phase_deg", 179.0, True)]
    assert found[1].sigmas == pytest.approx(1.5 / 8**0.5)


def test_what_one_cannot_tell_apart_is_named_by_the_other():
    tool = in_poses("payload", ["mount"], mass_kg=(12.0, 0.5))
    (pair,) = both(of_poses(tool), MotionDiagnosis.from_json(motion())).decided
    assert (pair.effects, pair.named, pair.by) == (("payload:mount", "arm"), "payload:mount", "poses")
    alike = NotSeparable(("joint_compliance:A2", "backlash:A2"), np.nan)
    undecided = of_poses(tool, not_separable=(alike,))
    assert {(p.named, p.by) for p in both(undecided, MotionDiagnosis.from_json(motion())).decided} == {
        ("payload:mount", "poses"),
        ("joint_compliance:A2", "motion"),
    }


TOOL_PRIOR = {"mass_kg": number(20.0, 17.0)}


def compared(log_odds, *effects):
    """A set of effects: name, locations, parameters."""
    each = (ComparedEffect(n, w, p, prior=TOOL_PRIOR if "mass_kg" in p else {}, log_prior=-5.0) for n, w, p in effects)
    return ComparedSet(tuple(each), log_odds)


def evidence(*sets):
    return EvidenceSummary(40, 50.0, 4.6, (*sets, ComparedSet((), -900.0)))


def tool(mass, std):
    return in_poses("payload", ["mount"], mass_kg=(mass, std))


def soft(at, value, std):
    return in_poses("joint_compliance", [at], **{f"{at}__compliance_rad_per_Nm": (value, std)})


def load_in_question(odds, *sets):
    """A motion that cannot tell a load from the masses of the links, which its sets take as described to 10 %."""
    content = motion() | {"verdict": "cannot_tell"}
    content["not_separable"] = [{"effects": ["arm", "payload:mount"], "correlation": 0.98, "odds": odds}]
    return replace(MotionDiagnosis.from_json(content), evidence=(ChannelEvidence("tau", evidence(*sets)),))


BALANCER = in_poses("gravity_compensator", ["A2"], A2__preload_Nm=(1800.0, 200.0))
OF_MOTION = (compared(0.0, BALANCER), compared(-2.3, BALANCER, tool(32.0, 4.0)))


def test_a_load_that_masses_of_links_may_stand_for_is_open_until_the_poses_show_it():
    stiff = soft("A3", 1e-6, 1e-7)
    weak = replace(of_poses(), verdict="cannot_tell", evidence=evidence(compared(0.0, stiff), compared(-6.0, stiff, tool(25.0, 9.0))))
    strong = replace(weak, evidence=evidence(compared(0.0, stiff, tool(33.0, 3.0)), compared(-9.0, soft("A3", 1.2e-6, 1e-7))))
    asked = both(weak, load_in_question(1.0, *OF_MOTION))
    assert asked.together.decided
    assert asked.verdict == "cannot_tell"
    assert asked.decided == []
    answered = both(strong, load_in_question(1.0, *OF_MOTION))
    assert answered.verdict == "explained"
    (pair,) = answered.decided
    assert (pair.effects, pair.named, pair.by) == (("arm", "payload:mount"), "payload:mount", "both")
    assert str(pair) == "one of them cannot separate arm and payload:mount: both together name payload:mount"


def test_poses_and_motion_are_compared_with_the_effects_that_both_together_name():
    """A tool that is heavier than declared makes a joint look softer, unless it is in the set: the poses alone leave it out."""
    of_motion = load_in_question(1.0, compared(0.0, BALANCER, tool(36.0, 3.0)), compared(-7.0, BALANCER))
    known = soft("A3", 1e-6, 1e-9)
    found = EffectFound(name=known[0], where=known[1], parameters=known[2], p_value=0.0, held_out_gain=1.0)
    of_motion = replace(of_motion, effects=(found,))
    without = compared(0.0, soft("A3", 1.2e-6, 4e-8))
    beside = compared(-1.2, soft("A3", 1.01e-6, 9e-8), tool(38.0, 4.0))
    given = GivenEvidence(("joint_compliance:A3",), evidence(without, beside))
    one_problem = PosesAndMotion(replace(of_poses(), evidence=evidence(without, beside)), of_motion, given)
    assert "payload:mount" in one_problem.together.sets[0].effects
    assert [(a.name, a.poses.value, a.agrees) for a in one_problem.agreement] == [("joint_compliance", 1.01e-6, True)]

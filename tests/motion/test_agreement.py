"""A parameter that was found both in the poses of a run and in its motion."""

import json
import pickle

import pytest

from mbcacq.diagnosis.motion.combine import agreement, combined
from mbcacq.diagnosis.motion.result import MotionDiagnosis
from mbcacq.errors import ConfigError


def poses(value, std):
    return {
        "effects": [{"name": "joint_compliance", "where": ["A2"], "parameters": {"A2.compliance_rad_per_Nm": {"value": value, "std": std}}}]
    }


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
        "alternatives": [{"name": "backlash", "where": ["A2"], "held_out_gain": 0.2}],
        "steps": [step],
        "notes": [],
    }
    mean = {"before_chi2_dof": 200.0, "after_chi2_dof": None}
    return {
        "format": "mbcacq-diagnosis/1",
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
    }


def test_two_measurements_of_one_compliance():
    found = agreement(poses(4.0e-6, 1e-7), MotionDiagnosis.from_json(motion()))
    assert [(a.parameter, a.agrees) for a in found] == [("A2.compliance_rad_per_Nm", True)]
    assert abs(found[0].sigmas - 1.414) < 1e-3
    assert not agreement(poses(4.0e-6, 1e-8), MotionDiagnosis.from_json(motion(std=1e-8)))[0].agrees
    assert agreement(poses(4.0e-6, 1e-8), MotionDiagnosis.from_json(motion(named=False))) == []


def test_combined_json_has_both_diagnoses_and_the_agreement():
    both = combined(poses(4.0e-6, 1e-7), MotionDiagnosis.from_json(motion()))
    assert both["motion"] == motion()
    assert both["agreement"][0]["poses"] == {"value": 4.0e-6, "std": 1e-7}
    assert both["agreement"][0]["motion"] == {"value": 4.2e-6, "std": 1e-7}


def test_diagnosis_of_motion_goes_through_json_and_pickle_unchanged():
    diagnosis = MotionDiagnosis.from_json(motion())
    assert json.dumps(diagnosis.to_json()) == json.dumps(motion())
    assert pickle.loads(pickle.dumps(diagnosis)).to_json() == motion()
    assert [e.name for e in diagnosis.named_effects] == ["joint_compliance"]


def test_diagnosis_of_motion_shows_its_effects_in_a_notebook():
    diagnosis = MotionDiagnosis.from_json(motion())
    assert "joint_compliance at A2 (q_joint): held-out gain 80.0%" in repr(diagnosis)
    assert "<td>joint_compliance</td><td>A2</td>" in diagnosis._repr_html_()


def test_a_diagnosis_of_poses_is_no_diagnosis_of_motion():
    with pytest.raises(ConfigError, match="not the diagnosis of a motion"):
        MotionDiagnosis.from_json({"format": "mbcacq-diagnosis/1", "fit": {"train": {}, "held_out": {}}})

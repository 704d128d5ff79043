"""What is found in one recording of motion is tried on another, of which nothing is learnt."""

import numpy as np
import pytest
from test_diagnose_trajectories import recording

from mbcacq import diagnose
from mbcacq.diagnosis.motion.diagnose import check_trajectories
from mbcacq.diagnosis.motion.result import MotionDiagnosis
from mbcacq.errors import ConfigError

FRICTION = {"coulomb": 5.0, "compliance": 1e-5, "seconds": 4.0}


def left(checks):
    return {(one.channel, one.at): one.error for one in checks[0].channels}


@pytest.fixture(scope="module")
def learnt():
    return recording(1, **FRICTION)


@pytest.fixture(scope="module")
def same_arm(learnt):
    return left(check_trajectories([learnt], [("b", recording(2, **FRICTION))]))


def test_effects_of_the_arm_leave_the_noise_of_the_other_recording(same_arm):
    assert set(same_arm) == {(channel, f"A{j}") for channel in ("tau", "q_joint") for j in (1, 2)}
    for (channel, _), error in same_arm.items():
        noise = 0.3 if channel == "tau" else np.degrees(2e-6)
        assert error.before_rms > 1.2 * noise
        assert error.after_rms == pytest.approx(noise, rel=0.1)


def test_another_friction_of_the_other_recording_stays_in_its_error(learnt, same_arm):
    """Learnt from both, 5 and 9 N m would meet at 7 and leave 2; learnt from the first alone they leave 4."""
    other = left(check_trajectories([learnt], [("b", recording(2, **FRICTION | {"coulomb": 9.0}))]))
    for axis in ("A1", "A2"):
        assert other["tau", axis].after_rms == pytest.approx(np.hypot(4.0, 0.3), rel=0.1)


def test_a_diagnosis_carries_its_checks_in_text_and_json(learnt):
    found = diagnose([learnt], check=[recording(2, **FRICTION)])
    assert found.motion.fit.channels == diagnose([learnt]).motion.fit.channels  # and nothing of the diagnosis is decided by them
    read = MotionDiagnosis.from_json(found.motion.to_json())
    assert read.checks == found.motion.checks
    assert "Tried on the other recording, from which nothing was learnt:\n  A1 torque" in found.in_words(whole=True)
    assert "Tried on the other recording, from which nothing was learnt, before and after:" in found.text


def test_motion_is_not_tried_on_poses(learnt, tmp_path):
    with pytest.raises(ConfigError, match="give --check recordings of motion"):
        diagnose([learnt], check=[tmp_path])

"""A short run that conceals a tool, a balancer, backlash and elastic joints: what neither its poses nor its motion tell, both do."""

import numpy as np
import pytest
import yaml

pytest.importorskip("mujoco")

from concealed_run import DECLARED_COM_MM, DECLARED_KG, SOFT, chosen_poses, faults, observed_poses, recorded_moves, tool

import mbcacq
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.given_effects import evidence_given
from mbcacq.diagnosis.motion.combine import PosesAndMotion
from mbcacq.diagnosis.motion.diagnose import diagnose_trajectories
from mbcacq.effects.effect import label_of
from mbcacq.plan import expand, load

FURTHER_KG, SEED, POSES = 15.0, 3, 30
CONCEALED = {"payload:mount", "gravity_compensator:A2", "backlash:A4", "joint_compliance:A2", "joint_compliance:A3"}


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plan")
    mbcacq.new_plan("kr210_r2700_2", "gocator-3210", "mbc-8", folder / "plan.yaml", mbcacq.NewPlanOptions(poses=40))
    plan = yaml.safe_load((folder / "plan.yaml").read_text(encoding="utf-8"))
    plan["robot"]["payload"] = {"mass_kg": DECLARED_KG, "com_mm": DECLARED_COM_MM.tolist()}
    (folder / "plan.yaml").write_text(yaml.safe_dump(plan), encoding="utf-8")
    loaded = load(folder / "plan.yaml")
    poses, narrow = chosen_poses(list(expand(loaded)), SEED, POSES, ("p1", "p4"))
    at_rest, moving = faults(loaded.cell.robot, FURTHER_KG)
    observed = observed_poses(loaded, poses, at_rest, SEED)
    alone = diagnose(observed, folds=2)
    motion = diagnose_trajectories(recorded_moves(loaded, narrow, moving, SEED, speed_share=0.3), cross_validation=False)
    given = evidence_given(observed, PosesAndMotion(alone, motion).given_by_motion)
    assert given is not None
    return PosesAndMotion(alone, motion, given.evidence)


def test_poses_and_motion_cannot_tell_by_themselves(found):
    assert (found.poses.verdict, found.motion.verdict) == ("cannot_tell", "cannot_tell")
    named = [{label_of(e.name, [at]) for e in one.effects for at in e.where} for one in (found.poses, found.motion)]
    assert not any(CONCEALED <= names for names in named)


def test_the_poses_state_no_wrong_compliance_for_a_balancer_that_they_do_not_see(found):
    """Without the balancer A2 seems less than half as elastic, with 27 of its standard deviations in between."""
    stated = {key: p for e in found.poses.effects for key, p in e.parameters.items()}
    compliance = stated["A2.compliance_rad_per_Nm"]
    assert abs(compliance.value - SOFT["A2"]) < 3 * compliance.std
    named = {label_of(e.name, e.where) for e in found.poses.effects} | {side for n in found.poses.not_separable for side in n.effects}
    assert any("gravity_compensator:A2" in label for label in named)


def test_the_motion_states_the_angle_of_the_balancer_and_no_effect_of_a_load_that_is_known_to_some_newton_metres(found):
    stated = {key: p for e in found.motion.named_effects for key, p in e.parameters.items()}
    upright = stated["A2.zero_deg"]
    assert abs(upright.value + 90.0) < 3 * upright.std
    assert {e.name for e in found.motion.named_effects if e.channel == "q_joint"} == {"joint_compliance", "backlash"}
    for at, true in SOFT.items():
        compliance = stated[f"{at}.compliance_rad_per_Nm"]
        assert abs(compliance.value - true) < 4 * compliance.std


def test_both_together_name_all_that_is_concealed_with_its_size(found):
    assert found.verdict in ("explained", "partly_explained")
    assert set(found.together.sets[0].effects) >= CONCEALED
    stated = {e.name: e.parameters for e in found.beside_motion if "A3" not in e.where}
    mass = stated["payload"]["mass_kg"]
    assert abs(mass.value - tool(FURTHER_KG)[0]) < 3 * mass.std < FURTHER_KG
    assert np.isclose(stated["backlash"]["A4.width_deg"].value, 0.006, atol=3 * stated["backlash"]["A4.width_deg"].std)
    assert found.contradictions == []

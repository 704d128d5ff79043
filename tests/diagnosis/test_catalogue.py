"""The catalogue has what was promised, found as files, each candidate consistent with its own description."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.evidence.hypothesis import SetPrior
from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.effects.described import functions_of, parts_of
from mbcacq.effects.kinds.gravity_compensator import RARE
from mbcacq.estimation import forward_model
from mbcacq.estimation.terms import PER_POSE

PROMISED = {  # none of them may be gone; further ones need no line here
    "joint_compliance",
    "base_compliance",
    "mount_compliance",
    "gear_transmission_error",
    "backlash",
    "joint_scale",
    "wrist_coupling",
    "joint_step",
    "thermal_growth",
    "mount_shift",
    "scanner_scale",
    "scanner_distortion",
    "scanner_warmup",
    "ball_shift",
    "artefact_expansion",
    "station_drift",
    "payload",
    "exposure_latency",
    "lost_motion",
    "hysteresis",
    "gravity_compensator",
    "incidence_bias",
    "orientation_bias",
}


def test_every_effect_that_was_promised_has_a_file():
    assert {name for name, module in catalogue.effects().items() if hasattr(module, "candidates")} >= PROMISED


def test_all_values_of_a_hyper_parameter_at_once_are_the_same_as_one_by_one(plan):
    obs = simulated.observe(plan, 31)
    state = simulated.nominal_state(obs)
    context = Context(obs, state, forward_model.predict(obs, state))
    scanned = [c for c in catalogue.candidates(context)[0] if c.components]
    assert len({c.name for c in scanned}) >= 7
    for candidate in scanned:
        values = candidate.hyper.values[1::5][:4]
        together = functions_of(candidate, context, values)
        for functions, value in zip(together, values, strict=True):
            parts = parts_of(candidate, context, float(value))
            at = {(p.place, p.index, p.component): p.basis for p in parts}
            for j, component in enumerate(candidate.components):
                own = slice(j * functions.shape[1], (j + 1) * functions.shape[1])
                whole = np.zeros((len(at[component]), candidate.k))
                whole[:, own] = functions if component[0] in PER_POSE else functions[obs.pose]
                np.testing.assert_allclose(at[component], whole, atol=1e-15, err_msg=candidate.key)


def test_gravity_moment_about_a_joint_axis_is_its_torque(plan):
    state = simulated.nominal_state(plan)
    s = Context(plan, state, forward_model.predict(plan, state))
    for i in range(s.n):
        about_axis = s.gravity_moment(i)[:, 2] * s.obs.cell.robot.chain.sign[i]
        np.testing.assert_allclose(about_axis, s.gravity_torque[:, i], atol=1e-9)


@pytest.mark.parametrize(("mass_kg", "highest_deg", "offered"), [(76.0, 65, True), (76.0, 360, False), (800.0, 360, True)])
def test_no_balancer_is_offered_to_a_light_arm_that_turns_all_around(plan, mass_kg, highest_deg, offered):
    limits, arm = plan.cell.robot.limits.copy(), plan.cell.robot
    limits[1] = np.radians([min(-185, -highest_deg), highest_deg])
    obs = replace(plan, cell=replace(plan.cell, robot=replace(arm, limits=limits, mass=arm.mass * mass_kg / arm.mass.sum())))
    state = simulated.nominal_state(obs)
    found, dropped = catalogue.candidates(Context(obs, state, forward_model.predict(obs, state)))
    assert any(c.name == "gravity_compensator" for c in found) == offered
    assert ("gravity_compensator" in dropped) != offered


@pytest.mark.parametrize(("balancer", "rarity"), [(None, RARE), (True, 1.0), (False, None)])
def test_a_balancer_is_rare_on_a_light_arm_unless_its_description_says_so(plan, balancer, rarity):
    obs = replace(plan, cell=replace(plan.cell, robot=replace(plan.cell.robot, balancer=balancer)))
    state = simulated.nominal_state(obs)
    found = catalogue.candidates(Context(obs, state, forward_model.predict(obs, state)))[0]
    assert [c.rarity for c in found if c.name == "gravity_compensator"] == ([] if rarity is None else [rarity])
    prior = SetPrior.of(found, 1)
    for one in (c for c in found if c.name == "gravity_compensator"):
        usual = prior.log_probability(replace(one, rarity=1.0), [])
        assert prior.log_probability(one, []) == pytest.approx(usual + np.log(rarity))


def test_nothing_gives_way_against_its_load(plan):
    state = simulated.nominal_state(plan)
    found = catalogue.candidates(Context(plan, state, forward_model.predict(plan, state)))[0]
    soft = [c for c in found if c.name.endswith("compliance")]
    assert {c.name for c in soft} == {"base_compliance", "joint_compliance", "mount_compliance"}
    assert all(c.positive and c.k == 1 for c in soft)

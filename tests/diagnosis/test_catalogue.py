"""The catalogue is the contract's, found as files, each candidate consistent with its own description."""

import numpy as np
import simulated

from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.estimation import forward_model

CONTRACT = {
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
}


def test_every_effect_of_the_contract_has_a_file():
    assert set(catalogue.effects()) == CONTRACT


def test_scans_multiply_the_same_functions_as_built_columns(plan):
    obs = simulated.observe(plan, 31)
    state = simulated.nominal_state(obs)
    context = Context(obs, state, forward_model.predict(obs, state))
    scanned = [c for c in catalogue.candidates(context)[0] if c.separable]
    assert scanned
    for candidate in scanned:
        value = float(candidate.hyper.values[len(candidate.hyper.values) // 2])
        functions = candidate.functions(np.array([value]))[0]
        parts = candidate.build(value)
        total = sum(np.abs(p.basis).sum() for p in parts if p.place != "point")
        expected = np.abs(functions).sum() * len(candidate.separable)
        if total:
            assert np.isclose(total, expected)


def test_gravity_moment_about_a_joint_axis_is_its_torque(plan):
    state = simulated.nominal_state(plan)
    s = Context(plan, state, forward_model.predict(plan, state))
    for i in range(s.n):
        about_axis = s.gravity_moment(i)[:, 2] * s.obs.cell.robot.chain.sign[i]
        np.testing.assert_allclose(about_axis, s.gravity_torque[:, i], atol=1e-9)

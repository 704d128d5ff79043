"""Each effect of the catalogue, simulated in a cell, is found, named and measured."""

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis import model_fit
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.verdict import verdict_of

CASES = [
    ("joint_compliance", ("A2",), [2.5e-6], None),
    ("joint_compliance", ("A3",), [6e-6], None),
    ("base_compliance", ("base",), [1.5e-6], None),
    ("mount_compliance", ("mount",), [1e-4], None),
    ("gear_transmission_error", ("A1",), [5e-5, 3e-5], 119.2),
    ("gear_transmission_error", ("A3",), [5e-5, -6e-5], 7.3),
    ("backlash", ("A2",), [4e-5], None),
    ("joint_scale", ("A5",), [4e-4], None),
    ("wrist_coupling", ("A4", "A5"), [3e-4], None),
    ("thermal_growth", ("link2",), [0.04], None),
    ("thermal_zero_shift", ("A3",), [2e-5], None),
    ("mount_shift", ("mount",), [0.05, 0.04, -0.05, 2e-4, -2e-4, 1e-4], 30.0),
    ("scanner_scale", ("scanner",), [400.0], None),
    ("scanner_warmup", ("scanner",), [0.02, 0.0, 0.06], 600.0),
    ("ball_shift", ("ball3",), [0.03, -0.01, 0.02], None),
    ("artefact_expansion", ("bar",), [150.0], None),
    ("station_drift", ("station3",), [0.06, -0.05, 0.08], None),
]


@pytest.mark.parametrize(("name", "where", "values", "hyper"), CASES, ids=[f"{c[0]}-{'-'.join(c[1])}" for c in CASES])
def test_found_named_and_measured(plan, name, where, values, hyper):
    assert_found(plan, name, where, values, hyper)


def test_a_step_of_a_joint_by_a_hundredth_of_a_degree_is_found_named_and_measured(medium_plan):
    assert_found(medium_plan, "joint_step", ("A2",), [2e-4], 50.0)


def assert_found(plan, name, where, values, hyper):
    observed = simulated.observe(plan, 11, [(name, where, values, hyper)])

    found = model_fit.fit_model(prepare(observed))

    assert {m.candidate.location for m in found.model.members} == {(name, where)}
    assert verdict_of(found) == "explained"
    std = np.sqrt(np.diag(found.model.covariance))[: len(values)]
    assert np.all(np.abs(found.model.coefficients[: len(values)] - values) < 4 * std)


def test_two_effects_at_once(plan):
    observed = simulated.observe(plan, 12, [("joint_compliance", ("A2",), [2.5e-6], None), ("backlash", ("A1",), [5e-5], None)])

    found = model_fit.fit_model(prepare(observed))

    assert {m.candidate.location for m in found.model.members} == {("joint_compliance", ("A2",)), ("backlash", ("A1",))}


def test_found_among_one_percent_of_gross_outliers(plan):
    observed = simulated.observe(plan, 13, [("joint_compliance", ("A2",), [2.5e-6], None)], outliers=0.01)

    found = model_fit.fit_model(prepare(observed))

    assert [m.candidate.location for m in found.model.members] == [("joint_compliance", ("A2",))]
    assert abs(found.model.coefficients[0] - 2.5e-6) < 4 * np.sqrt(found.model.covariance[0, 0])

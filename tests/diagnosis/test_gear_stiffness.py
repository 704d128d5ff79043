"""A gearbox with the three stiffnesses of a data sheet: the evidence finds how many branches there are."""

from dataclasses import replace

import numpy as np
import pytest
import simulated

from mbcacq.diagnosis.evidence.evidence_fit import compared
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.model_fit import model_of
from mbcacq.diagnosis.output.effects_table import merged_parameters, parameters_of_branches
from mbcacq.diagnosis.problem import prepare
from mbcacq.estimation.forward_model import Displacements
from mbcacq.estimation.variance_components import pack

BREAKPOINTS = np.array([25.0, 80.0])  # N m, of 159 that act at most
STIFFNESS = np.array([0.15e6, 0.3e6, 1.0e6])  # N m/rad, below, between and beyond them


def wound(torque, breakpoints, stiffness):
    """Angle (P,) of a gearbox under torque (P,), by integration of one over its stiffness."""
    ends = np.concatenate([[0.0], breakpoints, [np.inf]])
    inside = np.clip(np.abs(torque)[:, None] - ends[:-1], 0.0, np.diff(ends))
    return np.sign(torque) * (inside / stiffness).sum(axis=1)


def gearbox(breakpoints, stiffness):
    def displaced(context):
        joint = np.zeros(context.obs.q.shape)
        joint[:, 2] = wound(context.gravity_torque[:, 2], breakpoints, stiffness)
        return Displacements(joint=joint)

    return displaced


@pytest.mark.parametrize("branches", [2, 3])
def test_as_many_branches_are_found_as_the_gearbox_has(large_plan, branches):
    stiffness = STIFFNESS[-branches:]
    found = diagnosed(simulated.observe(large_plan, 140, [gearbox(BREAKPOINTS[-(branches - 1) :], stiffness)]))
    stated = parameters_of_branches(found, "lost_motion", "A3")

    assert set(found.model.names) == {"joint_compliance", "lost_motion"}
    assert {m.candidate.where for m in found.model.members} == {("A3",)}
    assert set(stated) == {f"A3.K{k + 1}_Nm_per_rad" for k in range(branches)}
    for k, true in enumerate(stiffness):
        each = stated[f"A3.K{k + 1}_Nm_per_rad"]
        assert abs(each.value - true) < 4 * each.std
        assert each.std < 0.15 * true


def diagnosed(observed):
    """What the compliances of a gearbox explain of a recording."""
    problem = prepare(observed)
    gears = [c for c in problem.candidates if c.name in ("joint_compliance", "lost_motion", "backlash", "hysteresis")]
    problem = replace(problem, candidates=gears)
    fit = compared(problem, problem.linear.restricted(np.ones(len(observed.xyz), dtype=bool)), pack(problem.noise), staged=True)
    return model_of(problem, fit, reported_hypothesis(fit), fit.linear)


@pytest.mark.parametrize("weaker", [1.0, 0.2])
def test_the_torque_at_which_a_gearbox_stiffens_is_as_uncertain_as_it_is_wrong(plan, weaker):
    """Also where it is known more sharply than any grid of torques is fine."""
    found = diagnosed(simulated.observe(plan, 140, [gearbox(BREAKPOINTS[1:], weaker * STIFFNESS[-2:])]))
    members = [j for j, m in enumerate(found.model.members) if m.candidate.name == "lost_motion"]
    breakpoint = merged_parameters(found, members)["A3.breakpoint_Nm"]
    assert abs(breakpoint.value - BREAKPOINTS[1]) < 4 * breakpoint.std
    assert breakpoint.std < 0.1 * BREAKPOINTS[1]

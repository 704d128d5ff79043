"""A tool heavier than declared, injected by the fake cell's own physics, is reported from elastic joints that carry what is declared."""

from pathlib import Path

import numpy as np
import pytest
import simulated

from mbcacq.challenge import simulated_cells
from mbcacq.challenge.scenarios import Scenario
from mbcacq.diagnosis import model_fit
from mbcacq.diagnosis.evidence.beam_search import EvidenceFit
from mbcacq.diagnosis.evidence.between_sets import BetweenSets
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, SetPrior
from mbcacq.diagnosis.evidence.posterior import coupled_instead, reported_hypothesis
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.diagnosis.verdict import verdict_of
from mbcacq.effects.context import Context
from mbcacq.effects.effect import ParameterEstimate
from mbcacq.effects.kinds import payload
from mbcacq.geometry import gravity
from mbcacq.plan import expand, load

PLAN = Path(__file__).parents[2] / "plans" / "seeing.yaml"


@pytest.fixture(scope="module")
def seeing():
    loaded = load(PLAN)
    return loaded, expand(loaded)


def observed(seeing, seed, hidden):
    return simulated_cells.observe(*seeing, Scenario(0, "payload", seed, ("payload",), 1, 1.0), [hidden])[0]


def test_a_heavy_tool_is_measured_with_the_elasticity_that_shows_it(seeing):
    mass, com, softness = 6.0, [0.0, 0.0, 100.0], 6e-6
    hidden = {"name": "payload", "mass_kg": mass, "com_mm": com, "compliance_rad_per_Nm": softness}

    found = model_fit.fit_model(prepare(observed(seeing, 102, hidden)))

    assert verdict_of(found) == "explained"
    assert {m.candidate.location for m in found.model.members} == {
        ("payload", ("mount",)),
        ("joint_compliance", ("A2",)),
        ("joint_compliance", ("A3",)),
    }
    for m, p in zip(found.model.members, found.model.slices(), strict=True):
        reported = m.candidate.parameters(found.model.coefficients[p], found.model.covariance[p, p], m.hyper)
        for name, entry in reported.items():
            true = {"mass_kg": mass, "com_mm": np.array(com)}.get(name, softness)
            assert np.all(np.abs(np.array(entry.value) - true) < 3 * np.array(entry.std)), name
    mass = found.model.coefficients[found.model.slices()[-1].start]
    assert mass > 3 * np.sqrt(found.model.covariance[found.model.slices()[-1].start, found.model.slices()[-1].start])


def test_a_far_too_heavy_tool_on_soft_joints_is_measured(seeing):
    """Far from where both were begun: what is left of compliance times weight is no further effect."""
    hidden = {"name": "payload", "mass_kg": 12.0, "com_mm": [20.0, 0.0, 130.0], "compliance_rad_per_Nm": 2.5e-5}

    loaded, poses = seeing
    two_thirds = [pose for k, pose in enumerate(poses) if k % 3 != 2]
    found = model_fit.fit_model(prepare(observed((loaded, two_thirds), 104, hidden)))

    assert set(found.model.names) == {"payload", "joint_compliance"}
    last = found.model.members[-1]
    p = found.model.slices()[-1]
    mass = last.candidate.parameters(found.model.coefficients[p], found.model.covariance[p, p], last.hyper)["mass_kg"]
    assert abs(mass.value - 12.0) < 3 * mass.std
    assert mass.std < 1.5


def test_elastic_joints_are_not_reported_as_a_wrong_payload(seeing):
    hidden = {"name": "joint_compliance", "compliance_rad_per_Nm": 4e-6, "where": ["A2", "A3"]}

    found = model_fit.fit_model(prepare(observed(seeing, 103, hidden)))

    assert {m.candidate.name for m in found.model.members} == {"joint_compliance"}


def test_unit_torques_add_up_to_the_torque_of_a_tool(plan):
    from mbcacq.estimation import forward_model

    state = simulated.nominal_state(plan)
    s = Context(plan, state, forward_model.predict(plan, state))
    arm, mass, com = plan.cell.robot, 4.2, np.array([30.0, -20, 90])
    none = np.zeros(s.n)

    expected = gravity.gravity_torque(arm.chain, arm.chain.frames(plan.q), none, np.zeros((s.n, 3)), mass, com, arm.gravity)

    np.testing.assert_allclose(s.payload_torque @ np.r_[mass, mass * com], expected, atol=1e-9)


def test_without_elasticity_or_masses_nothing_shows_a_payload(plan):
    from mbcacq.estimation import forward_model

    state = simulated.nominal_state(plan)
    s = Context(plan, state, forward_model.predict(plan, state))
    assert payload.candidates(s) == []
    assert payload.correction_for(s, {}) == []


def compared(*sets):
    """A fit that compared these sets, each (log posterior, labels)."""

    def member(label):
        name, where = label.split(":")
        return Member(simulated.candidate(name, where, [1.0]), None)

    none = Hypothesis((), None, 0.0)
    found = [Hypothesis(tuple(member(label) for label in labels), None, log) for log, labels in sets]
    return EvidenceFit(tuple(sorted([*found, none], key=lambda h: -h.log_posterior)), none, 50.0, 0.7, SetPrior.of([], 1), linear=None)


@pytest.mark.parametrize(("odds", "claimed"), [(10.0, False), (30.0, True)])
def test_a_payload_that_stands_for_elastic_joints_needs_odds_of_twenty_to_one(odds, claimed):
    elastic = ["joint_compliance:A5", "joint_compliance:A2", "joint_compliance:A3", "backlash:A1"]
    wrong_tool = ["joint_compliance:A5", "payload:mount", "backlash:A1"]
    fit = compared((50.0 + np.log(odds), wrong_tool), (50.0, elastic))

    reported = reported_hypothesis(fit)

    assert reported.labels == frozenset(wrong_tool if claimed else elastic)
    assert [(c.name, odds) for c, odds in coupled_instead(fit, reported)] == ([] if claimed else [("payload", pytest.approx(10.0))])


def test_a_payload_that_is_not_excluded_and_changes_a_compliance_leaves_it_open():
    fit = compared((52.0, ["joint_compliance:A2", "payload:mount"]), (50.0, ["joint_compliance:A2", "joint_compliance:A3"]))
    likely = fit.hypotheses[:2]
    key = "A3.compliance_rad_per_Nm"

    def changing(beside):
        sets = [(1.0, {"joint_compliance:A3": {key: ParameterEstimate(value, 5e-8)}}) for value in (beside, 4.6e-6)]
        return [changed for _, changed in BetweenSets(likely, tuple(sets), 1, sets[1][1]).changing()]

    assert reported_hypothesis(fit) is likely[1]
    assert changing(4.0e-6) == [frozenset({"joint_compliance:A3"})]
    assert changing(4.6e-6) == []


def test_a_payload_that_elasticity_excludes_is_not_spoken_of():
    fit = compared((50.0, ["joint_compliance:A2", "joint_compliance:A3"]), (40.0, ["joint_compliance:A2", "payload:mount"]))
    assert coupled_instead(fit, reported_hypothesis(fit)) == []

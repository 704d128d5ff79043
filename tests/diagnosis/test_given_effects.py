"""What something else states of an effect is the prior of the poses: the evidence is that of all rows, and what only shows through it is found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from mbcacq.calibration.calibrate import calibrate, calibrate_with_effects
from mbcacq.calibration.sufficiency import options_for
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.diagnosis.evidence.noise_model import NoisePoint
from mbcacq.diagnosis.findings import ComparedEffect
from mbcacq.diagnosis.given_effects import as_displaced, coefficient_of, evidence_given, given_effects
from mbcacq.diagnosis.interim import weigh
from mbcacq.diagnosis.problem import prepare
from mbcacq.effects.effect import Candidate, ParameterEstimate, StandstillRows, number, plain_report
from mbcacq.effects.effect_model import EffectModel
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.estimation.variance_components import pack
from mbcacq.plan import expand, load

PLAN = Path(__file__).parents[2] / "plans" / "seeing.yaml"
QUIET = Scenario(0, "none", 7, (), 1, 0.0)
SOFT, KNOWN = 2e-6, 2e-8  # rad/(N m), and how well something else knows it
DECLARED_KG, TOOL_KG = 2.3, 6.0
HEAVY = [
    {"name": "joint_compliance", "where": "A2", "compliance_rad_per_Nm": SOFT},
    {"name": "joint_compliance", "where": "A3", "compliance_rad_per_Nm": SOFT},
    {"name": "payload", "mass_kg": TOOL_KG, "com_mm": [-6, 4, 62], "compliance_rad_per_Nm": 0},
]


def of_motion(value: float = SOFT, std: float = KNOWN) -> list[ComparedEffect]:
    """The compliance of both joints as a motion would state it."""
    return [ComparedEffect("joint_compliance", (at,), {f"{at}.compliance_rad_per_Nm": number(value, std)}) for at in ("A2", "A3")]


@pytest.fixture(scope="module")
def recorded():
    loaded = load(PLAN)
    two_thirds = [pose for k, pose in enumerate(expand(loaded)) if k % 3 != 2]
    return observe(loaded, two_thirds, QUIET, HEAVY)[0]


@pytest.fixture(scope="module")
def searched(recorded):
    return evidence_given(recorded, of_motion())


def test_a_tool_that_the_poses_cannot_tell_from_softer_joints_is_named_where_the_motion_knows_these(recorded, searched):
    alone = weigh(recorded)
    assert not any(label.startswith("payload") for label in alone.reported.labels)
    assert searched is not None
    found = searched.evidence
    assert found.given == ("joint_compliance:A2", "joint_compliance:A3")
    best = {e.name: e for e in found.evidence.sets[0].effects}
    assert set(best) == {"joint_compliance", "payload"}
    mass = best["payload"].parameters["mass_kg"]
    assert abs(mass.value - TOOL_KG) < 3 * mass.std
    assert mass.value - 3 * mass.std > DECLARED_KG
    for e in found.evidence.sets[0].effects[:2]:  # what the poses themselves say of the joints, beside the tool
        (own,) = e.parameters.values()
        assert abs(own.value - SOFT) < 3 * own.std
        assert own.std > KNOWN


def test_what_no_gearbox_can_be_is_not_taken_from_a_motion(recorded):
    """Joints that wind up by tens of milliradians under the arm's own weight, and joints that rise under it."""
    problem = prepare(recorded, options_for(recorded, CalibrationOptions()))
    assert given_effects(problem, of_motion()).labels == ("joint_compliance:A2", "joint_compliance:A3")
    assert not given_effects(problem, of_motion(5e-3)).members
    assert not given_effects(problem, of_motion(-SOFT)).members


def test_a_cell_calibrated_with_it_has_the_given_effects_as_they_were_given(recorded, searched):
    model = searched.model(("joint_compliance:A2", "joint_compliance:A3", "payload:mount"))
    assert [(t.name, t.held) for t in model.terms] == [("joint_compliance", True), ("joint_compliance", True), ("payload", False)]
    cell = calibrate_with_effects(recorded, CalibrationOptions(refuse=False), EffectModel.from_dict(model.to_dict()))
    *held, tool = cell.effects.terms
    assert [float(t.coefficients[0]) for t in held] == [SOFT, SOFT]
    assert abs(DECLARED_KG + tool.coefficients[0] - TOOL_KG) < 3 * tool.std[0]
    assert cell.fit.rms_mm < calibrate(recorded, CalibrationOptions(discrepancy=False)).fit.rms_mm
    assert searched.model(("joint_compliance:A2",)) is None  # what was given is in every set


def test_effects_of_which_nothing_is_a_candidate_change_nothing(recorded):
    assert evidence_given(recorded, [ComparedEffect("friction", ("A2",), {"A2.coulomb_Nm": number(30.0, 1.0)})]) is None


def log_density(linear: LinearProblem, noise: Noise, mean: np.ndarray, columns: np.ndarray, sigma: np.ndarray) -> float:
    """Log density of the whitened rows, up to a constant, with all that is integrated over in one dense matrix.

    mean: (M, R) that the given effects displace in the mean; columns (M, R, k), sigma (k,): of what is integrated over, normal about zero.
    """
    whiten = linear.whitener(noise)
    r = whiten((linear.residual - mean)[..., None])[:, 0]
    stacked = np.concatenate([whiten(columns * sigma), np.eye(len(sigma))])  # least squares with a row for each prior
    Q, R = np.linalg.qr(stacked)
    left = np.r_[r, np.zeros(len(sigma))]
    left = left - Q @ (Q.T @ left)
    return -0.5 * float(left @ left) - float(np.log(np.abs(np.diag(R))).sum())


def test_the_evidence_with_a_given_effect_is_that_of_its_prior_in_all_rows(recorded):
    """The change of the log likelihood when an effect is given, twice: by the engine, and by the dense covariance of the rows."""
    few = recorded.select(np.arange(recorded.n_poses) % 2 == 0)
    with threadpool_limits(1):
        problem = prepare(few, options_for(few, CalibrationOptions()))
        plain, noise = problem.linear, replace(problem.noise, joint=np.full(6, 5e-6))
        given = given_effects(problem, of_motion(4e-6, 2e-7))
        terms = as_displaced(plain, given)
        together = LinearProblem.of(few, plain.state, plain.keep, layout=plain.layout, given=terms)
        ours = [
            NoisePoint(one, problem.prior_noise, pack(noise)).with_effects(one.extended(np.zeros((*one.residual.shape, 0)), np.zeros(0)))
            for one in (plain, together)
        ]
        columns, sigma = plain.nuisance()
        moved = np.concatenate([plain.columns(term.parts) for term, _ in terms], axis=2)
        mean = sum(plain.columns(term.parts) @ value for term, value in terms)
        dense = log_density(plain, noise, mean, np.concatenate([columns, moved], axis=2), np.r_[sigma, np.ones(len(terms))])
        without = log_density(plain, noise, 0.0 * mean, columns, sigma)
    gain = ours[1].log_likelihood - ours[0].log_likelihood
    assert abs(gain) > 10
    # The engine's residual is of the cell displaced by the mean, the dense one's is linear in it.
    assert gain == pytest.approx(dense - without, rel=0.01)


def test_a_parameter_without_a_sign_is_no_coefficient():
    def width(c, v, _):
        return {"A4.width_deg": number(abs(c[0]), np.sqrt(v[0, 0]))}

    parameters = {"A4.width_deg": number(0.006, 1e-4)}
    signed = Candidate("play", ("A4",), "direction_4", StandstillRows([], np.array([3e-5])), plain_report("A4.width_deg", scale=2.0))
    known = coefficient_of(signed, parameters)
    assert known is not None
    assert known[0] == pytest.approx(0.003)
    assert known[1] == pytest.approx(5e-5)
    assert coefficient_of(replace(signed, report=width), parameters) is None
    assert coefficient_of(signed, {"A4.width_deg": ParameterEstimate((0.006, 0.007), (1e-4, 1e-4))}) is None

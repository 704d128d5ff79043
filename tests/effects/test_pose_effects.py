"""Every pose effect of the catalogue against a simulation that shares no code with it: sign, unit and size of columns and parameters."""

import numpy as np
import pytest
import recorded
from cases import CASES, SOFT, Case, expected
from independent_cell import World

from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.effects.described import parts_of
from mbcacq.effects.effect import Candidate
from mbcacq.effects.kinds import lost_motion, payload
from mbcacq.estimation import terms

ESTIMATED_WITH_A_CURVE = ("order", "phase_deg", "time_constant_s", "at_pose", "breakpoint_Nm")  # not linear in the coefficients
WIDENED = {("scanner_warmup", "offset_mm"): np.sqrt(2.0)}  # for a time constant that is estimated too


def named(case: Case) -> str:
    return "-".join(dict.fromkeys([case.name, *case.where, case.variant or case.depends_on]))


def the_context(case: Case, world: World, context: Context) -> Context:
    return context if case.temperature_recorded else recorded.context(world, recorded_temperature=False)


def the_candidate(case: Case, context: Context) -> Candidate:
    """The one candidate of the catalogue that is meant."""
    every = (
        payload.correction_for(context, {(f"A{i + 1}",): c for i, c in SOFT.items()}, complete=True)
        if case.name == payload.NAME
        else catalogue.candidates(context)[0]
    )
    fitting = [c for c in every if c.name == case.name and c.where == case.where and c.depends_on in (case.depends_on or c.depends_on,)]
    return next(c for c in fitting if c.variant == case.variant or case.name == payload.NAME)


def columns(candidate: Candidate, hyper: float | None, context: Context) -> np.ndarray:
    return terms.columns(context.obs, context.prediction, terms.term(candidate.name, parts_of(candidate, context, hyper)))


def fitted(case: Case, candidate: Candidate, world: World, context: Context) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the physics moves (M, 3) mm, what the columns of the candidate fit of it, and their coefficients (k,)."""
    moved = world.measure(case.physics(world)) - world.measure(case.before(world))
    X = columns(candidate, case.hyper, context)
    scale = np.linalg.norm(X, axis=(0, 1))
    coefficients = np.linalg.lstsq((X / scale).reshape(-1, X.shape[2]), moved.ravel())[0] / scale
    return moved, X @ coefficients, coefficients


def test_the_prediction_of_a_perfect_cell_is_that_of_the_independent_one(world, context):
    np.testing.assert_allclose(context.prediction.xyz, world.measure(), atol=1e-9)


@pytest.mark.parametrize("case", CASES, ids=named)
def test_the_columns_hold_what_the_physics_moves(case, world, context):
    here = the_context(case, world, context)
    moved, explained, _ = fitted(case, the_candidate(case, here), world, here)

    assert np.abs(moved).max() > 1e-6
    np.testing.assert_allclose(explained, moved, atol=2e-4 * np.abs(moved).max())


@pytest.mark.parametrize("case", CASES, ids=named)
def test_the_reported_parameters_are_those_of_the_physics(case, world, context):
    here = the_context(case, world, context)
    candidate = the_candidate(case, here)
    *_, coefficients = fitted(case, candidate, world, here)

    reported = candidate.parameters(coefficients, 1e-12 * np.diag(coefficients**2), case.hyper)

    wanted = expected(case, world)
    assert set(reported) == set(wanted)
    for name, value in wanted.items():
        np.testing.assert_allclose(reported[name].value, value, rtol=2e-3, atol=2e-3 * np.abs(value).max(), err_msg=name)


@pytest.mark.parametrize("case", CASES, ids=named)
def test_a_stated_deviation_is_that_of_the_coefficients_propagated(case, world, context):
    here = the_context(case, world, context)
    candidate = the_candidate(case, here)
    *_, c = fitted(case, candidate, world, here)
    deviation = 1e-3 * np.maximum(np.abs(c), 1e-3 * np.abs(c).max())
    reported = candidate.parameters(c, np.diag(deviation**2), case.hyper)

    for name, entry in reported.items():
        if name.split(".")[-1] in ESTIMATED_WITH_A_CURVE:
            continue
        moved = [
            np.atleast_1d(candidate.parameters(c + step, np.diag(deviation**2), case.hyper)[name].value) for step in np.diag(deviation)
        ]
        propagated = np.sqrt(np.sum((np.array(moved) - np.atleast_1d(entry.value)) ** 2, axis=0))
        np.testing.assert_allclose(np.atleast_1d(entry.std), WIDENED.get((case.name, name), 1.0) * propagated, rtol=5e-3, err_msg=name)


def test_a_joint_with_backlash_stays_behind_its_motion(world, context):
    """The width has no sign, the coefficient has."""
    case = next(c for c in CASES if c.depends_on == "direction_5")
    *_, c = fitted(case, the_candidate(case, context), world, context)

    assert c[0] == pytest.approx(-0.5 * np.radians(3e-4), rel=1e-3)


def test_every_distortion_of_the_field_has_a_case(context):
    single = {c.variant for c in catalogue.candidates(context)[0] if c.name == "scanner_distortion" and c.k == 1}

    assert single == {case.variant for case in CASES if case.name == "scanner_distortion" and len(case.parameters) == 1}


def test_stiffnesses_of_a_data_sheet_are_the_slopes_on_either_side_of_the_breakpoint():
    """A gear of 10 kN m/rad about zero torque and 40 kN m/rad beyond; 1 % of either compliance is 1 % of its stiffness."""
    beyond, below = 1 / 40e3, 1 / 10e3
    covariance = np.array([[1.0, -1.0], [-1.0, 1.0]]) * (0.01 * beyond) ** 2 + np.diag([0.0, (0.01 * below) ** 2])

    found = lost_motion.stiffnesses("A2", np.array([beyond, below - beyond]), covariance)

    assert (found["A2.K1_Nm_per_rad"].value, found["A2.K2_Nm_per_rad"].value) == pytest.approx((10e3, 40e3))
    assert (found["A2.K1_Nm_per_rad"].std, found["A2.K2_Nm_per_rad"].std) == pytest.approx((100.0, 400.0))


def test_a_gear_that_does_not_yield_beyond_its_breakpoint_has_no_second_stiffness():
    found = lost_motion.stiffnesses("A3", np.array([1e-8, 1e-6]), np.diag([1e-16, 1e-16]))

    assert set(found) == {"A3.K1_Nm_per_rad"}


def test_three_stiffnesses_of_a_strain_wave_gear():
    """A size 25 of a data sheet: 8.4, 9.4 and 11 kN m/rad; every compliance known to 1 % of the stiffest branch."""
    branches = np.array([8.4e3, 9.4e3, 11e3])
    compliance = np.array([1 / branches[2], 1 / branches[0] - 1 / branches[1], 1 / branches[1] - 1 / branches[2]])
    std = 0.01 / branches[2]

    found = lost_motion.stiffnesses("A4", compliance, np.eye(3) * std**2)

    assert [found[f"A4.K{k}_Nm_per_rad"].value for k in (1, 2, 3)] == pytest.approx(branches)
    assert [found[f"A4.K{k}_Nm_per_rad"].std for k in (1, 2, 3)] == pytest.approx(std * np.sqrt([3, 2, 1]) * branches**2)

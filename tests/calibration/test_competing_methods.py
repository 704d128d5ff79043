"""A calibration that predicts held-out poses worse than a simpler one is not published."""

from dataclasses import replace

import numpy as np
import pytest
from cells import scanner_cell

from mbcacq.calibration import competing_methods
from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.competing_methods import HeldOutComparison, compared_on_held_out, plain_least_squares
from mbcacq.errors import CalibrationError
from mbcacq.estimation import forward_model
from mbcacq.estimation.adjustment import adjust
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.model.observations import Observations

ALONE = CalibrationOptions(discrepancy=False, random_links=False, refuse=False)


@pytest.fixture(scope="module")
def shaky():
    """Joints that repeat ten times worse than their data sheet has it."""
    return scanner_cell(np.random.default_rng(2), stations=6, per_station=6, joint_rad=4e-4)


def moved(state, mm):
    """With the scanner off along x."""
    T = state.T_flange_scanner.copy()
    T[0, 3] += mm
    return replace(state, T_flange_scanner=T)


def test_the_truth_beats_a_cell_that_is_off(shaky):
    fits = {"own": lambda some: moved(shaky.truth, 3.0), "truth": lambda some: shaky.truth}
    found = compared_on_held_out(shaky.observations, "own", fits)
    assert found.chosen == "truth"
    assert found.pooled("own") > found.pooled("truth")
    assert "better in 5 of 5 blocks" in found.sentence("own")


def test_what_blocks_do_not_tell_apart_stays_as_it_is(shaky):
    fits = {"own": lambda some: moved(shaky.truth, 0.001), "truth": lambda some: shaky.truth}
    assert compared_on_held_out(shaky.observations, "own", fits).chosen == "own"


def test_the_poses_of_a_block_take_no_part_in_what_predicts_it(shaky):
    seen: list[Observations] = []

    def fit(some):
        seen.append(some)
        return shaky.truth

    compared_on_held_out(shaky.observations, "own", {"own": fit})
    left_out = [set(shaky.observations.pose_id) - set(some.pose_id) for some in seen]
    assert set().union(*left_out) == set(shaky.observations.pose_id)
    assert sum(map(len, left_out)) == shaky.observations.n_poses
    assert len(left_out) == 5


def test_a_method_that_the_rest_does_not_determine_is_left_out(shaky):
    def refused(some):
        raise CalibrationError("nothing is determined")

    found = compared_on_held_out(shaky.observations, "own", {"own": lambda some: shaky.truth, "other": refused})
    assert list(found.rms_mm) == ["own"]
    assert compared_on_held_out(shaky.observations, "own", {"own": refused, "other": lambda some: shaky.truth}) is None


def test_two_places_that_nothing_else_knows_are_too_few_blocks():
    obs = scanner_cell(np.random.default_rng(1), stations=2, per_station=1).observations
    assert compared_on_held_out(obs, "own", {"own": lambda some: None}) is None


def test_an_accident_that_nobody_predicts_judges_nobody(shaky):
    xyz = shaky.observations.xyz.copy()
    xyz[5] += 400.0
    obs = replace(shaky.observations, xyz=xyz)
    found = compared_on_held_out(obs, "own", {"own": lambda some: moved(shaky.truth, 3.0), "truth": lambda some: shaky.truth})
    assert found.chosen == "truth"
    assert found.pooled("truth") > 10.0
    assert (found.centres, found.robust_centres) == (obs.n_centres, obs.n_centres - 1)
    assert found.pooled("truth", robust=True) < 0.5 * found.pooled("truth")
    assert f"over {obs.n_centres - 1} of {obs.n_centres} centres" in found.sentence("own")


def test_plain_least_squares_is_where_the_sum_of_squares_is_least(shaky):
    obs = shaky.observations
    found = plain_least_squares(adjust(obs, replace(ALONE, balls=False)))
    state, free = found.state, found.lineariser.layout.blocks[0].free

    def squares(step):
        chain = state.chain.with_errors(step.reshape(-1, 5))
        return np.sum((obs.xyz - forward_model.predict(obs, replace(state, chain=chain)).xyz) ** 2)

    least = squares(np.zeros(30))
    for k in np.flatnonzero(free):
        h = np.zeros(30)
        h[k] = 1e-2 if found.lineariser.layout.blocks[0].units[k] == "mm" else 1e-5
        there = [squares(s * h) for s in (-1, 1)]
        assert min(there) > least
        assert abs(there[1] - there[0]) < 0.02 * (there[0] + there[1] - 2 * least)  # the vertex is within 1 % of the step


@pytest.mark.parametrize("chosen", ["plain least squares", "the nominal arm", "the adjustment without smooth errors"])
def test_the_better_method_is_what_is_published_and_said(shaky, monkeypatch, chosen):
    names = ("the weighted adjustment", chosen)
    decided = HeldOutComparison(chosen, {name: np.full(5, rms) for name, rms in zip(names, (2.0, 1.0), strict=True)})
    monkeypatch.setattr(competing_methods, "compared_on_held_out", lambda *given: decided)
    found = calibrate(shaky.observations, CalibrationOptions(refuse=False))
    assert f"{chosen} predicts held-out poses better (1.000 mm rms against 2.000 mm" in found.extra["warnings"][0]
    assert found.extra["competing_methods"]["chosen"] == chosen
    nominal = np.array_equal(found.state.chain.rows, shaky.observations.cell.robot.chain.rows)
    assert nominal == (chosen == "the nominal arm")
    assert found.fit.options.kinematics != nominal


def test_an_arm_as_its_data_sheet_has_it_is_compared_with_nothing():
    obs = scanner_cell(np.random.default_rng(4), stations=6, per_station=6).observations
    assert "competing_methods" not in calibrate(obs).extra

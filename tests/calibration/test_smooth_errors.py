"""What an arm does beyond its geometry is learnt by a calibration that knows nothing of it, and is right at places that took no part."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from cells import scanner_cell
from erring_arms import LAWS, erring_arm, placed_wrong

from mbcacq.calibration import with_discrepancy
from mbcacq.calibration.calibrate import calibrate
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.design.adaptive.first_block import first_block
from mbcacq.effects import discrepancy
from mbcacq.estimation import forward_model
from mbcacq.estimation.adjustment import adjust_recording, with_random_links
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.geometry import se3
from mbcacq.plan import expand, load

GEOMETRY = CalibrationOptions(discrepancy=False)


@cache
def at_new_places(law, seed, options=None):
    """mm rms at other places, and the groups that were learnt; several tests compare with the same arm."""
    learn, new, truth = erring_arm(LAWS[law], seed)
    found = calibrate(learn, options)
    return placed_wrong(found, new, truth), {t.depends_on + t.variant for t in found.effects.terms} if found.effects else set()


@pytest.mark.parametrize("seed", [3, 8, 27, 34])
def test_an_arm_without_further_errors_is_calibrated_as_by_geometry_alone(seed):
    """28 sizes that fit the noise of three of these arms gain 6 to 7 by chance."""
    off, groups = at_new_places("nothing further", seed)
    assert groups == set()
    assert off == at_new_places("nothing further", seed, GEOMETRY)[0]


def test_a_wind_up_goes_on_at_torques_beyond_those_that_were_there():
    """A2 carries 190 to 417 N m in the recording, and -436 to 434 N m at the new places."""
    clean = at_new_places("nothing further", 3)[0]
    assert at_new_places("elastic A2, A4", 3)[0] < 1.2 * clean
    assert at_new_places("elastic A2, A4", 3, GEOMETRY)[0] > 4.0 * clean


def test_a_product_of_two_angles_is_not_taken_for_a_sum_of_functions_of_one():
    """Such a sum accounts for the poses as well, and is four times as wrong at new places."""
    off, groups = at_new_places("a product of two angles", 3)
    assert groups == {"q2*q5smooth"}
    assert off < 1.2 * at_new_places("nothing further", 3)[0]


def test_meshes_of_a_gear_are_laws_by_orders_that_no_smooth_function_follows():
    """Order 101 of A3 and 57 of A2, by 0.1 mrad: found to a quarter of what its travel tells apart."""
    learn, new, truth = erring_arm(LAWS["gear errors of orders 57 and 101"], 0)
    found = calibrate(learn)
    orders = {t.where[0]: t.hyper["order"] for t in found.effects.terms}
    assert orders == {"A2": pytest.approx(57, abs=0.2), "A3": pytest.approx(101, abs=0.2)}
    assert placed_wrong(found, new, truth) < 1.2 * at_new_places("nothing further", 0)[0]


@pytest.mark.parametrize("law", ["gear errors of orders 2 to 4", "gear errors of orders 17 and 22"])
def test_wheels_of_a_gear_are_learnt_each_by_its_own_periods(law):
    off, groups = at_new_places(law, 0)
    assert off < 0.35 * at_new_places(law, 0, GEOMETRY)[0]
    if "17" in law:
        assert {"q2order 17", "q3order 22"} <= groups
        assert len(groups) <= 6


@pytest.mark.parametrize(
    ("law", "group", "most"),
    [
        ("a link that twists by a tool with its weight aside", "gravity_moment_2smooth", 1.2),
        ("a base that tilts", "gravity_moment_0smooth", 1.2),
        ("a mount with clearance", "gravity_direction_6_xsmooth", 1.6),  # by geometry alone 5
    ],
)
def test_a_frame_that_gives_way_is_one_function_and_no_sum_of_those_of_the_joints(law, group, most):
    """The joints repeat within their data sheet beside the twisting link: its misfit passes for their noise."""
    off, groups = at_new_places(law, 3)
    assert group in groups
    assert off < most * at_new_places("nothing further", 3)[0]


def test_beyond_the_angles_that_were_visited_a_joint_is_as_uncertain_as_its_error_was_large():
    found = calibrate(erring_arm(LAWS["gear errors of orders 2 to 4"], 0)[0])
    own = [t for t in found.effects.terms if t.depends_on == "q1"]
    visited = found.fit.observations.q[:1]
    away = visited + [[np.pi, 0, 0, 0, 0, 0]]
    beyond = min(np.min(np.abs(away[0, 0] + turn - found.fit.observations.q[:, 0])) for turn in (0, -2 * np.pi)) - np.radians(5)
    left = 1 - np.exp(-((beyond / np.radians(70)) ** 2))
    assert own
    assert left > 0.8

    xyz = found.fit.observations.xyz[:1]
    inside, outside = (
        np.trace(found.point_covariance(q, xyz)[0]) - np.trace((A := found.point_columns(q, xyz)[0]) @ found.covariance @ A.T)
        for q in (visited, away)
    )
    lever = np.linalg.norm(found.to_base(away, xyz)[0, :2])  # mm from the first axis
    assert inside == pytest.approx(0.0, abs=1e-12)
    assert outside == pytest.approx(left * lever**2 * sum(t.sigma[0] ** 2 for t in own), rel=1e-2)


def test_groups_that_were_sized_by_a_part_of_the_poses_are_learnt_from_all(monkeypatch):
    """As in a recording of thousands of poses; sized by 60 of 96 poses the wind-up is right at new places as if by all of them."""
    whole = at_new_places("elastic A2, A4", 3)[0]
    monkeypatch.setattr(with_discrepancy, "MOST_POSES", 60)
    part, groups = at_new_places.__wrapped__("elastic A2, A4", 3)
    assert part < 1.1 * whole
    assert "gravity_torque_2smooth" in groups


def test_few_poses_in_which_no_group_is_left_are_calibrated():
    """The 24 poses that show most of one cell: own errors shrink to nothing there, and so do all that are tried after them."""
    plan = first_block(load(Path(__file__).parents[2] / "plans" / "seeing.yaml"))
    coupled = [{"name": "wrist_coupling", "strength": 0.0431422939131256, "seed": 1479368136}]
    obs, _ = observe(plan, expand(plan), Scenario(16, "wrist_coupling", 521319236, ("wrist_coupling",), 1479368136, 0.354), coupled)
    assert obs.n_poses == 24
    fit = calibrate(obs).own_fit
    assert fit is not None
    assert fit.rms_mm < 0.03


def shared_by_neighbours(correlation, joint_rad, seed):
    """96 poses of an arm whose joints' errors have this standard deviation, and this correlation with those of the pose before."""
    rng = np.random.default_rng([78, seed])
    cell = scanner_cell(rng, stations=4, per_station=24)
    obs, off = cell.observations, np.zeros((96, 6))
    for p in range(96):
        fresh = rng.normal(size=6)
        off[p] = correlation * off[p - 1] + np.sqrt(1 - correlation**2) * fresh if p else fresh
    xyz = forward_model.predict(obs, cell.truth, forward_model.Displacements(joint=joint_rad * off)).xyz
    return replace(obs, xyz=xyz + rng.normal(size=xyz.shape) * obs.cell.noise_mm), cell.truth


def wrong_in_the_workspace(found, truth):
    """mm rms at 100 random postures, a rigid motion of everything aside."""
    obs, rng = found.fit.observations, np.random.default_rng(5)
    q = rng.uniform(*found.state.chain.drawn_between(obs.cell.robot.limits), size=(100, 6))
    xyz = np.tile(obs.xyz.mean(axis=0), (100, 1))
    points, true = found.to_base(q, xyz), se3.apply(truth.chain.frames(q)[:, -1] @ truth.T_flange_scanner, xyz)
    rigid = np.concatenate([np.tile(np.eye(3), (100, 1, 1)), -1e-3 * se3.skew(points)], axis=2).reshape(-1, 6)
    off = (points - true).ravel()
    return np.sqrt(3 * np.mean((off - rigid @ np.linalg.lstsq(rigid, off)[0]) ** 2))


def test_errors_that_neighbouring_poses_share_are_no_functions_of_posture_and_cost_no_accuracy():
    better = []
    for seed in range(3):
        obs, truth = shared_by_neighbours(0.95, 8e-5, seed)
        found = calibrate(obs, CalibrationOptions(refuse=False))
        wander = np.array(found.extra["discrepancy"]["wander_rad"])
        assert 5e-5 < np.sqrt(np.mean(wander**2)) < 1.2e-4
        assert not found.effects or all("pose" not in t.covariates for t in found.effects.terms)
        geometry = calibrate(obs, CalibrationOptions(refuse=False, discrepancy=False))
        better.append(wrong_in_the_workspace(found, truth) / wrong_in_the_workspace(geometry, truth))
    assert np.mean(better) < 0.75


def test_what_wanders_is_not_sought_where_its_functions_are_too_few_for_the_poses(monkeypatch):
    """Sixty cosines over thousands of poses show nothing that neighbours share: what is left of it stays noise."""
    whole, _ = shared_by_neighbours(0.95, 8e-5, 0)
    obs, options = whole.select(np.arange(whole.n_poses) < 48), CalibrationOptions(refuse=False)
    alone = with_random_links(adjust_recording(obs, options, links_follow=True))
    found = with_discrepancy.with_discrepancy(alone)
    assert found is not None
    assert "wander_rad" in found.extra["discrepancy"]
    monkeypatch.setattr(discrepancy, "OPTIONS", replace(discrepancy.OPTIONS, wander_poses=obs.n_poses - 1))
    found = with_discrepancy.with_discrepancy(alone)
    assert found is None or "wander_rad" not in found.extra["discrepancy"]


def test_independent_errors_do_not_wander():
    for seed in range(3):
        found = calibrate(shared_by_neighbours(0.0, 8e-6, seed)[0], CalibrationOptions(refuse=False))
        assert "wander_rad" not in found.extra.get("discrepancy", {})

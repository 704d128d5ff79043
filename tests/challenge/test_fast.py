"""One challenge from scenario to score, and the twin; made recordings, no servers."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mbcacq.challenge import simulated_cells
from mbcacq.challenge.run import Challenger
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.strength import Gauge
from mbcacq.errors import ConfigError
from mbcacq.plan import expand, load
from mbcacq.workflow.simulate import simulate_poses

PLANS = Path(__file__).parents[2] / "plans"


@pytest.fixture(scope="module")
def challenger():
    """Half of the poses: enough to see, and quicker."""
    whole = Challenger.of(PLANS / "seeing.yaml")
    poses = whole.poses[::2]
    return replace(whole, poses=poses, gauge=Gauge(whole.loaded, poses))


@pytest.fixture(scope="module")
def quick():
    loaded = load(PLANS / "quick.yaml")
    return loaded, expand(loaded)


def test_strength_is_chosen_for_the_wanted_excess(challenger):
    scenario = Scenario(0, "joint_scale", 11, ("joint_scale",), 12, excess=2.0)
    injected = challenger.gauge.inject(scenario)
    gain = challenger.gauge.gain(scenario, injected)
    assert gain == pytest.approx(2.0 * challenger.gauge.screen.dof, rel=0.01)


@pytest.mark.parametrize("name", ["spalled_raceway", "loose_anchor", "link_bending", "taut_hose"])
def test_a_cell_that_is_measured_again_has_the_effect_that_it_had(quick, name):
    """Where and when such an effect acts is chosen by the planned poses: those of the first time, not of each."""
    loaded, poses = quick
    scenario, hidden = Scenario(0, name, 11, (name,), 12, 1.0), [{"name": name, "seed": 5, "strength": 2.0}]
    first, truth = simulated_cells.observe(loaded, poses, scenario, hidden)
    again, same = simulated_cells.observe(loaded, poses[::2], scenario, hidden, planned=poses)
    assert str(same) == str(truth)
    assert first.n_poses == 2 * again.n_poses or first.n_poses == 2 * again.n_poses - 1
    still, _ = simulated_cells.observe(loaded, poses[::2], scenario, [], planned=poses)
    whole, _ = simulated_cells.observe(loaded, poses, scenario, [])

    def by_centre(obs, displaced):
        return dict(zip(zip(obs.pose_id[obs.pose].tolist(), obs.ball.tolist(), strict=True), displaced, strict=True))

    moved = by_centre(first, first.xyz - whole.xyz)
    for centre, displaced in by_centre(again, again.xyz - still.xyz).items():
        assert np.linalg.norm(displaced - moved[centre]) < 2e-3  # mm: stops near a target differ by 10 urad


def test_a_plain_effect_is_concealed_found_and_scored(challenger, tmp_path):
    scenario = Scenario(0, "ball_shift", 11, ("ball_shift",), 12, excess=2.0)
    outcome = replace(challenger, folder=tmp_path).take(scenario)
    s = outcome.score
    assert s.counts
    assert 0.3 < s.achievable < 0.9
    assert s.placed
    assert s.share > 0.9
    assert s.sigmas
    assert max(s.sigmas.values()) < 5
    opened = json.loads((tmp_path / "000" / "scenario.json").read_text())
    assert opened["truth"][0]["name"] == "ball_shift"
    recorded = (tmp_path / "000" / "observations" / "cell.yaml").read_text()
    assert "ball_shift" not in recorded
    assert "pose_in_base" not in recorded


def test_the_recording_lacks_what_was_not_recorded(challenger):
    scenario = Scenario(0, "none", 1, (), 1, 0.0, missing=("time_s", "direction", "temperature"))
    observations, truth = simulated_cells.observe(challenger.loaded, challenger.poses, scenario, [])
    assert observations.time_s is None
    assert observations.direction is None
    assert observations.temperatures == {}
    assert truth["effects"] == []


def test_the_twin_of_the_nominal_cell_is_what_the_nominal_model_predicts(tmp_path):
    from mbcacq.calibration.calibrate import calibrate
    from mbcacq.cli.simulate import command
    from mbcacq.estimation.options import CalibrationOptions
    from mbcacq.recording import load_observations

    result = CliRunner().invoke(command, [str(PLANS / "quick.yaml"), "--out", str(tmp_path / "twin")], catch_exceptions=False)
    assert result.exit_code == 0
    observations = load_observations(tmp_path / "twin")
    assert all(s.T_base_station is None for s in observations.cell.stations)
    found = calibrate(observations, CalibrationOptions(kinematics=False))
    np.testing.assert_allclose(found.state.T_flange_scanner, observations.cell.T_flange_scanner, atol=1e-6)
    assert found.fit.rms_mm < 1e-6
    again = CliRunner().invoke(command, [str(PLANS / "quick.yaml"), "--out", str(tmp_path / "twin")])
    assert isinstance(again.exception, ConfigError)


def test_noise_scatters_the_twin_by_what_the_plan_states(quick):
    exact, first, again = simulate_poses(*quick), simulate_poses(*quick, noise=True, seed=4), simulate_poses(*quick, noise=True, seed=4)
    assert np.array_equal(first.xyz, again.xyz)
    assert np.array_equal(exact.q, first.q)
    # balls of one pose against each other: joint repeatability moves them together, scanner noise does not
    scatter = first.xyz - exact.xyz
    inner = np.concatenate([scatter[first.pose == p] - scatter[first.pose == p].mean(axis=0) for p in range(10)])
    assert np.std(inner[:, 2]) == pytest.approx(0.009 / np.sqrt(2), rel=0.3)


def test_the_twin_of_a_calibrated_cell_stands_where_the_calibration_says(quick):
    loaded, poses = quick
    observations, truth = simulated_cells.observe(loaded, poses, Scenario(0, "none", 21, (), 1, 0.0), [])
    from mbcacq.calibration.calibrate import calibrate
    from mbcacq.estimation.options import CalibrationOptions

    cell = calibrate(observations, CalibrationOptions(kinematics=False))
    twin = simulate_poses(loaded, poses, cell.to_dict())
    nominal = simulate_poses(loaded, poses)
    seen = {
        (int(observations.pose_id[p]), int(b)): x for p, b, x in zip(observations.pose, observations.ball, observations.xyz, strict=True)
    }
    pairs = np.array(
        [[x, n, seen[int(twin.pose_id[p]), int(b)]] for p, b, x, n in zip(twin.pose, twin.ball, twin.xyz, nominal.xyz, strict=True)]
    )
    assert np.linalg.norm(pairs[:, 1] - pairs[:, 2], axis=1).mean() > 0.5
    assert np.linalg.norm(pairs[:, 0] - pairs[:, 2], axis=1).mean() < 0.2


def test_a_result_of_another_arm_is_refused(quick):
    loaded, poses = quick
    with pytest.raises(ConfigError, match="no calibration result of format"):
        simulate_poses(loaded, poses, {"format": "something else"})

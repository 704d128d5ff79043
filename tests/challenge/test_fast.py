"""One challenge from envelope to score, and the twin; made recordings, no servers."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mbcacq.challenge import made
from mbcacq.challenge.envelopes import Envelope
from mbcacq.challenge.run import Challenger

SEEING = Path(__file__).parents[2] / "plans" / "seeing.yaml"


@pytest.fixture(scope="module")
def challenger():
    return Challenger.of(SEEING)


def test_strength_is_chosen_for_the_wanted_excess(challenger):
    envelope = Envelope(0, "joint_scale", 11, ("joint_scale",), 12, excess=2.0)
    concealed = challenger.gauge.conceal(envelope)
    gain = challenger.gauge.gain(envelope, concealed)
    assert gain == pytest.approx(2.0 * challenger.gauge.screen.dof, rel=0.01)


def test_a_plain_effect_is_concealed_found_and_scored(challenger, tmp_path):
    envelope = Envelope(0, "joint_scale", 11, ("joint_scale",), 12, excess=2.0)
    outcome = replace(challenger, folder=tmp_path).take(envelope)
    s = outcome.score
    assert s.counts
    assert 0.4 < s.achievable < 0.9
    assert s.placed
    assert s.share > 0.9
    assert s.sigmas
    assert max(s.sigmas.values()) < 5
    opened = json.loads((tmp_path / "000" / "envelope.json").read_text())
    assert opened["truth"][0]["name"] == "joint_scale"
    recorded = (tmp_path / "000" / "observations" / "cell.yaml").read_text()
    assert "joint_scale" not in recorded
    assert "pose_in_base" not in recorded


def test_the_recording_lacks_what_was_not_recorded(challenger):
    envelope = Envelope(0, "none", 1, (), 1, 0.0, missing=("time_s", "direction", "temperature"))
    observations, truth = made.observe(challenger.loaded, challenger.poses, envelope, [])
    assert observations.time_s is None
    assert observations.direction is None
    assert observations.temperatures == {}
    assert truth["effects"] == []


def test_the_twin_of_the_nominal_cell_is_calibrated_to_no_errors(tmp_path):
    from mbcacq.calibration import calibrate
    from mbcacq.cli.simulate import command
    from mbcacq.recording import load

    result = CliRunner().invoke(command, [str(SEEING), "--out", str(tmp_path / "twin")], catch_exceptions=False)
    assert result.exit_code == 0
    found = calibrate(load(tmp_path / "twin"))
    assert np.abs(found.errors[:, 1:3]).max() < 1e-6
    assert np.abs(found.errors[:, [0, 3, 4]]).max() < 1e-9


def test_noise_scatters_the_twin_by_what_the_plan_states(challenger):
    from mbcacq.twin import simulate

    exact = simulate(challenger.loaded, challenger.poses)
    first, again, other = (simulate(challenger.loaded, challenger.poses, noise=True, seed=seed) for seed in (4, 4, 5))
    assert np.array_equal(first.xyz, again.xyz)
    assert not np.array_equal(first.xyz, other.xyz)
    assert np.array_equal(exact.q, first.q)
    # balls of one pose against each other: joint repeatability moves them together, scanner noise does not
    scatter = first.xyz - exact.xyz
    inner = np.concatenate([scatter[first.pose == p] - scatter[first.pose == p].mean(axis=0) for p in range(8)])
    assert np.std(inner[:, 2]) == pytest.approx(0.009 / np.sqrt(3), rel=0.3)


def test_the_twin_of_a_calibrated_cell_has_its_errors(challenger, tmp_path):
    from mbcacq.calibration import calibrate
    from mbcacq.twin import simulate

    envelope = Envelope(0, "none", 21, (), 1, 0.0)
    observations, _ = made.observe(challenger.loaded, challenger.poses, envelope, [])
    cell = calibrate(observations)
    twin = calibrate(simulate(challenger.loaded, challenger.poses, cell.to_dict()))
    assert np.abs(cell.errors).max() > 0.05
    np.testing.assert_allclose(twin.errors, cell.errors, atol=1e-5)

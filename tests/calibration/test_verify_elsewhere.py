"""A calibrated arm tried on another recording: only the same arm, at its known stations, with figures that noise alone explains."""

import json
from dataclasses import replace

import numpy as np
import pytest
from cells import iiwa, measure, robot, scanner_cell
from click.testing import CliRunner

import mbcacq
from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.result_io import UNVERIFIED, caveats, read_result
from mbcacq.calibration.transfer import Transfer, check_transfer
from mbcacq.cli.verify import command
from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.model.json_text import from_fields
from mbcacq.quantities import micrometres
from mbcacq.recording.datasets.observation_set import write_observation_set

NOISE, JOINT_NOISE = (0.005, 0.005, 0.009), 8e-6


@pytest.fixture(scope="module")
def cell():
    return scanner_cell(np.random.default_rng(17), stations=8, per_station=12, bars=3)


@pytest.fixture(scope="module")
def other(cell):
    """The same poses again, under other numbers, with other noise."""
    obs = measure(cell.observations, cell.truth, np.random.default_rng(18), NOISE, JOINT_NOISE)
    return replace(obs, pose_id=obs.pose_id + 1000)


@pytest.fixture(scope="module")
def calibrated(cell):
    return calibrate(cell.observations, CalibrationOptions(refuse=False))


@pytest.fixture(scope="module")
def result(calibrated, tmp_path_factory):
    file = tmp_path_factory.mktemp("learnt") / "result.json"
    file.write_text(calibrated.to_json(), encoding="utf-8")
    return file


def of_arm(obs, arm):
    return replace(obs, cell=replace(obs.cell, robot=arm), cell_yaml="")


def other_arms(obs):
    arm = obs.cell.robot
    longer = arm.chain.with_errors(np.eye(6, 5, -1) * 60.0 * np.array([0, 1, 0, 0, 0]))
    return {
        "of 'another arm' (6 axes)": replace(arm, name="another arm"),
        "of 'test arm' (6 axes, other nominal links)": replace(arm, chain=longer),
        "of 'test arm' (7 axes)": robot(iiwa()),
    }


@pytest.mark.parametrize("number", range(3))
@pytest.mark.parametrize("place", ["fitted", "known"])
def test_a_result_of_another_arm_is_refused_and_both_arms_are_named(result, other, number, place, tmp_path):
    described, arm = list(other_arms(other).items())[number]
    obs = of_arm(other, arm)
    if arm.n != obs.q.shape[1]:
        obs = replace(obs, q=np.pad(obs.q, ((0, 0), (0, 1))))
    write_observation_set(obs, tmp_path / "day")

    done = CliRunner().invoke(command, [str(result), str(tmp_path / "day"), "--place", place])

    assert isinstance(done.exception, ConfigError)
    assert str(done.exception) == (
        f"the result is of 'test arm' (6 axes), and {tmp_path / 'day'} is {described}; give what was learnt on the same arm"
    )


def test_sphere_spacing_is_not_verified_with_another_arm(calibrated, other):
    for arm in list(other_arms(other).values())[:2]:
        with pytest.raises(ConfigError, match="the result is of 'test arm'"):
            mbcacq.verify(of_arm(other, arm), calibrated)


def test_the_plan_that_is_simulated_is_of_the_arm_of_the_result(result):
    with pytest.raises(ConfigError, match=r"the result is of 'test arm' \(6 axes\), and the plan is of 'KUKA KR 10"):
        mbcacq.simulate("plans/kuka.yaml", result)


def test_with_known_places_stations_that_the_result_lacks_are_left_out_and_named(calibrated, result, other):
    bars = int(np.sum(other.phase == "verification"))

    written, computed = (mbcacq.verify_elsewhere(other, one, place="known") for one in (result, calibrated))

    assert written.poses == computed.poses == other.n_poses - bars
    for found in (written, computed):
        assert found.warnings == (
            f"stations 9, 10, 11 have no known place in the calibrated cell and are left out, with {bars} of {other.n_poses} poses; "
            "--place fitted judges them too",
        )
        assert found.with_effects.chi2_dof == pytest.approx(written.with_effects.chi2_dof)


def test_one_station_is_left_out_in_the_singular(calibrated, other):
    obs = other.select((other.phase != "verification") | (other.station == 8))

    tried = check_transfer(obs, calibrated, place="known")
    assert tried.normalised_error is None  # the result does not hold how the errors of its arm and of its places go together
    assert from_fields(Transfer, tried.to_dict()) == tried
    (sentence,) = tried.warnings

    assert sentence.startswith("station 9 has no known place in the calibrated cell and is left out, with 4 of")


def test_without_any_known_station_nothing_can_be_judged(calibrated, other):
    with pytest.raises(ConfigError, match=r"no station of the recording \(9, 10, 11\) has a known place .*; try it with --place fitted"):
        check_transfer(other.select(other.phase == "verification"), calibrated, place="known")


def test_another_recording_of_the_same_cell_is_predicted_within_its_noise(calibrated, other):
    few = other.select(np.arange(other.n_poses) % 3 == 0)
    for obs, place in ((other, "fitted"), (few, "fitted"), (other, "known")):
        found = check_transfer(obs, calibrated, place=place)
        # Each station takes a large part of a few centres: what was fitted there is no degree of freedom.
        assert found.with_effects.chi2_dof == pytest.approx(1.0, abs=0.12), (obs.n_poses, place)


def test_figures_are_said_once_where_there_are_no_effects_and_chi2_with_them(result, other, tmp_path):
    write_observation_set(other, tmp_path / "day")

    done, as_json = (CliRunner().invoke(command, [str(result), str(tmp_path / "day"), *more]) for more in ([], ["--json"]))

    assert done.exit_code == 0, done.output
    (found,) = json.loads(as_json.stdout)["transfers"]
    learnt, own = found["geometry_alone"], found["own_geometry"]
    assert found["with_effects"] == learnt
    assert (
        f": {micrometres(learnt['rms_mm'])} with the learnt geometry; {micrometres(own['rms_mm'])} with a geometry fitted there."
        in done.stdout
    )
    assert (
        f"χ² per degree of freedom, under the noise that was learnt: {learnt['chi2_dof']:.2f} with the learnt geometry; "
        f"{own['chi2_dof']:.2f} with a geometry fitted there\n" in done.stdout
    )
    assert "effects" not in done.stdout


@pytest.mark.parametrize("place", ["fitted", "known"])
def test_every_centre_counts_and_a_robust_figure_stands_beside_it(calibrated, other, place):
    xyz = other.xyz.copy()
    gross = np.arange(3, len(xyz), 60)
    xyz[gross] += [0.0, 2.0, 0.0]

    clean, found = (check_transfer(obs, calibrated, place=place) for obs in (other, replace(other, xyz=xyz)))

    assert clean.robust is None
    judged = np.ones(len(xyz), bool) if place == "fitted" else (other.station < 8)[other.pose]
    share = int(judged[gross].sum())
    assert found.centres == clean.centres
    assert found.robust_centres == found.centres - share
    assert found.with_effects.rms_mm == pytest.approx(2.0 * np.sqrt(share / found.centres), rel=0.1)
    assert found.robust.rms_mm == pytest.approx(clean.with_effects.rms_mm, rel=0.1)
    assert f"all {found.centres} centres" in found.text
    assert f"robust {micrometres(found.robust.rms_mm)} over {found.robust_centres} of {found.centres} centres" in found.text


def test_places_that_were_moved_are_said_and_no_figure_of_the_arm(other, result):
    """Everything but the arm stands 300 mm elsewhere: what a base or a tracker that was moved looks like."""
    moved = replace(other, q=other.q + np.array([0.1, 0, 0, 0, 0, 0]))  # a turn of the first joint alone is a turn of the base
    with pytest.raises(
        CalibrationError, match=r"the artefacts or the robot's base were moved since the result was made: .* use --place fitted"
    ):
        mbcacq.verify_elsewhere(moved, result, place="known")
    assert mbcacq.verify_elsewhere(moved, result, place="fitted").with_effects.rms_mm < 0.1


def test_places_that_were_bumped_are_said_beside_the_figures(other, result):
    """A base that turned by 0.03 deg leaves half a millimetre that the arm is not to blame for."""
    bumped = replace(other, q=other.q + np.radians([0.03, 0, 0, 0, 0, 0]))

    found = mbcacq.verify_elsewhere(bumped, result, place="known")

    assert 0.2 < found.with_effects.rms_mm < 2.0
    assert found.warnings[0].startswith("the artefacts or the robot's base seem to have been moved a little since the result was made: ")
    assert "use --place fitted" in found.warnings[0]
    assert not any("moved" in w for w in mbcacq.verify_elsewhere(other, result, place="known").warnings)


def test_the_verdict_is_noted_in_the_result_which_then_counts_as_verified_or_contradicted(calibrated, other, tmp_path):
    file = tmp_path / "result.json"
    file.write_text(calibrated.to_json(), encoding="utf-8")
    bent = other.q + np.deg2rad(0.05) * np.sin(2 * other.q[:, [1]]) * (np.arange(6) == 2)
    for name, obs in (("same", other), ("bent", replace(other, q=bent))):
        write_observation_set(obs, tmp_path / name)

    assert UNVERIFIED in caveats(read_result(file))
    first = CliRunner().invoke(command, [str(file), str(tmp_path / "same")])
    assert f"Verdict: {tmp_path / 'same'} agrees with the result" in first.output
    assert not [s for s in caveats(read_result(file)) if "contradicts" in s]
    assert UNVERIFIED not in caveats(read_result(file))
    second = CliRunner().invoke(command, [str(file), str(tmp_path / "bent")])
    assert f"mbcacq calibrate {tmp_path / 'bent'}" in second.output
    against = [s for s in caveats(read_result(file)) if "contradicts" in s]
    assert len(against) == 1
    assert str(tmp_path / "bent") in against[0]

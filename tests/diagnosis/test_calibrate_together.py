"""Several recordings of one arm calibrated together: shared arm and effects, a cell of its own around it for each."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import simulated
from click.testing import CliRunner

import mbcacq
from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.several import calibrate_together
from mbcacq.calibration.transfer import check_transfer
from mbcacq.cli.calibrate import command
from mbcacq.diagnosis.output.kept_model import term_of
from mbcacq.effects import catalogue, unmodelled
from mbcacq.effects.context import Context
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import LearntRecording
from mbcacq.errors import ConfigError
from mbcacq.estimation import forward_model
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.recording.datasets.observation_set import write_observation_set

COMPLIANCE = 3e-6
OPTIONS = CalibrationOptions(refuse=False)


@pytest.fixture(scope="module")
def plan():
    return simulated.plan(stations=5, bars=2, each=6)


@pytest.fixture(scope="module")
def model(plan):
    state = simulated.nominal_state(plan)
    context = Context(plan, state, forward_model.predict(plan, state))
    soft = next(c for c in catalogue.candidates(context)[0] if c.name == "joint_compliance" and c.where == ("A2",))
    return EffectModel(plan.cell.robot, (term_of(context, soft, None, np.zeros(1), np.zeros(1)),), LearntRecording.of(plan))


def days(plan, compliances, first=0):
    """One arm on several days, with another tool and base, and the compliance of A2 that it had."""
    return [
        simulated.observe(plan, 500 + day, [("joint_compliance", ("A2",), [value], None)], arm=9)
        for day, value in enumerate(compliances, first)
    ]


def effects_of(calibration):
    assert calibration.effects is not None
    return calibration.effects.terms


@pytest.fixture(scope="module")
def same(plan):
    return days(plan, [COMPLIANCE, COMPLIANCE])


@pytest.fixture(scope="module")
def together(same, model):
    return calibrate_together(same, OPTIONS, model)


def test_two_days_give_one_arm_and_its_compliance(together):
    one, other = together

    np.testing.assert_array_equal(one.state.chain.rows, other.state.chain.rows)
    assert one.effects.terms[0].coefficients[0] == other.effects.terms[0].coefficients[0]
    assert abs(one.effects.terms[0].coefficients[0] - COMPLIANCE) < 4 * one.effects.terms[0].std[0]
    for calibration in together:
        assert calibration.fit.chi2 / calibration.fit.dof == pytest.approx(1.0, abs=0.15)


def test_the_arm_of_two_days_holds_on_a_third_within_its_uncertainty(plan, together):
    (third,) = days(plan, [COMPLIANCE], first=7)
    tried = check_transfer(replace(third, pose_id=third.pose_id + 1000), together[0])
    assert tried.with_effects.rms_mm < 0.5 * tried.geometry_alone.rms_mm
    assert 0.75 < tried.normalised_error.rms < 1.15


def test_what_is_the_same_every_day_has_no_variance_from_day_to_day(together):
    (entry,) = together[0].extra["day_to_day"]
    values, std = np.array(entry["values"]), np.array(entry["std"])
    assert np.all(np.abs(values - COMPLIANCE) < 4 * std)
    assert entry["between_std"] < 3 * std.max()


def test_what_differs_from_day_to_day_is_stated_with_it(plan, model):
    found = calibrate_together(days(plan, [2e-6, 4e-6]), OPTIONS, model)
    (entry,) = found[0].extra["day_to_day"]
    (term,) = effects_of(found[0])

    assert 0.7e-6 < entry["between_std"] < 3e-6  # of the two values: 1.4e-6
    assert entry["p_value"] < 1e-6
    assert term.std[0] > 0.99 * np.hypot(entry["between_std"], entry["common_std"] * 0.5)
    assert abs(term.coefficients[0] - 3e-6) < 2 * term.std[0]
    assert all(0.8 < one.fit.chi2 / one.fit.dof < 1.2 for one in found)


def test_what_is_unmodelled_beside_it_takes_nothing_of_that_variance(plan, model):
    recordings = days(plan, [2e-6, 4e-6])
    here = Covariates(recordings[0])
    groups = [unmodelled.group(here, f"A{i}", f"q{i}") for i in (4, 6)]
    both = replace(model, terms=(*model.terms, *(g for g in groups if g is not None)))

    found = calibrate_together(recordings, OPTIONS, both)
    (entry,) = found[0].extra["day_to_day"]
    term = next(t for t in effects_of(found[0]) if t.name == "joint_compliance")

    assert 0.7e-6 < entry["between_std"] < 3e-6
    assert term.std[0] > 0.99 * entry["between_std"]
    assert abs(term.coefficients[0] - 3e-6) < 2 * term.std[0]
    index = found[0].names.index(term.names[0])
    assert found[0].covariance[index, index] == pytest.approx(term.std[0] ** 2)


def test_effects_that_are_held_stay_as_they_are(same, model):
    known = model.with_coefficients([np.array([COMPLIANCE])], [np.zeros(1)])
    found = calibrate_together(same, OPTIONS, known, hold=True)
    assert all(effects_of(one)[0].coefficients[0] == COMPLIANCE for one in found)
    assert all(one.fit.chi2 / one.fit.dof == pytest.approx(1.0, abs=0.15) for one in found)
    assert not any(name.startswith("joint_compliance") for name in found[0].names)


def test_a_joint_result_holds_each_recording_and_is_read_again(same, model, tmp_path):
    paths = [tmp_path / "monday", tmp_path / "friday"]
    for obs, path in zip(same, paths, strict=True):
        write_observation_set(obs, path)
    effects, out = tmp_path / "effects.json", tmp_path / "arm.json"
    effects.write_text(json.dumps(model.to_dict()))

    asked = ["calibrate", *map(str, paths), "--even-if-undetermined", "--effects", str(effects), "--out", str(out)]
    done = CliRunner().invoke(command, asked[1:])

    assert done.exit_code == 0, done.output
    assert "Recording 2" in done.output
    assert "joint_compliance at A2" in done.output
    content = json.loads(out.read_text())
    assert [one["name"] for one in content["recordings"]] == list(map(str, paths))
    first, second = (CalibratedCell.from_json(tmp_path / f"arm.json#{n}") for n in (1, 2))
    np.testing.assert_array_equal(first.state.chain.rows, second.state.chain.rows)
    assert np.abs(first.state.T_flange_scanner - second.state.T_flange_scanner).max() > 0.1
    with pytest.raises(ConfigError, match=r"arm\.json#2"):
        CalibratedCell.from_json(out)
    with pytest.raises(ConfigError, match="2 recordings"):
        CalibratedCell.from_json(tmp_path / "arm.json#3")
    tried = mbcacq.verify_elsewhere(paths[1], out)
    assert tried.with_effects.rms_mm < 0.7 * tried.geometry_alone.rms_mm
    known = mbcacq.verify_elsewhere(paths[1], f"{out}#2", place="known")
    assert known.with_effects.chi2_dof < 1.2
    results = tmp_path / "results"
    with pytest.raises(ConfigError, match="give one"):
        mbcacq.export(out, results=results)
    assert mbcacq.export(f"{out}#2", results=results)


def test_a_joint_calibration_refuses_what_is_of_one_recording(same, tmp_path):
    for n, obs in enumerate(same):
        write_observation_set(obs, tmp_path / str(n))
    done = CliRunner().invoke(command, [str(tmp_path / "0"), str(tmp_path / "1"), "--held-out", "random"])
    assert done.exit_code != 0
    assert "of one recording" in str(done.exception or "") + done.output

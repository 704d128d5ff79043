"""A check of a cell: what changed is named, dated and sized; what cannot be judged is refused; the history survives or says why not."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from check_cells import simulated_plan
from click.testing import CliRunner
from shown_output import not_printed

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.cli.app import app
from mbcacq.cli.check import lines_of
from mbcacq.errors import CellChanged, ConfigError, DeviceFault, ExitCode
from mbcacq.interim_check.check import CheckSettings, InterimCheck, check, with_observations
from mbcacq.interim_check.history import CheckedDay, CheckHistory, read_history
from mbcacq.interim_check.measured_day import refuse_incomplete
from mbcacq.interim_check.options import CheckOptions, UsualChanges
from mbcacq.interim_check.planned_check import _criterion, _pose_grams, choose_poses, planned_check
from mbcacq.interim_check.verdict import verdict_of
from mbcacq.model.json_text import digest
from mbcacq.plan import expand, load

ROOT = Path(__file__).parents[2]
NOTHING = Scenario(0, "none", 3, (), 1, 1.0)


@pytest.fixture(scope="module")
def planned(learnt):
    loaded = load(ROOT / "plans" / "quick.yaml")
    return planned_check(loaded, expand(loaded), CalibratedCell.from_json(learnt), True, UsualChanges())


def history_of(planned, days):
    """(T, R) rows as a history."""
    kept = [
        CheckedDay(
            time=f"2026-03-{t + 1:02d}T08:00:00+00:00", run=f"/run{t}", residual=dict(zip(planned.keys, rows.reshape(-1, 3), strict=True))
        )
        for t, rows in enumerate(days)
    ]
    q = np.array([p.q for p in planned.poses])
    return CheckHistory(
        result="result",
        plan="plan",
        poses=tuple(p.number for p in planned.poses),
        q=q,
        standing=True,
        usual_days=UsualChanges(),
        stations={},
        days=tuple(kept),
    )


def noise(planned, days, seed=0):
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(planned.rows.noise)
    return rng.standard_normal((days, len(root))) @ root.T + rng.standard_normal((days, planned.rows.daily.shape[1])) @ planned.rows.daily.T


def change(planned, name, where):
    return next(r for r in planned.changes if (r.name, r.where) == (name, where))


def test_what_changed_is_named_dated_and_sized(planned):
    days = noise(planned, 12)
    assert not verdict_of(planned, history_of(planned, days)).changed
    mount = change(planned, "mount", "scanner on the flange")
    true = np.array([0.05, -0.03, 0.0, 0.0, 0.0, np.radians(0.02)])
    days[8:] += mount.columns @ (true / mount.usual)
    found = verdict_of(planned, history_of(planned, days))
    assert found.changed
    assert found.since == 8
    assert found.between == (8, 8)
    first = found.suspects[0]
    assert (first.name, len(found.suspects)) == ("mount", 1)
    assert np.abs((np.array(first.size) - true) / np.array(first.std)).max() < 4
    done = InterimCheck(found, history_of(planned, days), Path("check.json"), Path("run"))
    assert "mount (scanner on the flange), before the check of 2026-03-09" in done.sentence
    assert not_printed("docs/how-to/check.md", "tests/interim_check/test_check.py", "\n".join(lines_of(done))) == []
    with pytest.raises(CellChanged) as caught:
        done.refuse_changed()
    assert caught.value.exit_code is ExitCode.CHANGED


MOVED = np.array([0.05, -0.03, 0.0, 0.0, 0.0, np.radians(0.02)])


def judged(planned, days, looks):
    """The verdict after some of the days, as nightly checks give it."""
    history = history_of(planned, days)
    for t in looks:
        found = verdict_of(planned, replace(history, days=history.days[: t + 1]))
        kept = tuple(replace(day, log_e=found.log_e) if k == t else day for k, day in enumerate(history.days))
        history = replace(history, days=kept)
        yield found, history


def test_an_alarm_ends_once_what_changed_was_put_right(planned):
    days, mount = noise(planned, 14, seed=3), change(planned, "mount", "scanner on the flange")
    days[5:8] += mount.columns @ (MOVED / mount.usual)
    said = list(judged(planned, days, (4, 5, 7, 8, 13)))
    assert [found.changed for found, _ in said] == [False, True, True, False, False]
    found, history = said[-1]
    assert [(one.first, one.end, one.suspect.name) for one in found.put_right] == [(5, 8, "mount")]
    done = InterimCheck(found, history, Path("check.json"), Path("run"))
    assert "nothing changed in 11 checks" in done.sentence
    assert "off from the check of 2026-03-06T08:00:00+00:00 to that of 2026-03-08" in done.sentence
    assert "put right before the check of 2026-03-09" in done.sentence
    assert done.to_dict()["put_right"][0]["until"] == "2026-03-09T08:00:00+00:00"


@pytest.mark.parametrize("back", [0.0, 0.5], ids=["never", "half"])
def test_an_alarm_stands_where_what_changed_was_not_put_right(planned, back):
    days, mount = noise(planned, 14, seed=4), change(planned, "mount", "scanner on the flange")
    days[5:] += mount.columns @ (MOVED / mount.usual)
    days[8:] -= back * (mount.columns @ (MOVED / mount.usual))
    said = [found for found, _ in judged(planned, days, (4, 5, 8, 13))]
    assert [found.changed for found in said] == [False, True, True, True]
    assert said[-1].suspects[0].name == "mount"


def test_a_bad_day_does_not_hide_a_change_after_it(planned):
    days, mount = noise(planned, 14, seed=5), change(planned, "mount", "scanner on the flange")
    days[4] += change(planned, "mastering", "A4").columns[:, 0]
    days[9:] += mount.columns @ (MOVED / mount.usual)
    found, _ = list(judged(planned, days, (4, 8, 9, 13)))[-1]
    assert (found.changed, found.since, found.suspects[0].name) == (True, 9, "mount")


def test_days_count_in_the_order_in_which_they_were_measured_though_the_clock_was_set_back(planned):
    days = noise(planned, 6, seed=7)
    mount = change(planned, "mount", "scanner on the flange")
    days[4:] += mount.columns @ (np.array([0.05, -0.03, 0.0, 0.0, 0.0, np.radians(0.02)]) / mount.usual)
    history = history_of(planned, days)
    back = replace(history, days=tuple(replace(day, time=f"2026-03-{9 - t:02d}T08:00:00+00:00") for t, day in enumerate(history.days)))
    found = verdict_of(planned, back)
    assert (found.changed, found.since, found.suspects[0].name) == (True, 4, "mount")
    sentence = InterimCheck(found, back, Path("check.json"), Path("run")).sentence
    assert "before the check of 2026-03-05T08:00:00+00:00" in sentence


def test_a_joint_that_lost_its_zero_is_named_and_so_is_what_looks_like_it(planned):
    days = noise(planned, 8, seed=1)
    zero = change(planned, "mastering", "A4")
    days[5:] += zero.columns[:, 0] * np.radians(0.005) / zero.usual[0]
    found = verdict_of(planned, history_of(planned, days))
    assert found.changed
    named = next(s for s in found.suspects if s.name == "mastering")
    assert named.where == "A4"
    assert abs(np.degrees(named.size[0]) - 0.005) < 4 * np.degrees(named.std[0])


def test_a_change_without_a_name_is_not_given_one(planned):
    days = noise(planned, 8, seed=2)
    unnamed = change(planned, "unnamed", "the arm")
    days[4:] += unnamed.columns @ np.random.default_rng(4).standard_normal(unnamed.columns.shape[1])
    found = verdict_of(planned, history_of(planned, days))
    assert found.changed
    assert found.suspects[0].name == "unnamed"
    assert next(s for s in found.suspects if s.name != "unnamed").explains < 0.9


def test_a_change_that_moves_single_balls_is_still_seen_weeks_later(planned):
    """It stays from day to day, and so is no larger noise."""
    days = noise(planned, 24, seed=5)
    days[6:] += 0.01 * np.random.default_rng(6).standard_normal(days.shape[1])
    found = verdict_of(planned, history_of(planned, days))
    assert found.changed
    assert found.since == 6
    assert (found.suspects[0].name, found.suspects[0].where) == ("unnamed", "the scanner")


def test_a_change_between_calibration_and_first_check_is_seen_on_the_first_day(planned):
    days = noise(planned, 1, seed=3)
    assert not verdict_of(planned, history_of(planned, days)).changed
    zero = change(planned, "mastering", "A5")
    found = verdict_of(planned, history_of(planned, days + zero.columns[:, 0] * np.radians(0.05) / zero.usual[0]))
    assert found.changed
    assert found.since == 0


def test_the_poses_that_are_chosen_are_of_one_station_and_notice_more_than_others(learnt):
    loaded = load(ROOT / "plans" / "quick.yaml")
    everything = planned_check(loaded, expand(loaded), CalibratedCell.from_json(learnt), True, UsualChanges())
    numbers = choose_poses(everything, CheckOptions(poses=6))
    assert len(numbers) == 6
    grams, first, free = _pose_grams(everything, range(10))
    criteria = [
        _criterion(grams[list(k)].sum(axis=0), first, free) for k in ([0, 1, 2, 3, 4, 5], [4, 5, 6, 7, 8, 9], [0, 2, 4, 6, 8, 9], numbers)
    ]
    assert np.argmax(criteria) == 3
    with pytest.raises(ConfigError, match="no station of this plan has"):
        choose_poses(everything, CheckOptions(poses=12, fewest=11))


def test_measured_days_leave_the_noise_that_is_expected(learnt):
    """The fake cell as it was calibrated: residuals by the calibrated cell are the noise of measuring, with the artefact where it stands."""
    loaded = load(ROOT / "plans" / "quick.yaml")
    poses = [replace(p, exposures=load(ROOT / "plans" / "kuka.yaml").plan.exposures) for p in expand(loaded)]
    planned = planned_check(loaded, poses, CalibratedCell.from_json(learnt), True, UsualChanges())
    history = replace(history_of(planned, np.zeros((0, 3 * planned.obs.n_centres))), poses=tuple(p.number for p in poses))
    for day in range(2):
        obs, _ = observe(loaded, poses, NOTHING, [], noise_seed=day)
        history = with_observations(planned, history, obs, Path(f"/run{day}"))
    between = np.array([history.days[1].residual[k] - history.days[0].residual[k] for k in planned.keys]).reshape(-1) / np.sqrt(2)
    root = np.linalg.cholesky(planned.rows.noise)
    assert 0.6 < np.mean(np.linalg.solve(root, between) ** 2) < 1.6
    with pytest.raises(ConfigError, match="already"):
        with_observations(planned, history, obs, Path("/run1"))


def test_a_day_counts_whole(planned):
    residual = dict.fromkeys(planned.keys, np.zeros(3))
    refuse_incomplete(planned, residual)
    with pytest.raises(DeviceFault, match="pose 7 of the check"):
        refuse_incomplete(planned, {k: v for k, v in residual.items() if k[0] != 7})


def test_the_history_comes_back_as_it_was_and_a_damaged_one_says_so(planned, tmp_path):
    history, file = history_of(planned, noise(planned, 2)), tmp_path / "check.json"
    assert read_history(file) is None
    history.write(file)
    again = read_history(file)
    assert np.array_equal(again.q, history.q)
    assert max(np.abs(again.days[1].residual[k] - history.days[1].residual[k]).max() for k in planned.keys) <= 5e-6
    text = file.read_text()
    for harmed, said in (
        (text.replace("/run1", "/run2"), "is not as it was written"),
        (text[: len(text) // 2], "check.json"),
        ('{"format": "mbcacq-check/1"}', "is damaged"),
        ("[]", "is no history of checks"),
    ):
        file.write_text(harmed)
        with pytest.raises(ConfigError, match=said):
            read_history(file)


def test_a_history_is_of_one_result_and_one_set_of_poses(learnt, planned, tmp_path):
    file = tmp_path / "check.json"
    history_of(planned, noise(planned, 1)).write(file)
    with pytest.raises(ConfigError, match="is the history of another result"):
        check(learnt, ROOT / "plans" / "quick.yaml", history=file, dry_run=True)
    content = json.loads(learnt.read_text())
    replace(history_of(planned, noise(planned, 1)), result=digest(content), q=np.zeros((10, 6))).write(file)
    with pytest.raises(ConfigError, match="no longer has the poses"):
        check(learnt, ROOT / "plans" / "quick.yaml", history=file, dry_run=True)
    with pytest.raises(ConfigError, match="give 6 or more"):
        check(learnt, ROOT / "plans" / "quick.yaml", history=tmp_path / "new.json", dry_run=True, settings=CheckSettings(poses=3))


def test_a_real_arm_moves_for_a_check_only_where_somebody_said_so(learnt, tmp_path):
    plan = yaml.safe_load((ROOT / "plans" / "quick.yaml").read_text())
    plan["robot"]["model"] = str(ROOT / "plans" / plan["robot"]["model"])
    plan["artefacts"] = [str(ROOT / "plans" / a) for a in plan["artefacts"]]
    plan["robot"]["options"] |= {"bind": "192.168.1.5", "controller_ip": "192.168.1.6"}
    (tmp_path / "plan.yaml").write_text(yaml.safe_dump(plan))
    with pytest.raises(ConfigError, match="this calibration is simulated"):
        check(learnt, tmp_path / "plan.yaml", history=tmp_path / "check.json")
    measured = {key: value for key, value in json.loads(learnt.read_text()).items() if key not in ("simulated", "sha256")}
    with pytest.raises(ConfigError, match="this would move"):
        check(measured, tmp_path / "plan.yaml", history=tmp_path / "check.json")
    assert not (tmp_path / "check.json").exists()


def test_the_command_measures_judges_and_says_as_before(learnt, tmp_path):
    simulated_plan(tmp_path)
    history = tmp_path / "check.json"
    given = ["check", str(learnt), str(tmp_path / "plan.yaml"), "--history", str(history), "--json"]
    done = CliRunner().invoke(app, [*given, "--dry-run", "--poses", "6", "--out", str(tmp_path / "day"), "--seed", "3"])
    assert done.exit_code == 0, done.stderr
    said = json.loads(done.stdout)
    assert (said["verdict"], said["checks"]) == ("as_before", 1)
    assert len(read_history(history).poses) == 6
    again = CliRunner().invoke(app, [*given, "--from", str(tmp_path / "day")])
    assert again.exit_code == ExitCode.USAGE
    assert "is in the history of these checks already" in again.stderr

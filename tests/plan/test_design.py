"""Accuracy and detectability predicted for a plan and found true by simulation; poses chosen by a design."""

import json
import shutil

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from plan_folder import PLANS

from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.calibrated_cell import verify
from mbcacq.cli.plan import command
from mbcacq.design.candidate_views import candidates
from mbcacq.design.design_problem import DesignProblem
from mbcacq.design.effect_detectability import detectability
from mbcacq.design.exchange_algorithm import choose_by_exchange
from mbcacq.design.optimal_design import design
from mbcacq.design.optimality_criteria import AOptimality, DOptimality, updated_covariance
from mbcacq.design.options import DesignOptions
from mbcacq.design.plan_findings import identifiability_findings
from mbcacq.design.plan_rewriter import with_views
from mbcacq.design.predicted_accuracy import predicted_accuracy, predicted_calibration
from mbcacq.design.simulated_observations import planned_noise, planned_observations, planned_state, simulated_recording
from mbcacq.errors import ConfigError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.plan import expand, load, path
from mbcacq.plan.feasibility import check
from mbcacq.plan.schema import View
from mbcacq.plan.summary import summary


@pytest.fixture(scope="module")
def published():
    loaded = load(PLANS / "kuka.yaml")
    return loaded, expand(loaded)


def test_the_published_plan_predicts_the_accuracy_its_authors_expect(published):
    """All 24 parameters of arm and hand-eye; a linearised analysis of such a plan expects 0.012 to 0.020 mm at the bar."""
    accuracy = predicted_accuracy(*published)
    assert accuracy.distance_mm is not None
    assert accuracy.calibration_mm is not None
    assert (accuracy.determined, accuracy.parameters) == (24, 24)
    assert 0.010 < accuracy.distance_mm < 0.020
    assert accuracy.calibration_mm < accuracy.distance_mm
    assert len(accuracy.distances) == 10


def test_calibrated_cells_show_the_predicted_accuracy(published):
    """Twelve random true cells, recorded with noise and calibrated: bar errors have the predicted spread."""
    loaded, poses = published
    observations, noise = planned_observations(loaded, poses), planned_noise(loaded, poses)
    predicted = predicted_calibration(loaded, observations, noise)
    expected = np.array([e for _, e in predicted_accuracy(loaded, poses).distances])
    rng, bars = np.random.default_rng(12), []
    for _ in range(12):
        recorded = simulated_recording(loaded, observations, noise, rng)
        found = calibrate(recorded)
        bars.append(verify(recorded, found).errors("after") / expected)
        assert found.names == predicted.names
    # 120 errors, those of one cell correlated: the mean square of a unit normal within four of its standard errors
    assert np.mean(np.square(bars)) == pytest.approx(1.0, abs=0.75)


def test_views_of_two_close_places_leave_much_undetermined(folder):
    """All views from one side at two places, 60 mm apart; at the first alone a calibration would refuse them."""
    third = ("  - {id: 2,", "  - {id: 3, artefact: mbc, pose_in_base: {translation_mm: [600, 60, 150]}}\n  - {id: 2,")
    text = folder.plan(third).read_text().split("steps:")[0]
    steps = "steps:\n  - name: v\n    phase: position\n    do: look\n    stations: [1, 3]\n    views:\n" + "".join(
        f"      - {{tilt_deg: {t}, azimuth_deg: 180, wrist: positive}}\n" for t in (8, 10, 12, 14)
    )
    loaded = load(folder.write("plan.yaml", text + steps))
    poses = expand(loaded)
    found, accuracy, _ = identifiability_findings(loaded, poses, summary(loaded, poses))
    assert accuracy is not None
    assert accuracy.determined < accuracy.parameters
    assert accuracy.workspace_mm is None
    assert "undetermined" in {f.code for f in found if f.level == "warning"}
    alone = [p for p in poses if p.station == "1"]
    found, accuracy, _ = identifiability_findings(loaded, alone, summary(loaded, alone))
    assert accuracy is None
    assert found[0].sentence.startswith("a calibration will refuse these poses: all poses are at one station")


def test_one_orientation_is_refused_in_the_calibrations_words(folder):
    text = folder.plan().read_text().split("steps:")[0]
    step = "steps:\n  - {name: t, phase: translation, do: translate, station: 1, offsets_mm: [[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]]}\n"
    loaded = load(folder.write("plan.yaml", text + step))
    poses = expand(loaded)
    found, accuracy, effects = identifiability_findings(loaded, poses, summary(loaded, poses))
    assert (accuracy, effects) == (None, None)
    assert "all poses have the same orientation" in found[0].sentence


def test_without_calibration_poses_nothing_is_predicted(folder):
    loaded = load(folder.plan(("phase: position", "phase: verification")))
    poses = expand(loaded)
    found, accuracy, _ = identifiability_findings(loaded, poses, summary(loaded, poses))
    assert accuracy is None
    assert "no pose to calibrate with" in found[0].sentence


def test_every_pose_twice_halves_the_variance(published):
    loaded, poses = published
    once, twice = predicted_accuracy(loaded, poses), predicted_accuracy(loaded, [*poses, *poses])
    assert twice.indices["O3"] == pytest.approx(np.sqrt(2) * once.indices["O3"], rel=0.02)
    assert twice.indices["O2"] == pytest.approx(once.indices["O2"], rel=0.02)
    assert twice.calibration_mm == pytest.approx(once.calibration_mm / np.sqrt(2), rel=0.03)


def test_a_small_artefact_hides_gravity_and_a_long_bar_shows_it(published):
    """Compliance, pedestal tilt and link growth are absorbed by free stations; the bar seen end by end brings them out."""
    loaded, poses = published
    transits = path(loaded, poses)
    starts = 30.0 * np.arange(len(poses))
    few = [k for k, p in enumerate(poses) if p.phase != "verification"]
    whole = {(e.name, e.location): e for e in detectability(loaded, poses, transits, starts).effects}
    alone = {
        (e.name, e.location): e for e in detectability(loaded, [poses[k] for k in few], [transits[k] for k in few], starts[few]).effects
    }
    for key in [("joint_compliance", "A2"), ("joint_compliance", "A3"), ("base_compliance", "base")]:
        assert alone[key].absorbed > 0.98
        assert alone[key].sigmas < whole[key].sigmas
    assert not alone["joint_compliance", "A2"].detectable
    assert whole["gear_transmission_error", "A1"].detectable  # fast in its own angle: nothing else looks like it
    assert whole["gear_transmission_error", "A1"].absorbed < 0.5


def test_detectability_grows_with_the_square_root_of_the_poses(published):
    loaded, poses = published
    once = {(e.name, e.location): e.sigmas for e in detectability(loaded, poses).effects}
    twice = {(e.name, e.location): e.sigmas for e in detectability(loaded, [p for p in poses for _ in range(2)]).effects}
    for key in [("joint_scale", "A4"), ("wrist_coupling", "A4+A5")]:
        assert twice[key] == pytest.approx(np.sqrt(2) * once[key], rel=0.02)


def test_update_of_a_covariance_and_its_gain():
    rng = np.random.default_rng(3)
    A = rng.normal(size=(9, 9))
    base = A @ A.T + np.eye(9)
    C, B, target = np.linalg.inv(base), rng.normal(size=(5, 6, 9)), np.diag([1.0, 2, 3, 0, 0, 0, 0, 0, 0])
    for criterion in (AOptimality(target), DOptimality(4)):
        gains = criterion.gains(C, B, 1.0)
        for block, gain in zip(B, gains, strict=True):
            grown = np.linalg.inv(base + block.T @ block)
            assert updated_covariance(C, block, 1.0) == pytest.approx(grown, abs=1e-12)
            assert gain == pytest.approx(criterion.value(C) - criterion.value(grown), abs=1e-9)
            assert updated_covariance(grown, block, -1.0) == pytest.approx(C, abs=1e-9)
            assert criterion.gains(grown, block[None], -1.0)[0] == pytest.approx(-gain, abs=1e-9)


def test_exchange_finds_the_best_of_all_choices_of_a_small_problem():
    """Eight blocks, three to be chosen, two stations: against all 56 choices."""
    from itertools import combinations

    rng = np.random.default_rng(5)
    blocks, groups, base = rng.normal(size=(8, 6, 10)), np.array([0, 0, 0, 0, 1, 1, 1, 1]), np.eye(10) * 0.1
    criterion = AOptimality(np.diag([1.0, 1, 1, 1, 0, 0, 0, 0, 0, 0]))

    def value(which):
        return criterion.value(np.linalg.inv(base + sum(blocks[k].T @ blocks[k] for k in which)))

    every = sorted(value(c) for c in combinations(range(8), 3))
    assert value(choose_by_exchange(base, blocks, groups, 3, criterion)) <= every[2]


def test_candidates_can_be_taken(published, tmp_path):
    loaded, _ = published
    found = candidates(loaded, ["p2"], 40.0, 1, DesignOptions(views_per_station=60))
    assert len(found) > 20
    text = with_views(loaded, {("p2", None): [c.view for c in found]})
    shutil.copytree(PLANS, tmp_path, dirs_exist_ok=True)
    (tmp_path / "candidates.yaml").write_text(text)
    taken = load(tmp_path / "candidates.yaml")
    poses = [p for p in expand(taken) if p.phase == "position"]
    findings = [f for f in check(taken, expand(taken)) if f.level == "error" and f.step.startswith("designed")]
    assert len(poses) == len(found)
    assert findings == []
    assert {np.sign(p.q[4]) for p in poses} == {1.0, -1.0}


def test_information_blocks_agree_with_the_full_calibration(published):
    """Information blocks of six rows a pose against the complete problem, balls held."""
    loaded, poses = published
    kept = [p for p in poses if p.phase != "verification"]
    problem = DesignProblem(loaded, kept, [], poses)
    C = np.linalg.inv(problem.base)[: problem.layout.size, : problem.layout.size]
    free = CalibrationOptions(refuse=False, random_links=False)  # a design asks what the poses alone determine
    full = predicted_calibration(loaded, planned_observations(loaded, poses), planned_noise(loaded, poses), free)
    arm = [i for i, name in enumerate(full.names) if not name.startswith("ball_")]
    # the certificate's 1 um makes the full problem a little less certain
    ratio = np.sqrt(np.diag(full.covariance)[arm] / np.diag(C))
    assert (ratio > 0.999).all()
    assert ratio.max() < 1.25


def test_design_is_better_than_the_given_plan_and_keeps_the_rest(published, folder):
    loaded, poses = published
    result = design(loaded, 64)
    for name in ("kuka.yaml", "robots/kr10_r1100_2.yaml", "artefacts/mbc-8.yaml", "artefacts/bar-735.yaml"):
        (folder.path / name).parent.mkdir(exist_ok=True)
        (folder.path / name).write_text((PLANS / name).read_text())
    (folder.path / "kuka.yaml").write_text(result.text)
    new = load(folder.path / "kuka.yaml")
    better = expand(new)
    count = {phase: sum(p.phase == phase for p in better) for phase in ("translation", "orientation", "position", "verification")}
    assert count == {"translation": 6, "orientation": 6, "position": 64, "verification": 20}
    designed_mm, given_mm = predicted_accuracy(new, better).calibration_mm, predicted_accuracy(loaded, poses).calibration_mm
    assert designed_mm is not None
    assert given_mm is not None
    assert designed_mm < 0.9 * given_mm
    assert [str(f) for f in check(new, better) if f.level == "error"] == []
    assert "# Lengths mm, angles deg." in result.text
    assert "Eight places of the tripod" not in result.text
    assert "# The scale bar, longer than the view" in result.text
    assert "robot" in yaml.safe_load(result.text)


def test_a_long_bar_is_designed_end_by_end(folder):
    result = design(load(folder.plan(("phase: verification", "phase: position"))), 24)
    assert set(result.chosen) == {("1", None), ("2", 9), ("2", 10)}
    assert all(len(views) >= 2 for views in result.chosen.values())
    new = load(folder.write("new.yaml", result.text))
    assert {p.balls for p in expand(new) if p.station == "2"} == {(9,), (10,)}


def test_a_plan_written_on_one_line_is_rewritten_too(folder):
    text = folder.plan().read_text().split("steps:")[0]
    flow = "steps: [{name: a, phase: position, do: look, stations: [1], views: [{}]}, {name: b, phase: verification, do: look, stations: [2], balls: each, views: [{}]}]\n"
    loaded = load(folder.write("plan.yaml", text + flow))
    new = yaml.safe_load(with_views(loaded, {("1", None): [View(tilt_deg=12, shift_mm=(1, 2, 3.5), wrist="positive")]}))
    assert [s["name"] for s in new["steps"]] == ["designed 1", "b"]
    assert new["steps"][0]["views"] == [{"tilt_deg": 12, "azimuth_deg": 0, "roll_deg": 0, "shift_mm": [1, 2, 3.5], "wrist": "positive"}]
    assert new["steps"][0]["stations"] == [1]


def test_more_poses_than_can_be_taken_are_refused(folder):
    loaded = load(
        folder.plan(
            ("[600, 0, 150]", "[1000, 0, -100]"),
            ("{tilt_deg: 20, azimuth_deg: 30}", "{tilt_deg: 0}"),
            ("      - {tilt_deg: 30, azimuth_deg: 200, roll_deg: 40}\n", ""),
        )
    )
    with pytest.raises(ConfigError, match=r"of about 220 random views at 1 stations only \d+ can be taken, fewer than the 300 asked for"):
        design(loaded, 300)


def test_design_on_the_command_line(folder):
    third = ("  - {id: 2,", "  - {id: 3, artefact: mbc, pose_in_base: {translation_mm: [550, 150, 50]}}\n  - {id: 2,")
    plan = folder.plan(
        third, ("    stations: [1]", "    stations: [1, 3]"), ("      - {tilt_deg: 30, azimuth_deg: 200, roll_deg: 40}\n", "")
    )
    done = CliRunner().invoke(command, ["design", str(plan), "--poses", "16", "--json"], catch_exceptions=False)
    content = json.loads(done.stdout)
    assert content["designed"]["poses"] == 16
    assert content["given"]["expected_bar_mean_mm"] is None  # two poses determine nothing, so nothing is promised
    assert 0 < content["designed"]["expected_bar_mean_mm"] < 0.1
    again = CliRunner().invoke(command, ["design", str(plan), "--poses", "16"])
    assert isinstance(again.exception, ConfigError)
    assert "exists already" in str(again.exception)


def test_a_design_at_one_station_says_that_it_cannot_be_calibrated(folder):
    done = CliRunner().invoke(command, ["design", str(folder.plan()), "--poses", "8", "--json"], catch_exceptions=False)
    assert json.loads(done.stdout)["designed"]["expected_bar_mean_mm"] is None
    assert done.stderr.startswith("a calibration will refuse these poses: all poses are at one station")


def test_planned_observations_are_what_the_nominal_cell_shows(published):
    loaded, poses = published
    observations = planned_observations(loaded, poses)
    assert observations.n_poses == 96
    assert np.abs(observations.xyz[:, 2]).max() < 55
    state = planned_state(loaded)
    assert state.T_base_station.shape == (18, 4, 4)
    assert all(s.T_base_station is None for s in observations.cell.stations)

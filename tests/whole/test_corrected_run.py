"""A run that a calibrated arm steers: the true arm stands where the plan means it to; the same targets when the run goes on."""

import json
from dataclasses import replace

import numpy as np
import pytest
from dry_runs import plan_file
from mbcacq_fakes.world.arm import TrueArm, paper_errors
from typed_command import ROOT, mbcacq, one_sentence

import mbcacq as library
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.model.json_text import fields_as_json, sealed_text
from mbcacq.plan import expand, load
from mbcacq.recording import load_observations
from mbcacq.recording.run_folder.run_plan import keep_plan, plan_files_text, read_kept_plan
from mbcacq.workflow.corrected_targets import CorrectedTargets, corrected_targets, read_targets, to_go_on_with


@pytest.fixture(scope="module")
def learnt(tmp_path_factory):
    """result.json of the fake cell's arm, learnt at the places of kuka.yaml."""
    loaded = load(ROOT / "plans" / "kuka.yaml")
    observations, _ = observe(loaded, expand(loaded), Scenario(0, "none", 3, (), 1, 1.0), [])
    path = tmp_path_factory.mktemp("learnt") / "result.json"
    path.write_text(sealed_text(library.calibrate(observations).to_dict() | {"simulated": True}))
    return path


@pytest.fixture(scope="module")
def quick():
    loaded = load(ROOT / "plans" / "quick.yaml")
    return loaded, expand(loaded)


def missed(loaded, goals, q):
    """(P,) mm between the true flange at q and the goals, but for where base and tool are, which no measurement of the arm can tell."""
    chain = loaded.cell.robot.chain
    rows = np.stack([chain.theta, chain.d, chain.a, chain.alpha, chain.beta], axis=1)
    there = TrueArm.from_rows(chain.sign, rows + paper_errors()).flange(q)
    base, tool = np.zeros(6), np.zeros(6)
    for _ in range(5):
        now = se3.exp(base) @ there @ se3.exp(tool)
        local = se3.inverse(now) @ goals
        left = np.concatenate([local[:, :3, 3], se3.rotation_log(local[:, :3, :3])], axis=1).reshape(-1)
        A = np.concatenate([se3.adjoint(se3.inverse(now)), np.broadcast_to(np.eye(6), (len(now), 6, 6))], axis=2).reshape(-1, 12)
        step = np.linalg.lstsq(
            A * np.tile([1, 1, 1, 300, 300, 300], len(now))[:, None], left * np.tile([1, 1, 1, 300, 300, 300], len(now))
        )[0]
        base, tool = base + step[:6], tool + step[6:]
    return np.linalg.norm((se3.exp(base) @ there @ se3.exp(tool))[:, :3, 3] - goals[:, :3, 3], axis=1)


def test_the_true_arm_stands_where_the_plan_means_it_to(learnt, quick):
    loaded, poses = quick
    targets = corrected_targets(loaded, poses, learnt, dry_run=True)
    goals = loaded.cell.robot.chain.flange(targets.nominal)
    assert missed(loaded, goals, targets.nominal).max() > 0.1
    assert missed(loaded, goals, targets.corrected).max() < 0.02
    assert [p.q.tolist() for p in targets.steer(poses)] == targets.corrected.tolist()


def test_a_run_is_steered_checked_recorded_and_its_report_says_what_it_changed(learnt, tmp_path):
    def change(plan):
        plan["robot"] |= {"driver": "simulated", "options": {}}
        plan["scanner"] |= {"driver": "simulated", "options": {}}

    plan, run = plan_file(tmp_path, change), tmp_path / "run"
    done = mbcacq("run", plan, "--dry-run", "--out", run, "--corrected", learnt, "--json")
    assert done.returncode == 0, done.stderr
    improved = json.loads(done.stdout)["arm_improved"]
    assert improved["new"] is None  # a result.json alone does not say at which places it was learnt
    assert improved["before"]["rms_mm"] > 0.1
    assert improved["after"]["rms_mm"] < 2 * improved["noise_mm"] < 0.03
    assert "The arm improved" in (run / "report.html").read_text(encoding="utf-8")
    kept = read_targets(read_kept_plan(run).corrected)
    obs = load_observations(run)
    assert np.abs(obs.q - kept.corrected[obs.pose_id]).max() < 1e-4
    assert np.abs(kept.corrected - kept.nominal).max() > 1e-4
    # The recording holds the targets too: without its files the folder goes on with them.
    (run / "plan.files.json").unlink()
    assert np.array_equal(to_go_on_with(run, None).corrected, kept.corrected)


def test_a_run_that_goes_on_keeps_the_targets_it_began_with(learnt, quick, tmp_path):
    loaded, poses = quick
    targets = corrected_targets(loaded, poses, learnt, dry_run=True)
    keep_plan(tmp_path, loaded.text, plan_files_text(loaded.files, "the cell", path=loaded.path, corrected=fields_as_json(targets)))
    again = to_go_on_with(tmp_path, None)
    assert np.array_equal(again.corrected, targets.corrected)  # to the last bit
    assert np.array_equal(to_go_on_with(tmp_path, targets).nominal, targets.nominal)
    with pytest.raises(ConfigError, match="steered by another result"):
        to_go_on_with(tmp_path, CorrectedTargets("other", *(getattr(targets, n) for n in ("nominal", "corrected", "moved_mm", "noise_mm"))))
    keep_plan(tmp_path, loaded.text, plan_files_text(loaded.files, "the cell", path=loaded.path))
    with pytest.raises(ConfigError, match="the plan's own targets"):
        to_go_on_with(tmp_path, targets)


def test_targets_that_were_damaged_move_nothing(learnt, quick):
    loaded, poses = quick
    whole = fields_as_json(corrected_targets(loaded, poses, learnt, dry_run=True))
    for harm in ({"corrected": whole["corrected"][:-1]}, {"corrected": None}, {"nominal": [[float("nan")] * 6] * 10}):
        with pytest.raises(ConfigError, match="damaged"):
            read_targets(whole | harm)
    with pytest.raises(ConfigError, match="other poses"):
        read_targets(whole).steer(poses[::-1])


def test_a_real_arm_is_not_steered_by_a_simulated_result(learnt, tmp_path):
    plan = plan_file(tmp_path, lambda p: p["robot"]["options"].update(bind="192.168.1.5", controller_ip="192.168.1.6"))
    done = mbcacq("run", plan, "--arm", "--corrected", learnt, "--out", tmp_path / "run")
    assert done.returncode == 2
    assert "this calibration is simulated" in one_sentence(done)
    assert not (tmp_path / "run").exists()


def test_the_result_of_another_arm_or_of_one_far_off_steers_nothing(learnt, quick):
    loaded, poses = quick
    content = json.loads(learnt.read_text())
    with pytest.raises(ConfigError, match="the result is of 'other'"):
        corrected_targets(loaded, poses, content | {"robot": content["robot"] | {"name": "other"}}, dry_run=True)
    far = json.loads(learnt.read_text())
    far["robot"]["calibrated"]["theta"][1] += 0.1
    with pytest.raises(ConfigError, match="more than an arm in good order"):
        corrected_targets(loaded, poses, far, dry_run=True)


def test_a_place_beyond_a_limit_of_the_corrected_joints_is_refused(learnt, quick):
    loaded, poses = quick
    free = corrected_targets(loaded, poses, learnt, dry_run=True)
    axis = int(np.argmax(np.abs(free.corrected - free.nominal).max(axis=0)))
    pose = int(np.argmax(np.abs(free.corrected - free.nominal)[:, axis]))
    up = free.corrected[pose, axis] > free.nominal[pose, axis]
    limits = loaded.cell.robot.limits.copy()
    limits[axis, 1 if up else 0] = free.nominal[pose, axis] + (1e-6 if up else -1e-6)
    tight = replace(loaded, cell=replace(loaded.cell, robot=replace(loaded.cell.robot, limits=limits)))
    with pytest.raises(ConfigError, match="short of its place"):
        corrected_targets(tight, poses[pose : pose + 1], learnt, dry_run=True)

"""A check by the scans of a part: made scenes of a true cell, whose frame is another one every day."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.interim_check.check import with_observations
from mbcacq.interim_check.history import CheckHistory, read_history
from mbcacq.interim_check.on_part import seen_as_points, with_noise, with_points
from mbcacq.interim_check.options import UsualChanges
from mbcacq.interim_check.planned_check import planned_check
from mbcacq.interim_check.verdict import verdict_of
from mbcacq.parts.observations import observations_of_parts
from mbcacq.parts.scene import RegisteredScene
from mbcacq.parts.step import SmoothNoise
from mbcacq.plan import expand, load

PLANS = Path(__file__).parents[2] / "plans"
SIGMA = np.array([7e-3, 7e-3, 3e-3, 8e-5, 8e-5, 1.8e-4])  # of a scene's pose, as scans of a casting have it: mm, rad


@pytest.fixture(scope="module")
def planned(learnt):
    loaded = load(PLANS / "part.yaml")
    points, scans = with_points(loaded, expand(loaded))
    return planned_check(points, scans[::2], CalibratedCell.from_json(learnt), False, UsualChanges())


def day_of(check, rng, mount_mm=(0.0, 0.0, 0.0), noise=1.0):
    """What the scans of one day give: scene poses (P,) with noise, seen by the calibrated cell with its mount off, in a frame of that day."""
    obs, state, n = check.obs, check.state, check.obs.n_poses
    stood = obs.q + noise * check.cell.noise.joint * rng.standard_normal(obs.q.shape)
    X = state.T_flange_scanner @ se3.transform(np.eye(3), np.array(mount_mm))
    T_base_scanner = check.cell.frames(stood)[:, -1] @ X
    frame = se3.exp(np.r_[rng.normal(0, 3, 3), rng.normal(0, 0.02, 3)])
    seen = se3.inverse(T_base_scanner) @ state.T_base_station[obs.station[0]] @ frame
    off = noise * SIGMA * rng.standard_normal((n, 6))
    seen = se3.transform(se3.rotation_exp(off[:, 3:]) @ seen[:, :3, :3], seen[:, :3, 3] + off[:, :3])
    own = np.broadcast_to(np.diag(SIGMA**2), (n, 6, 6))
    scene = RegisteredScene(seen, own, np.zeros((n, 6, 0)), frame, (), SmoothNoise(0.0, 1.0))
    none = {"pose": np.zeros(0, int), "ball": np.zeros(0, int), "xyz": np.zeros((0, 3))}
    return observations_of_parts(replace(obs, **none), {obs.cell.stations[obs.station[0]].id: (scene, np.arange(n))})


def checked(check, days):
    """The verdict on days, and the history."""
    poses = tuple(p.number for p in check.poses)
    past = CheckHistory(result="r", plan="p", poses=poses, q=check.obs.q, standing=False, usual_days=UsualChanges())
    noise = None
    for number, day in enumerate(days):
        points, now = seen_as_points(check, day)
        noise = now if noise is None else noise
        past = with_observations(check, past, points, Path(f"/day{number}"))
    past = replace(past, noise=noise)
    return verdict_of(with_noise(check, noise), past), past


def test_a_scene_in_whatever_frame_of_the_day_leaves_nothing_where_nothing_changed(planned):
    points, _ = seen_as_points(planned, day_of(planned, np.random.default_rng(0), noise=0.0))
    past = CheckHistory(result="r", plan="p", poses=(), q=planned.obs.q, standing=False, usual_days=UsualChanges())
    day = with_observations(planned, past, points, Path("/day")).days[0]
    assert max(np.abs(r).max() for r in day.residual.values()) < 1e-5


def test_six_coordinates_of_a_pose_count_with_the_noise_of_its_scan(planned):
    _, noise = seen_as_points(planned, day_of(planned, np.random.default_rng(0)))
    check = with_noise(planned, noise)
    assert check.shown.reshape(-1, 9).sum(axis=1).tolist() == [6] * planned.obs.n_poses
    rows = np.ix_(check.shown, check.shown)
    assert np.linalg.eigvalsh(check.rows.noise[rows])[0] > 1e-9
    one = check.rows.noise[:9, :9] - forward_noise(planned)[:9, :9]
    assert np.linalg.matrix_rank(one, tol=1e-9) == 6


def forward_noise(check):
    """(R, R) by the joints alone."""
    J = check.prediction.by_twists(check.state.chain.joint_twists(check.prediction.frames)) * check.cell.noise.joint
    flat = J.reshape(-1, J.shape[2])
    pose = np.repeat(check.obs.pose, 3)
    return (flat @ flat.T) * (pose[:, None] == pose)


def test_a_slip_of_the_mount_is_found_and_quiet_days_are_left_alone(planned):
    rng = np.random.default_rng(4)
    quiet = [day_of(planned, rng) for _ in range(6)]
    assert not checked(planned, quiet)[0].changed
    found, _ = checked(planned, [*quiet, *(day_of(planned, rng, (0.04, -0.03, 0.0)) for _ in range(4))])
    assert found.changed
    assert found.since == 6
    assert any(s.name == "mount" for s in found.suspects)
    seen = {where for _, where, *_ in checked(planned, quiet)[0].noticed}
    assert "A1" not in seen  # turns all scans alike
    assert "A3" in seen


def test_the_history_keeps_the_noise_of_the_first_day(planned, tmp_path):
    past = checked(planned, [day_of(planned, np.random.default_rng(1))])[1]
    past.write(tmp_path / "check.json")
    kept = read_history(tmp_path / "check.json")
    assert kept.noise == pytest.approx(past.noise, rel=1e-12)


def test_a_plan_without_a_part_is_refused():
    loaded = load(PLANS / "quick.yaml")
    with pytest.raises(ConfigError, match="scans no part; a check on a part needs"):
        with_points(loaded, expand(loaded))

"""A run with a line scanner on the wire: sweeps become hand-eye transform and clock, and no accident gives a profile another pose."""

from pathlib import Path

import numpy as np
import pytest
from mbcacq_fakes.cell.fake_cell import FakeCell

import mbcacq
from mbcacq.acquisition.mover import Mover
from mbcacq.acquisition.sweep_measurement import StreamBroke, take_sweep
from mbcacq.devices import ConnectError, Cycles, SafetyStop
from mbcacq.errors import RecordingError
from mbcacq.geometry import se3
from mbcacq.plan import expand, load
from mbcacq.plan.motion_limits import motion_limits, sweep_limits
from mbcacq.plan.timing import joint_motion
from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.assemble import assemble
from mbcacq.recording.rrd.reader import Recording, intact
from mbcacq.recording.rrd.sweeps import sweep_observations
from mbcacq.workflow import acquire

PLANS = Path(__file__).parents[2] / "plans"
BEGAN_S = 950.25


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    """plans/profiler.yaml with six sweeps at its first station, of a sensor that loses one profile in twenty."""
    text = (PLANS / "profiler.yaml").read_text()
    for name in ("robots", "artefacts"):
        text = text.replace(f"{name}/", f"{PLANS}/{name}/")
    text = text[: text.index("  - name: places")].replace("    stations: [p1]\n", "    stations: [p1]\n    balls: [1, 3]\n")
    fake = f"{{errors: none, scanner: {{frame_rate_hz: 60, clock_began_s: {BEGAN_S}, lost_profiles: 0.05}}}}"
    path = tmp_path_factory.mktemp("profiler") / "profiler.yaml"
    path.write_text(f"{text}\nfake: {fake}\n")
    return load(path)


@pytest.fixture(scope="module")
def run(plan, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "run"
    mbcacq.run(plan, dry_run=True, seed=3, out=out)
    return out


def test_a_run_of_sweeps_recovers_hand_eye_and_clock(plan, run):
    poses = expand(plan)
    true = FakeCell(plan, poses, seed=3).truth()["T_flange_scanner"]
    obs = mbcacq.load_observations(run)
    assert obs.n_poses == 12  # each of six sweeps goes forth and back
    found = mbcacq.calibrate(obs, mbcacq.CalibrationOptions(kinematics=False))
    clock = found.extra["clock"]
    assert abs(clock["delay_s"] - BEGAN_S) < 4 * clock["delay_sigma_s"] < 4e-4
    at = [found.names.index(f"hand_eye.{part}") for part in ("x", "y", "z", "rx", "ry", "rz")]
    off = se3.inverse(true) @ found.state.T_flange_scanner
    error = np.r_[off[:3, 3], se3.rotation_log(off[:3, :3])]
    assert error @ np.linalg.solve(found.covariance[np.ix_(at, at)], error) < 22.5  # chi square of six, at 1e-3
    assert np.linalg.norm(error[:3]) < 0.25 * np.linalg.norm(plan.cell.T_flange_scanner[:3, 3] - true[:3, 3])


def test_the_recording_has_every_profile_that_came_and_counts_the_others(run):
    rows = [row for row in Recording(run / layout.RUN_FILE).rows(layout.SWEEP) if "points" in row]
    assert len(rows) == 6
    for row in rows:
        assert intact(row)
        assert int(row["lost"][0]) == int(np.sum(np.diff(row["counter"]) - 1)) > 0
        # The sensor's clock, 60 profiles a second from the moment of the arm's command on.
        np.testing.assert_allclose(row["time_s"] - row["time_s"][0], (row["counter"] - row["counter"][0]) / 60, atol=5e-6)


def test_a_resumed_run_has_one_clock_though_its_times_overlap_and_another_clock_is_refused(run):
    """The controller of the fake cell goes on at the last pose, so both parts have cycles of the same times at other places."""
    recording = Recording(run / layout.RUN_FILE)
    cell, rows, cycles = recording.text(layout.CELL), recording.observed(), recording.cycles(("time_s", "q"))
    sweeps = [row for row in recording.rows(layout.SWEEP) if "points" in row]
    whole = sweep_observations(assemble(cell, "run", rows), sweeps, [cycles], "run")
    overlap = 5.0
    later = [{**s, "part": np.array([1]), "time_s": s["time_s"] - overlap, "began_s": s["began_s"] - overlap} for s in sweeps[3:]]
    again = Cycles({"time_s": cycles.columns["time_s"] - overlap, "q": cycles.columns["q"]})
    parted = sweep_observations(assemble(cell, "run", rows), [*sweeps[:3], *later], [cycles, again], "run")
    np.testing.assert_allclose(parted.q, whole.q, atol=2e-6)
    np.testing.assert_allclose(parted.xyz, whole.xyz, atol=2e-3)
    np.testing.assert_allclose(parted.time_s[-6:], whole.time_s[-6:] - overlap, atol=1e-3)
    restarted = [{**s, "time_s": s["time_s"] - 40.0} for s in later]
    with pytest.raises(RecordingError, match="began anew between two parts of the run"):
        sweep_observations(assemble(cell, "run", rows), [*sweeps[:3], *restarted], [cycles, again], "run")


def test_a_sweep_moves_all_axes_in_proportion_within_the_limits_at_the_speed_asked(plan):
    pose = expand(plan)[0]
    limits, within = sweep_limits(plan, pose.q, pose.sweep, 60.0), motion_limits(plan)
    assert (limits.speed <= within.speed + 1e-12).all()
    assert (limits.acceleration <= within.acceleration + 1e-9).all()
    motion = joint_motion(pose.q, pose.sweep, limits)
    t = np.linspace(0, motion.duration, 400)
    q = np.array([motion.at_time(s)[0] for s in t])
    share = (q - pose.q) @ (pose.sweep - pose.q) / np.sum((pose.sweep - pose.q) ** 2)
    np.testing.assert_allclose(q, pose.q + share[:, None] * (pose.sweep - pose.q), atol=2e-4)
    place = (plan.cell.robot.chain.flange(q) @ plan.cell.T_flange_scanner)[:, :3, 3]
    speed = np.linalg.norm(np.gradient(place, t, axis=0), axis=1)
    middle = np.abs(share - 0.5) < 0.25
    assert speed[middle] == pytest.approx(60.0, rel=0.05)


class Arm(Mover):
    """Goes where it is asked, or raises."""

    def __init__(self, fault=None):
        self.fault = fault

    def state(self):
        return type("State", (), {"time_s": 1.0})()

    def go(self, target, limits=None):
        if self.fault is not None:
            raise self.fault


class Line:
    """A scanner whose stream breaks off: ``end`` says so."""

    def __init__(self):
        self.calls = []

    def start_profiles(self):
        self.calls.append("start")

    def end_profiles(self):
        self.calls.append("end")
        raise ConnectError("the cable was pulled")


class Nothing:
    def mark(self):
        pass


@pytest.mark.parametrize(
    ("fault", "said"), [(SafetyStop("the brakes closed"), "the brakes closed"), (None, "its profiles broke off: the cable was pulled")]
)
def test_a_sweep_that_breaks_off_says_why_and_the_arm_counts_first(plan, fault, said):
    line = Line()
    with pytest.raises(SafetyStop if fault else StreamBroke, match=said):
        take_sweep(expand(plan)[0], plan, line, None, Arm(fault), Nothing())
    assert line.calls == ["start", "end"]


def test_a_sweep_whose_cable_is_pulled_is_left_out_and_the_others_are_taken(plan, tmp_path):
    poses = expand(plan)[:3]
    run = acquire.plan_acquisition(plan, poses, frozenset(), 0, "the fake cell of seed 0")
    run.folder = acquire.new_run_folder(tmp_path / "run", "profiler")
    with FakeCell(plan, poses, seed=0) as cell:
        cell.faults.scanner("close_in_message", times=1)
        run.execute(cell.overrides())
    rows = [row for row in Recording(run.folder / layout.RUN_FILE).rows(layout.SWEEP) if "points" in row]
    assert [int(row["pose"][0]) for row in rows] == [poses[1].number, poses[2].number]
    assert all(len(row["counter"]) > 60 for row in rows)

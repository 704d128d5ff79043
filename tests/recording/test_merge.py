"""Two logs with clocks of their own: the delay that was put in comes out, and one that the motion does not show is refused."""

import numpy as np
import pytest
from click.testing import CliRunner
from shown_output import not_printed

from mbcacq import load_observations
from mbcacq.cli.data import command
from mbcacq.errors import ConfigError
from mbcacq.files.clock import in_seconds
from mbcacq.geometry import se3
from mbcacq.recording.datasets.cell_yaml import robot_of
from mbcacq.recording.datasets.merge import clock_delay, even_times, merge_logs

POSES = 14
REFLECTOR = np.array([30.0, -20.0, 110.0])
TRACKER = se3.from_abc(np.array([2500.0, 400.0, 300.0]), np.radians([140.0, 3.0, -2.0]))


@pytest.fixture(scope="module")
def motion():
    """Rests of 1.2 s with motions of different length between them: t (s), q (rad) at 100 Hz."""
    rng = np.random.default_rng(3)
    stops = np.radians([0, -80, 90, 0, 50, 0]) + rng.uniform(-0.6, 0.6, (POSES, 6))
    q = [np.repeat(stops[:1], 120, axis=0)]
    for before, after in zip(stops[:-1], stops[1:], strict=True):
        s = np.linspace(0, 1, int(rng.uniform(60, 220)))[:, None]
        q += [before + (3 * s**2 - 2 * s**3) * (after - before), np.repeat(after[None], 120, axis=0)]
    q = np.concatenate(q)
    return np.arange(len(q)) / 100.0, q


def seen_by_tracker(t, q, delay, rate, t_tracker):
    """Places (k, 3) mm of the reflector at times of the tracker's clock."""
    flange = robot_of("ur10e").chain.flange(q)
    places = se3.apply(se3.inverse(TRACKER), se3.apply(flange, REFLECTOR))
    of_arm = (t_tracker - delay) / (1 + rate)
    return np.stack([np.interp(of_arm, t, column) for column in places.T], axis=1)


def write_logs(folder, motion, delay, rate=0.0, bursts=0, clock=str):
    t, q = motion
    rows = [f"{value!r},{','.join(f'{a:.5f}' for a in np.degrees(joints))}" for value, joints in zip(t.tolist(), q, strict=True)]
    (folder / "joints.csv").write_text("Time,J1,J2,J3,J4,J5,J6\n" + "\n".join(rows) + "\n")
    t_tracker = np.arange(delay - 1.3, delay + t[-1] * (1 + rate) + 0.7, 0.0123)
    xyz = seen_by_tracker(t, q, delay, rate, t_tracker) + np.random.default_rng(5).normal(0, 0.01, (len(t_tracker), 3))
    stamps = t_tracker if not bursts else t_tracker[np.minimum((np.arange(len(t_tracker)) // bursts + 1) * bursts, len(t_tracker) - 1)]
    rows = [f"{clock(s)}\t{x:.4f}\t{y:.4f}\t{z:.4f}" for s, (x, y, z) in zip(stamps.tolist(), xyz, strict=True)]
    (folder / "tracker.csv").write_text("Station 1, AT960\nunits: mm\nTime\tX [mm]\tY [mm]\tZ [mm]\n" + "\n".join(rows) + "\n")
    return folder / "joints.csv", folder / "tracker.csv"


def time_of_day(s):
    return f"{int(s // 3600) % 24:02d}:{int(s // 60) % 60:02d}:{s % 60:09.6f}"


@pytest.mark.parametrize(
    ("delay", "rate", "bursts", "clock"),
    [(12.3456, 0.0, 0, repr), (-7.25, 0.0, 0, repr), (86_395.5, 0.0, 0, time_of_day), (3.2, 4e-4, 0, repr), (5.5, 0.0, 8, repr)],
    ids=["late", "early", "time of day over midnight", "fast clock", "bursts"],
)
def test_the_delay_that_was_put_in_comes_out_and_the_cell_with_it(tmp_path, motion, delay, rate, bursts, clock):
    arm, tracker = write_logs(tmp_path, motion, delay, rate, bursts, clock)
    done = CliRunner().invoke(
        command,
        ["merge", str(arm), str(tracker), "--robot", "ur10e", "--eye-to-hand", "--out", str(tmp_path / "set")],
        catch_exceptions=False,
    )
    assert done.exit_code == 0, done.output
    said = float(done.output.split("the instrument's clock is ")[1].split()[0])
    late = 0.0 if not bursts else bursts / 2 * 0.0123  # bursts come with their last row
    assert said == pytest.approx(delay + rate * motion[0][-1] / 2 + late, abs=0.01 + late)
    assert ("bursts of about 8 rows" in done.output) == bool(bursts)
    if bursts:
        printed = done.output.replace(f"{tmp_path}/", "")
        assert not_printed("docs/how-to/data-from-another-lab.md", "tests/recording/test_merge.py", printed) == []
    obs = load_observations(tmp_path / "set")
    assert obs.n_poses == POSES
    truth = se3.apply(se3.inverse(TRACKER), se3.apply(obs.cell.robot.chain.flange(obs.q), REFLECTOR))
    assert np.abs(obs.xyz - truth).max() < 0.02


def as_rtde(t, q):
    yield "timestamp " + " ".join(f"actual_q_{i}" for i in range(6))
    yield from (f"{a} " + " ".join(f"{v:.7f}" for v in row) for a, row in zip(t, q, strict=True))


def as_rtde_poses(t, q):
    T = robot_of("ur10e").chain.flange(q)
    yield "timestamp " + " ".join(f"actual_TCP_pose_{i}" for i in range(6))
    for a, one in zip(t, T, strict=True):
        yield f"{a} " + " ".join(f"{v:.8f}" for v in (*(one[:3, 3] / 1e3), *se3.rotation_log(one[:3, :3])))


def as_trace(t, q):
    yield "Time\t" + "\t".join(f"$AXIS_ACT.A{i}" for i in range(1, 7))
    yield from (f"{a}\t" + "\t".join(f"{v:.6f}" for v in np.degrees(row)) for a, row in zip(t, q, strict=True))


def as_scope(t, q):
    yield from ("Name\tYT Scope Project", "File\tC:\\arm.tcscopex", "Starttime of export\t133774012345670000\t25.11.2026", "")
    yield "\t".join(f"Name\tActPos_A{i}" for i in range(1, 7))
    yield "\t".join("Sample time [ms]\t10" for i in range(1, 7))
    yield ""
    yield from ("\t".join(f"{1e3 * a:.0f}\t{v:.6f}" for v in np.degrees(row)) for a, row in zip(t, q, strict=True))
    yield "EOF"


def us_time(s):
    return f"11/25/2026 {int(s // 3600) % 12 or 12}:{int(s // 60) % 60:02d}:{s % 60:06.3f} PM"


def as_spatialanalyzer(t, xyz):
    yield from ("// SpatialAnalyzer 2023.2.1", "// Working frame: A::WORLD", "// Units: Millimeters")
    yield from (f"A, Robot, p{k}, {x:.4f}, {y:.4f}, {z:.4f}, {us_time(a)}" for k, (a, (x, y, z)) in enumerate(zip(t, xyz, strict=True)))


def as_leica(t, xyz):
    yield from ("Leica AT960-MR  serial 750123", "Units: mm", "", "No  Time [s]  X [mm]  Y [mm]  Z [mm]")
    yield from (f"{k}  {a:.4f}  {x:.4f}  {y:.4f}  {z:.4f}" for k, (a, (x, y, z)) in enumerate(zip(t, xyz, strict=True)))


def as_api(t, xyz):
    yield from ("API Radian Pro", "Length unit: inch", "Time,X,Y,Z")
    yield from (f"{a:.4f},{x / 25.4:.6f},{y / 25.4:.6f},{z / 25.4:.6f}" for a, (x, y, z) in zip(t, xyz, strict=True))


EPOCH_NS = 1_700_000_000_000_000_000  # of the clock of a computer that runs ROS


def as_ros_joints(t, q):
    """As ``rostopic echo -p /joint_states`` of a Universal Robot, whose first three joints come in the order of the alphabet."""
    order, names = [2, 1, 0, 3, 4, 5], ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    yield "%time,field.header.seq," + ",".join(f"field.name{i}" for i in range(6)) + "," + ",".join(f"field.position{i}" for i in range(6))
    said = ",".join(f"{names[i]}_joint" for i in order)
    for k, (a, row) in enumerate(zip(t, q, strict=True)):
        yield f"{EPOCH_NS + round(1e9 * a)},{k},{said}," + ",".join(f"{row[i]:.7f}" for i in order)


def as_ros_point(t, xyz):
    yield "%time,field.header.seq,field.point.x,field.point.y,field.point.z"
    yield from (
        f"{EPOCH_NS + round(1e9 * a)},{k},{x / 1e3:.7f},{y / 1e3:.7f},{z / 1e3:.7f}"
        for k, (a, (x, y, z)) in enumerate(zip(t, xyz, strict=True))
    )


def as_euroc(t, xyz):
    yield "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m]"
    yield from (f"{EPOCH_NS + round(1e9 * a)},{x / 1e3:.7f},{y / 1e3:.7f},{z / 1e3:.7f}" for a, (x, y, z) in zip(t, xyz, strict=True))


WRITTEN = [
    (as_ros_joints, as_ros_point),
    (as_ros_joints, as_euroc),
    (as_rtde, as_spatialanalyzer),
    (as_rtde_poses, as_leica),
    (as_trace, as_api),
    (as_scope, as_leica),
]


@pytest.mark.parametrize(("arm", "instrument"), WRITTEN, ids=lambda write: write.__name__)
def test_logs_as_programs_write_them_become_a_set(tmp_path, motion, arm, instrument):
    t, q = motion
    times = np.arange(2.0, 2.0 + t[-1], 0.02)
    xyz = seen_by_tracker(t, q, 3.5, 0.0, times)
    for name, lines in (("arm.txt", arm(t, q)), ("seen.txt", instrument(times, xyz))):
        (tmp_path / name).write_text("\n".join(lines) + "\n")
    robot = [] if arm is as_rtde_poses else ["--robot", "ur10e"]
    out = tmp_path / "set"
    done = CliRunner().invoke(
        command, ["merge", str(tmp_path / "arm.txt"), str(tmp_path / "seen.txt"), *robot, "--eye-to-hand", "--out", str(out)]
    )
    assert done.exit_code == 0, done.output + str(done.exception)
    obs = load_observations(out)
    truth = se3.apply(se3.inverse(TRACKER), se3.apply(obs.cell.robot.chain.flange(obs.q), REFLECTOR))
    assert obs.n_poses >= POSES - 1
    assert np.abs(obs.xyz - truth).max() < 0.02


def test_what_the_speeds_do_not_show_is_refused(tmp_path, motion):
    t, q = motion
    with pytest.raises(ConfigError, match="agrees with the arm's at no delay"):
        clock_delay(t, q, t, np.random.default_rng(0).normal(size=(len(t), 3)).cumsum(axis=0))
    period = np.sin(2 * np.pi * t / 2.0)[:, None]
    with pytest.raises(ConfigError, match="at a delay of .* alike"):
        clock_delay(t, period, t + 3, period)
    arm, tracker = write_logs(tmp_path, motion, 0.0)
    arm.write_text("\n".join(line for line in arm.read_text().splitlines()[:10]) + "\n")
    with pytest.raises(ConfigError, match="a log of a motion has at least"):
        merge_logs(arm, tracker, {})


def test_times_that_no_motion_has_are_refused_and_clocks_of_computers_are_read_by_their_size(tmp_path, motion):
    t = 1.7e9 + np.arange(5)
    for factor in (1, 1e3, 1e6, 1e9):
        np.testing.assert_allclose(in_seconds(t * factor), t, rtol=1e-15)
    np.testing.assert_array_equal(in_seconds(np.arange(5) * 1e3), np.arange(5) * 1e3)
    arm, tracker = write_logs(tmp_path, motion, 0.0, clock=lambda s: repr(round(1e9 * s)))
    with pytest.raises(ConfigError, match="s from row to row, which cannot be s; name the column with its unit"):
        merge_logs(arm, tracker, {})


def test_exchanged_axes_are_said_with_the_words_of_calibrate(tmp_path, motion):
    arm, tracker = write_logs(tmp_path, motion, 0.0)
    arm.write_text(arm.read_text().replace("J1,J2,J3", "J3,J2,J1"))
    command_line = ["merge", str(arm), str(tracker), "--robot", "ur10e", "--eye-to-hand", "--out", str(tmp_path / "set")]
    said = CliRunner().invoke(command, command_line).exception
    assert "with the columns of A1 and A3 exchanged the residual falls from" in str(said)
    assert not (tmp_path / "set").exists()


def test_even_times_stay_as_they_are():
    t = np.arange(100) * 0.01 + np.random.default_rng(1).normal(0, 5e-4, 100)
    assert even_times(t)[0] is t

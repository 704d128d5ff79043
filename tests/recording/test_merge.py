"""Two logs with clocks of their own: the delay that was put in comes out, and one that the motion does not show is refused."""

import numpy as np
import pytest
from click.testing import CliRunner

from mbcacq import load_observations
from mbcacq.cli.data import command
from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.recording.datasets.loose_table import robot_of
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
    obs = load_observations(tmp_path / "set")
    assert obs.n_poses == POSES
    truth = se3.apply(se3.inverse(TRACKER), se3.apply(obs.cell.robot.chain.flange(obs.q), REFLECTOR))
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


def test_even_times_stay_as_they_are():
    t = np.arange(100) * 0.01 + np.random.default_rng(1).normal(0, 5e-4, 100)
    assert even_times(t)[0] is t

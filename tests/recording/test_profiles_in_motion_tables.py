"""Tables of a controller's cycles and of a profiler's points, each with the time of a clock of its own."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "calibration"))

from hand_eye_data import local_error
from sweep_data import sweeps

import mbcacq
from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.recording.datasets.hand_eye_sets import read_hand_eye_files
from mbcacq.recording.datasets.loose_table import TableOptions
from mbcacq.recording.datasets.observation_set import read_observation_set, write_observation_set

OPTIONS = TableOptions(diameter_mm=30.0, flange="kuka", measurement="artefact_in_scanner")


@pytest.fixture(scope="module")
def made():
    return sweeps(np.random.default_rng(3), jitter=1e-4, lines=7)


def files(folder, made, *, profiles=None, wraps=256, restart=None):
    """The tables; restart: profile from which the sensor's clock begins anew."""
    xyz, abc = se3.to_abc(made.reported)
    rows = [",".join(f"{v:.6f}" for v in (t, *p, *np.degrees(a))) for t, p, a in zip(made.cycle_s, xyz, abc, strict=True)]
    cycles, points = folder / "cycles.csv", folder / "points.csv"
    cycles.write_text("\n".join(["time_s,X,Y,Z,A,B,C", *rows]) + "\n")
    rows = []
    for k in range(len(made.points)) if profiles is None else profiles:
        stamp = made.profile_s[k] - (made.profile_s[restart] if restart and k >= restart else 0.0)
        rows += [f"{made.numbers[k] % wraps},{1e6 * stamp:.1f},{x:.5f},{z:.5f}" for x, z in made.points[k]]
    points.write_text("\n".join(["frame,time_us,x_mm,z_mm", *rows]) + "\n")
    return [cycles, points]


def test_tables_with_clocks_become_a_set_whose_calibration_states_the_clock(made, tmp_path):
    """The counter wraps in it, and a tenth of the profiles is lost."""
    some = np.flatnonzero(np.random.default_rng(0).random(len(made.points)) > 0.1)
    understood = read_hand_eye_files(files(tmp_path, made, profiles=some), OPTIONS)
    assert any(s.startswith("Clock: the controller's is ahead of the sensor's by 17.3") for s in understood.sentences)
    write_observation_set(understood.observations, tmp_path / "set")
    obs = read_observation_set(tmp_path / "set")
    np.testing.assert_allclose(obs.flange_velocity, understood.observations.flange_velocity, rtol=1e-14)
    found = mbcacq.calibrate(obs, mbcacq.CalibrationOptions(kinematics=False))
    clock = found.extra["clock"]
    assert abs(clock["delay_s"] - made.delay_s) < 4 * clock["delay_sigma_s"] < 1e-4
    at = [found.names.index(f"hand_eye.{part}") for part in ("x", "y", "z", "rx", "ry", "rz")]
    off = local_error(found.state.T_flange_scanner, made.T_hand_eye)
    assert off @ np.linalg.solve(found.covariance[np.ix_(at, at)], off) < 22.5  # chi square of six, at 1e-3


def test_a_sensor_that_began_anew_is_refused_at_its_row(made, tmp_path):
    with pytest.raises(ConfigError, match=r"points\.csv:\d+:.*the sensor's time goes back.*recordings of their own"):
        read_hand_eye_files(files(tmp_path, made, restart=200), OPTIONS)


def test_cycles_of_another_recording_are_refused(made, tmp_path):
    cycles, points = files(tmp_path, made)
    text = cycles.read_text().splitlines()
    cycles.write_text("\n".join(text[:200]) + "\n")
    with pytest.raises(ConfigError, match=r"no delay between both clocks|fewer profiles than needed|no reading of its columns"):
        read_hand_eye_files([cycles, points], OPTIONS)

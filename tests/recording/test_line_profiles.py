"""Line profiles of a sphere from a profiler, in the tables that people make of them."""

import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "calibration"))

from hand_eye_data import ARTEFACT_IN_SCANNER, TARGET_IN_BASE, local_error
from profile_data import RADIUS, observed, profiles

import mbcacq
from mbcacq.cli.app import app
from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.recording.datasets.hand_eye_sets import read_hand_eye_files
from mbcacq.recording.datasets.loose_table import TableOptions
from mbcacq.spheres.circles import circle_in, circles_in

ALONE = mbcacq.CalibrationOptions(kinematics=False)
SIX = [f"hand_eye.{part}" for part in ("x", "y", "z", "rx", "ry", "rz")]
KUKA = "X,Y,Z,A,B,C"


def as_kuka(T):
    xyz, abc = se3.to_abc(T)
    return ",".join(f"{v:.6f}" for v in (*xyz, *np.degrees(abc)))


@pytest.fixture(scope="module")
def shown():
    return profiles(np.random.default_rng(5), sweeps=6, steps=8, background=True)


def error_and_stated(obs, shown, measurement):
    found = mbcacq.calibrate(obs, ALONE)
    if measurement == TARGET_IN_BASE:
        return local_error(found.state.T_base_station[0], shown.T_hand_eye), found.fit.station_covariance[0]
    at = [found.names.index(name) for name in SIX]
    return local_error(found.state.T_flange_scanner, shown.T_hand_eye), found.covariance[np.ix_(at, at)]


def test_a_circle_is_found_beside_what_is_no_sphere(shown):
    circles, noise = circles_in(shown.points, RADIUS)
    true = np.sqrt(RADIUS**2 - shown.in_scanner[:, 1] ** 2)
    assert noise == pytest.approx(0.02, rel=0.1)
    off = np.array([[*(c.centre - s[[0, 2]]), c.radius - r] for c, s, r in zip(circles, shown.in_scanner, true, strict=True)])
    nees = np.mean([o @ np.linalg.solve(noise**2 * c.cofactor, o) for o, c in zip(off, circles, strict=True)]) / 3
    assert 0.65 < nees < 1.4  # chi square of 144 degrees of freedom over 144, at 1e-3
    across = np.arange(-20, 20, 0.2)
    assert circle_in(np.column_stack([across, 0.01 * np.sin(7 * across)]), RADIUS) is None


@pytest.mark.parametrize("measurement", [ARTEFACT_IN_SCANNER, TARGET_IN_BASE])
def test_the_stated_uncertainty_holds_of_profiles(measurement):
    """A short form of benchmarks/accuracy.py hand-eye: the chi square of 18 degrees of freedom is below 2.35 times these, at 1e-3."""
    nees = []
    for seed in range(3):
        made = profiles(np.random.default_rng(seed), sweeps=6, steps=6, measurement=measurement)
        off, covariance = error_and_stated(observed(made, measurement), made, measurement)
        nees.append(off @ np.linalg.solve(covariance, off) / 6)
    assert np.mean(nees) < 2.35


def test_one_table_and_two_say_the_same(shown, tmp_path):
    poses = [as_kuka(T) for T in shown.reported]
    one, flange, points = (tmp_path / name for name in ("one.csv", "flange.csv", "points.csv"))
    rows = [(k, x, z) for k, profile in enumerate(shown.points) for x, z in profile]
    one.write_text(f"profile,{KUKA},profile_x_mm,profile_z_mm\n" + "".join(f"{k},{poses[k]},{x:.5f},{z:.5f}\n" for k, x, z in rows))
    flange.write_text(f"profile,{KUKA}\n" + "".join(f"{k},{pose}\n" for k, pose in enumerate(poses)))
    points.write_text("profile,x_mm,z_mm\n" + "".join(f"{k},{x:.5f},{z:.5f}\n" for k, x, z in rows))
    with pytest.raises(ConfigError, match="these are line profiles; say the diameter"):
        mbcacq.load_observations(one)
    options = TableOptions(diameter_mm=2 * RADIUS)
    a, b = (read_hand_eye_files(files, options) for files in ([one], [flange, points]))
    np.testing.assert_array_equal(a.observations.xyz, b.observations.xyz)
    assert "scanner on the flange" in " ".join(a.sentences)
    off, covariance = error_and_stated(a.observations, shown, ARTEFACT_IN_SCANNER)
    assert off @ np.linalg.solve(covariance, off) < 22.5  # chi square of six, at 1e-3


def test_a_profile_without_a_pose_and_a_wrong_diameter_are_refused(shown, tmp_path):
    (tmp_path / "flange.csv").write_text(f"profile,{KUKA}\n" + "".join(f"{k},{as_kuka(T)}\n" for k, T in enumerate(shown.reported[:-1])))
    rows = "".join(f"{k},{x:.5f},{z:.5f}\n" for k, profile in enumerate(shown.points) for x, z in profile)
    (tmp_path / "points.csv").write_text("profile,x_mm,z_mm\n" + rows)
    command = ["data", "new", str(tmp_path / "flange.csv"), str(tmp_path / "points.csv"), "--out", str(tmp_path / "set")]
    done = CliRunner().invoke(app, [*command, "--diameter", "30"])
    assert done.exit_code == 2
    assert "profile 47 has no pose" in done.stderr
    done = CliRunner().invoke(app, [*command, "--diameter", "3"])
    assert done.exit_code == 2
    assert "show a circle of a sphere of 3 mm" in done.stderr


def test_a_point_out_of_all_proportion_leaves_the_circle_where_it_is():
    angle = np.linspace(0.3, 2.8, 60)
    points = np.c_[12.0 * np.cos(angle), 300.0 + 12.0 * np.sin(angle)]
    found = circle_in(np.vstack([points, [1e25, 300.0]]), RADIUS)
    assert found is not None
    assert np.allclose([*found.centre, found.radius], [0.0, 300.0, 12.0], atol=1e-6)


def test_a_diameter_that_the_profiles_contradict_is_refused_with_what_they_say(shown, tmp_path):
    flange, points = tmp_path / "flange.csv", tmp_path / "points.csv"
    flange.write_text(f"profile,{KUKA}\n" + "".join(f"{k},{as_kuka(T)}\n" for k, T in enumerate(shown.reported)))
    rows = "".join(f"{k},{x:.5f},{z:.5f}\n" for k, profile in enumerate(shown.points) for x, z in profile)
    points.write_text("profile,x_mm,z_mm\n" + rows)
    with pytest.raises(ConfigError, match=r"the profiles say a diameter of (29\.9|30\.0)\d ± .* mm \(k = 2\), and --diameter 30.6") as said:
        read_hand_eye_files([flange, points], TableOptions(diameter_mm=30.6))
    value, expanded = (float(text) for text in str(said.value).split("diameter of ")[1].split(" mm")[0].split(" ± "))
    assert abs(value - 2 * RADIUS) < 1.5 * expanded < 0.3
    sentence = read_hand_eye_files([flange, points], TableOptions(diameter_mm=2 * RADIUS)).sentences[-1]
    assert sentence.startswith("the profiles alone say a diameter of ")

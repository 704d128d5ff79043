"""A cell that is known by the poses of its flange has no joints: every command works on it, or says in one sentence why it cannot."""

import csv
import json
import re
import shutil

import numpy as np
import pytest
from click.testing import CliRunner
from defusedxml import ElementTree
from scipy.spatial.transform import Rotation

import mbcacq
from mbcacq.calibration.result_io import noise_of_a_view
from mbcacq.cli.app import app
from mbcacq.errors import MbcacqError
from mbcacq.geometry import se3

X = se3.transform(Rotation.from_euler("ZYX", [30, -5, 170], degrees=True).as_matrix(), np.array([40.0, -20, 110]))
Z = se3.transform(Rotation.from_euler("ZYX", [20, 5, 3], degrees=True).as_matrix(), np.array([700.0, 50, 20]))
HEADER = "X,Y,Z,A,B,C,board_x_mm,board_y_mm,board_z_mm,board_qx,board_qy,board_qz,board_qw"
JOINTS = re.compile(r"\bA[1-6]\b|joint repeatability|theta_\d|\balpha_\d|a joint angle|range of each axis|plan copy", re.IGNORECASE)


def table(path, seed, n=16, X=X, noise=0.05):
    rng = np.random.default_rng(seed)
    down = Rotation.from_euler("x", 180, degrees=True).as_matrix()
    F = se3.transform(down @ se3.rotation_exp(0.35 * rng.normal(size=(n, 3))), np.array([650.0, 0, 450]) + 80 * rng.normal(size=(n, 3)))
    C = se3.inverse(F @ X) @ Z
    C[:, :3, 3] += rng.normal(0, noise, (n, 3))
    turns = Rotation.from_matrix(F[:, :3, :3]).as_euler("ZYX", degrees=True)
    rows = np.column_stack([F[:, :3, 3], turns, C[:, :3, 3], Rotation.from_matrix(C[:, :3, :3]).as_quat()])
    path.write_text(HEADER + "\n" + "\n".join(",".join(f"{v:.7f}" for v in row) for row in rows) + "\n")
    return path


def run(*words):
    """Exit code and everything that was said; what is no sentence for users fails here."""
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exception is None or isinstance(done.exception, SystemExit | MbcacqError), done.exception
    return done.exit_code, done.output + str(done.exception or "")


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """A folder with a table, its observation set, and the result of it."""
    folder = tmp_path_factory.mktemp("flange")
    code, said = run("data", "new", table(folder / "views.csv", 1), "--eye-in-hand", "--out", folder / "set")
    assert code == 0, said
    for name, data in (("run", folder / "set"), ("later", table(folder / "later.csv", 2))):
        (folder / name).mkdir()
        code, said = run("calibrate", data, "--hand-eye-only", "--out", folder / name / "result.json")
        assert code == 0, said
        assert not JOINTS.search(said)
    return folder


WORKS = [
    ("compare", "set"),
    ("compare", "run", "later"),
    ("report", "set"),
    ("export", "run", "--results", "exported"),
    ("export", "set", "--observations", "copied"),
    ("verify", "run", "views.csv"),
    ("verify", "run", "set", "--place", "known"),
    ("calibrate", "set"),
    ("calibrate", "set", "--hand-eye-only", "--held-out", "random"),
    ("apply", "run", "cloud.ply", "--flange=650,0,450,20,5,175", "--orientation", "kuka"),
]
CANNOT = [
    ("diagnose", "set"),
    ("export", "run", "--results", "models", "--only", "mjcf"),
    ("correct", "program.src", "--with", "run"),
    ("apply", "run", "cloud.ply", "--joints=0,-90,90,0,0,0"),
    ("fleet", "run", "--out", "fleet"),
]


@pytest.mark.parametrize("words", [*WORKS, *CANNOT], ids=" ".join)
def test_every_command_works_on_it_or_says_why_not_in_a_sentence(words, cell, tmp_path, monkeypatch):
    for part in ("set", "run", "later"):
        shutil.copytree(cell / part, tmp_path / part)
    table(tmp_path / "views.csv", 7)
    (tmp_path / "program.src").write_text("PTP {A1 0,A2 -90,A3 90,A4 0,A5 0,A6 0}\n")
    (tmp_path / "cloud.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n"
    )
    monkeypatch.chdir(tmp_path)
    code, said = run(*words)
    assert (code == 0) == (words in WORKS), said
    assert not JOINTS.search(said), said
    for page in tmp_path.rglob("*.html"):
        text = re.sub(r"<script.*?</script>|<style.*?</style>|<svg.*?</svg>", "", page.read_text(), flags=re.DOTALL)
        assert not JOINTS.search(re.sub(r"<[^>]+>", " ", text))


def test_nothing_of_joints_is_written_and_the_noise_of_a_pose_is_in_mm_and_rad(cell, tmp_path):
    assert run("export", cell / "run", "--results", tmp_path / "out")[0] == 0
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names.isdisjoint({"kinematics.yaml", "arm.mjcf.xml"})
    assert {"mbcacq.calib", "scanner.launch.py", "static_transform.sh", "tool_data.txt"} <= names
    result = json.loads((cell / "run" / "result.json").read_text())
    assert {p["name"] for p in result["parameters"]} == {f"hand_eye.{c}" for c in ("x", "y", "z", "rx", "ry", "rz")}
    assert (result["held"], result["robot"]["limits"]) == ({}, None)


def test_verify_tries_the_hand_eye_transform_and_not_one_that_is_fitted_there(cell, tmp_path):
    """Further views of the same mount agree; those of a mount that moved by 2 mm miss by that, whatever could be fitted there."""
    slipped = X @ se3.exp(np.array([0, 0, 0, 0, 0.01, 0]))
    same, other = (mbcacq.verify_elsewhere(table(tmp_path / f"{k}.csv", 9, X=T), cell / "run") for k, T in enumerate((X, slipped)))
    assert "the hand-eye transform as it was learnt" in same.text
    assert same.with_effects.rms_mm < 0.12
    assert other.with_effects.rms_mm > 1.0
    assert other.own_geometry.rms_mm < 0.12
    assert other.normalised_error.rms > 5


def test_noise_that_one_target_cannot_split_is_stated_as_its_sum(tmp_path):
    """The camera scatters by 50, 50, 150 um, which is 96 um a coordinate, and the flange is exact."""
    path = table(tmp_path / "a.csv", 3, n=40, noise=(0.05, 0.05, 0.15))
    code, said = run("calibrate", path, "--hand-eye-only", "--out", tmp_path / "result.json")
    assert code == 0
    assert "scanner and flange together; one target at a pose does not tell their shares apart" in said
    place, _ = noise_of_a_view(json.loads((tmp_path / "result.json").read_text()))
    assert place == pytest.approx(0.096, rel=0.25)  # of 40 views, at three standard deviations


def in_abb(text):
    place, q = json.loads(text)
    return se3.transform(Rotation.from_quat([*q[1:], q[0]]).as_matrix(), np.array(place))


def in_universal_robots(text):
    values = np.array([float(v) for v in text.removeprefix("set_tcp(p[").removesuffix("])").split(",")])
    return se3.transform(Rotation.from_rotvec(values[3:]).as_matrix(), 1e3 * values[:3])


def in_words_and_degrees(axes):
    def read(text):
        values = np.array([float(v) for v in re.findall(r"-?\d+\.\d+", text)])
        return se3.transform(Rotation.from_euler(axes, values[3:], degrees=True).as_matrix(), values[:3])

    return read


CONTROLLERS = {
    "KUKA": in_words_and_degrees("ZYX"),
    "FANUC": in_words_and_degrees("xyz"),
    "ABB": in_abb,
    "Universal Robots": in_universal_robots,
}


def test_the_frame_on_the_flange_is_one_in_every_file(cell, tmp_path):
    out = tmp_path / "out"
    assert run("export", cell / "run", "--results", out, "--flange-frame", "flange")[0] == 0
    T = np.array(json.loads((cell / "run" / "result.json").read_text())["T_flange_scanner"])
    rows = list(csv.DictReader((out / "tool_frames.csv").read_text().splitlines()))
    assert {row["controller"] for row in rows} == set(CONTROLLERS)
    for row in rows:
        np.testing.assert_allclose(CONTROLLERS[row["controller"]](row["frame"]), T, atol=2e-4)
    robot = ElementTree.parse(out / "scanner.urdf.xacro").getroot()
    joint = robot.find("joint")
    assert (joint.find("parent").get("link"), joint.find("child").get("link")) == ("flange", "scanner_frame")
    xyz, rpy = ([float(v) for v in joint.find("origin").get(name).split()] for name in ("xyz", "rpy"))
    np.testing.assert_allclose(se3.transform(Rotation.from_euler("xyz", rpy).as_matrix(), 1e3 * np.array(xyz)), T, atol=1e-6)
    kept = json.loads((out / "hand_eye.json").read_text())
    np.testing.assert_allclose(Rotation.from_quat(kept["quaternion_xyzw"]).as_matrix(), T[:3, :3], atol=1e-9)
    assert kept["translation_mm"] == pytest.approx(T[:3, 3].tolist())
    assert any("never verified" in note for note in kept["notes"])
    off = np.linalg.inv(T) @ X  # the truth, as a motion of the scanner in its own frame
    twist = np.r_[off[:3, 3], Rotation.from_matrix(off[:3, :3]).as_rotvec()]
    assert twist @ np.linalg.solve(np.array(kept["covariance"]), twist) < 22.5  # chi square of 6 degrees of freedom, at 1e-3

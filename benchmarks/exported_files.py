"""From the files that other programs export to a result, command by command as the pages have them, with times.

    pip install 'mbcacq[ros]'
    python benchmarks/exported_files.py [DIR]

Writes the files as the programs write them, from cells whose truth is known, runs the commands on them one after the other and prints a
table. Its columns are program, commands, seconds, result and distance from the truth.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

ROOT = Path(__file__).resolve().parents[1]
for folder in ("calibration", "recording"):
    sys.path.insert(0, str(ROOT / "tests" / folder))

from driver_bags import TAG, at_times, stops_and_goes, write_lbr_bag, write_ur_bag  # noqa: E402
from hand_eye_data import recording  # noqa: E402
from rosbags.rosbag2 import StoragePlugin  # noqa: E402

from mbcacq.geometry import se3  # noqa: E402
from mbcacq.geometry.chain import Chain  # noqa: E402
from mbcacq.geometry.flange_poses import flange_transforms  # noqa: E402
from mbcacq.model.cell import ARTEFACT_IN_SCANNER, TARGET_IN_BASE  # noqa: E402
from mbcacq.recording.datasets import quaternions  # noqa: E402
from mbcacq.recording.datasets.cell_yaml import robot_of  # noqa: E402

RATE_HZ, POSES, REST_S, MOVE_S = 100.0, 40, 0.8, 1.0
TRACKER = se3.from_abc(np.array([2800.0, 400.0, 300.0]), np.radians([140.0, 3.0, -2.0]))
REFLECTOR = np.array([30.0, -20.0, 110.0])
HAND_EYE = se3.from_abc(np.array([40.0, -10.0, 90.0]), np.radians([10.0, -4.0, 3.0]))
MARKER = se3.from_abc(np.array([700.0, 100.0, 50.0]), np.radians([30.0, 0.0, 170.0]))
LINK_MM, LINK_RAD = 0.2, 5e-4  # one sigma of what the links of the simulated arms are off by, as delivered
TRACKER_MM, CAMERA_MM, CAMERA_RAD = 0.015, 0.1, 5e-4
MBCACQ = [sys.executable, "-m", "mbcacq"]


@dataclass(frozen=True)
class Walk:
    """commands: words of each, in the folder of the files; far: what the last one's result says of the truth."""

    program: str
    commands: tuple[str, ...]
    far: Callable[[dict], str]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, metavar="DIR", help="of the files [default: a temporary one]")
    folder = parser.parse_args().folder or Path(tempfile.mkdtemp(prefix="exported-"))
    print("| program | commands | s | found |\n|---|---|--:|---|")
    for make in (easy_handeye2, moveit, rtde_and_spatialanalyzer, trace_and_leica, scope_and_api, ur_driver, lbr_driver):
        here = folder / make.__name__
        shutil.rmtree(here, ignore_errors=True)
        here.mkdir(parents=True)
        walk = make(here)
        seconds = []
        for command in walk.commands:
            begun = time.monotonic()
            done = subprocess.run([*MBCACQ, *command.split()], cwd=here, capture_output=True, text=True, check=False)
            seconds.append(time.monotonic() - begun)
            (here / f"{command.split()[0]}.log").write_text(done.stdout + done.stderr, encoding="utf-8")
            if done.returncode:
                print(f"{command}: {done.stderr.strip()}", file=sys.stderr)
                return 1
        result = json.loads((here / "result.json").read_text(encoding="utf-8"))
        said = ", then ".join(f"`mbcacq {command}`" for command in walk.commands)
        print(f"| {walk.program} | {said} | {', '.join(f'{s:.1f}' for s in seconds)} | {walk.far(result)} |", flush=True)
    return 0


def easy_handeye2(folder: Path) -> Walk:
    made = recording(np.random.default_rng(1), "target", measurement=ARTEFACT_IN_SCANNER)
    samples = [{"robot": _ros(a), "tracking": _ros(b)} for a, b in zip(*_pairs(made.observations), strict=True)]
    content = {"parameters": {"name": "cell", "calibration_type": "eye_in_hand", "move_group": "manipulator"}, "samples": samples}
    (folder / "cell.samples").write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return Walk(
        "easy_handeye2: `~/.ros2/easy_handeye2/calibrations/cell.samples`",
        ("data new cell.samples --eye-in-hand --out cell", "calibrate cell --hand-eye-only --out result.json"),
        _hand_eye(made.T_flange_scanner),
    )


def moveit(folder: Path) -> Walk:
    made = recording(np.random.default_rng(2), "target", measurement=TARGET_IN_BASE)
    hand, eye = _pairs(made.observations)
    named = {"effector_wrt_world": hand, "object_wrt_sensor": eye}
    rows = [{key: _metres(T[k]).ravel().tolist() for key, T in named.items()} for k in range(len(hand))]
    (folder / "samples.yaml").write_text(yaml.safe_dump(rows, default_flow_style=None), encoding="utf-8")
    return Walk(
        "MoveIt calibration: the samples that it saved",
        ("data new samples.yaml --out cell", "calibrate cell --hand-eye-only --out result.json"),
        _station(made.T_base_station),
    )


def rtde_and_spatialanalyzer(folder: Path) -> Walk:
    arm = _TrackedArm("ur10e", 3)
    names = [f"actual_q_{i}" for i in range(6)]
    _write(folder / "robot_data.csv", ["timestamp " + " ".join(names)], (_row(f"{1000 + t:.3f}", q, " ", 7) for t, q in arm.log()))
    head = ["// SpatialAnalyzer 2023.2.1", "// Working frame: A::WORLD", "// Units: Millimeters"]
    points = (f"A, Robot, p{k}, {x:.4f}, {y:.4f}, {z:.4f}, {_us(t)}" for k, (t, (x, y, z)) in enumerate(arm.seen()))
    _write(folder / "points.txt", head, points)
    return arm.walk("UR over RTDE (`record.py`), SpatialAnalyzer points", "robot_data.csv", "points.txt")


def trace_and_leica(folder: Path) -> Walk:
    arm = _TrackedArm("kr10_r1100_2", 4)
    head = ["Time\t" + "\t".join(f"$AXIS_ACT.A{i}" for i in range(1, 7))]
    _write(folder / "trace.txt", head, (_row(f"{t:.3f}", np.degrees(q), "\t", 6) for t, q in arm.log()))
    head = ["Leica AT960-MR  serial 750123", "Units: mm", "", "No  Time [s]  X [mm]  Y [mm]  Z [mm]"]
    points = (f"{k}  {t:.4f}  {x:.4f}  {y:.4f}  {z:.4f}" for k, (t, (x, y, z)) in enumerate(arm.seen()))
    _write(folder / "tracker.txt", head, points)
    return arm.walk("KUKA trace (OfflineTraceTool), Leica tracker", "trace.txt", "tracker.txt")


def scope_and_api(folder: Path) -> Walk:
    arm = _TrackedArm("kr6_r900_2", 5)
    head = [
        "Name\tScope Project_AutoSave_10_15_03",
        "File\tD:\\autosave\\Scope Project_AutoSave_10_15_03.csv",
        "Starttime of export\t133774012345670000\tMittwoch, 25. November 2026\t10:15:03.992",
        "Endtime of export\t133774013345670000\tMittwoch, 25. November 2026\t10:16:43.992",
        "",
        "\t".join(f"Name\tActPos_A{i}" for i in range(1, 7)),
        "\t".join("SymbolComment\t" for _ in range(6)),
        "\t".join("Data-Type\tREAL64" for _ in range(6)),
        "\t".join("SampleTime[ms]\t10" for _ in range(6)),
        "\t".join(f"SymbolName\tMAIN.fbArm.q[{i}]" for i in range(1, 7)),
        "\t".join("NetID\t169.254.165.182.1.1" for _ in range(6)),
        "\t".join("Port\t851" for _ in range(6)),
        "",
    ]
    rows = ("\t".join(f"{1e3 * t:.0f}\t{v:.6f}".replace(".", ",") for v in np.degrees(q)) for t, q in arm.log())
    _write(folder / "scope.csv", head, rows)
    head = ["API Radian Pro", "Length unit: inch", "Time,X,Y,Z"]
    _write(folder / "tracker.csv", head, (f"{t:.4f},{x / 25.4:.6f},{y / 25.4:.6f},{z / 25.4:.6f}" for t, (x, y, z) in arm.seen()))
    return arm.walk("TwinCAT Scope, decimal commas; API tracker in inch", "scope.csv", "tracker.csv")


def ur_driver(folder: Path) -> Walk:
    robot = robot_of("ur10e")
    stops = np.radians([0, -80, 90, 0, 50, 0]) + np.random.default_rng(6).uniform(-0.4, 0.4, (24, 6))
    t, q = stops_and_goes(stops, REST_S, MOVE_S)
    times = np.arange(0.05, t[-1], 1 / 15)
    seen = se3.inverse(robot.chain.flange(at_times(t, q, times)) @ HAND_EYE) @ MARKER
    off = np.random.default_rng(7).normal(size=(len(seen), 6))
    seen = se3.transform(seen[:, :3, :3] @ se3.rotation_exp(CAMERA_RAD * off[:, 3:]), seen[:, :3, 3] + CAMERA_MM * off[:, :3])
    write_ur_bag(folder / "rosbag2_2026_11_25", StoragePlugin.MCAP, t, q, times, seen)
    _cell(folder, "artefact_in_scanner", "ur10e", f"target: /tf, target_frame: '{TAG}'")
    return Walk(
        "ROS 2 bag of ur_robot_driver (MCAP), a marker of apriltag_ros on /tf",
        ("calibrate . --hand-eye-only --out result.json",),
        _hand_eye(HAND_EYE),
    )


def lbr_driver(folder: Path) -> Walk:
    arm = _TrackedArm("iiwa14", 8)
    times, xyz = arm.times, arm.places
    write_lbr_bag(folder / "rosbag2_2026_11_25", StoragePlugin.SQLITE3, arm.t, arm.q, times, xyz)
    _cell(folder, "target_in_base", "iiwa14", "joint_states: /lbr/joint_states, target: /tracker/point")
    return Walk("ROS 2 bag of the LBR's FRI driver (SQLite), a tracker's PointStamped", ("calibrate . --out result.json",), arm.far)


class _TrackedArm:
    """An arm whose links are off, moving from rest to rest while a tracker follows a reflector on its flange."""

    def __init__(self, name: str, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.name, self.model = name, robot_of(name)
        n = self.model.n
        errors = rng.normal(size=(n, 5)) * np.array([LINK_RAD, LINK_MM, LINK_MM, LINK_RAD, 0.0])
        self.true: Chain = self.model.chain.with_errors(errors)
        low, high = (np.clip(limit, -np.pi, np.pi) for limit in self.model.limits.T)
        middle, span = 0.5 * (low + high), 0.25 * (high - low)
        self.t, self.q = stops_and_goes(middle + rng.uniform(-span, span, (POSES, n)), REST_S, MOVE_S)
        self.times = np.arange(0.05, self.t[-1], 0.02)
        flange = self.true.flange(at_times(self.t, self.q, self.times))
        self.places = se3.apply(se3.inverse(TRACKER), se3.apply(flange, REFLECTOR)) + rng.normal(0, TRACKER_MM, (len(self.times), 3))
        self.other = middle + rng.uniform(-span, span, (200, n))

    def log(self) -> Iterator[tuple[float, np.ndarray]]:
        yield from zip(self.t.tolist(), self.q, strict=True)

    def seen(self) -> Iterator[tuple[float, np.ndarray]]:
        """In the tracker's own clock, 3.5 s before the arm's."""
        yield from zip((self.times + 3.5).tolist(), self.places, strict=True)

    def far(self, result: dict) -> str:
        """The mean error of distances between places at 200 other postures, with the nominal arm and with the calibrated one."""
        import mbcacq

        arm = mbcacq.CalibratedCell.from_dict(result)
        truth = self._spacings(self.true, REFLECTOR)
        calibrated = arm.state.chain, arm.state.T_flange_scanner[:3, 3]  # errors of the last link are in the reflector's place
        guesses = (self.model.chain, REFLECTOR), calibrated
        before, after = (np.abs(self._spacings(chain, reflector) - truth).mean() for chain, reflector in guesses)
        return f"error of a distance {before:.3f} mm before, {after:.3f} mm after"

    def _spacings(self, chain: Chain, reflector: np.ndarray) -> np.ndarray:
        places = se3.apply(chain.flange(self.other), reflector)
        return np.linalg.norm(places[1:] - places[:-1], axis=1)

    def walk(self, program: str, arm: str, instrument: str) -> Walk:
        merge = f"data merge {arm} {instrument} --robot {self.name} --eye-to-hand --out cell"
        return Walk(program, (merge, "calibrate cell --out result.json"), self.far)


def _pairs(obs) -> tuple[np.ndarray, np.ndarray]:
    """(P, 4, 4) mm of the flange as reported and of the target as seen."""
    seen = se3.transform(obs.rotation, obs.xyz)
    return flange_transforms(obs.q), seen[np.argsort(obs.pose)]


def _metres(T: np.ndarray) -> np.ndarray:
    out = T.copy()
    out[:3, 3] *= 1e-3
    return out


def _ros(T: np.ndarray) -> dict:
    w, x, y, z = quaternions.from_matrix(T[:3, :3]).tolist()
    return {"translation": dict(zip("xyz", (1e-3 * T[:3, 3]).tolist(), strict=True)), "rotation": {"x": x, "y": y, "z": z, "w": w}}


def _hand_eye(truth: np.ndarray) -> Callable[[dict], str]:
    return lambda result: _off(np.array(result["T_flange_scanner"]), truth, "hand-eye")


def _station(truth: np.ndarray) -> Callable[[dict], str]:
    return lambda result: _off(np.array(result["stations"][0]["T_base_station"]), truth, "camera in the base")


def _off(T: np.ndarray, truth: np.ndarray, what: str) -> str:
    turn = np.degrees(np.linalg.norm(se3.rotation_log(T[:3, :3].T @ truth[:3, :3])))
    return f"{what} {np.linalg.norm(T[:3, 3] - truth[:3, 3]):.3f} mm and {turn:.4f} deg from the truth"


def _cell(folder: Path, measurement: str, robot: str, bag: str) -> None:
    lines = [
        "format: mbcacq-observation-set/1",
        f"measurement: {measurement}",
        f"robot: {robot}",
        "artefacts: [{id: target, balls: [{id: 1, centre_mm: [0, 0, 0]}]}]",
        "stations: [{id: place, artefact: target}]",
        f"bag: {{file: rosbag2_2026_11_25, {bag}}}",
    ]
    (folder / "cell.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _write(path: Path, head: list[str], rows: Iterator[str]) -> None:
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")


def _row(time: str, values: np.ndarray, separator: str, decimals: int) -> str:
    return separator.join([time, *(f"{v:.{decimals}f}" for v in values)])


def _us(t: float) -> str:
    return f"11/25/2026 {int(t // 3600) % 12 or 12}:{int(t // 60) % 60:02d}:{t % 60:06.3f} PM"


if __name__ == "__main__":
    sys.exit(main())

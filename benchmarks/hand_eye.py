"""Hand-eye calibration from every kind of input: the error against the bound and the stated uncertainty, beside OpenCV's methods.

Each recording has a hand-eye transform, a target and noise of its own. The bound is the Cramer-Rao bound with the noise that was put in,
from the problem linearised at the solution. NEES: squared error in stated sigmas over six, 1 where the uncertainty is right.

    pip install 'opencv-python-headless>=4.10'             # without it the columns of OpenCV are our own closed forms
    python benchmarks/hand_eye.py [--recordings 100] [--only KIND ..]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "calibration"))

from hand_eye_data import ARTEFACT_IN_SCANNER, BALLS, POSE_SIGMA, TARGET_IN_BASE, TARGET_SIGMA, local_error, recording  # noqa: E402
from profile_data import observed, profiles  # noqa: E402

import mbcacq  # noqa: E402
from mbcacq.calibration.methods import COMPARED_METHODS, artefact_poses  # noqa: E402
from mbcacq.errors import CalibrationError  # noqa: E402
from mbcacq.estimation import parameters  # noqa: E402
from mbcacq.estimation.linearization import Lineariser  # noqa: E402
from mbcacq.estimation.options import Noise  # noqa: E402
from mbcacq.estimation.solver import Weights, system  # noqa: E402
from mbcacq.geometry import se3  # noqa: E402
from mbcacq.model.cell import KnownLength  # noqa: E402
from mbcacq.recording.datasets.uncertified import with_estimated_centres  # noqa: E402

ALONE = mbcacq.CalibrationOptions(kinematics=False)
HAND_EYE = [f"hand_eye.{k}" for k in ("x", "y", "z", "rx", "ry", "rz")]
KINDS = ("certified", "one ball", "target", "sphere", "uncertified", "one length", "profiles")
MOTIONS = {"Tsai-Lenz": "TSAI", "Park-Martin": "PARK", "Horaud-Dornaika": "HORAUD", "Andreff": "ANDREFF", "Daniilidis": "DANIILIDIS"}
ONE_BALL = 2  # of the artefact's, the only one that the scanner sees
LENGTH_SCALE = 1.0004  # the scanner of 'one length' measures everything too long by as much


def made_of(kind: str, seed: int, measurement: str):
    """Observations of a recording, and the true hand-eye transform (or the scanner's place in the base)."""
    rng = np.random.default_rng(seed)
    if kind == "profiles":
        shown = profiles(rng, measurement=measurement)
        return observed(shown, measurement), shown.T_hand_eye
    base = {"one ball": "certified", "one length": "uncertified"}.get(kind, kind)
    made = recording(rng, base, measurement=measurement)
    obs = made.observations
    if kind == "one ball":
        seen = obs.ball == ONE_BALL
        obs = replace(obs, pose=obs.pose[seen], ball=obs.ball[seen], xyz=obs.xyz[seen])
    if kind == "one length":
        known = KnownLength((1, 2), float(np.linalg.norm(BALLS[0] - BALLS[1])), 1e-3)
        cell = replace(obs.cell, artefacts=(replace(obs.cell.artefacts[0], known_length=known),))
        obs = replace(obs, cell=cell, xyz=LENGTH_SCALE * obs.xyz)
    truth = made.T_base_station if measurement == TARGET_IN_BASE else made.T_flange_scanner
    return with_estimated_centres(obs, "simulated"), truth


def bound(found, obs, kind: str, measurement: str) -> np.ndarray:
    """(6, 6) covariance of the hand-eye transform under the noise that was put in."""
    turn = float(np.sqrt(np.mean(TARGET_SIGMA[3:] ** 2)))
    noise = Noise(obs.cell.noise_mm, POSE_SIGMA, turn if kind != "target" else 1e-4)
    layout = parameters.build(obs, ALONE)
    lineariser = Lineariser(obs, layout, ALONE)
    at = system(lineariser, parameters.Estimate(found.state), noise, Weights(np.ones(obs.n_centres), np.ones(obs.n_poses)))
    C = np.linalg.pinv(at.normal.information, hermitian=True, rcond=1e-14)
    if measurement == TARGET_IN_BASE:
        return at.normal.station_covariance(C)[0]
    rows = [layout.names.index(name) for name in HAND_EYE]
    return C[np.ix_(rows, rows)]


def stated(found, measurement: str) -> np.ndarray:
    if measurement == TARGET_IN_BASE:
        return found.station_covariance[0]
    rows = [found.names.index(name) for name in HAND_EYE]
    return found.covariance[np.ix_(rows, rows)]


def ours(fit: Callable, obs, measurement: str) -> np.ndarray:
    """What a closed form of the tool's finds: the hand-eye transform, or the scanner in the base."""
    state = fit(obs)
    return state.T_base_station[0] if measurement == TARGET_IN_BASE else state.T_flange_scanner


def opencv(method: str, obs, measurement: str) -> np.ndarray:
    """What a method of OpenCV's finds of the same poses."""
    cv2: Any = import_module("cv2")
    where, eye = artefact_poses(obs)
    hand = obs.cell.robot.chain.flange(obs.q[where])
    hand = se3.inverse(hand) if measurement == TARGET_IN_BASE else hand
    if method in MOTIONS:
        R, t = cv2.calibrateHandEye(*_parts(hand), *_parts(eye), method=getattr(cv2, f"CALIB_HAND_EYE_{MOTIONS[method]}"))
        return se3.transform(R, t.ravel())
    number = getattr(cv2, f"CALIB_ROBOT_WORLD_HAND_EYE_{method.upper()}")
    R, t = cv2.calibrateRobotWorldHandEye(*_parts(eye), *_parts(se3.inverse(hand)), method=number)[2:]
    return se3.inverse(se3.transform(R, t.ravel()))


def _parts(T: np.ndarray) -> tuple[list, list]:
    return list(T[:, :3, :3]), list(T[:, :3, 3])


def closed_forms() -> dict[str, Callable]:
    """Name -> function of observations and measurement."""
    names = {name.split(" ")[1]: fit for name, fit in COMPARED_METHODS.items() if name.startswith("AX=")}
    if find_spec("cv2"):
        return {name: lambda obs, m, name=name: opencv(name, obs, m) for name in names}
    return {name: lambda obs, m, fit=fit: ours(fit, obs, m) for name, fit in names.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=100)
    parser.add_argument("--only", nargs="+", choices=KINDS, default=list(KINDS))
    options = parser.parse_args()
    closed = closed_forms()
    print("closed forms: " + (f"OpenCV {import_module('cv2').__version__}" if find_spec("cv2") else "our own") + "\n")
    print("| input | scanner | NEES | rms over the bound | " + " | ".join(closed) + " |")
    print("|---" * (4 + len(closed)) + "|")
    for kind in options.only:
        for measurement in (ARTEFACT_IN_SCANNER, TARGET_IN_BASE):
            nees, squares = row(kind, measurement, options.recordings, closed)
            over = [f"{np.sqrt(np.mean(s)):.2f}" if s else "-" for s in squares.values()]
            where = "on the flange" if measurement == ARTEFACT_IN_SCANNER else "fixed"
            print(f"| {kind} | {where} | {nees:.2f} | " + " | ".join(over) + " |", flush=True)


def row(kind: str, measurement: str, count: int, closed: dict[str, Callable]) -> tuple[float, dict[str, list[float]]]:
    """Mean NEES, and the squared errors over the bound of each method, of ``count`` recordings."""
    nees, squares = [], {name: [] for name in ("ours", *closed)}
    for seed in range(count):
        obs, truth = made_of(kind, seed, measurement)
        found = mbcacq.calibrate(obs, ALONE)
        least = bound(found, obs, kind, measurement)
        if obs.scale is not None:  # the scale is a parameter that the known length alone determines
            least = least + stated(found, measurement) - stated(mbcacq.calibrate(replace(obs, scale=None), ALONE), measurement)
        least = np.linalg.inv(least)
        off = local_error(found.state.T_base_station[0] if measurement == TARGET_IN_BASE else found.state.T_flange_scanner, truth)
        nees.append(off @ np.linalg.solve(stated(found, measurement), off) / 6)
        squares["ours"].append(off @ least @ off / 6)
        for name, fit in closed.items():
            try:
                off = local_error(fit(obs, measurement), truth)
                squares[name].append(off @ least @ off / 6)
            except CalibrationError:
                pass
    return float(np.mean(nees)), squares


if __name__ == "__main__":
    main()

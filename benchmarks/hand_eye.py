"""Hand-eye calibration from every kind of input: the error against the bound and the stated uncertainty, beside the closed forms.

Each recording has a hand-eye transform, a target and noise of its own. The bound is the Cramer-Rao bound with the noise that was put in,
from the problem linearised at the solution. NEES: squared error in stated sigmas over six, 1 where the uncertainty is right.

    python benchmarks/hand_eye.py [--recordings 60]
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "calibration"))

from hand_eye_data import ARTEFACT_IN_SCANNER, POSE_SIGMA, TARGET_IN_BASE, TARGET_SIGMA, local_error, recording  # noqa: E402

import mbcacq  # noqa: E402
from mbcacq.calibration.methods import COMPARED_METHODS  # noqa: E402
from mbcacq.errors import CalibrationError  # noqa: E402
from mbcacq.estimation import parameters  # noqa: E402
from mbcacq.estimation.linearization import Lineariser  # noqa: E402
from mbcacq.estimation.options import Noise  # noqa: E402
from mbcacq.estimation.solver import Weights, system  # noqa: E402
from mbcacq.recording.datasets.uncertified import with_estimated_centres  # noqa: E402

ALONE = mbcacq.CalibrationOptions(kinematics=False)
HAND_EYE = [f"hand_eye.{k}" for k in ("x", "y", "z", "rx", "ry", "rz")]


def bound(found, obs, kind: str, measurement: str) -> np.ndarray:
    """(6, 6) covariance of the hand-eye transform under the noise that was put in."""
    turn = float(np.sqrt(np.mean(TARGET_SIGMA[3:] ** 2)))
    point = obs.cell.noise_mm
    noise = Noise(point, POSE_SIGMA, turn if kind != "target" else 1e-4)
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


def error_of(state, made, measurement: str) -> np.ndarray:
    if measurement == TARGET_IN_BASE:
        return local_error(state.T_base_station[0], made.T_base_station)
    return local_error(state.T_flange_scanner, made.T_flange_scanner)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=60)
    count = parser.parse_args().recordings
    closed = {name: fit for name, fit in COMPARED_METHODS.items() if name.startswith("AX=")}
    print("| input | scanner | NEES | rms over the bound | " + " | ".join(name.split(" ")[1] for name in closed) + " |")
    print("|---" * (4 + len(closed)) + "|")
    for kind in ("certified", "target", "sphere", "uncertified"):
        for measurement in (ARTEFACT_IN_SCANNER, TARGET_IN_BASE):
            nees, squares = [], {name: [] for name in ("ours", *closed)}
            for seed in range(count):
                made = recording(np.random.default_rng(seed), kind, measurement=measurement)
                obs = with_estimated_centres(made.observations, "simulated")
                found = mbcacq.calibrate(obs, ALONE)
                least = np.linalg.inv(bound(found, obs, kind, measurement))
                off = error_of(found.state, made, measurement)
                nees.append(off @ np.linalg.solve(stated(found, measurement), off) / 6)
                squares["ours"].append(off @ least @ off / 6)
                for name, fit in closed.items():
                    try:
                        off = error_of(fit(obs), made, measurement)
                        squares[name].append(off @ least @ off / 6)
                    except CalibrationError:
                        pass
            over = [f"{np.sqrt(np.mean(s)):.2f}" if s else "-" for s in squares.values()]
            where = "on the flange" if measurement == ARTEFACT_IN_SCANNER else "fixed"
            print(f"| {kind} | {where} | {np.mean(nees):.2f} | " + " | ".join(over) + " |", flush=True)


if __name__ == "__main__":
    main()

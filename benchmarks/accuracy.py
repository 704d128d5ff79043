"""Errors of a calibration against the Cramer-Rao bound: arms by the paper's plan, and hand-eye alone from every kind of input,
images among them.

    python benchmarks/accuracy.py efficiency [--cells 100] [--readings 3]
    pip install 'opencv-python-headless>=4.10'
    python benchmarks/accuracy.py hand-eye [--recordings 100] [--only KIND ..]
    python benchmarks/accuracy.py images [--recordings 20] [--only BOARD ..]

Each command says more with --help.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import bench
import numpy as np
from bench import option
from cells import measure, scanner_cell
from hand_eye_data import ARTEFACT_IN_SCANNER, BALLS, POSE_SIGMA, TARGET_IN_BASE, TARGET_SIGMA, local_error, recording
from profile_data import observed, profiles

import mbcacq
from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.compare_methods import COMPARED_METHODS, artefact_poses
from mbcacq.errors import CalibrationError
from mbcacq.estimation import parameters
from mbcacq.estimation.forward_model import CellState, predict
from mbcacq.estimation.identifiability import base_columns
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import PAIRS, CalibrationOptions, Noise
from mbcacq.estimation.parameters import Estimate
from mbcacq.estimation.solution import system
from mbcacq.estimation.terms import shared_errors
from mbcacq.geometry import se3
from mbcacq.model.cell import KnownLength
from mbcacq.recording.datasets.uncertified import with_estimated_centres

NOISE, JOINT, CERTIFICATE = (0.005, 0.005, 0.009), 8e-6, 0.001


def bar_bound(obs, truth: CellState):
    """Layout and covariance (g, g) of the free parameters at the truth, by the true noise."""
    layout = parameters.build(obs, CalibrationOptions())
    lineariser = Lineariser(obs, layout, CalibrationOptions())
    at = system(lineariser, Estimate(truth), Noise(np.array(NOISE), np.full(6, JOINT)), lineariser.everything)
    return layout, np.linalg.inv(at.normal.information)


def bars(obs, truth: CellState):
    """Exact readings at both ends of each bar: (qa, xa), (qb, xb), with (K, n) and (K, 3)."""
    exact = predict(obs, truth).xyz
    ends = []
    stations = np.unique(obs.station[obs.phase == "verification"])
    for ball in (8, 9):
        rows = [np.flatnonzero((obs.station[obs.pose] == s) & (obs.ball == ball))[0] for s in stations]
        ends.append((obs.q[obs.pose[rows]], exact[rows]))
    return ends


def length(state: CellState, ends) -> np.ndarray:
    a, b = (se3.apply(state.chain.flange(q) @ state.T_flange_scanner, x) for q, x in ends)
    return np.linalg.norm(a - b, axis=1)


def sigma(layout, covariance, truth: CellState, ends) -> np.ndarray:
    """(K,) mm: bound of the standard deviation of each bar's length."""
    (qa, xa), (qb, xb) = ends
    A, pa = base_columns(layout, truth, qa, xa[:, None])
    B, pb = base_columns(layout, truth, qb, xb[:, None])
    u = (pb - pa) / np.linalg.norm(pb - pa, axis=1, keepdims=True)
    row = np.einsum("pi,pig->pg", u, B - A)
    return np.sqrt(np.einsum("pg,gh,ph->p", row, covariance, row))


def stated_sigma(calibration, ends) -> np.ndarray:
    """(K,) mm: standard deviation of each bar's length that a calibration states."""
    (qa, xa), (qb, xb) = ends
    return calibration.distance_uncertainty(qa, xa, qb, xb)


def efficiency(given: argparse.Namespace) -> None:
    """Monte Carlo: how near the estimator comes to the Cramer-Rao bound, and how far the paper's method is from it.

    Each cell has its own errors of the size of the paper's Table 1, stations and poses (the paper's plan: 6 translations, 6 orientations, 8
    positions by 8 orientations). Each is measured several times with fresh noise. The judgement is made at ten places of a 500 mm bar,
    without noise of the verification itself. The error of the bar's length as the calibrated cell would see it is compared with its
    standard deviation by the inverse of the information at the truth.
    """
    square, limit, ours, inside, count = [], [], [], 0, 0
    theirs: dict[str, list[tuple[float, float]]] = {pairs: [] for pairs in PAIRS}
    for seed in range(given.cells):
        rng = np.random.default_rng(1000 + seed)
        cell = scanner_cell(rng, stations=8, per_station=8, bars=10, preliminary=True, tilt_deg=25)
        used = cell.observations.select(cell.observations.phase != "verification")
        layout, covariance = bar_bound(used, cell.truth)
        ends = bars(cell.observations, cell.truth)
        true_length, best = length(cell.truth, ends), sigma(layout, covariance, cell.truth, ends)
        for reading in range(given.readings):
            balls = cell.truth.balls + rng.normal(size=cell.truth.balls.shape) * CERTIFICATE
            obs = measure(used, replace(cell.truth, balls=balls), rng, NOISE, JOINT)
            found = calibrate(obs)
            error = length(found.state, ends) - true_length
            square.append(error**2)
            limit.append(best**2)
            ours.append(np.abs(error).mean())
            std = np.sqrt(np.diag(found.covariance))[: int(found.layout.blocks[0].free.sum())]
            off = (found.errors - cell.errors).reshape(-1)[found.layout.blocks[0].free]
            inside, count = inside + int(np.sum(np.abs(off) < 3 * std)), count + len(std)
            if reading == 0:
                for pairs, errors in theirs.items():
                    # Judged as it comes out: what the tool would refuse as too uncertain counts too.
                    paper = calibrate(obs, CalibrationOptions(method="paper", pairs=pairs, refuse=False))
                    off = length(paper.state, ends) - true_length
                    errors.append((np.abs(off).mean(), float(np.mean((off / stated_sigma(paper, ends)) ** 2))))
    square, limit = np.array(square), np.array(limit)
    ratio = np.sqrt(square.mean() / limit.mean())
    normalised = np.sqrt((square / limit).mean(axis=1))
    spread = normalised.std() / np.sqrt(len(normalised)) if len(normalised) > 1 else np.nan
    print(f"cells {given.cells}, readings {given.readings} each")
    print(
        f"bar length: rms error {1e3 * np.sqrt(square.mean()):.1f} um, bound {1e3 * np.sqrt(limit.mean()):.1f} um, ratio {ratio:.3f}; "
        f"rms of normalised errors {np.sqrt((square / limit).mean()):.3f} +- {spread:.3f}"
    )
    first = np.array(ours)[:: given.readings]
    floor = 1e3 * np.sqrt(2 / np.pi) * np.sqrt(limit).mean()
    print(f"mean bar error: maximum likelihood {1e3 * first.mean():.1f} um; no unbiased method below {floor:.1f} um")
    for pairs, errors in theirs.items():
        mean, square_ratio = np.array(errors).T
        drawn = np.random.default_rng(1).integers(len(mean), size=(2000, len(mean)))
        low, high = np.quantile(first[drawn].mean(axis=1) / mean[drawn].mean(axis=1), [0.025, 0.975])
        print(
            f"paper, pairs of balls '{pairs}': {1e3 * mean.mean():.1f} um, ours / theirs {first.mean() / mean.mean():.3f} "
            f"(95 % {low:.3f} to {high:.3f}), ours smaller in {np.mean(first < mean):.0%} of the cells; the bound / theirs "
            f"{floor / 1e3 / mean.mean():.3f}; its error over its stated uncertainty: rms {np.sqrt(square_ratio.mean()):.2f}"
        )
    print(f"MD-H parameters within 3 sigma: {inside / count:.2%} of {count}")


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
    at = system(lineariser, parameters.Estimate(found.state), noise, lineariser.everything)
    C = np.linalg.pinv(at.normal.information, hermitian=True, rcond=1e-14)
    if measurement == TARGET_IN_BASE:
        return at.normal.station_covariance(C)[0]
    rows = [layout.names.index(name) for name in HAND_EYE]
    return C[np.ix_(rows, rows)]


def stated(found: CalibratedCell, measurement: str) -> np.ndarray:
    if measurement == TARGET_IN_BASE:
        return found.fit.station_covariance[0]
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


def hand_eye_row(kind: str, measurement: str, count: int, closed: dict[str, Callable]) -> tuple[float, dict[str, list[float]]]:
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


def hand_eye(given: argparse.Namespace) -> None:
    """Hand-eye calibration from every kind of input: the error against the bound and the stated uncertainty, beside OpenCV's methods.

    Each recording has a hand-eye transform, a target and noise of its own. The bound is the Cramer-Rao bound with the noise that was
    put in, from the problem linearised at the solution. NEES: squared error in stated sigmas over six, 1 where the uncertainty is
    right. Without opencv-python-headless the columns of OpenCV are our own closed forms.
    """
    closed = closed_forms()
    print("closed forms: " + (f"OpenCV {import_module('cv2').__version__}" if find_spec("cv2") else "our own") + "\n")
    print("| input | scanner | NEES | rms over the bound | " + " | ".join(closed) + " |")
    print("|---" * (4 + len(closed)) + "|")
    for kind in given.only:
        for measurement in (ARTEFACT_IN_SCANNER, TARGET_IN_BASE):
            nees, squares = hand_eye_row(kind, measurement, given.recordings, closed)
            over = [f"{np.sqrt(np.mean(s)):.2f}" if s else "-" for s in squares.values()]
            where = "on the flange" if measurement == ARTEFACT_IN_SCANNER else "fixed"
            print(f"| {kind} | {where} | {nees:.2f} | " + " | ".join(over) + " |", flush=True)


IMAGES = ("charuco", "chessboard", "aruco", "april", "circles")


def images(given: argparse.Namespace) -> None:
    """Hand-eye and intrinsics at once from rendered images of boards: the error against the bound and the stated uncertainty.

    Each cell has 16 images of 640 x 480 px with blur (0.7 px), noise (3 grey levels) and distortion, and a flange that errs by 20 um and
    100 urad. The bound takes the noise of the flange that was put in, and the noise of the corners that was found.
    """
    made = import_module("rendered_boards")
    print("| board | camera | corner noise px | NEES | rms over the bound |\n|---|---|---|---|---|")
    for kind in given.only:
        for measurement in (ARTEFACT_IN_SCANNER, TARGET_IN_BASE):
            nees, squares, noise = [], [], []
            for seed in range(given.recordings):
                cell = made.make(kind, np.random.default_rng(100 + seed), fixed=measurement == TARGET_IN_BASE)
                obs = _of_images(made, cell, measurement)
                found = mbcacq.calibrate(obs, ALONE)
                at_end = found.state.T_base_station[0] if measurement == TARGET_IN_BASE else found.state.T_flange_scanner
                off = local_error(at_end, cell.Z if measurement == TARGET_IN_BASE else cell.X)
                nees.append(off @ np.linalg.solve(stated(found, measurement), off) / 6)
                squares.append(off @ np.linalg.solve(_image_bound(found, obs, measurement), off) / 6)
                noise.append(obs.images.noise_px)
            where = "on the flange" if measurement == ARTEFACT_IN_SCANNER else "fixed"
            over = np.sqrt(np.mean(squares))
            print(f"| {kind} | {where} | {np.median(noise):.3f} | {np.mean(nees):.2f} | {over:.2f} |", flush=True)


def _of_images(made: Any, cell: Any, measurement: Any) -> Any:
    from mbcacq.recording.datasets.hand_eye_sets import table_of
    from mbcacq.recording.datasets.image_set import read_images
    from mbcacq.recording.datasets.loose_table import TableOptions

    options = TableOptions(flange="vector", measurement=measurement)
    with TemporaryDirectory() as folder:
        shown, flange = made.write(cell, Path(folder) / "cell")
        return read_images([shown], table_of(flange, options), cell.board, None, options).observations


def _image_bound(found: CalibratedCell, obs: Any, measurement: str) -> np.ndarray:
    """(6, 6) covariance under the flange's noise that was put in, the images' own, and what these say of the intrinsics."""
    options = replace(ALONE, terms=shared_errors(obs))
    layout = parameters.build(obs, options)
    lineariser = Lineariser(obs, layout, options)
    noise = Noise(obs.cell.noise_mm, POSE_SIGMA, obs.cell.noise_rad)
    at = system(lineariser, parameters.Estimate(found.state, found.fit.coefficients), noise, lineariser.everything)
    C = np.linalg.pinv(at.normal.information, hermitian=True, rcond=1e-14)
    if measurement == TARGET_IN_BASE:
        return at.normal.station_covariance(C)[0]
    rows = [layout.names.index(name) for name in HAND_EYE]
    return C[np.ix_(rows, rows)]


if __name__ == "__main__":
    bench.main(
        __doc__,
        {
            "efficiency": (efficiency, [option("--cells", type=int, default=100), option("--readings", type=int, default=3)]),
            "images": (
                images,
                [option("--recordings", type=int, default=20), option("--only", nargs="+", choices=IMAGES, default=list(IMAGES))],
            ),
            "hand-eye": (
                hand_eye,
                [option("--recordings", type=int, default=100), option("--only", nargs="+", choices=KINDS, default=list(KINDS))],
            ),
        },
    )

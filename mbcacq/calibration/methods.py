"""Methods of calibration that are compared on the same data, each as a function from observations to a ``CellState``.

Where a method does not apply to a recording, it raises CalibrationError with the reason.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbcacq.calibration.maximum_likelihood import calibrate
from mbcacq.errors import CalibrationError
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.initial_guess import with_all_stations
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.geometry import se3
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.observations import Observations

LEAST_SECOND_ROTATION = np.radians(2.0)  # rms rotation about a second axis; below it AX = XB leaves the translation along the first open
OPENCV = ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")


def nominal(obs: Observations) -> CellState:
    """Nothing identified: nominal arm, hand-eye as first guessed, stations where the points are."""
    nowhere = np.tile(np.eye(4), (len(obs.cell.stations), 1, 1))
    return with_all_stations(obs, CellState(obs.cell.robot.chain, obs.cell.T_flange_scanner, nowhere, obs.cell.ball_centres))


def hand_eye_only(obs: Observations) -> CellState:
    """Nominal arm; hand-eye and stations by maximum likelihood."""
    return calibrate(obs, CalibrationOptions(kinematics=False)).state


def opencv(name: str) -> Callable[[Observations], CellState]:
    """Hand-eye by AX = XB with one of OpenCV's methods, from the artefact's pose in each scan of the station with most poses."""

    def fit(obs: Observations) -> CellState:
        try:
            import cv2  # pyright: ignore[reportMissingImports]  # not a dependency: compared where it is installed
        except ImportError as error:
            raise CalibrationError("OpenCV is not installed; pip install 'opencv-python-headless<5'") from error
        if not hasattr(cv2, "calibrateHandEye"):
            raise CalibrationError(f"OpenCV {cv2.__version__} has no calibrateHandEye in Python; pip install 'opencv-python-headless<5'")
        where, T_scanner_artefact = artefact_poses(obs)
        station = np.bincount(obs.station[where]).argmax()
        here = obs.station[where] == station
        if here.sum() < 3:
            raise CalibrationError("needs three scans of one station that show three balls each, not all on one line")
        T = obs.cell.robot.chain.flange(obs.q[where[here]])
        rotations = se3.rotation_log(np.swapaxes(T[:1, :3, :3], 1, 2) @ T[:, :3, :3])
        if np.linalg.svd(rotations - rotations.mean(axis=0), compute_uv=False)[1] < LEAST_SECOND_ROTATION * np.sqrt(len(T)):
            raise CalibrationError(
                "the orientations at a station turn too little, or about one axis only, which leaves AX = XB "
                "undetermined; turn about two axes by 10 deg and more"
            )
        measured = T_scanner_artefact[here]
        method = getattr(cv2, f"CALIB_HAND_EYE_{name}")
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the exception says it, or what comes back
        try:
            R, t = cv2.calibrateHandEye(
                list(T[:, :3, :3]), list(T[:, :3, 3]), list(measured[:, :3, :3]), list(measured[:, :3, 3]), method=method
            )
        except cv2.error as error:
            raise CalibrationError(f"OpenCV refused the poses: {str(error).splitlines()[-1].strip()}") from error
        X = se3.transform(R, t.ravel())
        if not np.all(np.isfinite(X)):
            raise CalibrationError("gave no finite transform")
        return with_all_stations(obs, replace(nominal(obs), T_flange_scanner=X))

    return fit


def staged_method(pairs: str) -> Callable[[Observations], CellState]:
    """The paper's method, with one of the readings of its distance constraint (``mbcacq.estimation.options.PAIRS``)."""
    return lambda obs: calibrate(obs, CalibrationOptions(method="paper", pairs=pairs)).state


def distances_only(obs: Observations) -> CellState:
    """The distance constraint alone, on the measured centres of all balls, redundant parameters held."""
    from mbcacq.calibration.staged import method
    from mbcacq.calibration.staged.error_propagation import Measured, scanner_noise
    from mbcacq.estimation import parameters

    _scanner_of_several_balls(obs)
    first = hand_eye_only(obs)
    found = method.identify(
        obs,
        first,
        method.constraint(obs, "all"),
        parameters.build(obs, CalibrationOptions(balls=False)),
        CalibrationOptions(),
        Measured(scanner_noise(obs)),
    )
    return with_all_stations(obs, replace(first, chain=found.chain, T_flange_scanner=found.T_flange_scanner))


def maximum_likelihood(obs: Observations) -> CellState:
    """Everything at once by maximum likelihood."""
    return calibrate(obs).state


COMPARED_METHODS: dict[str, Callable[[Observations], CellState]] = {
    "nominal": nominal,
    **{f"AX=XB {name.capitalize()} (OpenCV)": opencv(name) for name in OPENCV},
    "hand-eye only": hand_eye_only,
    "paper": staged_method("one"),
    "paper (four balls)": staged_method("four"),
    "paper (all pairs)": staged_method("all"),
    "distances only": distances_only,
    "maximum likelihood": maximum_likelihood,
}


def artefact_poses(obs: Observations) -> tuple[np.ndarray, np.ndarray]:
    """Poses (K,) whose scan shows three balls or more that are not on one line, and T_scanner_artefact (K, 4, 4) of each."""
    _scanner_of_several_balls(obs)
    from mbcacq.calibration.staged.ball_pairs import FLAT_MM, width
    from mbcacq.estimation.initial_guess import fit_rigid_transforms

    enough = np.flatnonzero(np.bincount(obs.pose, minlength=obs.n_poses) >= 3)
    flat = [width(obs.cell.ball_centres[obs.ball[obs.pose == p]]) < FLAT_MM for p in enough]
    where = enough[~np.array(flat, bool)]
    if not len(where):
        raise CalibrationError("needs three scans of one station that show three balls each, not all on one line")
    rows = np.isin(obs.pose, where)
    group = np.searchsorted(where, obs.pose[rows])
    return where, fit_rigid_transforms(obs.cell.ball_centres[obs.ball[rows]], obs.xyz[rows], group, len(where))


def _scanner_of_several_balls(obs: Observations) -> None:
    if obs.cell.measurement == TARGET_IN_BASE or np.bincount(obs.pose).max(initial=0) < 2 or not np.any(np.abs(obs.xyz) > 1e-9):
        raise CalibrationError("needs a scanner that sees several balls at a pose")

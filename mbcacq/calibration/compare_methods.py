"""Methods of calibration on the same data, judged alike: fit, sphere spacing error, held-out error, time.

A method is a function from observations to a ``CellState``, or to a calibrated cell where it has effects. It raises CalibrationError, with
the reason, if it does not apply to a recording.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, overload

import numpy as np

from mbcacq.calibration import notebook
from mbcacq.calibration.calibrate import calibrate
from mbcacq.calibration.calibrated_cell import CalibratedCell, verify
from mbcacq.calibration.hand_eye_equations import LEAST_TURN, MOTION_METHODS, POSE_METHODS, motions
from mbcacq.calibration.held_out_poses import about_best_station, predicted, rms
from mbcacq.calibration.staged import method
from mbcacq.calibration.staged.pair_distances import FLAT_MM, Measured, scanner_noise, width
from mbcacq.errors import CalibrationError, ContradictionError
from mbcacq.estimation import parameters
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.initial_guess import with_all_stations
from mbcacq.estimation.options import CalibrationOptions, select_phases
from mbcacq.geometry import se3
from mbcacq.model.cell import TARGET_IN_BASE
from mbcacq.model.json_text import AsJson
from mbcacq.model.observations import Observations
from mbcacq.quantities import DEGREE, fixed

FOLDS = 5
SAME_POSTURE = 0.1 * DEGREE


@dataclass(frozen=True, kw_only=True)
class ComparisonRow:
    """One method.

    Attributes
    ----------
    fit_mm : float or None
        3D rms about the best station poses, on the poses fitted.
    bar_mean_mm, bar_max_mm : float or None
        Sphere spacing error at the verification poses.
    held_out_mm : float or None
        3D rms on held-out stations (or, with one or two stations, poses).
    why : str
        Why there is no result.
    why_not_held_out : str
        Why there is no held-out figure, where one was asked for.
    """

    method: str
    fit_mm: float | None = None
    bar_mean_mm: float | None = None
    bar_max_mm: float | None = None
    held_out_mm: float | None = None
    time_s: float | None = None
    why: str = ""
    why_not_held_out: str = ""


@dataclass(frozen=True, repr=False)
class Comparison(AsJson, Sequence[ComparisonRow]):
    """The rows of a comparison, in the order of the methods; a sequence of them.

    Attributes
    ----------
    rows
        One row for each method.
    """

    format: Literal["mbcacq-comparison/1"] = field(default="mbcacq-comparison/1", kw_only=True)
    rows: tuple[ComparisonRow, ...]

    @overload
    def __getitem__(self, index: int) -> ComparisonRow: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[ComparisonRow, ...]: ...

    def __getitem__(self, index: int | slice) -> ComparisonRow | tuple[ComparisonRow, ...]:
        return self.rows[index]

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        judged = [row for row in self.rows if row.held_out_mm is not None]
        best = min(judged, key=lambda row: row.held_out_mm or 0.0) if judged else None
        smallest = f", smallest held-out error {best.held_out_mm:.4f} mm by {best.method}" if best else ""
        return f"Comparison({len(self.rows)} methods{smallest})"

    def _repr_html_(self) -> str:
        rows = [
            (r.method, *(fixed(v, 4) for v in (r.fit_mm, r.bar_mean_mm, r.bar_max_mm, r.held_out_mm)), fixed(r.time_s, 2))
            for r in self.rows
        ]
        header = ("method", "fit rms mm", "bar mean mm", "bar max mm", "held-out rms mm", "time s")
        return notebook.table("Methods of calibration", header, rows)


def compare(
    observations: Observations,
    methods: Iterable[str] | None = None,
    *,
    held_out: bool = True,
    seed: int = 0,
    progress: Callable[[str], None] = lambda text: None,
) -> Comparison:
    """One row a method of ``COMPARED_METHODS``, in that order. Methods that identify links are left out if the data are poses of a flange.
    A method that the data do not determine has the reason in place of figures. progress: gets a sentence a method. Raises CalibrationError
    where no method is determined: no station was seen from two postures."""
    obs = select_phases(observations, CalibrationOptions())
    if all(np.ptp(obs.q[obs.station == s], axis=0).max() < SAME_POSTURE for s in np.unique(obs.station)):
        raise CalibrationError(
            "every station was seen from one posture of the arm only, which leaves all but the shape of the scans "
            "undetermined; nothing can be compared. Take several different poses at each station"
        )
    of_flange = obs.cell.robot.of_flange_poses  # which have no links to identify
    names = [name for name in COMPARED_METHODS if not (of_flange and name in OF_LINKS)] if methods is None else list(methods)
    rows = []
    for number, name in enumerate(names, 1):
        progress(f"{name} (method {number}/{len(names)})")  # no count: some take a hundred times as long as others
        rows.append(_row(name, COMPARED_METHODS[name], obs, observations, held_out, seed))
    return Comparison(tuple(rows))


def _row(
    name: str, fit: Callable[[Observations], CellState | CalibratedCell], obs: Observations, whole: Observations, held_out: bool, seed: int
) -> ComparisonRow:
    begin = time.perf_counter()
    try:
        cell = fit(obs)
    except CalibrationError as error:
        return ComparisonRow(method=name, why=str(error))
    seconds = time.perf_counter() - begin
    d, _ = about_best_station(obs, cell)
    bar = verify(whole, cell)
    mean, largest = (bar.after.mean_mm, bar.after.max_mm) if bar.places else (None, None)
    held_out_mm, why = None, ""
    try:
        held_out_mm = _held_out(fit, obs, seed) if held_out else None
    except CalibrationError as error:
        why = str(error)
    row = ComparisonRow(method=name, fit_mm=rms(d), bar_mean_mm=mean, bar_max_mm=largest, held_out_mm=held_out_mm, time_s=seconds)
    return replace(row, why_not_held_out=why)


def _held_out(fit: Callable[[Observations], CellState | CalibratedCell], obs: Observations, seed: int) -> float:
    """Stations in FOLDS groups, each left out once; with fewer than three stations, random poses. Raises CalibrationError if the rest
    does not determine the method's unknowns."""
    rng = np.random.default_rng(seed)
    stations = np.unique(obs.station)
    by_station = len(stations) >= 3
    unit = obs.station if by_station else np.arange(obs.n_poses)
    distances, freedom = [], 0
    for part in np.array_split(rng.permutation(np.unique(unit)), min(FOLDS, len(np.unique(unit)))):
        test = np.isin(unit, part)
        d, used = predicted(obs.select(test), fit(obs.select(~test)), by_station)
        distances.append(d)
        freedom += used
    found = rms(np.concatenate(distances), freedom)
    if not np.isfinite(found):
        raise CalibrationError("the centres left out are too few to judge anything by; measure more poses")
    return found


LEAST_SECOND_ROTATION = 2.0 * DEGREE  # rms rotation about a second axis; below it AX = XB leaves the translation along the first open
LEAST_POSES = 3
TOO_FEW = "needs three scans of one station that show a target's pose or three balls each, not all on one line"


def nominal(obs: Observations) -> CellState:
    """Nothing identified: nominal arm, hand-eye as first guessed, stations where the points are."""
    if obs.cell.length_scale:
        raise CalibrationError("needs places of the target, and these are distances")
    nowhere = np.tile(np.eye(4), (len(obs.cell.stations), 1, 1))
    return with_all_stations(obs, CellState(obs.cell.robot.chain, obs.cell.T_flange_scanner, nowhere, obs.cell.ball_centres))


def hand_eye_only(obs: Observations) -> CellState | CalibratedCell:
    """Nominal arm; hand-eye and stations by maximum likelihood, of a recording that contradicts its description as well."""
    try:
        cell = calibrate(obs, CalibrationOptions(kinematics=False))
    except ContradictionError:
        cell = calibrate(obs, CalibrationOptions(kinematics=False, refuse=False))
    return _with_instrument(obs, cell)


def _with_instrument(obs: Observations, cell: CalibratedCell) -> CellState | CalibratedCell:
    """The cell where errors of the instrument were estimated with it, else its geometry."""
    return cell if obs.shared is not None or obs.cell.length_scale else cell.state


def by_motions(name: str) -> Callable[[Observations], CellState]:
    """Hand-eye by A X = X B, from the target's pose in each scan and every two poses at one station."""

    def fit(obs: Observations) -> CellState:
        hand, eye, station = _poses_of_both(obs, name)
        A, B = motions(hand, eye, station)
        turning = np.linalg.norm(se3.rotation_log(A[:, :3, :3]), axis=1) > LEAST_TURN
        return _with_hand_eye(obs, _finite(MOTION_METHODS[name](A[turning], B[turning])))

    return fit


def by_poses(name: str) -> Callable[[Observations], CellState]:
    """Hand-eye and the place of the target at once by A X = Z B, from the poses at the station that has most."""

    def fit(obs: Observations) -> CellState:
        hand, eye, station = _poses_of_both(obs, name)
        here = station == np.bincount(station).argmax()
        if here.sum() < LEAST_POSES:
            raise CalibrationError(TOO_FEW)
        _, Z = POSE_METHODS[name](eye[here], se3.inverse(hand[here]))
        return _with_hand_eye(obs, _finite(se3.inverse(Z)))

    return fit


def _poses_of_both(obs: Observations, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The moving hand (K, 4, 4), the target seen by the eye (K, 4, 4) and the station (K,) of each pose. With a fixed scanner the
    hand that moves is the base as the flange sees it. Raises CalibrationError if the poses do not determine the equations ``name``."""
    where, eye = artefact_poses(obs)
    station = obs.station[where]
    if np.bincount(station).max() < LEAST_POSES:
        raise CalibrationError(TOO_FEW)
    hand = obs.cell.robot.chain.flange(obs.q[where])
    if obs.cell.measurement == TARGET_IN_BASE:
        hand = se3.inverse(hand)
    best = max(_second_rotation(hand[station == s]) for s in np.unique(station))
    if best < LEAST_SECOND_ROTATION:
        equations = "AX = XB" if name in MOTION_METHODS else "AX = ZB"
        raise CalibrationError(
            f"the orientations at a station turn too little, or about one axis only, which leaves {equations} "
            "undetermined; turn about two axes by 10° and more"
        )
    return hand, eye, station


def _second_rotation(T: np.ndarray) -> float:
    """rms rotation (rad) of transforms (P, 4, 4) about the second of their axes."""
    rotations = se3.rotation_log(np.swapaxes(T[:1, :3, :3], 1, 2) @ T[:, :3, :3])
    size = np.linalg.svd(rotations - rotations.mean(axis=0), compute_uv=False)
    return float(size[1] / np.sqrt(len(T))) if len(size) > 1 else 0.0


def _with_hand_eye(obs: Observations, X: np.ndarray) -> CellState:
    """The nominal cell with what the equations gave: the scanner on the flange, or where a fixed one stands in the base."""
    first = nominal(obs)
    if obs.cell.measurement != TARGET_IN_BASE:
        return with_all_stations(obs, replace(first, T_flange_scanner=X))
    where, eye = artefact_poses(obs)
    station = np.bincount(obs.station[where]).argmax()
    here = obs.station[where] == station
    target = se3.inverse(obs.cell.robot.chain.flange(obs.q[where[here]])) @ X @ eye[here]
    T = se3.transform(se3.nearest_rotation(target[:, :3, :3].mean(axis=0)), target[:, :3, 3].mean(axis=0))
    return with_all_stations(obs, replace(first, T_flange_scanner=T))


def _finite(X: np.ndarray) -> np.ndarray:
    if not np.all(np.isfinite(X)):
        raise CalibrationError("gave no finite transform")
    return X


def staged_method(pairs: str) -> Callable[[Observations], CellState]:
    """The paper's method, with one of the readings of its distance constraint (``mbcacq.estimation.options.PAIRS``)."""
    return lambda obs: calibrate(obs, CalibrationOptions(method="paper", pairs=pairs)).state


def distances_only(obs: Observations) -> CellState:
    """The distance constraint alone, on the measured centres of all balls, redundant parameters held."""
    _scanner_of_several_balls(obs)
    first = calibrate(obs, CalibrationOptions(kinematics=False)).state
    layout, measured = parameters.build(obs, CalibrationOptions(balls=False)), Measured(scanner_noise(obs))
    found = method.identify(obs, first, method.constraint(obs, "all"), layout, CalibrationOptions(), measured)
    return with_all_stations(obs, replace(first, chain=found.chain, T_flange_scanner=found.T_flange_scanner))


def geometry_alone(obs: Observations) -> CellState | CalibratedCell:
    """All parameters by maximum likelihood; whatever else the arm does counts as noise."""
    return _with_instrument(obs, calibrate(obs, CalibrationOptions(discrepancy=False, random_links=False)))


OF_LINKS = ("paper", "paper (four balls)", "paper (all pairs)", "distances only", "geometry alone", "maximum likelihood")
COMPARED_METHODS: dict[str, Callable[[Observations], CellState | CalibratedCell]] = {
    "nominal": nominal,
    **{f"AX=XB {name}": by_motions(name) for name in MOTION_METHODS},
    **{f"AX=ZB {name}": by_poses(name) for name in POSE_METHODS},
    "hand-eye only": hand_eye_only,
    "paper": staged_method("one"),
    "paper (four balls)": staged_method("four"),
    "paper (all pairs)": staged_method("all"),
    "distances only": distances_only,
    "geometry alone": geometry_alone,
    "maximum likelihood": calibrate,
}


def artefact_poses(obs: Observations) -> tuple[np.ndarray, np.ndarray]:
    """Poses (K,) at which the pose of the target shows, measured itself or by three balls or more that are not on one line, and
    T_scanner_target (K, 4, 4) of each."""
    if obs.rotation is not None:
        where, first = np.unique(obs.pose, return_index=True)
        R = obs.rotation[first]
        place = obs.xyz[first] - np.einsum("mij,mj->mi", R, obs.cell.ball_centres[obs.ball[first]])
        return where, se3.transform(R, place)
    if np.bincount(obs.pose).max(initial=0) < LEAST_POSES or not np.any(np.abs(obs.xyz) > 1e-9):
        raise CalibrationError(TOO_FEW)
    enough = np.flatnonzero(np.bincount(obs.pose, minlength=obs.n_poses) >= LEAST_POSES)
    flat = [width(obs.cell.ball_centres[obs.ball[obs.pose == p]]) < FLAT_MM for p in enough]
    where = enough[~np.array(flat, bool)]
    if not len(where):
        raise CalibrationError(TOO_FEW)
    rows = np.isin(obs.pose, where)
    group = np.searchsorted(where, obs.pose[rows])
    return where, se3.fit_rigid_transforms(obs.cell.ball_centres[obs.ball[rows]], obs.xyz[rows], group, len(where))


def _scanner_of_several_balls(obs: Observations) -> None:
    if obs.cell.robot.of_flange_poses:
        raise CalibrationError("needs joint angles: poses of the flange say nothing of the arm's links")
    if obs.cell.measurement == TARGET_IN_BASE or np.bincount(obs.pose).max(initial=0) < 2 or not np.any(np.abs(obs.xyz) > 1e-9):
        raise CalibrationError("needs a scanner that sees several balls at a pose")

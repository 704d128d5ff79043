"""Whether a recording is described as it was made: simple changes of its description, compared by a quick robust fit.

The fit is of the plain geometry: hand-eye and station poses, the arm as it is described. Every measurement says that a point m that moves
with the flange and a point f of a station coincide: F_i T_e m = T_s f. Here F_i is the pose of the flange, T_e the hand-eye transform and
T_s the station's pose. For a scanner on the flange m is the measured centre and f the certified one; for an instrument that watches a
target m belongs to the target and f is measured. A measured orientation counts as three points more, ``LEVER_MM`` along its axes. With
affine instead of rigid T_e and T_s the equations are linear: that is the start; Gauss-Newton with iteratively reweighted residuals follows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import fminbound

from mbcacq.calibration.description_hypotheses import Misreading, exchanged_balls, hypotheses, other_arms
from mbcacq.errors import CalibrationError, ContradictionError
from mbcacq.geometry import se3
from mbcacq.model.observations import Observations
from mbcacq.quantities import K

LEVER_MM = 200.0  # of the points that stand for an orientation
MOST_POSES = 60  # a convention shows in few
MOST_STATIONS = 6
ROUNDS, SCREENING_ROUNDS = 8, 3  # Gauss-Newton steps; conventions differ by more than its last digit
SETTLED = 1e-6  # relative decrease of the cost at which the fit has converged
KEPT = 0.8  # share of the smallest squared distances that the residual counts, so that single wrong rows do not decide
RIDGE = 1e-9  # of a scaled normal matrix
DECLARED_SIGMA_MM = 5.0  # of a declared station pose without sigma_mm
HUBER = 1.5  # robust standard deviations from which a residual counts less
MOST, OF_ANOTHER_ARM = 0.3, 0.2  # share of the misfit that may remain with a change, and with the links of another arm
SAME = 1.25  # factor within which two changes explain as much and cannot be told apart
LIKELIER = ("sign", "unit", "handedness", "orientation", "order", "offset", "coupling", "frame", "rows", "arm")  # of those that fit alike
SCREENED = 8  # changes of the smallest residual in a few steps that are fitted to the end
MOST_ALTERNATIVES = 3  # named in the text; a mirror of positions is any mirror
SCALES = (0.8, 1.25)  # of measured places, that are tried; units are off by more
SCALE_STEP = 1e-3  # of the difference that says how well a scale is known
LEAST_CENTRES = 8  # fewer fit any scale
SURE = 5.0  # standard uncertainties by which a scale must differ from 1
MOST_WITH_SCALE = 0.7  # share of the misfit that may remain with it
MOST_CHANGES = 2  # mistakes found one after the other


@dataclass(frozen=True)
class DescriptionFinding:
    """A mistake of the description that fits. before_mm, after_mm: residual without and with its change; alternatives: those that fit as
    well, in words."""

    mistake: Misreading
    before_mm: float
    after_mm: float
    alternatives: tuple[str, ...]

    @property
    def what(self) -> str:
        """The change in words, after 'with'."""
        return self.mistake.what

    def __str__(self) -> str:
        text = f"with {self.what} the residual falls from {_number(self.before_mm)} to {_number(self.after_mm)} mm"
        if not self.alternatives:
            return text
        more = len(self.alternatives) - MOST_ALTERNATIVES
        others = " or ".join(self.alternatives[:MOST_ALTERNATIVES])
        return f"{text} (the data cannot tell it from {others}{f' and {more} more' if more > 0 else ''})"


def misdescribed(obs: Observations) -> str:
    """A sentence on what is described otherwise than it was measured: numbers of balls, signs, units, orders and frames, the arm; '' where
    no simple change of the description removes most of the misfit."""
    if exchanged := exchanged_balls(obs):
        return exchanged
    if found := wrong_descriptions(obs):
        return "; ".join(map(str, found))
    arm = _best(obs, other_arms(obs), OF_ANOTHER_ARM)
    return f"{arm}; name that arm" if arm else ""


@contextmanager
def likely_cause_named(observations: Observations) -> Iterator[None]:
    """Where the recording contradicts its cell in the context, the error names the simple change of the description that removes most of
    the misfit, if there is one.
    """
    try:
        yield
    except ContradictionError as error:
        found = misdescribed(observations)
        raise (CalibrationError(f"{error}; {found}") if found else error) from None


def wrong_descriptions(observations: Observations) -> tuple[DescriptionFinding, ...]:
    """Changes of convention that remove most of the misfit, in the order of finding: each was sought with those before it made."""
    found: list[DescriptionFinding] = []
    current = observations
    for _ in range(MOST_CHANGES):
        finding = _best(current, hypotheses(current), MOST)
        if finding is None:
            break
        found.append(finding)
        current = finding.mistake.change(current)
    return tuple(found)


def _best(observations: Observations, among: Iterable[Misreading], most: float) -> DescriptionFinding | None:
    """The change that fits best, where it leaves at most a share ``most`` of the misfit; all are screened, the best are fitted."""
    few = subset(observations)
    before = residual_mm(few)
    screened = sorted(((_score(observations, few, h, True), i, h) for i, h in enumerate(among)), key=lambda s: s[:2])
    scored = sorted(((_score(observations, few, h, False), i, h) for _, i, h in screened[:SCREENED]), key=lambda s: s[:2])
    near = [(score, h) for score, _, h in scored if score < min(most * before, SAME * scored[0][0])]
    if not near:
        return None
    near.sort(key=lambda pair: LIKELIER.index(pair[1].kind))
    score, best = near[0]
    return DescriptionFinding(best, before, score, tuple(h.what for _, h in near[1:]))


def _score(observations: Observations, few: Observations, hypothesis: Misreading, screening: bool) -> float:
    """Infinite where the change leaves nothing that can be fitted. few: the subset that is fitted; rows are moved before it is taken."""
    try:
        changed = subset(hypothesis.change(observations)) if hypothesis.kind == "rows" else hypothesis.change(few)
        return residual_mm(changed, screening)
    except (ValueError, np.linalg.LinAlgError):
        return float("inf")


def _number(value: float) -> str:
    return f"{value:.3g}" if value < 1e4 else f"{value:.0f}"


@dataclass(frozen=True)
class Correspondences:
    """M pairs: flange (M, 4, 4), moving (M, 3), fixed (M, 3), station (M,) 0..S-1. hand_eye: (4, 4) as described; declared: (S, 4, 4)
    poses of the stations where the cell gives one, NaN elsewhere; declared_sigma: (S,) mm."""

    flange: np.ndarray
    moving: np.ndarray
    fixed: np.ndarray
    station: np.ndarray
    hand_eye: np.ndarray
    declared: np.ndarray
    declared_sigma: np.ndarray


def subset(observations: Observations) -> Observations:
    """At most ``MOST_POSES`` poses of the stations that have most of them, evenly chosen."""
    stations, counts = np.unique(observations.station, return_counts=True)
    largest = stations[np.argsort(-counts, kind="stable")[:MOST_STATIONS]]
    measured = np.zeros(observations.n_poses, dtype=bool)
    measured[observations.pose] = True
    usable = np.flatnonzero(np.isin(observations.station, largest) & measured)
    keep = np.zeros(observations.n_poses, dtype=bool)
    keep[usable[np.unique(np.linspace(0, len(usable) - 1, MOST_POSES).astype(int))]] = True
    return observations.select(keep)


def correspondences(o: Observations) -> Correspondences:
    """The pairs of points that these observations say are one."""
    certified = o.cell.ball_centres[o.ball]
    on_flange = o.cell.measurement == "target_in_base"
    moving, fixed = (certified, o.xyz) if on_flange else (o.xyz, certified)
    pose = o.pose
    if o.rotation is not None:
        of_target, measured = (moving, fixed) if on_flange else (fixed, moving)
        of_target = np.concatenate([of_target, *(of_target + axis for axis in LEVER_MM * np.eye(3))])
        measured = np.concatenate([measured, *(measured + LEVER_MM * o.rotation[:, :, k] for k in range(3))])
        moving, fixed = (of_target, measured) if on_flange else (measured, of_target)
        pose = np.tile(pose, 4)
    used = np.unique(o.station)
    poses = [o.cell.stations[s] for s in used]
    declared = np.stack([np.full((4, 4), np.nan) if s.T_base_station is None else s.T_base_station for s in poses])
    sigma = np.array([s.sigma_mm or DECLARED_SIGMA_MM for s in poses])
    flange = o.cell.robot.chain.flange(o.q)[pose]
    return Correspondences(flange, moving, fixed, np.searchsorted(used, o.station[pose]), o.cell.T_flange_scanner, declared, sigma)


def residual_mm(o: Observations, screening: bool = False) -> float:
    """Root mean square distance (mm) of the ``KEPT`` closest pairs after the fit; infinite where it fails. screening: from the linear start
    alone and in few steps, enough where the description is right."""
    c = correspondences(o)
    if screening:
        return _refine(c, _linear_start(c), SCREENING_ROUNDS)
    return min(_refine(c, T_e, ROUNDS) for T_e in (c.hand_eye, _linear_start(c)))


def wrong_length(o: Observations) -> str:
    """A sentence on a stated length that the poses of a flange contradict: the scale of the measured places that fits best, of all three
    coordinates or of the one along the scanner's z; '' where it is 1 within its uncertainty, or most of the misfit stays with it. Links of
    an arm may err as a scale does, so that it is asked of poses of a flange alone; balls of one scan show a scale by their distances."""
    if not o.cell.robot.of_flange_poses or np.bincount(o.pose).max(initial=0) != 1 or o.n_centres < LEAST_CENTRES:
        return ""
    few, found = subset(o), []
    for what, axes in (("the measured places", np.ones(3)), ("the measured places along z of the scanner", np.array([0.0, 0.0, 1.0]))):

        def square(s: float, axes: np.ndarray = axes) -> float:
            return residual_mm(replace(few, xyz=few.xyz * (1 + (s - 1) * axes))) ** 2

        best = float(np.asarray(fminbound(square, *SCALES, xtol=1e-6)).item())
        step = SCALE_STEP
        bend = (square(best + step) - 2 * square(best) + square(best - step)) / step**2
        sigma = np.sqrt(2 * square(best) / max(few.n_centres * bend, 1e-300))
        found.append((square(best), best, sigma, what))
    (after, factor, sigma, what), (second, *_) = sorted(found)
    before = residual_mm(few) ** 2
    if abs(factor - 1) < SURE * sigma or after > (MOST_WITH_SCALE**2) * before:
        return ""
    cause = (
        "the focal length or the depth scale of the camera" if what.endswith("scanner") else "the pitch or size of the target, or a unit"
    )
    either = ", or a scale of all three coordinates" if what.endswith("scanner") and second < SAME**2 * after else ""
    return (
        f"with {what} times {factor:.5f} ± {K * sigma:.1g} (k = 2) the residual falls from {_number(float(np.sqrt(before)))} to "
        f"{_number(float(np.sqrt(after)))} mm{either}: {cause} is wrong by that; correct it, and calibrate with it"
    )


def _linear_start(c: Correspondences) -> np.ndarray:
    """Hand-eye transform (4, 4) from the linear problem with affine maps in place of rotations."""
    S, M = int(c.station.max()) + 1, len(c.moving)
    R, p = c.flange[:, :3, :3], c.flange[:, :3, 3]
    A = np.zeros((M, 3, 12 + 12 * S))
    A[:, :, :9] = (R[:, :, :, None] * c.moving[:, None, None, :]).reshape(M, 3, 9)
    A[:, :, 9:12] = R
    rows = np.arange(M)
    for k in range(3):
        for m in range(3):
            A[rows, k, 12 + 12 * c.station + 3 * k + m] = -c.fixed[:, m]
        A[rows, k, 12 + 12 * c.station + 9 + k] = -1.0
    A = A.reshape(3 * M, -1)
    scale = np.maximum(np.linalg.norm(A, axis=0), 1e-300)
    x = np.linalg.lstsq(A / scale, -p.ravel(), rcond=1e-10)[0] / scale
    if not np.isfinite(x).all() or not np.any(x[:9]):
        return se3.transform(np.eye(3), np.nan_to_num(x[9:12]))
    return se3.transform(se3.nearest_rotation(x[:9].reshape(3, 3)), x[9:12])


def _refine(c: Correspondences, T_e: np.ndarray, rounds: int) -> float:
    """Residual (mm) after damped Gauss-Newton steps from a hand-eye transform; infinite where it diverges."""
    current = (T_e, _stations(c, T_e))
    damping, weights = 1e-3, np.ones(len(c.moving))
    r, J, declared, J_declared = _linearized(c, *current)
    for _ in range(rounds):
        cost = _cost(weights, r, declared)
        if not np.isfinite(cost):
            return float("inf")
        w = np.sqrt(weights)[:, None]
        A = np.concatenate([(w[:, :, None] * J).reshape(3 * len(r), -1), J_declared])
        b = np.concatenate([(w * r).ravel(), declared])
        N, g = A.T @ A, A.T @ b
        scale = 1.0 / np.sqrt(np.maximum(np.diag(N), 1e-300))
        step = -scale * np.linalg.solve(N * np.outer(scale, scale) + (RIDGE + damping) * np.eye(len(N)), scale * g)
        trial = (current[0] @ se3.exp(step[:6]), current[1] @ se3.exp(step[6:].reshape(-1, 6)))
        tried = _linearized(c, *trial)
        drop = cost - _cost(weights, tried[0], tried[2])
        if drop > 0:
            current, (r, J, declared, J_declared), damping = trial, tried, damping * 0.1
        else:
            damping *= 10.0
        if 0 <= drop < SETTLED * cost:
            break
        weights = _huber(np.linalg.norm(r, axis=1))
    return _rms(r, declared)


def _cost(weights: np.ndarray, r: np.ndarray, declared: np.ndarray) -> float:
    return float((weights * (r**2).sum(axis=1)).sum() + (declared**2).sum())


def _rms(r: np.ndarray, declared: np.ndarray) -> float:
    squares = np.sort((r**2).sum(axis=1))
    kept = float(squares[: max(int(KEPT * len(squares)), 1)].mean())
    return float(np.sqrt(kept + ((declared**2).mean() if len(declared) else 0.0)))


def _huber(distance: np.ndarray) -> np.ndarray:
    spread = max(1.4826 * float(np.median(distance)), 1e-12)
    return 1.0 / np.maximum(distance / (HUBER * spread), 1.0)


def _stations(c: Correspondences, T_e: np.ndarray) -> np.ndarray:
    """(S, 4, 4) by closed-form registration of the certified or measured points to where the flange carries their counterparts."""
    carried = np.einsum("mij,mj->mi", c.flange[:, :3, :3], se3.apply(T_e, c.moving)) + c.flange[:, :3, 3]
    out = []
    for s in range(int(c.station.max()) + 1):
        of = c.station == s
        a, b = c.fixed[of], carried[of]
        H = (b - b.mean(axis=0)).T @ (a - a.mean(axis=0))
        R = se3.nearest_rotation(H) if np.any(H) else np.eye(3)
        out.append(se3.transform(R, b.mean(axis=0) - R @ a.mean(axis=0)))
    return np.stack(out)


def _linearized(c: Correspondences, T_e: np.ndarray, T_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Residuals (M, 3) with their Jacobian (M, 3, 6 + 6 S), and those of declared station poses (k,), (k, 6 + 6 S); steps are local
    twists (v, w)."""
    M, S = len(c.moving), len(T_s)
    R = c.flange[:, :3, :3]
    on_flange = se3.apply(T_e, c.moving)
    at = np.einsum("sij,sj->si", T_s[c.station, :3, :3], c.fixed) + T_s[c.station, :3, 3]
    r = np.einsum("mij,mj->mi", R, on_flange) + c.flange[:, :3, 3] - at
    J = np.zeros((M, 3, 6 + 6 * S))
    Re = R @ T_e[:3, :3]
    J[:, :, :3], J[:, :, 3:6] = Re, -Re @ se3.skew(c.moving)
    Rs = T_s[c.station, :3, :3]
    rows = np.arange(M)[:, None]
    columns = 6 + 6 * c.station[:, None] + np.arange(6)
    block = np.concatenate([-Rs, Rs @ se3.skew(c.fixed)], axis=2)
    for k in range(3):
        J[rows, k, columns] = block[:, k]
    declared, J_declared = _declared(c, T_s)
    return r, J, declared, J_declared


def _declared(c: Correspondences, T_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    S = len(T_s)
    known = np.flatnonzero(np.isfinite(c.declared[:, 0, 0]))
    residuals, rows = [], []
    corners = LEVER_MM * np.concatenate([np.zeros((1, 3)), np.eye(3)])
    for s in known:
        r = se3.apply(T_s[s], corners) - se3.apply(c.declared[s], corners)
        J = np.zeros((4, 3, 6 + 6 * S))
        R = T_s[s, :3, :3]
        J[:, :, 6 + 6 * s : 9 + 6 * s], J[:, :, 9 + 6 * s : 12 + 6 * s] = R, -R @ se3.skew(corners)
        residuals.append((r / c.declared_sigma[s]).ravel())
        rows.append((J / c.declared_sigma[s]).reshape(12, -1))
    if not residuals:
        return np.zeros(0), np.zeros((0, 6 + 6 * S))
    return np.concatenate(residuals), np.concatenate(rows)

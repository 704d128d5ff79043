"""Better poses for a plan: chosen by what they tell about the arm, from many that can be taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbcacq.calibration import CalibrationOptions
from mbcacq.calibration.verification import ball_positions, verification_poses
from mbcacq.design.candidate_views import CandidateView, candidates
from mbcacq.design.exchange_algorithm import Criterion, choose
from mbcacq.design.expected_accuracy import ExpectedAccuracy, prospect
from mbcacq.design.plan_rewriter import Chosen, with_views
from mbcacq.design.simulated_observations import planned_noise, planned_observations, planned_state, trial
from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.estimation import identifiability, parameters
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import Noise
from mbcacq.estimation.parameters import ParameterLayout
from mbcacq.estimation.whitening import Whitening
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose, expand

PER_STATION = 220
STATION_SIGMA = np.array([50.0, 50.0, 50.0, 0.2, 0.2, 0.2])


@dataclass(frozen=True)
class Design:
    """text: YAML of the new plan; chosen: its views by station and ball (None: all); tried: how many candidates there were."""

    text: str
    chosen: Chosen
    tried: int


def design(loaded: LoadedPlan, count: int, *, criterion: str = "A", steepest_deg: float = 40.0, seed: int = 0) -> Design:
    """Replace the plan's 'position' poses by ``count`` others at the same stations; the poses of its other phases stay and count.

    criterion: 'A' (mean variance of the certified distances at the verification poses; without such, of points all over the reach) or
    'D' (volume of the parameters' confidence region). Raises ConfigError where the plan has no station to choose poses at, or fewer
    poses can be taken.
    """
    poses = expand(loaded)
    stations = _stations(loaded, poses)
    found = candidates(loaded, stations, PER_STATION, steepest_deg, seed)
    if len(found) < count:
        tried = f"of about {PER_STATION * len(stations)} random views at {len(stations)} stations only {len(found)} can be taken"
        raise ConfigError(f"{loaded.path}: {tried}, fewer than the {count} asked for; move the stations, or ask for fewer")
    kept = [p for p in poses if p.phase in ("translation", "orientation")]
    problem = DesignProblem(loaded, kept, found, poses)
    picked = choose(problem.base, problem.blocks, problem.groups, count, problem.criterion(criterion))
    chosen: Chosen = {}
    for k in sorted(picked, key=lambda k: _order(stations, found[k])):
        chosen.setdefault((found[k].station, found[k].aim), []).append(found[k].view)
    return Design(with_views(loaded, chosen), chosen, len(found))


@dataclass(frozen=True)
class Simulated:
    """Errors (mm) of the certified distances over random true cells: mean of |error| with its standard error, and the largest."""

    mean_mm: float
    standard_error_mm: float
    max_mm: float
    cells: int


def simulated_error(loaded: LoadedPlan, poses: Sequence[PlannedPose], cells: int = 40, seed: int = 1) -> Simulated | None:
    """Each random cell is recorded with noise, calibrated, and verified; None where the plan has no verification
    poses, or does not suffice to calibrate."""
    from mbcacq.calibration import calibrate, verify

    rng, observations, noise = np.random.default_rng(seed), planned_observations(loaded, poses), planned_noise(loaded, poses)
    if verification_poses(observations).n_poses == 0:
        return None
    errors = []
    for _ in range(cells):
        recorded = trial(loaded, observations, noise, rng)
        try:
            found = calibrate(recorded)
        except CalibrationError:
            return None
        errors.append(np.abs(verify(recorded, found).errors("after")))
    means = np.array([e.mean() for e in errors])
    return Simulated(float(means.mean()), float(means.std(ddof=1) / np.sqrt(cells)), float(np.max(errors)), cells)


def compare(plans: Sequence[tuple[LoadedPlan, Sequence[PlannedPose]]], seed: int = 0) -> list[dict[str, Any]]:
    """Expected and simulated accuracy of each plan, in flat dictionaries."""
    out = []
    for loaded, poses in plans:
        try:
            outlook: ExpectedAccuracy | None = prospect(loaded, poses)
        except CalibrationError:
            outlook = None
        found = outlook and simulated_error(loaded, poses, seed=seed)
        indices = dict.fromkeys(("O1", "O2", "O3", "O4", "O5")) if outlook is None else outlook.indices
        out.append(
            {
                "poses": sum(p.phase != "verification" for p in poses),
                "expected_bar_mean_mm": outlook and outlook.bar_mm,
                "expected_bar_mean_of_calibration_mm": outlook and outlook.bar_cell_mm,
                "expected_workspace_mm": outlook and outlook.workspace_mm,
                **indices,
                "simulated_bar_mean_mm": found and found.mean_mm,
                "simulated_standard_error_mm": found and found.standard_error_mm,
                "simulated_bar_max_mm": found and found.max_mm,
            }
        )
    return out


class DesignProblem:
    """The choice as matrices. base: (G, G) information of the kept poses and vague knowledge of all; blocks: (P, 6, G); groups: (P,)."""

    def __init__(self, loaded: LoadedPlan, kept: Sequence[PlannedPose], found: Sequence[CandidateView], poses: Sequence[PlannedPose]):
        self._loaded, self._poses = loaded, poses
        self._state, self._noise = planned_state(loaded), planned_noise(loaded, [*kept, *(c.pose for c in found)])
        everything = planned_observations(loaded, [*kept, *(c.pose for c in found)])
        self._options = CalibrationOptions(balls=False, refuse=False)
        self.layout = parameters.build(everything, self._options)
        used, place = np.unique(everything.station, return_inverse=True)
        rows = pose_information(everything, self._state, self.layout, self._noise)
        g = self.layout.size
        every = np.zeros((len(rows), rows.shape[1], g + 6 * len(used)))
        every[:, :, :g] = rows[:, :, :g]
        columns = g + 6 * place[:, None] + np.arange(6)
        every[np.arange(len(rows))[:, None, None], np.arange(rows.shape[1])[None, :, None], columns[:, None, :]] = rows[:, :, g:]
        vague = np.concatenate([self.layout.gather("scale"), np.tile(STATION_SIGMA, len(used))])
        known = every[: len(kept)].reshape(-1, every.shape[2])
        self.base = np.diag(1 / vague**2) + known.T @ known
        self.blocks = every[len(kept) :]
        self.groups = np.unique([f"{c.station} {c.aim}" for c in found], return_inverse=True)[1]

    def criterion(self, name: str) -> Criterion:
        if name == "D":
            return Criterion(self.layout.size)
        target = np.zeros_like(self.base)
        g = self.layout.size
        rows = distance_rows(self._loaded, self._poses, self.layout)
        if len(rows):
            target[:g, :g] = rows.T @ rows / len(rows)
        else:
            observations = planned_observations(self._loaded, self._poses)
            target[:g, :g] = identifiability.workspace_information(observations, self._state, self.layout)
        return Criterion(g, target)


def pose_information(obs: Observations, state: CellState, layout: ParameterLayout, noise: Noise) -> np.ndarray:
    """(P, 6, g + 6): whitened rows of each pose, in the order of ``obs``, by arm and hand-eye and by its own station, brought down to the
    six that a rigid view can have."""
    lineariser = Lineariser(obs, layout, CalibrationOptions(balls=False, refuse=False))
    linear = lineariser(parameters.Estimate(state))
    weights = np.ones(obs.n_centres), np.ones(obs.n_poses)
    X = Whitening(lineariser.rows, linear.J, noise, *weights)(linear.X)[..., :-1]
    value, vector = np.linalg.eigh(np.swapaxes(X, 1, 2) @ X)
    value, vector = value[:, -6:], vector[:, :, -6:]
    reduced = np.sqrt(np.maximum(value, 0.0))[:, :, None] * np.swapaxes(vector, 1, 2)
    out = np.empty_like(reduced)
    out[lineariser.rows.order] = reduced
    return out


def distance_rows(loaded: LoadedPlan, poses: Sequence[PlannedPose], layout: ParameterLayout) -> np.ndarray:
    """(k, g): change of each certified distance of the verification poses, as measured through the arm, by the parameters."""
    obs = verification_poses(planned_observations(loaded, poses))
    state = planned_state(loaded)
    if obs.n_poses == 0:
        return np.zeros((0, layout.size))
    where, ends = ball_positions(obs, state)
    keys, rows = sorted(where), []
    for i, (station, a) in enumerate(keys):
        for other, b in keys[i + 1 :]:
            if other == station:
                u = where[other, b] - where[station, a]
                qa, xa, _ = ends[station, a]
                qb, xb, _ = ends[other, b]
                A, B = (identifiability.base_columns(layout, state, q, x[:, None])[0][0] for q, x in ((qa, xa), (qb, xb)))
                rows.append(u / np.linalg.norm(u) @ (B - A))
    return np.array(rows).reshape(-1, layout.size)


def _order(stations: list[str], candidate: CandidateView) -> tuple:
    """Station by station, ball by ball, one wrist branch after the other, around the artefact."""
    return stations.index(candidate.station), candidate.aim or 0, candidate.view.wrist, candidate.view.azimuth_deg


def _stations(loaded: LoadedPlan, poses: Sequence[PlannedPose]) -> list[str]:
    """Where the plan's position poses are, or, without such, every station of an artefact with at least three balls."""
    own = list(dict.fromkeys(p.station for p in poses if p.phase == "position"))
    rich = [s.id for s in loaded.cell.stations if len(loaded.cell.artefact(s.artefact).ball_ids) >= 3]
    stations = own or rich
    if not stations:
        raise ConfigError(f"{loaded.path}: there is no station of an artefact with at least three balls to choose poses at; add one")
    return stations

"""Artefacts without a certificate: where their balls are is found from the measurements themselves, as a start that the fit improves.

Scans that show three balls or more are laid over each other (generalised Procrustes analysis); where they show fewer, the balls are brought
into the base by the hand-eye transform that keeps them at rest. Their scale is that of a known length or, without one, of the instrument.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.estimation.initial_guess import hand_eye_from_fixed_points
from mbcacq.estimation.scan_scale import measured_length
from mbcacq.geometry import se3
from mbcacq.model.cell import TARGET_IN_BASE, Artefact
from mbcacq.model.observations import Observations

ROUNDS = 5
FLAT_PRIOR = 100.0  # sigma of a ball's place over the scatter of its measurements: large enough to say nothing
LEAST_PRIOR_MM = 1.0


def with_estimated_centres(obs: Observations, source: str) -> Observations:
    """The observations with places of the balls of each artefact that is not certified, in a frame of the first scan, and to scale.

    Raises ConfigError if the measurements do not show them, or a known length was not measured.
    """
    unknown = [a for a in obs.cell.artefacts if not a.certified]
    if not unknown:
        return obs
    done = {a.id: a for a in obs.cell.artefacts}
    for artefact in unknown:
        artefact = _estimated(obs, artefact, source)
        done[artefact.id] = artefact
    obs = replace(obs, cell=replace(obs.cell, artefacts=tuple(done.values())))
    return _to_scale(obs, source)


def _rows_of(obs: Observations, artefact: Artefact) -> np.ndarray:
    number = [a.id for a in obs.cell.artefacts].index(artefact.id)
    return np.flatnonzero(obs.cell.ball_artefact[obs.ball] == number)


def _estimated(obs: Observations, artefact: Artefact, source: str) -> Artefact:
    rows = _rows_of(obs, artefact)
    first = obs.cell.ball_ids.index(artefact.ball_ids[0])
    ball, xyz = obs.ball[rows] - first, obs.xyz[rows]
    count = len(artefact.ball_ids)
    if count == 1:
        return replace(artefact, centres=np.zeros((1, 3)))
    found = _laid_over(ball, xyz, obs.pose[rows], count)
    if found is None:
        found = _at_rest(obs, rows, ball, count)
    if found is None:
        raise ConfigError(
            f"{source}: artefact '{artefact.id}' is not certified, and the measurements do not show how its balls lie to each other; "
            "show three balls or more at a pose, or all balls at one station"
        )
    centres, scatter = found
    centres = np.nan_to_num(centres)  # a ball that was never seen
    return replace(artefact, centres=centres, uncertainty_mm=max(LEAST_PRIOR_MM, FLAT_PRIOR * scatter))


def _laid_over(ball: np.ndarray, xyz: np.ndarray, pose: np.ndarray, count: int) -> tuple[np.ndarray, float] | None:
    """Places (count, 3) of the balls, NaN where not measured, and their rms scatter, by laying scans over the fullest one; None if a
    ball is in no scan with three others that are placed."""
    poses, group = np.unique(pose, return_inverse=True)
    shown = np.bincount(group)
    centres = np.full((count, 3), np.nan)
    fullest = np.flatnonzero(group == np.argmax(shown))
    if shown.max(initial=0) < 3:
        return None
    centres[ball[fullest]] = xyz[fullest]
    scatter = 0.0
    for _ in range(ROUNDS):
        known = np.isfinite(centres[ball, 0])
        enough = np.bincount(group, known, minlength=len(poses)) >= 3
        use = known & enough[group]
        T = se3.fit_rigid_transforms(xyz[use], centres[ball[use]], group[use], len(poses))
        laid = se3.apply_each(T, group, xyz)
        take = enough[group]
        weight = np.bincount(ball[take], minlength=count)
        total = np.stack([np.bincount(ball[take], laid[take, k], minlength=count) for k in range(3)], axis=1)
        centres = np.where(weight[:, None] > 0, total / np.maximum(weight, 1)[:, None], np.nan)
        scatter = float(np.sqrt(np.mean((laid[take] - centres[ball[take]]) ** 2)))
    measured = np.isin(np.arange(count), ball)
    return None if np.isnan(centres[measured]).any() else (centres, scatter)


def _at_rest(obs: Observations, rows: np.ndarray, ball: np.ndarray, count: int) -> tuple[np.ndarray, float] | None:
    """The same from one station, by the hand-eye transform that keeps the balls at rest in the base; a scanner on the flange only."""
    if obs.cell.measurement == TARGET_IN_BASE:
        return None
    T = obs.cell.robot.chain.flange(obs.q)
    X = hand_eye_from_fixed_points(obs, T, obs.cell.T_flange_scanner)
    if X is None:
        return None
    station = obs.station[obs.pose[rows]]
    here = station == np.bincount(station).argmax()
    base = se3.apply_each(T @ X, obs.pose[rows][here], obs.xyz[rows][here])
    weight = np.bincount(ball[here], minlength=count)
    total = np.stack([np.bincount(ball[here], base[:, k], minlength=count) for k in range(3)], axis=1)
    centres = np.where(weight[:, None] > 0, total / np.maximum(weight, 1)[:, None], np.nan)
    if np.isnan(centres[np.isin(np.arange(count), ball)]).any():
        return None
    scatter = float(np.sqrt(np.mean((base - centres[ball[here]]) ** 2)))
    return centres - np.nanmean(centres, axis=0), scatter


def _to_scale(obs: Observations, source: str) -> Observations:
    """Measurements and balls multiplied so that the known length comes out as known; as they are without one."""
    known = [(a, a.known_length) for a in obs.cell.artefacts if a.known_length is not None]
    if not known:
        return obs
    if len(known) > 1:
        raise ConfigError(f"{source}: two artefacts have a known_length, and the instrument has one scale; leave one of them out")
    artefact, length = known[0]
    if length is None:  # said above
        return obs
    a, b = (artefact.ball_ids.index(ball) for ball in length.balls)
    mean, _ = measured_length(obs, length.balls)
    measured = mean or float(np.linalg.norm(artefact.centres[a] - artefact.centres[b]))
    shown = np.isin([obs.cell.ball_ids.index(ball) for ball in length.balls], obs.ball)
    if not shown.all() or not measured > 0:
        raise ConfigError(f"{source}: known_length is of balls {length.balls[0]} and {length.balls[1]}, which were not both measured")
    scale = length.length_mm / measured
    artefacts = tuple(a if a.certified else replace(a, centres=scale * a.centres) for a in obs.cell.artefacts)
    return replace(obs, xyz=scale * obs.xyz, cell=replace(obs.cell, artefacts=artefacts), scale=scale)

"""What to measure next: poses within the joint limits at which two rival explanations part most, or an unseen effect would show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mbcacq.diagnosis.linearized.linear_problem import LinearProblem
from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate
from mbcacq.estimation import forward_model
from mbcacq.model.observations import Observations

TRIED, GIVEN = 400, 6
IN_TIME = ("joint_step", "mount_shift", "station_drift", "scanner_warmup", "thermal_growth")


def elsewhere(situation: Context, seed: int = 0) -> Context:
    """The same cell at random postures within limits and not below the lowest flange so far, one ball in the middle of the field each."""
    obs, robot = situation.obs, situation.obs.cell.robot
    rng = np.random.default_rng(seed)
    low = np.maximum(robot.limits[:, 0], -np.pi)
    high = np.minimum(robot.limits[:, 1], np.pi)
    q = rng.uniform(low, high, (8 * TRIED, robot.n))
    height = robot.chain.frames(obs.q)[:, -1, 2, 3].min()
    q = q[robot.chain.frames(q)[:, -1, 2, 3] > height][:TRIED]
    count = len(q)
    pose = np.arange(count)
    blank = Observations(
        obs.cell,
        pose,
        np.full(count, obs.station[0]),
        q,
        pose,
        np.full(count, obs.ball[0]),
        np.zeros((count, 3)),
        direction=None if obs.direction is None else rng.choice([-1.0, 1.0], q.shape),
    )
    if obs.rotation is not None:
        blank = replace(blank, rotation=np.tile(np.eye(3), (count, 1, 1)))
    return Context(blank, situation.state, forward_model.predict(blank, situation.state))


def displacement(there: Context, linear: LinearProblem, key: str, hyper: float | None, coefficients: np.ndarray) -> np.ndarray | None:
    """(P, 3) mm: what a candidate of the recording would do at other postures; None where it cannot be built there."""
    candidate = next((c for c in catalogue.candidates(there)[0] if c.key == key), None)
    if candidate is None:
        return None
    return linear.columns(candidate.build(hyper))[:, :3] @ coefficients


def separate(
    situation: Context, pairs: Sequence[tuple[tuple[Candidate, float | None, np.ndarray], tuple[Candidate, float | None, np.ndarray]]]
) -> list[dict[str, Any]]:
    """One piece of advice for each pair of rivals, each with hyper-parameter and coefficients."""
    if not pairs:
        return []
    there = elsewhere(situation)
    linear = LinearProblem.of(there.obs, there.state)
    out = []
    for (a, ha, ca), (b, hb, cb) in pairs:
        if a.name in IN_TIME or b.name in IN_TIME:
            out.append(
                {
                    "reason": f"{a.name} and {b.name} differ in time: measure the first station again, at the same postures, at the end",
                    "poses_deg": first_poses(situation),
                }
            )
            continue
        moved = [displacement(there, linear, c.key, h, v) for c, h, v in ((a, ha, ca), (b, hb, cb))]
        if moved[0] is None or moved[1] is None:
            continue
        chosen = spread(moved[0] - moved[1])
        apart = float(np.linalg.norm((moved[0] - moved[1])[chosen], axis=1).mean())
        out.append(
            {
                "reason": f"{a.name} at {'+'.join(a.where)} and {b.name} at {'+'.join(b.where)} differ by {apart:.3f} mm "
                "at these poses, on one station",
                "poses_deg": np.degrees(there.obs.q[chosen]).round(3).tolist(),
            }
        )
    return out


def show(situation: Context, candidate: Candidate) -> dict[str, Any]:
    """Poses at which an effect of typical size, invisible in the recording, would show."""
    there = elsewhere(situation)
    moved = displacement(there, LinearProblem.of(there.obs, there.state), candidate.key, None, candidate.typical)
    chosen = spread(moved) if moved is not None else np.arange(0)
    return {
        "reason": f"{candidate.name} at {'+'.join(candidate.where)} is absorbed by the free geometry: measure these poses on one "
        "station, or a long bar end by end",
        "poses_deg": np.degrees(there.obs.q[chosen]).round(3).tolist(),
    }


def spread(moved: np.ndarray) -> np.ndarray:
    """Indices of poses whose displacements (P, 3) are large and point to different sides: greedy, farthest from those chosen."""
    chosen = [int(np.argmax(np.linalg.norm(moved - moved.mean(axis=0), axis=1)))]
    while len(chosen) < min(GIVEN, len(moved)):
        nearest = np.min(np.linalg.norm(moved[:, None] - moved[None, chosen], axis=2), axis=1)
        chosen.append(int(np.argmax(nearest)))
    return np.array(chosen)


def first_poses(situation: Context) -> list[list[float]]:
    first = situation.obs.station[np.argmin(situation.order)]
    return np.degrees(situation.obs.q[situation.obs.station == first][:GIVEN]).round(3).tolist()

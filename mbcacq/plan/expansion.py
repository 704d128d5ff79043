"""A plan as the list of poses to take, with joint angles."""

from __future__ import annotations

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.plan.expansion_targets import Target, targets
from mbcacq.plan.ik_selection import DEFAULT_SPEED, cheapest
from mbcacq.plan.kinematics import InverseKinematics
from mbcacq.plan.planned import LoadedPlan, PlannedPose


def expand(loaded: LoadedPlan) -> list[PlannedPose]:
    """Every pose of the plan in running order. Raises ConfigError naming step and line of the first pose that cannot be reached."""
    poses, unreachable = expand_reachable(loaded)
    if unreachable:
        raise ConfigError(unreachable_sentence(loaded, unreachable[0]))
    return poses


def expand_reachable(loaded: LoadedPlan) -> tuple[list[PlannedPose], list[Target]]:
    """The poses that can be reached, and the targets that cannot."""
    wanted = targets(loaded)
    options = _options(loaded, wanted)
    reachable = [(t, q) for t, q in zip(wanted, options, strict=True) if len(q)]
    unreachable = [t for t, q in zip(wanted, options, strict=True) if not len(q)]
    robot = loaded.cell.robot
    stations = [t.station for t, _ in reachable]
    restart = [i > 0 and stations[i] != stations[i - 1] for i in range(len(stations))]
    speed = np.full(robot.n, DEFAULT_SPEED) if robot.speed is None else robot.speed
    home = np.radians(loaded.plan.robot.home_deg)
    chosen = cheapest(home, [q for _, q in reachable], restart, robot, speed)
    return [_planned(loaded, i, t, q[k]) for i, ((t, q), k) in enumerate(zip(reachable, chosen, strict=True))], unreachable


def unreachable_sentence(loaded: LoadedPlan, target: Target) -> str:
    """'file:line: ...' about a target that no joint position reaches."""
    step = loaded.plan.steps[target.step]
    wrist = "" if target.wrist == "any" else f" with A5 {target.wrist}"
    return (
        f"{loaded.path}:{loaded.lines[target.where]}: step '{step.name}' at station '{target.station}': no joint position within the "
        f"limits of {loaded.cell.robot.name} reaches this pose{wrist}; move the station or change the view"
    )


def _options(loaded: LoadedPlan, wanted: list[Target]) -> list[np.ndarray]:
    options = [np.empty((0, 0)) if t.q is None else t.q[None] for t in wanted]
    free = [i for i, t in enumerate(wanted) if t.q is None]
    if free:
        solver = InverseKinematics.of(loaded.cell.robot)
        for i, q in zip(free, solver.solutions(np.stack([wanted[i].T_base_flange for i in free])), strict=True):
            sense = {"any": 0, "positive": 1, "negative": -1}[wanted[i].wrist]
            options[i] = q[sense * q[:, 4] >= 0]
    return options


def _planned(loaded: LoadedPlan, number: int, target: Target, q: np.ndarray) -> PlannedPose:
    step = loaded.plan.steps[target.step]
    station = next(s for s in loaded.cell.stations if s.id == target.station)
    return PlannedPose(
        number=number,
        step=target.step,
        step_name=step.name,
        phase=step.phase,
        station=target.station,
        artefact=station.artefact,
        q=q,
        balls=target.balls,
        exposures=step.exposures or loaded.plan.exposures,
        line=loaded.lines[target.where],
    )

"""The twin: what a calibrated cell would record if it executed a plan, and nothing else were at work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from mbcacq.calibration.result_io import state_from_dict
from mbcacq.errors import ConfigError
from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import Noise
from mbcacq.model.observations import Observations
from mbcacq.model.trajectory import Trajectory
from mbcacq.plan import LoadedPlan, PlannedPose


def simulate(
    loaded: LoadedPlan, poses: Sequence[PlannedPose], result: dict[str, Any] | None = None, noise: bool = False, seed: int = 0
) -> Observations:
    """Every planned pose with its expected balls, where the model puts them (mm, scanner frame); times and senses of motion as planned.

    result: the content of a result.json; default the nominal cell. Stations that the result does not know stand where the plan puts
    them. noise: add the scatter of centres and the repeatability of the joints (the result's, else the plan's and the data sheet's).
    As in a run, the cell that is written says nothing of where stations stand; it states the scatter of a centre, for a solver that
    has none to estimate it from. Raises ConfigError where result and plan do not match.
    """
    from mbcacq.design.simulated_observations import planned_observations
    from mbcacq.plan import path
    from mbcacq.plan.summary import summary
    from mbcacq.workflow.run import solver_cell

    starts = {p["pose"]: p["start_s"] for p in summary(loaded, poses)["poses"]}
    blank = planned_observations(loaded, poses, path(loaded, poses), [starts[p.number] for p in poses])
    state = cell_state(loaded, result)
    rng = np.random.default_rng(seed)
    scatter = _noise(loaded, poses, result) if noise else None
    stood = blank if scatter is None else replace(blank, q=blank.q + scatter.joint * rng.standard_normal(blank.q.shape))
    xyz = forward_model.predict(stood, state).xyz
    if scatter is not None:
        xyz = xyz + scatter.point * rng.standard_normal(xyz.shape)
    return replace(blank, cell=replace(solver_cell(loaded), noise_mm=_noise(loaded, poses, result).point), xyz=xyz)


def cell_state(loaded: LoadedPlan, result: dict[str, Any] | None) -> CellState:
    """The calibrated cell with every station of the plan at a place; nominal where there is no result. Raises ConfigError."""
    from mbcacq.design.simulated_observations import planned_state

    planned = planned_state(loaded)
    if result is None:
        return planned
    state = state_from_dict(result, loaded.cell)
    name = result["robot"].get("name")
    if name != loaded.cell.robot.name:
        raise ConfigError(f"the result is of a '{name}', the plan uses a '{loaded.cell.robot.name}'; give the matching result")
    known = {str(s["id"]): s.get("artefact") for s in result["stations"]}
    same = np.array([known.get(s.id) == s.artefact for s in loaded.cell.stations])
    return replace(state, T_base_station=np.where(same[:, None, None], state.T_base_station, planned.T_base_station))


def _noise(loaded: LoadedPlan, poses: Sequence[PlannedPose], result: dict[str, Any] | None) -> Noise:
    from mbcacq.design.simulated_observations import planned_noise

    stated = planned_noise(loaded, poses)
    found = (result or {}).get("noise")
    if not found:
        return stated
    return replace(stated, point=np.array(found["scanner_mm"], dtype=float), joint=np.array(found["joint_rad"], dtype=float))


def simulate_motion(trajectory: Trajectory) -> Trajectory:
    """What an ideal arm would have recorded along the same motion: set point followed at once, rigid gears, torque of rigid bodies alone.

    The motion is the recording's motor side; derivatives by a zero-phase filter. Torque (N m about the joints) only where the robot's
    masses are known. Raises ConfigError for a recording that is too short or whose times do not rise.
    """
    from mbcacq.diagnosis.motion.signals import prepare

    run, _ = prepare(replace(trajectory, torque=np.zeros_like(trajectory.q), motor_torque=None))
    t = trajectory
    time_s = t.time_s[0] + run.step_s * np.arange(len(run.q))
    rigid = run.rigid if t.robot.mass.any() else None
    return replace(
        t,
        time_s=time_s,
        q=run.q,
        q_set=None if t.q_set is None else run.q,
        q_joint=None if t.q_joint is None else run.q,
        torque=rigid,
        motor_torque=None,
        current=None,
        temperatures={},
        extra={},
    )

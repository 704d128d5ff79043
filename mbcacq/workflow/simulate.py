"""Simulation: what a calibrated cell, with the effects in its result, would record if it executed a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.result_io import effects_of, state_from_dict
from mbcacq.design.simulated_observations import planned_noise, planned_observations, planned_state
from mbcacq.effects.effect_model import EffectModel
from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import Noise
from mbcacq.model.observations import Observations
from mbcacq.model.trajectory import Trajectory
from mbcacq.plan import LoadedPlan, PlannedPose, expand, path, refuse_errors
from mbcacq.plan.summary import summary
from mbcacq.workflow.acquire import solver_cell
from mbcacq.workflow.load import as_plan, as_result


def simulate(
    plan: LoadedPlan | Path | str, cell: CalibratedCell | dict[str, Any] | Path | str | None = None, *, noise: bool = False, seed: int = 0
) -> Observations:
    """What a plan would record: P planned poses, M expected centres where the model puts them.

    Parameters
    ----------
    plan
        The plan, or its file.
    cell
        A calibrated cell, or its result.json, or a run folder with one; the nominal cell by default.
    noise
        Add the scatter of centres and the repeatability of the joints.
    seed
        Seed of that noise.

    Returns
    -------
    Observations
        ``q`` (P, n) rad, ``xyz`` (M, 3) mm in the scanner frame.

    Raises
    ------
    ConfigError
        The plan cannot be executed, or the cell is another.
    """
    loaded = as_plan(plan)
    poses = expand(loaded)
    refuse_errors(loaded, poses)
    return simulate_poses(loaded, poses, None if cell is None else as_result(cell), noise, seed)


def simulate_poses(
    loaded: LoadedPlan, poses: Sequence[PlannedPose], result: dict[str, Any] | None = None, noise: bool = False, seed: int = 0
) -> Observations:
    """Every planned pose with its expected balls, where the model puts them (mm, scanner frame); times and directions of motion as planned.

    result: the content of a result.json; default the nominal cell. Stations that the result does not have stand where the plan puts them.
    noise: add the scatter of centres and the repeatability of the joints (the result's, else the plan's and the data sheet's). The cell
    that is written has no placements of stations, as in a run. It states the scatter of a centre, for a solver that has no scatter to
    estimate it from. Raises ConfigError where result and plan do not match.
    """
    starts = {p["pose"]: p["start_s"] for p in summary(loaded, poses)["poses"]}
    blank = planned_observations(loaded, poses, path(loaded, poses), [starts[p.number] for p in poses])
    state = cell_state(loaded, result)
    rng = np.random.default_rng(seed)
    scatter = _noise(loaded, poses, result) if noise else None
    scattered = blank if scatter is None else replace(blank, q=blank.q + scatter.joint * rng.standard_normal(blank.q.shape))
    xyz = predicted(scattered, state, effects_of(result) if result else None)
    if scatter is not None:
        xyz = xyz + scatter.point * rng.standard_normal(xyz.shape)
    return replace(blank, cell=replace(solver_cell(loaded), noise_mm=_noise(loaded, poses, result).point, simulated=True), xyz=xyz)


def predicted(obs: Observations, state: CellState, effects: EffectModel | None) -> np.ndarray:
    """(M, 3) mm where the model, with its effects, puts the balls in the scanner; what is measured of them in ``obs`` does not matter."""
    xyz = forward_model.predict(obs, state).xyz
    if effects:
        for _ in range(2):  # a bias of the scanner depends on the place in its field of view, which it changes in the second order
            here = replace(obs, xyz=xyz)
            xyz = forward_model.predict(here, state, effects.displacements(here)).xyz
    return xyz


def cell_state(loaded: LoadedPlan, result: dict[str, Any] | None) -> CellState:
    """The calibrated cell with every station of the plan at a place; nominal where there is no result. Raises ConfigError."""
    planned = planned_state(loaded)
    if result is None:
        return planned
    state = state_from_dict(result, loaded.cell, other="the plan")
    known = {str(s["id"]): s.get("artefact") for s in result["stations"]}
    same = np.array([known.get(s.id) == s.artefact for s in loaded.cell.stations])
    return replace(state, T_base_station=np.where(same[:, None, None], state.T_base_station, planned.T_base_station))


def _noise(loaded: LoadedPlan, poses: Sequence[PlannedPose], result: dict[str, Any] | None) -> Noise:
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
        simulated=True,
    )

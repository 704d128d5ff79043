"""Recordings of the fake cell: the fast way without protocols and pictures, or by running the plan against its servers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.challenge.scenarios import Scenario
from mbcacq.devices import load_driver
from mbcacq.effects.support import with_drives_for
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose, path
from mbcacq.plan.routing import path_home
from mbcacq.recording import load_observations
from mbcacq.workflow.acquire import Acquisition, solver_cell

Injected = list[dict[str, Any]]


def observe(
    loaded: LoadedPlan,
    poses: Sequence[PlannedPose],
    scenario: Scenario,
    injected: Injected,
    climate: Mapping[str, float] | None = None,
    noise_seed: int | None = None,
    planned: Sequence[PlannedPose] | None = None,
) -> tuple[Observations, dict[str, Any]]:
    """The recording of the run, as observations, and the truth. injected, climate, noise_seed: as ``hidden`` and the like of a plan's
    ``fake``. planned: the poses by which injected effects choose where and when they act, where the same cell was measured before.
    """
    fake = {"climate": dict(climate or {}), "noise_seed": noise_seed}
    planned_q = None if planned is None else np.array([p.q for p in planned])
    made = load_driver("fakes", "recorded")
    recorded = made(loaded.cell, poses, injected, scenario.seed, outliers=scenario.outliers, fake=fake, planned_q=planned_q)
    observations = Observations(
        cell=solver_cell(loaded),
        pose_id=np.array([p.number for p in poses]),
        station=recorded.station,
        q=recorded.q,
        pose=recorded.pose,
        ball=recorded.ball,
        xyz=recorded.xyz,
        phase=np.array([p.phase for p in poses]),
        time_s=recorded.time_s,
        direction=recorded.direction.astype(int),
        temperatures={"air_C": recorded.air_C, "robot_C": recorded.robot_C},
    )
    return described(without(observations, scenario.missing), recorded.truth), recorded.truth


def run(
    loaded: LoadedPlan, poses: Sequence[PlannedPose], scenario: Scenario, injected: Injected, folder: Path, noise_seed: int | None = None
) -> tuple[Observations, dict[str, Any]]:
    """The plan executed against the fake cell's servers, in lock-step, recorded into ``folder`` and read back; and the truth."""
    secret = replace(
        loaded, plan=loaded.plan.model_copy(update={"fake": {**loaded.plan.fake, "hidden": injected, "noise_seed": noise_seed}})
    )
    folder.mkdir(parents=True, exist_ok=True)
    with load_driver("fakes", "cell")(secret, list(poses), realtime=False, seed=scenario.seed) as cell:
        Acquisition(
            loaded=loaded, poses=poses, paths=path(loaded, poses), path_home=path_home(loaded, poses[-1]), folder=folder, simulated=True
        ).execute(cell.overrides())
        truth = cell.truth()
    return described(without(load_observations(folder), scenario.missing), truth), truth


def described(observations: Observations, truth: Mapping[str, Any]) -> Observations:
    """The recording, stating the drives that its joints need for the injected effects."""
    robot = observations.cell.robot
    for effect in truth["effects"]:
        robot = with_drives_for(robot, effect["name"], tuple(effect.get("where", ())))
    return replace(observations, cell=replace(observations.cell, robot=robot))


def without(observations: Observations, missing: Sequence[str]) -> Observations:
    """The same recording, had it lacked some columns."""
    gone: dict[str, Any] = {"time_s": {"time_s": None}, "temperature": {"temperatures": {}}, "direction": {"direction": None}}
    for name in missing:
        observations = replace(observations, **gone[name])
    return observations

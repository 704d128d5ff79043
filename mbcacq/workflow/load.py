"""Reading what a program works on: plans, observations, trajectories, results."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.result_io import read_result, split_number
from mbcacq.errors import ConfigError
from mbcacq.model.json_text import SEAL
from mbcacq.model.observations import Observations
from mbcacq.model.trajectory import Trajectory, moves
from mbcacq.model.yaml_source import parse
from mbcacq.plan import LoadedPlan
from mbcacq.plan import load as read_plan
from mbcacq.plan.controller_joints import matrix_of
from mbcacq.plan.schema import ControllerJoints
from mbcacq.recording import load_observations
from mbcacq.recording.datasets.trajectory_set import is_trajectory_set, read_trajectory_set
from mbcacq.recording.rrd import layout
from mbcacq.recording.run_folder.run_plan import PLAN


def load_plan(path: Path | str) -> LoadedPlan:
    """A plan with the robot and artefact files that it names.

    Parameters
    ----------
    path
        The YAML file.

    Returns
    -------
    LoadedPlan
        The plan and its cell.

    Raises
    ------
    ConfigError
        The plan has a mistake; the message is 'file:line: sentence'.
    """
    return read_plan(path)


def load_trajectories(*paths: Path | str) -> list[Trajectory]:
    """The motion in recordings: one trajectory for each trajectory set, and for a run one for each stretch in which its arm moves.

    Parameters
    ----------
    *paths
        Trajectory sets (folders with cell.yaml and trajectory.csv), run folders or .rrd files. A run without torques and joint-side angles
        gives no trajectory.

    Returns
    -------
    list of Trajectory
        T samples each: ``time_s`` (T,), ``q`` (T, n) rad, ``torque`` (T, n) N m. A signal that was not recorded is None.

    Raises
    ------
    ConfigError
        A path holds no trajectory, or its content has a fault.
    """
    found: list[Trajectory] = []
    for path in map(Path, paths):
        if is_trajectory_set(path):
            found.append(read_trajectory_set(path))
        else:
            found += recorded_moves(path)
    return found


def recorded_moves(recording: Path) -> list[Trajectory]:
    """The stretches of a run folder or a .rrd in which the arm moves; none where neither torques nor joint-side angles were recorded.

    Raises ConfigError where there is no recording of controller cycles.
    """
    from mbcacq.recording.rrd.trajectory_recording import trajectory_of_run

    trajectory = trajectory_of_run(recording)
    return moves(trajectory) if trajectory.torque is not None or trajectory.q_joint is not None else []


def is_run_folder(path: Path) -> bool:
    """Whether this is the folder of a run, where results and diagnoses are kept with the recording."""
    return path.is_dir() and bool(layout.parts(path))


def as_plan(plan: LoadedPlan | Path | str) -> LoadedPlan:
    """A plan as it is, or read from its file. Raises ConfigError."""
    return load_plan(plan) if isinstance(plan, Path | str) else plan


def as_observations(data: Observations | Path | str) -> Observations:
    """Observations as they are, or read from their place; see ``load_observations``. A recording that saw parts alone
    gives the places of their scenes."""
    if isinstance(data, Observations):
        return data
    found = load_observations(data)
    if found.n_centres or not any(artefact.is_part for artefact in found.cell.artefacts):
        return found

    from mbcacq.workflow.part_scenes import scenes_as_observations  # registration, which few recordings need

    return scenes_as_observations(Path(data), found)


def as_trajectories(data: Sequence[Trajectory | Path | str]) -> list[Trajectory]:
    """Trajectories as they are, or read from their places; see ``load_trajectories``."""
    return [t for one in data for t in ([one] if isinstance(one, Trajectory) else load_trajectories(one))]


def as_cell(cell: CalibratedCell | dict[str, Any] | Path | str) -> CalibratedCell:
    """A calibrated cell as it is, of the content of its result.json, or of the file or run folder that holds it. Raises ConfigError."""
    return cell if isinstance(cell, CalibratedCell) else CalibratedCell.from_dict(as_result(cell))


def as_result(cell: CalibratedCell | dict[str, Any] | Path | str) -> dict[str, Any]:
    """The content of result.json of a calibrated cell, or of the file or run folder that holds it. Raises ConfigError."""
    if isinstance(cell, CalibratedCell):
        return cell.to_dict()
    if isinstance(cell, dict):
        return cell
    return read_result(Path(cell))


def unsealed_note(source: Path | str) -> list[str]:
    """A sentence where the file of a result carries no checksum, so that nothing shows whether it was changed; else nothing."""
    path, _ = split_number(Path(source))
    file = path / "result.json" if path.is_dir() else path
    try:
        content = json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):  # whoever reads the result says what is wrong with it
        return []
    if not isinstance(content, dict) or SEAL in content:
        return []
    return [f"unsealed: {file} carries no checksum ({SEAL}), so it may have been edited or damaged; its values are used as they stand"]


def refuse_existing(path: Path, force: bool, sentence: str) -> None:
    """Raises ConfigError with ``sentence`` where ``path`` exists and must not be replaced."""
    if path.exists() and not force:
        raise ConfigError(sentence)


def counted_joints(run: Path, n: int) -> dict[str, Any]:
    """'controller_joints' of a result: how the controller of an arm with n axes counts them, as the plan kept in a run folder states it.

    matrix: (n, n); offset_deg: (n,), so that angles = matrix q + offset. Empty where the model counts alike, or ``run`` keeps no plan.
    """
    try:
        text = (run / PLAN).read_text(encoding="utf-8")
    except (OSError, ValueError):
        return {}
    robot = parse(text, run / PLAN).data.get("robot")
    stated = robot.get("controller_joints") if isinstance(robot, Mapping) else None
    if not stated:
        return {}
    A, offset = matrix_of(ControllerJoints.model_validate(stated), n, ConfigError)
    return {"controller_joints": {"matrix": A.tolist(), "offset_deg": offset.tolist()}}

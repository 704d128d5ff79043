"""Diagnose a recording against somebody else's simulation: a set that another simulator made, or a model file that MuJoCo runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mbcacq.calibration.calibrate import calibrate, calibrate_with_effects
from mbcacq.errors import ConfigError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.model.observations import Observations
from mbcacq.model.trajectory import Trajectory
from mbcacq.simulation.simulated_sets import observations_against, trajectory_against
from mbcacq.workflow.diagnose_recordings import Data, Question, Trial, checked, diagnose_poses, is_trajectory, provenance, trial_on
from mbcacq.workflow.diagnosis_result import DiagnosisResult
from mbcacq.workflow.load import as_observations, as_trajectories

MODEL_FILES = (".xml", ".mjcf", ".urdf")


def diagnose_against(recorded: Sequence[Data], simulated: Sequence[Data], how: Question) -> DiagnosisResult:
    """The diagnosis of recordings against simulated sets, one each, or against one model file. Raises ConfigError where they do not fit."""
    motion = [is_trajectory(one) for one in recorded]
    if any(motion) != all(motion):
        raise ConfigError("poses and trajectories cannot be compared with one simulation; diagnose them one after the other")
    if _is_model(simulated[0]):
        if len(simulated) > 1:
            raise ConfigError("several model files were given; give one")
        against = _motion_against_model if all(motion) else _poses_against_model
        return against(recorded, Path(str(simulated[0])), how)
    if len(simulated) != len(recorded):
        raise ConfigError(f"{len(recorded)} recordings and {len(simulated)} simulated sets were given; give one set for each recording")
    if [is_trajectory(one) for one in simulated] != motion:
        raise ConfigError("poses are compared with simulated poses, trajectories with simulated trajectories; give the same kind of set")
    return (_motion_against_sets if all(motion) else _poses_against_set)(recorded, simulated, how)


def _is_model(data: Data) -> bool:
    if not isinstance(data, Path | str) or Path(data).suffix.lower() not in MODEL_FILES:
        return False
    if not Path(data).is_file():
        raise ConfigError(f"{data}: there is no such model file; correct the path")
    return True


def _trajectories(data: Sequence[Data]) -> list[Trajectory]:
    return as_trajectories([one for one in data if not isinstance(one, Observations)])


def _one_of_poses(data: Sequence[Data]) -> Observations:
    if len(data) > 1:
        raise ConfigError("several recordings of poses were given; diagnose one at a time against a simulation")
    (one,) = data
    assert not isinstance(one, Trajectory), "trajectories are compared elsewhere"
    return as_observations(one)


def _motion_against_model(recorded: Sequence[Data], model: Path, how: Question) -> DiagnosisResult:
    from mbcacq.simulation.motion import check_model, diagnose_against_model
    from mbcacq.simulation.mujoco_arm import load_arm

    arm = load_arm(model)
    found, match = diagnose_against_model(_trajectories(recorded), arm, how.progress)
    for other in how.check:
        if not is_trajectory(other):
            raise ConfigError(f"{other}: what was learnt from trajectories is tried on trajectories; give a trajectory set to --check")
        how.progress(f"MuJoCo runs {_name(other)}")
        match = check_model(match, arm, _trajectories([other]), _name(other))
    return DiagnosisResult(motion=replace(found, verdict=match.verdict or found.verdict), simulation=match)


def _motion_against_sets(recorded: Sequence[Data], simulated: Sequence[Data], how: Question) -> DiagnosisResult:
    from mbcacq.diagnosis.motion.diagnose import diagnose_trajectories

    if how.check:
        raise ConfigError("a simulated set knows its own motion alone; give a model file to --simulation, or leave --check out")
    pairs = zip(_trajectories(recorded), _trajectories(simulated), strict=True)
    return DiagnosisResult(motion=diagnose_trajectories([trajectory_against(r, s) for r, s in pairs], minutes=how.minutes))


def _poses_against_model(recorded: Sequence[Data], model: Path, how: Question) -> DiagnosisResult:
    from mbcacq.simulation.mujoco_arm import load_arm, remarks_on_masses
    from mbcacq.simulation.poses import is_written, observations_of_model, write_into_model

    arm = load_arm(model)
    observations = observations_of_model(_one_of_poses(recorded), arm)
    found = diagnose_poses(observations, how)
    others = [(name := _name(other), trial_on(observations_of_model(_one_of_poses([other]), arm), name, how.place)) for other in how.check]
    found = _checked(found, observations, others, how, recorded[0])
    if found.poses is not None:
        found = replace(found, poses=replace(found.poses, notes=(*found.poses.notes, *remarks_on_masses(arm, arm.spec))))
    written = None if found.model is None else found.model.select(lambda t: is_written(t.name))
    options = replace(how.options or CalibrationOptions(), refuse=False)
    how.progress("writing what was found into the model")
    cell = calibrate_with_effects(observations, options, written) if written else calibrate(observations, options)
    effects = () if found.poses is None else found.poses.effects
    return replace(found, simulation=write_into_model(arm, cell, effects))


def _poses_against_set(recorded: Sequence[Data], simulated: Sequence[Data], how: Question) -> DiagnosisResult:
    if how.check:
        raise ConfigError("a simulated set knows its own poses alone; give a model file to --simulation, or leave --check out")
    observations = observations_against(_one_of_poses(recorded), _one_of_poses(simulated))
    found = diagnose_poses(observations, how)
    return _checked(found, observations, [], how, recorded[0])


def _checked(
    found: DiagnosisResult, observations: Observations, others: Sequence[tuple[str, Trial]], how: Question, source: Data
) -> DiagnosisResult:
    origin = provenance(source, how.check, {"place": how.place, "workers": how.workers})
    if others:
        found = checked(observations, found, others, how.progress)
    return replace(found, provenance=origin)


def _name(data: Data) -> str:
    return (
        data.name or "the other recording" if isinstance(data, Trajectory) else str(data) if isinstance(data, Path | str) else "the other"
    )

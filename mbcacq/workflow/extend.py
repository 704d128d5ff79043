"""A run that grows: the poses of another plan of the same cell are added to its recording, at its own stations."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mbcacq.calibration.sufficiency import options_for
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.errors import ConfigError, RecordingError
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import CalibrationOptions, Noise
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, expand
from mbcacq.plan.growth import grown
from mbcacq.recording.run_folder.journal import read_journal
from mbcacq.recording.run_folder.progress import poses_done
from mbcacq.recording.run_folder.run_plan import read_kept_plan, refuse_change
from mbcacq.workflow.dry_run import name_of
from mbcacq.workflow.evaluate import RunResult
from mbcacq.workflow.load import as_plan, load_observations
from mbcacq.workflow.next_plan import plan_of_recording
from mbcacq.workflow.run import Operator, run

LEAST_MM, SIGMAS = 0.05, 6.0  # by which an artefact must stand elsewhere to be said to, and standard deviations


def extend(
    recording: Path | str,
    plan: LoadedPlan | Path | str,
    *,
    dry_run: bool = False,
    live: bool = False,
    seed: int = 0,
    operator: Operator | None = None,
) -> RunResult:
    """Add the poses of a plan to the recording of a finished run, at its stations, and calibrate and verify the whole again.

    Everything is as in ``run``: the same checks, gates and safety. An extension that was interrupted is resumed as a run is. The artefacts
    must stand as they did; if one stands elsewhere, ``operator.message`` gets a sentence.

    Parameters
    ----------
    recording
        The folder of the run.
    plan
        A plan of the same cell, whose steps are added.
    dry_run, live, seed, operator
        As for ``run``.

    Returns
    -------
    RunResult
        The calibrated and verified cell of all poses.

    Raises
    ------
    ConfigError
        The plan is of another cell, or the run is not whole.
    SafetyStop, CalibrationError, RecordingError
        As ``run``.
    """
    folder, operator = Path(recording), operator or Operator()
    loaded = extended_plan(folder, as_plan(plan), name_of(dry_run, seed))
    before = _measured(folder)
    done = run(loaded, dry_run=dry_run, resume=folder, live=live, seed=seed, operator=operator)
    for sentence in moved_artefacts(load_observations(folder), before):
        operator.message(sentence)
    return done


def extended_plan(folder: Path, further: LoadedPlan, cell: str) -> LoadedPlan:
    """The plan of a run with the steps of another one after its own. cell: which is driven, in words.

    Raises ConfigError where the run is not whole, or is of another cell.
    """

    kept, before = read_kept_plan(folder), plan_of_recording(folder)
    refuse_change(folder, kept, before.text, before.files, cell)
    poses = expand(before)
    missing = {p.number for p in poses} - _measured(folder)
    if missing and not _ended_well(folder):
        raise ConfigError(
            f"{folder} was interrupted, and {len(missing)} of its poses are not measured; first: mbcacq run --resume {folder}"
        )
    return grown(before, further, len(poses))


def moved_artefacts(obs: Observations, before: frozenset[int]) -> list[str]:
    """A sentence for each station whose poses after an extension see the artefact elsewhere than those before it. before: numbers of the
    poses that were measured until then.
    """
    old = np.isin(obs.pose_id, list(before))
    shared = [s for s in np.unique(obs.station) if old[obs.station == s].any() and not old[obs.station == s].all()]
    if not shared:
        return []
    problem = prepare(obs, options_for(obs, CalibrationOptions()))
    linear, out = problem.linear, list[str]()
    for s in shared:
        new = ~np.isin(linear.obs.pose_id, list(before)) & (linear.obs.station == s)
        shift, std = _second_placement(linear, problem.noise, new)
        if shift > LEAST_MM and shift > SIGMAS * std:
            name = obs.cell.stations[int(s)].id
            out.append(
                f"the artefact at station {name} stands {shift:.2f} mm from where it stood before (standard deviation {std:.2f} mm), or "
                "the cell has changed meanwhile: if it was put back by hand, give the visit a station of its own at the same place"
            )
    return out


def _second_placement(linear: LinearProblem, noise: Noise, new: np.ndarray) -> tuple[float, float]:
    """Distance in mm by which the artefact of the new poses (P,) bool stands elsewhere, and its standard deviation."""
    scoring = CandidateScoring.of(linear, noise)
    columns = linear.station[:, :, :3] * new[linear.obs.pose][:, None, None]
    X = scoring.whiten(columns)
    absorbed = scoring.absorbed(X)
    S = X.T @ X - absorbed.T @ absorbed
    covariance = np.linalg.inv(S + 1e-9 * np.trace(S) * np.eye(3))
    shift = covariance @ (X.T @ scoring.beyond_geometry())
    return float(np.linalg.norm(shift)), float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))


def _measured(folder: Path) -> frozenset[int]:
    try:
        return poses_done(folder)
    except RecordingError as error:
        raise ConfigError(f"{folder} holds no whole recording to extend ({error}); first: mbcacq run --resume {folder}") from error


def _ended_well(folder: Path) -> bool:
    """Whether the last recording of a run ended as planned; poses may be missing that showed too few balls."""
    ends = [entry.get("exit_status") for entry in read_journal(folder) if entry.get("event") == "run_stopped"]
    return bool(ends) and ends[-1] == "success"

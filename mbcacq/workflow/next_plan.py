"""The next measurements after a recording, as a plan that runs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from mbcacq.calibration.description import likely_cause_named
from mbcacq.design.adaptive.next_plan import NextPoses, advised, next_plan_text
from mbcacq.design.adaptive.options import OPTIONS
from mbcacq.design.adaptive.pool import reachable_views
from mbcacq.diagnosis.findings import Advice
from mbcacq.diagnosis.interim import InterimEvidence, weigh
from mbcacq.errors import ConfigError, MbcacqError
from mbcacq.files.atomic_write import write_file
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, load
from mbcacq.recording.run_folder.run_plan import read_kept_plan
from mbcacq.workflow.diagnosis_result import DiagnosisResult
from mbcacq.workflow.load import as_observations, as_plan


@dataclass(frozen=True)
class NextPlan:
    """What to measure next: the chosen poses, and the text of a plan with them ('' where there are none)."""

    chosen: NextPoses
    text: str

    @property
    def sentences(self) -> list[str]:
        """What is chosen and why, for people."""
        said = [f"{reason}." for reason in self.chosen.reasons]
        if not self.chosen.visits:
            return [*said, "No pose that can be reached would decide more."]
        each = ", ".join(f"{len(v.poses)} poses at station {v.station}" for v in self.chosen.visits)
        return [*said, f"Next: {each}."]


def next_poses(
    observations: Observations | Path | str,
    plan: LoadedPlan | Path | str,
    *,
    visits: int = OPTIONS.advised_visits,
    poses: int = OPTIONS.advised_poses,
    seed: int = 0,
) -> NextPoses:
    """The poses to measure next with a cell of a plan, for people with a runner of their own.

    Parameters
    ----------
    observations
        What was measured so far.
    plan
        Describes the cell, its stations and obstacles. Its poses are among those to choose from.
    visits, poses
        Largest numbers of visits of a station, and of poses.
    seed
        Seed of the random views to choose from.

    Returns
    -------
    NextPoses
        The joint angles are ``[p.q for p in chosen.poses]``, (n,) rad each.

    Raises
    ------
    CalibrationError
        The data do not determine the geometry.
    ConfigError
        Plan and recording are of different cells.
    """
    return _chosen(_weighed(as_observations(observations)), as_plan(plan), visits, poses, seed)


def next_plan(
    run: Path | str,
    out: Path | str,
    *,
    plan: LoadedPlan | Path | str | None = None,
    visits: int = OPTIONS.advised_visits,
    poses: int = OPTIONS.advised_poses,
) -> NextPlan:
    """The next measurements after a run as a plan, which is written to a file if there are any.

    Parameters
    ----------
    run
        The run folder.
    out
        The file to write. The new plan runs by itself, and ``run --extend`` adds its poses to the run.
    plan
        Plan of the cell (default: that of the run folder).
    visits, poses
        Largest numbers of visits of a station, and of poses.

    Returns
    -------
    NextPlan
        The chosen poses, and the text of the plan.

    Raises
    ------
    ConfigError
        The run has no plan.
    CalibrationError
        The data of the run do not determine the geometry.
    """
    out = Path(out)
    loaded = plan_of_recording(Path(run)) if plan is None else as_plan(plan)
    chosen = _chosen(_weighed(as_observations(run)), loaded, visits, poses)
    if not chosen.visits:
        return NextPlan(chosen, "")
    text = next_plan_text(loaded, chosen.visits, out.parent, chosen.reasons)
    write_file(out, text)
    return NextPlan(chosen, text)


def _weighed(observations: Observations) -> InterimEvidence:
    with likely_cause_named(observations):
        return weigh(observations)


def with_reachable_advice(found: DiagnosisResult, run: Path) -> DiagnosisResult:
    """The diagnosis of a run that cannot tell, with poses as advice that can be reached, seen and routed in the cell of its plan."""
    if found.poses is None or found.poses.verdict != "cannot_tell" or found.observations is None:
        return found
    try:
        loaded = plan_of_recording(run)
        chosen = _chosen(_weighed(found.observations), loaded)
    except MbcacqError:
        return found  # a run of which the plan is not known any more, or whose cell is another one
    advice = chosen.advice or tuple(Advice(reason, ()) for reason in chosen.reasons)
    return replace(found, poses=replace(found.poses, advice=(*found.poses.rejected_balls, *advice)))


def plan_of_recording(folder: Path) -> LoadedPlan:
    """The plan that a run folder was recorded with, as it is kept there. Raises ConfigError where there is none."""
    if not folder.is_dir():
        raise ConfigError(f"{folder} is no run folder, which would say what can be measured next; give the folder of a run, or a plan")
    kept = read_kept_plan(folder)
    if kept.plan is None or kept.path is None:
        raise ConfigError(f"{folder} does not hold the plan that it was recorded with; give the plan of the cell")
    return replace(load(Path(kept.path), kept.plan), grown_from=kept.grown_from)


def _chosen(
    look: InterimEvidence, loaded: LoadedPlan, visits: int = OPTIONS.advised_visits, poses: int = OPTIONS.advised_poses, seed: int = 0
) -> NextPoses:
    arm, planned = look.problem.linear.obs.cell.robot, loaded.cell.robot
    if arm.n != planned.n:
        raise ConfigError(f"the recording is of an arm with {arm.n} axes, {loaded.path} of one with {planned.n}; give the plan of the cell")
    unknown = {s.id for s in look.problem.linear.obs.cell.stations} - {s.id for s in loaded.cell.stations}
    if unknown:
        raise ConfigError(f"{loaded.path} has no station {', '.join(sorted(unknown))} of the recording; give the plan of the cell")
    return advised(look, loaded, visits, poses, reachable_views(loaded, seed))

"""Diagnose a recording: poses at standstill, trajectories in time, or a run that has both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.catalogue import Added, with_added
from mbcacq.errors import ConfigError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.model.observations import Observations
from mbcacq.model.trajectory import Trajectory
from mbcacq.workflow.diagnose_recordings import (
    Data,
    Question,
    checked,
    combined_with_motion,
    diagnose_motion,
    diagnose_poses,
    diagnose_together,
    is_trajectory,
    provenance,
    to_be_checked,
)
from mbcacq.workflow.diagnose_simulation import diagnose_against
from mbcacq.workflow.diagnosis_result import DiagnosisResult
from mbcacq.workflow.load import as_observations, is_run_folder
from mbcacq.workflow.next_plan import with_reachable_advice
from mbcacq.workflow.part_scenes import trials_on_parts


def diagnose(  # noqa: PLR0913 -- one argument an option of its command
    data: Data | Sequence[Data],
    *,
    progress: Callable[[str], None] = lambda text: None,
    workers: int | None = None,
    options: CalibrationOptions | None = None,
    check: Sequence[Data] = (),
    place: str = "fitted",
    simulation: Data | Sequence[Data] | None = None,
    propose: bool = False,
    minutes: float | None = OPTIONS.minutes,
    effects: Sequence[Added] = (),
) -> DiagnosisResult:
    """Find the effects that the model of the cell lacks, and say how sure that is.

    Parameters
    ----------
    data
        Observations, or a run folder, a recording, an observation set; or trajectories of one robot (objects or trajectory sets). Several
        recordings of one arm share the arm and its effects. If a run's controller recorded torques or joint-side angles, the motion
        between the poses is compared too.
    progress
        Called with a sentence for each step.
    workers
        Processes that share the cross-validation (default: one for each processor core).
    options
        Options of the adjustment of poses, as ``mbcacq.calibrate`` takes them (which phases are used, what is held).
    check
        Further recordings of the arm, on which what was learnt is tried.
    place
        'fitted': base, tool and stations of ``check`` are fitted. 'known': nothing is fitted.
    simulation
        Another simulator's set for the same poses or motion, one for each recording, or a model file that MuJoCo runs (MJCF, URDF). The
        mismatch is explained against it, and ``found.simulation.write("found.xml")`` writes what was found into a model file.
    propose
        Search short formulas for unmodelled effects of one recording of poses (``found.proposals``, ``found.write_effect("folder")``).
    minutes
        The search ends after this time, and the verdict is ``cannot_tell`` with what was found by then. None: no end.
    effects
        Further effects that are tried with the catalogue: functions ``name(context)`` that return candidates of that name, modules with
        NAME and ``candidates``, or files with these.

    Returns
    -------
    DiagnosisResult
        Verdict, effects with their uncertainties, alternatives, exclusion limits.

    Raises
    ------
    ConfigError
        The data do not belong together.
    CalibrationError
        The data do not determine the geometry.

    Examples
    --------
    >>> found = mbcacq.diagnose("runs/today")
    >>> print(found.text)
    >>> better = mbcacq.calibrate("runs/today").with_effects(found)
    """
    several = listed(data)
    how = Question(progress=progress, workers=workers, options=options, check=tuple(check), place=place, minutes=minutes)
    if propose and (len(several) > 1 or simulation is not None or is_trajectory(several[0])):
        raise ConfigError("formulas are proposed for one recording of poses; leave --propose out, or give that recording alone")
    with with_added(effects):
        if simulation is not None:
            return diagnose_against(several, listed(simulation), how)
        return _diagnosed(several, how, propose)


def _diagnosed(several: list[Data], how: Question, propose: bool) -> DiagnosisResult:
    """The diagnosis of recordings by themselves, without another simulation beside them."""
    check = how.check
    if all(is_trajectory(one) for one in several):
        if not all(is_trajectory(one) for one in check):
            raise ConfigError("what was learnt from trajectories is tried on trajectories; give --check recordings of motion")
        learnt, others = ([one for one in some if not isinstance(one, Observations)] for some in (several, check))
        return diagnose_motion(learnt, how, others)
    if len(several) > 1:
        return diagnose_together(several, how)
    (one,) = several
    if isinstance(one, Trajectory):
        raise TypeError("a trajectory is diagnosed as motion")
    observations = as_observations(one)
    others = to_be_checked(observations, check, how.place)
    others += [] if isinstance(one, Observations) else trials_on_parts(Path(one), observations)
    found = diagnose_poses(observations, how, formulas=propose, fitted=not others)
    found = replace(found, provenance=provenance(one, check, {"place": how.place, "workers": how.workers}))
    if others:
        found = checked(observations, found, others, how.progress)
    if isinstance(one, Observations):
        return found
    if is_run_folder(Path(one)):
        found = with_reachable_advice(found, Path(one))
    return combined_with_motion(found, Path(one), how)


def listed(data: Data | Sequence[Data]) -> list[Data]:
    """One or several recordings as a list."""
    return list(data) if isinstance(data, Sequence) and not isinstance(data, str) else [data]

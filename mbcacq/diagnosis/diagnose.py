"""``diagnose``: observations in, verdict out; the method on one page, in the order of docs/explanation/method.md."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from mbcacq.calibration.sufficiency import options_for
from mbcacq.diagnosis.executor import Refit, Refitting, TimeBudget, give_back_freed_memory, processes
from mbcacq.diagnosis.formulas.propose import propose
from mbcacq.diagnosis.model_fit import fit_everywhere, fit_model, search
from mbcacq.diagnosis.noise_dependence import noise_variations, with_noise_scale
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.kept_model import kept_model, predicting_better, with_groups_everywhere
from mbcacq.diagnosis.output.notes import noise_in_words
from mbcacq.diagnosis.output.over_whole_range import with_open_laws_as_functions
from mbcacq.diagnosis.problem import DiagnosisProblem, determined, prepare, thinned
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.validation.cross_validation import validated
from mbcacq.diagnosis.validation.folds import repeated, repeated_early
from mbcacq.diagnosis.validation.found_again import repetitions
from mbcacq.diagnosis.verdict import conclude
from mbcacq.errors import ConfigError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.model.observations import Observations

Progress = Callable[[str], None]


def diagnose(
    recordings: Observations | Sequence[Observations],
    folds: int | None = None,
    progress: Progress = lambda text: None,
    workers: int = 1,
    options: CalibrationOptions | None = None,
    formulas: bool = False,
    refit: Refit | None = None,
    minutes: float | None = OPTIONS.minutes,
) -> Diagnosis:
    """Locate the mismatch, explain it by effects, and validate these on data left out.

    recordings: one, or several of one arm, which share the arm and its effects and keep their own base, tool, stations and noise.
    folds: of the cross-validation; by default as many as the recording allows. workers: its processes.
    options: of the adjustment, as ``mbcacq.calibrate`` takes them; the same poses, noise and geometry come out. formulas: whether
    formulas are proposed for unmodelled effects. refit: makes of the effects that are kept those of the diagnosis' ``model``, and says
    what is to be noted of it. minutes: when they are over the search ends, and what was compared by then is concluded from: the verdict is
    then ``cannot_tell``, with a note (None: it takes the time that it needs).
    Raises CalibrationError if the data do not even determine the geometry, ConfigError if there are no joint angles.
    """
    first = recordings if isinstance(recordings, Observations) else recordings[0]
    if first.cell.robot.of_flange_poses:
        raise ConfigError(
            "the recording has poses of the flange and no joint angles, so what a joint does cannot be asked; give q1_deg .. for a "
            "diagnosis, or compare the methods for the hand-eye transformation with mbcacq compare"
        )
    budget, options = TimeBudget.of_minutes(minutes), options_for(first, options or CalibrationOptions())
    with determined(recordings), processes(workers) as pool:

        def begins(stage: str) -> None:
            give_back_freed_memory()
            progress(stage)

        begins("fitting the geometry")
        problem, notes = linearised(recordings, options, budget)
        refitting = Refitting(refit, pool)

        begins("searching for effects")
        early = repeated_early(replace(problem, budget=budget), folds, pool)
        part, fit, members = search(problem)
        if problem.in_part:  # what is left nearly always asks for groups at all locations
            refitting.begin(with_groups_everywhere(problem.linear.obs, EffectSet.unsolved(members)))
        full = fit_everywhere(problem, part, fit, members)
        variations = noise_variations(full)
        if variations and not problem.in_part and not problem.budget.spent:
            begins("searching for effects again, with the noise as it depends on the place")
            problem = problem.with_observations(with_noise_scale(problem.linear.obs, variations), options)
            full = fit_model(problem)
        kept = kept_model(full)
        refitting.begin(kept)

        problem = replace(problem, budget=budget)
        again, halves = early or repeated(problem, full, folds, pool)
        validation = validated(full, again, begins)
        kept, left_out = predicting_better(kept, full, validation)
        if not full.everywhere:
            kept = with_open_laws_as_functions(problem.linear.obs, kept, full.evidence)
        refitting.begin(kept)
        parts = repetitions(full, halves)

        begins("drawing the conclusion: uncertainties, alternatives, what could not have been found")
        result = replace(conclude(problem, full, validation, parts), model=kept or None)
        if formulas:
            proposals, tried = propose(problem, full, result.effects, progress)
            result = replace(result, proposals=proposals, notes=(*result.notes, *tried))
        dependences = tuple(entry for entry, _ in variations)
        noted = (*noise_in_words(dependences, not problem.in_part), *result.notes, *left_out, *notes)
        result = replace(result, notes=noted, noise_depends_on=dependences)
        if not refitting.begun:
            return result
        del problem, part, fit, full, early, again, halves, validation, parts  # they would take their memory beside the refit's
        begins("fitting the cell with its effects")
        model, further = refitting.answer()
        return replace(result, model=model, notes=(*result.notes, *further))


def linearised(
    recordings: Observations | Sequence[Observations], options: CalibrationOptions, budget: TimeBudget
) -> tuple[DiagnosisProblem, list[str]]:
    """The recording at its geometric fit, with a note where it has more poses than can be used."""
    problem = replace(prepare(recordings, options), budget=budget.for_the_search)
    poses = problem.linear.obs.n_poses
    if poses <= OPTIONS.most_poses:
        return problem, []
    problem = thinned(problem, problem.linear.keep, OPTIONS.most_poses)
    return problem, [f"of {poses} poses {OPTIONS.most_poses}, evenly at random, were used"]

"""``diagnose``: observations in, verdict out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mbcacq.calibration.sufficiency import options_for
from mbcacq.description import with_likely_cause
from mbcacq.diagnosis.executor import TimeBudget, WorkerPool, freed_memory_kept
from mbcacq.diagnosis.formulas.propose import propose
from mbcacq.diagnosis.model_fit import fit_everywhere, fit_model, search_in_part
from mbcacq.diagnosis.noise_dependence import noise_variations, with_noise_scale
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.kept_model import kept_model, with_groups_everywhere
from mbcacq.diagnosis.output.notes import noise_in_words
from mbcacq.diagnosis.problem import is_long, prepare, thinned
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.diagnosis.validation.cross_validation import validated
from mbcacq.diagnosis.validation.folds import RepeatedSearch
from mbcacq.diagnosis.verdict import conclude, judge
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.functions import DescribedPart
from mbcacq.errors import CalibrationError, ConfigError, ContradictionError
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.one_thread import one_thread
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.model.observations import Observations

Progress = Callable[[str], None]
Refit = Callable[[EffectModel], tuple[EffectModel | None, tuple[str, ...]]]


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
    Raises CalibrationError where the data do not even determine the geometry, ConfigError where there are no joint angles.
    """
    first = recordings if isinstance(recordings, Observations) else recordings[0]
    if first.cell.robot.of_flange_poses:
        raise ConfigError(
            "the recording has poses of the flange and no joint angles, so what a joint does cannot be asked; give q1_deg .. for a "
            "diagnosis, or compare the methods for the hand-eye transformation with mbcacq compare"
        )
    poses = first.n_poses if isinstance(recordings, Observations) else sum(r.n_poses for r in recordings)
    if poses < OPTIONS.fewest_poses:
        raise CalibrationError(f"{poses} poses are too few for a diagnosis: measure at least {OPTIONS.fewest_poses}")
    try:
        with one_thread(), freed_memory_kept(), WorkerPool(min(workers, OPTIONS.folds)) as pool:
            budget = TimeBudget.of_minutes(minutes)
            chosen = options_for(first, options or CalibrationOptions())
            return _diagnose(recordings, folds, progress, pool, chosen, formulas=formulas, refit=refit, budget=budget)
    except ContradictionError as error:
        raise with_likely_cause(error, first) from error
    except np.linalg.LinAlgError as error:
        raise CalibrationError(f"the recording does not determine the cell ({error}): measure more stations and orientations") from error


def _diagnose(
    recordings: Observations | Sequence[Observations],
    folds: int | None,
    progress: Progress,
    pool: WorkerPool,
    options: CalibrationOptions,
    *,
    formulas: bool,
    refit: Refit | None,
    budget: TimeBudget,
) -> Diagnosis:
    progress("fitting the geometry")
    problem = replace(prepare(recordings, options), budget=budget.for_the_search)
    obs, notes = problem.linear.obs, []
    if obs.n_poses > OPTIONS.most_poses:
        problem = thinned(problem, problem.linear.keep, OPTIONS.most_poses)
        notes = [f"of {obs.n_poses} poses {OPTIONS.most_poses}, evenly at random, were used"]
    progress("searching for effects")
    usual = OPTIONS.folds if obs.n_poses < 2 * OPTIONS.searched_poses else 2

    def begin_again(linear: LinearProblem, unmodelled: bool) -> RepeatedSearch:
        return RepeatedSearch.begin(replace(problem, linear=linear, budget=budget), folds or usual, pool, unmodelled)

    if is_long(obs):  # its search takes seconds, in which other processes repeat it without each part
        again, variations = begin_again(problem.linear, True), []
        part = search_in_part(problem)
        refitting = Refitting(refit, pool)
        # What is left nearly always asks for groups at all locations.
        refitting.begin(with_groups_everywhere(problem.linear.obs, EffectSet.unsolved(part.members)))
        full = fit_everywhere(problem, part)
    else:
        full = fit_model(problem)
        variations = noise_variations(full)
        if variations and not problem.budget.spent:
            progress("searching for effects again, with the noise as it depends on the place")
            problem = problem.with_observations(with_noise_scale(problem.linear.obs, variations), options)
            full = fit_model(problem)
        pool = WorkerPool() if full.empty else pool  # nothing is claimed, there is nothing to validate
        again = begin_again(full.geometry_only.linear, bool(full.random))
        refitting = Refitting(refit, pool)
    kept = kept_model(full)
    refitting.begin(kept)
    validation = validated(full, again, progress)
    variations = noise_variations(full) if is_long(obs) else variations
    problem = replace(problem, budget=budget)
    progress("drawing the conclusion: uncertainties, alternatives, what could not have been found")
    result = replace(conclude(problem, judge(problem, full, validation)), model=kept or None)
    if formulas:
        proposed = propose(problem, full, result.effects, progress)
        result = replace(result, proposals=proposed.proposals, notes=(*result.notes, *proposed.tried))
    dependences = tuple(one.entry for one in variations)
    result = replace(result, notes=(*noise_in_words(dependences, not is_long(obs)), *result.notes, *notes), noise_depends_on=dependences)
    if not refitting.begun:
        return result
    progress("fitting the cell with its effects")
    model, further = refitting.answer()
    return replace(result, model=model, notes=(*result.notes, *further))


class Refitting:
    """The refit of the effects that are kept, which takes seconds. Validation and conclusion do not depend on it: another process makes it
    meanwhile.
    """

    def __init__(self, refit: Refit | None, pool: WorkerPool):
        self._refit, self._pool = refit, pool
        self._of: list[tuple[str, tuple[DescribedPart, ...]]] = []
        self._answer: Callable[[], tuple[EffectModel | None, tuple[str, ...]]] | None = None

    def begin(self, model: EffectModel) -> None:
        """Begin with a model; with another one than before it is begun anew."""
        of = [(t.key, t.parts) for t in model.terms]
        if self._refit is None or of == self._of:
            return
        self._of = of
        self._answer = self._pool.beside(self._refit, model) if of else None

    @property
    def begun(self) -> bool:
        return self._answer is not None

    def answer(self) -> tuple[EffectModel | None, tuple[str, ...]]:
        """The model as it was fitted, and what is to be noted of it."""
        assert self._answer is not None, "asked of a refit that was begun"
        return self._answer()

"""A look at the evidence while a recording grows: what ``diagnose`` compares, without validation on data left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.calibration.sufficiency import options_for
from mbcacq.diagnosis.evidence.between_sets import alternatives_to
from mbcacq.diagnosis.evidence.candidate_evidence import evidence_of_candidates
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis, SetPrior
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.findings import EvidenceSummary
from mbcacq.diagnosis.model_fit import ModelFit, fit_model
from mbcacq.diagnosis.output.evidence_summary import summarized
from mbcacq.diagnosis.output.next_measurements import Elsewhere, elsewhere, errors_elsewhere
from mbcacq.diagnosis.output.sufficient_poses import excluded_share, limited_effects, says_too_little, weights
from mbcacq.diagnosis.problem import DiagnosisProblem, determined, prepare
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.diagnosis.verdict import verdict_of
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.solver import one_thread
from mbcacq.model.observations import Observations


@dataclass(frozen=True, eq=False)
class InterimEvidence:
    """One look at a recording. problem: linearised at its geometry; full: the model that the evidence speaks for."""

    problem: DiagnosisProblem
    full: ModelFit

    @property
    def reported(self) -> Hypothesis:
        """The set of effects that would be reported."""
        return reported_hypothesis(self.full.evidence)

    @cached_property
    def alternatives(self) -> list[Hypothesis]:
        """Sets that the evidence does not exclude in favour of the reported one, the most probable first; none without an effect."""
        fit = self.full.evidence
        return sorted((h for h, _ in alternatives_to(fit, self.reported)), key=lambda h: -h.log_posterior) if fit.significant else []

    @cached_property
    def limited(self) -> list[Member]:
        """Every candidate that was not found, at the largest size that is not excluded."""
        return limited_effects(self.problem, self.full, self._there)

    @property
    def excluded(self) -> float:
        """Share of the effects of the catalogue that are excluded at their typical size."""
        return excluded_share(self.limited)

    def hiding(self, limit_mm: float | None = None) -> dict[str, float]:
        """The effects that could hide at their typical size, as ``name:where``, and the share of the catalogue that each stands for.

        limit_mm: of an error of length that matters (95 % of lengths in the workspace); an effect whose largest possible size does less
        counts as excluded.
        """
        out: dict[str, float] = {}
        for weight, effect in zip(weights(self.limited), self.limited, strict=True):
            if effect.in_typical_sizes > 1.0 and self._matters(effect, limit_mm):
                out[effect.label] = out.get(effect.label, 0.0) + float(weight)
        return out

    def _matters(self, effect: Member, limit_mm: float | None) -> bool:
        error = None if limit_mm is None else errors_elsewhere(self._there, effect)[1]
        return limit_mm is None or error is None or error > limit_mm

    @cached_property
    def _there(self) -> Elsewhere:
        return elsewhere(self.problem.context)

    @cached_property
    def further_odds(self) -> float:
        """Posterior odds that there is one more effect of the catalogue beside the reported ones: its prior, with what the recording says
        for or against it at every location.
        """
        found = self.reported
        present = [m.candidate for m in found.members]
        if self.problem.in_part:
            larger = [h for h in self.full.evidence.hypotheses if h.labels > found.labels]
            return sum(float(np.exp(min(h.log_posterior - found.log_posterior, 0.0))) for h in larger)
        prior, there = SetPrior.of(self.problem.candidates, 1), {(c.name, c.where) for c in present}
        scored = evidence_of_candidates(found.conditioned, self.problem.candidates)
        logs = [
            log + prior.log_probability(m.candidate, present) for log, m in scored if (m.candidate.name, m.candidate.where) not in there
        ]
        return float(np.exp(min(np.logaddexp.reduce(logs), 50.0))) if logs else 0.0

    @cached_property
    def verdict(self) -> str:
        """What a diagnosis would say: 'none', 'explained', 'partly_explained', 'unexplained' or 'cannot_tell'."""
        found = verdict_of(self.full)
        too_little = found == "none" and says_too_little(self.limited, self.problem.linear.obs.n_poses) is not None
        return "cannot_tell" if too_little else found

    @cached_property
    def summary(self) -> EvidenceSummary:
        """The e-value, and the compared sets with coefficients and odds, as plain data."""
        return summarized(self.problem, self.full.evidence)


def weigh(recordings: Observations | Sequence[Observations], options: CalibrationOptions | None = None) -> InterimEvidence:
    """Weigh all explanations of a recording, or of several of one arm together, as ``diagnose`` does, and validate nothing.

    options: of the adjustment, as ``mbcacq.calibrate`` takes them. Raises CalibrationError if the data do not even determine the
    geometry.
    """
    first = recordings if isinstance(recordings, Observations) else recordings[0]
    with determined(recordings), one_thread():
        problem = prepare(recordings, options_for(first, options or CalibrationOptions()))
        return InterimEvidence(problem, fit_model(problem))

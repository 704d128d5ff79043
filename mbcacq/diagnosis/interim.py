"""A look at the evidence while a recording grows: what ``diagnose`` compares, without validation on data left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from threadpoolctl import threadpool_limits

from mbcacq.calibration.sufficiency import options_for
from mbcacq.description import with_likely_cause
from mbcacq.diagnosis.evidence.hypothesis import Hypothesis
from mbcacq.diagnosis.evidence.posterior import reported_hypothesis
from mbcacq.diagnosis.evidence_verdict import alternatives_to
from mbcacq.diagnosis.fitted_model import ModelFit
from mbcacq.diagnosis.model_fit import fit_model
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.output.evidence_summary import summarized
from mbcacq.diagnosis.output.next_measurements import SizedEffect, elsewhere
from mbcacq.diagnosis.output.sufficient_poses import excluded_share, limited_effects, says_too_little
from mbcacq.diagnosis.problem import DiagnosisProblem, prepare
from mbcacq.diagnosis.result import EvidenceSummary
from mbcacq.diagnosis.verdict import verdict_of
from mbcacq.errors import CalibrationError, ContradictionError
from mbcacq.estimation.options import CalibrationOptions
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
        return sorted(alternatives_to(fit, self.reported), key=lambda h: -h.log_posterior) if fit.significant else []

    @cached_property
    def limited(self) -> list[SizedEffect]:
        """Every candidate that was not found, at the largest size that is not excluded."""
        return limited_effects(self.problem, self.full, elsewhere(self.problem.context))

    @property
    def excluded(self) -> float:
        """Share of the effects of the catalogue that are excluded at their typical size."""
        return excluded_share(self.limited)

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

    options: of the adjustment, as ``mbcacq.calibrate`` takes them. Raises CalibrationError where the data do not even determine the
    geometry.
    """
    first = recordings if isinstance(recordings, Observations) else recordings[0]
    if first.n_poses < OPTIONS.fewest_poses:
        raise CalibrationError(f"{first.n_poses} poses are too few for a diagnosis: measure at least {OPTIONS.fewest_poses}")
    try:
        with threadpool_limits(1):
            problem = prepare(recordings, options_for(first, options or CalibrationOptions()))
            return InterimEvidence(problem, fit_model(problem))
    except ContradictionError as error:
        raise with_likely_cause(error, first) from error
    except np.linalg.LinAlgError as error:
        raise CalibrationError(f"the recording does not determine the cell ({error}): measure more stations and orientations") from error

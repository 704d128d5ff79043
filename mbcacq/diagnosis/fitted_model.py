"""What one pass over a recording has found."""

from __future__ import annotations

from dataclasses import dataclass

from mbcacq.diagnosis.evidence.evidence_fit import EvidenceFit
from mbcacq.diagnosis.nonparametric.evidence_map import MapCell
from mbcacq.diagnosis.nonparametric.random_effects import RandomEffectsModel
from mbcacq.diagnosis.nonparametric.residual_tests import ResidualTests
from mbcacq.diagnosis.search.candidate_scoring import CandidateScoring
from mbcacq.diagnosis.search.effect_set import EffectSet
from mbcacq.estimation.options import Noise


@dataclass(frozen=True)
class ModelFit:
    """What one pass has found.

    model: parametric effects. smooth: random effects, or None. cells: where the evidence map put them; empty where they stand at all
    locations. noise: estimated with both in place. geometry_only, conditioned: the projected problem under that noise, with geometry alone
    and conditioned on the parametric effects. evidence: the hypotheses that were compared, of a long recording on a part of it.
    residual_tests: of what parametric effects leave, of a long recording.
    """

    model: EffectSet
    smooth: RandomEffectsModel | None
    cells: tuple[MapCell, ...]
    noise: Noise
    geometry_only: CandidateScoring
    conditioned: CandidateScoring
    evidence: EvidenceFit
    residual_tests: ResidualTests | None = None

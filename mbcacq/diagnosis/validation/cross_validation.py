"""Cross-validation: whole stations (of one station: blocks of poses) are left out of every choice and fit, and predicted."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from mbcacq.diagnosis.model_fit import ModelFit
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS
from mbcacq.diagnosis.validation.folds import Refitted, RepeatedSearch, evaluated_folds
from mbcacq.diagnosis.validation.predictive_score import NO_CENTRES, HeldOutPrediction, PredictiveScore


@dataclass(frozen=True)
class CrossValidation:
    """Scores on data left out.

    Attributes
    ----------
    before, after : PredictiveScore
        Scores with geometry alone and with the model.
    split : str
        How the data were left out.
    without : dict[str, PredictiveScore]
        The model without one effect, by its name, or 'name:location' of one at several; without random effects at a location, by
        'unknown:LOCATION'.
    parametric : PredictiveScore or None
        Where random effects at all locations could explain what parametric ones do, the model without these; each effect's gain is then
        measured against it.
    refitted : dict[str, tuple[PredictiveScore, PredictiveScore]]
        Scores with and without effects that most searches without a part have not found: effects of all data, their coefficients fitted
        without the part.
    """

    before: PredictiveScore
    after: PredictiveScore
    split: str
    without: dict[str, PredictiveScore]
    parametric: PredictiveScore | None = None
    refitted: Refitted = field(default_factory=dict)

    def gain(self, key: str) -> float:
        """Share of the held-out excess over the noise floor that an effect removes."""
        whole = self.parametric or self.after
        return self._share(self.without.get(key, whole).chi2 - whole.chi2)

    @property
    def unmodelled_gain(self) -> float:
        """The same of all random effects together."""
        return self._share((self.parametric or self.before).chi2 - self.after.chi2)

    def gain_std(self, gain: float) -> float:
        """Standard deviation of a share that is removed.

        An effect that changes predictions by d standard deviations of the noise lowers chi2 by d'd - 2 d'e, where e is the
        remaining misfit: by d'd in the mean, with the standard deviation 2 |d|.
        """
        spread = max(self.after.chi2 / max(self.after.dof, 1), 1.0)
        return float(2.0 * np.sqrt(gain * spread / self._excess))

    def _share(self, chi2: float) -> float:
        return float(np.clip(chi2 / self._excess, 0, 1))

    @property
    def _excess(self) -> float:
        """chi2 of the geometry beyond noise, of which shares are stated; no less than the standard deviation that it has by noise alone."""
        return max(self.before.chi2 - self.before.dof, float(np.sqrt(2.0 * max(self.before.dof, 1))))


def validated(full: ModelFit, again: RepeatedSearch, progress: Callable[[str], None] = lambda text: None) -> CrossValidation:
    """The models of the search repeated without each fold, evaluated on the fold under the noise of the full data. progress: gets a
    sentence a fold."""
    keys, left_out = effect_keys(full), again.left_out
    if full.empty:  # nothing is claimed, there is nothing to validate
        plain = geometry_scores(full, left_out)
        return CrossValidation(plain, plain, again.how, {})

    def begun(done: int) -> None:
        if done < len(left_out):
            progress(f"searching again without each part of the data: part {done + 1} of {len(left_out)}")

    begun(0)
    results, refitted = evaluated_folds(full, again, keys, begun)
    without = {key: summed(a.without[key] for a in results) for key in keys}
    parametric = summed(a.parametric for a in results) if full.everywhere else None
    return CrossValidation(summed(a.before for a in results), summed(a.after for a in results), again.how, without, parametric, refitted)


def effect_keys(full: ModelFit) -> tuple[str, ...]:
    """Keys of what is left out of the model in turn."""
    names = full.model.names
    if full.everywhere:
        return names
    return (*names, *full.model.located_names, *dict.fromkeys(f"unknown:{g.location}" for g in full.random))


def geometry_scores(full: ModelFit, left_out: list[np.ndarray]) -> PredictiveScore:
    """Held-out score of geometry alone."""
    linear = full.geometry_only.linear
    pose, keep = linear.obs.pose, linear.keep
    masks = [test[pose] for test in left_out]
    return summed(HeldOutPrediction(linear, keep & ~test, keep & test, NO_EFFECTS, (), full.noise, every=test).score() for test in masks)


def summed(scores: Iterable[PredictiveScore]) -> PredictiveScore:
    return sum(scores, NO_CENTRES)

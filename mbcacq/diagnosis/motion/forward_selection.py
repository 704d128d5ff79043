"""Forward selection with backward elimination: which effects a group of channels needs.

Effects are selected one by one, by what they gain on held-out parts of the recordings; an effect that later ones
make needless is dropped again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import fdtrc

from mbcacq.diagnosis.motion.candidate_pool import CandidatePool
from mbcacq.diagnosis.motion.determination import UndeterminedEffect, resemblance
from mbcacq.diagnosis.motion.hyperparameters import estimate_hyperparameters
from mbcacq.diagnosis.motion.motion_model import AlternativeEffect, MotionModel, SelectedEffect, Variant
from mbcacq.diagnosis.motion.noise import sandwich_covariance
from mbcacq.diagnosis.motion.options import SMALLEST_EIGENVALUE
from mbcacq.effects import catalogue
from mbcacq.effects.motion_effect import MotionCandidate

TINY = 1e-300  # keeps a ratio of mean squares finite


@dataclass(frozen=True)
class SelectionStep:
    """The model before one effect more. mean_square: (J,) held out; prior_distance: None while a joint is not explained."""

    weights: np.ndarray
    chosen: np.ndarray
    normal: np.ndarray
    fold_normals: dict[int, np.ndarray]
    mean_square: np.ndarray
    prior_distance: float | None


@dataclass(frozen=True)
class HeldOutTrial:
    """A variant tried on held-out data. gain: in log likelihood, times two; share: of the held-out mean square of a joint that it removes;
    after: (J,) held-out mean square with it; by_prior: it also lets the arm be as it is described."""

    gain: float
    variant: Variant
    ids: np.ndarray
    x: np.ndarray
    after: np.ndarray
    share: float
    by_prior: bool


class ForwardSelection:
    """Selects effects for a model. start: (J,) held-out mean square of the model's base alone."""

    def __init__(self, model: MotionModel, candidates: list[MotionCandidate] | None = None) -> None:
        """candidates: what may be selected, None for the whole catalogue."""
        self.model = model
        self.pool = CandidatePool(model, catalogue.motion_candidates(model.group, model.runs) if candidates is None else candidates)
        chosen = model.chosen()
        self.start = model.held_out_mean_square(chosen, model.fold_normals(model.weights(chosen)))

    def run(self) -> None:
        """Start with what every arm may have, drop what is not needed; select effects until none gains enough, then drop those that became
        needless."""
        self._select_usual()
        while len(self.model.selected) < self.model.options.most_effects:
            self.pool.forget_step()
            chosen = self.model.chosen()
            weights = self.model.weights(chosen)
            variants = [*self.pool.open(), *self.pool.periodic(weights, chosen)]
            effect = self._best(self._step(weights, chosen), variants)
            if effect is None:
                break
            self.pool.forget_step()
            self._accept(effect)
        self.pool.forget_step()
        self._eliminate()

    def _select_usual(self) -> None:
        """Effects that hide each other (friction of all joints, a tool, a balancer) start together and are dropped one by one: selected one
        by one, each would have to stand out of the structure that the others leave."""
        step_chosen = self.model.chosen()
        before = self.model.held_out_mean_square(step_chosen, self.model.fold_normals(self.model.weights(step_chosen)))
        best: dict[tuple, Variant] = {}
        for variant in self.pool.open():
            if variant.candidate.usual and variant.candidate.location not in best:
                best[variant.candidate.location] = variant
        self.model.selected += [SelectedEffect(variant, 0.0, before, before) for variant in best.values()]
        self._choose_hypers()
        self._drop_indistinct(len(best))
        self._eliminate(least=0)
        for effect in self.model.selected:
            self.pool.extend(effect)
        self._record_gains()

    def _choose_hypers(self) -> None:
        """Give each selected effect the value of its hyper-parameter that fits best, one effect after the other."""
        for effect in self.model.selected:
            same = [v for v in self.pool.open_at(effect) if v.candidate is effect.candidate]
            if len(same) > 1:
                effect.variant = min(same, key=lambda v: self._deviance_with(effect, v))

    def _deviance_with(self, effect: SelectedEffect, variant: Variant) -> float:
        store, now = self.model.store, effect.variant
        effect.variant = variant
        chosen = self.model.chosen()
        weights = self.model.weights(chosen)
        effect.variant = now
        return -float(store.count.sum(axis=0) @ np.log(weights))

    def _drop_indistinct(self, tests: int) -> None:
        """Drop effects that are zero within their uncertainty or have the wrong sign, the least certain first."""
        while self.model.selected:
            chosen = self.model.chosen()
            weights = self.model.weights(chosen)
            x = self.model.store.solve(self.model.store.normal(weights), chosen)
            v = sandwich_covariance(self.model.store, weights, chosen, x)
            position = {int(c): i for i, c in enumerate(chosen)}
            p = [self._indistinct(e, x, v, position) * tests for e in self.model.selected]
            worst = int(np.argmax(p))
            if p[worst] < self.model.options.significance:
                return
            del self.model.selected[worst]

    def _indistinct(self, effect: SelectedEffect, x: np.ndarray, v: np.ndarray, position: dict[int, int]) -> float:
        at = [position[int(i)] for i in effect.variant.ids][: effect.candidate.tested]
        if effect.candidate.positive and x[at[0]] <= 0:
            return np.inf
        return self._wald(x[at], v[np.ix_(at, at)])

    def _record_gains(self) -> None:
        """p-values, and held-out mean squares without and with each effect that started: all others there."""
        model = self.model
        if not model.selected:
            return
        chosen = model.chosen()
        weights = model.weights(chosen)
        normals = model.fold_normals(weights)
        x = model.store.solve(model.store.normal(weights), chosen)
        v = sandwich_covariance(model.store, weights, chosen, x)
        position = {int(c): i for i, c in enumerate(chosen)}
        after = model.held_out_mean_square(chosen, normals)
        for effect in model.selected:
            effect.before, effect.after = self._mean_square_without(effect, weights, normals), after
            effect.p_value = min(self._indistinct(effect, x, v, position) * len(model.selected), 1.0)

    def _accept(self, effect: SelectedEffect) -> None:
        effect.variant = self.pool.keep(effect.variant)
        self.model.selected.append(effect)
        candidate = effect.candidate
        if (effect.variant.hyper is not None and (candidate.continuous or candidate.channel_delay)) or candidate.follows_load:
            estimate_hyperparameters(self.model)  # before another effect is looked for
        self.pool.extend(effect)

    def _step(self, weights: np.ndarray, chosen: np.ndarray) -> SelectionStep:
        model, options = self.model, self.model.options
        normals = model.fold_normals(weights)
        mean_square, normal = model.held_out_mean_square(chosen, normals), model.store.normal(weights)
        # Once the torque is explained, a deviation of the arm's parameters from their description is a mismatch too.
        explained = bool((mean_square < options.explained_chi2_dof * model.floor**2).all())
        distance = model.store.prior_distance(chosen, model.store.solve(normal, chosen)) if explained else None
        return SelectionStep(weights, chosen, normal, normals, mean_square, distance)

    def _best(self, step: SelectionStep, variants: list[Variant]) -> SelectedEffect | None:
        """The variant to select: of those that predict about as well, the one with the fewest coefficients, for it claims least."""
        strongest = _strongest_of_each_form(variants, self._fit_gains(step, variants))
        tried = strongest[: self.model.options.most_held_out_trials]
        trials = [t for t in (self._trial(step, v) for v in tried) if t is not None]
        trials.sort(key=lambda t: -t.gain)
        significant = self._significant(step, trials, len(strongest))
        if not significant:
            return None
        best, p = min(significant, key=lambda t: (len(t[0].variant.ids), -t[0].gain))
        return SelectedEffect(best.variant, min(p, 1.0), step.mean_square, best.after, self._alternatives(best, trials), best.by_prior)

    def _fit_gains(self, step: SelectionStep, variants: list[Variant]) -> list[float]:
        """Drop of the weighted squared error (per joint's mean square) by each variant, all else refitted."""
        N = step.normal
        (lower, _), scale = self.model.store.factor(N, step.chosen)
        B = solve_triangular(lower, scale[:, None] * N[step.chosen], lower=True, check_finite=False)  # (b, P + 1)
        out = []
        for v in variants:
            ids = np.concatenate([v.ids, [-1]])
            M = N[np.ix_(ids, ids)] - B[:, ids].T @ B[:, ids]
            k = len(v.ids)
            d = np.sqrt(np.maximum(np.diag(N)[v.ids], TINY))
            values, vectors = np.linalg.eigh(M[:k, :k] / np.outer(d, d))
            fine = values > SMALLEST_EIGENVALUE
            g = (vectors[:, fine].T @ (M[:k, k] / d)) / np.sqrt(values[fine])
            out.append(float(g @ g))
        return out

    def _trial(self, step: SelectionStep, variant: Variant) -> HeldOutTrial | None:
        """The variant on held-out data; None where its first coefficient has the wrong sign."""
        model, candidate = self.model, variant.candidate
        ids = np.concatenate([step.chosen, variant.ids])
        x = model.store.solve(step.normal, ids)
        if candidate.positive and x[len(step.chosen)] <= 0:
            return None
        before, after = step.mean_square, model.held_out_mean_square(ids, step.fold_normals)
        joints = model.joint_indices(candidate)
        gain = float((model.store.count.sum(axis=0) * np.log(np.maximum(before, TINY) / np.maximum(after, TINY))).sum())
        share = float(np.max(1.0 - after[joints] / np.maximum(before[joints], TINY)))
        prior_gain = 0.0 if step.prior_distance is None else step.prior_distance - model.store.prior_distance(ids, x)
        if prior_gain > model.options.least_prior_gain:
            return HeldOutTrial(gain + prior_gain, variant, ids, x, after, model.options.least_gain, True)
        return HeldOutTrial(gain, variant, ids, x, after, share, False)

    def _significant(self, step: SelectionStep, trials: list[HeldOutTrial], tests: int) -> list[tuple[HeldOutTrial, float]]:
        """Of trials in the order of their gain, those that are significant and about as good as the best, with their p-values."""
        options = self.model.options
        out: list[tuple[HeldOutTrial, float]] = []
        for t in trials:
            if t.gain <= 0 or (out and t.gain < (1.0 - options.equivalent_gain) * out[0][0].gain):
                break
            if t.share < options.least_gain:
                continue
            p = self._p_value(t.variant, t.ids, len(step.chosen)) * tests * t.variant.candidate.trials
            if p < options.significance:
                out.append((t, p))
        return out

    def _p_value(self, variant: Variant, ids: np.ndarray, first: int) -> float:
        """p-value that the tested coefficients of a variant, from ``first`` on, are zero: Wald test with segments of the recording as
        independent, weighted by the residual that the model with them leaves."""
        weights = self.model.weights(ids)
        x = self.model.store.solve(self.model.store.normal(weights), ids)
        last = first + len(ids[first:][: variant.candidate.tested])
        return self._wald(x[first:last], sandwich_covariance(self.model.store, weights, ids, x)[first:last, first:last])

    def _wald(self, c: np.ndarray, v: np.ndarray) -> float:
        """p-value that coefficients c with covariance v are zero (Hotelling: the covariance is estimated from the segments)."""
        k = len(c)
        d = np.sqrt(np.maximum(np.diag(v), TINY))
        values, vectors = np.linalg.eigh(v / np.outer(d, d))
        good = values > SMALLEST_EIGENVALUE
        wald = float((((vectors[:, good].T @ (c / d)) ** 2) / values[good]).sum())
        return float(fdtrc(k, max(len(self.model.store.segments) - k, 1), wald / k))

    def _alternatives(self, best: HeldOutTrial, trials: list[HeldOutTrial]) -> list[AlternativeEffect]:
        """Other effects on the same joints that would have gained a good part of what the best one gains."""
        options, own = self.model.options, best.variant.candidate
        return [
            AlternativeEffect(t.variant.candidate.name, t.variant.candidate.where, t.gain / best.gain)
            for t in trials
            if t.variant.candidate.location != own.location
            and set(t.variant.candidate.joints) & set(own.joints)
            and t.gain > options.alternative_gain * best.gain
        ][: options.most_alternatives]

    def _eliminate(self, least: int = 1) -> None:
        """Drop effects that the others have made needless, weakest first, until ``least`` remain."""
        options = self.model.options
        while len(self.model.selected) > least:
            losses = self._losses()
            if not losses:
                return
            loss, weakest = min(losses, key=lambda e: e[0])
            if loss >= options.elimination * options.least_gain:
                return
            self.model.selected.remove(weakest)
            if weakest.candidate.channel_delay:
                self.model.store.correct_delay(0.0)

    def drop_undetermined(self, effect: SelectedEffect, spread: np.ndarray) -> list[UndeterminedEffect]:
        """Drop an effect whose parameters are not determined. Returns it where the data ask for it: held out, its joints lose by that.

        spread: covariance of the coefficients of ``chosen()``, then of hyper-parameters.
        """
        model, candidate = self.model, effect.candidate
        other, correlation = resemblance(model, effect, spread)
        weights = model.weights(model.chosen())
        after = model.held_out_mean_square(model.chosen(), model.fold_normals(weights))
        model.selected.remove(effect)
        if candidate.channel_delay:
            model.store.correct_delay(0.0)
        before = model.held_out_mean_square(model.chosen(), model.fold_normals(model.weights(model.chosen())))
        needed = float(np.max(1.0 - after / np.maximum(before, TINY))) > model.options.least_gain
        if not needed or candidate.extends or correlation < model.options.not_separable:
            return []
        return [UndeterminedEffect(candidate.name, candidate.where, other, correlation)]

    def _losses(self) -> list[tuple[float, SelectedEffect]]:
        """For each effect that may be dropped, the share by which the held-out mean square of a joint grows without it."""
        model = self.model
        chosen = model.chosen()
        weights = model.weights(chosen)
        normals = model.fold_normals(weights)
        full = model.held_out_mean_square(chosen, normals)
        extended = {e.candidate.location for e in model.selected if e.candidate.extends}
        out = []
        for effect in model.selected:
            candidate = effect.candidate
            if effect.by_prior or (not candidate.extends and candidate.location in extended):
                continue
            without = self._mean_square_without(effect, weights, normals)
            out.append((float(np.max(1.0 - full / np.maximum(without, TINY))), effect))
        return out

    def _mean_square_without(self, effect: SelectedEffect, weights: np.ndarray, normals: dict[int, np.ndarray]) -> np.ndarray:
        model, chosen = self.model, self.model.chosen(without=effect)
        if not effect.candidate.channel_delay:
            return model.held_out_mean_square(chosen, normals)
        delay = model.store.delay
        model.store.correct_delay(0.0)
        out = model.held_out_mean_square(chosen, model.fold_normals(weights))
        model.store.correct_delay(delay)
        return out


def _strongest_of_each_form(variants: list[Variant], gains: list[float]) -> list[Variant]:
    """Of each form of an effect at a location the variant of the largest gain, ordered by gain."""
    best: dict[tuple, tuple[float, Variant]] = {}
    for gain, v in zip(gains, variants, strict=True):
        key = (v.candidate.location, v.candidate.form)
        if key not in best or gain > best[key][0]:
            best[key] = (gain, v)
    return [v for _, v in sorted(best.values(), key=lambda e: -e[0])]

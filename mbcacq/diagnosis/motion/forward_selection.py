"""Which effects a group of channels needs: taken one by one by what they gain on parts of the recording that took no part in the fit."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import solve_triangular
from scipy.stats import f as f_distribution
from scipy.stats import t as t_distribution

from mbcacq.diagnosis.motion.hyperparameters import refine
from mbcacq.diagnosis.motion.normal_store import NormalStore, third_difference_noise
from mbcacq.diagnosis.motion.spectrum import lines
from mbcacq.effects import motion as effects
from mbcacq.effects.motion.effect import ChannelGroup, MotionCandidate, MotionSignals

LEAST_GAIN = 0.02  # of the held-out mean square of a joint it acts on, as it is before the effect is taken
LEAST_RELIEF = 25.0  # squared sigmas by which an effect lets the arm be as it is described
UNDERSTOOD = 4.0  # chi2 per degree of freedom of a joint that is explained
SIGNIFICANCE = 1e-4  # after correction for the number of candidates
MOST_EFFECTS = 40
TRIED = 14  # candidates of the largest gain in the fit that are tried on held-out data
NEAR = 0.05  # of the best candidate's gain: closer is as good, and the one with fewer coefficients claims less


@dataclass
class Variant:
    """A candidate at one value of its hyper-parameter, with the numbers of its columns."""

    candidate: MotionCandidate
    hyper: float | None
    ids: np.ndarray


@dataclass
class SelectedEffect:
    variant: Variant
    p_value: float
    before: np.ndarray  # held-out mean square (J,) without it
    after: np.ndarray  # and with it
    rivals: list[dict] = field(default_factory=list)
    relieves: bool = False  # taken for what the arm's description had to be bent without it

    @property
    def candidate(self) -> MotionCandidate:
        return self.variant.candidate


def all_candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[MotionCandidate]:
    out = []
    for info in pkgutil.iter_modules(effects.__path__):
        module = importlib.import_module(f"{effects.__name__}.{info.name}")
        if hasattr(module, "candidates"):
            out += module.candidates(group, runs)
    return out


class ForwardSelection:
    """Forward choice with a look back: an effect that later ones make needless is dropped again."""

    def __init__(
        self,
        group: ChannelGroup,
        runs: tuple[MotionSignals, ...],
        held: int | None = None,
        candidates: Sequence[MotionCandidate] | None = None,
    ) -> None:
        """candidates: what may be chosen, None for the whole catalogue."""
        self.group, self.runs, self.ledger = group, runs, NormalStore(group, runs, held)
        self.pool = all_candidates(group, runs) if candidates is None else list(candidates)
        self.variants = [v for c in self.pool if not c.extends for v in self._variants(c)]
        self.mark = len(self.ledger.prior)
        self.floor = np.array([third_difference_noise(tuple(m[:, k] for m in group.mismatch)) for k in range(len(group.joints))])
        self.taken: list[SelectedEffect] = []
        self.start = self.held(self.weights(self.chosen()), self.chosen())
        if candidates is None or self.pool:
            self._choose()

    # what stands

    def chosen(self, *more: np.ndarray, without: SelectedEffect | None = None) -> np.ndarray:
        return np.concatenate([self.ledger.base, *(t.variant.ids for t in self.taken if t is not without), *more]).astype(int)

    def weights(self, chosen: np.ndarray) -> np.ndarray:
        """One over the mean square (J,) that the columns leave, joint by joint, found in turn."""
        ledger = self.ledger
        count = np.maximum(ledger.count.sum(axis=0), 1.0)
        weights = count / np.maximum(ledger.errors(np.zeros(0, dtype=int), np.zeros(0)).sum(axis=0), 1e-300)
        for _ in range(3):
            x = ledger.solve(ledger.normal(weights), chosen)
            weights = count / np.maximum(ledger.errors(chosen, x).sum(axis=0), 1e-300)
        return weights

    def _normals(self, weights: np.ndarray) -> dict[int, np.ndarray]:
        return {f: self.ledger.normal(weights, f) for f in self.ledger.folds}

    def held(self, weights: np.ndarray, chosen: np.ndarray, normals: dict | None = None) -> np.ndarray:
        return self.ledger.held_out(weights, chosen, normals or self._normals(weights))

    def mean_square(self, blocks: np.ndarray) -> np.ndarray:
        return blocks.sum(axis=0) / np.maximum(self.ledger.count.sum(axis=0), 1.0)

    def simulated(self, place: int, k: int, x: np.ndarray, position: dict[int, int], but: Collection[str], rotors: bool) -> np.ndarray:
        """What the links, the rotors if asked for and the effects, without those named in ``but``, add (T,) at the joint at ``place``
        in run number k; position: of x by column."""
        run, joint, group = self.runs[k], self.group.joints[place], self.group
        out = np.zeros(len(run.q))
        if group.base[k].shape[2]:
            own = self.ledger.base[len(group.joints) : None if rotors else -run.q.shape[1]]  # the last are the rotors
            out += group.base[k][:, place, : len(own)] @ x[[position[int(i)] for i in own]]
        for t in self.taken:
            if t.candidate.name not in but and joint in t.candidate.joints:
                out += t.candidate.columns(run, joint, t.variant.hyper) @ x[[position[int(i)] for i in t.variant.ids]]
        return out

    # choosing

    def _variants(self, candidate: MotionCandidate, hyper: np.ndarray | None = None) -> list[Variant]:
        values = candidate.hyper if hyper is None else hyper
        values = [None] if values is None else values
        if len(candidate.joints) > 1:
            return [Variant(candidate, h, self.ledger.candidate(candidate, h)) for h in values]
        joint = candidate.joints[0]
        place = self.group.joints.index(joint)
        columns = [self.ledger.columns(candidate, joint, h) for h in values]
        numbers = self.ledger.add_many([(place, c) for c in columns], [np.broadcast_to(candidate.sigma, c.shape[1]) for c in columns])
        return [Variant(candidate, h, ids) for h, ids in zip(values, numbers, strict=True)]

    def _choose(self) -> None:
        while len(self.taken) < MOST_EFFECTS:
            self.ledger.forget(self.mark)
            chosen = self.chosen()
            weights = self.weights(chosen)
            waves = self._waves(weights, chosen)
            normals = self._normals(weights)
            now = self.held(weights, chosen, normals)
            step = self._best(weights, chosen, normals, now, [*self._open(), *waves])
            if step is None:
                break
            taken, wave = step
            self.ledger.forget(self.mark)
            if wave:
                taken.variant.ids = self.ledger.candidate(taken.candidate, taken.variant.hyper)
            self.taken.append(taken)
            if taken.variant.hyper is not None and (taken.candidate.refine or taken.candidate.tuned) or taken.candidate.by_load:
                refine(self)  # before anything else is looked for beside it
            self._extend(taken)
            self.mark = len(self.ledger.prior)
        self.ledger.forget(self.mark)
        self._look_back()

    def _open(self) -> list[Variant]:
        there = {(t.candidate.place, t.candidate.tag) for t in self.taken}
        # One plain form of an effect at a place; its refinements come as extensions.
        plain = {t.candidate.place for t in self.taken if not t.candidate.extends}
        return [
            v
            for v in self.variants
            if (v.candidate.place, v.candidate.tag) not in there and (v.candidate.extends or v.candidate.place not in plain)
        ]

    def _extend(self, taken: SelectedEffect) -> None:
        if taken.candidate.extends:
            return
        for candidate in self.pool:
            if candidate.extends and candidate.place == taken.candidate.place:
                # What runs away with time can only be tested on another motion, not on other moments of the same.
                if candidate.follows and (taken.candidate.refine or len({p.run for p in self.ledger.pieces}) < 2):
                    continue
                self.variants += self._variants(candidate, np.array([taken.variant.hyper]) if candidate.follows else None)

    def _waves(self, weights: np.ndarray, chosen: np.ndarray) -> list[Variant]:
        x = self.ledger.solve(self.ledger.normal(weights), chosen)
        found = [
            c
            for place, joint in enumerate(self.group.joints)
            for c in lines(self.group, self.runs, joint, self.ledger.residual(place, chosen, x), self.ledger.training)
        ]
        middle = [float(c.hyper[len(c.hyper) // 2]) for c in found]
        numbers = self.ledger.add_many(
            [
                (self.group.joints.index(c.joints[0]), self.ledger.columns(c, c.joints[0], order))
                for c, order in zip(found, middle, strict=True)
            ],
            [np.full(2, np.inf)] * len(found),
        )
        return [Variant(c, order, ids) for c, order, ids in zip(found, middle, numbers, strict=True)]

    def _best(self, weights, chosen, normals, now, variants: list[Variant]) -> tuple[SelectedEffect, bool] | None:
        if not variants:
            return None
        gains = self._fit_gains(weights, chosen, variants)
        best: dict[tuple, tuple[float, Variant]] = {}
        for gain, v in zip(gains, variants, strict=True):
            key = (v.candidate.place, v.candidate.tag)
            if key not in best or gain > best[key][0]:
                best[key] = (gain, v)
        ranked = sorted(best.values(), key=lambda e: -e[0])[:TRIED]
        tests = len(best)
        standing, n = self.mean_square(now), self.ledger.count.sum(axis=0)
        trials, whole = [], self.ledger.normal(weights)
        # Once the torque is explained, what the description of the arm had to be bent for is a mismatch too.
        understood = bool((standing < UNDERSTOOD * self.floor**2).all())
        strain = self.ledger.strain(chosen, self.ledger.solve(whole, chosen)) if understood else 0.0
        for _, v in ranked:
            ids = np.concatenate([chosen, v.ids])
            x = self.ledger.solve(whole, ids)
            if v.candidate.positive and x[len(chosen)] <= 0:
                continue
            after = self.mean_square(self.held(weights, ids, normals))
            touched = [self.group.joints.index(j) for j in v.candidate.joints]
            gain = float((n * np.log(np.maximum(standing, 1e-300) / np.maximum(after, 1e-300))).sum())
            share = float(np.max(1.0 - after[touched] / np.maximum(standing[touched], 1e-300)))
            relief = strain - self.ledger.strain(ids, x) if understood else 0.0
            if relief > LEAST_RELIEF:
                gain, share = gain + relief, LEAST_GAIN
            trials.append((gain, v, ids, x, after, share, relief > LEAST_RELIEF))
        trials.sort(key=lambda t: -t[0])
        self.trials = trials
        good: list[tuple] = []
        for gain, v, ids, x, after, share, relieves in trials:
            if gain <= 0 or (good and gain < (1.0 - NEAR) * good[0][0]):
                break
            p = self._significance(weights, ids, x, len(chosen)) * tests * v.candidate.search if share >= LEAST_GAIN else 1.0
            if p < SIGNIFICANCE:
                good.append((gain, p, v, after, relieves))
        if not good:
            return None
        # Of those that predict about as well, the one with the fewest coefficients: it claims least.
        gain, p, v, after, relieves = min(good, key=lambda t: (len(t[2].ids), -t[0]))
        rivals = [
            {"name": t[1].candidate.name, "where": list(t[1].candidate.where), "gain": t[0] / gain}
            for t in trials
            if t[1].candidate.place != v.candidate.place and set(t[1].candidate.joints) & set(v.candidate.joints) and t[0] > 0.1 * gain
        ][:3]
        return SelectedEffect(v, min(p, 1.0), standing, after, rivals, relieves), not any(v is w for w in self.variants)

    def _fit_gains(self, weights: np.ndarray, chosen: np.ndarray, variants: list[Variant]) -> list[float]:
        """Drop of the weighted squared error (per joint's mean square) by each variant, all else refitted."""
        N = self.ledger.normal(weights)
        factor, scale = self.ledger.factor(N, chosen)
        B = solve_triangular(factor[0], scale[:, None] * N[chosen], lower=True, check_finite=False)  # (b, P + 1)
        out = []
        for v in variants:
            ids = np.concatenate([v.ids, [-1]])
            M = N[np.ix_(ids, ids)] - B[:, ids].T @ B[:, ids]
            k = len(v.ids)
            d = np.sqrt(np.maximum(np.diag(N)[v.ids], 1e-300))
            values, vectors = np.linalg.eigh(M[:k, :k] / np.outer(d, d))
            fine = values > 1e-8
            g = (vectors[:, fine].T @ (M[:k, k] / d)) / np.sqrt(values[fine])
            out.append(float(g @ g))
        return out

    def _significance(self, weights: np.ndarray, ids: np.ndarray, x: np.ndarray, first: int) -> float:
        """p-value that the coefficients from ``first`` on are zero: Wald test with pieces of the recording as independent witnesses."""
        v = self.ledger.covariance(weights, ids, x)[first:, first:]
        c, k = x[first:], len(ids) - first
        d = np.sqrt(np.maximum(np.diag(v), 1e-300))
        values, vectors = np.linalg.eigh(v / np.outer(d, d))
        good = values > 1e-8
        wald = float((((vectors[:, good].T @ (c / d)) ** 2) / values[good]).sum())
        return float(f_distribution.sf(wald / k, k, max(len(self.ledger.pieces) - k, 1)))

    def _look_back(self) -> None:
        """Drop what the others have made needless, weakest first."""
        while len(self.taken) > 1:
            chosen = self.chosen()
            weights = self.weights(chosen)
            normals = self._normals(weights)
            full = self.mean_square(self.held(weights, chosen, normals))
            losses = []
            for t in self.taken:
                if not t.candidate.extends and any(o.candidate.extends and o.candidate.place == t.candidate.place for o in self.taken):
                    continue
                without = self._held_without(t, weights, normals)
                if not t.relieves:
                    losses.append((float(np.max(1.0 - full / np.maximum(without, 1e-300))), t))
            if not losses:
                return
            least, weakest = min(losses, key=lambda e: e[0])
            if least >= 0.5 * LEAST_GAIN:
                return
            self.taken.remove(weakest)
            if weakest.candidate.tuned:
                self.ledger.retime(0.0)

    def _held_without(self, t: SelectedEffect, weights: np.ndarray, normals: dict[int, np.ndarray]) -> np.ndarray:
        if not t.candidate.tuned:
            return self.mean_square(self.held(weights, self.chosen(without=t), normals))
        delay = self.ledger.delay
        self.ledger.retime(0.0)
        out = self.mean_square(self.held(weights, self.chosen(without=t)))
        self.ledger.retime(delay)
        return out


def improvement_p(before: np.ndarray, after: np.ndarray) -> float:
    """One-sided p-value that the squared error of blocks (B,) became smaller: paired t-test of its square root."""
    gain = np.sqrt(before) - np.sqrt(after)
    spread = float(gain.std(ddof=1)) / np.sqrt(len(gain))
    return float(t_distribution.sf(gain.mean() / max(spread, 1e-300), len(gain) - 1))

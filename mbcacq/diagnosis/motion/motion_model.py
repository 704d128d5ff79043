"""The model of one group of channels: what the rigid arm explains, and the effects that were selected, with their columns."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.motion.noise import third_difference_noise
from mbcacq.diagnosis.motion.normal_store import NormalStore
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects.effect import Candidate
from mbcacq.effects.motion_effect import ChannelGroup, MotionSignals, available

LEAST_NOISE = 1e-6  # of a channel, as a share of its range: of simulated recordings without noise; encoders resolve a millionth of a turn


class MotionModel:
    """Columns of a group of channels and the effects selected among them. floor: (J,) standard deviation of the channels' noise."""

    def __init__(self, group: ChannelGroup, runs: tuple[MotionSignals, ...], held: int | None = None, learnt: int | None = None) -> None:
        """held, learnt: what takes part, as ``segments.segments`` has it."""
        self.group, self.runs = group, runs
        self.store = NormalStore(group, runs, held, learnt)
        self.load_error = self._with_load_error() if group.name == "q_joint" else np.zeros(0, dtype=int)
        self.selected: list[Member] = []
        joints = range(len(group.joints))
        measured = group.signal or group.mismatch  # where there is no delay to be found, there is no signal beside the mismatch
        ranges = np.array([np.ptp(np.concatenate([one[:, j] for one in measured])) for j in joints])
        self.least_noise = np.maximum(LEAST_NOISE * ranges, 1e-12)
        self.floor = np.maximum([third_difference_noise(tuple(m[:, j] for m in group.mismatch)) for j in joints], self.least_noise)

    # error of the load

    def _with_load_error(self) -> np.ndarray:
        """Numbers of the columns of the base by which the error of the load shows; zero as long as no effect passes it on."""
        if any(run.load_error is None for run in self.runs):
            return np.zeros(0, dtype=int)
        store, joints, r = self.store, list(range(len(self.group.joints))), available(self.runs[0].load_error).shape[2]
        numbers = store.add(joints, [np.zeros((len(store.matrix[j]), r)) for j in joints], np.ones(r))
        store.base = np.concatenate([store.base, numbers])
        return numbers

    # columns

    def columns(self, candidate: Candidate, joint: int, hyper: float | None) -> np.ndarray:
        """(Ttot, k) of a candidate at one joint."""
        return np.concatenate([candidate.rows.columns(run, joint, hyper) for run in self.runs])

    def joint_indices(self, candidate: Candidate) -> list[int]:
        return [self.group.index(joint) for joint in candidate.rows.joints]

    def add(self, candidate: Candidate, hyper: float | None) -> np.ndarray:
        """Add the columns of a candidate. Returns their numbers."""
        columns = [self.columns(candidate, joint, hyper) for joint in candidate.rows.joints]
        return self.store.add(self.joint_indices(candidate), columns, np.broadcast_to(candidate.rows.sigma, columns[0].shape[1]))

    def add_of_one_joint(self, candidates: list[Candidate], hypers: list[float | None]) -> list[Member]:
        """Candidates of one joint each, at one value of the hyper-parameter each."""
        joints = [candidate.rows.joints[0] for candidate in candidates]
        columns = [self.columns(c, joint, h) for c, joint, h in zip(candidates, joints, hypers, strict=True)]
        sigmas = [np.broadcast_to(c.rows.sigma, column.shape[1]) for c, column in zip(candidates, columns, strict=True)]
        numbers = self.store.add_many([(self.group.index(j), column) for j, column in zip(joints, columns, strict=True)], sigmas)
        return [Member(c, h, columns=ids) for c, h, ids in zip(candidates, hypers, numbers, strict=True)]

    def moved(self, effect: Member, hyper: float | None, columns: np.ndarray) -> Member:
        """A selected effect at another value of its hyper-parameter, whose columns have these numbers; it is selected in its place."""
        new = replace(effect, hyper=hyper, columns=columns)
        self.selected = [new if one is effect else one for one in self.selected]
        return new

    def set_runs(self, runs: tuple[MotionSignals, ...]) -> None:
        """The same runs with another load; columns of the effects that follow it are computed again."""
        self.runs = runs
        for effect in self.selected:
            if effect.candidate.rows.follows_load:
                columns = [self.columns(effect.candidate, j, effect.hyper) for j in effect.candidate.rows.joints]
                self.store.replace(effect.columns, self.joint_indices(effect.candidate), columns)

    # fit

    def chosen(self, without: Member | None = None) -> np.ndarray:
        """Numbers of the columns of the base and of the selected effects."""
        return np.concatenate([self.store.base, *(e.columns for e in self.selected if e is not without)]).astype(int)

    def weights(self, chosen: np.ndarray) -> np.ndarray:
        """Weight of a sample of each joint (J,). It is one over the mean square of the residual of these columns and over the number of
        samples that say the same. A residual with structure then does not outvote the knowledge of the arm. Weights and coefficients in
        turn."""
        store = self.store
        count = np.maximum(store.count.sum(axis=0), 1.0)
        least = count * self.least_noise**2
        weights = count / np.maximum(store.errors(np.zeros(0, dtype=int), np.zeros(0)), least)
        for _ in range(NUMBERS.weight_rounds):
            x = store.solve(store.normal(weights), chosen)
            weights = count / np.maximum(store.errors(chosen, x) * self._correlated_samples(chosen, x), least)
        return weights

    def colour(self, chosen: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """(J,) samples of the residual of these columns, fitted with these weights, that count as one."""
        return self._correlated_samples(chosen, self.store.solve(self.store.normal(weights), chosen))

    def _correlated_samples(self, chosen: np.ndarray, x: np.ndarray) -> np.ndarray:
        return self.store.correlated_samples(chosen, x, self.least_noise**2)

    def coefficients(self) -> np.ndarray:
        """Coefficients of ``chosen()``."""
        chosen = self.chosen()
        return self.store.solve(self.store.normal(self.weights(chosen)), chosen)

    def fold_normals(self, weights: np.ndarray) -> dict[int, np.ndarray]:
        """Normal matrices by the fold that is left out."""
        return {f: self.store.normal(weights, f) for f in self.store.folds}

    def held_out_mean_square(self, chosen: np.ndarray, normals: dict[int, np.ndarray]) -> np.ndarray:
        """(J,) of each fold predicted from the others."""
        return self.store.held_out(chosen, normals) / np.maximum(self.store.count.sum(axis=0), 1.0)

    # simulation

    def coefficients_of(self, effect: Member, x: np.ndarray) -> np.ndarray:
        """(k,) of a selected effect. x: coefficients of ``chosen()``."""
        return x[self.store.positions(self.chosen())[effect.columns]]

    def of_links(self, j: int, run: int, x: np.ndarray, rotors: bool = False) -> np.ndarray:
        """(T,) of the links, and of the rotors if asked for, at joint j of the group in one run. x: coefficients of ``chosen()``."""
        base = self.group.base[run]
        count = max(base.shape[2] - (0 if rotors else self.runs[run].q.shape[1]), 0)  # the last are the rotors
        first = len(self.group.joints)
        return base[:, j, :count] @ x[self.store.positions(self.chosen())[self.store.base[first : first + count]]]

    def columns_of(self, effect: Member, j: int, run: int) -> np.ndarray:
        """(T, k) of a selected effect at joint j of the group in one run; zero where it does not act."""
        signals, joint = self.runs[run], self.group.joints[j]
        if joint not in effect.candidate.rows.joints:
            return np.zeros((len(signals.q), effect.candidate.k))
        return effect.candidate.rows.columns(signals, joint, effect.hyper)

    def simulated(self, j: int, run: int, x: np.ndarray, without: Collection[str], rotors: bool) -> np.ndarray:
        """Sum (T,) of the links, of the rotors if asked for, and of the selected effects except those named in ``without``, at joint j of
        the group in one run. x: coefficients of ``chosen()``."""
        effects = [e for e in self.selected if e.candidate.name not in without and self.group.joints[j] in e.candidate.rows.joints]
        moved = (self.columns_of(e, j, run) @ self.coefficients_of(e, x) for e in effects)
        return sum(moved, self.of_links(j, run, x, rotors))

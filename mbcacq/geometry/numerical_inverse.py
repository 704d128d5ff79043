"""Numerical inverse kinematics of any serial chain: damped least squares from many starts, all starts of all targets at once.

Every start is a posture of a fixed table of random ones whose flange lies close to the target; starts go in rounds, and a target whose
last round brought no new branch is done. The damping follows the remaining error (Sugihara, "Solvability-Unconcerned Inverse Kinematics
by the Levenberg-Marquardt Method", 2011), so a step is short far away and near a singularity, and becomes Newton's close to a solution.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache, cached_property
from itertools import product

import numpy as np

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain

FULL_TURN = 2 * np.pi


@dataclass(frozen=True, kw_only=True)
class SolverOptions:
    """The numbers that tune the solver, each with its reason; ``benchmarks/speed.py inverse-kinematics`` measured them."""

    table_size: int = 20000  # random postures to start from; beyond, starts come no closer
    starts_per_round: int = 24  # enough for most branches of most targets at once
    rounds: int = 12  # at most; only a target without any solution, or with a new one in every round, needs them all
    quiet_rounds: int = 2  # without a new branch, after which a target is done
    iterations: int = 60  # of one start; most need ten
    damping: float = 0.3  # of a step, per unit of the squared error
    least_damping: float = 1e-12  # keeps the normal equations regular at a solution that is singular
    longest_step: float = 0.7  # rad a joint and iteration, or share of the reach: beyond, the linearisation says little
    solved: float = 2e-10  # remaining error, as a share of the reach, and in rad
    stalled: float = 0.98  # of the error ten iterations before: a start that improves less is given up
    same_branch: float = 0.02  # rad: positions of a six-axis arm that differ by less are one
    same_posture: float = 0.3  # rad: the same for an arm with more axes than a pose has freedoms, whose positions are a continuum
    most_branches: int = 24  # per target: a six-axis arm has at most 16, and of a continuum this is a fair sample


# For searches that try thousands of views and need only enough of them. On 40 targets of a Panda and of a CRX-10iA none was missed, and 6
# and 1 % of the branches, in 0.27 and 0.31 of the time.
SAMPLED = SolverOptions(rounds=3, quiet_rounds=1)


@dataclass(frozen=True)
class NumericalInverse:
    """Solver of one chain. limits: (n, 2) rad, mm of a prismatic joint. preferred: (n,), a posture from which every target is tried first,
    or None."""

    chain: Chain
    limits: np.ndarray
    options: SolverOptions = field(default_factory=SolverOptions)
    preferred: np.ndarray | None = None

    def branches(self, targets: np.ndarray) -> list[np.ndarray]:
        """Per target (P, 4, 4) the joint positions (k, n) rad within the limits that were found, none a full turn from another; k may be 0.

        An arm with more than six axes has a continuum, of which these are samples.
        """
        targets = np.asarray(targets, dtype=float).reshape(-1, 4, 4)
        found = [np.empty((0, self.chain.n)) for _ in targets]
        quiet = np.zeros(len(targets), dtype=int)
        order = self._starts(targets)
        reachable = np.linalg.norm(targets[:, :3, 3] - self._shoulder, axis=1) <= self._longest
        for number in range(self.options.rounds):
            open_ = np.flatnonzero(reachable & (quiet < self.options.quiet_rounds))
            if not len(open_):
                break
            first = number * self.options.starts_per_round
            start = self._table[0][order[open_, first : first + self.options.starts_per_round]]
            if number == 0 and self.preferred is not None:
                start = np.concatenate([np.broadcast_to(self.preferred, (len(open_), 1, self.chain.n)), start], axis=1)
            owner = np.repeat(open_, start.shape[1])
            q, solved = self._solve(targets[owner], start.reshape(-1, self.chain.n))
            for target in open_:
                known = found[target]
                found[target] = self._merged(known, q[solved & (owner == target)])
                new = len(found[target]) > len(known)
                # A target without any solution is given every start; one with solutions is done once no new ones come.
                quiet[target] = 0 if new or not len(known) else quiet[target] + 1
                if len(found[target]) >= self.options.most_branches:
                    quiet[target] = self.options.quiet_rounds
        return found

    def solutions(self, T_base_flange: np.ndarray, margin: float = 0.0) -> list[np.ndarray]:
        """Like ``branches``, with the full turns that the limits less ``margin`` (rad) allow, and nothing outside of those."""
        low, high = self.limits[:, 0] + margin, self.limits[:, 1] - margin
        return [with_full_turns(q, low, high, self.chain.prismatic) for q in self.branches(T_base_flange)]

    def nearest(self, T_base_flange: np.ndarray, q: np.ndarray) -> np.ndarray | None:
        """The joint position (n,) rad at a target (4, 4) to which the one start ``q`` (n,) leads, or None."""
        found, solved = self._solve(np.asarray(T_base_flange, dtype=float)[None], np.asarray(q, dtype=float)[None])
        return found[0] if solved[0] else None

    @cached_property
    def _reach(self) -> float:
        """mm by which errors of position are made comparable with errors of angle."""
        return max(float(np.hypot(self.chain.a, self.chain.d).sum()), 1.0)

    @cached_property
    def _shoulder(self) -> np.ndarray:
        return np.array([0.0, 0.0, self.chain.d[0]])

    @cached_property
    def _unit(self) -> np.ndarray:
        """(n,) by which steps of the joints are made comparable: 1 rad, and the reach of a prismatic joint."""
        return self.chain.by_kind(1.0, self._reach)

    @cached_property
    def _longest(self) -> float:
        """mm from the first axis' end to the flange, all links stretched."""
        if self.chain.sliding:
            return np.inf
        return float(abs(self.chain.a[0]) + np.hypot(self.chain.a, self.chain.d)[1:].sum()) * (1 + 1e-9)

    @cached_property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """Random postures (N, n) rad within the limits (a full turn at most), and where their flanges are (N, 12)."""
        low, high = self._narrow
        q = np.random.default_rng(0).uniform(low, high, (self.options.table_size, self.chain.n))
        return q, self._place(self.chain.flange(q))

    @cached_property
    def _narrow(self) -> tuple[np.ndarray, np.ndarray]:
        """Limits (n,), (n,) rad within which the solver works: the middle full turn of an axis that turns further."""
        low, high = self.limits.T
        middle = np.where((low <= -np.pi) & (high >= np.pi), 0.0, (low + high) / 2)
        wide = self._turns
        return np.where(wide, middle - np.pi, low), np.where(wide, middle + np.pi, high)

    @cached_property
    def _turns(self) -> np.ndarray:
        """(n,) bool: the axis may turn all the way round, so that no limit holds it."""
        return (self.limits[:, 1] - self.limits[:, 0] >= FULL_TURN) & ~self.chain.prismatic

    def _place(self, T: np.ndarray) -> np.ndarray:
        return np.concatenate([T[:, :3, 3] / self._reach, 0.25 * T[:, :3, :3].reshape(-1, 9)], axis=1)

    def _starts(self, targets: np.ndarray) -> np.ndarray:
        """(P, k) indices into the table, nearest first, k all that the rounds may use."""
        from scipy.spatial import KDTree

        count = min(self.options.rounds * self.options.starts_per_round, self.options.table_size)
        return np.atleast_2d(KDTree(self._table[1]).query(self._place(targets), k=count)[1])

    def _error(self, targets: np.ndarray, flange: np.ndarray) -> np.ndarray:
        """(P, 6): what is left to go, translation as a share of the reach, rotation in rad, base frame."""
        turn = targets[:, :3, :3] @ np.swapaxes(flange[:, :3, :3], 1, 2)
        return np.concatenate([(targets[:, :3, 3] - flange[:, :3, 3]) / self._reach, se3.rotation_log(turn)], axis=1)

    def _jacobian(self, frames: np.ndarray) -> np.ndarray:
        """(P, 6, n) of the flange's origin (share of the reach) and orientation (rad) by the controller's positions, in ``_unit``."""
        axis = self.chain.sign[:, None] * frames[:, :-1, :3, 2]
        lever = frames[:, -1:, :3, 3] - frames[:, :-1, :3, 3]
        out = np.concatenate([se3.cross(axis, lever) / self._reach, axis], axis=2)
        if self.chain.sliding:
            slides = list(self.chain.sliding)
            out[:, slides, :3], out[:, slides, 3:] = axis[:, slides], 0.0
        return self.chain.of_leaders(out).swapaxes(1, 2)

    def _solve(self, targets: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where each start (S, n) ends for its target (S, 4, 4), and which of them solved it."""
        options, q = self.options, start.copy()
        solved = np.zeros(len(q), dtype=bool)
        active, before = np.arange(len(q)), np.full(len(q), np.inf)
        for iteration in range(options.iterations):
            frames = self.chain.frames(q[active])
            error = self._error(targets[active], frames[:, -1])
            size = np.linalg.norm(error, axis=1)
            solved[active[np.abs(error).max(axis=1) < options.solved]] = True
            going = ~solved[active]
            if iteration % 10 == 9:
                going &= size < options.stalled * before[active]
                before[active] = size
            active, frames, error = active[going], frames[going], error[going]
            if not len(active):
                break
            q[active] = self._stepped(q[active], self._jacobian(frames), error)
        low, high = self._narrow
        q = np.where(self._turns, low + np.mod(q - low, FULL_TURN), np.clip(q, low, high))
        return q, solved

    def _stepped(self, q: np.ndarray, J: np.ndarray, error: np.ndarray) -> np.ndarray:
        """One damped step that ends within the limits; a joint that a limit holds leaves its share to the others."""
        step = self._damped(J, error)
        low, high = self._narrow
        held = ~self._turns & (((q <= low) & (step < 0)) | ((q >= high) & (step > 0)))
        if held.any():
            rows = held.any(axis=1)
            step[rows] = np.where(held[rows], 0.0, self._damped(np.where(held[rows, None], 0.0, J[rows]), error[rows]))
        longest = np.abs(step).max(axis=1, keepdims=True)
        moved = q + self._unit * (step * np.minimum(1.0, self.options.longest_step / np.maximum(longest, 1e-12)))
        return np.where(self._turns, moved, np.clip(moved, low, high))

    def _damped(self, J: np.ndarray, error: np.ndarray) -> np.ndarray:
        """(J' J + w I)^-1 J' e, by the smaller of the two equal forms."""
        damping = self.options.damping * np.sum(error**2, axis=1) + self.options.least_damping
        normal = J @ J.swapaxes(1, 2) + damping[:, None, None] * np.eye(6)
        return np.einsum("pij,pi->pj", J, np.linalg.solve(normal, error[..., None])[..., 0])

    def _merged(self, known: np.ndarray, more: np.ndarray) -> np.ndarray:
        """The known positions, and those of the others that differ from all of them."""
        nearest = self.options.same_posture if self.chain.n > 6 else self.options.same_branch
        for q in more:
            away = q - known
            away = np.where(self._turns, np.mod(away + np.pi, FULL_TURN) - np.pi, away) / self._unit
            if len(known) < self.options.most_branches and (np.abs(away).max(axis=1) > nearest).all():
                known = np.vstack([known, q])
        return known


def with_full_turns(q: np.ndarray, low: np.ndarray, high: np.ndarray, prismatic: np.ndarray | None = None) -> np.ndarray:
    """Joint positions (k, n) rad with every full turn of every joint that stays between ``low`` and ``high`` (n,); others are dropped.

    prismatic: (n,) bool, joints that do not turn.
    """
    if not len(q):
        return np.empty((0, q.shape[1]))
    first, last = np.ceil((low - q) / FULL_TURN - 1e-12), np.floor((high - q) / FULL_TURN + 1e-12)
    if prismatic is not None:
        first, last = (
            np.where(prismatic, np.where((low <= q) & (q <= high), 0.0, end), bound) for end, bound in ((1.0, first), (0.0, last))
        )
    q, first, last = (x[(last >= first).all(axis=1)] for x in (q, first, last))
    most = (last - first).max(axis=0, initial=0.0).astype(int)
    turns = _turns_up_to(tuple(most.tolist()))
    whole = first[:, None] + turns
    position, turn = np.nonzero((whole <= last[:, None]).all(axis=2))
    return np.clip(q[position] + FULL_TURN * whole[position, turn], low, high)


@cache
def _turns_up_to(most: tuple[int, ...]) -> np.ndarray:
    """(T, n) every number of further turns of each joint, up to its own most."""
    return np.array(list(product(*(range(m + 1) for m in most))), dtype=float)

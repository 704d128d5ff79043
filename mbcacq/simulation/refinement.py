"""The blocks of a MuJoCo model that recordings ask for, fitted to them in MuJoCo's own runs, and their error on held-out parts.

The residual is what was recorded minus what the model's sensors give, each channel by its standard deviation; its derivatives are
differences of runs. Blocks that a diagnosis named are fitted first. The others are scored against the residual that is left, all at
once and linearised; one is taken while its gain on held-out segments exceeds what its coordinates cost. What is not significant in the
end goes back to the model as it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtrc

from mbcacq.diagnosis.motion.noise import third_difference_noise
from mbcacq.diagnosis.motion.options import DEFAULTS
from mbcacq.diagnosis.motion.signals import rates
from mbcacq.model.trajectory import Trajectory
from mbcacq.simulation.model_match import ChannelError, ModelParameter
from mbcacq.simulation.mujoco_arm import (
    ENCODER,
    JOINT_SIDE,
    TORQUE,
    UNITS,
    MujocoArm,
    RecordedSignal,
    channels_of,
    recorded,
    roll_out,
    sensors_of,
    torque_along,
    with_sensors,
)
from mbcacq.simulation.parameters import Block

SEGMENT_S = 0.5  # residuals further apart count as independent
EDGE_S = 0.1  # after the first motion; and at both ends of a recording without new runs, where rates are not known
FIRST_MOTION_RAD = 5e-3  # after which friction no longer holds what it held before the recording
LEAST_GAIN, GAIN_PER_COORDINATE = 20.0, 4.0  # chi2 on held-out segments that a block must remove
SIGNIFICANCE = 1e-4  # of a block's difference from the model, over the number of blocks tried
TIME_BLOCKS = 6  # held-out parts of a single recording
ROUNDS = 3
EVALUATIONS = 10  # of one fit
FINE, COARSE = 1e-4, 3e-2  # relative change of chi2 at which a fit ends
SMOOTH_FLOOR = 1e-6  # least standard deviation of a channel, as a share of its range: of recordings without noise


@dataclass(frozen=True)
class FittedBlock:
    """x: (k,) coordinates; covariance: (k, k); p_value: of the difference from the model as it was given; named: by the diagnosis."""

    block: Block
    x: np.ndarray
    covariance: np.ndarray
    p_value: float
    named: bool

    def parameters(self) -> list[ModelParameter]:
        """The block in the model's own terms, with standard deviations."""
        before = dict.fromkeys(self.block.values(self.x), np.inf) if self.block.absent else self.block.values(self.block.start)
        after = self.block.values(self.x)
        slopes = []
        for k, h in enumerate(self.block.step):
            moved = self.block.values(self.x + h * np.eye(self.block.size)[k])
            slopes.append([(moved[name] - after[name]) / h for name in after])
        A = np.array(slopes)
        std = np.sqrt(np.maximum(np.einsum("ki,kl,li->i", A, self.covariance, A), 0.0))
        name, where = self.block.key
        return [
            ModelParameter(name, where, p, float(before[p]), float(after[p]), float(s), self.p_value, self.named)
            for p, s in zip(after, std, strict=True)
        ]


class RollOutFit:
    """Recordings and the blocks of a model fitted to them. runs: whether the model runs by its servos; else the torque along the recorded
    motion is compared."""

    def __init__(self, arm: MujocoArm, trajectories: Sequence[Trajectory], workers: int = 2) -> None:
        self.arm, self.trajectories, self.workers = arm, list(trajectories), workers
        self.runs = runs_by_servos(arm, trajectories)
        channels = channels_of(arm, trajectories)
        self.channels = channels if self.runs else [c for c in channels if c.signal != ENCODER]
        self.data = [recorded(t, self.channels) for t in self.trajectories]
        self.used = [_after_first_motion(t) if self.runs else _inside(t) for t in self.trajectories]
        self.noise = np.array([_noise([d[:, c] for d in self.data]) for c in range(len(self.channels))])
        self.sigma = self.noise.copy()
        self.blocks: list[Block] = []
        self.named: set[tuple[str, str]] = set()
        self.x: list[np.ndarray] = []
        self._linearised: tuple[Any, tuple[np.ndarray, np.ndarray]] | None = None

    # prediction

    def template(self, blocks: Sequence[Block]) -> Any:
        """The model with what the blocks need, at their start."""
        spec = self.arm.spec.copy()
        for block in blocks:
            block.prepare(spec)
        with_sensors(self.arm, spec, any(c.signal == JOINT_SIDE for c in self.channels))
        for block in blocks:
            if block.name == "sensor_delay":
                block.prepare(spec)
        return spec

    def residuals(self, blocks: Sequence[Block], many: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
        """(B, N, C) in units of the channels, the recordings one after the other."""
        template = self.template(blocks)
        specs = []
        for values in many:
            spec = template.copy()
            for block, x in zip(blocks, values, strict=True):
                block.apply(spec, x)
            specs.append(spec)
        return np.concatenate(
            [(d - self._predict(specs, t))[:, used] for t, d, used in zip(self.trajectories, self.data, self.used, strict=True)], axis=1
        )

    def _predict(self, specs: Sequence[Any], t: Trajectory) -> np.ndarray:
        if self.runs:
            return roll_out(self.arm, specs, t, self.channels, self.workers)
        return np.stack([along(self.arm, spec, t, self.channels) for spec in specs])

    def jacobian(self, blocks: Sequence[Block], x: Sequence[np.ndarray], wanted: Sequence[Block]) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N, C) at x, and their derivatives (N, C, k) by the coordinates of the wanted blocks."""
        many = [list(x)]
        for block in wanted:
            number = [b.key for b in blocks].index(block.key)
            for k in range(block.size):
                moved = [np.array(v) for v in x]
                moved[number][k] += block.step[k]
                many.append(moved)
        steps = np.concatenate([b.step for b in wanted]) if wanted else np.zeros(0)
        out = self.residuals(blocks, many)
        return out[0], np.moveaxis((out[1:] - out[0]) / steps[:, None, None], 0, 2)

    # fit

    def add(self, block: Block, named: bool) -> None:
        self.blocks.append(block)
        self.x.append(np.clip(block.first, block.lower, block.upper))
        if named:
            self.named.add(block.key)

    def fit(self, precisely: bool = True) -> None:
        """Least squares over the coordinates of all blocks, within their bounds; not precisely: as a start of further ones."""
        self._weigh()
        if not self.blocks:
            return
        sizes = np.cumsum([b.size for b in self.blocks])[:-1]
        start, sigma = (np.concatenate([getattr(b, name) for b in self.blocks]) for name in ("start", "sigma"))
        lower, upper = (np.concatenate([getattr(b, name) for b in self.blocks]) for name in ("lower", "upper"))

        def residual(x: np.ndarray) -> np.ndarray:
            r = self.residuals(self.blocks, [np.split(x, sizes)])[0] / self.sigma
            return np.concatenate([r.ravel(), (x - start) / sigma])

        def derivative(x: np.ndarray) -> np.ndarray:
            _, J = self.jacobian(self.blocks, np.split(x, sizes), self.blocks)
            return np.concatenate([(J / self.sigma[:, None]).reshape(-1, len(x)), np.diag(1 / sigma)])

        first = np.clip(np.concatenate(self.x), lower, upper)
        search: Any = least_squares  # its type stub knows no function as jac
        found = search(
            residual, first, derivative, (lower, upper), "dogbox", x_scale=sigma, ftol=FINE if precisely else COARSE, max_nfev=EVALUATIONS
        )
        self.x = [np.array(v) for v in np.split(found.x, sizes)]
        self._weigh()

    def _weigh(self) -> None:
        """Standard deviation of each channel: its noise, and what the model leaves above that."""
        r = self.residuals(self.blocks, [self.x])[0]
        self.sigma = np.maximum(self.noise, np.sqrt(np.mean(r**2, axis=0)))

    def select(self, candidates: Sequence[Block]) -> list[Block]:
        """The candidates that the residual asks for, in the order of their gain. They are not added."""
        free = [b for b in candidates if b.key not in {known.key for known in self.blocks}]
        if not free:
            return []
        together = [*self.blocks, *free]
        r, J = self.jacobian(together, [*self.x, *(b.start for b in free)], together)
        weighted, columns = (r / self.sigma).ravel(), (J / self.sigma[:, None]).reshape(-1, J.shape[2])
        columns = columns * np.concatenate([b.sigma for b in together])  # unit prior
        everything = np.concatenate([columns, weighted[:, None]], axis=1)
        odd = (self._segments() % 2 == 1).repeat(len(self.channels))
        halves = [everything[half].T @ everything[half] for half in (odd, ~odd)]
        ends = np.cumsum([b.size for b in together])
        number = {b.key: np.arange(end - b.size, end) for b, end in zip(together, ends, strict=True)}
        chosen = [i for b in self.blocks for i in number[b.key]]
        picked: list[Block] = []
        while free:
            gains = [_gain(halves, chosen, number[b.key]) for b in free]
            excess = [held - LEAST_GAIN - GAIN_PER_COORDINATE * b.size for (held, _), b in zip(gains, free, strict=True)]
            best = int(np.argmax(excess))
            if excess[best] <= 0 or gains[best][1] * len(candidates) > SIGNIFICANCE:
                break
            picked.append(free.pop(best))
            chosen += list(number[picked[-1].key])
            free = [b for b in free if not _overlap(b, picked[-1])]
        return picked

    def prune(self) -> bool:
        """Take back the blocks that do not differ significantly from the model as it was given. Returns whether there were any."""
        weak = [f.block.key for f in self.fitted() if not f.p_value * max(len(self.blocks), 1) < SIGNIFICANCE]
        keep = [i for i, b in enumerate(self.blocks) if b.key not in weak]
        self.blocks, self.x = [self.blocks[i] for i in keep], [self.x[i] for i in keep]
        return bool(weak)

    def fitted(self) -> list[FittedBlock]:
        """The blocks with their uncertainties: the larger of those of white noise and of segments (sandwich)."""
        if not self.blocks:
            return []
        weighted, columns, prior = self._linear()
        H = np.linalg.inv(columns.T @ columns + prior)
        segments = self._segments().repeat(len(self.channels))
        scores = np.zeros((int(segments.max()) + 1, columns.shape[1]))
        np.add.at(scores, segments, weighted[:, None] * columns)
        robust = H @ (scores.T @ scores + prior) @ H
        grow = np.sqrt(np.maximum(np.diag(robust) / np.diag(H), 1.0))
        covariance = H * np.outer(grow, grow)
        out, end = [], 0
        for block, x in zip(self.blocks, self.x, strict=True):
            own = slice(end, end := end + block.size)
            C = covariance[own, own]
            # What was absent is compared with none: a gear's compliance with zero.
            known = x[:1] if block.absent else x - block.start
            wald = float(known @ np.linalg.solve(C[: len(known), : len(known)], known))
            out.append(FittedBlock(block, x, C, float(chdtrc(len(known), wald)), block.key in self.named))
        return out

    # held-out parts

    def errors(self) -> list[ChannelError]:
        """Each recording (of a single one, each block of time) predicted by blocks fitted to the others, linearised at the fit."""
        before = np.sqrt(np.mean(self.residuals([], [[]])[0] ** 2, axis=0))
        held = self.residuals(self.blocks, [self.x])[0]
        if self.blocks:
            weighted, columns, prior = self._linear()
            part = self._parts().repeat(len(self.channels))
            out = weighted.copy()
            pull = prior @ (np.concatenate([b.start for b in self.blocks]) - np.concatenate(self.x))
            for number in np.unique(part):
                rest, own = part != number, part == number
                A = columns[rest].T @ columns[rest] + prior
                step = np.linalg.solve(A, columns[rest].T @ weighted[rest] + pull)
                out[own] = weighted[own] - columns[own] @ step
            held = out.reshape(-1, len(self.channels)) * self.sigma
        after = np.sqrt(np.mean(held**2, axis=0))
        rows = zip(self.channels, self.noise, before, after, strict=True)
        return [ChannelError(c.name, UNITS[c.signal], float(n), float(b), float(a)) for c, n, b, a in rows]

    def errors_of(self, spec: Any) -> list[ChannelError]:
        """The errors of the model as it was given, and of another one with the same sensors."""
        found = np.concatenate(
            [(d - self._predict([spec], t)[0])[u] for t, d, u in zip(self.trajectories, self.data, self.used, strict=True)]
        )
        return [replace(e, after=float(np.sqrt(np.mean(r**2)))) for e, r in zip(self.errors(), found.T, strict=True)]

    def _linear(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Weighted residual (M,), its change with each coordinate (M, k) with the sign of a regression, and the prior's precision."""
        at = tuple(b.key for b in self.blocks), np.concatenate(self.x).tobytes(), self.sigma.tobytes()
        if self._linearised is None or self._linearised[0] != at:
            self._linearised = at, self.jacobian(self.blocks, self.x, self.blocks)
        r, J = self._linearised[1]
        k = J.shape[2]
        prior = np.diag(1.0 / np.concatenate([b.sigma for b in self.blocks]) ** 2)
        return (r / self.sigma).ravel(), -(J / self.sigma[:, None]).reshape(-1, k), prior

    def _segments(self) -> np.ndarray:
        """(N,) number of the half second of each sample."""
        out, first = [], 0
        for t, used in zip(self.trajectories, self.used, strict=True):
            number = ((t.time_s - t.time_s[0])[used] // SEGMENT_S).astype(int) + first
            out.append(number)
            first = int(number.max()) + 1
        return np.concatenate(out)

    def _parts(self) -> np.ndarray:
        if len(self.trajectories) > 1:
            return np.concatenate([np.full(int(u.sum()), k) for k, u in enumerate(self.used)])
        n = int(self.used[0].sum())
        return np.arange(n) * TIME_BLOCKS // n

    def model(self) -> Any:
        """The model with what was found: mujoco.MjSpec."""
        spec = self.template(self.blocks)
        for block, x in zip(self.blocks, self.x, strict=True):
            block.apply(spec, x)
        return spec


def runs_by_servos(arm: MujocoArm, trajectories: Sequence[Trajectory]) -> bool:
    """Whether new runs can be made: every axis has a servo, every recording its set points."""
    return arm.servos is not None and all(t.q_set is not None and np.isfinite(t.q_set).all() for t in trajectories)


def along(arm: MujocoArm, spec: Any, t: Trajectory, channels: Sequence[RecordedSignal]) -> np.ndarray:
    """(T, C) torques and joint-side angles of a model along the recorded motion, each as late as its sensor."""
    step = float(np.median(np.diff(t.time_s)))
    q, qd, qdd = (rates(t.q, step, d, DEFAULTS.rate_window_s) for d in (0, 1, 2))
    torque, windup = torque_along(arm, spec, q, qd, qdd, step)
    signals = {TORQUE: torque, JOINT_SIDE: t.q + windup}
    out = np.stack([signals[c.signal][:, c.axis] for c in channels], axis=1)
    for k, c in enumerate(channels):
        delay = max((float(getattr(s, "delay", 0.0)) for s in sensors_of(spec, c.signal, arm.joints[c.axis])), default=0.0)
        out[:, k] = np.interp(t.time_s - delay, t.time_s, out[:, k])
    return out


def _after_first_motion(t: Trajectory) -> np.ndarray:
    """(T,) whether every axis that moves at all has turned far enough: where friction held it before is not recorded. At most a third of
    the recording is left out."""
    step = float(np.median(np.diff(t.time_s)))
    far = np.abs(t.q - t.q[0]) > FIRST_MOTION_RAD
    begins = [int(np.argmax(column)) for column in far.T if column.any()]
    first = min(max(begins, default=0) + int(EDGE_S / step), len(t.q) // 3)
    return np.arange(len(t.q)) >= first


def _inside(t: Trajectory) -> np.ndarray:
    """(T,) away from both ends."""
    edge = int(EDGE_S / float(np.median(np.diff(t.time_s))))
    number = np.arange(len(t.q))
    return (number >= edge) & (number < len(t.q) - edge)


def _noise(signals: list[np.ndarray]) -> float:
    return max(third_difference_noise(tuple(signals)), SMOOTH_FLOOR * float(np.ptp(np.concatenate(signals))), 1e-12)


def _gain(halves: list[np.ndarray], chosen: list[int], own: np.ndarray) -> tuple[float, float]:
    """Chi2 that columns remove in the half that did not fit them, with those chosen refitted; and their p-value in all data. halves: the
    products of all columns and, last, of the residual, by the two halves of the data. Columns count with a unit prior."""
    ids = [*chosen, *own]
    one, other = halves
    both = one + other
    held = sum(_remaining(fit, rest, chosen) - _remaining(fit, rest, ids) for fit, rest in ((one, other), (other, one)))
    gain = _remaining(both, both, chosen) - _remaining(both, both, ids)
    return held, float(chdtrc(len(own), max(gain, 0.0)))


def _remaining(fit: np.ndarray, rest: np.ndarray, ids: list[int]) -> float:
    """Squares that these columns, fitted in one part, leave in another."""
    x = np.linalg.solve(fit[np.ix_(ids, ids)] + np.eye(len(ids)), fit[ids, -1]) if ids else np.zeros(0)
    return float(rest[-1, -1] - 2 * x @ rest[ids, -1] + x @ rest[np.ix_(ids, ids)] @ x)


def _overlap(one: Block, other: Block) -> bool:
    """Both set the same attributes of the model."""
    return one.name == other.name == "actuator_delay"

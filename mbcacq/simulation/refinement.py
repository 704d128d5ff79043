"""The blocks of a MuJoCo model that recordings ask for, fitted to them in MuJoCo's own runs, and their error on held-out parts.

Blocks that a diagnosis named are fitted first, each channel weighted by its standard deviation. The others are scored against the residual
that is left, all at once and linearised; one is taken while its gain on held-out segments exceeds what its coordinates cost. Parameters
that are not significant in the end go back to the model as it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtrc

from mbcacq.model.trajectory import Trajectory
from mbcacq.simulation.model_match import ChannelError, ModelParameter
from mbcacq.simulation.model_residual import ModelResidual
from mbcacq.simulation.mujoco_arm import UNITS, MujocoArm
from mbcacq.simulation.parameters import Block

LEAST_GAIN, GAIN_PER_COORDINATE = 20.0, 4.0  # chi2 on held-out segments that a block must remove
SIGNIFICANCE = 1e-4  # of a block's difference from the model, over the number of blocks tried
ROUNDS = 3
EVALUATIONS = 10  # of one fit
FINE, COARSE = 1e-4, 3e-2  # relative change of chi2 at which a fit ends


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
        return [
            ModelParameter(*self.block.key, p, float(before[p]), float(after[p]), float(s), self.p_value, named=self.named)
            for p, s in zip(after, std, strict=True)
        ]


class RollOutFit(ModelResidual):
    """Recordings and the blocks of a model fitted to them."""

    def __init__(self, arm: MujocoArm, trajectories: Sequence[Trajectory], workers: int = 2) -> None:
        super().__init__(arm, trajectories, workers)
        self.sigma = self.noise.copy()
        self.blocks: list[Block] = []
        self.named: set[tuple[str, str]] = set()
        self.x: list[np.ndarray] = []
        self._linearised: tuple[Any, tuple[np.ndarray, np.ndarray]] | None = None

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
        odd = (self.segments() % 2 == 1).repeat(len(self.channels))
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
            if picked[-1].name == "actuator_delay":  # all of them set the same attributes of the model
                free = [b for b in free if b.name != "actuator_delay"]
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
        segments = self.segments().repeat(len(self.channels))
        scores = np.zeros((int(segments.max()) + 1, columns.shape[1]))
        np.add.at(scores, segments, weighted[:, None] * columns)
        robust = H @ (scores.T @ scores + prior) @ H
        grow = np.sqrt(np.maximum(np.diag(robust) / np.diag(H), 1.0))
        covariance = H * np.outer(grow, grow)
        out, end = [], 0
        for block, x in zip(self.blocks, self.x, strict=True):
            own = slice(end, end := end + block.size)
            C = covariance[own, own]
            # An absent part is compared with none: a gear's compliance with zero.
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
            part = self.parts().repeat(len(self.channels))
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
            [(d - self.predict([spec], t)[0])[u] for t, d, u in zip(self.trajectories, self.data, self.used, strict=True)]
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

    def model(self) -> Any:
        """The model with what was found: mujoco.MjSpec."""
        spec = self.template(self.blocks)
        for block, x in zip(self.blocks, self.x, strict=True):
            block.apply(spec, x)
        return spec


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

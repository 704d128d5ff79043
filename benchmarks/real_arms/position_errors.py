"""Position errors of a recording of a real arm, fitted by models of growing size."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.estimation.adjustment import adjust_recording
from mbcacq.estimation.linear_problem import LinearProblem
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.recording import load_observations

SETS = ("ur5-tracker", "ur10-tracker-c", "ur10-tracker-a", "panda-sockets", "iiwa14-sockets")
MOST_POSES = 4000
TRAINED_NOISE = {3: np.full(3, 0.03), 6: np.r_[np.full(3, 0.03), np.full(3, 3e-5)]}  # mm and rad: weights of position and orientation
WIND_UP, BENDING, SHIFT, DRIFT = 1e-3, 5e-4, 0.03, 0.3  # prior sigmas at the largest load: rad, rad, mm, mm
GEAR, GEAR_FALLS = 5e-4, 15.0  # prior sigma (rad) of a periodic error, halved at this order


@dataclass(frozen=True)
class Design:
    """columns: (M, R, z) of geometry and effects; sigma: (z,) of their priors; groups: the columns of each effect."""

    columns: np.ndarray
    sigma: np.ndarray
    groups: list[slice]


class Data:
    """A set linearised at its geometric fit, with the columns of the candidate effects."""

    def __init__(self, folder: Path):
        obs = load_observations(folder)
        if obs.n_poses > MOST_POSES:
            chosen = np.zeros(obs.n_poses, bool)
            chosen[np.random.default_rng(0).permutation(obs.n_poses)[:MOST_POSES]] = True
            obs = obs.select(chosen)
        adjusted = adjust_recording(obs, CalibrationOptions(refuse=False))
        self.obs, self.linear = obs, LinearProblem.of(obs, adjusted.state, adjusted.used)
        self.context = Context(obs, adjusted.state, self.linear.prediction)
        self.n = self.context.n
        self.places = len(np.unique(obs.station)) > 1

    @property
    def time(self) -> np.ndarray:
        return self.obs.time_s if self.obs.time_s is not None else np.arange(self.obs.n_poses, dtype=float)

    def block(self, keys, functions: np.ndarray, sigma) -> tuple[np.ndarray, np.ndarray]:
        """Columns (M, R, k) of functions (P, f) at each of the keys, and their prior sigmas (k,)."""
        rows = functions[self.obs.pose][:, None, :]
        columns = np.concatenate([self.linear.unit(*key)[:, :, None] * rows for key in keys], axis=2)
        return columns, np.tile(np.broadcast_to(np.asarray(sigma, float), functions.shape[1:]), len(keys))

    # Effects; ``who`` (P,) says from which pose a covariate is taken: each its own, or shuffled for a control ---------------

    def compliance(self, who):
        torque = self.context.gravity_torque[who]
        scale = np.abs(torque).max()
        return [self.block([("joint", i, 0)], torque[:, i : i + 1] / scale, WIND_UP) for i in range(1, self.n)]

    def bending(self, who):
        out = []
        for i in range(self.n):
            moment = self.context.gravity_moment(i)[who]
            out.append(self.block([("frame", i, 3 + c) for c in range(3)], moment / max(np.abs(moment).max(), 1e-9), BENDING))
        return out

    def periodic(self, lowest: int, highest: int):
        def columns(who):
            k = np.arange(lowest, highest + 1)
            sigma = np.tile(GEAR / (1 + (k / GEAR_FALLS) ** 2), 2)
            phase = self.obs.q[who][:, :, None] * k
            F = np.concatenate([np.sin(phase), np.cos(phase)], axis=2)
            return [self.block([("joint", i, 0)], F[:, i], sigma) for i in range(self.n)]

        return columns

    def strain_wave(self, who):
        """Once and twice per turn of the wave generator of gears of ratio 80 and 120."""
        out = []
        for order in (80, 120, 160, 240):
            phase = order * self.obs.q[who]
            F = np.stack([np.sin(phase), np.cos(phase)], axis=2)
            out += [self.block([("joint", i, 0)], F[:, i], GEAR / 5) for i in range(self.n)]
        return out

    def wobble(self, who):
        """Displacement of each axis in all directions, once and twice per turn: a bearing that runs out."""
        out = []
        for i in range(self.n):
            phase = self.obs.q[who][:, i, None] * np.array([1, 2])
            F = np.concatenate([np.sin(phase), np.cos(phase)], axis=1)
            out.append(self.block([("frame", i + 1, c) for c in range(3)], F, SHIFT))
            out.append(self.block([("frame", i + 1, 3 + c) for c in range(3)], F, SHIFT / 300))
        return out

    def base_drift(self, who):
        time = self.time
        F = np.cos(np.pi * ((time[who] - time.min()) / np.ptp(time))[:, None] * np.arange(1, 9))
        for T in self.obs.temperatures.values():
            F = np.column_stack([F, (T[who] - T.mean()) / max(T.std(), 1e-9)])
        return [
            self.block([("frame", 0, c) for c in range(3)], F, DRIFT),
            self.block([("frame", 0, 3 + c) for c in range(3)], F, DRIFT / 1000),
        ]

    def ladder(self) -> list[tuple[str, list]]:
        steps = [("geometry", None), ("joint elasticity under gravity", self.compliance)]
        if self.places:
            return [
                *steps,
                ("bending of the links", self.bending),
                ("orders 80, 120, 160, 240", self.strain_wave),
                ("periodic errors, orders 1..4", self.periodic(1, 4)),
            ]
        return [
            *steps,
            ("bending of the links", self.bending),
            ("periodic errors, orders 1..4", self.periodic(1, 4)),
            ("orders 5..12", self.periodic(5, 12)),
            ("orders 13..32", self.periodic(13, 32)),
            ("orders 33..60", self.periodic(33, 60)),
            ("axes running out", self.wobble),
            ("instrument or base drifting", self.base_drift),
        ]

    def design(self, blocks) -> Design:
        """Geometry and effects side by side."""
        columns, sigma = self.linear.nuisance()
        ends = np.cumsum([columns.shape[2], *(len(s) for _, s in blocks)])
        return Design(
            np.concatenate([columns, *(b for b, _ in blocks)], axis=2),
            np.concatenate([sigma, *(s for _, s in blocks)]),
            [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)],
        )

    def rows(self, design: Design, use: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weighted columns of the centres in use (M,), each in its prior sigma, and their weighted residuals."""
        weight = 1 / TRAINED_NOISE[self.linear.width]
        A = (design.columns[use] * weight[:, None]).reshape(-1, len(design.sigma)) * design.sigma
        return A, (self.linear.residual[use] * weight).reshape(-1)

    def fitted(self, design: Design, use: np.ndarray) -> np.ndarray:
        """Coefficients (z,) of geometry and effects by the centres in use (M,)."""
        return design.sigma * ridge(*self.rows(design, use), design.groups)

    # Judging ----------------------------------------------------------------------------------------------------------

    def held_out(self, blocks, tests: list[np.ndarray]) -> np.ndarray:
        """Residual (M, R) of every centre while its poses were held out; NaN where none of the tests covers it."""
        linear, design = self.linear, self.design(blocks)
        out = np.full(linear.residual.shape, np.nan)
        for test in tests:
            here = test[self.obs.pose]
            out[here] = linear.residual[here] - design.columns[here] @ self.fitted(design, linear.keep & ~here)
        return out

    def distance(self, left: np.ndarray) -> np.ndarray:
        """(M,) mm; where a place was left out, from the mean of each of its points in the base frame (the place itself is unknown)."""
        if not self.places:
            return np.linalg.norm(left[:, :3], axis=1)
        left = np.einsum("mij,mj->mi", self.linear.prediction.T_base_scanner[self.obs.pose, :3, :3], left[:, :3])
        point = self.obs.station[self.obs.pose] * 1000 + self.obs.ball
        _, inverse = np.unique(point, return_inverse=True)
        mean = np.stack([np.bincount(inverse, left[:, c]) / np.bincount(inverse) for c in range(3)], axis=1)
        return np.linalg.norm(left - mean[inverse], axis=1)

    def splits(self) -> dict[str, list[np.ndarray]]:
        P = self.obs.n_poses
        if self.places:
            return {"place": [self.obs.station == k for k in np.unique(self.obs.station)]}
        chance = np.zeros(P, bool)
        chance[np.random.default_rng(0).permutation(P)[: int(0.3 * P)]] = True
        piece = np.argsort(np.argsort(self.time, kind="stable"), kind="stable") * 12 // P
        return {"random": [chance], "block": [piece % 4 == k for k in range(4)]}


def ridge(A: np.ndarray, r: np.ndarray, groups: list[slice], rounds: int = 12) -> np.ndarray:
    """Least squares with u ~ N(0, size^2) in each group; sizes and noise by MacKay's fixed point on these rows alone."""
    S, b, square = A.T @ A, A.T @ r, float(r @ r)
    size2, noise2 = np.ones(len(b)), 1.0
    for _ in range(rounds if groups else 1):
        root = np.sqrt(size2)
        normal = S * np.outer(root, root) / noise2
        inverse = np.linalg.inv(normal + np.eye(len(b)))
        u = root * (inverse @ (root * b)) / noise2
        known = 1 - np.diag(inverse)
        noise2 = max(square - 2 * float(u @ b) + float(u @ S @ u), 1e-9) / max(len(r) - known.sum(), 0.1 * len(r))
        for g in groups:
            determined = max(float(known[g].sum()), 1e-6)
            size2[g] = np.clip(float(np.sum(u[g] ** 2)) / determined, 1e-8, 1e2) if determined > 1e-4 else 1e-8
    return u


def rms(distance: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(distance**2)))

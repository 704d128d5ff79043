"""Real recordings: which physics geometry leaves out, one effect after another, on held-out data.

    python benchmarks/real_data.py [SET ...] [--data ../shared/data] [--out docs/data]

For each set a ladder of models is fitted on training poses and judged on left-out ones: 30 % at random, then contiguous
blocks (or whole places). Every step refits the geometry together with all effects so far. The last rows are controls: the
same effects with their covariates taken from shuffled poses. Writes NAME.json and NAME.svg per set.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np  # noqa: E402
from real_data_figures import bars, spectrum  # noqa: E402

from mbcacq.effects.context import Context  # noqa: E402
from mbcacq.estimation.adjustment import adjust_recording  # noqa: E402
from mbcacq.estimation.linear_problem import LinearProblem  # noqa: E402
from mbcacq.estimation.options import CalibrationOptions  # noqa: E402
from mbcacq.recording import load_observations  # noqa: E402

SETS = ("ur5-tracker", "ur10-tracker-c", "ur10-tracker-a", "panda-sockets", "iiwa14-sockets")
MOST_POSES = 4000
TRAINED_NOISE = {3: np.full(3, 0.03), 6: np.r_[np.full(3, 0.03), np.full(3, 3e-5)]}  # mm and rad: weights of position and orientation
WIND_UP, BENDING, SHIFT, DRIFT = 1e-3, 5e-4, 0.03, 0.3  # prior sigmas at the largest load: rad, rad, mm, mm
GEAR, GEAR_FALLS = 5e-4, 15.0  # prior sigma (rad) of a periodic error, halved at this order


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

    # Judging ----------------------------------------------------------------------------------------------------------

    def held_out(self, blocks, tests: list[np.ndarray]) -> np.ndarray:
        """Residual (M, R) of every centre while its poses were held out; NaN where none of the tests covers it."""
        linear, pose = self.linear, self.obs.pose
        columns, sigma = linear.nuisance()
        X = np.concatenate([columns, *(b for b, _ in blocks)], axis=2)
        sigma = np.concatenate([sigma, *(s for _, s in blocks)])
        weight = 1 / TRAINED_NOISE[linear.width]
        ends = np.cumsum([columns.shape[2], *(len(s) for _, s in blocks)])
        groups = [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)]
        out = np.full(linear.residual.shape, np.nan)
        for test in tests:
            train = linear.keep & ~test[pose]
            A = (X[train] * weight[:, None]).reshape(-1, len(sigma)) * sigma
            here = test[pose]
            out[here] = linear.residual[here] - X[here] @ (sigma * ridge(A, (linear.residual[train] * weight).reshape(-1), groups))
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


def run(folder: Path, out: Path) -> None:
    data = Data(folder)
    splits, rows, blocks, used = data.splits(), [], [], []
    own, shuffled = np.arange(data.obs.n_poses), np.random.default_rng(1).permutation(data.obs.n_poses)

    def judged(step: str, with_blocks) -> None:
        row = {"model": step, "coefficients": int(sum(len(s) for _, s in with_blocks))}
        for name, tests in splits.items():
            d = data.distance(data.held_out(with_blocks, tests))
            row[name] = rms(d)
            if data.places:
                row["each"] = [rms(d[data.obs.station[data.obs.pose] == k]) for k in np.unique(data.obs.station)]
        rows.append(row)
        print(f"{folder.name:16s} {step:34s} {row['coefficients']:5d}  " + "  ".join(f"{s} {row[s]:.4f}" for s in splits), flush=True)

    for step, effect in data.ladder():
        if effect is not None:
            blocks = blocks + effect(own)
            used.append((step, effect))
        judged(("+ " if used else "") + step, blocks)
    control = []
    for _, effect in used:
        control += effect(shuffled)
    judged("control: all, covariates shuffled", control)
    result = {"set": folder.name, "poses": data.obs.n_poses, "set_aside": int((~data.linear.keep).sum()), "rows": rows}
    found = lines(data)
    clear = {joint: [v for v in values if v[1] > 5 * v[2]] for joint, values in found.items()}
    result["lines"] = {joint: sorted(values, key=lambda v: -v[1] / v[2])[:12] for joint, values in clear.items()}
    picture = spectrum(found, f"{folder.name}: periodic error of each joint, one order at a time")
    (out / f"{folder.name}-lines.svg").write_text(picture, encoding="utf-8")
    (out / f"{folder.name}.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    picture = bars(rows, list(splits), f"{folder.name}: residual on held-out poses (mm rms)")
    (out / f"{folder.name}.svg").write_text(picture, encoding="utf-8")


def lines(data: Data) -> dict[str, list[list[float]]]:
    """Joint -> [order, amplitude (arc seconds), its std], one order at a time beside geometry, elasticity and the other joints."""
    own, linear, n = np.arange(data.obs.n_poses), data.linear, data.n
    rest = [] if data.places else data.periodic(1, 32)(own)
    elastic = data.compliance(own) + (data.bending(own) if data.places else [])
    weight = 1 / TRAINED_NOISE[linear.width]
    columns, sigma = linear.nuisance()
    orders = np.arange(1.0, 281.0)
    out = {}
    for i in range(n):
        blocks = elastic + [b for j, b in enumerate(rest) if j != i]
        X = np.concatenate([columns, *(b for b, _ in blocks)], axis=2)
        A = (X[linear.keep] * weight[:, None]).reshape(-1, X.shape[2]) * np.concatenate([sigma, *(s for _, s in blocks)])
        r = (linear.residual[linear.keep] * weight).reshape(-1)
        lower = np.linalg.cholesky(A.T @ A + np.eye(A.shape[1]))
        left = r - A @ np.linalg.solve(lower.T, np.linalg.solve(lower, A.T @ r))
        turn = (linear.unit("joint", i, 0)[linear.keep] * weight).reshape(-1, 1)
        phase = np.repeat(data.obs.q[data.obs.pose[linear.keep], i], linear.width)[:, None] * orders
        table = []
        for F in (np.sin(phase), np.cos(phase)):
            F *= turn
            gone = np.linalg.solve(lower, A.T @ F)
            table.append((left @ F, np.sum(F**2, axis=0) - np.sum(gone**2, axis=0)))
        amplitude = np.hypot(table[0][0] / table[0][1], table[1][0] / table[1][1])
        std = np.sqrt(np.mean(left**2) / np.mean([table[0][1], table[1][1]], axis=0))
        seconds = np.degrees(3600.0)
        rows = np.column_stack([amplitude, std]) * seconds
        out[f"A{i + 1}"] = [[int(k), *(round(float(v), 2) for v in row)] for k, row in zip(orders, rows, strict=True)]
    return out


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", default=SETS)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--out", type=Path, default=Path("docs/data"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name in arguments.sets:
        run(arguments.data / name, arguments.out)

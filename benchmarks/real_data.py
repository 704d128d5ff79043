"""Recordings of real arms: a ladder of models, two campaigns beside each other, single figures of docs/data.

    python benchmarks/real_data.py ladder [SET ...] [--data ../shared/data] [--out docs/data]
    python benchmarks/real_data.py campaigns
    python benchmarks/real_data.py checks

Each command says more with --help.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import bench
import numpy as np
from bench import COLOURS, DATA, curve, option, rect, svg, text
from threadpoolctl import threadpool_limits

from mbcacq.diagnosis.model_fit import fit_model, fit_part, prepare
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS
from mbcacq.diagnosis.validation import predictive_score
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


def ladder(given: argparse.Namespace) -> None:
    """Which physics geometry leaves out, one effect after another, on held-out data.

    For each set a ladder of models is fitted on training poses and judged on left-out ones: 30 % at random, then contiguous
    blocks (or whole places). Every step refits the geometry together with all effects so far. The last rows are controls: the
    same effects with their covariates taken from shuffled poses. Writes NAME.json and NAME.svg per set.
    """
    given.out.mkdir(parents=True, exist_ok=True)
    for name in given.sets:
        run(given.data / name, given.out)


SLOWEST, FASTEST = 5, 32


def whole(data: Data) -> tuple[np.ndarray, int, np.ndarray]:
    """Coefficients (z,) of geometry, elasticity, bending and orders 1..32 on all poses; how many are geometry's; their columns."""
    own, linear = np.arange(data.obs.n_poses), data.linear
    columns, sigma = linear.nuisance()
    blocks = data.compliance(own) + data.bending(own) + data.periodic(1, FASTEST)(own)
    X = np.concatenate([columns, *(b for b, _ in blocks)], axis=2)
    sigma = np.concatenate([sigma, *(s for _, s in blocks)])
    ends = np.cumsum([columns.shape[2], *(len(s) for _, s in blocks)])
    weight = 1 / TRAINED_NOISE[linear.width]
    A = (X[linear.keep] * weight[:, None]).reshape(-1, len(sigma)) * sigma
    u = ridge(A, (linear.residual[linear.keep] * weight).reshape(-1), [slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True)])
    return sigma * u, columns.shape[2], X


def coefficients(data: Data) -> np.ndarray:
    """(n, 2, 32) sine and cosine coefficients (rad) of every joint."""
    return whole(data)[0][-2 * FASTEST * data.n :].reshape(data.n, 2, FASTEST)


def joint_error(values: np.ndarray, angle: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Arc seconds at the angles (rad), orders SLOWEST..FASTEST only, free of a straight line over those seen."""
    k = np.arange(SLOWEST, FASTEST + 1)
    y = np.sin(np.outer(angle, k)) @ values[0, SLOWEST - 1 :] + np.cos(np.outer(angle, k)) @ values[1, SLOWEST - 1 :]
    return np.degrees(y - np.polyval(np.polyfit(angle[seen], y[seen], 1), angle)) * 3600


def visits(q: np.ndarray, angle: np.ndarray, within: float = np.radians(1.0)) -> np.ndarray:
    """How many poses came within a degree of each angle."""
    ordered = np.sort(q)
    return np.searchsorted(ordered, angle + within) - np.searchsorted(ordered, angle - within)


def size(values: np.ndarray) -> float:
    return round(float(values.std()), 1)


def campaigns(given: argparse.Namespace) -> None:
    """Do two campaigns with one robot, fitted independently, find the same error of a joint where they used the same angles?

    Both UR10 series are fitted with geometry, elasticity, bending and orders 1..32. Compared is the sum of orders 5..32 (slower
    ones trade with geometry) over the angles that both visited (five poses within a degree). Writes ur10-campaigns.json and
    ur10-campaigns.svg.
    """
    sets = [Data(given.data / f"ur10-tracker-{s}") for s in "ac"]
    found = [coefficients(d) for d in sets]
    table, parts, y = [], [text(10, 20, "Error of a joint in its own angle, found in series A (blue) and in series C (orange)", 14)], 40.0
    for i in range(sets[0].n):
        ranges = np.array([np.quantile(d.obs.q[:, i], [0.02, 0.98]) for d in sets])
        low, high = ranges[:, 0].max(), ranges[:, 1].min()
        if high - low < np.radians(20):
            table.append({"joint": f"A{i + 1}", "overlap_deg": None})
            continue
        angle = np.linspace(low, high, 500)
        seen = np.all([visits(d.obs.q[:, i], angle) >= 5 for d in sets], axis=0)
        a, c = (joint_error(f[i], angle, seen) for f in found)
        overlap = [round(float(v), 1) for v in np.degrees([low, high])]
        row = {"joint": f"A{i + 1}", "overlap_deg": overlap, "visited_by_both": round(float(seen.mean()), 2)}
        row |= {"a_arcsec": size(a[seen]), "c_arcsec": size(c[seen]), "difference_arcsec": size((a - c)[seen])}
        row["correlation"] = round(float(np.corrcoef(a[seen], c[seen])[0, 1]), 3)
        table.append(row)
        print(row)
        a, c = np.where(seen, a, np.nan), np.where(seen, c, np.nan)
        scale = 45 / np.nanmax(np.abs([a, c]))
        for values, colour in zip((a, c), COLOURS, strict=True):
            for part in np.split(np.arange(500), np.flatnonzero(np.diff(seen.astype(int))) + 1):
                if seen[part[0]]:
                    parts.append(curve(((60 + 640 * j / 499, y + 50 - scale * values[j]) for j in part), colour, 1.2))
        start, end = row["overlap_deg"]
        sizes = f"rms {row['a_arcsec']} and {row['c_arcsec']} arc seconds, difference {row['difference_arcsec']}"
        parts += [text(10, y + 54, row["joint"], 13), text(60, y + 112, f"{start:.0f} deg", 10)]
        parts += [text(700, y + 112, f"{end:.0f} deg", 10, "end"), text(380, y + 112, sizes, 10, "middle")]
        y += 125
    (given.out / "ur10-campaigns.json").write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    (given.out / "ur10-campaigns.svg").write_text(svg(720, y, parts), encoding="utf-8")


def diagnosed(folder: Path) -> None:
    """Noise and the point of linearisation are those of all poses; effects, orders and coefficients are found in training."""
    obs = load_observations(folder)
    setup = prepare(obs)
    full = fit_model(setup)
    linear = full.geometry_only.linear
    third = np.random.default_rng(0).permutation(obs.n_poses) < int(0.3 * obs.n_poses)
    stations = np.unique(obs.station)
    for test in [obs.station == k for k in stations] if len(stations) > 1 else [third]:
        train, judged = linear.keep & ~test[obs.pose], test[obs.pose]
        model, random = fit_part(setup.with_linearization(linear), train, bool(full.random))
        before = predictive_score.held_out_score(linear, train, judged, NO_EFFECTS, (), full.noise)
        after = predictive_score.held_out_score(linear, train, judged, model, random, full.noise)
        print(f"diagnosis of {folder.name}, {int(judged.sum())} centres left out: {before.rms:.4f} -> {after.rms:.4f} mm", flush=True)


def single(data: Data, orders: list[int], who: np.ndarray | None = None) -> list:
    """Columns of these orders at every joint."""
    q, out = data.obs.q if who is None else data.obs.q[who], []
    for k in orders:
        F = np.stack([np.sin(k * q), np.cos(k * q)], axis=2)
        out += [data.block([("joint", i, 0)], F[:, i], 1e-4) for i in range(data.n)]
    return out


def panda(folder: Path) -> None:
    data = Data(folder)
    own, shuffled = np.arange(data.obs.n_poses), np.random.default_rng(1).permutation(data.obs.n_poses)
    base, found, places = data.compliance(own) + data.bending(own), [80, 120, 160, 240], data.splits()["place"]
    tries = {"none": [], "80 120 160 240": single(data, found), "the same, shuffled": single(data, found, shuffled)}
    tries |= {" ".join(map(str, k)): single(data, k) for k in ([120, 240], [80, 160], [100], [101], [200], [202], [77, 113, 151, 229])}
    for name, extra in tries.items():
        print(f"panda, elasticity, bending and orders {name}: {rms(data.distance(data.held_out(base + extra, places))):.4f} mm")


def ur10(folder: Path) -> None:
    a, c = (Data(folder / f"ur10-tracker-{s}") for s in "ac")
    for name, data in (("A", a), ("C", c)):
        own, tests = np.arange(data.obs.n_poses), data.splits()["random"]
        base = data.compliance(own) + data.bending(own) + data.periodic(1, 60)(own)
        for orders in ([], [128], [117], [101, 202]):
            left = data.held_out(base + single(data, orders), tests)
            print(f"UR10 series {name}, orders to 60 and {orders}: {rms(data.distance(left)):.4f} mm")
    own = np.arange(c.obs.n_poses)
    for name, blocks in (("geometry", []), ("orders to 32", c.compliance(own) + c.bending(own) + c.periodic(1, 32)(own))):
        left = c.held_out(blocks, c.splits()["random"])[:, 3:]
        print(f"UR10 series C, orientation, {name}: {np.degrees(np.sqrt(np.nanmean(np.sum(left**2, axis=1)))) * 3600:.0f} arc seconds")
    (own_a, k_a, X_a), (own_c, k_c, X_c) = whole(a), whole(c)
    for name, data, X, other, start in (("A on C", c, X_c[:, :, k_c:], own_a, k_a), ("C on A", a, X_a[:, :, k_a:], own_c, k_c)):
        measured, tests = data.linear.residual, data.splits()["random"]
        before = rms(data.distance(data.held_out([], tests)))
        data.linear = data.linear.with_residual(measured - X @ other[start:])
        print(f"UR10, model of {name}: {before:.4f} -> {rms(data.distance(data.held_out([], tests))):.4f} mm")
        data.linear = data.linear.with_residual(measured)


def checks(given: argparse.Namespace) -> None:
    """The single figures in docs/data that no ladder shows.

    1. The diagnosis' own search, repeated on training poses only and judged on the rest (random 30 %, or each place in turn).
    2. Panda: other orders in the place of those found. 3. UR10: what single orders beyond 60 are worth, the orientation, and the
    whole model of one campaign tried on the other.
    """
    for name in ("ur5-tracker", "panda-sockets", "ur10-tracker-c"):
        diagnosed(given.data / name)
    panda(given.data / "panda-sockets")
    ur10(given.data)


def bars(rows: list[dict], series: list[str], title: str) -> str:
    """Horizontal bars, one group a row; rows: {"model": text, SERIES: number}."""
    left, width, bar = 300, 420, 11
    group = bar * len(series) + 8
    top = max(row[s] for row in rows for s in series)
    out = [text(10, 20, title, 14)]
    for j, name in enumerate(series):
        out += [rect(left + 130 * j, 30, 10, 10, COLOURS[j]), text(left + 14 + 130 * j, 39, f"left out by {name}")]
    y = 52
    for row in rows:
        out.append(text(left - 6, y + group / 2, row["model"], anchor="end"))
        for j, name in enumerate(series):
            size = width * row[name] / top
            out += [rect(left, y + bar * j, size, bar - 1, COLOURS[j]), text(left + size + 4, y + bar * j + 9, f"{row[name]:.3f}", 10)]
        y += group
    return svg(left + width + 60, y + 10, out)


def spectrum(lines: dict[str, list[list[float]]], title: str) -> str:
    """One strip a joint: amplitude (arc seconds) over order; grey where below three standard deviations."""
    left, width, strip = 60, 640, 78
    highest = max(line[0] for joint in lines.values() for line in joint)
    out, y = [text(10, 20, title, 14)], 34
    for joint, values in lines.items():
        clear = [v for v in values if v[1] > 3 * v[2]]
        top = max((v[1] for v in clear), default=1.0)
        floor = y + strip - 14
        out += [text(10, y + strip / 2, joint, 13), text(left - 4, y + 10, f'{top:.0f}"', 10, "end")]
        out.append(rect(left, floor, width, 1, "#888888"))
        for order, amplitude, std in values:
            size = (strip - 20) * min(amplitude / top, 1.0)
            colour = COLOURS[0] if amplitude > 3 * std else "#cccccc"
            out.append(rect(left + width * order / (highest + 1), floor - size, max(width / highest * 0.7, 1.5), size, colour))
        y += strip
    step = 20 if highest > 60 else 4
    out += [text(left + width * k / (highest + 1), y + 2, str(k), 10, "middle") for k in range(step, highest + 1, step)]
    out.append(text(left + width / 2, y + 18, "periods per turn", 11, "middle"))
    return svg(left + width + 20, y + 26, out)


if __name__ == "__main__":
    OUT = option("--out", type=Path, default=Path("docs/data"))
    with threadpool_limits(1):
        bench.main(
            __doc__,
            {
                "ladder": (ladder, [option("sets", nargs="*", default=SETS), DATA, OUT]),
                "campaigns": (campaigns, [DATA, OUT]),
                "checks": (checks, [DATA]),
            },
        )

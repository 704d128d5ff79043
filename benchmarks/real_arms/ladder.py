"""A ladder of models, and the lines of each joint's errors, as pictures."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from bench import COLOURS, rect, svg, text
from threadpoolctl import threadpool_limits

from real_arms.position_errors import TRAINED_NOISE, Data, rms


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
    orders = np.arange(1.0, 281.0)
    out = {}
    for i in range(n):
        blocks = elastic + [b for j, b in enumerate(rest) if j != i]
        A, r = data.rows(data.design(blocks), linear.keep)
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


@threadpool_limits.wrap(limits=1)
def ladder(given: argparse.Namespace) -> None:
    """Which physics geometry leaves out, one effect after another, on held-out data.

    For each set a ladder of models is fitted on training poses and judged on left-out ones: 30 % at random, then contiguous
    blocks (or whole places). Every step refits the geometry together with all effects so far. The last rows are controls: the
    same effects with their covariates taken from shuffled poses. Writes NAME.json and NAME.svg per set.
    """
    given.out.mkdir(parents=True, exist_ok=True)
    for name in given.sets:
        run(given.data / name, given.out)


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

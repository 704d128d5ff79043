"""Two campaigns on one arm beside each other."""

from __future__ import annotations

import argparse
import json

import numpy as np
from bench import COLOURS, curve, svg, text
from threadpoolctl import threadpool_limits

from real_arms.position_errors import Data

SLOWEST, FASTEST = 5, 32


def whole(data: Data) -> tuple[np.ndarray, int, np.ndarray]:
    """Coefficients (z,) of geometry, elasticity, bending and orders 1..32 on all poses; how many are geometry's; their columns."""
    own = np.arange(data.obs.n_poses)
    blocks = data.compliance(own) + data.bending(own) + data.periodic(1, FASTEST)(own)
    design = data.design(blocks)
    return data.fitted(design, data.linear.keep), design.groups[0].start, design.columns


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


@threadpool_limits.wrap(limits=1)
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

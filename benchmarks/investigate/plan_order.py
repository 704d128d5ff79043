"""What the first poses of an ordered plan show, against all of another plan."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import bench
import numpy as np
from detection_power import least_gain
from threadpoolctl import threadpool_limits

from mbcacq.challenge.run import Challenger
from mbcacq.challenge.scenarios import Scenario, catalogued
from mbcacq.challenge.simulated_cells import observe
from mbcacq.challenge.strength import Gauge
from mbcacq.diagnosis.interim import weigh
from mbcacq.effects.catalogue import declaration
from mbcacq.plan import PlannedPose

KEPT = Path("runs") / "plan-order-benchmark"
FIRST = 64
MULTIPLE = 2.5


def tried(old: Challenger, new: Challenger, first: Gauge, name: str, seed: int) -> dict:
    """Information and what is found of one effect at one place, by both plans."""
    scenario, one = Scenario(0, name, seed, (name,), seed + 1, 1.0), {"name": name, "strength": 1.0, "seed": seed + 1}
    gain = max(old.gauge.gain(scenario, [one]), 1e-9)
    strength = min(MULTIPLE * float(np.sqrt(least_gain(3) / gain)), 30.0)
    injected = [{**one, "strength": strength}]
    row = {"name": name, "seed": seed, "in_time": declaration(name).acts_in_time, "old": strength**2 * gain}
    row["new"] = first.gain(scenario, injected)
    for key, challenger, count in (("old", old, len(old.poses)), ("new", new, FIRST)):
        obs, _ = observe(challenger.loaded, challenger.poses, scenario, injected)
        look = weigh(obs.select(np.arange(obs.n_poses) < count))
        labels = {label.partition(":")[0] for h in (look.reported, *look.alternatives) for label in h.labels}
        row |= {f"{key}_found": look.full.evidence.significant and name in labels, f"{key}_log_e": look.full.evidence.log_e_value}
    return row


def early_and_late(poses: Sequence[PlannedPose]) -> list[PlannedPose]:
    """Each station visited twice, with every second of its poses."""
    of = {name: [p for p in poses if p.station == name] for name in dict.fromkeys(p.station for p in poses)}
    return [p for start in (0, 1) for here in of.values() for p in here[start::2]]


def in_time(old: Challenger, new: Challenger, count: int, seed: int) -> None:
    """Table of the information of three choices of 64 poses on what acts in time, in that of all poses of the old plan."""
    first = list(new.poses[:FIRST])
    tried = {"first 64 of the order": (new, first), "early and late": (new, early_and_late(first)), "every second": (old, old.poses[::2])}
    gauges = [Gauge(one.loaded, [replace(p, number=k) for k, p in enumerate(poses)]) for one, poses in tried.values()]
    lines = []
    for name in (name for name in catalogued() if declaration(name).acts_in_time):
        shares = []
        for number in range(seed, seed + 10 * count, 10):
            scenario, one = Scenario(0, name, number, (name,), number + 1, 1.0), {"name": name, "strength": 1.0, "seed": number + 1}
            whole = max(old.gauge.gain(scenario, [one]), 1e-9)
            shares.append([gauge.gain(scenario, [one]) / whole for gauge in gauges])
        lines.append(
            [name, count, *(", ".join(f"{q:.2f}" for q in np.quantile(each, (0.1, 0.5, 0.9))) for each in zip(*shares, strict=True))]
        )
    print("\n".join(bench.table(("effect", "cells", *tried), lines)))
    obs, _ = observe(old.loaded, old.poses, Scenario(0, "none", seed, (), 1, 1.0), [])
    warmth = np.asarray(obs.temperatures["robot_C"])
    half, whole = np.ptp(warmth[:FIRST]), np.ptp(warmth)
    print(f"\nthe arm warms by {half:.1f} K in {FIRST} poses, by {whole:.1f} K in {len(warmth)}: information {(half / whole) ** 2:.2f}")


def plan_order(given: argparse.Namespace) -> None:
    """What an ordered plan shows with half of the poses: power of its first 64 against all 128 of another plan, over the catalogue.

    Each effect of the catalogue is injected at several places. Its strength is that at which a test that knows it finds it nine times in
    ten with OLD's 128 poses, times 2.5, because a search over the catalogue needs so much. Both plans record the same cell by the array
    path, and a look weighs all explanations. Rows go to runs/plan-order-benchmark, so that a call goes on where another ended; the last
    line counts them.

    With --in-time the first 64 are compared as a run by itself, by information only: what is concealed begins or grows within it. Beside
    them stand every second pose of OLD, and the same 64 with each station visited early and late, half of its poses each time.
    """
    if given.in_time:
        with threadpool_limits(1):
            in_time(Challenger.of(given.old), Challenger.of(given.new), given.count, given.seed)
        return
    KEPT.mkdir(parents=True, exist_ok=True)
    table = bench.Kept(KEPT / f"{given.old.stem}-{given.new.stem}-{given.seed}.jsonl")
    rows = table.rows
    done = {(r["name"], r["seed"]) for r in rows}
    with threadpool_limits(1):
        old, new = Challenger.of(given.old), Challenger.of(given.new)
        first = Gauge(new.loaded, new.poses[:FIRST])
        for seed in range(given.seed, given.seed + 10 * given.count, 10):
            for name in catalogued():
                if (name, seed) not in done:
                    table.add(tried(old, new, first, name, seed))
    for title, some in (("at rest", [r for r in rows if not r["in_time"]]), ("in time", [r for r in rows if r["in_time"]])):
        ratio = np.array([r["new"] / r["old"] for r in some])
        found = [sum(r[f"{key}_found"] for r in some) for key in ("old", "new")]
        quantiles = ", ".join(f"{q:.2f}" for q in np.quantile(ratio, (0.1, 0.5, 0.9)))
        print(f"| {title} | {len(some)} | {found[0]} | {found[1]} | {quantiles} |")

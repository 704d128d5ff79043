"""Single figures of docs/data."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from mbcacq.diagnosis.model_fit import fit_model, fit_part
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.search.effect_set import NO_EFFECTS
from mbcacq.diagnosis.validation import predictive_score
from mbcacq.recording import load_observations
from real_arms.campaigns import whole
from real_arms.position_errors import Data, rms


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
        found = fit_part(setup.with_linearization(linear), train, bool(full.random))
        before = predictive_score.HeldOutPrediction(linear, train, judged, NO_EFFECTS, (), full.noise).score()
        after = predictive_score.HeldOutPrediction(linear, train, judged, found.model, found.random, full.noise).score()
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


@threadpool_limits.wrap(limits=1)
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

"""Numerical inverse kinematics: branches found, and time."""

from __future__ import annotations

import argparse
import time

import numpy as np

from mbcacq.geometry.numerical_inverse import NumericalInverse
from mbcacq.geometry.three_parallel_axes import ThreeParallelAxesInverse
from mbcacq.model import shipped
from mbcacq.plan.inverse_kinematics import OrthoParallelInverse

ARMS = ("ur10", "ur10e", "crx10ia", "panda", "iiwa14", "kr10_r1100_2")
BRANCH_POSES = 500
AGREE = 1e-4  # rad


def missed(known: np.ndarray, found: np.ndarray) -> int:
    """How many of the known positions (k, n) are not among those found, full turns apart."""
    away = np.abs(np.mod(known[:, None] - found[None] + np.pi, 2 * np.pi) - np.pi).max(axis=2)
    return int((away.min(axis=1, initial=np.inf) > AGREE).sum())


def branches_found(name: str, poses: int) -> tuple[int, int, int]:
    """Branches that exist, that were missed, and targets of which one was missed."""
    arm = shipped.robot(name)
    q = np.random.default_rng(11).uniform(-np.pi, np.pi, (poses, 6))
    q = np.clip(q, arm.limits[:, 0], arm.limits[:, 1])
    T = arm.chain.flange(q)
    found = NumericalInverse(arm.chain, arm.limits).branches(T)
    if name.startswith("ur"):
        closed = ThreeParallelAxesInverse.of(arm.chain, arm.limits)
        assert closed is not None
        known = [q[np.isfinite(q).all(axis=1)] for q in closed.branches(T)]
    else:
        known = OrthoParallelInverse.of(arm).solutions(T)
    lost = [missed(k, f) for k, f in zip(known, found, strict=True)]
    unique = [len(np.unique(np.mod(k.round(6), 2 * np.pi).round(5), axis=0)) for k in known]
    return sum(unique), sum(lost), sum(1 for n in lost if n)


def solved(name: str, poses: int) -> tuple[int, float, float]:
    """Targets without a solution, ms a target, largest miss of a solution (mm)."""
    arm = shipped.robot(name)
    q = np.random.default_rng(5).uniform(arm.limits[:, 0], arm.limits[:, 1], (poses, arm.n))
    T = arm.chain.flange(q)
    solver = NumericalInverse(arm.chain, arm.limits)
    solver.branches(T[:1])  # its table of starts
    start, left, miss = time.perf_counter(), 0, 0.0
    for first in range(0, poses, 200):
        for found, target in zip(solver.branches(T[first : first + 200]), T[first : first + 200], strict=True):
            left += not len(found)
            inside = (found >= arm.limits[:, 0]) & (found <= arm.limits[:, 1])
            assert inside.all(), name
            miss = max(miss, float(np.abs(arm.chain.flange(found) - target)[:, :3, 3].max(initial=0.0)))
    return left, 1e3 * (time.perf_counter() - start) / poses, miss


def inverse_kinematics(given: argparse.Namespace) -> None:
    """How much of its reach the numerical inverse kinematics finds, and whether it finds every branch.

    Poses are those of random joint angles within the limits, so every one can be reached. The branches of the UR arms are compared with
    the closed form for three parallel axes, those of the KR 10 R1100-2 with py-opw-kinematics.
    """
    lines = ["# Numerical inverse kinematics", "", "**Question.** Does the numerical solver find every reachable pose?", ""]
    lines += [f"Random reachable poses, {given.poses} an arm. Made by `python benchmarks/speed.py inverse-kinematics {given.poses}`.", ""]
    lines += ["| arm | axes | solved | without a solution | largest miss, mm | ms a pose |", "|---|---|---|---|---|---|"]
    for name in ARMS:
        left, ms, miss = solved(name, given.poses)
        axes = shipped.robot(name).n
        lines.append(f"| {name} | {axes} | {100 * (1 - left / given.poses):.2f} % | {left} of {given.poses} | {miss:.1e} | {ms:.0f} |")
        print(lines[-1], flush=True)
    lines += ["", f"Branches against a closed form, {BRANCH_POSES} poses an arm.", ""]
    lines += ["| arm | branches that exist | missed | poses with all of them |", "|---|---|---|---|"]
    for name in ("ur10", "ur10e", "kr10_r1100_2"):
        exist, lost, targets = branches_found(name, BRANCH_POSES)
        lines.append(f"| {name} | {exist} | {lost} | {100 * (1 - targets / BRANCH_POSES):.1f} % |")
        print(lines[-1], flush=True)
    given.out.write_text("\n".join(lines) + "\n", encoding="utf-8")

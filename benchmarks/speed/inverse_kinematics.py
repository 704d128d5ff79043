"""Numerical inverse kinematics: branches found, and time."""

from __future__ import annotations

import argparse
import time

import numpy as np
import yaml

from mbcacq.geometry.numerical_inverse import NumericalInverse
from mbcacq.model import shipped
from mbcacq.model.cell import RobotModel
from mbcacq.model.cell_schema import RobotSpec
from mbcacq.plan.inverse_kinematics import OrthoParallelInverse

ARMS = ("ur10", "ur10e", "crx10ia", "panda", "iiwa14", "kr10_r1100_2")
BRANCH_POSES = 500
AGREE = 1e-4  # rad


def robot(name: str) -> RobotModel:
    return RobotSpec.model_validate(yaml.safe_load(shipped.robot_file(name).read_text(encoding="utf-8"))).model()


def ur_branches(arm: RobotModel, T: np.ndarray) -> np.ndarray:
    """Every joint position (k, 6) rad in (-pi, pi] of a UR at a flange pose (4, 4): two shoulders, two wrists, two elbows.

    Axes 2, 3 and 4 are parallel: the arm's plane, turned by q1, passes the wrist at the distance d4; in it lies a two-link arm.
    """
    d1, d4, d5, d6 = arm.chain.d[[0, 3, 4, 5]]
    a2, a3 = arm.chain.a[[1, 2]]
    p5 = T[:3, 3] - d6 * T[:3, 2]
    out, across = [], np.hypot(p5[0], p5[1])
    if across < abs(d4):
        return np.empty((0, 6))
    for q1 in np.arctan2(p5[1], p5[0]) + np.pi / 2 + np.array([1, -1]) * np.arccos(d4 / across):
        side = np.array([np.sin(q1), -np.cos(q1), 0.0])
        cosine = (T[:3, 3] @ side - d4) / d6
        if abs(cosine) > 1:
            continue
        for q5 in np.array([1, -1]) * np.arccos(cosine):
            x, y = T[:3, 0] @ side, T[:3, 1] @ side
            q6 = np.arctan2(-y / np.sin(q5), x / np.sin(q5))
            # What is left, from axis 2 to the wrist, lies in the plane of the two links.
            chain = arm.chain.link_transforms(np.array([[q1, 0, 0, 0, q5, q6]]))[0]
            M = np.linalg.inv(chain[0]) @ T @ np.linalg.inv(chain[4] @ chain[5])
            u, v = M[0, 3], M[1, 3]
            bend = (u * u + v * v - a2 * a2 - a3 * a3) / (2 * a2 * a3)
            if abs(bend) > 1:
                continue
            for q3 in np.array([1, -1]) * np.arccos(bend):
                q2 = np.arctan2(v, u) - np.arctan2(a3 * np.sin(q3), a2 + a3 * np.cos(q3))
                q4 = np.arctan2(M[1, 0], M[0, 0]) - q2 - q3
                out.append([q1, q2, q3, q4, q5, q6])
    return np.pi - np.mod(np.pi - np.array(out).reshape(-1, 6), 2 * np.pi)


def missed(known: np.ndarray, found: np.ndarray) -> int:
    """How many of the known positions (k, n) are not among those found, full turns apart."""
    away = np.abs(np.mod(known[:, None] - found[None] + np.pi, 2 * np.pi) - np.pi).max(axis=2)
    return int((away.min(axis=1, initial=np.inf) > AGREE).sum())


def branches_found(name: str, poses: int) -> tuple[int, int, int]:
    """Branches that exist, that were missed, and targets of which one was missed."""
    arm = robot(name)
    q = np.random.default_rng(11).uniform(-np.pi, np.pi, (poses, 6))
    q = np.clip(q, arm.limits[:, 0], arm.limits[:, 1])
    T = arm.chain.flange(q)
    found = NumericalInverse(arm.chain, arm.limits).branches(T)
    if name.startswith("ur"):
        known = [ur_branches(arm, t) for t in T]
        assert all(np.abs(arm.chain.flange(k) - t).max() < 1e-6 for k, t in zip(known, T, strict=True))
    else:
        known = OrthoParallelInverse.of(arm).solutions(T)
    lost = [missed(k, f) for k, f in zip(known, found, strict=True)]
    unique = [len(np.unique(np.mod(k.round(6), 2 * np.pi).round(5), axis=0)) for k in known]
    return sum(unique), sum(lost), sum(1 for n in lost if n)


def solved(name: str, poses: int) -> tuple[int, float, float]:
    """Targets without a solution, ms a target, largest miss of a solution (mm)."""
    arm = robot(name)
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

    Poses are those of random joint angles within the limits, so every one can be reached. The branches of the UR10 are compared with
    a closed form written here from the arm's geometry, those of the KR 10 R1100-2 with py-opw-kinematics.
    """
    lines = ["# Numerical inverse kinematics", ""]
    lines += [f"Random reachable poses, {given.poses} an arm. Made by `python benchmarks/speed.py inverse-kinematics {given.poses}`.", ""]
    lines += ["| arm | axes | solved | without a solution | largest miss, mm | ms a pose |", "|---|---|---|---|---|---|"]
    for name in ARMS:
        left, ms, miss = solved(name, given.poses)
        lines.append(
            f"| {name} | {robot(name).n} | {100 * (1 - left / given.poses):.2f} % | {left} of {given.poses} | {miss:.1e} | {ms:.0f} |"
        )
        print(lines[-1], flush=True)
    lines += ["", f"Branches against a closed form, {BRANCH_POSES} poses an arm.", ""]
    lines += ["| arm | branches that exist | missed | poses with all of them |", "|---|---|---|---|"]
    for name in ("ur10", "ur10e", "kr10_r1100_2"):
        exist, lost, targets = branches_found(name, BRANCH_POSES)
        lines.append(f"| {name} | {exist} | {lost} | {100 * (1 - targets / BRANCH_POSES):.1f} % |")
        print(lines[-1], flush=True)
    given.out.write_text("\n".join(lines) + "\n", encoding="utf-8")

"""A robot program played in the fake cell, the clouds of its exposures saved as a scanner's own program would save them."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from mbcacq.files.atomic_write import write_file
from mbcacq.plan.controller_joints import from_controller, to_controller
from mbcacq.recording.datasets.scan_folder import write_ply
from mbcacq_fakes.cell.build_world import make_camera, make_world
from mbcacq_fakes.cell.program_steps import Step, steps_of
from mbcacq_fakes.world import options as fake_options
from mbcacq_fakes.world.camera import Camera
from mbcacq_fakes.world.description import from_cell
from mbcacq_fakes.world.scanner import Optics

MOVE_S = 2.0
DAY_S = 1_700_000_000.0  # when the session begins: the clouds are as old as they are far apart


@dataclass(frozen=True)
class TakenCloud:
    """Number from 1, pose as the program says it, joint angles q (n,) rad where the arm stands, time_s since the session began; points
    (N, 3) float32 mm."""

    number: int
    pose: int
    q: np.ndarray
    time_s: float
    points: np.ndarray


class _Arm:
    """Where the program has brought the arm."""

    def __init__(self, n: int) -> None:
        self.now = SimpleNamespace(q=(0.0,) * n, qd=(0.0,) * n, direction=(0.0,) * n, arrivals=0, time_s=0.0, standstill=True)

    def read(self) -> Any:
        return self.now

    def go(self, q: np.ndarray) -> None:
        turned = np.sign(q - np.array(self.now.q))
        direction = np.where(np.abs(q - np.array(self.now.q)) > 1e-9, turned, self.now.direction)
        self.now.q, self.now.direction = tuple(q.tolist()), tuple(direction.tolist())
        self.now.arrivals += 1
        self.now.time_s += MOVE_S


def rehearse(loaded: Any, poses: list[Any], program: Path, out: Path, *, seed: int = 0) -> list[Path]:
    """Play the program in a folder against the fake cell of a plan and save clouds (PLY) and ``joints.csv`` into ``out``.

    loaded, poses: the plan and its expansion (read by name). Returns the files. Raises ConfigError for a program that is none.
    """
    spec = loaded.plan.robot.controller_joints
    steps = steps_of(program, None if spec is None else spec.pulses_per_deg, tuple(loaded.cell.robot.axes))
    out.mkdir(parents=True, exist_ok=True)
    files, rows = [], []
    for cloud in taken(loaded, poses, steps, seed):
        path = out / f"cloud_{cloud.number:04d}.ply"
        write_ply(path, cloud.points, simulated=True)
        os.utime(path, (DAY_S + cloud.time_s, DAY_S + cloud.time_s))
        files.append(path)
        if not rows or rows[-1][0] != cloud.pose:
            rows.append([cloud.pose, *(f"{angle:.6f}" for angle in to_controller(loaded, cloud.q))])
    heads = ["pose", *loaded.cell.robot.headings]
    log = write_file(out / "joints.csv", "".join(f"{','.join(map(str, row))}\n" for row in (heads, *rows)))
    return [*files, log]


def taken(loaded: Any, poses: list[Any], steps: list[Step], seed: int = 0) -> Iterator[TakenCloud]:
    """The clouds of a program's exposures."""
    plan, n = loaded.plan, loaded.cell.robot.n
    options = fake_options.parse(fake_options.of_scanner(plan.scanner, plan.fake))
    planned_q = np.array([p.q for p in poses], dtype=float).reshape(-1, n)
    facts = replace(from_cell(loaded.cell, plan.scanner.field_of_view), planned_q=planned_q)
    world = make_world(facts, options, seed)
    station = np.array([facts.station_ids.index(str(p.station)) for p in poses], dtype=int)
    arm = _Arm(n)
    camera: Camera = make_camera(world, arm, options, planned_q, station, plan.scanner.exposure_us, optics=Optics.above(facts.view))
    number = 0
    for kind, value in steps:
        if kind == "move":
            arm.go(from_controller(loaded, value))
            continue
        number += 1
        frame = camera(plan.scanner.exposure_us or 0.0)
        points = frame.xyz.reshape(-1, 3)
        arm.now.time_s += plan.scanner.scan_time_s
        yield TakenCloud(number, value, np.array(arm.now.q), arm.now.time_s, points[np.isfinite(points).all(axis=1)])

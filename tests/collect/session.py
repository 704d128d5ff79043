"""A small plan of two stations, its program played in the fake cell, and what can go wrong with its clouds."""

from __future__ import annotations

import os
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import yaml
from mbcacq_fakes.cell.rehearsal import rehearse

from mbcacq.model import shipped
from mbcacq.plan import expand, load
from mbcacq.recording.datasets.scan_folder import write_ply
from mbcacq.spheres.ply import read_cloud
from mbcacq.workflow.controller_files import write as write_files
from mbcacq.workflow.robot_program import robot_program


def content() -> dict:
    folder = shipped.folder()
    plan = yaml.safe_load((folder / "quick.yaml").read_text(encoding="utf-8"))
    plan["robot"]["model"] = str(folder / plan["robot"]["model"])
    plan["artefacts"] = [str(folder / name) for name in plan["artefacts"]]
    plan["exposures"] = 1
    plan["scanner"]["resolution_mm"] = 0.7  # two hundred points a ball are enough here
    plan["stations"].append({"id": "p2", "artefact": "mbc", "pose_in_base": {"translation_mm": [500, 250, 100], "abc_deg": [20, -10, 0]}})
    views = plan["steps"][1]
    plan["steps"] = [plan["steps"][0], views, {**views, "name": "more", "stations": ["p2"]}]
    for step in plan["steps"]:
        step.pop("exposures", None)
    return plan


def written_plan(folder: Path, name: str = "plan", **more: object) -> Path:
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump({**content(), **more}), encoding="utf-8")
    return path


@cache
def loaded(plan: Path):
    """A plan, its postures found once."""
    return load(plan)


def play(plan: Path, program: Path, clouds: Path) -> Path:
    """The clouds of a program, taken in the fake cell of a plan; joints.csv stands beside them."""
    rehearse(loaded(plan), expand(loaded(plan)), program, clouds)
    shutil.move(clouds / "joints.csv", clouds.parent / f"{clouds.name}-joints.csv")
    return clouds


def program_of(plan: Path, folder: Path, dialect: str = "csv", **more: object) -> Path:
    write_files(robot_program(loaded(plan), dialect, **more), folder, True)
    return folder


def cloud(folder: Path, number: int) -> Path:
    return folder / f"cloud_{number:04d}.ply"


def rewrite(path: Path, change) -> None:
    """Change the points (N, 3) of a cloud; it stays as old as it was."""
    age = path.stat()
    write_ply(path, np.ascontiguousarray(change(read_cloud(path))).astype(np.float32), simulated=True)
    os.utime(path, (age.st_atime, age.st_mtime))


def noisy(points: np.ndarray) -> np.ndarray:
    """Another exposure of the same scene."""
    return points + np.random.default_rng(0).normal(0, 0.002, points.shape)

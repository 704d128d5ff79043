"""Real arms with their effects, learnt on one recording and tried on another."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from bench import HERE, put
from scipy.spatial import KDTree

import mbcacq
from mbcacq.calibration.calibrate import calibrate_with_effects
from mbcacq.calibration.transfer import check_transfer
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.model.observations import Observations

OFF_GRID = 20


def some(obs: Observations, poses: int) -> Observations:
    """At most so many poses, at random."""
    keep = np.zeros(obs.n_poses, bool)
    keep[np.random.default_rng(0).permutation(obs.n_poses)[:poses]] = True
    return obs.select(keep)


def learnt(obs: Observations) -> tuple[mbcacq.CalibratedCell, mbcacq.CalibratedCell]:
    """The cell with what a diagnosis finds, and as geometry alone."""
    options = mbcacq.CalibrationOptions(refuse=False)
    geometry = replace(options, discrepancy=False, random_links=False)
    model = diagnose(obs).model
    cell = mbcacq.calibrate(obs, options) if model is None else calibrate_with_effects(obs, options, model)
    return cell, mbcacq.calibrate(obs, geometry)


def tried(cell: mbcacq.CalibratedCell, alone: mbcacq.CalibratedCell, other: Observations, name: str) -> str:
    """The figures on a recording, as one row."""
    found = check_transfer(replace(other, pose_id=other.pose_id + 10**6), cell, alone.state.chain)
    own = found.own_geometry.rms_mm if found.own_geometry else float("nan")
    error, left = found.normalised_error, found.parts_left_out
    row = (
        f"| {name} | {own:.3f} | {found.geometry_alone.rms_mm:.3f} | {found.with_effects.rms_mm:.3f} | "
        f"{left.as_learnt.rms_mm:.3f} -> {left.drawn_anew.rms_mm:.3f} | {error.rms:.2f} | {error.share_below_3:.1%} |"
    )
    print(row, flush=True)
    return row


def ur5(data: Path) -> list[str]:
    """Learnt on a random half of the grid, checked on the rest, and on the poses farthest from any learnt one."""
    grid = mbcacq.load_observations(data / "ur5-tracker")
    half = np.zeros(grid.n_poses, bool)
    half[np.random.default_rng(1).permutation(grid.n_poses)[:700]] = True
    cell, alone = learnt(grid.select(half))
    rows = [tried(cell, alone, grid.select(~half), "ur5-tracker, 700 poses -> 300")]
    distance = KDTree(grid.q[half]).query(grid.q[~half])[0]
    far = np.zeros(grid.n_poses, bool)
    far[np.flatnonzero(~half)[np.argsort(-distance)[:OFF_GRID]]] = True
    return [*rows, tried(cell, alone, grid.select(far), f"ur5-tracker -> the {OFF_GRID} farthest of these")]


def ur10(data: Path, poses: int) -> list[str]:
    """Each campaign checked by the other."""
    campaigns = {name: some(mbcacq.load_observations(data / f"ur10-tracker-{name}"), poses) for name in "ac"}
    rows = []
    for here, there in (("a", "c"), ("c", "a")):
        cell, alone = learnt(campaigns[here])
        rows.append(tried(cell, alone, campaigns[there], f"ur10-tracker-{here} -> {there}"))
    return rows


HEADER = (
    "| learnt -> checked | geometry fitted there mm | learnt geometry mm | with effects mm | parts left out: as learnt -> drawn anew mm | "
    "error over uncertainty, rms | below 3 |"
)


def transfer(given: argparse.Namespace) -> None:
    """Learn here, check there: an arm with its effects on recordings that it was not fitted to.

    UR10: learnt on one campaign, checked on the other, both ways (base, tool and stations of the other fitted). UR5: learnt on a
    700-pose half of its grid, checked on the rest, and on the 20 poses that lie farthest from any learnt pose in the joints.
    """
    head = [HEADER, "|---|---|---|---|---|---|---|"]
    print(*head, sep="\n", flush=True)
    rows = ur5(given.data) if given.only != "ur10" else []
    rows += ur10(given.data, given.poses) if given.only != "ur5" else []
    if given.write:
        put(HERE / "transfer.md", "\n".join([*head, *rows]))

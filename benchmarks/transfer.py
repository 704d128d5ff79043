"""Learn here, check there: an arm with its effects on recordings that it was not fitted to.

    python benchmarks/transfer.py [--data ../shared/data] [--poses 3000]

UR10: learnt on one campaign, checked on the other, both ways (base, tool and stations of the other fitted). UR5: learnt on a 700-pose half
of its grid, checked on the rest, and on the 20 poses that lie farthest from any learnt pose in the joints.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

import mbcacq
from mbcacq.calibration.transfer import Transfer, check_transfer
from mbcacq.calibration.with_effects import calibrate_with_effects
from mbcacq.effects import unmodelled
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import LearntRecording
from mbcacq.model.observations import Observations

OFF_GRID = 20


def some(obs: Observations, poses: int) -> Observations:
    """At most so many poses, at random."""
    keep = np.zeros(obs.n_poses, bool)
    keep[np.random.default_rng(0).permutation(obs.n_poses)[:poses]] = True
    return obs.select(keep)


def learnt(obs: Observations) -> tuple[mbcacq.Calibration, mbcacq.Calibration]:
    """The cell with all groups, and as geometry alone."""
    options = mbcacq.CalibrationOptions(refuse=False)
    terms = tuple(unmodelled.everywhere(Covariates(obs)))
    model = EffectModel(obs.cell.robot, terms, LearntRecording.of(obs), obs.cell.measurement)
    return calibrate_with_effects(obs, options, model), mbcacq.calibrate(obs, options)


def tried(cell: mbcacq.Calibration, alone: mbcacq.Calibration, other: Observations, name: str) -> Transfer:
    """The figures on a recording, as one row."""
    found = check_transfer(replace(other, pose_id=other.pose_id + 10**6), cell, alone.state.chain)
    own = found.own_geometry.rms_mm if found.own_geometry else float("nan")
    error = found.normalised_error
    print(
        f"| {name} | {own:.3f} | {found.geometry_alone.rms_mm:.3f} | {found.with_effects.rms_mm:.3f} | {error.rms:.2f} | "
        f"{error.share_below_3:.1%} |",
        flush=True,
    )
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--poses", type=int, default=3000)
    given = parser.parse_args()
    print("| learnt -> checked | own geometry mm | learnt geometry mm | with effects mm | error over uncertainty | below 3 |")
    print("|---|---|---|---|---|---|")
    grid = mbcacq.load_observations(given.data / "ur5-tracker")
    half = np.zeros(grid.n_poses, bool)
    half[np.random.default_rng(1).permutation(grid.n_poses)[:700]] = True
    cell, alone = learnt(grid.select(half))
    tried(cell, alone, grid.select(~half), "ur5-tracker, 700 poses -> 300")
    distance = KDTree(grid.q[half]).query(grid.q[~half])[0]
    far = np.zeros(grid.n_poses, bool)
    far[np.flatnonzero(~half)[np.argsort(-distance)[:OFF_GRID]]] = True
    tried(cell, alone, grid.select(far), f"ur5-tracker -> the {OFF_GRID} farthest of these")
    campaigns = {name: some(mbcacq.load_observations(given.data / f"ur10-tracker-{name}"), given.poses) for name in "ac"}
    for here, there in (("a", "c"), ("c", "a")):
        cell, alone = learnt(campaigns[here])
        tried(cell, alone, campaigns[there], f"ur10-tracker-{here} -> {there}")


if __name__ == "__main__":
    main()

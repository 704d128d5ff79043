"""Play in the gearbox: the joint side hangs back by half the width, on the side it is driven from."""

from __future__ import annotations

import numpy as np

from mbcacq.physics.trajectory.effect import Candidate, Group, Run, plain_report

NAME = "backlash"
LEAST_LOAD = 0.02   # of the largest: below, the flank in contact is not known sharply


def candidates(group: Group, runs: tuple[Run, ...]) -> list[Candidate]:
    if group.name != "q_joint":
        return []
    out = []
    for j in group.joints:
        report = plain_report(f"A{j + 1}.width_deg", scale=float(np.degrees(1)))
        out.append(Candidate(NAME, (f"A{j + 1}",), f"direction_{j + 1}", (j,), _by_motion, report, positive=True))
        if all(run.load is not None for run in runs) and _changes_flank(runs, j):
            out.append(Candidate(NAME, (f"A{j + 1}",), f"tau{j + 1}", (j,), _by_load, report, positive=True, tag="load"))
    return out


def _by_motion(run: Run, joint: int, _: float | None) -> np.ndarray:
    return -0.5 * run.sense[:, [joint]]


def _by_load(run: Run, joint: int, _: float | None) -> np.ndarray:
    load = run.load[:, joint]
    return -0.5 * np.tanh(load / max(LEAST_LOAD * float(np.abs(load).max()), 1e-9))[:, None]


def _changes_flank(runs: tuple[Run, ...], joint: int) -> bool:
    signs = np.concatenate([np.sign(run.load[:, joint]) for run in runs])
    return float(min((signs > 0).mean(), (signs < 0).mean())) > 0.02

"""Relative uncertainty of the torque that passes a gear, which is itself an estimate."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.effects import catalogue


def load_uncertainty(model: MotionModel, chosen: np.ndarray, x: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(J,) relative standard deviation of the load: of the links' torque and of the effects behind the gear, that part which is
    proportional to the load itself.

    chosen, x: columns and their coefficients, covariance: (c, c) theirs.
    """
    if model.group.name != "tau":
        return np.zeros(len(model.group.joints))
    out = []
    for j in range(len(model.group.joints)):
        load, columns, at = _load(model, j, chosen, x)
        present = model.store.present(j)
        load = load - present * load.sum() / max(present.sum(), 1.0)
        share = load @ columns / max(float(load @ load), 1e-300)
        out.append(np.sqrt(max(float(share @ covariance[np.ix_(at, at)] @ share), 0.0)))
    return np.array(out)


def _load(model: MotionModel, j: int, chosen: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The torque that passes a gear (Ttot,), zero where a sample takes no part; the columns (Ttot, k) by which it was fitted, and their
    positions in ``chosen``."""
    group, store = model.group, model.store
    links = store.base[len(group.joints) : -model.runs[0].q.shape[1]]  # the first are offsets, the last the rotors
    behind_gear = {int(i) for i in links}
    behind_gear |= {int(i) for e in model.selected if not catalogue.declaration(e.candidate.name).motor_side for i in e.columns}
    columns, at = store.training_columns(j, chosen)
    own = np.array([i for i, number in enumerate(chosen[at]) if int(number) in behind_gear], dtype=int)
    rigid = [run.rigid[:, group.joints[j]] for run in model.runs if run.rigid is not None]
    load = np.concatenate(rigid) * store.present(j)
    return load + columns[:, own] @ x[at[own]], columns[:, own], at[own]

"""Which poses of a recording are fitted."""

from __future__ import annotations

import numpy as np

from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.model.observations import Observations


def select_phases(obs: Observations, options: CalibrationOptions) -> Observations:
    """The poses to fit: of the phases asked for, else all but 'verification' where there are others."""
    if obs.phase is None:
        keep = np.ones(obs.n_poses, bool)
    elif options.phases is not None:
        keep = np.isin(obs.phase, options.phases)
    else:
        keep = obs.phase != "verification"
        keep = keep if keep.any() else ~keep
    if not keep.any() and options.phases:
        recorded = sorted(set([] if obs.phase is None else obs.phase.tolist()))
        raise ConfigError(f"there is no pose of phase {' or '.join(options.phases)}; these data have {', '.join(recorded)}")
    chosen = (obs if keep.all() else obs.select(keep)).measured()
    if not chosen.n_poses:
        asked = f" of phase {' or '.join(options.phases)}" if options.phases else ""
        raise CalibrationError(f"there is no pose with a measured centre{asked}; nothing can be calibrated")
    return chosen


def without_copies(obs: Observations) -> Observations:
    """Every exact copy of a pose once."""
    again = copies(obs)
    return obs.select(~np.isin(np.arange(obs.n_poses), again)) if len(again) else obs


def copies(obs: Observations) -> np.ndarray:
    """Indices of poses that are exact copies of an earlier one: the same station, angles, balls and every digit of the centres. They are no
    second measurement, which would differ by noise."""
    if len(np.unique(obs.q[:, 0])) == obs.n_poses:
        return np.zeros(0, dtype=int)
    _, first, of = np.unique(np.c_[obs.station, obs.q], axis=0, return_index=True, return_inverse=True)
    again = np.flatnonzero(first[of.ravel()] != np.arange(obs.n_poses))
    if not len(again):
        return again
    rows = {p: np.flatnonzero(obs.pose == p) for p in np.unique([*again, *first[of.ravel()[again]]])}
    seen: dict[tuple, int] = {}
    out = []
    for p in sorted(rows):
        measured = obs.xyz[rows[p]]
        key = (int(of.ravel()[p]), obs.ball[rows[p]].tobytes(), measured.tobytes())
        if len(measured) and seen.setdefault(key, p) != p:
            out.append(p)
    return np.array(out, dtype=int)

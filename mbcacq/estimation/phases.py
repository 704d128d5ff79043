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

"""The clock of a scanner that measured in motion, as a term of the cell: what is left of its delay and drift, with everything else.

The poses of such a recording are those at the controller's times that its clock was estimated to have. Near these the flange moves by its
velocity times an error of the time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.calibration.profile_clock import DRIFT_SIGMA
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.terms import Part, Term, term
from mbcacq.model.observations import Observations
from mbcacq.quantities import K

CLOCK = "clock"
NAMES = ("clock.delay", "clock.drift")


def clock_term(obs: Observations) -> Term | None:
    """Delay (s) and drift of the clock; None for a recording at rest."""
    if obs.flange_velocity is None or obs.sensor_time_s is None:
        return None
    since = obs.sensor_time_s - obs.sensor_time_s.mean()
    bases = (np.column_stack([v, v * since]) for v in obs.flange_velocity.T)
    parts = [Part("frame", obs.cell.robot.n, c, basis) for c, basis in enumerate(bases)]
    return term(CLOCK, parts, NAMES, ("s", ""), np.array([np.inf, DRIFT_SIGMA]))


def with_clock_term(obs: Observations, options: CalibrationOptions) -> CalibrationOptions:
    """The options with the clock of a recording in motion among the terms."""
    found = clock_term(obs)
    return options if found is None else replace(options, terms=(*options.terms, found))


def with_clock(cell: CalibratedCell) -> CalibratedCell:
    """The cell with its clock in ``extra``: delay and drift of the controller's clock against the sensor's, and their standard
    uncertainties. A recording at rest is returned unchanged."""
    obs = cell.fit.observations
    if NAMES[0] not in cell.names or obs.time_s is None or obs.sensor_time_s is None:
        return cell
    drift, delay = np.polyfit(obs.sensor_time_s - obs.sensor_time_s.mean(), obs.time_s - obs.sensor_time_s, 1)
    at = [cell.names.index(name) for name in NAMES]
    index = [t.name for t in cell.fit.options.terms].index(CLOCK)
    further, sigma = cell.fit.coefficients[index], np.sqrt(np.diag(cell.covariance)[at])
    clock = {"delay_s": float(delay + further[0]), "delay_sigma_s": float(sigma[0])}
    clock |= {"drift": float(drift + further[1]), "drift_sigma": float(sigma[1])}
    return replace(cell, extra={**cell.extra, "clock": clock})


def clock_sentence(delay_s: float, sigma_s: float, drift: float, jitter_s: float | None = None) -> str:
    """What is known of the sensor's clock, in words."""
    jitter = "" if jitter_s is None else f", stamps scatter by {1e6 * jitter_s:.2g} µs (k = 1)"
    delay = f"{1e3 * delay_s:.4f} ms ± {K * 1e6 * sigma_s:.2g} µs (k = 2)"
    return f"Clock: the controller's is ahead of the sensor's by {delay}, drift {1e6 * drift:+.2g} ppm{jitter}"

"""Covariates that a mismatch may depend on, with smooth functions of each: the columns of the evidence map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.nonparametric import joint_travel, periodic_component
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects.context import Context


@dataclass(frozen=True)
class Covariate:
    """name as in ``depends_on``; functions (P, f) or, where it varies within a pose, (M, f); values (P,) or (M,) for pictures."""

    name: str
    functions: np.ndarray
    values: np.ndarray


def of_poses(s: Context) -> list[Covariate]:
    """Covariates that are one number a pose."""
    obs, out = s.obs, list[Covariate]()
    for i in range(s.n):
        if np.ptp(obs.q[:, i]) > 0.02:
            out.append(smooth(f"q{i + 1}", obs.q[:, i]))
    torque = s.gravity_torque
    for i in range(s.n):
        if np.ptp(torque[:, i]) > 0.02 * np.ptp(torque, axis=0).max() + 1e-9:
            out.append(polynomial(f"gravity_torque_{i + 1}", torque[:, i], 2))
    if obs.direction is not None:
        moving = [i for i in range(s.n) if np.ptp(obs.direction[:, i]) > 0]
        out += [polynomial(f"direction_{i + 1}", obs.direction[:, i], 1) for i in moving]
        out += [Covariate(f"direction_{i + 1}", joint_travel.functions(s, i), obs.direction[:, i]) for i in moving]
    if obs.time_s is not None and np.ptp(obs.time_s) > 0:
        out.append(smooth("time", s.time))
    else:
        out.append(smooth("pose", s.order))
    out += [polynomial(name, values, 2) for name, values in obs.temperatures.items() if np.ptp(values) > 0.2]
    if obs.velocity is not None and np.ptp(obs.velocity) > 1e-6:
        out += [polynomial(f"qd{i + 1}", np.nan_to_num(obs.velocity[:, i]), 1) for i in range(s.n) if np.ptp(obs.velocity[:, i]) > 1e-9]
    if obs.torque is not None:
        out += [polynomial(f"tau{i + 1}", np.nan_to_num(obs.torque[:, i]), 1) for i in range(s.n) if np.ptp(obs.torque[:, i]) > 1e-9]
    return out


def of_centres(s: Context) -> list[Covariate]:
    """Covariates within the field of view (M,), x and y with periodic components."""
    return [
        Covariate(c.name, np.concatenate([c.functions, periodic_component.harmonics(c.values)], axis=1), c.values)
        if c.name in ("x", "y")
        else c
        for c in smooth_of_centres(s)
    ]


def smooth_of_centres(s: Context) -> list[Covariate]:
    """Covariates within the field of view (M,): polynomials."""
    out = [polynomial("xyz"[c], s.obs.xyz[:, c], 3) for c in range(3) if np.ptp(s.obs.xyz[:, c]) > 1e-6]
    if out:
        radius = np.hypot(s.obs.xyz[:, 0], s.obs.xyz[:, 1])
        out[0] = Covariate("x", np.concatenate([out[0].functions, standard(radius**2)[:, None]], axis=1), s.obs.xyz[:, 0])
    tilt = artefact_tilt(s)
    if np.ptp(tilt) > 0.02:
        out.append(polynomial("tilt", tilt[s.obs.pose], 2))
    return out


def artefact_tilt(s: Context) -> np.ndarray:
    """(P,) rad between the scanner's axis and the artefact's z."""
    scanner, station = s.prediction.T_base_scanner[:, :3, 2], s.prediction.T_base_station[:, :3, 2]
    return np.arccos(np.clip(np.abs(np.sum(scanner * station, axis=1)), 0, 1))


def standard(values: np.ndarray) -> np.ndarray:
    """Values of mean zero and unit standard deviation."""
    return (values - values.mean()) / max(float(values.std()), 1e-12)


def polynomial(name: str, values: np.ndarray, degree: int) -> Covariate:
    """Powers of the standardised covariate up to a degree."""
    x = standard(np.asarray(values, dtype=float))
    return Covariate(name, np.stack([x ** (d + 1) for d in range(degree)], axis=1), values)


def smooth(name: str, values: np.ndarray) -> Covariate:
    """Cosines over the range of a covariate: they stay bounded where there are no data."""
    low, span = float(np.min(values)), max(float(np.ptp(values)), 1e-12)
    phase = np.pi * (np.asarray(values, dtype=float) - low) / span
    return Covariate(name, np.cos(phase[:, None] * np.arange(1, OPTIONS.cosines + 1)), values)

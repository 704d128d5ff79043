"""Drift of an arm over its recordings: a straight line through all parameters together, and the single parameter that explains it.

One recording of a few poses determines combinations of parameters far better than any of them. The slope of all parameters over the
recordings is estimated by generalised least squares with their whole covariances. Each parameter gets the drift that it would have if it
alone drifted; this uses those combinations. Its significance is corrected for the number of parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from mbcacq.fleet.row import FleetRow

FEWEST = 4  # recordings of an arm without which there is no line
FALSE_ALARMS = 0.0027  # of an arm
MEDIAN_SQUARE = 0.4549  # median of chi square with one degree of freedom
REGULAR = 1e-12  # of a covariance, relative to its largest normalised eigenvalue


@dataclass(frozen=True)
class Drift:
    """A parameter of an arm that drifts: change (mm or rad) from its first recording to its last, and the least that is significant."""

    arm: str
    name: str
    change: float
    limit: float


@dataclass(frozen=True)
class Trend:
    """Each parameter of an arm, as if it were the only one that drifts: change (p,) from first to last recording, and its sigma (p,)."""

    arm: str
    names: tuple[str, ...]
    change: np.ndarray
    sigma: np.ndarray


def drifts(rows: Sequence[FleetRow]) -> list[Drift]:
    """The arms of one type that drift, each by the parameter that explains it best. rows: evaluated, sorted by arm and time."""
    by_arm: dict[str, list[FleetRow]] = {}
    for row in rows:
        by_arm.setdefault(row.arm, []).append(row)
    trends = [found for arm, own in by_arm.items() if (found := trend(arm, own)) is not None]
    if not trends:
        return []
    # Changes of arms from day to day beyond their stated uncertainty widen all limits.
    squares = [float(np.median((t.change / t.sigma) ** 2)) for t in trends]
    scale = float(np.sqrt(max(np.median(squares) / MEDIAN_SQUARE, 1.0)))
    out = []
    for t in trends:
        limit = -scale * ndtri(FALSE_ALARMS / 2 / len(t.names)) * t.sigma
        best = int(np.argmax(np.abs(t.change) / limit))
        if abs(t.change[best]) > limit[best]:
            out.append(Drift(t.arm, t.names[best], float(t.change[best]), float(limit[best])))
    return out


def trend(arm: str, rows: Sequence[FleetRow]) -> Trend | None:
    """The trend of the kinematic parameters that all recordings determine; None for fewer than FEWEST recordings."""
    if len(rows) < FEWEST:
        return None
    names = [n for n in rows[0].names if "." not in n and all(n in row.estimates for row in rows)]
    if not names:
        return None
    value = np.array([[row.estimates[n][0] for n in names] for row in rows])
    weight = np.array([_information(row, names) for row in rows])
    p, x = len(names), np.linspace(0.0, 1.0, len(rows))
    moments = [np.einsum("i,ijk->jk", x**power, weight) for power in (0, 1, 2)]
    normal = np.block([[moments[0], moments[1]], [moments[1], moments[2]]])
    target = np.concatenate([np.einsum("i,ijk,ik->j", x**power, weight, value) for power in (0, 1)])
    # The line's start is eliminated: information and gradient of the slopes.
    back = np.linalg.solve(normal[:p, :p], normal[:p, p:])
    information = normal[p:, p:] - normal[p:, :p] @ back
    gradient = target[p:] - back.T @ target[:p]
    own = np.diag(information)
    return Trend(arm, tuple(names), gradient / own, own**-0.5)


def _information(row: FleetRow, names: Sequence[str]) -> np.ndarray:
    """(p, p) inverse covariance of the named parameters, whatever the others are."""
    covariance = row.covariance_of(names)
    size = np.sqrt(np.diag(covariance))
    scaled = covariance / np.outer(size, size)
    regular = scaled + REGULAR * np.linalg.eigvalsh(scaled)[-1] * np.eye(len(names))
    return np.linalg.inv(regular) / np.outer(size, size)

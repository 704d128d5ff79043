"""What a fleet says about the next arm of a type: mean and spread of the arms' errors, as the prior of its calibration.

Model: an arm's errors b ~ N(mu, diag(tau^2)); a calibration of it y ~ N(b, C) with its own covariance, where a parameter that was held
says nothing. mu and tau by maximum likelihood (EM; Laird and Ware 1982). The prior of a new arm is wider than tau by the uncertainty of mu
and by the few arms there are (variance of the predictive t distribution).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.estimation.options import ArmPrior
from mbcacq.fleet.control_chart import ArmType, arm_types
from mbcacq.fleet.row import FleetRow
from mbcacq.fleet.store import read_table
from mbcacq.geometry.chain import PARAMETERS
from mbcacq.model.cell import counted_axes, link_parameters

FEWEST_ARMS = 5  # the variance of the predictive distribution is finite from four arms on
ROUNDS, SETTLED = 500, 1e-4  # of the EM iteration; relative change of a standard deviation
LEAST = 1e-3  # of the first guess: arms that differ less are alike


def read_priors(fleet: Path | str) -> tuple[ArmPrior, ...]:
    """One prior for each type of arm of which the fleet has at least five. Raises ConfigError if it has none."""
    kinds = arm_types(read_table(Path(fleet)))
    found = tuple(prior for kind in kinds if (prior := learnt(kind)) is not None)
    if not found:
        raise ConfigError(f"{fleet} has less than {FEWEST_ARMS} calibrated arms of any type; a prior needs as many")
    return found


def learnt(kind: ArmType) -> ArmPrior | None:
    """The prior of one type of arm; None if there are too few."""
    nominal = np.array(kind.rows[0].nominal).reshape(-1, len(PARAMETERS))
    names = link_parameters(kind.rows[0].axes or counted_axes(len(nominal)))
    arms: dict[str, list[FleetRow]] = {}
    for row in kind.rows:
        arms.setdefault(row.arm, []).append(row)
    if len(arms) < FEWEST_ARMS:
        return None
    value, information = zip(*(combined(rows, names) for rows in arms.values()), strict=True)
    mean, sigma = population(np.array(value), np.array(information))
    return ArmPrior(kind.robot, nominal, mean.reshape(nominal.shape), sigma.reshape(nominal.shape), len(arms))


def combined(rows: Sequence[FleetRow], names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Errors (K,) of one arm over its recordings, and their information (K, K); zero where nothing was determined."""
    total, weighted = np.zeros((len(names), len(names))), np.zeros(len(names))
    for row in rows:
        here = [k for k, name in enumerate(names) if name in row.names]
        C = row.covariance_of([names[k] for k in here])
        scale = np.sqrt(np.diag(C))
        own = np.linalg.inv(C / np.outer(scale, scale)) / np.outer(scale, scale)
        error = np.array([row.estimates[names[k]][0] for k in here])
        total[np.ix_(here, here)] += own
        weighted[here] += own @ error
    known = np.flatnonzero(np.diag(total) > 0)
    value = np.zeros(len(names))
    if len(known):
        scale = np.sqrt(np.diag(total)[known])
        value[known] = np.linalg.solve(total[np.ix_(known, known)] / np.outer(scale, scale), weighted[known] / scale) / scale
    return value, total


def population(value: np.ndarray, information: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and predictive sigma (K,) of the next arm, from the errors (A, K) of A arms and their information (A, K, K).

    sigma is inf where fewer than FEWEST_ARMS arms know a parameter.
    """
    seen = np.diagonal(information, axis1=1, axis2=2) > 0
    count = seen.sum(axis=0)
    use = np.flatnonzero(count >= FEWEST_ARMS)
    mean, sigma = np.zeros(value.shape[1]), np.full(value.shape[1], np.inf)
    if not len(use):
        return mean, sigma
    scale = np.array([np.sqrt(np.mean(value[seen[:, k], k] ** 2)) or 1.0 for k in use])
    y = value[:, use] / scale
    A = information[:, use][:, :, use] * np.outer(scale, scale)
    tau, mu = np.ones(len(use)), np.zeros(len(use))
    identity = of_mean = np.eye(len(use))
    for _ in range(ROUNDS):
        # Covariance of the arm's own errors given its calibration: S = (T^-1 + A)^-1 = T^1/2 (I + T^1/2 A T^1/2)^-1 T^1/2.
        S = tau[:, None] * np.linalg.inv(identity + tau[:, None] * A * tau) * tau
        weight = A - A @ S @ A  # (T + C)^-1
        of_mean = np.linalg.inv(weight.sum(axis=0) + 1e-12 * identity)
        mu = of_mean @ np.einsum("aij,aj->i", weight, y)
        b = np.einsum("aij,ajk,ak->ai", S, A, y - mu)
        here = seen[:, use]
        # The restricted step: the uncertainty of mu counts as well.
        spread = np.diagonal(S, axis1=1, axis2=2) + np.diagonal((S @ A) @ of_mean @ np.swapaxes(S @ A, 1, 2), axis1=1, axis2=2)
        new = np.maximum(np.sqrt(np.sum((b**2 + spread) * here, axis=0) / here.sum(axis=0)), LEAST)
        change = float(np.max(np.abs(new / tau - 1)))
        tau = new
        if change < SETTLED:
            break
    few = (count[use] - 1) / (count[use] - 3)  # variance of Student's t, of as many degrees of freedom as there are arms less one
    mean[use] = scale * mu
    sigma[use] = scale * np.sqrt((tau**2 + np.diag(of_mean)) * few)
    return mean, sigma

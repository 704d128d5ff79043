"""Estimates of a result without the prior of the arm's links: what the recording alone says.

A prior of the size that link errors have lets every estimate lean towards nominal, by more where the poses determine less. That makes the
calibrated arm better; between two recordings it makes every change too small. With the posterior N(x, C) and the prior N(m, D) of the
links, the data alone give N(x + C_l (D - C_ll)^-1 (x_l - m), C + C_l (D - C_ll)^-1 C_l'). C_l are the columns of the links (Woodbury's
identity applied to the difference of the two informations).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbcacq.geometry import se3
from mbcacq.geometry.chain import PARAMETERS

LEAST = 1e-9  # share of a direction's prior variance that the data take away, below which rounding decides


@dataclass(frozen=True)
class OwnEstimate:
    """The estimate of a recording without the prior of the links.

    Attributes
    ----------
    error : Mapping[str, float]
        Error of the arm's parameters, value minus nominal, by name.
    covariance : ndarray
        (g, g) of ``names``.
    T_flange_scanner : ndarray
        (4, 4).
    known : bool
        Whether the result says which prior it used (an older one does not, and its estimates then stay as they are).
    """

    names: tuple[str, ...]
    error: Mapping[str, float]
    covariance: np.ndarray
    T_flange_scanner: np.ndarray
    known: bool

    def std(self, name: str) -> float:
        """Standard deviation of one parameter, of the hand-eye translation along the scanner's axes."""
        at = self.names.index(name)
        return float(np.sqrt(self.covariance[at, at]))


def without_prior(result: Mapping[str, Any]) -> OwnEstimate:
    """The estimates of a result.json without the prior of the links. Those of balls (their certificate) and of smooth errors stay."""
    names, C = tuple(map(str, result["names"])), np.array(result["covariance"], dtype=float)
    T = np.array(result["T_flange_scanner"], dtype=float)
    arm = {f"{p}_{i + 1}" for p in PARAMETERS for i in range(len(result["robot"]["sign"]))}
    error = {p["name"]: float(p["error"]) for p in result["parameters"]}
    links = [p for p in result["parameters"] if p["name"] in arm and p["status"] == "prior"]
    if any(p.get("prior_std") is None for p in links) or not links:
        return OwnEstimate(names, error, C, T, not links)
    at = [names.index(p["name"]) for p in links]
    size = np.array([float(p["prior_std"]) for p in links])
    away = np.array([float(p["error"]) - float(p.get("prior_mean", 0.0)) for p in links])
    value, vector = np.linalg.eigh(np.eye(len(at)) - C[np.ix_(at, at)] / size[:, None] / size)
    root = C[:, at] / size @ (vector / np.sqrt(np.maximum(value, LEAST)))
    shift = root @ (vector.T @ (away / size) / np.sqrt(np.maximum(value, LEAST)))
    own = {name: error[name] + float(shift[i]) for i, name in enumerate(names) if name in error and not name.startswith("hand_eye.")}
    turned = np.array([shift[names.index(f"hand_eye.{c}")] if f"hand_eye.{c}" in names else 0.0 for c in ("x", "y", "z", "rx", "ry", "rz")])
    return OwnEstimate(names, error | own, C + root @ root.T, T @ se3.exp(turned), True)

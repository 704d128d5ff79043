"""Covariances that a measurement states itself, as columns beside it.

``sigma_x_mm`` .. ``sigma_rz_deg`` are standard deviations; ``cov_x_x`` .. ``cov_rz_rz`` the entries on and above the diagonal (mm, rad);
``cov_0`` .. ``cov_35`` a row-major 6 x 6 matrix in metres and radians, as ROS messages have it. Rotations are about the axes of the
instrument. ``shared_1_x`` .. ``shared_K_rz`` (mm, rad) are changes by one standard deviation of errors that all measurements share.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.table import Table
from mbcacq.quantities import DEGREE
from mbcacq.recording.datasets.csv_columns import numbers

AXES = ("x", "y", "z", "rx", "ry", "rz")
LEAST = 1e-12  # of the largest eigenvalue of a correlation matrix: below it, it is singular


def _names(size: int) -> list[str]:
    return [f"cov_{AXES[i]}_{AXES[j]}" for i in range(size) for j in range(i, size)]


def read(table: Table, size: int) -> np.ndarray | None:
    """(rows, size, size) mm and rad, or None if there are no such columns. size: 3 of a point, 6 of a pose. Raises ConfigError."""
    sigmas = [f"sigma_{a}_{'mm' if i < 3 else 'deg'}" for i, a in enumerate(AXES[:size])]
    ros = [f"cov_{k}" for k in range(36)]
    if any(name in table.columns for name in sigmas):
        table.require(sigmas)
        sigma = table.numbers(sigmas) * np.where(np.arange(size) < 3, 1.0, DEGREE)
        C = sigma[:, :, None] ** 2 * np.eye(size)
    elif table.has(ros):
        unit = np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1.0])
        C = (table.numbers(ros).reshape(-1, 6, 6) * unit[:, None] * unit)[:, :size, :size]
    elif any(name in table.columns for name in _names(size)):
        table.require(_names(size))
        i, j = np.triu_indices(size)
        C = np.zeros((len(table), size, size))
        C[:, i, j] = C[:, j, i] = table.numbers(_names(size))
    else:
        return None
    _refuse_singular(table, C)
    return C


def read_shared(table: Table, size: int) -> np.ndarray | None:
    """(rows, size, K) mm and rad, or None if there are no such columns. Raises ConfigError."""
    count = sum(name.startswith("shared_") and name.endswith("_x") for name in table.columns)
    if not count:
        return None
    names = [f"shared_{k + 1}_{axis}" for axis in AXES[:size] for k in range(count)]
    table.require(names)
    return table.numbers(names).reshape(-1, size, count)


def shared_columns(shared: np.ndarray) -> dict[str, Sequence[str]]:
    """Columns of (M, size, K)."""
    return {f"shared_{k + 1}_{AXES[i]}": numbers(shared[:, i, k]) for k in range(shared.shape[2]) for i in range(shared.shape[1])}


def columns(C: np.ndarray) -> dict[str, Sequence[str]]:
    """Columns of covariances (M, size, size)."""
    i, j = np.triu_indices(C.shape[1])
    return dict(zip(_names(C.shape[1]), (numbers(C[:, a, b]) for a, b in zip(i, j, strict=True)), strict=True))


def _refuse_singular(table: Table, C: np.ndarray) -> None:
    sigma = np.sqrt(np.maximum(np.einsum("mii->mi", C), 0.0))
    positive = (sigma > 0).all(axis=1)
    correlation = C / np.where(sigma > 0, sigma, 1.0)[:, :, None] / np.where(sigma > 0, sigma, 1.0)[:, None, :]
    good = positive & (np.linalg.eigvalsh(correlation)[:, 0] > LEAST)
    if not good.all():
        row = int(np.argmin(good))
        raise ConfigError(f"{table.path}:{table.line[row]}: the covariance is not positive definite; correct it, or leave its columns out")

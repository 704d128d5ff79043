"""Angle adjustment (Eq. 8-12): measured centres are corrected until the angles between them are the certified ones.

Angles do not change with translation, rotation or scale: seven directions of the corrections stay undetermined, hence ridge regression, its
parameter from the L-curve (Hansen 1992). A scale error of the scanner survives this stage untouched.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from mbcacq.figure import Figure
from mbcacq.files.atomic_write import write_file


@dataclass(frozen=True)
class LCurve:
    """ridge: (L,) parameters; misfit: (L,) rad norm of the remaining angle errors; size: (L,) mm norm of the corrections; corner: index
    of the one taken."""

    ridge: np.ndarray
    misfit: np.ndarray
    size: np.ndarray
    corner: int

    def plot(self, path: Path | str) -> None:
        """Write the curve as an HTML page. Raises RecordingError."""
        label = [f"{value:.3g}" for value in self.ridge]
        figure = Figure().add_scatter(x=self.misfit, y=self.size, text=label, mode="lines+markers", name="ridge parameter")
        taken = {"x": self.misfit[[self.corner]], "y": self.size[[self.corner]], "marker": {"size": 12}}
        figure.add_scatter(mode="markers", name="taken", **taken)
        figure.update_xaxes(type="log", title="misfit of the angles (rad)")
        figure.update_yaxes(type="log", title="size of the corrections (mm)")
        write_file(path, figure.to_html())


def triples(n_balls: int) -> np.ndarray:
    """(K, 3) of vertex and two arms: every angle between n balls, n (n - 1) (n - 2) / 2 of them."""
    return np.array([(v, a, b) for v in range(n_balls) for a, b in combinations([i for i in range(n_balls) if i != v], 2)])


def angles(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles (P, K) rad at the corners (K, 3) of points (P, B, 3), and their derivative (P, K, 3 B) (Eq. 8, 9)."""
    v, a, b = corners.T
    to_a, to_b = points[:, a] - points[:, v], points[:, b] - points[:, v]
    la, lb = np.linalg.norm(to_a, axis=2, keepdims=True), np.linalg.norm(to_b, axis=2, keepdims=True)
    ua, ub = to_a / la, to_b / lb
    cosine = np.sum(ua * ub, axis=2, keepdims=True)
    sine = np.sqrt(np.maximum(1 - cosine**2, 1e-12))
    da, db = (cosine * ua - ub) / (la * sine), (cosine * ub - ua) / (lb * sine)
    out = np.zeros((*points.shape[:1], len(corners), points.shape[1], 3))
    k = np.arange(len(corners))
    out[:, k, a], out[:, k, b] = da, db
    out[:, k, v] = -(da + db)
    return np.arccos(np.clip(cosine[..., 0], -1, 1)), out.reshape(len(points), len(corners), -1)


def adjust(points: np.ndarray, certified: np.ndarray, ridge: float | None = None) -> tuple[np.ndarray, LCurve, np.ndarray]:
    """Corrected points (P, B, 3) of measured ones, B >= 3 balls with certified centres (B, 3). Also returns the L-curve that gave the ridge
    parameter, one for all poses (a given ``ridge`` is taken instead). The last value, (P, 3 B, 3 B), is the part of small errors of the
    points that the adjustment leaves."""
    corners = triples(points.shape[1])
    measured, B = angles(points, corners)
    wanted, _ = angles(certified[None], corners)
    d = wanted - measured
    U, s, Vt = np.linalg.svd(B, full_matrices=False)
    along = np.einsum("pki,pk->pi", U, d)
    beyond = np.sum(d**2) - np.sum(along**2)
    grid = np.logspace(-12, 2, 57) * float(np.max(s)) ** 2
    if ridge is not None:
        grid = np.append(grid, ridge)
    damp = s[None] ** 2 / (s[None] ** 2 + grid[:, None, None])
    misfit = np.sqrt(np.sum(((1 - damp) * along) ** 2, axis=(1, 2)) + max(beyond, 0.0))
    size = np.sqrt(np.sum((s / (s**2 + grid[:, None, None]) * along) ** 2, axis=(1, 2)))
    corner = len(grid) - 1 if ridge is not None else corner_of(misfit, size)
    curve = LCurve(grid, misfit, size, corner)
    step = np.einsum("pij,pi->pj", Vt, s / (s**2 + grid[corner]) * along)
    smoother = np.eye(Vt.shape[2]) - np.swapaxes(Vt, 1, 2) @ ((s**2 / (s**2 + grid[corner]))[..., None] * Vt)
    return points + step.reshape(points.shape), curve, smoother


def corner_of(misfit: np.ndarray, size: np.ndarray) -> int:
    """Index of the largest curvature of (log misfit, log size)."""
    x, y = np.log(np.maximum(misfit, 1e-300)), np.log(np.maximum(size, 1e-300))
    dx, dy = np.gradient(x), np.gradient(y)
    ddx, ddy = np.gradient(dx), np.gradient(dy)
    speed = (dx**2 + dy**2) ** 1.5
    curvature = np.where(speed > 1e-12, (dx * ddy - dy * ddx) / np.maximum(speed, 1e-12), 0.0)
    inner = slice(2, -2)
    return 2 + int(np.argmax(np.abs(curvature[inner])))

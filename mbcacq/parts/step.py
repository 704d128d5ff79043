"""The rigid step between two scans of one surface, from the distances in their overlap: generalised least squares.

Neighbouring cells share the smooth error of a scan, so their covariance is s^2 exp(-d^2 / 2 l^2) beside the scatter of the points. These
numbers are those of the scanner: they are estimated from all overlaps together by restricted maximum likelihood (Patterson and Thompson
1971).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from mbcacq.parts.options import PartOptions
from mbcacq.parts.overlap import Overlap
from mbcacq.parts.placement import rigid_columns

MOST_FOR_NOISE = 150  # cells of an overlap from which the smooth noise is estimated
OVERLAPS_FOR_NOISE = 40


@dataclass(frozen=True)
class SmoothNoise:
    """The noise of the distance of two scans: sigma_mm of what varies over length_mm, and the share of the scatter in a cell that is noise.

    The rest of that scatter is shape of the surface beyond the cell's quadric, which both scans have, and which cancels in their distance.
    """

    sigma_mm: float
    length_mm: float
    share: float = 1.0

    @property
    def of_two(self) -> SmoothNoise:
        """That of the distance of two scans, if this is of one."""
        return replace(self, sigma_mm=np.sqrt(2) * self.sigma_mm)

    def covariance(self, cells: Overlap) -> np.ndarray:
        """(c, c) mm^2 of the distances."""
        return self.covariance_of(cells.point, cells.variance)

    def covariance_of(self, points: np.ndarray, variance: np.ndarray) -> np.ndarray:
        """(c, c) mm^2 of heights at points (c, 3) mm, whose own variance (c,) is known."""
        return self.by_distance(cdist(points, points, "sqeuclidean"), variance)

    def by_distance(self, square: np.ndarray, variance: np.ndarray) -> np.ndarray:
        """(c, c) mm^2 of heights whose points are apart by the roots of ``square`` (c, c) mm^2."""
        return self.sigma_mm**2 * np.exp(-square / (2 * self.length_mm**2)) + self.share * np.diag(variance)


@dataclass(frozen=True)
class RigidStep:
    """How the first scan of a pair stands to the second.

    Attributes
    ----------
    twist : ndarray
        (6,) mm and rad, base frame, about ``centre``; nothing along what the overlap does not determine.
    covariance : ndarray
        (6, 6) of it.
    centre : ndarray
        (3,) mm.
    determined : ndarray
        (6, r) orthonormal directions of ``scaled`` motions that the overlap determines.
    radius_mm : float
        Lever by which rotations are compared with shifts.
    cells : Overlap
        The cells that count.
    left_out : int
        Number of cells with gross differences.
    """

    twist: np.ndarray
    covariance: np.ndarray
    centre: np.ndarray
    determined: np.ndarray
    radius_mm: float
    cells: Overlap
    left_out: int

    @property
    def scaled(self) -> np.ndarray:
        """(6,) factors that turn all components of a twist into mm."""
        return np.repeat([1.0, self.radius_mm], 3)

    def shown(self, twist: np.ndarray) -> np.ndarray:
        """The part (6,) of a twist that the overlap determines."""
        return (self.determined @ (self.determined.T @ (self.scaled * twist))) / self.scaled

    def rms_mm(self, twist: np.ndarray) -> float:
        """Movement of the overlap by the determined part of a twist (6,), rms over its cells, 3D."""
        return float(np.sqrt(np.mean(np.sum((rigid_columns(self.cells.point - self.centre) @ self.shown(twist)) ** 2, axis=1))))

    def expected_mm(self, covariance: np.ndarray) -> float:
        """rms of ``rms_mm`` of twists with a covariance (6, 6)."""
        P = self.determined @ self.determined.T * self.scaled / self.scaled[:, None]
        moved = rigid_columns(self.cells.point - self.centre) @ P
        return float(np.sqrt(np.mean(np.einsum("kci,ij,kcj->k", moved, covariance, moved))))

    def normalised(self, twist: np.ndarray, covariance: np.ndarray) -> float:
        """Square of a twist (6,) in the determined directions over what a covariance (6, 6) expects, per direction (NEES)."""
        G = self.determined.T * self.scaled
        return float((G @ twist) @ np.linalg.solve(G @ covariance @ G.T, G @ twist) / G.shape[0])

    @property
    def undetermined(self) -> list[str]:
        """The motions that the overlap does not determine, in words."""
        return in_words(np.linalg.svd(self.determined)[0][:, self.determined.shape[1] :], self.scaled, self.centre)


def rigid_step(cells: Overlap, noise: SmoothNoise, options: PartOptions) -> RigidStep:
    """The step of an overlap with at least ``options.cells[0]`` cells."""
    everything = len(cells)
    if everything > options.cells[1]:
        cells = cells.some(np.linspace(0, everything - 1, options.cells[1]).astype(int))
    count, step = len(cells), _solved(cells, noise, options)
    for _ in range(options.rounds):
        J = np.einsum("kc,kci->ki", step.cells.normal, rigid_columns(step.cells.point - step.centre))
        left = step.cells.distance - J @ step.twist
        sigma = 1.4826 * np.median(np.abs(left - np.median(left)))
        good = np.abs(left) < options.gross * max(sigma, float(np.sqrt(np.median(step.cells.variance))))
        if good.all() or good.sum() < options.cells[0]:
            break
        step = _solved(step.cells.some(good), noise, options)
    return replace(step, left_out=count - len(step.cells))


def _solved(cells: Overlap, noise: SmoothNoise, options: PartOptions) -> RigidStep:
    centre, scale, J, determined, _ = motions(cells.point, cells.normal, options)
    whitened = np.linalg.cholesky(noise.covariance(cells))
    A, r = (solve_triangular(whitened, side, lower=True) for side in (J @ determined, cells.distance))
    covariance, D = np.linalg.inv(A.T @ A), determined / scale[:, None]
    twist, covariance = D @ covariance @ (A.T @ r), D @ covariance @ D.T
    return RigidStep(
        twist=twist, covariance=covariance, centre=centre, determined=determined, radius_mm=float(scale[3]), cells=cells, left_out=0
    )


def motions(points: np.ndarray, normals: np.ndarray, options: PartOptions) -> tuple[np.ndarray, ...]:
    """The rigid motions of a surface about its middle: which of them show themselves in distances along its normals.

    Returns the middle (3,) mm, factors (6,) that turn a twist into mm, the columns (c, 6) of the distances by twists in mm, and
    orthonormal directions (6, r) and (6, 6 - r) of these that are determined and that are not.
    """
    centre = points.mean(axis=0)
    arms = points - centre
    scale = np.repeat([1.0, float(np.sqrt(np.mean(np.sum(arms**2, axis=1))))], 3)
    J = np.einsum("kc,kci->ki", normals, rigid_columns(arms)) / scale
    values, vectors = np.linalg.eigh(J.T @ J / len(J))
    return centre, scale, J, vectors[:, values > options.slope**2], vectors[:, values <= options.slope**2]


def smooth_noise(overlaps: Sequence[Overlap], options: PartOptions) -> SmoothNoise:
    """The smooth noise of the scanner from overlaps whose scans are nearly in place."""
    rng = np.random.default_rng(0)
    chosen = [overlaps[k] for k in np.unique(np.linspace(0, len(overlaps) - 1, OVERLAPS_FOR_NOISE).astype(int))]
    some = []
    for cells in chosen:
        kept = rigid_step(cells, SmoothNoise(0.0, 1.0), options).cells
        some.append(kept.some(rng.permutation(len(kept))[:MOST_FOR_NOISE]))
    spans = [float(np.ptp(cells.point, axis=0).max()) for cells in some]
    squares = [cdist(cells.point, cells.point, "sqeuclidean") for cells in some]
    shortest = float(np.median([np.sqrt(np.partition(square, 1)[:, 1]).mean() for square in squares]))
    sides = [np.c_[motions(cells.point, cells.normal, options)[2], cells.distance] for cells in some]

    def cost(at: np.ndarray) -> float:
        noise = SmoothNoise(*np.exp(at).tolist())
        return sum(_restricted_cost(noise.by_distance(d, o.variance), b) for d, o, b in zip(squares, some, sides, strict=True))

    sigma = np.sqrt(np.median([np.median(cells.variance) for cells in some]))
    low, high = np.log([0.01 * sigma, 0.5 * shortest, 0.05]), np.log([30 * sigma, 0.5 * float(np.median(spans)), 2.0])
    starts = [np.log([sigma, length, 0.7]) for length in (2 * shortest, 0.2 * float(np.median(spans)))]
    limits, exact = list(zip(low, high, strict=True)), {"xatol": 0.02, "fatol": 0.1}
    found = minimize(cost, min(starts, key=cost), method="Nelder-Mead", bounds=limits, options=exact)
    return SmoothNoise(*np.exp(found.x).tolist())


def _restricted_cost(covariance: np.ndarray, sides: np.ndarray) -> float:
    """-2 times the restricted log likelihood of an overlap's distances, but for a constant.

    covariance: (c, c) of the distances. sides: (c, 7) their columns by rigid motions, and they themselves.
    """
    L = np.linalg.cholesky(covariance)
    white = solve_triangular(L, sides, lower=True, check_finite=False)
    U, s, _ = np.linalg.svd(white[:, :6], full_matrices=False)
    r = white[:, 6] - U @ (U.T @ white[:, 6])
    return float(2 * np.log(np.diag(L)).sum() + 2 * np.log(s).sum() + r @ r)


def in_words(directions: np.ndarray, scale: np.ndarray, centre: np.ndarray) -> list[str]:
    """Motions of a surface in words, turns before shifts: orthonormal directions (6, r), each to be divided by factors (6,)."""
    turning = np.linalg.svd(directions[3:])[2]
    return [_one_in_words(v / scale, centre) for v in turning @ directions.T]


def _one_in_words(twist: np.ndarray, centre: np.ndarray) -> str:
    """A motion that leaves a surface on itself: a shift along a direction, or a turn about an axis through a point, base frame."""
    shift, turn = twist[:3], twist[3:]
    angle = float(np.linalg.norm(turn))
    if angle * 1e3 < float(np.linalg.norm(shift)):  # the axis is more than 1 m away: nearly a shift
        return "along ({:z.2f}, {:z.2f}, {:z.2f})".format(*shift / np.linalg.norm(shift))
    at = centre + np.cross(turn, shift) / angle**2
    return "about ({:z.2f}, {:z.2f}, {:z.2f}) through ({:z.0f}, {:z.0f}, {:z.0f}) mm".format(*turn / angle, *at)

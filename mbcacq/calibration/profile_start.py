"""Hand-eye calibration from line profiles of one sphere: start values, and each profile as a measured centre.

The laser plane is y = 0 of the scanner. It cuts the sphere (centre s in the scanner's frame, radius R) in a circle about (s_x, s_z) of
radius sqrt(R^2 - s_y^2). A profile thus measures s_x, s_z and the absolute value of s_y; near the sphere's equator it hardly measures s_y.
The start decides the signs; linearised there, each profile is a centre with a covariance of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from mbcacq.geometry import se3
from mbcacq.spheres.circles import Circle

STARTS_OF = 60  # profiles that the start is searched with: more decide no better
CLEARLY = 3.0  # times the misfit of the best transform, below which another is as likely
NEVER_MM = 0.02  # misfits below are noise
EQUATOR = 0.02  # |s_y| over the radius, below which a profile says nothing of s_y
STARTS, FINISHES = 60, 20  # rounds of the search for a start, and of its improvement
ROUNDS = 15  # of the adjustment of the radius
MEDIAN_OF_THREE = 1.538  # of the length of three normal numbers
SOFT_MM = 0.1  # misfit from which a profile counts less
APART_MM, APART_RAD = 1.0, 0.02  # two transforms nearer than that are the same


@dataclass(frozen=True)
class ProfileStart:
    """T_hand_eye (4, 4) and the sphere (3,) mm where it rests; misfit_mm: rms of what circles and sphere miss each other by; other_mm:
    that of the next best transform; sphere_in_scanner (P, 3) mm."""

    T_hand_eye: np.ndarray
    sphere: np.ndarray
    misfit_mm: float
    other_mm: float
    sphere_in_scanner: np.ndarray

    @property
    def ambiguous(self) -> bool:
        return self.other_mm < CLEARLY * max(self.misfit_mm, NEVER_MM)


def find_start(hand: np.ndarray, circles: Sequence[Circle], radius: float, starts_of: int = STARTS_OF) -> ProfileStart:
    """The transform behind the moving frame ``hand`` (P, 4, 4) that lets one sphere of ``radius`` mm make all circles.

    hand: T_base_flange of each profile, or its inverse where the scanner is fixed. Levenberg-Marquardt from each of the 24 rotations of a
    cube, all at once; the best is improved with the weights of all profiles.
    """
    middle = np.array([c.centre for c in circles])
    size = np.array([c.radius for c in circles])
    few = np.unique(np.linspace(0, len(hand) - 1, min(starts_of, len(hand))).round().astype(int))
    first = [_linear_start(R, hand[few], middle[few]) for R in _cube_rotations()]
    section = _Section(hand[few], middle[few], size[few], radius)
    T, sphere, cost = _minimised(section, np.array([f[0] for f in first]), np.array([f[1] for f in first]), STARTS)
    best = int(np.argmin(cost))
    whole = _Section(hand, middle, size, radius)
    T_best, sphere_best, _ = _minimised(whole, T[best : best + 1], sphere[best : best + 1], FINISHES, robust=True)
    X, c = T_best[0], sphere_best[0]
    others = [float(np.sqrt(one / len(few))) for one, t in zip(cost, T, strict=True) if not _same(t, X)]
    off, s = whole.missed(X[None], c[None])
    misfit = float(np.sqrt(np.median(np.sum(off[0] ** 2, axis=1))))
    return ProfileStart(X, c, misfit, min(others, default=np.inf), s[0])


def radius_by_profiles(hand: np.ndarray, circles: Sequence[Circle], radius: float, start: ProfileStart) -> tuple[float, float]:
    """The radius that the profiles alone say, mm, and its standard uncertainty: hand-eye, sphere and radius adjusted together, each circle
    weighted by its own covariance, robustly. Infinite uncertainty where they do not say it."""
    middle, size = np.array([c.centre for c in circles]), np.array([c.radius for c in circles])
    root = np.linalg.inv(np.linalg.cholesky(np.array([c.cofactor for c in circles])))
    T, c, R = start.T_hand_eye[None], start.sphere[None], radius
    whole, size_of, scale = np.eye(10), np.ones(10), 1.0
    for _ in range(ROUNDS):
        section = _Section(hand, middle, size, R)
        off, s = section.missed(T, c)
        J = np.zeros((len(hand), 3, 10))
        J[:, :, :9], J[:, 2, 9] = section.jacobian(T, s)[0], -R / size
        r, J = (root @ off[0][..., None])[..., 0], root @ J
        distance = np.linalg.norm(r, axis=1)
        scale = max(float(np.median(distance)) / MEDIAN_OF_THREE, 1e-12)
        weight = 1 / np.maximum(distance / (2 * scale), 1.0)
        normal = np.einsum("pia,p,pib->ab", J, weight, J)
        size_of = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        whole = normal / np.outer(size_of, size_of)
        step = -np.linalg.lstsq(whole, np.einsum("pia,p,pi->a", J, weight, r) / size_of, rcond=1e-12)[0] / size_of
        T = se3.transform(T[:, :3, :3] @ se3.rotation_exp(step[None, 3:6]), T[:, :3, 3] + step[:3])
        c, R = c + step[6:9], R + float(np.clip(step[9], -0.1 * radius, 0.1 * radius))
    if not np.isfinite(whole).all() or np.linalg.cond(whole) > 1e12:
        return R, np.inf
    return R, float(scale * np.sqrt(np.linalg.inv(whole)[9, 9]) / size_of[9])


def measured_centres(
    start: ProfileStart, circles: Sequence[Circle], radius: float | np.ndarray, noise_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Centre (P, 3) mm of the sphere as each profile has it, and its covariance (P, 3, 3), linearised at the start.

    From r^2 = R^2 - s_y^2: s_y = h + (R^2 - h^2 - r^2) / (2 h) and ds_y/dr = -r / h, with h the s_y of the start.
    """
    centres, covariances = [], []
    radii = np.broadcast_to(radius, len(circles))
    for circle, h, radius in zip(circles, start.sphere_in_scanner[:, 1], radii, strict=True):
        r, of_circle = circle.radius, noise_mm**2 * circle.cofactor
        if abs(h) > EQUATOR * radius:
            y = h + (radius**2 - h**2 - r**2) / (2 * h)
            J = np.array([[1.0, 0, 0], [0, 0, -r / h], [0, 1, 0]])
            C = J @ of_circle @ J.T
        else:
            y, C = h, np.zeros((3, 3))
            C[np.ix_((0, 2), (0, 2))], C[1, 1] = of_circle[:2, :2], radius**2
        centres.append([circle.centre[0], y, circle.centre[1]])
        covariances.append(C)
    return np.array(centres), np.array(covariances)


def section_rows(
    hand: np.ndarray, circles: Sequence[Circle], radius: np.ndarray, T_hand_eye: np.ndarray, spheres: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What each circle misses its own sphere by.

    hand: (P, 4, 4); radius: (P,) mm; spheres: (P, 3) mm, of each circle.

    Returns the rows (P, 3) mm, their derivatives (P, 3, 3) by the place of the sphere in the scanner, that place (P, 3) mm, and the
    derivatives (P, 3, 9) by translation and rotation behind the transform (4, 4), and by the sphere.
    """
    middle, size = np.array([c.centre for c in circles]), np.array([c.radius for c in circles])
    section = _Section(hand, middle, size, radius)
    rows, s = section.missed(T_hand_eye[None], spheres[None])
    by_place = np.zeros((len(size), 3, 3))
    by_place[:, 0, 0] = by_place[:, 1, 2] = -1.0
    by_place[:, 2, 1] = s[0, :, 1] / size
    return rows[0], by_place, s[0], section.jacobian(T_hand_eye[None], s)[0]


@dataclass(frozen=True)
class _Section:
    """Circles of spheres: hand (P, 4, 4), their middles (P, 2) and sizes (P,), and the radius of the sphere, or (P,) of each, mm."""

    hand: np.ndarray
    middle: np.ndarray
    size: np.ndarray
    radius: float | np.ndarray

    def missed(self, T: np.ndarray, sphere: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(K, P, 3) mm by which middles and sizes differ from those of K transforms (K, 4, 4) and spheres (K, 3), or (K, P, 3) of each
        circle, and the place of the sphere in the scanner (K, P, 3)."""
        away = (sphere[:, None] if sphere.ndim == 2 else sphere) - self.hand[:, :3, 3]
        in_hand = np.einsum("pji,kpj->kpi", self.hand[:, :3, :3], away)
        s = np.einsum("kji,kpj->kpi", T[:, :3, :3], in_hand - T[:, None, :3, 3])
        of_size = (self.size**2 - self.radius**2 + s[..., 1] ** 2) / (2 * self.size)
        return np.stack([self.middle[:, 0] - s[..., 0], self.middle[:, 1] - s[..., 2], of_size], axis=2), s

    def jacobian(self, T: np.ndarray, s: np.ndarray) -> np.ndarray:
        """(K, P, 3, 9) of ``missed`` by translation, rotation behind the transform, and sphere. s turns with the rotation as s x w."""
        back = np.swapaxes(T[:, :3, :3], 1, 2)
        count = self.hand.shape[0]
        by_sphere = np.einsum("kij,pmj->kpim", back, self.hand[:, :3, :3])
        ds = np.concatenate([np.broadcast_to(-back[:, None], (len(T), count, 3, 3)), se3.skew(s), by_sphere], axis=3)
        return np.stack([-ds[:, :, 0], -ds[:, :, 2], (s[..., 1] / self.size)[..., None] * ds[:, :, 1]], axis=2)


def _minimised(
    section: _Section, T: np.ndarray, sphere: np.ndarray, rounds: int, robust: bool = False
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """K transforms, spheres and sums of squares after ``rounds`` of Levenberg-Marquardt, each with a damping of its own."""
    off, s = section.missed(T, sphere)
    cost, damping = np.sum(off**2, axis=(1, 2)), np.full(len(T), 1e-2)
    for _ in range(rounds):
        weight = 1 / np.sqrt(1 + np.sum(off**2, axis=2) / SOFT_MM**2) if robust else np.ones(off.shape[:2])
        J = section.jacobian(T, s)
        weighted = J * weight[..., None, None]
        normal = np.einsum("kpia,kpib->kab", weighted, J)
        gradient = np.einsum("kpia,kpi->ka", weighted, off)
        scale = np.einsum("kaa->ka", normal) + 1e-12
        step = -np.linalg.solve(normal + damping[:, None, None] * scale[:, :, None] * np.eye(9), gradient[..., None])[..., 0]
        t = T[:, :3, 3] + step[:, :3]
        tried = se3.transform(T[:, :3, :3] @ se3.rotation_exp(step[:, 3:6]), t), sphere + step[:, 6:]
        off_tried, s_tried = section.missed(*tried)
        size = np.sum((weight[..., None] if robust else 1.0) * off_tried**2, axis=(1, 2))
        better = size < (np.sum(weight[..., None] * off**2, axis=(1, 2)) if robust else cost)
        T, sphere = np.where(better[:, None, None], tried[0], T), np.where(better[:, None], tried[1], sphere)
        off, s = np.where(better[:, None, None], off_tried, off), np.where(better[:, None, None], s_tried, s)
        cost = np.sum(off**2, axis=(1, 2))
        damping = np.clip(np.where(better, damping / 10, damping * 10), 1e-10, 1e6)
    return T, sphere, cost


def _linear_start(R: np.ndarray, hand: np.ndarray, middle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Transform and sphere by least squares for a rotation R (3, 3), as if every circle were an equator."""
    s = np.column_stack([middle[:, 0], np.zeros(len(middle)), middle[:, 1]])
    turned = hand[:, :3, :3] @ R
    columns = np.concatenate([hand[:, :3, :3], np.broadcast_to(-np.eye(3), (len(hand), 3, 3))], axis=2).reshape(-1, 6)
    right = -(np.einsum("pij,pj->pi", turned, s) + hand[:, :3, 3])
    found = np.linalg.lstsq(columns, right.ravel(), rcond=None)[0]
    return se3.transform(R, found[:3]), found[3:]


def _cube_rotations() -> list[np.ndarray]:
    """The 24 rotations that bring a cube onto itself."""
    out = []
    for order, signs in product(permutations(range(3)), product((1.0, -1.0), repeat=3)):
        R = np.zeros((3, 3))
        R[range(3), order] = signs
        if np.linalg.det(R) > 0:
            out.append(R)
    return out


def _same(a: np.ndarray, b: np.ndarray) -> bool:
    off = se3.inverse(a) @ b
    return bool(np.linalg.norm(off[:3, 3]) < APART_MM and np.linalg.norm(se3.rotation_log(off[:3, :3])) < APART_RAD)

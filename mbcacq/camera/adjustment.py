"""Least squares over the images alone: the target's pose in each of them, and the intrinsics that they share.

The images enter the calibration of the cell as what they say of the target's poses, with nothing left out but curvature (Schur complement;
Triggs et al. 2000, Bundle adjustment, section 6). With the intrinsics at their estimate, image i gives the pose T_i with covariance
``inv(A_i)``; an error of the intrinsics moves it by ``inv(A_i) B_i`` times that error; and all images together give the error a normal
distribution, whose covariance has the root L. ``inv(A_i) B_i L`` are errors of variance 1 that all measurements share, which the
calibration estimates with everything else: poses of the flange say more of the intrinsics than images alone do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.camera.board import LEAST_POINTS, Board
from mbcacq.camera.intrinsics import NAMES, Intrinsics, opencv
from mbcacq.errors import CalibrationError
from mbcacq.geometry import se3

ROUNDS = 12
GROSS = 5.0  # sigma of a coordinate, beyond which a point is no part of the board
CONTRADICTS = 4.0  # times the usual rms of an image, beyond which it contradicts itself
LEAST_CONTRADICTION_PX = 0.5  # detectors place corners within 0.1 px; an image that is blurred has so much noise, which counts as its own
MOST_GROSS = 0.3  # of the points of an image that may be gross errors
IMAGE_DOF = 20.0  # degrees of freedom by which the noise of all images counts as that of each
UNKNOWN_FOCAL = 0.03  # relative uncertainty (k = 1) of the focal length, beyond which images determine no intrinsics
LEAST_IMAGES = 4  # that determine intrinsics
RIM = 48  # corners of the polygon that takes a circle's place
# Lenses have distortion coefficients of this size at most (standard deviations of a prior); without it few images leave some of them open.
PRIOR = {"k1": 1.0, "k2": 1.0, "p1": 0.05, "p2": 0.05, "k3": 1.0}


@dataclass(frozen=True)
class BoardView:
    """What an image shows of a board. ids: (n,) its points; uv: (n, 2) px."""

    name: str
    ids: np.ndarray
    uv: np.ndarray


@dataclass(frozen=True, kw_only=True)
class AdjustedImages:
    """Images adjusted.

    Attributes
    ----------
    intrinsics : Intrinsics
        As given, or estimated.
    root : (K, K') ndarray
        Root of the covariance of their values that the images alone leave; no columns where they were given.
    T : (I, 4, 4) ndarray
        T_camera_board, mm.
    covariance : (I, 6, 6) ndarray
        Of place and rotation vector in the camera's frame, with the intrinsics as they are.
    shared : (I, 6, K') ndarray
        Change of these by one standard deviation of each error that all images share.
    sigma_px : float
        Noise of one coordinate of a point.
    rms_px, worst_px : (I,) ndarray
        Reprojection errors of each image: rms of a coordinate over the points used, largest distance of all points.
    points, rejected : (I,) ndarray
        Number of points used, and of gross errors.
    contradicts : (I,) ndarray
        bool, whether an image contradicts itself: no pose of the board explains it.
    """

    intrinsics: Intrinsics
    root: np.ndarray
    T: np.ndarray
    covariance: np.ndarray
    shared: np.ndarray
    sigma_px: float
    rms_px: np.ndarray
    worst_px: np.ndarray
    points: np.ndarray
    rejected: np.ndarray
    contradicts: np.ndarray

    @property
    def uncertainty(self) -> np.ndarray:
        """(K,) standard uncertainties of the intrinsics by the images alone."""
        return np.sqrt((self.root**2).sum(axis=1))


def adjust_images(board: Board, views: Sequence[BoardView], size: tuple[int, int], given: Intrinsics | None = None) -> AdjustedImages:
    """The target's poses in some views, and the intrinsics where none are given. size: (width, height) px of the images.

    Raises CalibrationError if the images do not determine the intrinsics.
    """
    start = given or _first_intrinsics(board, views, size)
    problem = _Problem(board, views, estimated=given is None)
    return problem.solved(start)


def _first_intrinsics(board: Board, views: Sequence[BoardView], size: tuple[int, int]) -> Intrinsics:
    """By the method of Zhang (2000), as OpenCV has it."""
    cv2 = opencv()
    if len(views) < LEAST_IMAGES:
        raise CalibrationError(f"{len(views)} image(s) show the board; intrinsics need {LEAST_IMAGES} and more: give --camera FILE")
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_ASPECT_RATIO
    objects = [board.points[v.ids].astype(np.float32) for v in views]
    K = cv2.initCameraMatrix2D(objects, [v.uv.astype(np.float32) for v in views], size)
    try:
        _, K, distortion, *_ = cv2.calibrateCamera(objects, [v.uv.astype(np.float32) for v in views], size, K, None, flags=flags)
    except cv2.error as error:
        raise CalibrationError(f"the images determine no intrinsics ({error.err}); tilt the board more, or give --camera FILE") from None
    return Intrinsics(np.array([K[0, 0], K[1, 1]]), K[:2, 2].copy(), np.resize(distortion, 5), size=size)


class _Problem:
    """All points of all views as arrays over corners. ids, image: (n,); uv: (n, 2)."""

    def __init__(self, board: Board, views: Sequence[BoardView], *, estimated: bool):
        self.board, self.count, self.estimated = board, len(views), estimated
        self.image = np.repeat(np.arange(len(views)), [len(v.ids) for v in views])
        self.points = board.points[np.concatenate([v.ids for v in views])]
        self.uv = np.concatenate([v.uv for v in views])

    def solved(self, lens: Intrinsics) -> AdjustedImages:
        T = self._first_poses(lens)
        weight, sigma = np.ones(len(self.uv)), np.ones(self.count)
        for _ in range(ROUNDS):
            r, J, Jk = self._rows(lens, T)
            weight = self._not_gross(r)
            sigma = self._noise(r, weight)
            normal = _Normal(self, r, J, Jk, weight / sigma[self.image] ** 2, lens)
            step, own = normal.steps()
            lens = lens.moved(step) if self.estimated else lens
            T = T.copy()
            T[:, :3, 3] += own[:, :3]
            T[:, :3, :3] = se3.rotation_exp(own[:, 3:]) @ T[:, :3, :3]
            if np.abs(own / normal.sigma).max() < 1e-3:
                break
        return self._result(lens, T, sigma, weight)

    def _first_poses(self, lens: Intrinsics) -> np.ndarray:
        """The better of the two poses in which a plane looks alike from far (Collins, Bartoli 2014)."""
        cv2, out = opencv(), []
        rays = lens.rays(self.uv)
        for i in range(self.count):
            here = self.image == i
            _, turns, places, errors = cv2.solvePnPGeneric(self.points[here], rays[here], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
            best = int(np.argmin(errors))
            out.append(se3.transform(se3.rotation_exp(turns[best].ravel()), places[best].ravel()))
        return np.array(out)

    def _rows(self, lens: Intrinsics, T: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Residual (n, 2), and its columns by the poses (n, 2, 6) and by the intrinsics (n, 2, K)."""
        turned = np.einsum("nij,nj->ni", T[self.image, :3, :3], self.points)
        uv, by_point, by_lens = lens.project(turned + T[self.image, :3, 3])
        if self.board.circles:
            uv = uv + self._off_centre(lens, T, uv)
        by_turn = -by_point @ se3.skew(turned)
        return self.uv - uv, np.concatenate([by_point, by_turn], axis=2), by_lens if self.estimated else by_lens[:, :, :0]

    def _off_centre(self, lens: Intrinsics, T: np.ndarray, uv: np.ndarray) -> np.ndarray:
        """(n, 2): what is found is the centroid of a circle's image, which is not the image of its centre (Heikkila 2000)."""
        angle = np.linspace(0, 2 * np.pi, RIM, endpoint=False)
        # A polygon with the circle's area.
        radius = 0.5 * self.board.inner_mm * np.sqrt((2 * np.pi / RIM) / np.sin(2 * np.pi / RIM))
        rim = self.points[:, None] + radius * np.c_[np.cos(angle), np.sin(angle), np.zeros(RIM)]
        rim = np.einsum("nij,nkj->nki", T[self.image, :3, :3], rim) + T[self.image, None, :3, 3]
        a = lens.project(rim.reshape(-1, 3))[0].reshape(-1, RIM, 2) - uv[:, None]
        b = np.roll(a, -1, axis=1)
        cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
        return ((a + b) * cross[..., None]).sum(axis=1) / (3 * cross.sum(axis=1))[:, None]

    def _not_gross(self, r: np.ndarray) -> np.ndarray:
        """(n,) 1 or 0, by the robust scale of the point's image."""
        size = np.linalg.norm(r, axis=1)
        scale = np.array([np.median(size[self.image == i]) for i in range(self.count)]) / np.sqrt(2 * np.log(2))
        usual = np.median(scale)
        return (size < GROSS * np.maximum(scale, 0.3 * usual)[self.image]).astype(float)

    def _noise(self, r: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """(I,) sigma of a coordinate in each image: its own, drawn towards that of all images."""
        squares = np.bincount(self.image, weight * (r**2).sum(axis=1), self.count)
        dof = np.maximum(2 * np.bincount(self.image, weight, self.count) - 6, 0)
        usual = np.median(squares[dof > 0] / dof[dof > 0]) if (dof > 0).any() else 1.0
        return np.maximum(np.sqrt((squares + IMAGE_DOF * usual) / (dof + IMAGE_DOF)), 1e-4)

    def _result(self, lens: Intrinsics, T: np.ndarray, sigma: np.ndarray, weight: np.ndarray) -> AdjustedImages:
        r, J, Jk = self._rows(lens, T)
        normal = _Normal(self, r, J, Jk, weight / sigma[self.image] ** 2, lens)
        size, used = np.linalg.norm(r, axis=1), np.bincount(self.image, weight, self.count)
        rms = np.sqrt(np.bincount(self.image, weight * size**2, self.count) / np.maximum(2 * used, 1))
        gross = np.bincount(self.image, 1 - weight, self.count)
        worst = np.zeros(self.count)
        np.maximum.at(worst, self.image, size)
        root = np.linalg.cholesky(np.linalg.inv(normal.schur)) if self.estimated else np.zeros((len(lens.values), 0))
        if self.estimated and (off := np.sqrt((root[:2] ** 2).sum(axis=1)) / lens.focal).max() > UNKNOWN_FOCAL:
            raise CalibrationError(
                f"the images determine the focal length to {100 * off.max():.0f} % only; tilt the board by 20 to 40 deg in different "
                "directions, or give --camera FILE"
            )
        bad = (
            (rms > max(CONTRADICTS * float(np.median(rms)), LEAST_CONTRADICTION_PX))
            | (gross > MOST_GROSS * (gross + used))
            | (used < min(LEAST_POINTS, len(self.board.points)))
        )
        return AdjustedImages(
            intrinsics=lens,
            root=root,
            T=T,
            covariance=normal.inverse,
            shared=normal.inverse @ normal.B @ root if self.estimated else np.zeros((self.count, 6, 0)),
            sigma_px=float(np.sqrt(np.median(sigma**2))),
            rms_px=rms,
            worst_px=worst,
            points=used.astype(int),
            rejected=gross.astype(int),
            contradicts=bad,
        )


class _Normal:
    """Normal equations condensed image by image. inverse: (I, 6, 6) of A; B: (I, 6, K); schur: (K, K), with the prior of the lens."""

    def __init__(self, problem: _Problem, r: np.ndarray, J: np.ndarray, Jk: np.ndarray, weight: np.ndarray, lens: Intrinsics):
        image, count = problem.image, problem.count
        starts = np.flatnonzero(np.diff(image, prepend=-1))
        weighted = J * weight[:, None, None]
        A = np.add.reduceat(np.swapaxes(weighted, 1, 2) @ J, starts)
        self.B = np.add.reduceat(np.swapaxes(weighted, 1, 2) @ Jk, starts)
        self.a = np.add.reduceat((np.swapaxes(weighted, 1, 2) @ r[..., None])[..., 0], starts)
        # Places in mm and turns in rad differ by a thousand: scaled, the inverse keeps its digits.
        scale = 1 / np.sqrt(np.maximum(np.einsum("iuu->iu", A), 1e-12))
        self.inverse = np.linalg.inv(A * scale[:, :, None] * scale[:, None, :] + 1e-12 * np.eye(6)) * scale[:, :, None] * scale[:, None, :]
        self.sigma = np.sqrt(np.einsum("iuu->iu", self.inverse))
        assert len(A) == count, "each image has points"
        C = np.einsum("nri,n,nrj->ij", Jk, weight, Jk)
        c = np.einsum("nri,n,nr->i", Jk, weight, r)
        precision = np.array([1 / PRIOR.get(name, np.inf) ** 2 for name in NAMES[: Jk.shape[2]]])
        self.schur = C - np.einsum("iuk,iuv,ivl->kl", self.B, self.inverse, self.B) + np.diag(precision)
        self.right = c - np.einsum("iuk,iuv,iv->k", self.B, self.inverse, self.a) - precision * lens.values[: Jk.shape[2]]

    def steps(self) -> tuple[np.ndarray, np.ndarray]:
        """Steps of the intrinsics (K,) and of the poses (I, 6)."""
        step = np.linalg.solve(self.schur, self.right) if len(self.right) else np.zeros(0)
        return step, np.einsum("iuv,iv->iu", self.inverse, self.a - self.B @ step)

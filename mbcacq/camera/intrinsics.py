"""The intrinsics of a camera: pinhole with the distortion of Brown (1971) and its rational form, or equidistant (fisheye); and their files.

Pixel centres have whole coordinates, as in OpenCV.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbcacq.errors import ConfigError
from mbcacq.files.bounded_read import read_bounded
from mbcacq.model import yaml12

MAX_BYTES = 1 << 20
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tx", "ty")
COEFFICIENTS = (4, 5, 8, 12, 14)  # that OpenCV's model may have
MATRIX_KEYS = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "k", "intrinsic_matrix", "mtx")
DISTORTION_KEYS = ("distortion_coefficients", "Distortion_Coefficients", "dist_coeffs", "distCoeffs", "D", "d", "dist")
FISHEYE = ("equidistant", "fisheye", "kannala_brandt4")
# COLMAP: names of the parameters of each model
COLMAP = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
}


def opencv() -> Any:
    """The module ``cv2``. Raises ConfigError if it is not installed."""
    try:
        import cv2
    except ImportError:
        raise ConfigError("images need OpenCV: pip install 'mbcacq[camera]'") from None
    return cv2


@dataclass(frozen=True)
class Intrinsics:
    """focal, centre: (2,) px; distortion: (k,) as OpenCV orders them; fisheye: equidistant, with four coefficients; size: (width, height)
    px, None if it is not known."""

    focal: np.ndarray
    centre: np.ndarray
    distortion: np.ndarray
    fisheye: bool = False
    size: tuple[int, int] | None = None

    @property
    def values(self) -> np.ndarray:
        """(4 + k,) in the order of ``names``."""
        return np.concatenate([self.focal, self.centre, self.distortion])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the values."""
        radial = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4") if self.fisheye else NAMES
        return radial[: len(self.values)]

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3)."""
        return np.array([[self.focal[0], 0, self.centre[0]], [0, self.focal[1], self.centre[1]], [0, 0, 1.0]])

    def moved(self, step: np.ndarray) -> Intrinsics:
        """After a step (4 + k,) of the values."""
        v = self.values + step
        return replace(self, focal=v[:2], centre=v[2:4], distortion=v[4:])

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pixels (N, 2) of points (N, 3) in the camera's frame, and their derivatives by the points (N, 2, 3) and by the values."""
        cv2, none = opencv(), np.zeros(3)
        if self.fisheye:
            uv, J = cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), none, none, self.matrix, self.distortion)
            J, own = J.reshape(-1, 2, 15), slice(0, 8)
            return uv.reshape(-1, 2), J[:, :, 11:14], J[:, :, own]
        uv, J = cv2.projectPoints(points, none, none, self.matrix, self.distortion)
        J = J.reshape(-1, 2, J.shape[1])
        return uv.reshape(-1, 2), J[:, :, 3:6], J[:, :, 6 : 10 + len(self.distortion)]

    def straightened(self, uv: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) as they would be without distortion."""
        return (self.rays(uv) * self.focal + self.centre).reshape(uv.shape)

    def distorted(self, uv: np.ndarray) -> np.ndarray:
        """The inverse of ``straightened``."""
        rays = (uv.reshape(-1, 2) - self.centre) / self.focal
        return self.project(np.c_[rays, np.ones(len(rays))])[0].reshape(uv.shape)

    def rays(self, uv: np.ndarray) -> np.ndarray:
        """(N, 2) x / z and y / z of pixels (N, 2)."""
        cv2 = opencv()
        undistort = cv2.fisheye.undistortPoints if self.fisheye else cv2.undistortPoints
        return undistort(uv.reshape(-1, 1, 2), self.matrix, self.distortion).reshape(-1, 2)


def read_intrinsics(path: Path) -> Intrinsics:
    """Intrinsics of OpenCV (YAML, JSON), ROS camera_info, Kalibr or COLMAP (cameras.txt). Raises ConfigError naming what is missing."""
    text = read_bounded(path, MAX_BYTES).decode("utf-8", "replace") if path.is_file() else ""
    if not text:
        raise ConfigError(
            f"{path} does not exist; give a file of intrinsics (OpenCV, ROS camera_info, Kalibr, COLMAP), or leave --camera out"
        )
    rows = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    try:
        if rows and len(rows[0]) > 4 and rows[0][1] in COLMAP:
            return _colmap(path, rows)
        content = yaml12.load(re.sub(r"^%YAML.*$|!!opencv-[a-z]+", "", text, flags=re.MULTILINE).replace("\t", " "))
        if not isinstance(content, dict):
            raise ConfigError(f"{path}: no intrinsics; give a file of OpenCV, ROS camera_info, Kalibr or COLMAP")
        return _kalibr(path, content) or _matrix_and_coefficients(path, content)
    except (yaml.YAMLError, ValueError, TypeError, KeyError, IndexError) as error:
        raise ConfigError(f"{path}: the intrinsics are damaged ({str(error).splitlines()[0]}); save them anew") from None


def _colmap(path: Path, rows: list[list[str]]) -> Intrinsics:
    if len(rows) > 1:
        raise ConfigError(f"{path}: {len(rows)} cameras; keep the line of the one that took these images")
    _, model, width, height, *numbers = rows[0]
    v = dict(zip(COLMAP[model].split(), map(float, numbers), strict=True))
    fisheye = model.endswith("FISHEYE")
    names = ("k1", "k2", "k3", "k4") if fisheye else NAMES[4:12]
    distortion = np.array([v.get(name, 0.0) for name in names])
    # The middle of the first pixel is 0.5 in COLMAP.
    pinhole = v.get("fx", v.get("f", 0.0)), v.get("fy", v.get("f", 0.0)), v["cx"] - 0.5, v["cy"] - 0.5
    return _checked(path, pinhole, distortion, fisheye, (width, height))


def _kalibr(path: Path, content: dict[str, Any]) -> Intrinsics | None:
    cameras = {name: one for name, one in content.items() if isinstance(one, dict) and "intrinsics" in one}
    cameras = {"camera": content} if isinstance(content.get("intrinsics"), list) else cameras
    if not cameras:
        return None
    if len(cameras) > 1:
        raise ConfigError(f"{path}: cameras {', '.join(cameras)}; keep the one that took these images")
    (one,) = cameras.values()
    model, distorted = one.get("camera_model", "pinhole"), one.get("distortion_model", "none")
    if model != "pinhole" or distorted not in ("radtan", "none", *FISHEYE):
        raise ConfigError(
            f"{path}: the model {model} with distortion {distorted} is not known; calibrate with pinhole-radtan or pinhole-equi"
        )
    fx, fy, cx, cy = one["intrinsics"]
    return _checked(path, (fx, fy, cx, cy), one.get("distortion_coeffs", ()), distorted in FISHEYE, one.get("resolution"))


def _matrix_and_coefficients(path: Path, content: dict[str, Any]) -> Intrinsics:
    def numbers(keys: tuple[str, ...]) -> np.ndarray | None:
        found = next((content[key] for key in keys if key in content), None)
        return None if found is None else np.array(found["data"] if isinstance(found, dict) else found, dtype=float).ravel()

    K, distortion = numbers(MATRIX_KEYS), numbers(DISTORTION_KEYS)
    if K is None or len(K) != 9 or distortion is None:
        raise ConfigError(
            f"{path}: no camera matrix of nine numbers with distortion coefficients; give a file of OpenCV, ROS, Kalibr or COLMAP"
        )
    model = str(content.get("distortion_model", "plumb_bob"))
    size = [content.get(f"image_{side}", content.get(f"image_{side.capitalize()}", content.get(side))) for side in ("width", "height")]
    return _checked(path, (K[0], K[4], K[2], K[5]), distortion, model in FISHEYE, None if None in size else size)


def _checked(path: Path, fx_fy_cx_cy: tuple[float, ...], distortion: Any, fisheye: bool, size: Any) -> Intrinsics:
    pinhole = np.array(fx_fy_cx_cy, dtype=float)
    focal, centre = pinhole[:2], pinhole[2:]
    coefficients = np.array(distortion, dtype=float).ravel()
    if not (np.isfinite([*focal, *centre, *coefficients]).all() and (focal > 1).all()):
        raise ConfigError(f"{path}: a focal length of {focal[0]:g}, {focal[1]:g} px is impossible; give the matrix in pixels")
    if len(coefficients) > (4 if fisheye else COEFFICIENTS[-1]):
        raise ConfigError(f"{path}: {len(coefficients)} distortion coefficients are more than the model has")
    count = 4 if fisheye else next(n for n in COEFFICIENTS[1:] if n >= len(coefficients))
    padded = np.zeros(count)
    padded[: len(coefficients)] = coefficients
    return Intrinsics(focal, centre, padded, fisheye, None if size is None else (int(size[0]), int(size[1])))

"""What is known of the images from which an observation set was made: reprojection errors, and the intrinsics of their camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mbcacq.model.json_text import AsJson, Matrix, Vector

FORMAT = "mbcacq-images/1"


@dataclass(frozen=True, kw_only=True)
class BoardImage:
    """One image.

    Attributes
    ----------
    name : str
        Of its file.
    pose : int or None
        Its number in the observation set, None if it is not in it.
    points : int
        Number of points of the board that were used.
    rms_px, worst_px : float or None
        Reprojection error, rms of a coordinate and largest distance; None if no board was found.
    reason : str
        Why it is not in the set, or ''.
    """

    name: str
    pose: int | None = None
    points: int = 0
    rms_px: float | None = None
    worst_px: float | None = None
    reason: str = ""


@dataclass(frozen=True, kw_only=True)
class BoardImages(AsJson):
    """The images of an observation set.

    Attributes
    ----------
    intrinsics : tuple[str, ...]
        Names.
    values : (K,) ndarray
        Intrinsics by the images alone, or as given; px, and distortion coefficients as OpenCV orders them.
    root : (K, K') ndarray
        Root of their covariance, whose columns are the errors that all measurements share; without columns where they were given.
    noise_px : float
        Noise of a coordinate of a point.
    images : tuple[BoardImage, ...]
        One for each image.
    """

    format: Literal["mbcacq-images/1"] = FORMAT
    intrinsics: tuple[str, ...]
    values: Vector
    root: Matrix
    noise_px: float
    images: tuple[BoardImage, ...]

    def calibrated(self, shared: np.ndarray, covariance: np.ndarray) -> dict[str, Any]:
        """Content of a result: the intrinsics after a calibration that found the shared errors (K',) with this covariance (K', K')."""
        root = self.root.reshape(len(self.values), -1)
        known = root.shape[1] == len(shared)
        values = self.values + root @ shared if known else self.values
        spread = np.sqrt(np.einsum("ik,kl,il->i", root, covariance, root)) if known and len(shared) else np.zeros(len(values))
        found = {n: {"value": float(v), "std": float(s)} for n, v, s in zip(self.intrinsics, values, spread, strict=True)}
        return {"intrinsics": found, "noise_px": self.noise_px, "images": self.to_dict()["images"]}

    def name_of(self, pose: int) -> str:
        """The file of a pose, '' if there is none."""
        return next((one.name for one in self.images if one.pose == pose), "")

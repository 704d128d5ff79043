"""Planar targets of a camera and their points in an image, as OpenCV finds them (extra ``camera``)."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.camera.intrinsics import Intrinsics, opencv
from mbcacq.camera.marker_edges import corners_of_edges
from mbcacq.errors import ConfigError

LEAST_POINTS = 6  # of an image: its pose has six unknowns, and four points leave too little to judge it
WINDOW = 0.3  # half of the window about an inner corner, over the distance to the next
IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".webp")


def read_grey(path: Path) -> np.ndarray:
    """(H, W) uint8. Raises ConfigError where the file is no image."""
    grey = opencv().imread(str(path), 0)
    if grey is None:
        raise ConfigError(f"{path}: no image that OpenCV reads; remove it, or save it as PNG")
    return grey


@dataclass(frozen=True, kw_only=True)
class Board:
    """A planar target, x along its columns, y along its rows, z into it as seen from the front.

    Attributes
    ----------
    kind : str
        charuco, chessboard, aruco, april, circles or asymmetric-circles.
    columns, rows : int
        Squares of a charuco board, inner corners of a chessboard, markers, or circles.
    pitch_mm : float
        Side of a square, or distance of two markers' or circles' centres.
    inner_mm : float
        Side of a marker, or diameter of a circle.
    dictionary : str
        Of the markers, such as ``5X5_100``.
    """

    kind: str
    columns: int
    rows: int
    pitch_mm: float
    inner_mm: float = 0.0
    dictionary: str = ""

    def __post_init__(self) -> None:
        if self.kind in ("charuco", "aruco", "april", "circles", "asymmetric-circles") and not 0 < self.inner_mm < self.pitch_mm:
            raise ConfigError(
                f"the {'circles' if self.circles else 'markers'} of {self.inner_mm:g} mm do not fit a pitch of {self.pitch_mm:g}"
            )
        if self.dictionary and not hasattr(opencv().aruco, f"DICT_{self.dictionary.upper()}"):
            raise ConfigError(f"OpenCV has no dictionary '{self.dictionary}'; give one such as 5X5_100 or APRILTAG_36h11")

    @property
    def circles(self) -> bool:
        """Whether its points are centres of circles."""
        return "circles" in self.kind

    @cached_property
    def points(self) -> np.ndarray:
        """(N, 3) mm in the board's frame, row by row."""
        if self.kind in ("aruco", "april"):
            corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * self.inner_mm
            flat = (self._grid(self.columns, self.rows)[:, None] * self.pitch_mm + corners).reshape(-1, 2)
        elif self.kind == "asymmetric-circles":
            column, row = self._grid(self.columns, self.rows).T
            flat = np.stack([2 * column + row % 2, row], axis=1) * self.pitch_mm
        elif self.kind == "charuco":
            flat = (self._grid(self.columns - 1, self.rows - 1) + 1) * self.pitch_mm
        else:
            flat = self._grid(self.columns, self.rows) * self.pitch_mm
        return np.c_[flat, np.zeros(len(flat))]

    @staticmethod
    def _grid(columns: int, rows: int) -> np.ndarray:
        return np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2).astype(float)

    @property
    def turns(self) -> list[np.ndarray]:
        """Orders (N,) of the points that an image cannot tell apart, the first as they are: of boards that look alike when turned."""
        grid = np.arange(len(self.points)).reshape(self.rows, -1) if self.kind in ("chessboard", "circles") else None
        if grid is None or (self.kind == "chessboard" and (self.columns + self.rows) % 2):
            return [np.arange(len(self.points))]
        quarters = (0, 1, 2, 3) if self.columns == self.rows else (0, 2)
        return [np.rot90(grid, k).ravel() for k in quarters]

    def find(self, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Indices (n,) of the points that an image (H, W) uint8 shows, and where (n, 2) px; None where it shows too few."""
        found = self._find(grey)
        return None if found is None or len(found[0]) < min(LEAST_POINTS, len(self.points)) else found

    def _find(self, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        if self.kind == "charuco":
            return self._charuco(grey)
        if self.kind in ("aruco", "april"):
            return self._markers(grey)
        cv2, size = opencv(), (self.columns, self.rows)
        if self.kind == "chessboard":
            seen, uv = cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY)
        else:
            layout = cv2.CALIB_CB_ASYMMETRIC_GRID if self.kind == "asymmetric-circles" else cv2.CALIB_CB_SYMMETRIC_GRID
            seen, uv = cv2.findCirclesGrid(grey, size, flags=layout, blobDetector=self._blobs(grey))
        if not seen:
            return None
        uv = uv.reshape(-1, 2).astype(float) if self.circles else _at_saddles(grey, uv.reshape(-1, 2), WINDOW)
        dark_first = self.kind != "chessboard" or (self.columns + self.rows) % 2 == 0 or _first_is_dark(grey, uv, self.columns)
        return np.arange(len(uv)), uv if dark_first else uv[::-1]

    def refined(self, grey: np.ndarray, ids: np.ndarray, uv: np.ndarray, lens: Intrinsics) -> np.ndarray:
        """The points (n, 2) px of an image once its distortion is known: edges of markers are straight without it."""
        if self.kind not in ("aruco", "april"):
            return uv
        corners, good = corners_of_edges(grey, uv.reshape(-1, 4, 2), lens)
        return np.where(good[:, None, None], corners, uv.reshape(-1, 4, 2)).reshape(-1, 2)

    def _blobs(self, grey: np.ndarray) -> Any:
        cv2 = opencv()
        options = cv2.SimpleBlobDetector_Params()
        options.minArea, options.maxArea = 12.0, grey.size / (self.columns * self.rows)
        options.thresholdStep, options.minDistBetweenBlobs = 5.0, 4.0
        return cv2.SimpleBlobDetector_create(options)

    @cached_property
    def _aruco(self) -> Any:
        aruco = opencv().aruco
        return aruco.getPredefinedDictionary(getattr(aruco, f"DICT_{self.dictionary.upper()}"))

    def _charuco(self, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        cv2 = opencv()
        for legacy in (False, True):  # patterns with an even number of rows that were printed before OpenCV 4.6
            board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.pitch_mm, self.inner_mm, self._aruco)
            board.setLegacyPattern(legacy)
            uv, ids, *_ = cv2.aruco.CharucoDetector(board).detectBoard(grey)
            if ids is not None and len(ids) >= LEAST_POINTS:
                free = min(WINDOW, 0.45 * (1 - self.inner_mm / self.pitch_mm))  # of the markers in the squares
                return ids.ravel(), _at_saddles(grey, uv.reshape(-1, 2), free)
        return None

    def _markers(self, grey: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        aruco = opencv().aruco
        found, ids, _ = aruco.ArucoDetector(self._aruco, aruco.DetectorParameters()).detectMarkers(grey)
        if ids is None:
            return None
        known = ids.ravel() < self.columns * self.rows
        corners = np.array(found, dtype=float).reshape(-1, 4, 2)[known]
        uv, good = corners_of_edges(grey, corners)
        return (4 * ids.ravel()[known][good, None] + np.arange(4)).ravel(), uv[good].reshape(-1, 2)


def board_of(kind: str, size: str, pitch_mm: float, inner_mm: float | None = None, dictionary: str | None = None) -> Board:
    """A board as somebody says it: size such as '8x6'. Raises ConfigError."""
    found = re.fullmatch(r"\s*(\d{1,3})\s*[xX*]\s*(\d{1,3})\s*", size)
    if not found or min(map(int, found.groups())) < (1 if kind in ("aruco", "april") else 2):
        raise ConfigError(f"the size '{size}' of the board is not understood; give columns and rows, such as 8x6")
    marked = kind in ("charuco", "aruco", "april")
    if marked and inner_mm is None:
        of_pitch = "side of a square" if kind == "charuco" else "distance of their centres"
        raise ConfigError(f"the side of the markers is missing; give --inner MM beside --pitch MM, the {of_pitch}")
    names = dictionary or ("APRILTAG_36h11" if kind == "april" else "5X5_100")
    return Board(
        kind=kind,
        columns=int(found[1]),
        rows=int(found[2]),
        pitch_mm=pitch_mm,
        inner_mm=inner_mm or (pitch_mm / 2 if "circles" in kind else 0.0),
        dictionary=re.sub(r"^DICT_", "", names, flags=re.IGNORECASE) if marked else "",
    )


def _at_saddles(grey: np.ndarray, uv: np.ndarray, window: float) -> np.ndarray:
    """Inner corners (n, 2) px where the gradients around them say, in windows that hold one corner each (Forstner, Gulch 1987). window:
    half of its width over the distance of the corners."""
    cv2 = opencv()
    apart = np.linalg.norm(uv[:, None] - uv, axis=2) + np.diag(np.full(len(uv), np.inf))
    half = int(np.clip(window * apart.min(), 2, 15))
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-4)
    return cv2.cornerSubPix(grey, uv.astype(np.float32), (half, half), (-1, -1), stop).astype(float)


def _first_is_dark(grey: np.ndarray, uv: np.ndarray, columns: int) -> bool:
    """Whether the square at the first inner corner is darker than its neighbour along the row."""
    first, second = (uv[[k, k + 1, k + columns, k + columns + 1]].mean(axis=0) for k in (0, 1))
    a, b = (float(grey[int(np.rint(v)), int(np.rint(u))]) for u, v in (first, second))
    return a < b

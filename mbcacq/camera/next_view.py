"""Where the next view of a board should be: where it tells most of the camera's place.

An image shows ``M = inv(X) F W``: X is the camera's pose and W the board's, each in what carries it, and F joins the two. Local errors x of
X and w of W move M by ``-x`` on its left and by w on its right, whatever F and X are. A view is thus worth what M alone says, before
anything is calibrated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.camera.adjustment import AdjustedImages
from mbcacq.camera.board import Board
from mbcacq.camera.intrinsics import Intrinsics
from mbcacq.geometry import se3
from mbcacq.quantities import from_degrees, in_degrees

# Noise of poses that controllers report: some tenths of a mm, as ISO 9283 states pose accuracy, and its turn over half of a reach.
FLANGE_MM, FLANGE_RAD = 0.1, 2e-4
UNKNOWN = np.repeat([1e4, 3.0, 1e4, 3.0], 3)  # sigma of places in mm and turns in rad before the first view
FIRST_MM, FIRST_RAD = 0.1, 5e-4  # noise of a view of which none like it was seen
FILLED = 0.55  # of the image by the board in the first view
MARGIN = 0.04  # of the image that stays free around the board
ALIKE = from_degrees(25.0)  # turn within which a view is as out of reach as one that was refused
TILTS = from_degrees(np.array([0.0, 15.0, 30.0, 40.0]))  # beyond, the points of a board are found poorly
DIRECTIONS = from_degrees(np.arange(0.0, 360.0, 45.0))
ROLLS = from_degrees(np.array([-90.0, -45.0, 0.0, 45.0, 90.0]))
DISTANCES = np.array([0.8, 1.0, 1.25])  # over the usual distance
SIDE = 0.38  # sine of 22.5 deg: a direction is named by one side, or by two


@dataclass(frozen=True)
class NextView:
    """A view to be taken. T: (4, 4) T_camera_board, mm; outline: (4, 2) px of the board's outer points in the image."""

    board: Board
    T: np.ndarray
    outline: np.ndarray

    def in_words(self) -> str:
        """Where the camera goes, as seen by somebody who stands before the board, its first row on top."""
        R = self.T[:3, :3]
        camera = -R.T @ self.T[:3, 3] - _middle(self.board)
        away = float(np.linalg.norm(camera))
        tilt = in_degrees(np.arccos(np.clip(-camera[2] / away, -1.0, 1.0)))
        where = "straight at the board"
        if tilt > 5:
            x, y = camera[:2] / np.hypot(*camera[:2])
            sides = {"right": x > SIDE, "left": x < -SIDE, "below": y > SIDE, "above": y < -SIDE}
            where = f"at the board from {tilt:.0f}° off straight, from {' and '.join(name for name, holds in sides.items() if holds)}"
        roll = in_degrees(np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]))
        turned = f", the board turned {abs(roll):.0f}° {'' if roll > 0 else 'anti'}clockwise in the image" if abs(roll) > 5 else ", upright"
        return f"look {where}, {away:.0f} mm away{turned}"


def next_view(
    board: Board, size: tuple[int, int], lens: Intrinsics, seen: AdjustedImages | None, refused: Sequence[np.ndarray] = ()
) -> NextView:
    """The view after which the camera's place, and that of a point of the board seen by it, have the smallest variance.

    Parameters
    ----------
    board, size
        What is seen, and width and height of the images in px.
    lens
        Of the camera, known roughly.
    seen
        The views so far; None before the first.
    refused
        T_camera_board (4, 4) of views that are out of reach.

    Returns
    -------
    NextView
        Of the whole board in the image.
    """
    if seen is None or not len(seen.T):
        return _view(board, lens, _looking(board, _filling(board, size, lens), 0.0, 0.0, 0.0))
    candidates = _candidates(board, size, lens, float(np.median(np.linalg.norm(se3.apply(seen.T, _middle(board)), axis=-1))))
    for T in refused:
        far = _turn_between(candidates, T) > ALIKE
        candidates = candidates[far] if far.any() else candidates
    shared = seen.shared.shape[2]
    information = np.diag(np.r_[1 / UNKNOWN**2, np.ones(shared)])
    J = np.concatenate([_columns(seen.T), seen.shared], axis=2)
    information += np.einsum("iua,iuv,ivb->ab", J, np.linalg.inv(_noise(seen.T, seen.covariance)), J)
    known = np.linalg.inv(information)
    like = np.argmin([_turn_between(candidates, T) for T in seen.T], axis=0)
    J = np.concatenate([_columns(candidates), seen.shared[like]], axis=2)
    PJ = known @ np.swapaxes(J, 1, 2)
    gain = PJ @ np.linalg.inv(J @ PJ + _noise(candidates, seen.covariance[like])) @ np.swapaxes(PJ, 1, 2)
    left = np.einsum("aa->a", known)[:6] - np.einsum("caa->ca", gain)[:, :6]
    away = np.linalg.norm(candidates[:, :3, 3], axis=1).mean()
    return _view(board, lens, candidates[np.argmin(left[:, :3].sum(axis=1) + 0.5 * away**2 * left[:, 3:].sum(axis=1))])


def _middle(board: Board) -> np.ndarray:
    return board.points.max(axis=0) / 2


def _view(board: Board, lens: Intrinsics, T: np.ndarray) -> NextView:
    corners = board.points.max(axis=0) * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    return NextView(board, T, lens.project(se3.apply(T, corners))[0])


def _looking(board: Board, away: float, tilt: float, direction: float, roll: float) -> np.ndarray:
    """T_camera_board (4, 4) of a camera that looks at the board's middle."""
    R = se3.rotation_exp(tilt * np.array([np.cos(direction), np.sin(direction), 0.0])) @ se3.rotation_exp(np.array([0.0, 0.0, roll]))
    return se3.transform(R, np.array([0.0, 0.0, away]) - R @ _middle(board))


def _filling(board: Board, size: tuple[int, int], lens: Intrinsics) -> float:
    """mm at which the board fills its share of the image."""
    return float(np.max(board.points.max(axis=0)[:2] * lens.focal / (FILLED * np.array(size))))


def _candidates(board: Board, size: tuple[int, int], lens: Intrinsics, away: float) -> np.ndarray:
    """(C, 4, 4) that show the whole board, or what shows it from the front where none does."""
    grid = [(d * away, t, a, r) for d in DISTANCES for t in TILTS for a in DIRECTIONS[: 1 if t == 0 else None] for r in ROLLS]
    T = np.array([_looking(board, *one) for one in grid])
    uv = lens.project(se3.apply(T[:, None], board.points).reshape(-1, 3))[0].reshape(len(T), -1, 2)
    free = MARGIN * np.array(size)
    whole = ((uv > free) & (uv < np.array(size) - free)).all(axis=(1, 2))
    return T[whole] if whole.any() else _looking(board, _filling(board, size, lens), 0.0, 0.0, 0.0)[None]


def _turn_between(T: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(C,) rad."""
    return np.linalg.norm(se3.rotation_log(np.swapaxes(T[:, :3, :3], 1, 2) @ other[:3, :3]), axis=1)


def _columns(T: np.ndarray) -> np.ndarray:
    """(I, 6, 12): change of the board's place and turn in the camera's frame by x and w."""
    J = np.zeros((len(T), 6, 12))
    J[:, :3, :3] = J[:, 3:, 3:6] = -np.eye(3)
    J[:, :3, 3:6] = se3.skew(T[:, :3, 3])
    J[:, :3, 6:9] = J[:, 3:, 9:] = T[:, :3, :3]
    return J


def _noise(T: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """(I, 6, 6) of an image and of the flange, whose turns move the board by its distance."""
    turn = _columns(T)[:, :, 3:6]
    floor = np.diag(np.repeat([FIRST_MM**2, FIRST_RAD**2], 3)) * 1e-2
    return covariance + floor + np.diag(np.repeat([FLANGE_MM**2, 0.0], 3)) + FLANGE_RAD**2 * turn @ np.swapaxes(turn, 1, 2)

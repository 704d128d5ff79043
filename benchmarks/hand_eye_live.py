"""``python benchmarks/hand_eye_live.py [CELLS]``: views to a hand-eye transformation of 0.1 mm, led and unled.

A made camera sees the points of a board with noise; the flange's poses err. Whoever is led takes the views that ``mbcacq hand-eye`` asks
for, each missed by some degrees and centimetres. Whoever is not takes views that are tilted and turned at random, as far as the board
stays in the image.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mbcacq.camera.adjustment import BoardView
from mbcacq.camera.board import Board
from mbcacq.camera.intrinsics import Intrinsics
from mbcacq.camera.next_view import NextView
from mbcacq.geometry import se3
from mbcacq.model.cell import ARTEFACT_IN_SCANNER
from mbcacq.workflow.hand_eye import HandEyeSession

SIZE = (640, 480)
LENS = Intrinsics(np.array([610.0, 608.0]), np.array([322.4, 236.7]), np.array([-0.12, 0.05, 0.0008, -0.0006, 0.0]))
POINT_PX, FLANGE_MM, FLANGE_RAD = 0.05, 0.03, 1e-4
MISSED_RAD, MISSED_MM = 0.08, 12.0  # by which a person misses the view that was asked for
MOST = 60


Asked = Callable[[NextView, np.random.Generator, Board], np.ndarray]


def views_needed(seed: int, asked: Asked, folder: Path, enough: float) -> tuple[int, float]:
    """Number of views, and the error of the camera's place in stated standard deviations (mean square)."""
    rng = np.random.default_rng(seed)
    board = Board(kind="charuco", columns=8, rows=6, pitch_mm=20.0, inner_mm=15.0, dictionary="4X4_50")
    X = se3.transform(se3.rotation_exp(0.3 * rng.normal(size=3)), np.array([30.0, -10, 120]) + 20 * rng.normal(size=3))
    Z = se3.transform(se3.rotation_exp(np.array([np.pi, 0, 0]) + 0.3 * rng.normal(size=3)), np.array([650.0, 0, 100]))
    session = HandEyeSession(folder, board, None, ARTEFACT_IN_SCANNER, enough)
    session.size = SIZE
    while not session.enough and len(session.views) < MOST:
        T = asked(session.next_view(), rng, board)
        uv = LENS.project(se3.apply(T, board.points))[0]
        off = rng.normal(size=6) * np.repeat([FLANGE_MM, FLANGE_RAD], 3)
        true = Z @ se3.inverse(T) @ se3.inverse(X)
        flange = se3.transform(se3.rotation_exp(off[3:]) @ true[:3, :3], true[:3, 3] + off[:3])
        session.take(BoardView(f"view{len(session.views)}", np.arange(len(uv)), uv + POINT_PX * rng.normal(size=uv.shape)), flange)
    off = session.place.T[:3, 3] - X[:3, 3]
    return len(session.views), float(np.mean((off / (session.place.U[:3] / 2)) ** 2))


def led(view: NextView, rng: np.random.Generator, board: Board) -> np.ndarray:
    """As asked for, but for what a person misses it by."""
    middle = se3.transform(np.eye(3), board.points.max(axis=0) / 2)
    while True:
        missed = se3.transform(se3.rotation_exp(MISSED_RAD * rng.normal(size=3)), MISSED_MM * rng.normal(size=3))
        T = view.T @ middle @ missed @ se3.inverse(middle)
        if shown(T, board):
            return T


def unled(view: NextView, rng: np.random.Generator, board: Board) -> np.ndarray:
    """Tilted by up to 35 deg, turned by up to 40 deg."""
    while True:
        tilt = se3.rotation_exp(np.r_[rng.uniform(-0.6, 0.6, 2), 0.0]) @ se3.rotation_exp(np.r_[0, 0, rng.uniform(-0.7, 0.7)])
        T = se3.transform(tilt, np.r_[rng.uniform(-20, 20, 2), rng.uniform(210, 330)] - tilt @ (board.points.max(axis=0) / 2))
        if shown(T, board):
            return T


def shown(T: np.ndarray, board: Board) -> bool:
    """Whether the whole board is in the image."""
    uv = LENS.project(se3.apply(T, board.points))[0]
    return bool(((uv > 10) & (uv < np.array(SIZE) - 10)).all())


def main() -> None:
    cells = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    enough = float(sys.argv[2]) if len(sys.argv) > 2 else 0.1
    print(f"U of {enough:g} mm (k = 2) of x, y and z; {cells} cells")
    for name, asked in (("led", led), ("unled", unled)):
        with tempfile.TemporaryDirectory() as folder:
            found = [views_needed(seed, asked, Path(folder), enough) for seed in range(cells)]
        views, squares = np.array(found).T
        print(f"{name}: views median {np.median(views):.0f}, 10 to 90 % {np.quantile(views, 0.1):.0f} to {np.quantile(views, 0.9):.0f};"
              f" squared error in sigma {squares.mean():.2f}")  # fmt: skip


if __name__ == "__main__":
    main()

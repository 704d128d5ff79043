"""Images of boards as a camera with blur, noise and distortion takes them, rendered from the truth, with poses of a flange that errs."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from mbcacq.camera.board import Board
from mbcacq.geometry import se3
from mbcacq.geometry.flange_poses import flange_coordinates

SIZE = (640, 480)
K = np.array([[610.0, 0, 322.4], [0, 608.0, 236.7], [0, 0, 1]])
DISTORTION = np.array([-0.12, 0.05, 0.0008, -0.0006, 0.0])
POSE_SIGMA = np.array([0.02, 0.02, 0.02, 1e-4, 1e-4, 1e-4])  # of the flange, mm and rad
FINE = 3  # rays a pixel along each axis
TEXTURE = 8  # px a mm
BOARDS = {
    "charuco": Board(kind="charuco", columns=8, rows=6, pitch_mm=20.0, inner_mm=15.0, dictionary="4X4_50"),
    "chessboard": Board(kind="chessboard", columns=8, rows=5, pitch_mm=18.0),
    "aruco": Board(kind="aruco", columns=4, rows=3, pitch_mm=36.0, inner_mm=27.0, dictionary="4X4_50"),
    "april": Board(kind="april", columns=4, rows=3, pitch_mm=36.0, inner_mm=27.0, dictionary="APRILTAG_36h11"),
    "circles": Board(kind="circles", columns=8, rows=6, pitch_mm=18.0, inner_mm=9.0),
}


@dataclass(frozen=True)
class Cell:
    """images: uint8; flange: (P, 6) mm and rotation vector as reported; X, Z: T_flange_camera and T_base_board, or of a fixed camera
    T_flange_board and T_base_camera; seen: (P, 4, 4) T_camera_board."""

    board: Board
    images: list[np.ndarray]
    flange: np.ndarray
    X: np.ndarray
    Z: np.ndarray
    seen: np.ndarray


@cache
def texture(board: Board) -> tuple[np.ndarray, np.ndarray]:
    """The printed board and the place (2,) of its first pixel's corner, mm."""
    c, r, pitch = board.columns, board.rows, board.pitch_mm
    if board.kind == "charuco":
        made = cv2.aruco.CharucoBoard((c, r), pitch, board.inner_mm, board._aruco)
        return made.generateImage((int(c * pitch * TEXTURE), int(r * pitch * TEXTURE)), marginSize=0), np.zeros(2)
    if board.kind in ("aruco", "april"):
        made = cv2.aruco.GridBoard((c, r), board.inner_mm, pitch - board.inner_mm, board._aruco)

        w, h = (c - 1) * pitch + board.inner_mm, (r - 1) * pitch + board.inner_mm
        return made.generateImage((int(w * TEXTURE), int(h * TEXTURE)), marginSize=0), np.zeros(2)
    if board.kind == "chessboard":
        side = int(pitch * TEXTURE)
        dark = (np.add.outer(np.arange(r + 1), np.arange(c + 1)) % 2 == 0).repeat(side, 0).repeat(side, 1)
        return np.where(dark, 0, 255).astype(np.uint8), np.array([-pitch, -pitch])
    y, x = np.mgrid[0 : int((r + 1) * pitch * TEXTURE), 0 : int((c + 1) * pitch * TEXTURE)]
    off = [(np.abs((v + 0.5) / TEXTURE - pitch + pitch / 2) % pitch) - pitch / 2 for v in (x, y)]
    inside = (np.hypot(*off) < board.inner_mm / 2) & (x / TEXTURE > pitch / 2) & (y / TEXTURE > pitch / 2)
    inside &= (x / TEXTURE < (c + 0.5) * pitch) & (y / TEXTURE < (r + 0.5) * pitch)
    return np.where(inside, 0, 255).astype(np.uint8), np.array([-pitch, -pitch])


@cache
def rays() -> np.ndarray:
    """(2, H FINE, W FINE) float32 x / z and y / z."""
    u, v = (((np.arange(n * FINE) + 0.5) / FINE - 0.5) for n in SIZE)
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    term = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-9)
    along = cv2.undistortPointsIter(uv, K, DISTORTION, None, None, term).reshape(len(v), len(u), 2)
    return np.ascontiguousarray(np.moveaxis(along, 2, 0), dtype=np.float32)


def render(board: Board, T: np.ndarray, rng: np.random.Generator, blur: float, noise: float) -> np.ndarray:
    picture, corner = texture(board)
    (x, y, z), t = (r.astype(np.float32) for r in T[:3, :3].T), T[:3, 3]
    a, b = rays()
    depth = np.float32(z @ t) / (a * z[0] + b * z[1] + z[2])
    u, v = ((depth * (a * r[0] + b * r[1] + r[2]) - np.float32(r @ t + c)) * TEXTURE - 0.5 for r, c in ((x, corner[0]), (y, corner[1])))
    white = cv2.remap(picture, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=255)
    grey = cv2.resize(white.astype(np.float32), SIZE, interpolation=cv2.INTER_AREA)
    grey = cv2.GaussianBlur(30 + 0.75 * grey, (0, 0), blur) + noise * rng.normal(size=grey.shape)
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def camera_pose(board: Board, rng: np.random.Generator, whole: bool) -> np.ndarray:
    """T_camera_board of a view that tilts by up to 35 deg and shows the board, all of it where it must."""
    span = board.points.max(axis=0)
    while True:
        tilt = se3.rotation_exp(np.r_[rng.uniform(-0.6, 0.6, 2), 0.0]) @ se3.rotation_exp(np.r_[0, 0, rng.uniform(-0.7, 0.7)])
        reach = 20.0 if whole else 60.0
        middle = np.r_[rng.uniform(-reach, reach, 2), rng.uniform(210, 330)]
        T = se3.transform(tilt, middle - tilt @ (span / 2))
        uv = cv2.projectPoints(se3.apply(T, board.points), np.zeros(3), np.zeros(3), K, DISTORTION)[0].reshape(-1, 2)
        inside = ((uv > 25) & (uv < np.array(SIZE) - 25)).all(axis=1)
        if inside.all() or (not whole and inside.mean() > 0.4):
            return T


def make(kind: str, rng: np.random.Generator, *, fixed: bool = False, poses: int = 16, blur: float = 0.7, noise: float = 3.0) -> Cell:
    board = BOARDS[kind]
    X = se3.transform(se3.rotation_exp(0.3 * rng.normal(size=3)), np.array([30.0, -10, 120]) + 20 * rng.normal(size=3))
    turn = np.array([np.pi, 0, 0]) * (1 - fixed)
    Z = se3.transform(
        se3.rotation_exp(turn) @ se3.rotation_exp(0.3 * rng.normal(size=3)), np.array([650.0, 0, 100]) + 50 * rng.normal(size=3)
    )
    seen = np.array([camera_pose(board, rng, kind in ("chessboard", "circles")) for _ in range(poses)])
    true = Z @ seen @ se3.inverse(X) if fixed else Z @ se3.inverse(seen) @ se3.inverse(X)
    off = POSE_SIGMA * rng.normal(size=(poses, 6))
    reported = se3.transform(se3.rotation_exp(off[:, 3:]) @ true[:, :3, :3], true[:, :3, 3] + off[:, :3])
    images = [render(board, T, rng, blur, noise) for T in seen]
    return Cell(board, images, flange_coordinates(reported), X, Z, seen)


def write(cell: Cell, folder: Path) -> tuple[Path, Path]:
    """The images in a folder, and the table of the flange's poses."""
    (folder / "images").mkdir(parents=True)
    for number, image in enumerate(cell.images, 1):
        cv2.imwrite(str(folder / "images" / f"view{number}.png"), image)
    rows = [",".join(map(repr, row)) for row in cell.flange.tolist()]
    (folder / "flange.csv").write_text("\n".join(["x_mm,y_mm,z_mm,rx_rad,ry_rad,rz_rad", *rows]) + "\n")
    return folder / "images", folder / "flange.csv"

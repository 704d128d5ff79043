"""Images of a board with poses of the arm as observations: the target's pose in each image, its covariance, and what the images share."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mbcacq.camera.adjustment import AdjustedImages, BoardView, adjust_images
from mbcacq.camera.board import IMAGES, Board, read_grey
from mbcacq.camera.intrinsics import Intrinsics, read_intrinsics
from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.files.table import Table
from mbcacq.geometry import se3
from mbcacq.model.board_images import BoardImage, BoardImages
from mbcacq.recording.datasets import covariances, quaternions
from mbcacq.recording.datasets.columns import flange_group, joint_columns
from mbcacq.recording.datasets.csv_columns import numbers
from mbcacq.recording.datasets.loose_table import LEAST_POSES, TableOptions, UnderstoodTable, conventions_of, understood

IMAGE_COLUMN = ("image", "file", "filename", "picture", "bild", "name")
TARGET = ("target_x_mm", "target_y_mm", "target_z_mm", "target_qw", "target_qx", "target_qy", "target_qz")
BETTER = 5.0  # standard deviations by which free intrinsics fit better than those given, from which it is said
BETTER_RMS = 1.15  # and the rms of those given over theirs: less changes nothing
SWEEPS = 4  # over the images of a board that looks alike when turned


def read_images(sources: Sequence[Path], poses: Table, board: Board, camera: Path | None, options: TableOptions) -> UnderstoodTable:
    """The observations of images and of the arm's poses, which are of one row each.

    Parameters
    ----------
    sources
        Images, or folders of images.
    poses
        A row for each image, in the order of their names; or with a column ``image``.
    board
        What they show.
    camera
        File of the intrinsics; None: they are estimated.
    options
        Of the poses, as for any table.

    Raises
    ------
    ConfigError
        Images and poses do not belong together, or too few images show the board.
    CalibrationError
        The images do not determine the intrinsics.
    """
    files = _images_of(sources)
    row_of = _rows_of(files, poses)
    given = read_intrinsics(camera) if camera else None
    views, rows, missing, size = _found(files, row_of, board, given)
    at = {file.name: file for file in files}
    return observations_of_views(
        ImageViews(board, views, at, missing, size, given), poses.rows(np.isin(np.arange(len(poses)), rows)), options
    )


@dataclass(frozen=True)
class ImageViews:
    """What images show of a board.

    Attributes
    ----------
    board : Board
    views : list[BoardView]
        Of the images that show it, in the order of the poses.
    at : dict[str, Path]
        Their files by name.
    missing : list[BoardImage]
        The other images.
    size : tuple[int, int]
        Width and height, px.
    given : Intrinsics or None
        None: estimated.
    """

    board: Board
    views: list[BoardView]
    at: dict[str, Path]
    missing: list[BoardImage]
    size: tuple[int, int]
    given: Intrinsics | None


def observations_of_views(seen: ImageViews, poses: Table, options: TableOptions) -> UnderstoodTable:
    """The observations of views of a board and of the arm's poses, a row for each. Raises as ``read_images``."""
    board, views, size, given = seen.board, seen.views, seen.size, seen.given
    adjusted = adjust_images(board, views, size, given)
    if board.kind in ("aruco", "april"):
        views = [replace(v, uv=board.refined(read_grey(seen.at[v.name]), v.ids, v.uv, adjusted.intrinsics)) for v in views]
        adjusted = adjust_images(board, views, size, given)
    warnings = [] if given is None else _doubts(board, views, size, adjusted)
    if len(board.turns) > 1:
        views = _turned(board, views, adjusted.T, poses, options)
        adjusted = adjust_images(board, views, size, given)
    good = ~adjusted.contradicts
    if good.sum() < LEAST_POSES:
        raise ConfigError(
            f"{int(good.sum())} images agree with the board, at least {LEAST_POSES} are needed; check --board and its measures"
        )
    table = _table(poses.rows(good), adjusted.T[good], adjusted.covariance[good])
    found = understood(table, replace(options, target="wxyz", target_inverted=False))
    lens = adjusted.intrinsics
    images = BoardImages(
        intrinsics=lens.names,
        values=lens.values,
        root=adjusted.root,
        noise_px=adjusted.sigma_px,
        images=(*_results(adjusted, views), *seen.missing),
    )
    obs = replace(found.observations, shared=adjusted.shared[good], images=images)
    return UnderstoodTable(obs, (*_sentences(adjusted, board, images), *warnings, *found.sentences))


def _images_of(sources: Sequence[Path]) -> list[Path]:
    """The images, in the order of the numbers in their names."""
    out: list[Path] = []
    for source in sources:
        if not source.exists():
            raise ConfigError(f"{source} does not exist; give images, or a folder of images")
        inside = sorted(source.iterdir(), key=_by_number) if source.is_dir() else [source]
        out += [path for path in inside if path.suffix.lower() in IMAGES]
    if not out:
        raise ConfigError(f"{', '.join(map(str, sources))}: no images ({' '.join(IMAGES)})")
    return out


def _by_number(path: Path) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def _rows_of(files: Sequence[Path], poses: Table) -> list[int | None]:
    """The row of the poses of each image, None if it has none: by their names, else in their order. Raises ConfigError."""
    column = next((name for name in poses.columns if name.strip().lower() in IMAGE_COLUMN), None)
    if column is not None:
        named = {Path(cell.strip()).name: row for row, cell in enumerate(poses.columns[column])}
        rows = [named.get(file.name, named.get(file.stem)) for file in files]
        if not any(row is not None for row in rows):
            raise ConfigError(f"{poses.path}: none of the names in column {column} is that of an image, such as {files[0].name}")
        return rows
    if len(files) != len(poses):
        raise ConfigError(
            f"{poses.path}: {len(poses)} poses and {len(files)} images; give a row for each image, in the order of their names, or add a "
            "column image with the names"
        )
    return list(range(len(files)))


def _found(
    files: Sequence[Path], row_of: Sequence[int | None], board: Board, given: Intrinsics | None
) -> tuple[list[BoardView], list[int], list[BoardImage], tuple[int, int]]:
    """The views in the order of the poses with their rows, the images without the board or without a pose, and the size of the images."""
    seen: dict[int, BoardView] = {}
    missing: list[BoardImage] = []
    size = given.size if given else None
    for file, row in zip(files, row_of, strict=True):
        if row is None:
            missing.append(BoardImage(name=file.name, reason="no pose of the arm"))
            continue
        grey = read_grey(file)
        here = (grey.shape[1], grey.shape[0])
        size = size or here
        if here != size:
            raise ConfigError(
                f"{file}: {here[0]} x {here[1]} px, and {size[0]} x {size[1]} are expected; give images of one camera and mode"
            )
        found = board.find(grey)
        if found is None:
            missing.append(BoardImage(name=file.name, reason="the board was not found"))
        else:
            seen[row] = BoardView(file.name, *found)
    if len(seen) == len(files) < LEAST_POSES:
        raise ConfigError(
            f"{len(files)} images, and at least {LEAST_POSES} are needed; take 15 to 30 with the camera tilted and turned between them"
        )
    if len(seen) < LEAST_POSES or size is None:
        raise ConfigError(
            f"{len(seen)} of {len(files)} images show the {board.kind} board of {board.columns} x {board.rows}, at least {LEAST_POSES} are "
            f"needed; check --board, --size{' and --dictionary' if board.dictionary else ' (inner corners of a chessboard)'}"
        )
    return [seen[row] for row in sorted(seen)], sorted(seen), missing, size


def _doubts(board: Board, views: Sequence[BoardView], size: tuple[int, int], adjusted: AdjustedImages) -> list[str]:
    """A sentence where other intrinsics fit the images clearly better than those that were given."""
    try:
        free = adjust_images(board, views, size)
    except CalibrationError:  # too few images to say anything
        return []
    of_given, of_free = (np.sqrt(np.average(a.rms_px**2, weights=np.maximum(a.points, 1))) for a in (adjusted, free))
    dof, more = 2 * free.points.sum(), len(free.intrinsics.values)
    gain = dof * ((of_given / of_free) ** 2 - 1)
    if gain < more + BETTER * np.sqrt(2 * more) or of_given < BETTER_RMS * of_free:
        return []
    f, g = free.intrinsics.focal.mean(), adjusted.intrinsics.focal.mean()
    return [
        f"warning: other intrinsics than those of --camera fit the images better: {of_free:.2f} px rms instead of {of_given:.2f}, with a "
        f"focal length of {f:.1f} px instead of {g:.1f}; check that they are of this camera and mode, or leave --camera out"
    ]


def _turned(board: Board, views: Sequence[BoardView], T: np.ndarray, poses: Table, options: TableOptions) -> list[BoardView]:
    """The views of a board that looks alike when turned, each turned so that it turned by as much as the flange did between the images."""
    group = None if joint_columns(poses) and options.robot else flange_group(poses)
    if group is None:
        return list(views)
    order = board.turns
    # A turn of the points about the board's middle turns the board's frame.
    R = np.array([se3.fit_rigid_transforms(board.points, board.points[k], np.zeros(len(k), int), 1)[0, :3, :3] for k in order])
    seen = np.einsum("iab,kbc->ikac", T[:, :3, :3], R)
    between = _angles(seen[:, :, None, None], seen[None, None])
    best: tuple[float, np.ndarray] | None = None
    for convention in conventions_of(group, options.flange, "--flange"):
        flange = replace(group, convention=convention, alternatives=()).transforms(poses)[:, :3, :3]
        moved = _angles(flange[:, None], flange[None])
        chosen = np.zeros(len(T), dtype=int)
        for _ in range(SWEEPS):
            for i in range(1, len(T)):
                off = np.abs(between[i][:, np.arange(len(T)), chosen] - moved[i])
                off[:, i] = 0.0
                chosen[i] = int(np.argmin(np.median(off, axis=1) + off.mean(axis=1)))
        off = np.abs(between[np.arange(len(T))[:, None], chosen[:, None], np.arange(len(T)), chosen] - moved)
        if best is None or off.mean() < best[0]:
            best = float(off.mean()), chosen
    assert best is not None, "there is a convention"
    return [BoardView(v.name, np.argsort(order[k])[v.ids] if k else v.ids, v.uv) for v, k in zip(views, best[1], strict=True)]


def _angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles (...) rad between rotations (..., 3, 3)."""
    trace = np.einsum("...ij,...ij->...", a, b)
    return np.arccos(np.clip((trace - 1) / 2, -1.0, 1.0))


def _table(poses: Table, T: np.ndarray, covariance: np.ndarray) -> Table:
    """The poses of the arm beside those of the target."""
    group, joints = flange_group(poses), joint_columns(poses)
    own = {*joints, *((*group.names, *group.closing) if group else ()), "station", "time_s"}
    columns = {name: cells for name, cells in poses.columns.items() if name in own}
    values = np.c_[T[:, :3, 3], quaternions.from_matrix(T[:, :3, :3])]
    columns |= {name: tuple(numbers(values[:, k])) for k, name in enumerate(TARGET)}
    columns |= {name: tuple(cells) for name, cells in covariances.columns(covariance).items()}
    return replace(poses, columns=columns, taken=set())


def _results(adjusted: AdjustedImages, views: Sequence[BoardView]) -> list[BoardImage]:
    number, out = 0, []
    for i, view in enumerate(views):
        used, gross, rms = int(adjusted.points[i]), int(adjusted.rejected[i]), float(adjusted.rms_px[i])
        bad = bool(adjusted.contradicts[i])
        number += not bad
        reason = (
            f"no pose of a board explains it: {gross} of {used + gross} points are gross errors, and {rms:.2f} px rms is left of others"
        )
        out.append(
            BoardImage(
                name=view.name,
                pose=None if bad else number,
                points=used,
                rms_px=rms,
                worst_px=float(adjusted.worst_px[i]),
                reason=reason if bad else "",
            )
        )
    return out


def _sentences(adjusted: AdjustedImages, board: Board, images: BoardImages) -> list[str]:
    used = [one for one in images.images if one.pose is not None]
    worst = max(used, key=lambda one: one.rms_px or 0.0)
    rms = np.sqrt(np.mean([(one.rms_px or 0.0) ** 2 for one in used]))
    out = [
        f"{len(used)} of {len(images.images)} images show the {board.kind} board, {sum(one.points for one in used)} points; reprojection "
        f"error {rms:.3f} px rms, largest in {worst.name} ({worst.rms_px:.3f} px); noise of a coordinate {adjusted.sigma_px:.3f} px"
    ]
    if gross := int(adjusted.rejected[~adjusted.contradicts].sum()):
        out.append(f"{gross} points are gross errors and are left out")
    lens = adjusted.intrinsics
    if adjusted.root.shape[1]:
        spread = zip(lens.names, lens.values, adjusted.uncertainty, strict=True)
        figures = ", ".join(f"{name} {value:.6g} ± {2 * std:.2g}" for name, value, std in spread)
        out.append(f"intrinsics by the images alone, ± U (k = 2): {figures}; the calibration estimates them with everything else")
    else:
        figures = ", ".join(f"{name} {value:.6g}" for name, value in zip(lens.names, lens.values, strict=True))
        out.append(f"intrinsics as given, taken as exact: {figures}")
    return out + [f"not used: {one.name} ({one.reason})" for one in images.images if one.pose is None]

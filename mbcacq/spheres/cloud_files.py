"""Clouds as scanners' own programs save them: PLY, PCD, STL, text (XYZ, ASC, TXT, CSV) and range maps (TIFF), read as points in mm."""

from __future__ import annotations

import io
import math
import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.bounded_read import kind_of
from mbcacq.files.mesh_file import read_mesh
from mbcacq.files.stated_unit import stated_unit, unit_of_axes
from mbcacq.spheres.cloud_file import mm_per, read_cloud_file

SUFFIXES = (".ply", ".pcd", ".stl", ".xyz", ".asc", ".txt", ".csv", ".pts", ".tif", ".tiff")
TEXTS = (".xyz", ".asc", ".txt", ".csv", ".pts")
MAX_BYTES = 2 << 30
MOST_POINTS = 200_000_000
_AXIS = re.compile(r"([+-]?)([xyz])")


@dataclass(frozen=True)
class CloudFormat:
    """How a scanner's program writes its clouds.

    Attributes
    ----------
    unit : str or None
        Unit of length; None for the one that a file states, else mm.
    axes : str
        The file's axes that are x, y, z of the plan's scanner frame, such as 'x -y -z'.
    range_map : tuple[float, float, float, float] or None
        Range map of TIFF files, mm from column to column, mm from row to row, mm per count, mm at count 0; 0 counts and no number are no
        point.
    """

    unit: str | None = None
    axes: str = "x y z"
    range_map: tuple[float, float, float, float] | None = None

    def matrix(self, stated: str = "") -> np.ndarray:
        """(3, 3): coordinates of a file to mm in the scanner frame. stated: the unit in the file, '' for none.

        Raises ConfigError for a unit or axes that there are none of.
        """
        factor = mm_per(self.unit or stated or "mm")
        words = self.axes.lower().replace(",", " ").split()
        found = [_AXIS.fullmatch(word) for word in words]
        if len(words) != 3 or not all(found) or sorted(word[-1] for word in words) != ["x", "y", "z"]:
            raise ConfigError(f"'{self.axes}' names no three axes; write each once, such as 'x -y -z'")
        out = np.zeros((3, 3))
        for row, match in enumerate(found):
            assert match is not None
            out[row, "xyz".index(match[2])] = -1.0 if match[1] == "-" else 1.0
        return factor * out


def read_points(path: str | Path, form: CloudFormat | None = None) -> np.ndarray:
    """Points (N, 3) mm, float32 or float64, in the plan's scanner frame. Raises ConfigError naming the file: absent, half written, not
    what its name says, or without points."""
    path, form = Path(path), form or CloudFormat()
    form.matrix()
    points, stated = _read(path, kind_of(path, SUFFIXES, "cloud", MAX_BYTES), form)
    to_mm = form.matrix(stated)
    if not (finite := np.isfinite(points)).all():
        points = points[finite.all(axis=1)]
    if not len(points):
        raise ConfigError(f"{path}: holds no points; save the cloud anew")
    return points if np.array_equal(to_mm, np.eye(3)) else points @ to_mm.T.astype(points.dtype)


def says_simulated(path: Path) -> bool:
    """Whether a cloud that this program wrote says that no real scanner made it."""
    try:
        with path.open("rb") as file:
            return b"comment simulated: true" in file.read(2048)
    except OSError:
        return False


def _read(path: Path, suffix: str, form: CloudFormat) -> tuple[np.ndarray, str]:
    """Points in the file's unit, and that unit where the file states one."""
    try:
        if suffix in TEXTS:
            return _text(path)
        if suffix == ".stl":
            return np.unique(read_mesh(path).vertices, axis=0), ""
        if suffix in (".tif", ".tiff"):
            return _range_map(path, form), ""
        found = read_cloud_file(path)
        return found.points, found.unit
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}; save the cloud anew") from error


def _text(path: Path) -> tuple[np.ndarray, str]:
    """The first three columns of numbers, and the unit that the lines above them state; comments and the number of points are passed
    over."""
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-16") if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else raw.decode("latin-1")
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: begins like UTF-16 but is not; save the cloud as text") from None
    lines = text.splitlines()
    start = next((k for k, line in enumerate(lines[:100]) if _numbers(line) is not None), None)
    if start is None:
        raise ConfigError(f"{path}: none of its first lines has three numbers; save the cloud as x, y, z a line")
    above = lines[:start]
    unit = stated_unit("\n".join(above), str(path)) or (unit_of_axes(above[-1], str(path)) if above else "")
    kept = [k for k in range(start, len(lines)) if lines[k].strip() and lines[k].lstrip()[0] not in "#/;"]
    if not kept:
        raise _bad_line(path, lines, start)
    separator = _separator(lines[start])
    decimal_comma = separator != "," and any("," in lines[k] for k in kept)
    _refuse_two_readings(path, lines, kept, separator, decimal_comma)
    announced = lines[start - 1].strip() if start else ""
    if announced.isdecimal() and int(announced) != len(kept):
        raise ConfigError(f"{path}:{start}: announces {announced} points, and {len(kept)} follow; save the cloud anew")
    body = "\n".join(lines[k] for k in kept)
    body = body.replace(",", "." if decimal_comma else " ").replace(";", " ").replace("\t", " ")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return np.loadtxt(io.StringIO(body), usecols=(0, 1, 2), ndmin=2), unit
    except (ValueError, IndexError):
        raise _bad_line(path, lines, start) from None


def _separator(line: str) -> str:
    """What stands between the numbers of a line: ';', ' ' (blanks or tabs) or ','."""
    if ";" in line:
        return ";"
    return " " if "\t" in line.strip() or re.search(r"[\d.]\s+[-+.\d]", line) else ","


def _refuse_two_readings(path: Path, lines: list[str], kept: list[int], separator: str, decimal_comma: bool) -> None:
    """Raises ConfigError for a line of another length than the first, and for commas that may be decimal marks or separators."""
    between = None if separator == " " else separator
    columns = len([cell for cell in lines[kept[0]].split(between) if cell.strip()])
    for k in kept:
        found = len([cell for cell in lines[k].split(between) if cell.strip()])
        if found != columns and _numbers(lines[k]) is not None:
            raise ConfigError(
                f"{path}:{k + 1}: the line has {found} columns, the first one {columns}; save the cloud anew, with decimal points"
            )
        if decimal_comma and "." in lines[k]:
            raise ConfigError(f"{path}:{k + 1}: has a point in a cloud with decimal commas; save it with one kind of decimal mark")
    if separator == "," and columns % 2 == 0 and columns >= 2 * len("xyz") and not any("." in lines[k] for k in kept):
        raise ConfigError(
            f"{path}:{kept[0] + 1}: its {columns} columns of whole numbers may be numbers with decimal commas; save it with decimal points"
        )


def _bad_line(path: Path, lines: list[str], start: int) -> ConfigError:
    for number, line in enumerate(lines[start:], start + 1):
        if line.strip() and line.lstrip()[0] not in "#/;" and _numbers(line) is None:
            last = number == len(lines)
            what = "the file is cut off in its last line; save the cloud anew" if last else f"'{line.strip()[:40]}' is no x, y, z"
            return ConfigError(f"{path}:{number}: {what}")
    return ConfigError(f"{path}: its lines have no three numbers each; save the cloud as x, y, z a line")


def _numbers(line: str) -> tuple[float, ...] | None:
    """The first three numbers of a line, or None."""
    point = line.replace(";", " ").replace("\t", " ")
    for text in (point.replace(",", " "), point.replace(",", ".")):
        words = text.split()[:3]
        try:
            values = tuple(float(word) for word in words)
        except ValueError:
            continue
        if len(values) == 3:
            return values
    return None


def _has_second_page(file: Any) -> bool:
    try:
        file.pages[1]
    except IndexError:
        return False
    return True


def _range_map(path: Path, form: CloudFormat) -> np.ndarray:
    try:
        import tifffile
    except ImportError as error:
        raise ConfigError(f"{path}: range maps need tifffile; install it with: pip install 'mbcacq[tiff]'") from error
    if form.range_map is None:
        raise ConfigError(f"{path}: a range map says no millimetres; give its scale (mm a column, mm a row, mm a count, mm at count 0)")
    try:
        with tifffile.TiffFile(path) as file:
            page = file.pages.first  # the pages of a damaged file may be a chain without an end: never all of them
            shape = tuple(size for size in page.shape if size != 1)
            plain = len(shape) == 2 and math.prod(shape) <= MOST_POINTS and not _has_second_page(file)
            counts = page.asarray().reshape(shape) if plain else None
    except Exception as error:  # the library raises what it meets in a broken file
        raise ConfigError(f"{path}: is no whole TIFF file ({type(error).__name__}); save the range map anew") from error
    if counts is None:
        raise ConfigError(f"{path}: has a page of the shape {shape}, or several, and a range map has rows and columns; save one channel")
    dx, dy, dz, z0 = form.range_map
    rows, columns = np.nonzero(np.isfinite(counts) & (counts != 0))
    middle = (np.array(counts.shape) - 1) / 2
    z = z0 + dz * counts[rows, columns].astype(float)
    return np.stack([dx * (columns - middle[1]), dy * (rows - middle[0]), z], axis=1)

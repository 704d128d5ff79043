"""Point clouds in PLY and PCD files with all properties of their points in the types they have: whole and of numbers, or refused."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.bounded_read import kind_of
from mbcacq.files.open3d_library import open3d
from mbcacq.files.ply_header import PlyElement, read_header
from mbcacq.files.stated_unit import stated_unit
from mbcacq.files.units import AmbiguousUnit, converted, same_dimension, unit_named

MAX_BYTES = 4 * 2**30
MAX_PCD_HEADER = 64 * 1024
PCD_KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
VECTORS = {"positions": ("x", "y", "z"), "normals": ("nx", "ny", "nz"), "colors": ("red", "green", "blue")}  # as Open3D joins them
PACKED = ("rgb", "rgba")  # PCD's colours: four bytes in one number
UNITS_MM = {"mm": 1.0, "m": 1e3, "cm": 10.0, "um": 1e-3, "in": 25.4}
FEWEST_TO_JUDGE = 10  # points whose size says something
SMALL = 4.0  # a view of several balls spans two gaps and more, which inches show 25 times smaller
SMALLEST_MM, LARGEST_MM = 5.0, 100e3  # of the largest coordinate: a field in mm is not smaller, a hall not larger


@dataclass(frozen=True)
class CloudFile:
    """The content of a file of points.

    Attributes
    ----------
    points : ndarray
        (N, 3) in the file's type and unit.
    properties : dict[str, ndarray]
        (N,) each, by name, of the points alone.
    missing : int
        How many places of an organised cloud hold no point and were left out.
    unit : str
        Unit of length, as the header states it, '' if it states none.
    viewpoint : bool
        Whether a PCD header gives a place of the sensor other than the origin.
    """

    points: np.ndarray
    properties: dict[str, np.ndarray]
    missing: int
    unit: str = ""
    viewpoint: bool = False


def read_cloud_file(path: str | Path) -> CloudFile:
    """The cloud of a PLY or PCD file. Raises ConfigError, naming the file, where it is not whole or holds no points."""
    path = Path(path)
    kind = kind_of(path, (".ply", ".pcd"), "cloud", MAX_BYTES)
    columns, header = _ply(path) if kind == ".ply" else _pcd(path)
    if any(columns[axis].dtype.kind not in "fiu" for axis in "xyz"):
        raise ConfigError(f"{path}: its x, y, z are no numbers; export the cloud anew")
    points = np.stack([columns.pop(axis) for axis in "xyz"], axis=1)
    if points.dtype not in (np.float32, np.float64):
        points = points.astype(np.float64)
    there = np.full(len(points), True)
    if not (finite := np.isfinite(points)).all():
        there = ~np.isnan(points).all(axis=1)
        if len(wrong := np.flatnonzero(there & ~finite.all(axis=1))):
            raise ConfigError(f"{path}: point {wrong[0] + 1} has a coordinate that is no finite number; export the cloud anew")
        points, columns = points[there], {name: values[there] for name, values in columns.items()}
    if not len(points):
        raise ConfigError(f"{path}: holds no points; export the cloud anew")
    unit = stated_unit("\n".join(line for line in header if not line.startswith("VIEWPOINT")), str(path))
    moved = any(line.startswith("VIEWPOINT") and _moved(line.split()[1:]) for line in header)
    return CloudFile(points, columns, int((~there).sum()), unit, moved)


def mm_per(unit: str) -> float:
    """Millimetres of a unit of length. Raises ConfigError if the word names none."""
    try:
        named = unit_named(unit) or ""
    except AmbiguousUnit:
        named = ""
    if named in UNITS_MM:
        return UNITS_MM[named]
    if not named or not same_dimension(named, "mm"):
        raise ConfigError(f"there is no unit '{unit}' of clouds; give one of {', '.join(UNITS_MM)}")
    return float(converted(np.ones(1), named, "mm")[0])


def in_mm(path: str | Path, cloud: CloudFile, unit: str | None) -> np.ndarray:
    """Points (N, 3) of a cloud in mm. unit: of the file, None if nobody said it: then the one that its header states, or mm.

    Raises ConfigError if nothing states a unit and their size cannot be mm.
    """
    points = cloud.points
    if unit or cloud.unit:
        factor = mm_per(unit or cloud.unit)
        return points if factor == 1 else points.astype(np.float64) * factor
    largest = float(np.abs(points).max())
    if len(points) >= FEWEST_TO_JUDGE and largest < SMALLEST_MM:
        raise ConfigError(
            f"{path}: all coordinates are within {largest:.3g}, which looks like metres; say --unit m, or --unit mm if they are mm"
        )
    if len(points) >= FEWEST_TO_JUDGE and largest > LARGEST_MM:
        raise ConfigError(f"{path}: coordinates reach {largest:.3g}, which looks like um; say --unit um, or --unit mm if they are mm")
    return points


def looks_small(points: np.ndarray, centres: np.ndarray) -> str:
    """A sentence about points (N, 3) that span far less than the scanner showed of an artefact at once, as inches do; '' else.

    centres: (B, 3) mm of its balls, of which those that stand nearest to each other were seen together.
    """
    if len(points) < FEWEST_TO_JUDGE or len(centres) < 3:
        return ""
    apart = np.linalg.norm(centres[:, None] - centres, axis=2) + np.diag(np.full(len(centres), np.inf))
    gap, span = float(np.median(apart.min(axis=1))), float(np.ptp(points, axis=0).max())
    if span * SMALL >= gap:
        return ""
    known = f"the balls that this scanner measured stand {gap:.0f} mm apart"
    return f"the cloud spans {span:.3g} mm, and {known}; if it is in inches, say --unit in"


def _ply(path: Path) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Columns of the vertices, and the comments of the header."""
    header = read_header(path)
    at = next(i for i, element in enumerate(header.elements) if element.name == "vertex" and element.count)
    vertex, before = header.elements[at], header.elements[:at]
    if any(p.counted for element in (vertex, *before) for p in element.properties):
        raise ConfigError(f"{path}: has lists before or in its vertices, which are not read; export the points alone")
    names = [p.name for p in vertex.properties]
    if len(set(names)) != len(names):
        raise ConfigError(f"{path}: a property of its vertices stands twice; export the cloud anew")
    if header.text:
        data = path.read_bytes()[header.size :]
        lines = [line for line in data.splitlines() if line.strip()]
        first = sum(element.count for element in before)
        rows = lines[first : first + vertex.count]
        announced = sum(element.count for element in header.elements)
        if len(lines) < announced:
            raise ConfigError(f"{path}: is cut off: its header announces {vertex.count} points and {len(rows)} lines follow; copy it anew")
        if len(lines) > announced:
            raise ConfigError(f"{path}: its header announces {announced} lines and {len(lines)} follow; export the cloud anew")
        if lines[-1] == rows[-1]:
            _refuse_cut_number(path, data, rows)
        return _text_columns(path, rows, [(p.name, np.dtype(p.type)) for p in vertex.properties]), header.comments
    order = "<" if header.little else ">"
    dtype = _row_type(vertex, order)
    offset = header.size + sum(element.count * _row_type(element, order).itemsize for element in before)
    if not any(p.counted for element in header.elements for p in element.properties):
        whole = header.size + sum(element.count * _row_type(element, order).itemsize for element in header.elements)
        if path.stat().st_size not in (whole, whole + 1):  # some writers end the file with a line feed
            raise ConfigError(f"{path}: has {path.stat().st_size} bytes where its header announces {whole}; copy it anew")
    with path.open("rb") as file:
        file.seek(offset)
        data = file.read(dtype.itemsize * vertex.count)
    rows = np.frombuffer(data, dtype)
    return {name: rows[name].astype(rows[name].dtype.newbyteorder("="), copy=False) for name in names}, header.comments


def _row_type(element: PlyElement, order: str) -> np.dtype:
    return np.dtype([(f"{i} {p.name}" if element.name != "vertex" else p.name, order + p.type) for i, p in enumerate(element.properties)])


def _text_columns(path: Path, lines: Sequence[bytes], columns: Sequence[tuple[str, np.dtype]]) -> dict[str, np.ndarray]:
    """Columns of rows of numbers. Raises ConfigError at the first row that is none."""
    try:
        table = np.loadtxt(io.BytesIO(b"\n".join(lines)), dtype=np.float64, ndmin=2, comments=None)
    except ValueError:
        table = np.empty((0, 0))
    if table.shape != (len(lines), len(columns)):
        raise ConfigError(f"{path}: {_first_bad_row(lines, len(columns))}")
    out = {}
    for (name, dtype), values in zip(columns, table.T, strict=True):
        with np.errstate(invalid="ignore", over="ignore"):
            typed = values.astype(dtype)
        if dtype.kind in "iu" and not np.array_equal(typed, values):
            row = int(np.flatnonzero(typed != values)[0])
            raise ConfigError(f"{path}: point {row + 1}: {name} is {values[row]:g}, which is no {dtype.name}; export the cloud anew")
        out[name] = typed
    return out


def _refuse_cut_number(path: Path, data: bytes, rows: Sequence[bytes]) -> None:
    """Raise ConfigError where a file ends in a number with fewer decimals than all numbers above it have."""
    if data.endswith((b"\n", b"\r")):
        return
    decimals = [len(row.split()[-1].partition(b".")[2]) for row in rows]
    if len(rows) >= FEWEST_TO_JUDGE and len(set(decimals[:-1])) == 1 and decimals[-1] < decimals[0]:
        raise ConfigError(f"{path}: is cut off in its last number, '{rows[-1].split()[-1].decode('ascii', 'replace')[:40]}'; copy it anew")


def _first_bad_row(lines: Sequence[bytes], count: int) -> str:
    for number, line in enumerate(lines, 1):
        words = line.split()
        for word in words:
            try:
                float(word)
            except ValueError:
                comma = "; decimal commas are not read, save it with decimal points" if b"," in word else "; export the cloud anew"
                return f"point {number}: '{word.decode('ascii', 'replace')[:40]}' is not a number{comma}"
        if len(words) != count:
            return f"point {number} has {len(words)} numbers where its header announces {count}; export the cloud anew"
    return "its points are not understood; export the cloud anew"


def _pcd(path: Path) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Fields of the points, and of the header the comments and the line VIEWPOINT."""
    with path.open("rb") as file:
        head = file.read(MAX_PCD_HEADER)
    found = re.search(rb"(?m)^DATA[ \t]+(\w+)[ \t]*\r?\n", head)
    if found is None:
        raise ConfigError(
            f"{path}: is no PCD file (its header must end with DATA ascii, binary or binary_compressed); export the cloud anew"
        )
    said: dict[str, list[str]] = {}
    lines = [line.strip() for line in head[: found.end()].decode("latin-1").splitlines()]
    for line in lines:
        words = line.split()
        if words and not words[0].startswith("#"):
            if words[0] not in PCD_KEYS:
                raise ConfigError(f"{path}: '{line[:60]}' is nothing a PCD header may say; export the cloud anew")
            said[words[0]] = words[1:]
    fields, count = _pcd_fields(path, said)
    kind, data = found[1].decode(), path.read_bytes()[found.end() :]
    if kind not in ("ascii", "binary", "binary_compressed"):
        raise ConfigError(f"{path}: DATA {kind} is not known (ascii, binary, binary_compressed); export the cloud anew")
    if kind == "ascii":
        rows = [row for row in data.splitlines() if row.strip()]
        if len(rows) != count:
            raise ConfigError(f"{path}: has {len(rows)} lines of points where its header announces {count}; copy it anew")
        _refuse_cut_number(path, data, rows)
        columns = _text_columns(path, rows, [(name, t) for name, t in fields])
    else:
        columns = _pcd_binary(path, data, fields, count, compressed=kind == "binary_compressed")
    header_lines = tuple(line for line in lines if line.startswith(("#", "VIEWPOINT")))
    return _unpacked({name: values for name, values in columns.items() if not name.startswith("_")}), header_lines


def _moved(words: Sequence[str]) -> bool:
    """Whether a VIEWPOINT (x y z qw qx qy qz) is another than the origin of the points' frame."""
    try:
        values = [float(word) for word in words]
    except ValueError:
        return True
    return any(values[:3]) or any(values[4:])


def _pcd_fields(path: Path, said: dict[str, list[str]]) -> tuple[list[tuple[str, np.dtype]], int]:
    """Name and type of each field, one for each of several numbers of it; and the number of points."""
    names = said.get("FIELDS", [])
    counts = said.get("COUNT", ["1"] * len(names))
    try:
        types = [np.dtype({"F": "f", "I": "i", "U": "u"}[t] + size) for t, size in zip(said["TYPE"], said["SIZE"], strict=True)]
        numbers = [int(c) for c in counts]
        points = int(said["POINTS"][0]) if "POINTS" in said else int(said["WIDTH"][0]) * int(said.get("HEIGHT", ["1"])[0])
    except (KeyError, IndexError, ValueError, TypeError):
        raise ConfigError(
            f"{path}: its header lacks FIELDS, SIZE, TYPE, COUNT or POINTS, or they are no numbers; export the cloud anew"
        ) from None
    whole = len(names) == len(types) == len(numbers) and all(0 < c <= 4096 for c in numbers) and 0 < points <= MAX_BYTES
    if not whole or not {"x", "y", "z"} <= set(names):
        raise ConfigError(f"{path}: holds no points (fields x, y and z of as many types and sizes); export the cloud anew")
    out: list[tuple[str, np.dtype]] = []
    for i, (name, dtype, number) in enumerate(zip(names, types, numbers, strict=True)):
        padding = name == "_"
        out += [(f"_{i}_{k}" if padding else name if number == 1 else f"{name}_{k}", dtype) for k in range(number)]
    if len({name for name, _ in out}) != len(out):
        raise ConfigError(f"{path}: a field stands twice; export the cloud anew")
    return out, points


def _pcd_binary(path: Path, data: bytes, fields: list[tuple[str, np.dtype]], count: int, *, compressed: bool) -> dict[str, np.ndarray]:
    size = count * sum(t.itemsize for _, t in fields)
    if not compressed:
        if len(data) not in (size, size + 1):
            raise ConfigError(f"{path}: has {len(data)} bytes of points where its header announces {size}; copy it anew")
        rows = np.frombuffer(data[:size], np.dtype([(name, t.newbyteorder("<")) for name, t in fields]))
        return {name: rows[name].astype(t, copy=False) for name, t in fields}
    length, announced = np.frombuffer(data[:8], "<u4").tolist() if len(data) >= 8 else (0, -1)
    if announced != size or len(data) < 8 + length:
        raise ConfigError(f"{path}: its compressed points are not whole; copy it anew")
    if not all(name.isascii() for name, _ in fields):  # Open3D takes them for UTF-8
        raise ConfigError(f"{path}: a name of its fields is no ASCII; copy it anew")
    columns: dict[str, np.ndarray] = {}
    for name, values in open3d().t.io.read_point_cloud(str(path), format="pcd").point.items():
        columns |= dict(zip(VECTORS.get(name, (name,)), values.numpy().T, strict=True))
    whole = {c for name, _ in fields if name[0] != "_" for c in _unpacked({name: np.empty(0, "<u4")})}  # every field that is asked for
    if any(len(values) != count for values in columns.values()) or not whole <= set(columns):
        raise ConfigError(f"{path}: its compressed points are damaged, or of other kinds than Open3D reads; save it uncompressed")
    return columns


def _unpacked(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """With PCD's packed colours as red, green and blue, and its names of normals as PLY has them."""
    out: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        if name in PACKED and values.dtype.itemsize == 4:
            number = values.view(np.uint32)
            out |= {c: (number >> shift & 255).astype(np.uint8) for c, shift in (("red", 16), ("green", 8), ("blue", 0))}
        else:
            out[f"n{name[-1]}" if re.fullmatch("normal_[xyz]", name) else name] = values
    return out

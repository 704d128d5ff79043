"""A batch of controller cycles as few bytes, every bit kept: decimals of the wire as whole numbers, differences in time, deflated.

Twenty columns as components of their own are 350 bytes a cycle and 5 kB of schema a batch, though half of them never change. A telegram
says decimals: as float64 in rad these are eight bytes of noise, as whole millionths of a degree they differ by little from cycle to cycle.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Collection, Mapping

import numpy as np

# Decimals, and whether they are of degrees that a driver turned into rad. KUKA sends up to six; clocks tick in ms and ns.
GRIDS = ((3, False), (6, False), (6, True), (9, False))
MOST = 2.0**53  # whole numbers up to here are exact in float64
ULPS = 100  # a sum of decimals misses the nearest decimal by a few units in the last place; int8


def packed(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Columns (k,) or (k, n) of numbers, k > 0, as (bytes,) uint8. Raises TypeError for what is no number of at most 64 bits."""
    arrays = {name: _table(np.asarray(values)) for name, values in columns.items()}
    whole = np.concatenate([_bits(values) for values in arrays.values()], axis=1)
    code, ulps = np.zeros(whole.shape[1], np.uint8), np.zeros(whole.shape, np.int8)
    floats = np.repeat([values.dtype == np.float64 for values in arrays.values()], [values.shape[1] for values in arrays.values()])
    for number, grid in enumerate(GRIDS, start=1):
        left = np.flatnonzero(floats & (code == 0))
        nearest, off = _nearest(whole[:, left].view(np.float64), grid)
        fits = np.all((off >= -ULPS) & (off <= ULPS), axis=0)
        taken = left[fits]
        whole[:, taken], ulps[:, taken], code[taken] = nearest[:, fits], off[:, fits], number
    steps = np.diff(whole, axis=0, prepend=np.zeros((1, whole.shape[1]), np.int64))
    folded = ((steps << 1) ^ (steps >> 63)).astype("<i8")  # small of either sign has zeros above
    planes = np.ascontiguousarray(folded.T).view(np.uint8).reshape(-1, 8).T  # all lowest bytes, all second ones and so on
    listed = [[name, values.shape[1], values.dtype.str] for name, values in arrays.items()]
    head = json.dumps({"rows": len(whole), "columns": listed, "code": code.tolist()}, separators=(",", ":"))
    return np.frombuffer(zlib.compress(head.encode() + b"\n" + planes.tobytes() + ulps.T.tobytes(), 6), np.uint8)


def unpacked(data: np.ndarray, only: Collection[str] = ()) -> dict[str, np.ndarray]:
    """What ``packed`` was given, bit for bit, each column as (k, n). only: names of the columns that are wanted, () for all.

    Raises ValueError if bytes are damaged.
    """
    try:
        return _inflated(zlib.decompress(data.tobytes()), only)
    except (zlib.error, ValueError, KeyError, IndexError, TypeError) as error:
        raise ValueError(f"the packed cycles are damaged ({error})") from error


def _inflated(data: bytes, only: Collection[str]) -> dict[str, np.ndarray]:
    text, body = data.split(b"\n", 1)
    header = json.loads(text)
    rows, code = header["rows"], np.array(header["code"], np.uint8)
    size = rows * len(code)
    planes = np.frombuffer(body, np.uint8, 8 * size).reshape(8, -1)
    folded = np.ascontiguousarray(planes.T).view("<u8").reshape(-1, rows)
    ulps = np.frombuffer(body, np.int8, size, 8 * size).reshape(-1, rows)
    ends = np.cumsum([0, *(width for _, width, _ in header["columns"])])
    wanted = [(item, slice(*ends[k : k + 2])) for k, item in enumerate(header["columns"]) if not only or item[0] in only]
    read = np.concatenate([np.arange(len(code))[own] for _, own in wanted]) if wanted else np.zeros(0, int)
    whole = np.empty(folded.shape, np.int64)
    whole[read] = np.cumsum((folded[read] >> np.uint64(1)).astype(np.int64) ^ -(folded[read] & np.uint64(1)).astype(np.int64), axis=1)
    for number, grid in enumerate(GRIDS, start=1):
        on = read[code[read] == number]
        whole[on] = _on_grid(whole[on], grid).view(np.int64) + ulps[on]
    return {name: np.ascontiguousarray(whole[own].T).astype(f"<i{kind[2:]}").view(kind) for (name, _, kind), own in wanted}


def _table(values: np.ndarray) -> np.ndarray:
    if values.dtype.kind not in "iufb" or values.dtype.itemsize > 8:
        raise TypeError(f"values of type {values.dtype} cannot be recorded")
    return np.ascontiguousarray(values.reshape(len(values), -1), dtype=values.dtype.newbyteorder("<"))


def _bits(values: np.ndarray) -> np.ndarray:
    return values.view(f"<i{values.dtype.itemsize}").astype(np.int64)


def _nearest(values: np.ndarray, grid: tuple[int, bool]) -> tuple[np.ndarray, np.ndarray]:
    """The nearest points of a grid as whole numbers, and by how many units in the last place (or bits, where none is near) they miss."""
    decimals, degrees = grid
    with np.errstate(over="ignore"):
        scaled = values * (10.0**decimals * (180.0 / np.pi if degrees else 1.0))
    nearest = np.rint(np.where(np.abs(scaled) < MOST, scaled, 0.0)).astype(np.int64)
    return nearest, values.view(np.int64) - _on_grid(nearest, grid).view(np.int64)


def _on_grid(whole: np.ndarray, grid: tuple[int, bool]) -> np.ndarray:
    """Two operations that every computer rounds alike (IEEE 754)."""
    decimals, degrees = grid
    return whole / 10.0**decimals * (np.pi / 180.0 if degrees else 1.0)

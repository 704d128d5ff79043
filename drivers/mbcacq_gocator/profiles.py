"""The profiles of a line scanner: whole blocks of data sets become points.

A data set has one stamp and one profile, or several of both where the sensor sends them together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from mbcacq.devices import Profiles, ProtocolError
from mbcacq_gocator.dataset import DataSet
from mbcacq_gocator.decode import TICKS_PER_US, ArrayMessage
from mbcacq_gocator.layouts import INVALID, PROFILE_POINTS, TYPE_NAMES, UNIFORM_PROFILE


@dataclass(frozen=True)
class ProfileBlock:
    """Profiles of one data set. counter, time_s, encoder, inputs: (k,), as ``Profiles``. raw: (k, W) z or (k, W, 2) x and z, int16; scale,
    offset: (2,) mm, of x and z."""

    counter: np.ndarray
    time_s: np.ndarray
    encoder: np.ndarray
    inputs: np.ndarray
    raw: np.ndarray
    scale: tuple[float, float]
    offset: tuple[float, float]


def block_of(data: DataSet) -> ProfileBlock | None:
    """The profiles of a data set, copied; None if it has none. Raises ProtocolError if stamps and profiles do not agree."""
    profiles = [array for array in data.arrays if array.type in (PROFILE_POINTS, UNIFORM_PROFILE)]
    if not profiles:
        return None
    array = profiles[0]
    if data.stamps is None or len(data.stamps) != len(array.array):
        raise ProtocolError(f"the Gocator sent {len(array.array)} profiles with {0 if data.stamps is None else len(data.stamps)} stamps")
    stamps = data.stamps.copy()
    return ProfileBlock(stamps[:, 0], stamps[:, 1] / (TICKS_PER_US * 1e6), stamps[:, 2], stamps[:, 4], array.array.copy(), *_scales(array))


def _scales(array: ArrayMessage) -> tuple[tuple[float, float], tuple[float, float]]:
    try:
        of = array.attributes
        return (of["x_resolution"] / 1e6, of["z_resolution"] / 1e6), (of["x_offset"] / 1e3, of["z_offset"] / 1e3)
    except KeyError as missing:
        raise ProtocolError(f"a Gocator {TYPE_NAMES[array.type]} does not say its {missing}") from None


def joined(blocks: Sequence[ProfileBlock]) -> Profiles:
    """All profiles of the blocks. Neighbours of one form are made into points together."""
    points, counts = [np.empty((0, 2), np.float32)], [np.empty(0, np.int64)]
    for (_, scale, offset), alike in groupby(blocks, lambda b: (b.raw.shape[1:], b.scale, b.offset)):
        raw = np.concatenate([b.raw for b in alike])
        z = raw[..., 1] if raw.ndim == 3 else raw
        valid = z != INVALID
        if raw.ndim == 3:
            x = raw[..., 0][valid] * np.float32(scale[0]) + np.float32(offset[0])
        else:
            grid = (offset[0] + np.arange(z.shape[1]) * scale[0]).astype(np.float32)
            x = np.broadcast_to(grid, z.shape)[valid]
        points.append(np.column_stack([x, z[valid] * np.float32(scale[1]) + np.float32(offset[1])]))
        counts.append(valid.sum(axis=1))
    count = np.concatenate(counts)
    kinds = {"counter": np.int64, "time_s": float, "encoder": np.int64, "inputs": np.int64}
    of = {name: np.concatenate([np.zeros(0, kind), *(getattr(b, name) for b in blocks)]) for name, kind in kinds.items()}
    first = np.cumsum(count) - count
    return Profiles(of["counter"], of["time_s"], of["encoder"], of["inputs"], first, np.concatenate(points))

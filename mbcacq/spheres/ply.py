"""Ball centres from a cloud in a file, as another laboratory would send it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mbcacq.model.cell import Artefact
from mbcacq.spheres.cloud_file import in_mm, read_cloud_file
from mbcacq.spheres.extract import find_spheres
from mbcacq.spheres.found import FoundSpheres, SphereOptions


def read_cloud(path: str | Path) -> np.ndarray:
    """Points (N, 3) of a PLY or PCD file, in mm where its header states a unit, else as stored. Raises ConfigError naming the file."""
    found = read_cloud_file(path)
    return in_mm(path, found, found.unit or "mm")


def centres_from_ply(
    path: str | Path,
    artefact: Artefact,
    *,
    expected: Sequence[int] | None = None,
    predicted: np.ndarray | None = None,
    options: SphereOptions | None = None,
) -> FoundSpheres:
    """``find_spheres`` on the cloud in a file (mm, scanner frame)."""
    return find_spheres(read_cloud(path), artefact, expected=expected, predicted=predicted, options=options)

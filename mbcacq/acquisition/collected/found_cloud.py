"""One cloud of a folder: its name, time, and the balls that it shows."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from mbcacq.devices import DeviceFault, MbcacqError
from mbcacq.model.cell import Artefact

LEAST_BALLS = 3  # that say by themselves which ball is which, and where the artefact is
_POSE_IN_NAME = re.compile(r"pose[ _-]?(\d+)(?:\D+(\d+))?", re.IGNORECASE)


@dataclass(frozen=True)
class FoundCloud:
    """path; number: the last one in its name, or None; named_pose, named_exposure: where the name says them ('pose_012_1'); written_s: when
    the file was written, s. digest: of its bytes. ball (k,) ids and xyz (k, 3) mm in the scanner frame.
    fault: why it cannot be used, or ''."""

    path: Path
    number: int | None
    named_pose: int | None
    named_exposure: int | None
    written_s: float
    digest: str = ""
    ball: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    xyz: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    fault: str = ""

    @property
    def name(self) -> str:
        return self.path.name

    @property
    def identified(self) -> bool:
        """Whether it says by itself what it shows."""
        return len(self.ball) >= LEAST_BALLS


def look_at(
    path: Path, read: Callable[[Path], np.ndarray], artefacts: Sequence[Artefact], find: Callable[[np.ndarray, Artefact], object]
) -> FoundCloud:
    """Read a cloud and look for the balls of the artefacts. read: its points (N, 3) mm; find: their centres, as ``find_spheres``."""
    numbers = re.findall(r"\d+", path.stem)
    named = _POSE_IN_NAME.search(path.stem)
    about = {
        "path": path,
        "number": int(numbers[-1][-15:]) if numbers else None,
        "named_pose": int(named[1][-9:]) if named else None,
        "named_exposure": int(named[2][-9:]) if named and named[2] else None,
        "written_s": path.stat().st_mtime,
    }
    try:
        points = read(path)
    except MbcacqError as error:
        return FoundCloud(**about, fault=str(error))
    best, why = None, ""
    for artefact in artefacts:
        try:
            found = find(points, artefact)
        except DeviceFault as error:
            why = why or str(error)
            continue
        if best is None or len(found.ball) > len(best.ball):  # type: ignore[attr-defined]
            best = found
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    ball, xyz = (np.zeros(0, dtype=int), np.zeros((0, 3))) if best is None else (best.ball, best.xyz)  # type: ignore[attr-defined]
    return FoundCloud(**about, digest=digest, ball=ball, xyz=xyz, fault="" if best is not None else f"{path.name}: {why}")

"""What arms change from one day to the next without a cause, as the recordings of a fleet show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.fleet.control_chart import FEWEST, arm_types, excess_variance
from mbcacq.fleet.row import FleetRow, estimates_of
from mbcacq.fleet.store import read_table
from mbcacq.interim_check.options import UsualChanges
from mbcacq.interim_check.possible_changes import TWIST


def read_day_to_day(fleet: Path | str, robot: str) -> UsualChanges:
    """Standard deviations from the table of a fleet that has several recordings of arms of a type. robot: name of the type.

    As in the fleet's control charts, they are such that the median moving range is as expected: one arm that drifts, or a few bad
    recordings, do not widen them. Values that the table does not state stay as usual. Raises ConfigError if no arm of the type was
    recorded often enough.
    """
    kind = next((k for k in arm_types(read_table(Path(fleet))) if k.robot == robot), None)
    rows = [] if kind is None else list(kind.rows)
    if sum(a.arm == b.arm for a, b in zip(rows[1:], rows[:-1], strict=True)) < FEWEST:
        raise ConfigError(f"{fleet} has too few arms of type '{robot}' with several recordings to say what changes from day to day")
    usual = UsualChanges()
    joints = [name for name in rows[0].names if name.startswith("theta_")]
    figures = {
        "joint": _spread(rows, joints),
        "mount_mm": _spread(rows, [f"hand_eye.{c}" for c in TWIST[:3]]),
        "mount_rad": _spread(rows, [f"hand_eye.{c}" for c in TWIST[3:]]),
    }
    known = {name: value for name, value in figures.items() if value is not None}
    return replace(usual, **known, source=f"{len(rows)} recordings of {len({r.arm for r in rows})} arms in {fleet}")


def _spread(rows: Sequence[FleetRow], names: Sequence[str]) -> float | None:
    """Root mean square, over parameters, of what changes from a recording to the next of the same arm; None if it is not known."""
    arms = np.array([r.arm for r in rows])
    same = arms[1:] == arms[:-1]
    found = []
    for name in names:
        value, std = estimates_of(rows, name)
        known = same & np.isfinite(value[1:] - value[:-1])
        stated = np.nan_to_num(std[1:] ** 2 + std[:-1] ** 2)
        variance = excess_variance((value[1:] - value[:-1])[known], stated[known])
        found += [variance / 2] if np.isfinite(variance) else []
    return float(np.sqrt(np.mean(found))) if found else None

"""A motorised stand of the artefact, as far as the plan tells it: a column, and a turntable where the stations lie on a circle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from mbcacq.recording.rrd import layout
from mbcacq.recording.rrd.drawn_later import Stream
from mbcacq.recording.rrd.of_plan import of_plan

BELOW_MM = 60.0  # of a station's origin: the bracket that holds the artefact stands on the table there
FOOT_MM = 100.0  # that the column reaches below the lowest table
TABLE_MM, COLUMN_MM, ROD_MM = 16.0, 30.0, 6.0  # thickness of the table, radii of column and bracket
RIM_MM = 40.0  # of the table beyond the stations
CIRCLE_MM = 3.0  # stations nearer to one circle than this turn about its axis
STEEL = (122, 128, 136)


@dataclass(frozen=True)
class StationStand:
    """places: station -> (3,) mm in the base frame. axis: (2,) mm where the table turns, None if the stations lie on no circle."""

    places: dict[str, np.ndarray]
    axis: np.ndarray | None = None

    @classmethod
    def of(cls, plan_yaml: str) -> StationStand | None:
        """None if the plan has no positioner with a motor, or is of another form."""

        def read(plan: Any) -> StationStand | None:
            if plan["positioner"]["driver"] == "manual":
                return None
            places = {str(s["id"]): np.array(s["pose_in_base"]["translation_mm"], float).reshape(3) for s in plan["stations"]}
            return cls(places, turning_axis(np.array(list(places.values())).reshape(-1, 3)[:, :2]))

        return of_plan(plan_yaml, read, None)

    def log(self, rec: Stream, station: str) -> None:
        """Draw it as it stands at that station, at the times set on the stream."""
        if station not in self.places:
            return
        place = self.places[station]
        axis = place[:2] if self.axis is None else self.axis
        table, foot = place[2] - BELOW_MM, min(p[2] for p in self.places.values()) - BELOW_MM - FOOT_MM
        radius = RIM_MM + float(np.linalg.norm(place[:2] - axis))
        cylinders = rr.Cylinders3D(
            lengths=[table - foot, TABLE_MM],
            radii=[COLUMN_MM, radius],
            centers=[[*axis, (table + foot) / 2], [*axis, table]],
            colors=[STEEL, STEEL],
            line_radii=rr.Radius.ui_points(0.8),
        )
        rec.log(layout.STAND, cylinders)
        rec.log(f"{layout.STAND}/bracket", rr.LineStrips3D([[[*place[:2], table], place]], colors=[STEEL], radii=[ROD_MM]))


def turning_axis(xy: np.ndarray) -> np.ndarray | None:
    """(2,) centre of the circle through points (k, 2), by least squares; None of fewer than four, or where they lie on none."""
    if len(xy) < 4:
        return None
    middle = xy.mean(axis=0)
    about = xy - middle
    found, _, rank, _ = np.linalg.lstsq(np.column_stack([2 * about, np.ones(len(xy))]), np.sum(about**2, axis=1), rcond=None)
    distance = np.linalg.norm(about - found[:2], axis=1)
    return middle + found[:2] if rank == 3 and np.ptp(distance) < 2 * CIRCLE_MM else None

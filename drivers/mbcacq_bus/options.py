"""Driver options as pydantic models, so that a typing error in a plan is one clear sentence."""

from __future__ import annotations

from pydantic import Field

from mbcacq.devices import DriverOptions


class StationOptions(DriverOptions):
    """stations: station id -> position. limits: of the position; a station outside is refused."""

    stations: dict[str | int, float] = Field(min_length=1)
    limits: tuple[float, float] | None = None
    tolerance: float = Field(default=0.05, gt=0)
    move_timeout_s: float = Field(default=120.0, gt=0)
    settle_s: float = Field(default=0.0, ge=0)

    def refuse_outside(self, unit: str = "") -> None:
        """Raises ValueError for a station beyond the limits."""
        for station, value in self.stations.items():
            if self.limits is not None and not self.limits[0] <= value <= self.limits[1]:
                low, high = self.limits
                raise ValueError(f"station {station} at {value:g}{unit} is outside the limits {low:g}..{high:g}")

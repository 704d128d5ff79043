"""Options of the UR driver, so that a typing error in a plan is one clear sentence."""

from __future__ import annotations

from pydantic import Field, model_validator

from mbcacq.devices import HOST, DriverOptions

AXES = 6


class UrOptions(DriverOptions):
    """address, port: of the controller. frequency_hz: of its packages. silence_s: without a package for so long it counts as lost.
    payload_kg: what the controller must have set; None: whatever it has. limits_deg, speed_deg_s: from the plan's robot file;
    follow: of its robot section: only listen, and send nothing that the arm could move by. digital_outputs: numbers of
    the standard digital outputs (0 to 7) that may be switched from here, as to trigger a scanner; none where others switch them."""

    address: str = Field(min_length=1, pattern=HOST)
    port: int = Field(default=30004, ge=1, le=65535)
    frequency_hz: float = Field(default=125.0, ge=1, le=500)
    connect_timeout_s: float = Field(default=5.0, gt=0)
    silence_s: float = Field(default=1.0, gt=0)
    payload_kg: float | None = Field(default=None, ge=0)
    payload_tolerance_kg: float = Field(default=0.1, gt=0)
    limits_deg: tuple[tuple[float, float], ...] = Field(min_length=AXES, max_length=AXES)
    speed_deg_s: tuple[float, ...] | None = None
    follow: bool = False
    digital_outputs: tuple[int, ...] = ()

    @model_validator(mode="after")
    def _limits(self) -> UrOptions:
        if any(low >= high for low, high in self.limits_deg):
            raise ValueError("the lower limit of an axis must come first")
        if not all(0 <= number <= 7 for number in self.digital_outputs):
            raise ValueError("digital_outputs are numbers from 0 to 7")
        if self.digital_outputs and self.follow:
            raise ValueError("an arm that is only followed is sent nothing, digital_outputs neither; leave them out, or follow")
        return self

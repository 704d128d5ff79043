"""The interfaces of devices, as small Protocols, and the data they exchange."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

import numpy as np


@dataclass(frozen=True)
class Field:
    """One quantity a device delivers."""

    name: str
    unit: str
    shape: tuple[int, ...] = ()
    rate_hz: float | None = None
    meaning: str = ""


@dataclass(frozen=True)
class Fact:
    """A property of a device on which results depend, as the device reports it now, e.g. ``Fact("load", 2.3, "kg", 0.05)``.

    Attributes
    ----------
    tolerance : float
        Numbers that differ by no more are the same.
    critical : bool
        Poses under two values of it cannot be compared. A change of another fact is recorded, and the pose is kept.
    """

    name: str
    value: str | float
    unit: str = ""
    tolerance: float = 0.0
    critical: bool = True

    @property
    def text(self) -> str:
        """The value with its unit, e.g. '2.3 kg'."""
        return f"{self.value if isinstance(self.value, str) else format(self.value, '.6g')} {self.unit}".rstrip()

    def recorded(self, text: str) -> Fact:
        """This property with a value that was recorded as ``text`` earlier."""
        if isinstance(self.value, str):
            return replace(self, value=text)
        try:
            return replace(self, value=float(text.removesuffix(self.unit)))
        except ValueError:
            return replace(self, value=text)

    def differs(self, other: Fact) -> bool:
        """Whether the value is another one than that of ``other``."""
        if isinstance(self.value, str) or isinstance(other.value, str):
            return self.value != other.value
        return self.text != other.text and not abs(self.value - other.value) <= self.tolerance


@dataclass(frozen=True)
class Description:
    """What a device is and delivers. Known before connecting, except what only the device can tell (serial, firmware, settings).

    settings: how the device is set up, by name, as far as results depend on it and the plan does not say it.
    """

    kind: str
    model: str
    fields: tuple[Field, ...]
    serial: str = ""
    firmware: str = ""
    verified_on_hardware: bool = False
    settings: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class MotionLimits:
    """Limits of one joint motion, and when it counts as finished.

    speed, acceleration, jerk: (n,) rad/s, rad/s^2, rad/s^3. ``tolerance`` (rad; (n,) with mm of an axis that slides) is the largest
    distance of a measured joint to its target that counts as arrived; ``settle_s`` is how long, on the robot's own clock, it must
    stay there.
    """

    speed: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    tolerance: float | np.ndarray = 2e-4
    settle_s: float = 0.2


@dataclass(frozen=True)
class RobotState:
    """The latest measured state. ``q`` (n,) rad as the controller reports it; ``arrived`` refers to the last ``move_to``."""

    time_s: float
    q: np.ndarray
    moving: bool
    arrived: bool


@dataclass(frozen=True)
class Cycles:
    """Raw controller cycles, one row a received telegram, oldest first. ``columns`` maps a name to an array (k,) or (k, n).

    Always present: ``time_s`` (robot clock), ``host_time_s`` (monotonic clock of this computer), ``q`` (measured, rad),
    ``q_set`` (the set point the controller reports, rad), ``q_command`` (what we asked for in the reply, rad).
    A driver adds what else it receives: ``current_percent``, ``delay``, ``ipoc``...
    """

    columns: Mapping[str, np.ndarray]

    def __len__(self) -> int:
        return len(self.columns["time_s"]) if self.columns else 0


@dataclass(frozen=True)
class Scan:
    """One exposure of a 3D scanner.

    Attributes
    ----------
    points : ndarray
        (N, 3) float32, mm, scanner frame, valid points only.
    intensity : ndarray or None
        (N,) uint8 or None.
    shape : tuple[int, int]
        (rows, columns) of the sensor grid, (0, 0) if unorganised.
    pixel : ndarray or None
        (N,) int32 index row * columns + column of each point in that grid, or None.
    time_s : float
        The device's clock at the exposure.
    frame : int
        The device's frame counter.
    measurements, health : Mapping[str, float]
        Numbers the device sent along, by name.
    warnings : tuple[str, ...]
        Sentences for the operator.
    """

    points: np.ndarray
    intensity: np.ndarray | None = None
    shape: tuple[int, int] = (0, 0)
    pixel: np.ndarray | None = None
    time_s: float = 0.0
    frame: int = 0
    exposure_us: float = 0.0
    measurements: Mapping[str, float] = field(default_factory=dict)
    health: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Profiles:
    """Profiles of a line scanner, one row each, oldest first.

    Attributes
    ----------
    counter, encoder, inputs : (k,) ndarray
        int64: the sensor's number of the profile, ticks of its encoder, and its inputs as bits.
    time_s : (k,) ndarray
        The sensor's clock at the exposure.
    first : (k,) ndarray
        Row of ``points`` at which each profile begins.
    points : (N, 2) ndarray
        float32, mm: x along the laser line, z, valid points only. The laser plane is y = 0 of the scanner.
    lost : int
        How many profiles the counter says there were that never came, up to the last of these.
    """

    counter: np.ndarray
    time_s: np.ndarray
    encoder: np.ndarray
    inputs: np.ndarray
    first: np.ndarray
    points: np.ndarray
    lost: int = 0

    def __len__(self) -> int:
        return len(self.counter)


@runtime_checkable
class Device(Protocol):
    """Common to every device: a context manager that connects on entry and closes on exit."""

    def connect(self) -> None:
        """Open the connection and identify the device. Raises ConnectError, IdentityError."""
        ...

    def describe(self) -> Description:
        """What it is and delivers, e.g. ``Description("sensor", "PT100", (Field("air_C", "deg C"),), serial="4711")``."""
        ...

    def stop(self) -> None:
        """Bring the device to rest. Idempotent, allowed in any state and from any thread; never raises."""
        ...

    def close(self) -> None:
        """Stop, then release everything. Idempotent."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None: ...


@runtime_checkable
class Robot(Device, Protocol):
    def move_to(self, q: np.ndarray, limits: MotionLimits) -> None:
        """Start a joint motion to ``q`` (n,) rad and return at once; ``state().arrived`` tells when it is done.

        Raises SafetyStop if the target may not be approached, and any error the connection met since the last call.
        """
        ...

    def state(self) -> RobotState:
        """The latest state, from any thread, e.g. ``RobotState(12.504, q, moving=False, arrived=True)``. Raises the error that stopped the
        robot, if one did."""
        ...

    def cycles(self) -> Cycles:
        """Every cycle received since the last call, nothing dropped silently, e.g. ``Cycles({"time_s": t, "q": q, ...})`` with t (k,) and
        q (k, n), or ``Cycles({})``. Never raises."""
        ...


@runtime_checkable
class Scanner(Device, Protocol):
    def capture(self, exposure_us: float | None = None) -> Scan:
        """Expose once and return the scan, e.g. ``Scan(points, frame=17)`` with points (N, 3).

        Raises DeviceTimeout, ProtocolError, DeviceFault."""
        ...


@runtime_checkable
class ProfileScanner(Device, Protocol):
    """A line scanner, which measures while the arm moves."""

    def start_profiles(self) -> None:
        """Begin to take profiles, triggered as the sensor's job says. Raises ConfigError, and as ``Scanner.capture``."""
        ...

    def profiles(self) -> Profiles:
        """Every profile since the last call, nothing dropped silently. Raises the error that ended the stream, once all before it are
        returned; DeviceFault where counter or clock began anew, as nobody can tell when later profiles were taken."""
        ...

    def end_profiles(self) -> None:
        """Stop, and return once all profiles that were under way have come; the next ``profiles()`` has them. Raises the error that ended
        the stream before."""
        ...


@runtime_checkable
class Positioner(Device, Protocol):
    def go_to(self, station: str, prompt: str) -> None:
        """Bring the artefact to a station and return when it stands still. ``prompt`` is what an operator would be asked."""
        ...


@runtime_checkable
class Sensor(Device, Protocol):
    def read(self) -> dict[str, float]:
        """Current values by field name, in the units of ``describe()``, e.g. ``{"air_C": 21.5}``."""
        ...

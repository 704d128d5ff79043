"""What happens during a run, as data. The runner emits these; recorder, journal, progress bar and viewer subscribe.

Times: ``time_s`` is seconds since the run started, on this computer's monotonic clock. Every run ends with RunStopped.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mbcacq.devices import Cycles, Description, Profiles, Scan

OPERATOR = "operator"  # source of a message that a person at the arm waits for


@dataclass(frozen=True)
class Event:
    time_s: float


@dataclass(frozen=True)
class RunStarted(Event):
    """A run begins.

    Attributes
    ----------
    plan_yaml, cell_yaml : str
        Full texts, so that the recording is enough to calibrate again.
    started : str
        ISO 8601, UTC.
    route : Mapping[int, ndarray]
        Number of each pose yet to come -> (k, n) rad, the joint waypoints that lead to it, the pose last.
    urdf : str
        File that draws the arm, or ''.
    simulated : bool
        The devices are fakes.
    plan_files : str
        JSON of the files that the plan names and which cell is driven, with which a resumed run is compared.
    """

    name: str
    started: str
    plan_yaml: str
    cell_yaml: str
    n_poses: int
    versions: Mapping[str, str]
    route: Mapping[int, np.ndarray] = field(default_factory=dict)
    urdf: str = ""
    simulated: bool = False
    plan_files: str = ""


@dataclass(frozen=True)
class DeviceConnected(Event):
    """What a device says of itself once it is connected. role: 'robot', 'scanner', 'positioner', 'sensor 1'..; driver: its class."""

    role: str
    driver: str
    about: Description


@dataclass(frozen=True)
class StateChanged(Event):
    """state: 'connecting', 'moving', 'settling', 'scanning', 'waiting', 'paused', 'stopped'."""

    state: str


@dataclass(frozen=True)
class StepStarted(Event):
    index: int
    name: str
    n_poses: int


@dataclass(frozen=True)
class StationReached(Event):
    station: str
    artefact: str


@dataclass(frozen=True)
class CyclesReceived(Event):
    """Raw controller cycles of the last moment, also while scanning."""

    cycles: Cycles


@dataclass(frozen=True)
class PoseReached(Event):
    """The arm stands. pose: number in the plan; q: (n,) rad as reported; direction: (n,) -1, 0, 1, of rotation in the last motion."""

    pose: int
    station: str
    phase: str
    step: str
    q: np.ndarray
    direction: np.ndarray
    robot_time_s: float


@dataclass(frozen=True)
class ScanTaken(Event):
    pose: int
    exposure: int
    scan: Scan


@dataclass(frozen=True)
class CentresFound(Event):
    """Balls found in one exposure: ball (k,) certificate ids; xyz (k, 3) mm; n_points (k,); rms_mm (k,)."""

    pose: int
    exposure: int
    ball: np.ndarray
    xyz: np.ndarray
    n_points: np.ndarray
    rms_mm: np.ndarray


@dataclass(frozen=True)
class SweepTaken(Event):
    """Profiles of a sweep over one ball (its certificate id) that began and ended at a pose.

    began_s: the controller's clock just before the scanner was started. expected: (3,) mm, where the ball was expected in the scanner's
    frame, in the middle of the sweep.
    """

    pose: int
    ball: int
    began_s: float
    expected: np.ndarray
    profiles: Profiles


@dataclass(frozen=True)
class PoseDone(Event):
    """The pose's observation: mean over its exposures. scatter_mm: (k, 3) standard deviation between exposures.

    A pose is observed only once this event is out; q is the mean of the joint angles reported during the exposures. facts: what the
    devices reported of themselves meanwhile, e.g. ``{"robot load": "2.3 kg"}``.
    """

    pose: int
    station: str
    phase: str
    step: str
    q: np.ndarray
    direction: np.ndarray
    robot_time_s: float
    ball: np.ndarray
    xyz: np.ndarray
    n_points: np.ndarray
    rms_mm: np.ndarray
    scatter_mm: np.ndarray
    n_exposures: int
    current: np.ndarray | None = None
    sensors: Mapping[str, float] = field(default_factory=dict)
    facts: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class HealthReceived(Event):
    device: str
    values: Mapping[str, float]


@dataclass(frozen=True)
class FactChanged(Event):
    """A device reports another value of what results depend on. role: of the device; before, now: with their unit."""

    role: str
    name: str
    before: str
    now: str


@dataclass(frozen=True)
class Gap(Event):
    """Something the recording lacks. kind: 'pose' or 'exposure' (left out), 'sensor', 'cycles', 'scanner' (was away); text: one sentence;
    pose: number. A Message says the same to the operator."""

    kind: str
    text: str
    pose: int | None = None


@dataclass(frozen=True)
class Message(Event):
    """level: 'info', 'warning' or 'error'. source: its sender; OPERATOR: it tells a person what to do next."""

    level: str
    text: str
    source: str = "mbcacq"


@dataclass(frozen=True)
class RunStopped(Event):
    """exit_status: 'success', 'abort' or 'fail'; reason: one sentence."""

    exit_status: str
    reason: str

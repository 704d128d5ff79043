"""The plan as a user writes it: YAML checked against this schema, unknown keys refused. mm and deg here, rad after expansion."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from mbcacq.model.bounds import (
    Angle,
    CouplingFactor,
    Direction,
    Error,
    Gap,
    JointAngle,
    Length,
    Noise,
    Place,
    Position,
    Pulses,
    Radius,
    Resolution,
)
from mbcacq.model.cell_schema import ExternalAxisSpec, PayloadSpec, PoseSpec, Strict, TemperatureRange, Whole, in_order_of_chain, whole
from mbcacq.quantities import from_degrees

MOST_EXPOSURES = 1000  # of one pose: at a second each, a quarter of an hour
MOST_PLACES = 100  # at which a plan asks for accuracy
LEAST_SPEED = 1e-3  # of the axes' largest: slower ones take hours from pose to pose, and cannot be timed
LONGEST_S = 3600.0  # of what is waited for at one pose
Options = Annotated[dict[str, Any], BeforeValidator(whole)]


class Coupling(Strict):
    """``factor`` times the angle of axis ``of`` is added to that of ``axis``, both counted from 1."""

    axis: Whole = Field(ge=1)
    of: Whole = Field(ge=1)
    factor: CouplingFactor


class ControllerJoints(Strict):
    """How the controller counts its joints where that differs from the robot file: sign * angle + offset, then the couplings."""

    sign: tuple[Literal[-1, 1], ...] | None = None
    offset_deg: tuple[JointAngle, ...] | None = None
    couplings: tuple[Coupling, ...] = ()  # of FANUC, whose A3 is counted from the horizontal: {axis: 3, of: 2, factor: -1}
    pulses_per_deg: tuple[Pulses, ...] | None = None  # of encoders, for jobs that hold pulses (INFORM)


class FollowUse(Strict):
    """An arm that no computer may move: a person, or the arm's own program, brings it to each target, and the run takes it where it
    stands. No motion is ever commanded."""

    tolerance_deg: float = Field(default=2.0, gt=0, le=30)  # of each axis, between its target and where it is taken
    stand_s: float = Field(default=1.5, gt=0, le=60)  # so long the arm must stand there
    timeout_s: float = Field(default=900.0, gt=0, le=86400)  # so long the run waits for it at one target


class RobotUse(Strict):
    """Which arm, how to reach it, and how fast it may move."""

    driver: str
    model: str  # robot YAML, relative to the plan
    urdf: str | None = None  # draws the arm in the viewer; relative to the plan
    options: Options = {}  # the driver's own
    speed: float = Field(default=0.3, ge=LEAST_SPEED, le=1)  # share of the model's largest joint speed
    acceleration_time_s: float = Field(default=0.3, gt=0, le=60)  # time to reach that speed
    jerk_time_s: float = Field(default=0.1, gt=0, le=60)  # time to reach that acceleration
    settle_s: float = Field(default=0.3, ge=0, le=LONGEST_S)
    tolerance_deg: float = Field(default=0.01, gt=0, le=30)
    home_deg: tuple[JointAngle, ...]  # where the run starts, ends, and the artefact is moved
    external_axes: tuple[ExternalAxisSpec, ...] = ()  # track, lift, gantry under the arm; turntable, positioner under the artefact
    home_external: tuple[Position, ...] = ()  # of these axes, deg or mm; default: zero
    fixed_axes: tuple[str, ...] = ()  # names of those that stay at home; the others go where they bring the arm soonest
    spread_axes: tuple[str, ...] = ()  # names of those that are spread over what they may do, from view to view
    payload: PayloadSpec | None = None  # scanner with bracket, in the flange frame; default: the robot file's
    link_radius_mm: Radius | None = None  # of the upper arm, for collisions; default: 7 % of the arm's reach
    base_to_gravity: Direction | None = None  # for an arm on a wall or a ceiling; default: the robot file's
    follow: FollowUse | None = None  # only follow the arm, never move it
    controller_joints: ControllerJoints | None = None  # for programs, joint logs and readings of the controller

    @property
    def home(self) -> np.ndarray:
        """(n,) rad, mm."""
        return self.with_external(from_degrees(self.home_deg))

    @property
    def free_axes(self) -> tuple[bool, ...]:
        """Whether each external axis, in the order of the chain, may leave home for a target."""
        return tuple(axis.name not in self.fixed_axes for axis in in_order_of_chain(self.external_axes))

    @property
    def is_spread(self) -> tuple[bool, ...]:
        """Whether the views are spread over what each external axis, in the order of the chain, may do."""
        return tuple(axis.name in self.spread_axes for axis in in_order_of_chain(self.external_axes))

    def with_external(self, arm: np.ndarray) -> np.ndarray:
        """Positions (n,) of all axes in the order of the chain: those of the arm (m,) rad, the external ones at home."""
        values = self.home_external or (0.0,) * len(self.external_axes)
        at_home = {axis.name: axis.inside(value) for axis, value in zip(self.external_axes, values, strict=False)}
        return np.concatenate([[at_home[axis.name] for axis in in_order_of_chain(self.external_axes)], arm])


class FieldOfView(Strict):
    """Where the scanner sees, in its own frame: a frustum from z near to z far, half widths there. z points to the scanner."""

    near_z_mm: Position
    far_z_mm: Position
    near_half_mm: tuple[Position, Position]
    far_half_mm: tuple[Position, Position]
    body_mm: tuple[Place, Place] | None = None  # housing, a box in the scanner frame: min, max corner


class ScannerUse(Strict):
    driver: str
    model: str = ""
    options: Options = {}
    field_of_view: FieldOfView
    exposure_us: float | None = Field(default=None, gt=0, le=1e8)
    noise_mm: tuple[Noise, Noise, Noise] | None = None  # of one fitted ball centre along x, y, z, in the middle of the field of view
    noise_far_mm: tuple[Noise, Noise, Noise] | None = None  # the same at its far end, where it differs; between them by their ratio
    noise_factor_at_60_deg: float = Field(default=1.0, ge=1, le=100)  # how many times noisier a surface is that is seen 60 deg aslant
    resolution_mm: Resolution | None = None  # between neighbouring points, in the middle of the field of view
    keep_clouds: Literal["balls", "all"] = "balls"  # in the recording: the points of the balls with a thinned rest, or every point
    scan_time_s: float = Field(default=1.0, ge=0, le=LONGEST_S)  # of one exposure with its transfer, for the estimate of the duration
    reconnect_s: float = Field(default=90.0, ge=0, le=86400)  # how long a scanner that went away (a reboot, a cable) is tried again


class DeviceUse(Strict):
    driver: str
    model: str = ""
    options: Options = {}


class SensorUse(DeviceUse):
    required: bool = False  # a run ends where its value is missing; else the pose is without it


class StationPlace(Strict):
    """Where an artefact will stand, roughly: good enough to aim at."""

    id: str | int
    artefact: str
    pose_in_base: PoseSpec


class View(Strict):
    """How the scanner looks at a point: tilt of its axis from the station's z axis towards azimuth, roll about its axis."""

    tilt_deg: float = Field(default=0.0, ge=0, lt=90)
    azimuth_deg: Angle = 0.0
    roll_deg: Angle = 0.0
    shift_mm: Place = (0.0, 0.0, 0.0)  # of the looked-at point, in the scanner frame
    wrist: Literal["any", "positive", "negative"] = "any"  # sign of A5: the two ways a wrist reaches one orientation


class Step(Strict):
    name: str
    exposures: Whole | None = Field(default=None, ge=1, le=MOST_EXPOSURES)


class BallStep(Step):
    phase: Literal["translation", "orientation", "position", "length", "verification"]


class Translate(BallStep):
    """Keep the orientation of one view, move along the base axes."""

    do: Literal["translate"]
    station: str | int
    view: View = View()
    offsets_mm: tuple[Place, ...] = Field(min_length=1)


class Look(BallStep):
    """Look at every station from every view; with ``balls: each``, or certain ids, at each of these balls by itself (an artefact
    longer than the view)."""

    do: Literal["look"]
    stations: tuple[str | int, ...] = Field(min_length=1)
    views: tuple[View, ...] = Field(min_length=1)
    balls: Literal["all", "each"] | tuple[Whole, ...] = "all"


class Sweep(BallStep):
    """Let a line scanner's laser plane cross single balls, forth and back, while the arm moves: from every view, in every direction."""

    do: Literal["sweep"]
    stations: tuple[str | int, ...] = Field(min_length=1)
    views: tuple[View, ...] = Field(min_length=1)
    balls: Literal["each"] | tuple[Whole, ...] = "each"
    directions_deg: tuple[Angle, ...] = Field(default=(0.0,), min_length=1)  # of the line, from across the laser line towards along it
    length_mm: float = Field(gt=0, le=2000)  # of each line; half a ball more than its diameter lets the speed settle
    speed_mm_s: float = Field(gt=0, le=2000)  # profile rate times the spacing that is wanted


class Taught(BallStep):
    """Joint positions as taught."""

    do: Literal["joints"]
    station: str | int
    poses_deg: tuple[tuple[JointAngle, ...], ...] = Field(min_length=1)
    balls: tuple[Whole, ...] | None = None  # expected ids; default: all in view


class PartView(View):
    at_mm: Place | None = None  # point of the part to look at, in its frame; default: the middle of its upper side


class ScanPart(Step):
    """Scan the surface of a part at its stations: every view is one cloud, for `mbcacq merge`."""

    do: Literal["scan"]
    phase: Literal["part"] = "part"
    stations: tuple[str | int, ...] = Field(min_length=1)
    views: tuple[PartView, ...] = Field(min_length=1)


AnyStep = Annotated[Translate | Look | Sweep | Taught | ScanPart, Field(discriminator="do")]


class Obstacle(Strict):
    """Something the arm must not touch: a box along the axes of the base frame, from one corner to the other."""

    name: str
    min_mm: Place
    max_mm: Place


class Workspace(Strict):
    """A box along the axes of the base frame that the arm from its second link on, with flange and scanner, must stay in."""

    min_mm: Place
    max_mm: Place


class AcceptanceBox(Strict):
    """Where the arm is to be accurate: a box along the axes of the base frame."""

    min_mm: Place
    max_mm: Place


class Acceptance(Strict):
    """Limits of the verification. A run that misses one ends with its own exit code. box, places_mm: where the arm is to be accurate, by
    which ``investigate`` and ``diagnose --next`` choose poses as well.
    """

    sphere_spacing_error_mm: Error | None = None
    min_balls: Whole = Field(default=3, ge=1)
    box: AcceptanceBox | None = None
    places_mm: tuple[Place, ...] = Field(default=(), max_length=MOST_PLACES)


class Plan(Strict):
    format: Literal["mbcacq-plan/1"]
    name: str
    robot: RobotUse
    scanner: ScannerUse
    positioner: DeviceUse = DeviceUse(driver="manual")
    sensors: tuple[SensorUse, ...] = ()
    hand_eye: PoseSpec
    artefacts: tuple[str, ...] = Field(min_length=1)  # artefact YAML files, relative to the plan
    room_temperature_C: TemperatureRange | None = None  # range that the room keeps: its share of a verified length's uncertainty
    stations: tuple[StationPlace, ...] = Field(min_length=1)
    exposures: Whole = Field(default=3, ge=1, le=MOST_EXPOSURES)
    station_tolerance_mm: Length = 30.0  # an artefact seen farther from its planned place ends the run
    obstacles: tuple[Obstacle, ...] = ()
    workspace: Workspace | None = None  # nothing of the arm that moves may leave it
    clearance_mm: Gap = 10.0  # closer than this counts as a collision
    tripod_radius_mm: Gap = 40.0  # of the stand below each station, down to the lowest obstacle; 0: none
    steps: tuple[AnyStep, ...] = Field(min_length=1)
    accept: Acceptance = Acceptance()
    fake: dict[str, Any] = {}  # errors injected into the fake cell; a real run ignores it

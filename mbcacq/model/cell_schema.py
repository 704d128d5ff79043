"""Robot, artefact and cell descriptions as YAML: one schema for plan files and observation sets. deg in files, rad inside."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.geometry.chain_from_axes import carried
from mbcacq.model import bounds, cell
from mbcacq.quantities import from_degrees


def whole(value: Any) -> Any:
    """A whole number as such, however it is written (5., 1e3), also inside lists and mappings; anything else as it is."""
    if isinstance(value, dict):
        return {key: whole(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(whole(one) for one in value)
    return int(value) if isinstance(value, float) and value.is_integer() and abs(value) < MOST_EXACT else value


MOST_EXACT = 2.0**53  # above it not every whole number is a float
Whole = Annotated[int, BeforeValidator(whole)]


def _rising(limits: tuple[float, float]) -> tuple[float, float]:
    if limits[0] > limits[1]:
        raise ValueError("the lowest comes first; exchange the two")
    return limits


TemperatureRange = Annotated[tuple[bounds.RoomTemperature, bounds.RoomTemperature], AfterValidator(_rising)]


class Strict(BaseModel):
    """Unknown keys are refused. A subclass that reads foreign files may allow them."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class PoseSpec(Strict):
    """A frame: rotation matrix or KUKA angles A, B, C (deg), and translation (mm)."""

    rotation: tuple[bounds.RotationRow, bounds.RotationRow, bounds.RotationRow] | None = None
    abc_deg: bounds.Angles | None = None
    translation_mm: bounds.Place = (0.0, 0.0, 0.0)
    sigma_mm: bounds.Uncertainty | None = None

    def transform(self) -> np.ndarray:
        """(4, 4); a rotation matrix given with few digits is brought to the nearest rotation, one given in full is kept bit for bit."""
        xyz = np.array(self.translation_mm, dtype=float)
        if self.rotation is not None:
            R = np.array(self.rotation, dtype=float)
            exact = np.abs(R @ R.T - np.eye(3)).max() < 1e-14 and np.linalg.det(R) > 0
            return se3.transform(R if exact else se3.nearest_rotation(R), xyz)
        return se3.from_abc(xyz, from_degrees(self.abc_deg or (0.0, 0.0, 0.0)))


class JointSpec(Strict):
    """What a joint may do: deg of a revolute one, mm of a prismatic one."""

    type: Literal["revolute", "prismatic"] = "revolute"
    name: Annotated[str, Field(pattern=r"^[AE][1-9][0-9]?$")] | None = None
    carries: Literal["arm", "artefact"] = "arm"
    limits_deg: tuple[bounds.JointAngle, bounds.JointAngle] = (-360.0, 360.0)
    limits_mm: tuple[bounds.Position, bounds.Position] | None = None
    speed_deg_s: bounds.Speed | None = None
    speed_mm_s: bounds.LinearSpeed | None = None
    acceleration_deg_s2: bounds.Acceleration | None = None
    acceleration_mm_s2: bounds.LinearAcceleration | None = None
    jerk_deg_s3: bounds.Jerk | None = None
    jerk_mm_s3: bounds.LinearJerk | None = None
    drive: cell.Drive | None = None

    @model_validator(mode="after")
    def _in_its_unit(self) -> JointSpec:
        other = "_mm" if self.type == "revolute" else "_deg"
        if wrong := [name for name in self.model_fields_set if other in name and name.split("_")[0] in QUANTITIES]:
            raise ValueError(f"{wrong[0]} is not for a {self.type} joint; give {joint_key(wrong[0].split('_')[0], self.type)}")
        if self.type == "prismatic" and self.limits_mm is None:
            raise ValueError("a prismatic joint needs limits_mm; give the lowest and the highest position")
        return self

    @property
    def slides(self) -> bool:
        """Whether it is prismatic."""
        return self.type == "prismatic"

    def inside(self, value: float) -> float:
        """A position of a file, deg or mm, in rad or mm."""
        return value if self.slides else float(from_degrees(value))

    def quantity(self, name: str) -> Any:
        """limits, speed, acceleration or jerk in rad, or mm of a prismatic joint; None where nothing is said."""
        said = getattr(self, joint_key(name, self.type))
        return said if said is None or self.slides else from_degrees(said)


def ratio_unit(joint: JointSpec, leader: JointSpec) -> float:
    """Factor from a ratio in the units of files (deg, mm) to the same ratio in rad and mm."""
    unit = {False: float(from_degrees(1.0)), True: 1.0}
    return 1.0 if joint.slides == leader.slides else unit[joint.slides] / unit[leader.slides]


QUANTITIES = {"limits": "", "speed": "_s", "acceleration": "_s2", "jerk": "_s3"}  # of a joint, and how the key ends


def joint_key(quantity: str, kind: str) -> str:
    """The key under which a file states a quantity of a joint: speed_deg_s, speed_mm_s of a prismatic one."""
    return f"{quantity}_{'mm' if kind == 'prismatic' else 'deg'}{QUANTITIES[quantity]}"


class FollowsSpec(Strict):
    """The joint that a joint moves with, by its number in the list of links, and the ratio of their motions, in deg and mm."""

    link: Annotated[int, Field(ge=1)]
    ratio: Annotated[float, Field(ge=-1e4, le=1e4)] = 1.0


class LinkSpec(JointSpec):
    sign: Literal[-1, 1] = 1
    theta_deg: bounds.Angle
    d_mm: bounds.Position
    a_mm: bounds.Position
    alpha_deg: bounds.Angle
    beta_deg: bounds.Angle = 0.0
    mass_kg: bounds.Mass = 0.0
    com_mm: bounds.Place = (0.0, 0.0, 0.0)
    gear_ratio: bounds.GearRatio | None = None
    follows: FollowsSpec | None = None


class ExternalAxisSpec(JointSpec):
    """An axis beside the arm: under the arm (track, lift, gantry), or under the artefact (turntable, positioner).

    direction, point_mm: the line about which it turns, or along which it moves what it carries, in the base of the arm while all external
    axes are at zero. They are listed from the floor on, those of a positioner too.
    """

    name: Annotated[str, Field(pattern=r"^E[1-9]$")] | None = None
    direction: bounds.Direction
    point_mm: bounds.Place = (0.0, 0.0, 0.0)


def in_order_of_chain(axes: Sequence[ExternalAxisSpec]) -> tuple[ExternalAxisSpec, ...]:
    """Those that carry the artefact from its table to the floor, then those that carry the arm from the floor on."""
    of_table = [axis for axis in axes if axis.carries == "artefact"]
    return (*of_table[::-1], *(axis for axis in axes if axis.carries == "arm"))


class PayloadSpec(Strict):
    mass_kg: bounds.PayloadMass = 0.0
    com_mm: bounds.Place = (0.0, 0.0, 0.0)


class RobotSpec(Strict):
    """links: the joints of the chain one after another; external_axes: those given by their lines. base_to_first_axis: frame of the first
    joint, where it is not the base."""

    name: str
    links: tuple[LinkSpec, ...] = Field(min_length=2)
    external_axes: tuple[ExternalAxisSpec, ...] = ()
    base_to_first_axis: PoseSpec | None = None
    payload: PayloadSpec = PayloadSpec()
    base_to_gravity: bounds.Direction = (0.0, 0.0, -1.0)
    repeatability_mm: bounds.Repeatability | None = None
    balancer: bool | None = None

    @model_validator(mode="after")
    def _in_order(self) -> RobotSpec:
        carries = [link.carries for link in self.links]
        if "artefact" in carries[carries.index("arm") if "arm" in carries else 0 :]:
            raise ValueError("the joints that carry the artefact come first, from its table to the floor; reorder the links")
        if self.external_axes and "artefact" in carries:
            raise ValueError("links carry the artefact already; give the external axes all as links, or all as external_axes")
        if any(link.follows and link.follows.link > len(self.links) for link in self.links):
            raise ValueError("a link follows one that is not there; give the number of another link, counted from 1")
        names = [joint.name for joint in (*self.external_axes, *self.links) if joint.name]
        if len(set(names)) < len(names):
            raise ValueError("two axes have the same name; rename one")
        return self

    def model(self, external_axes: tuple[ExternalAxisSpec, ...] = ()) -> cell.RobotModel:
        """The arm. external_axes: further ones, that carry it or the artefact beside its own."""
        column = {
            name: np.array([getattr(link, name) for link in self.links], dtype=float)
            for name in ("sign", "theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg", "mass_kg")
        }
        chain = Chain(
            column["sign"],
            from_degrees(column["theta_deg"]),
            column["d_mm"],
            column["a_mm"],
            from_degrees(column["alpha_deg"]),
            from_degrees(column["beta_deg"]),
            sliding=tuple(i for i, link in enumerate(self.links) if link.slides),
            floor=sum(link.carries == "artefact" for link in self.links),
            root=self.base_to_first_axis.transform() if self.base_to_first_axis else None,
            follows=tuple(
                (i, f.link - 1, f.ratio * ratio_unit(link, self.links[f.link - 1]))
                for i, link in enumerate(self.links)
                if (f := link.follows)
            ),
        )
        before = in_order_of_chain((*external_axes, *self.external_axes))
        if before:
            towards = np.array([_unit(np.array(axis.direction, dtype=float)) for axis in before])
            of_table = sum(axis.carries == "artefact" for axis in before)
            towards[:of_table] *= -1
            slides = [i for i, axis in enumerate(before) if axis.slides]
            chain = carried(chain, towards, np.array([axis.point_mm for axis in before], dtype=float), slides, of_table)
        joints: tuple[JointSpec, ...] = (*before, *self.links)
        speed, acceleration, jerk = (_all_or_none([j.quantity(name) for j in joints]) for name in ("speed", "acceleration", "jerk"))
        gravity, k = np.array(self.base_to_gravity, dtype=float), len(before)
        return cell.RobotModel(
            name=self.name,
            chain=chain,
            limits=np.array([(0.0, 0.0) if isinstance(j, LinkSpec) and j.follows else j.quantity("limits") for j in joints], dtype=float),
            mass=np.concatenate([np.zeros(k), column["mass_kg"]]),
            com=np.vstack([np.zeros((k, 3)), [link.com_mm for link in self.links]]),
            speed=speed,
            acceleration=acceleration,
            jerk=jerk,
            gear_ratio=_all_or_none([*[1.0] * k, *(link.gear_ratio for link in self.links)]),
            payload_mass=self.payload.mass_kg,
            payload_com=np.array(self.payload.com_mm, dtype=float),
            gravity=_unit(gravity),
            repeatability_mm=self.repeatability_mm,
            balancer=self.balancer,
            drives=tuple(j.drive for j in joints) if any(j.drive for j in joints) else (),
            names=_names(joints) if any(j.name for j in joints) else (),
        )


class BallSpec(Strict):
    """centre_mm may be missing where the artefact is not certified."""

    id: int
    centre_mm: bounds.Place | None = None
    diameter_mm: bounds.Distance = 0.0


class KnownLengthSpec(Strict):
    """The distance of two balls of an artefact that is not certified otherwise."""

    balls: tuple[int, int]
    length_mm: bounds.Length
    uncertainty_mm: bounds.Uncertainty = 0.0


class ArtefactSpec(Strict):
    """certified: false says that the places of the balls are unknown: they are estimated, to the scale of ``known_length`` or, without it,
    of the scanner. A part has no balls, but a mesh of its surface (STL, mm) or the box that holds it."""

    id: str
    name: str = ""
    reference_temperature_C: bounds.RoomTemperature = 20.0
    expansion_ppm_per_K: bounds.Expansion | None = None
    uncertainty_mm: bounds.Uncertainty = 0.001
    balls: tuple[BallSpec, ...] = ()
    mesh: str | None = None  # relative to this file
    box_mm: tuple[bounds.Place, bounds.Place] | None = None  # lowest and highest corner
    certificate: str | None = None
    certified: bool = True
    known_length: KnownLengthSpec | None = None

    @model_validator(mode="after")
    def _has_centres(self) -> ArtefactSpec:
        if bool(self.balls) == bool(self.mesh or self.box_mm):
            raise ValueError("an artefact has balls; a part has a mesh or a box_mm instead of them; give one of the two")
        if self.box_mm and not all(low < high for low, high in zip(*self.box_mm, strict=True)):
            raise ValueError("box_mm: each number of the first corner must be below that of the second; exchange those that are not")
        missing = [b.id for b in self.balls if b.centre_mm is None]
        if self.certified and missing:
            raise ValueError(f"ball {missing[0]} has no centre_mm; give it, or say certified: false")
        if self.known_length and self.certified:
            raise ValueError("known_length is for an artefact with certified: false; the certificate has all lengths already")
        if self.known_length and not set(self.known_length.balls) <= {b.id for b in self.balls}:
            raise ValueError("known_length names a ball that is not among the balls of this artefact")
        return self

    def model(self) -> cell.Artefact:
        return cell.Artefact(
            id=self.id,
            name=self.name,
            ball_ids=tuple(b.id for b in self.balls),
            centres=np.array([b.centre_mm or (np.nan,) * 3 for b in self.balls], dtype=float).reshape(-1, 3),
            diameters=np.array([b.diameter_mm for b in self.balls], dtype=float),
            uncertainty_mm=self.uncertainty_mm,
            reference_temperature_C=self.reference_temperature_C,
            expansion_ppm_per_K=self.expansion_ppm_per_K,
            certified=self.certified,
            known_length=cell.KnownLength(*vars(self.known_length).values()) if self.known_length else None,
            box=np.array(self.box_mm, dtype=float) if self.box_mm else None,
        )


class StationSpec(Strict):
    id: str | int
    artefact: str
    pose_in_base: PoseSpec | None = None


class ScannerSpec(Strict):
    """noise_mm: of one centre along x, y, z; zeros say as little as none. length_scale: of an instrument that measures distances alone, the
    relative standard uncertainty of its scale."""

    name: str = ""
    noise_mm: tuple[bounds.Noise, bounds.Noise, bounds.Noise] | None = None
    length_scale: Annotated[float, Field(gt=0, le=0.1)] | None = None
    noise_deg: bounds.AngleNoise | None = None


# What people call who carries what; the first of each is how the program writes it.
MEASUREMENTS: dict[str, cell.Measurement] = {
    **dict.fromkeys(("artefact_in_scanner", "eye_in_hand", "scanner_on_flange"), cell.ARTEFACT_IN_SCANNER),
    **dict.fromkeys(("target_in_base", "eye_to_hand", "fixed_scanner"), cell.TARGET_IN_BASE),
}


class FlangePosesSpec(Strict):
    """How ``poses.csv`` gives the poses of the flange in place of joint angles. orientation: a maker (kuka, fanuc, ur ..) or a convention
    (ZYX, xyz, vector, wxyz ..), length and angle: units, where the headings do not say."""

    robot: str = "poses of the flange"
    repeatability_mm: bounds.Repeatability | None = None
    orientation: str | None = None
    length: Literal["mm", "m"] | None = None
    angle: Literal["deg", "rad"] | None = None


class CellSpec(Strict):
    """``cell.yaml`` of an observation set."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    format: Literal["mbcacq-observation-set/1"]
    measurement: Literal["artefact_in_scanner", "target_in_base", "eye_in_hand", "eye_to_hand", "scanner_on_flange", "fixed_scanner"] = (
        "artefact_in_scanner"
    )
    simulated: bool = False
    robot: RobotSpec | None = None
    flange_poses: FlangePosesSpec | None = None
    columns: dict[str, str] = {}
    hand_eye: PoseSpec = PoseSpec()
    artefacts: tuple[ArtefactSpec, ...] = Field(min_length=1)
    stations: tuple[StationSpec, ...] = Field(min_length=1)
    scanner: ScannerSpec = ScannerSpec()
    room_temperature_C: TemperatureRange | None = None

    def model(self) -> cell.Cell:
        flange = self.flange_poses or FlangePosesSpec()
        return cell.Cell(
            robot=self.robot.model() if self.robot else cell.arm_of_flange_poses(flange.robot, flange.repeatability_mm),
            T_flange_scanner=self.hand_eye.transform(),
            artefacts=tuple(a.model() for a in self.artefacts),
            stations=tuple(
                cell.Station(
                    str(s.id),
                    s.artefact,
                    s.pose_in_base.transform() if s.pose_in_base else None,
                    s.pose_in_base.sigma_mm if s.pose_in_base else None,
                )
                for s in self.stations
            ),
            scanner_name=self.scanner.name,
            noise_mm=np.array(self.scanner.noise_mm) if self.scanner.noise_mm and all(self.scanner.noise_mm) else None,
            measurement=MEASUREMENTS[self.measurement],
            length_scale=self.scanner.length_scale,
            noise_rad=from_degrees(self.scanner.noise_deg) if self.scanner.noise_deg else None,
            simulated=self.simulated,
            room_temperature_C=self.room_temperature_C,
        )


def _unit(vector: np.ndarray) -> np.ndarray:
    """Normalised; what is normalised already stays as it is, so that writing and reading changes no bit."""
    length = np.linalg.norm(vector)
    return vector if abs(length - 1) < 1e-15 else vector / length


def _names(joints: tuple[JointSpec, ...]) -> tuple[str, ...]:
    """Those that are given; the others are counted as axes of the arm."""
    free = (name for name in (f"A{i}" for i in count(1)) if name not in {j.name for j in joints})
    return tuple(j.name or next(free) for j in joints)


def _all_or_none(values: list[Any]) -> np.ndarray | None:
    return None if any(v is None for v in values) else np.array(values, dtype=float)

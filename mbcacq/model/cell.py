"""The cell as data: robot, scanner, certified artefacts, stations. Plain arrays; ``cell_schema`` reads them from YAML."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np

from mbcacq.files.mesh_file import Mesh
from mbcacq.geometry.chain import PARAMETERS, Chain
from mbcacq.geometry.flange_poses import FlangePoses
from mbcacq.quantities import in_degrees

Measurement = Literal["artefact_in_scanner", "target_in_base"]
Drive = Literal["gear", "direct", "belt", "friction_wheel", "screw", "scaled_encoder"]
ARTEFACT_IN_SCANNER: Final = "artefact_in_scanner"
TARGET_IN_BASE: Final = "target_in_base"
SCENE: Final = "scene"  # artefact of scans of a part, whose frame is what these scans make of it
SIMULATED = "simulated: the fake cell or a model made these data, no real arm was measured"


@dataclass(frozen=True)
class RobotModel:
    """Nominal arm. Arrays over the n axes; angles rad, lengths mm, masses kg; in place of rad stands mm for a prismatic joint.

    Attributes
    ----------
    limits : ndarray
        (n, 2) rad.
    speed, acceleration, jerk : ndarray or None
        (n,) rad/s, rad/s^2 and rad/s^3, or None where the source did not say.
    com : ndarray
        (n, 3) mm, each in the frame of its link (behind its MD-H row).
    gear_ratio : ndarray or None
        (n,) or None.
    payload_com : ndarray
        (3,) mm in the flange frame.
    gravity : ndarray
        (3,) unit vector in the base frame, pointing down.
    balancer : bool or None
        Whether a spring or gas balancer carries A2; None where the source does not say.
    drives : tuple[Drive | None, ...]
        (n,) what moves each joint, None where the source does not say; empty where it says so of no joint.
    names : tuple[str, ...]
        (n,) of the axes, as the controller counts them: A1 .. those of the arm, E1 .. external ones; empty: A1 to An.
    """

    name: str
    chain: Chain
    limits: np.ndarray
    mass: np.ndarray
    com: np.ndarray
    speed: np.ndarray | None = None
    acceleration: np.ndarray | None = None
    gear_ratio: np.ndarray | None = None
    payload_mass: float = 0.0
    payload_com: np.ndarray = field(default_factory=lambda: np.zeros(3))
    gravity: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -1.0]))
    repeatability_mm: float | None = None
    jerk: np.ndarray | None = None
    balancer: bool | None = None
    drives: tuple[Drive | None, ...] = ()
    names: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        return self.chain.n

    @property
    def counted(self) -> np.ndarray:
        """(n,) bool: the axis has a position of its own, which a controller counts; one that follows another has none."""
        return ~np.isin(np.arange(self.n), [joint for joint, _, _ in self.chain.follows])

    @property
    def axes(self) -> tuple[str, ...]:
        """(n,) names of the axes."""
        return self.names or counted_axes(self.n)

    @property
    def tags(self) -> tuple[str, ...]:
        """(n,) what stands for an axis in the name of a quantity: '1' of A1, 'E1' of E1."""
        return tags_of(self.axes)

    @property
    def frames(self) -> tuple[str, ...]:
        """(n + 1,) names of the base, and of the frame behind each axis."""
        return ("base", *(f"link{tag}" for tag in self.tags[:-1]), "mount")

    def axis(self, name: str) -> int | None:
        """The index of an axis by its name; None for another name."""
        return self.axes.index(name) if name in self.axes else None

    @property
    def external(self) -> int:
        """How many of the first axes are external ones."""
        return sum(name.startswith("E") for name in self.names)

    def shown(self, values: np.ndarray) -> np.ndarray:
        """Positions, speeds .. (.., n) as people read them: deg of an axis that turns, mm of one that slides."""
        return np.where(self.chain.prismatic, values, in_degrees(values))

    def drawn(self, q: np.ndarray) -> np.ndarray:
        """Positions (.., n) as charts show them: deg, and cm of an axis that slides, which fits the scale of the angles."""
        return np.where(self.chain.prismatic, q / 10, in_degrees(q))

    @property
    def drawn_axes(self) -> tuple[str, ...]:
        """(n,) axes with the units of ``drawn``."""
        return tuple(f"{name} / {'cm' if slides else '°'}" for name, slides in zip(self.axes, self.chain.prismatic.tolist(), strict=True))

    @property
    def headings(self) -> tuple[str, ...]:
        """(n,) headings of positions in tables: q1_deg of A1, e1_mm of E1 that slides."""
        kinds = zip(self.axes, self.chain.prismatic.tolist(), strict=True)
        return tuple(f"{'q' if name[0] == 'A' else 'e'}{name[1:]}_{'mm' if slides else 'deg'}" for name, slides in kinds)

    def in_words(self, q: np.ndarray) -> str:
        """A position (n,): 'A1 10.0° A2 ..'."""
        return " ".join(f"{name} {value:.1f}{self.unit(k)}" for k, (name, value) in enumerate(zip(self.axes, self.shown(q), strict=True)))

    def unit(self, axis: int) -> str:
        """The sign of its unit: '°', or ' mm'."""
        return " mm" if axis in self.chain.sliding else "°"

    def drive(self, joint: int) -> Drive | None:
        """What moves a joint, by its index; None where the source does not say."""
        return self.drives[joint] if joint < len(self.drives) else None

    @property
    def of_flange_poses(self) -> bool:
        """Whether only the poses of the flange are known, no joints and no links."""
        return isinstance(self.chain, FlangePoses)


def counted_axes(n: int) -> tuple[str, ...]:
    """A1 to An: the names of axes that nothing else names."""
    return tuple(axis_of_tag(str(i + 1)) for i in range(n))


def tags_of(axes: tuple[str, ...]) -> tuple[str, ...]:
    """What stands for each axis in the name of a quantity."""
    return tuple(axis.removeprefix("A") for axis in axes)


def axis_of_tag(tag: str) -> str:
    """The axis by what stands for it in a name: A1 of '1'."""
    return f"A{tag}" if tag.isdigit() else tag


def link_parameters(axes: tuple[str, ...]) -> tuple[str, ...]:
    """(5 n,) names of the MD-H parameters, row by row: theta_1 of A1, theta_E1 of E1."""
    return tuple(f"{p}_{tag}" for tag in tags_of(axes) for p in PARAMETERS)


def arm_of_flange_poses(name: str, repeatability_mm: float | None = None, coordinates: np.ndarray | None = None) -> RobotModel:
    """An arm of which only the poses of its flange are known. coordinates: (P, 6) mm and rad of these, whose range becomes the limits."""
    chain = FlangePoses.new()
    at = np.zeros((1, chain.n)) if coordinates is None else coordinates
    limits = np.stack([at.min(axis=0), at.max(axis=0)], axis=1)
    return RobotModel(name, chain, limits, np.zeros(chain.n), np.zeros((chain.n, 3)), repeatability_mm=repeatability_mm)


@dataclass(frozen=True)
class KnownLength:
    """Distance of two balls (ids) in mm, with its standard uncertainty."""

    balls: tuple[int, int]
    length_mm: float
    uncertainty_mm: float = 0.0


@dataclass(frozen=True)
class Artefact:
    """A certified object. ball_ids: certificate names, unique in the cell. centres: (B, 3) mm, artefact frame; diameters: (B,) mm.

    uncertainty_mm: standard uncertainty (k = 1) of one coordinate of a centre. expansion_ppm_per_K: None if unknown. The centres of an
    artefact without a certificate are a guess (NaN: none yet), and known_length is all that is known of its scale, if anything.
    """

    id: str
    name: str
    ball_ids: tuple[int, ...]
    centres: np.ndarray
    diameters: np.ndarray
    uncertainty_mm: float = 0.001
    reference_temperature_C: float = 20.0
    expansion_ppm_per_K: float | None = None
    certified: bool = True
    known_length: KnownLength | None = None
    box: np.ndarray | None = None  # (2, 3) mm, of a part: lowest and highest corner in its frame
    mesh: Mesh | None = None  # of a part, in a loaded plan

    @property
    def is_part(self) -> bool:
        """Whether it is a part, whose surface is scanned: it has no balls, and calibrates nothing by itself."""
        return not self.ball_ids


@dataclass(frozen=True)
class Station:
    """One fixed placement of one artefact. T_base_station: (4, 4) if given, with sigma_mm its standard uncertainty."""

    id: str
    artefact: str
    T_base_station: np.ndarray | None = None
    sigma_mm: float | None = None

    @property
    def planned_pose(self) -> np.ndarray:
        """T_base_station of a station that a plan has placed; every station of a loaded plan is."""
        assert self.T_base_station is not None, f"station '{self.id}' has no planned place"
        return self.T_base_station


@dataclass(frozen=True)
class Cell:
    """Everything known before measuring. T_flange_scanner is a first guess; noise_mm: (3,) sigma of one centre, or None.

    measurement: ARTEFACT_IN_SCANNER (a scanner on the flange) or TARGET_IN_BASE (an external instrument sees a target on
    the flange; then the one station is the instrument and T_flange_scanner holds the target's place).
    noise_rad: sigma of a measured orientation about each axis, or None.
    simulated: what was recorded in it comes from a fake cell or a model, not from a real arm.
    room_temperature_C: range that the room keeps, lowest and highest, or None where nobody stated it.
    length_scale: of an instrument that measures the target's distance alone (draw wire, ballbar, interferometer), the relative standard
    uncertainty of its scale; None for any other. Distances stand in the first coordinate.
    joint_step: rad, to which the joint angles that were recorded in it are rounded; 0 where they are not.
    """

    robot: RobotModel
    T_flange_scanner: np.ndarray
    artefacts: tuple[Artefact, ...]
    stations: tuple[Station, ...]
    scanner_name: str = ""
    noise_mm: np.ndarray | None = None
    measurement: Measurement = ARTEFACT_IN_SCANNER
    simulated: bool = False
    noise_rad: float | None = None
    room_temperature_C: tuple[float, float] | None = None
    joint_step: float = 0.0
    length_scale: float | None = None

    def artefact(self, artefact_id: str) -> Artefact:
        return next(a for a in self.artefacts if a.id == artefact_id)

    def station(self, station_id: str) -> Station:
        return next(s for s in self.stations if s.id == station_id)

    @property
    def ball_ids(self) -> tuple[int, ...]:
        """All balls of all artefacts, in order; ``Observations.ball`` indexes this."""
        return tuple(b for a in self.artefacts for b in a.ball_ids)

    @property
    def ball_centres(self) -> np.ndarray:
        """(K, 3) mm certified centres in the order of ``ball_ids``, each in its artefact's frame."""
        return np.concatenate([a.centres for a in self.artefacts])

    @property
    def ball_artefact(self) -> np.ndarray:
        """(K,) index into ``artefacts`` of each ball."""
        return np.concatenate([np.full(len(a.ball_ids), i) for i, a in enumerate(self.artefacts)])

"""The cell as simple solids: capsules along the links, a box for the scanner, boxes and a post for what stands around."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mbcacq.geometry import se3
from mbcacq.model.cell import Artefact
from mbcacq.plan.limits import PlanningLimits
from mbcacq.plan.planned import LoadedPlan


@dataclass(frozen=True, eq=False)
class Body:
    """A capsule or a box, fixed to frame ``link`` of the arm (0: base and surroundings, n: flange). pose: (4, 4) in that frame.

    sides: (3,) mm of a box, or (0, 0, length of the line) of a capsule of radius ``rounding``. radius: of a sphere around the origin of
    ``pose`` that holds it. carried: the scanner, or what carries it, no link. Two bodies are equal only if they are the same object.
    """

    name: str
    link: int
    pose: np.ndarray
    sides: np.ndarray
    radius: float
    rounding: float = 0.0
    carried: bool = False

    @cached_property
    def length(self) -> float:
        """mm, of its longest side; of a capsule, of the line in it."""
        return float(np.max(self.sides))

    @cached_property
    def extent_m(self) -> np.ndarray:
        """(3,) m: half the sides of a box; radius, half of the line and 0 of a capsule."""
        return np.array([self.rounding, self.length / 2, 0.0] if self.rounding > 0 else self.sides / 2) / 1e3


def halves(body: Body) -> tuple[Body, Body]:
    """The two halves of a body across its longest side, as bodies of the same name."""
    axis, half = int(np.argmax(body.sides)), body.length / 2
    sides = np.where(np.arange(3) == axis, half, body.sides)
    radius = float(np.linalg.norm(sides) / 2) + body.rounding
    shift = np.eye(3)[axis] * half / 2
    low, high = (replace(body, pose=body.pose @ se3.transform(np.eye(3), s), sides=sides, radius=radius) for s in (-shift, shift))
    return low, high


def arm_bodies(loaded: LoadedPlan) -> list[Body]:
    """Base column, links and scanner."""
    robot, field = loaded.cell.robot, loaded.plan.scanner.field_of_view
    frames = robot.chain.frames(np.zeros((1, robot.n)))[0]
    bodies = []
    first = robot.chain.first_turning  # what slides or turns below the arm has a shape that nobody stated
    for i, radius in list(enumerate(_link_radii(loaded)))[first:]:
        lifted = frames[i, :3, 3] + robot.chain.d[i] * frames[i, :3, 2]
        # The d of a row lies along its own axis, so it turns with the link, but does not move.
        for part, (start, end) in enumerate(((frames[i, :3, 3], lifted), (lifted, frames[i + 1, :3, 3]))):
            if np.linalg.norm(end - start) > loaded.planning.shortest_body_mm:
                link = i if i == first and part == 0 else i + 1
                name = "base" if link == first else f"link {i + 1}"
                bodies.append(_capsule(name, link, se3.inverse(frames[link]), start, end, radius))
    if field.body_mm is not None:
        low, high = np.array(field.body_mm)
        bodies.append(replace(_box("scanner", robot.n, loaded.cell.T_flange_scanner, low, high), carried=True))
        bodies += _bracket(loaded, low, high)
    return bodies


def _link_radii(loaded: LoadedPlan) -> list[float]:
    """mm, links 1 to n; a radius that the plan states is that of the upper arm, and the other links scale with it."""
    shares, stated = loaded.planning.link_radius_shares, loaded.plan.robot.link_radius_mm
    scale = 1.0 if stated is None else stated / (shares[1] * reach(loaded))
    return [scale * reach(loaded) * shares[min(i, len(shares) - 1)] for i in range(loaded.cell.robot.n)]


def _bracket(loaded: LoadedPlan, low: np.ndarray, high: np.ndarray) -> Iterator[Body]:
    """What carries the scanner: from the flange to the nearest point of its housing, where there is room between."""
    T = loaded.cell.T_flange_scanner
    flange = se3.inverse(T)[:3, 3]
    end = se3.apply(T, np.clip(flange, low, high))
    if np.linalg.norm(end) > loaded.planning.shortest_body_mm:
        radius = reach(loaded) * loaded.planning.link_radius_shares[-1]
        yield replace(_capsule("bracket", loaded.cell.robot.n, np.eye(4), np.zeros(3), end, radius), carried=True)


def surrounding_bodies(loaded: LoadedPlan) -> list[Body]:
    """Obstacles, and the workspace's limits as walls around it."""
    boxes = [_box(o.name, *_floor(loaded), np.array(o.min_mm), np.array(o.max_mm)) for o in loaded.plan.obstacles]
    return boxes + list(_walls(loaded))


def _walls(loaded: LoadedPlan) -> Iterator[Body]:
    space, thickness = loaded.plan.workspace, loaded.planning.wall_mm
    if space is None:
        return
    low, high = np.array(space.min_mm) - thickness, np.array(space.max_mm) + thickness
    for axis, name in enumerate("xyz"):
        for side, limit in (("lower", space.min_mm[axis]), ("upper", space.max_mm[axis])):
            near, far = low.copy(), high.copy()
            (far if side == "lower" else near)[axis] = limit
            yield _box(f"the workspace's {side} {name} limit", *_floor(loaded), near, far)


def _floor(loaded: LoadedPlan) -> tuple[int, np.ndarray]:
    """Number of the frame that stands on the floor, and the base at zero in it."""
    chain = loaded.cell.robot.chain
    return chain.floor, se3.inverse(chain.frames(np.zeros((1, chain.n)))[0, chain.floor])


def station_bodies(loaded: LoadedPlan, station: str) -> list[Body]:
    """The artefact at a station, and the tripod below it."""
    planning, T_base_station = loaded.planning, loaded.cell.station(station).planned_pose
    artefact = loaded.cell.artefact(loaded.cell.station(station).artefact)
    if artefact.box is not None:
        low, high = artefact.box.copy()
    else:
        low, high = _room_of_balls(artefact, planning)
    root = loaded.cell.robot.chain.root
    T_frame_base = np.eye(4) if root is None else se3.inverse(root)
    bodies = [_box(f"artefact {artefact.id}", 0, T_frame_base @ T_base_station, low, high)]
    radius = loaded.plan.tripod_radius_mm
    down = loaded.cell.robot.gravity
    top = se3.apply(T_base_station, np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])) + radius * down
    without_floor = top @ down + planning.deepest_tripod_mm
    floor = max((np.abs(np.array([o.min_mm, o.max_mm]) @ down).max() for o in loaded.plan.obstacles), default=without_floor)
    length = floor - top @ down - radius
    if radius > 0 and length > planning.shortest_body_mm and not loaded.cell.robot.chain.floor:  # a table has no tripods
        bodies.append(_capsule("tripod", 0, T_frame_base, top, top + length * down, radius))
    return bodies


def _room_of_balls(artefact: Artefact, planning: PlanningLimits) -> tuple[np.ndarray, np.ndarray]:
    """Corners (3,) mm of the box that an artefact fills in its frame, with the plate below its balls."""
    room = artefact.diameters[:, None] / 2 + np.array([planning.artefact_side_mm, planning.artefact_side_mm, 0.0])
    low, high = (artefact.centres - room).min(axis=0), (artefact.centres + room).max(axis=0)
    low[2] -= planning.plate_mm
    return low, high


def reach(loaded: LoadedPlan) -> float:
    """mm from axis 2 to the wrist, stretched."""
    frames = loaded.cell.robot.chain.frames(np.zeros((1, loaded.cell.robot.n)))[0]
    steps = np.linalg.norm(np.diff(frames[1:-1, :3, 3], axis=0), axis=1)
    return float(steps.sum())


def _box(name: str, link: int, T: np.ndarray, low: np.ndarray, high: np.ndarray) -> Body:
    middle = se3.transform(np.eye(3), (low + high) / 2)
    return Body(name, link, T @ middle, high - low, float(np.linalg.norm(high - low) / 2))


def _capsule(name: str, link: int, T: np.ndarray, start: np.ndarray, end: np.ndarray, radius: float) -> Body:
    """Around the line from start to end (3,), both in the frame outside ``T``."""
    length = float(np.linalg.norm(end - start))
    z = (end - start) / length
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    pose = T @ se3.transform(np.stack([x, np.cross(z, x), z], axis=1), (start + end) / 2)
    return Body(name, link, pose, np.array([0.0, 0.0, length]), length / 2 + radius, rounding=radius)

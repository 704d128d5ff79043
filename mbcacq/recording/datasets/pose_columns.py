"""Columns that hold poses, found by their headings: whose pose it is, which numbers its orientation has, and in which units.

A heading is a word of the thing (``flange``, ``target``), if any, the component (``x``, ``qw``, ``A``, ``r11``) and a unit, if any:
``x_mm``, ``X [mm]``, ``flange.position.x``, ``robot_rx (rad)``, ``T_cam_board_r11``.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.table import Table
from mbcacq.files.table_schema import KEPT_HEADING
from mbcacq.geometry import orientations, se3
from mbcacq.geometry.flange_poses import flange_coordinates
from mbcacq.quantities import DEGREE

LENGTHS = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "in": 25.4, "inch": 25.4}
ANGLES = {"deg": DEGREE, "°": DEGREE, "degree": DEGREE, "degrees": DEGREE, "rad": 1.0, "radian": 1.0, "radians": 1.0}
FLANGE_WORDS = ("flange", "robot", "tcp", "tool", "tool0", "ee", "eef", "gripper", "hand", "arm", "effector", "base2gripper", "end", "bt")
TARGET_WORDS = (
    "target", "board", "marker", "tag", "apriltag", "charuco", "checkerboard", "chessboard", "object", "cal", "calib", "pattern",
    "artefact",
    "cam", "camera", "sensor", "scanner", "sphere", "ball", "tracker", "measured", "eye", "instrument",
)  # fmt: skip
CAMERAS, BASES = {"cam", "camera", "sensor", "scanner", "eye", "tracker", "instrument"}, {"base", "world"}  # that a pose is seen from
FILLERS = {
    "pos", "position", "trans", "translation", "pose", "orient", "orientation", "rot", "rotation", "quat", "quaternion",
    "t", "r", "p", "transform", "field",
}  # fmt: skip
STATISTICS = {"sigma", "std", "cov", "dir", "tau"}  # things whose x, y, z are no pose
TURNING = {"orient", "orientation", "rot", "rotation", "quat", "quaternion", "q"}
QUATERNION_WORDS = {"quat", "quaternion"}
PLACE_WORDS = {"t", "trans", "translation"}
EULERS = {
    ("a", "b", "c"): ("ZYX", "xyz"),  # KUKA first; Mitsubishi writes A, B, C for turns about x, y, z
    ("w", "p", "r"): ("xyz",),
    ("u", "v", "w"): ("ZYX", "vector"),
    ("o", "a", "t"): ("ZYZ",),
    ("rx", "ry", "rz"): ("vector", "xyz", "XYZ", "ZYX"),
    ("qx", "qy", "qz"): ("vector", "xyz", "XYZ", "ZYX"),  # rot_x, rot_y, rot_z without w
    ("roll", "pitch", "yaw"): ("xyz",),
}  # fmt: skip
RTDE_POSE = ("0", "1", "2", "3", "4", "5")  # actual_TCP_pose_0 ..
VECTORS = ("rvec", "rotvec", "axisangle", "rodrigues")
OPENCV = "tvec"  # the thing of OpenCV's tvec and rvec without a word before them: what a camera sees
AGAIN = "again"  # at the thing of components that a header names twice
METRES_BELOW, MILLIMETRES_ABOVE = 10.0, 50.0  # largest coordinate of a whole recording
RADIANS_BELOW = 6.3  # largest angle of a whole recording; a calibration turns by more than 6 deg
MOST_RADIANS = 12.6  # of an orientation: nobody writes more than two turns
CLOSED = 1e-3  # by which the last row of a matrix may differ from 0 0 0 1
_UNIT = re.compile(r"^(.*?)[\s_.]*[\[(<]?\s*(mm|cm|um|µm|μm|m|inch|in|degrees|degree|deg|°|radians|radian|rad)\s*[\])>]?$", re.IGNORECASE)
_SPLIT = re.compile(r"[\s_.\-/:\[\]]+")
_VECTOR = re.compile(rf"^({'|'.join((*VECTORS, OPENCV))})([xyz012])$")


@dataclass(frozen=True)
class Heading:
    """A column's name taken apart. thing: words before the component, '' for none; component: in small letters; unit: '' for none."""

    name: str
    thing: str
    component: str
    unit: str


@dataclass(frozen=True)
class PoseHeadings:
    """A pose, or a point where ``rotation`` is empty. thing: whose. translation, rotation: names of the columns; convention: of the
    orientation (``orientations``), '' for a point; alternatives: others that the headings allow. length: mm of a unit; angle: rad of a
    unit;
    None if headings do not say. closing: names of the last row of a 4 x 4 matrix, () where it is not there. inverted: whether the pose
    is of the base in the flange, or of the camera in the target; None if the name says either."""

    thing: str
    translation: tuple[str, ...]
    rotation: tuple[str, ...] = ()
    convention: str = ""
    alternatives: tuple[str, ...] = ()
    length: float | None = None
    angle: float | None = None
    closing: tuple[str, ...] = ()
    inverted: bool | None = False

    @property
    def names(self) -> tuple[str, ...]:
        return (*self.translation, *self.rotation)

    def upright(self, table: Table) -> PoseHeadings:
        """With the cells of a 4 x 4 matrix where they belong, whether the file has it row by row or column by column: its last row is
        0 0 0 1. Raises ConfigError if neither holds."""
        if not self.closing:
            return self
        rows, columns = (np.abs(table.numbers(names) - (0.0, 0.0, 0.0, 1.0)).max(axis=1) for names in (self.closing, self._last_column))
        if rows.max(initial=0.0) < CLOSED:
            return self
        if columns.max(initial=0.0) < CLOSED:
            R = np.array(self.rotation).reshape(3, 3).T.ravel()
            return replace(self, translation=self.closing[:3], rotation=tuple(R.tolist()), closing=self._last_column)
        row = int(np.argmax(rows if np.median(rows) < CLOSED else columns if np.median(columns) < CLOSED else rows > CLOSED))
        raise ConfigError(
            f"{table.where(row, self.closing[0])}: the last row of the matrix is not 0 0 0 1, nor its last column; "
            "correct the row, or the order of its numbers"
        )

    @property
    def _last_column(self) -> tuple[str, ...]:
        return (*self.translation, self.closing[3])

    def with_units(self, table: Table) -> PoseHeadings:
        """With units by the size of the numbers where headings do not say. Raises ConfigError if the numbers do not say either, and of
        radians that no orientation reaches."""
        length, angle = self.length, self.angle
        if length is None:
            length = _length_by_size(table, self.translation)
        largest = np.abs(table.numbers(self.rotation)).max(initial=0.0) if self._turns else 0.0
        if angle is None:
            angle = 1.0 if largest < RADIANS_BELOW else DEGREE
        if angle == 1.0 and largest > MOST_RADIANS:
            raise ConfigError(
                f"{table.at_headings}: {', '.join(self.rotation)} are said to be radians, and reach {largest:.0f}; if they are degrees, "
                "name them so (_deg)"
            )
        return replace(self, length=length, angle=angle)

    @property
    def _turns(self) -> bool:
        return bool(self.rotation) and self.convention not in ("matrix", *orientations.QUATERNIONS)

    def transforms(self, table: Table) -> np.ndarray:
        """T (rows, 4, 4) in mm. Raises ConfigError naming file, line and column."""
        known = self.with_units(table)
        xyz = table.numbers(known.translation) * known.length
        if not self.rotation:
            return se3.transform(np.eye(3), xyz)
        # Decimals of degrees come back bit for bit.
        exact = self._turns and known.angle == DEGREE
        values = (
            table.numbers(known.rotation, angle=True) if exact else table.numbers(known.rotation) * (known.angle if self._turns else 1.0)
        )
        try:
            T = se3.transform(orientations.to_matrices(values, self.convention), xyz)
            return se3.inverse(T) if self.inverted else T
        except ValueError as error:
            row = _first_fault(values, self.convention)
            raise ConfigError(f"{table.where(row, self.rotation[0])}: {error}; correct the orientation, or its convention") from None

    def coordinates(self, table: Table) -> np.ndarray:
        """(rows, 6) mm and rotation vectors in rad; numbers that are these already come back bit for bit."""
        if self.convention == "vector" and self.length == self.angle == 1.0 and not self.inverted:
            return table.numbers(self.names)
        return flange_coordinates(self.transforms(table))

    def described(self) -> str:
        """In words, for people."""
        unit = {1.0: "mm", 1e3: "m", 10.0: "cm", 1e-3: "um", 25.4: "inches"}.get(self.length or 0.0, "")
        text = f"{', '.join(self.translation)} in {unit}"
        if not self.rotation:
            return text
        turning = f" in {'rad' if self.angle == 1.0 else 'deg'}" if self._turns else ""
        inverted = ", inverted" if self.inverted else ""
        return f"{text}; {', '.join(self.rotation)}{turning} as {orientations.in_words(self.convention)}{inverted}"


def named_convention(word: str, what: str = "the convention") -> str:
    """The convention that a maker's name or a convention's word says. Raises ConfigError."""
    word = word.strip()
    found = orientations.MAKERS.get(word.lower(), word)
    if not orientations.is_convention(found):
        known = ", ".join(orientations.MAKERS)
        raise ConfigError(
            f"{what} '{word}' is not known; give a maker ({known}), three axes (ZYX turning along, xyz fixed), vector, wxyz, xyzw or matrix"
        )
    return found


def heading(name: str) -> Heading:
    """A column's name taken apart."""
    return _taken_apart(name) if len(name) <= KEPT_HEADING else _taken_apart.__wrapped__(name)


@lru_cache(maxsize=4096)  # a table's headings are asked for again by every question on its columns
def _taken_apart(name: str) -> Heading:
    text, unit = name.strip(), ""
    found = _UNIT.match(text)
    if found and found[1] and (found[1][-1] in " _.[(<" or text[len(found[1])] in " _.[(<" or found[2] == "°"):
        text, unit = found[1].strip(" _.[(<"), found[2].lower()
    words = [w for w in _SPLIT.split(text.replace("->", " ")) if w]
    words = [*words[:-1], *_apart(words[-1])] if words else [""]
    *before, last = [w.lower() for w in words]
    before = [w for w in before if w]
    if before and (last in FLANGE_WORDS or last in TARGET_WORDS) and re.fullmatch(r"[tp]?[xyz]|[qr][xyzw]", before[0]):
        before, last = [*before[1:], last], before[0]  # x_cam
    by_ros = before[:1] == ["field"]  # of a text log of ROS, whose lengths are in m
    if last in ("x", "y", "z", "w") and before and set(before) & TURNING:
        last = ("q" if set(before) & {"quat", "quaternion", "orientation", "orient", "q", "rotation", "rot"} else "r") + last
        before = [w for w in before if w != "q"]
    if last in ("0", "1", "2", "3") and set(before) & QUATERNION_WORDS:
        last = f"quat{last}"
    elif set(before) & PLACE_WORDS:
        last = _axis_of(last)
    if found := _VECTOR.match("".join(before[-1:]) + last):
        before, last = [w for w in before[:-1] if w != OPENCV], ("v" if found[1] in VECTORS else "") + _axis_of(found[2])
        before = before or [OPENCV]
    elif vector := set(before) & {*VECTORS, OPENCV}:
        before, last = [w for w in before if w not in vector] or [OPENCV], ("" if OPENCV in vector else "v") + _axis_of(last)
    last = {"tx": "x", "ty": "y", "tz": "z", "px": "x", "py": "y", "pz": "z", "posx": "x", "posy": "y", "posz": "z", "rw": "qw"}.get(
        last, last
    )
    return Heading(name, "_".join(w for w in before if w not in FILLERS), last, unit or ("m" if by_ros and last in ("x", "y", "z") else ""))


def _axis_of(text: str) -> str:
    """x, y, z, also of 0, 1, 2."""
    return {"0": "x", "1": "y", "2": "z"}.get(text, text)


def _apart(word: str) -> list[str]:
    """'robotX' as robot, X; other words whole."""
    found = re.match(r"^([a-z]{3,})([XYZ]|[RQ][xyzwXYZW])$", word)
    return [found[1], found[2]] if found else [word]


def pose_groups(names: Sequence[str]) -> list[PoseHeadings]:
    """The poses and points of a header, in the order of their first columns, each column in one of them.

    An orientation belongs to the place of its own thing, of several to that beside which it stands. Raises ConfigError for an orientation
    that may belong to several places.
    """
    by_thing: dict[str, dict[str, Heading]] = {}
    for part in map(heading, names):
        thing = part.thing
        while (there := by_thing.setdefault(thing, {}).get(part.component)) and there.unit == part.unit:
            thing = f"{thing}_{AGAIN}".strip("_")
        by_thing[thing].setdefault(part.component, part)
    if OPENCV in by_thing and "x" not in by_thing[OPENCV]:  # rvec of a place without tvec
        by_thing[""] = by_thing.pop(OPENCV) | by_thing.get("", {})
    found, points, turns = [], [], []
    for thing, parts in by_thing.items():
        if (whole := _of_matrix(thing, parts) or _of_rtde(thing, parts)) is not None:
            found.append(whole)
            continue
        if all(c in parts for c in "xyz"):
            xyz = tuple(parts[c] for c in "xyz")
            points.append(PoseHeadings(thing, tuple(p.name for p in xyz), length=_length_of(xyz)))
        turns += [(thing, *turn) for turn in _rotations(parts)]
    found += _with_orientations(points, turns, list(names))
    found = [replace(group, inverted=_inverted(group.thing)) if group.rotation else group for group in found]
    return sorted(found, key=lambda group: min(list(names).index(n) for n in group.names))


Turn = tuple[str, tuple[Heading, ...], tuple[str, ...]]  # thing, components and conventions of an orientation


def _with_orientations(points: list[PoseHeadings], turns: list[Turn], names: list[str]) -> list[PoseHeadings]:
    """The points with the orientations that are theirs."""
    out = {point.thing: point for point in points}
    left: list[Turn] = []
    for thing, point in list(out.items()):
        own = [turn for turn in turns if turn[0] == thing]
        if len(own) > 1:
            own.sort(key=lambda turn: not _beside(turn, point, names))
        out[thing] = _turned(point, own[0]) if own else point
        left += own[1:]
    left += [turn for turn in turns if turn[0] not in out]
    for turn in left:
        bare = [p for p in out.values() if not p.rotation and p.thing.split("_")[0] not in STATISTICS]
        near = [p for p in bare if _beside(turn, p, names)]
        if not bare or (not near and turn[0] in out):
            continue  # a second orientation of a whole pose is not used
        if len(near) != 1:
            raise ConfigError(
                f"the columns {', '.join(p.name for p in turn[1])} are an orientation, and nothing says whose; "
                "name them flange_.. or target_.., or say --column OURS=FILE"
            )
        out[near[0].thing] = _turned(near[0], turn)
    return list(out.values())


def _beside(turn: Turn, point: PoseHeadings, names: list[str]) -> bool:
    """Whether the columns of an orientation stand next to those of a place."""
    of_turn, of_point = (sorted(names.index(n) for n in some) for some in ([p.name for p in turn[1]], point.translation))
    return of_turn[0] == of_point[-1] + 1


def _turned(point: PoseHeadings, turn: Turn) -> PoseHeadings:
    _, parts, (first, *others) = turn
    angle = next((ANGLES[p.unit] for p in parts if p.unit in ANGLES), None)
    return replace(point, rotation=tuple(p.name for p in parts), convention=first, alternatives=tuple(others), angle=angle)


def _of_rtde(thing: str, parts: dict[str, Heading]) -> PoseHeadings | None:
    """A pose as UR controllers record it: m and a rotation vector."""
    if "tcp" not in thing.split("_") or not all(c in parts for c in RTDE_POSE):
        return None
    names = tuple(parts[c].name for c in RTDE_POSE)
    return PoseHeadings(thing, names[:3], names[3:], "vector", (), LENGTHS["m"], 1.0)


def _length_of(parts: Sequence[Heading]) -> float | None:
    return next((LENGTHS[p.unit] for p in parts if p.unit in LENGTHS), None)


def _rotations(parts: dict[str, Heading]) -> list[tuple[tuple[Heading, ...], tuple[str, ...]]]:
    """Components of each orientation and the conventions it may be in."""
    known: list[tuple[tuple[str, ...], tuple[str, ...]]] = [
        (quaternion, ("wxyz",))
        for quaternion in (("qw", "qx", "qy", "qz"), ("q1", "q2", "q3", "q4"), ("q0", "q1", "q2", "q3"))
        if not {"q5", "q6"} & set(parts)
    ]
    known += [(("quat0", "quat1", "quat2", "quat3"), ("xyzw", "wxyz")), (("vx", "vy", "vz"), ("vector",))]
    if "qw" in parts:  # robot_rx, robot_ry, robot_rz, robot_rw
        known.append((("qw", "rx", "ry", "rz"), ("wxyz",)))
    known += [*EULERS.items(), (_matrix_components(parts), ("matrix",))]
    found, taken = [], set()
    for components, conventions in known:
        if components and all(c in parts and c not in taken for c in components):
            found.append((tuple(parts[c] for c in components), conventions))
            taken |= set(components)
    return found


def _matrix_components(parts: dict[str, Heading]) -> tuple[str, ...]:
    """Nine components r11 .. r33, or r00 .. r22."""
    for letter, first in product(("r", "m", "t", ""), (1, 0)):
        nine = tuple(f"{letter}{i + first}{j + first}" for i in range(3) for j in range(3))
        if all(c in parts for c in nine):
            return nine
    return ()


def _of_matrix(thing: str, parts: dict[str, Heading]) -> PoseHeadings | None:
    """A 4 x 4 matrix: t11 .. t44, or t00 .. t33, of any letter, with its last row or without; or t0 .. t15, t1 .. t16."""
    letters = {m[1] for c in parts if (m := re.match(r"^([a-z]*?)\d+$", c))}
    for letter, first in product(sorted(letters), (1, 0)):
        grid = [[f"{letter}{i + first}{j + first}" for j in range(4)] for i in range(4)]
        flat = [[f"{letter}{4 * i + j + first}" for j in range(4)] for i in range(4)]
        for names in (grid, flat):
            column, nine = [row[3] for row in names[:3]], [c for row in names[:3] for c in row[:3]]
            whole = all(c in parts for c in names[3])
            if all(c in parts for c in (*column, *nine)) and (whole or names is grid):
                xyz = [parts[c] for c in column]
                return PoseHeadings(
                    thing,
                    tuple(p.name for p in xyz),
                    tuple(parts[c].name for c in nine),
                    "matrix",
                    length=_length_of(xyz),
                    closing=tuple(parts[c].name for c in names[3]) if whole else (),
                )
    return None


def role(group: PoseHeadings) -> str:
    """'flange' or 'target' by the words in a column's name, '' if it has none. If it names both, the last one counts (base2gripper,
    T_cam_board)."""
    words = re.split(r"_to_|[_2]", group.thing)
    known = [("flange" if w in FLANGE_WORDS else "target") for w in words if w in FLANGE_WORDS or w in TARGET_WORDS]
    return known[-1] if known else ""


def _inverted(thing: str) -> bool | None:
    """Whether a pose of two frames, by the order of their names, is of the frame that is usually seen from: flange_T_base, target_T_cam,
    base_in_flange. None of base2gripper and cam2target: in OpenCV these are inverted, to others they are not."""
    words = re.split(r"_to_|[_2]", thing)
    words = words[::-1] if {"in", "wrt"} & set(words) else words
    seen_from, of = ([i for i, w in enumerate(words) if w in some] for some in (CAMERAS | BASES, {*FLANGE_WORDS, *TARGET_WORDS} - CAMERAS))
    if not seen_from or not of or {"robot", "arm"} & set(words):
        return False
    direct = seen_from[-1] < of[-1]
    if "2" in thing or "_to_" in thing:
        return None if direct else False
    return not direct


def _length_by_size(table: Table, names: Sequence[str]) -> float:
    largest = float(np.abs(table.numbers(names)).max(initial=0.0))
    if largest < METRES_BELOW:
        return 1e3
    if largest > MILLIMETRES_ABOVE:
        return 1.0
    raise ConfigError(
        f"{table.path}:1: column {names[0]}: the largest coordinate is {largest:.4g}, which may be metres or millimetres; "
        f"write the unit into the heading ({names[0]}_mm or {names[0]}_m)"
    )


def _first_fault(values: np.ndarray, convention: str) -> int:
    for row in range(len(values)):
        try:
            orientations.to_matrices(values[row : row + 1], convention)
        except ValueError:
            return row
    return 0

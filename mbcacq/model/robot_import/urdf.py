"""An arm of a URDF or xacro file: the joints from a base link to a flange link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.model.bounds import refuse_beyond
from mbcacq.model.robot_import.kinematic_tree import TURNING, Arm, KinematicTree, TreeJoint
from mbcacq.model.robot_import.source import ArmSource
from mbcacq.model.robot_import.xacro_file import BEFORE_2014, STATEMENTS, expanded, macros
from mbcacq.model.xml_file import XmlFile
from mbcacq.quantities import in_degrees

WITHOUT_LIMITS = 1e3  # rad: limits beyond say that there are none
MOST_TURNS = 4 * np.pi  # rad: limits beyond, and within ``WITHOUT_LIMITS``, are degrees
FASTEST = 35.0  # rad/s: no axis of an arm turns at 2000 deg/s
LONGEST_ARM_MM, SHORTEST_ARM_MM = 50e3, 20.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Joint(TreeJoint):
    """origin: (4, 4) mm in the parent link; axis: (3,) unit; lower, upper, velocity: nan where absent; follows: joint of a <mimic>; offset:
    its position where that of the other is zero."""

    origin: np.ndarray
    axis: np.ndarray
    velocity: float
    offset: float


def read_urdf(
    path: Path, base: str | None, flange: str | None, packages: Mapping[str, Path] | None = None, arguments: Mapping[str, str] | None = None
) -> ArmSource:
    """Raises ConfigError for a file that describes no serial arm between the two links."""
    root = _root(path, packages or {}, arguments or {})
    found = [j for j in (_joint(e, path) for e in root.findall("joint")) if j is not None]
    tree, joints = _tree(path, root, found), {j.child: j for j in found}
    arm = tree.arm(base, flange)
    chain = [joints[j.child] for j in arm.joints]
    moving = [j for j in chain if j.is_axis]
    frames = _frames(arm, chain, np.zeros((1, len(moving))))
    at_joint = [frames[j.name][0] for j in moving]
    mass, com = _masses(path, root, joints, chain, frames)
    limits, about_limits = _limits(moving)
    speed, about_speed = _speed(moving)
    remarks = [*arm.remarks, *about_limits, *about_speed, *_roots(tree, root, chain), *_sizes(path, chain)]
    return ArmSource(
        name=str(root.get("name") or path.stem),
        base=arm.base,
        flange=arm.flange,
        joints=[j.name for j in moving],
        direction=np.array([T[:3, :3] @ j.axis for T, j in zip(at_joint, moving, strict=True)]),
        point=np.array([T[:3, 3] for T in at_joint]),
        T_base_flange=frames[chain[-1].name][0],
        limits=limits,
        speed=speed,
        mass=mass,
        com=com,
        forward=lambda q: _frames(arm, chain, q)[chain[-1].name],
        remarks=remarks,
        sliding=arm.sliding,
        follows=arm.follows,
    )


def _root(path: Path, packages: Mapping[str, Path], arguments: Mapping[str, str]) -> Element:
    data = _bytes(path)
    is_xacro = path.suffix == ".xacro" or b"<xacro:" in data
    root = XmlFile(expanded(path, packages, arguments) if is_xacro else data, path).root
    if root.tag != "robot":
        raise ConfigError(f"{path}: begins with <{root.tag}>, not with <robot> as a URDF does; give a .urdf, .xacro or MJCF file")
    if root.find("link") is None and (defined := macros(data)):
        raise ConfigError(f"{path}: defines macros only ({', '.join(defined)}); import the file that calls them")
    for old in STATEMENTS:
        if root.find(old) is not None:
            raise ConfigError(f"{path}: has <{old}> without 'xacro:', {BEFORE_2014}")
    return root


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: the robot description cannot be read ({error.strerror}); correct the path") from None


def _tree(path: Path, root: Element, joints: Sequence[Joint]) -> KinematicTree:
    links = {str(e.get("name")): e for e in root.findall("link")}
    shaped = {name for name, e in links.items() if e.find("visual") is not None or e.find("collision") is not None}
    named = [link for j in joints for link in (j.parent, j.child)]
    return KinematicTree((replace(j, bare=j.child not in shaped) for j in joints), [*links, *named], path)


def _roots(tree: KinematicTree, root: Element, chain: Sequence[Joint]) -> list[str]:
    """Sentences about what makes the links no single tree."""
    declared = {str(e.get("name")) for e in root.findall("link")}
    out = [f"the file names a link '{link}' and does not describe it" for link in tree.links if link not in declared]
    if len(tree.roots) > 1:
        own = (tree.chain(chain[0].child)[0]).parent
        others = ", ".join(f"'{link}'" for link in tree.roots if link != own)
        out.append(f"nothing connects the arm, which hangs on '{own}', with {others}")
    return out


def _joint(element: Element, path: Path) -> Joint | None:
    parent, child = element.find("parent"), element.find("child")
    if parent is None or child is None:
        return None  # of a transmission
    name, kind = str(element.get("name")), str(element.get("type"))
    origin, axis, limit = element.find("origin"), element.find("axis"), element.find("limit")
    mimic, unit = element.find("mimic"), 1e3 if kind == "prismatic" else 1.0

    def number(key: str, of: Element | None = limit, silent: float = np.nan) -> float:
        value = None if of is None else of.get(key)
        return silent if value is None else _numbers(value, 1, path, name)[0]

    xyz = _numbers("0 0 0" if origin is None else origin.get("xyz", "0 0 0"), 3, path, name)
    roll, pitch, yaw = _numbers("0 0 0" if origin is None else origin.get("rpy", "0 0 0"), 3, path, name)
    refuse_beyond("angle", in_degrees([roll, pitch, yaw]), f"{path}: rpy of joint '{name}' (deg)")
    direction = np.array([1.0, 0.0, 0.0])
    if kind != "fixed" and axis is not None:  # the axis of a fixed joint means nothing; exporters write 0 0 0
        direction = _numbers(axis.get("xyz", "1 0 0"), 3, path, name)
    length = np.linalg.norm(direction)
    if length < 1e-9:
        raise ConfigError(f"{path}: joint '{name}' has an axis of length zero; correct it")
    return Joint(
        name=name,
        kind=kind,
        parent=str(parent.get("link")),
        child=str(child.get("link")),
        origin=se3.from_abc(1e3 * xyz, np.array([yaw, pitch, roll])),
        axis=direction / length,
        lower=unit * number("lower"),
        upper=unit * number("upper"),
        velocity=unit * number("velocity"),
        follows="" if mimic is None else str(mimic.get("joint")),
        ratio=number("multiplier", mimic, 1.0),
        offset=unit * number("offset", mimic, 0.0),
    )


def _numbers(text: str, count: int, path: Path, name: str) -> np.ndarray:
    try:
        values = np.array([float(v) for v in text.split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all() or "_" in text:
        raise ConfigError(f"{path}: joint '{name}': '{text}' should be {count} number{'s' if count > 1 else ''}; is it a xacro file?")
    return values


def _limits(moving: Sequence[Joint]) -> tuple[np.ndarray, list[str]]:
    """(n, 2) rad, mm, nan where the file's cannot be meant, and sentences about those."""
    out, remarks = [], []
    for j in moving:
        low, high = j.lower, j.upper
        if j.kind not in TURNING:
            out.append((low, high))
            continue
        said = f"'{j.name}' has limits {low:g} {high:g}"
        if j.kind == "continuous" or min(abs(low), abs(high)) > WITHOUT_LIMITS:
            remarks.append(f"{j.name} turns without limits in the file; -360..360° is taken")
            low, high = -2 * np.pi, 2 * np.pi
        elif low == high:
            remarks.append(f"{said}, between which nothing moves; none are taken")
            low = high = np.nan
        elif max(abs(low), abs(high)) > MOST_TURNS:
            remarks.append(f"{said}, which look like degrees where a URDF has radians; none are taken")
            low = high = np.nan
        elif low > high:
            remarks.append(f"{said}, the larger first; they are taken in order")
            low, high = high, low
        out.append((low, high) if not np.isnan(low + high) else (np.nan, np.nan))
    return np.array(out), remarks


def _speed(moving: Sequence[Joint]) -> tuple[np.ndarray, list[str]]:
    """(n,) rad/s, mm/s, nan where the file's cannot be meant, and sentences about those."""
    speed = np.array([j.velocity for j in moving])
    fast = np.flatnonzero((speed > FASTEST) & [j.kind in TURNING for j in moving]).tolist()
    remarks = [
        f"'{moving[i].name}' has a speed of {speed[i]:g} rad/s, more than any axis turns; none is taken (--speed gives one for all)"
        for i in fast
    ]
    speed[fast] = np.nan
    return speed, remarks


def _sizes(path: Path, chain: Sequence[Joint]) -> list[str]:
    reach = sum(float(np.linalg.norm(j.origin[:3, 3])) for j in chain[1:])
    if reach > LONGEST_ARM_MM:
        raise ConfigError(f"{path}: its links are {reach / 1e3:.0f} m long together, which looks like mm; a URDF has lengths in m")
    if reach < SHORTEST_ARM_MM:
        return [f"its links are {reach:.3g} mm long together; a URDF has lengths in m"]
    return []


def _frames(arm: Arm, chain: list[Joint], q: np.ndarray) -> dict[str, np.ndarray]:
    """Per joint the frame (P, 4, 4) of its child link in the base, q (P, n) rad, mm."""
    T, out, number = np.broadcast_to(np.eye(4), (len(q), 4, 4)), {}, 0
    leader = {follower: (of, ratio) for follower, of, ratio in arm.follows}
    for joint in chain:
        T = T @ joint.origin
        if joint.is_axis:
            of, ratio = leader.get(number, (number, 0.0))
            along = (joint.offset + q[:, number] + ratio * q[:, of])[:, None] * joint.axis
            turns = joint.kind in TURNING
            T = T @ (se3.transform(se3.rotation_exp(along), np.zeros(3)) if turns else se3.transform(np.eye(3), along))
            number += 1
        out[joint.name] = T
    return out


def _masses(
    path: Path, root: Element, joints: dict[str, Joint], chain: list[Joint], frames: dict[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Mass (n,) and centre of gravity (n, 3), base frame at zero, of each moving link with what is fixed to it."""
    own = {str(e.get("name")): e.find("inertial") for e in root.findall("link")}
    below: dict[str, list[Joint]] = {}
    for joint in joints.values():
        below.setdefault(joint.parent, []).append(joint)
    mass, com = [], []
    for joint in chain:
        if not joint.is_axis:
            continue
        parts, stack = [], [(joint.child, frames[joint.name][0])]
        while stack:
            link, T = stack.pop()
            if (found := _inertial(own.get(link), path, link)) is not None:
                parts.append((found[0], se3.apply(T, found[1])))
            stack += [(j.child, T @ j.origin) for j in below.get(link, ()) if j.kind == "fixed"]
        total = sum(m for m, _ in parts)
        mass.append(total)
        com.append(sum((m * c for m, c in parts), np.zeros(3)) / total if total > 0 else frames[joint.name][0][:3, 3])
    return np.array(mass), np.array(com)


def _inertial(element: Element | None, path: Path, link: str) -> tuple[float, np.ndarray] | None:
    """kg, and mm in the link's frame."""
    if element is None or (weight := element.find("mass")) is None:
        return None
    origin = element.find("origin")
    xyz = _numbers("0 0 0" if origin is None else origin.get("xyz", "0 0 0"), 3, path, f"inertial of {link}")
    if (mass := float(_numbers(weight.get("value", "0"), 1, path, f"inertial of {link}")[0])) < 0:
        raise ConfigError(f"{path}: link '{link}' has a mass of {mass:g} kg; correct it")
    return mass, 1e3 * xyz

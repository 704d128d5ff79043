"""An arm of a URDF or xacro file: the revolute joints from a base link to a flange link."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.geometry import se3
from mbcacq.model.robot_import.source import ArmSource
from mbcacq.model.xml_file import XmlFile

FLANGES = ("flange", "tool0", "tool_flange", "ee_link", "link_ee")  # usual names, the best first
MOVING = ("revolute", "continuous")


@dataclass(frozen=True)
class Joint:
    """origin: (4, 4) mm in the parent link; axis: (3,) unit; lower, upper, velocity: nan where absent."""

    name: str
    kind: str
    parent: str
    child: str
    origin: np.ndarray
    axis: np.ndarray
    lower: float
    upper: float
    velocity: float


def read_urdf(path: Path, base: str | None, flange: str | None) -> ArmSource:
    """Raises ConfigError for a file that describes no serial arm of revolute joints between the two links."""
    root = _root(path)
    joints = {j.child: j for j in (_joint(e, path) for e in root.findall("joint")) if j is not None}
    links = [str(e.get("name")) for e in root.findall("link")]
    chain = _chain(path, joints, links, base, flange)
    moving = [j for j in chain if j.kind in MOVING]
    first, last = chain[0].parent, chain[-1].child
    remarks = [f"{j.name} turns without limits in the file; -360..360 deg is taken" for j in moving if j.kind == "continuous"]
    frames = _frames(chain, np.zeros((1, len(moving))))
    at_joint = [frames[j.name][0] for j in moving]
    mass, com = _masses(path, root, joints, chain, frames)
    limits = np.array([[-2 * np.pi, 2 * np.pi] if j.kind == "continuous" else [j.lower, j.upper] for j in moving])
    return ArmSource(
        name=str(root.get("name") or path.stem),
        base=first,
        flange=last,
        joints=[j.name for j in moving],
        direction=np.array([T[:3, :3] @ j.axis for T, j in zip(at_joint, moving, strict=True)]),
        point=np.array([T[:3, 3] for T in at_joint]),
        T_base_flange=frames[chain[-1].name][0],
        limits=limits,
        speed=np.array([j.velocity for j in moving]),
        mass=mass,
        com=com,
        forward=lambda q: _frames(chain, q)[chain[-1].name],
        remarks=remarks,
    )


def _root(path: Path) -> Element:
    root = XmlFile(_expanded(path) if path.suffix == ".xacro" else _bytes(path), path).root
    if root.tag != "robot":
        raise ConfigError(f"{path}: begins with <{root.tag}>, not with <robot> as a URDF does; give a .urdf, .xacro or MJCF file")
    return root


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: the robot description cannot be read ({error.strerror}); correct the path") from None


def _expanded(path: Path) -> bytes:
    _bytes(path)
    try:
        xacro: Any = import_module("xacro")
    except ImportError:
        raise ConfigError(
            f"{path}: xacro is not installed; run `xacro {path.name} > {path.stem.removesuffix('.urdf')}.urdf` where ROS is "
            "and import that, or pip install 'mbcacq[xacro]'"
        ) from None
    try:
        return xacro.process_file(str(path)).toxml().encode("utf-8")
    except Exception as error:  # xacro raises many kinds, also those of the expressions in the file
        raise ConfigError(f"{path}: xacro cannot expand it: {error}; expand it where its packages are installed") from None


def _joint(element: Element, path: Path) -> Joint | None:
    parent, child = element.find("parent"), element.find("child")
    if parent is None or child is None:
        return None  # of a transmission
    name = str(element.get("name"))
    origin, axis, limit = element.find("origin"), element.find("axis"), element.find("limit")

    def number(key: str) -> float:
        value = None if limit is None else limit.get(key)
        return np.nan if value is None else _numbers(value, 1, path, name)[0]

    xyz = _numbers("0 0 0" if origin is None else origin.get("xyz", "0 0 0"), 3, path, name)
    roll, pitch, yaw = _numbers("0 0 0" if origin is None else origin.get("rpy", "0 0 0"), 3, path, name)
    direction = _numbers("1 0 0" if axis is None else axis.get("xyz", "1 0 0"), 3, path, name)
    length = np.linalg.norm(direction)
    if length < 1e-9:
        raise ConfigError(f"{path}: joint '{name}' has an axis of length zero; correct it")
    return Joint(
        name,
        str(element.get("type")),
        str(parent.get("link")),
        str(child.get("link")),
        se3.from_abc(1e3 * xyz, np.array([yaw, pitch, roll])),
        direction / length,
        number("lower"),
        number("upper"),
        number("velocity"),
    )


def _numbers(text: str, count: int, path: Path, name: str) -> np.ndarray:
    try:
        values = np.array([float(v) for v in text.split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all():
        raise ConfigError(f"{path}: joint '{name}': '{text}' should be {count} number{'s' if count > 1 else ''}; is it a xacro file?")
    return values


def _chain(path: Path, joints: dict[str, Joint], links: list[str], base: str | None, flange: str | None) -> list[Joint]:
    """The joints from the base link to the flange link."""
    for link, role in ((base, "base"), (flange, "flange")):
        if link is not None and link not in links:
            raise ConfigError(f"{path}: has no link '{link}' for the {role}; its links are {', '.join(links)}")
    tip = flange or _usual_flange(path, joints, links)
    chain: list[Joint] = []
    link = tip
    while link in joints and link != base:
        chain.insert(0, joints[link])
        link = joints[link].parent
        if len(chain) > len(joints):
            raise ConfigError(f"{path}: its joints run in a circle; correct the file")
    if base is not None and link != base:
        raise ConfigError(f"{path}: no joints lead from link '{base}' to link '{tip}'; name others with --base and --flange")
    if base is None:  # what holds the arm in the world is none of it
        while chain and chain[0].kind == "fixed":
            chain.pop(0)
    odd = [j for j in chain if j.kind not in (*MOVING, "fixed")]
    if odd:
        raise ConfigError(
            f"{path}: joint '{odd[0].name}' is {odd[0].kind}; an arm of revolute joints is needed, name its --base and --flange"
        )
    if sum(j.kind in MOVING for j in chain) < 2:
        raise ConfigError(f"{path}: fewer than two moving joints lead to link '{tip}'; name the arm's last link with --flange")
    return chain


def _usual_flange(path: Path, joints: dict[str, Joint], links: list[str]) -> str:
    """The link that is called like a flange, or the last that moves."""
    for name in FLANGES:
        found = [link for link in links if link == name or link.endswith(("_" + name, "-" + name))]
        if len(found) == 1 and found[0] in joints:
            return found[0]
    moving = {child: j for child, j in joints.items() if j.kind in MOVING}
    above: set[str] = set()
    for joint in moving.values():
        link = joint.parent
        while link not in above:
            above.add(link)
            if link not in joints:
                break
            link = joints[link].parent
    ends = [child for child in moving if child not in above]
    if len(ends) != 1:
        raise ConfigError(f"{path}: {len(ends)} chains of joints end in {', '.join(ends)}; name the arm's flange with --flange")
    return ends[0]


def _frames(chain: list[Joint], q: np.ndarray) -> dict[str, np.ndarray]:
    """Per joint the frame (P, 4, 4) of its child link in the base, q (P, n) rad."""
    T, out, number = np.broadcast_to(np.eye(4), (len(q), 4, 4)), {}, 0
    for joint in chain:
        T = T @ joint.origin
        if joint.kind in MOVING:
            T = T @ se3.transform(se3.rotation_exp(q[:, number, None] * joint.axis), np.zeros(3))
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
        if joint.kind not in MOVING:
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
    return float(_numbers(weight.get("value", "0"), 1, path, f"inertial of {link}")[0]), 1e3 * xyz

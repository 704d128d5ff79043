"""Where a server keeps what a calibration needs: the nodes of OPC 40010-1 (OPC UA for Robotics, part 1), found by their browse names.

DeviceSet holds a motion device system, that holds motion devices with their axes and loads, controllers, and safety states.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from asyncua import ua
from asyncua.client.client import Client
from asyncua.common.node import Node
from asyncua.ua.object_ids import ObjectIds

ROBOTICS, DEVICES = "http://opcfoundation.org/UA/Robotics/", "http://opcfoundation.org/UA/DI/"
ROTARY = {0, 1, 2}  # AxisMotionProfileEnumeration: OTHER, ROTARY, ROTARY_ENDLESS; 3 and 4 are linear
DEGREE, RADIAN = 17476, 4405297  # UnitId: the characters of UNECE's codes DD and C81 as numbers
UNITS = {DEGREE: "deg", RADIAN: "rad"}


class NoSuchRobot(Exception):
    """The server has no robot as it was asked for; the text is a predicate with what to do."""


@dataclass
class RobotNodes:
    """names: browse names of the axes; units: of each, 'deg', 'rad' or what the server states instead, '' if it states none; about: what
    it says of itself; safety: nodes of emergency and protective stop, by name; watched: model, serial number and payload, as far as
    it has them."""

    names: tuple[str, ...]
    positions: list[Node]
    units: tuple[str, ...]
    about: dict[str, str] = field(default_factory=dict)
    payload_kg: float | None = None
    safety: Mapping[str, Node] = field(default_factory=dict)
    watched: dict[str, Node] = field(default_factory=dict)


async def find_robot(client: Client, axes: int, device: str | None, wanted: tuple[str, ...] | None) -> RobotNodes:
    """The nodes of the motion device with ``axes`` rotary axes, or with those that are ``wanted`` by name. Raises NoSuchRobot."""
    spaces = await client.get_namespace_array()
    if ROBOTICS not in spaces:
        raise NoSuchRobot("does not serve the nodes of OPC UA Robotics; is that option installed and licensed on the controller?")
    robotics, di = spaces.index(ROBOTICS), spaces.index(DEVICES) if DEVICES in spaces else -1
    systems = [s for top in (await _children(client.nodes.objects)).values() for s in await _systems(top, robotics)]
    devices: dict[str, tuple[Node, Node]] = {}
    for system in systems:
        found = await _child(system, f"{robotics}:MotionDevices")
        if found is not None:
            devices |= {name: (node, system) for name, node in (await _children(found)).items()}
    if device is not None:
        if device not in devices:
            raise NoSuchRobot(f"has no motion device '{device}' (it has: {_list(devices)}); correct the option arm")
        devices = {device: devices[device]}
    seen: dict[str, list[str]] = {}
    fitting: dict[str, tuple[Node, Node, dict[str, Node]]] = {}
    for name, (node, system) in devices.items():
        chosen = await _axes(node, robotics, wanted)
        seen[name] = list(chosen)
        if len(chosen) == axes:
            fitting[name] = node, system, chosen
    if len(fitting) != 1:
        raise NoSuchRobot(_which(seen, fitting, axes, wanted))
    node, system, chosen = next(iter(fitting.values()))
    return await _robot(node, system, chosen, robotics, di)


def _which(seen: Mapping[str, list[str]], fitting: Mapping[str, Any], axes: int, wanted: tuple[str, ...] | None) -> str:
    if fitting:
        return f"has several motion devices with {axes} axes ({_list(fitting)}); name one in the option arm"
    has = "; ".join(f"{name}: {_list(names)}" for name, names in seen.items()) or "none"
    asked = f"the axes {_list(wanted)}" if wanted else f"{axes} rotary axes"
    return f"has no motion device with {asked} (it has {has}); correct the robot file, or name the axes in the option axes"


async def _systems(top: Node, robotics: int) -> list[Node]:
    """The motion device systems below an object; what is no object has none."""
    return [node for node in (await _children(top)).values() if await _child(node, f"{robotics}:MotionDevices") is not None]


async def _axes(device: Node, robotics: int, wanted: tuple[str, ...] | None) -> dict[str, Node]:
    folder = await _child(device, f"{robotics}:Axes")
    found = {} if folder is None else await _children(folder)
    if wanted is not None:
        return {name: found[name] for name in wanted if name in found}
    rotary = {}
    for name in sorted(found, key=_in_order):
        profile = await _value(found[name], f"{robotics}:MotionProfile")
        if profile is None or int(profile) in ROTARY:
            rotary[name] = found[name]
    return rotary


def _in_order(name: str) -> list[Any]:
    """Axis_10 behind Axis_9."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", name)]


async def _robot(device: Node, system: Node, axes: Mapping[str, Node], robotics: int, di: int) -> RobotNodes:
    positions, units = [], []
    for name, axis in axes.items():
        node = await _child(axis, f"{di}:ParameterSet", f"{robotics}:ActualPosition")
        if node is None:
            raise NoSuchRobot(f"has an axis '{name}' without ActualPosition; ask its maker, or name other axes in the option axes")
        positions.append(node)
        unit = await _value(node, "0:EngineeringUnits")
        units.append(UNITS.get(getattr(unit, "UnitId", -1)) or text_of(getattr(unit, "DisplayName", None)))
    about = {what: text for what in ("Manufacturer", "Model", "SerialNumber") if (text := text_of(await _value(device, f"{di}:{what}")))}
    mass = await _value(device, f"{robotics}:FlangeLoad", f"{robotics}:Mass")
    found = RobotNodes(tuple(axes), positions, tuple(units), about, None if mass is None else float(mass))
    for what in ("Model", "SerialNumber"):
        if (node := await _child(device, f"{di}:{what}")) is not None:
            found.watched[what] = node
    if (node := await _child(device, f"{robotics}:FlangeLoad", f"{robotics}:Mass")) is not None:
        found.watched["payload"] = node
    await _read_controller(found, system, robotics, di)
    return found


async def _read_controller(found: RobotNodes, system: Node, robotics: int, di: int) -> None:
    """Fill in what the system says of its controller and its safety."""
    controllers = await _child(system, f"{robotics}:Controllers")
    for controller in [] if controllers is None else (await _children(controllers)).values():
        software = await _child(controller, f"{robotics}:Software")
        for part in [] if software is None else (await _children(software)).values():
            if revision := text_of(await _value(part, f"{di}:SoftwareRevision")):
                found.about.setdefault("Software", revision)
    states = await _child(system, f"{robotics}:SafetyStates")
    safety = {}
    for state in [] if states is None else (await _children(states)).values():
        for what in ("OperationalMode", "EmergencyStop", "ProtectiveStop"):
            if (node := await _child(state, f"{di}:ParameterSet", f"{robotics}:{what}")) is not None:
                safety[what] = node
    found.safety = safety


async def _children(node: Node) -> dict[str, Node]:
    """The components of a node by their browse names."""
    described = await node.get_children_descriptions(refs=ObjectIds.HierarchicalReferences)
    return {d.BrowseName.Name: Node(node.session, d.NodeId) for d in described if d.NodeClass == ua.NodeClass.Object}


async def _child(node: Node, *path: str) -> Node | None:
    try:
        return await node.get_child(list(path))
    except ua.UaStatusCodeError:
        return None


async def _value(node: Node, *path: str) -> Any:
    """A value below a node, or None if it has none, or none that is good."""
    found = await _child(node, *path)
    try:
        return None if found is None else await found.read_value()
    except ua.UaStatusCodeError:
        return None


def text_of(value: Any) -> str:
    """A string or a localised text."""
    return str(getattr(value, "Text", value) or "").strip()


def _list(names: Any) -> str:
    return ", ".join(names) or "none"

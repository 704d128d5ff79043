"""The nodes of one arm as OPC 40010-1 arranges them; written without a look at the driver that reads them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from asyncua import ua
from asyncua.common.node import Node
from asyncua.server.server import Server

ROBOTICS, DI = "http://opcfoundation.org/UA/Robotics/", "http://opcfoundation.org/UA/DI/"
CODES = {
    "deg": ("DD", "°"),
    "rad": ("C81", "rad"),
    "gon": ("A91", "gon"),
    "kg": ("KGM", "kg"),
}  # UNECE recommendation 20, and what is shown


@dataclass(frozen=True)
class ArmNodes:
    """What the server is made of. profiles: AxisMotionProfileEnumeration of each axis, 1 rotary, 3 linear; unit: of the angles, or None."""

    model: str = "KR 10 R1100-2"
    manufacturer: str = "KUKA"
    serial: str = "4711"
    software: str = "8.6.11"
    names: tuple[str, ...] = ("Axis_1", "Axis_2", "Axis_3", "Axis_4", "Axis_5", "Axis_6")
    profiles: tuple[int, ...] = (1,) * 6
    unit: str | None = "deg"
    payload_kg: float | None = 2.3
    values: dict[str, Node] = field(default_factory=dict, compare=False)


def unit(code: str) -> ua.EUInformation:
    """A unit by its UNECE code: UnitId is the code's characters as one number, base 256."""
    text, shown = CODES[code]
    return ua.EUInformation(
        NamespaceUri="http://www.opcfoundation.org/UA/units/un/cefact",
        UnitId=int.from_bytes(text.encode(), "big"),
        DisplayName=ua.LocalizedText(shown),
        Description=ua.LocalizedText(code),
    )


def node_id(path: str, space: int) -> ua.NodeId:
    """A node by its name in a namespace."""
    return ua.NodeId(ua.String(path), ua.Int16(space))


async def build(server: Server, arm: ArmNodes) -> list[Node]:
    """Adds the nodes; returns those of the axes' positions. ``arm.values`` gets the others that change."""
    robotics, di = await server.register_namespace(ROBOTICS), await server.register_namespace(DI)
    device_set = await server.nodes.objects.add_object(node_id("DeviceSet", di), ua.QualifiedName("DeviceSet", di))

    async def obj(parent: Node, name: str, space: int = robotics) -> Node:
        path = f"{parent.nodeid.Identifier}.{name}"
        return await parent.add_object(node_id(path, space), ua.QualifiedName(name, space))

    async def var(parent: Node, name: str, value: Any, space: int = robotics, eu: str | None = None) -> Node:
        path = f"{parent.nodeid.Identifier}.{name}"
        node = await parent.add_variable(node_id(path, space), ua.QualifiedName(name, space), value)
        if eu is not None:
            await node.add_property(node_id(f"{path}.EngineeringUnits", space), ua.QualifiedName("EngineeringUnits", 0), unit(eu))
        return node

    system = await obj(device_set, "MotionDeviceSystem")
    device = await obj(await obj(system, "MotionDevices"), "MotionDevice_1")
    for name, text in (("Manufacturer", ua.LocalizedText(arm.manufacturer)), ("Model", ua.LocalizedText(arm.model))):
        arm.values[name] = await var(device, name, text, di)
    arm.values["SerialNumber"] = await var(device, "SerialNumber", arm.serial, di)
    if arm.payload_kg is not None:
        arm.values["Mass"] = await var(await obj(device, "FlangeLoad"), "Mass", float(arm.payload_kg), eu="kg")
    positions = await _axes(arm, await obj(device, "Axes"), obj, var, di)
    controller = await obj(await obj(system, "Controllers"), "Controller_1")
    await var(await obj(await obj(controller, "Software"), "Software_1"), "SoftwareRevision", arm.software, di)
    safety = await obj(await obj(await obj(system, "SafetyStates"), "SafetyState_1"), "ParameterSet", di)
    for name, value in (("OperationalMode", 1), ("EmergencyStop", False), ("ProtectiveStop", False)):
        arm.values[name] = await var(safety, name, value)
    return positions


async def _axes(arm: ArmNodes, folder: Node, obj: Any, var: Any, di: int) -> list[Node]:
    positions = []
    for name, profile in zip(arm.names, arm.profiles, strict=True):
        axis = await obj(folder, name)
        await var(axis, "MotionProfile", int(profile))
        node = await var(await obj(axis, "ParameterSet", di), "ActualPosition", 0.0, eu=arm.unit if profile < 3 else None)
        await node.set_writable()  # a client that wrote would be caught by its value
        positions.append(node)
    return positions


def served(angles_deg: Sequence[float], arm: ArmNodes) -> list[float]:
    """The values of the rotary axes in the server's unit; 0 for linear ones."""
    turned = iter(angles_deg)
    factor = 3.141592653589793 / 180.0 if arm.unit == "rad" else 1.0
    return [next(turned, 0.0) * factor if profile < 3 else 0.0 for profile in arm.profiles]

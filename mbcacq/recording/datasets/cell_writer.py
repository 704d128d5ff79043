"""A cell as ``cell.yaml``, without losing a bit."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq.files import angles
from mbcacq.model.cell import Artefact, Cell, RobotModel, Station
from mbcacq.model.cell_schema import QUANTITIES, joint_key
from mbcacq.model.yaml12 import Flow, FlowList, dump
from mbcacq.quantities import from_degrees, in_degrees

FORMAT = "mbcacq-observation-set/1"


def cell_to_yaml(cell: Cell) -> str:
    """``cell.yaml`` of an observation set; reading it gives every float of ``cell`` back, bit for bit.

    The one exception: an angle that no float64 in deg converts to becomes its nearest neighbour (never one that was read from a file).
    """
    data: dict[str, Any] = {"format": FORMAT, "measurement": cell.measurement} | _simulated(cell.simulated) | _arm(cell.robot)
    data["hand_eye"] = _frame(cell.T_flange_scanner)
    data["artefacts"] = [_artefact(a) for a in cell.artefacts]
    data["stations"] = [_station(s) for s in cell.stations]
    scanner: dict[str, Any] = {"name": cell.scanner_name}
    if cell.noise_mm is not None:
        scanner["noise_mm"] = _list(cell.noise_mm)
    if cell.length_scale is not None:
        scanner["length_scale"] = float(cell.length_scale)
    if cell.noise_rad is not None:
        scanner["noise_deg"] = _degrees(np.array([cell.noise_rad]))[0]
    data["scanner"] = scanner
    if cell.room_temperature_C is not None:
        data["room_temperature_C"] = FlowList(float(T) for T in cell.room_temperature_C)
    return _dump(data)


def robot_to_yaml(form: str, robot: RobotModel, simulated: bool = False) -> str:
    """A ``cell.yaml`` that holds only the robot, such as a trajectory set's."""
    return _dump({"format": form} | _simulated(simulated) | {"robot": _robot(robot)})


def artefact_to_yaml(artefact: Artefact) -> str:
    """An artefact file, as the plans and the ``artefacts`` of a cell have it."""
    return _dump(_artefact(artefact))


def _simulated(simulated: bool) -> dict[str, Any]:
    """The key of simulated data; measured data carry none."""
    return {"simulated": True} if simulated else {}


def _dump(data: dict[str, Any]) -> str:
    return dump(data, allow_unicode=True, width=160)


def _arm(robot: RobotModel) -> dict[str, Any]:
    """The robot, or what is known of an arm of which only the poses of the flange are."""
    if not robot.of_flange_poses:
        return {"robot": _robot(robot)}
    said = {} if robot.repeatability_mm is None else {"repeatability_mm": float(robot.repeatability_mm)}
    return {"flange_poses": {"robot": robot.name, **said}}


def _robot(robot: RobotModel) -> dict[str, Any]:
    chain, n = robot.chain, robot.n
    kind = ["prismatic" if slides else "revolute" for slides in chain.prismatic]
    columns: dict[str, list[Any]] = {
        "sign": [int(s) for s in chain.sign],
        "theta_deg": _degrees(chain.theta),
        "d_mm": _list(chain.d),
        "a_mm": _list(chain.a),
        "alpha_deg": _degrees(chain.alpha),
        "beta_deg": _degrees(chain.beta),
        "limits": [_degrees(row) if k == "revolute" else _list(row) for row, k in zip(robot.limits, kind, strict=True)],
        "mass_kg": _list(robot.mass),
        "com_mm": [_list(row) for row in robot.com],
    }
    for name in ("speed", "acceleration", "jerk"):
        if (values := getattr(robot, name)) is not None:
            columns[name] = np.where(chain.prismatic, values, angles.degrees(values)[0]).tolist()
    if robot.gear_ratio is not None:
        columns["gear_ratio"] = _list(robot.gear_ratio)
    data: dict[str, Any] = {"name": robot.name}
    if robot.repeatability_mm is not None:
        data["repeatability_mm"] = float(robot.repeatability_mm)
    if robot.balancer is not None:
        data["balancer"] = robot.balancer
    data["links"] = [
        Flow(
            _kind_of_joint(robot, i)
            | {joint_key(k, kind[i]) if k in QUANTITIES else k: v[i] for k, v in columns.items()}
            | ({} if robot.drive(i) is None else {"drive": robot.drive(i)})
        )
        for i in range(n)
    ]
    if chain.root is not None:
        data["base_to_first_axis"] = _frame(chain.root)
    data["payload"] = Flow({"mass_kg": float(robot.payload_mass), "com_mm": _list(robot.payload_com)})
    data["base_to_gravity"] = _list(robot.gravity)
    return data


def _kind_of_joint(robot: RobotModel, i: int) -> dict[str, Any]:
    """What is not as of the revolute joints of an arm."""
    out = {"type": "prismatic"} if robot.chain.prismatic[i] else {}
    named: dict[str, Any] = {"name": robot.names[i]} if robot.names else {}
    for joint, leader, ratio in robot.chain.follows:
        if joint == i:
            slides = robot.chain.prismatic
            unit = 1.0 if slides[i] == slides[leader] else (in_degrees(1.0) if slides[leader] else from_degrees(1.0))
            named["follows"] = Flow({"link": leader + 1, "ratio": float(ratio * unit)})
    return out | named | ({"carries": "artefact"} if i < robot.chain.floor else {})


def _artefact(artefact: Artefact) -> dict[str, Any]:
    data: dict[str, Any] = {"id": artefact.id, "name": artefact.name, "reference_temperature_C": float(artefact.reference_temperature_C)}
    if artefact.expansion_ppm_per_K is not None:
        data["expansion_ppm_per_K"] = float(artefact.expansion_ppm_per_K)
    data["uncertainty_mm"] = float(artefact.uncertainty_mm)
    if not artefact.certified:
        data["certified"] = False
    if (known := artefact.known_length) is not None:
        data["known_length"] = Flow(
            {"balls": FlowList(known.balls), "length_mm": float(known.length_mm), "uncertainty_mm": float(known.uncertainty_mm)}
        )
    if artefact.box is not None:
        return data | {"box_mm": [_list(corner) for corner in artefact.box]}
    data["balls"] = [
        Flow({"id": int(ball), **({} if np.isnan(centre).any() else {"centre_mm": _list(centre)}), "diameter_mm": float(diameter)})
        for ball, centre, diameter in zip(artefact.ball_ids, artefact.centres, artefact.diameters, strict=True)
    ]
    return data


def _station(station: Station) -> dict[str, Any]:
    name: str | int = station.id
    if name.lstrip("-").isdecimal() and str(int(name)) == name:
        name = int(name)
    data = Flow({"id": name, "artefact": station.artefact})
    if station.T_base_station is not None:
        data["pose_in_base"] = _frame(station.T_base_station)
        if station.sigma_mm is not None:
            data["pose_in_base"]["sigma_mm"] = float(station.sigma_mm)
    return data


def _frame(T: np.ndarray) -> dict[str, Any]:
    return {"rotation": [_list(row) for row in T[:3, :3]], "translation_mm": _list(T[:3, 3])}


def _list(values: np.ndarray) -> list[float]:
    return FlowList(np.asarray(values, dtype=float).tolist())


def _degrees(values: np.ndarray) -> list[float]:
    return FlowList(angles.degrees(values)[0].tolist())

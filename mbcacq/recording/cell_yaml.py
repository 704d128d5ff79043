"""``cell.yaml`` in and out: checked with file and line on the way in, without losing a bit on the way out."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml
from pydantic import BaseModel, ValidationError

from mbcacq.cell import Artefact, Cell, RobotModel, Station
from mbcacq.cellfile import CellSpec
from mbcacq.errors import ConfigError
from mbcacq.recording import angles

FORMAT = "mbcacq-observation-set/1"
MAX_BYTES = 16 << 20
Spec = TypeVar("Spec", bound=BaseModel)
_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def read_cell(path: Path) -> tuple[Cell, str]:
    """A cell and the text it was read from. Raises ConfigError with file and line."""
    text = read_yaml_text(path)
    return parse_cell(text, str(path)), text


def parse_cell(text: str, name: str = "cell.yaml") -> Cell:
    """A cell from YAML text; ``name`` is what messages call it."""
    data, node = load_yaml(text, name)
    spec = validate(CellSpec, data, node, name)
    _check_references(spec, node, name)
    return spec.model()


def read_yaml_text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{path}: larger than {MAX_BYTES >> 20} MiB; this is no cell description")
        return path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}; check the path") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not UTF-8 text; save the file as UTF-8") from None


def load_yaml(text: str, name: str) -> tuple[dict[str, Any], yaml.Node]:
    """The mapping in a YAML text, and its node tree for line numbers. Raises ConfigError."""
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        data = loader.construct_document(node) if node is not None else None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = mark.line + 1 if mark else 1
        raise ConfigError(f"{name}:{line}: not valid YAML ({getattr(error, 'problem', None) or 'unreadable'}); correct the line") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{name}:1: not valid YAML ({error}); correct it") from None
    finally:
        loader.dispose()
    if not isinstance(data, dict):
        raise ConfigError(f"{name}:1: a mapping of keys is expected (format, robot, ...), found {type(data).__name__}; correct the file")
    return data, node


def validate(model: type[Spec], data: dict[str, Any], node: yaml.Node, name: str) -> Spec:
    """The data checked against a pydantic model; the first fault becomes a ConfigError with its line."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        more = f" ({error.error_count() - 1} more)" if error.error_count() > 1 else ""
        raise ConfigError(f"{name}:{line_of(node, first['loc'])}: {place}: {first['msg']}{more}; correct it") from None


def line_of(node: yaml.Node, path: tuple[int | str, ...]) -> int:
    """Line (from 1) of the node at a path of keys and indices, or of its nearest parent that exists."""
    line = node.start_mark.line + 1
    for part in path:
        child = None
        if isinstance(node, yaml.MappingNode):
            child = next(((key, value) for key, value in node.value if key.value == str(part)), None)
            if child is not None:
                line, node = child[0].start_mark.line + 1, child[1]
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            child = node = node.value[part]
            line = node.start_mark.line + 1
        if child is None:
            break
    return line


def _check_references(spec: CellSpec, node: yaml.Node, name: str) -> None:
    def refuse(path: tuple[int | str, ...], text: str) -> None:
        raise ConfigError(f"{name}:{line_of(node, path)}: {text}")

    artefacts = [a.id for a in spec.artefacts]
    for kind, ids in (("artefacts", artefacts), ("stations", [str(s.id) for s in spec.stations])):
        for i, key in enumerate(ids):
            if ids.index(key) < i:
                refuse((kind, i), f"{kind}: id '{key}' is used twice; give each an id of its own")
    balls: set[int] = set()
    for i, artefact in enumerate(spec.artefacts):
        for k, ball in enumerate(artefact.balls):
            if ball.id in balls:
                refuse(("artefacts", i, "balls", k), f"ball id {ball.id} is used twice; ids must be unique over all artefacts")
            balls.add(ball.id)
    for i, station in enumerate(spec.stations):
        if station.artefact not in artefacts:
            refuse(("stations", i), f"station '{station.id}' names the artefact '{station.artefact}', "
                                    f"which is not among: {', '.join(artefacts)}")
    if not np.any(spec.robot.base_to_gravity):
        refuse(("robot", "base_to_gravity"), "base_to_gravity is the zero vector; give the direction of gravity in the base frame")
    poses = [(("hand_eye",), spec.hand_eye)] + [(("stations", i, "pose_in_base"), s.pose_in_base)
                                                for i, s in enumerate(spec.stations) if s.pose_in_base]
    for path, pose in poses:
        if pose.rotation is not None:
            R = np.array(pose.rotation)
            if np.abs(R @ R.T - np.eye(3)).max() > 0.02 or np.linalg.det(R) < 0:
                refuse((*path, "rotation"), "the rotation matrix is not orthonormal and right-handed; correct its rows")


def cell_to_yaml(cell: Cell) -> str:
    """``cell.yaml`` of an observation set; reading it gives every float of ``cell`` back, bit for bit.

    The one exception: an angle that no float64 in deg converts to becomes its nearest neighbour (never one that was read from a file).
    """
    data: dict[str, Any] = {"format": FORMAT, "measurement": cell.measurement, "robot": _robot(cell.robot)}
    data["hand_eye"] = _frame(cell.T_flange_scanner)
    data["artefacts"] = [_artefact(a) for a in cell.artefacts]
    data["stations"] = [_station(s) for s in cell.stations]
    scanner: dict[str, Any] = {"name": cell.scanner_name}
    if cell.noise_mm is not None:
        scanner["noise_mm"] = _list(cell.noise_mm)
    data["scanner"] = scanner
    return _dump(data)


def robot_to_yaml(form: str, robot: RobotModel) -> str:
    """A ``cell.yaml`` that holds only the robot, such as a trajectory set's."""
    return _dump({"format": form, "robot": _robot(robot)})


def _dump(data: dict[str, Any]) -> str:
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=160)


def _robot(robot: RobotModel) -> dict[str, Any]:
    chain, n = robot.chain, robot.n
    columns: dict[str, list[Any]] = {
        "sign": [int(s) for s in chain.sign], "theta_deg": _degrees(chain.theta), "d_mm": _list(chain.d), "a_mm": _list(chain.a),
        "alpha_deg": _degrees(chain.alpha), "beta_deg": _degrees(chain.beta), "limits_deg": [_degrees(row) for row in robot.limits],
        "mass_kg": _list(robot.mass), "com_mm": [_list(row) for row in robot.com],
    }
    if robot.speed is not None:
        columns["speed_deg_s"] = _degrees(robot.speed)
    if robot.acceleration is not None:
        columns["acceleration_deg_s2"] = _degrees(robot.acceleration)
    if robot.gear_ratio is not None:
        columns["gear_ratio"] = _list(robot.gear_ratio)
    data: dict[str, Any] = {"name": robot.name}
    if robot.repeatability_mm is not None:
        data["repeatability_mm"] = float(robot.repeatability_mm)
    data["links"] = [_Flow({key: values[i] for key, values in columns.items()}) for i in range(n)]
    data["payload"] = _Flow({"mass_kg": float(robot.payload_mass), "com_mm": _list(robot.payload_com)})
    data["base_to_gravity"] = _list(robot.gravity)
    return data


def _artefact(artefact: Artefact) -> dict[str, Any]:
    data: dict[str, Any] = {"id": artefact.id, "name": artefact.name,
                            "reference_temperature_C": float(artefact.reference_temperature_C)}
    if artefact.expansion_ppm_per_K is not None:
        data["expansion_ppm_per_K"] = float(artefact.expansion_ppm_per_K)
    data["uncertainty_mm"] = float(artefact.uncertainty_mm)
    data["balls"] = [_Flow({"id": int(ball), "centre_mm": _list(centre), "diameter_mm": float(diameter)})
                     for ball, centre, diameter in zip(artefact.ball_ids, artefact.centres, artefact.diameters, strict=True)]
    return data


def _station(station: Station) -> dict[str, Any]:
    name: str | int = station.id
    if name.lstrip("-").isdecimal() and str(int(name)) == name:
        name = int(name)
    data = _Flow({"id": name, "artefact": station.artefact})
    if station.T_base_station is not None:
        data["pose_in_base"] = _frame(station.T_base_station)
        if station.sigma_mm is not None:
            data["pose_in_base"]["sigma_mm"] = float(station.sigma_mm)
    return data


def _frame(T: np.ndarray) -> dict[str, Any]:
    return {"rotation": [_list(row) for row in T[:3, :3]], "translation_mm": _list(T[:3, 3])}


def _list(values: np.ndarray) -> list[float]:
    return _FlowList(np.asarray(values, dtype=float).tolist())


def _degrees(values: np.ndarray) -> list[float]:
    return _FlowList(angles.degrees(values)[0].tolist())


class _Flow(dict):
    """A mapping written on one line."""


class _FlowList(list):
    """A list written on one line."""


class _Dumper(yaml.SafeDumper):
    pass


_Dumper.add_representer(_Flow, lambda dumper, data: dumper.represent_mapping("tag:yaml.org,2002:map", data, flow_style=True))
_Dumper.add_representer(_FlowList, lambda dumper, data: dumper.represent_sequence("tag:yaml.org,2002:seq", data, flow_style=True))

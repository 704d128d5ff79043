"""``cell.yaml`` read: checked with file and line, its references too. Writing it is in ``cell_writer``."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mbcacq.errors import ConfigError
from mbcacq.model import yaml12
from mbcacq.model.cell import Cell, RobotModel
from mbcacq.model.cell_schema import CellSpec, RobotSpec
from mbcacq.model.shipped import named_file
from mbcacq.model.yaml_source import LARGE, Path_, YamlFile, parse, read
from mbcacq.recording.datasets.cell_writer import cell_to_yaml as cell_to_yaml
from mbcacq.recording.datasets.cell_writer import robot_to_yaml as robot_to_yaml
from mbcacq.recording.datasets.open_format import validate

Fault = tuple[Path_, str]  # path of keys and indices in the YAML, and what is wrong there
CELL = "cell description"


def read_cell(path: Path) -> tuple[Cell, str]:
    """A cell and the text it was read from, in which a robot that is named by its file stands in full. Raises ConfigError with file and
    line."""
    text = _with_its_robot(read(path, CELL, LARGE))
    return parse_cell(text, str(path)), text


def robot_of(name: str) -> RobotModel:
    """The arm of the tool's of that name, or of a robot file. Raises ConfigError."""
    return validate(RobotSpec, read(named_file("robots", name), "robot file")).model()


def _with_its_robot(file: YamlFile) -> str:
    """``robot: ../arm.yaml`` or the name of a robot of the tool, replaced by what that file says; a robot that stands there stays."""
    named, text = file.data.get("robot"), file.text
    if not isinstance(named, str):
        return text
    root: Any = yaml.compose(text, yaml12.Yaml12Loader)
    value = next(value for key, value in root.value if key.value == "robot")
    beside = file.path.parent / named
    try:
        robot = read(beside if beside.is_file() else named_file("robots", named), "robot file")
    except ConfigError as error:
        raise file.error(("robot",), f"robot: {error}") from None
    validate(RobotSpec, robot)
    whole = yaml12.dump(robot.data, default_flow_style=True, width=1 << 30, allow_unicode=True).strip()
    lines = text.splitlines(keepends=True)
    begin, end = (sum(len(line) for line in lines[: mark.line]) + mark.column for mark in (value.start_mark, value.end_mark))
    return text[:begin] + whole + text[end:]


def parse_cell(text: str, name: str = "cell.yaml") -> Cell:
    """A cell from YAML text; ``name`` is what messages call it."""
    file = parse(text, Path(name), CELL, LARGE)
    spec = validate(CellSpec, file)
    _check_references(spec, file)
    return spec.model()


def _check_references(spec: CellSpec, file: YamlFile) -> None:
    """Raise ConfigError at the first id, reference, direction or rotation that a schema cannot check."""
    for path, text in chain(_repeated_ids(spec), _unknown_artefacts(spec), _zero_gravity(spec), _wrong_rotations(spec)):
        raise file.error(path, text)


def _repeated_ids(spec: CellSpec) -> Iterator[Fault]:
    for kind, ids in (("artefacts", [a.id for a in spec.artefacts]), ("stations", [str(s.id) for s in spec.stations])):
        for i, key in enumerate(ids):
            if ids.index(key) < i:
                yield (kind, i), f"{kind}: id '{key}' is used twice; give each an id of its own"
    balls: set[int] = set()
    for i, artefact in enumerate(spec.artefacts):
        for k, ball in enumerate(artefact.balls):
            if ball.id in balls:
                yield ("artefacts", i, "balls", k), f"ball id {ball.id} is used twice; number the balls of all artefacts once"
            balls.add(ball.id)


def _unknown_artefacts(spec: CellSpec) -> Iterator[Fault]:
    artefacts = [a.id for a in spec.artefacts]
    for i, station in enumerate(spec.stations):
        if station.artefact not in artefacts:
            known = ", ".join(artefacts)
            sentence = f"station '{station.id}' names the artefact '{station.artefact}', which is not among: {known}"
            yield ("stations", i), f"{sentence}; name one of these, or add the artefact"


def _zero_gravity(spec: CellSpec) -> Iterator[Fault]:
    if spec.robot and not np.any(spec.robot.base_to_gravity):
        yield ("robot", "base_to_gravity"), "base_to_gravity is the zero vector; give the direction of gravity in the base frame"


def _wrong_rotations(spec: CellSpec) -> Iterator[Fault]:
    stations = [(("stations", i, "pose_in_base"), s.pose_in_base) for i, s in enumerate(spec.stations) if s.pose_in_base]
    for path, pose in [(("hand_eye",), spec.hand_eye), *stations]:
        if pose.rotation is None:
            continue
        R = np.array(pose.rotation)
        if np.abs(R @ R.T - np.eye(3)).max() > 0.02 or np.linalg.det(R) < 0:
            yield (*path, "rotation"), "the rotation matrix is not orthonormal and right-handed; correct its rows"

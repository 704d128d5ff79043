"""``cell.yaml`` read: checked with file and line, its references too. Writing it is in ``cell_writer``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from mbcacq.errors import ConfigError
from mbcacq.model.cell import Cell
from mbcacq.model.cell_schema import CellSpec
from mbcacq.recording.datasets.cell_writer import cell_to_yaml, robot_to_yaml
from mbcacq.recording.datasets.yaml_text import line_of, load_yaml, read_yaml_text, validate

__all__ = ["cell_to_yaml", "parse_cell", "read_cell", "robot_to_yaml"]


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
            refuse(
                ("stations", i),
                f"station '{station.id}' names the artefact '{station.artefact}', which is not among: {', '.join(artefacts)}",
            )
    if not np.any(spec.robot.base_to_gravity):
        refuse(("robot", "base_to_gravity"), "base_to_gravity is the zero vector; give the direction of gravity in the base frame")
    poses = [(("hand_eye",), spec.hand_eye)] + [
        (("stations", i, "pose_in_base"), s.pose_in_base) for i, s in enumerate(spec.stations) if s.pose_in_base
    ]
    for path, pose in poses:
        if pose.rotation is not None:
            R = np.array(pose.rotation)
            if np.abs(R @ R.T - np.eye(3)).max() > 0.02 or np.linalg.det(R) < 0:
                refuse((*path, "rotation"), "the rotation matrix is not orthonormal and right-handed; correct its rows")

"""A calibrated cell to and from the content of result.json (``result_file``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.calibration import notebook
from mbcacq.calibration.joint_file import result_of_one, split_number
from mbcacq.calibration.observation_fit import Parameter
from mbcacq.calibration.result_file import CURE, THE_RESULT, ResultFile, result_of
from mbcacq.calibration.same_arm import refuse_other_arm
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import ConfigError
from mbcacq.estimation import parameters
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.parameters import ParameterLayout
from mbcacq.files.atomic_write import finish_set
from mbcacq.geometry.chain import PARAMETERS
from mbcacq.model.cell import Cell
from mbcacq.model.json_text import damaged, read_json
from mbcacq.quantities import K, pair, symbol, uncertainty

MAX_BYTES = 256 << 20  # a joint result of a hundred recordings has a tenth of that


def effects_of(result: Mapping[str, Any]) -> EffectModel | None:
    """The effects of a result; None where it is geometry alone. Raises ConfigError where they are damaged."""
    return EffectModel.from_dict(result["effects"]) if result.get("effects") else None


def state_from_dict(content: Mapping[str, Any], cell: Cell | None = None, *, other: str = "the recording") -> CellState:
    """The calibrated cell of a result. With ``cell``, its stations and balls are filled in that cell's order (identity where unknown);
    without, in the result's. other: what has that cell. Raises ConfigError if this is no such result, or the cell has another arm."""
    file = result_of(content)
    if cell is None:
        return file.state
    refuse_other_arm("the result is of", file.robot.name, file.robot.nominal_chain, cell.robot, other)
    placed, balls = {s.id: s.T_base_station for s in file.stations}, {b.id: b.centre_mm for b in file.balls}
    stations = np.array([placed.get(s.id, np.eye(4)) for s in cell.stations])
    centres = np.array([balls.get(b, c) for b, c in zip(cell.ball_ids, cell.ball_centres, strict=True)])
    return CellState(file.robot.chain, file.T_flange_scanner, stations, centres)


def layout_of(file: ResultFile, source: str = THE_RESULT) -> ParameterLayout:
    """Names and freedom of the parameters of a result: blocks of chain, hand-eye and balls, and one of all effects, if there are any.

    Raises ConfigError where the names are in another order.
    """
    free, reported = set(file.names), {p.name: p for p in file.parameters}
    groups = {
        "chain": [f"{p}_{i + 1}" for i in range(len(file.robot.sign)) for p in PARAMETERS],
        "hand_eye": [f"hand_eye.{c}" for c in parameters.HAND_EYE],
        "balls": [f"ball_{b.id}.{c}" for b in file.balls for c in "xyz"],
    }
    known = {name for names in groups.values() for name in names}
    if effects := [name for name in file.names if name not in known]:
        groups["effects"] = effects
    layout = ParameterLayout(tuple(_block(block, names, free, reported) for block, names in groups.items()))
    if layout.names != file.names:
        raise damaged(source, "names are not in the order of arm, hand-eye, balls, effects", CURE)
    return layout


def _block(block: str, names: Sequence[str], free: set[str], reported: Mapping[str, Parameter]) -> parameters.ParameterBlock:
    units = tuple(reported[name].unit if name in reported else "" for name in names)
    why = {name: reported[name].reason for name in names if name in reported and reported[name].status == "held"}
    size = len(names)
    is_free = np.array([name in free for name in names], dtype=bool)
    return parameters.ParameterBlock(block, tuple(names), units, is_free, np.full(size, np.inf), np.ones(size), why)


def read_result(path: Path, *, any_of_them: bool = False) -> dict[str, Any]:
    """The content of a result.json, given itself or by its run folder; one of several recordings is given by its number (result.json#2), or
    without a number where ``any_of_them`` will do. Raises ConfigError naming file and what is wrong."""
    path, number = split_number(path)
    if path.is_dir():
        finish_set(path)
    file = path / "result.json" if path.is_dir() else path
    try:
        if file.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{file} is larger than {MAX_BYTES >> 20} MiB, so it is no calibration result; {CURE}")
        text = file.read_bytes()
    except OSError as error:
        raise ConfigError(f"cannot read {file}: {error.strerror}; give a result.json, or the run folder that holds one") from error
    content = result_of_one(read_json(text, str(file), CURE), number, file, any_of_them=any_of_them)
    result_of(content, str(file))
    if content.get("effects"):
        EffectModel.from_dict(content["effects"], str(file), "effects")
    return content


def html(result: Mapping[str, Any]) -> str:
    """The free parameters of a result as an HTML table, in mm and degrees."""
    rows = []
    for p in result["parameters"]:
        if p["std"] is not None and not p["name"].startswith("ball_"):
            scale, unit = (180 / np.pi, "°") if p["unit"] == "rad" else (1.0, symbol(p["unit"]))
            U = K * scale * p["std"]
            rows.append((p["name"], unit, *(pair(scale * p[key], U)[0] for key in ("value", "error")), uncertainty(U)))
    return notebook.table(f"{result['robot']['name']}, calibrated", ("parameter", "unit", "value", "error", "U (k = 2)"), rows)

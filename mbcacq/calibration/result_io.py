"""The parts of result.json, format 'mbcacq-result/1': as they are written, and enough of them read back to use the calibrated cell.

Lengths mm, angles rad; transforms are 4 x 4 row lists T_outer_inner; the covariance is of the free parameters in the order of 'names', the
hand-eye entries being a local twist (scanner frame) behind T_flange_scanner.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.calibration import notebook
from mbcacq.calibration.joint_file import result_of_one, split_number
from mbcacq.calibration.observation_fit import ObservationFit, Parameter
from mbcacq.calibration.result_schema import check_result
from mbcacq.calibration.same_arm import refuse_other_arm
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import ConfigError
from mbcacq.estimation import parameters
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import Noise
from mbcacq.estimation.parameters import ParameterLayout
from mbcacq.estimation.scan_scale import scale_in_words, scan_scale
from mbcacq.estimation.variance_components import first_noise
from mbcacq.geometry import se3
from mbcacq.geometry.chain import PARAMETERS, Chain
from mbcacq.geometry.flange_poses import FlangePoses
from mbcacq.model.cell import Cell, RobotModel, Station
from mbcacq.model.json_text import damage, read_json
from mbcacq.quantities import K, pair, symbol, uncertainty

FORMAT = "mbcacq-result/1"


def robot_content(robot: RobotModel, chain: Chain) -> dict[str, Any]:
    """JSON content of an arm with its calibrated chain."""
    nominal = robot.chain
    return {
        "name": robot.name,
        **({"flange_poses": True} if robot.of_flange_poses else {}),
        "sign": nominal.sign.tolist(),
        "limits": robot.limits.tolist(),
        "nominal": {p: getattr(nominal, p).tolist() for p in PARAMETERS},
        "calibrated": {p: getattr(chain, p).tolist() for p in PARAMETERS},
        "errors": {p: (chain.rows - nominal.rows)[:, i].tolist() for i, p in enumerate(PARAMETERS)},
    }


def station_content(station: Station, T_base_station: np.ndarray, covariance: np.ndarray) -> dict[str, Any]:
    """JSON content of a station. covariance: (6, 6) of its local twist."""
    std = np.sqrt(np.diag(covariance)).tolist()
    return {"id": station.id, "artefact": station.artefact, "T_base_station": T_base_station.tolist(), "std": std}


def noise_content(noise: Noise, cell: Cell, *, oriented: bool) -> dict[str, Any]:
    """JSON content of the noise; ``oriented`` where orientations were measured."""
    return {
        "scanner_mm": noise.point.tolist(),
        "joint_rad": noise.joint.tolist(),
        **({"turn_rad": noise.turn} if oriented else {}),
        **({"check_factor": (noise.point / first_noise(cell).point).tolist()} if cell.noise_mm is not None else {}),
    }


def fit_content(fit: ObservationFit) -> dict[str, Any]:
    """JSON content of the figures of a fit."""
    return {
        "poses": fit.used_poses,
        "centres": int(fit.used.sum()),
        "rms_mm": fit.rms_mm,
        "chi2": fit.chi2,
        "dof": fit.dof,
        "chi2_dof": fit.chi2 / fit.dof if fit.dof > 0 else None,
        "rank": fit.rank,
        "iterations": fit.iterations,
    }


def scale_content(fit: ObservationFit, noise: Noise) -> dict[str, Any]:
    """JSON content on the scale of the scans."""
    found, words = scan_scale(fit.observations, fit.used, noise.point), scale_in_words(fit.observations)
    return {"scan_scale": None if found is None else found.to_dict(), **({"scale": words} if words else {})}


def doubts_content(fit: ObservationFit) -> dict[str, Any]:
    """JSON content of correlated parameters and rejected measurements."""
    return {
        "correlated": [{"parameters": [a, b], "correlation": r} for a, b, r in fit.correlated],
        "rejected": [{"pose": r.pose, **({} if r.ball is None else {"ball": r.ball}), "distance_mm": r.distance_mm} for r in fit.rejected],
    }


def parameters_of(fit: ObservationFit, layout: ParameterLayout, state: CellState, covariance: np.ndarray) -> list[Parameter]:
    """Every parameter of a fit, blocks in order; of the balls only the free ones."""
    cell, T = fit.observations.cell, state.T_flange_scanner
    turn = se3.rotation_log((se3.inverse(cell.T_flange_scanner) @ T)[:3, :3])
    mount, moved = np.concatenate([T[:3, 3], turn]), np.concatenate([T[:3, 3] - cell.T_flange_scanner[:3, 3], turn])
    values = [state.chain.rows.reshape(-1), mount, state.balls.reshape(-1), *fit.coefficients]
    arm, balls = state.chain.rows - cell.robot.chain.rows, state.balls - cell.ball_centres
    errors = [arm.reshape(-1), moved, balls.reshape(-1), *fit.coefficients]
    std = iter(_standard_deviations(layout.names, T, covariance))
    return [
        Parameter(
            name=name,
            value=float(value[i]),
            error=float(error[i]),
            unit=block.units[i],
            std=next(std) if block.free[i] else None,
            status=_status(block, i, fit.options.kinematics),
            reason=block.why.get(name, ""),
            **_prior(block, i, fit.options.kinematics),
        )
        for block, value, error in zip(layout.blocks, values, errors, strict=True)
        for i, name in enumerate(block.names)
        if block.free[i] or name in block.why
    ]


def _standard_deviations(names: Sequence[str], T_flange_scanner: np.ndarray, covariance: np.ndarray) -> list[float]:
    """Standard deviations of the free parameters; the hand-eye translation along the flange's axes."""
    C = covariance.copy()
    hand_eye = [names.index(f"hand_eye.{c}") for c in "xyz" if f"hand_eye.{c}" in names]
    if len(hand_eye) == 3:
        R = T_flange_scanner[:3, :3]
        block = np.ix_(hand_eye, hand_eye)
        C[block] = R @ C[block] @ R.T
    return np.sqrt(np.diag(C)).tolist()


def _status(block: parameters.ParameterBlock, i: int, identified: bool) -> str:
    if not block.free[i]:
        return "held"
    if block.name == "chain" and block.group is not None and not identified:
        return "marginal"
    return "prior" if np.isfinite(block.sigma[i]) else "free"


def _prior(block: parameters.ParameterBlock, i: int, identified: bool) -> dict[str, float]:
    """Standard deviation and mean of the prior of a parameter's error, where one was used."""
    if _status(block, i, identified) != "prior":
        return {}
    return {"prior_std": float(block.sigma[i]), "prior_mean": 0.0 if block.centre is None else float(block.centre[i])}


def effects_of(result: Mapping[str, Any]) -> EffectModel | None:
    """The effects of a result; None where it is geometry alone. Raises ConfigError where they are damaged."""
    return EffectModel.from_dict(result["effects"]) if result.get("effects") else None


def state_from_dict(result: dict[str, Any], cell: Cell | None = None, *, other: str = "the recording") -> CellState:
    """The calibrated cell of a result. With ``cell``, its stations and balls are filled in that cell's order (identity where unknown);
    without, in the result's. other: what has that cell. Raises ConfigError if this is no such result, or the cell has another arm."""
    if not isinstance(result, dict) or result.get("format") != FORMAT:
        raise ConfigError(f"this is not a calibration result of format '{FORMAT}'; give the result.json of a calibration")
    try:
        name, nominal, chain = str(result["robot"]["name"]), chain_of(result, "nominal"), chain_of(result, "calibrated")
        T = transform(result["T_flange_scanner"])
        placed = {s["id"]: transform(s["T_base_station"]) for s in result["stations"]}
        balls = {b["id"]: np.array(b["centre_mm"], dtype=float).reshape(3) for b in result["balls"]}
    except (KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"the calibration result is damaged ({damage(error)}); write it anew with mbcacq calibrate") from error
    if cell is None:
        return CellState(chain, T, np.array(list(placed.values())).reshape(-1, 4, 4), np.array(list(balls.values())).reshape(-1, 3))
    refuse_other_arm("the result is of", name, nominal, cell.robot, other)
    stations = np.array([placed.get(s.id, np.eye(4)) for s in cell.stations])
    centres = np.array([balls.get(b, c) for b, c in zip(cell.ball_ids, cell.ball_centres, strict=True)])
    return CellState(chain, T, stations, centres)


def chain_of(result: Mapping[str, Any], which: str) -> Chain:
    """The 'nominal' or the 'calibrated' arm of a result. Raises KeyError, TypeError or ValueError where it is damaged."""
    rows, sign = result["robot"][which], np.array(result["robot"]["sign"], dtype=float)
    columns = [np.array(rows[p], dtype=float) for p in PARAMETERS]
    for name, column in zip(PARAMETERS, columns, strict=True):
        if column.shape != sign.shape:
            raise ValueError(f"{name} of the {which} arm has {column.size} values, the arm has {sign.size} axes")
    return FlangePoses.new() if result["robot"].get("flange_poses") else Chain(sign, *columns)


def layout_from_dict(result: Mapping[str, Any]) -> ParameterLayout:
    """Names and freedom of the parameters of a result: blocks of chain, hand-eye and balls, and one of all effects, if there are any.

    Raises KeyError, TypeError or ValueError where the result is damaged.
    """
    free, reported = set(result["names"]), {p["name"]: p for p in result["parameters"]}
    chain = [f"{p}_{i + 1}" for i in range(len(result["robot"]["sign"])) for p in PARAMETERS]
    groups = {
        "chain": chain,
        "hand_eye": [f"hand_eye.{c}" for c in parameters.HAND_EYE],
        "balls": [f"ball_{b['id']}.{c}" for b in result["balls"] for c in "xyz"],
    }
    known = {name for names in groups.values() for name in names}
    if effects := [name for name in result["names"] if name not in known]:
        groups["effects"] = effects
    layout = ParameterLayout(tuple(_block(block, names, free, reported) for block, names in groups.items()))
    if layout.names != tuple(result["names"]):
        raise ValueError("names are not in the order of arm, hand-eye, balls, effects")
    return layout


def _block(block: str, names: Sequence[str], free: set[str], reported: Mapping[str, Any]) -> parameters.ParameterBlock:
    units = tuple(reported.get(name, {}).get("unit", "") for name in names)
    why = {name: reported[name].get("reason", "") for name in names if reported.get(name, {}).get("status") == "held"}
    size = len(names)
    is_free = np.array([name in free for name in names], dtype=bool)
    return parameters.ParameterBlock(block, tuple(names), units, is_free, np.full(size, np.inf), np.ones(size), why)


def noise_from_dict(found: Mapping[str, Any]) -> Noise:
    """The noise of a result: scanner_mm (3,), joint_rad (n,), turn_rad where an orientation was measured."""
    point, joint = (np.array(found[key], dtype=float) for key in ("scanner_mm", "joint_rad"))
    return Noise(point, joint, float(found["turn_rad"])) if "turn_rad" in found else Noise(point, joint)


def read_result(path: Path, *, any_of_them: bool = False) -> dict[str, Any]:
    """The content of a result.json, given itself or by its run folder; of one of several recordings by its number (result.json#2), or
    without a number where ``any_of_them`` will do. Raises ConfigError."""
    path, number = split_number(path)
    file = path / "result.json" if path.is_dir() else path
    try:
        text = file.read_bytes()
    except OSError as error:
        raise ConfigError(f"cannot read {file}: {error.strerror}; give the result.json of a calibration") from error
    content = read_json(text, str(file), "give the result.json of a calibration")
    content = result_of_one(content, number, file, any_of_them=any_of_them)
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ConfigError(f"{file} is not a calibration result of format '{FORMAT}'; give the result.json of a calibration")
    check_result(content, str(file))
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


def transform(rows: Any) -> np.ndarray:
    """(4, 4) transform of rows that were read. Raises TypeError or ValueError where they are none."""
    T = np.array(rows, dtype=float)
    if T.shape != (4, 4) or not np.all(np.isfinite(T)):
        raise ValueError("a transform is not 4 x 4")
    return T

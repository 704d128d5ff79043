"""Schema of result.json, on which other programs may rely, and a reader that names every fault."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mbcacq.calibration.joint_file import result_of_one, split_number
from mbcacq.errors import ConfigError
from mbcacq.recording.run_folder.latest import refuse_plan

MAX_BYTES = 256 << 20
Row = tuple[float, float, float, float]
Transform = tuple[Row, Row, Row, Row]
Rows = dict[Literal["theta", "d", "a", "alpha", "beta"], list[float]]


class Open(BaseModel):
    """Further keys are allowed, and kept."""

    model_config = ConfigDict(extra="allow", allow_inf_nan=False)


class ResultRobot(Open):
    name: str
    sign: list[float] = Field(description="direction of rotation of each axis, +1 or -1")
    limits: list[tuple[float, float]] | None = Field(None, description="smallest and largest angle of each axis, rad")
    nominal: Rows = Field(description="MD-H rows by parameter, over the axes: theta, alpha, beta rad; d, a mm")
    calibrated: Rows
    errors: Rows = Field(description="calibrated minus nominal")


class ResultStation(Open):
    id: str
    artefact: str
    T_base_station: Transform
    std: list[float] = Field(description="of the local twist: mm, mm, mm, rad, rad, rad", min_length=6, max_length=6)


class Ball(Open):
    id: int
    centre_mm: tuple[float, float, float]


class ResultParameter(Open):
    name: str
    value: float
    error: float = Field(description="value minus nominal")
    unit: str
    std: float | None
    status: Literal["free", "prior", "held"]
    reason: str = ""


class ResultNoise(Open):
    scanner_mm: tuple[float, float, float] = Field(description="sigma of one centre along x, y, z of the scanner")
    joint_rad: list[float] = Field(description="repeatability of each axis")


class Fit(Open):
    poses: int
    centres: int
    rms_mm: float | None
    chi2: float
    dof: int
    rank: int


class ResultFile(Open):
    """Result of a calibration. Lengths mm, angles rad; T_outer_inner are 4 x 4 row lists that act on column vectors."""

    format: Literal["mbcacq-result/1"]
    method: str
    simulated: bool = Field(False, description="whether a fake cell or a model made the data, and no real arm was measured")
    robot: ResultRobot
    T_flange_scanner: Transform
    stations: list[ResultStation]
    balls: list[Ball]
    parameters: list[ResultParameter]
    names: list[str] = Field(description="free parameters, in the order of the covariance")
    covariance: list[list[float]] = Field(description="hand_eye entries are a local twist (scanner frame) behind T_flange_scanner")
    noise: ResultNoise
    fit: Fit
    effects: dict[str, Any] | None = Field(None, description="effects as terms of the cell, format mbcacq-effect-model/1")
    sha256: str = Field("", description="of the other keys as JSON, keys sorted, no spaces, shortest decimals")


def result_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of result.json."""
    schema = ResultFile.model_json_schema()
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": "mbcacq-result/1"}


def load_result(path: str | Path) -> dict[str, Any]:
    """The result in a file, or in the run folder's result.json; of one of several recordings by its number (result.json#2).

    Raises ConfigError naming file and what is wrong."""
    path, number = split_number(Path(path))
    refuse_plan(path)
    file = path / "result.json" if path.is_dir() else path
    try:
        if file.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{file}: larger than {MAX_BYTES >> 20} MiB; this is no calibration result")
        data = json.loads(file.read_bytes())
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror}; give a result.json, or the run folder that holds one") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{file}: is not JSON ({error}); give the result.json that mbcacq calibrate writes") from error
    data = result_of_one(data, number, file)
    if not isinstance(data, dict) or data.get("format") != "mbcacq-result/1":
        raise ConfigError(f"{file}: is not a calibration result of format 'mbcacq-result/1'; give the one that mbcacq calibrate writes")
    try:
        ResultFile.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(p) for p in first["loc"])
        raise ConfigError(f"{file}: {key}: {first['msg']}; the file is damaged, write it anew with mbcacq calibrate") from None
    n, axes = len(data["names"]), len(data["robot"]["sign"])
    if len(data["covariance"]) != n or any(len(row) != n for row in data["covariance"]):
        raise ConfigError(f"{file}: the covariance is not {n} x {n} as the {n} names say; write it anew with mbcacq calibrate")
    limits = data["robot"].get("limits")
    if limits is not None and len(limits) != axes:
        raise ConfigError(f"{file}: robot.limits are of {len(limits)} axes, the arm has {axes}; write it anew with mbcacq calibrate")
    for which in ("nominal", "calibrated", "errors"):
        if any(len(column) != axes for column in data["robot"][which].values()):
            raise ConfigError(f"{file}: robot.{which} has not {axes} axes in every column; write it anew with mbcacq calibrate")
    return data

"""Schema of result.json, on which other programs may rely, and the check of what was read that names every fault."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mbcacq.errors import ConfigError
from mbcacq.model.json_text import first_fault

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
    status: Literal["free", "prior", "marginal", "held"]
    reason: str = ""
    prior_std: float | None = Field(None, description="of the prior of the error, where one was used")
    prior_mean: float = 0.0


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


def check_result(data: dict[str, Any], source: str) -> None:
    """Refuse a result with a missing key, a value of another kind, or an array of another shape than the arm and the names say.

    source: how a message calls it, the file or 'the calibration result'. Raises ConfigError.
    """
    try:
        ResultFile.model_validate(data)
    except ValidationError as error:
        raise _damaged(source, *first_fault(error)) from None
    n, axes = len(data["names"]), len(data["robot"]["sign"])
    if len(data["covariance"]) != n or any(len(row) != n for row in data["covariance"]):
        raise _damaged(source, "covariance", f"the covariance is not {n} x {n} as the {n} names say")
    arm = data["robot"]
    columns = {f"robot.{which}.{p}": column for which in ("nominal", "calibrated", "errors") for p, column in arm[which].items()}
    for key, values in {"robot.limits": arm.get("limits"), "noise.joint_rad": data["noise"]["joint_rad"], **columns}.items():
        if values is not None and len(values) != axes:
            raise _damaged(source, key, f"it has {len(values)} values, and the arm has {axes} axes")


def _damaged(source: str, key: str, fault: str) -> ConfigError:
    return ConfigError(f"{source}: {key}: {fault}; the file is damaged, write it anew with mbcacq calibrate")

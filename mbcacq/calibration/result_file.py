"""The content of result.json, format 'mbcacq-result/1': the types here write it, read it and make its JSON Schema, and what they say of
a calibrated cell.

Lengths mm, angles rad; transforms are 4 x 4 row lists T_outer_inner; the covariance is of the free parameters in the order of 'names', the
hand-eye entries being a local twist (scanner frame) behind T_flange_scanner. Further keys are allowed, and kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import ConfigDict, Field, FiniteFloat

from mbcacq.calibration.cell_estimate import CellEstimate
from mbcacq.calibration.observation_fit import EstimatedNoise, ObservationFit, Parameter, Rejected, parameters_of
from mbcacq.calibration.workspace_accuracy import arm_indices
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.scan_scale import ScanScale, scale_in_words, scan_scale
from mbcacq.estimation.variance_components import first_noise
from mbcacq.geometry.chain import PARAMETERS, Chain
from mbcacq.geometry.flange_poses import FlangePoses
from mbcacq.model.cell import Measurement, RobotModel, counted_axes
from mbcacq.model.json_text import EveryKey, Limits, Matrix, RowsOfTransform, Transform, Vector, as_list, as_rows, damaged, from_document

FORMAT = "mbcacq-result/1"
CURE = "give the result.json of a calibration, or write it anew with mbcacq calibrate"
THE_RESULT = "the calibration result"  # how a message calls one that is in no file

Figure = Annotated[float, Field(allow_inf_nan=True)]  # older files have NaN and Infinity where this is null
Rows = Annotated[Mapping[Literal["theta", "d", "a", "alpha", "beta"], Vector], Field(min_length=len(PARAMETERS))]
Point = Annotated[np.ndarray, as_list(tuple[FiniteFloat, FiniteFloat, FiniteFloat])]
Twist = Annotated[np.ndarray, as_list(Annotated[list[FiniteFloat], Field(min_length=6, max_length=6)])]


@dataclass(frozen=True, kw_only=True)
class RobotInResult(EveryKey):
    """The arm, as described and as calibrated."""

    left_out = ("flange_poses", "sliding", "floor", "root", "follows", "axes")
    later = ("limits",)

    name: str
    flange_poses: Annotated[bool, Field(description="whether the poses are of the flange, and not joint angles")] = False
    sign: Annotated[Vector, Field(description="direction of rotation of each axis, +1 or -1")]
    limits: Annotated[Limits | None, Field(description="smallest and largest angle of each axis, rad; null: without end")] = None
    sliding: Annotated[tuple[int, ...], Field(description="indices of the prismatic joints: their positions are in mm")] = ()
    floor: Annotated[int, Field(description="how many of the first joints carry the artefact")] = 0
    root: Annotated[RowsOfTransform | None, Field(description="frame of the first joint in the base; null: they are one")] = None
    follows: Annotated[tuple[tuple[int, int, float], ...], Field(description="joint, leader and ratio of those that others move")] = ()
    axes: Annotated[tuple[str, ...], Field(description="names of the axes; empty: A1 ..")] = ()
    nominal: Annotated[Rows, Field(description="MD-H rows by parameter, over the axes: theta, alpha, beta rad; d, a mm")]
    calibrated: Rows
    errors: Annotated[Rows, Field(description="calibrated minus nominal")]

    @property
    def names(self) -> tuple[str, ...]:
        """(n,) names of the axes."""
        return self.axes or counted_axes(len(self.sign))

    @classmethod
    def of(cls, robot: RobotModel, calibrated: Chain) -> Self:
        """An arm with its calibrated chain."""
        nominal, errors = robot.chain, (calibrated.rows - robot.chain.rows).T
        return cls(
            name=robot.name,
            flange_poses=robot.of_flange_poses,
            sign=nominal.sign,
            limits=None if robot.of_flange_poses else robot.limits,
            sliding=nominal.sliding,
            floor=nominal.floor,
            root=as_rows(nominal.root),
            follows=nominal.follows,
            axes=robot.names,
            nominal=_rows(nominal),
            calibrated=_rows(calibrated),
            errors=dict(zip(PARAMETERS, errors, strict=True)),
        )

    @property
    def nominal_chain(self) -> Chain:
        """The arm as described."""
        return self._chain(self.nominal)

    @property
    def chain(self) -> Chain:
        """The arm as calibrated."""
        return self._chain(self.calibrated)

    def _chain(self, rows: Rows) -> Chain:
        if self.flange_poses:
            return FlangePoses.new()
        root = None if self.root is None else np.array(self.root)
        return Chain(self.sign, *(rows[p] for p in PARAMETERS), sliding=self.sliding, floor=self.floor, root=root, follows=self.follows)


def _rows(chain: Chain) -> Rows:
    return {p: getattr(chain, p) for p in PARAMETERS}


@dataclass(frozen=True, kw_only=True)
class StationInResult:
    """A station that took part."""

    id: str
    artefact: str
    T_base_station: Transform
    std: Annotated[Twist, Field(description="of the local twist: mm, mm, mm, rad, rad, rad")]


@dataclass(frozen=True)
class BallInResult:
    """A ball, in the frame of its artefact."""

    id: int
    centre_mm: Point


@dataclass(frozen=True)
class Preliminary:
    """Before the calibration: of the nominal arm, hand-eye fitted alone."""

    T_flange_scanner: Transform


@dataclass(frozen=True)
class NoiseInResult(EstimatedNoise):
    """With how the scanner's noise compares with its statement."""

    left_out = ("turn_rad", "check_factor")

    check_factor: Annotated[tuple[Figure, ...] | None, Field(description="scanner_mm over what the instrument states")] = None


@dataclass(frozen=True, kw_only=True)
class FitInResult(EveryKey):
    """The figures of a fit."""

    later = ("chi2_dof", "iterations", "expected_accuracy_mm")

    poses: int
    centres: int
    rms_mm: float | None
    chi2: float
    dof: int
    chi2_dof: Figure | None = None
    rank: int
    iterations: int | None = None
    expected_accuracy_mm: Figure | None = None


@dataclass(frozen=True)
class Correlated:
    """Two parameters that the data can hardly separate."""

    parameters: tuple[str, str]
    correlation: float


@dataclass(frozen=True, kw_only=True)
class ResultFile(EveryKey):
    """Result of a calibration. Lengths mm, angles rad; T_outer_inner are 4 x 4 row lists that act on column vectors."""

    __pydantic_config__ = ConfigDict(allow_inf_nan=False)

    left_out = ("simulated", "scale", "effects", "loads_Nm", "sha256")
    later = ("measurement", "preliminary", "observability", "scan_scale", "held", "correlated", "rejected")

    format: Literal["mbcacq-result/1"]
    method: str
    measurement: Measurement | None = None
    simulated: Annotated[bool, Field(description="whether a fake cell or a model made the data, and no real arm was measured")] = False
    robot: RobotInResult
    T_flange_scanner: Transform
    stations: tuple[StationInResult, ...]
    balls: tuple[BallInResult, ...]
    preliminary: Preliminary | None = None
    parameters: tuple[Parameter, ...]
    names: Annotated[tuple[str, ...], Field(description="free parameters, in the order of the covariance")]
    covariance: Annotated[Matrix, Field(description="hand_eye entries are a local twist (scanner frame) behind T_flange_scanner")]
    noise: NoiseInResult
    fit: FitInResult
    observability: Mapping[str, Figure | None] = field(default_factory=dict)
    scan_scale: ScanScale | None = None
    scale: Annotated[str, Field(description="whose scale the cell has, where an artefact is not certified")] = ""
    held: Annotated[Mapping[str, str], Field(description="parameters that keep their nominal value, and why")] = field(default_factory=dict)
    correlated: tuple[Correlated, ...] = ()
    rejected: tuple[Rejected, ...] = ()
    effects: Annotated[Mapping[str, Any] | None, Field(description="effects as terms of the cell, format mbcacq-effect-model/1")] = None
    loads_Nm: Annotated[
        tuple[tuple[FiniteFloat, FiniteFloat], ...],
        Field(description="range of the torque of gravity about each axis in nine of ten poses, where masses are known"),
    ] = ()
    sha256: Annotated[str, Field(description="of the other keys as JSON, keys sorted, no spaces, shortest decimals")] = ""

    @property
    def state(self) -> CellState:
        """The calibrated cell, stations and balls in the file's order."""
        stations = np.array([s.T_base_station for s in self.stations]).reshape(-1, 4, 4)
        return CellState(self.robot.chain, self.T_flange_scanner, stations, np.array([b.centre_mm for b in self.balls]).reshape(-1, 3))


def result_of(content: Any, source: str = THE_RESULT) -> ResultFile:
    """The result that the content of a result.json says. source: how a message calls it, the file or 'the calibration result'.

    Raises ConfigError for another format, a missing key, a value of another kind, or an array of another shape than the arm and the names
    say.
    """
    file = from_document(ResultFile, content, FORMAT, source, "calibration result", CURE)
    n, axes, arm = len(file.names), len(file.robot.sign), file.robot
    if file.covariance.size != n * n or len(file.covariance) != n:
        raise damaged(source, f"the covariance is not {n} x {n} as the {n} names say", CURE)
    columns = {f"robot.{which}.{p}": column for which in ("nominal", "calibrated", "errors") for p, column in getattr(arm, which).items()}
    for key, values in {"robot.limits": arm.limits, "noise.joint_rad": file.noise.joint_rad, **columns}.items():
        if values is not None and len(values) != axes:
            raise damaged(source, f"{key}: it has {len(values)} values, and the arm has {axes} axes", CURE)
    return file


def result_file(
    estimate: CellEstimate, fit: ObservationFit, *, preliminary: CellState, simulated: bool, expected_accuracy_mm: float
) -> ResultFile:
    """The content of a result.

    Parameters
    ----------
    estimate
        The calibrated cell.
    fit
        The observations with residuals and weights.
    preliminary
        Nominal arm, hand-eye fitted alone.
    simulated
        Whether a fake cell or a model made the data.
    expected_accuracy_mm
        The rms uncertainty of a measured point, mm.

    Returns
    -------
    ResultFile
        Stations are those that took part.
    """
    cell, state = fit.observations.cell, estimate.state
    noise = NoiseInResult.of(estimate.noise, oriented=fit.oriented)
    if cell.noise_mm is not None:
        noise = replace(noise, check_factor=tuple((estimate.noise.point / first_noise(cell).point).tolist()))
    used = set(fit.used_stations)
    no_links = set(estimate.layout.blocks[0].names) if cell.robot.of_flange_poses else set()
    stations = [
        StationInResult(id=station.id, artefact=station.artefact, T_base_station=state.T_base_station[s], std=np.sqrt(np.diag(covariance)))
        for s, (station, covariance) in enumerate(zip(cell.stations, fit.station_covariance, strict=True))
        if s in used
    ]
    figures = {name: getattr(fit, name) for name in ("rms_mm", "chi2", "dof", "rank", "iterations")}
    figures |= {"poses": fit.used_poses, "centres": int(fit.used.sum())}
    return ResultFile(
        format=FORMAT,
        method=fit.options.method,
        measurement=cell.measurement,
        simulated=simulated,
        robot=RobotInResult.of(cell.robot, state.chain),
        T_flange_scanner=state.T_flange_scanner,
        stations=tuple(stations),
        balls=tuple(BallInResult(b, state.balls[i]) for i, b in enumerate(cell.ball_ids)),
        preliminary=Preliminary(preliminary.T_flange_scanner),
        parameters=tuple(p for p in parameters_of(fit, estimate.layout, state, estimate.covariance) if p.name not in no_links),
        names=estimate.names,
        covariance=estimate.covariance,
        noise=noise,
        fit=FitInResult(**figures, chi2_dof=fit.chi2 / fit.dof if fit.dof > 0 else None, expected_accuracy_mm=expected_accuracy_mm),
        observability=arm_indices(estimate.layout, estimate.covariance, fit.used_poses),
        scan_scale=scan_scale(fit.observations, fit.used, estimate.noise.point),
        scale=scale_in_words(fit.observations),
        held={name: why for name, why in estimate.layout.held.items() if name not in no_links},
        correlated=tuple(Correlated((a, b), r) for a, b, r in fit.correlated),
        rejected=fit.rejected,
        effects=estimate.effects.to_dict() if estimate.effects else None,
    )

"""The calibrated cell: what was found out about arm, hand-eye, stations, artefacts and effects, how well it is known, and what follows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mbcacq.calibration import notebook, result_io, verification
from mbcacq.calibration.cell_estimate import CellEstimate
from mbcacq.calibration.length_budget import length_budget
from mbcacq.calibration.observation_fit import ObservationFit, Parameter, adjusted_fit, parameters_of
from mbcacq.calibration.result_file import CURE, THE_RESULT, ResultFile, result_file, result_of
from mbcacq.calibration.sufficiency import refuse_other_arm
from mbcacq.calibration.verification import Verification, judge, verification_poses
from mbcacq.calibration.verified_lengths import verified_lengths
from mbcacq.calibration.workspace_accuracy import arm_indices, expected_accuracy
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import ConfigError
from mbcacq.estimation.adjustment import Adjustment
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.figure import Figure
from mbcacq.geometry.chain import PARAMETERS, Chain
from mbcacq.model.cell import TARGET_IN_BASE, axis_of_tag
from mbcacq.model.json_text import damaged, fields_as_json, from_fields, read_json, sealed_text, unsealed
from mbcacq.model.observations import Observations


class HasModel(Protocol):
    """A diagnosis: what it found, as a model of effects."""

    @property
    def model(self) -> EffectModel | None: ...


@dataclass(frozen=True, repr=False, kw_only=True)
class CalibratedCell(CellEstimate):
    """A calibrated cell, whether it was just computed or read from result.json. Lengths mm, angles rad.

    Attributes
    ----------
    robot : str
        Name of the arm.
    nominal : Chain
        The arm as described.
    limits : ndarray or None
        (n, 2) rad, smallest and largest angle of each axis; None if the result does not have them.
    state : CellState
        The arm with its errors, T_flange_scanner (4, 4), T_base_station (S, 4, 4), balls (K, 3) mm.
    preliminary : CellState
        Nominal arm, hand-eye fitted alone.
    stations, ball_ids : tuple
        Ids of the S stations and the K balls.
    layout : ParameterLayout
        Names and freedom of the parameters.
    covariance : ndarray
        (g, g) of the free parameters in the order of ``names``; those of the hand-eye are a local twist (scanner frame).
    noise : Noise
        Noise of a centre and of the joints.
    effects : EffectModel or None
        What the arm does beyond its geometry, free or held: parametric, unmodelled, and the smooth discrepancy of the joints.
    simulated : bool
        Whether a fake cell or a model made the data, and no real arm was measured.
    extra : mapping
        Further content of result.json, such as warnings; all of it if the cell was read from a file.
    own_fit : ObservationFit or None
        The observations that it was calibrated from; None if it was read from result.json. See ``fit``.
    own_adjustment : Adjustment or None
        The converged adjustment, while the cell is being calibrated; None afterwards. See ``adjustment``.
    calibrate_again : callable or None
        Calibrates observations under options with a model of effects, as this cell was calibrated.
    """

    robot: str
    nominal: Chain
    limits: np.ndarray | None
    preliminary: CellState
    stations: tuple[str, ...]
    ball_ids: tuple[int, ...]
    simulated: bool = False
    extra: Mapping[str, Any] = field(default_factory=dict)
    own_fit: ObservationFit | None = None
    own_adjustment: Adjustment | None = None
    calibrate_again: Callable[..., CalibratedCell] | None = None

    def to_base(self, q: np.ndarray, xyz: np.ndarray) -> np.ndarray:
        """Scanner points in the base frame.

        Parameters
        ----------
        q : (P, n) ndarray
            Joint angles at which each point was seen, rad.
        xyz : (P, 3) ndarray
            Points in the scanner frame, mm.

        Returns
        -------
        (P, 3) ndarray
            Points in the base frame, mm.

        Raises
        ------
        ConfigError
            The instrument does not move: it stands in the base.
        """
        measurement = self.extra.get("measurement") if self.own_fit is None else self.own_fit.observations.cell.measurement
        if measurement == TARGET_IN_BASE:
            raise ConfigError(
                "the target is on the flange and the instrument stands in the base, so joint angles do not say where its points are; "
                "its place is cell.state.T_base_station"
            )
        return self.placed(q, xyz)

    @classmethod
    def fitted(
        cls, fit: ObservationFit, estimate: CellEstimate, preliminary: CellState, extra: Mapping[str, Any] | None = None
    ) -> CalibratedCell:
        """The cell of these observations with what a fit found of it.

        Parameters
        ----------
        fit
            The observations with residuals and weights.
        estimate, preliminary
            State, layout, covariance, noise and effects; the nominal arm.
        extra
            What else result.json will hold.

        Returns
        -------
        CalibratedCell
            With ``own_fit``.
        """
        cell = fit.observations.cell
        return cls(
            **{one.name: getattr(estimate, one.name) for one in fields(CellEstimate)},
            robot=cell.robot.name,
            nominal=cell.robot.chain,
            limits=cell.robot.limits,
            preliminary=preliminary,
            stations=tuple(s.id for s in cell.stations),
            ball_ids=cell.ball_ids,
            simulated=cell.simulated,
            extra=extra or {},
            own_fit=fit,
        )

    @classmethod
    def from_dict(cls, content: dict[str, Any], source: str = THE_RESULT) -> CalibratedCell:
        """The cell of a result's content.

        Parameters
        ----------
        content
            Content of a result.json.
        source
            What a message calls it.

        Returns
        -------
        CalibratedCell
            Without observations.

        Raises
        ------
        ConfigError
            The content is no result of a calibration, or a damaged one.
        """
        file = result_of(content, source)
        if file.preliminary is None:
            raise damaged(source, "the key 'preliminary' is missing", CURE)
        state, nominal = file.state, file.robot.nominal_chain
        return cls(
            robot=file.robot.name,
            nominal=nominal,
            limits=file.robot.limits,
            state=state,
            preliminary=CellState(nominal, file.preliminary.T_flange_scanner, state.T_base_station, state.balls),
            stations=tuple(s.id for s in file.stations),
            ball_ids=tuple(b.id for b in file.balls),
            layout=result_io.layout_of(file, source),
            covariance=file.covariance.reshape(len(file.names), len(file.names)),
            noise=file.noise.noise,
            effects=result_io.effects_of(content),
            simulated=file.simulated,
            extra=content,
        )

    @classmethod
    def from_json(cls, source: str | Path, *, any_of_them: bool = False) -> CalibratedCell:
        """The cell of a result's JSON text, of a result.json, or of a run folder that holds one.

        Parameters
        ----------
        source
            The text or the path. ``result.json#2`` is the second of several recordings.
        any_of_them
            Take any of several recordings without a number; they share the arm.

        Returns
        -------
        CalibratedCell
            Without observations.

        Raises
        ------
        ConfigError
            The content is no result of a calibration, or a damaged one.
        """
        if isinstance(source, str) and source.lstrip().startswith("{"):
            content = read_json(source, THE_RESULT, "give the content of a result.json")
            return cls.from_dict(unsealed(content, Path(THE_RESULT)))
        return cls.from_dict(result_io.read_result(Path(source), any_of_them=any_of_them), str(source))

    def to_dict(self) -> dict[str, Any]:
        """The content of result.json; see ``mbcacq.calibration.result_file``.

        Returns
        -------
        dict
            Format 'mbcacq-result/1'.
        """
        return dict(self.extra) if self.own_fit is None else {**fields_as_json(self.file), **self.extra}

    @property
    def axes(self) -> tuple[str, ...]:
        """(n,) names of the axes."""
        return tuple(axis_of_tag(name.rpartition("_")[2]) for name in self.layout.blocks[0].names[:: len(PARAMETERS)])

    @property
    def file(self) -> ResultFile:
        """The cell as a file holds it. Raises ConfigError as ``fit``."""
        return result_file(
            self, self.fit, preliminary=self.preliminary, simulated=self.simulated, expected_accuracy_mm=self.expected_accuracy()
        )

    def to_json(self) -> str:
        """``to_dict`` as JSON text, with its checksum.

        Returns
        -------
        str
            Text that ``from_json`` takes.
        """
        return sealed_text(self.to_dict())

    @property
    def fit(self) -> ObservationFit:
        """The observations that it was calibrated from, with residuals and weights. Raises ConfigError if the cell was read from
        result.json, which does not hold them."""
        if self.own_fit is None:
            raise ConfigError("this calibrated cell was read from its result, which holds no observations; calibrate the recording again")
        return self.own_fit

    @property
    def adjustment(self) -> Adjustment:
        """The converged adjustment behind it, with its linear problem."""
        assert self.own_adjustment is not None, "asked while it is being calibrated"
        return self.own_adjustment

    @property
    def errors(self) -> np.ndarray:
        """(n, 5) identified MD-H errors."""
        return self.state.chain.rows - self.nominal.rows

    @property
    def station_places(self) -> dict[str, np.ndarray]:
        """T_base_station (4, 4) by id, of the stations that took part; ``state`` has a first guess, or nothing, for the others."""
        used = range(len(self.stations)) if self.own_fit is None else self.own_fit.used_stations
        return {self.stations[s]: self.state.T_base_station[s] for s in used}

    @property
    def parameters(self) -> list[Parameter]:
        """Every parameter, blocks in order; balls have only their free ones."""
        if self.own_fit is None:
            return [from_fields(Parameter, p) for p in self.extra["parameters"]]
        return parameters_of(self.own_fit, self.layout, self.state, self.covariance)

    @property
    def observability(self) -> dict[str, float]:
        """Indices O1..O5 of the kinematic and hand-eye parameters, balls, stations and effects being free as they were."""
        return arm_indices(self.layout, self.covariance, self.fit.used_poses)

    def expected_accuracy(self, postures: int = 300, seed: int = 1) -> float:
        """The rms uncertainty of a measured point over postures within the joint limits.

        The effects are included. A rigid motion of all points together is not.

        Parameters
        ----------
        postures
            Number of random postures.
        seed
            Seed of the postures.

        Returns
        -------
        float
            In mm (3D, k = 1).

        Raises
        ------
        ConfigError
            The cell was read from result.json, which holds no observations.
        """
        return expected_accuracy(self, self.fit.observations, postures, seed)

    def took_part(self, observations: Observations) -> bool | None:
        """Whether any of these poses took part in the calibration.

        Parameters
        ----------
        observations
            The poses.

        Returns
        -------
        bool or None
            A cell that was read from result.json does not list its poses: False if none of these stations is its own, else None.
        """
        if self.own_fit is not None:
            return self.own_fit.holds(observations)
        measured = {observations.cell.stations[s].id for s in np.unique(observations.station)}
        return None if measured & set(self.stations) else False

    def verify(self, observations: Observations, *, limit_mm: float | None = None) -> Verification:
        """Sphere spacing errors of a recording at its verification poses; if no phases are recorded, of all two-ball artefacts.

        Parameters
        ----------
        observations
            The recording.
        limit_mm
            Largest error permitted, mm.

        Returns
        -------
        Verification
            Each error has the uncertainty that is expected of it, and that by which it is compared with the limit.

        Raises
        ------
        ConfigError
            The recording is of another arm.
        """
        refuse_other_arm("the result is of", self.robot, self.nominal, observations.cell.robot, "the recording")
        found = verified_lengths(self, self.preliminary, observations, limit_mm)
        took_part = self.took_part(verification_poses(observations))
        found = replace(found, independent=None if took_part is None else not took_part)
        figures = judge(observations, self.state, self.effects, found)
        return replace(found, figures=tuple(figures))

    def with_effects(self, found: EffectModel | HasModel, *, hold: bool = False) -> CalibratedCell:
        """Calibrate the same recording with effects as terms of the cell.

        Parameters
        ----------
        found
            A model of effects, or a diagnosis that holds one.
        hold
            Keep the coefficients of the effects as they are.

        Returns
        -------
        CalibratedCell
            The cell with its effects.

        Raises
        ------
        ConfigError
            There are no effects, they are of another arm, or the cell was read from result.json.
        """
        model = found if isinstance(found, EffectModel) else found.model
        if not model:
            raise ConfigError("this diagnosis found no effects that a calibration could take")
        if self.calibrate_again is None:
            raise ConfigError("this calibration does not know how it was made; call mbcacq.calibrate with effects")
        return self.calibrate_again(self.fit.observations, self.fit.options, model, hold=hold)

    def __repr__(self) -> str:
        if self.own_fit is None:
            return f"CalibratedCell({self.robot}: {len(self.names)} parameters, {len(self.stations)} stations)"
        return (
            f"CalibratedCell({self.robot}: {int(self.own_fit.used.sum())} centres, residual {self.own_fit.rms_mm:.4f} mm rms, "
            f"{len(self.names)} parameters, rank {self.own_fit.rank})"
        )

    def plot(self) -> Figure:
        """The identified errors of the arm's parameters.

        Returns
        -------
        Figure
            Each error with its U (k = 2).
        """
        content = self.to_dict()
        return notebook.parameter_figure(f"{content['robot']['name']}: errors against the data sheet", content["parameters"])

    def _repr_html_(self) -> str:
        return result_io.html(self.to_dict()) + notebook.paragraph(repr(self))


def adjusted_cell(options: CalibrationOptions, adjustment: Adjustment, known_noise: bool = False) -> CalibratedCell:
    """The calibrated cell of an adjustment; the arguments are those of ``adjusted_fit``."""
    return CalibratedCell.fitted(*adjusted_fit(options, adjustment, known_noise), adjustment.preliminary)


def verify(
    observations: Observations, calibrated: CalibratedCell | CellState, *, before: CellState | None = None, limit_mm: float | None = None
) -> Verification:
    """Sphere spacing errors of a recording; see ``CalibratedCell.verify``. A ``CellState`` alone is compared with ``before`` (default: the
    same), and has no expected uncertainty."""
    if isinstance(calibrated, CalibratedCell):
        return calibrated.verify(observations, limit_mm=limit_mm)
    obs = verification_poses(observations)
    pairs = verification.measured_pairs(obs, before or calibrated, calibrated)
    budgets = [length_budget(obs, p.station, p.pair.balls) for p in pairs]
    return verification.verification_of(pairs, budgets, limit_mm)

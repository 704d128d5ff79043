"""The diagnosis of poses as typed objects, and as the JSON object (``mbcacq-diagnosis/3``) that other programs read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Self

from mbcacq.calibration.cell_estimate import CellEstimate
from mbcacq.calibration.observation_fit import EstimatedNoise, ObservationFit, Parameter, parameters_of
from mbcacq.diagnosis.findings import OUT_OF_TIME, EvidenceSummary, Findings
from mbcacq.effects.effect_file import EffectModelFile
from mbcacq.effects.effect_model import EffectModel
from mbcacq.effects.effect_term import EffectTerm
from mbcacq.estimation.several_recordings import BetweenRecordings
from mbcacq.geometry.chain import PARAMETERS
from mbcacq.model.json_text import EveryKey, InJson, Number
from mbcacq.quantities import micrometres


def _model(file: EffectModelFile | None) -> EffectModel | None:
    return None if file is None else EffectModel.of_file(file)


def _content(model: EffectModel | None) -> dict[str, Any] | None:
    return None if model is None else model.to_dict()


Model = Annotated[EffectModel | None, InJson(EffectModelFile | None, _model, _content)]


@dataclass(frozen=True)
class GeometryAlone:
    """The cell of one recording before any effect, as ``mbcacq.calibrate`` has it: keys, names and units are those of result.json (format
    'mbcacq-result/1').

    Attributes
    ----------
    poses, centres : int
        Numbers of poses and centres that took part. A search for effects may begin with more centres, since an effect may be what puts them
        off.
    rms_mm : Number
        Rms of 3D distances.
    chi2, dof
        Chi2 and dof of the fit.
    calibrated : Mapping[str, tuple[float, ...]]
        MD-H rows by parameter, (n,) rad or mm.
    T_flange_scanner : tuple[tuple[float, ...], ...]
        (4, 4) mm.
    parameters : tuple[Parameter, ...]
        Parameters of the arm and the hand-eye transform.
    """

    poses: int
    centres: int
    rms_mm: Number
    chi2: Number
    dof: int
    noise: EstimatedNoise
    calibrated: Mapping[str, tuple[float, ...]]
    T_flange_scanner: tuple[tuple[float, ...], ...]
    parameters: tuple[Parameter, ...]

    @classmethod
    def of(cls, fit: ObservationFit, cell: CellEstimate) -> Self:
        """Noise and figures of a calibration without effects."""
        arm, hand_eye, *_ = cell.layout.blocks
        parameters = parameters_of(fit, cell.layout, cell.state, cell.covariance)
        parameters = tuple(p for p in parameters if p.name in {*arm.names, *hand_eye.names})
        figures = fit.used_poses, int(fit.used.sum()), fit.rms_mm, float(fit.chi2), fit.dof
        calibrated = {p: tuple(getattr(cell.state.chain, p).tolist()) for p in PARAMETERS}
        T, noise = tuple(tuple(row) for row in cell.state.T_flange_scanner.tolist()), EstimatedNoise.of(cell.noise, oriented=fit.oriented)
        return cls(*figures, noise, calibrated, T, parameters)


@dataclass(frozen=True)
class FitFigures:
    """How well the geometry alone (before) and the model with its effects (after) agree with centres: rms of 3D distances in mm, and
    chi2 per degree of freedom under the full noise model.
    """

    before_rms_mm: Number
    after_rms_mm: Number
    before_chi2_dof: Number
    after_chi2_dof: Number


@dataclass(frozen=True)
class HeldOutFigures(FitFigures, EveryKey):
    """The same figures on held-out data: in no choice and no fit.

    Attributes
    ----------
    split : str
        ``station`` or ``block``, what was left out at a time.
    centres, robust_centres : int
        Number of all held-out centres, and of those that the fit of all data does not reject as gross outliers. The figures above are
        robust: of the latter. Both are 0 where none is rejected.
    every_before_rms_mm, every_after_rms_mm : Number
        Rms of all held-out centres; 0 where none is rejected.
    """

    left_out = ("centres", "robust_centres", "every_before_rms_mm", "every_after_rms_mm")

    split: str
    centres: int = 0
    robust_centres: int = 0
    every_before_rms_mm: Number = 0.0
    every_after_rms_mm: Number = 0.0

    @property
    def rejects(self) -> bool:
        """Whether the fit of all data rejects a centre."""
        return self.centres > self.robust_centres


@dataclass(frozen=True)
class FitSummary:
    """repeatability_floor_mm: 3D rms expected at one centre from the estimated noise alone."""

    train: FitFigures
    held_out: HeldOutFigures
    repeatability_floor_mm: Number


@dataclass(frozen=True, kw_only=True)
class NoiseDependence:
    """A noise that depends on the place, and is taken so in everything else but for long recordings.

    Attributes
    ----------
    of : str
        'instrument', or 'instrument and joints' of what moves a pose as a whole.
    covariate, unit : str
        The quantity that the noise depends on.
    low, high : Number
        Range in which the noise was measured (5 and 95 % of the poses).
    sigma_low_mm, sigma_high_mm : Number
        Sigma low and sigma high of the instrument there, an axis.
    p_value : Number
        P value of as large a variation by chance.
    """

    of: str
    covariate: str
    unit: str
    low: Number
    high: Number
    sigma_low_mm: Number
    sigma_high_mm: Number
    p_value: Number


@dataclass(frozen=True)
class ExclusionBand:
    """Values of a hyper-parameter for which a limit holds, from low to high, but for those that are left out. They are orders of a gear
    (periods a turn), numbers of the first pose after a change, breakpoints, or time constants.
    """

    parameter: str
    low: Number
    high: Number
    left_out: tuple[Number, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ExclusionLimit:
    """The size of an effect at a location that is excluded with 95 % confidence, everything that it is confused with being free. 95 % of
    effects as large, with any value from ``holds_for`` and any direction of the coefficients, would have shown more than the recording
    does.

    Attributes
    ----------
    parameter : str
        Its name, with the unit as suffix.
    value : float or None
        None if the free geometry absorbs the effect.
    workspace_mm : float or None
        Largest error that it would make in the workspace, together with what would hide it here.
    length_mm : float or None
        Error of a length between two postures that 95 % of lengths do not exceed. Both are None for what depends on time or on single
        balls, and where the effect is not tested.
    in_usual_sizes : float or None
        The limit relative to the effect's usual size; None if value is, and in older files.
    tested : bool
        Whether the limit is within what machines have; a larger one says nothing.
    holds_for : ExclusionBand or None
        The values of the effect's hyper-parameter for which the limit holds; None if it has none.
    """

    later = ("in_usual_sizes", "tested", "holds_for")

    name: str
    where: tuple[str, ...]
    parameter: str
    value: float | None
    workspace_mm: float | None
    length_mm: float | None
    in_usual_sizes: float | None = None
    tested: bool = True
    holds_for: ExclusionBand | None = None


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A short formula for an unmodelled effect that was located.

    Attributes
    ----------
    where : tuple[str, ...]
        Its location.
    formula : str
        The displaced quantity and its functions, with the fitted coefficients.
    terms : tuple[str, ...]
        Terms of what it is a function, whatever the phase, e.g. ``q4*q6``.
    log_bayes_factor : Number
        Natural logarithm, against no effect there.
    odds : Number
        Posterior probability relative to the most probable formula.
    held_out_before_chi2_dof, held_out_chi2_dof, held_out_rms_mm : Number
        Misfit of data left out, without the formula and with it.
    smooth_chi2_dof : Number
        Misfit of data left out, with the smooth model in the place of the formula.
    found_in, parts : int
        Found in and parts of how many repetitions of the search without a part of the data it was among the reported.
    term : EffectTerm
        The formula as a term, from which a draft of an effect is written.
    """

    where: tuple[str, ...]
    formula: str
    terms: tuple[str, ...]
    log_bayes_factor: Number
    odds: Number
    held_out_before_chi2_dof: Number
    held_out_chi2_dof: Number
    held_out_rms_mm: Number
    smooth_chi2_dof: Number
    found_in: int
    parts: int
    term: EffectTerm


@dataclass(frozen=True, repr=False, kw_only=True)
class Diagnosis(Findings):
    """The result of ``diagnose``, of poses.

    geometry_alone: the cell of each recording before any effect, as a calibration has it; empty in older files. dropped: effects that were
    not considered, with what the recording lacks for them. notes: further sentences for people. exclusion_limits: of all effects that
    were not found, those with the largest error first. between_recordings: of several recordings of one arm. proposals: formulas for
    unmodelled effects, where they were asked for, the most probable of each location first. noise_depends_on: where one noise for all
    poses would be wrong. model: the effects as terms that a calibration takes; None if there is none. evidence: of the sets that were
    compared; None in older files. plot_data: an ``output.pictures.PlotData``.
    """

    later = ("geometry_alone", "exclusion_limits", "between_recordings", "proposals", "noise_depends_on", "evidence")

    fit: FitSummary
    geometry_alone: tuple[GeometryAlone, ...] = ()
    dropped: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    exclusion_limits: tuple[ExclusionLimit, ...] = ()
    between_recordings: tuple[BetweenRecordings, ...] = ()
    proposals: tuple[Proposal, ...] = ()
    noise_depends_on: tuple[NoiseDependence, ...] = ()
    model: Model = field(default=None, compare=False)
    evidence: EvidenceSummary | None = None

    @property
    def out_of_time(self) -> bool:
        return OUT_OF_TIME in self.notes

    @property
    def held_out(self) -> str:
        held = self.fit.held_out
        rms = f"{micrometres(held.before_rms_mm)} before, {micrometres(held.after_rms_mm)} after"
        return f"{rms}; χ²/dof {held.before_chi2_dof:.2f} before, {held.after_chi2_dof:.2f} after"

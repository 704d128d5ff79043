"""Content of a report as plain values, between the result file and the page. Lengths mm, angles deg; None or empty is left out.

Some fields of ``Content`` hold rows. ``figures`` are those of the verification (name, value, uncertainty, limit, verdict). ``headlines``
are the numbers of the first screen (label, value with unit, value to compare with). ``budget`` has the sources of uncertainty (source,
standard uncertainty, remark). ``identity`` names the measuring devices (label, text). ``hand_eye_alone`` says that the arm was taken as
nominal. ``caveats`` are the sentences that stand above everything (simulated, never verified).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from mbcacq.calibration.place_errors import ArmImprovement
from mbcacq.model.channel_series import ChannelSeries
from mbcacq.quantities import K, decimal_places, fixed


@dataclass(frozen=True)
class ReportVerdict:
    """level: 'pass', 'fail', 'undecided' (within the measurement's uncertainty of the limit) or 'none' (no limit or no verification)."""

    level: str
    headline: str
    reason: str


@dataclass(frozen=True)
class Action:
    """The one thing to do next: what, why, and the command for it, or ''."""

    what: str
    why: str
    command: str = ""


@dataclass(frozen=True)
class Spacing:
    """Sphere spacing errors at the verification artefact.

    Attributes
    ----------
    place : list[str]
        The k names.
    certified : ndarray
        (k,) mm.
    before, after : ndarray
        (k,) mm signed.
    sigma : ndarray or None
        (k,) mm standard deviation that the fit expects, or None.
    limit : float or None
        mm or None.
    more : list[tuple[str, str]]
        Further figures (label, text).
    independent : bool
        The poses were held out of the fit.
    judging : ndarray or None
        (k,) mm standard uncertainty of judging each error, or None.
    common : float or None
        mm standard uncertainty of the mean error, which all places share, or None.
    """

    place: list[str]
    certified: np.ndarray
    before: np.ndarray
    after: np.ndarray
    sigma: np.ndarray | None = None
    limit: float | None = None
    more: list[tuple[str, str]] = field(default_factory=list)
    independent: bool = True
    judging: np.ndarray | None = None
    common: float | None = None

    @property
    def beyond(self) -> np.ndarray:
        """(k,) bool: the error after is larger than its expanded expected uncertainty."""
        return np.zeros(len(self.after), dtype=bool) if self.sigma is None else np.abs(self.after) > K * self.sigma

    @property
    def places_shown(self) -> int:
        """Decimal places of every length of the table: those of the smallest uncertainty of judging."""
        return 3 if self.judging is None or not self.judging.all() else max(decimal_places(K * float(self.judging.min())), 0)

    def mm(self, value: float) -> str:
        """A length of the table, without its unit."""
        return fixed(value, self.places_shown)


@dataclass(frozen=True, kw_only=True)
class ParameterRow:
    """One identified parameter with its expanded uncertainty (k = 2). nominal and value may be None if only the correction is known.
    held: reason, or None if free."""

    group: str
    name: str
    unit: str
    nominal: float | None
    correction: float | None
    value: float | None
    uncertainty: float | None
    held: str | None = None

    @property
    def label(self) -> str:
        return f"hand-eye {self.name}" if self.group.startswith("Hand-eye") else self.name


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """Measured minus predicted.

    Attributes
    ----------
    pose, ball : ndarray
        (M,) ids.
    phase : ndarray
        (M,) str.
    xyz : ndarray
        (M, 3) mm.
    weighted : ndarray or None
        (M, r), of unit variance if all is well, or None.
    outlier : ndarray or None
        (M,) bool, left out of the fit, or None.
    station : ndarray or None
        (M,) str.
    q_deg : ndarray or None
        (M, n) joint angles of the pose; cm of an axis that slides.
    axes : tuple[str, ...]
        (n,) axes with their units.
    """

    pose: np.ndarray
    ball: np.ndarray
    phase: np.ndarray
    xyz: np.ndarray
    weighted: np.ndarray | None = None
    outlier: np.ndarray | None = None
    station: np.ndarray | None = None
    q_deg: np.ndarray | None = None
    axes: tuple[str, ...] = ()

    def used(self) -> Residuals:
        """Without what was left out of the fit, unless nothing would remain."""
        if self.outlier is None or not self.outlier.any() or self.outlier.all():
            return self
        keep = ~self.outlier
        return replace(self, **{f.name: v[keep] for f in fields(self) if isinstance(v := getattr(self, f.name), np.ndarray)})


@dataclass(frozen=True)
class Spheres:
    """Quality of the sphere fits: pose, ball (M,) ids, n_points (M,), rms_um (M,)."""

    pose: np.ndarray
    ball: np.ndarray
    n_points: np.ndarray
    rms_um: np.ndarray


@dataclass(frozen=True)
class AccuracyGrid:
    """Expected accuracy: centres (C, 3) mm of cells of edge cell_mm in the base, uncertainty_mm (C,) expanded uncertainty (k = 2) of a
    point there."""

    centres: np.ndarray
    uncertainty_mm: np.ndarray
    cell_mm: float


@dataclass(frozen=True, kw_only=True)
class Devices:
    """Timing and health of the devices.

    Attributes
    ----------
    late : ndarray or None
        (k,) late answers counted by the controller at each cycle.
    period_ms : ndarray or None
        (k,) from cycle to cycle on this computer.
    exposure_s : ndarray or None
        (e,) from one exposure to the next at a pose.
    state_s : list[tuple[str, float]]
        (state, seconds spent in it).
    gaps : list[str]
        Sentences on what the recording lacks and on warnings.
    health : list[tuple[str, str, str, str]]
        (quantity, lowest, highest, last).
    """

    late: np.ndarray | None = None
    period_ms: np.ndarray | None = None
    nominal_ms: float | None = None
    exposure_s: np.ndarray | None = None
    state_s: list[tuple[str, float]] = field(default_factory=list)
    gaps: list[str] = field(default_factory=list)
    health: list[tuple[str, str, str, str]] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class Coverage:
    """Joint angles q_deg (P, n), cm of an axis that slides, None of poses of a flange, limits_deg (n, 2) likewise, axes (n,) with their
    units, and phase (P,) str; flange (P, 3) mm in the base, or None;
    balls (M, 3) mm in the base with ball_phase (M,) str, or None. arm: (3 n, 3) mm, the links in the middle pose as ``arm_outline`` has
    them, or None; arm_radii: (n,) mm."""

    q_deg: np.ndarray | None
    limits_deg: np.ndarray | None
    phase: np.ndarray
    axes: tuple[str, ...] = ()
    flange: np.ndarray | None = None
    balls: np.ndarray | None = None
    ball_phase: np.ndarray | None = None
    arm: np.ndarray | None = None
    arm_radii: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class EffectContent:
    """One effect of a diagnosis.

    Attributes
    ----------
    parameters : list[tuple[str, str, str, str]]
        (name, value, expanded uncertainty, unit) as texts.
    gain : str
        Share of the excess over noise that it removes on held-out data; empty if none is stated.
    harmonics : tuple[list[str], list[list[str]]] or None
        Harmonics of a periodic effect, the heads of a table and a row a harmonic.
    alternatives : list[str]
        Sentences.
    trend : str
        Why no figure of it is shown.
    notes : list[str]
        What its parameters leave open.
    """

    title: str
    depends_on: str
    p_value: str
    gain: str
    parameters: list[tuple[str, str, str, str]]
    alternatives: list[str]
    harmonics: tuple[list[str], list[list[str]]] | None = None
    trend: str = ""
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class TrialContent:
    """What was found, tried on a recording of which nothing was learnt. heads of a table; rows: texts; words: how many columns at the left
    are words; notes: sentences."""

    recording: str
    heads: list[str]
    rows: list[tuple[str, ...]]
    words: int = 1
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class MotionChannel:
    """One joint of a channel as texts. noise: standard deviation; held_out, fitted: rms before and after the effects; chi2: per degree of
    freedom on the held-out data; remark: where its model is refused."""

    at: str
    noise: str
    held_out: tuple[str, str]
    chi2: tuple[str, str]
    fitted: tuple[str, str]
    remark: str = ""


@dataclass(frozen=True, kw_only=True)
class MotionKind:
    """One kind of channel. rows: a joint each; quantity, unit: of the axis of its charts; series: the drawn stretch of each joint."""

    title: str
    quantity: str
    unit: str
    rows: list[MotionChannel]
    series: list[ChannelSeries]


@dataclass(frozen=True, kw_only=True)
class DiagnosisContent:
    """A diagnosis of poses or of a motion in words and units.

    Attributes
    ----------
    mismatch
        (location, kind of channel or '', covariate, share of the excess over noise).
    small
        Number of further mismatches of small share.
    trials
        Trials on other recordings.
    validation
        (data, 3D rms before, after) with a row for the data fitted and one for the held-out data. Poses only.
    noise_floor
        Figures as expected from noise alone. Poses only.
    evidence_map
        (locations, covariates, strengths (a, c), NaN where nothing was tested). Poses only.
    curves, covariates, centres
        As in the file of pictures. Poses only.
    kinds
        Kinds of channels. Motion only.
    split
        How data were held out. Motion only.
    recordings
        Names of the recordings. Motion only.
    contradictions, both
        Statements in which the motion and the poses of the same run differ, and those that both make together (heading, lines).
    """

    level: str
    headline: str
    reason: str
    effects: list[EffectContent]
    mismatch: list[tuple[str, str, str, str]]
    trials: list[TrialContent]
    remarks: list[str]
    small: int = 0
    validation: list[tuple[str, str, str]] = field(default_factory=list)
    noise_floor: str = ""
    evidence_map: tuple[list[str], list[str], np.ndarray] | None = None
    curves: list[Mapping[str, Any]] = field(default_factory=list)
    covariates: list[Mapping[str, Any]] = field(default_factory=list)
    centres: Mapping[str, Any] | None = None
    kinds: list[MotionKind] = field(default_factory=list)
    split: str = ""
    recordings: list[str] = field(default_factory=list)
    contradictions: list[str] = field(default_factory=list)
    both: list[tuple[str, list[str]]] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class PartContent:
    """A part whose scans were merged. sentences: how well the scans agree, and how far the part is from its design. poses: of each of the
    k pairs of scans. before_mm, after_mm, expected_mm: (k,) 3D rms over the overlap of each pair. x_mm (a,), y_mm (b,), deviation_mm
    (b, a): map of the mean deviation from the design, NaN where there is no point; None without a design."""

    sentences: list[str]
    poses: list[str]
    before_mm: np.ndarray
    after_mm: np.ndarray
    expected_mm: np.ndarray
    x_mm: np.ndarray | None = None
    y_mm: np.ndarray | None = None
    deviation_mm: np.ndarray | None = None


@dataclass(frozen=True, kw_only=True)
class Content:
    """All that a report says. It is about the cell with the effects of its diagnosis, if the run has these, else about its geometry.
    earlier: the spacing without them, at the places of ``spacing``, where the cell has effects. arm_improved: of a run with
    corrected targets."""

    title: str
    subtitle: str
    verdict: ReportVerdict
    instrument: str = "scanner"
    facts: list[tuple[str, str]] = field(default_factory=list)
    fit: list[tuple[str, str]] = field(default_factory=list)
    figures: list[tuple[str, str, str, str, str]] = field(default_factory=list)
    spacing: Spacing | None = None
    budget: list[tuple[str, str, str]] = field(default_factory=list)
    one_sign: str = ""
    identity: list[tuple[str, str]] = field(default_factory=list)
    next: Action | None = None
    headlines: list[tuple[str, str, str]] = field(default_factory=list)
    parameters: list[ParameterRow] = field(default_factory=list)
    hand_eye: np.ndarray | None = None
    hand_eye_alone: bool = False
    residuals: Residuals | None = None
    noise: list[tuple[str, str]] = field(default_factory=list)
    observability: list[tuple[str, str]] = field(default_factory=list)
    not_separable: list[tuple[str, float]] = field(default_factory=list)
    correlation: tuple[list[str], np.ndarray] | None = None
    coverage: Coverage | None = None
    spheres: Spheres | None = None
    part: PartContent | None = None
    accuracy: AccuracyGrid | None = None
    devices: Devices | None = None
    camera: list[tuple[str, str]] = field(default_factory=list)
    images: list[tuple[str, str, str, str, str]] = field(default_factory=list)
    diagnosis: DiagnosisContent | None = None
    motion: DiagnosisContent | None = None
    earlier: Spacing | None = None
    arm_improved: ArmImprovement | None = None
    warnings: list[str] = field(default_factory=list)
    caveats: list[str] = field(default_factory=list)
    versions: list[tuple[str, str]] = field(default_factory=list)
    hashes: list[tuple[str, str, str]] = field(default_factory=list)
    plan_yaml: str = ""

    def next_step(self) -> tuple[str, str]:
        """What to do next and the command for it, as the terminal says it; two empty texts where the page has none."""
        return ("", "") if self.next is None else (self.next.what, self.next.command)

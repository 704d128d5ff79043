"""What a report says, as plain values: between the result file and the page. Lengths mm, angles deg; None or empty is left out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Verdict:
    """level: 'pass', 'fail', 'undecided' (within the measurement's uncertainty of the limit) or 'none' (nothing to judge by)."""

    level: str
    headline: str
    reason: str


@dataclass(frozen=True)
class Spacing:
    """Sphere spacing errors at the verification artefact. place: k names; certified: (k,) mm; before, after: (k,) mm signed;
    sigma: (k,) mm standard deviation that the fit expects, or None; limit: mm or None; more: further figures (label, text). independent:
    the poses took no part in the fit.
    """

    place: list[str]
    certified: np.ndarray
    before: np.ndarray
    after: np.ndarray
    sigma: np.ndarray | None = None
    limit: float | None = None
    more: list[tuple[str, str]] = field(default_factory=list)
    independent: bool = True


@dataclass(frozen=True)
class Parameter:
    """One identified parameter; nominal and value may be None where only the correction is known. held: reason, or None if free."""

    group: str
    name: str
    unit: str
    nominal: float | None
    correction: float | None
    value: float | None
    std: float | None
    held: str | None = None

    @property
    def label(self) -> str:
        return f"hand-eye {self.name}" if self.group.startswith("Hand-eye") else self.name


@dataclass(frozen=True)
class Residuals:
    """Measured minus predicted. pose, ball: (M,) ids; phase: (M,) str; xyz: (M, 3) mm; weighted: (M, r), of unit variance if all is well,
    or None; outlier: (M,) bool, left out of the fit, or None."""

    pose: np.ndarray
    ball: np.ndarray
    phase: np.ndarray
    xyz: np.ndarray
    weighted: np.ndarray | None = None
    outlier: np.ndarray | None = None


@dataclass(frozen=True)
class Coverage:
    """Joint angles q_deg (P, n), limits_deg (n, 2) and phase (P,) str; flange (P, 3) mm in the base, or None."""

    q_deg: np.ndarray
    limits_deg: np.ndarray | None
    phase: np.ndarray
    flange: np.ndarray | None = None


@dataclass(frozen=True)
class Content:
    title: str
    subtitle: str
    verdict: Verdict
    instrument: str = "scanner"
    facts: list[tuple[str, str]] = field(default_factory=list)
    fit: list[tuple[str, str]] = field(default_factory=list)
    spacing: Spacing | None = None
    parameters: list[Parameter] = field(default_factory=list)
    hand_eye: np.ndarray | None = None
    residuals: Residuals | None = None
    noise: list[tuple[str, str]] = field(default_factory=list)
    observability: list[tuple[str, str]] = field(default_factory=list)
    not_separable: list[tuple[str, float]] = field(default_factory=list)
    correlation: tuple[list[str], np.ndarray] | None = None
    coverage: Coverage | None = None
    warnings: list[str] = field(default_factory=list)
    versions: list[tuple[str, str]] = field(default_factory=list)
    plan_yaml: str = ""

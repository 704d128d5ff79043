"""Content of the pages about several recordings, as plain values: a fleet, and two recordings compared. Lengths mm, angles deg."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mbcacq.report.content import Action, Spacing


@dataclass(frozen=True, kw_only=True)
class FleetChart:
    """One figure of the N recordings of a type of arm.

    Attributes
    ----------
    arm
        (N,) index of the arm.
    value, std
        (N,) in ``unit``.
    deviation, limit
        (N,) deviation from the arm's centre line, and its limit, in ``unit``.
    outside
        (N,) bool.
    usual, permitted
        Median of the arms and the permitted distance from it, NaN where there are too few.
    unusual
        (A,) bool.
    """

    title: str
    unit: str
    arm: np.ndarray
    value: np.ndarray
    std: np.ndarray
    deviation: np.ndarray
    limit: np.ndarray
    outside: np.ndarray
    usual: float
    permitted: float
    unusual: np.ndarray


@dataclass(frozen=True)
class ArmTypeContent:
    """The arms of one type. recordings, times (ISO 8601 or ''): of the N recordings, sorted by arm and time."""

    robot: str
    arms: list[str]
    recordings: list[str]
    times: list[str]
    charts: list[FleetChart]


@dataclass(frozen=True, kw_only=True)
class FleetContent:
    """A fleet.

    Attributes
    ----------
    outliers : list[tuple[str, str, str, str, str, str]]
        (arm, recording, figure, difference, limit, their ratio).
    broken : list[tuple[str, str, str, str]]
        (arm, recording, status, reason).
    verdicts, effects : list[tuple[str, str]]
        (name, how often).
    unlisted : int
        Number of outliers and broken recordings that are in the table only.
    caveat : str
        A sentence that data are simulated; '' where none are.
    recordings : list[tuple[str, ...]]
        (arm, recording, date, poses, rms of the residuals, largest sphere spacing error, verdict or status).
    """

    headlines: list[tuple[str, str, str]]
    outliers: list[tuple[str, str, str, str, str, str]]
    broken: list[tuple[str, str, str, str]]
    verdicts: list[tuple[str, str]]
    effects: list[tuple[str, str]]
    types: list[ArmTypeContent]
    unlisted: int = 0
    caveat: str = ""
    recordings: list[tuple[str, ...]] = field(default_factory=list)


@dataclass(frozen=True, kw_only=True)
class ChangeRow:
    """One change that a figure shows. expanded: U with k = 2, in ``unit``; marked: it is beyond chance."""

    name: str
    unit: str
    change: float
    expanded: float
    marked: bool


@dataclass(frozen=True, kw_only=True)
class ChangesContent:
    """Two recordings compared.

    Attributes
    ----------
    names : tuple[str, str]
        Names of the recordings.
    charts : list[tuple[str, str]]
        (title, name) of the figures, whose rows ``rows`` has by that name.
    spacings : list[tuple[str, Spacing]]
        The verification of each recording that has one, by its name.
    table : list[tuple[bool, str, str, str, str, str]]
        (beyond chance, quantity, before, after, change, unit).
    """

    title: str
    names: tuple[str, str]
    headline: str
    reason: str
    changed: bool
    next: Action
    charts: list[tuple[str, str]]
    rows: dict[str, list[ChangeRow]]
    spacings: list[tuple[str, Spacing]]
    table: list[tuple[bool, str, str, str, str, str]]
    caveats: list[str]
    footer: str

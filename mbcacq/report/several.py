"""What is known of several recordings: a fleet with its control charts, and two recordings compared."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from mbcacq.errors import command_line
from mbcacq.model.json_text import AsJson, keyed
from mbcacq.quantities import fixed, in_degrees, measured, p_value, significant, symbol

TITLES = {"rms_mm": "rms of the residuals", "spacing_max_mm": "largest sphere spacing error"}  # others are shown by their name


@dataclass(frozen=True, kw_only=True)
class ControlChart:
    """One figure of the N recordings of one type of arm.

    Attributes
    ----------
    value, std : ndarray
        (N,) as calibrated, NaN where it was not.
    centre : ndarray
        (N,) centre line of the arm of each.
    limit : ndarray
        (N,) half width about it, NaN where an arm has one recording.
    arms : tuple[str, ...]
        Names (A,).
    arm : ndarray
        (N,) index into them.
    arm_value, arm_limit : ndarray
        (A,) each arm's centre and its permitted distance from ``usual``, the median of the arms (NaN: too few).
    """

    name: str
    value: np.ndarray
    std: np.ndarray
    arm: np.ndarray
    arms: tuple[str, ...]
    centre: np.ndarray
    limit: np.ndarray
    arm_value: np.ndarray
    arm_limit: np.ndarray
    usual: float

    @property
    def deviation(self) -> np.ndarray:
        return self.value - self.centre

    @property
    def outside(self) -> np.ndarray:
        """(N,) bool of the recordings outside the limits of their arm."""
        return np.abs(self.deviation) > self.limit

    @property
    def unusual(self) -> np.ndarray:
        """(A,) bool of the arms outside of what is usual among them."""
        return np.abs(self.arm_value - self.usual) > self.arm_limit

    @property
    def permitted(self) -> float:
        """Median of the permitted distances of the arms, NaN where there are too few."""
        return float(np.nanmedian(self.arm_limit)) if np.isfinite(self.arm_limit).any() else np.nan

    @property
    def farthest(self) -> float:
        """Largest distance from a centre line, in limits."""
        ratio = np.abs(self.deviation) / self.limit
        return float(np.nanmax(ratio)) if np.isfinite(ratio).any() else 0.0

    @property
    def title(self) -> str:
        return TITLES.get(self.name, self.name)

    @property
    def unit(self) -> str:
        """In which people read it, degrees for rad."""
        return scale_and_unit(self.name)[1]

    def as_read(self) -> ControlChart:
        """The chart in ``unit``."""
        scale = scale_and_unit(self.name)[0]
        lengths = ("value", "std", "centre", "limit", "arm_value", "arm_limit", "usual")
        return replace(self, **{name: scale * getattr(self, name) for name in lengths})


def scale_and_unit(name: str) -> tuple[float, str]:
    """Factor and unit in which a figure is shown."""
    angle = name.startswith(("theta", "alpha", "beta")) or name.rpartition(".")[2] in ("rx", "ry", "rz")
    return (in_degrees(1.0), "°") if angle else (1.0, "mm")


@dataclass(frozen=True)
class ArmTypeContent:
    """The arms of one type. recordings, times (ISO 8601 or ''): of the N recordings, sorted by arm and time."""

    robot: str
    arms: list[str]
    recordings: list[str]
    times: list[str]
    charts: list[ControlChart]


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


FALSE_ALARMS = 0.05  # of a whole comparison: shared out among its rows
# A bracket that was mounted anew moves a thousand times as far as an arm drifts, and would hide it on one axis.
CHARTS = (
    ("Lengths of the arm", "lengths", "parameter", "mm"),
    ("Angles of the arm", "angles", "parameter", "deg"),
    ("Hand-eye transform, translation", "mount-lengths", "hand-eye", "mm"),
    ("Hand-eye transform, rotation", "mount-angles", "hand-eye", "deg"),
)

WithU = Annotated[tuple[float, float | None], keyed("value", "U")]


@dataclass(frozen=True)
class Change(AsJson):
    """One quantity in both recordings, with expanded uncertainties (k = 2); None where a recording does not determine it.

    what: 'parameter', 'hand-eye', 'effect' or 'figure'. significant: the change is beyond what chance makes of that many rows.
    """

    what: str
    name: str
    unit: str
    before: WithU | None
    after: WithU | None
    change: WithU | None
    significant: bool = False
    why_not: str = ""

    @property
    def title(self) -> str:
        """The quantity as people read it: 'hand-eye x' of 'hand_eye.x', 'unmodelled A1 q1 order 2 [0]' of 'unknown:A1:q1:order 2[0]'."""
        if self.name.startswith("unknown:"):
            return self.name.replace("unknown:", "unmodelled ").replace(":", " ").replace("_", " ").replace("[", " [")
        return self.name.replace("hand_eye.", "hand-eye ")


@dataclass(frozen=True, kw_only=True)
class Together:
    """Test of all changes of arm and hand-eye together, with their whole covariances, against none; p_value is the probability of a
    larger chi2 where nothing changed.
    """

    chi2: float
    dof: int
    p_value: float


@dataclass(frozen=True, kw_only=True)
class RunComparison(AsJson):
    """What changed between two recordings of one arm.

    Attributes
    ----------
    names
        How the recordings are called, the earlier first.
    robot
        Name of the arm.
    rows
        A row a quantity.
    together
        Test of all changes of arm and hand-eye.
    leaning
        An older result does not say which prior of the links it used: the changes of the arm lean towards zero, and may be understated.
    """

    format: Literal["mbcacq-run-comparison/1"] = "mbcacq-run-comparison/1"
    names: Annotated[tuple[str, str], Field(alias="recordings")]
    robot: str
    together: Together
    leaning: bool = False
    rows: tuple[Change, ...]

    @property
    def changed(self) -> list[Change]:
        """The rows whose change is significant."""
        return [row for row in self.rows if row.significant]

    @property
    def sentences(self) -> list[str]:
        """What changed, and the test of everything together."""
        names = ", ".join(row.title for row in self.changed)
        out = [f"Changed beyond chance: {names}" if names else "No single quantity changed beyond chance"]
        all_of_it = self.together
        said = f"χ² {significant(all_of_it.chi2)} of {all_of_it.dof} degrees of freedom, {p_value(all_of_it.p_value)}"
        return [*out, f"Arm and hand-eye together: {said}"]

    @property
    def next_step(self) -> tuple[str, str]:
        """What to do next, and the command for it."""
        if self.changed or self.together.p_value < FALSE_ALARMS:
            return "ask what the later recording says of the cause", command_line("diagnose", self.names[1])
        return "calibrate both together, as of one arm", command_line("calibrate", *self.names)

    @property
    def how(self) -> str:
        """A sentence on what the changes of the arm rest on."""
        if self.leaning:
            return (
                "An older mbcacq wrote one of the results, which does not say which prior of the links it used: the changes of the arm "
                "lean towards zero, and may be understated; calibrate both recordings anew."
            )
        return "Values and changes of the arm are what each recording alone says, without the prior that a calibration has of its links."

    @property
    def table(self) -> list[tuple[bool, str, str, str, str, str]]:
        """(beyond chance, quantity, before, after, change, unit) of every row, in words and figures."""

        def text(row: Change, pair: tuple[float, float | None] | None) -> str:
            if pair is None:
                return "–"
            return fixed(1e3 * pair[0], 1) if row.what == "figure" else measured(*pair)

        return [
            (
                row.significant,
                row.title,
                text(row, row.before),
                text(row, row.after),
                text(row, row.change) if row.change is not None else row.why_not or "–",
                "µm" if row.what == "figure" else symbol(row.unit),
            )
            for row in self.rows
        ]

    @property
    def charts(self) -> list[tuple[str, str, list[Change]]]:
        """(title, name, rows) of each chart: changes of one kind and unit with their uncertainty."""
        units = dict.fromkeys(row.unit for row in self.rows if row.what == "effect")
        effects = [(f"Effects, {symbol(unit)}", f"effects-{k}", "effect", unit) for k, unit in enumerate(units)]
        each = [
            (title, name, [row for row in self.rows if (row.what, row.unit) == (what, unit) and row.change and row.change[1] is not None])
            for title, name, what, unit in (*CHARTS, *effects)
        ]
        return [chart for chart in each if chart[2]]

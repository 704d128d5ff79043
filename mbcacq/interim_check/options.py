"""The numbers that tune interim checks, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from mbcacq.quantities import DEGREE

Size = Annotated[float, Field(ge=0, allow_inf_nan=False)]


@dataclass(frozen=True, kw_only=True)
class UsualChanges:
    """Standard deviations of the changes of a cell from one day to the next, without a cause that anybody would look for.

    joint: rad, of each joint's zero; mount_mm, mount_rad: of the scanner on the flange, per axis; station_mm, station_rad: of an artefact
    that stays where it stands. source: where these figures are from.
    """

    joint: Size = 2e-6
    mount_mm: Size = 0.001
    mount_rad: Size = 3e-6
    station_mm: Size = 0.002
    station_rad: Size = 3e-6
    source: str = "usual figures: a kelvin or two of the room, on mounts of steel"


@dataclass(frozen=True, kw_only=True)
class CheckOptions:
    """Lengths mm, angles rad.

    The threshold follows from ``false_alarms``: an e-process exceeds 1 / alpha with a probability of at most alpha, ever (Ville 1939). Two
    are kept, since the calibration and since the first check, and share it.
    """

    poses: int = 12  # of a check; more notice little more, and take minutes
    fewest: int = 6  # below them hardly any change is told from another
    false_alarms: float = 0.01  # of an arm, over all of its checks
    # Of the calibration's noise (fewer exposures have more); the null is the best.
    noise_levels: tuple[float, ...] = (0.6, 0.8, 1.0, 1.25, 1.6, 2.0, 2.5)
    day_levels: tuple[float, ...] = (0.0, 1.0, 3.0, 10.0)  # of ``UsualChanges``; the null is the best of them
    sizes: tuple[float, ...] = (0.3, 2.0)  # of a usual change: a slight one and a plain one, equally probable
    onset_days: float = 100.0  # half of all changes begin within so many checks; later ones fade slowly, as 1 / day^2
    class_odds: float = 20.0  # a name is given alone where the next one is less probable by this
    hopeless: float = 40.0  # log odds of a level of noise against the best, from which on it takes no part beside the changes
    discrepancy: float = 1.5e-5  # rad, what a joint of a good arm is off beyond its calibrated model (one-sigma, by posture)
    mastering: float = 0.01 * DEGREE  # usual changes: a joint's zero after a new mastering or a slipped belt
    mount_mm: float = 0.05
    mount_rad: float = 0.02 * DEGREE
    station_mm: float = 0.1
    station_rad: float = 0.02 * DEGREE
    link_mm: float = 0.1  # a crash
    link_rad: float = 0.01 * DEGREE
    tool_kg: float = 1.0
    elastic: float = 2e-6  # rad/(N m), of a joint of an arm of 10 kg; a tool bends it
    unnamed: float = 3e-5  # rad of each joint, each pose by itself: what no name describes
    unnamed_mm: float = 0.01  # of each centre by itself, the same
    hypers: int = 3  # values of an effect's hyper-parameter that are tried
    station_rounds: int = 4  # Gauss-Newton steps for the place of an artefact
    usual_days: UsualChanges = field(default_factory=UsualChanges)


OPTIONS = CheckOptions()

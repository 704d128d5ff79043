"""What the poses of a flange say of the lengths that a target or a camera states: one more coefficient of the fit, the scale of places.

Only poses of a flange are asked for a scale, because links of an arm may err as a scale does. Balls of one scan show a scale by their
distances.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mbcacq.calibration.calibrated_cell import adjusted_cell
from mbcacq.calibration.description import SAME
from mbcacq.errors import CalibrationError
from mbcacq.estimation.adjustment import adjust_recording
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.estimation.terms import Part, own_errors, term
from mbcacq.model.observations import Observations
from mbcacq.quantities import K, measured

LEAST_CENTRES = 8  # fewer fit any scale
SURE = 5.0  # standard uncertainties by which a scale must differ from 1
MOST_WITH_SCALE = 0.8  # share of the misfit that may remain with it: errors of an arm may look a little like a scale
NAME = "target_scale"
ALL, DEPTH = (0, 1, 2), (2,)  # coordinates of the scanner's frame


@dataclass(frozen=True)
class TargetScale:
    """factor: by which places are to be multiplied; sigma: its standard uncertainty; before_mm, after_mm: rms misfit without it and with
    it."""

    factor: float
    sigma: float
    before_mm: float
    after_mm: float

    @property
    def contradicts(self) -> bool:
        """Whether the places as they are stated are wrong by that, beyond doubt."""
        return abs(self.factor - 1) > SURE * self.sigma and self.after_mm < MOST_WITH_SCALE * self.before_mm

    def __str__(self) -> str:
        return (
            f"stated lengths of the target; by the poses of the flange they are {measured(self.factor, K * self.sigma)} (k = 2) times that"
        )


def target_scale(o: Observations, axes: tuple[int, ...] = ALL) -> TargetScale | None:
    """The scale of the measured places, or of the one along the scanner's z, as the poses of a flange determine it; None for other cells,
    and where it is not determined."""
    if not o.cell.robot.of_flange_poses or np.bincount(o.pose).max(initial=0) != 1 or o.n_centres < LEAST_CENTRES:
        return None
    scale = term(NAME, [Part("point", 0, axis, -o.xyz[:, [axis]]) for axis in axes])
    plain = CalibrationOptions(kinematics=False, discrepancy=False, refuse=False, terms=own_errors(o))
    try:
        before, after = (adjusted_cell(x, adjust_recording(o, x)) for x in (plain, replace(plain, terms=(*plain.terms, scale))))
    except CalibrationError:
        return None
    if NAME not in after.names:
        return None
    at = after.names.index(NAME)
    rms = [float(np.sqrt(np.mean(np.sum(one.fit.residual[:, :3] ** 2, axis=1)))) for one in (before, after)]
    return TargetScale(1.0 + float(after.fit.coefficients[-1][0]), float(np.sqrt(after.covariance[at, at])), *rms)


def wrong_length(o: Observations) -> str:
    """A sentence on a stated length that the poses of a flange contradict: the scale that fits best, of all three coordinates or of the
    one along the scanner's z; '' if the places are as stated within their uncertainty, or most of the misfit stays with a scale."""
    size, depth = target_scale(o), target_scale(o, DEPTH)
    found = [one for one in (size, depth) if one is not None and one.contradicts]
    if not found:
        return ""
    best = min(found, key=lambda one: one.after_mm)
    what, cause, either = "the measured places", "the pitch or size of the target, or a unit", ""
    if best is depth:
        what, cause = "the measured places along z of the scanner", "the focal length or the depth scale of the camera"
        either = ", or a scale of all three coordinates" if size is not None and size.after_mm < SAME * best.after_mm else ""
    return (
        f"with {what} times {best.factor:.5f} ± {K * best.sigma:.1g} (k = 2) the residual falls from {best.before_mm:.3g} to "
        f"{best.after_mm:.3g} mm{either}: {cause} is wrong by that; correct it, and calibrate with it"
    )

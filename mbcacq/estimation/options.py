"""Options of a calibration: which parameters are free, which noise is assumed, how outliers are treated, and which poses are fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.terms import Term
from mbcacq.model.observations import Observations

METHODS = ("ml", "paper")
NOISE = ("auto", "given", "estimate")
PAIRS = ("one", "four", "all")


@dataclass(frozen=True)
class ArmPrior:
    """What other arms of one type say about the next one. robot: name of the type; nominal (n, 5): its MD-H rows in mm and rad; mean,
    sigma (n, 5): normal prior of the errors (value minus nominal), sigma inf where nothing was learnt; arms: how many were learnt from."""

    robot: str
    nominal: np.ndarray
    mean: np.ndarray
    sigma: np.ndarray
    arms: int


@dataclass(frozen=True, kw_only=True)
class CalibrationOptions:
    """How ``mbcacq.calibration.calibrate`` works.

    Attributes
    ----------
    method : str
        'ml' (everything at once, maximum likelihood) or 'paper' (stage by stage).
    pairs : str
        Which balls enter the distance constraint of method 'paper': 'one' pair, as printed; all pairs of the 'four' balls that make the
        virtual point; 'all' pairs of all balls.
    phases : tuple[str, ...] or None
        Use only poses of these phases; None: all but 'verification', or all if there is nothing else.
    kinematics : bool
        Identify MD-H errors; otherwise only hand-eye and stations (``--hand-eye-only`` of the command).
    random_links : bool
        The errors of the links of an arm that is to be identified have a common size for each kind, which is estimated; the poses then
        need not determine each of them. Without it they are free, for comparisons between arms or days.
    discrepancy : bool
        Take lacks of the model as a random effect beside the noise: the errors of the links of an arm that is not to be identified,
        smooth functions of posture of one that is. Without it, such an arm is exactly as nominal, and all that a model lacks counts as
        noise.
    hold, release : tuple[str, ...]
        Names of parameters to keep at their nominal value, or to free although they would be held ('d_2', 'hand_eye.rz').
    balls : bool
        Estimate the ball centres within the certificate's uncertainty.
    noise : str
        'auto' (a stated scanner noise is a prior of 30 %, joint repeatability is estimated), 'given' (stated figures are exact; joint
        repeatability from repeatability_mm), 'estimate' (stated figures are ignored).
    robust : bool
        Reject gross outliers (centres and poses).
    terms : tuple[Term, ...]
        Effects to estimate with everything else.
    displaced : tuple[tuple[Term, ndarray], ...]
        Effects that are known, with their coefficients.
    start : CellState or None
        State to start from, instead of a closed form.
    priors : tuple[ArmPrior, ...]
        Knowledge from other arms about this one; that of its type is used.
    refuse : bool
        Raise CalibrationError if the data leave undetermined what another recording could determine; otherwise such parameters are
        held, and named.
    """

    method: str = "ml"
    pairs: str = "four"
    phases: tuple[str, ...] | None = None
    kinematics: bool = True
    random_links: bool = True
    discrepancy: bool = True
    hold: tuple[str, ...] = ()
    release: tuple[str, ...] = ()
    balls: bool = True
    noise: str = "auto"
    robust: bool = True
    terms: tuple[Term, ...] = ()
    displaced: tuple[tuple[Term, np.ndarray], ...] = ()
    start: CellState | None = None
    refuse: bool = True
    priors: tuple[ArmPrior, ...] = ()

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ConfigError(f"there is no calibration method '{self.method}'; give one of {', '.join(METHODS)}")
        if self.pairs not in PAIRS:
            raise ConfigError(f"there is no choice of pairs '{self.pairs}'; give one of {', '.join(PAIRS)}")
        if self.noise not in NOISE:
            raise ConfigError(f"there is no noise option '{self.noise}'; give one of {', '.join(NOISE)}")


@dataclass(frozen=True)
class Noise:
    """The hierarchical noise. point: (3,) mm of a centre along the instrument's axes; joint: (n,) rad repeatability of each axis,
    which moves all centres of a pose together; turn: rad, of a measured orientation about each axis."""

    point: np.ndarray
    joint: np.ndarray
    turn: float = 1e-4

    def row_sigma(self, width: int) -> np.ndarray:
        """(R,) sigma of the rows of one centre."""
        return self.point[:width] if width <= 3 else np.concatenate([self.point, np.full(3, self.turn)])


def select_phases(obs: Observations, options: CalibrationOptions) -> Observations:
    """The poses to fit: of the phases asked for, else all but 'verification' where there are others."""
    if obs.phase is None:
        keep = np.ones(obs.n_poses, bool)
    elif options.phases is not None:
        keep = np.isin(obs.phase, options.phases)
    else:
        keep = obs.phase != "verification"
        keep = keep if keep.any() else ~keep
    if not keep.any() and options.phases:
        recorded = sorted(set([] if obs.phase is None else obs.phase.tolist()))
        raise ConfigError(f"there is no pose of phase {' or '.join(options.phases)}; these data have {', '.join(recorded)}")
    chosen = (obs if keep.all() else obs.select(keep)).measured()
    if not chosen.n_poses:
        asked = f" of phase {' or '.join(options.phases)}" if options.phases else ""
        raise CalibrationError(f"there is no pose with a measured centre{asked}; nothing can be calibrated")
    return chosen


def without_copies(obs: Observations) -> Observations:
    """Every exact copy of a pose once."""
    again = copies(obs)
    return obs.select(~np.isin(np.arange(obs.n_poses), again)) if len(again) else obs


def copies(obs: Observations) -> np.ndarray:
    """Indices of poses that are exact copies of an earlier one: the same station, angles, balls and every digit of the centres. They are no
    second measurement, which would differ by noise."""
    if len(np.unique(obs.q[:, 0])) == obs.n_poses:
        return np.zeros(0, dtype=int)
    _, first, of = np.unique(np.c_[obs.station, obs.q], axis=0, return_index=True, return_inverse=True)
    again = np.flatnonzero(first[of.ravel()] != np.arange(obs.n_poses))
    if not len(again):
        return again
    rows = {p: np.flatnonzero(obs.pose == p) for p in np.unique([*again, *first[of.ravel()[again]]])}
    seen: dict[tuple, int] = {}
    out = []
    for p in sorted(rows):
        measured = obs.xyz[rows[p]]
        key = (int(of.ravel()[p]), obs.ball[rows[p]].tobytes(), measured.tobytes())
        if len(measured) and seen.setdefault(key, p) != p:
            out.append(p)
    return np.array(out, dtype=int)

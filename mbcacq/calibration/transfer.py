"""A calibrated arm, with its effects, tried on a recording that it was not fitted to: another day, another placement of base and tool.

The arm and its effects stay as they were learnt. Base, tool and stations belong to the other recording alone and are fitted to it. Nothing
at all is fitted where its places are known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from pydantic import computed_field

from mbcacq.calibration.calibrate import calibrate, changed_while_recorded
from mbcacq.calibration.calibrated_cell import CalibratedCell, adjusted_cell
from mbcacq.calibration.held_out_poses import gross
from mbcacq.calibration.normalised_error import NormalisedError, all_phases, normalised_error
from mbcacq.calibration.parts_left_out import PartsLeftOut, TransferFigures, parts_left_out, reversed_joints
from mbcacq.calibration.published_cell import TWIST
from mbcacq.calibration.sufficiency import refuse_other_arm
from mbcacq.effects.effect_model import EffectModel
from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.estimation import parameters
from mbcacq.estimation.adjustment import Adjustment
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.linearization import Lineariser
from mbcacq.estimation.options import CalibrationOptions, select_phases
from mbcacq.estimation.parameters import Estimate
from mbcacq.estimation.pose_information import Weights
from mbcacq.estimation.solution import system
from mbcacq.geometry.chain import Chain
from mbcacq.model.json_text import AsJson, Number
from mbcacq.model.observations import Observations
from mbcacq.quantities import fixed, micrometres

PLACES = ("fitted", "known")
OVERLAPS = "overlaps"


@dataclass(frozen=True)
class EffectGain:
    """The gain of one effect on the other recording.

    Attributes
    ----------
    name : str
        Name of the effect.
    where : tuple of str
        Its locations.
    without_mm : float
        The rms without the effect.
    gain : float
        Share of the geometry's mean square that the effect removes; negative where it does harm.
    """

    name: str
    where: tuple[str, ...]
    without_mm: Number
    gain: Number


@dataclass(frozen=True, kw_only=True)
class Transfer(AsJson):
    """A calibrated cell tried on another recording.

    Attributes
    ----------
    place : str
        'fitted' (base, tool, stations of the recording), 'known' (nothing), or 'overlaps': the scans of a part were compared with each
        other. ``poses`` are then scans and ``centres`` overlaps of two, and chi2_dof is the mean of their squared steps over what the
        calibrated cell expects.
    own_geometry : TransferFigures or None
        Misfit of a geometric calibration of that recording itself, the best that geometry alone can do there; None if it cannot
        be had.
    normalised_error : NormalisedError or None
        Errors over their stated uncertainty. None with known places, since a result does not hold the correlation of the errors of its
        arm and of its places.
    parts_left_out : PartsLeftOut or None
        Misfit of left-out parts; None with known places, and where the recording learnt from left nothing open.
    warnings : tuple[str, ...]
        Sentences.
    fitted : str
        What was fitted to the recording, in words: of poses of a flange the place of the target alone, since the hand-eye transform is
        what is tried.
    robust : TransferFigures or None
        ``with_effects`` without gross centres, which neither the geometry alone nor the effects predict; None if there are none. All
        other figures include every centre: a tested cell must not select its own test.
    robust_centres : int
        The number of centres that are not gross.
    inside, outside : TransferFigures or None
        ``with_effects`` of the centres whose covariates are all within the ranges in which the effects were learnt, and of the others; None
        if all centres are of one kind.
    inside_centres : int
        The number of the former.
    """

    place: str
    poses: int
    centres: int
    geometry_alone: TransferFigures
    with_effects: TransferFigures
    own_geometry: TransferFigures | None
    effects: tuple[EffectGain, ...]
    normalised_error: NormalisedError | None
    warnings: tuple[str, ...] = ()
    recording: str = ""
    fitted: str = "base, tool and stations fitted"
    parts_left_out: PartsLeftOut | None = None
    robust: TransferFigures | None = None
    robust_centres: int = 0
    inside: TransferFigures | None = None
    outside: TransferFigures | None = None
    inside_centres: int = 0

    def __str__(self) -> str:
        return self.text

    @property
    def text(self) -> str:
        """The figures in plain sentences."""
        out = [
            *([f"Verdict: {self.judgement}."] if self.verdict != "none" else []),
            f"On {self.recording or 'the other recording'} ({self.tried_on}): {self._compared('rms_mm', micrometres)}.",
            f"  χ² per degree of freedom, under the noise that was learnt: {self._compared('chi2_dof', lambda value: fixed(value, 2))}",
        ]
        if self.robust:
            out.append(
                f"  robust {micrometres(self.robust.rms_mm)} over {self.robust_centres} of {self.centres} centres, with what was learnt"
            )
        if self.inside and self.outside:
            out.append(
                f"  where the effects were learnt {micrometres(self.inside.rms_mm)} ({self.inside_centres} centres), beyond that range "
                f"{micrometres(self.outside.rms_mm)} ({self.centres - self.inside_centres} centres)"
            )
        if left := self.parts_left_out:
            out.append(
                f"  on parts left out of the fit: {micrometres(left.as_learnt.rms_mm)} with base, tool and stations of the other parts; "
                f"{micrometres(left.drawn_anew.rms_mm)} where these also determine what the first recording could not"
            )
        out += [
            f"  {e.name} at {', '.join(e.where)}: without it {micrometres(e.without_mm)} ({e.gain:+.0%} of the geometry's mean square)"
            for e in self.effects
        ]
        if self.normalised_error:
            out.append(f"  error over stated uncertainty: {self.normalised_error.in_words}")
        return "\n".join([*out, *(f"  Note: {w}." for w in self.warnings)])

    @computed_field
    @property
    def verdict(self) -> str:
        """'agrees' if the errors are as large as the result states, 'contradicts' if they are larger than in 97.5 % of recordings of which
        the statement holds, 'none' if that is not known."""
        error = self.normalised_error
        if error is None or error.usual is None:
            return "none"
        return "contradicts" if error.rms > error.usual[1] else "agrees"

    @property
    def judgement(self) -> str:
        """The verdict as a sentence that can stand beside the result."""
        name, error = self.recording or "the other recording", self.normalised_error
        if self.verdict == "none" or error is None:
            return f"{name} does not say whether the stated uncertainty holds"
        if self.verdict == "agrees":
            return f"{name} agrees with the result: its errors are within the stated uncertainty"
        times = error.rms / (error.expected_rms or 1.0)
        return f"{name} contradicts the result: its errors are {times:.2g} times as large as stated"

    @property
    def tried_on(self) -> str:
        """Numbers of what it was tried on, in words."""
        if self.place == OVERLAPS:
            return f"{self.poses} scans, {self.centres} overlaps, each scan against the others"
        return f"{self.poses} poses, all {self.centres} centres, {self.fitted if self.place == 'fitted' else 'nothing fitted'}"

    def _compared(self, figure: str, shown: Callable[[float], str]) -> str:
        """One figure of the geometry, of the effects where there are any, and of a geometry fitted there."""
        learnt, effects = getattr(self.geometry_alone, figure), getattr(self.with_effects, figure)
        what = "hand-eye transform" if self.fitted == FITTED_OF_FLANGE else "geometry"
        text = f"{shown(learnt)} with the learnt {what}"
        if self.with_effects != self.geometry_alone:
            text += f" alone, {shown(effects)} with its effects"
        if self.own_geometry:
            text += f"; {shown(getattr(self.own_geometry, figure))} with a {what} fitted there"
        return text


FITTED_OF_FLANGE = "the target's place fitted, the hand-eye transform as it was learnt"


def check_transfer(
    observations: Observations, cell: CalibratedCell, alone: Chain | None = None, *, place: str = "fitted", recording: str = ""
) -> Transfer:
    """Try a calibrated cell on a recording. alone: the arm that geometry alone gave on the recording learnt from; by default the
    cell's own without its effects. With known places, poses at stations that the calibrated cell does not have are left out.

    Raises ConfigError if the recording is of another arm or none of its stations is known, CalibrationError if it does not
    determine its own places.
    """
    if place not in PLACES:
        raise ConfigError(f"there is no choice of places '{place}'; give one of {', '.join(PLACES)}")
    if observations.cell.length_scale:
        raise ConfigError("a result of distances is tried on poses of its own recording: mbcacq calibrate --held-out random")
    refuse_other_arm("the result is of", cell.robot, cell.nominal, observations.cell.robot, recording or "the recording")
    observations = select_phases(observations, CalibrationOptions(phases=all_phases(observations)))
    observations, left_out = at_known_stations(observations, cell) if place == "known" else (observations, ())
    model = cell.effects or EffectModel(observations.cell.robot)
    tried = _Trial(observations, cell, place)
    best = tried.fit(cell.state.chain, model)
    used, every = best.fit.used, np.ones(len(best.fit.used), bool)
    whole = tried.figures(best, every)
    without_effects = tried.fit(alone or cell.state.chain, None) if model else best
    plain = tried.figures(without_effects, every) if model else whole
    kept = ~gross(*(np.linalg.norm(one.fit.residual[:, :3], axis=1) for one in (best, without_effects)))
    gains = []
    grouped: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for t in model.terms:
        grouped.setdefault((t.name, ("all",)) if t.name == "unknown" else (t.name, t.where), []).append(t.key)
    for (name, where), keys in grouped.items() if len(grouped) > 1 else ():
        rest = model.select(lambda t, keys=keys: t.key not in keys)
        without = tried.figures(tried.fit(cell.state.chain, rest), every).rms_mm
        gains.append(EffectGain(name, where, without, (without**2 - whole.rms_mm**2) / max(plain.rms_mm**2, 1e-300)))
    warned_of = (*tried.changes(cell.state.chain, model), *left_out, *map(str, model.departures(observations)))
    inside = model.inside(observations)
    both = inside.any() and not inside.all()
    return Transfer(
        place=place,
        poses=observations.n_poses,
        centres=len(every),
        geometry_alone=plain,
        with_effects=whole,
        own_geometry=tried.own_geometry(every),
        effects=tuple(sorted(gains, key=lambda e: -e.gain)),
        normalised_error=normalised_error(best, cell, model, used) if place == "fitted" else None,
        warnings=(*warned_of, *reversed_loads(observations, cell), *model.absent(observations)),
        recording=recording,
        fitted=FITTED_OF_FLANGE if tried.of_flange_poses else Transfer.fitted,
        parts_left_out=tried.parts_left_out(best, model, used),
        robust=None if kept.all() else tried.figures(best, kept),
        robust_centres=int(kept.sum()),
        inside=tried.figures(best, inside) if both else None,
        outside=tried.figures(best, ~inside) if both else None,
        inside_centres=int(inside.sum()),
    )


def at_known_stations(obs: Observations, cell: CalibratedCell) -> tuple[Observations, tuple[str, ...]]:
    """The poses at stations whose places a calibrated cell has, and a sentence that names the other stations, if there are any.

    Raises ConfigError if there is no pose at a known station.
    """
    places = cell.station_places
    known = np.array([s.id in places for s in obs.cell.stations])[obs.station]
    if known.all():
        return obs, ()
    missing = [obs.cell.stations[s].id for s in np.unique(obs.station[~known])]
    if not known.any():
        raise ConfigError(
            f"no station of the recording ({', '.join(missing)}) has a known place in the calibrated cell; try it with --place fitted"
        )
    stations, have, are = ("station", "has", "is") if len(missing) == 1 else ("stations", "have", "are")
    sentence = (
        f"{stations} {', '.join(missing)} {have} no known place in the calibrated cell and {are} left out, with {np.sum(~known)} of "
        f"{obs.n_poses} poses; --place fitted judges them too"
    )
    return obs.select(known), (sentence,)


def reversed_loads(obs: Observations, cell: CalibratedCell) -> tuple[str, ...]:
    """A sentence on the joints that gravity turns one way here and hardly ever did where the arm was learnt, if there are any. Backlash and
    lost motion are a constant there."""
    found = reversed_joints(obs, cell)
    if not found:
        return ()
    names, largest = ", ".join(obs.cell.robot.axes[j] for j in found), max(float(there.mean()) for there in found.values())
    return (
        f"gravity turns {names} the other way at up to {largest:.0%} of the poses, and hardly ever did where the arm was learnt: backlash "
        "and lost motion of their gears do not show there; the uncertainty stated here contains the lost motion of a typical gear",
    )


@dataclass(frozen=True)
class _Trial:
    """Fits of what belongs to a recording alone."""

    obs: Observations
    cell: CalibratedCell
    place: str

    @property
    def of_flange_poses(self) -> bool:
        return self.obs.cell.robot.of_flange_poses

    def fit(self, chain: Chain, model: EffectModel | None) -> CalibratedCell:
        """Base, tool and stations for a given arm with given effects; with known places, everything as in the calibrated cell."""
        displaced = tuple(zip(model.at(self.obs), model.coefficients, strict=True)) if model else ()
        obs = with_arm(self.obs, chain)
        options = CalibrationOptions(
            kinematics=False, discrepancy=False, balls=False, refuse=False, displaced=displaced, phases=all_phases(obs)
        )
        if self.place == "fitted":
            if self.of_flange_poses:  # the hand-eye transform is what is tried
                learnt = replace(obs.cell, T_flange_scanner=self.cell.state.T_flange_scanner)
                obs, options = replace(obs, cell=learnt), replace(options, hold=TWIST)
            return calibrate(obs, options)
        known = self._known(obs)
        cell = known.cell
        placed = np.array([np.eye(4) if s.T_base_station is None else s.T_base_station for s in cell.stations])
        start = CellState(chain, cell.T_flange_scanner, placed, cell.ball_centres.copy())
        options = replace(options, hold=TWIST)
        lineariser = Lineariser(known, parameters.build(known, options), options)
        every = lineariser.everything
        at = system(lineariser, Estimate(start), self.cell.noise, every)
        distance = np.linalg.norm(at.residual[:, :3], axis=1)
        weights = replace(every, centre=(~gross(distance)).astype(float))
        return adjusted_cell(
            options, Adjustment(solution=at, noise=self.cell.noise, weights=weights, preliminary=start, found=[]), known_noise=True
        )

    def changes(self, chain: Chain, model: EffectModel) -> tuple[str, ...]:
        """A sentence on what changed while the recording was made, where something did."""
        displaced = tuple(zip(model.at(self.obs), model.coefficients, strict=True)) if model else ()
        change = changed_while_recorded(with_arm(self.obs, chain), displaced)
        return () if change is None else (f"something changed while that recording was made: {change.event}",)

    def _known(self, obs: Observations) -> Observations:
        """The recording with tool and stations where the calibrated cell has them."""
        places = self.cell.station_places
        found = tuple(replace(s, T_base_station=places[s.id], sigma_mm=1e-6) if s.id in places else s for s in obs.cell.stations)
        return replace(obs, cell=replace(obs.cell, stations=found, T_flange_scanner=self.cell.state.T_flange_scanner))

    def figures(self, fitted: CalibratedCell, used: np.ndarray) -> TransferFigures:
        """The figures of the centres used (M,), which have their share of the degrees of freedom that the fit has lost. With known places
        nothing was fitted.
        """
        fit, rank = fitted.fit, fitted.fit.rank if self.place == "fitted" else 0
        lineariser = Lineariser(fit.observations, fitted.layout, fit.options)
        weights = Weights(used.astype(float), np.ones(fit.observations.n_poses))
        whitened = system(lineariser, Estimate(fitted.state, fit.coefficients), self.cell.noise, weights).whitened_residual[used]
        return TransferFigures.of(fit.residual[used, :3], whitened, round(rank * float(used.mean())))

    def parts_left_out(self, placed: CalibratedCell, model: EffectModel, used: np.ndarray) -> PartsLeftOut | None:
        """The figures of parts predicted by the others; None with known places, which are not fitted."""
        return parts_left_out(placed, model, self.cell, used) if self.place == "fitted" and model else None

    def own_geometry(self, used: np.ndarray) -> TransferFigures | None:
        """The recording's own geometric calibration; None with known places, to which a geometry fitted there is no comparison."""
        if self.place == "known":
            return None
        try:
            options = CalibrationOptions(kinematics=not self.of_flange_poses, refuse=False, discrepancy=False, random_links=False)
            own = calibrate(self.obs, replace(options, phases=all_phases(self.obs)))
        except CalibrationError:
            return None
        return self.figures(own, used)


def with_arm(obs: Observations, chain: Chain) -> Observations:
    """The recording with another nominal arm."""
    return replace(obs, cell=replace(obs.cell, robot=replace(obs.cell.robot, chain=chain)))

"""Sphere spacing error: the distance of two certified balls, each measured through the arm, minus the certified distance.

Verification after the manner of VDI/VDE 2634 Part 3: probing error (form and size), sphere spacing error, length measuring error.

"After the manner of", because that guideline speaks of optical measuring systems by themselves and excludes sensors that are positioned by
axes. The quantities are formed as it forms them, on places and balls of the verification poses. A limit is held against each figure with
the uncertainty of measuring it in mind (``length_budget``): pass only where it keeps clear of it, fail only where it clearly exceeds it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np
from pydantic import computed_field

from mbcacq.calibration import notebook
from mbcacq.calibration.length_budget import LengthBudget
from mbcacq.effects.effect_model import EffectModel
from mbcacq.estimation.forward_model import CellState
from mbcacq.figure import Figure
from mbcacq.geometry import se3
from mbcacq.model.cell import ARTEFACT_IN_SCANNER
from mbcacq.model.json_text import EveryKey, fields_as_json
from mbcacq.model.observations import Observations
from mbcacq.quantities import K, fixed, measured, signed, uncertainty

End = tuple[np.ndarray, np.ndarray, int]  # of a length: q (1, n) rad, xyz (1, 3) mm in the scanner frame, number of poses averaged over


@dataclass(frozen=True, kw_only=True)
class VerifiedPair:
    """One pair of balls at one station. errors in mm, measured minus certified; expected_mm: standard uncertainty of ``after_mm`` that the
    calibration leaves, noise included; judging_mm: standard uncertainty of measuring the error, by which it is held against a limit."""

    station: str
    balls: tuple[int, int]
    certified_mm: float
    before_mm: float
    after_mm: float
    expected_mm: float | None = None
    judging_mm: float | None = None

    @property
    def beyond_expected(self) -> bool:
        """Whether the error is larger than its expanded expected uncertainty: the model lacks something there."""
        return beyond_expected(self.after_mm, self.expected_mm)


@dataclass(frozen=True)
class LengthErrors:
    """Errors (mm) at all places: mean and largest size, mean with its sign, and each."""

    mean_mm: float
    max_mm: float
    signed_mean_mm: float
    errors_mm: tuple[float, ...]

    @classmethod
    def of(cls, errors: np.ndarray) -> Self:
        size = np.abs(errors)
        return cls(float(size.mean()), float(size.max()), float(errors.mean()), tuple(errors.tolist()))


@dataclass(frozen=True, kw_only=True)
class JudgedFigure:
    """value_mm: largest of ``count`` values; uncertainty_mm: standard uncertainty of measuring it, None if unknown;
    verdict: 'pass', 'fail', 'undecided' (within the uncertainty of the limit) or 'none' (no limit or no data)."""

    name: str
    value_mm: float | None
    count: int
    uncertainty_mm: float | None
    limit_mm: float | None
    verdict: str


@dataclass(frozen=True, repr=False, kw_only=True)
class Verification(EveryKey):
    """Sphere spacing errors at every station, before and after calibration. The keys of its JSON are its fields and properties.

    Before means with the nominal arm and the preliminary hand-eye transform.

    Attributes
    ----------
    places
        One entry for each pair of balls at each station.
    limit_mm
        Largest error permitted, mm, or None.
    independent
        Whether none of the poses took part in the calibration; None: not known.
    figures
        Figures of ``judge``.
    common_mm
        Standard uncertainty of the mean signed error after calibration, mm, as far as it comes from the calibration and is common to all
        places.
    budget
        Terms of the uncertainty of judging, at the place where it is largest.
    """

    left_out = ("budget",)
    later = ("common_mm",)

    places: tuple[VerifiedPair, ...]
    limit_mm: float | None = None
    independent: bool | None = True
    figures: tuple[JudgedFigure, ...] = ()
    common_mm: float | None = None
    budget: LengthBudget | None = None

    def errors(self, which: str) -> np.ndarray:
        """Signed errors of all places.

        Parameters
        ----------
        which
            'before' or 'after' calibration.

        Returns
        -------
        (places,) ndarray
            In mm.
        """
        return np.array([getattr(p, f"{which}_mm") for p in self.places])

    @computed_field
    @property
    def before(self) -> LengthErrors:
        """With the nominal arm and the preliminary hand-eye."""
        return LengthErrors.of(self.errors("before"))

    @computed_field
    @property
    def after(self) -> LengthErrors:
        """Calibrated."""
        return LengthErrors.of(self.errors("after"))

    @computed_field
    @property
    def expected_mean_mm(self) -> float | None:
        """Mean size of error that is expected; None where no uncertainty is known."""
        expected = [p.expected_mm for p in self.places if p.expected_mm is not None]
        # For a normal error the mean of |error| is sqrt(2 / pi) of its standard deviation.
        return float(np.sqrt(2 / np.pi) * np.mean(expected)) if expected else None

    @computed_field
    @property
    def verdict(self) -> str:
        """'pass', 'fail', 'undecided' or 'none': the places held against the limit, each with its own uncertainty."""
        return verdict_of_places(self.errors("after"), [p.judging_mm for p in self.places], self.limit_mm)

    def to_dict(self) -> dict[str, Any] | None:
        """JSON content.

        Returns
        -------
        dict or None
            None if there was nothing to verify on.
        """
        return fields_as_json(self) if self.places else None

    def __repr__(self) -> str:
        if not self.places:
            return (
                "Nothing is verified: the recording has no poses that measure a certified distance. verify_elsewhere(OTHER, cell) tries "
                "the calibration on another recording."
            )
        before, after = (np.abs(self.errors(which)) for which in ("before", "after"))
        worst = int(after.argmax())
        largest = measured(after[worst], K * (self.places[worst].judging_mm or 0.0), "mm")
        return (
            f"Verification({len(self.places)} sphere spacings, mean {fixed(before.mean())} -> {fixed(after.mean())} mm, "
            f"largest {fixed(before.max())} mm -> {largest})"
        )

    def _repr_html_(self) -> str:
        rows = []
        for p in self.places:
            after = signed(p.after_mm) + (" (beyond expected)" if p.beyond_expected else "")
            judging, expected = (uncertainty(K * (u or 0.0)) for u in (p.judging_mm, p.expected_mm))
            rows.append((p.station, f"{p.balls[0]}-{p.balls[1]}", fixed(p.certified_mm, 4), signed(p.before_mm), after, judging, expected))
        header = ("station", "balls", "certified mm", "before mm", "after mm", "U of judging mm", "U expected mm")
        return notebook.table("Sphere spacing error, U with k = 2", header, rows) + notebook.paragraph(repr(self))

    def plot(self) -> Figure:
        """The sphere spacing errors before and after calibration.

        Returns
        -------
        Figure
            With U (k = 2) of judging each error.
        """
        labels = [f"{p.station}: {p.balls[0]}-{p.balls[1]}" for p in self.places]
        U = [K * (p.judging_mm or 0.0) for p in self.places]
        errors = {which: list(self.errors(which)) for which in ("before", "after")}
        return notebook.before_and_after("Sphere spacing error", labels, errors["before"], errors["after"], U)


class MeasuredPair(NamedTuple):
    """One pair of balls as two states of the cell have it. station: its index; ends: where each ball was measured."""

    station: int
    pair: VerifiedPair
    ends: tuple[End, End]


def measured_pairs(obs: Observations, before: CellState, after: CellState, effects: EffectModel | None = None) -> list[MeasuredPair]:
    """Every pair of balls at every station, with the cell before and after its calibration; ``effects`` belong to the second."""
    start, _ = ball_positions(obs, before)
    found, ends = ball_positions(obs, after, effects)
    certified = dict(zip(obs.cell.ball_ids, obs.cell.ball_centres, strict=True))
    out = []
    for station, a, b in pairs_of_balls(found):
        first, last = (float(np.linalg.norm(where[station, a] - where[station, b])) for where in (start, found))
        length, at = float(np.linalg.norm(certified[a] - certified[b])), obs.cell.stations[station].id
        pair = VerifiedPair(station=at, balls=(a, b), certified_mm=length, before_mm=first - length, after_mm=last - length)
        out.append(MeasuredPair(station, pair, (ends[station, a], ends[station, b])))
    return out


def stacked(ends: Sequence[End]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends as arrays: q (P, n) rad, xyz (P, 3) mm, numbers of poses (P,)."""
    q, xyz, count = zip(*ends, strict=True)
    return np.concatenate(q), np.concatenate(xyz), np.array(count)


def verification_of(pairs: Sequence[MeasuredPair], budgets: Sequence[LengthBudget], limit_mm: float | None) -> Verification:
    """The errors of measured pairs, with the budget of judging each."""
    places = tuple(replace(p.pair, judging_mm=budget.combined_mm) for p, budget in zip(pairs, budgets, strict=True))
    largest = max(budgets, key=lambda b: b.combined_mm, default=None)
    return Verification(places=places, limit_mm=limit_mm, budget=largest)


def verification_poses(obs: Observations) -> Observations:
    """The poses of phase 'verification'; without phases, those at stations of two-ball artefacts where there are other artefacts too."""
    if obs.cell.measurement != ARTEFACT_IN_SCANNER:
        return obs.select(np.zeros(obs.n_poses, bool))
    if obs.phase is not None and np.any(obs.phase == "verification"):
        return obs.select(obs.phase == "verification")
    sizes = np.array([len(obs.cell.artefact(s.artefact).ball_ids) for s in obs.cell.stations])
    keep = sizes[obs.station] == 2
    return obs.select(keep if not keep.all() else np.zeros(obs.n_poses, bool))


def points_in_base(obs: Observations, state: CellState, effects: EffectModel | None = None) -> np.ndarray:
    """(M, 3) mm: the measured points in the base, with the effects of arm and scanner taken into account where there are any."""
    moved = effects.displacements(obs) if effects else None
    q = obs.q if moved is None or moved.joint is None else obs.q + moved.joint
    T = state.chain.frames(q, None if moved is None else moved.frame)[:, -1] @ state.T_flange_scanner
    xyz = obs.xyz if moved is None or moved.point is None else obs.xyz - moved.point
    return se3.apply(T[obs.pose], xyz)


def ball_positions(obs: Observations, state: CellState, effects: EffectModel | None = None):
    """Mean place of each ball of each station in the base, over poses: {(station, ball id): (3,) mm}. Also the pose nearest to that mean
    with the number of poses, {(station, ball id): (q (1, n), xyz (1, 3), count)}."""
    base = points_in_base(obs, state, effects)
    station = obs.station[obs.pose]
    where, ends = {}, {}
    for s, b in np.unique(np.stack([station, obs.ball], axis=1), axis=0):
        rows = np.flatnonzero((station == s) & (obs.ball == b))
        key = int(s), obs.cell.ball_ids[b]
        where[key] = base[rows].mean(axis=0)
        best = rows[np.argmin(np.linalg.norm(base[rows] - where[key], axis=1))]
        ends[key] = obs.q[obs.pose[best]][None], obs.xyz[best][None], len(np.unique(obs.pose[rows]))
    return where, ends


def pairs_of_balls(where: Iterable[tuple[int, int]]) -> list[tuple[int, int, int]]:
    """(station, ball id, ball id) of every two balls of one station, of keys (station, ball id)."""
    keys = sorted(where)
    return [(s, a, b) for i, (s, a) in enumerate(keys) for t, b in keys[i + 1 :] if t == s]


def judge(observations: Observations, state: CellState, effects: EffectModel | None, verification: Verification) -> list[JudgedFigure]:
    """The four figures of a calibrated cell and its verification, from the verification poses (where there are none, only what can be said
    is said). The first is held against the verification's limit.

    Form: the range of distances from the fitted sphere cannot be had from centres; four times the rms of the fits (95 % of a normal
    distribution) stands for it. Size: needs measured diameters, which an observation set does not hold. Length: largest error
    between two balls of one station, over every pair of single scans, so that repeats do not average. Lengths are judged with the
    uncertainty of ``length_budget``.
    """
    obs, spacing, limit = verification_poses(observations), verification.errors("after"), verification.limit_mm
    sigma = None if verification.budget is None else verification.budget.combined_mm
    form = [4 * float(np.nanmax(obs.rms_mm))] if obs.rms_mm is not None and obs.n_centres and np.any(np.isfinite(obs.rms_mm)) else []
    points = 0.0 if obs.n_points is None or not obs.n_centres else float(np.min(obs.n_points))
    form_sigma = form[0] / np.sqrt(2 * points) if form and points > 1 else None
    judged = verdict_of_places(spacing, [p.judging_mm for p in verification.places], limit)
    return [
        replace(_figure("sphere spacing error", spacing, sigma), limit_mm=limit, verdict=judged),
        _figure("probing error, form (4 sigma of the sphere fits)", form, form_sigma),
        _figure("probing error, size", (), None),
        _figure("length measuring error (every pair of scans)", single_lengths(obs, state, effects), sigma),
    ]


def single_lengths(obs: Observations, state: CellState, effects: EffectModel | None) -> np.ndarray:
    """(K,) mm errors of the distance of two different balls of a station, for every pair of single measurements."""
    base = points_in_base(obs, state, effects)
    station, certified = obs.station[obs.pose], obs.cell.ball_centres
    out = []
    for s in np.unique(station):
        rows = np.flatnonzero(station == s)
        i, j = np.triu_indices(len(rows), 1)
        a, b = rows[i], rows[j]
        keep = obs.ball[a] != obs.ball[b]
        a, b = a[keep], b[keep]
        out.append(np.linalg.norm(base[a] - base[b], axis=1) - np.linalg.norm(certified[obs.ball[a]] - certified[obs.ball[b]], axis=1))
    return np.concatenate(out) if out else np.array([])


def verdict(value: float | None, sigma: float | None, limit: float | None) -> str:
    """'pass', 'fail', 'undecided' or 'none': the expanded uncertainty (k = 2) on either side of the limit decides (ISO 14253-1)."""
    if value is None or limit is None:
        return "none"
    margin = K * (sigma or 0.0)
    if value <= limit - margin:
        return "pass"
    return "fail" if value > limit + margin else "undecided"


def verdict_of_places(errors: np.ndarray, sigma: Sequence[float | None], limit: float | None) -> str:
    """The decision over all places: 'pass' where each passes, 'fail' where one fails, else 'undecided'; 'none' without limit or places."""
    each = [verdict(abs(float(e)), s, limit) for e, s in zip(errors, sigma, strict=True)]
    if not each or limit is None:
        return "none"
    return "fail" if "fail" in each else "undecided" if "undecided" in each else "pass"


def beyond_expected(error_mm: float, expected_mm: float | None) -> bool:
    """Whether an error is larger than the expanded uncertainty that is expected of it; False where none is known."""
    return expected_mm is not None and abs(error_mm) > K * expected_mm


def _figure(name: str, values: Sequence[float] | np.ndarray, sigma: float | None) -> JudgedFigure:
    value = float(np.abs(values).max()) if len(values) else None
    return JudgedFigure(name=name, value_mm=value, count=len(values), uncertainty_mm=sigma, limit_mm=None, verdict="none")

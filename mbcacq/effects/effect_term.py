"""An effect that was found, written down so that it can be kept in a file and evaluated, held or refitted on any recording."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Annotated, Any

import numpy as np
from pydantic import Field, FiniteFloat

from mbcacq.effects.covariates import OF_RECORDING, Covariates
from mbcacq.effects.described import evaluated
from mbcacq.effects.effect import Missing
from mbcacq.effects.functions import OF_CENTRES, DescribedPart
from mbcacq.effects.learnt_range import MOVEMENT, STANDSTILL, LearntRange, learnt_ranges, own_angle
from mbcacq.estimation.terms import PER_POSE, Part, Term, term
from mbcacq.model.json_text import EveryKey, InJson, Number, Vector, as_list
from mbcacq.model.observations import Observations

UNKNOWN = "unknown"
SMOOTH = "smooth"  # variant of those groups of a calibration's discrepancy that go on where the recording was not
GIVES_WAY = "rad/Nm"  # unit of what turns in proportion to a load
LAW_DEVIATION = 0.3  # share by which a gear's stiffness differs between small and large torques (K1, K2, K3 of data sheets)
BEYOND = "beyond"  # variant of the change to a cell without some unmodelled functions, which holds beyond their ranges
COMMON_PATTERN = "common pattern"  # variant of what several joints share: each learns of it in the range of the others


@dataclass(frozen=True)
class Anchor:
    """A pose by which a recording is known again: its number and its joint angles (rad)."""

    pose: int
    q: tuple[FiniteFloat, ...]


@dataclass(frozen=True)
class LearntRecording(EveryKey):
    """Features by which the recording from which effects were learnt is recognised.

    anchors: some of its poses. poses: numbers of all poses in the order of time. time_origin_s: time of
    the first; duration_s: from the first to the last.
    """

    anchors: tuple[Anchor, ...] = ()
    poses: tuple[int, ...] = ()
    time_origin_s: FiniteFloat = 0.0
    duration_s: FiniteFloat = 0.0

    @classmethod
    def of(cls, obs: Observations) -> LearntRecording:
        chosen = np.unique(np.linspace(0, obs.n_poses - 1, min(48, obs.n_poses)).astype(int))
        anchors = tuple(Anchor(int(obs.pose_id[p]), tuple(float(v) for v in obs.q[p])) for p in chosen)
        times = obs.time_s if obs.time_s is not None else np.zeros(1)
        order = tuple(int(i) for i in obs.pose_id[np.argsort(Covariates(obs).order)])
        return cls(anchors, order, float(np.min(times)), float(np.ptp(times)))

    def is_of(self, obs: Observations) -> bool:
        """Whether these poses belong to the recording: poses of the same numbers have the same joint angles."""
        mine = {anchor.pose: np.array(anchor.q) for anchor in self.anchors}
        same = [np.array_equal(mine[n], q) for n, q in zip(obs.pose_id.tolist(), obs.q, strict=True) if n in mine]
        return bool(same) and all(same)

    def ranks(self, obs: Observations) -> np.ndarray:
        """(P,) rank in time, in the recording learnt from, of the poses of a part of it."""
        position = {number: rank for rank, number in enumerate(self.poses)}
        return np.array([position.get(int(n), len(self.poses) - 1) for n in obs.pose_id], dtype=float)


def _or_none(sigma: np.ndarray) -> list[float | None]:
    return [float(s) if np.isfinite(s) else None for s in sigma]


Sigma = Annotated[
    np.ndarray, InJson(list[FiniteFloat | None], lambda each: np.array([np.inf if s is None else s for s in each]), _or_none)
]  # None in a file: there is none
Known = Annotated[np.ndarray, as_list(list[Number])]


@dataclass(frozen=True, kw_only=True, eq=False)  # arrays have no one truth value
class EffectTerm(EveryKey):
    """A parametric effect, or a group of basis functions of an unmodelled one, with its coefficients.

    name, where, depends_on, variant: as of the ``mbcacq.effects.effect.Candidate``; name is 'unknown' for an unmodelled effect.
    hyper: name of the hyper-parameter -> value, kept when the effect is refitted. parts: what is displaced, as functions of covariates.
    names, units: of the k coefficients. coefficients (k,), std (k,), typical size (k,); sigma (k,): prior standard deviation about zero,
    inf for none.
    ranges: covariate -> where it was in the recording learnt from. clamped: covariates that are held at the end of their learnt range
    beyond it: there the effect is a constant, as an error of the geometry is. laws: loads to which it is proportional beyond their learnt
    range too, with an uncertainty of its own there. held: whether something else than the poses determines the
    coefficients, which stay then where others are fitted.
    """

    left_out = ("held",)
    later = ("laws",)

    name: Annotated[str, Field(min_length=1)]
    where: tuple[str, ...]
    depends_on: str
    variant: str = ""
    hyper: Mapping[str, FiniteFloat] = field(default_factory=dict)
    parts: Annotated[tuple[DescribedPart, ...], Field(min_length=1)]
    names: Annotated[tuple[str, ...], Field(min_length=1)]
    units: tuple[str, ...]
    coefficients: Vector
    std: Known
    sigma: Sigma
    typical: Known
    ranges: Mapping[str, LearntRange] = field(default_factory=dict)
    clamped: tuple[str, ...] = ()
    laws: tuple[str, ...] = ()
    held: bool = False

    @classmethod
    def of_group(
        cls,
        here: Covariates,
        where: tuple[str, ...],
        depends_on: str,
        parts: Sequence[DescribedPart],
        sigma: np.ndarray,
        units: tuple[str, ...],
        variant: str = "",
        **fields: Any,
    ) -> EffectTerm:
        """A group of basis functions of which the recording has not said anything yet. sigma: (k,) prior; fields: clamped, hyper."""
        label, sizes = key_of(UNKNOWN, where, depends_on, variant, fields.get("hyper", {})), np.asarray(sigma, dtype=float)
        names, nothing = tuple(f"{label}[{j}]" for j in range(len(sizes))), np.zeros(len(sizes))
        fields |= {"where": where, "depends_on": depends_on, "parts": tuple(parts), "variant": variant, "units": units}
        fields |= {"ranges": learnt_ranges(here, parts), "sigma": sizes, "typical": sizes}
        return cls(name=UNKNOWN, names=names, coefficients=nothing, std=nothing, **fields)

    @property
    def k(self) -> int:
        """The number of coefficients."""
        return len(self.names)

    @property
    def key(self) -> str:
        """Identifies the term among all of a model."""
        return key_of(self.name, self.where, self.depends_on, self.variant, self.hyper)

    @property
    def covariates(self) -> frozenset[str]:
        """Names of everything that it is a function of."""
        return frozenset().union(*(part.covariates for part in self.parts))

    @property
    def periodic_in_own_angle(self) -> bool:
        """Whether it turns one joint by sines and cosines of that joint's own angle, as a group of the joint's own orders does."""
        own = {("joint", p.index) for p in self.parts} if all(p.place == "joint" for p in self.parts) else set()
        kinds = {f.kind for p in self.parts for column in p.columns for product in column for f in product.functions}
        return self.name != UNKNOWN and len(own) == 1 and kinds <= {"sin", "cos"} and self.covariates == {own_angle(self.where[0])}

    @property
    def bound_to_recording(self) -> bool:
        """Whether it depends on time, on the order of the poses or on a station: elsewhere it is as it was at the end. The trace of a
        movement depends on the speed and the pause of that recording: elsewhere there is none.
        """
        return bool(self.covariates & set(OF_RECORDING)) or any(name.startswith(MOVEMENT) for name in self.covariates)

    def parts_at(self, here: Covariates, learnt: LearntRecording) -> list[Part]:
        """Its parts at the poses and centres of a recording."""
        parts = self._going_on(here, learnt)
        if not self.fades:
            return parts
        share = [self._within(here, own) for own in self.parts]
        return [_times(p, 1 - w if self.variant == BEYOND else w) for p, w in zip(parts, share, strict=True)]

    def _going_on(self, here: Covariates, learnt: LearntRecording, held: Sequence[str] | None = None) -> list[Part]:
        """The parts without fading, with these covariates held in their learnt range; by default those that are ``clamped``."""
        same = learnt.is_of(here.obs) if self.bound_to_recording else True
        at_ends = self.clamped if held is None else held
        # A hundred functions are of one covariate: its values are looked up once.
        return evaluated(here, self.parts, cache(lambda name: self._value(here, learnt, name, same, at_ends)))

    @property
    def fades(self) -> bool:
        """Whether it shrinks to nothing outside of where it was learnt, in the covariates that are not held: a smooth function says nothing
        of what lies beyond its data.

        The discrepancy of a calibration has both. A joint's own error by periods a turn (``order k``) and the softening of a wind-up are
        known in the range of the data alone, and fade. Its other groups (variant ``SMOOTH``) go on, with the uncertainty of their
        coefficients. Wind-up is proportional to the torque beyond the recorded torques, too, and a coupling to the other joint's angle. A
        direction of arrival or a product of two first harmonics has no end of a range.
        """
        return self.name == UNKNOWN and self.variant not in (COMMON_PATTERN, SMOOTH) and GIVES_WAY not in self.units

    def _within(self, here: Covariates, part: DescribedPart) -> np.ndarray:
        """(rows,) of a part: 1 where its covariates that are not held are as they were when it was learnt, falling to nought beyond."""
        obs = here.obs
        per_pose = part.place in PER_POSE
        out = np.ones(obs.n_poses if per_pose else obs.n_centres)
        ending = self.depends_on.split("*") if self.variant == BEYOND else (part.covariates & set(self.ranges)) - set(self.clamped)
        for name in sorted(ending):
            if name in self.missing(here):
                continue
            own = self.ranges[name].within(name, here.value(name))
            out = out * (own if per_pose or name in OF_CENTRES else own[obs.pose])
        return out

    def term(self, here: Covariates, learnt: LearntRecording) -> Term:
        """The term of the estimation at the poses and centres of a recording."""
        return term(self.key, self.parts_at(here, learnt), self.names, self.units, self.sigma)

    @property
    def ends(self) -> bool:
        """Whether it has a range in which it was learnt, and a size by which it is uncertain beyond."""
        return bool(self.fades or self.clamped or self.laws) and bool(np.all(np.isfinite(self.sigma)))

    def beyond_learnt(self, here: Covariates, learnt: LearntRecording) -> Term:
        """What an effect that ``ends`` may be beyond the range in which it was learnt, beside what is predicted there: as its functions go
        on, with the size that it was found with, and of a law a share of that.
        """
        if self.variant == BEYOND:
            return replace(self.term(here, learnt), name=f"{self.key}:beyond", names=tuple(f"beyond {name}" for name in self.names))
        held, parts = self._going_on(here, learnt, (*self.clamped, *self.laws)), list[Part]()
        free = self._going_on(here, learnt, ()) if self.clamped or self.laws else held
        for at_end, on, own in zip(held, free, self.parts, strict=True):
            left = np.sqrt(np.maximum(1.0 - self._within(here, own) ** 2, 0.0)) if self.fades else np.zeros(len(at_end.basis))
            parts.append(replace(at_end, basis=on.basis - at_end.basis + left[:, None] * at_end.basis))
        sigma = self.sigma_elsewhere * (1.0 if self.clamped or self.fades else LAW_DEVIATION)
        return term(f"{self.key}:beyond", parts, tuple(f"beyond {name}" for name in self.names), self.units, sigma)

    def inside(self, here: Covariates) -> np.ndarray:
        """(M,) bool: centres at which every covariate that has a range is as it was where the effect was learnt."""
        obs, out = here.obs, np.ones(here.obs.n_centres, bool)
        at_ends = {*self.clamped, *self.laws}
        limited = at_ends | (self.covariates if self.name == UNKNOWN and self.variant != COMMON_PATTERN else set())
        for name in sorted(limited & set(self.ranges) - set(self.missing(here))):
            known, values = self.ranges[name], here.value(name)
            left = np.abs(known.held(name, values) - values) > known.margin(name) if name in at_ends else known.outside(name, values)
            out &= ~(left if name in OF_CENTRES else left[obs.pose])
        return out

    @property
    def sigma_elsewhere(self) -> np.ndarray:
        """(k,) standard deviation of the coefficients in another recording, of an effect that differs between recordings: as large as it
        was found, in typical sizes; an unmodelled effect has its estimated size. The prior is of what any machine has.
        """
        if self.name == UNKNOWN:
            return self.sigma
        size = float(np.sqrt(np.mean((self.coefficients**2 + self.std**2) / self.typical**2)))
        return np.minimum(size * self.typical, self.sigma)

    def missing(self, here: Covariates) -> tuple[str, ...]:
        """Covariates that a recording lacks; they are taken as they were on average when the effect was learnt."""
        out = []
        for name in sorted(self.covariates - set(OF_RECORDING)):
            if name.startswith(MOVEMENT):
                continue
            try:
                here.value(name)
            except Missing:
                out.append(name)
        return tuple(out)

    def _value(self, here: Covariates, learnt: LearntRecording, name: str, same: bool, held: Sequence[str]) -> np.ndarray:
        poses = here.obs.n_poses
        if name == "pose":
            return learnt.ranks(here.obs) if same else np.full(poses, float(len(learnt.poses) - 1))
        if name == "time":
            return here.obs.time_s - learnt.time_origin_s if same and here.obs.time_s is not None else np.full(poses, learnt.duration_s)
        if not same and (name == "station" or name.startswith(MOVEMENT)):
            return np.full(poses, -1.0 if name == "station" else 0.0)
        known = self.ranges.get(name)
        try:
            values = here.value(name)
        except Missing:
            rows = here.obs.n_centres if name in OF_CENTRES else poses
            return np.full(rows, 0.0 if name.startswith(STANDSTILL) or known is None else known.mean)
        return known.held(name, values) if name in held and known is not None else values


def key_of(name: str, where: Iterable[str], depends_on: str, variant: str, hyper: Mapping[str, float]) -> str:
    """The key of an effect at its hyper-parameters."""
    at = ",".join(f"{k}={v:.6g}" for k, v in hyper.items())
    return ":".join(part for part in (name, "+".join(where), depends_on, variant, at) if part)


def _times(part: Part, factor: np.ndarray) -> Part:
    return replace(part, basis=part.basis * factor[:, None])

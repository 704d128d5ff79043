"""The effects of an arm as a model: terms with their coefficients, evaluated at any pose, and what they were learnt from."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from mbcacq.effects.covariates import Covariates
from mbcacq.effects.effect_file import FORMAT, ArmInFile, EffectModelFile, check_effects, read_effects
from mbcacq.effects.effect_term import UNKNOWN, EffectTerm, LearntRecording
from mbcacq.effects.learnt_range import MOVEMENT, LearntRange, is_angle, learnt_ranges
from mbcacq.errors import ConfigError
from mbcacq.estimation.forward_model import Displacements
from mbcacq.estimation.terms import Term, accumulate
from mbcacq.geometry.chain import Chain
from mbcacq.model.cell import ARTEFACT_IN_SCANNER, Artefact, Cell, Measurement, RobotModel, Station
from mbcacq.model.json_text import fields_as_json
from mbcacq.model.observations import Observations

DRIFTED = "it changed in the course of the recording learnt from, and is taken as it was at its end"
SETTLED = "it is what movements left behind at the speed and with the pauses of the recording learnt from, and is left out"
NAMED_POSES = 8  # in a sentence
REPORTED_SHARE = 0.02  # of the poses that must leave a learnt range before that is said


@dataclass(frozen=True, kw_only=True)
class Departure:
    """A covariate that leaves the range in which effects were learnt. share: of the poses; effects: names with their location; poses:
    numbers of those that do.
    """

    covariate: str
    share: float
    low: float
    high: float
    effects: tuple[str, ...]
    poses: tuple[int, ...] = ()

    def __str__(self) -> str:
        scale, unit = (180 / np.pi, "°") if is_angle(self.covariate) else (1.0, " N·m" if "torque" in self.covariate else "")
        listed = ", ".join(map(str, self.poses[:NAMED_POSES])) + (", .." if len(self.poses) > NAMED_POSES else "")
        which = f" (numbers {listed})" if self.poses else ""
        return (
            f"{self.covariate} leaves the range in which {', '.join(self.effects)} was learnt at {self.share:.0%} of the poses{which}, "
            f"here {scale * self.low:.4g} to {scale * self.high:.4g}{unit}: no data support it there"
        )


@dataclass(frozen=True)
class EffectModel:
    """Effects that were found in recordings of one arm. robot: as it is nominally, by which covariates are computed."""

    robot: RobotModel
    terms: tuple[EffectTerm, ...] = ()
    learnt: LearntRecording = field(default_factory=LearntRecording)
    measurement: Measurement = ARTEFACT_IN_SCANNER

    def __bool__(self) -> bool:
        return bool(self.terms)

    @property
    def coefficients(self) -> tuple[np.ndarray, ...]:
        """One (k,) array for each term."""
        return tuple(t.coefficients for t in self.terms)

    @property
    def parametric(self) -> EffectModel:
        """The model without its unmodelled part."""
        return self.select(lambda t: t.name != UNKNOWN)

    def select(self, wanted) -> EffectModel:
        """The terms for which ``wanted(term)`` holds."""
        return replace(self, terms=tuple(t for t in self.terms if wanted(t)))

    def with_coefficients(self, coefficients: Sequence[np.ndarray], std: Sequence[np.ndarray]) -> EffectModel:
        """The same terms with other coefficients."""
        terms = tuple(replace(t, coefficients=c, std=s) for t, c, s in zip(self.terms, coefficients, std, strict=True))
        return replace(self, terms=terms)

    def at(self, obs: Observations) -> tuple[Term, ...]:
        """The terms of the estimation at the poses and centres of a recording."""
        here = Covariates(obs)
        return tuple(t.term(here, self.learnt) for t in self.terms)

    def left_out_at(self, obs: Observations) -> tuple[Term, ...]:
        """The terms that differ between recordings, for another recording than the one learnt from, as functions of its own covariates.

        ``at`` leaves them out, or takes them as they were at the end; there they are as large as they were found, with coefficients of
        which nothing else is known. So are effects beyond where they were learnt.
        """
        if self.learnt.is_of(obs):
            return ()
        here, own = Covariates(obs), LearntRecording.of(obs)
        beyond = tuple(t.beyond_learnt(here, self.learnt) for t in self.terms if t.ends and not t.inside(here).all())
        bound = [t for t in self.terms if t.bound_to_recording and np.all(np.isfinite(t.sigma)) and not t.missing(here)]
        # Stations are fitted, or known.
        return (*(replace(t, sigma=t.sigma_elsewhere).term(here, own) for t in bound if "station" not in t.covariates), *beyond)

    def beyond(self, obs: Observations) -> tuple[Term, ...]:
        """What effects may be at the poses of a recording beyond where they were learnt, as random effects beside ``at``; the same terms
        for any recording."""
        here = Covariates(obs)
        return tuple(t.beyond_learnt(here, self.learnt) for t in self.terms if t.ends)

    def displacements(self, obs: Observations) -> Displacements | None:
        """What the effects displace at the poses and centres of a recording; None if there are none."""
        return accumulate(obs, self.at(obs), self.coefficients) if self.terms else None

    def frames(self, chain: Chain, q: np.ndarray, obs: Observations | None = None) -> np.ndarray:
        """(P, n+1, 4, 4) frames of an arm with its effects at joint angles q (P, n) rad. obs: the recording of these poses, where there is
        one: what is recorded of them besides the angles (direction, temperature, time) counts then.
        """
        moved = self.displacements(obs if obs is not None else self.poses(q))
        if moved is None:
            return chain.frames(q)
        return chain.frames(q if moved.joint is None else q + moved.joint, moved.frame)

    def poses(self, q: np.ndarray) -> Observations:
        """Joint angles q (P, n) rad as a recording of nothing but poses."""
        tool = Artefact("none", "none", (0,), np.zeros((1, 3)), np.ones(1))
        cell = Cell(self.robot, np.eye(4), (tool,), (Station("none", "none"),), measurement=self.measurement)
        number = np.full(len(q), -1)
        none = np.zeros(0, dtype=int)
        return Observations(cell, number, np.zeros(len(q), dtype=int), np.asarray(q, dtype=float), none, none, np.zeros((0, 3)))

    def inside(self, obs: Observations) -> np.ndarray:
        """(M,) bool: centres of a recording that lie where all effects were learnt."""
        here, out = Covariates(obs), np.ones(obs.n_centres, bool)
        for t in self.terms:
            out &= t.inside(here)
        return out

    def learnt_at(self, obs: Observations) -> EffectModel:
        """The model with the ranges of a recording to which it is fitted anew."""
        here = Covariates(obs)
        return replace(self, terms=tuple(replace(t, ranges={**t.ranges, **_ranges(t, here)}) for t in self.terms))

    def departures(self, obs: Observations) -> list[Departure]:
        """Covariates of a recording that leave their learnt range, largest share first."""
        here = Covariates(obs)
        found: dict[str, tuple[float, float, float, list[str]]] = {}
        where: dict[str, np.ndarray] = {}
        for t in self.terms:
            for name, known in t.ranges.items():
                if name in t.missing(here):
                    continue
                values = here.value(name)
                left = known.outside(name, values)
                share = float(np.mean(left))
                if share > REPORTED_SHARE:
                    entry = found.setdefault(name, (share, float(values.min()), float(values.max()), []))
                    entry[3].append(f"{t.name} at {'+'.join(t.where)}")
                    rows = np.flatnonzero(left) if len(left) == obs.n_poses else np.unique(obs.pose[left])
                    where[name] = np.union1d(where.get(name, rows), rows)
        out = []
        for name, (share, low, high, effects) in found.items():
            poses = tuple(obs.pose_id[where[name]].tolist())
            named = tuple(dict.fromkeys(effects))[:4]
            out.append(Departure(covariate=name, share=share, low=low, high=high, effects=named, poses=poses))
        return sorted(out, key=lambda d: -d.share)

    def absent(self, obs: Observations) -> list[str]:
        """Sentences on covariates that a recording lacks, and on effects that belong to the recording they were learnt from."""
        here = Covariates(obs)
        lacking = {name: t for t in self.terms for name in t.missing(here)}
        out = [f"{name} is not recorded here: {t.name} is taken as it was on average" for name, t in lacking.items()]
        if not self.learnt.is_of(obs):
            bound = [t for t in self.terms if t.bound_to_recording]
            settling = [t for t in bound if t.depends_on.startswith(MOVEMENT)]
            drifting = [t for t in bound if t not in settling]
            for those, why in ((drifting, DRIFTED), (settling, SETTLED)):
                if those:
                    out.append(f"{', '.join(dict.fromkeys(_placed(t) for t in those))}: {why}")
        return out

    def to_dict(self) -> dict[str, Any]:
        """JSON content, format 'mbcacq-effect-model/1'."""
        return fields_as_json(self.file)

    @property
    def file(self) -> EffectModelFile:
        """The model as a file holds it; the order of all poses only where a term depends on it."""
        bound = any("pose" in t.covariates for t in self.terms)
        learnt = self.learnt if bound else replace(self.learnt, poses=())
        arm = ArmInFile.of(self.robot)
        return EffectModelFile(format=FORMAT, measurement=self.measurement, robot=arm, learnt=learnt, terms=self.terms)

    @classmethod
    def of_file(cls, file: EffectModelFile, source: str = "the model of effects", key: str = "") -> EffectModel:
        """The model that a file holds; source and key as of ``from_dict``. Raises ConfigError if an index in it is beyond the arm."""
        check_effects(file, source, key)
        return cls(file.robot.robot, file.terms, file.learnt, file.measurement)

    @classmethod
    def from_dict(cls, content: Mapping[str, Any], source: str = "the model of effects", key: str = "") -> EffectModel:
        """The model that ``to_dict`` wrote. source: how a message calls the file; key: under which the model is in it. Raises ConfigError
        where it is none, or damaged.
        """
        return cls.of_file(read_effects(content, source, key), source, key)


def combined(models: Iterable[EffectModel]) -> EffectModel:
    """Several models of one arm as one; a term of the same key stands once, as in the last of them. Raises ConfigError for two arms."""
    several = list(models)
    if len({m.robot.name for m in several}) > 1:
        raise ConfigError(f"these effects are of several arms: {', '.join(m.robot.name for m in several)}; give those of one")
    terms = {t.key: t for m in several for t in m.terms}
    return replace(several[-1], terms=tuple(terms.values()))


def _ranges(t: EffectTerm, here: Covariates) -> dict[str, LearntRange]:
    """The ranges of the covariates of a term in a recording, of those that it has."""
    lacking = set(t.missing(here))
    return learnt_ranges(here, [part for part in t.parts if not part.covariates & lacking])


def _placed(t: EffectTerm) -> str:
    return f"{t.name} at {'+'.join(t.where)}"

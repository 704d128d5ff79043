"""A run has both: poses at standstill and the motion between them. The findings of both about one effect are compared, in one vocabulary.

1. The parameters of the motion are put into the words of the poses (``Declaration.in_terms_of_poses``): a balancer's torque, say, becomes
   the angle by which it winds A2 up.
2. Every parameter that both state is compared. Values that differ by more than three combined standard deviations contradict each other.
3. Where one of them cannot tell two effects apart, and the other, or the evidence of both, names one of these, that one is named.
4. Effects of which the motion is sure are given to the poses as their prior (``given_effects``), and these are searched again. Effects that
   show only through or beside them are found then.
5. The evidences of both multiply (``joint_sets``): both together may show and decide what neither does alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from mbcacq.diagnosis.effect_found import EffectFound
from mbcacq.diagnosis.evidence.between_sets import averaged
from mbcacq.diagnosis.findings import CURE, READABLE, ComparedEffect, ComparedSet, EvidenceSummary, GivenEvidence, NotSeparable, Verdict
from mbcacq.diagnosis.motion.joint_sets import (
    DecidedPair,
    JointEvidence,
    JointSet,
    ParameterAgreement,
    distance_of,
    joint_evidence,
    log_odds_of,
    named_side,
    not_excluded,
    paired,
)
from mbcacq.diagnosis.motion.load_error import ARM
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.diagnosis.motion.result import MotionDiagnosis
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.effects import catalogue
from mbcacq.effects.effect import Parameters, label_of, parameter_in_words
from mbcacq.effects.in_words import effect_in_words
from mbcacq.errors import ConfigError
from mbcacq.model.json_text import EveryKey, fields_as_json, from_document

VERDICT_OF_BOTH = {
    "none": "no effect.",
    "explained": "effects explain what both show.",
    "partly_explained": "named effects explain a part of what both show; the rest is unmodelled.",
    "unexplained": "there is a mismatch that no effect of the catalogue describes.",
    "cannot_tell": "these data do not decide between the possible causes.",
}
MOST_TOGETHER = 6  # joint sets that are reported
RARE = 1e-6  # odds below which an alternative counts as that rare: its logarithm stays finite


@dataclass(frozen=True, kw_only=True)
class JointVerdict(JointEvidence):
    """What poses and motion show as one problem, and the verdict on the run."""

    verdict: Verdict


@dataclass(frozen=True, kw_only=True)
class BothInFile(EveryKey):
    """The keys that the motion between the poses adds to a diagnosis of these. agreement: of what both found; decided: by one where the
    other cannot tell."""

    left_out = ("given_motion", "motion", "agreement", "decided", "together")

    given_motion: GivenEvidence | None = None
    motion: MotionDiagnosis | None = None
    agreement: tuple[ParameterAgreement, ...] | None = None
    decided: tuple[DecidedPair, ...] | None = None
    together: JointVerdict | None = None


@dataclass(frozen=True, eq=False)
class PosesAndMotion:
    """The findings in the poses of a run and in the motion between them. given: the evidence of the poses with what the motion is sure of
    as their prior, where they were searched so.
    """

    poses: Diagnosis
    motion: MotionDiagnosis
    given: GivenEvidence | None = None

    @classmethod
    def of_json(cls, content: Mapping[str, Any]) -> PosesAndMotion:
        """From a diagnosis as it is written, with its ``motion``. Raises ConfigError if that is damaged."""
        beside = from_document(BothInFile, content, READABLE, "the diagnosis", "diagnosis", CURE)
        if beside.motion is None:
            raise ConfigError("the diagnosis is of poses alone; diagnose a run that recorded the motion between them")
        return cls(Diagnosis.from_json(content), beside.motion, beside.given_motion)

    def to_json(self) -> dict[str, Any]:
        """The keys of the document of a diagnosis that a motion adds (``BothInFile``)."""
        joint, agreement, decided = self.together, tuple(self.agreement), tuple(self.decided)
        verdict = JointVerdict(verdict=self.verdict, **{f.name: getattr(joint, f.name) for f in fields(joint)})
        both = BothInFile(given_motion=self.given, motion=self.motion, agreement=agreement, decided=decided, together=verdict)
        return fields_as_json(both)

    @cached_property
    def verdict(self) -> str:
        """The verdict on a run: 'cannot_tell' where poses and motion contradict each other, or one of them cannot tell and both together
        cannot either; else what is explained of both.
        """
        each, both = {self.poses.verdict, self.motion.verdict}, self.together
        if any(not a.agrees for a in self.agreement):
            return "cannot_tell"
        if "cannot_tell" in each and not (both.decided and (both.significant or not both.sets[0].effects)):
            return "cannot_tell"
        loads = [pair for pair in self.motion.not_separable if ARM in pair.effects]
        if self.motion.verdict == "cannot_tell" and any(self._named(pair) is None for pair in loads):
            return "cannot_tell"
        named = bool(both.reported) or bool(each & {"explained", "partly_explained"})
        if each & {"unexplained", "partly_explained"}:
            return "partly_explained" if named else "unexplained"
        return "explained" if named else "none"

    @cached_property
    def agreement(self) -> list[ParameterAgreement]:
        """Every parameter that both found.

        If the poses were searched with the motion's values, the values over all joint sets that are not excluded are compared.
        """
        out = []
        for effect in self.beside_motion:
            for where, other in self.in_terms_of_poses.get(effect.name, []):
                if "." not in next(iter(effect.parameters), ".") and set(where) != set(effect.where):
                    continue  # the names of its parameters do not tell where it is
                for key, mine, theirs in paired(effect.parameters, other):
                    sigmas = distance_of(key, mine, theirs)
                    out.append(ParameterAgreement(effect.name, where, key, mine, theirs, sigmas, sigmas <= NUMBERS.agreement_sigmas))
        return out

    @property
    def contradictions(self) -> list[str]:
        """Sentences, in front of everything else, on what poses and motion state differently."""
        out = []
        for a in self.agreement:
            if not a.agrees:
                poses_say, motion_says = a.stated()
                out.append(
                    f"Poses and motion contradict each other on {a.label}: {poses_say} by the poses and {motion_says} by the motion "
                    f"({a.sigmas:.1f} sigma). One of them has another cause: use neither value until it is found."
                )
        return out

    @cached_property
    def beside_motion(self) -> Sequence[EffectFound | ComparedEffect]:
        """The effects of the poses: those in the most probable joint set where the poses were searched with what the motion states, else
        those of the poses alone.
        """
        if self.given is None or not self.together.sets:
            return self.poses.effects
        evidence = self.given.evidence
        one = evidence.part_of(self.together.sets[0].effects)
        return self.poses.effects if one is None else over_joint_sets(one, evidence, self._joint.sets)

    @property
    def given_by_motion(self) -> list[ComparedEffect]:
        """Effects of which the motion is sure, in the words of the poses: those in every set that its evidence does not exclude."""
        sure: set[str] = set()
        for one in self.motion.evidence:
            likely = [s for s in one.evidence.sets if s.log_odds > np.log(OPTIONS.undecided)]
            sure |= set.intersection(*({e.label for e in s.effects} for s in likely)) if likely else set()
        stated = [ComparedEffect(name, where, p) for name, found in self.in_terms_of_poses.items() for where, p in found]
        return [one for one in stated if one.label in sure]

    @cached_property
    def every(self) -> Parameters:
        """All parameters of both; those of the motion, where both have one."""
        return {key: p for effect in (*self.poses.effects, *self.motion.named_effects) for key, p in effect.parameters.items()}

    @cached_property
    def in_terms_of_poses(self) -> dict[str, list[tuple[tuple[str, ...], Parameters]]]:
        """Name of an effect of the motion -> its locations and its parameters in the words of the poses."""
        out: dict[str, list[tuple[tuple[str, ...], Parameters]]] = {}
        for effect in self.motion.named_effects:
            out.setdefault(effect.name, []).append((effect.where, translated(effect.name, effect.parameters, self.every)))
        return out

    @cached_property
    def decided(self) -> list[DecidedPair]:
        """Pairs that one diagnosis cannot tell apart and of which the other, or both together, name exactly one."""
        pairs = (*self.poses.not_separable, *self.motion.not_separable)
        return [found for pair in pairs if (found := self._named(pair)) is not None]

    def _named(self, pair: NotSeparable) -> DecidedPair | None:
        """What is named of effects that one diagnosis cannot tell apart; None if that is not exactly one."""
        diagnosis, by = (self.poses, "poses") if pair in self.motion.not_separable else (self.motion, "motion")
        found = diagnosis.effects if by == "poses" else self.motion.named_effects
        named = named_side(pair, labels_of((e.name, e.where) for e in found))
        if not named:
            # Of the joint set, where that is the only one.
            sides = named_side(pair, self.together.reported) if self.together.decided else []
            named, by = self._load_by_both(pair) if ARM in pair.effects else sides, "both"
        return DecidedPair(pair.effects, named[0], by) if len(named) == 1 else None

    def _load_by_both(self, pair: NotSeparable) -> list[str]:
        """The load, or the masses of the arm in its place in the motion: the one that poses and motion make twenty times as probable."""
        first, second = pair.effects
        load, odds = (second, 1.0) if first == ARM else (first, -1.0)
        own = sum(_own_log_odds(load, one.evidence) for one in self.motion.evidence)
        both = log_odds_of(load, ((one.effects, one.log_odds) for one in self._joint.sets))
        log = odds * float(np.log(max(pair.odds or 0.0, RARE))) + both - own
        least = -float(np.log(OPTIONS.undecided))
        if log > least and load in self.together.reported:
            return [load]
        return [ARM] if log < -least else []

    @property
    def together(self) -> JointEvidence:
        """The evidence of poses and motion as one problem, by their most probable sets; no set where one of them has no evidence."""
        return replace(self._joint, sets=self._joint.sets[:MOST_TOGETHER])

    @cached_property
    def _joint(self) -> JointEvidence:
        """The same with all sets."""
        if self.poses.evidence is None or not self.motion.evidence:
            return JointEvidence((), -np.inf)
        moving = [in_words_of_poses(one.evidence, self.every) for one in self.motion.evidence]
        found = joint_evidence([self.poses.evidence, *moving])
        if self.given is not None:
            beside = joint_evidence([self.given.evidence, *moving], self.given.given)
            found = replace(found, sets=beside.sets or found.sets)
        return found

    def in_words(self, of_poses: str, of_motion: str) -> str:
        """of_poses, of_motion: the diagnosis of each in words."""
        lines = [*self.contradictions, f"Poses and motion together: {VERDICT_OF_BOTH[self.verdict]}", ""]
        lines += ["Poses, at standstill", "====================", of_poses, ""]
        lines += ["Motion, between the poses", "=========================", of_motion]
        for heading, said in self.in_both:
            lines += ["", f"{heading}:", *(f"  {line}" for line in said)]
        return "\n".join(lines)

    @property
    def in_both(self) -> list[tuple[str, list[str]]]:
        """What poses and motion say together, in words: heading and lines."""
        out = [("Found in both", list(map(str, self.agreement)))] if self.agreement else []
        out += [("Decided by both together", list(map(str, self.decided)))] if self.decided else []
        return out + self._beside_motion_in_words() + self._together_in_words()

    def _beside_motion_in_words(self) -> list[tuple[str, list[str]]]:
        """What the poses show beside the effects that the motion is sure of, where they were searched with these."""
        if self.given is None:
            return []
        lines = []
        for e in self.beside_motion:
            if (label := label_of(e.name, e.where)) not in self.given.given:
                values = ", ".join(parameter_in_words(name, p) for name, p in e.parameters.items())
                lines.append(f"{effect_in_words(label)}{': ' if values else ''}{values}")
        known = " and ".join(map(effect_in_words, self.given.given))
        return [(f"The poses, searched with {known} as the motion states it, show", lines or ["no further effect"])]

    def _together_in_words(self) -> list[tuple[str, list[str]]]:
        """The most probable joint set, and the others that are not excluded."""
        sets = self.together.sets
        if not self.together.reported:
            return []
        names = [" and ".join(effect_in_words(label) for label in one.effects) or "no effect" for one in (sets[0], *not_excluded(sets))]
        rest = [f"not excluded: {name}" for name in names[1:]] or ["no other set is within 20 : 1"]
        return [("By the evidence of poses and motion together", [names[0], *rest])]


def over_joint_sets(one: ComparedSet, evidence: EvidenceSummary, joint: Sequence[JointSet]) -> tuple[ComparedEffect, ...]:
    """The effects of a set of the poses with the parameters as they state them in all joint sets that are not excluded."""
    parts = [(s.log_odds, evidence.part_of(s.effects)) for s in joint if s.log_odds > np.log(OPTIONS.undecided)]
    each = [(log, {e.label: e.parameters for e in part.effects}) for log, part in parts if part is not None]
    own = {e.label: e.parameters for e in one.effects}
    sets = [(float(np.exp(log)), stated) for log, stated in each]
    return tuple(replace(e, parameters={**e.parameters, **averaged(e.label, e.parameters, own, sets)}) for e in one.effects)


def translated(name: str, parameters: Parameters, every: Parameters) -> Parameters:
    """The parameters that an effect has in motion in the words of the poses. every: the parameters of all effects."""
    translate = catalogue.declaration(name).in_terms_of_poses
    return parameters if translate is None or not parameters else translate(parameters, every)


def labels_of(effects: Iterable[tuple[str, tuple[str, ...]]]) -> set[str]:
    """``name:location`` of effects, each location by itself unless they are one thing."""
    out = set()
    for name, where in effects:
        together = catalogue.declaration(name).between_locations
        out |= {label_of(name, where)} if together else {f"{name}:{at}" for at in where}
    return out


def in_words_of_poses(evidence: EvidenceSummary, every: Parameters) -> EvidenceSummary:
    """The evidence of a motion with its parameters in the words of the poses. every: the parameters of all effects."""

    def said(e: ComparedEffect) -> ComparedEffect:
        parameters, prior = (translated(e.name, p, every) for p in (e.parameters, e.prior))
        return replace(e, parameters=parameters, prior=prior)

    return replace(evidence, sets=tuple(replace(one, effects=tuple(map(said, one.effects))) for one in evidence.sets))


def _own_log_odds(label: str, evidence: EvidenceSummary) -> float:
    """Log odds of an effect by one evidence; zero where it was not compared there."""
    each = [({e.label for e in one.effects}, one.log_odds) for one in evidence.sets]
    return log_odds_of(label, each) if any(label in labels for labels, _ in each) else 0.0

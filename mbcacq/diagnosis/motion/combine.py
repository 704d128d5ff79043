"""A run has both: poses at standstill and the motion between them. What both found of one effect is compared, in one vocabulary.

1. The parameters of the motion are put into the words of the poses (``Declaration.in_terms_of_poses``): a balancer's torque, say, becomes
   the angle by which it winds A2 up.
2. Every parameter that both state is compared. Values that differ by more than three combined standard deviations contradict each other.
3. Where one of them cannot tell two effects apart, and the other names one of these, that one is named.
4. What the motion is sure of is given to the poses as their prior (``given_effects``), and these are searched again: what shows only
   through it, or beside it, is found then.
5. The evidences of both multiply (``joint_sets``): what neither shows or decides alone may be shown and decided by both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtrc, ndtri

from mbcacq.diagnosis.given_effects import StatedParameters, label_of
from mbcacq.diagnosis.motion.joint_sets import (
    EvidenceSets,
    JointEvidence,
    SingleValue,
    StatedEffect,
    apart,
    joint_evidence,
    not_excluded,
    paired,
)
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.diagnosis.motion.result import MotionDiagnosis
from mbcacq.diagnosis.motion.text import motion_text
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects import catalogue
from mbcacq.effects.declaration import Estimates
from mbcacq.effects.effect import ParameterEstimate, parameter_in_words
from mbcacq.effects.in_words import effect_in_words
from mbcacq.model.json_text import from_fields, plain
from mbcacq.quantities import K, measured, split_unit

VERDICT_OF_BOTH = {
    "none": "no effect.",
    "explained": "what both show is explained by effects.",
    "partly_explained": "effects explain a part of what both show; structure remains.",
    "unexplained": "there is a mismatch that no effect of the catalogue describes.",
    "cannot_tell": "cannot tell what is behind what they show.",
}
MOST_TOGETHER = 6  # joint sets that are reported
FARTHEST = 38.0  # standard deviations: beyond, the probability of a normal distribution is no floating point number


@dataclass(frozen=True)
class SingleEstimate:
    """A value with its standard deviation; tuples of a parameter with several components."""

    value: float | tuple[float, ...]
    std: float | tuple[float, ...]

    @classmethod
    def of(cls, one: SingleValue) -> SingleEstimate:
        """As a number where it has one component."""
        value, std = one.value.tolist(), one.std.tolist()
        return cls(value[0], std[0]) if len(value) == 1 else cls(tuple(value), tuple(std))

    def shown(self, parameter: str) -> str:
        """With its expanded uncertainty (k = 2) in the unit of the parameter's name; a vector component by component."""
        _, unit, factor = split_unit(parameter)
        values, stds = np.atleast_1d(self.value), np.atleast_1d(self.std)
        return ", ".join(measured(factor * v, K * factor * s, unit) for v, s in zip(values, stds, strict=True))


@dataclass(frozen=True)
class ParameterAgreement:
    """A parameter of an effect that was found in the poses and in the motion.

    Attributes
    ----------
    name, where, parameter
        The effect, its locations, and the parameter with its unit.
    poses, motion
        Both estimates.
    sigmas
        Their distance in combined standard deviations; of several components the distance of one that is as improbable as all together.
    agrees
        Whether that is less than three.
    """

    name: str
    where: tuple[str, ...]
    parameter: str
    poses: SingleEstimate
    motion: SingleEstimate
    sigmas: float
    agrees: bool

    @property
    def label(self) -> str:
        """Effect, locations and parameter in words."""
        return f"{self.name} at {'+'.join(self.where)}, {split_unit(self.parameter)[0]}"

    def stated(self) -> tuple[str, str]:
        """What the poses and what the motion state, each with its expanded uncertainty."""
        return self.poses.shown(self.parameter), self.motion.shown(self.parameter)


@dataclass(frozen=True)
class DecidedPair:
    """Effects that one diagnosis cannot tell apart, of which the other names one. by: 'poses' or 'motion', which names it."""

    effects: tuple[str, ...]
    named: str
    by: str

    def __str__(self) -> str:
        other = "motion" if self.by == "poses" else "poses"
        return f"{' and '.join(self.effects)}, which the {other} cannot tell apart: the {self.by} name {self.named}".replace(
            "the motion name ", "the motion names "
        )


def combined(poses: dict[str, Any], motion: MotionDiagnosis) -> dict[str, Any]:
    """The JSON of the pose diagnosis with that of the motion (``motion``), what both found (``agreement``), what one decides that the
    other cannot (``decided``), and what both show as one problem (``together``).
    """
    both = together(poses, motion)
    return poses | {
        "motion": motion.to_json(),
        "agreement": [asdict(a) for a in agreement(poses, motion)],
        "decided": [asdict(d) for d in decided(poses, motion)],
        "together": {"verdict": verdict_of_both(poses, motion, both)} | plain(both),
    }


def verdict_of_both(poses: Mapping[str, Any], motion: MotionDiagnosis, both: JointEvidence) -> str:
    """The verdict on a run: 'cannot_tell' where poses and motion contradict each other, or one of them cannot tell and both together cannot
    either; else what is explained of both.
    """
    each = {poses["verdict"], motion.verdict}
    if any(not a.agrees for a in agreement(poses, motion)):
        return "cannot_tell"
    if "cannot_tell" in each and not (both.decided and (both.significant or not both.sets[0].effects)):
        return "cannot_tell"
    named = bool(both.reported) or bool(each & {"explained", "partly_explained"})
    if each & {"unexplained", "partly_explained"}:
        return "partly_explained" if named else "unexplained"
    return "explained" if named else "none"


def agreement(poses: Mapping[str, Any], motion: MotionDiagnosis, sigmas: float = NUMBERS.agreement_sigmas) -> list[ParameterAgreement]:
    """Every parameter that both found. poses: JSON of the pose diagnosis; sigmas: within which two values agree.

    Where the poses were searched with what the motion states, the values of the most probable set are compared.
    """
    in_motion = in_terms_of_poses(poses, motion)
    out = []
    for effect in effects_beside_motion(poses, motion):
        name, own = effect["name"], effect["parameters"]
        for where, other in in_motion.get(name, []):
            if "." not in next(iter(own), ".") and set(where) != set(effect["where"]):
                continue  # the names of its parameters do not tell where it is
            for key, mine, theirs in paired(own, other):
                distance = distance_of(key, mine, theirs)
                out.append(
                    ParameterAgreement(name, where, key, SingleEstimate.of(mine), SingleEstimate.of(theirs), distance, distance <= sigmas)
                )
    return out


def effects_beside_motion(poses: Mapping[str, Any], motion: MotionDiagnosis) -> Sequence[Mapping[str, Any]]:
    """The effects of the poses: those in the most probable joint set where the poses were searched with what the motion states, else those
    of the poses alone.
    """
    given, both = poses.get("given_motion"), together(poses, motion).sets
    if not given or not both:
        return poses["effects"]
    best = set(both[0].effects)
    sets = (one["effects"] for one in given["evidence"]["sets"])
    return next((effects for effects in sets if {label_of(e["name"], e["where"]) for e in effects} <= best), poses["effects"])


def given_by_motion(poses: Mapping[str, Any], motion: MotionDiagnosis) -> list[StatedParameters]:
    """What the motion is sure of, in the words of the poses: the effects that are in every set that its evidence does not exclude."""
    sure: set[str] = set()
    for one in motion.evidence:
        likely = [s for s in one.evidence.sets if s.log_odds > np.log(OPTIONS.undecided)]
        sure |= set.intersection(*({label_of(e.name, e.where) for e in s.effects} for s in likely)) if likely else set()
    stated = [StatedParameters(name, where, p) for name, found in in_terms_of_poses(poses, motion).items() for where, p in found]
    return [one for one in stated if one.label in sure]


def in_terms_of_poses(poses: Mapping[str, Any], motion: MotionDiagnosis) -> dict[str, list[tuple[tuple[str, ...], Estimates]]]:
    """Name of an effect of the motion -> its locations and its parameters in the words of the poses."""
    found = (*(e["parameters"] for e in poses["effects"]), *(m.parameters for m in motion.named_effects))
    every = {key: p for parameters in found for key, p in parameters.items()}
    out: dict[str, list[tuple[tuple[str, ...], Estimates]]] = {}
    for effect in motion.named_effects:
        translate = catalogue.declaration(effect.name).in_terms_of_poses
        parameters = effect.parameters if translate is None else translate(effect.parameters, every)
        out.setdefault(effect.name, []).append((effect.where, parameters))
    return out


def distance_of(key: str, mine: SingleValue, theirs: SingleValue) -> float:
    """Distance of two estimates in combined standard deviations."""
    sigmas = np.abs(apart(key, mine, theirs)) / np.maximum(np.hypot(mine.std, theirs.std), 1e-300)
    if len(sigmas) == 1:
        return float(sigmas[0])
    probability = float(chdtrc(len(sigmas), np.sum(sigmas**2)))
    return float(-ndtri(probability / 2)) if probability > 0 else max(FARTHEST, float(sigmas.max()))


def decided(poses: Mapping[str, Any], motion: MotionDiagnosis) -> list[DecidedPair]:
    """Pairs that one diagnosis cannot tell apart and of which the other names exactly one."""
    in_poses = labels_of((e["name"], e["where"]) for e in poses["effects"])
    in_motion = labels_of((e.name, e.where) for e in motion.named_effects)
    pairs = [(tuple(p["effects"]), in_motion, "motion") for p in poses.get("not_separable", ())]
    pairs += [(p.effects, in_poses, "poses") for p in motion.not_separable]
    found = [(effects, [e for e in effects if e in names], by) for effects, names, by in pairs]
    return [DecidedPair(effects, named[0], by) for effects, named, by in found if len(named) == 1]


def labels_of(effects: Any) -> set[str]:
    """``name:location`` of effects, each location by itself unless they are one thing."""
    out = set()
    for name, where in effects:
        together = catalogue.declaration(name).between_locations
        out |= {label_of(name, where)} if together else {f"{name}:{at}" for at in where}
    return out


def together(poses: Mapping[str, Any], motion: MotionDiagnosis) -> JointEvidence:
    """The evidence of poses and motion as one problem, by their most probable sets; no set where one of them has no evidence."""
    of_poses, given = poses.get("evidence"), poses.get("given_motion")
    of_motion = [plain(e.evidence) for e in motion.evidence]
    if not of_poses or not of_motion:
        return JointEvidence((), -np.inf)
    every = {key: p for e in poses["effects"] for key, p in e["parameters"].items()}
    every |= {key: p for e in motion.named_effects for key, p in e.parameters.items()}
    moving = [_sets_of(one, every) for one in of_motion]
    found = joint_evidence([_sets_of(of_poses, {}), *moving])
    if given:
        beside = joint_evidence([replace(_sets_of(given["evidence"], {}), given=frozenset(given["given"])), *moving])
        found = replace(found, sets=beside.sets or found.sets)
    return replace(found, sets=found.sets[:MOST_TOGETHER])


def _sets_of(evidence: Mapping[str, Any], every: Estimates) -> EvidenceSets:
    """The sets of an evidence, in the words of the poses where ``every`` parameter of both is given."""
    out = []
    for one in evidence["sets"]:
        effects: dict[str, StatedEffect] = {}
        for e in one["effects"]:
            translate = catalogue.declaration(e["name"]).in_terms_of_poses if every else None
            stated, prior = (p if translate is None or not p else translate(p, every) for p in (e["parameters"], e.get("prior", {})))
            label = label_of(e["name"], e["where"])
            before = effects.get(label, StatedEffect())
            log_prior = before.log_prior + (e.get("log_prior") or 0.0)
            effects[label] = StatedEffect({**before.parameters, **stated}, {**before.prior, **prior}, log_prior)
        out.append(effects)
    log_odds = np.array([float(one["log_odds"]) for one in evidence["sets"]])
    some = np.array([bool(one["effects"]) for one in evidence["sets"]])
    mass = 0.0
    if some.any() and not some.all() and evidence["log_e_value"] is not None:
        mass = float(np.logaddexp.reduce(log_odds[some]) - log_odds[~some].max()) - float(evidence["log_e_value"])
    return EvidenceSets(tuple(log_odds.tolist()), tuple(out), max(mass, 0.0))


def combined_text(poses: dict[str, Any], text: str, motion: MotionDiagnosis) -> str:
    """poses, text: the pose diagnosis as JSON and in words."""
    front, both = contradictions(agreement(poses, motion)), in_both(poses, motion)
    said = VERDICT_OF_BOTH[verdict_of_both(poses, motion, together(poses, motion))]
    lines = [*front, f"Poses and motion together: {said}", "", "Poses, at standstill", "====================", text, ""]
    lines += ["Motion, between the poses", "=========================", motion_text(motion)]
    for heading, said in both:
        lines += ["", f"{heading}:", *(f"  {line}" for line in said)]
    return "\n".join(lines)


def in_both(poses: Mapping[str, Any], motion: MotionDiagnosis) -> list[tuple[str, list[str]]]:
    """What poses and motion say together, in words: heading and lines. poses: JSON of the pose diagnosis."""
    found, pairs = agreement(poses, motion), decided(poses, motion)
    out = [("Found in both", [_agreement_in_words(a) for a in found])] if found else []
    out += [("Decided by both together", [str(pair) for pair in pairs])] if pairs else []
    return out + _beside_motion_in_words(poses, motion) + _together_in_words(together(poses, motion))


def _agreement_in_words(a: ParameterAgreement) -> str:
    poses_say, motion_says = a.stated()
    verdict = "they agree" if a.agrees else "they contradict each other"
    return f"{a.label}: {poses_say} from the poses, {motion_says} from the motion: {verdict} ({a.sigmas:.1f} sigma)"


def _beside_motion_in_words(poses: Mapping[str, Any], motion: MotionDiagnosis) -> list[tuple[str, list[str]]]:
    """What the poses show beside the effects that the motion is sure of, where they were searched with these."""
    given = poses.get("given_motion")
    if not given:
        return []
    shown = [e for e in effects_beside_motion(poses, motion) if label_of(e["name"], e["where"]) not in given["given"]]
    values = [", ".join(parameter_in_words(k, from_fields(ParameterEstimate, p)) for k, p in e["parameters"].items()) for e in shown]
    lines = [f"{effect_in_words(label_of(e['name'], e['where']))}{': ' if one else ''}{one}" for e, one in zip(shown, values, strict=True)]
    known = " and ".join(effect_in_words(label) for label in given["given"])
    return [(f"The poses, searched with {known} as the motion states it, show", lines or ["no further effect"])]


def _together_in_words(both: JointEvidence) -> list[tuple[str, list[str]]]:
    """The most probable joint set, and the others that are not excluded."""
    sets = both.sets
    if not both.reported:
        return []
    names = [" and ".join(effect_in_words(label) for label in one.effects) or "no effect" for one in (sets[0], *not_excluded(sets))]
    rest = [f"not excluded: {name}" for name in names[1:]] or ["no other set is within 20 : 1"]
    return [("By the evidence of poses and motion together", [names[0], *rest])]


def contradictions(found: Sequence[ParameterAgreement]) -> list[str]:
    """Sentences, in front of everything else, on what poses and motion state differently."""
    out = []
    for a in found:
        if not a.agrees:
            poses_say, motion_says = a.stated()
            out.append(
                f"Poses and motion contradict each other on {a.label}: {poses_say} by the poses and {motion_says} by the motion "
                f"({a.sigmas:.1f} sigma). One of both has another cause: believe neither value before that is found."
            )
    return out

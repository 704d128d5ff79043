"""What a diagnosis of poses and one of motion have in common: what was found, its evidence, what is not separable, advice.

Every class here is plain data: it pickles, and its fields are the keys of the JSON object, in their order.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, WithJsonSchema

from mbcacq.diagnosis.effect_found import EffectFound, MismatchEntry
from mbcacq.effects.effect import ParameterEstimate, label_of, parameter_in_words
from mbcacq.model.json_text import Number, fields_as_json, from_document
from mbcacq.quantities import percent

FORMAT = "mbcacq-diagnosis/3"
READABLE = ("mbcacq-diagnosis/1", "mbcacq-diagnosis/2", FORMAT)
THE_CONTENT, CURE = "this JSON content", "give a diagnosis as mbcacq diagnose --out writes it"
TOGETHER = " and "  # between effects that stand together on one side of a pair
OUT_OF_TIME = (
    "time ran out before all explanations were compared: the effects that are listed were found by then, and held-out figures could be "
    "better; give the diagnosis more time (--minutes)"
)
MOST_PARAMETERS = 8  # of an effect, in a table of a notebook

Format = Annotated[str, WithJsonSchema({"type": "string", "const": FORMAT})]
Verdict = Annotated[str, WithJsonSchema({"enum": ["none", "explained", "partly_explained", "unexplained", "cannot_tell"]})]


@dataclass(frozen=True)
class NotSeparable:
    """Two effects, as ``name:where``, that these data cannot tell apart, and the correlation of what they explain. Several that stand
    together are joined by ' and '. odds: posterior probability of the second relative to the first; None if that was not computed.
    """

    later = ("odds",)

    effects: tuple[str, ...]
    correlation: Number
    odds: float | None = None


LOOK_AT = "look at ball "  # with which advice on a ball begins


@dataclass(frozen=True)
class Advice:
    """What to measure next and why; poses_deg: joint angles, one tuple a pose."""

    reason: str
    poses_deg: tuple[tuple[Number, ...], ...]


@dataclass(frozen=True)
class ComparedEffect:
    """One effect of a set that was compared.

    Attributes
    ----------
    parameters : Mapping[str, ParameterEstimate]
        Its posterior mean with standard deviations, the geometry refitted.
    tried : bool
        False for a smooth function that stands for an effect of the catalogue which the recording does not allow to be tried.
    prior : Mapping[str, ParameterEstimate]
        The parameters without the effect, with the standard deviations that they have before the recording.
    log_prior : float or None
        Natural logarithm of its probability next to the others of the set, before the recording; both are empty in older files.
    """

    later = ("prior", "log_prior")

    name: str
    where: tuple[str, ...]
    parameters: Mapping[str, ParameterEstimate]
    tried: bool = True
    prior: Mapping[str, ParameterEstimate] = field(default_factory=dict)
    log_prior: float | None = None

    @property
    def label(self) -> str:
        """``name:where``."""
        return label_of(self.name, self.where)


@dataclass(frozen=True)
class ComparedSet:
    """A set of effects that was compared. log_odds: natural logarithm of its posterior probability relative to the most probable set's."""

    effects: tuple[ComparedEffect, ...]
    log_odds: Number


@dataclass(frozen=True)
class EvidenceSummary:
    """The evidence of a recording: what decides whether there is an effect, and which.

    Attributes
    ----------
    poses : int
        Number of poses that took part.
    log_e_value : Number
        Natural logarithm of the evidence of all sets with an effect together against none.
    least_log_e_value : Number
        The logarithm above which there is an effect. Without any effect, the e-value of a recording that grows has mean one, so that this
        holds at every look.
    sets : tuple[ComparedSet, ...]
        The most probable first, the empty one among them.
    untried : tuple[str, ...]
        A sentence about each set that stands for what was not tried and is not excluded.
    """

    later = ("untried",)

    poses: int
    log_e_value: Number
    least_log_e_value: Number
    sets: tuple[ComparedSet, ...]
    untried: tuple[str, ...] = ()

    @property
    def significant(self) -> bool:
        """Whether there is an effect."""
        return self.log_e_value > self.least_log_e_value

    def part_of(self, labels: Collection[str]) -> ComparedSet | None:
        """The most probable set with those of some effects (``name:where``) that were compared here, and no other; else the most probable
        one without any other; None if there is none.
        """
        each = [(one, {e.label for e in one.effects}) for one in self.sets]
        here = set().union(*(known for _, known in each)) & set(labels)
        found = [one for one, known in each if known == here] or [one for one, known in each if known <= here]
        return next(iter(found), None)


@dataclass(frozen=True)
class GivenEvidence:
    """The evidence of poses with what the motion of the same run is sure of as their prior. given: labels (``name:where``) of the effects
    that were given, which are in all sets of ``evidence``, with the parameters that the poses alone state of them there.
    """

    given: tuple[str, ...]
    evidence: EvidenceSummary


@dataclass(frozen=True, repr=False, kw_only=True)
class Findings:
    """The part that every diagnosis has.

    verdict: ``none``, ``explained``, ``partly_explained``, ``unexplained`` or ``cannot_tell``. mismatch: largest share first. advice: what
    to measure next. plot_data: from which pictures are drawn; it is no part of the JSON object, so None after ``from_json``.
    """

    data: ClassVar[str] = "poses"  # that it is of

    format: Format = field(init=False, default=FORMAT)
    verdict: Verdict
    mismatch: tuple[MismatchEntry, ...]
    effects: tuple[EffectFound, ...]
    not_separable: tuple[NotSeparable, ...] = ()
    advice: tuple[Advice, ...] = ()
    plot_data: Annotated[object | None, Field(exclude=True)] = field(default=None, compare=False)

    def to_json(self) -> dict[str, Any]:
        """The JSON object as Python lists, dictionaries and numbers; a number that is not finite becomes None."""
        return fields_as_json(self)

    @classmethod
    def from_json(cls, content: Any) -> Self:
        """The diagnosis that ``to_json`` wrote; a None becomes not-a-number, keys that the format does not have are left out.

        Raises ConfigError if the object has another format or lacks a key.
        """
        return from_document(cls, content, READABLE, THE_CONTENT, "diagnosis", CURE)

    @property
    def rejected_balls(self) -> tuple[Advice, ...]:
        """The advice on balls of which most centres were rejected."""
        return tuple(one for one in self.advice if one.reason.startswith(LOOK_AT))

    @property
    def out_of_time(self) -> bool:
        """Whether the search ended before all explanations were compared."""
        raise NotImplementedError

    @property
    def held_out(self) -> str:
        """The misfit of held-out data before and after, in words."""
        raise NotImplementedError

    def __repr__(self) -> str:
        found = "; ".join(f"{e.name} at {e.at}" for e in self.effects) or "no effect"
        return f"<{type(self).__name__} {self.verdict}: {found}; held out: {self.held_out}>"

    def _repr_html_(self) -> str:
        """A table of the effects for a notebook."""
        heads = "".join(f"<th>{head}</th>" for head in ("effect", "where", "parameters", "removes"))
        rows = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in _row(e))}</tr>" for e in self.effects)
        table = f"<table><tr>{heads}</tr>{rows}</table>" if rows else ""
        return f"<p><b>{escape(self.verdict)}</b>; held out: {escape(self.held_out)}; ± is U (k = 2)</p>{table}"


def _row(effect: EffectFound) -> tuple[str, str, str, str]:
    """Cells of a table, as HTML; a trend has no figure."""
    values = [parameter_in_words(*p) for p in list(effect.parameters.items())[:MOST_PARAMETERS]]
    shown = f"a trend: {escape(effect.trend)}" if effect.trend else "<br>".join(map(escape, values))
    return escape(effect.name), escape(effect.at), shown, percent(effect.held_out_gain)

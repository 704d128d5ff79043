"""What a diagnosis finds, in poses or in a motion: an effect with its parameters and alternatives, and where model and data disagree."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from mbcacq.effects.effect import ParameterEstimate
from mbcacq.model.json_text import EveryKey, Number
from mbcacq.quantities import K

NOT_SIZES = ("order", "phase_deg", "at_pose", "time_constant_s", "transition_Nm", "breakpoint_Nm", "zero_deg")
LINE = ("order", "amplitude_deg", "phase_deg")  # parameters of a periodic error, of which a joint has one component for each line
UNCERTAIN = "no figure is beyond its expanded uncertainty (k = 2)"
REMOVES_NOTHING = "held-out data are predicted as well without it"
NOT_FOUND_AGAIN = "the same search does not find it in both halves of the recording"
SELDOM_FOUND = "most searches without a part of the poses do not find it"
NOTHING = 0.0005  # a share that is written as 0.0 %


def trend(parameters: Mapping[str, tuple[Iterable[float | None], Iterable[float | None]]], gain: float | None, std: float = 0.0) -> str:
    """Why an effect is a trend: none of its sizes, or not what it removes, reaches its expanded uncertainty. Empty for a finding.

    parameters: by name, the values of its components and their standard deviations. gain, std: share of the held-out excess over the
    noise that it removes, None or not a number where it is not known, and its standard deviation.
    """
    sizes = [pairs for name, pairs in parameters.items() if name.rpartition(".")[2] not in NOT_SIZES]
    known = [(v, s) for values, stds in sizes for v, s in zip(values, stds, strict=False) if v is not None and s]
    if known and all(abs(v) < K * s for v, s in known):
        return UNCERTAIN
    return REMOVES_NOTHING if gain is not None and gain < max(K * std, NOTHING) else ""


OF_POSES = ("p_local", "p_corrected", "log_bayes_factor", "equivalent", "held_out_gain_std")  # keys of an effect of poses alone
WHERE_KNOWN = ("orders", "found_again")  # of these, keys that are left out where they are empty
OF_MOTION = ("channel", "held_out_gain_here", "steps", "notes", "shape")  # keys of an effect of a motion alone
OF_MODELS = ("held_out_gain_here", "steps", "notes", "trend")  # of these, keys that an unmodelled effect of a motion does not have


@dataclass(frozen=True)
class MismatchEntry(EveryKey):
    """A location and covariate at which recording and simulation differ.

    Attributes
    ----------
    share : Number
        Share of the excess over the noise, 0 to 1. For a motion it is the held-out excess of that kind of mismatch (``channel``), at a
        joint or of all joints.
    equivalent : tuple[str, ...]
        Other locations that move the centres of a recording of poses alike, so that these data cannot tell which it is.
    """

    left_out = ("channel",)
    later = ("equivalent",)

    at: str
    depends_on: str
    share: Number
    p_value: Number
    equivalent: tuple[str, ...] = ()
    channel: str = ""

    def unwritten(self) -> Sequence[str]:
        return ("equivalent",) if self.channel else ("channel",)


@dataclass(frozen=True)
class Alternative:
    """An effect that could stand in place of a found one. held_out_gain: share of the excess that it would remove, 0 to 1. odds:
    its posterior probability relative to the found effect's; None where that was not computed.
    """

    later = ("odds",)

    name: str
    where: tuple[str, ...]
    held_out_gain: Number
    odds: float | None = None

    @classmethod
    def of_label(cls, label: str, odds: float) -> Self:
        """From ``name:where``; what it would remove is not computed."""
        name, _, where = label.partition(":")
        return cls(name, tuple(where.split("+")), 0.0, odds)


@dataclass(frozen=True)
class PossibleOrder:
    """An order that a periodic error may have.

    Attributes
    ----------
    at : str
        The joint.
    line : int
        Number of the line of that joint, from 1, to which it belongs.
    order, sigma : Number
        Periods a turn of the joint, and the standard deviation within this peak of the posterior.
    odds : Number
        Posterior probability relative to the most probable order of this line.
    determined : bool
        Whether the order of this line is determined; where it is not, no parameter states it.
    """

    at: str
    line: int
    order: Number
    sigma: Number
    odds: Number
    determined: bool


@dataclass(frozen=True)
class FoundAgain:
    """Whether the same search finds an effect again in parts of the recording, and with which values.

    Attributes
    ----------
    at : str
        Its location.
    found_in, parts : int
        The number of parts in which it was found, and of all parts.
    disjoint : bool
        True for halves that share no pose; False for a small recording, whose parts are all poses but one part of them.
    values : Mapping[str, tuple[ParameterEstimate, ...]]
        By parameter, one estimate for each part in which it was found.
    size_spread : Number
        Of something unmodelled, the relative standard deviation of its size as disjoint parts differ, pooled over its kind; the largest.
    """

    at: str
    found_in: int
    parts: int
    disjoint: bool
    values: Mapping[str, tuple[ParameterEstimate, ...]] = field(default_factory=dict)
    size_spread: Number = 0.0

    @property
    def repeats(self) -> bool:
        """False where disjoint parts do not all have it, or of searches without a part of the poses less than half."""
        return self.found_in == self.parts if self.disjoint else 2 * self.found_in >= self.parts


@dataclass(frozen=True)
class MotionStep:
    """One form of an effect, in the order of selection. adds: names of its parameters; held_out_before_rms, held_out_after_rms: by joint,
    in the unit of the channel (deg, N m)."""

    adds: tuple[str, ...]
    held_out_before_rms: Mapping[str, Number]
    held_out_after_rms: Mapping[str, Number]


@dataclass(frozen=True)
class ResponseShape:
    """Mean ``y`` over bins ``x`` of a covariate, in SI units."""

    x: tuple[float, ...]
    y: tuple[float, ...]

    @property
    def rms(self) -> float:
        """Root mean square of y. The bins hold equally many samples, so that the mean square over them is that over the recording."""
        return float(np.sqrt(np.mean(np.square(self.y))))


@dataclass(frozen=True, kw_only=True)
class EffectFound(EveryKey):
    """An effect that a diagnosis reports.

    Attributes
    ----------
    name
        Name in the catalogue, or ``unknown`` for an unmodelled effect.
    parameters
        By name, with the unit as its suffix.
    p_value
        As in version 1 of the format: ``p_local`` of a parametric effect of poses; otherwise exp(-log Bayes factor).
    held_out_gain
        Share of the held-out excess over the noise floor that the effect removes, 0 to 1. For a motion it is the excess of its ``channel``.
    trend
        Reason why it is a trend, whose figures are not reliable; empty for a finding.
    p_local
        Probability that noise alone gains as much by these very coefficients. Poses only; None for an unmodelled effect.
    p_corrected
        The same by anything that was tried (all candidates and values of their hyper-parameters, or all locations). Poses only.
    log_bayes_factor
        Natural logarithm of the Bayes factor of an unmodelled effect against none. Poses only.
    equivalent
        Other locations that act alike on these data. Poses only.
    held_out_gain_std
        Standard deviation of ``held_out_gain``, 0 where it is not known. Poses only.
    orders
        All orders that a periodic error may have. Poses only.
    found_again
        One entry for each location: whether parts of the recording show it again. Poses only; empty where that was not tried.
    channel
        Kind of mismatch of a motion that shows the effect; empty for poses.
    held_out_gain_here
        Share of the excess of its own joints that it removes on held-out data. Motion only. Together the effects of a joint remove what the
        table of channels says.
    steps
        Forms of the effect in the order of selection. Motion only.
    notes
        Sentences on what its parameters leave open. Motion only.
    shape
        Structure in a residual that no effect of the catalogue explains, over the covariate ``depends_on``. Motion only.
    """

    left_out = (*OF_MOTION, *WHERE_KNOWN, "trend")
    later = ("depends_on", "alternatives", *OF_POSES)

    name: str
    where: tuple[str, ...]
    depends_on: str = ""
    parameters: Mapping[str, ParameterEstimate]
    p_value: Number
    held_out_gain: Number
    alternatives: tuple[Alternative, ...] = ()
    trend: str = field(init=False, default="")
    p_local: float | None = None
    p_corrected: float | None = None
    log_bayes_factor: float | None = None
    equivalent: tuple[str, ...] = ()
    held_out_gain_std: Number = 0.0
    orders: tuple[PossibleOrder, ...] = ()
    found_again: tuple[FoundAgain, ...] = ()
    channel: str = ""
    held_out_gain_here: float | None = None
    steps: tuple[MotionStep, ...] = ()
    notes: tuple[str, ...] = ()
    shape: ResponseShape | None = None

    def __post_init__(self) -> None:
        """An unmodelled effect of a motion is never a trend: it was held against noise by itself."""
        if self.shape is None:
            sizes = {name: estimate.components for name, estimate in self.parameters.items()}
            seldom = self.found_again and not any(one.repeats for one in self.found_again)
            # A model that has not found it predicts as well without it: that says nothing of what it removes.
            reason = trend(sizes, None if seldom else self.gain_here, self.held_out_gain_std)
            if not reason and seldom:
                reason = NOT_FOUND_AGAIN if self.found_again[0].disjoint else SELDOM_FOUND
            object.__setattr__(self, "trend", reason)

    @property
    def removes(self) -> bool:
        """Whether there is a share of the held-out excess that it removes: not where held-out data, or the models of most parts, do without
        it."""
        return self.trend not in (REMOVES_NOTHING, SELDOM_FOUND)

    def unwritten(self) -> Sequence[str]:
        empty = [key for key in WHERE_KNOWN if not getattr(self, key)]
        if not self.channel:
            return (*OF_MOTION, *empty)
        return (*OF_POSES, *empty, "shape") if self.shape is None else (*OF_POSES, *empty, *OF_MODELS)

    @property
    def gain_here(self) -> float:
        """Share of the held-out excess that it removes where it acts."""
        return self.held_out_gain if self.held_out_gain_here is None else self.held_out_gain_here

    @property
    def at(self) -> str:
        """Its locations in words."""
        at = ", ".join(self.where)
        return f"{at} ({self.channel})" if self.channel else at

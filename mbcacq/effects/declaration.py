"""What an effect says of itself besides its candidates: its couplings with other effects, and how it is challenged.

Everything outside of ``mbcacq.effects`` that treats one effect otherwise than another asks for a field here; none knows an effect by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Parameters
from mbcacq.model.cell import Drive

Where = tuple[str, ...]  # locations of a candidate


@dataclass(frozen=True, kw_only=True)
class EffectCoupling:
    """An effect that shows only through another one, whose coefficients multiply its own.

    Attributes
    ----------
    name, through
        Names of the effect and of the other one.
    size
        Number of its coefficients.
    parameter
        Name, without location, of the parameter of the other effect that multiplies it.
    locations
        (context) -> locations at which the other effect matters for it.
    candidates
        (context, coefficient of the other effect by location) -> candidates. ``spread`` is the covariance (size, size) of its coefficients,
        if it is known with the uncertainty of the other effect in it. ``complete`` says that every location at which the other effect acts
        is among those given.
    carrier
        (context, candidate of the other effect, coefficients (size,), text that tells it apart) -> that candidate as it acts where the
        effect has these coefficients.
    advice
        What a person should do if the recording cannot tell the effect from the other one.
    """

    name: str
    through: str
    size: int
    parameter: str
    locations: Callable[[Context], list[Where]]
    candidates: Callable[..., list[Candidate]]
    carrier: Callable[[Context, Candidate, np.ndarray, str], Candidate]
    advice: str


@dataclass(frozen=True, kw_only=True)
class Refinement:
    """An effect that is a further branch of another one at the same location, with the breakpoint as its hyper-parameter.

    Attributes
    ----------
    of
        Name of the other effect.
    excess
        Breakpoint -> by how much a unit of its coefficient raises the other effect's coefficient below the breakpoint.
    report
        (location, coefficients (b + 1,) of the last branch and then their excess below each breakpoint, by rising breakpoint, their
        covariance (b + 1, b + 1)) -> parameters of both effects together.
    """

    of: str
    excess: Callable[[float], float]
    report: Callable[[str, np.ndarray, np.ndarray], Parameters]


@dataclass(frozen=True, kw_only=True)
class PeriodicInMotion:
    """An effect that is periodic in the angle of a joint and is found in the spectrum of a mismatch in motion.

    Attributes
    ----------
    channel
        'q_joint' or 'tau'.
    lowest_order
        Periods a turn of the joint below which the mismatch has other causes.
    amplitude
        Name, without location, of the parameter that states the amplitude.
    scale
        From the unit of the computation to that of the parameter.
    """

    channel: str
    lowest_order: float
    amplitude: str
    scale: float


@dataclass(frozen=True, kw_only=True)
class Challenge:
    """How the effect is injected into simulated cells.

    Attributes
    ----------
    number
        Its place among all that are drawn from for recordings of poses: a seed draws the same scenario as long as it stays. A new effect
        has the next one. None for an effect that does not show in poses.
    in_motion
        The same for recordings of motion.
    companions
        Names of effects that are no false names next to it.
    strongest
        Largest strength, in plain sizes, that such an effect can have; None for the general one.
    options
        Further options of the injected effect.
    """

    number: int | None = None
    in_motion: int | None = None
    companions: tuple[str, ...] = ()
    strongest: float | None = None
    options: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True, kw_only=True)
class Declaration:
    """The particulars of an effect.

    Attributes
    ----------
    acts_in_time
        It differs by order or time of the poses, so that no posture makes it visible.
    every_arm
        Every arm has it: where effects are selected in stages, it is selected first.
    between_locations
        Its locations are one thing, as the two joints of a coupling are; else each of them can have the effect by itself.
    same_as_group
        A group of basis functions of the same covariate at its location describes the same.
    refines, coupling
        How it depends on another effect.
    periodic_in_motion
        How it is periodic in a channel of motion.
    motor_side
        It is a part of the drive's torque that never passes the gear.
    dissipative
        All its parts together take energy from a motion at every speed.
    adds_body
        In motion its ten coefficients are inertial parameters of a body on the flange.
    model_block
        What of a MuJoCo model it is written into: 'friction', 'inertia', 'sensor_delay' or 'gear'; empty if such a model has no place for
        it.
    in_terms_of_poses
        (parameters found in motion, parameters of all effects found) -> the same in the vocabulary of the poses, if that differs.
    needs
        Columns of a recording without which it cannot be told from others.
    of_slides
        Prismatic joints can have it, too; its coefficients and covariates are then in mm.
    drives, without_drive
        Drives of a joint that can have it, where not every one can; and why no other has it, as the end of a sentence.
    challenge
        How it is injected into simulated cells, None for one that is not.
    """

    acts_in_time: bool = False
    every_arm: bool = False
    between_locations: bool = False
    same_as_group: bool = False
    refines: Refinement | None = None
    coupling: EffectCoupling | None = None
    periodic_in_motion: PeriodicInMotion | None = None
    motor_side: bool = False
    dissipative: bool = False
    adds_body: bool = False
    model_block: str = ""
    in_terms_of_poses: Callable[[Parameters, Parameters], Parameters] | None = None
    needs: tuple[str, ...] = ()
    of_slides: bool = False
    drives: tuple[Drive, ...] = ()
    without_drive: str = ""
    challenge: Challenge | None = None


NOTHING_PARTICULAR = Declaration()

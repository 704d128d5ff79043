"""A name is a physical claim: which effects an arm can have at a joint, in which direction and of which size.

What the data want beyond that has another cause. It keeps its location and its size, and loses the name.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbcacq.effects.catalogue import declaration
from mbcacq.effects.effect import Candidate, Support, parameter_in_words
from mbcacq.effects.effect_term import UNKNOWN
from mbcacq.model.cell import RobotModel
from mbcacq.quantities import K


def refusal(candidate: Candidate, robot: RobotModel, c: np.ndarray, covariance: np.ndarray) -> str:
    """Why coefficients (k,) with covariance (k, k) cannot be what a candidate is called; empty if they can.

    A bound holds against a coefficient that exceeds it by more than its expanded uncertainty (k = 2).
    """
    if without := joints_without_drive(candidate, robot):
        return f"{without}, and {declaration(candidate.name).without_drive}"
    margin = K * np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if candidate.positive and c[0] < -margin[0]:
        return "it cannot be negative"
    return candidate.support.limit if np.any(np.abs(c) - margin > candidate.support.largest) else ""


def joints_without_drive(candidate: Candidate, robot: RobotModel) -> str:
    """In words, what the description says of the drive of a joint that cannot have an effect; empty if every joint can."""
    permitted = declaration(candidate.name).drives
    if not permitted:
        return ""
    stated = [robot.drive(joint) for at in candidate.where if (joint := robot.axis(at)) is not None and joint not in robot.chain.sliding]
    wrong = [drive for drive in stated if drive not in permitted]
    if not wrong:
        return ""
    return "the robot file states no drive of the joint" if wrong[0] is None else f"the drive of the joint is '{wrong[0]}'"


def with_drives_for(robot: RobotModel, name: str, where: tuple[str, ...]) -> RobotModel:
    """The arm with drives by which its joints ``where`` can have an effect; the same arm for an effect of any drive."""
    permitted = declaration(name).drives
    if not permitted:
        return robot
    drives = [robot.drive(i) for i in range(robot.n)]
    for at in where:
        drives[robot.axes.index(at)] = permitted[0]
    return replace(robot, drives=tuple(drives))


def unnamed(candidate: Candidate, refused: str) -> Candidate:
    """The candidate as an unmodelled effect at its location. refused: the sentence on the name that it cannot have."""
    variant, support = f"as {candidate.name} {candidate.variant}".rstrip(), Support(refused=refused)
    plain = replace(candidate, name=UNKNOWN, report=lambda c, v, h: {}, variant=variant, support=support)
    return replace(plain, positive=False, several=True)


def refused_in_words(candidate: Candidate, c: np.ndarray, covariance: np.ndarray, hyper: float | None, why: str) -> str:
    """The sentence on a name that was refused, with the figures that the data ask for."""
    figures = ", ".join(parameter_in_words(*one) for one in candidate.parameters(c, covariance, hyper).items())
    at = "+".join(candidate.where)
    return (
        f"{candidate.name} at {at} fits ({figures}) and is refused as a name: {why}; it is kept as an unmodelled effect of "
        f"{candidate.depends_on} at {candidate.where[0]}"
    )

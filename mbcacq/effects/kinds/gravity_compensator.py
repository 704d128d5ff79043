"""A spring or gas balancer at A2, which carries the arm; nothing of it stands in the rigid-body model.

Its torque depends on q2 alone. A rod between a point of the base, D apart from the axis, and one of the link, k along it, has the length l
= sqrt(D^2 + k^2 - 2 D k cos(delta)), delta = q2 - q0. It pulls with a force F(l), which is a torque F D k sin(delta) / l. It carries the
arm, so q0 is near the angle at which the link stands upright. For springs and gas, which is compressed by less than half, F = F0 + F1 (l -
l0). F0, F1 and a shift of q0 are the coefficients; the ratio k / D is tried.

In the torque of a motion these coefficients are identified themselves, for mechanisms of another shape by a series of harmonics. At
standstill the torque winds the gearbox up against gravity: what is identified is the torque times the compliance of A2, two angles.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import (
    Candidate,
    HyperEstimate,
    Hyperparameter,
    Missing,
    ParameterEstimate,
    Parameters,
    PriorOdds,
    Report,
    StandstillRows,
    angle,
    number,
    plain_report,
    standard_deviations,
)
from mbcacq.effects.functions import Column, DescribedPart, Function, Product, evaluate
from mbcacq.effects.motion_effect import ChannelGroup, Columns, MotionRows, MotionSignals, available
from mbcacq.geometry.gravity import upright_angle
from mbcacq.model.cell import RobotModel
from mbcacq.quantities import DEGREE

NAME = "gravity_compensator"
LEVER_RATIOS = np.array([0.15, 0.25, 0.4])  # k / D of built balancers
TYPICAL = 1e-4  # rad: half a wind-up of 0.2 mrad, as of 1 kN m at 2e-7 rad/(N m)
UPRIGHT_SIGMA = 10.0 * DEGREE  # by how much q0 may differ from the upright angle
STEP = 1e-3  # rad, of a numerical derivative; at 1e-4 both differ in the seventh digit
LEAST_SPAN = 20.0 * DEGREE
# Arms by the mass of their links. Those for 100 kg and more on the flange have 800 kg and more (KR 120 to KR 300), those for 70 kg have 420
# (KR 70), those for 20 kg have 190 (KR 20). Of the heavy ones nearly all are built with a spring or gas balancer at A2, which carries the
# link arm (KUKA's KR QUANTEC and FORTEC, ABB's IRB 6600 and 7600, FANUC's R-2000 and M-900); a few of them have none (ABB's IRB 6620).
HEAVY_KG, MEDIUM_KG = 600.0, 200.0
ODDS_OF_HEAVY = 3.0  # that an arm of that class has one: three in four at least
ODDS_OF_STATED = 20.0  # that an arm whose description says so has one
RARE = 0.03  # share of the light arms, and of those of unknown mass: a few have a spring
LEAST_OF_HEAVY = 3.0  # typical sizes: it carries 30 to 100 % of 5 kN m and more, and 1e-7 to 1e-6 rad/(N m) make at least 0.2 mrad of it
THROUGH = "joint_compliance:A2"  # at standstill the torque shows by winding up A2
WITHOUT_ROD = 300.0 * DEGREE  # travel of A2 that the rod of a balancer would be in the way of
THIRD_HARMONIC = 0.1  # prior sigma, as a share of that of the first two: the series of a spring converges as fast


def candidates(context: Context) -> list[Candidate]:
    """One candidate at A2 of three coefficients (rad): constant force, growing force, shift of the upright angle times the first."""
    robot = context.obs.cell.robot
    j = robot.axis("A2") or 1
    upright = None if context.n < j + 2 else upright_angle(robot.chain, robot.gravity)
    if upright is None:
        raise Missing("A2 does not lift the arm against gravity")
    if robot.balancer is False:
        raise Missing("the arm has no balancer, as its description says")
    light = robot.mass.sum() < MEDIUM_KG
    if robot.balancer is None and light and np.ptp(robot.limits[j]) >= WITHOUT_ROD:
        raise Missing("A2 of this light arm turns all around, past where the rod of a balancer would be")
    if np.ptp(context.obs.q[:, j]) < LEAST_SPAN:
        raise Missing("A2 turns too little for the law of a balancer")

    def described(ratio):
        return [DescribedPart("joint", j, 0, _law(upright, ratio))]

    rows = StandstillRows(described, np.array([TYPICAL, TYPICAL, TYPICAL * UPRIGHT_SIGMA]))
    hyper = Hyperparameter("lever_ratio", LEVER_RATIOS, 2.0, refine=False)
    rarity = RARE if light and not robot.balancer else 1.0
    least = LEAST_OF_HEAVY if robot.mass.sum() >= HEAVY_KG else 0.0
    report = _report(upright, "deg", angle, 1e-30)
    return [Candidate(NAME, ("A2",), "q2", rows, report, hyper, rarity=rarity, usual=usual(robot), least_size=least)]


def _law(upright: float, ratio: Any) -> tuple[Column, ...]:
    """Torques by the angle of A2: of a constant force, over the largest, which is F0 k; of a growing one; the first by its upright."""
    lever, later, earlier = (Function("q2", "lever", (upright + shift, ratio)) for shift in (0.0, STEP, -STEP))
    growing = (Product(1.0, (lever, Function("q2", "stretch", (upright, ratio)))),)
    return (Product(1.0, (lever,)),), growing, (Product(0.5 / STEP, (later,)), Product(-0.5 / STEP, (earlier,)))


def _report(upright: float, unit: str, stated: Callable[[float, float], ParameterEstimate], least: float = 0.0) -> Report:
    def report(c: np.ndarray, v: np.ndarray, _: HyperEstimate) -> Parameters:
        """The shift of the upright angle is the third coefficient over the first."""
        first, std = c[0] if abs(c[0]) > least else least, standard_deviations(v)
        slope = np.array([-c[2] / first, 0.0, 1.0]) / first
        return {
            f"A2.preload_{unit}": stated(c[0], std[0]),
            f"A2.stretched_{unit}": stated(c[1], std[1]),
            "A2.zero_deg": angle(upright + c[2] / first, float(np.sqrt(max(slope @ v @ slope, 0.0)))),
        }

    return report


def usual(robot: RobotModel) -> PriorOdds | None:
    """Prior odds of a balancer beside an elastic A2; None for an arm of a class that seldom has one."""
    if robot.balancer:
        return PriorOdds(ODDS_OF_STATED, THROUGH)
    return PriorOdds(ODDS_OF_HEAVY, THROUGH) if robot.mass.sum() >= HEAVY_KG else None


def motion_candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[Candidate]:
    j = group.axes.index("A2") if "A2" in group.axes else -1
    if group.name != "tau" or j not in group.joints:
        return []
    weight = max(float(np.abs(available(run.gravity)[:, j]).max()) for run in runs)  # the torque that a balancer has to balance
    first = plain_report("A2.sin_Nm", "A2.cos_Nm", "A2.sin2_Nm", "A2.cos2_Nm")
    third = plain_report("A2.sin3_Nm", "A2.cos3_Nm")
    out = [
        Candidate(NAME, ("A2",), "q2", MotionRows((j,), _harmonics(1, 2), weight), first, variant="series"),
        Candidate(NAME, ("A2",), "q2", MotionRows((j,), _harmonics(3), THIRD_HARMONIC * weight, extends=True), third, variant="third"),
    ]
    robot = runs[0].robot
    upright = None if robot is None else upright_angle(robot.chain, robot.gravity)
    if upright is not None:
        sigma = (2.0 * weight, weight, 2.0 * weight * float(UPRIGHT_SIGMA))
        load = (("A2.preload_Nm", 1.0), ("A2.stretched_Nm", 1.0), ("A2.turned_Nm_per_rad", 1.0))
        rows = MotionRows((j,), _balancing(upright), sigma, usual=True, load_parameters=load)
        hyper = Hyperparameter("", LEVER_RATIOS, 1.0, refine=False)
        out.append(Candidate(NAME, ("A2",), "q2", rows, _report(upright, "Nm", number), hyper, positive=True, variant="balancing"))
    return out


def _harmonics(*harmonics: int) -> Columns:
    def columns(run: MotionSignals, joint: int, _: object) -> np.ndarray:
        return np.stack([function(k * run.q[:, joint]) for k in harmonics for function in (np.sin, np.cos)], axis=1)

    return columns


def _balancing(upright: float) -> Columns:
    return lambda run, joint, ratio: evaluate(_law(upright, ratio), lambda _: run.q[:, joint], len(run.q))


def as_wind_up(found: Parameters, every: Parameters) -> Parameters:
    """The torques of the balancer as the angles by which they wind A2 up; without its compliance only the angle of the upright link.

    The part that the drive need not carry lifts the link: the angles are negative where the torques are positive.
    """
    out = {"A2.zero_deg": found["A2.zero_deg"]} if "A2.zero_deg" in found else {}
    soft = every.get("A2.compliance_rad_per_Nm")
    if soft is None or len(soft.components[0]) != 1:  # several recordings may have one each
        return out
    (compliance,), (uncertainty,) = soft.components
    for torque, name in (("A2.preload_Nm", "A2.preload_deg"), ("A2.stretched_Nm", "A2.stretched_deg")):
        if torque in found:
            (value,), (std,) = found[torque].components
            out[name] = angle(-value * compliance, np.hypot(std * compliance, value * uncertainty))
    return out


DECLARED = Declaration(in_terms_of_poses=as_wind_up, challenge=Challenge(number=19, in_motion=11, companions=("joint_compliance",)))

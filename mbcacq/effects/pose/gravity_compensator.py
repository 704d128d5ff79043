"""A spring or gas balancer at A2, whose torque winds the gearbox up against gravity; nothing of it stands in the rigid-body model.

A rod between a point of the base, D apart from the axis, and one of the link, k along it, pulls with F0 + F1 (l - l0), l its length: the
law of ``mbcacq.effects.motion.gravity_compensator``. The wind-up is that torque times the compliance of A2, so two angles are
identified: of the constant force and of the part that grows as the rod gets longer; and the angle about which the law is even, which is
near that of the upright link.
"""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Hyperparameter, Missing, number
from mbcacq.effects.functions import DescribedPart, Function, Product
from mbcacq.geometry.gravity import upright_angle

NAME = "gravity_compensator"
DECLARED = Declaration(challenge=Challenge(number=19, companions=("joint_compliance",)))
LEVER_RATIOS = np.array([0.15, 0.25, 0.4])  # k / D of built balancers
TYPICAL = 1e-4  # rad: half a wind-up of 0.2 mrad, as of 1 kN m at 2e-7 rad/(N m)
UPRIGHT_SIGMA = np.radians(10.0)
STEP = 1e-3  # rad, of a numerical derivative
LEAST_SPAN = np.radians(20.0)
HEAVY_KG = 200.0  # mass of the links: a lighter arm whose A2 may turn all around has no rod that would be in its way


def candidates(context: Context) -> list[Candidate]:
    """One candidate at A2 of three coefficients (rad): constant force, growing force, shift of the upright angle times the first."""
    robot = context.obs.cell.robot
    upright = None if context.n < 3 else upright_angle(robot.chain, robot.gravity)
    if upright is None:
        raise Missing("A2 does not lift the arm against gravity")
    if robot.mass.sum() < HEAVY_KG and np.ptp(robot.limits[1]) >= 2 * np.pi:
        raise Missing("A2 of this light arm turns all around, past where the rod of a balancer would be")
    if np.ptp(context.obs.q[:, 1]) < LEAST_SPAN:
        raise Missing("A2 turns too little for the law of a balancer")

    def described(ratio):
        def lever(shift: float) -> Function:
            return Function("q2", "lever", (upright + shift, ratio))

        constant = (Product(1.0, (lever(0.0),)),)
        growing = (Product(1.0, (lever(0.0), Function("q2", "stretch", (upright, ratio)))),)
        turned = (Product(0.5 / STEP, (lever(STEP),)), Product(-0.5 / STEP, (lever(-STEP),)))
        return [DescribedPart("joint", 1, 0, (constant, growing, turned))]

    def report(c, v, ratio):
        first = c[0] if abs(c[0]) > 1e-30 else 1e-30
        slope = np.array([-c[2] / first, 0.0, 1.0]) / first
        std = np.sqrt(np.diag(v))
        return {
            "A2.preload_deg": number(np.degrees(c[0]), np.degrees(std[0])),
            "A2.stretched_deg": number(np.degrees(c[1]), np.degrees(std[1])),
            "A2.zero_deg": number(np.degrees(upright + c[2] / first), np.degrees(np.sqrt(max(slope @ v @ slope, 0.0)))),
        }

    typical = np.array([TYPICAL, TYPICAL, TYPICAL * UPRIGHT_SIGMA])
    hyper = Hyperparameter("lever_ratio", LEVER_RATIOS, 2.0, refine=False)
    return [Candidate(NAME, ("A2",), "q2", described, report, typical, hyper)]

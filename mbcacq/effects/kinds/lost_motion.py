"""Lost motion: a gearbox that is soft about zero torque and stiff beyond. Data sheets give it by K1, K2 and the torque T1 between them, or
by K1, K2, K3 with the torques T1 and T2.

A wind-up with the slope 1/K1 up to the torque T1 and 1/K2 beyond has two parts. The linear one, tau / K2, is ``joint_compliance``. The
other one grows up to T1 and stays: h clip(tau / T1, -1, 1), with h = T1 (1/K1 - 1/K2). The lost motion is 2 h, the angle between the two
stiff branches, prolonged to zero torque. Each further branch is one more such part at the same joint; the evidence decides how many.
"""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration, Refinement
from mbcacq.effects.effect import BREAKPOINT, Candidate, Hyperparameter, Missing, Parameters, StandstillRows, Support, angle, number
from mbcacq.effects.functions import DescribedPart, Function, Product

NAME = "lost_motion"
TORQUE = "breakpoint_Nm"
SHARES = np.geomspace(0.05, 0.7, 12)  # of the largest torque; below, it is backlash under load, above, it is compliance
LEAST_TORQUE = 0.5  # N m
LEAST_TYPICAL = 5e-5  # rad: half a lost motion of a third of an arc minute

# rad, half of it: data sheets state 0.3 mrad (cycloidal) to 3 mrad (planetary) of lost motion; worn gears have a few times as much.
LARGEST = Support(5e-3, "no gearbox loses more than 10 mrad")


def candidates(context: Context) -> list[Candidate]:
    """For each joint whose gravity torque is on both sides of a breakpoint: half the lost motion in rad, and the breakpoint to be found."""
    if not context.masses_known:
        raise Missing("no masses of the links given")
    torque = context.gravity_torque
    return [of_joint(context, i) for i in range(context.n) if np.ptp(torque[:, i]) > max(0.02 * np.ptp(torque, axis=0).max(), LEAST_TORQUE)]


def stiffnesses(joint: str, compliance: np.ndarray, covariance: np.ndarray) -> Parameters:
    """K1, K2 .. of a data sheet in N m/rad.

    compliance: (b + 1,) rad/(N m): of the last branch, then by how much it is larger below each breakpoint, by rising torque; covariance:
    (b + 1, b + 1) of these. A branch is left out where its compliance is not larger than twice its standard deviation: its stiffness has
    no upper end.
    """
    breakpoints = len(compliance) - 1
    out = {}
    for branch in range(breakpoints + 1):
        beyond = np.r_[1.0, np.arange(breakpoints) >= branch]  # the breakpoints at which this branch ends, or which are further out
        total, std = float(beyond @ compliance), float(np.sqrt(beyond @ covariance @ beyond))
        if total > 2 * std:
            out[f"{joint}.K{branch + 1}_Nm_per_rad"] = number(1 / total, std / total**2)
    return out


def of_joint(context: Context, i: int) -> Candidate:
    tau, cause = context.gravity_torque[:, i], f"gravity_torque_{context.tags[i]}"
    values = SHARES * np.abs(tau).max()

    def described(at):
        return [DescribedPart("joint", i, 0, ((Product(1.0 / at, (Function(cause, "clip", (at,)),)),),))]

    def report(c, v, at):
        h, std = float(c[0]), float(np.sqrt(v[0, 0]))
        return {
            f"{context.axes[i]}.lost_motion_deg": angle(2 * h, 2 * std),
            f"{context.axes[i]}.excess_compliance_rad_per_Nm": number(h / at.value, std / at.value),
            f"{context.axes[i]}.{TORQUE}": number(at.value, at.value * std / max(abs(h), 1e-30)),
        }

    rows, hyper = StandstillRows(described, np.array([LEAST_TYPICAL])), Hyperparameter(TORQUE, values, 3.0, kind=BREAKPOINT)
    return Candidate(NAME, (context.axes[i],), cause, rows, report, hyper, positive=True, several=True, support=LARGEST)


DECLARED = Declaration(
    refines=Refinement(of="joint_compliance", excess=lambda at: 1.0 / at, report=stiffnesses),
    challenge=Challenge(number=17, companions=("joint_compliance",)),
)

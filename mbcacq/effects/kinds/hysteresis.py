"""Hysteresis of a gearbox under load: friction that grows with the torque leaves the joint behind its last motion."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Missing, Report, StandstillRows, Support, angle, number
from mbcacq.effects.functions import DescribedPart, Function, Product

NAME = "hysteresis"
DECLARED = Declaration(needs=("direction",), challenge=Challenge(number=18))

LARGEST = 5e-3  # rad, half of it at the largest torque: friction holds back no more than a gearbox winds up by


def candidates(context: Context) -> list[Candidate]:
    """For each loaded joint that came from both sides: rad/(N m), negative where the joint stays behind its motion.

    The part that does not depend on the load is ``backlash`` by the direction.
    """
    direction, torque = context.obs.direction, context.gravity_torque
    if direction is None:
        raise Missing("no senses of motion recorded (dir1..)")
    if not context.masses_known:
        raise Missing("no masses of the links given")
    out = []
    for i in range(context.n):
        if np.ptp(direction[:, i]) == 0 or np.ptp(torque[:, i]) < 0.02 * np.ptp(torque, axis=0).max() + 1e-9:
            continue
        load = Function(f"gravity_torque_{context.tags[i]}")
        size = (Function(f"direction_{context.tags[i]}"), Function(f"gravity_torque_{context.tags[i]}", "sign", ()), load)
        parts = [DescribedPart("joint", i, 0, ((Product(1.0, size),),))]
        largest = float(np.abs(torque[:, i]).max())
        rows = StandstillRows(parts, np.array([5e-5 / max(largest, 1e-9)]))
        support = Support(LARGEST / max(largest, 1e-9), f"friction leaves no gearbox wound up by more than {LARGEST * 1e3:.0f} mrad")
        report = report_of(context.axes[i], largest)
        out.append(Candidate(NAME, (context.axes[i],), f"direction_{context.tags[i]}", rows, report, support=support))
    return out


def report_of(axis: str, largest: float) -> Report:
    """Full width at the largest torque of the recording, and half of it for each N m."""

    def report(c, v, _):
        half, std = float(abs(c[0])), float(np.sqrt(v[0, 0]))
        return {f"{axis}.hysteresis_deg": angle(2 * half * largest, 2 * std * largest), f"{axis}.half_width_rad_per_Nm": number(half, std)}

    return report

"""Settling: after a pause a joint is not yet where it is later. It sags through its brakes, or creeps back after it stood under load.

The history of a pose is the time since the one before it, the time since the last pause, and its number within the visit to a station.
"""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Hyperparameter, Missing, StandstillRows, plain_report
from mbcacq.effects.functions import Column, DescribedPart, of, times
from mbcacq.quantities import in_degrees

NAME = "joint_settling"
DECLARED = Declaration(acts_in_time=True, needs=("time_s",), challenge=Challenge(number=22))
FEWEST = 3  # poses on either side of a pause's least length, to tell a habit from a single error
GAP = 1.5  # between two neighbouring lengths of pauses, so that they are of two kinds
CREEP_S = np.array([15.0, 30.0, 60.0, 120.0, 300.0])  # time constants: grease, and rubber under load
VISIT = np.array([0.2, 1.0, 2.5])  # poses after which it has faded; after the first one at 0.2
TYPICAL = 5e-5  # rad: 50 um at a metre, as brakes and belts leave


def candidates(context: Context) -> list[Candidate]:
    """For each joint its error after a pause, at the beginning of a visit, or fading with the time since a pause. It is in a direction of
    its own, or to the side to which the weight pulls. Coefficients in rad.
    """
    histories = [*_by_time(context), *_by_visit(context)]
    if not histories:
        raise Missing("no pauses, and no station with several poses")
    torque = context.gravity_torque
    out = []
    for i in np.flatnonzero(np.ptp(context.obs.q, axis=0) > 0).tolist():
        pulls = context.masses_known and np.any(torque[:, i] > 0) and np.any(torque[:, i] < 0)
        sides = {"": None, " under load": of(f"gravity_torque_{context.tags[i]}", "sign")} if pulls else {"": None}
        for cause, function, hyper in histories:
            for side, sign in sides.items():
                out.append(of_joint((i, context.axes[i]), cause, function, hyper, sign, f"{cause}{side}"))
    return out


def of_joint(joint: tuple[int, str], cause: str, function: str, hyper: Hyperparameter, sign: Column | None, variant: str) -> Candidate:
    i, axis = joint

    def described(value: float) -> list[DescribedPart]:
        column = of(cause, function, value)
        return [DescribedPart("joint", i, 0, (column if sign is None else times(column, sign),))]

    report = plain_report(f"{axis}.sag_deg", scale=float(in_degrees(1)), hyper_name=f"{axis}.{hyper.name}")
    return Candidate(NAME, (axis,), cause, StandstillRows(described, np.array([TYPICAL])), report, hyper, variant=variant)


def _by_time(context: Context) -> list[tuple[str, str, Hyperparameter]]:
    try:
        pause = context.pause
    except Missing:
        return []
    lengths = np.sort(pause)
    between = [k for k in range(FEWEST, len(lengths) - FEWEST + 1) if lengths[k] > GAP * max(lengths[k - 1], 1e-9)]
    if not between:
        return []
    values = np.array([float(np.sqrt(max(lengths[k - 1], 1e-9) * lengths[k])) for k in between])
    least = Hyperparameter("least_pause_s", values, 1.0, refine=False)
    creep = Hyperparameter("time_constant_s", CREEP_S, 2.0, refine=False)
    return [("pause", "step", least), ("since_pause", "decay", creep)]


def _by_visit(context: Context) -> list[tuple[str, str, Hyperparameter]]:
    first = context.visit == 0
    if min(first.sum(), (~first).sum()) < FEWEST:
        return []
    return [("visit", "decay", Hyperparameter("fades_within_poses", VISIT, 1.0, refine=False))]

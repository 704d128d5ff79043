"""Torque lost in the drive train: Coulomb and viscous; where they show, Stribeck friction, growth with load, difference by direction.

Coulomb friction follows the direction of the last motion and keeps its value at standstill only in sign: samples at standstill take no
part (there the drive may give anything up to the stiction). Form: Olsson et al., Friction models and friction compensation, 1998.
"""

from __future__ import annotations

import numpy as np

from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Hyperparameter, plain_report
from mbcacq.effects.motion_effect import ChannelGroup, MotionRows, MotionSignals, available

NAME = "friction"
# The second law of thermodynamics: Coulomb, viscous and Stribeck friction together take energy at every speed, whatever the sign of each.
DECLARED = Declaration(every_arm=True, motor_side=True, dissipative=True, model_block="friction", challenge=Challenge(in_motion=3))
LEAST_LOAD = 0.05  # change of the load, as a share of the torque's, without which no dependence on it can be seen
LEAST_SPEED = 1e-3  # rad/s; a joint that is slower throughout stands still
UNEVEN = 0.03  # sigma of what friction differs by between the directions, as a share of the largest torque: of friction it is a quarter
STRIBECK_SPEEDS = np.geomspace(0.01, 0.4, 8)  # tried, as shares of the fastest speed: outside, it looks like Coulomb or viscous friction


def motion_candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[Candidate]:
    if group.name != "tau":
        return []
    out = []
    for j in group.joints:
        fastest = max(float(np.abs(run.qd[:, j]).max()) for run in runs)
        if fastest >= LEAST_SPEED:
            largest = max(float(np.abs(available(run.torque)[:, j]).max()) for run in runs)
            varies = (np.ptp(np.abs(available(run.rigid)[:, j])) > LEAST_LOAD * np.ptp(available(run.torque)[:, j]) for run in runs)
            out += _of_joint(group, j, fastest, largest, with_load=all(varies))
    return out


def _of_joint(group: ChannelGroup, j: int, fastest: float, largest: float, with_load: bool) -> list[Candidate]:
    """fastest: rad/s, largest: torque in N m, of all recordings."""
    axis = group.axes[j]
    here = (axis,), f"qd{group.tags[j]}"
    plain = plain_report(f"{axis}.coulomb_Nm", f"{axis}.viscous_Nms_per_rad")
    stribeck = plain_report(f"{axis}.stribeck_Nm", hyper_name=f"{axis}.stribeck_speed_rad_per_s")
    uneven = plain_report(f"{axis}.coulomb_uneven_Nm", f"{axis}.viscous_uneven_Nms_per_rad")
    load = plain_report(f"{axis}.load_dependent")
    speeds = Hyperparameter(f"{axis}.stribeck_speed_rad_per_s", STRIBECK_SPEEDS * fastest, 3.0)
    # Without a bound it would be a free offset of the torque, which stands for a balancer or a mass where a joint moves little.
    by_direction = (UNEVEN * largest, UNEVEN * largest / fastest)
    out = [
        Candidate(NAME, *here, MotionRows((j,), _plain, usual=True), plain, positive=True),
        Candidate(NAME, *here, MotionRows((j,), _stribeck, extends=True), stribeck, speeds, variant="stribeck"),
        Candidate(NAME, *here, MotionRows((j,), _uneven, by_direction, extends=True), uneven, variant="direction"),
    ]
    if with_load:
        out.append(Candidate(NAME, *here, MotionRows((j,), _load, extends=True, follows_load=True), load, variant="load"))
    return out


def _plain(run: MotionSignals, joint: int, _: object) -> np.ndarray:
    return np.stack([run.direction[:, joint], run.qd[:, joint]], axis=1)


def _stribeck(run: MotionSignals, joint: int, speed: float) -> np.ndarray:
    return (run.direction[:, joint] * np.exp(-((run.qd[:, joint] / speed) ** 2)))[:, None]


def _load(run: MotionSignals, joint: int, _: object) -> np.ndarray:
    load = available(run.rigid) if run.load is None else run.load
    return (run.direction[:, joint] * np.abs(load[:, joint]))[:, None]


def _uneven(run: MotionSignals, joint: int, _: object) -> np.ndarray:
    return np.stack([np.abs(run.direction[:, joint]), np.abs(run.qd[:, joint])], axis=1)

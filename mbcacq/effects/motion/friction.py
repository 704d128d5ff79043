"""Torque lost in the drive train: Coulomb and viscous; then, where they show, the Stribeck bump, growth with load, unequal senses.

Coulomb friction follows the sense of the last motion and keeps its value at standstill only in sign: samples at standstill take no
part (there the drive may give anything up to the stiction). Form: Olsson et al., Friction models and friction compensation, 1998.
"""

from __future__ import annotations

import numpy as np

from mbcacq.effects.motion.effect import ChannelGroup, MotionCandidate, MotionSignals, plain_report

NAME = "friction"
LEAST_LOAD = 0.05  # change of the load, as a share of the torque's, without which no dependence on it can be seen


def candidates(group: ChannelGroup, runs: tuple[MotionSignals, ...]) -> list[MotionCandidate]:
    if group.name != "tau":
        return []
    out = []
    for j in group.joints:
        axis, depends = f"A{j + 1}", f"qd{j + 1}"
        fastest = max(float(np.abs(run.qd[:, j]).max()) for run in runs)
        if fastest < 1e-3:
            continue
        place = ((axis,), depends, (j,))
        out += [
            MotionCandidate(NAME, *place, _plain, plain_report(f"{axis}.coulomb_Nm", f"{axis}.viscous_Nms_per_rad"), positive=True),
            MotionCandidate(
                NAME,
                *place,
                _stribeck,
                plain_report(f"{axis}.stribeck_Nm", hyper_name=f"{axis}.stribeck_speed_rad_per_s"),
                hyper=np.geomspace(0.01, 0.4, 8) * fastest,
                search=3.0,
                extends=True,
                tag="stribeck",
            ),
            MotionCandidate(
                NAME,
                *place,
                _uneven,
                plain_report(f"{axis}.coulomb_uneven_Nm", f"{axis}.viscous_uneven_Nms_per_rad"),
                extends=True,
                tag="direction",
            ),
        ]
        if all(np.ptp(np.abs(run.rigid[:, j])) > LEAST_LOAD * np.ptp(run.torque[:, j]) for run in runs):
            out.append(MotionCandidate(NAME, *place, _load, plain_report(f"{axis}.load_dependent"), extends=True, tag="load", by_load=True))
    return out


def _plain(run: MotionSignals, joint: int, _: float | None) -> np.ndarray:
    return np.stack([run.sense[:, joint], run.qd[:, joint]], axis=1)


def _stribeck(run: MotionSignals, joint: int, speed: float | None) -> np.ndarray:
    return (run.sense[:, joint] * np.exp(-((run.qd[:, joint] / speed) ** 2)))[:, None]


def _load(run: MotionSignals, joint: int, _: float | None) -> np.ndarray:
    load = run.rigid if run.load is None else run.load
    return (run.sense[:, joint] * np.abs(load[:, joint]))[:, None]


def _uneven(run: MotionSignals, joint: int, _: float | None) -> np.ndarray:
    return np.stack([np.abs(run.sense[:, joint]), np.abs(run.qd[:, joint])], axis=1)

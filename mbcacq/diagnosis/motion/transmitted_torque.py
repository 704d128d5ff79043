"""The torque that passes the gears, as far as it is known: without what stays in the drive (friction, rotor, ripple, a late clock)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import savgol_filter

from mbcacq.diagnosis.motion.fit import MotionFit
from mbcacq.diagnosis.motion.result import noise_floor
from mbcacq.effects.motion.effect import OF_THE_DRIVE, MotionSignals

LOAD_WINDOW_S = 0.1
DOUBT = 0.05  # of a load that is the drive's torque: a rotor's part of it is not told apart
UNDERSTOOD = 4.0  # chi2 per degree of freedom below which the torque of a joint counts as explained


def with_load(runs: tuple[MotionSignals, ...], torque: MotionFit) -> tuple[MotionSignals, ...]:
    """The runs with the torque that passes the gears, joint by joint.

    Where the torque is explained, that of the arm as it was found, without what stays in the drive: friction, rotor, ripple, a late
    clock. Else what the drive gave, less its friction.
    """
    out = []
    understood = torque.train_end < UNDERSTOOD * noise_floor(torque) ** 2
    for k, run in enumerate(runs):
        load = run.rigid.copy()
        window = min(max(2 * int(LOAD_WINDOW_S / run.step_s / 2) + 1, 5), (len(load) - 1) // 2 * 2 - 1)
        for place, joint in enumerate(torque.group.joints):
            if understood[place]:
                others = sum(f.contributions[place][k] for f in torque.found if f.name not in OF_THE_DRIVE)
                load[:, joint] += torque.links[place][k] + others
            else:  # smoothed: noise of a covariate would shrink its coefficient
                lost = sum(f.contributions[place][k] for f in torque.found if f.name in OF_THE_DRIVE)
                load[:, joint] = savgol_filter(run.torque[:, joint] - lost, window, 2)
        doubt = np.zeros(load.shape[1])
        for place, joint in enumerate(torque.group.joints):
            doubt[joint] = torque.load_doubt[place] if understood[place] else DOUBT
        out.append(replace(run, load=load, load_doubt=doubt))
    return tuple(out)

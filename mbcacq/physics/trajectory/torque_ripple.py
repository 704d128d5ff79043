"""Torque periodic in the joint's or the motor's angle: cogging, gear meshing, commutation."""

from __future__ import annotations

from mbcacq.physics.trajectory.effect import Candidate, Channel, Run, orders, sine_report
from mbcacq.physics.trajectory.gear_transmission_error import _waves

NAME = "torque_ripple"


def candidates(channel: Channel, runs: tuple[Run, ...]) -> list[Candidate]:
    if channel.name != "tau":
        return []
    ratio = runs[0].gear_ratio
    tried = orders(runs, channel.joint, 12.5 * ratio[channel.joint] if ratio is not None else 600.0)
    tried = tried[tried > 6.0]  # slower waves are gravity's
    if not len(tried):
        return []
    report = sine_report("amplitude_Nm", 1.0)
    return [Candidate(NAME, (channel.axis,), f"q{channel.joint + 1}", _waves,
                      lambda c, v, order: {f"{channel.axis}.{k}": p for k, p in report(c, v, order).items()},
                      hyper=tried, several=True, search=len(tried) / 4)]

"""The gearbox winds up under load: the joint side lags the motor side by compliance times the torque that passes the gear.

Friction in front of the gear winds nothing up, so the load is the drive's torque without the friction found in its own channel.
"""

from __future__ import annotations

from mbcacq.physics.trajectory.effect import Candidate, Channel, Run, value

NAME = "joint_compliance"


def candidates(channel: Channel, runs: tuple[Run, ...]) -> list[Candidate]:
    if channel.name != "q_joint" or any(run.load is None for run in runs):
        return []
    return [Candidate(
        NAME, (channel.axis,), f"tau{channel.joint + 1}", lambda run, joint, _: -run.load[:, [joint]],
        lambda c, v, _: value(f"{channel.axis}.compliance_rad_per_Nm", c[0], v[0, 0]), positive=True,
    )]

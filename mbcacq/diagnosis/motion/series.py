"""The channels of a diagnosis of motion over time: measured, and as the model has them without and with the effects."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbcacq.diagnosis.motion.fit import MotionFit
from mbcacq.diagnosis.motion.result import ChannelFit
from mbcacq.effects.motion_effect import MotionSignals
from mbcacq.model.channel_series import ChannelSeries, MotionSeries
from mbcacq.model.trajectory import Trajectory


def motion_series(
    fits: Sequence[MotionFit], channels: Sequence[ChannelFit], trajectories: Sequence[Trajectory], runs: Sequence[MotionSignals]
) -> MotionSeries:
    """Every channel over time, as it was fitted to all data. A joint whose model is refused (``channels``) has none: after is as before."""
    names = tuple(dict.fromkeys(t.name for t in trajectories))
    refused = {(c.channel, c.at) for c in channels if c.refused_rms is not None}
    found = []
    for fit in fits:
        unit, scale = ("deg", float(np.degrees(1))) if fit.group.unit == "rad" else (fit.group.unit, 1.0)
        shown = fit.group.signal if fit.group.name == "tau" else fit.group.mismatch
        for j, joint in enumerate(fit.group.joints):
            at = f"A{joint + 1}"
            kept = fit.residual_before if (fit.group.name, at) in refused else fit.residual_after
            for k, (trajectory, run) in enumerate(zip(trajectories, runs, strict=True)):
                measured = shown[k][:, j]
                before, after = (
                    scale * np.where(fit.used[j][k], measured - residual[j][k], np.nan) for residual in (fit.residual_before, kept)
                )
                time = float(trajectory.time_s[0]) + run.step_s * np.arange(len(measured))
                number = names.index(trajectory.name)
                found.append(
                    ChannelSeries(
                        channel=fit.group.name,
                        at=at,
                        unit=unit,
                        recording=number,
                        time_s=time,
                        measured=scale * measured,
                        before=before,
                        after=after,
                    )
                )
    return MotionSeries(trajectories[0].robot.name, names, tuple(found))

"""Events of a run that say no more than which pose they are of."""

import numpy as np

from mbcacq.acquisition import events


def pose_done(pose: int, station: str = "p") -> events.PoseDone:
    """A pose that was measured, without anything seen in it."""
    none = np.zeros(0)
    return events.PoseDone(
        time_s=1.0,
        pose=pose,
        station=station,
        phase="position",
        step="s",
        q=none,
        direction=none,
        robot_time_s=0.0,
        ball=none,
        xyz=none,
        n_points=none,
        rms_mm=none,
        scatter_mm=none,
        n_exposures=1,
    )

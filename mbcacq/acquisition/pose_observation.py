"""The observation of one pose as an event, whether its exposures were taken just now or come from files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypedDict

import numpy as np

from mbcacq.acquisition import events
from mbcacq.acquisition.event_bus import EventBus
from mbcacq.acquisition.expected_view import mean_centres
from mbcacq.plan import PlannedPose
from mbcacq.spheres.found import FoundSpheres


class ArmAtPose(TypedDict, total=False):
    """What is known of the arm, and of the cell, while a pose was exposed: fields of ``PoseDone``."""

    q: np.ndarray
    direction: np.ndarray
    robot_time_s: float
    current: np.ndarray | None
    sensors: Mapping[str, float]
    facts: Mapping[str, str]


def emit_observation(bus: EventBus, pose: PlannedPose, found: Sequence[FoundSpheres], min_balls: int, label: str, arm: ArmAtPose) -> bool:
    """Emit ``PoseDone`` with the mean of the exposures that were kept, and return True; or a gap and False if they show too few balls.

    Parameters
    ----------
    found
        Centres of the exposures that were kept.
    min_balls
        Fewest balls of an observation, of the plan; all of a pose that shows fewer.
    label
        What the sentence on too few balls calls the pose beside its number.
    """
    mean = mean_centres(found)
    if len(mean.ball) < min(min_balls, len(pose.balls)):
        few = f"{len(mean.ball)} of {len(pose.balls)} balls found, pose left out"
        bus.gap("pose", f"pose {pose.number} ({label}): {few}", pose.number)
        return False
    about = (pose.number, pose.station, pose.phase, pose.step_name)
    bus.emit(events.PoseDone, *about, **vars(mean), n_exposures=len(found), **arm)
    return True

"""One sweep measured: the laser plane of a line scanner crosses a ball forth and back, while profiles and cycles are recorded."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np

from mbcacq.acquisition import events
from mbcacq.acquisition.cycle_collector import CycleCollector
from mbcacq.acquisition.event_bus import EventBus
from mbcacq.acquisition.expected_view import predicted_centres
from mbcacq.acquisition.mover import Mover
from mbcacq.devices import (
    ConfigError,
    ConnectError,
    DeviceFault,
    DeviceTimeout,
    MbcacqError,
    Profiles,
    ProfileScanner,
    ProtocolError,
    Scanner,
)
from mbcacq.plan import LoadedPlan, PlannedPose
from mbcacq.plan.motion_limits import sweep_limits
from mbcacq.plan.schema import Sweep

LEAST_PROFILES = 8


class StreamBroke(DeviceFault):
    """The profiles of a sweep did not come whole."""


def line_scanner(scanner: Scanner) -> ProfileScanner:
    """The scanner as one that streams. Raises ConfigError."""
    if not isinstance(scanner, ProfileScanner):
        raise ConfigError("the plan has a step 'sweep', and its scanner streams no profiles; use the driver of a line scanner")
    return scanner


def take_sweep(
    pose: PlannedPose, loaded: LoadedPlan, scanner: ProfileScanner, bus: EventBus, mover: Mover, collector: CycleCollector
) -> Profiles:
    """Move forth and back from the pose, at which the arm stands, and return what was seen meanwhile.

    Raises SafetyStop if the arm does not arrive, StreamBroke where the scanner's connection broke or was out of step, and what the scanner
    raises else; the scanner is at rest again in every case.
    """
    step = loaded.plan.steps[pose.step]
    assert isinstance(step, Sweep), "a pose has a sweep if its step has"
    assert pose.sweep is not None, "it is asked for before"
    limits = sweep_limits(loaded, pose.q, pose.sweep, step.speed_mm_s)
    collector.mark()
    began_s = mover.state().time_s
    with _breaks_off():
        scanner.start_profiles()
    try:
        mover.go(pose.sweep, limits)
        mover.go(pose.q, limits)
    except BaseException:
        with suppress(MbcacqError):  # what stopped the arm counts
            scanner.end_profiles()
        raise
    with _breaks_off():
        scanner.end_profiles()
        found = scanner.profiles()
    bus.emit(events.SweepTaken, pose.number, pose.balls[0], began_s, expected_ball(loaded, pose), found)
    return found


@contextmanager
def _breaks_off() -> Iterator[None]:
    try:
        yield
    except (ConnectError, DeviceTimeout, ProtocolError) as error:
        raise StreamBroke(f"its profiles broke off: {error}") from error


def expected_ball(loaded: LoadedPlan, pose: PlannedPose) -> np.ndarray:
    """(3,) mm in the scanner's frame: where the ball is expected in the middle of the sweep."""
    assert pose.sweep is not None, "it is asked for a sweep"
    return predicted_centres(loaded.cell, replace(pose, q=(pose.q + pose.sweep) / 2))[0]

"""What was measured in time beside what a model says: one joint of one channel of a recording of motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class ChannelSeries:
    """One joint of one channel over T equidistant times.

    Attributes
    ----------
    channel : str
        Kind of channel ('tau', 'q_joint', 'q_set').
    at : str
        The joint, 'A2'.
    unit : str
        'deg' or 'N m'.
    recording : int
        Number among those of ``MotionSeries``.
    time_s : ndarray
        (T,) on the recording's clock.
    measured : ndarray
        (T,) the torque, or the angle's difference from the one that it is compared with.
    before, after : ndarray
        (T,) what the model says without and with the effects; NaN where nothing is compared.
    """

    channel: str
    at: str
    unit: str
    recording: int
    time_s: np.ndarray
    measured: np.ndarray
    before: np.ndarray
    after: np.ndarray

    def residual(self, when: str) -> np.ndarray:
        """(T,) measured minus the model, 'before' or 'after'."""
        return self.measured - (self.before if when == "before" else self.after)

    def part(self, where: slice) -> ChannelSeries:
        """A stretch of it."""
        return replace(self, **{name: getattr(self, name)[where] for name in ("time_s", "measured", "before", "after")})


@dataclass(frozen=True, eq=False)
class MotionSeries:
    """All channels of the recordings that were diagnosed together. robot: its name; recordings: their names; a recording in several
    stretches has several series of a channel and joint."""

    robot: str
    recordings: tuple[str, ...]
    channels: tuple[ChannelSeries, ...]

    def kinds(self) -> list[str]:
        """The kinds of channel, in their order."""
        return list(dict.fromkeys(c.channel for c in self.channels))

    def of(self, channel: str, recording: int | None = None) -> list[ChannelSeries]:
        """The series of one kind of channel, of one recording or of all."""
        return [c for c in self.channels if c.channel == channel and recording in (None, c.recording)]

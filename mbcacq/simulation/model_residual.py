"""What was recorded minus what the sensors of a MuJoCo model give: channels, the samples that count, their noise, and derivatives by the
coordinates of blocks, which are differences of runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbcacq.diagnosis.motion.noise import third_difference_noise
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.diagnosis.motion.signals import rates
from mbcacq.model.trajectory import Trajectory
from mbcacq.simulation.mujoco_arm import (
    ENCODER,
    JOINT_SIDE,
    TORQUE,
    MujocoArm,
    RecordedSignal,
    channels_of,
    recorded,
    roll_out,
    sensors_of,
    torque_along,
    with_sensors,
)
from mbcacq.simulation.parameters import Block

SEGMENT_S = 0.5  # residuals further apart count as independent
EDGE_S = 0.1  # after the first motion; and at both ends of a recording without new runs, where rates are not known
FIRST_MOTION_RAD = 5e-3  # after which friction no longer holds what it held before the recording
TIME_BLOCKS = 6  # held-out parts of a single recording
SMOOTH_FLOOR = 1e-6  # least standard deviation of a channel, as a share of its range: of recordings without noise


class ModelResidual:
    """Recordings beside a model of their arm. runs: whether the model runs by its servos; else the torque along the recorded motion is
    compared. channels: C signals that all recordings have; data: (T, C) of each recording; used: (T,) bool of the samples that count, N in
    all; noise: (C,) standard deviation of each channel."""

    def __init__(self, arm: MujocoArm, trajectories: Sequence[Trajectory], workers: int = 2) -> None:
        self.arm, self.trajectories, self.workers = arm, list(trajectories), workers
        self.runs = runs_by_servos(arm, trajectories)
        channels = channels_of(arm, trajectories)
        self.channels = channels if self.runs else [c for c in channels if c.signal != ENCODER]
        self.data = [recorded(t, self.channels) for t in self.trajectories]
        self.used = [_after_first_motion(t) if self.runs else _inside(t) for t in self.trajectories]
        self.noise = np.array([_noise([d[:, c] for d in self.data]) for c in range(len(self.channels))])

    def template(self, blocks: Sequence[Block]) -> Any:
        """The model with what the blocks need, at their start."""
        spec = self.arm.spec.copy()
        for block in blocks:
            block.prepare(spec)
        with_sensors(self.arm, spec, any(c.signal == JOINT_SIDE for c in self.channels))
        for block in blocks:
            if block.name == "sensor_delay":
                block.prepare(spec)
        return spec

    def residuals(self, blocks: Sequence[Block], many: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
        """(B, N, C) in units of the channels, the recordings one after the other."""
        template = self.template(blocks)
        specs = []
        for values in many:
            spec = template.copy()
            for block, x in zip(blocks, values, strict=True):
                block.apply(spec, x)
            specs.append(spec)
        return np.concatenate(
            [(d - self.predict(specs, t))[:, used] for t, d, used in zip(self.trajectories, self.data, self.used, strict=True)], axis=1
        )

    def predict(self, specs: Sequence[Any], t: Trajectory) -> np.ndarray:
        """(B, T, C) what the sensors of each model give along one recording."""
        if self.runs:
            return roll_out(self.arm, specs, t, self.channels, self.workers)
        return np.stack([along(self.arm, spec, t, self.channels) for spec in specs])

    def jacobian(self, blocks: Sequence[Block], x: Sequence[np.ndarray], wanted: Sequence[Block]) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (N, C) at x, and their derivatives (N, C, k) by the coordinates of the wanted blocks."""
        many = [list(x)]
        for block in wanted:
            number = [b.key for b in blocks].index(block.key)
            for k in range(block.size):
                moved = [np.array(v) for v in x]
                moved[number][k] += block.step[k]
                many.append(moved)
        steps = np.concatenate([b.step for b in wanted]) if wanted else np.zeros(0)
        out = self.residuals(blocks, many)
        return out[0], np.moveaxis((out[1:] - out[0]) / steps[:, None, None], 0, 2)

    def segments(self) -> np.ndarray:
        """(N,) number of the half second of each sample."""
        out, first = [], 0
        for t, used in zip(self.trajectories, self.used, strict=True):
            number = ((t.time_s - t.time_s[0])[used] // SEGMENT_S).astype(int) + first
            out.append(number)
            first = int(number.max()) + 1
        return np.concatenate(out)

    def parts(self) -> np.ndarray:
        """(N,) number of the part of each sample that is held out together: its recording, or its block of time in a single recording."""
        if len(self.trajectories) > 1:
            return np.concatenate([np.full(int(u.sum()), k) for k, u in enumerate(self.used)])
        n = int(self.used[0].sum())
        return np.arange(n) * TIME_BLOCKS // n


def runs_by_servos(arm: MujocoArm, trajectories: Sequence[Trajectory]) -> bool:
    """Whether new runs can be made: every axis has a servo, every recording its set points."""
    return arm.servos is not None and all(t.q_set is not None and np.isfinite(t.q_set).all() for t in trajectories)


def along(arm: MujocoArm, spec: Any, t: Trajectory, channels: Sequence[RecordedSignal]) -> np.ndarray:
    """(T, C) torques and joint-side angles of a model along the recorded motion, each as late as its sensor."""
    step = float(np.median(np.diff(t.time_s)))
    q, qd, qdd = (rates(t.q, step, d, NUMBERS.rate_window_s) for d in (0, 1, 2))
    torque, windup = torque_along(arm, spec, q, qd, qdd, step)
    signals = {TORQUE: torque, JOINT_SIDE: t.q + windup}
    out = np.stack([signals[c.signal][:, c.axis] for c in channels], axis=1)
    for k, c in enumerate(channels):
        delay = max((float(getattr(s, "delay", 0.0)) for s in sensors_of(spec, c.signal, arm.joints[c.axis])), default=0.0)
        out[:, k] = np.interp(t.time_s - delay, t.time_s, out[:, k])
    return out


def _after_first_motion(t: Trajectory) -> np.ndarray:
    """(T,) whether every axis that moves at all has turned far enough: where friction held it before is not recorded. At most a third of
    the recording is left out."""
    step = float(np.median(np.diff(t.time_s)))
    far = np.abs(t.q - t.q[0]) > FIRST_MOTION_RAD
    begins = [int(np.argmax(column)) for column in far.T if column.any()]
    first = min(max(begins, default=0) + int(EDGE_S / step), len(t.q) // 3)
    return np.arange(len(t.q)) >= first


def _inside(t: Trajectory) -> np.ndarray:
    """(T,) away from both ends."""
    edge = int(EDGE_S / float(np.median(np.diff(t.time_s))))
    number = np.arange(len(t.q))
    return (number >= edge) & (number < len(t.q) - edge)


def _noise(signals: list[np.ndarray]) -> float:
    return max(third_difference_noise(tuple(signals)), SMOOTH_FLOOR * float(np.ptp(np.concatenate(signals))), 1e-12)

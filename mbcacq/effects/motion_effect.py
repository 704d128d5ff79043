"""The form of an effect in time: columns of a mismatch, linear in coefficients, with one hyper-parameter at most."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from mbcacq.model.cell import RobotModel, tags_of
from mbcacq.quantities import in_degrees

FILTER_OVERSAMPLING = 4  # filter steps in one sample, where a time constant is as short as the sampling interval
SHORT_TIME_CONSTANT = 20.0  # sampling intervals; below, a filter is oversampled
NO_TIME_CONSTANT = 1e-2  # sampling intervals; below, a filter passes its input


@dataclass(frozen=True)
class MotionSignals:
    """One trajectory at equidistant times. Arrays (T, n), rad, rad/s, rad/s^2, N m on the joint side; None if not recorded.

    q is the motor-side angle the controller reports; smooth, qd and qdd are the same and its rates by a zero-phase filter. q_set is the
    command with its rates qd_set, qdd_set, qddd_set. q_joint is the joint-side encoder (NaN columns where a joint has none). torque is the
    drive's torque at the joint, and load the part of it that passes the gear (without friction). rigid is the torque of the rigid-body
    simulation, gravity its static part, and rigid_set the same torque along the command. direction: (T, n) -1..1, direction of rotation of
    the last motion. payload: (T, n, 10) torque by unit inertial parameters (``geometry.dynamics.INERTIAL``) of what rides on the flange.
    load_error: (T, n, r) what independent errors of standard deviation 1 change of the load. robot: the arm as it is described.
    """

    step_s: float
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    direction: np.ndarray
    smooth: np.ndarray
    q_set: np.ndarray | None = None
    qd_set: np.ndarray | None = None
    qdd_set: np.ndarray | None = None
    qddd_set: np.ndarray | None = None
    q_joint: np.ndarray | None = None
    torque: np.ndarray | None = None
    load: np.ndarray | None = None
    rigid: np.ndarray | None = None
    gravity: np.ndarray | None = None
    rigid_set: np.ndarray | None = None
    payload: np.ndarray | None = None
    gear_ratio: np.ndarray | None = None
    load_error: np.ndarray | None = None
    robot: RobotModel | None = None


@dataclass(frozen=True)
class ChannelGroup:
    """One kind of mismatch (recorded minus simulated) of all joints that show it. name: 'tau', 'q_joint' or 'q_set'.

    joints: which; mismatch[run] and use[run]: (T, J), use False where a sample carries no information (standstill in torque).
    base[run]: (T, J, b) columns with coefficients common to all joints, prior (b,) their sigma: inertial parameters.
    refit: an offset is a convention (zero of an encoder) and is estimated again in held-out data.
    signal[run]: (T, J) the recorded channel that is compared with the simulation at the times of q, and may be late; none for 'q_set'.
    axes: (n,) names of all joints of the arm.
    """

    name: str
    unit: str
    joints: tuple[int, ...]
    mismatch: tuple[np.ndarray, ...]
    use: tuple[np.ndarray, ...]
    base: tuple[np.ndarray, ...]
    prior: np.ndarray
    refit: bool
    signal: tuple[np.ndarray, ...] = ()
    axes: tuple[str, ...] = ()

    @property
    def tags(self) -> tuple[str, ...]:
        """(n,) what stands for each joint in the name of a quantity."""
        return tags_of(self.axes)

    @property
    def shown_unit(self) -> str:
        """The unit in which its errors are shown: degrees for angles."""
        return "deg" if self.unit == "rad" else self.unit

    @property
    def scale(self) -> float:
        """From the unit of the computation to the one that is shown."""
        return float(in_degrees(1)) if self.unit == "rad" else 1.0

    def index(self, joint: int) -> int:
        """The column of a joint in the arrays (T, J) of this group."""
        return self.joints.index(joint)


Columns = Callable[[MotionSignals, int, Any], np.ndarray]


@dataclass(frozen=True)
class MotionRows:
    """What an effect adds to a mismatch in motion.

    Attributes
    ----------
    joints
        Joints in whose mismatch it shows.
    columns
        (run, joint, value of the hyper-parameter) -> (T, k), with the same k coefficients for all of the joints. With ``refine`` the
        hyper-parameter is estimated with these, and at the first or last of its values it is a bound of what was tried, no estimate.
    sigma
        Prior standard deviation of the coefficients, one number or one each; it bounds what the data do not determine.
    extends
        A refinement of the effect of this name and location, offered only once that is selected; its parameters join that one's.
    shares_hyper
        Its hyper-parameter is that of the effect extended.
    channel_delay
        The hyper-parameter is the delay of the channel, which is corrected in the recording itself; the coefficient is the remaining delay.
    follows_load
        Its columns follow the load, which is known better the further the torque is explained.
    linear_in_load
        Its columns are proportional to the load that passes the gear, so that they pass an error of the load on to the mismatch.
    usual
        So common that it starts selected and is dropped where it is not needed.
    tested
        So many leading coefficients must differ from zero; the others only follow (None: all).
    load_parameters
        Names of its leading coefficients and factors to their units, of an effect that loads the arm as its own masses do.
    typical
        (k,) sizes of the coefficients as the search compares them, which follow from sigma or from the recording.
    """

    hyper_digits: ClassVar[int | None] = None  # a hyper-parameter is found with the coefficients: no two values are alike

    joints: tuple[int, ...]
    columns: Columns
    sigma: float | tuple[float, ...] = np.inf
    extends: bool = False
    shares_hyper: bool = False
    channel_delay: bool = False
    follows_load: bool = False
    linear_in_load: bool = False
    usual: bool = False
    tested: int | None = None
    load_parameters: tuple[tuple[str, float], ...] = ()
    typical: np.ndarray = field(default_factory=lambda: np.zeros(0))


def available(signal: np.ndarray | None) -> np.ndarray:
    """The signal of a run. A candidate is offered only where its signals were recorded, so None is an error of the program."""
    assert signal is not None, "an effect was offered without the signal that it needs"
    return signal


def low_pass(signal: np.ndarray, time_constant_s: float, step_s: float) -> np.ndarray:
    """1 / (T s + 1) applied to a smooth signal (T,), starting settled at the first value; taken as straight
    between samples, where the filter is fast between finer ones."""
    if time_constant_s < NO_TIME_CONSTANT * step_s:
        return signal
    finer = FILTER_OVERSAMPLING if time_constant_s < SHORT_TIME_CONSTANT * step_s else 1
    if finer > 1:
        from scipy.interpolate import CubicSpline  # takes a fifth of a second, which most commands do not need

        time = np.arange(len(signal))
        signal = CubicSpline(time, signal)(np.arange((len(signal) - 1) * finer + 1) / finer)
        # A chord lies above a curve by a twelfth of its second difference, on average.
        signal = signal - np.concatenate([[0.0], np.diff(signal, 2), [0.0]]) / 12.0
    ratio = step_s / finer / time_constant_s
    a = np.exp(-ratio)
    share = -np.expm1(-ratio)
    now, past = 1.0 - share / ratio, share / ratio - a
    first = signal[0]
    from scipy.signal import lfilter  # takes half a second, which most commands do not need

    return (first + lfilter([now, past], [1.0, -a], signal - first))[::finer]

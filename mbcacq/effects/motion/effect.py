"""The shape of an effect in time: columns of a mismatch, linear in coefficients, perhaps with one hyper-parameter."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

OF_THE_DRIVE = ("friction", "channel_latency", "torque_ripple")  # what of a torque never passes the gear, beside the rotor
FINER = 4  # samples between samples where a filter is as fast as the clock


@dataclass(frozen=True)
class MotionSignals:
    """One trajectory on an equidistant clock. Arrays (T, n), rad, rad/s, rad/s^2, N m on the joint side; None where not recorded.

    q is the motor-side angle the controller reports, smooth, qd and qdd the same and its rates by a zero-phase filter; q_set the
    command with its rates qd_set, qdd_set, qddd_set; q_joint the joint-side encoder (NaN columns where a joint has none); torque the
    drive's torque at the joint, load the part of it that passes the gear (friction taken out); rigid the torque of the rigid-body
    simulation, gravity its static part, rigid_set the same torque along the command. sense: (T, n) -1..1, sense of the last motion.
    payload: (T, n, 10) torque by unit inertial parameters (``geometry.dynamics.INERTIAL``) of what rides on the flange.
    load_doubt: (n,) relative standard deviation of the load.
    """

    step_s: float
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray
    sense: np.ndarray
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
    load_doubt: np.ndarray | None = None


@dataclass(frozen=True)
class ChannelGroup:
    """One kind of mismatch (recorded minus simulated) of all joints that show it. name: 'tau', 'q_joint' or 'q_set'.

    joints: which; mismatch[run] and use[run]: (T, J), use False where a sample says nothing (standstill in torque).
    base[run]: (T, J, b) columns with coefficients common to all joints, prior (b,) their sigma: inertial parameters.
    refit: an offset is convention (zero of an encoder) and is found again in data held out.
    signal[run]: (T, J) the recorded channel that is compared with the simulation on the clock of q, and may be late; none for 'q_set'.
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


Report = Callable[[np.ndarray, np.ndarray, "float | None", float], dict]


@dataclass(frozen=True)
class MotionCandidate:
    """columns(run, joint, hyper) -> (T, k), with the same k coefficients for all of ``joints``.

    report(coefficients (k,), covariance (k, k), hyper, its standard deviation) -> parameters. hyper: values to try, or None.
    positive: physics demands a positive first coefficient. search: number of independent hyper values tried, for the p-value.
    extends: a refinement of the effect of this name and place, offered only once that is there; its parameters join that one's.
    refine: the hyper-parameter is continuous and is estimated with the coefficients. follows: it is that of the effect extended.
    tuned: the hyper-parameter is the delay of the channel, which is put right in the recording itself; the coefficient is what is left.
    by_load: its columns follow the load, which is known better the further the torque is explained.
    sigma: what a coefficient may reasonably be (one sigma), one number or one each; it bounds what the data do not determine.
    """

    name: str
    where: tuple[str, ...]
    depends_on: str
    joints: tuple[int, ...]
    columns: Callable[[MotionSignals, int, float | None], np.ndarray]
    report: Report
    hyper: np.ndarray | None = None
    positive: bool = False
    search: float = 1.0
    extends: bool = False
    refine: bool = True
    follows: bool = False
    sigma: float | tuple[float, ...] = np.inf
    tuned: bool = False
    by_load: bool = False
    tag: str = ""

    @property
    def place(self) -> tuple[str, tuple[str, ...]]:
        return self.name, self.where


def plain_report(*names: str, scale: float = 1.0, hyper_name: str | None = None, least: float = 0.0) -> Report:
    """Coefficients by name, each multiplied by ``scale``, and the hyper-parameter by its name. least: standard deviation below which
    nothing is claimed."""

    def report(c: np.ndarray, v: np.ndarray, hyper: float | None, std: float) -> dict:
        std_of = scale * np.sqrt(np.maximum(np.diag(v), 0.0))
        out = {name: {"value": scale * float(c[k]), "std": float(np.hypot(std_of[k], least))} for k, name in enumerate(names)}
        return out if hyper_name is None else out | {hyper_name: {"value": float(hyper), "std": float(std)}}

    return report


def low_pass(signal: np.ndarray, time_constant_s: float, step_s: float) -> np.ndarray:
    """1 / (T s + 1) applied to a smooth signal (T,), starting settled at the first value; taken as straight
    between samples, where the filter is fast between finer ones."""
    if time_constant_s < 1e-2 * step_s:
        return signal
    finer = FINER if time_constant_s < 20 * step_s else 1
    if finer > 1:
        time = np.arange(len(signal))
        signal = CubicSpline(time, signal)(np.arange((len(signal) - 1) * finer + 1) / finer)
        # A chord lies above a curve by a twelfth of its second difference, on average.
        signal = signal - np.concatenate([[0.0], np.diff(signal, 2), [0.0]]) / 12.0
    ratio = step_s / finer / time_constant_s
    a = np.exp(-ratio)
    share = -np.expm1(-ratio)
    now, past = 1.0 - share / ratio, share / ratio - a
    first = signal[0]
    return (first + lfilter([now, past], [1.0, -a], signal - first))[::finer]

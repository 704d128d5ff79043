"""The kinds of mismatch that recordings can show: torque, joint side, set point."""

from __future__ import annotations

import numpy as np

from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.effects.motion_effect import ChannelGroup, MotionSignals
from mbcacq.geometry.dynamics import inertial_sigma
from mbcacq.model.cell import RobotModel

Runs = tuple[MotionSignals, ...]


def channel_groups(runs: Runs, inertial: list[np.ndarray], robot: RobotModel) -> list[ChannelGroup]:
    """Every kind of mismatch that all of these recordings can show. inertial: (T, n, n, 10) torque by unit inertial parameter, by run."""
    inside = tuple(_inside(run) for run in runs)
    found = (_torque(runs, inertial, robot, inside), _angles("q_joint", runs, 1.0, robot, inside), _angles("q_set", runs, -1.0, robot))
    return [group for group in found if group is not None]


def _torque(runs: Runs, inertial: list[np.ndarray], robot: RobotModel, inside: tuple) -> ChannelGroup | None:
    torque, rigid = [run.torque for run in runs if run.torque is not None], [run.rigid for run in runs if run.rigid is not None]
    if len(torque) < len(runs) or len(rigid) < len(runs):
        return None
    joints = _complete(torque)
    if not joints:
        return None
    columns = list(joints)
    sigma, fastest = inertial_sigma(robot), np.max([np.abs(run.qd).max(axis=0) for run in runs], axis=0)
    known = sigma > 0
    base = tuple(
        np.concatenate([(c * sigma)[:, joints][:, :, known], _rotors(run, robot, joints)], axis=2)
        for c, run in zip(inertial, runs, strict=True)
    )
    mismatch = tuple((t - r)[:, columns] for t, r in zip(torque, rigid, strict=True))
    use, prior = tuple((_moving(run, fastest) & k)[:, columns] for run, k in zip(runs, inside, strict=True)), np.ones(base[0].shape[2])
    signal = tuple(t[:, columns] for t in torque)
    return ChannelGroup("tau", "N m", joints, mismatch, use, base, prior, refit=False, signal=signal, axes=robot.axes)


def _angles(name: str, runs: Runs, sign: float, robot: RobotModel, inside: tuple[np.ndarray, ...] | None = None) -> ChannelGroup | None:
    """The mismatch of an angle beside that of the motor: ``sign`` times their difference.

    inside: (T, n) by run, the samples that are used where the channel may be late. The set point is not shifted, and all of it is used: a
    late set point and a late drive look the same.
    """
    signals = [s for run in runs if (s := getattr(run, name)) is not None]
    joints = _complete(signals) if len(signals) == len(runs) else ()
    if not joints:
        return None
    columns = list(joints)
    mismatch = tuple(sign * (s - run.q)[:, columns] for s, run in zip(signals, runs, strict=True))
    use = tuple(np.ones(m.shape, dtype=bool) for m in mismatch) if inside is None else tuple(k[:, columns] for k in inside)
    signal = () if inside is None else tuple(s[:, columns] for s in signals)
    no_base = tuple(np.zeros((*m.shape, 0)) for m in mismatch)
    return ChannelGroup(name, "rad", joints, mismatch, use, no_base, np.zeros(0), refit=True, signal=signal, axes=robot.axes)


def _complete(signals: list[np.ndarray]) -> tuple[int, ...]:
    """The joints that have the signal in every run."""
    return tuple(j for j in range(signals[0].shape[1]) if all(np.isfinite(s[:, j]).all() for s in signals))


def _inside(run: MotionSignals) -> np.ndarray:
    """(T, n): away from both ends of the recording."""
    out, edge = np.ones(run.q.shape, dtype=bool), int(np.ceil(NUMBERS.edge_s / run.step_s))
    out[:edge] = out[len(out) - edge :] = False
    return out


def _moving(run: MotionSignals, fastest: np.ndarray) -> np.ndarray:
    """(T, n): the joint moves, well away from a reversal. fastest: (n,) rad/s of all recordings: in some a joint may stand all the time."""
    return np.abs(run.qd) > NUMBERS.standstill * fastest


def _rotors(run: MotionSignals, robot: RobotModel, joints: tuple[int, ...]) -> np.ndarray:
    """(T, J, n): torque of each rotor by a share of the inertia of the whole arm: behind its gear a small rotor counts as much, at the
    wrist too."""
    reach = float((np.abs(robot.chain.a) + np.abs(robot.chain.d)).sum()) * 1e-3
    scale = NUMBERS.rotor_share * max(float(robot.mass.sum()), float(robot.n)) * reach**2
    return np.einsum("tj,jl->tjl", run.qdd[:, joints], np.eye(robot.n)[list(joints)] * scale)

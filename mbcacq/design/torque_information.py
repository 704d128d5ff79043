"""What recordings of torque, and motions that were not made yet, tell about the parameters that the diagnosis of motion fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from mbcacq.diagnosis.motion.channel_groups import channel_groups
from mbcacq.diagnosis.motion.load_error import canonical_correlation
from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.diagnosis.motion.signals import direction_of_rotation, prepare, with_torque
from mbcacq.diagnosis.search.effect_set import Member
from mbcacq.effects import catalogue
from mbcacq.effects.motion_effect import ChannelGroup, MotionSignals
from mbcacq.errors import ConfigError
from mbcacq.geometry.dynamics import regressor
from mbcacq.model.cell import RobotModel
from mbcacq.model.trajectory import Trajectory


@dataclass(frozen=True)
class TorqueInformation:
    """Normal equations of everything that is fitted to the torque: offsets, inertial parameters of the links, rotors, friction, a load on
    the flange, a balancer.

    Attributes
    ----------
    normal : ndarray
        (P, P) of the recordings, with the priors.
    weights : ndarray
        (J,) of a sample at each joint.
    step_s : float
        Time between two samples.
    placed : tuple[Member, ...]
        The effects that every arm may have, whose columns are those of ``normal``.
    named : ndarray
        Positions of the parameters that are to be separated, names: with their unit.
    scale : ndarray
        (P,) from coefficients to these units.
    arm : ndarray
        Positions of the links' inertial parameters.
    """

    robot: RobotModel
    group: ChannelGroup
    normal: np.ndarray
    weights: np.ndarray
    step_s: float
    placed: tuple[Member, ...]
    named: np.ndarray
    names: tuple[str, ...]
    scale: np.ndarray
    arm: np.ndarray

    @classmethod
    def of(cls, recordings: Sequence[Trajectory]) -> TorqueInformation:
        """Raises ConfigError for recordings without torque."""
        prepared = [prepare(t) for t in with_torque(list(recordings))]
        runs, robot = tuple(run for run, _ in prepared), recordings[0].robot
        groups = [g for g in channel_groups(runs, [i for _, i in prepared], robot) if g.name == "tau"]
        if not groups:
            raise ConfigError("the recordings have no torque (tau*_Nm, motor_tau*_Nm or i*_A); record it, or give others to --motion")
        group = groups[0]
        model = MotionModel(group, runs)
        for candidate in catalogue.motion_candidates(group, runs):
            if candidate.rows.usual and not candidate.rows.extends:
                hyper = None if candidate.hyper is None else float(candidate.hyper.values[len(candidate.hyper.values) // 2])
                model.selected.append(Member(candidate, hyper, columns=model.add(candidate, hyper)))
        chosen = model.chosen()
        weights = model.weights(chosen)
        normal = model.store.normal(weights)[np.ix_(chosen, chosen)] + np.diag(1.0 / np.array(model.store.prior)[chosen] ** 2)
        position = {int(c): i for i, c in enumerate(chosen)}
        placed = tuple(replace(e, columns=np.array([position[int(i)] for i in e.columns])) for e in model.selected)
        named, names, scale = _named(placed, len(chosen))
        arm = np.array([position[int(i)] for i in model.store.base[len(group.joints) : -robot.n]], dtype=int)
        return cls(robot, group, normal, weights, runs[0].step_s, placed, named, names=names, scale=scale, arm=arm)

    def of_motion(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, step_s: float) -> np.ndarray:
        """(P, P): what recording a motion adds, of which the angles (T, n) and their rates are given every so many s."""
        run, inertial = self._signals(q, qd, qdd, step_s)
        (group,) = [g for g in channel_groups((run,), [inertial], self.robot) if g.name == "tau"]
        count, J = len(self.normal), len(self.group.joints)
        out = np.zeros((count, count))
        for j, joint in enumerate(self.group.joints):
            here = group.index(joint)
            X = np.zeros((len(q), count))
            X[:, j] = 1.0
            X[:, J : J + group.base[0].shape[2]] = group.base[0][:, here]
            for one in self.placed:
                if joint in one.candidate.rows.joints:
                    X[:, one.columns] = one.candidate.rows.columns(run, joint, one.hyper)
            X = X[group.use[0][:, here]]
            out += self.weights[j] * step_s / self.step_s * (X.T @ X)
        return out

    def _signals(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, step_s: float) -> tuple[MotionSignals, np.ndarray]:
        robot, still = self.robot, np.zeros_like(q)
        inertial = regressor(robot.chain, q, qd, qdd, robot.gravity)
        run = MotionSignals(step_s, q, qd, qdd, direction_of_rotation(q, step_s), q, robot=robot)
        return replace(run, torque=still, rigid=still, gravity=still, payload=inertial[:, :, -1]), inertial

    def covariance(self, more: np.ndarray | None = None) -> np.ndarray:
        """(P, P) expected, in the units of the names, after these recordings and a further motion."""
        A = self.normal if more is None else self.normal + more
        size = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
        inverse = np.linalg.inv(A * np.outer(size, size) + 1e-12 * np.eye(len(A))) * np.outer(size, size)
        return inverse * np.outer(self.scale, self.scale)

    def log_volume(self, more: np.ndarray) -> float:
        """Log determinant of the covariance of the named parameters after a further motion."""
        named = self.covariance(more)[np.ix_(self.named, self.named)]
        return float(np.linalg.slogdet(named)[1])

    def correlations(self, covariance: np.ndarray) -> dict[str, float]:
        """Largest canonical correlation of balancer and load with each other and with the inertial parameters of the links."""
        at = {one.candidate.name: [int(i) for i in one.columns if i in self.named] for one in self.placed}
        at = {name: own for name, own in at.items() if own} | {"arm": [int(i) for i in self.arm]}
        pairs = [(a, b) for a, b in combinations(at, 2) if at[b]]
        return {f"{a} and {b}": canonical_correlation(covariance, at[a], at[b]) for a, b in pairs}


def _named(placed: Sequence[Member], count: int) -> tuple[np.ndarray, tuple[str, ...], np.ndarray]:
    """Positions, names and scale (P,) of the parameters of a balancer and of a load."""
    named, names, scale = [], [], np.ones(count)
    for one in placed:
        for position, (name, factor) in zip(one.columns, one.candidate.rows.load_parameters, strict=False):
            named.append(int(position))
            names.append(name)
            scale[position] = factor
    return np.array(named, dtype=int), tuple(names), scale

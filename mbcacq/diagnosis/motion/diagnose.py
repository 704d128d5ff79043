"""Diagnosis of recordings of motion: joint-side against motor-side angle, set point against actual, torque against rigid body."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import replace

import numpy as np

from mbcacq.diagnosis.executor import UNLIMITED, TimeBudget
from mbcacq.diagnosis.findings import OUT_OF_TIME
from mbcacq.diagnosis.motion.allowed_names import refused_in_words
from mbcacq.diagnosis.motion.assemble import assemble, checked_channels, cut_short
from mbcacq.diagnosis.motion.channel_groups import channel_groups
from mbcacq.diagnosis.motion.description_check import suspicions
from mbcacq.diagnosis.motion.effect_selection import EffectSelection
from mbcacq.diagnosis.motion.fit import MotionFit, fit_selected, motion_series, with_load
from mbcacq.diagnosis.motion.motion_model import MotionModel
from mbcacq.diagnosis.motion.normal_store import Part, held_out_parts
from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.diagnosis.motion.result import CheckedChannel, MotionCheck, MotionDiagnosis
from mbcacq.diagnosis.motion.signals import prepare, with_torque
from mbcacq.diagnosis.options import OPTIONS
from mbcacq.effects import catalogue
from mbcacq.effects.motion_effect import MotionSignals
from mbcacq.errors import ConfigError
from mbcacq.model.cell import RobotModel
from mbcacq.model.trajectory import Trajectory
from mbcacq.quantities import K, measured

OPTIONAL = ("q_set", "qd_set", "qdd_set", "qddd_set", "q_joint", "torque", "load", "rigid", "gravity", "rigid_set", "payload")


def diagnose_trajectories(
    trajectories: Sequence[Trajectory], cross_validation: bool = True, minutes: float | None = OPTIONS.minutes
) -> MotionDiagnosis:
    """Diagnose one or several recordings of one robot. Raises ConfigError if they do not fit together.

    The held-out errors of the result's channels are of held-out parts (a trajectory, or a block of the only one), not used in selecting or
    fitting anything. Without ``cross_validation``, in a third of the time, they are of parts that took part in selecting. minutes: when
    they are over the search ends, the verdict is ``cannot_tell``, and what was compared by then is reported (None: it takes the time that
    it needs).
    """
    budget = TimeBudget.of_minutes(minutes)
    recordings = Recordings(trajectories, budget=budget)
    fits, runs = recordings.explain()
    found = assemble(fits, runs, recordings.cross_validate() if cross_validation else None)
    late = [OUT_OF_TIME] if cut_short(fits) else []
    return replace(
        found,
        suspicions=(*late, *suspicions(recordings.runs), *_other_payload(found, recordings.robot), *refused_in_words(fits, runs)),
        plot_data=motion_series(fits, found.fit.channels, trajectories, recordings.runs),
    )


def _other_payload(found: MotionDiagnosis, robot: RobotModel) -> list[str]:
    """In words, by how much the load on the flange is not as described, where that was found."""
    masses = [e.parameters["mass_kg"] for e in found.named_effects if catalogue.declaration(e.name).adds_body]
    described = float(robot.payload_mass)
    extra = (measured(value - described, K * std, "kg") for m in masses for value, std in zip(*m.components, strict=True))
    return [f"with a load that differs by {kg} (k = 2) at the flange the torque is explained better" for kg in extra]


def check_trajectories(learnt: Sequence[Trajectory], others: Sequence[tuple[str, Trajectory]]) -> tuple[MotionCheck, ...]:
    """Residuals in other recordings of the same robot, of effects that are selected and fitted in some.

    Parameters
    ----------
    learnt : sequence of Trajectory
        The recordings from which everything is learnt, torque constants included.
    others : sequence of (str, Trajectory)
        The recordings on which it is tried, with their names. Only what is a convention of a recording (the zero of an encoder) is
        estimated there.

    Returns
    -------
    tuple of MotionCheck
        One for each of the others, with every channel that all recordings have.

    Raises
    ------
    ConfigError
        The recordings are of robots with different numbers of axes, or there is nothing to compare.
    """
    recordings = Recordings([*learnt, *(t for _, t in others)], len(learnt))
    fits, _ = recordings.explain()
    out = []
    for run, (name, _) in enumerate(others, len(learnt)):
        channels: list[CheckedChannel] = []
        for fit in fits:
            squares, samples = _errors_of(fit, [(run, slice(0, len(recordings.runs[run].q)))])
            channels += checked_channels(fit, *(squares / np.maximum(samples, 1.0)))
        out.append(MotionCheck(name, tuple(channels)))
    return tuple(out)


class Recordings:
    """Signals of recordings of one robot. learnt: number of those, the first ones, from which anything is learnt (None: all).
    budget: of the time for everything; the search of all recordings has a part of it."""

    def __init__(self, trajectories: Sequence[Trajectory], learnt: int | None = None, budget: TimeBudget = UNLIMITED) -> None:
        self.budget = budget
        if not trajectories:
            raise ConfigError("no trajectory was given")
        if len({t.robot.n for t in trajectories}) > 1:
            raise ConfigError("the trajectories belong to robots with different numbers of axes; diagnose them separately")
        prepared = [prepare(t) for t in with_torque(list(trajectories), learnt)]
        self.learnt = learnt
        self.runs = _common([run for run, _ in prepared])
        self.inertial = [inertial for _, inertial in prepared]
        self.robot: RobotModel = trajectories[0].robot

    def explain(self, held: int | None = None) -> tuple[list[MotionFit], tuple[MotionSignals, ...]]:
        """Fits, torque first: the load that it gives winds up the gears. held: number of a part (``normal_store.held_out_parts``) that
        takes no part in them. Raises ConfigError if there is nothing to compare."""
        runs = self.runs
        groups = channel_groups(runs, self.inertial, self.robot)
        if not groups:
            raise ConfigError(
                "nothing to compare: the trajectory needs q*_joint_deg, q*_set_deg, tau*_Nm, motor_tau*_Nm or i*_A in addition to q*_deg"
            )
        fits: list[MotionFit] = []
        for group in groups:
            budget = self.budget.for_the_search if held is None else self.budget
            selection = EffectSelection(MotionModel(group, runs, held, self.learnt), budget=budget)
            selection.run()
            fits.append(fit_selected(selection))
            if group.name == "tau":
                runs = with_load(runs, fits[-1])
        return fits, runs

    def cross_validate(self) -> dict[str, np.ndarray]:
        """Mean squares (2, J) before and after by kind of mismatch, each part predicted by what was selected and fitted on the others."""
        parts = held_out_parts(self.runs)[0]
        # A thread sees the effects of files (``catalogue.with_added``) in a copy of the context alone, each in its own.
        contexts = [copy_context() for _ in parts]
        with ThreadPoolExecutor(NUMBERS.workers) as pool:
            passes = list(pool.map(lambda number: contexts[number].run(self.explain, number)[0], range(len(parts))))
        total: dict[str, np.ndarray] = {}
        count: dict[str, np.ndarray] = {}
        for part, fits in zip(parts, passes, strict=True):
            for fit in fits:
                squares, samples = _errors_of(fit, part)
                total[fit.group.name] = total.get(fit.group.name, 0.0) + squares
                count[fit.group.name] = count.get(fit.group.name, 0.0) + samples
        return {name: square / np.maximum(count[name], 1.0) for name, square in total.items()}


def _errors_of(fit: MotionFit, part: Part) -> tuple[np.ndarray, np.ndarray]:
    """Squared errors (2, J) before and after in a part of the recordings, and numbers of samples (J,)."""
    J = len(fit.group.joints)
    squares, samples = np.zeros((2, J)), np.zeros(J)
    for j in range(J):
        for run, stretch in part:
            use = fit.used[j][run][stretch]
            for row, residual in enumerate((fit.residual_before, fit.residual_after)):
                r = residual[j][run][stretch][use]
                squares[row, j] += float(((r - r.mean()) ** 2).sum() if fit.group.refit else r @ r) if len(r) else 0.0
            samples[j] += int(use.sum())
    return squares, samples


def _common(runs: list[MotionSignals]) -> tuple[MotionSignals, ...]:
    """Keep only the signals that every run has."""
    missing = {name: None for name in OPTIONAL if any(getattr(run, name) is None for run in runs)}
    return tuple(replace(run, **missing) for run in runs)

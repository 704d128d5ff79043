"""The chosen effects fitted to everything: parameters with uncertainty, continuous hyper-parameters among them, and what is left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.motion.forward_selection import ForwardSelection, SelectedEffect
from mbcacq.diagnosis.motion.hyperparameters import refine, slopes
from mbcacq.diagnosis.motion.load_uncertainty import load_doubt
from mbcacq.diagnosis.motion.noise import covariance
from mbcacq.diagnosis.motion.normal_store import NormalStore
from mbcacq.diagnosis.motion.time_alignment import lateness
from mbcacq.effects.motion.effect import ChannelGroup, MotionCandidate


@dataclass(frozen=True)
class FoundTerm:
    """One effect of the catalogue at one place, with all its refinements. held_before, held_after: (J,) mean square without and with.

    steps: what each part of it gained, in the order taken. contributions: (T,) per run and joint of the group, what it adds.
    """

    name: str
    where: list[str]
    depends_on: str
    parameters: dict[str, dict]
    p_value: float
    joints: tuple[int, ...]
    gain: np.ndarray
    steps: list[dict]
    rivals: list[dict]
    contributions: list[list[np.ndarray]]


@dataclass(frozen=True)
class MotionFit:
    """A group with what was found. before, after: left per joint and run by the base alone and with all effects; used: which samples
    count. links: torque (T,) per joint and run by which the links differ from their description, as fitted; load_doubt:
    (J,) relative standard deviation of the torque that passes the gear. held_start, held_end,
    train_start, train_end: (J,) mean squares."""

    group: ChannelGroup
    found: list[FoundTerm]
    before: list[list[np.ndarray]]
    after: list[list[np.ndarray]]
    used: list[list[np.ndarray]]
    held_start: np.ndarray
    held_end: np.ndarray
    train_start: np.ndarray
    train_end: np.ndarray
    split: str
    links: list[list[np.ndarray]]
    load_doubt: np.ndarray


def conclude(selection: ForwardSelection) -> MotionFit:
    ledger = selection.ledger
    refine(selection)
    delay = ledger.delay
    ledger.retime(0.0)  # what there was to explain is what was recorded
    start = np.array(ledger.base)
    x0 = ledger.solve(ledger.normal(selection.weights(start)), start)
    before, train_start = _left(selection, start, x0), ledger.errors(start, x0).sum(axis=0)
    ledger.retime(delay)
    chosen = selection.chosen()
    weights = selection.weights(chosen)
    N = ledger.normal(weights)
    x = ledger.solve(N, chosen)
    held = selection.mean_square(selection.held(weights, chosen))
    slope = slopes(selection, chosen, x)
    ids = np.concatenate([chosen, *(i for _, i in slope)]).astype(int)
    everything = np.concatenate([x, np.zeros(len(slope))])
    # A part held out tells a prediction, not how sure it is: there the quicker estimate does.
    spread = (covariance if ledger.whole else NormalStore.covariance)(ledger, weights, ids, everything)
    hyper_std = {id(t): float(np.sqrt(max(spread[len(chosen) + k, len(chosen) + k], 0.0))) for k, (t, _) in enumerate(slope)}
    position = {int(c): i for i, c in enumerate(chosen)}
    found = _found(selection, x, spread, position, hyper_std)
    n = np.maximum(ledger.count.sum(axis=0), 1.0)
    result = MotionFit(
        selection.group,
        found,
        before,
        _left(selection, chosen, x),
        [[u[:, k] for u in selection.group.use] for k in range(len(selection.group.joints))],
        selection.mean_square(selection.start),
        held,
        train_start / n,
        ledger.errors(chosen, x).sum(axis=0) / n,
        ledger.split,
        _links(selection, x),
        load_doubt(selection, chosen, x, spread),
    )
    ledger.forget(selection.mark)
    return result


def _left(selection: ForwardSelection, chosen: np.ndarray, x: np.ndarray) -> list[list[np.ndarray]]:
    out = []
    for k in range(len(selection.group.joints)):
        left = selection.ledger.residual(k, chosen, x)
        out.append([left[selection.ledger.slices(r)] for r in range(len(selection.runs))])
    return out


def _links(selection: ForwardSelection, x: np.ndarray) -> list[list[np.ndarray]]:
    group, n, J = selection.group, selection.runs[0].q.shape[1], len(selection.group.joints)
    if group.name != "tau":
        return [[np.zeros(len(r.q)) for r in selection.runs] for _ in group.joints]
    inertial = x[J : len(selection.ledger.base) - n]  # the base: an offset a joint, inertial parameters, one column a rotor
    return [[group.base[r][:, k, :-n] @ inertial for r in range(len(selection.runs))] for k in range(J)]


def _found(selection: ForwardSelection, x: np.ndarray, spread: np.ndarray, position: dict[int, int], hyper_std: dict) -> list[FoundTerm]:
    out: dict[tuple, FoundTerm] = {}
    for t in selection.taken:
        at = [position[int(i)] for i in t.variant.ids]
        c, v = x[at], spread[np.ix_(at, at)]
        told = t.candidate.report(c, v, t.variant.hyper, hyper_std.get(id(t), 0.0))
        added = _late(selection, t, c) if t.candidate.tuned else _contribution(selection, t.candidate, t.variant.hyper, c)
        step = {"adds": list(told), "before": t.before.tolist(), "after": t.after.tolist()}
        key = t.candidate.place
        if key not in out:
            out[key] = FoundTerm(
                t.candidate.name,
                list(t.candidate.where),
                t.candidate.depends_on,
                told,
                t.p_value,
                t.candidate.joints,
                t.before - t.after,
                [step],
                t.rivals,
                added,
            )
            continue
        mine = out[key]
        added = [[a + b for a, b in zip(p, q, strict=True)] for p, q in zip(mine.contributions, added, strict=True)]
        out[key] = FoundTerm(
            mine.name,
            mine.where,
            mine.depends_on,
            _join(mine.parameters, told),
            min(mine.p_value, t.p_value),
            mine.joints,
            mine.gain + t.before - t.after,
            [*mine.steps, step],
            mine.rivals,
            added,
        )
    return list(out.values())


def _join(one: dict, other: dict) -> dict:
    """Parameters of both; what both have (several waves) becomes lists."""
    out = dict(one)
    for key, entry in other.items():
        out[key] = entry if key not in one else {k: [*np.atleast_1d(one[key][k]).tolist(), entry[k]] for k in ("value", "std")}
    return out


def _contribution(selection: ForwardSelection, candidate: MotionCandidate, hyper: float | None, c: np.ndarray) -> list[list[np.ndarray]]:
    return [
        [candidate.columns(run, joint, hyper) @ c if joint in candidate.joints else np.zeros(len(run.q)) for run in selection.runs]
        for joint in selection.group.joints
    ]


def _late(selection: ForwardSelection, t: SelectedEffect, c: np.ndarray) -> list[list[np.ndarray]]:
    return [
        [-lateness(selection.group, run, k, place, t.variant.hyper + float(c[0])) for k, run in enumerate(selection.runs)]
        for place in range(len(selection.group.joints))
    ]

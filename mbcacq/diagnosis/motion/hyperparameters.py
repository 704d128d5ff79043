"""Continuous hyper-parameters (an order, a time constant, a speed) estimated with the coefficients, by Gauss-Newton."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mbcacq.diagnosis.motion.time_alignment import fitted, settle
from mbcacq.effects.motion.effect import OF_THE_DRIVE

if TYPE_CHECKING:
    from mbcacq.diagnosis.motion.forward_selection import ForwardSelection, SelectedEffect

ROUNDS = 4
SMALL = 1e-3  # relative step of a hyper-parameter for its derivative


def refine(selection: ForwardSelection) -> None:
    """Gauss-Newton on the continuous hyper-parameters, all coefficients refitted, within the spacing of what was tried."""
    ledger = selection.ledger
    settle(selection)
    renew(selection)
    free = [t for t in selection.taken if t.variant.hyper is not None and t.candidate.refine]
    if not free:
        return
    spans = {id(t): _neighbours(t) for t in free}
    best = None
    for _ in range(ROUNDS):
        chosen = selection.chosen()
        weights = selection.weights(chosen)
        x = ledger.solve(ledger.normal(weights), chosen)
        cost = float(np.log(np.maximum(ledger.errors(chosen, x).sum(axis=0), 1e-300)) @ ledger.count.sum(axis=0))
        if best is not None and cost > best:
            break
        best = cost
        mark = len(ledger.prior)
        slope = slopes(selection, chosen, x)
        ids = np.concatenate([chosen, *(i for _, i in slope)]).astype(int)
        step = ledger.solve(ledger.normal(weights), ids)[len(chosen) :]
        ledger.forget(mark)
        for (t, _), s in zip(slope, step, strict=True):
            low, high = spans[id(t)]
            t.variant.hyper = float(np.clip(t.variant.hyper + s, low, high))
            t.variant.ids = ledger.candidate(t.candidate, t.variant.hyper)
    settle(selection)
    renew(selection)


def renew(selection: ForwardSelection) -> None:
    """Effects that follow the load see it as it is now known, no longer as the arm is described."""
    by_load = [t for t in selection.taken if t.candidate.by_load]
    if not by_load:
        return
    x = fitted(selection)
    position = {int(c): i for i, c in enumerate(selection.chosen())}
    runs = []
    for k, run in enumerate(selection.runs):
        load = run.rigid.copy()
        for place, joint in enumerate(selection.group.joints):
            load[:, joint] += selection.simulated(place, k, x, position, OF_THE_DRIVE, rotors=False)
        runs.append(replace(run, load=load))
    selection.runs = selection.ledger.runs = tuple(runs)
    for t in by_load:
        columns = [selection.ledger.columns(t.candidate, j, t.variant.hyper) for j in t.candidate.joints]
        selection.ledger.replace(t.variant.ids, [selection.group.joints.index(j) for j in t.candidate.joints], columns)


def _neighbours(t: SelectedEffect) -> tuple[float, float]:
    values = np.sort(t.candidate.hyper)
    k = int(np.argmin(np.abs(values - t.variant.hyper)))
    low = values[k - 1] if k else values[0]
    high = values[k + 1] if k + 1 < len(values) else 2 * values[-1] - values[-2]
    return float(low), float(high)


def slopes(selection: ForwardSelection, chosen: np.ndarray, x: np.ndarray) -> list[tuple[SelectedEffect, np.ndarray]]:
    """Per continuous hyper-parameter the column d(effect)/d(hyper), added to the ledger."""
    position = {int(c): i for i, c in enumerate(chosen)}
    out = []
    for t in selection.taken:
        if t.variant.hyper is None or not t.candidate.refine:
            continue
        c = x[[position[int(i)] for i in t.variant.ids]]
        h, d = t.variant.hyper, SMALL * max(abs(t.variant.hyper), 1e-9)
        places = [selection.group.joints.index(j) for j in t.candidate.joints]
        columns = [
            np.concatenate([(t.candidate.columns(r, j, h + d) - t.candidate.columns(r, j, h - d)) @ c / (2 * d) for r in selection.runs])[
                :, None
            ]
            for j in t.candidate.joints
        ]
        out.append((t, selection.ledger.add(places, columns)))
    return out

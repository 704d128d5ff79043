"""What all joints of a channel have in common: one latency, told from lags that belong to single axes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from mbcacq.diagnosis.trajectory.fit import autoregression, whiten
from mbcacq.diagnosis.trajectory.select import Explained, all_candidates, explain
from mbcacq.physics.trajectory.effect import Candidate, Channel, Run

SPREAD = 0.25       # of single axes' values about the common one, as a share of it, that still is one cause
LEAST_SHARE = 0.05  # of the channel's mean square that a common cause must explain
ROUNDS = 3


@dataclass(frozen=True)
class Shared:
    candidate: Candidate
    value: float
    std: float
    p_value: float
    gain: float


def explain_group(channels: list[Channel], runs: tuple[Run, ...]) -> tuple[Shared | None, list[Explained]]:
    """Explain the channels of one kind together: a common cause first, each joint's own effects given it, both refined in turn."""
    if not channels:
        return None, []
    found = {c.joint: all_candidates(c, runs) for c in channels}
    common = [next((c for c in found[ch.joint] if c.shared), None) for ch in channels]
    own = {joint: [c for c in pool if not c.shared] for joint, pool in found.items()}
    if any(c is None for c in common):
        return None, [explain(c, runs, own[c.joint]) for c in channels]
    separate = [explain(c, runs, own[c.joint]) for c in channels]
    shared = _estimate(channels, common, runs, None)
    if shared is None:
        return None, separate
    together: list[Explained] = []
    for _ in range(ROUNDS):
        together = [explain(_without(c, cand, runs, shared.value), runs, own[c.joint]) for c, cand in zip(channels, common, strict=True)]
        refined = _estimate(channels, common, runs, together)
        if refined is None:
            return None, separate
        settled = abs(refined.value - shared.value) < 0.1 * refined.std
        shared = refined
        if settled:
            break
    # One cause for all joints must predict as well as each joint's own names, or need clearly fewer of them.
    left = [sum(e.held_out_after / s.held_out_before for e, s in zip(way, separate, strict=True)) for way in (together, separate)]
    names = [sum(len(e.taken) for e in way) for way in (together, separate)]
    if left[0] > left[1] and not (names[0] < names[1] and left[0] < 1.2 * left[1]):
        return None, separate
    together = [replace(e, before=s.before, held_out_before=s.held_out_before) for e, s in zip(together, separate, strict=True)]
    before = sum(s.held_out_before for s in separate)
    gain = 1.0 - sum(e.held_out_before for e in [explain(_without(c, cand, runs, shared.value), runs, [])
                                                  for c, cand in zip(channels, common, strict=True)]) / before
    return replace(shared, gain=gain), together


def _without(channel: Channel, candidate: Candidate, runs: tuple[Run, ...], value: float) -> Channel:
    left = tuple(m - value * candidate.columns(run, channel.joint, None)[:, 0] for m, run in zip(channel.mismatch, runs, strict=True))
    return replace(channel, mismatch=left)


def _estimate(channels, common, runs, explained: list[Explained] | None) -> Shared | None:
    """Precision-weighted common coefficient, every joint's base and own effects projected out; None if there is no common cause."""
    numerator, precision, drop, total = [], [], 0.0, 0.0
    for index, (channel, candidate) in enumerate(zip(channels, common, strict=True)):
        chosen = [(t.candidate, t.hyper) for t in explained[index].taken] if explained else []
        columns = [np.concatenate([*(c.columns(run, channel.joint, h) for c, h in chosen), channel.base[k]], axis=1)
                   for k, run in enumerate(runs)]
        signal = [candidate.columns(run, channel.joint, None)[:, 0] for run in runs]
        A, x, y = np.concatenate(columns), np.concatenate(signal), np.concatenate(channel.mismatch)
        B = np.column_stack([A, x])
        scale = np.maximum(np.linalg.norm(B, axis=0), 1e-300)
        solution, *_ = np.linalg.lstsq(B / scale, y, rcond=1e-10)
        left = np.split(y - (B / scale) @ solution, np.cumsum([len(c) for c in columns])[:-1])
        taps = autoregression(list(left))
        q, _ = np.linalg.qr(np.concatenate([whiten(taps, c) for c in columns]) / np.maximum(np.linalg.norm(A, axis=0), 1e-300))
        xw, yw = np.concatenate([whiten(taps, s) for s in signal]), np.concatenate([whiten(taps, m) for m in channel.mismatch])
        xw, yw = xw - q @ (q.T @ xw), yw - q @ (q.T @ yw)
        numerator.append(float(xw @ yw))
        precision.append(float(xw @ xw))
        offset = np.linalg.lstsq(A / np.maximum(np.linalg.norm(A, axis=0), 1e-300), np.column_stack([y, x]), rcond=1e-10)[0]
        plain = np.column_stack([y, x]) - (A / np.maximum(np.linalg.norm(A, axis=0), 1e-300)) @ offset
        total += float(plain[:, 0] @ plain[:, 0])
        drop += float(plain[:, 0] @ plain[:, 1]) ** 2 / max(float(plain[:, 1] @ plain[:, 1]), 1e-300)
    n, w = np.array(numerator), np.array(precision)
    if not w.sum() > 0:
        return None
    value = float(n.sum() / w.sum())
    single = n / np.maximum(w, 1e-300)
    scatter = float(np.sqrt(np.average((single - value) ** 2, weights=w)))
    std = float(np.hypot(1.0 / np.sqrt(w.sum()), scatter / np.sqrt(max(len(n) - 1, 1)) if len(n) > 1 else 0.0))
    p = float(chi2.sf((value / std) ** 2, 1))
    if p > 1e-4 or (len(n) > 1 and scatter > SPREAD * abs(value)) or drop < LEAST_SHARE * total:
        return None
    return Shared(common[0], value, std, p, drop / total)

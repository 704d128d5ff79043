"""Which effects a channel needs: taken one by one by their gain on parts of the recording that took no part in the fit."""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import savgol_filter
from scipy.stats import f as f_distribution
from scipy.stats import t as t_distribution

from mbcacq.diagnosis.trajectory.fit import Fit, autoregression, solve, whiten
from mbcacq.physics import trajectory as effects
from mbcacq.physics.trajectory.effect import Candidate, Channel, Run

LEAST_GAIN = 0.02      # share of the held-out excess over the noise
SIGNIFICANCE = 1e-3    # after correction for the number of candidates
MOST_EFFECTS = 6
PARTS = 4              # blocks of a single recording
NEAR = 0.03            # of the best candidate's gain: closer is as good
LOAD_WINDOW_S = 0.1
BLOCK_S = 0.5          # pieces of held-out data taken as independent witnesses of an improvement


@dataclass(frozen=True)
class Taken:
    candidate: Candidate
    hyper: float | None
    p_value: float
    gain: float


@dataclass(frozen=True)
class Explained:
    """What a channel was found to hold. before, after: mismatch left (T,) per run by the base alone and with the effects;
    contributions: per effect and run, what it adds to the channel (T,)."""

    channel: Channel
    taken: tuple[Taken, ...]
    parameters: tuple[dict, ...]
    before: tuple[np.ndarray, ...]
    after: tuple[np.ndarray, ...]
    held_out_before: float
    held_out_after: float
    split: str
    contributions: tuple[tuple[np.ndarray, ...], ...]


def all_candidates(channel: Channel, runs: tuple[Run, ...]) -> list[Candidate]:
    out = []
    for info in pkgutil.iter_modules(effects.__path__):
        module = importlib.import_module(f"{effects.__name__}.{info.name}")
        if hasattr(module, "candidates"):
            out += module.candidates(channel, runs)
    return out


def folds(runs: tuple[Run, ...]) -> tuple[list[list[tuple[int, slice]]], str]:
    """Parts to hold out in turn: whole trajectories, or blocks in time where there is only one."""
    if len(runs) > 1:
        return [[(k, slice(None))] for k in range(len(runs))], "trajectory"
    length = len(runs[0].q)
    edges = np.linspace(0, length, PARTS + 1).astype(int)
    return [[(0, slice(int(a), int(b)))] for a, b in zip(edges[:-1], edges[1:], strict=True)], "time block"


def explain(channel: Channel, runs: tuple[Run, ...], candidates: list[Candidate]) -> Explained:
    """Forward choice by held-out gain, each candidate refitted together with all taken before and with the base."""
    taken: list[Taken] = []
    pool = list(candidates)
    tests = sum(max(c.search, 1.0) for c in pool) or 1.0
    start_blocks = held_out_blocks(channel, runs, [])
    best_blocks = start_blocks
    while pool and len(taken) < MOST_EFFECTS:
        chosen = [(t.candidate, t.hyper) for t in taken]
        filters = _filter(channel, runs, chosen)
        now = _fit(channel, runs, chosen, filters)
        trials = []
        for candidate in pool:
            hyper, fit = _best_hyper(channel, runs, chosen, candidate, filters)
            k = len(fit.coefficients) - len(now.coefficients)
            ratio = max(now.sse - fit.sse, 0.0) / k / (fit.sse / fit.dof)
            p = float(min(f_distribution.sf(ratio, k, fit.dof) * tests, 1.0))
            after = held_out_blocks(channel, runs, [*chosen, (candidate, hyper)])
            # Whitening makes a slow effect look small beside a noise as slow as it is; pieces of held-out data are the other witness.
            p = min(p, improvement_p(best_blocks, after) * len(pool))
            x = _plain_fit(channel, runs, [*chosen, (candidate, hyper)], _everything(runs))
            if p < SIGNIFICANCE and not (candidate.positive and x[len(now.coefficients)] <= 0):
                trials.append((after, p, candidate, hyper))
        best, start = best_blocks.mean(), start_blocks.mean()
        good = [t for t in trials if (best - t[0].mean()) / max(best, 1e-300) >= LEAST_GAIN]
        if not good:
            break
        # Of those that predict about as well, the one with the fewest coefficients: it claims least.
        least = min(t[0].mean() for t in good)
        near = [t for t in good if t[0].mean() <= least + NEAR * (best - least)]
        after, p, candidate, hyper = min(near, key=lambda t: (t[2].columns(runs[0], channel.joint, t[3]).shape[1], t[0].mean()))
        taken.append(Taken(candidate, hyper, p, float((best - after.mean()) / max(start, 1e-300))))
        best_blocks = after
        if not candidate.several:
            pool = [c for c in pool if (c.name, c.where) != (candidate.name, candidate.where)]
    return _conclude(channel, runs, taken, float(start_blocks.mean()), float(best_blocks.mean()))


def improvement_p(before: np.ndarray, after: np.ndarray) -> float:
    """One-sided p-value that the squared error of blocks (B,) became smaller: paired t-test of its square root."""
    gain = np.sqrt(before) - np.sqrt(after)
    spread = float(gain.std(ddof=1)) / np.sqrt(len(gain))
    return float(t_distribution.sf(gain.mean() / max(spread, 1e-300), len(gain) - 1))


def _everything(runs: tuple[Run, ...]) -> list[tuple[int, np.ndarray]]:
    return [(k, _rest(len(r.q), None)) for k, r in enumerate(runs)]


def held_out_blocks(channel: Channel, runs: tuple[Run, ...], chosen: list[tuple[Candidate, float | None]]) -> np.ndarray:
    """Mean square (unit^2) of the mismatch in pieces (B,) of the parts held out, each predicted from the others; its offset is refitted."""
    out = []
    for part in folds(runs)[0]:
        held = dict(part)
        train = [(k, _rest(len(run.q), held.get(k))) for k, run in enumerate(runs)]
        x = _plain_fit(channel, runs, chosen, train)
        for k, where in part:
            left = (channel.mismatch[k] - _columns(channel, runs[k], k, chosen) @ x)[where]
            left = left - left.mean()
            pieces = max(int(len(left) * runs[k].step_s / BLOCK_S), 2)
            out += [float(np.mean(piece**2)) for piece in np.array_split(left, pieces)]
    return np.array(out)


def _rest(length: int, held: slice | None) -> np.ndarray:
    keep = np.ones(length, dtype=bool)
    if held is not None:
        keep[held] = False
    return keep


def _columns(channel: Channel, run: Run, k: int, chosen) -> np.ndarray:
    return np.concatenate([*(c.columns(run, channel.joint, h) for c, h in chosen), channel.base[k]], axis=1)


def _plain_fit(channel: Channel, runs, chosen, train) -> np.ndarray:
    A = np.concatenate([_columns(channel, runs[k], k, chosen)[keep] for k, keep in train])
    y = np.concatenate([channel.mismatch[k][keep] for k, keep in train])
    effect = A[:, : A.shape[1] - channel.base[0].shape[1]]
    noise = max(float(np.std(np.diff(y))), 1e-12)
    fit = solve(y / noise, A[:, effect.shape[1]:] / noise, effect / noise, channel.prior)
    return np.concatenate([fit.coefficients, fit.base])


def _filter(channel: Channel, runs, chosen) -> np.ndarray:
    """Whitening filter from what the model so far leaves."""
    x = _plain_fit(channel, runs, chosen, _everything(runs))
    return autoregression([channel.mismatch[k] - _columns(channel, r, k, chosen) @ x for k, r in enumerate(runs)])


def _fit(channel: Channel, runs, chosen, taps: np.ndarray) -> Fit:
    effect, base, mismatch = [], [], []
    for k, run in enumerate(runs):
        columns = np.concatenate([np.zeros((len(run.q), 0)), *(c.columns(run, channel.joint, h) for c, h in chosen)], axis=1)
        effect.append(whiten(taps, columns))
        base.append(whiten(taps, channel.base[k]))
        mismatch.append(whiten(taps, channel.mismatch[k]))
    return solve(np.concatenate(mismatch), np.concatenate(base), np.concatenate(effect), channel.prior)


def _best_hyper(channel: Channel, runs, chosen, candidate: Candidate, taps: np.ndarray) -> tuple[float | None, Fit]:
    if candidate.hyper is None:
        return None, _fit(channel, runs, [*chosen, (candidate, None)], taps)
    # Scan with the model so far projected out, then fit in full at the best value and refine around it.
    A = np.concatenate([whiten(taps, _columns(channel, run, k, chosen)) for k, run in enumerate(runs)])
    q_basis, _ = np.linalg.qr(A / np.maximum(np.linalg.norm(A, axis=0), 1e-300))
    y = np.concatenate([whiten(taps, m) for m in channel.mismatch])
    y = y - q_basis @ (q_basis.T @ y)

    def gain(hyper: float) -> float:
        C = np.concatenate([whiten(taps, candidate.columns(run, channel.joint, hyper)) for run in runs])
        C = C - q_basis @ (q_basis.T @ C)
        x, *_ = np.linalg.lstsq(C, y, rcond=1e-8)
        return float(y @ (C @ x))

    values = candidate.hyper
    best = int(np.argmax([gain(h) for h in values]))
    low, high = values[max(best - 1, 0)], values[min(best + 1, len(values) - 1)]
    fine = np.linspace(low, high, 21) if high > low else np.array([values[best]])
    hyper = float(fine[int(np.argmax([gain(h) for h in fine]))])
    return hyper, _fit(channel, runs, [*chosen, (candidate, hyper)], taps)


def _conclude(channel: Channel, runs, taken: list[Taken], start: float, best: float) -> Explained:
    chosen = [(t.candidate, t.hyper) for t in taken]
    everything = _everything(runs)
    x0, x1 = _plain_fit(channel, runs, [], everything), _plain_fit(channel, runs, chosen, everything)
    before = tuple(channel.mismatch[k] - _columns(channel, r, k, []) @ x0 for k, r in enumerate(runs))
    after = tuple(channel.mismatch[k] - _columns(channel, r, k, chosen) @ x1 for k, r in enumerate(runs))
    covariance = _clustered_covariance(channel, runs, chosen, after)
    parameters, contributions, at = [], [], 0
    for t in taken:
        own = slice(at, at + t.candidate.columns(runs[0], channel.joint, t.hyper).shape[1])
        contributions.append(tuple(t.candidate.columns(run, channel.joint, t.hyper) @ x1[own] for run in runs))
        parameters.append(t.candidate.report(x1[own], covariance[own, own], t.hyper))
        at = own.stop
    return Explained(channel, tuple(taken), tuple(parameters), before, after, start, best, folds(runs)[1], tuple(contributions))


def with_load(runs: tuple[Run, ...], torque: list[Explained]) -> tuple[Run, ...]:
    """The runs with the torque that passes the gears: what the drives gave, less the friction found."""
    out = []
    for k, run in enumerate(runs):
        load = run.torque.copy()
        for e in torque:
            for t, added in zip(e.taken, e.contributions, strict=True):
                if t.candidate.name == "friction":
                    load[:, e.channel.joint] -= added[k]
        window = min(max(2 * int(LOAD_WINDOW_S / run.step_s / 2) + 1, 5), len(load) // 4 * 2 - 1)
        out.append(replace(run, load=savgol_filter(load, window, 2, axis=0)))  # noise of a covariate would shrink its coefficient
    return tuple(out)


def _clustered_covariance(channel: Channel, runs, chosen, left: tuple[np.ndarray, ...]) -> np.ndarray:
    """Covariance of all coefficients from pieces of BLOCK_S taken as independent (sandwich): right however the noise is coloured within."""
    A = np.concatenate([_columns(channel, r, k, chosen) for k, r in enumerate(runs)])
    noise = max(float(np.std(np.diff(np.concatenate(channel.mismatch)))), 1e-12)
    pull = np.concatenate([np.zeros(A.shape[1] - len(channel.prior)), np.where(np.isfinite(channel.prior), noise / channel.prior, 0.0)])
    scale = np.maximum(np.sqrt((A**2).sum(axis=0) + pull**2), 1e-300)
    inverse = np.linalg.pinv((A / scale).T @ (A / scale) + np.diag((pull / scale) ** 2), rcond=1e-11, hermitian=True)
    meat, at = np.zeros_like(inverse), 0
    for k, run in enumerate(runs):
        rows = (A[at: at + len(run.q)] / scale) * left[k][:, None]
        at += len(run.q)
        for piece in np.array_split(rows, max(int(len(rows) * run.step_s / BLOCK_S), 2)):
            score = piece.sum(axis=0)
            meat += np.outer(score, score)
    return inverse @ meat @ inverse / np.outer(scale, scale)

"""Recordings cut into half seconds, and those into folds: what is fitted and what is predicted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mbcacq.diagnosis.motion.options import NUMBERS
from mbcacq.effects.motion_effect import MotionSignals

Part = list[tuple[int, slice]]  # stretches of recordings: (number of the run, samples)


@dataclass(frozen=True)
class NormalSegment:
    """Samples of one run whose normal equations are kept together. fold: to which fold they belong while effects are selected."""

    run: int
    samples: slice
    fold: int


def held_out_parts(runs: Sequence[MotionSignals]) -> tuple[list[Part], str]:
    """What is held out in turn: whole trajectories (several at once where there are many), or blocks in time where there is only one.

    The second value names the split, 'trajectory' or 'time block'.
    """
    lengths = [len(run.q) for run in runs]
    if len(lengths) > 1:
        number = min(len(lengths), NUMBERS.held_out_parts)
        return [[(k, slice(0, lengths[k])) for k in range(f, len(lengths), number)] for f in range(number)], "trajectory"
    return [[(0, block)] for block in _blocks(slice(0, lengths[0]), NUMBERS.held_out_parts)], "time block"


def segments(runs: Sequence[MotionSignals], held: int | None = None, learnt: int | None = None) -> tuple[list[NormalSegment], str]:
    """All segments, and the name of the split. held: number of a part that is left out altogether; learnt: number of the trajectories, the
    first ones, from which anything is learnt (None: all).

    Folds are the remaining trajectories; of a single one, interleaved blocks.
    """
    parts, split = held_out_parts(runs[:learnt])
    remaining = [part for i, part in enumerate(parts) if i != held]
    by_trajectory = split == "trajectory" and len(remaining) > 1
    number = NUMBERS.interleaved_blocks if split == "trajectory" else NUMBERS.interleaved_blocks // NUMBERS.held_out_parts
    out: list[NormalSegment] = []
    for fold, part in enumerate(remaining):
        for run, samples in part:
            step = runs[run].step_s
            if by_trajectory:
                out += [NormalSegment(run, s, fold) for s in _half_seconds(samples, step)]
                continue
            for i, block in enumerate(_blocks(samples, number)):
                out += [NormalSegment(run, s, i % NUMBERS.held_out_parts) for s in _half_seconds(block, step)]
    return out, split


def _half_seconds(samples: slice, step_s: float) -> list[slice]:
    return _blocks(samples, max(int((samples.stop - samples.start) * step_s / NUMBERS.segment_s), 1))


def _blocks(samples: slice, number: int) -> list[slice]:
    edges = np.linspace(0, samples.stop - samples.start, number + 1).astype(int)
    return [slice(samples.start + int(a), samples.start + int(b)) for a, b in zip(edges[:-1], edges[1:], strict=True)]

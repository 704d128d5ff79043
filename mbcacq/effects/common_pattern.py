"""One pattern of error in several joints: the joints' own periodic errors are the same function, turned by an offset, perhaps mirrored.

Absolute encoders of one make carry the same scale. Its errors then repeat in every joint, from another zero and, where an encoder is
mounted the other way round, in the other direction. Angles that one joint never visited are known from another.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

STEP = 720  # values over a turn
LEAST_OVERLAP = 80  # of them, that two curves must share: 40 deg
BANDWIDTH = 25  # orders that the errors of encoders take up: two independent values a period
LEAST_DEVIATE = 4.5  # normal deviate of a correlation (Fisher), from which two curves are one: 15 pairs at 1440 positions are tried
LEAST_JOINTS = 3
SLOWEST = 5  # orders below are not compared: geometry and gravity take them up


@dataclass(frozen=True)
class Curve:
    """Own error of a joint at STEP angles over a turn, from order SLOWEST on; visited: (STEP,) bool, angles near which poses are."""

    values: np.ndarray
    visited: np.ndarray

    @classmethod
    def of(cls, q: np.ndarray, orders: np.ndarray, sines: np.ndarray, cosines: np.ndarray) -> Curve:
        """From the joint's angles q (P,) rad and the coefficients of its orders (K,)."""
        angle = 2 * np.pi * np.arange(STEP) / STEP
        fast = orders >= SLOWEST
        phase = np.outer(angle, orders[fast])
        values = np.sin(phase) @ sines[fast] + np.cos(phase) @ cosines[fast]
        turned = np.sort(np.mod(q, 2 * np.pi))
        near = np.radians(1.0)
        count = np.searchsorted(turned, angle + near) - np.searchsorted(turned, angle - near)
        return cls(values, count > 3)

    def seen(self) -> np.ndarray:
        """(STEP,) values, NaN where no pose is near."""
        return np.where(self.visited, self.values, np.nan)


@dataclass(frozen=True)
class CommonPattern:
    """joints: indices; offset: rad, direction: +1 or -1 of each. Joint i errs by direction_i f(direction_i q - offset_i)."""

    joints: tuple[int, ...]
    offset: tuple[float, ...]
    direction: tuple[int, ...]


def find_common_pattern(curves: Mapping[int, Curve]) -> CommonPattern | None:
    """The pattern that most joints share; None where fewer than LEAST_JOINTS do."""
    seen = {i: c.seen() for i, c in curves.items() if c.visited.sum() >= LEAST_OVERLAP and np.ptp(c.values) > 0}
    pairs = [(*best_alignment(seen[i], seen[j]), i, j) for i in seen for j in seen if j > i]
    if not pairs:
        return None
    deviate, _, _, first, _ = max(pairs)
    if deviate < LEAST_DEVIATE:
        return None
    aligned = {first: (0, 1, seen[first])}
    while len(aligned) < len(seen):
        pattern = _mean([curve for *_, curve in aligned.values()])
        candidates = [(*best_alignment(pattern, seen[j]), j) for j in seen if j not in aligned]
        deviate, shift, direction, joint = max(candidates)
        if deviate < LEAST_DEVIATE:
            break
        aligned[joint] = (shift, direction, turned(seen[joint], shift, direction))
    if len(aligned) < LEAST_JOINTS:
        return None
    joints = tuple(sorted(aligned))
    offsets, directions = [], []
    for i in joints:
        shift, direction, _ = aligned[i]
        # pattern[k] = direction * curve[direction * (k - shift)], so the joint errs by direction f(direction q + shift).
        offsets.append(float(np.mod(-2 * np.pi * shift / STEP, 2 * np.pi)))
        directions.append(direction)
    return CommonPattern(joints, tuple(offsets), tuple(directions))


def turned(curve: np.ndarray, shift: float, direction: int) -> np.ndarray:
    """direction * curve(direction * (angle - shift)) at the STEP angles."""
    k = np.arange(STEP)
    return direction * curve[np.mod(direction * (k - int(shift)), STEP)]


def best_alignment(pattern: np.ndarray, curve: np.ndarray) -> tuple[float, int, int]:
    """(normal deviate of the correlation, shift, direction) of the best position of a curve under a pattern; NaN is not seen."""
    best = (-np.inf, 0, 1)
    known = np.isfinite(pattern)
    for direction in (1, -1):
        for shift in range(STEP):
            other = turned(curve, shift, direction)
            both = known & np.isfinite(other)
            count = int(both.sum())
            if count < LEAST_OVERLAP:
                continue
            a, b = pattern[both] - pattern[both].mean(), other[both] - other[both].mean()
            r = float(a @ b / max(float(np.sqrt((a @ a) * (b @ b))), 1e-300))
            independent = 2 * BANDWIDTH * count / STEP
            deviate = float(np.arctanh(min(r, 0.999999)) * np.sqrt(max(independent - 3, 0.0)))
            best = max(best, (deviate, shift, direction))
    return best


def _mean(curves: list[np.ndarray]) -> np.ndarray:
    """Mean of curves over what is seen of them."""
    stack = np.stack(curves)
    count = np.isfinite(stack).sum(axis=0)
    return np.where(count > 0, np.nansum(stack, axis=0) / np.maximum(count, 1), np.nan)

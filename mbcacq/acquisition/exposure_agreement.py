"""Whether the exposures of one pose agree, ball by ball."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from mbcacq.acquisition.gate_options import GateOptions
from mbcacq.spheres.found import FoundSpheres

MAD_TO_SIGMA = 1.4826  # of a normal distribution


class ExposureAgreement:
    """Compares the exposures of a pose by the scanner's noise, which it learns from the poses of the run."""

    def __init__(self, noise_mm: Sequence[float] | None, options: GateOptions) -> None:
        """noise_mm: (3,) stated standard uncertainty of one centre, or None."""
        self._stated = None if noise_mm is None else float(max(noise_mm))
        self._options = options
        self._scatter_mm: list[float] = []

    def majority(self, found: Sequence[FoundSpheres]) -> list[int] | None:
        """Indices of the exposures that agree, where they are more than half of all; None if no such majority exists."""
        if len(found) < 2:
            return list(range(len(found)))
        limits = self._limits(found)
        agree = np.eye(len(found), dtype=bool)
        for i, j in combinations(range(len(found)), 2):
            agree[i, j] = agree[j, i] = all(distance <= limits[ball] for ball, distance in _distances(found[i], found[j]).items())
        best = int(np.argmax(agree.sum(axis=1)))
        kept: list[int] = np.flatnonzero(agree[best]).tolist()
        return kept if 2 * len(kept) > len(found) else None

    def largest_difference(self, found: Sequence[FoundSpheres]) -> tuple[float, int]:
        """The largest distance of one ball between two exposures, in mm, and the ball; (0, 0) where no ball was found twice."""
        pairs = [(d, ball) for a, b in combinations(found, 2) for ball, d in _distances(a, b).items()]
        return max(pairs, default=(0.0, 0))

    def learn(self, found: Sequence[FoundSpheres]) -> None:
        """Take the scatter of a pose that was accepted as a sample of the noise."""
        distances = [d for a, b in combinations(found, 2) for d in _distances(a, b).values()]
        if distances:
            self._scatter_mm.append(MAD_TO_SIGMA * float(np.median(distances)) / np.sqrt(2.0))

    def _limits(self, found: Sequence[FoundSpheres]) -> dict[int, float]:
        """Largest credible distance of each ball between two exposures, mm."""
        o = self._options
        known = max(self._stated or 0.0, float(np.median(self._scatter_mm)) if self._scatter_mm else 0.0)
        fitted: dict[int, list[float]] = {}
        for each in found:
            for ball, covariance in zip(each.ball.tolist(), each.covariance, strict=True):
                fitted.setdefault(ball, []).append(float(np.sqrt(np.linalg.eigvalsh(covariance)[-1])))
        floor = o.least_disagreement_mm
        if self._stated is None and len(found) > 2:
            closest = min(_rms(list(_distances(a, b).values())) for a, b in combinations(found, 2))
            floor = max(floor, o.unstated_noise_factor * closest)
        return {ball: max(floor, o.agreement_sigmas * np.sqrt(2.0) * max(known, float(np.median(sigma)))) for ball, sigma in fitted.items()}


def _distances(a: FoundSpheres, b: FoundSpheres) -> dict[int, float]:
    """Distance (mm) of each ball that both exposures show."""
    _, i, j = np.intersect1d(a.ball, b.ball, return_indices=True)
    return dict(zip(a.ball[i].tolist(), np.linalg.norm(a.xyz[i] - b.xyz[j], axis=1).tolist(), strict=True))


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else 0.0

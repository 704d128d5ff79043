"""The noise of a hypothesis is found although the information of its rows is not its curvature."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from mbcacq.diagnosis.evidence.hypothesis import estimated
from mbcacq.diagnosis.options import OPTIONS

MAXIMUM = -3.7


@dataclass(frozen=True)
class Equations:
    """No effects, and a log posterior of one noise that is a parabola."""

    theta: float
    curvature: float
    A: np.ndarray
    a: np.ndarray

    @property
    def log_likelihood(self) -> float:
        return -0.5 * self.curvature * (self.theta - MAXIMUM) ** 2

    def score(self, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The information says 100, whatever the curvature."""
        return np.array([-self.curvature * (self.theta - MAXIMUM)]), np.array([[100.0]])


@dataclass(frozen=True)
class OneNoise:
    """A recording of which one noise is unknown."""

    theta: float
    curvature: float

    def extended(self, members):
        return None

    def with_effects(self, extended) -> Equations:
        return Equations(self.theta, self.curvature, np.zeros((0, 0)), np.zeros(0))

    def conditioned(self, members):
        return self

    def moved(self, gradient: np.ndarray, information: np.ndarray) -> tuple[OneNoise, np.ndarray]:
        step = np.linalg.solve(information, gradient)
        return replace(self, theta=self.theta + float(step[0])), step

    def forget(self) -> None: ...


@pytest.mark.parametrize("curvature", [60.0, 100.0, 180.0, 200.0, 240.0, 390.0])
def test_the_most_probable_noise_is_found_where_the_information_is_half_of_the_curvature(curvature):
    """With steps of the information alone a curvature of 200 goes to and fro for ever, and one of 240 away."""
    found = estimated((), OneNoise(MAXIMUM + 0.6, curvature), 0.0)
    assert found.point.theta == pytest.approx(MAXIMUM, abs=2 * OPTIONS.steady)

"""A hose that is too short: clamped to the forearm and to the scanner's bracket, it hangs slack until the wrist stretches it."""

from __future__ import annotations

from typing import Any

import numpy as np

from mbcacq_fakes.effects.base import InjectedEffect
from mbcacq_fakes.world.hooks import Moments, Moved


class TautHose(InjectedEffect):
    """Beyond its length the hose pulls like a spring, along the line between the clamps, and the bracket leans under the moment.

    How far the clamps are apart is a matter of A5 and A6 together; the lean has all three components.
    """

    STIFFNESS = 0.1  # N/mm, of the stretched hose
    BACK, BESIDE = 180.0, 90.0  # mm, of the clamp on the forearm: from the hand axis back, and off the forearm
    OUT, FORWARD = 75.0, 60.0  # mm, of the clamp on the bracket: off the flange's axis, and beyond the flange

    def draw(self) -> dict[str, Any]:
        zero = self.arm.zero
        wrist = self.cell.n - 2  # the frame behind the forearm
        back = zero[wrist, :3, :3].T @ (zero[wrist - 1, :3, 3] - zero[wrist, :3, 3])
        back = back / np.linalg.norm(back)
        beside = np.cross(back, self.rng.standard_normal(3))
        self._forearm = self.BACK * back + self.BESIDE * beside / np.linalg.norm(beside)
        turn = float(self.rng.uniform(-np.pi, np.pi))
        self._bracket = np.array([self.OUT * np.cos(turn), self.OUT * np.sin(turn), self.FORWARD])
        self.lean = abs(self.size(4e-4))
        # It is taut in a third to a half of what the arm does.
        self.length = float(np.quantile(np.linalg.norm(self._between(self.planned), axis=1), self.rng.uniform(0.5, 0.67)))
        last = self.cell.n
        return {
            "where": ["mount"],
            "depends_on": [f"q{last - 1}", f"q{last}"],
            "length_mm": self.length,
            "stiffness_N_per_mm": self.STIFFNESS,
            "lean_rad_per_Nm": self.lean,
        }

    def _between(self, q: np.ndarray) -> np.ndarray:
        """(P, 3) mm from the clamp on the bracket to that on the forearm, in the flange frame."""
        frames = self.arm.frames(q)
        wrist, flange = frames[:, self.cell.n - 2], frames[:, self.cell.n]
        forearm = wrist[:, :3, :3] @ self._forearm + wrist[:, :3, 3] - flange[:, :3, 3]
        return np.einsum("pij,pi->pj", flange[:, :3, :3], forearm) - self._bracket

    def displace(self, at: Moments, moved: Moved) -> None:
        between = self._between(at.q)
        distance = np.linalg.norm(between, axis=1, keepdims=True)
        force = self.STIFFNESS * np.maximum(distance - self.length, 0) * between / distance  # N
        moved.frame[:, self.cell.n, 3:] += self.lean * np.cross(self._bracket * 1e-3, force)

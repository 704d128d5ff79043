"""Where the flange is between the cycles of its controller, and how fast it moves there.

Between two cycles each coordinate follows the cubic whose slopes at both are those of the parabola through a cycle and its neighbours. No
pose is stated where cycles are missing, nor before the first or after the last.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mbcacq.geometry import se3
from mbcacq.geometry.chain import Chain
from mbcacq.geometry.flange_poses import FlangePoses

MISSING = 1.5  # times the usual step from cycle to cycle, from which one is missing
AROUND = 5.0  # steps before and after, of which a velocity is the difference: their noise is not that of the cycles at the moment itself


@dataclass(frozen=True)
class FlangeMotion:
    """Cycles of a controller: time_s (N,) ascending; q (N, n) joint angles in rad, or coordinates of ``FlangePoses``.

    inverted: the pose of the base as the flange sees it stands in place of the flange's, for a scanner that does not move.
    """

    chain: Chain
    time_s: np.ndarray
    q: np.ndarray
    inverted: bool = False

    @classmethod
    def of_poses(cls, time_s: np.ndarray, coordinates: np.ndarray, inverted: bool = False) -> FlangeMotion:
        """The motion of coordinates (N, 6) of the flange. A rotation vector that passes half a turn goes on with its sign."""
        turn = coordinates[:, 3:]
        angle = np.maximum(np.linalg.norm(turn, axis=1), 1e-12)
        passes = (np.sum(turn[1:] * turn[:-1], axis=1) < 0) & (np.minimum(angle[1:], angle[:-1]) > np.pi / 2)
        other = np.r_[False, np.cumsum(passes) % 2 == 1]
        turn = np.where(other[:, None], turn * (1 - 2 * np.pi / angle)[:, None], turn)
        return cls(FlangePoses.new(), time_s, np.column_stack([coordinates[:, :3], turn]), inverted)

    @cached_property
    def step_s(self) -> float:
        """The usual time from one cycle to the next."""
        return float(np.median(np.diff(self.time_s)))

    @cached_property
    def _slopes(self) -> np.ndarray:
        """(N, n) per s, of the parabola through a cycle and its neighbours; at a gap that of the side that is there."""
        gap = np.diff(self.time_s)
        rate = np.diff(self.q, axis=0) / gap[:, None]
        before, after = np.concatenate([rate[:1], rate]), np.concatenate([rate, rate[-1:]])
        left, right = np.r_[gap[:1], gap], np.r_[gap, gap[-1:]]
        share = np.where(left > MISSING * self.step_s, 0.0, np.where(right > MISSING * self.step_s, 1.0, right / (left + right)))
        return share[:, None] * before + (1 - share)[:, None] * after

    def known(self, t: np.ndarray) -> np.ndarray:
        """Whether cycles enclose each time t (P,) s and none is missing between them."""
        i = self._before(t)
        inside = (t >= self.time_s[0]) & (t <= self.time_s[-1])
        return inside & (self.time_s[i + 1] - self.time_s[i] <= MISSING * self.step_s)

    def coordinates(self, t: np.ndarray) -> np.ndarray:
        """(P, n) coordinates of the arm at times t (P,) s."""
        i = self._before(t)
        length = self.time_s[i + 1] - self.time_s[i]
        u = ((t - self.time_s[i]) / length)[:, None]
        bend = length[:, None] * u * (1 - u) * ((1 - u) * self._slopes[i] - u * self._slopes[i + 1])
        smooth = u * u * (3 - 2 * u)
        return (1 - smooth) * self.q[i] + smooth * self.q[i + 1] + bend

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Poses (P, 4, 4) and velocities (P, 6) in the moving frame itself, mm/s and rad/s, at times t (P,) s."""
        h = AROUND * self.step_s
        before, after = np.maximum(t - h, self.time_s[0]), np.minimum(t + h, self.time_s[-1])
        T, earlier, later = (self._transforms(moment) for moment in (t, before, after))
        shift = np.einsum("pji,pj->pi", T[:, :3, :3], later[:, :3, 3] - earlier[:, :3, 3])
        turn = se3.rotation_log(np.swapaxes(earlier[:, :3, :3], 1, 2) @ later[:, :3, :3])
        return T, np.concatenate([shift, turn], axis=1) / np.maximum(after - before, h)[:, None]

    def _transforms(self, t: np.ndarray) -> np.ndarray:
        T = self.chain.flange(self.coordinates(t))
        return se3.inverse(T) if self.inverted else T

    def _before(self, t: np.ndarray) -> np.ndarray:
        return np.clip(np.searchsorted(self.time_s, t, side="right") - 1, 0, len(self.time_s) - 2)

"""The arm behind the fake controller: it follows its set point with a dead time and a lag, and knows where its flange is. deg, mm, s."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import atan2, copysign, cos, degrees, exp, hypot, radians, sin

_DEAD_CYCLES = 2
_STILL_DEG = 1e-6
_STILL_CYCLES = 5


class IdealArm:
    """Six axes, and external ones behind them. ``step`` advances one controller cycle towards a set point."""

    def __init__(self, start: Sequence[float], cycle_s: float, lag_s: float) -> None:
        self.q = list(start)
        self.qd = [0.0] * len(self.q)
        self.direction = [0.0] * len(self.q)
        self.standstill, self.arrivals, self.still_cycles = True, 0, _STILL_CYCLES
        self._cycle_s = cycle_s
        self._share = 1.0 - exp(-cycle_s / lag_s) if lag_s > 0 else 1.0
        self._ahead = deque([tuple(start)] * _DEAD_CYCLES, maxlen=_DEAD_CYCLES)
        self._steady: tuple[float, ...] | None = None

    def step(self, set_point: tuple[float, ...]) -> bool:
        """True if the arm moved."""
        if self._steady == set_point:  # everything downstream has settled
            self._settle(0.0)
            return False
        target = self._ahead[0]
        self._ahead.append(set_point)
        q, share, fastest = self.q, self._share, 0.0
        for axis in range(len(q)):
            away = target[axis] - q[axis]
            move = away * share if abs(away) > 1e-7 else away
            if move:
                q[axis] += move
                self.direction[axis] = copysign(1.0, move)
                fastest = max(fastest, abs(move))
            self.qd[axis] = move / self._cycle_s
        self._settle(fastest)
        self._steady = set_point if fastest == 0.0 and self._ahead[0] == set_point == target else None
        return fastest > 0.0

    def _settle(self, fastest: float) -> None:
        if fastest > _STILL_DEG:
            # Counted where a motion begins: a scanner that looks before the last of it is done sees the same arrival.
            self.arrivals += self.standstill
            self.standstill, self.still_cycles = False, 0
            return
        self.still_cycles += 1
        self.standstill = self.standstill or self.still_cycles >= _STILL_CYCLES

    def currents(self) -> list[float]:
        """A rough picture of motor currents (percent): holding the arm up, and friction."""
        a2, a23, a5 = radians(self.q[1]), radians(self.q[1] + self.q[2]), radians(self.q[4])
        forearm = 11.0 * cos(a23)
        holding = (0.0, 24.0 * cos(a2) + forearm, forearm, 0.0, 2.5 * cos(a23 + a5), 0.0)
        return [h + (copysign(3.0, v) + 0.08 * v if v else 0.0) for h, v in zip(holding, self.qd[:6], strict=True)]


class Kinematics:
    """Flange pose X, Y, Z, A, B, C (mm, deg) from rows (sign, theta_deg, d_mm, a_mm, alpha_deg, beta_deg) of a modified DH chain."""

    def __init__(self, dh: Sequence[Sequence[float]]) -> None:
        self._rows = []
        for sign, theta, d, a, alpha, *rest in dh:
            beta = radians(rest[0]) if rest else 0.0
            self._rows.append((sign, radians(theta), d, a, cos(radians(alpha)), sin(radians(alpha)), cos(beta), sin(beta)))

    def pose(self, q: Sequence[float]) -> tuple[float, float, float, float, float, float]:
        if not self._rows:
            return (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        (x0, x1, x2), (y0, y1, y2), (z0, z1, z2), px, py, pz = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), 0.0, 0.0, 0.0
        for angle, (sign, theta, d, a, ca, sa, cb, sb) in zip(q, self._rows, strict=True):
            turned = sign * radians(angle) + theta
            c, s = cos(turned), sin(turned)
            # the columns x, y, z of the rotation and the origin p, multiplied from the right by Rz, Tz, Tx, Rx, Ry
            x0, x1, x2, y0, y1, y2 = (c * x0 + s * y0, c * x1 + s * y1, c * x2 + s * y2, c * y0 - s * x0, c * y1 - s * x1, c * y2 - s * x2)
            px, py, pz = px + d * z0 + a * x0, py + d * z1 + a * x1, pz + d * z2 + a * x2
            y0, y1, y2, z0, z1, z2 = (
                ca * y0 + sa * z0,
                ca * y1 + sa * z1,
                ca * y2 + sa * z2,
                ca * z0 - sa * y0,
                ca * z1 - sa * y1,
                ca * z2 - sa * y2,
            )
            if sb:
                x0, x1, x2, z0, z1, z2 = (
                    cb * x0 - sb * z0,
                    cb * x1 - sb * z1,
                    cb * x2 - sb * z2,
                    cb * z0 + sb * x0,
                    cb * z1 + sb * x1,
                    cb * z2 + sb * x2,
                )
        return px, py, pz, degrees(atan2(x1, x0)), degrees(atan2(-x2, hypot(x0, x1))), degrees(atan2(y2, z2))

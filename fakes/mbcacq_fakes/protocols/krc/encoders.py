"""What the controller reads of its axes: a servo at rest hums, and an encoder has steps. deg."""

from __future__ import annotations

from collections.abc import Sequence
from random import Random

_CYCLES = 2048  # of noise, which then begins again: longer than any window in which it is judged


class Encoders:
    """``read`` the angles of a cycle. noise_deg: standard deviation, white from cycle to cycle; step_deg: resolution, 0 for none."""

    def __init__(self, noise_deg: float, step_deg: float, seed: int, axes: int = 6) -> None:
        draw = Random(seed)
        self._step = step_deg
        self._noise = [[draw.gauss(0.0, noise_deg) for _ in range(axes)] for _ in range(_CYCLES)] if noise_deg else None

    @property
    def noisy(self) -> bool:
        """Whether an arm at rest reads differently from cycle to cycle."""
        return self._noise is not None

    def read(self, q: Sequence[float], cycle: int) -> list[float]:
        """Angles (n,) of an arm that stands at q (n,)."""
        shown = list(q) if self._noise is None else [v + e for v, e in zip(q, self._noise[cycle % _CYCLES], strict=True)]
        return [round(v / self._step) * self._step for v in shown] if self._step else shown

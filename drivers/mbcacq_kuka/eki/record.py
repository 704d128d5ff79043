"""The states of the controller as the cycles of a recording."""

from __future__ import annotations

from collections import deque

import numpy as np

from mbcacq.devices import Cycles
from mbcacq_kuka.eki.options import EkiOptions
from mbcacq_kuka.eki.telegrams import State

MAX_ROWS = 200_000  # more than an hour that nobody fetched


class Record:
    """``add`` from one thread, ``drain`` from another; ``lost`` counts what was not fetched in time."""

    def __init__(self, options: EkiOptions) -> None:
        self._options = options
        self._rows: deque[list[float]] = deque(maxlen=MAX_ROWS)
        self.lost = 0

    def add(self, arrival_s: float, state: State, target: tuple[float, ...] | None, connection: int) -> None:
        self.lost += len(self._rows) == MAX_ROWS
        command = (np.nan,) * len(state.axis) if target is None else target
        age = max(0, state.time - state.beat) if state.beat else np.nan
        self._rows.append(
            [
                arrival_s,
                state.time * 1e-3,
                state.override,
                state.moving,
                age,
                connection,
                *state.current,
                *state.cart,
                *state.axis,
                *command,
            ]
        )

    def drain(self) -> Cycles:
        """q_set is not reported over EKI (NaN); q_command is the target of the move under way."""
        taken = []
        while self._rows:
            taken.append(self._rows.popleft())
        if not taken:
            return Cycles({})
        rows, n = np.array(taken, dtype=float), len(self._options.axes)
        return Cycles(
            {
                "host_time_s": rows[:, 0],
                "time_s": rows[:, 1],
                "override_percent": rows[:, 2],
                "moving": rows[:, 3].astype(bool),
                "sign_of_life_ms": rows[:, 4],
                "connection": rows[:, 5],
                "q": self._options.in_plan(rows[:, 18 : 18 + n]),
                "q_set": np.full((len(rows), n), np.nan),
                "q_command": self._options.in_plan(rows[:, 18 + n :]),
                "current_percent": rows[:, 6:12],
                "tool_in_base_mm_deg": rows[:, 12:18],
            }
        )

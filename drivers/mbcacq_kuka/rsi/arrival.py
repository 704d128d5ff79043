"""Does the arm stand where it was asked to go? Judged from the measured joints, cycle by cycle."""

from __future__ import annotations

from collections.abc import Sequence

from mbcacq_kuka.rsi.shared import RsiCommand

_COARSE_CYCLES = 100  # standing so long next to the target: look whether rounding hides the arrival


class Arrival:
    """``begin`` with every move, ``judge`` in every cycle in which no set point moves, ``abandon`` where the move is given up."""

    def __init__(self) -> None:
        self.arrived = True
        self._command: RsiCommand | None = None
        self._inside_since: float | None = None

    def begin(self, command: RsiCommand) -> None:
        self.arrived, self._command, self._inside_since = False, command, None

    def abandon(self) -> None:
        self._command = None

    def judge(self, measured: Sequence[float], still: int, time_s: float) -> str | None:
        """measured: (6,) deg; still: cycles for which the arm has been standing; time_s: the controller's clock. Returns what is wrong
        where the telegrams are too coarse to tell."""
        command = self._command
        if self.arrived or command is None:
            return None
        if any(abs(m - t) > command.tolerance for m, t in zip(measured, command.target, strict=True)):
            self._inside_since = None
            if still == _COARSE_CYCLES and (digits := _rounded_to(measured, command.target)) is not None:
                return (
                    f"the telegrams show joint angles with {digits} decimals only, too coarse to see an arrival within "
                    f"{command.tolerance:g} deg; set Precision to 6 at the ETHERNET object of the RSI context"
                )
        elif self._inside_since is None:
            self._inside_since = time_s
        elif time_s - self._inside_since >= command.settle_s:
            self.arrived = True
        return None


def _rounded_to(measured: Sequence[float], target: Sequence[float]) -> int | None:
    """If the arm stands at its target but for rounding: to how many decimals."""
    return next((d for d in (1, 2, 3) if all(abs(round(t, d) - m) < 1e-9 for m, t in zip(measured, target, strict=True))), None)

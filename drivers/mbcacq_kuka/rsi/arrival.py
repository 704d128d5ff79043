"""Does the arm stand where it was asked to go? Judged from the measured joints, cycle by cycle."""

from __future__ import annotations

from collections.abc import Sequence

from mbcacq_kuka.rsi.shared import RsiCommand


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

    def judge(self, mean: Sequence[float], time_s: float) -> None:
        """mean: joints (6,) deg of the last cycles, as single ones are noisy; time_s: the controller's clock."""
        command = self._command
        if self.arrived or command is None:
            return
        if any(abs(m - t) > command.tolerance for m, t in zip(mean, command.target, strict=True)):
            self._inside_since = None
        elif self._inside_since is None:
            self._inside_since = time_s
        elif time_s - self._inside_since >= command.settle_s:
            self.arrived = True


def too_coarse(decimals: int, command: RsiCommand) -> str:
    """Why angles that are written with so many decimals cannot show an arrival; '' if they can."""
    if 0.5 * 10.0**-decimals <= command.tolerance:
        return ""
    return (
        f"the telegrams show joint angles with {decimals} decimal{'s' * (decimals != 1)} only, too coarse to see an arrival within "
        f"{command.tolerance:.2g}°; set Precision to 6 at the ETHERNET object of the RSI context; nothing was moved"
    )

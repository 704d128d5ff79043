"""Judges the states of the controller: has the arm arrived, does it do what it was asked to? No sockets, no clock of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from mbcacq.devices import DeviceFault, DeviceTimeout, MbcacqError, SafetyStop
from mbcacq_kuka.eki.options import mode_name
from mbcacq_kuka.eki.telegrams import EXTERNAL_REFUSALS, REFUSALS, State

_TAKE_S, _BEGIN_S, _REACH_S = 2.0, 3.0, 1.0  # robot time to take a move, to begin it, to come to the target once it is done
_NAMES = {"tool": "tool", "base": "base", "mode": "operating mode"}


@dataclass(frozen=True)
class Move:
    """One move under way. ``away(state)`` is the distance to its target, in units of the tolerance; settle_s on the robot's clock."""

    number: int
    away: Callable[[State], float]
    settle_s: float


class Watch:
    """``take`` every state; it returns what is wrong, or None. The first state is what the cell must stay like."""

    def __init__(self, name: str, first: State) -> None:
        self._name, self._first = name, first
        self.move: Move | None = None
        self.arrived = False
        self._since: float | None = None
        self._inside_since: float | None = None

    def begin(self, move: Move) -> None:
        self.move, self.arrived = move, False
        self._since = self._inside_since = None

    def abandon(self) -> None:
        """The move was stopped: it will not arrive, and that is no fault."""
        self.move = None

    def take(self, state: State) -> MbcacqError | None:
        return self._fault(state) or (None if self.move is None or self.arrived else self._judge(self.move, state))

    def _fault(self, state: State) -> MbcacqError | None:
        robot = f"robot '{self._name}'"
        if state.emergency_stop or state.guard_stop:
            which = "emergency stop" if state.emergency_stop else "operator safety (guard) stop"
            return SafetyStop(f"{robot}: {which}; the controller has stopped the arm: release, acknowledge, start its program again")
        if not state.ready:
            return DeviceFault(f"{robot}: the program on the controller has stopped; read the message on the smartPAD, start it again")
        if state.session != self._first.session:
            return SafetyStop(f"{robot}: the program on the controller was started again during the run; start the run again as well")
        for what, words in _NAMES.items():
            if (now := getattr(state, what)) != (before := getattr(self._first, what)):
                before, now = (mode_name(v) if what == "mode" else str(v) for v in (before, now))
                return SafetyStop(f"{robot}: the {words} changed from {before} to {now} during the run; the arm is stopped")
        return None

    def _judge(self, move: Move, state: State) -> MbcacqError | None:
        now = state.time * 1e-3
        since = self._since = now if self._since is None else self._since
        if (refusal := self._refusal(move, state)) is not None:
            return refusal
        if state.last < move.number:
            return self._overdue(now - since, _TAKE_S, "the controller did not take the move; the arm is stopped")
        if state.done < move.number or state.moving:
            self._inside_since = None
            if state.moving:
                self._since = now
            return self._overdue(
                0.0 if state.moving else now - since,
                _BEGIN_S,
                "the controller took the move, but the arm does not begin it; look at the smartPAD (drives, start key in T1, messages)",
            )
        return self._judge_standstill(move, state, now, since)

    def _refusal(self, move: Move, state: State) -> MbcacqError | None:
        robot = f"robot '{self._name}'"
        if state.refused == move.number:
            reason = (REFUSALS | EXTERNAL_REFUSALS).get(state.code, f"code {state.code}")
            return SafetyStop(
                f"{robot}: the controller refused the move: {reason}; nothing was moved (the files on the controller must be "
                "those that `mbcacq controller-files` writes for this plan)"
            )
        if state.cancelled >= move.number:
            return DeviceFault(
                f"{robot}: the controller stopped the move by itself, for want of signs of life; look at the network and "
                "the load of this computer"
            )
        return None

    def _judge_standstill(self, move: Move, state: State, now: float, since: float) -> MbcacqError | None:
        away = move.away(state)
        if away <= 1.0:
            self._inside_since = now if self._inside_since is None else self._inside_since
            self.arrived = now - self._inside_since >= move.settle_s
            return None
        self._inside_since = None
        if now - since <= _REACH_S:
            return None
        return SafetyStop(
            f"robot '{self._name}': the arm stands {away:.1f} times the tolerance away from its target, although the controller "
            "says the move is done; it is not moved any further"
        )

    def _overdue(self, waited_s: float, limit_s: float, sentence: str) -> MbcacqError | None:
        return DeviceTimeout(f"robot '{self._name}': {sentence}") if waited_s > limit_s else None

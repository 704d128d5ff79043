"""The set points of a session: which one the controller has, which it was sent last, and which it gets next.

They advance by one an answered telegram. None is sent before it was seen to be within the axes' limits, and no motion begins before the
controller was seen to take corrections as absolute.

If a telegram is missing, or the controller counts an answer as late, nobody knows whether it has the last set point or the one before.
Nothing is inferred from its count: the answers carry no correction, so that it holds what it has, until the arm is seen to stand at one
of the two. The motion goes on from there, from rest. So no two set points of the controller differ by more than the limits allow,
whatever it counts. The hold itself is the exception.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from mbcacq_kuka.rsi.handshake import Layout, SessionFault
from mbcacq_kuka.rsi.motion import MotionRefused, RsiMotion
from mbcacq_kuka.rsi.plausibility import proof_fault
from mbcacq_kuka.rsi.shared import RsiCommand
from mbcacq_kuka.rsi.standstill import Standstill
from mbcacq_kuka.rsi.step_limits import StepLimits

MOST_DOUBTS = 200  # of a motion: each takes a fifth of a second, and more of them are no network that can be worked with
FEWEST, MOST = 6, 250  # cycles in each of two windows; the most are a second
NEAR, DRIFT = 0.25, 0.05  # in shares of the way between two set points: how near the arm is to one, and how little it still moves


class SetPoints:
    """``sent`` last, ``used`` by the controller before, and ``next``: joints (6,) deg; each with whether the arm moves there.

    Parameters
    ----------
    layout : Layout
        Of the session, with its reference.
    settings : Mapping[str, Any]
        See options.RsiOptions.
    cycle_s : float
        Of the controller.
    fail : Callable[[SessionFault], None]
        Gets what ends the session; it brakes by ``brake`` or ``freeze``.
    """

    def __init__(self, layout: Layout, settings: Mapping[str, Any], cycle_s: float, fail: Callable[[SessionFault], None]) -> None:
        self._settings, self._fail = settings, fail
        joint_limits = [tuple(pair) for pair in settings["limits_deg"]]
        self._motion = RsiMotion(layout.reference, cycle_s, joint_limits)
        self._limits = StepLimits(layout.reference, joint_limits, settings["dynamics"], cycle_s)
        self._proof = None if layout.carries_out else layout.proof(settings)
        self._doubt: tuple[tuple[float, ...], tuple[float, ...]] | None = None  # the controller has one of these
        self._doubts = 0  # of this motion
        self._shares: deque[float] = deque(maxlen=2 * MOST)  # of the way between the two at which the arm was seen since
        self.sent = self.used = self._next = layout.reference
        self.sent_moving = self.used_moving = self._next_moving = self._frozen = False
        self._consumed = True

    @property
    def unproven(self) -> bool:
        """The controller was not yet seen to be absolute: only a correction of zero is safe."""
        return self._proof is not None

    @property
    def _moves(self) -> bool:
        return self._motion.moving or self._proof is not None and self._proof.wanted is not None

    @property
    def answer(self) -> tuple[float, ...] | None:
        """What goes to the controller once more; None: it is to keep what it has."""
        return None if self._doubt is not None else self.sent

    @property
    def next(self) -> tuple[float, ...] | None:
        """What goes to the controller next, as ``answer``."""
        return None if self._doubt is not None else self._next

    # what an answer has done

    def accept(self) -> None:
        """The controller has taken what was sent."""
        if self._doubt is None:
            self.used, self.used_moving = self.sent, self.sent_moving

    def advance(self) -> None:
        """The prepared set point goes to the controller."""
        if self._doubt is None:
            self.sent, self.sent_moving, self._consumed = self._next, self._next_moving, True

    def doubt(self) -> None:
        """The controller has ``sent``, or ``used`` and did not take what was sent."""
        if self._doubt is not None:
            return  # it has what it had
        if self._proof is not None or self._motion.reaches(self.used, self.sent):
            self.go_on_from_rest()
            return
        self._doubt, self.sent_moving, self._doubts = (self.used, self.sent), False, self._doubts + 1
        self._shares.clear()
        if self._doubts > MOST_DOUBTS:
            late = "telegrams or answers were late or lost in this motion, each of which held the arm for a moment"
            self._fail(SessionFault("late", f"{self._doubts} {late}; check the network and the load of this computer"))

    def go_on_from_rest(self) -> None:
        """The controller held ``sent`` meanwhile. It gets it once more; from the next answer on the motion goes on."""
        self._motion.hold(self.sent)
        self._limits.rest(self.sent)
        self.sent_moving, self._consumed = self._moves, True

    def _look(self, measured: Sequence[float], arm: Standstill) -> None:
        """Decide where the controller is, once the means of two windows, one after the other, agree on one of the two set points. An arm
        with a lag comes nearer so slowly that it seems to stand elsewhere: so the way it still goes counts, not its speed."""
        assert self._doubt is not None  # prepare looked
        before, last = self._doubt
        way = [b - a for a, b in zip(before, last, strict=True)]
        squared = sum(d * d for d in way)
        self._shares.append(sum(d * (q - a) for d, q, a in zip(way, measured, before, strict=True)) / squared)
        variance = sum(d * d * v for d, v in zip(way, arm.variance, strict=True)) / squared**2
        cycles = min(max(FEWEST, round(100.0 * variance)), MOST)  # whose mean is known to a tenth of the way
        if not arm.cycles or self._frozen or len(self._shares) < 2 * cycles:
            return
        seen = list(self._shares)[-2 * cycles :]
        earlier, share = sum(seen[:cycles]) / cycles, sum(seen[cycles:]) / cycles
        if abs(share - earlier) > DRIFT:
            return
        moved = share > 0.5
        if abs(share - moved) > NEAR:
            if len(self._shares) < 2 * MOST:
                return
            if not self._motion.reaches(before, last, jerk=False):  # else an arm that rests slightly beside what it was given
                text = "the arm stands at neither of the two set points of which it was given one; look at what is in its way"
                self._fail(SessionFault("follow", text))
                return
        self.sent, self._doubt = last if moved else before, None
        self.go_on_from_rest()
        self.used, self.used_moving = self.sent, self.sent_moving

    # what comes next

    def prepare(self, measured: tuple[float, ...], arm: Standstill) -> None:
        """The next set point, where the last one went out; one that is not within the limits is replaced by braking. measured: joints
        (6,) deg; arm: how it stands."""
        if self._doubt is not None:
            self._look(measured, arm)
        if not self._consumed or self._doubt is not None:
            return
        self._consumed = False
        try:
            if self._proof is not None and self._proof.wanted is not None and not self._frozen:
                self._prove(measured)
            position = self._motion.step()
        except MotionRefused as error:
            self._fail(SessionFault("refused", str(error)))
            position = self._motion.step()
        if refusal := self._limits.refusal(position):
            self._motion.brake_instead(self._limits.dynamics)
            position = self._motion.step()
            still = self._limits.refusal(position)
            self._fail(SessionFault("refused", f"{refusal}; that set point was not sent", muted=bool(still)))
            if still:  # nothing is sent any more, the controller stops the arm
                return
        self._limits.take(position)
        self._next, self._next_moving = position, self._moves

    def _prove(self, measured: tuple[float, ...]) -> None:
        """No motion begins before an absolute correction was seen to be carried out. Raises MotionRefused."""
        proof = self._proof
        assert proof is not None  # prepare looked
        proof.advance(self._motion, measured)
        if (fault := proof_fault(proof, self._settings)) is not None:
            self._fail(fault)
        elif proof.seen and proof.wanted is not None:
            self._proof = None
            self._motion.move(proof.wanted)

    def move(self, command: RsiCommand) -> None:
        """Begin a motion."""
        self.used_moving = self.sent_moving = True  # nothing of it has been sent yet
        self._doubts = 0
        if refusal := self._limits.too_fast(command):
            self._fail(SessionFault("refused", refusal))
        elif self._proof is not None:
            self._proof.ask(command)
        else:
            try:
                self._motion.move(command)
            except MotionRefused as error:
                self._fail(SessionFault("refused", str(error)))

    def brake(self) -> None:
        """To rest within the limits."""
        if self._proof is None:
            self._motion.stop()
            return
        try:
            self._proof.stop(self._motion)  # not known to be absolute: back to zero, where an arm of either kind stands
        except MotionRefused:
            self._motion.stop()

    def freeze(self) -> None:
        """No set point moves the arm any more."""
        self._frozen = True
        self._motion.freeze(self.sent)
        self._limits.rest(self.sent)
        self.sent_moving, self._consumed = False, True

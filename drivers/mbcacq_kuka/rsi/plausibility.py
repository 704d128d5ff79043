"""Is it the arm that was asked to move, and does it? Measured joints, telegram by telegram. deg."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mbcacq_kuka.rsi.handshake import SessionFault
from mbcacq_kuka.rsi.mode import Proof
from mbcacq_kuka.rsi.watch import Follow, Jump

_MOVED_DEG = 0.2  # more than noise and rounding
_LIMITED = "look for a correction limit of the controller (AXISCORR, AXISCORRMON) or a stopped program"
_IGNORED = (
    "no axis has moved at all. Compare sen_type '{sen_type}' with SENTYPE, and correction '{correction}' with the names in the RECEIVE "
    "section, of the controller's RSI Ethernet configuration; see that RSI_MOVECORR runs (in T1 its message must be "
    "acknowledged) and that AXISCORR is connected and not limited to 0°"
)


class ArmPlausibility:
    """``check`` every telegram of a session."""

    def __init__(self, reference: Sequence[float], measured: Sequence[float], settings: Mapping[str, Any], cycle_s: float) -> None:
        """reference: joints (6,) without a correction; measured: those of the session's first telegram; settings: see RsiOptions."""
        self._reference, self._settings, self._cycle_s = reference, settings, cycle_s
        self._follow = Follow(reference, settings["follow_tolerance_deg"], settings["follow_cycles"], settings["follow_lag_s"], cycle_s)
        self._jump = Jump(measured, settings["dynamics"][0], cycle_s)
        self._moved = False

    def check(self, sent: Sequence[float], measured: Sequence[float], steps: int) -> None:
        """sent: set point (6,) of the last answer; measured: joints (6,), so many cycles after the telegram before. Raises SessionFault."""
        jumped = self._jump.check(measured, steps)
        if jumped is not None:
            raise SessionFault(
                "implausible",
                f"the controller reports that A{jumped[0] + 1} jumped by {jumped[1]:.2f}° within {steps * self._cycle_s * 1e3:.0f} ms, "
                "faster than it can turn; look at the arm, its resolvers and the RSI Ethernet configuration",
            )
        if self._settings["follow"]:  # others move it
            return
        if steps > 1:
            self._follow.skip(measured, steps - 1)
        axis = self._follow.check(sent, measured)
        self._moved = self._moved or max(abs(a - b) for a, b in zip(measured, self._reference, strict=True)) > _MOVED_DEG
        if axis is not None:
            raise SessionFault(
                "follow",
                f"A{axis + 1} does not follow: commanded {sent[axis]:.3f}°, measured {measured[axis]:.3f}°; "
                + (_LIMITED if self._moved else _IGNORED.format(**self._settings)),
            )


def proof_fault(proof: Proof, settings: Mapping[str, Any]) -> SessionFault | None:
    """Why no motion may begin; None as long as that is not decided, and where one may."""
    if proof.relative:
        return SessionFault(
            "relative",
            "the controller adds each correction to the ones before, as RSI_ON(#RELATIVE) does; use RSI_ON(#ABSOLUTE) in its program. The "
            "motion was not begun",
        )
    if proof.in_vain:
        return SessionFault("follow", f"before the first motion {_IGNORED.format(**settings)}")
    return None

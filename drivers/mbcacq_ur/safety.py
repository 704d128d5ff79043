"""What a controller says about its safety and its program, as sentences for an operator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

RUNNING = 7  # robot_mode
PLAYING = 2  # runtime_state
MODES = {
    -1: "no controller",
    0: "disconnected",
    1: "waits for the confirmation of its safety settings",
    2: "boots",
    3: "powered off",
    4: "powered on, brakes closed",
    5: "idle, brakes closed",
    6: "in backdrive",
    8: "updates its firmware",
}
STOPS = (  # bits of safety_status_bits, the gravest first
    (9, "has a safety fault", "restart it"),
    (8, "has a safety violation", "look at the pendant, restart the safety system"),
    (6, "is emergency stopped at the robot", "release the button, power it on"),
    (5, "is emergency stopped by the system", "release the emergency stop, power it on"),
    (7, "is emergency stopped", "release the button, power it on"),
    (2, "is protective stopped", "look for what it touched, clear the stop on the pendant"),
    (4, "is safeguard stopped", "close the safeguard, reset it"),
    (3, "is in recovery mode", "move it back inside its safety planes by hand"),
)


def safety_stop(values: Mapping[str, Any]) -> str:
    """Why the arm may not move, as a predicate with what to do; '' if its safety is normal or reduced."""
    bits = int(values["safety_status_bits"])
    for bit, what, remedy in STOPS:
        if bits >> bit & 1:
            return f"{what}; {remedy}"
    return ""


def not_ready(values: Mapping[str, Any], program: int) -> str:
    """Why it cannot be driven, as a predicate with what to do; '' if it can. program: number by which ours is known."""
    if stop := safety_stop(values):
        return stop
    if (mode := int(values["robot_mode"])) != RUNNING:
        return f"is not running ({MODES.get(mode, f'mode {mode}')}); switch it on and release its brakes"
    if int(values["runtime_state"]) != PLAYING:
        return "runs no program; load mbcacq_ur.script (mbcacq controller-files) and press play"
    if int(values["output_int_register_2"]) != program:
        return f"runs another program than this driver's ({program}); load the mbcacq_ur.script of this version and press play"
    if float(values["target_speed_fraction"]) < 0.01:
        return "has its speed slider at 0 %; set it to 100 %"
    return ""

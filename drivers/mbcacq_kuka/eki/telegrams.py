"""What is said over the channel mbcacq_eki: commands to the controller, its introduction and its state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import isfinite
from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

BEAT, PTP, STOP, SWITCH = 0, 1, 3, 4
INTERFACE = "mbcacq 3"  # what the programs on the controller must be
AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
POSE = ("X", "Y", "Z", "A", "B", "C")
REFUSALS = {
    **{k: f"A{k} would leave the limits written into its program" for k in range(1, 7)},
    10: "it does not know this kind of move",
    11: "the speed is beyond what its program allows",
    12: "the acceleration is beyond what its program allows",
    13: "eight moves wait already",
    14: "its program does not run",
    15: "the number of the move was used before",
}
EXTERNAL_REFUSALS = {
    19: "it has fewer external axes than the plan",
    **{20 + k: f"E{k} would leave the limits written into its program" for k in range(1, 7)},
}
SWITCH_REFUSALS = {
    16: "its program may not switch it (the files on the controller must be those that `mbcacq controller-files` writes for this plan)",
    17: "it does not change; is it write-protected, or does another program set it?",
    18: "an emergency stop or an open guard has stopped the arm; acknowledge it",
}


class BadTelegram(ValueError):
    """A telegram that the program on the controller does not send."""


@dataclass(frozen=True)
class Hello:
    """What the controller says of itself. model: $ROBTRAFO[]; frames: X, Y, Z, A, B, C in mm and deg; session: count of program starts."""

    axes: int
    interface: str
    machine_data: str
    model: str
    session: int
    load_kg: float
    base_frame: tuple[float, ...]
    tool_frame: tuple[float, ...]
    robroot: tuple[float, ...]
    load_centre: tuple[float, ...]


@dataclass(frozen=True)
class State:
    """One moment. time ms; load_kg: as at the last move; axis: (n,) deg, or mm of an external axis that slides, arm first; current:
    (6,) %; cart: tool in base, mm and deg. last, done, cancelled, refused: numbers of moves; code: why one was refused (REFUSALS).
    switched: number of the last switch of an output; switch_code: 0, or why it was not switched (SWITCH_REFUSALS). mode: 1 T1, 2 T2,
    3 AUT, 4 EXT. beat: the last sign of life the controller had from us.
    """

    base: int
    beat: int
    cancelled: int
    code: int
    done: int
    drives: int
    emergency_stop: int
    guard_stop: int
    last: int
    mode: int
    moving: int
    override: int
    ready: int
    refused: int
    session: int
    switch_code: int
    switched: int
    time: int
    tool: int
    load_kg: float
    axis: tuple[float, ...]
    cart: tuple[float, ...]
    current: tuple[float, ...]


_INTEGERS = {f.name: f.name.title().replace("_", "") for f in fields(State) if f.type == "int"}


def interface(names: Sequence[str]) -> str:
    """What the programs on the controller must be to move these axes."""
    return " ".join((INTERFACE, *names[len(AXES) :]))


def command(
    kind: int,
    number: int = 0,
    beat: int = 0,
    speed: float = 0.0,
    acceleration: int = 0,
    axes: Sequence[float] | None = None,
    names: Sequence[str] = AXES,
) -> bytes:
    """Always with every element: EKI keeps a queue for each, and they must not fall out of step. names: of all axes; speed: %."""
    a = " ".join(f'{n}="{v:.6f}"' for n, v in zip(names, axes or (0.0,) * len(names), strict=True))
    return (
        f'<Command Kind="{kind}" Id="{number}" Beat="{beat}" Speed="{speed:.6f}" Accel="{acceleration}"><Axis {a}></Axis></Command>'
    ).encode("ascii")


def switch(number: int, output: int, on: bool, beat: int, names: Sequence[str] = AXES) -> bytes:
    """The command that switches $OUT[output]. Its two values travel where moves have acceleration and speed, as every telegram has the same
    elements."""
    return command(SWITCH, number, beat, speed=float(on), acceleration=output, names=names)


def parse(data: bytes, names: Sequence[str] = AXES) -> tuple[Hello | None, State | None]:
    """One ``<Robot>`` telegram; EKI 3 sends introduction and state apart, EKI 6 always both. names: of all axes. Raises BadTelegram."""
    try:
        robot = fromstring(data, forbid_dtd=True)
    except (ParseError, DefusedXmlException, ValueError) as error:
        raise BadTelegram(f"it is no XML ({error})") from error
    hello, state = robot.find("Hello"), robot.find("State")
    if hello is None and state is None:
        raise BadTelegram("it holds neither Hello nor State; is the channel's XML file on the controller ours?")
    return None if hello is None else _hello(hello), None if state is None else _state(state, names)


def _hello(element: Element) -> Hello:
    frames = [_numbers(_child(element, name), POSE) for name in ("BaseFrame", "ToolFrame", "RobRoot", "LoadCentre")]
    return Hello(
        _integer(element, "Axes"),
        element.get("Interface", ""),
        element.get("MachineData", ""),
        element.get("Model", ""),
        _integer(element, "Session"),
        _numbers(element, ("LoadKg",))[0],
        *frames,
    )


def _state(element: Element, names: Sequence[str]) -> State:
    integers = {name: _integer(element, attribute) for name, attribute in _INTEGERS.items()}
    return State(
        **integers,
        load_kg=_numbers(element, ("LoadKg",))[0],
        axis=_numbers(_child(element, "Axis"), names),
        cart=_numbers(_child(element, "Cart"), POSE),
        current=_numbers(_child(element, "Current"), AXES),
    )


def _child(element: Element, name: str) -> Element:
    child = element.find(name)
    if child is None:
        raise BadTelegram(f"{element.tag} has no {name}")
    return child


def _integer(element: Element, name: str) -> int:
    text = element.get(name)
    try:
        value = int(text or "")
    except ValueError:
        raise BadTelegram(f"{element.tag}/@{name} is {text!r}, not a whole number") from None
    if abs(value) >= 1 << 31:
        raise BadTelegram(f"{element.tag}/@{name} is {value:.3g}, more than an INT holds")
    return value


def _numbers(element: Element, names: Sequence[str]) -> tuple[float, ...]:
    values = []
    for name in names:
        text = element.get(name)
        try:
            values.append(float(text or ""))
        except ValueError:
            raise BadTelegram(f"{element.tag}/@{name} is {text!r}, not a number") from None
        if not isfinite(values[-1]) or abs(values[-1]) > 1e7:
            raise BadTelegram(f"{element.tag}/@{name} is {values[-1]:g}, which cannot be")
    return tuple(values)

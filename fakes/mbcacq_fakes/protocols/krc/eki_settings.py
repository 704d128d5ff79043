"""How a fake EKI controller is set up when it starts, and what can be done to it while it runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import radians
from typing import Any

from mbcacq_fakes.protocols.faults import refuse_unknown
from mbcacq_fakes.protocols.krc.settings import ArmSettings

FAULTS = {
    "silence": "no telegram leaves the controller",
    "deaf": "nothing that arrives is read",
    "refuse": "new connections are not accepted",
    "close": "that many times the connection is closed before a telegram",
    "close_inside": "that many times in the middle of a telegram",
    "reset": "that many times the link program does Clear, Init, Open",
    "drop": "that many telegrams are lost",
    "truncate": "that many telegrams lose their second half",
    "duplicate": "that many telegrams come twice",
    "garbage": "that many times bytes without meaning come between telegrams",
    "malformed": "that many telegrams are no XML",
    "no_number": "that many telegrams carry a word where a number should be",
    "delay_ms": "telegrams leave so much later",
    "split": "telegrams leave byte by byte",
    "merge": "telegrams leave in one piece with the next two",
    "ignore": "moves are accepted and never begun",
    "stuck": "outputs are not switched",
    "short_deg": "A1 stops so far before its target",
    "program_stop": "that many times the operator stops the robot program",
    "restart": "that many times the operator selects it and starts it again",
    "emergency_stop": "until taken back; then the program must be started again",
    "override": "$OV_PRO, 0: leave it as it is",
    "mode": "1 T1, 2 T2, 3 AUT, 4 EXT; 0: leave it as it is",
    "load_kg": "somebody enters another load; 0: leave it as it is",
    "tool": "the program runs with another tool number, plus 1; 0: as it is",
}


@dataclass(frozen=True, kw_only=True)
class EkiSettings(ArmSettings):
    """sources: name -> text of the KRL programs and data lists, of which ``program`` runs in the robot interpreter and ``link`` has the
    two entries mbcacq_link_init and mbcacq_link_step for the submit interpreter. channel: text of the EKI channel's XML.

    tools, bases: number -> X, Y, Z (mm), A, B, C (deg). loads: number -> kg. realtime: by the clock, or as fast as the client gives signs
    of life. external: name, slides, limits, speed, start of each external axis, in deg or mm, in the order in which the plan counts them.
    """

    sources: dict[str, str]
    channel: str
    host: str = "127.0.0.1"
    port: int = 0
    program: str = "mbcacq_eki"
    link: str = "mbcacq_link"
    model: str = "#KR10R1100_2 C4 SV"
    machine_data: str = "V8.6.11"
    tools: dict[str, tuple[float, ...]] = field(default_factory=dict)
    bases: dict[str, tuple[float, ...]] = field(default_factory=dict)
    loads: dict[str, float] = field(default_factory=dict)
    robroot: tuple[float, ...] = (0.0,) * 6
    override: int = 100
    mode: str = "#EX"
    running: bool = True
    clock_ms: int = 1_000_000
    external: tuple[dict[str, Any], ...] = ()

    def __post_init__(self) -> None:
        refuse_unknown(self.faults, FAULTS)
        if self.mode not in ("#T1", "#T2", "#AUT", "#EX"):
            raise ValueError("mode must be #T1, #T2, #AUT or #EX")

    @property
    def behind(self) -> list[dict[str, Any]]:
        """The external axes as a controller counts them, behind those of the arm."""
        return sorted(self.external, key=lambda axis: axis["name"])

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of all axes, as KRL writes them."""
        return ("a1", "a2", "a3", "a4", "a5", "a6", *(axis["name"].lower() for axis in self.behind))

    @property
    def start(self) -> tuple[float, ...]:
        return tuple(self.as_the_plan([*self.start_deg, *(float(axis["start"]) for axis in self.behind)]))

    def as_the_plan(self, values: Sequence[float]) -> list[float]:
        """Values of all axes (n,) deg, mm in the plan's order, in rad, mm."""
        own = {axis["name"]: v if axis["slides"] else radians(v) for axis, v in zip(self.behind, values[6:], strict=True)}
        return [*(own[axis["name"]] for axis in self.external), *map(radians, values[:6])]

    def as_counted(self, values: Sequence[float]) -> list[float]:
        """The plan's (n,) deg, as if all axes turned, as this controller counts them, in deg and mm."""
        own = {axis["name"]: radians(v) if axis["slides"] else v for axis, v in zip(self.external, values, strict=False)}
        return [*values[len(self.external) :], *(own[axis["name"]] for axis in self.behind)]

"""How a fake controller is set up when it starts, and what can be done to it while it runs."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from math import radians
from typing import Any

from mbcacq_fakes.protocols.faults import refuse_unknown

PROFILES = {
    "mbcacq": ("RIst", "RSol", "AIPos", "ASPos", "MACur", "Tech", "Delay"),
    "sdk": ("RIst", "AIPos", "EIPos", "Delay"),
    "ros": ("RIst", "RSol", "AIPos", "ASPos", "Delay"),
    "minimal": ("AIPos", "Delay"),
    "motion": ("RIst", "RSol", "AIPos", "ASPos", "MACur", "GearTorque", "AJPos", "Delay"),
}

ELEMENTS = ("RIst", "RSol", "AIPos", "ASPos", "EIPos", "ESPos", "MACur", "MECur", "GearTorque", "AJPos", "Tech", "Delay")
JUMP_DEG = 30.0
FAULTS = {
    "silence": "no telegram leaves the controller",
    "drop": "probability that a telegram is lost on its way",
    "drop_answers": "probability that an answer is lost on its way",
    "delay_ms": "a telegram leaves so much later in its cycle",
    "malformed": "that many telegrams are broken XML",
    "wrong_ipoc": "that many telegrams carry an IPOC out of step",
    "no_aipos": "that many telegrams lack AIPos",
    "foreign": "that many telegrams come from another port",
    "jump": "that many telegrams show A1 30 deg from where it is",
    "clamp_deg": "AXISCORR limits the correction to this, silently",
    "ignore": "corrections are accepted and not carried out",
    "stuck": "outputs are not switched",
    "stop": "that many times the operator stops the program",
    "load_kg": "the program says this of $LOAD",
    "tool": "the program says this of $ACT_TOOL, in place of 1",
    "base": "the program says this of $ACT_BASE, in place of 0",
    "swap": "the elements come in reverse order",
    "spaced": "1: CR LF between elements, blanks before />; 2: line feeds only; 3: blanks wherever XML allows them",
    "upper_type": "TYPE instead of Type",
}


@dataclass(frozen=True, kw_only=True)
class ArmSettings:
    """What both fake controllers know of the arm and its clock. Angles deg, speeds deg/s.

    realtime: by the clock, or as fast as the client lets it. limits_deg: (6, 2). dh: rows (sign, theta_deg, d_mm, a_mm, alpha_deg,
    beta_deg) from which the pose is computed, or none. lag_s: first-order lag of the arm behind its set point. encoder_noise_deg,
    encoder_step_deg: how far the measured axis angles scatter about where the arm is, in any cycle, and in which steps they are read;
    zero for none. faults: those it begins with.
    """

    realtime: bool = True
    start_deg: tuple[float, ...] = (0.0, -90.0, 90.0, 0.0, 0.0, 0.0)
    limits_deg: tuple[tuple[float, float], ...] = ((-185, 185), (-185, 65), (-138, 175), (-350, 350), (-130, 130), (-350, 350))
    speed_deg_s: tuple[float, ...] = (200.0, 175.0, 190.0, 430.0, 430.0, 630.0)
    dh: tuple[tuple[float, ...], ...] = ()
    lag_s: float = 0.012
    encoder_noise_deg: float = 2e-4
    encoder_step_deg: float = 5e-5
    faults: dict[str, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    @property
    def start(self) -> tuple[float, ...]:
        """Where all axes stand first, rad or mm, in the plan's order."""
        return tuple(map(radians, self.start_deg))


@dataclass(frozen=True, kw_only=True)
class KrcSettings(ArmSettings):
    """client: where the telegrams go; bind: from where. realtime: 4 ms by the clock, or lock-step as fast as the answers come. lag_s:
    behind a dead time of two cycles. stretch: by the clock, a second of the robot takes so many seconds. answer_wait_s: in lock-step, how
    long an answer is waited for, and how long where the cycle before had none at all.

    speed_deg_s, acceleration_deg_s2: a correction that asks an axis for ``overspeed`` times more ends the session; accelerations (deg/s^2)
    are watched where they are given and no answer was missing. clamp_deg, monitor_deg: AXISCORR and AXISCORRMON limits, None for the full
    range. external_deg: what EIPos shows. load_kg: in $LOAD, sent in Tech. empty_first: so many nearly empty telegrams begin a session, as
    with RSI 2.
    timeout: late packets that end the session; counting: 'total' or 'consecutive'. digital_outputs: numbers n of $OUT[n] that the files
    on it switch by DiO and report as Digout; files of before have none. layout: a name of PROFILES or the elements themselves.
    moving: the bodies and drives behind the axes (``mbcacq_fakes.dynamics.online.description``), or None for an arm without masses.
    rearm_s: pause before telegrams are offered again after a fault.
    """

    client: tuple[str, int] = ("127.0.0.1", 49152)
    bind: str = "127.0.0.1"
    stretch: float = 1.0
    answer_wait_s: tuple[float, float] = (0.5, 0.01)
    acceleration_deg_s2: tuple[float, ...] | None = None
    overspeed: float = 1.05
    external_deg: tuple[float, ...] = (0.0,) * 6
    load_kg: float = 2.3
    cycle_ms: int = 4
    ipoc: int = 1_000_000
    sen_type: str = "ImFree"
    correction: str = "AK"
    stop_element: str = "Stop"
    hold_on: bool = True
    timeout: int = 100
    counting: str = "total"
    clamp_deg: float | None = None
    monitor_deg: float | None = None
    precision: int = 6
    empty_first: int = 0
    digital_outputs: tuple[int, ...] = ()
    layout: str | tuple[str, ...] = "mbcacq"
    moving: dict[str, Any] | None = None
    rearm_s: float = 2.0
    log: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if isinstance(self.layout, str) and self.layout not in PROFILES:
            raise ValueError(f"layout must be one of {', '.join(PROFILES)}, or a list of elements")
        if unknown := sorted(set(self.elements) - set(ELEMENTS)):
            raise ValueError(f"layout: unknown element {', '.join(unknown)}; known are {', '.join(ELEMENTS)}")
        if self.counting not in ("total", "consecutive"):
            raise ValueError("counting must be total or consecutive")
        if self.cycle_ms not in (4, 12) or not 1 <= self.precision <= 32 or self.timeout < 1:
            raise ValueError("cycle_ms must be 4 or 12, precision 1 to 32, timeout at least 1")
        refuse_unknown(self.faults, FAULTS)

    @property
    def elements(self) -> tuple[str, ...]:
        return PROFILES[self.layout] if isinstance(self.layout, str) else tuple(self.layout)

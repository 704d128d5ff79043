"""A checker at the controller's side, in simulated time."""

from __future__ import annotations

import argparse
import re
import sys
from dataclasses import dataclass

import numpy as np
from bench import TESTS

sys.path.insert(0, str(TESTS / "kuka"))
from mbcacq_kuka.rsi.options import RsiOptions
from mbcacq_kuka.rsi.session import RsiSession
from mbcacq_kuka.rsi.shared import MOVE, STOP, RsiCommand, Shared
from rsi_bench import ACCELERATION, JERK, LIMITS, SOURCE, SPEED, START, T

EVENTS = ("lost", "rejected", "counted", "late", "burst", "repeated", "swapped", "restarted")
SHARES = (0.2, 0.2, 0.2, 0.15, 0.05, 0.1, 0.09, 0.01)  # of the disturbances
DISTURBED = (0.01, 0.1)  # shares of the cycles, motion by motion
ABSOLUTE, AWAKENING = "absolute", "absolute once it was probed"
RELATIVE, HIDDEN = "relative", "relative once it was probed"
GROUPS = (ABSOLUTE,) * 17 + (AWAKENING, RELATIVE, HIDDEN)
NAMES, ARMS = ("ideal", "lag", "lag and hum"), ((0.0, 0.0), (0.02, 0.0), (0.02, 3e-4))  # s, deg
SLOW = 0.1  # s: lag of relative arms instead; an absolute one with such a lag is refused at this speed, as it does not follow
JUMPS = 0.05  # share of the motions in which the reported angles jump once
CYCLES = 340
QUIET = 120  # cycles after a stop, or after a fault: braking takes no longer
AT_ONCE = ("relative", "connect")  # faults after which not even that
ROUNDING_DEG = 1e-6  # of the answers
_AXES = re.compile(rb'A\d="([^"]+)"')


@dataclass
class Controller:
    """``cycle`` is one exchange. ``set_point``: where the arm shall be, deg; ``path``: one a cycle; ``given``: whether it was a new one."""

    relative: bool
    lag_s: float
    noise_deg: float
    rng: np.random.Generator
    decimals: int = 6

    def __post_init__(self) -> None:
        self.shared = Shared.create()
        self.session = RsiSession(self.shared, RsiOptions(limits_deg=LIMITS, late_limit=1_000_000).settings())
        self.share = 1.0 - np.exp(-T / self.lag_s) if self.lag_s else 1.0
        self.set_point = self.q = np.array(START)
        self.ipoc, self.delay, self.behind, self.deaf, self.ended = 1000, 0, 0.0, False, False
        self.path: list[np.ndarray] = []
        self.given: list[bool] = []
        self.woken = 0  # the cycle of the first answer that was carried out
        self.overtaken = b""  # a telegram that arrives after the next one

    def cycle(self, event: str = "good", jump_deg: float = 0.0) -> None:
        """counted: the controller takes the answer, and counts it as late all the same."""
        self.ipoc += 4 if event != "restarted" else 40_000
        self.behind = 6.0 * T if event == "burst" else max(0.0, self.behind - T)
        answer = None
        now, telegram, before = self.ipoc * 1e-3 + self.behind, self._telegram(jump_deg), self.overtaken
        self.overtaken = telegram if event == "swapped" else b""
        if event not in ("lost", "swapped"):
            answer = self.session.reply(telegram, SOURCE, now, event != "late")
            self.session.digest(now)
            for again in filter(None, (before, telegram if event == "repeated" else b"")):
                second = self.session.reply(again, SOURCE, now)
                assert second is None or not self.session.connected, "a telegram was answered twice"
                self.session.digest(now)
        used = answer is not None and event in ("good", "burst", "counted", "repeated") and self.behind < 0.9 * T and not self.ended
        self.delay += (not used or event == "counted") and not self.ended
        correction = _AXES.findall(answer or b"")  # none: the controller keeps what it has
        if used and answer is not None and not self.deaf:
            self.woken = self.woken or len(self.path)
            self.ended = b"<Stop>1<" in answer
            if not self.ended and correction:
                self.set_point = np.array([float(v) for v in correction]) + (self.set_point if self.relative else START)
        self.path.append(self.set_point)
        self.given.append(used and bool(correction))
        self.q = self.q + self.share * (self.set_point - self.q)

    def _telegram(self, jump_deg: float) -> bytes:
        shown = self.q + self.noise_deg * self.rng.standard_normal(6)
        shown[0] += jump_deg
        axes = " ".join(f'A{i + 1}="{v:.{self.decimals}f}"' for i, v in enumerate(shown))
        return f'<Rob Type="KUKA"><AIPos {axes}/><Delay D="{self.delay}"/><IPOC>{self.ipoc}</IPOC></Rob>'.encode()

    def connect(self) -> None:
        while not self.session.connected and self.shared.fault() is None:
            self.cycle()

    def move(self) -> None:
        target = self.rng.uniform(*np.array(LIMITS).T)
        self.shared.send(RsiCommand(MOVE, tuple(target), (SPEED,) * 6, (ACCELERATION,) * 6, (JERK,) * 6, 0.01, 0.1))


@dataclass(frozen=True)
class Found:
    """speed, acceleration, jerk: largest, in shares of their limits, but for what a hold is by itself; disturbances: how many; after:
    largest step (deg) once the arm must stand; travel: largest way (deg) of an arm whose controller adds up; fault: kind of it, or ''."""

    speed: float
    acceleration: float
    jerk: float
    disturbances: int
    after: float
    travel: float
    fault: str


def drive(seed: int, number: int) -> Found:
    """One motion of one controller."""
    rng = np.random.default_rng([seed, number])
    group, arm = number % len(GROUPS), number // len(GROUPS) % len(ARMS)
    relative, asleep = GROUPS[group] in (RELATIVE, HIDDEN), GROUPS[group] in (AWAKENING, HIDDEN)
    lag_s, noise_deg = ARMS[arm]
    one = Controller(relative, SLOW if relative and lag_s else lag_s, noise_deg, rng)
    awake_at = int(rng.integers(0, 200)) if asleep else 0
    try:
        one.deaf = asleep  # RSI_MOVECORR is not reached yet when it is probed
        one.connect()
        one.deaf = awake_at > 0
        if one.shared.fault() is None:
            one.move()
        begin, still_from = len(one.path), CYCLES
        stop_at, turn_at = rng.integers(20, CYCLES - QUIET), rng.integers(20, CYCLES)
        jump_at = rng.integers(20, CYCLES) if rng.random() < JUMPS else -1
        disturbed, disturbances = DISTURBED[number // (len(GROUPS) * len(ARMS)) % len(DISTURBED)], 0
        for cycle in range(CYCLES):
            one.deaf = cycle < awake_at
            if cycle == turn_at and turn_at < stop_at:
                one.move()
            elif cycle == stop_at:
                one.shared.send(RsiCommand(STOP))
                still_from = min(still_from, cycle + QUIET)
            event = str(rng.choice(EVENTS, p=SHARES)) if not one.behind and rng.random() < disturbed else "good"
            disturbances += event != "good"
            one.cycle(event, 30.0 if cycle == jump_at else 0.0)
            if (fault := one.shared.fault()) is not None:
                still_from = min(still_from, cycle + (1 if fault["kind"] in AT_ONCE else QUIET))
        fault = one.shared.fault()
    finally:
        one.shared.close()
    path, given = np.array(one.path), np.array(one.given)
    after = float(np.abs(np.diff(path[begin + still_from :], axis=0)).max(initial=0.0))
    steps, changes = np.abs(np.diff(path, axis=0)), np.abs(np.diff(path, 2, axis=0)).max(axis=1)
    speed = (steps.max() - 2 * ROUNDING_DEG) / (SPEED * T)
    acceleration = (changes[given[2:]].max(initial=0.0) - 4 * ROUNDING_DEG) / (ACCELERATION * T**2)
    smooth = given[3:] & given[2:-1] & given[1:-2] & given[:-3]
    if asleep and not relative:
        smooth[: one.woken] = False  # it wakes where the proof's correction is: a step of 0.006 deg, of its own doing
    jerk = (np.abs(np.diff(path, 3, axis=0)).max(axis=1)[smooth].max(initial=0.0) - 8 * ROUNDING_DEG) / (JERK * T**3)
    travel = float(np.abs(path - START).max()) if relative else 0.0
    return Found(float(speed), float(acceleration), float(jerk), disturbances, after, travel, fault["kind"] if fault else "")


PROOF_LAGS_S = (0.0, 0.02, 0.05, 0.1, 0.15)
PROOF_TELEGRAMS = ((0.0, 6), (0.0003, 6), (0.001, 4), (0.0, 2))  # noise, deg; decimals
PROOF_MOST = 2000  # cycles


def proof_cycles(lag_s: float, noise_deg: float, decimals: int, asleep: bool, seed: int) -> int | None:
    """Cycles from the request of the first motion to its first set point (first axis: no proof moves it); None where there is none.
    asleep: the controller carries nothing out before the motion is asked for."""
    one = Controller(False, lag_s, noise_deg, np.random.default_rng(seed), decimals)
    try:
        one.deaf = asleep
        one.connect()
        one.deaf = False
        target = np.array(START) + [10.0, 0, 0, 0, 0, 0]
        one.shared.send(RsiCommand(MOVE, tuple(target), (SPEED,) * 6, (ACCELERATION,) * 6, (JERK,) * 6, 0.01, 0.1))
        for cycle in range(PROOF_MOST):
            one.cycle()
            if one.set_point[0] != START[0]:
                return cycle
        return None
    finally:
        one.shared.close()


def proof(given: argparse.Namespace) -> None:
    """What the proof of an absolute correction costs before the first motion."""
    for noise_deg, decimals in PROOF_TELEGRAMS:
        for lag_s in PROOF_LAGS_S:
            row = [f"{noise_deg:g} deg, {decimals} decimals, lag {lag_s * 1e3:.0f} ms:"]
            for asleep in (False, True):
                cycles = [proof_cycles(lag_s, noise_deg, decimals, asleep, seed) for seed in range(given.seeds)]
                begun = [c for c in cycles if c is not None]
                kind = "carried out late" if asleep else "carried out from the first telegram on"
                figure = f"{np.median(begun):.0f} cycles, at most {max(begun)}" if begun else "none"
                row.append(f"{kind} {figure}" + (f" ({len(begun)} of {given.seeds} began)" if len(begun) < given.seeds else ""))
            print(*row, sep="; ")


def report(found: list[Found], what: str) -> bool:
    """Print a row; whether all of it is within the limits."""
    speed, acceleration, jerk, after, travel = (
        max(getattr(f, n) for f in found) for n in ("speed", "acceleration", "jerk", "after", "travel")
    )
    kinds = {kind: sum(f.fault == kind for f in found) for kind in sorted({f.fault for f in found} - {""})}
    way = f", furthest {travel:.2f} deg" if travel else ""
    disturbances = sum(f.disturbances for f in found)
    print(
        f"{what}: {len(found)} motions, {disturbances} disturbances, speed {speed:.4f}, acceleration {acceleration:.4f}, jerk {jerk:.4f}, "
        f"after {after:.1e} deg{way}; faults {kinds}",
        flush=True,
    )
    return after == 0.0 and (travel > 0.0 or max(speed, acceleration, jerk) <= 1.001)


def path(given: argparse.Namespace) -> int:
    """Every set point that a controller is given, on the path that it saw, against the limits of its motion, in simulated time.

    Motions with lost, repeated and overtaken telegrams, lost and late answers, answers that are counted as late although they were taken,
    telegrams that come in a burst, restarts, angles that jump, stops and turns; none may move after a stop. Arms are ideal, lag, or lag and
    hum. Every tenth controller adds up its corrections (#RELATIVE), every second of these only once it was probed: it carries corrections
    out from some moment on before or after its first motion was asked for. So does every twentieth absolute one.
    """
    found = [drive(given.seed, k) for k in range(given.motions)]
    sound = True
    for group in dict.fromkeys(GROUPS):
        for arm, name in enumerate(NAMES):
            some = [f for k, f in enumerate(found) if GROUPS[k % len(GROUPS)] == group and k // len(GROUPS) % len(ARMS) == arm]
            sound = (not some or report(some, f"{group}, {name}")) and sound
    return int(not sound)

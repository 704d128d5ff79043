"""Every fault at every message: how a driver ends a small piece of work when one message is lost, late, cut, doubled or nonsense."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

from mbcacq.conformance.bounded import Hang, bounded, outcome
from mbcacq.conformance.driver_bench import DriverBench, Stand
from mbcacq.conformance.faults import ACTIONS, DEVICE, DRIVER, Sender
from mbcacq.conformance.steps import comes_back, rests

_CALM_S = 0.05  # a fault at the very last message takes effect after the work
RECOVERED, NAMED, UNREACHED = "recovered", "named error", "not reached"


@dataclass(frozen=True)
class Case:
    link: str
    sender: Sender
    index: int
    action: str

    def __str__(self) -> str:
        return f"{self.action} of message {self.index} from the {self.sender} on '{self.link}'"


@dataclass(frozen=True)
class InjectionVerdict:
    """result: RECOVERED, NAMED, UNREACHED (the message never came), or what is wrong: 'hang', 'wrong', 'not at rest', 'stays broken'."""

    case: Case
    result: str
    detail: str = ""
    seconds: float = 0.0

    @property
    def good(self) -> bool:
        return self.result in (RECOVERED, NAMED, UNREACHED)


def survey(bench: DriverBench) -> dict[tuple[str, Sender], int]:
    """Messages by (link, sender) of the undisturbed work. Raises what the work raises."""
    with bench.open() as stand:
        _work(stand)
        return {(name, sender): proxy.channel.count[sender] for name, proxy in stand.proxies.items() for sender in (DEVICE, DRIVER)}


def cases(counts: dict[tuple[str, Sender], int], most: int = 24, actions: tuple[str, ...] = ACTIONS) -> Iterator[Case]:
    """All messages of a link and sender, or ``most`` of them: the first half one by one, the rest spread over what follows."""
    for (link, sender), count in sorted(counts.items()):
        indices = list(range(min(count, most)))
        if count > most:
            first = most // 2
            step = (count - 1 - first) / max(most - first - 1, 1)
            indices = [*range(first), *sorted({first + round(k * step) for k in range(most - first)})]
        for index in indices:
            for action in actions:
                yield Case(link, sender, index, action)


def inject(bench: DriverBench, case: Case, delay_s: float = 1.0, *, waiting: bool = True, seed: int = 0) -> InjectionVerdict:
    """Connect, use twice, close, with that one fault; then look whether the device rests and the next driver works.

    waiting: the driver is given its short time limits, because it waits in vain. A fault that costs no waiting runs with the ordinary
    limits, so that a busy computer adds no error of its own. seed: of garbage, and of the bit that is flipped.
    """
    began = time.monotonic()

    def verdict(result: str, detail: str = "") -> InjectionVerdict:
        return InjectionVerdict(case, result, detail, time.monotonic() - began)

    with bench.open() as stand:
        proxy = stand.proxies[case.link]
        proxy.channel.set(case.action, case.sender, index=case.index, seconds=delay_s, seed=seed)
        try:
            error = outcome(str(case), lambda: _work(stand, **(stand.short_limits if waiting else {})), 3 * bench.limit_s)
        except Hang as hang:
            return verdict("hang", str(hang))
        except AssertionError as wrong:
            return verdict("wrong", str(wrong))
        struck = proxy.channel.struck
        proxy.channel.heal()
        try:
            time.sleep(_CALM_S)
            comes_back(bench, stand)
            rests(bench, stand)
        except AssertionError as moving:
            return verdict("not at rest", str(moving))
        try:
            bounded("the next work", lambda: _work(stand), 3 * bench.limit_s)
        except BaseException as broken:
            return verdict("stays broken", f"{type(broken).__name__}: {broken}")
    if error is not None:
        return verdict(NAMED, f"{type(error).__name__}: {error}")
    return verdict(RECOVERED if struck else UNREACHED)


def _work(stand: Stand, **options: object) -> None:
    driver = stand.make(**options)
    try:
        driver.connect()
        for _ in range(2):
            stand.use(driver)
    finally:
        driver.close()

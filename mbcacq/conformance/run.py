"""Run the checks on a bench."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

from mbcacq.conformance.checks import CHECKS, Check
from mbcacq.conformance.driver_bench import DriverBench
from mbcacq.conformance.steps import Skip

PASSED, FAILED, SKIPPED = "passed", "failed", "skipped"


@dataclass(frozen=True)
class CheckResult:
    bench: str
    check: str
    status: str
    detail: str = ""
    seconds: float = 0.0

    def __str__(self) -> str:
        return f"{self.bench}: {self.check.replace('_', ' ')}: {self.status}" + (f" ({self.detail})" if self.detail else "")


def run(bench: DriverBench, checks: tuple[Check, ...] = CHECKS) -> Iterator[CheckResult]:
    """One result a check, each on a stand of its own."""
    for each in checks:
        yield check(bench, each)


def check(bench: DriverBench, each: Check) -> CheckResult:
    """One check. Never raises what the driver did wrong."""
    name, began = each.__name__, time.monotonic()
    if name in bench.excused:
        return CheckResult(bench.name, name, SKIPPED, bench.excused[name])
    try:
        with bench.open() as stand:
            each(bench, stand)
    except Skip as reason:
        return CheckResult(bench.name, name, SKIPPED, str(reason), time.monotonic() - began)
    except Exception as error:
        detail = str(error) if isinstance(error, AssertionError) else f"{type(error).__name__}: {error}"
        return CheckResult(bench.name, name, FAILED, detail, time.monotonic() - began)
    return CheckResult(bench.name, name, PASSED, "", time.monotonic() - began)

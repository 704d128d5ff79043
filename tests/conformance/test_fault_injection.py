"""One faulty message each: a selection of what benchmarks/faults.py messages does at every step of every driver."""

from __future__ import annotations

import pytest
from benches import BENCHES, marked

from mbcacq.conformance import Case, cases, inject
from mbcacq.conformance.injection import NAMED, RECOVERED

CHOSEN = [
    ("gocator", Case("control", "device", 3, "garbage"), {NAMED}),
    ("gocator", Case("data", "device", 1, "duplicate"), {RECOVERED}),
    ("gocator", Case("data", "device", 0, "drop"), {NAMED}),
    ("gocator", Case("data", "device", 3, "close"), {NAMED}),
    ("gocator", Case("control", "driver", 7, "truncate"), {NAMED}),
    ("gocator", Case("health", "device", 0, "garbage"), {RECOVERED}),
    ("gocator trigger", Case("control", "device", 12, "duplicate"), {NAMED, RECOVERED}),
    ("gocator trigger", Case("data", "device", 1, "drop"), {NAMED}),
    ("gopxl", Case("control", "device", 5, "garbage"), {NAMED}),
    ("gopxl", Case("control", "device", 7, "duplicate"), {NAMED}),
    ("gopxl", Case("control", "driver", 9, "truncate"), {NAMED}),
    ("gopxl", Case("data", "device", 0, "drop"), {NAMED}),
    ("gopxl", Case("data", "device", 1, "duplicate"), {RECOVERED}),
    ("gopxl", Case("data", "device", 2, "close"), {NAMED}),
    ("kuka_rsi", Case("rsi", "device", 40, "duplicate"), {RECOVERED}),
    ("kuka_rsi", Case("rsi", "device", 40, "garbage"), {NAMED, RECOVERED}),  # recovered where the datagram was one that is repeated
    ("kuka_rsi", Case("rsi", "driver", 30, "drop"), {NAMED, RECOVERED}),
    ("kuka_rsi", Case("rsi", "device", 30, "delay"), {NAMED, RECOVERED}),
    ("kuka_eki", Case("eki", "device", 5, "close"), {NAMED, RECOVERED}),
    ("kuka_eki", Case("eki", "device", 6, "truncate"), {NAMED, RECOVERED}),
    ("opcua", Case("opcua", "device", 30, "close"), {NAMED}),
    ("opcua", Case("opcua", "device", 30, "garbage"), {NAMED}),
    ("modbus positioner", Case("modbus", "device", 3, "truncate"), {NAMED, RECOVERED}),
    ("modbus positioner", Case("modbus", "driver", 1, "close"), {NAMED}),  # an order, that may have begun to move something
    ("modbus positioner", Case("modbus", "driver", 2, "close"), {RECOVERED}),  # a question
    ("serial positioner", Case("line", "device", 2, "delay"), {NAMED}),
    ("serial positioner", Case("line", "driver", 1, "garbage"), {NAMED}),
    ("serial sensor pty", Case("line", "device", 1, "duplicate"), {RECOVERED}),
    ("serial sensor pty", Case("line", "device", 1, "close"), {NAMED, RECOVERED}),  # opened again, where the far end takes it back
]


@pytest.mark.parametrize(
    ("name", "case", "expected"),
    [marked(*each) for each in CHOSEN],
    ids=lambda value: str(value).replace(" ", "-") if not isinstance(value, set) else "",
)
def test_one_faulty_message_is_recovered_or_a_named_error(name, case, expected):
    verdict = inject(BENCHES[name], case, waiting=expected != {RECOVERED})
    assert verdict.result in expected, f"{case}: {verdict.result}: {verdict.detail}"


def test_cases_reach_from_the_first_message_to_the_last():
    counts = {("line", "device"): 100, ("line", "driver"): 3}
    made = list(cases(counts, most=8, actions=("drop",)))
    assert [c.index for c in made if c.sender == "device"] == [0, 1, 2, 3, 4, 36, 67, 99]
    assert [c.index for c in made if c.sender == "driver"] == [0, 1, 2]
    assert len(list(cases(counts, most=8))) == 6 * 11

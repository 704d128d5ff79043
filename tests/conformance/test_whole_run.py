"""One faulty message in a whole run: a good end or a named error, a readable recording, and never a wrong centre in it."""

from __future__ import annotations

import pytest
from whole_run import WholeRun

from mbcacq.conformance import Case


@pytest.fixture(scope="module")
def run():
    made = WholeRun()
    yield made
    made.close()


@pytest.mark.timeout(600)
@pytest.mark.parametrize("case", [Case("data", "device", 5, "close"), Case("rsi", "device", 300, "garbage")], ids=str)
def test_one_faulty_message_is_recovered_or_a_named_error(run, case):
    verdict = run.inject(case)
    assert verdict.good, f"{case}: {verdict.result}: {verdict.detail}"
    assert verdict.result != "not reached"

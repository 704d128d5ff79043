"""Every driver of ours passes every check, and the suite finds drivers that should not."""

from __future__ import annotations

import pytest
from benches import BENCHES, marked

from mbcacq.conformance import CHECKS, check
from mbcacq.conformance.checks import a_changed_fact_is_seen
from mbcacq.devices import available

NO_LINE = {
    "silence_is_an_error_in_time",
    "garbage_is_survived",
    "half_a_message_is_survived",
    "an_end_in_mid_frame_is_survived",
    "two_messages_in_one_segment_are_two",
    "a_message_byte_by_byte_is_one",
    "refuses_the_wrong_device",
    "names_an_absent_device",
    "refuses_to_work_unconnected",
}
SKIPPED = {
    "manual": NO_LINE,
    "ur_rtde": {"refuses_the_wrong_device"},
    "opcua": {"stop_ends_what_is_under_way"},
    "folder": {"refuses_the_wrong_device"},
    "simulated": (NO_LINE - {"refuses_to_work_unconnected"}) | {"refuses_an_unknown_option"},
    "simulated scanner": (NO_LINE - {"refuses_to_work_unconnected"}) | {"refuses_an_unknown_option"},
    "serial sensor pty": {"stop_ends_what_is_under_way"},
}
QUICK = {
    "manual",
    "ur_rtde",
    "folder",
    "simulated",
    "simulated scanner",
    "gocator",
    "gopxl profiles",
    "kuka_eki",
    "modbus positioner",
    "opcua",
    "serial sensor pty",
}


SWITCHES = {"kuka_rsi", "kuka_eki", "ur_rtde"}
REPORTS_FACTS = {
    *("ur_rtde", "opcua", "kuka_eki", "kuka_rsi", "gocator", "gopxl", "gocator profiles", "gopxl profiles"),
    *("modbus positioner", "serial positioner", "modbus sensor", "serial sensor", "folder"),
}
REPORTS_NONE = {"manual", "simulated", "simulated scanner"}


OTHERS = [check for check in CHECKS if check is not a_changed_fact_is_seen]


@pytest.mark.parametrize("name", [marked(name) for name in sorted(REPORTS_FACTS | REPORTS_NONE)])
def test_every_fact_of_a_driver_is_watched(name):
    result = check(BENCHES[name], a_changed_fact_is_seen)
    assert result.status == ("skipped" if name in REPORTS_NONE else "passed"), str(result)


@pytest.mark.parametrize("each", OTHERS, ids=lambda each: each.__name__)
@pytest.mark.parametrize("name", [marked(name) for name in sorted(QUICK)])
def test_a_driver_passes_the_check(name, each):
    result = check(BENCHES[name], each)
    no_outputs = each.__name__ == "an_output_that_is_on_goes_off" and name not in SWITCHES
    assert result.status == ("skipped" if no_outputs or each.__name__ in SKIPPED.get(name, ()) else "passed"), str(result)


def test_every_driver_that_is_installed_has_a_bench():
    made = {name.split()[0] for name in BENCHES}
    for kind in ("robots", "scanners", "positioners", "sensors"):
        ours = {name for name, target in available(kind).items() if target.startswith("mbcacq_")}
        assert ours <= made, ours - made

"""What the first telegrams of a session tell: where the arm stands without a correction."""

import pytest
from mbcacq_kuka.rsi.handshake import Handshake, SessionFault
from mbcacq_kuka.rsi.sequence import Counts
from mbcacq_kuka.rsi.telegram import Composer

SETTINGS = {
    "sen_type": "ImFree",
    "correction": "AK",
    "stop_element": "Stop",
    "controller_ip": "",
    "cycle_ms": 4,
    "check_set_point": True,
    "digital_outputs": (),
}


def telegram(actual, planned, ipoc=b"1000"):
    elements = b"".join(
        b"<%s %s/>" % (name, b" ".join(b'A%d="%.4f"' % (k + 1, v) for k, v in enumerate(values)))
        for name, values in ((b"AIPos", actual), (b"ASPos", planned))
    )
    return b'<Rob Type="KUKA">' + elements + b'<Delay D="0"/><IPOC>' + ipoc + b"</IPOC></Rob>"


def shaken(actual, planned, **settings):
    handshake = Handshake(Composer("ImFree", "AK", "Stop"), {**SETTINGS, **settings}, Counts())
    handshake.take(telegram(actual, planned), ("127.0.0.1", 1), 0.0)
    assert handshake.layout is not None
    return handshake.layout.reference


def test_the_arm_without_correction_stands_at_aspos_though_a_small_one_is_still_applied():
    """An earlier session moved A1 by 0.04 deg, and its program was not restarted: a correction of zero takes the arm back by that."""
    assert shaken((0.04, -90, 90, 0, 0, 0), (0, -90, 90, 0, 0, 0)) == (0, -90, 90, 0, 0, 0)


def test_a_controller_that_does_not_report_aspos_properly_is_taken_at_its_actual_angles():
    assert shaken((0.04, -90, 90, 0, 0, 0), (5, 0, 0, 0, 0, 0), check_set_point=False) == (0.04, -90, 90, 0, 0, 0)


def test_a_large_correction_that_is_still_applied_is_refused():
    with pytest.raises(SessionFault, match="AIPos and ASPos differ by 0.20°"):
        shaken((0.2, -90, 90, 0, 0, 0), (0, -90, 90, 0, 0, 0))

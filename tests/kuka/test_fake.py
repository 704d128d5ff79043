"""The fake controller, seen by a client of a few lines: it speaks first, answers nothing, and is as unforgiving as a real one."""

import re
import socket

import numpy as np
import pytest
from kuka_bench import HOME_DEG, LIMITS_DEG, wait
from mbcacq_fakes.protocols.krc.server import FakeKrc
from mbcacq_fakes.protocols.krc.settings import KrcSettings

IPOC = re.compile(rb"<IPOC>(\d+)</IPOC>")
DELAY = re.compile(rb'<Delay D="(\d+)"')


class Client:
    """Answers telegrams by hand."""

    def __init__(self):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(60.0)
        self.address = self.socket.getsockname()
        self.last = None

    def receive(self):
        data, self.peer = self.socket.recvfrom(65536)
        self.last = data, int(IPOC.search(data)[1]), int(DELAY.search(data)[1])
        return self.last

    def newest(self):
        """The telegram that is being waited for now."""
        data = self.receive()
        self.socket.setblocking(False)
        try:
            while True:
                data = self.receive()
        except BlockingIOError:
            return data
        finally:
            self.socket.settimeout(60.0)

    def answer(self, body=b"", ipoc=None, sen=b"ImFree"):
        ipoc = self.last[1] if ipoc is None else ipoc
        self.socket.sendto(b'<Sen Type="%b">%b<IPOC>%d</IPOC></Sen>' % (sen, body, ipoc), self.peer)

    def begin(self, krc):
        """Answer until the controller has taken an answer: an offer is past a few milliseconds after it was sent."""

        def taken():
            self.newest()
            self.answer()
            try:
                return wait(lambda: krc.report()["active"], 0.1)
            except AssertionError:
                return False

        wait(taken)

    def exchange(self, body=b"", **given):
        """Wait for a telegram and answer it."""
        data = self.receive()
        self.answer(body, **given)
        return data


def axis(data, name=b"A1", element=b"AIPos"):
    return float(re.search(b"<" + element + rb"[^>]*?\b" + name + b'="([^"]*)"', data)[1])


def ak(a1):
    return b'<AK A1="%.6f" A2="0" A3="0" A4="0" A5="0" A6="0"/>' % a1


@pytest.fixture
def start():
    opened = []

    def start(**settings):
        client = Client()
        krc = FakeKrc(  # its arm stands still to the last digit, so that bytes can be stated
            **{
                "client": client.address,
                "realtime": False,
                "start_deg": tuple(HOME_DEG),
                "limits_deg": LIMITS_DEG,
                "encoder_noise_deg": 0.0,
                "encoder_step_deg": 0.0,
                **settings,
            }
        ).start()
        opened.extend([krc.stop, client.socket.close])
        return krc, client

    yield start
    for close in opened:
        close()


def test_it_speaks_first_and_keeps_offering_without_counting(start):
    krc, client = start(timeout=5)
    telegrams = [client.receive() for _ in range(40)]
    assert {b - a for a, b in zip([t[1] for t in telegrams], [t[1] for t in telegrams][1:], strict=False)} == {4}
    assert {t[2] for t in telegrams} == {0}
    assert krc.report()["late"] == 0


def test_the_compact_telegram_to_the_byte(start):
    krc, client = start(layout="sdk", precision=4, ipoc=4208163630, start_deg=(0.5, -90.0, 90.0, 0.0, -1.25, 0.0))
    zeros = b'%b="0.0000" %b="0.0000" %b="0.0000" %b="0.0000" %b="0.0000" %b="0.0000"/>'
    assert client.receive()[0] == (
        b'<Rob Type="KUKA"><RIst '
        + zeros % (b"X", b"Y", b"Z", b"A", b"B", b"C")
        + b'<AIPos A1="0.5000" A2="-90.0000" A3="90.0000" A4="0.0000" A5="-1.2500" A6="0.0000"/>'
        + b"<EIPos "
        + zeros % (b"E1", b"E2", b"E3", b"E4", b"E5", b"E6")
        + b'<Delay D="0"/><IPOC>4208163634</IPOC></Rob>'
    )


def test_quirks_of_spacing(start):
    krc, client = start(layout=("AIPos", "Delay"), precision=1, faults={"spaced": 1, "upper_type": 1, "swap": 1})
    assert re.fullmatch(
        rb'<Rob TYPE="KUKA">\r\n<Delay D="0" />\r\n<AIPos A1="0.0" A2="-90.0" A3="90.0" A4="0.0" A5="0.0" A6="0.0" />\r\n'
        rb"<IPOC>\d+</IPOC>\r\n</Rob>",
        client.receive()[0],
    )


def test_corrections_are_absolute_and_move_aipos_but_not_aspos(start):
    krc, client = start()
    client.begin(krc)
    for i in range(60):
        data = client.exchange(ak(min(0.02 * i, 1.0)))[0]
    assert axis(data) == pytest.approx(1.0, abs=0.02)
    assert axis(data, element=b"ASPos") == 0.0
    wait(lambda: client.exchange(ak(1.0)) and krc.state.read().standstill)
    assert np.degrees(krc.state.read().q[0]) == pytest.approx(1.0, abs=1e-5)
    assert krc.state.read().arrivals == 1
    assert krc.state.read().direction == (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("wrong", [{"ipoc": 1}, {"sen": b"Other"}, {"body": b'<AK A1="x"/>'}, {"body": b"<!DOCTYPE a>"}])
def test_wrong_answers_are_thrown_away_silently_and_delay_rises(start, wrong):
    krc, client = start()
    client.begin(krc)
    before = client.exchange()[2]
    for _ in range(5):
        client.exchange(**wrong)
    data, _, delay = client.exchange()
    assert (before, delay) == (0, 5)
    assert axis(data) == 0.0


def test_the_ipoc_plus_cycle_myth_is_rejected(start):
    krc, client = start()
    client.begin(krc)
    for _ in range(3):
        client.receive()
        client.answer(ipoc=client.last[1] + 4)
    assert client.receive()[2] == 3


@pytest.mark.parametrize(("counting", "ends"), [("total", True), ("consecutive", False)])
def test_late_packets_counted_in_total_or_in_a_row(start, counting, ends):
    krc, client = start(timeout=6, counting=counting, rearm_s=0.1)
    client.begin(krc)
    for i in range(60):
        client.exchange(**({"ipoc": 1} if i % 3 == 2 else {}))
        if krc.report()["sessions"] > 1:
            break
    assert (wait(lambda: krc.report()["late"] >= 6 and krc.report())["sessions"] > 1) is ends


def test_a_missing_value_holds_or_falls_to_zero(start):
    for hold_on, expected in ((True, 0.3), (False, 0.0)):
        krc, client = start(hold_on=hold_on)
        client.begin(krc)
        for _ in range(80):
            client.exchange(ak(0.3))
        for _ in range(80):
            data = client.exchange(b"<Stop>0</Stop>")[0]
        assert axis(data) == pytest.approx(expected, abs=1e-3)


def test_the_correction_is_clamped_silently(start):
    krc, client = start(clamp_deg=0.5)
    client.begin(krc)
    for i in range(200):
        data, _, delay = client.exchange(ak(0.01 * i))
    assert (axis(data), delay) == (pytest.approx(0.5, abs=1e-5), 0)
    assert krc.report()["ended"] == 0


@pytest.mark.parametrize(
    ("settings", "bodies", "fault"),
    [
        ({"monitor_deg": 0.5}, [ak(0.01 * i) for i in range(100)], "permissible overall correction exceeded"),
        ({}, [ak(0.0), ak(2.0)], "overspeed: command velocity"),
    ],
)
def test_the_controller_stops_by_itself(start, settings, bodies, fault):
    krc, client = start(**settings, rearm_s=0.2)
    client.begin(krc)
    for body in bodies:
        client.exchange(body)
        if krc.state.read().fault:
            break
    assert wait(lambda: krc.state.read().fault) == fault
    wait(lambda: krc.report()["sessions"] >= 2)
    data, _, delay = client.receive()  # offered again, with a new start
    assert (axis(data), delay) == (axis(data, element=b"ASPos"), 0)


def test_stop_ends_the_session(start):
    krc, client = start()
    client.begin(krc)
    client.exchange(b"<Stop>1</Stop>")
    wait(lambda: krc.report()["sessions"] >= 2)
    assert krc.state.read().fault == ""


def test_multi_line_answers_in_any_order_are_taken(start):
    krc, client = start()
    client.begin(krc)
    for _ in range(60):
        _, ipoc, _ = client.receive()
        client.socket.sendto(
            b"<Sen Type='ImFree'>\r\n <IPOC>%d</IPOC>\r\n <EStr>x</EStr>\r\n <AK A6='0' A1 = '0.25' />\r\n</Sen>\r\n\0" % ipoc, client.peer
        )
    assert axis(client.receive()[0]) == pytest.approx(0.25, abs=1e-5)


def test_the_pose_of_a_kr210(start):
    """X 1765, Z 1910 at A = (0, -90, 90, 0, 0, 0); A1 turns clockwise seen from above."""
    a1, c1, c2, c3, high, c4 = 330.0, 645.0, 1150.0, 1220.0, 115.0, 215.0
    dh = (
        (-1, 0, c1, a1, -90, 0),
        (1, 0, 0, c2, 0, 0),
        (1, -90, 0, high, 90, 0),
        (1, 0, -c3, 0, -90, 0),
        (1, 0, 0, 0, 90, 0),
        (1, 0, -c4, 0, 0, 180),
    )
    krc, client = start(dh=dh)
    data = client.receive()[0]
    assert [axis(data, n, b"RIst") for n in (b"X", b"Y", b"Z")] == pytest.approx([a1 + c3 + c4, 0.0, c1 + c2 + high], abs=1e-6)
    krc, client = start(dh=dh, start_deg=(90.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    data = client.receive()[0]
    assert [axis(data, n, b"RIst") for n in (b"X", b"Y", b"Z")] == pytest.approx([0.0, -(a1 + c2 + c3 + c4), c1 + high], abs=1e-6)


def test_by_the_clock_a_cycle_is_answered_or_missed(start):
    krc, client = start(realtime=True, stretch=50.0, timeout=1_000_000)  # 0.2 s a cycle: a busy machine is in time, too
    client.exchange()
    client.exchange()
    first = client.exchange()[1]
    for _ in range(4):
        client.receive()
    assert client.last[1] - first == 16
    wait(lambda: client.newest()[2] >= 3)


@pytest.mark.parametrize(
    "wrong",
    [{"layout": "other"}, {"layout": ("AIPos", "Xyz")}, {"counting": "sum"}, {"cycle_ms": 8}, {"precision": 0}, {"faults": {"silent": 1}}],
)
def test_wrong_settings_are_refused(wrong):
    with pytest.raises(ValueError, match=r"layout|counting|cycle_ms|faults"):
        FakeKrc(**wrong)


def test_unknown_faults_are_refused(start):
    krc, _ = start()
    with pytest.raises(ValueError, match="unknown faults"):
        krc.inject(silent=1)


def test_an_arm_at_rest_hums_as_encoders_do_unless_told_otherwise(start):
    known = KrcSettings()
    krc, client = start(encoder_noise_deg=known.encoder_noise_deg, encoder_step_deg=known.encoder_step_deg)
    shown = np.array([axis(client.receive()[0]) for _ in range(400)])
    assert 1e-4 < shown.std() < 5e-4
    np.testing.assert_allclose(shown / 5e-5, np.rint(shown / 5e-5), atol=0.02)
    assert len(np.unique(shown)) > 5

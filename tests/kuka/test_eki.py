"""EKI: where telegrams end, and what the controller answers."""

import socket
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mbcacq_fakes.cell.ports import free_port
from mbcacq_fakes.protocols.krc.eki import FakeEki
from mbcacq_kuka.eki import EkiClient
from mbcacq_kuka.eki.framing import MAX_TELEGRAM, Cutter, FramingError

from mbcacq.devices import ConnectError, DeviceFault, DeviceTimeout, ProtocolError

STATUS = b'<Robot><Status ControlMode="1" CycleTime="1" DrivesPowered="0"></Status></Robot>'
EVENT = b'<Robot><Response EventID="3"> </Response></Robot >'
EMPTY = b'<Robot A="1" />'


@given(
    st.lists(st.sampled_from([STATUS, EVENT, EMPTY]), max_size=5),
    st.sampled_from([b"", b"\n", b"\n\0\0\0", b"x > y", b"</Robot>", b"<Rob"]),
    st.integers(1, 200),
)
def test_telegrams_are_the_same_however_the_stream_is_cut(telegrams, junk, size):
    stream = junk + b"".join(t + junk for t in telegrams)
    cutter = Cutter("Robot")
    found = [t for i in range(0, len(stream), size) for t in cutter.feed(stream[i : i + size])]
    assert found == telegrams


def test_a_name_that_only_begins_like_the_root_is_junk():
    assert Cutter("Robot").feed(b"<RobotState a='1'></RobotState>" + EVENT) == [EVENT]


def test_endless_telegrams_and_declarations_are_refused():
    cutter = Cutter("Robot")
    assert cutter.feed(b"<Robot>" + b" " * (MAX_TELEGRAM - 7)) == []
    with pytest.raises(FramingError, match="longer"):
        cutter.feed(b" and no end")
    with pytest.raises(FramingError, match="declaration"):
        Cutter("Robot").feed(b"<Robot><!DOCTYPE x></Robot>")


@pytest.mark.parametrize("answer", ["plain", "merged", "split", "junk"])
def test_a_session(answer):
    started = []
    with (
        FakeEki(answer=answer, pause_s=0.0, on_start=lambda *a: started.append(a)) as server,
        EkiClient("127.0.0.1", server.port) as client,
    ):
        assert (client.identity.model, client.identity.axes) == ("#KR16R2010_2 C4 FLR", 6)
        client.choose_joint_position()
        with pytest.raises(DeviceFault, match="answered start with 'error': drives are off"):
            client.start()
        client.drives_on()
        client.choose_cycle(4)
        client.start()
        client.reset()
        client.start()
        client.cancel()
        assert (client.status.control_mode, client.status.cycle_time, client.status.emergency_stop) == (0, 1, False)
    assert started == [(1, 1), (1, 1)]
    assert [r[0] for r in server.requests] == [0, 4, 1, 6, 8, 1, 2, 1, 3]


def refused(request):
    with pytest.raises(DeviceFault, match="Invalid transition requested"):
        request()


def test_the_server_takes_only_what_its_state_allows():
    with FakeEki(pause_s=0.0) as server, EkiClient("127.0.0.1", server.port) as client:
        for request in (client.start, client.reset, client.cancel):  # nothing was chosen yet
            refused(request)
        client.drives_on()
        refused(client.start)
        client.choose_joint_position()
        refused(client.reset)
        client.start()
        for request in (client.start, client.choose_joint_position, client.drives_on):  # the program runs
            refused(request)
        client.cancel()
        refused(client.start)


def test_without_a_choice_the_cycle_is_twelve_milliseconds_and_a_new_connection_forgets_it():
    started = []
    with FakeEki(pause_s=0.0, on_start=lambda *a: started.append(a)) as server:
        for choose in (True, False):
            with EkiClient("127.0.0.1", server.port) as client:
                client.drives_on()
                if choose:
                    client.choose_cycle(4)
                client.choose_joint_position()
                client.start()
    assert started == [(1, 1), (1, 2)]


def test_the_bytes_of_a_request():
    received = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            connection, _ = server.accept()
            with connection:
                received.append(connection.recv(4096))
                connection.sendall(b'<Robot><Init VER="1" NumAxes="6" NumExternalAxes="0" Model="#KR6" RobVer=""/></Robot>')
                connection.recv(1)

        thread = threading.Thread(target=serve)
        thread.start()
        client = EkiClient("127.0.0.1", server.getsockname()[1])
        assert client.connect().model == "#KR6"
        client.close()
        thread.join()
    assert received == [b'<External REQTYPE="0" ControlMode="-1" CycleTime="-1"></External>']


def test_the_fake_takes_the_padded_writes_of_the_sdk():
    request = b'<External REQTYPE="6" ControlMode="1" CycleTime="1"></External>'
    with FakeEki(pause_s=0.0) as server, socket.create_connection(("127.0.0.1", server.port), 5.0) as client:
        client.sendall((request + b"\n\0").ljust(500, b"\xa5"))
        received = b""
        while b"EventID" not in received:
            received += client.recv(4096)
    assert b'<Response EventID="9">' in received
    assert server.drives


@pytest.mark.parametrize(
    ("reply", "kind"),
    [
        (b"", DeviceTimeout),
        (b"<Robot><Init NumAxes='six'/></Robot>", ProtocolError),
        (b"<Robot><Init></Robot>", ProtocolError),
        (b"<Robot>&lol;</Robot>", ProtocolError),
        (None, ConnectError),
    ],
)
def test_wrong_answers(reply, kind):
    with socket.create_server(("127.0.0.1", 0)) as server:
        client = EkiClient("127.0.0.1", server.getsockname()[1], timeout_s=0.2)

        def serve():
            connection, _ = server.accept()
            with connection:
                connection.recv(4096)
                if reply is not None:
                    connection.sendall(reply)
                    connection.recv(1)

        thread = threading.Thread(target=serve)
        thread.start()
        with pytest.raises(kind):
            client.connect()
        thread.join()


def test_nobody_there():
    port = free_port()
    with pytest.raises(ConnectError, match="cannot be reached"):
        EkiClient("127.0.0.1", port, timeout_s=0.5).connect()
    with pytest.raises(ConnectError, match="call connect first"):
        EkiClient("127.0.0.1", port).drives_on()


class Scripted:
    """An EKI server that sends what the test gives it for each request, e.g. nothing yet, or two answers at once."""

    def __init__(self, *answers):
        self._answers, self.requests = list(answers), []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._listener.close()
        self._thread.join(5)

    def _serve(self):
        cutter = Cutter("External")
        try:
            client, _ = self._listener.accept()
            with client:
                client.sendall(b'<Robot><Init VER="1" NumAxes="6" NumExternalAxes="0" Model="#KR6" RobVer=""/></Robot>')
                while data := client.recv(4096):
                    for telegram in cutter.feed(data):
                        self.requests.append(telegram)
                        if len(self.requests) > 1:
                            client.sendall(
                                b"".join(b'<Robot><Response EventID="%d">x</Response></Robot>' % e for e in self._answers.pop(0))
                            )
        except OSError:
            return


def test_a_late_answer_is_not_taken_for_that_to_the_next_request():
    """The answer to START comes after it was given up, together with that to CANCEL, which must not be taken for refused."""
    started, cancelled, error, drives_on = 0, 2, 4, 9
    with Scripted([], [started, cancelled], [], [error, drives_on]) as server:
        with EkiClient("127.0.0.1", server.port, timeout_s=0.5) as client:
            with pytest.raises(DeviceTimeout):
                client.start()
            client.cancel()
            with pytest.raises(DeviceTimeout):
                client.reset()
            client.drives_on()  # the refusal that comes first was that of RESET


def test_a_connection_that_the_server_closed_meanwhile_is_made_again():
    with FakeEki(pause_s=0.0) as server, EkiClient("127.0.0.1", server.port) as client:
        client.drives_on()
        client._link._socket.shutdown(socket.SHUT_RDWR)
        client.drives_on()
        client._link._socket.shutdown(socket.SHUT_RDWR)
        with pytest.raises(ConnectError):  # what was chosen is forgotten: not started
            client.start()

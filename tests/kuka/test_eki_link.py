"""A connection that has ended is known as such before anything is sent over it, and not before all that waits in it was received."""

import socket
import time

from mbcacq_kuka.eki.link import Link


def test_a_connection_has_ended_once_what_waited_in_it_was_received():
    with socket.create_server(("127.0.0.1", 0)) as listener:
        link = Link("127.0.0.1", listener.getsockname()[1], 5.0)
        far, _ = listener.accept()
        try:
            assert not link.has_ended
            far.sendall(b"<Rob")  # the beginning of a telegram
            far.close()
            assert not link.has_ended
            assert link.telegrams(5.0) == []
            deadline = time.monotonic() + 30.0
            while not link.has_ended and time.monotonic() < deadline:
                pass
            assert link.has_ended
        finally:
            link.close()
    assert link.has_ended

"""The conversation with the controller's program, in a thread of its own: states in, signs of life out, the connection kept."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from mbcacq.devices import ConnectError, DeviceFault, DeviceTimeout, IdentityError, LinkLost, MbcacqError
from mbcacq_kuka.eki import telegrams
from mbcacq_kuka.eki.link import RETRY_S, Link, dial
from mbcacq_kuka.eki.meeting import meet, refuse_moved
from mbcacq_kuka.eki.options import EkiOptions
from mbcacq_kuka.eki.record import Record
from mbcacq_kuka.eki.telegrams import BEAT, STOP, Hello, State
from mbcacq_kuka.eki.watch import Move, Watch

_POLL_S, _FIRST_S = 0.05, 3.0


class EkiSession:
    """From connect to close, over all reconnections. ``check(hello, state)`` raises for a wrong cell. ``error``: what ended it."""

    def __init__(self, name: str, options: EkiOptions, record: Record, check: Callable[[Hello, State], None]) -> None:
        self._name, self._options, self._record, self._check = name, options, record, check
        self._link: Link | None = None
        self._news = threading.Condition()
        self._quit = threading.Event()
        self._thread = threading.Thread(target=self._work, name="kuka-eki", daemon=True)
        self._watch: Watch | None = None
        self._target: tuple[float, ...] | None = None
        self._beaten, self._heard, self._connections, self._first_deadline = -1, 0.0, 0, 0.0
        self._switching, self._switch, self._on = threading.Lock(), 0, set[int]()
        self.error: MbcacqError | None = None
        self.hello: Hello | None = None
        self.state: State | None = None

    def open(self) -> None:
        """Raises ConnectError, IdentityError, DeviceFault, ProtocolError."""
        deadline = time.monotonic() + self._options.connect_timeout_s
        self._first_deadline = time.monotonic() + min(_FIRST_S, self._options.connect_timeout_s)
        self._link = self._dial(self._first_deadline - time.monotonic())
        self._thread.start()
        where = f"robot '{self._name}': the controller at {self._options.address}"
        self._await(
            lambda: self.state is not None,
            min(deadline, time.monotonic() + _FIRST_S),
            f"{where} accepts the connection but tells no state; is our link program in its submit interpreter?",
        )
        if self._options.follow:
            return  # whoever moves the arm may do so already
        while self._watch is None:  # a connection that is lost meanwhile is replaced: who is at the new one?
            self._await(self._complete, deadline, f"{where} does not run its program; select mbcacq_eki on the smartPAD and start it")
            if (hello := self.hello) is None:
                continue
            self._check(hello, self.latest)
            # The arm may still brake because a former connection was lost.
            if not self._wait(lambda: not self.latest.moving, time.monotonic() + _FIRST_S):
                raise DeviceFault(f"{where} is moving the arm already; wait until it stands")
            with self._news:
                if self.hello is hello:
                    self._watch = Watch(self._name, self.latest)

    @property
    def latest(self) -> State:
        """The last state of the controller; there is one from ``open`` on."""
        assert self.state is not None  # open waits for the first one
        return self.state

    @property
    def busy(self) -> bool:
        """A move was begun and not stopped."""
        return self._watch is not None and self._watch.move is not None

    @property
    def arrived(self) -> bool:
        return self._watch is not None and self._watch.arrived

    @property
    def beat(self) -> int:
        """The time of the last state, ms: shows the controller that it is heard."""
        return 0 if self.state is None else self.state.time

    def await_link(self) -> None:
        """Wait until the controller is heard again, over a connection taken up again where the last one has ended: nobody knows whether a
        move that was sent into an ended one was begun. A telegram may have waited in a connection that has ended since. Raises what ended
        the session.
        """
        asked = time.monotonic()
        self._await(
            lambda: (link := self._link) is not None and self._heard > asked and not link.has_ended,
            time.monotonic() + self._options.reconnect_s + self._options.silence_s + 10.0,
            f"robot '{self._name}': the connection is not there",
        )

    def begin(self, move: Move, target: tuple[float, ...] | None, telegram: bytes) -> None:
        with self._news:
            assert self._watch is not None  # made by open
            self._watch.begin(move)
            self._target = target
        self._send(telegram)

    def switch(self, output: int, on: bool) -> None:
        """Switch $OUT[output]; returns once the controller says that it did. Raises DeviceTimeout, DeviceFault, and what ended the
        session."""
        self.await_link()
        robot = f"robot '{self._name}'"
        with self._switching:
            connection, number = self._connections, max(self._switch, self.latest.switched) + 1
            self._switch = number
            (self._on.add if on else self._on.discard)(output)
            self._send(telegrams.switch(number, output, on, self.beat, self._options.axes))

            def settled() -> bool:
                return self.latest.switched >= number or self._link is None or self._connections != connection

            if not self._wait(settled, time.monotonic() + self._options.silence_s):
                self.halt(self.latest.last)
                raise DeviceTimeout(
                    f"{robot}: the controller did not acknowledge the switching of output {output}; copy the files that "
                    "`mbcacq controller-files` writes again"
                )
            if self.latest.switched < number:
                raise DeviceTimeout(
                    f"{robot}: the connection was lost while output {output} was switched; the controller has switched it off by itself"
                )
            if code := self.latest.switch_code:
                why = telegrams.SWITCH_REFUSALS.get(code, f"code {code}")
                raise DeviceFault(f"{robot}: the controller did not switch output {output}: {why}")

    @property
    def switched_on(self) -> bool:
        """An output was switched on, and not off again."""
        return bool(self._on)

    def halt(self, number: int) -> None:
        """Stop all moves up to ``number``; what was switched on goes off. Never raises: without a connection the controller has done so
        already."""
        if self._options.follow:
            return
        self._on.clear()
        with self._news:
            if self._watch is not None and not self._watch.arrived:
                self._watch.abandon()
        self._send(telegrams.command(STOP, number, self.beat, names=self._options.axes))

    def fail(self, error: MbcacqError) -> None:
        """The first error is kept; the arm is stopped."""
        with self._news:
            if self.error is None:
                self.error = error
            self._news.notify_all()
        if self.state is not None:
            self.halt(max(self.state.last, 0 if self._watch is None or self._watch.move is None else self._watch.move.number))

    def close(self, standstill_s: float) -> None:
        """Wait until the arm stands, as long as its state is reported; then hang up."""
        deadline = time.monotonic() + standstill_s
        last = None if self.state is None else self.state.time
        while self._thread.is_alive() and self._link is not None and last is not None and time.monotonic() < deadline:
            if self.latest.time > last + 2 * self._options.state_ms and not self.latest.moving or self._heard + 0.5 < time.monotonic():
                break
            time.sleep(0.002)
        self._quit.set()
        if (link := self._link) is not None:
            link.close()
        if self._thread.is_alive():
            self._thread.join()
        if (link := self._link) is not None:  # one that was just being taken up again
            link.close()

    # the thread

    def _work(self) -> None:
        while not self._quit.is_set():
            try:
                self._listen()
            except LinkLost as error:
                if self._quit.is_set() or not self._again(str(error)):
                    return
            except MbcacqError as error:
                self.fail(error)
                if self._watch is None:  # still connecting: nothing to look after
                    return

    def _listen(self) -> None:
        if (link := self._link) is None:
            raise LinkLost("the connection was closed")
        for arrival, hello, state in link.telegrams(_POLL_S):
            self._heard = arrival
            if hello is not None:
                self.hello = hello
            if state is not None:
                self._take(arrival, state)
        silent = time.monotonic() - self._heard
        if silent > self._options.silence_s and self.state is not None:
            raise LinkLost(f"the controller reported no state for {silent:.1f} s")

    def _take(self, arrival: float, state: State) -> None:
        before = self.state
        if before is not None and state.time < before.time:
            raise DeviceFault(f"robot '{self._name}': the controller's clock went back by {before.time - state.time} ms; was it restarted?")
        if before is None or state.time > before.time:  # else the same telegram once more
            with self._news:
                self.state = state
                self._record.add(arrival, state, self._target, self._connections)
                error = None if self._watch is None or self.error is not None else self._watch.take(state)
                self._news.notify_all()
            if error is not None:
                self.fail(error)
        if self._beaten < 0 or state.time - self._beaten >= self._options.beat_ms:
            self._beaten = state.time
            self._send(telegrams.command(BEAT, beat=state.time, names=self._options.axes))

    def _again(self, how: str) -> bool:
        """The connection is lost. Take it up again if the arm stood still; else say what happened. False: that was all."""
        with self._news:
            link, self._link, watching = self._link, None, self._watch is not None
            if not watching:
                self.hello = None
        if link is not None:
            link.close()
        if not watching and self._redial():
            return True
        robot = f"robot '{self._name}'"
        before, follows = self.state, self._options.follow
        if (
            before is None
            or not watching
            or before.moving
            or (self.busy and not self.arrived)
            or self.error is not None
            or not self._options.reconnect_s
        ):
            lost = DeviceTimeout if watching or (follows and before is not None) else ConnectError
            what_next = "; the controller brakes the arm by itself" if watching else "; connect again" if follows else ""
            self.fail(lost(f"{robot}: {how}{what_next}"))
            return False
        deadline = time.monotonic() + self._options.reconnect_s
        try:
            self._resume_in_time(deadline, before)
        except LinkLost as error:
            self.fail(DeviceTimeout(f"{robot}: {how}, and when connected again: {error}; the arm stands"))
        except IdentityError as error:
            self.fail(error)
        except ConnectError as error:
            self.fail(DeviceTimeout(f"{robot}: {how}, and it did not come back within {self._options.reconnect_s:g} s: {error}"))
        except MbcacqError as error:
            self.fail(error)
        return self._link is not None

    def _redial(self) -> bool:
        """While connecting: a controller that still ends a former connection closes the new one, too."""
        left = self._first_deadline - time.monotonic()
        if left <= 0 or self._quit.wait(min(left, RETRY_S)):
            return False
        try:
            self._link = self._dial(left)
        except ConnectError:
            return False
        return True

    def _resume_in_time(self, deadline: float, before: State) -> None:
        """A controller that still ends the former connection closes the new one, too. Raises MbcacqError, LinkLost."""
        while True:
            try:
                return self._resume(self._dial(max(0.0, deadline - time.monotonic())), deadline, before)
            except LinkLost:
                if time.monotonic() > deadline or self._quit.wait(RETRY_S):
                    raise

    def _resume(self, link: Link, deadline: float, before: State) -> None:
        """Raises MbcacqError, LinkLost."""
        try:
            self._heard, hello, state = meet(link, deadline, self._quit, _POLL_S)
            self._check(hello, state)
            refuse_moved(self._name, before, state)
        except BaseException:
            link.close()
            raise
        with self._news:
            self.hello, self._beaten = hello, -1
            self._link = link
            self._news.notify_all()

    def _dial(self, wait_s: float) -> Link:
        """Raises ConnectError."""
        link = dial(self._options.address, self._options.port, wait_s, self._quit, self._options.axes)
        self._connections += 1
        self._heard = time.monotonic()
        return link

    def _send(self, telegram: bytes) -> None:
        if (link := self._link) is None:
            return
        try:
            link.send(telegram)
        except LinkLost:
            link.close()  # the thread will notice

    def _complete(self) -> bool:
        return self.hello is not None and bool(self.latest.ready) and self.hello.session == self.latest.session

    def _await(self, condition: Callable[[], bool], deadline: float, otherwise: str) -> None:
        if not self._wait(condition, deadline):
            raise ConnectError(otherwise)

    def _wait(self, condition: Callable[[], bool], deadline: float) -> bool:
        """Whether it came true until ``deadline``. Raises what ended the session."""
        with self._news:
            while not condition():
                if self.error is not None:
                    raise self.error.with_traceback(None)
                if (left := deadline - time.monotonic()) <= 0:
                    return False
                self._news.wait(min(left, 0.1))
        return True

"""Client of the EKI server program that KUKA's external-control SDK puts on a controller (EkiKSSinterface, TCP 54600)."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any
from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

from mbcacq.devices import ConnectError, ContextDevice, DeviceFault, DeviceTimeout, LinkLost, ProtocolError, TcpLink
from mbcacq_kuka.eki.framing import Cutter, FramingError


class Request(IntEnum):
    CONNECT, START, RESET, CANCEL, CHANGE_MODE, NONE, DRIVES_ON, DRIVES_OFF, CYCLE = range(9)


class EkiEvent(IntEnum):
    (STARTED, STOPPED, CANCELLED, RESET_OK, ERROR, CONNECTED, SWITCH_OK, INVALID, NONE, DRIVES_ON, DRIVES_OFF, CYCLE_SET, STATUS) = range(
        13
    )


@dataclass(frozen=True)
class RobotIdentity:
    """model: $ROBTRAFO[], machine_data: $V_R1MADA[]."""

    interface: str
    axes: int
    external_axes: int
    model: str
    machine_data: str


@dataclass(frozen=True)
class EkiStatus:
    """control_mode: 1 joint position. cycle_time: 1 is 4 ms, 2 is 12 ms."""

    control_mode: int
    cycle_time: int
    emergency_stop: bool
    guard_stop: bool


_JOINT_POSITION = 1  # ControlMode
_REFUSALS = (EkiEvent.ERROR, EkiEvent.INVALID)


class EkiClient(ContextDevice):
    """Synchronous requests; every one waits for its answer. Raises ConnectError, DeviceTimeout, ProtocolError, DeviceFault.

    Answers carry no number. One that comes after its time-out is known by its event, and by coming before that of any later request.
    """

    def __init__(self, host: str, port: int = 54600, timeout_s: float = 4.0) -> None:
        self._host, self._port, self._timeout_s, self._where = host, port, timeout_s, f"{host}:{port}"
        self._link: TcpLink | None = None
        self._waiting: deque[Element] = deque()
        self._unanswered: deque[tuple[EkiEvent, ...]] = deque()  # what could have answered each request given up, the oldest first
        self.identity: RobotIdentity | None = None
        self.status: EkiStatus | None = None

    def connect(self) -> RobotIdentity:
        self.close()
        try:
            self._link = TcpLink("it", self._host, self._port, self._timeout_s, self._timeout_s)
        except OSError as error:
            raise ConnectError(
                f"the EKI server {self._where} cannot be reached ({error}); is the submit program running and the port open?"
            ) from error
        self._cutter = Cutter("Robot")
        try:
            self._send(Request.CONNECT)
            return self._await(lambda: self.identity)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        link, self._link = self._link, None
        self._waiting.clear()
        self._unanswered.clear()
        self.identity = self.status = None
        if link is not None:
            link.close()

    def drives_on(self) -> None:
        self._request(Request.DRIVES_ON, (EkiEvent.DRIVES_ON,))

    def choose_cycle(self, cycle_ms: int) -> None:
        """Choose between the RSI programs of 4 and of 12 ms. A server that knows one cycle only (iiQKA.OS2) refuses the request and
        has that of 4 ms; the first telegrams show which one it is."""
        self._request(Request.CYCLE, (EkiEvent.CYCLE_SET, EkiEvent.INVALID), cycle_time={4: 1, 12: 2}[cycle_ms])

    def choose_joint_position(self) -> None:
        """What the RSI program shall correct. Without this choice the server does not take ``start``."""
        self._request(Request.CHANGE_MODE, (EkiEvent.SWITCH_OK,), control_mode=_JOINT_POSITION)

    def start(self) -> None:
        """Start the RSI program that was chosen: the controller begins to send RSI telegrams."""
        self._request(Request.START, (EkiEvent.STARTED,))

    def cancel(self) -> None:
        """End the RSI program."""
        self._request(Request.CANCEL, (EkiEvent.CANCELLED, EkiEvent.STOPPED))

    def reset(self) -> None:
        """Return a program that is running to its beginning."""
        self._request(Request.RESET, (EkiEvent.RESET_OK,))

    def poll(self) -> EkiStatus | None:
        """The latest status, after reading what has arrived."""
        while self._receive(0.0):
            pass
        return self.status

    def _request(self, request: Request, accepted: tuple[EkiEvent, ...], control_mode: int = -1, cycle_time: int = -1) -> None:
        self._restore(request)
        self._discard_late()
        self._send(request, control_mode, cycle_time)
        try:
            answer = self._await(lambda: self._event(accepted))
        except DeviceTimeout:
            self._unanswered.append(accepted)
            raise
        event = answer.get("EventID", "")
        if event in _ids(accepted):
            return
        name = next((e.name.lower() for e in EkiEvent if str(int(e)) == event), event)
        text = (answer.text or "").strip()
        raise DeviceFault(
            f"the controller answered {request.name.lower()} with '{name}'{': ' + text if text else ''}; "
            "look at the smartPAD (operation mode EXT, drives, messages)"
        )

    def _restore(self, request: Request) -> None:
        """Connect again where the server has closed the connection since the last request. It has then forgotten what was chosen."""
        self._connected()
        try:
            self.poll()
        except ConnectError:
            if request is Request.START:
                raise
            self.connect()

    def _discard_late(self) -> None:
        """Answers that came before this request are late ones to those before it, or news that nobody asked for."""
        while self._event(()) is not None:
            pass

    def _event(self, accepted: tuple[EkiEvent, ...]) -> Element | None:
        """The next answer that does not belong to a request that was given up."""
        while self._waiting:
            response = self._waiting.popleft()
            event = response.get("EventID")
            if event not in _ids((EkiEvent.NONE, EkiEvent.STATUS)) and not self._is_late(event, accepted):
                return response
        return None

    def _is_late(self, event: str | None, accepted: tuple[EkiEvent, ...]) -> bool:
        while self._unanswered:
            expected = self._unanswered[0]
            if event in _ids((*expected, *_REFUSALS)):
                self._unanswered.popleft()
                return True
            if event in _ids(accepted):  # answers keep their order, so the older ones are lost
                self._unanswered.popleft()
                continue
            return False
        return False

    def _send(self, request: Request, control_mode: int = -1, cycle_time: int = -1) -> None:
        telegram = f'<External REQTYPE="{int(request)}" ControlMode="{control_mode}" CycleTime="{cycle_time}"></External>'
        try:
            self._connected().send(telegram.encode())
        except LinkLost as error:
            raise ConnectError(f"the EKI server {self._where}: {error}") from error

    def _connected(self) -> TcpLink:
        if self._link is None:
            raise ConnectError("the EKI client is not connected; call connect first")
        return self._link

    def _await(self, condition: Callable[[], Any]) -> Any:
        deadline = time.monotonic() + self._timeout_s
        while (result := condition()) is None:
            left = deadline - time.monotonic()
            if left <= 0:
                raise DeviceTimeout(f"the EKI server {self._where} did not answer within {self._timeout_s:g} s")
            self._receive(left)
        return result

    def _receive(self, timeout_s: float) -> bool:
        """Read once; True if something came."""
        try:
            _, data = self._connected().receive(timeout_s)
        except LinkLost as error:
            raise ConnectError(f"the EKI server {self._where}: {error}") from error
        try:
            for telegram in self._cutter.feed(data):
                self._take(fromstring(telegram, forbid_dtd=True))
        except (FramingError, ParseError, DefusedXmlException, ValueError) as error:
            raise ProtocolError(f"the EKI server {self._where} sent a malformed telegram: {error}") from error
        return bool(data)

    def _take(self, robot: Element) -> None:
        if (init := robot.find("Init")) is not None:
            self.identity = RobotIdentity(
                init.get("VER", ""),
                int(init.get("NumAxes", "0")),
                int(init.get("NumExternalAxes", "0")),
                init.get("Model", ""),
                init.get("RobVer", ""),
            )
        if (status := robot.find("Status")) is not None:
            self.status = _status(status)
        if (response := robot.find("Response")) is not None:
            self._waiting.append(response)


def _ids(events: tuple[EkiEvent, ...]) -> set[str]:
    return {str(int(event)) for event in events}


def _status(element: Element) -> EkiStatus:
    """Raises ValueError for what is no whole number."""

    def number(attribute: str) -> int:
        return int(element.get(attribute, "0"))

    return EkiStatus(number("ControlMode"), number("CycleTime"), bool(number("EmergencyStop")), bool(number("GuardStop")))

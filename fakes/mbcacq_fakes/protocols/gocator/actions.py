"""What commands make the fake sensor do: start, stop, expose, align, restart."""

from __future__ import annotations

import queue
import threading

from mbcacq_fakes.protocols.gocator import encode
from mbcacq_fakes.protocols.gocator.files import EXPOSURE
from mbcacq_fakes.protocols.gocator.replies import BUSY, INVALID_STATE, NOT_LOGGED_IN, UNKNOWN_COMMAND, CommandRefused
from mbcacq_fakes.protocols.gocator.state import SensorState

_REBOOT_S = 3.0
_ALIGNED = {"Z": -12.5, "YAngle": 0.25}


def start(state: SensorState) -> None:
    """Raises CommandRefused where the sensor runs already."""
    with state.lock:
        if state.running:
            raise CommandRefused(INVALID_STATE)
        state.running = True
    state.catch_up()


def stop(state: SensorState) -> None:
    """Allowed in any state."""
    state.catch_up()
    with state.lock:
        state.running = False


def snapshot(state: SensorState) -> None:
    """One exposure of a sensor that does not run. Raises CommandRefused."""
    if state.generation < 5:
        raise CommandRefused(UNKNOWN_COMMAND)
    if state.running:
        raise CommandRefused(INVALID_STATE)
    _request_exposure(state)


def trigger(state: SensorState) -> None:
    """One exposure of a sensor that runs. Raises CommandRefused."""
    if not state.running:
        raise CommandRefused(INVALID_STATE)
    _request_exposure(state)


def reboot(state: SensorState) -> None:
    """Three seconds after the reply all connections end and the sensor is ready again."""

    def later() -> None:
        if not state.closing.wait(_REBOOT_S):
            state.running = False
            state.drop_connections()

    threading.Thread(target=later, name="fake-gocator-reboot", daemon=True).start()


def align(state: SensorState) -> int:
    """The number of the operation; its result follows on the data channel. The state and the transformation change, the points do not."""
    number = _next_operation(state)
    state.files.set_transform(_ALIGNED)
    state.settings["alignment_state"] = 1
    state.data.publish([encode.operation_result(encode.ALIGNMENT_RESULT, number)])
    return number


def clear_alignment(state: SensorState) -> None:
    state.files.set_transform({})
    state.settings["alignment_state"] = 0


def log_in(state: SensorState, user: int, password: str) -> None:
    """User 0 logs out. Raises CommandRefused for a wrong password."""
    if user and password != state.options.password:
        raise CommandRefused(NOT_LOGGED_IN)
    state.settings["login"] = user


def expose_automatically(state: SensorState) -> int:
    """The number of the operation; the exposure found follows on the data channel."""
    number = _next_operation(state)
    exposure = int(state.files.number(EXPOSURE)).to_bytes(4, "little")
    state.data.publish([encode.operation_result(encode.EXPOSURE_RESULT, number, exposure)])
    return number


def _next_operation(state: SensorState) -> int:
    with state.lock:
        state.operations += 1
        return state.operations


def _request_exposure(state: SensorState) -> None:
    """Raises CommandRefused(BUSY) when too many wait already."""
    try:
        state.requests.put_nowait(state.ticks())
    except queue.Full:
        raise CommandRefused(BUSY) from None

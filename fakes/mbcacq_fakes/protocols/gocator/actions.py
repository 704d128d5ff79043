"""What commands make the fake sensor do: start, stop, expose, align."""

from __future__ import annotations

import queue

from mbcacq_fakes.protocols.gocator import encode
from mbcacq_fakes.protocols.gocator.replies import BUSY, INVALID_STATE, NOT_LOGGED_IN, UNKNOWN_COMMAND, CommandRefused
from mbcacq_fakes.protocols.gocator.state import SensorState

_ALIGNED = {"Z": -12.5, "YAngle": 0.25}


def start(state: SensorState) -> None:
    """Raises CommandRefused where the sensor runs already."""
    state.catch_up()  # at rest: the profiles of this start begin now
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


def align(state: SensorState) -> int:
    """The number of the operation; its result follows on the data channel. The state and the transformation change, the points do not."""
    with state.lock:
        state.operations += 1
        number = state.operations
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


def _request_exposure(state: SensorState) -> None:
    """Raises CommandRefused(BUSY) when too many wait already."""
    try:
        state.requests.put_nowait(state.ticks())
    except queue.Full:
        raise CommandRefused(BUSY) from None

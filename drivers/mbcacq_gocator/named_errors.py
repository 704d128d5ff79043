"""Errors of a driver with the device's name in front."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from mbcacq.devices import MbcacqError


@contextmanager
def named(name: str) -> Iterator[None]:
    """Puts the device's name in front of the messages of errors that pass."""
    prefix = f"scanner '{name}'"
    try:
        yield
    except MbcacqError as error:
        if error.args and not str(error.args[0]).startswith(prefix):
            error.args = (f"{prefix}: {error.args[0]}", *error.args[1:])
        raise

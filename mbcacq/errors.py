"""Every error a user can meet, and the exit code each one ends the program with.

An error message is one sentence: what happened, where, and what to do about it.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from difflib import get_close_matches
from enum import IntEnum


def command_line(*words: object) -> str:
    """A command of ours that can be pasted: words with spaces in them are quoted, empty ones left out."""
    return shlex.join(["mbcacq", *(str(word) for word in words if str(word))])


def nearest(name: str, known: Iterable[str]) -> str:
    """What a name may have been meant to be, as the end of a sentence: '; did you mean a or b?', or '' where none is near."""
    known = list(known)
    begun = [one for one in known if name and one.startswith(name)]
    near = list(dict.fromkeys([*begun, *get_close_matches(name, known, 2, 0.6)]))[:2]
    return f"; did you mean {' or '.join(near)}?" if near else ""


class ExitCode(IntEnum):
    """Exit status of the ``mbcacq`` command."""

    OK = 0
    BUG = 1
    USAGE = 2
    UNREACHABLE = 3
    DEVICE_FAULT = 4
    ABORTED = 5
    RECORDING_FAILED = 6
    NOT_ACCEPTABLE = 7
    SAFETY_STOP = 8
    LOST = 9
    SYSTEM_REFUSED = 10
    CHANGED = 11
    INTERRUPTED = 130


EXIT_CODE_MEANING = {
    ExitCode.OK: "ok",
    ExitCode.BUG: "unexpected error: please report it",
    ExitCode.USAGE: "wrong command, plan or input data",
    ExitCode.UNREACHABLE: "a device cannot be reached or is not the one expected",
    ExitCode.DEVICE_FAULT: "a device reported a fault, or its measurement cannot be used",
    ExitCode.ABORTED: "aborted by the operator",
    ExitCode.RECORDING_FAILED: "the recording could not be written or read",
    ExitCode.NOT_ACCEPTABLE: "the calibration is not acceptable",
    ExitCode.SAFETY_STOP: "the robot was stopped for safety, or a motion was refused",
    ExitCode.LOST: "a device was lost or fell silent during the run",
    ExitCode.SYSTEM_REFUSED: "the computer refused memory, a file or a right, or has no screen",
    ExitCode.CHANGED: "a check found that the cell changed",
    ExitCode.INTERRUPTED: "interrupted (Ctrl-C)",
}


class MbcacqError(Exception):
    """Base of all errors meant for the user; ``exit_code`` says how the program ends."""

    exit_code = ExitCode.BUG


class ConfigError(MbcacqError, ValueError):
    """A plan, a robot or artefact file, or input data is wrong; the message names file and line."""

    exit_code = ExitCode.USAGE


class ConnectError(MbcacqError, ConnectionError):
    """A device does not answer at its address."""

    exit_code = ExitCode.UNREACHABLE


class IdentityError(ConnectError):
    """Something answers, but it is not the device the plan asks for (model, firmware, protocol version)."""


class DeviceTimeout(MbcacqError, TimeoutError):
    """A device that was connected fell silent or did not finish in time."""

    exit_code = ExitCode.LOST


class ProtocolError(MbcacqError):
    """A device sent something that its protocol does not allow."""

    exit_code = ExitCode.DEVICE_FAULT


class DeviceFault(MbcacqError):
    """A device reported a fault of its own, or its measurement cannot be used."""

    exit_code = ExitCode.DEVICE_FAULT


class SafetyStop(DeviceFault):
    """The robot was stopped because going on could have been dangerous."""

    exit_code = ExitCode.SAFETY_STOP


class Aborted(MbcacqError):
    """The operator ended the run."""

    exit_code = ExitCode.ABORTED


class RecordingError(MbcacqError, OSError):
    """A recording cannot be written (disk full, no permission) or read (torn, not ours)."""

    exit_code = ExitCode.RECORDING_FAILED


class SystemRefused(MbcacqError):
    """The computer refuses what the program needs: memory, open files, rights, a screen."""

    exit_code = ExitCode.SYSTEM_REFUSED


class CellChanged(MbcacqError):
    """A check found that the cell is not as it was when it was calibrated, or first checked."""

    exit_code = ExitCode.CHANGED


class CalibrationError(MbcacqError):
    """The data do not determine what was asked for, or the result misses the plan's limits."""

    exit_code = ExitCode.NOT_ACCEPTABLE


class ContradictionError(CalibrationError):
    """The measurements contradict the cell as it is described: a sign, a unit, an order of columns or a certificate is wrong."""

"""A device is lost in the middle of a run: the arm stands, the recording is closed and readable, the exit code says which; or it comes back."""

import signal
import threading

import pytest
from short_run import readable, run_with

from mbcacq.errors import ExitCode
from mbcacq.recording import load_observations as load_run
from mbcacq.recording.rrd.reader import Recording
from mbcacq.recording.run_folder.gaps import find_gaps


def in_a_while(seconds, what):
    timer = threading.Timer(seconds, what)
    timer.daemon = True
    timer.start()


@pytest.mark.parametrize(
    ("hurt", "code"),
    [
        (lambda cell: cell.faults.robot(silence=1), ExitCode.LOST),
        (lambda cell: cell.faults.robot(ignore=1), ExitCode.SAFETY_STOP),
        (lambda cell: cell.faults.robot(stop=1), ExitCode.LOST),
        (lambda cell: cell.faults.scanner("status", {0x4528: -1}), ExitCode.DEVICE_FAULT),
        (lambda cell: cell.faults.mishap("wrong_artefact", station="p1", artefact=None), ExitCode.DEVICE_FAULT),
        (lambda cell: signal.raise_signal(signal.SIGINT), ExitCode.INTERRUPTED),
    ],
    ids=["silent-controller", "does-not-follow", "stopped-at-the-pendant", "refused-exposure", "empty-place", "ctrl-c"],
)
def test_the_arm_stands_the_recording_is_closed_the_exit_code_says_which(tmp_path, hurt, code):
    def impatient(plan):
        if code == ExitCode.LOST:
            plan["robot"]["options"]["silence_s"] = 1.5

    error, folder = run_with(tmp_path, hurt, impatient)
    assert error is not None
    assert getattr(error, "exit_code", ExitCode.INTERRUPTED) == code, error
    readable(folder, [0, 1], "abort" if code == ExitCode.INTERRUPTED else "fail")
    gaps = "; ".join(find_gaps(folder))
    assert "2 of 4 planned poses were not measured: 2, 3" in gaps or ("pose 2" in gaps and "pose 3" in gaps)


def test_a_scanner_that_reboots_costs_time_but_no_pose(tmp_path):
    def reboot(cell):
        cell.faults.scanner("refuse_connections")
        cell.faults.scanner("close_data")
        in_a_while(3.0, lambda: (cell.faults.clear_scanner("refuse_connections"), cell.faults.clear_scanner("close_data")))

    error, folder = run_with(tmp_path, reboot)
    assert error is None
    readable(folder, [0, 1, 2, 3], "success")
    assert "the scanner was lost" in str(Recording(folder / "run.rrd").about()["reason"])
    log = (folder / "log.jsonl").read_text()
    assert "trying again for up to 20 s" in log
    assert "the scanner is back after" in log


def test_a_thermometer_that_falls_silent_is_a_named_gap(tmp_path):
    error, folder = run_with(tmp_path, lambda cell: cell.faults.sensor(0, silent=True))
    assert error is None
    readable(folder, [0, 1, 2, 3], "success")
    gaps = find_gaps(folder)
    assert len(gaps) == 2
    assert all("has no robot_C" in gap for gap in gaps)
    assert load_run(folder).extra["poses.robot_C"].tolist()[2:] == ["", ""]

"""A device is lost in the middle of a run: the arm stands, the recording is closed and readable, the exit code says which; or it comes back."""

import signal
import threading
import time

import numpy as np
import pytest
from test_run import plan_file

from mbcacq.acquisition import events
from mbcacq.devices import load_driver
from mbcacq.errors import ExitCode, MbcacqError
from mbcacq.plan import expand, load
from mbcacq.recording import Recording, find_gaps
from mbcacq.recording import load_observations as load_run
from mbcacq.workflow import acquire


def short(plan):
    plan["steps"] = [plan["steps"][1] | {"views": plan["steps"][1]["views"][:4]}]
    plan["scanner"] |= {"reconnect_s": 20.0}
    plan["scanner"]["options"] |= {"timeout_s": 1.5, "retries": 0}
    plan["sensors"] = [
        {
            "driver": "modbus",
            "options": {
                "host": "127.0.0.1",
                "port": 5020,
                "timeout_s": 0.3,
                "retries": 0,
                "values": {"robot_C": {"address": 0, "table": "input", "type": "int16", "scale": 0.1}},
            },
        }
    ]


def run_with(tmp_path, hurt, change=lambda plan: None, at=(events.PoseDone, 1)):
    """Run; ``hurt(cell)`` is called once, at the first event of that kind and pose. Returns the error that ended it, and the folder."""
    loaded = load(plan_file(tmp_path, lambda p: (short(p), change(p))))
    poses = expand(loaded)
    acquisition = acquire.plan_acquisition(loaded, poses, frozenset(), 0, "the fake cell")
    acquisition.folder = acquire.new_run_folder(tmp_path / "run", "x")
    done, still = [], []

    def watch(event):
        if isinstance(event, at[0]) and event.pose == at[1] and not done:
            done.append(event.pose)
            hurt(cell)
        if isinstance(event, events.RunStopped):
            before = np.array(cell.arm.read().q)
            time.sleep(0.2)
            still.append(np.abs(np.array(cell.arm.read().q) - before).max())

    with load_driver("fakes", "cell")(loaded, poses, seed=1) as cell:
        try:
            acquisition.execute(cell.overrides(), [watch])
            error = None
        except (MbcacqError, KeyboardInterrupt) as caught:
            error = caught
    assert still == [0.0]  # at the end of the run the arm stands
    return error, acquisition.folder


def readable(folder, poses, status):
    assert load_run(folder).pose_id.tolist() == poses
    assert Recording(folder / "run.rrd").about()["exit_status"] == status


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
    error, folder = run_with(tmp_path, hurt)
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

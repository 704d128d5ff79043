"""A dry run on a computer that stands for seconds waits: arm, controller and scanner stand with it, and none of them is lost."""

import os
import signal
import threading

import psutil
import pytest
from short_run import run_with

from mbcacq.acquisition import events
from mbcacq.recording import load_observations


@pytest.mark.skipif(os.name == "nt", reason="Windows cannot stop a process")
@pytest.mark.parametrize(("part", "seconds"), [("mbcacq_kuka.rsi.cycle", 8.0), ("mbcacq_fakes.cell.process", 6.0)])
def test_a_process_of_a_dry_run_that_stands_still_ends_no_run(tmp_path, part, seconds):
    def stall(cell):
        found = [p for p in psutil.Process().children(recursive=True) if part in " ".join(p.cmdline())]
        assert found
        for process in found:
            os.kill(process.pid, signal.SIGSTOP)
            threading.Timer(seconds, os.kill, (process.pid, signal.SIGCONT)).start()

    def alone(plan):
        plan.pop("sensors")
        plan["scanner"]["options"].pop("timeout_s")

    error, folder = run_with(tmp_path, stall, alone, (events.PoseReached, 1))
    assert error is None
    assert load_observations(folder).n_poses == 4

"""What the cycle process asks of the operating system, and gets where it is permitted. POSIX."""

import json
import os
import subprocess
import sys

import pytest

PROGRAM = """
import gc, json, os, sys
from mbcacq_kuka.rsi.realtime import become_real_time
granted = become_real_time(json.loads(sys.argv[1]))
status = dict(line.split(":", 1) for line in open("/proc/self/status") if ":" in line)
print(json.dumps({
    "granted": granted, "cores": sorted(os.sched_getaffinity(0)), "collects": gc.isenabled(),
    "policy": os.sched_getscheduler(0), "locked_kb": int(status["VmLck"].split()[0]),
}))
"""

pytestmark = pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="this system has no processor affinity")


def seen(cpu):
    done = subprocess.run([sys.executable, "-c", PROGRAM, json.dumps(cpu)], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


@pytest.mark.parametrize("cpu", [None, min(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 0])
def test_priority_and_one_core_come_together(cpu):
    allowed, found = sorted(os.sched_getaffinity(0)), seen(cpu)
    assert not found["collects"]
    if found["granted"]:
        assert found["policy"] == os.SCHED_FIFO
        assert found["cores"] == (allowed if cpu is None else [cpu])
    else:
        assert found["cores"] == allowed


def test_memory_is_locked_where_it_is_permitted():
    if os.geteuid() != 0:
        pytest.skip("only a privileged process may lock all its memory for certain")
    found = seen(None)
    if not found["granted"]:
        pytest.skip("this system grants no privileges")
    assert found["locked_kb"] > 1000


def test_the_process_of_the_cycle_loads_nothing_of_the_rest():
    """What is not loaded cannot take its interpreter: arrays, scans, the viewer, the program itself."""
    code = "import sys, mbcacq_kuka.rsi.cycle; print(*sys.modules)"
    loaded = set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split())
    assert not loaded & {"numpy", "scipy", "rerun", "mbcacq", "pydantic", "mbcacq_gocator"}

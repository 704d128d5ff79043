"""A program that makes many recordings keeps no thread of those that it has closed."""

import gc
import threading
from pathlib import Path

import pytest
import rerun as rr

from mbcacq.recording.rrd.new_stream import new_stream

TASKS = Path("/proc/self/task")


@pytest.mark.skipif(not TASKS.exists(), reason="the threads of a process are counted as Linux shows them")
def test_a_closed_stream_leaves_no_thread_when_the_next_is_made(tmp_path):
    def recorded(name: str) -> int:
        stream = new_stream("of_many", name)
        stream.save(tmp_path / f"{name}.rrd")
        stream.log("a", rr.TextLog("b"))
        stream.flush()
        stream.disconnect()
        native = len(list(TASKS.iterdir())) - threading.active_count()
        del stream
        gc.collect()
        return native

    counts = [recorded(f"r{k}") for k in range(6)]
    assert counts[-1] <= counts[1], f"threads outside Python: {counts}"

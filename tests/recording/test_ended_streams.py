"""A program that makes many recordings keeps no thread of those that it has closed."""

import gc
import threading
from pathlib import Path

import pytest
import rerun as rr
import rerun.blueprint as rrb

from mbcacq.recording.rrd.new_stream import new_stream, send_default_blueprint
from mbcacq.recording.rrd.sink import Sink

TASKS = Path("/proc/self/task")


def a_stream(path):
    stream = new_stream("of_many", path.stem)
    stream.save(path)
    stream.log("a", rr.TextLog("b"))
    stream.flush()
    stream.disconnect()


def a_stream_with_its_blueprint(path):
    stream = new_stream("of_many", path.stem)
    stream.save(path)
    send_default_blueprint(stream, rrb.Blueprint(rrb.TextLogView(origin="a")))
    stream.log("a", rr.TextLog("b"))
    stream.flush()
    stream.disconnect()


def a_recording(path):
    sink = Sink(path, path.stem, live=False, port=0, blueprint=rrb.Blueprint(rrb.TextLogView(origin="a")))
    sink.stream.log("a", rr.TextLog("b"))
    sink.close()


@pytest.mark.skipif(not TASKS.exists(), reason="the threads of a process are counted as Linux shows them")
@pytest.mark.parametrize("write", [a_stream, a_stream_with_its_blueprint, a_recording])
def test_a_closed_stream_leaves_no_thread_when_the_next_is_made(tmp_path, write):
    def threads_after(name: str) -> int:
        write(tmp_path / f"{name}.rrd")
        gc.collect()
        return len(list(TASKS.iterdir())) - threading.active_count()

    gc.collect()
    gc.freeze()  # what other tests left is not looked through again after each stream
    counts = [threads_after(f"r{k}") for k in range(6)]
    assert counts[-1] <= counts[1], f"threads outside Python: {counts}"


def test_a_blueprint_stands_in_the_recording_it_was_sent_to(tmp_path):
    a_stream(tmp_path / "without.rrd")
    a_stream_with_its_blueprint(tmp_path / "with.rrd")
    assert b"ViewBlueprint" not in (tmp_path / "without.rrd").read_bytes()
    assert b"ViewBlueprint" in (tmp_path / "with.rrd").read_bytes()

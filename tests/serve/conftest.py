import json
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "report"))  # made-up results, which the report's tests have

PORT = 8765
STAND_IN = """
import sys, time, signal
if sys.argv[2] == "deaf":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
from mbcacq.cli.signals import end_in_order_on_signals
from mbcacq.errors import Aborted
from mbcacq.recording.run_folder.lock import write_lock
end_in_order_on_signals()
code = 0
with write_lock(sys.argv[1], "run"):
    print("held", flush=True)
    try:
        while True:
            time.sleep(60)
    except KeyboardInterrupt:
        code = 130
    except Aborted:
        code = 5
sys.exit(code)
"""


@pytest.fixture
def stand_in():
    """stand_in(folder, how): a process that holds the lock of a run folder and ends as a run does; 'deaf': as one started with &."""
    started = []

    def start(folder, how="hearing"):
        process = subprocess.Popen([sys.executable, "-c", STAND_IN, folder, how], stdout=subprocess.PIPE, text=True)
        started.append(process)
        assert process.stdout.readline() == "held\n"
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


@pytest.fixture
def runs(tmp_path):
    """A folder with one verified run."""
    from result_page import make_result

    folder = tmp_path / "runs" / "monday"
    folder.mkdir(parents=True)
    (folder / "result.json").write_text(json.dumps(make_result()))
    return tmp_path / "runs"


@pytest.fixture
def measuring(runs):
    """The folder of a run of ten poses, of which three are measured."""
    folder = runs / "now"
    folder.mkdir()
    entries = [{"time_s": 0.0, "event": "run_started", "name": "quick", "started": "2026-11-25T14:17:11+00:00", "n_poses": 10}]
    entries += [{"time_s": 4.0 + 2 * k, "event": "pose_done", "pose": k, "station": "p1", "step": "views", "balls": 8} for k in range(3)]
    (folder / "journal.jsonl").write_text("".join(json.dumps(entry) + "\n" for entry in entries))
    line = {"time": "2026-11-25T14:17:13+00:00", "time_s": 2.0, "level": "info", "source": "mbcacq", "text": "artefact at <b>p1</b>"}
    (folder / "log.jsonl").write_text(json.dumps(line) + "\n")
    return folder

"""A run and a resume of the same folder at once."""

import signal
import subprocess

from dry_runs import few_views, plan_file
from typed_command import MBCACQ, ROOT, mbcacq, one_sentence, until


def test_a_run_that_goes_on_cannot_be_resumed_by_another_process(tmp_path):
    plan, run = plan_file(tmp_path, few_views), tmp_path / "run"
    first = subprocess.Popen(
        [MBCACQ, "run", plan, "--dry-run", "--out", run], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    journal = run / "journal.jsonl"
    until(lambda: journal.exists() and "pose_done" in journal.read_text())
    first.send_signal(signal.SIGSTOP)  # it is under way for as long as the others ask
    try:
        for command in (["run", plan, "--dry-run", "--resume", run], ["recover", run], ["report", run]):
            second = mbcacq(*command)
            assert second.returncode == 6, second.stderr
            assert f"process {first.pid}" in one_sentence(second)
    finally:
        first.send_signal(signal.SIGCONT)
    _, errors = first.communicate(timeout=900)
    assert first.returncode == 0, errors
    assert journal.read_text().count("run_started") == 1
    assert mbcacq("report", run).returncode == 0

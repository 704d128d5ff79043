"""What the computer refuses, and signals that come more than once: one sentence, an exit code that says so, nothing left behind."""

import resource
import signal
import subprocess
import sys

import numpy as np
import pytest
from dry_runs import few_views, plan_file
from test_run import MBCACQ, ROOT, mbcacq, one_sentence, until

from mbcacq.cli.app import refused_by_the_system

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits of processes are Linux's here")


def test_too_small_an_address_space_is_said_before_anything_moves(tmp_path):
    done = subprocess.run(
        [MBCACQ, "run", "plans/quick.yaml", "--dry-run", "--out", tmp_path / "run"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (800_000_000, 800_000_000)),
    )
    assert done.returncode == 10
    assert "762 MiB of addresses here, and a run needs 1280 MiB" in one_sentence(done)
    assert not (tmp_path / "run").exists()


def test_two_gigabytes_of_addresses_and_64_files_are_enough_for_a_run_to_its_report(tmp_path):
    """A fifth of the addresses is used; allocators would reserve more than there are."""

    def little() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (2_000_000_000, 2_000_000_000))
        resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))

    plan = plan_file(tmp_path, few_views)
    done = subprocess.run(
        [MBCACQ, "run", plan, "--dry-run", "--out", tmp_path / "run"], cwd=ROOT, capture_output=True, text=True, preexec_fn=little
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "report.html").read_text(encoding="utf-8").rstrip().endswith("</html>")


def test_a_report_is_whole_or_refused_where_few_files_may_be_open(tmp_path):
    plan = plan_file(tmp_path, few_views)
    assert mbcacq("simulate", plan, "--noise", "--out", tmp_path / "set").returncode == 0
    for files in (64, 24):
        page = tmp_path / f"{files}.html"
        done = subprocess.run(
            [MBCACQ, "report", tmp_path / "set", "--out", page],
            capture_output=True,
            text=True,
            timeout=300,
            preexec_fn=lambda files=files: resource.setrlimit(resource.RLIMIT_NOFILE, (files, files)),
        )
        if done.returncode == 0:
            assert page.read_text(encoding="utf-8").rstrip().endswith("</html>")
        else:
            assert done.returncode == 10
            assert "open files" in one_sentence(done)
            assert not page.exists()


@pytest.mark.parametrize(
    "arguments", [["run", "plans/quick.yaml", "--dry-run", "--out"], ["run", "plans/quick.yaml", "--dry-run", "--resume"]]
)
def test_a_name_that_no_folder_can_have_is_a_sentence(tmp_path, arguments):
    done = mbcacq(*arguments, tmp_path / ("x" * 300))
    assert done.returncode in (2, 6, 10)
    assert "File name too long" in one_sentence(done)


def test_memory_files_and_threads_that_are_refused_are_no_bug():
    with pytest.raises(MemoryError) as memory:
        np.empty(1 << 50)
    assert "too little memory" in refused_by_the_system(memory.value)
    assert "too little memory" in refused_by_the_system(ImportError("libx.so: failed to map segment from shared object"))
    assert "too little memory" in refused_by_the_system(RuntimeError("can't start new thread"))
    with pytest.raises(OSError, match="too long") as name:
        open("y" * 300)
    assert "File name too long" in refused_by_the_system(name.value)
    assert refused_by_the_system(RuntimeError("another")) == refused_by_the_system(ValueError("x")) == ""


def over_eki(plan):
    plan["robot"] |= {
        "driver": "kuka_eki",
        "options": {"address": "127.0.0.1", "port": 54610, "tool": 1, "base": 0, "mode": "any", "override": 100},
    }


@pytest.mark.parametrize("change", [lambda plan: None, over_eki], ids=["rsi", "eki"])
def test_ctrl_c_three_times_ends_the_run_as_once(tmp_path, change):
    run = tmp_path / "run"
    process = subprocess.Popen(
        [MBCACQ, "run", plan_file(tmp_path, change), "--dry-run", "--out", run],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    journal = run / "journal.jsonl"
    until(lambda: journal.exists() and "pose_done" in journal.read_text())
    process.send_signal(signal.SIGINT)
    until(lambda: process.poll() is not None or "run_stopped" in journal.read_text())
    for _ in range(2):  # while it closes
        process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=900)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert "BufferError" not in errors
    assert errors.count("mbcacq: interrupted") == 1

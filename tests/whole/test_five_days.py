"""A cell is lived with for five days by the commands that the pages and the program itself propose: what each day meets, in one walk."""

import re
import shlex
import shutil
from contextlib import chdir
from pathlib import Path

import pytest
from click.testing import CliRunner
from finished_runs import at_full_speed

from mbcacq.cli.app import app

PLANS = Path(__file__).parents[2] / "plans"
BUMPED = "\nfake:\n  hidden:\n    - {name: mount_shift, at_pose: 0, translation_mm: [0.2, 0.1, 0.0]}\n"


def typed(desk, command):
    """(exit code, everything printed) of a command as it is typed in a folder."""
    with chdir(desk):
        done = CliRunner().invoke(app, shlex.split(command)[1:])
    assert "Traceback" not in done.output
    return done.exit_code, done.stdout + done.stderr


def proposed(said):
    return re.findall(r"^next: .*?: (mbcacq .*)$", said, re.MULTILINE)


@pytest.fixture
def desk(tmp_path, finished_run):
    """The first day is over: a calibrated run, and the plans with which it was made."""
    shutil.copytree(finished_run("kuka.yaml").desk / "runs", tmp_path / "desk" / "runs", symlinks=True)
    shutil.copytree(PLANS, tmp_path / "desk" / "plans")
    at_full_speed(tmp_path / "desk" / "plans" / "kuka.yaml")
    return tmp_path / "desk"


def test_five_days_with_a_cell(desk, tmp_path, finished_run):
    run = (desk / "runs" / "latest").resolve()
    check = "mbcacq check runs/latest plans/kuka.yaml --dry-run --poses 6"

    # Day 1: what the run proposed when it ended; the first check.
    for command in proposed(finished_run("kuka.yaml").stderr):
        assert typed(desk, command)[0] == 0, command
    code, said = typed(desk, check)
    assert (code, "nothing changed in 1 check" in said) == (0, True)

    # Day 2: what the check proposed. A check is no run: 'latest' stays the run.
    code, said = typed(desk, proposed(said)[-1])
    assert (code, "nothing changed in 2 checks" in said) == (0, True)
    assert f"runs/{run.name}/report.html" in typed(desk, "mbcacq report latest")[1]
    compared = typed(desk, f"mbcacq compare runs/latest runs/{run.name}")
    assert (compared[0], "is the same recording" in compared[1]) == (2, True)

    # Day 3: somebody hits the scanner. The check is interrupted first: that day does not count.
    (desk / "runs" / "2026-03-03T07-00-00_check-kuka").mkdir()
    (desk / "runs" / "2026-03-03T07-00-00_check-kuka" / "journal.jsonl").write_text('{"event": "run_started", "n_poses": 6}\n')
    plan = desk / "plans" / "kuka.yaml"
    untouched = plan.read_text(encoding="utf-8")
    plan.write_text(untouched + BUMPED, encoding="utf-8")
    code, said = typed(desk, check)
    assert (code, "The cell changed: mount" in said, proposed(said)) == (11, True, ["mbcacq run plans/kuka.yaml --dry-run"])

    # Day 4: a second cell beside it has a history of its own.
    plan.write_text(untouched, encoding="utf-8")
    shutil.copytree(run, desk / "runs" / "cell-b", ignore=shutil.ignore_patterns("check.json"))
    code, said = typed(desk, check.replace("runs/latest", "runs/cell-b"))
    assert (code, "nothing changed in 1 check" in said) == (0, True)

    # Day 5: the folder was copied to another computer, one recording of it only by half.
    shutil.copytree(desk / "runs", tmp_path / "elsewhere" / "runs", symlinks=True)
    half = tmp_path / "elsewhere" / "runs" / "cell-b" / "run.rrd"
    half.write_bytes(half.read_bytes()[: half.stat().st_size // 2])
    code, said = typed(tmp_path / "elsewhere", "mbcacq diagnose runs/cell-b --minutes 1")
    assert code != 0
    assert [line for line in said.splitlines() if line.startswith("mbcacq: ")]
    assert f"runs/{run.name}/report.html" in typed(tmp_path / "elsewhere", "mbcacq report latest")[1]

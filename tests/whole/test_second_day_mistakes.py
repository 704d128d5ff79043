"""What goes wrong when somebody comes back to his runs: files that are missing, cut, of another version or kind. Each has one sentence."""

import json
import os
import re
import shutil
from contextlib import chdir
from pathlib import Path

import pytest
from click.testing import CliRunner
from filelock import FileLock

from mbcacq.cli.app import app

PLANS = Path(__file__).parents[2] / "plans"
NEWER = '{"format": "mbcacq-result/9"}'


def removed(name):
    return lambda folder: (folder / name).unlink()


def written(name, text):
    def spoil(folder):
        (folder / name).unlink(missing_ok=True)
        (folder / name).write_text(text)

    return spoil


def cut(name):
    def spoil(folder):
        whole = (folder / name).read_bytes()
        (folder / name).unlink()
        (folder / name).write_bytes(whole[: len(whole) // 2])

    return spoil


def cut_between_two_messages(folder):
    """The library reads such a file to its end and says nothing: half of the poses would be gone unsaid."""
    noted = [json.loads(line) for line in (folder / "checksums.jsonl").read_text().splitlines()]
    ends = [stretch["end"] for stretch in noted if stretch["file"] == "run.rrd"]
    whole = (folder / "run.rrd").read_bytes()
    (folder / "run.rrd").unlink()
    (folder / "run.rrd").write_bytes(whole[: ends[len(ends) // 2] + 7])


def edited_history(folder):
    (folder / "check.json").write_text(json.dumps({"format": "mbcacq-check/1", "sha256": "0" * 64, "days": []}))


def edited_result(folder):
    content = json.loads((folder / "result.json").read_text())
    content["parameters"][0]["value"] += 1
    written("result.json", json.dumps(content))(folder)


def moved_plan(folder):
    shutil.copy(PLANS / "kuka.yaml", folder.parents[1] / "moved.yaml")


def renamed_runs(folder):
    folder.parent.rename(folder.parents[1] / "of-last-year")


def removed_latest(folder):
    (folder.parent / "latest").symlink_to("monday")
    for run in (folder, folder.parent / "monday"):
        shutil.rmtree(run)


def a_check(name, text):
    """The folder holds a check, one file of which is another one."""

    def spoil(folder):
        written("plan.files.json", '{"kind": "check"}')(folder)
        removed("result.json")(folder)
        written(name, text)(folder)

    return spoil


def somebody_works_in_it(folder):
    lock = FileLock(folder / ".run.lock")
    lock.acquire()
    AT_WORK.append(lock)


def nothing(folder):
    pass


AT_WORK = []  # the locks of others


MISTAKES = [  # what happened, what is typed, what the sentence says
    (
        removed("result.json"),
        "export runs/x --results out",
        "this recording is not calibrated yet: mbcacq calibrate runs/x --out runs/x/result.json",
    ),
    (
        removed("result.json"),
        "check runs/x plans/kuka.yaml --dry-run",
        "this recording is not calibrated yet: mbcacq calibrate runs/x --out runs/x/result.json",
    ),
    (
        removed("result.json"),
        "verify runs/x runs/x",
        "this recording is not calibrated yet: mbcacq calibrate runs/x --out runs/x/result.json",
    ),
    (removed("run.rrd"), "report runs/x", "copied by half"),
    (removed("run.rrd"), "diagnose runs/x", "copied by half"),
    (removed("run.rrd"), "recover runs/x", "holds no recording (run.rrd)"),
    (cut("result.json"), "report runs/x", "result.json is not JSON (it breaks off"),
    (cut("result.json"), "export runs/x --results out", "result.json is not JSON (it breaks off"),
    (cut("result.json"), "compare runs/x runs/monday", "result.json is not JSON (it breaks off"),
    (written("result.json", ""), "report runs/x", "(it is empty)"),
    (written("result.json", NEWER), "report runs/x", "written by a newer mbcacq"),
    (written("result.json", NEWER), "export runs/x --results out", "written by a newer mbcacq"),
    (written("result.json", NEWER), "check runs/x plans/kuka.yaml --dry-run", "written by a newer mbcacq"),
    (cut("run.rrd"), "diagnose runs/x", "mbcacq recover"),
    (cut_between_two_messages, "diagnose runs/x", "mbcacq recover"),
    (cut_between_two_messages, "calibrate runs/x", "mbcacq recover"),
    (written("diagnosis.json", "broken"), "report runs/x", "write it anew with mbcacq diagnose"),
    (written("diagnosis.json", "broken"), "calibrate runs/x --effects runs/x/diagnosis.json", "give what mbcacq diagnose --out wrote"),
    (nothing, "calibrate runs/x --effects runs/x/result.json", "holds no effects that a calibration could take"),
    (written("check.json", '{"a": 1}'), "check runs/x plans/kuka.yaml --dry-run", "no history of checks"),
    (edited_history, "check runs/x plans/kuka.yaml --dry-run", "take its copy from a backup"),
    (nothing, "run plans/kuka.yaml --dry-run --out runs/x", "already holds a run"),
    (nothing, "run --resume runs/x", "start a new run"),
    (nothing, "compare runs/x runs/x", "is the same recording"),
    (nothing, "compare runs/x plans/kuka.yaml", "nothing was measured yet"),
    (nothing, "verify runs/x plans/kuka.yaml", "nothing was measured yet"),
    (nothing, "calibrate runs", "give one of them, such as runs/x"),
    (nothing, "export runs/x/result.jso --results out", "did you mean result.json"),
    (nothing, "export runs/x --results out", "--simulated-anyway"),
    (nothing, "report runs/monday-2", "does not exist; did you mean monday?"),
    (nothing, "calibrate lates", "lates does not exist; did you mean latest"),
    (nothing, "serve runs/x/result.json", "give the folder that holds them"),
    (nothing, "view runs/x/plan.yaml", "is a plan"),
    (written("result.json", '{"format": "mbcacq-result/0"}'), "report runs/x", "is no calibration result of format 'mbcacq-result/1'"),
    (edited_result, "report runs/x", "is not as it was written"),
    (edited_result, "verify runs/x runs/monday", "is not as it was written"),
    (written("check.json", '{"format": "mbcacq-check/9"}'), "check runs/x plans/kuka.yaml --dry-run", "written by a newer mbcacq"),
    (written("diagnosis.json", '{"format": "mbcacq-diagnosis/9"}'), "report runs/x", "a newer mbcacq wrote"),
    (written("run.rrd", ""), "report runs/x", "is empty: nothing was ever written into it"),
    (written("run.rrd", ""), "recover runs/x", "is empty, nothing was ever written into it"),
    (moved_plan, "plan show moved.yaml", "correct the path (it is relative to the plan)"),
    (moved_plan, "run moved.yaml --dry-run", "correct the path (it is relative to the plan)"),
    (renamed_runs, "report latest", "runs holds no run yet"),
    (renamed_runs, "fleet runs --out arms", "runs does not exist"),
    (removed_latest, "report latest", "names the run runs/monday, which is gone"),
    (a_check("check-result.json", ""), "report runs/x", "repeat the check"),
    (a_check("check-result.json", '{"format": "mbcacq-check-result/9"}'), "report runs/x", "another version wrote it"),
    (a_check("check-result.json", ""), "calibrate runs/x", "give the run that it checked"),
    (a_check("check-result.json", ""), "run --resume runs/x", "give the run that it checked"),
    (somebody_works_in_it, "report runs/x", "is in use by another process"),
    (somebody_works_in_it, "check runs/x plans/kuka.yaml --dry-run", "is in use by another process"),
    (somebody_works_in_it, "recover runs/x", "is in use by another process"),
    (somebody_works_in_it, "run --resume runs/x --dry-run", "is in use by another process"),
    (nothing, "check runs/x plans/ur.yaml --dry-run", "give what was learnt on the same arm"),
    (nothing, "run --extend runs/x plans/ur.yaml --dry-run", "grows in its own cell only"),
]


@pytest.mark.parametrize(("spoil", "command", "said"), MISTAKES, ids=[f"{k}-{command}" for k, (_, command, _) in enumerate(MISTAKES)])
def test_a_mistake_has_one_sentence(spoil, command, said, finished_run, tmp_path):
    source = finished_run("kuka.yaml").folder
    for name in ("monday", "x"):
        shutil.copytree(source, tmp_path / "runs" / name, copy_function=os.link, ignore=shutil.ignore_patterns(".run.lock*"))
    (tmp_path / "plans").symlink_to(PLANS)
    spoil(tmp_path / "runs" / "x")
    with chdir(tmp_path):
        done = CliRunner().invoke(app, command.split())
    while AT_WORK:
        AT_WORK.pop().release()
    printed = done.stdout + done.stderr
    sentences = re.findall(r"^mbcacq: (.*)$", printed, re.MULTILINE)
    assert (done.exit_code != 0, len(sentences)) == (True, 1), printed
    assert said in sentences[0]
    assert "unexpected" not in sentences[0]

"""What a command proposes next works: typed as it is printed, and what that proposes in turn, until nothing new is proposed."""

import re
import shlex
import shutil
from contextlib import chdir
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from mbcacq.cli.app import app

PLANS = Path(__file__).parents[2] / "plans"
NEXT = re.compile(r"^next: .*?: (mbcacq .*)$", re.MULTILINE)
ANOTHER_PROCESS = {"run", "view", "serve", "collect", "fakes", "investigate", "extend"}  # minutes, a window or an end by Ctrl-C
TYPED = """
mbcacq calibrate latest
mbcacq calibrate latest --out result.json
mbcacq compare latest
mbcacq compare runs/first runs/second
mbcacq verify runs/first runs/second
mbcacq export latest --results handover --simulated-anyway
mbcacq fleet runs --out arms
mbcacq simulate plans/quick.yaml --out twin
mbcacq plan check --quick plans/kuka.yaml
mbcacq plan show plans/quick.yaml --rrd plan.rrd
"""


@pytest.fixture
def desk(tmp_path, finished_run):
    """Two runs of one cell, as two days would leave them, beside the shipped plans."""
    for name in ("first", "second"):
        shutil.copytree(finished_run("kuka.yaml").folder, tmp_path / "runs" / name)
    (tmp_path / "runs" / "latest").symlink_to("second")
    shutil.copytree(PLANS, tmp_path / "plans")
    return tmp_path


def parsed(command):
    """Raises what click says of a command that is not to be started here."""
    context, found = click.Context(app), app
    words = shlex.split(command)[1:]
    while isinstance(found, click.Group):
        found, words = found.get_command(context, words[0]), words[1:]
    found.make_context("mbcacq", words, resilient_parsing=False)


def test_every_next_step_works(desk):
    waiting, done = TYPED.strip().splitlines(), list[str]()
    with chdir(desk):
        while waiting:
            command = waiting.pop(0)
            done.append(command)
            if shlex.split(command)[1] in ANOTHER_PROCESS or command.startswith("mbcacq plan new "):
                parsed(command)
                continue
            if " --results results" in command:  # several proposals export into it, and none replaces another's
                shutil.rmtree("results", ignore_errors=True)
            ended = CliRunner().invoke(app, shlex.split(command)[1:])
            assert ended.exit_code == 0, f"{command}: {ended.output[-800:]}"
            waiting += [one for one in NEXT.findall(ended.stdout + ended.stderr) if one not in done and one not in waiting]
    assert len(done) > len(TYPED.strip().splitlines()) + 5, done

"""A real arm moves only after --arm and a typed sentence; a stepped run waits for keys."""

import fcntl
import os
import pty
import select
import signal
import subprocess
import termios
import time

import pytest
from dry_runs import few_views, plan_file
from terminal_session import Terminal
from typed_command import MBCACQ, mbcacq, one_sentence

from mbcacq.devices.addresses import on_loopback_only


@pytest.mark.parametrize(
    ("options", "fake"),
    [
        ({"bind": "127.0.0.1", "port": 49152}, True),
        ({"bind": "127.0.0.1", "controller_ip": "127.0.0.1", "server": "localhost:54600"}, True),
        ({"bind": "127.0.0.1", "sen_type": "ImFree", "server": ""}, True),
        ({"address": "::1"}, True),
        ({"url": "socket://127.0.0.1:5000"}, True),
        ({}, False),
        ({"port": 49152}, False),
        ({"bind": "192.168.1.5"}, False),
        ({"bind": "127.0.0.1", "server": "192.168.1.2:54600"}, False),
        ({"bind": "127.0.0.1", "controller_ip": "10.0.0.7"}, False),
        ({"bind": "127.0.0.1", "host": "krc.local"}, False),
        ({"bind": "0.0.0.0"}, False),
        ({"serial": "/dev/ttyUSB0"}, False),
        ({"bind": "127.0.0.1", "also": ["10.0.0.7"]}, False),
        ({"bind": "127.0.0.1", "nested": {"address": "arm.example"}}, False),
    ],
)
def test_only_what_can_lead_nowhere_but_to_this_computer_is_a_fake(options, fake):
    assert on_loopback_only(options) is fake


def real(plan):
    plan["robot"]["options"] = {
        "bind": "192.0.2.1",
        "controller_ip": "192.0.2.2",
        "port": 49152,
    }  # an address of the documentation block: nobody's
    plan["workspace"] = {"min_mm": [-400, -600, -100], "max_mm": [1300, 600, 1400]}


def test_without_arm_and_without_a_terminal_nothing_moves(tmp_path):
    plan = plan_file(tmp_path, real)
    done = mbcacq("run", plan, "--out", tmp_path / "run")
    assert done.returncode == 2
    assert "--arm" in one_sentence(done)
    done = mbcacq("run", plan, "--out", tmp_path / "run", "--arm", "--yes")
    assert done.returncode == 2
    assert "not a terminal" in one_sentence(done)
    assert not (tmp_path / "run").exists()


def test_an_absent_operator_is_no_reason_while_arm_is_missing(tmp_path):
    """An investigation of a real arm whose artefacts a person moves, started without either: what was not said comes first."""

    def elsewhere(plan):
        real(plan)
        del plan["workspace"]

    plan = plan_file(tmp_path, elsewhere, "concealed.yaml")
    done = mbcacq("investigate", plan, "--out", tmp_path / "run")
    assert done.returncode == 2
    assert "--arm" in one_sentence(done)
    assert "--resume" not in done.stderr


def test_arm_asks_about_loopback_too_where_a_tunnel_may_end(tmp_path):
    done = mbcacq("run", plan_file(tmp_path, lambda plan: None), "--out", tmp_path / "run", "--arm", "--yes")
    assert done.returncode == 2
    assert "must be confirmed by typing" in one_sentence(done)


@pytest.mark.parametrize(("typed", "code"), [("yes", 5), ("", 5), ("move 9", 5), ("move 10", 3)])
def test_the_sentence_names_what_will_move_and_must_be_typed(tmp_path, typed, code):
    terminal = Terminal("run", plan_file(tmp_path, real), "--out", tmp_path / "run", "--arm", "--yes")
    terminal.wait_for("Type 'move 10'")
    for shown in (
        "10, in 11 motions",
        "25 % of the axes",
        "x 520..1000, y -227..97, z 147..895",
        "kept within x -400..1300",
        "A1 0.0° A2 -90.0° A3 90.0°",
        "pose 0 at station p1",
        "T1",
    ):
        assert shown in terminal.text
    terminal.type(typed)
    assert terminal.end() == code, terminal.text  # 3: then it tries to listen on an address that is not this computer's
    assert (tmp_path / "run").exists() == (code == 3)


def test_a_stepped_run_waits_before_each_pose_until_it_is_let_go(tmp_path):
    terminal = Terminal("run", plan_file(tmp_path, few_views), "--dry-run", "--step", "--out", tmp_path / "run")
    terminal.wait_for("next: pose 0 (")
    journal = tmp_path / "run" / "journal.jsonl"
    time.sleep(0.5)
    assert "pose_done" not in journal.read_text()
    terminal.type("")
    terminal.wait_for("next: pose 1 (")
    assert journal.read_text().count("pose_done") == 1
    terminal.type("q")
    assert terminal.end() == 5
    assert "before pose 1" in terminal.text
    done = mbcacq("run", "plans/quick.yaml", "--dry-run", "--step", "--out", tmp_path / "other")
    assert done.returncode == 2
    assert "not a terminal" in one_sentence(done)


def test_a_stepped_run_hears_ctrl_c_even_where_its_parent_ignored_it(tmp_path):
    """Shells start what runs in the background deaf to Ctrl-C, and that is inherited; who sits at the keyboard must be able to stop an arm."""
    mine, theirs = pty.openpty()

    def at_the_keyboard():
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        fcntl.ioctl(theirs, termios.TIOCSCTTY, 0)

    words = [MBCACQ, "run", plan_file(tmp_path, few_views), "--dry-run", "--step", "--out", tmp_path / "run"]
    process = subprocess.Popen(
        list(map(str, words)), stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True, preexec_fn=at_the_keyboard
    )
    os.close(theirs)
    text, typed = b"", False
    while process.poll() is None or select.select([mine], [], [], 0.1)[0]:
        if not select.select([mine], [], [], 0.2)[0]:
            continue
        try:
            text += os.read(mine, 65536)
        except OSError:  # the other side is closed
            break
        if b"next: pose 0 (" in text and not typed:
            os.write(mine, b"\x03")
            typed = True
    assert process.wait(timeout=900) == 130, text.decode()
    os.close(mine)
    lines = [line.strip() for line in text.decode().splitlines() if line.strip()]
    shown = " ".join(lines[-2:])
    assert "next: go on where it ended: " in shown
    assert shown.endswith(f"mbcacq run --dry-run --step --resume {tmp_path / 'run'}")

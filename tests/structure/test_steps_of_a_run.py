"""The steps of a run are named while they last, and nothing is written over a question."""

from __future__ import annotations

import time

import pytest

from mbcacq.acquisition import events
from mbcacq.cli import step_progress
from mbcacq.cli.plan import _poses
from mbcacq.cli.progress import RunProgress
from mbcacq.cli.step_progress import StepProgress


def alarms_of(steps: StepProgress, monkeypatch) -> list[float]:
    """Intervals to which the timer is set."""
    seconds: list[float] = []
    monkeypatch.setattr(steps, "_timed", True)
    monkeypatch.setattr(step_progress.signal, "setitimer", lambda which, first, interval=0.0: seconds.append(interval))
    return seconds


def test_no_signal_comes_between_the_steps(monkeypatch, capfd):
    steps = StepProgress()
    alarms = alarms_of(steps, monkeypatch)
    for text in ("checking", "starting", "", "evaluating", ""):
        steps.begin(text)
    assert alarms == [step_progress.EVERY_S, 0.0, step_progress.EVERY_S, 0.0]
    steps("")
    assert capfd.readouterr().err == ""


def test_what_a_run_waits_for_is_named_where_there_is_no_bar(capsys):
    named: list[str] = []
    progress = RunProgress(named.append)
    for state in ("connecting", "moving"):
        progress(events.StateChanged(time.monotonic(), state))
    assert named == ["connecting to the devices", ""]


@pytest.mark.parametrize("axes", [6, 7])
def test_the_poses_of_a_plan_fit_eighty_columns(axes, capsys):
    pose = {
        "pose": 123,
        "start_s": 4321.0,
        "step": "orientations",
        "station": "p10",
        "balls": [1],
        "q_deg": [-174.03] * axes,
        "waypoints": 2,
    }
    lines = list(_poses({"poses": [pose, pose | {"step": "bar"}], "axes": [{"name": f"A{i}"} for i in range(1, axes + 1)]}))
    assert max(map(len, lines)) <= 80
    assert [line for line in lines if line.endswith(":")] == ["orientations:", "bar:"]

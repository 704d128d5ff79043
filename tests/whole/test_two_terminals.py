"""The fake cell in one terminal and the run in another, with the person who moves the artefact, as the README says."""

import subprocess

import pytest
from dry_runs import plan_file
from mbcacq_fakes.cell.ports import free_port
from terminal_session import Terminal
from typed_command import MBCACQ


@pytest.fixture
def plan(tmp_path):
    robot, control, health, data = (free_port() for _ in range(4))

    def change(plan):
        plan["robot"]["options"] = {"bind": "127.0.0.1", "port": robot}
        plan["scanner"]["options"] = {"address": "127.0.0.1", "control_port": control, "health_port": health, "data_port": data}
        second = {"id": "p2", "artefact": "mbc", "pose_in_base": {"translation_mm": [600, 60, 150]}}
        plan["stations"].append(second)
        plan["steps"][1]["stations"] = ["p2"]
        plan["exposures"] = 1
        plan["steps"][0]["offsets_mm"] = plan["steps"][0]["offsets_mm"][:1]
        plan["steps"][1]["views"] = plan["steps"][1]["views"][:3]

    return plan_file(tmp_path, change)


@pytest.fixture
def fake_cell(plan):
    """The fake cell, once it says that it is up."""
    process = subprocess.Popen([MBCACQ, "fakes", plan, "--fast"], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    said = ""
    while "in another terminal" not in said:
        line = process.stdout.readline()
        assert line, said
        said += line
    yield said
    for _ in range(20):  # as `timeout` and service managers do: again before the first has been handled
        process.terminate()
    assert process.wait(60) == 0, process.stdout.read()
    process.stdout.close()


def test_a_run_in_another_terminal_asks_for_each_placement_and_ends(plan, fake_cell, tmp_path):
    assert f"mbcacq run {plan}" in fake_cell
    terminal = Terminal("run", plan, cwd=tmp_path)
    terminal.wait_for("press Enter when it stands still", times=1)
    assert "p1" in terminal.text
    terminal.type("")
    terminal.wait_for("press Enter when it stands still", times=2)
    assert "p2" in terminal.text.split("press Enter")[1]
    terminal.type("")
    assert terminal.end() == 0, terminal.text
    runs = tmp_path / "runs"
    assert (runs / "latest" / "report.html").stat().st_size > 10_000
    assert (runs / "latest").resolve() == next(p for p in runs.iterdir() if p.name.endswith("_plan"))

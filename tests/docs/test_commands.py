"""Every command that README or docs/ shows in a ``sh`` block is executed, page by page, as a reader would paste it."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from doc_pages import ROOT, Page, pages
from finished_runs import FinishedRun, at_full_speed
from mbcacq_fakes.cell.ports import free_port

from mbcacq.recording.rrd import rerun_program

sys.path.insert(0, str(ROOT / "docs" / "_make"))

from printed import BY_TEST, MARKED, faults  # noqa: E402

WITH_COMMANDS = [page for page in pages() if page.script.strip()]
# What a reader does once for the computer is done by the continuous integration itself.
INSTALLING = re.compile(r"python3 -m venv \.venv|\bpip install\b|\bapt-get install\b|^sudo |\bpython -m pytest\b")
# Programs with a window: a stand-in checks that what they are to show is there. Without a window, rerun is rerun.
STAND_IN = """#!/bin/sh
case "$1" in --bind) shift 3 ;; --hide-welcome-screen) shift ;; *) case "$0" in *rerun) exec {rerun} "$@" ;; esac ;; esac
for what in "$@"; do test -e "$what" || {{ echo "$what does not exist" >&2; exit 1; }}; done
"""


@pytest.fixture
def desk(tmp_path: Path) -> Path:
    """A folder like a fresh checkout, with this Python as its environment."""
    shutil.copytree(ROOT / "plans", tmp_path / "plans")
    quick = tmp_path / "plans" / "quick.yaml"  # a fake cell at the usual ports would meet those of other programs
    text = quick.read_text(encoding="utf-8").replace("port: 49152", f"port: {free_port()}")
    ports = ", ".join(f"{name}_port: {free_port()}" for name in ("control", "health", "data"))
    quick.write_text(text.replace("options: {address: 127.0.0.1}", f"options: {{address: 127.0.0.1, {ports}}}"), encoding="utf-8")
    ur = tmp_path / "plans" / "ur.yaml"  # at its first two places, with fewer packages for each pose
    text = ur.read_text(encoding="utf-8").replace("{address: 127.0.0.1}   #", "{address: 127.0.0.1, frequency_hz: 40}   #")
    ur.write_text(text[: text.index("  - name: designed p3")], encoding="utf-8")
    for name in ("ur", "folder", "folder-output", "opcua"):  # that each pose comes to its cloud is the fact, not how large or how slow
        plan = tmp_path / "plans" / f"{name}.yaml"
        at_full_speed(plan, speed=0.5)
        with plan.open("a", encoding="utf-8") as end:
            end.write("\nfake: {pitch_mm: 1.0}\n")
    at_full_speed(tmp_path / "plans" / "kuka.yaml")
    sweeps = tmp_path / "plans" / "profiler.yaml"  # at its first station: those of all five are the same commands for a minute longer
    text = sweeps.read_text(encoding="utf-8")
    sweeps.write_text(text[: text.index("  - name: places")] + text[text.index("\nfake:") :], encoding="utf-8")
    at_full_speed(tmp_path / "plans" / "concealed.yaml", scan_time_s=1.0)
    for entry in ("docs", "benchmarks", "tests", "mbcacq", "drivers", "fakes", "pyproject.toml", "mkdocs.yml"):
        (tmp_path / entry).symlink_to(ROOT / entry)
    bin = tmp_path / ".venv" / "bin"
    bin.mkdir(parents=True)
    for program in Path(sys.executable).parent.iterdir():
        if program.name.startswith("python"):  # a link would not find the environment
            (bin / program.name).write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
            (bin / program.name).chmod(0o755)
        else:
            (bin / program.name).symlink_to(program)
    for window in ("rerun", "xdg-open"):
        (bin / window).unlink(missing_ok=True)
        (bin / window).write_text(STAND_IN.format(rerun=rerun_program.program()))
        (bin / window).chmod(0o755)
    return tmp_path


def without_installing(script: str) -> str:
    """The script with the installing parts of its `&&` chains left out."""
    lines = []
    for line in script.replace("\\\n", " ").splitlines():
        kept = [part for part in line.split("&&") if not INSTALLING.search(part.strip())]
        lines.append("&&".join(kept).strip())
    return "\n".join(lines)


# Six pages run the same plan: their command is executed once, and what it left behind is copied to each of them.
DRY_RUN = re.compile(r"^(?:\.venv/bin/)?mbcacq run plans/((?:quick|kuka|concealed)\.yaml) --dry-run(?: --out runs/(\w+))?(?:\s+#.*)?$")

DIAGNOSED = re.compile(r"^(?:\.venv/bin/)?mbcacq diagnose runs/concealed --calibrate$")

# This page makes a plan of its own; its arm moves faster and its scanner takes less time, with as many poses.
FASTER = "sed -i -e 's/^  speed: .*/  speed: 1.0/; s/^  scan_time_s: .*/  scan_time_s: 0.1/'"
OWN_CELL = "mbcacq plan copy quick my-cell"  # goes by the clock, and exposes once

# That a plan of this arm comes of it is the fact, not for how many places.
NEW_PLAN, FEW = "mbcacq plan new --robot ur10e", "--stations 3 --poses 12"


def on_finished_runs(script: str, finished_run: Callable[[str], FinishedRun], diagnosed: Callable[[], FinishedRun]) -> str:
    """The script with the dry runs of shipped plans, and the diagnosis of one of them, replaced by copies of what they left."""
    lines = []
    for line in script.splitlines():
        if line.strip() == "sleep 2":  # stands for: until the fake cell says that it is up
            lines.append("until grep -q 'in another terminal' printed; do sleep 0.2; done")
        elif line.strip() == OWN_CELL:
            lines.append(f"{OWN_CELL} && {FASTER} -e 's/^exposures: .*/exposures: 1/' my-cell/quick.yaml")
        elif line.startswith(NEW_PLAN):
            lines.append(f"{line} {FEW}")
        elif DIAGNOSED.match(line.strip()):
            run = diagnosed()
            lines.append(f"cp -a '{run.folder}'/. runs/concealed && cat '{run.desk / 'stdout'}'")
        elif found := DRY_RUN.match(line.strip()):
            run = finished_run(found[1])
            lines.append(f"cp -a '{run.desk / 'runs'}' . && cat '{run.desk / 'stdout'}'")
            if found[2]:
                lines.append(f"mv 'runs/{run.folder.name}' 'runs/{found[2]}' && ln -sfn '{found[2]}' runs/latest")
        else:
            lines.append(line)
    return "\n".join(lines)


@pytest.mark.parametrize("page", WITH_COMMANDS, ids=lambda page: page.name)
def test_commands_of_a_page_work_when_pasted(
    page: Page, desk: Path, finished_run: Callable[[str], FinishedRun], request: pytest.FixtureRequest
):
    script = on_finished_runs(without_installing(page.script), finished_run, lambda: request.getfixturevalue("concealed_run")[1])
    if not script.strip():
        return
    environment = dict(
        os.environ,
        PATH=f"{desk / '.venv' / 'bin'}:{os.environ['PATH']}",
        DISPLAY=":0",
        RERUN_CLI_PATH=str(desk / ".venv" / "bin" / "rerun"),
    )
    printed = desk / "printed"  # a file: what a page leaves in the background would keep a pipe open
    with printed.open("w") as sink:
        shell = subprocess.Popen(
            ["bash", "-euo", "pipefail", "-c", script],
            cwd=desk,
            env=environment,
            stdout=sink,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            shell.wait(timeout=1150)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(shell.pid, signal.SIGKILL)  # nothing that a page starts in the background outlives it
            shell.wait()
    assert shell.returncode == 0, f"{page.name}: exit {shell.returncode}\n{script}\n---\n{printed.read_text()[-6000:]}"
    assert faults(page.text, printed.read_text()) == [], f"run python docs/_make/printed.py {page.name}"


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.name)
def test_commands_are_shown_only_where_they_are_executed(page: Page):
    """An indented or untagged block with a command would escape the test above."""
    outside = re.sub(r"^```.*?^```$", "", page.text, flags=re.DOTALL | re.MULTILINE)
    assert not re.findall(r"^(?: {4}|\t)\$? ?mbcacq .*", outside, flags=re.MULTILINE)
    for language, body in re.findall(r"^```(\w*).*?\n(.*?)^```$", page.text, flags=re.DOTALL | re.MULTILINE):
        if language not in ("sh", "text"):
            assert not re.search(r"^\$? ?(\.venv/bin/)?mbcacq ", body, flags=re.MULTILINE), f"{page.name}: tag this block sh"


def test_numbers_are_compared_to_the_digits_that_matter():
    page = "<!-- printed -->\n```text\nFit: 68 centres, residual 7.0 µm\n...\nagrees within 3.4e-13 mm\n```\n"
    assert faults(page, "first\nFit: 68 centres, residual 7.4 µm\nmore\nagrees within 9e-14 mm\n") == []
    assert faults(page, "Fit: 68 centres, residual 9.4 µm\nagrees within 1e-5 mm\n") == page.splitlines()[2:5:2]
    assert faults(page, "Fit: 68 poses, residual 7.0 µm\nagrees within 0 mm\n") == ["Fit: 68 centres, residual 7.0 µm"]


@pytest.mark.parametrize("page", [page for page in pages() if MARKED.search(page.text)], ids=lambda page: page.name)
def test_a_page_with_printed_blocks_has_the_commands_that_print_them(page: Page):
    assert without_installing(page.script).strip()


@pytest.mark.parametrize("page", [page for page in pages() if BY_TEST.search(page.text)], ids=lambda page: page.name)
def test_a_block_that_a_test_prints_is_compared_there(page: Page):
    for test, _ in BY_TEST.findall(page.text):
        assert f'not_printed("{page.name}", "{test}"' in (ROOT / test).read_text(encoding="utf-8")

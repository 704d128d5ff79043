"""A month with a cell, by the commands of the pages alone, in the fake cell.

    python benchmarks/month.py FOLDER [EVERY]    # FOLDER keeps the runs; EVERY: days from one with checks to the next, 1 if left out

Two checks a day, about ten minutes of processor time in all; on day 8 the scanner is hit, on day 15 a tool is changed, on day 18 a run is
interrupted and resumed, on day 21 the disk is full, on day 24 the folder is copied to another computer and used there, on day 27 a second
cell comes beside it. Prints a table of what was typed and said. Every draw of a day but the cell itself comes anew.
"""

from __future__ import annotations

import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[1]
MBCACQ = Path(sys.executable).parent / "mbcacq"
FAST = {"  speed": "1.0", "  scan_time_s": "0.1", "exposures": "1"}
HIT = {"name": "mount_shift", "at_pose": 0, "translation_mm": [0.15, -0.1, 0.05], "rotation_deg": [0.0, 0.02, 0.0]}
TOOL = {"name": "mount_shift", "at_pose": 0, "translation_mm": [0.9, 0.4, -0.3], "rotation_deg": [0.1, 0.05, 0.0]}
SMALL_DISK = "6m"


class Cell:
    """A folder with plans and runs, in which commands are typed. hidden: what has happened to the cell so far."""

    def __init__(self, desk: Path):
        self.desk, self.hidden, self.draw = desk, list[dict[str, object]](), 0
        shutil.copytree(ROOT / "plans", desk / "plans")
        text = (desk / "plans" / "kuka.yaml").read_text(encoding="utf-8")
        for key, value in FAST.items():
            text = re.sub(rf"^({key}:) [\d.]+", rf"\1 {value}", text, flags=re.MULTILINE)
        self.plan = text

    def today(self, seed: int = 0) -> None:
        """The plan of the next recording: the same cell, with the noise of another day."""
        self.draw += 1
        fake = yaml.safe_dump({"fake": {"seed": seed, "noise_seed": self.draw, "hidden": self.hidden}})
        (self.desk / "plans" / "kuka.yaml").write_text(f"{self.plan}\n{fake}", encoding="utf-8")

    def type(self, day: int, command: str, disk: str = "", until: Callable[[], bool] | None = None) -> tuple[int, str]:
        """Type a command; prints a row of the table. disk: a folder that is mounted as a small disk; until: press Ctrl-C once it is so."""
        began = time.perf_counter()
        words = [str(MBCACQ), *shlex.split(command)[1:]]
        if disk:
            mounted = f"mkdir -p {disk} && mount -t tmpfs -o size={SMALL_DISK} none {disk} && exec {shlex.join(words)}"
            words = ["unshare", "-Urm", "sh", "-c", mounted]
        with subprocess.Popen(
            words, cwd=self.desk, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, text=True
        ) as process:
            if until is not None:
                while process.poll() is None and not until():
                    time.sleep(0.2)
                process.send_signal(signal.SIGINT)
            said = process.communicate()[0]
        lines = said.splitlines()
        told = [line for line in lines if re.match(r"mbcacq: |As before|The cell changed|Calibrated|Passed|Not passed", line)]
        first = (told or lines or [""])[-1][:170].replace("|", "\\|")
        print(f"| {day} | `{command}` | {time.perf_counter() - began:.0f} | {process.returncode} | {first} |", flush=True)
        assert "Traceback" not in said, said
        return process.returncode, said


RUN, CHECK = "mbcacq run plans/kuka.yaml --dry-run", "mbcacq check runs/latest plans/kuka.yaml --dry-run --poses 6"


def changed(cell: Cell, day: int, what: dict[str, object]) -> None:
    """Something happened to the cell: the next check notices, and the arm is calibrated anew."""
    cell.hidden = [what]
    cell.today()
    assert cell.type(day, CHECK)[0] == 11, "a change is noticed on the same day"
    cell.today()
    assert cell.type(day, RUN)[0] == 0


def interrupted(cell: Cell, day: int) -> None:
    journal = cell.desk / "runs" / "interrupted" / "journal.jsonl"
    code, _ = cell.type(
        day, f"{RUN} --out runs/interrupted", until=lambda: journal.exists() and journal.read_text().count("pose_done") > 30
    )
    assert code != 0, "Ctrl-C stops a run"
    assert cell.type(day, "mbcacq run --resume runs/interrupted --dry-run")[0] == 0


def without_room(cell: Cell, day: int) -> None:
    assert cell.type(day, f"{RUN} --out small/run", disk="small")[0] != 0


def elsewhere(cell: Cell, day: int) -> None:
    there = cell.desk.parent / "elsewhere"
    shutil.copytree(cell.desk, there, symlinks=True)
    cell.desk = there
    assert cell.type(day, "mbcacq report latest")[0] == 0


def second_cell(cell: Cell, day: int) -> None:
    cell.today(seed=7)
    assert cell.type(day, f"{RUN} --out runs/cell-b")[0] == 0
    assert cell.type(day, CHECK.replace("runs/latest", "runs/cell-b"))[0] == 0
    cell.today()


def first_day(cell: Cell, day: int) -> None:
    assert cell.type(day, RUN)[0] == 0


DAYS: dict[int, Callable[[Cell, int], None]] = {
    1: first_day,
    8: lambda cell, day: changed(cell, day, HIT),
    15: lambda cell, day: changed(cell, day, TOOL),
    18: interrupted,
    21: without_room,
    24: elsewhere,
    27: second_cell,
}


def month(base: Path, every: int) -> None:
    """Thirty days in a folder."""
    cell = Cell(base / "desk")
    print("| day | typed | s | exit | said |\n|--:|---|--:|--:|---|")
    for day in range(1, 31):
        cell.today()
        if day in DAYS:
            DAYS[day](cell, day)
        for _ in ("morning", "night") if day in DAYS or day % every == 0 else ():
            cell.today()
            latest = max((cell.desk / "runs").glob("20*_kuka"))
            assert cell.type(day, CHECK.replace("runs/latest", f"runs/{latest.name}"))[0] == 0, f"nothing changed on day {day}"
    names = sorted(path.name for path in (cell.desk / "runs").glob("20*_kuka"))
    cell.type(30, f"mbcacq compare runs/{names[0]} runs/{names[-1]}")


def main() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell in the background leaves it ignored, and commands inherit that
    base = Path(sys.argv[1])
    base.mkdir(parents=True)
    month(base, int(sys.argv[2]) if len(sys.argv) > 2 else 1)


if __name__ == "__main__":
    main()

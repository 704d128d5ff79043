"""What is costly to make and only looked at, such as whole dry runs: made once, by the first process of the suite that needs it."""

import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock

ROOT = Path(__file__).resolve().parents[1]


def made_once(base: Path, name: str, make: Callable[[Path], None]) -> Path:
    """The folder ``base / name`` as ``make`` left it; nobody may change it. base: a folder that all processes of the suite share."""
    folder, complete = base / name, base / f"{name}.complete"
    with FileLock(base / f"{name}.lock"):
        if not complete.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            complete.touch()
    return folder


@dataclass(frozen=True)
class FinishedRun:
    """``desk``: the folder in which ``mbcacq run PLAN --dry-run`` was typed; ``folder``: that of the run."""

    desk: Path

    @property
    def folder(self) -> Path:
        return (self.desk / "runs" / "latest").resolve()

    @property
    def stdout(self) -> str:
        return (self.desk / "stdout").read_text()

    @property
    def stderr(self) -> str:
        return (self.desk / "stderr").read_text()


def at_full_speed(plan: Path, speed: float = 1.0, exposures: int = 1, scan_time_s: float = 0.1) -> None:
    """Change a plan to as many poses in less time: a fake controller sends a telegram each few ms, of a motion or of standing still."""
    text = plan.read_text(encoding="utf-8")
    for key, value in (("  speed", speed), ("  scan_time_s", scan_time_s), ("exposures", exposures)):
        text, changed = re.subn(rf"^({key}:) [\d.]+", rf"\1 {value}", text, flags=re.MULTILINE)
        assert changed == 1, f"{plan} has {key} {changed} times"
    plan.write_text(text, encoding="utf-8")


def dry_run(desk: Path, plan: str) -> None:
    """Type ``mbcacq run plans/PLAN --dry-run`` on a desk with the shipped plans; what takes long runs at full speed."""
    shutil.copytree(ROOT / "plans", desk / "plans")
    if plan == "kuka.yaml":
        at_full_speed(desk / "plans" / plan)
    elif plan == "concealed.yaml":  # its scanner warms up by the clock
        at_full_speed(desk / "plans" / plan, scan_time_s=1.0)
    typed(desk, "run", f"plans/{plan}", "--dry-run")


def diagnosed(desk: Path, run: FinishedRun) -> None:
    """Copy a finished run to a desk and type ``mbcacq diagnose latest --calibrate``."""
    shutil.copytree(run.desk / "runs", desk / "runs", symlinks=True)
    typed(desk, "diagnose", "latest", "--calibrate")


def typed(desk: Path, *words: str) -> None:
    """Type an mbcacq command on a desk, which keeps what it prints."""
    with (desk / "stdout").open("w") as out, (desk / "stderr").open("w") as err:
        command = [Path(sys.executable).parent / "mbcacq", *words]
        done = subprocess.run(command, cwd=desk, stdout=out, stderr=err, stdin=subprocess.DEVNULL, timeout=1150)
    assert done.returncode == 0, (desk / "stderr").read_text()

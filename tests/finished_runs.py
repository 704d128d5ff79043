"""What is costly to make and only looked at, such as whole dry runs: made once, by the first process of the suite that needs it."""

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


# The fake controller sends a telegram each 12 ms of a motion: at full speed there are a third as many, and as many poses.
AT_FULL_SPEED = (("speed: 0.3", "speed: 1.0"), ("exposures: 3", "exposures: 1"))


def dry_run(desk: Path, plan: str) -> None:
    """Type ``mbcacq run plans/PLAN --dry-run`` on a desk with the shipped plans; that of kuka.yaml runs at full speed."""
    shutil.copytree(ROOT / "plans", desk / "plans")
    for usual, faster in AT_FULL_SPEED if plan == "kuka.yaml" else ():
        text = (desk / "plans" / plan).read_text(encoding="utf-8")
        assert text.count(usual) == 1
        (desk / "plans" / plan).write_text(text.replace(usual, faster), encoding="utf-8")
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

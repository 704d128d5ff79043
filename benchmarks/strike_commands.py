"""The commands that ``command_strikes.py`` strikes: how each is called, and which of its files belong together."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from interrupted_runs import plan_file

ROOT = Path(__file__).parents[1]
JOINTS = "0,-90,90,0,30,0"
Work = Callable[[], object]


@dataclass(frozen=True)
class Case:
    """make(of, folder): the command of the data 'a' or 'b', writing into a folder. prepare: fills the folder before.

    sets: beginning of a file's name -> the set that it belongs to, '' for files that are none of its outputs; a file that none begins is of
    the one set. strikes: at most so many real runs of each kind. run_folder: it works on a run folder, whose checksums are compared.
    """

    make: Callable[[str, Path], Work]
    prepare: Callable[[Path], object] = lambda folder: None
    sets: dict[str, str] = field(default_factory=dict)
    strikes: int = 6
    run_folder: bool = False

    def set_of(self, name: str) -> str:
        """The set of a file, '' for one that is no output."""
        return next((of for begin, of in self.sets.items() if name.startswith(begin)), "all")


def command(*arguments: object) -> Work:
    """A command line of mbcacq, run in this process."""

    def work() -> object:
        from mbcacq.cli.app import app

        return app.main([str(a) for a in arguments])

    return work


def make_inputs(work: Path, run: Callable[[Work], int]) -> None:
    """Observation sets a and b, their results, a finished run, a torn one, and what else the commands take."""
    from mbcacq.calibration.sealed_json import sealed_text

    for seed, name in enumerate("ab"):
        assert run(command("simulate", ROOT / "plans" / "kuka.yaml", "--noise", "--seed", seed, "--out", work / name)) == 0
        for other in "ab"[seed:]:
            shutil.copytree(work / name, work / f"arms-{other}" / "arm" / name)
    assert run(command("calibrate", work / "a", "--out", work / "a.json")) == 0
    other = json.loads((work / "a.json").read_text())
    other["T_flange_scanner"][2][3] += 1.0
    for angle in range(6):
        other["robot"]["calibrated"]["theta"][angle] += 1e-4
    (work / "b.json").write_text(sealed_text(other))
    (work / "points.csv").write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n" + f"{JOINTS}\n" * 20)
    (work / "scan.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 2000\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        + "".join(f"{i % 50}.5 {i // 50}.25 {i % 7}.125\n" for i in range(2000))
    )
    print("ready for the commands on sets", flush=True)


def make_run(work: Path, run: Callable[[Work], int]) -> None:
    """A finished run of 16 poses, and one whose recording is torn in its middle."""
    assert run(command("run", plan_file(work), "--dry-run", "--out", work / "run")) == 0
    shutil.copytree(work / "run", work / "torn", ignore=shutil.ignore_patterns("result*", "report*"))
    data = (work / "torn" / "run.rrd").read_bytes()
    (work / "torn" / "run.rrd").write_bytes(data[: len(data) * 2 // 3])
    print("ready for the commands on runs", flush=True)


RUN_FILES = {"diagnosis": "diagnosis", "with-effects": "with-effects", "report.html": "report", "": ""}


def cases(work: Path) -> dict[str, Case]:
    """The commands by name."""
    force = ("--force", "--simulated-anyway")

    def copied(name: str) -> Callable[[Path], object]:
        return lambda folder: shutil.copytree(work / name, folder, dirs_exist_ok=True)

    def held(of: str) -> tuple[str, ...]:
        return ("--hold", "d_2", "--hold", "a_3") if of == "a" else ()

    return {
        "correct": Case(
            lambda of, f: command("correct", work / "points.csv", "--with", work / f"{of}.json", "--out", f / "points.csv", *force)
        ),
        "apply": Case(
            lambda of, f: command("apply", work / f"{of}.json", work / "scan.ply", f"--joints={JOINTS}", "--out", f / "s.ply", "--force")
        ),
        "export --results": Case(lambda of, f: command("export", work / f"{of}.json", "--results", f, *force)),
        "export --observations": Case(lambda of, f: command("export", work / of, "--observations", f, "--force")),
        "calibrate --out": Case(lambda of, f: command("calibrate", work / of, "--out", f / "result.json"), strikes=4),
        "report": Case(lambda of, f: command("report", work / of, "--out", f / "report.html"), strikes=4),
        "fleet": Case(
            lambda of, f: command("fleet", work / f"arms-{of}", "--out", f, "--workers", 1),
            sets={"fleet": "fleet", "recordings/a": "first", "recordings/b": "second", "": ""},
            strikes=3,
        ),
        "diagnose --calibrate": Case(
            lambda of, f: command("diagnose", f, "--workers", 1, "--calibrate", *held(of)),
            prepare=copied("run"),
            sets=RUN_FILES,
            strikes=3,
            run_folder=True,
        ),
        "diagnose --out --report --rrd": Case(
            lambda of, f: command(
                "diagnose", work / "run", "--workers", 1, *held(of), "--out", f / "d.json", "--report", f / "e.html", "--rrd", f / "g.rrd"
            ),
            sets={"d.json": "json", "e.html": "page", "g.rrd": "recording", "": ""},
            strikes=2,
        ),
        "recover": Case(
            lambda of, f: command("recover", f) if of == "b" else lambda: None,
            prepare=copied("torn"),
            sets={"run.recovered": "copy", "": ""},
            strikes=3,
            run_folder=True,
        ),
    }

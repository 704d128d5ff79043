"""Commands that replace what they wrote before from other data: how each is called, and which of its files belong together."""

from __future__ import annotations

import ctypes
import json
import random
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from bench import PLANS, changed_plan

from faults.preloaded import Work, command, in_child
from faults.small_run import two_stations
from faults.strikes import REPLAYED, Files, Struck

JOINTS = "0,-90,90,0,30,0"
DH_ROWS = "theta_deg,d_mm,a_mm,alpha_deg\n0,400,25,-90\n-90,0,455,0\n0,0,35,-90\n0,420,0,90\n0,0,0,-90\n"  # five of six
NEW_PLAN = ("plan", "new", "--robot", "kr6_r900_2", "--scanner", "gocator-3210", "--artefact", "mbc-8", "--poses", 6, "--stations", 2)
CHECKED = 6  # replayed moments of a run folder whose checksums are compared as well


@dataclass(frozen=True, kw_only=True)
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


def _make(work: Work) -> None:
    if code := in_child(work):
        raise SystemExit(f"exit code {code} while the inputs are made")


def _alter(step: int, plan: dict[str, Any]) -> None:
    """Another speed, which programs of poses state, and another port, which files of the controller state."""
    plan["robot"]["speed"] = 0.1 * (1 + step)
    plan["robot"]["options"]["port"] += step


def make_inputs(work: Path) -> None:
    """Observation sets a and b, their results, a finished run, a torn one, and what else the commands take."""
    from mbcacq.calibration.sealed_json import sealed_text

    for seed, name in enumerate("ab"):
        _make(command("simulate", PLANS / "kuka.yaml", "--noise", "--seed", seed, "--out", work / name))
        for other in "ab"[seed:]:
            shutil.copytree(work / name, work / f"arms-{other}" / "arm" / name)
    _make(command("calibrate", work / "a", "--out", work / "a.json"))
    other = json.loads((work / "a.json").read_text())
    other["T_flange_scanner"][2][3] += 1.0
    for angle in range(6):
        other["robot"]["calibrated"]["theta"][angle] += 1e-4
    (work / "b.json").write_text(sealed_text(other))
    for place, name in enumerate("ab"):
        changed_plan("quick.yaml", work / f"plan-{name}.yaml", partial(_alter, place))
        (work / f"hand-eye-{name}.csv").write_text(hand_eye_table(place))
        (work / f"rows-{name}.csv").write_text(f"{DH_ROWS}0,{80 + place},0,0\n")
    (work / "points.csv").write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n" + f"{JOINTS}\n" * 20)
    (work / "scan.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 2000\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        + "".join(f"{i % 50}.5 {i // 50}.25 {i % 7}.125\n" for i in range(2000))
    )
    print("ready for the commands on sets", flush=True)


def measure_checks(work: Path) -> None:
    """Two checks of the result a, in a simulated cell that is another one than the calibrated."""

    def simulate(plan: dict[str, Any]) -> None:
        for device in ("robot", "scanner"):
            plan[device] |= {"driver": "simulated", "options": {}}

    cell = changed_plan("quick.yaml", work / "check.yaml", simulate)
    for seed, name in enumerate("ab"):
        files = ("--history", work / "checks.json", "--out", work / f"check-{name}")
        _make(finding_changes(command("check", work / "a.json", cell, "--dry-run", "--seed", seed, *files)))


def finding_changes(check: Work) -> Work:
    """A check that ends well where it finds the cell changed."""

    def work() -> None:
        try:
            check()
        except SystemExit as end:
            if end.code != 11:
                raise

    return work


def copied_and_edited(plan: str, folder: Path) -> Work:
    """A plan's copy, and a line of the user's behind each of its files."""

    def work() -> None:
        from mbcacq.workflow.copy_plan import copy_plan

        for file in copy_plan(plan, folder):
            file.write_text(file.read_text() + "# mine\n")

    return work


def hand_eye_table(seed: int) -> str:
    """Twenty poses of the flange as a KUKA shows them (mm, deg), and of a target as the camera on it sees it (mm, quaternion)."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    from mbcacq.geometry import se3

    rng = np.random.default_rng(seed)
    xyz, abc = rng.uniform(-100, 100, (20, 3)) + [600, 0, 500], rng.uniform(-40, 40, (20, 3)) + [0, 90, 0]
    T_flange_camera, T_base_target = (
        se3.from_abc(np.array(at), np.radians(by)) for at, by in (([10, 20, 80], [5, 3, 90]), ([900, 0, 0], [0, 0, 0]))
    )
    target = se3.inverse(se3.from_abc(xyz, np.radians(abc)) @ T_flange_camera) @ T_base_target
    rows = np.column_stack([xyz, abc, target[:, :3, 3], Rotation.from_matrix(target[:, :3, :3]).as_quat()])
    head = "X,Y,Z,A,B,C,target_x_mm,target_y_mm,target_z_mm,target_qx,target_qy,target_qz,target_qw"
    return "\n".join([head, *(",".join(f"{value:.6f}" for value in row) for row in rows)]) + "\n"


def make_run(work: Path) -> None:
    """A finished run of 16 poses, and one whose recording is torn in its middle."""
    _make(command("run", two_stations(work), "--dry-run", "--out", work / "run"))
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

    def other(of: str) -> str:
        return "b" if of == "a" else "a"

    def held(of: str) -> tuple[str, ...]:
        return ("--hold", "d_2", "--hold", "a_3") if of == "a" else ()

    return {
        "correct": Case(
            make=lambda of, f: command("correct", work / "points.csv", "--with", work / f"{of}.json", "--out", f / "points.csv", *force)
        ),
        "apply": Case(
            make=lambda of, f: command(
                "apply", work / f"{of}.json", work / "scan.ply", f"--joints={JOINTS}", "--out", f / "s.ply", "--force"
            )
        ),
        "export --results": Case(make=lambda of, f: command("export", work / f"{of}.json", "--results", f, *force)),
        "export --observations": Case(make=lambda of, f: command("export", work / of, "--observations", f, "--force")),
        "calibrate --out": Case(make=lambda of, f: command("calibrate", work / of, "--out", f / "result.json"), strikes=4),
        "report": Case(make=lambda of, f: command("report", work / of, "--out", f / "report.html"), strikes=4),
        "fleet": Case(
            make=lambda of, f: command("fleet", work / f"arms-{of}", "--out", f, "--workers", 1),
            sets={"fleet": "fleet", "recordings/a": "first", "recordings/b": "second", "": ""},
            strikes=3,
        ),
        "diagnose --calibrate": Case(
            make=lambda of, f: command("diagnose", f, "--workers", 1, "--calibrate", *held(of)),
            prepare=copied("run"),
            sets=RUN_FILES,
            strikes=3,
            run_folder=True,
        ),
        "diagnose --out --report --rrd": Case(
            make=lambda of, f: command(
                "diagnose", work / "run", "--workers", 1, *held(of), "--out", f / "d.json", "--report", f / "e.html", "--rrd", f / "g.rrd"
            ),
            sets={"d.json": "json", "e.html": "page", "g.rrd": "recording", "": ""},
            strikes=2,
        ),
        "compare --report": Case(
            make=lambda of, f: command("compare", work / f"{of}.json", work / f"{other(of)}.json", "--report", f / "changes.html")
        ),
        "simulate": Case(
            make=lambda of, f: command("simulate", PLANS / "quick.yaml", "--noise", "--seed", "ab".index(of), "--out", f, "--force")
        ),
        "robot import": Case(
            make=lambda of, f: command(
                "robot", "import", work / f"rows-{of}.csv", "--convention", "standard", "--out", f / "arm.yaml", "--force"
            )
        ),
        "plan new": Case(make=lambda of, f: command(*NEW_PLAN, "--seed", "ab".index(of), "--out", f / "plan.yaml", "--force")),
        "plan copy": Case(
            make=lambda of, f: command("plan", "copy", "kuka", f, "--force") if of == "b" else copied_and_edited("kuka", f),
            sets={"robots/": "robot", "artefacts/mbc": "artefact", "artefacts/bar": "bar", "kuka.yaml": "plan"},
        ),
        "plan program": Case(
            make=lambda of, f: command("plan", "program", work / f"plan-{of}.yaml", "--for", "rapid", "--out", f, "--replace")
        ),
        "controller-files": Case(make=lambda of, f: command("controller-files", work / f"plan-{of}.yaml", "--out", f, "--replace")),
        "data new": Case(
            make=lambda of, f: command(
                "data", "new", work / f"hand-eye-{of}.csv", "--flange", "kuka", "--eye-in-hand", "--out", f, "--force"
            )
        ),
        "check --from": Case(
            make=lambda of, f: finding_changes(
                command("check", work / "a.json", work / "check.yaml", "--from", work / f"check-{of}", "--history", f / "history.json")
            ),
            prepare=lambda folder: measure_checks(work),
            sets={".run.lock": ""},
            strikes=3,
        ),
        "recover": Case(
            make=lambda of, f: command("recover", f) if of == "b" else lambda: None,
            prepare=copied("torn"),
            sets={"run.recovered": "copy", "": ""},
            strikes=3,
            run_folder=True,
        ),
    }


class ReplacedOutputs(Struck):
    """The command with data 'b' in a folder where it wrote from data 'a' before."""

    def __init__(self, name: str, case: Case, work: Path, library: ctypes.CDLL, moments: int) -> None:
        super().__init__(name, work, library, moments, (case.strikes, 2 * case.strikes))
        self._case, self._before, self._checked = case, work / "kept", False
        shutil.rmtree(self._before, ignore_errors=True)
        self._before.mkdir()
        case.prepare(self._before)
        _make(case.make("a", self._before))
        self._first = _content(self._before)
        self.record()
        self._second = _content(self.folder)
        assert self._sets(self._second) != self._sets(self._first), "both commands write the same"

    def fresh(self) -> Files:
        shutil.rmtree(self.folder, ignore_errors=True)
        shutil.copytree(self._before, self.folder)
        return self._first

    def begin(self) -> Work:
        return self._case.make("b", self.folder)

    def planned(self, rng: random.Random) -> list[tuple[str, int]]:
        out = super().planned(rng)
        moments = sorted({number for kind, number in out if kind in REPLAYED})
        self._with_checksums = set(rng.sample(moments, min(CHECKED, len(moments)))) if self._case.run_folder else set()
        return out

    def lay(self, files: Files, moment: int) -> None:
        """Only what is compared."""
        self._checked = moment in self._with_checksums
        super().lay({path: data for path, data in files.items() if self._checked or self._is_compared(path)}, moment)

    def _is_compared(self, path: str) -> bool:
        return bool(self._case.set_of(Path(path).name)) or any(part in path for part in (".part", "INCOMPLETE", "/"))

    def judged(self, code: int | None) -> str:
        """Some sets may be the old ones and others the new ones: 'between'. A full disk may not end in 0 where something is not new."""
        now = _content(self.folder)
        found = self._compared(now, replayed=code is None)
        if code == 0 and found != "new":
            return "neither: exit 0"
        if self._checked and code is None and not found.startswith("neither") and in_child(lambda: _refuse_faults(self.folder)):
            return "neither: checksums"
        return found

    def _compared(self, now: Files, *, replayed: bool) -> str:
        """replayed: what stands there was written by the recorded run, byte for byte."""
        there, old, new = (self._sets(files) for files in (now, self._first, self._second))
        ways = set()
        for group in sorted({*old, *new, *there}):
            a, b, c = old.get(group, {}), new.get(group, {}), there.get(group, {})
            if a == b == c:
                continue
            if c == a:
                ways.add("old")
            elif c == b or not replayed and set(c) == set(b) and all(data == b[n] or _is_whole(n, data) for n, data in c.items()):
                ways.add("new")
            else:
                return f"neither: {group}"
        return "between" if len(ways) > 1 else ways.pop() if ways else "new"

    def _sets(self, files: Files) -> dict[str, Files]:
        """Files by set."""
        out: dict[str, Files] = {}
        for name, data in files.items():
            if group := self._case.set_of(name):
                out.setdefault(group, {})[name] = data
        return out


def _content(folder: Path) -> Files:
    """Files of a folder without temporary ones, once the sets in it that were stopped are completed."""
    from mbcacq.files.atomic_write import finish_set

    for place in [folder, *(p for p in folder.rglob("*") if p.is_dir())]:
        finish_set(place)
    files = (p for p in sorted(folder.rglob("*")) if p.is_file() and not p.is_symlink())
    return {str(p.relative_to(folder)): p.read_bytes() for p in files if not p.name.endswith(".part") and ".part" not in str(p)}


def _refuse_faults(folder: Path) -> None:
    """Raises AssertionError where a file that a command made is not one that was noted."""
    from mbcacq.recording.rrd.checksums import is_version, read_versions

    for name, versions in read_versions(folder).items():
        if name.startswith(("diagnosis", "result.rrd", "run.recovered")) and (folder / name).exists():
            assert is_version(folder / name, versions), name


def _is_whole(name: str, data: bytes) -> bool:
    """Whether a file, whose bytes differ from run to run, is one to its end."""
    if name.endswith(".html"):
        return data.rstrip().endswith(b"</html>")
    if name.endswith(".rrd"):
        from mbcacq.recording.rrd import rerun_program

        with tempfile.NamedTemporaryFile(suffix=".rrd") as file:
            file.write(data)
            file.flush()
            return rerun_program.run(["rrd", "verify", file.name]).returncode == 0
    if name.endswith(".json"):
        return data.rstrip().endswith(b"}")
    return name.endswith((".parquet", ".svg")) and data[-4:] in (b"PAR1", b"svg>", b"vg>\n")

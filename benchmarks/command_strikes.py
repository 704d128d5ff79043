"""Kills, full disks and power cuts over the commands that write: what stands there afterwards is the old output or the new one, whole.

    python benchmarks/command_strikes.py [--strikes 20] [--seed 0] [--only correct,apply] [--write]

Each command replaces what it wrote from another recording. A strike is SIGKILL at the k-th file that is opened, renamed or removed (k drawn
among all of them), a file size limit at a byte drawn below the largest output (a disk that is full), or a power cut at a record drawn among
the writes, synchronisations and renames (see power_cut.py). Then the next command's first step (``finish_set``) is taken and every file is
compared. Linux, gcc.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from disturbed_run import preload
from power_cut import Disk, File, records

ROOT = Path(__file__).parents[1]
PAGE = Path(__file__).with_suffix(".md")
JOINTS = "0,-90,90,0,30,0"
KILLED = -int(signal.SIGKILL)
Files = dict[str, bytes]


def in_child(work: Callable[[], object]) -> int:
    """Exit code of the work in a process of its own, negative for a signal."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        nothing = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nothing, 1)
        os.dup2(nothing, 2)
        try:
            work()
            os._exit(0)
        except SystemExit as end:
            os._exit(int(end.code or 0))
        except BaseException:
            os._exit(99)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def command(*arguments: object) -> Callable[[], object]:
    def work() -> object:
        from mbcacq.cli.app import app

        return app.main([str(a) for a in arguments])

    return work


def content(folder: Path) -> Files:
    """Files of a folder without temporary ones, once a set that was stopped is completed."""
    from mbcacq.files.atomic_write import finish_set

    finish_set(folder)
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file() and not p.name.endswith(".part")}


def inputs(work: Path) -> dict[str, Callable[[str, Path], Callable[[], object]]]:
    """Commands by name: of the data 'a' or 'b', writing into a folder."""
    from mbcacq.calibration.sealed_json import sealed_text

    for seed, name in enumerate("ab"):
        simulate = ("simulate", ROOT / "plans" / "kuka.yaml", "--noise", "--seed", seed, "--out", work / name)
        assert in_child(command(*simulate)) == 0
    assert in_child(command("calibrate", work / "a", "--out", work / "a.json")) == 0
    other = json.loads((work / "a.json").read_text())
    other["T_flange_scanner"][2][3] += 1.0
    for angle in range(6):
        other["robot"]["calibrated"]["theta"][angle] += 1e-4
    (work / "b.json").write_text(sealed_text(other))
    print("ready", flush=True)
    (work / "points.csv").write_text("q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n" + f"{JOINTS}\n" * 20)
    (work / "scan.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 2000\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        + "".join(f"{i % 50}.5 {i // 50}.25 {i % 7}.125\n" for i in range(2000))
    )
    force = ("--force", "--simulated-anyway")
    return {
        "correct": lambda of, f: command("correct", work / "points.csv", "--with", work / f"{of}.json", "--out", f / "points.csv", *force),
        "apply": lambda of, f: command(
            "apply", work / f"{of}.json", work / "scan.ply", f"--joints={JOINTS}", "--out", f / "s.ply", "--force"
        ),
        "export --results": lambda of, f: command("export", work / f"{of}.json", "--results", f, *force),
        "export --observations": lambda of, f: command("export", work / of, "--observations", f, "--force"),
        "calibrate --out": lambda of, f: command("calibrate", work / of, "--out", f / "result.json"),
    }


def killed_at(number: int, folder: Path, work: Callable[[], object], count: list[int] | None = None) -> Callable[[], object]:
    """The work, which ends by SIGKILL at this event below the folder; count: gets how many there were."""

    def struck() -> object:
        left = number

        def hook(event: str, arguments: tuple) -> None:
            nonlocal left
            if event in ("open", "os.rename", "os.remove", "os.mkdir") and str(folder) in str(arguments[0]):
                left -= 1
                if left == 0:
                    os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(hook)
        try:
            return work()
        finally:
            if count is not None:
                (folder.parent / "count").write_text(str(number - left))

    return struck


def full_at(size: int, work: Callable[[], object]) -> Callable[[], object]:
    def struck() -> object:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))
        return work()

    return struck


def judged(now: Files, old: Files, new: Files) -> str:
    return "old" if now == old else "new" if now == new else "neither"


def strike(name: str, made: Callable, work: Path, strikes: int, rng: random.Random, library: object) -> Counter:
    """Outcomes of one command by (kind of strike, exit, what stood there)."""
    folder, kept = work / "out", work / "kept"
    for path in (folder, kept):
        shutil.rmtree(path, ignore_errors=True)
    kept.mkdir()
    assert in_child(made("a", kept)) == 0, name
    old = content(kept)

    def fresh() -> None:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(kept, folder)

    fresh()
    assert in_child(killed_at(1 << 60, folder, made("b", folder), [0])) == 0, name
    new, events = content(folder), int((work / "count").read_text())
    assert new != old, f"{name}: both recordings give the same"
    out: Counter = Counter()
    for _ in range(strikes):
        fresh()
        code = in_child(killed_at(rng.randint(1, events), folder, made("b", folder)))
        out["kill", "killed" if code == KILLED else code, judged(content(folder), old, new)] += 1
        fresh()
        code = in_child(full_at(rng.randint(0, max(map(len, new.values())) - 1), made("b", folder)))
        out["full disk", code, judged(content(folder), old, new)] += 1
    fresh()
    log = work / "log"
    log.unlink(missing_ok=True)

    def recorded() -> object:
        library.fault_record(str(folder).encode(), str(log).encode())
        return made("b", folder)()

    assert in_child(recorded) == 0, name
    found = list(records(log.read_bytes()))
    for _ in range(strikes):
        disk = Disk()
        disk.names = {path: File(bytearray(data), data) for path, data in old.items()}
        disk.durable_names = dict(disk.names)
        for record in found[: rng.randrange(len(found) + 1)]:
            disk.apply(record)
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        for path, data in disk.after_cut(rng if rng.random() < 0.5 else None).items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(data)
        out["power cut", "-", judged(content(folder), old, new)] += 1
    return out


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--strikes", type=int, default=20, help="of each kind, for each command")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="names of commands, with commas")
    parser.add_argument("--write", action="store_true", help=f"write the table into {PAGE.name}")
    given = parser.parse_args()
    library = preload()
    work = Path(tempfile.mkdtemp(prefix="strikes-"))
    commands = inputs(work)
    wanted = given.only.split(",") if given.only else list(commands)
    lines, bad = ["| command | strike | exit | old | new | neither |", "|---|---|---|---|---|---|"], 0
    for name in wanted:
        found = strike(name, commands[name], work, given.strikes, random.Random(given.seed), library)
        for kind, code in sorted({(kind, code) for kind, code, _ in found}, key=str):
            counts = [found[kind, code, what] for what in ("old", "new", "neither")]
            bad += counts[2]
            lines.append(f"| {name} | {kind} | {code} | " + " | ".join(str(n or "") for n in counts) + " |")
            print(lines[-1], flush=True)
    shutil.rmtree(work, ignore_errors=True)
    if given.write:
        head = PAGE.read_text(encoding="utf-8").partition("| command |")[0]
        PAGE.write_text(head + "\n".join(lines) + "\n", encoding="utf-8")
    print(f"{bad} neither")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())

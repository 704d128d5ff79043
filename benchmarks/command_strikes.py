"""Kills, full disks and power cuts over the commands that write: what stands there afterwards is the old output or the new one, whole.

    python benchmarks/command_strikes.py [--moments 400] [--seed 0] [--only correct,apply] [--write]

Each command replaces what it wrote from other data. Its writes, synchronisations and renames below the folder are recorded once
(``system_call_faults.c``), those of programs that it starts too, and replayed up to each moment: as the system has them (SIGKILL there),
and as a disk may hold them (a power cut: only what was synchronised, or unsynchronised blocks and names by chance; interrupted_runs.py).
Beside the replay the command is really run and killed at files that it opens, renames or removes, and with a disk that is full from its
n-th write on. Then the next command's first step (``finish_set``) is taken and every file is compared. Linux, gcc.
"""

from __future__ import annotations

import argparse
import errno
import os
import random
import shutil
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from disturbed_run import preload
from interrupted_runs import Disk, Record, records
from strike_commands import Case, Work, cases, make_inputs, make_run
from strike_sessions import Tools, sessions, strike_session

PAGE = Path(__file__).with_suffix(".md")
KILLED = -int(signal.SIGKILL)
CHECKED = 6  # replayed moments of a run folder whose checksums are compared as well
Files = dict[str, bytes]


def in_child(work: Work) -> int:
    """Exit code of the work in a process of its own, negative for a signal; 99 for an exception that is no end of a program."""
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


def content(folder: Path) -> Files:
    """Files of a folder without temporary ones, once the sets in it that were stopped are completed."""
    from mbcacq.files.atomic_write import finish_set

    for place in [folder, *(p for p in folder.rglob("*") if p.is_dir())]:
        finish_set(place)
    files = (p for p in sorted(folder.rglob("*")) if p.is_file() and not p.is_symlink())
    return {str(p.relative_to(folder)): p.read_bytes() for p in files if not p.name.endswith(".part") and ".part" not in str(p)}


def killed_at(number: int, folder: Path, work: Work, count: Path | None = None) -> Work:
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
                count.write_text(str(number - left))

    return struck


class Struck:
    """One command with the old and the new state of its folder."""

    def __init__(self, case: Case, work: Path, library: object) -> None:
        self.case, self.work, self.library = case, work, library
        self.folder, self.kept, self.log = work / "out", work / "kept", work / "log"
        shutil.rmtree(self.kept, ignore_errors=True)
        self.kept.mkdir()
        case.prepare(self.kept)
        code = in_child(case.make("a", self.kept))
        assert code == 0, code
        self.old = content(self.kept)
        self.fresh()
        self.log.unlink(missing_ok=True)
        code = in_child(self._recorded)
        assert code == 0, code
        self.new = content(self.folder)
        self.records = list(records(self.log.read_bytes()))
        assert self.outputs(self.new) != self.outputs(self.old), "both commands write the same"
        self.writes = sum(record.kind == "w" for record in self.records)

    def fresh(self) -> None:
        shutil.rmtree(self.folder, ignore_errors=True)
        shutil.copytree(self.kept, self.folder)

    def _recorded(self) -> object:
        self.library.fault_record(str(self.folder).encode(), str(self.log).encode())
        os.environ["FAULT_RECORD"] = f"{self.folder}|{self.log}"
        return self.case.make("b", self.folder)()

    def outputs(self, files: Files) -> dict[str, Files]:
        """Files by set."""
        out: dict[str, Files] = {}
        for name, data in files.items():
            if group := self.case.set_of(name):
                out.setdefault(group, {})[name] = data
        return out

    def judged(self, now: Files, *, replayed: bool) -> str:
        """'old', 'new', 'between' (some sets are the old ones, others the new ones), 'neither' with the name of a set."""
        there, old, new = (self.outputs(files) for files in (now, self.old, self.new))
        ways = set()
        for group in sorted({*old, *new, *there}):
            a, b, c = old.get(group, {}), new.get(group, {}), there.get(group, {})
            if a == b == c:
                continue
            if c == a:
                ways.add("old")
            elif c == b or not replayed and set(c) == set(b) and all(data == b[n] or is_whole(n, data) for n, data in c.items()):
                ways.add("new")
            else:
                return f"neither: {group}"
        return "between" if len(ways) > 1 else ways.pop() if ways else "new"

    def full_at(self, write: int) -> Work:
        def work() -> object:
            self.library.fault_below(str(self.folder).encode())
            self.library.fault_arm(b"write", write, errno.ENOSPC)
            return self.case.make("b", self.folder)()

        return work

    def replay(self, moments: Sequence[int], rng: random.Random) -> Counter:
        """Outcomes of kills and power cuts at moments among the records."""
        out: Counter = Counter()
        disk = Disk(self.old)
        done = 0
        checked = set(rng.sample(list(moments), min(CHECKED, len(moments)))) if self.case.run_folder else set()
        for moment in sorted(moments):
            for record in self.records[done:moment]:
                disk.apply(record)
            done = moment
            states = {
                "kill, replayed": {name: bytes(file.content) for name, file in disk.names.items()},
                "power cut, lost": disk.after_cut(None),
                "power cut, some kept": disk.after_cut(rng),
            }
            for kind, files in states.items():
                out[kind, "-", self._judged_on_disk(files, moment in checked)] += 1
        return out

    def _judged_on_disk(self, files: Files, checked: bool) -> str:
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        for path, data in files.items():
            if checked or self.case.set_of(Path(path).name) or ".part" in path or "INCOMPLETE" in path or "/" in path:
                (self.folder / path).parent.mkdir(parents=True, exist_ok=True)
                (self.folder / path).write_bytes(data)
        found = self.judged(content(self.folder), replayed=True)
        if checked and not found.startswith("neither") and in_child(lambda: refuse_faults(self.folder)):
            return "neither: checksums"
        return found


def refuse_faults(folder: Path) -> None:
    """Raises AssertionError where a file that a command made is not one that was noted."""
    from mbcacq.recording.rrd.checksums import is_version, read_versions

    for name, versions in read_versions(folder).items():
        if name.startswith(("diagnosis", "result.rrd", "run.recovered")) and (folder / name).exists():
            assert is_version(folder / name, versions), name


def is_whole(name: str, data: bytes) -> bool:
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


def drawn(moments: int, found: Sequence[Record], rng: random.Random) -> list[int]:
    """Moments among records: all, or those around synchronisations, renames and removals and a sample of the writes."""
    if len(found) < moments:
        return list(range(len(found) + 1))
    marked = {k for i, record in enumerate(found) if record.kind in "sruc" for k in (i, i + 1)}
    marked = set(rng.sample(sorted(marked), min(len(marked), moments)))
    rest = rng.sample(range(len(found) + 1), max(moments - len(marked), moments // 4))
    return sorted({*marked, *rest, len(found)})


def strike(name: str, case: Case, work: Path, moments: int, rng: random.Random, library: object) -> Counter:
    """Outcomes of one command by (kind of strike, exit, what stood there)."""
    struck = Struck(case, work, library)
    out = struck.replay(drawn(moments, struck.records, rng), rng)
    count = work / "count"
    struck.fresh()
    assert in_child(killed_at(1 << 60, struck.folder, case.make("b", struck.folder), count)) == 0, name
    events = int(count.read_text())
    for number in rng.sample(range(1, events + 1), min(case.strikes, events)):
        struck.fresh()
        code = in_child(killed_at(number, struck.folder, case.make("b", struck.folder)))
        out["kill", "killed" if code == KILLED else code, struck.judged(content(struck.folder), replayed=False)] += 1
    for write in sorted(rng.sample(range(struck.writes), min(2 * case.strikes, struck.writes))):
        struck.fresh()
        code = in_child(struck.full_at(write))
        found = struck.judged(content(struck.folder), replayed=False)
        out["full disk", code, "neither: exit 0" if code == 0 and found != "new" else "neither: foreign" if code in (1, 99) else found] += 1
    print(f"{name}: {len(struck.records)} records, {struck.writes} writes, {events} events", flush=True)
    return out


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moments", type=int, default=400, help="of each command, at which it is killed or the power cut in the replay")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="names of commands, with commas")
    parser.add_argument("--write", action="store_true", help=f"write the table into {PAGE.name}")
    given = parser.parse_args()
    library = preload()
    library.fault_below.argtypes = library.fault_record.argtypes[:1]
    place = tempfile.TemporaryDirectory(prefix="strikes-", dir="/dev/shm" if os.path.isdir("/dev/shm") else None)
    work = Path(place.name)
    commands, growing = cases(work), sessions(work)
    wanted = given.only.split(",") if given.only else [*commands, *growing]
    if any(name in commands for name in wanted):
        make_inputs(work, in_child)
    if any(name in commands and (commands[name].run_folder or "diagnose" in name) for name in wanted):
        make_run(work, in_child)
    lines, bad = ["| command | strike | exit | old | new | between | neither |", "|---|---|---|---|---|---|---|"], 0
    for name in wanted:
        rng = random.Random(f"{given.seed} {name}")
        if name in growing:
            moments = partial(drawn, rng=rng)
            found = strike_session(name, growing[name], work, moments, in_child, Tools(library, killed_at, rng))
        else:
            found = strike(name, commands[name], work, given.moments, rng, library)
        for kind, code in sorted({(kind, code) for kind, code, _ in found}, key=str):
            here = {what: n for (k, c, what), n in found.items() if (k, c) == (kind, code)}
            neither = {what: n for what, n in here.items() if what.startswith("neither")}
            counts = [here.get(what, 0) for what in ("old", "new", "between")] + [sum(neither.values())]
            bad += counts[3]
            lines.append(f"| {name} | {kind} | {code} | " + " | ".join(str(n or "") for n in counts) + " |")
            print(lines[-1], neither or "", flush=True)
    place.cleanup()
    if given.write:
        _write_table(lines)
    print(f"{bad} neither")
    return 1 if bad else 0


def _write_table(lines: list[str]) -> None:
    """Replace the table of the page; what stands behind it stays."""
    text = PAGE.read_text(encoding="utf-8")
    head, _, rest = text.partition("| command |")
    behind = rest.partition("\n\n")[2]
    PAGE.write_text(head + "\n".join(lines) + "\n" + (f"\n{behind}" if behind else ""), encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())

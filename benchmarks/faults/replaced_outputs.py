"""A command that replaces what it wrote before from other data: each set of its files is the old one or the new one."""

from __future__ import annotations

import ctypes
import random
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from faults.preloaded import Work, in_child
from faults.strikes import REPLAYED, Files, Struck

EACH = "each"
CHECKED = 6  # replayed moments of a run folder whose checksums are compared as well


@dataclass(frozen=True, kw_only=True)
class Case:
    """make(of, folder): the command of the data 'a' or 'b', writing into a folder. prepare: fills the folder before.

    sets: beginning of a file's name -> the set that it belongs to, '' for files that are none of its outputs, EACH where each is one by
    itself. A file whose name has none of these beginnings belongs to the one set. strikes: at most so many real runs of each kind.
    run_folder: it works on a run folder, whose checksums are compared. runs: it reads the simulated runs.
    """

    make: Callable[[str, Path], Work]
    prepare: Callable[[Path], object] = lambda folder: None
    sets: dict[str, str] = field(default_factory=dict)
    strikes: int = 6
    run_folder: bool = False
    runs: bool = False

    def set_of(self, name: str) -> str:
        """The set of a file, '' for one that is no output."""
        found = next((of for begin, of in self.sets.items() if name.startswith(begin)), "all")
        return name if found == EACH else found


class ReplacedOutputs(Struck):
    """The command with data 'b' in a folder where it wrote from data 'a' before."""

    def __init__(self, name: str, case: Case, work: Path, library: ctypes.CDLL, moments: int) -> None:
        super().__init__(name, work, library, moments, (case.strikes, 2 * case.strikes))
        self._case, self._before, self._checked = case, work / "kept", False
        shutil.rmtree(self._before, ignore_errors=True)
        self._before.mkdir()
        case.prepare(self._before)
        if code := in_child(case.make("a", self._before)):
            raise SystemExit(f"{name}: exit code {code} while the old files are made")
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
    ends = {".parquet": b"PAR1", ".svg": b"</svg>", ".pdf": b"%%EOF", ".png": b"IEND\xaeB`\x82", ".md": b"\n"}
    return data.endswith(ends.get(Path(name).suffix, b"\0no such end\0")) or name.endswith(".svg") and data.endswith(b"</svg>\n")

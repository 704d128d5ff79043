"""Mutated inputs for every parser of bytes from outside: one of our errors or a value, never anything else, in bounded memory.

    python benchmarks/fuzz.py [--only NAME ...] [--inputs N] [--minutes M] [--seed S] [--rounds R] [--keep DIR] [--totals FILE]
    python benchmarks/fuzz.py --grow [--only NAME ...]         # new inputs for tests/conformance/corpus, guided by coverage
    python benchmarks/fuzz.py --show FILE                      # the table of all that stands in a file of totals
    python benchmarks/fuzz.py --atheris NAME [--inputs N]      # guided by coverage in libFuzzer, where atheris is installed

Inputs are mutated from the valid inputs of a parser and its corpus. Prints for each parser: inputs, share that was accepted, inputs a
second of processor time, slowest input, growth of the process' memory, largest allocation of a thousand inputs under tracemalloc.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
import tracemalloc
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "tests" / "conformance")]

if "--atheris" in sys.argv:  # ours are instrumented while they are imported
    import atheris

    with atheris.instrument_imports(
        include=[
            "mbcacq_kuka",
            "mbcacq_gocator",
            "mbcacq_bus",
            "mbcacq.recording",
            "mbcacq.model.yaml_source",
            "mbcacq.exports",
            "mbcacq.files",
            "mbcacq.model",
            "mbcacq.spheres",
        ]
    ):
        from fuzz_targets import Target, targets
else:
    from fuzz_targets import Target, targets  # noqa: E402
from fuzz_corpus import corpus, write_corpus  # noqa: E402
from mutate import mutate  # noqa: E402

TRACED = 1000
MOST_S, MOST_MB = 20.0, 1024.0  # of processor time for one input, and of memory that all inputs of a parser make the process grow by
LONGEST = 2048  # bytes of an input in the corpus
OURS = tuple(str(HERE.parent / name) for name in ("mbcacq", "drivers"))
HEAD = "| parser | inputs | accepted | a second | slowest | memory | largest | faults |\n|---|---|---|---|---|---|---|---|"


@dataclass
class Outcome:
    """What came of the inputs of one parser. slowest: s; memory: MB; largest: bytes. faults: what was raised -> the first such input."""

    name: str
    seed: int
    inputs: int = 0
    accepted: int = 0
    seconds: float = 0.0
    slowest: float = 0.0
    memory: float = 0.0
    largest: int = 0
    faults: dict[str, bytes] = field(default_factory=dict)

    def row(self) -> str:
        return (
            f"| {self.name} | {self.inputs:,} | {100 * self.accepted / max(self.inputs, 1):.1f} % | {self.inputs / self.seconds:.0f} | "
            f"{1e3 * self.slowest:.0f} ms | {self.memory:+.0f} MB | {self.largest / 1024:.0f} KiB | {len(self.faults) or 'none'} |"
        )

    def note(self, totals: Path) -> None:
        with totals.open("a") as file:
            file.write(json.dumps(asdict(self) | {"faults": {key: data.decode("latin-1") for key, data in self.faults.items()}}) + "\n")

    def add(self, other: Outcome) -> None:
        self.inputs, self.accepted, self.seconds = self.inputs + other.inputs, self.accepted + other.accepted, self.seconds + other.seconds
        self.slowest, self.memory = max(self.slowest, other.slowest), max(self.memory, other.memory)
        self.largest, self.faults = max(self.largest, other.largest), {**other.faults, **self.faults}


def fuzz(target: Target, inputs: int, seconds: float, seed: int, keep: Path | None, traced: int = TRACED) -> Outcome:
    """Mutated inputs until there are so many or the time is over."""
    known = (*target.seeds, *corpus(target.name))
    rng = random.Random(f"{seed} {target.name}")
    for valid in known:
        target.run(valid)
    outcome = Outcome(target.name, seed, largest=trace(target, known, random.Random(f"{seed} {target.name} traced"), traced))
    gc.freeze()  # what was imported need not be looked at again
    gc.set_threshold(20_000, 50, 50)
    memory, began, run, clock = resident_MB(), time.process_time(), target.run, time.process_time
    start = began

    def too_long(*_: object) -> None:
        if clock() - start > MOST_S:
            raise TooLongError

    signal.signal(signal.SIGVTALRM, too_long)
    signal.setitimer(signal.ITIMER_VIRTUAL, 1.0, 1.0)
    while outcome.inputs < inputs and start - began < seconds:
        data = mutate(known[int(rng.random() * len(known))], known, rng)
        try:
            outcome.accepted += run(data)
        except (Exception, TooLongError) as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            key = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {str(error)[:100]}"
            if key.split(": ")[0] not in {k.split(": ")[0] for k in outcome.faults}:
                outcome.faults[key] = data
                if keep:
                    keep.mkdir(parents=True, exist_ok=True)
                    (keep / f"{target.name.replace(' ', '-')}-{seed}-{len(outcome.faults)}").write_bytes(data)
        outcome.inputs += 1
        now = clock()
        outcome.slowest = max(outcome.slowest, now - start)
        start = now
    signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
    outcome.seconds, outcome.memory = start - began, resident_MB() - memory
    if outcome.memory > MOST_MB:
        outcome.faults[f"memory grew by {outcome.memory:.0f} MB"] = b""
    return outcome


class TooLongError(BaseException):
    """An input takes longer than any may; no parser of a library that catches everything takes it for its own."""


def grow(target: Target, inputs: int, seed: int) -> None:
    """Add to the corpus what reaches a pair of successive lines of ours that no other input reaches; the shortest inputs are kept."""
    rng, known, found = random.Random(f"{seed} {target.name} grown"), [*target.seeds, *corpus(target.name)], {}
    for data in known:
        found[data] = arcs(target, data)
    reached = set().union(*found.values())
    for _ in range(inputs):
        data = mutate(rng.choice(known), known, rng)
        if len(data) <= LONGEST and not reached.issuperset(new := arcs(target, data)):
            known.append(data)
            found[data] = new
            reached |= new
    kept, covered = [], set().union(*(found[data] for data in target.seeds))
    for data in sorted(known, key=len):
        if not covered.issuperset(found[data]):
            covered |= found[data]
            kept.append(data)
    write_corpus(target.name, kept)
    print(f"| {target.name} | {len(reached)} | {len(kept)} |", flush=True)


def arcs(target: Target, data: bytes) -> set[tuple[object, int, int]]:
    """The pairs of successive lines of our own files that an input reaches."""
    found: set[tuple[object, int, int]] = set()

    def entered(frame, event, _):
        code, last = frame.f_code, 0
        if not code.co_filename.startswith(OURS):
            return None

        def line(frame, event, _):
            nonlocal last
            if event == "line":
                found.add((code, last, frame.f_lineno))
                last = frame.f_lineno
            return line

        return line

    sys.settrace(entered)
    try:
        target.run(data)
    except Exception:  # noqa: S110  what it raises is counted in the long run
        pass
    finally:
        sys.settrace(None)
    return found


def trace(target: Target, known: Sequence[bytes], rng: random.Random, inputs: int) -> int:
    """The largest number of bytes that one of these inputs had allocated at a time."""
    largest = 0
    tracemalloc.start()
    for _ in range(inputs):
        data = mutate(rng.choice(known), known, rng)
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        try:
            target.run(data)
        except Exception:
            continue  # counted in the long run
        largest = max(largest, tracemalloc.get_traced_memory()[1] - before)
    tracemalloc.stop()
    return largest


def bounded_memory() -> None:
    """No input may take the machine's memory: an allocation of more than twice what is allowed fails."""
    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    resource.setrlimit(resource.RLIMIT_AS, (used + int(2 * MOST_MB) * 2**20, resource.RLIM_INFINITY))


def quiet_libraries() -> None:
    """The reader of clouds writes every complaint to standard error by itself; ours goes to a copy of it."""
    sys.stderr = os.fdopen(os.dup(2), "w", buffering=1)
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def resident_MB() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def guided(name: str, inputs: int) -> None:
    """Ends the process by itself, as libFuzzer does."""
    target = targets()[name]

    def one(data: bytes) -> None:
        target.run(data)

    folder = Path(tempfile.mkdtemp(prefix="corpus-"))
    for number, seed in enumerate((*target.seeds, *corpus(name))):
        (folder / str(number)).write_bytes(seed)
    settings = [f"-runs={inputs}", "-max_len=4096", "-rss_limit_mb=4096", "-timeout=20", "-print_final_stats=1"]
    atheris.Setup([sys.argv[0], str(folder), *settings], one)
    atheris.Fuzz()


def noted(totals: Path) -> set[tuple[str, int]]:
    """Parser and seed of each line in a file of totals."""
    return {(entry["name"], entry["seed"]) for entry in map(json.loads, totals.read_text().splitlines())}


def show(totals: Path) -> None:
    """The table of all runs in a file of totals, the parsers in their order."""
    sums = {name: Outcome(name, 0) for name in targets()}
    for line in totals.read_text().splitlines():
        entry = json.loads(line)
        sums[entry["name"]].add(Outcome(**entry))
    print(HEAD)
    for outcome in sums.values():
        if outcome.inputs:
            print(outcome.row())
    print(f"| **all** | {sum(outcome.inputs for outcome in sums.values()):,} | | | | | | |")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=list(targets()), default=list(targets()), metavar="NAME")
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--minutes", type=float, default=1e9, help="processor time for each parser")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rounds", type=int, default=1, help="of successive seeds; those that stand in the file of totals are left out")
    parser.add_argument("--untraced", action="store_true", help="leave out the thousand inputs under tracemalloc, the slowest of all")
    parser.add_argument("--keep", type=Path, help="write inputs that break a parser here")
    parser.add_argument("--totals", type=Path, help="append a line for each parser")
    parser.add_argument("--show", type=Path)
    parser.add_argument("--grow", action="store_true")
    parser.add_argument("--atheris", metavar="NAME", choices=list(targets()))
    given = parser.parse_args()
    if given.atheris:
        guided(given.atheris, given.inputs)
    if given.show:
        show(given.show)
        return 0
    quiet_libraries()
    if given.grow:
        print("| parser | pairs of lines reached | inputs in the corpus |\n|---|---|---|")
        for name in given.only:
            grow(targets()[name], given.inputs, given.seed)
        return 0
    targets()
    bounded_memory()
    print(HEAD)
    faults = 0
    for seed, name in [(seed, name) for seed in range(given.seed, given.seed + given.rounds) for name in given.only]:
        if given.totals and given.totals.exists() and (name, seed) in noted(given.totals):
            continue  # a campaign that was stopped goes on
        outcome = fuzz(
            targets()[name], given.inputs, 60 * given.minutes, seed, given.keep, 0 if given.untraced or seed > given.seed else TRACED
        )
        print(outcome.row(), flush=True)
        for key, data in outcome.faults.items():
            print(f"    {key}\n        {data[:300]!r}", flush=True)
        faults += len(outcome.faults)
        if given.totals:
            outcome.note(given.totals)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())

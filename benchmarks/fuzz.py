"""A million inputs for every parser of bytes from outside: one of our errors or a value, never anything else, in bounded memory.

    python benchmarks/fuzz.py [--only NAME ...] [--inputs N] [--seed S] [--keep DIR]
    python benchmarks/fuzz.py --atheris NAME [--inputs N]      # guided by coverage, where atheris is installed

Prints for each parser: inputs, share that was accepted, inputs a second, slowest input, growth of the process' memory, largest
allocation of a thousand inputs under tracemalloc.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import sys
import tempfile
import time
import traceback
import tracemalloc
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
            "mbcacq.plan.yaml_source",
            "mbcacq.exports",
            "mbcacq.spheres.ply_header",
        ]
    ):
        from fuzz_targets import Target, targets
else:
    from fuzz_targets import Target, targets  # noqa: E402
from mutate import mutate  # noqa: E402

TRACED = 1000
SLOW_S = 2.0


def fuzz(target: Target, inputs: int, seed: int, keep: Path | None) -> bool:
    rng = random.Random(f"{seed} {target.name}")
    for valid in target.seeds:
        target.run(valid)
    largest = trace(target, random.Random(f"{seed} {target.name} traced"))
    memory, began, accepted, slowest, faults = resident_MB(), time.perf_counter(), 0, 0.0, {}
    for _ in range(inputs):
        data = mutate(target.seeds[int(rng.random() * len(target.seeds))], target.seeds, rng)
        start = time.perf_counter()
        try:
            accepted += target.run(data)
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            key = f"{type(error).__name__} at {Path(place.filename).name}:{place.lineno}: {str(error)[:100]}"
            if key.split(": ")[0] not in {k.split(": ")[0] for k in faults}:
                faults[key] = data
                if keep:
                    keep.mkdir(parents=True, exist_ok=True)
                    (keep / f"{target.name.replace(' ', '-')}-{len(faults)}").write_bytes(data)
        slowest = max(slowest, time.perf_counter() - start)
    seconds = time.perf_counter() - began
    print(
        f"| {target.name} | {inputs} | {100 * accepted / inputs:.1f} % | {inputs / seconds:.0f} | {1e3 * slowest:.0f} ms | "
        f"{resident_MB() - memory:+.0f} MB | {largest / 1024:.0f} KiB | {len(faults) or 'none'} |",
        flush=True,
    )
    for key, data in faults.items():
        print(f"    {key}\n        {data[:300]!r}", flush=True)
    return not faults


def trace(target: Target, rng: random.Random) -> int:
    """The largest number of bytes that one of a thousand inputs had allocated at a time."""
    largest = 0
    tracemalloc.start()
    for _ in range(TRACED):
        data = mutate(rng.choice(target.seeds), target.seeds, rng)
        tracemalloc.reset_peak()
        before = tracemalloc.get_traced_memory()[0]
        try:
            target.run(data)
        except Exception:
            continue  # counted in the long run
        largest = max(largest, tracemalloc.get_traced_memory()[1] - before)
    tracemalloc.stop()
    return largest


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

    corpus = Path(tempfile.mkdtemp(prefix="corpus-"))
    for number, seed in enumerate(target.seeds):
        (corpus / str(number)).write_bytes(seed)
    settings = [f"-runs={inputs}", "-max_len=4096", "-rss_limit_mb=4096", "-timeout=20", "-print_final_stats=1"]
    atheris.Setup([sys.argv[0], str(corpus), *settings], one)
    atheris.Fuzz()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=list(targets()), default=list(targets()), metavar="NAME")
    parser.add_argument("--inputs", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="write inputs that break a parser here")
    parser.add_argument("--atheris", metavar="NAME", choices=list(targets()))
    given = parser.parse_args()
    if given.atheris:
        guided(given.atheris, given.inputs)
    quiet_libraries()
    print("| parser | inputs | accepted | a second | slowest | memory | largest | faults |\n|---|---|---|---|---|---|---|---|")
    good = [fuzz(targets()[name], given.inputs, given.seed, given.keep) for name in given.only]
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())

"""A fault at a system call of a run, and steps of the clock."""

from __future__ import annotations

import argparse
import errno
import random
import time
from collections import Counter

from bench import Kept, counted

from faults.preloaded import preload
from faults.small_run import CYCLE, DisturbedRuns, Fault

ERRNOS = {
    "open": ("EMFILE", "ENFILE", "EACCES", "ENOSPC", "EIO", "ENOMEM", "EINTR"),
    "read": ("EIO", "EINTR", "ENOMEM"),
    "write": ("ENOSPC", "EIO", "EDQUOT", "EINTR", "EPIPE"),
    "fsync": ("EIO", "ENOSPC", "EINTR"),
    "rename": ("EIO", "ENOSPC", "EACCES"),
    "unlink": ("EIO", "EACCES"),
    "mkdir": ("ENOSPC", "EACCES"),
    "stat": ("EIO", "EACCES", "ENOMEM"),
    "ftruncate": ("EIO", "ENOSPC"),
    "mmap": ("ENOMEM",),
    "alloc": ("ENOMEM",),
    "socket": ("EMFILE", "ENOBUFS", "EACCES"),
    "connect": ("ECONNREFUSED", "ETIMEDOUT", "ENETUNREACH", "EINTR"),
    "bind": ("EADDRINUSE", "EACCES"),
    "send": ("EPIPE", "ECONNRESET", "ENOBUFS", "ENETUNREACH", "EINTR"),
    "recv": ("ECONNRESET", "ENOMEM", "EINTR"),
    "poll": ("ENOMEM", "EINTR"),
    "pipe": ("EMFILE",),
}


CYCLE_CALLS = ("read", "write", "send", "recv", "poll", "mmap", "open", "socket", "bind")  # 400 of each are drawn from


def drawn_faults(runs: DisturbedRuns, rng: random.Random, only: list[str], cycle: bool):
    """Endless: one call after the other, n and errno drawn."""
    counts = dict.fromkeys(CYCLE_CALLS, 400) if cycle else runs.counts
    calls = [call for call in ERRNOS if call in only and counts.get(call)]
    while True:
        for call in calls:
            n, error = rng.randrange(counts[call]), rng.choice(ERRNOS[call])
            yield Fault(call, n, getattr(errno, error), CYCLE if cycle else "")


def clock_steps(runs: DisturbedRuns, cases: int) -> int:
    """The clock of the day jumps forwards and backwards at each pose."""
    from mbcacq.acquisition.events import PoseReached

    bad = 0
    for case in range(cases):
        step, at = (3600, -3600)[case % 2], case // 2 % len(runs.poses)

        def jump(event: object, step: int = step, at: int = at) -> None:
            if isinstance(event, PoseReached) and event.pose == at:
                runs.library.fault_clock(step)

        ending = runs.run(lambda: None, runs.work / f"clock{case}", False, [jump])
        bad += bool(ending.wrong) or ending.how != "goes on"
        print(f"clock {step:+} s at pose {at}: {ending.how} {ending.detail} {'; '.join(ending.wrong)}", flush=True)
    print(f"{cases} runs, {bad} not good")
    return bad


def print_table(cases: list[dict]) -> int:
    """Returns whether any case is not good."""
    table = Counter((case["call"], case["errno"], case["how"]) for case in cases)
    ways = sorted({how for *_, how in table})
    print("", *counted(table, ["call", "errno"], ways, lambda key: (list(ERRNOS).index(key[0]), key[1])), sep="\n")
    bad = sum(case["bad"] for case in cases)
    print(f"\n{len(cases)} cases, {bad} not good, {sum(case['seconds'] for case in cases):.0f} s")
    return 1 if bad else 0


def system_calls(given: argparse.Namespace) -> int:
    """A fault at a system call of a run: does it go on or end named, does the arm rest, can the folder be resumed?

    A run of three poses is repeated. In each repetition the n-th call of one function of the C library (open, write, fsync, ..., an
    allocation above 1 MiB) fails with one errno that it may have. Calls are taken in turn, n and errno are drawn with the seed. --cycle: in
    the process that answers the controller. --kept: every case is added to this file at once, those in it are not repeated. --clock: the
    clock of the day jumps by an hour in the middle, in place of faults. Linux, gcc.
    """
    runs, began = DisturbedRuns(preload()), time.monotonic()
    print("calls of an undisturbed run: " + ", ".join(f"{n} {call}" for call, n in runs.counts.items() if n), flush=True)
    if given.clock:
        return 1 if clock_steps(runs, given.cases) else 0
    kept = Kept(given.kept)
    for case, fault in enumerate(drawn_faults(runs, random.Random(given.seed), given.only, given.cycle)):
        if case >= given.cases or time.monotonic() - began > 60 * given.minutes:
            break
        if case < len(kept.rows):
            continue
        ending = runs.disturbed(fault, resume=case % 4 == 0)
        how = ending.how if ending.struck or fault.role or ending.how != "goes on" else "not reached"
        bad = bool(ending.wrong) or how == "foreign error"
        named = {"call": fault.call, "n": fault.n, "errno": errno.errorcode[fault.error]}
        result = {"how": how, "seconds": ending.seconds, "bad": bad}
        kept.add(named | result | {"detail": ending.detail, "wrong": ending.wrong})
        if bad or how.startswith("killed"):
            print(f"  {fault}: {how}: {ending.detail}; {'; '.join(ending.wrong)}", flush=True)
    runs.close()
    return print_table(kept.rows)

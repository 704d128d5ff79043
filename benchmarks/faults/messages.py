"""A fault at every message of every driver, and of a whole run."""

from __future__ import annotations

import argparse
import json
import random
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

from bench import TESTS

sys.path.insert(0, str(TESTS / "conformance"))

from benches import BENCHES  # noqa: E402
from whole_run import BUSES, WholeRun  # noqa: E402

from mbcacq.conformance import Case, InjectionVerdict, cases, inject, survey  # noqa: E402
from mbcacq.conformance.faults import ACTIONS, FLIP  # noqa: E402

WHOLE = {"whole run": "", f"whole run over {BUSES}": BUSES}
NAMES = [*(name for name in BENCHES if name != "manual"), *WHOLE]


def drawn(counts: Mapping[tuple[str, Any], int], number: int, seed: int, actions: tuple[str, ...]) -> Iterator[Case]:
    """So many faults at messages drawn at random, each link and sender as likely as any other."""
    rng, links = random.Random(seed), [link for link, count in sorted(counts.items()) if count]
    for _ in range(number):
        link, sender = rng.choice(links)
        yield Case(link, sender, rng.randrange(counts[link, sender]), rng.choice(actions))


def examine(name: str, most: int, draw: int = 0, seed: int = 0, flip: bool = False) -> list[InjectionVerdict]:
    verdicts: list[InjectionVerdict] = []
    if name in WHOLE:
        run = WholeRun(WHOLE[name])
        counts, one = run.counts, run.inject
    else:
        counts, one = survey(BENCHES[name]), partial(inject, BENCHES[name])
    began = time.monotonic()
    actions = (FLIP,) if flip else ACTIONS
    for number, case in enumerate(drawn(counts, draw, seed, actions) if draw else cases(counts, most, actions)):
        verdict = one(case, seed=seed + number) if flip and name not in WHOLE else one(case)
        verdicts.append(verdict)
        if not verdict.good:
            print(f"  NOT GOOD: {name}: {case}: {verdict.result}: {verdict.detail}", flush=True)
    if name in WHOLE:
        run.close()
    slowest = max((v.seconds for v in verdicts), default=0.0)
    print(
        f"\n{name}: {len(verdicts)} cases in {time.monotonic() - began:.0f} s, slowest {slowest:.1f} s; undisturbed messages: "
        + ", ".join(f"{link} {sender} {n}" for (link, sender), n in counts.items()),
        flush=True,
    )
    table(verdicts)
    return verdicts


def table(verdicts: list[InjectionVerdict]) -> None:
    results = sorted(
        {v.result for v in verdicts},
        key=lambda r: ("recovered", "named error", "not reached").index(r) if r in ("recovered", "named error", "not reached") else 9,
    )
    print("| fault | " + " | ".join(results) + " |\n|---|" + "---|" * len(results))
    for action in (*ACTIONS, FLIP):
        if count := Counter(v.result for v in verdicts if v.case.action == action):
            print(f"| {action} | " + " | ".join(str(count[r]) for r in results) + " |")
    errors = Counter(v.detail.split(":")[0] for v in verdicts if v.result == "named error")
    print("errors: " + (", ".join(f"{n} {name}" for name, n in errors.most_common()) or "none"), flush=True)


def messages(given: argparse.Namespace) -> int:
    """Every fault at every protocol step, for every driver: a named error or a recovery, a robot at rest, no hang, no wrong result.

    A man in the middle hurts one message of a small piece of work (connect, use twice, close): drop, delay, truncate, duplicate, garbage,
    close; with --flip one bit is flipped. Afterwards the device must rest and the next driver must work. 'whole run' does the same to a run
    of a small plan: its recording must be readable, and every centre in it that of the undisturbed run. Prints a table a driver, and every
    case that is not good.
    """
    found = {name: examine(name, given.most, given.draw, given.seed, given.flip) for name in given.only}
    if given.json:
        given.json.write_text(
            json.dumps(
                [
                    {"bench": name, "case": str(v.case), "result": v.result, "detail": v.detail, "seconds": v.seconds}
                    for name, verdicts in found.items()
                    for v in verdicts
                ],
                indent=0,
            )
        )
    bad = [v for verdicts in found.values() for v in verdicts if not v.good]
    total = sum(map(len, found.values()))
    print(f"\n{total} cases, {total - len(bad)} good, {len(bad)} not good")
    return 1 if bad else 0

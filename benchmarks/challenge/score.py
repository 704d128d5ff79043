"""Effects injected in simulated cells and diagnosed without knowledge of them: the score table."""

from __future__ import annotations

import argparse
import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial

import numpy as np
from bench import HERE, PLANS, Kept, put, table, wilson
from detection_power import PowerCell, evidence_of, ninety_percent_point, search_multiple, try_cell, with_interval
from statements import contradictions

from mbcacq.challenge import simulated_cells
from mbcacq.challenge.run import _begin, _take
from mbcacq.challenge.scenarios import Scenario, draw, kinds
from mbcacq.challenge.score import Score
from mbcacq.challenge.table import COLUMNS, row, text
from mbcacq.diagnosis.result import Diagnosis

# part: title, seed, effects, how many, share of outliers, missing columns

PARTS = {
    "catalogue": ("Effects of the catalogue", 5700, "catalogue", 304, 0.0, ()),
    "outside": ("Effects outside the catalogue", 8800, "outside", 108, 0.0, ()),
    "clean": ("Cells with nothing injected", 9900, "none", 300, 0.0, ()),
    "outliers": ("1 % gross outliers", 6000, "catalogue,none", 51, 0.01, ()),
    "missing": ("No times, temperatures, senses of motion", 6100, "catalogue,none", 42, 0.0, ("time_s", "temperature", "direction")),
    "two": ("Two effects at once", 6200, "two", 32, 0.0, ()),
}


POWER = ("joint_compliance", "joint_scale", "backlash", "gear_transmission_error", "mount_shift", "ball_shift")
MULTIPLES = (0.8, 1.0, 1.2, 1.4, 1.7)
LEAST = (10.0, 5.0, 3.0, 2.0, 1.5, 1.0)  # e-values
CELLS = 40
POWER_TEXT = """
Strength at which nine in ten effects are named at their location, over the strength that a likelihood-ratio test (level 1 %) needs. The \
test knows name and place and estimates the rest. Last column: the ratio for an ideal search \
without that knowledge, at 2 % false alarms.
"""
FALSE_ALARMS = 0.02  # of the best search


def measured(measure: Callable, todo: list, jobs: int) -> Iterator[tuple]:
    """Each job with what comes of it in one of so many processes, which know the challenger, in their order."""
    with ProcessPoolExecutor(jobs, initializer=_begin, initargs=(PLANS / "seeing.yaml", False, None)) as pool:
        yield from zip(todo, pool.map(measure, todo), strict=True)


def measure_part(part: str, share: float, jobs: int, kept: Kept) -> None:
    _, seed, effects, count, outliers, missing = PARTS[part]
    done = {r["number"] for r in kept.rows if r["part"] == part}
    names = kinds(effects, missing)
    wanted = max(int(round(share * count)), 1)
    todo = [e for e in draw(seed, wanted, names, outliers, missing) if e.number not in done]
    for scenario, outcome in measured(_take, todo, jobs):
        record = {"part": part, "number": scenario.number, "seconds": outcome.seconds, "score": outcome.score.to_dict(), "code": CODE}
        kept.add({**record, "contradictions": contradictions(Diagnosis.from_json(outcome.diagnosis))})


def measure_power(share: float, jobs: int, kept: Kept) -> None:
    done = {(r["effect"], r["cell"]) for r in kept.rows if r["part"] == "power"}
    cells = [91000 + 17 * i for i in range(max(int(round(share * CELLS)), 1))]
    todo = [(name, cell) for cell in cells for name in POWER if (name, cell) not in done]
    for (name, cell), one in measured(_power, todo, jobs):
        kept.add({"part": "power", "effect": name, "cell": cell, **asdict(one), "code": CODE})


def _power(job: tuple[str, int]) -> PowerCell:
    from mbcacq.challenge import run

    return try_cell(run._challenger, *job, MULTIPLES)


def measure_e_values(share: float, jobs: int, kept: Kept) -> None:
    """Rates of the clean cells."""
    _, seed, effects, count, *_ = PARTS["clean"]
    done = {r["number"] for r in kept.rows if r["part"] == "e-values"}
    todo = [s for s in draw(seed, max(int(round(share * count)), 1), kinds(effects)) if s.number not in done]
    for scenario, value in measured(_log_e_value, todo, jobs):
        kept.add({"part": "e-values", "number": scenario.number, "log_e_value": value, "code": CODE})


def _log_e_value(scenario: Scenario) -> float:
    from mbcacq.challenge import run

    return evidence_of(simulated_cells.observe(run._challenger.loaded, run._challenger.poses, scenario, [])[0]).log_e_value


def code() -> str:
    """Commit of the code that is measured, where it is a checkout."""
    answer = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=HERE, capture_output=True, text=True, check=False)
    return answer.stdout.strip() or "unknown"


CODE = code()


HEADS = ("cells", "challenges", "named and placed, located, or false alarms", *COLUMNS[6:9])


def score_page(kept: list[dict]) -> str:
    lines = []
    for part, (title, *_rest) in PARTS.items():
        mine = [r for r in kept if r["part"] == part]
        if mine:
            scores = [Score(**r["score"]) for r in mine]
            every = row(title, scores)
            rates = [text(every[column]) for column in COLUMNS[6:9]]
            lines.append([title[0].lower() + title[1:], len(mine), bounds(part, scores), *rates])
    return "\n".join(table(HEADS, lines) + power_lines(kept))


def bounds(part: str, scores: list[Score]) -> str:
    """The rate that matters in this part, with its 95 % interval (Wilson)."""
    count = [s for s in scores if s.counts]
    clean = [s.detected for s in scores if not s.truth]
    yes = {"clean": clean, "outside": [s.located for s in count]}.get(part, [s.placed for s in count])
    low, high = wilson(sum(yes), len(yes)) if yes else (0.0, 100.0)
    return f"{sum(yes)} of {len(yes)} ({low:.1f} to {high:.1f} %)"


def not_right(kept: list[dict]) -> list[str]:
    """A line for each challenge of which the diagnosis is not right, and for those that contradict themselves."""
    lines = []
    for part, (title, *_rest) in PARTS.items():
        mine = [r for r in kept if r["part"] == part]
        said = failures(mine, [Score(**r["score"]) for r in mine])
        said += against_itself([r["contradictions"] for r in mine if "contradictions" in r])
        lines += [f"{title}: {one}" for one in said if one]
    return lines


def against_itself(each: list[list[str]]) -> list[str]:
    """How many diagnoses contradict themselves, and how (``benchmarks/statements.py``)."""
    if not each:
        return []
    said = [f"- {one}" for some in each for one in some]
    return [f"Contradict themselves: {sum(map(bool, each))} of {len(each)} diagnoses.", "", *said, *([""] if said else [])]


def failures(records: list[dict], scores: list[Score]) -> list[str]:
    bad = [
        (r, s)
        for r, s in zip(records, scores, strict=True)
        if (s.counts and not (s.placed or s.located and s.kind in kinds("outside") and not s.confident)) or (not s.truth and s.detected)
    ]
    return [
        f"number {r['number']}: {', '.join(s.truth) or 'nothing'} ({100 * s.achievable:.0f} % to gain) was reported as "
        f"{', '.join(s.reported) or 'nothing'}, {s.verdict}"
        for r, s in bad
    ]


def power_lines(kept: list[dict]) -> list[str]:
    mine = [r for r in kept if r["part"] == "power"]
    rows = []
    for name in POWER:
        cells = [r for r in mine if r["effect"] == name]
        if cells:
            found, known = (np.array([r[which] for r in cells], dtype=bool) for which in ("found", "estimating"))
            best = np.median([search_multiple(r["coefficients"], r["share"], FALSE_ALARMS) for r in cells])
            rows.append([name, against(found, known), f"{best:.2f}"])
    return [POWER_TEXT, *table(["effect", "ratio (95 %)", "best search"], rows)] if rows else []


def thresholds(kept: list[dict]) -> list[str]:
    """Lines: what another least e-value would have given, in clean cells and in strengths."""
    clean = np.array([r["log_e_value"] for r in kept if r["part"] == "e-values"])
    power = [r for r in kept if r["part"] == "power"]
    names = [name for name in POWER if any(r["effect"] == name for r in power)]
    lines = []
    for least in np.log(LEAST) if len(clean) else ():
        found = [np.array([r["log_e_values"] for r in power if r["effect"] == name]) > least for name in names]
        points = ", ".join(f"{name} {ninety_percent_point(MULTIPLES, each):.2f}" for name, each in zip(names, found, strict=True))
        lines.append(f"e-value above {np.exp(least):g}: {np.sum(clean > least)} of {len(clean)} clean; nine in ten at {points}")
    return lines


def against(found: np.ndarray, known: np.ndarray) -> str:
    """The ratio to a test that knows more, of where each finds nine in ten."""
    # who must estimate the noise cannot need less than who knows it
    ratio, low, high = with_interval(
        lambda cells: ninety_percent_point(MULTIPLES, found[cells]) / max(ninety_percent_point(MULTIPLES, known[cells]), 1.0), len(found)
    )
    return f"{ratio:.2f} ({low:.2f} to {high:.2f})"


OTHERS = {"power": measure_power, "e-values": measure_e_values}


def score(given: argparse.Namespace) -> None:
    """Score table of the diagnosis: effects injected in simulated cells, diagnosed without knowledge of them.

    Hours in two processes; --share 0.3 takes a third of it.
    """
    kept = Kept(given.kept)
    for part in given.only:
        OTHERS.get(part, partial(measure_part, part))(given.share, given.jobs, kept)
        put(given.out, score_page(kept.rows))
    print(*not_right(kept.rows), *thresholds(kept.rows), sep="\n")
    print(row("all", [Score(**r["score"]) for r in kept.rows if "score" in r]))

"""Effects injected in simulated cells and diagnosed without knowledge of them: the score table."""

from __future__ import annotations

import argparse
import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial

import numpy as np
from bench import HERE, PLANS, Kept, put, wilson
from detection_power import PowerCell, evidence_of, ninety_percent_point, search_multiple, try_cell, with_interval
from statements import contradictions

from mbcacq.challenge import simulated_cells
from mbcacq.challenge.run import _begin, _take
from mbcacq.challenge.scenarios import NONE, Scenario, draw, kinds
from mbcacq.challenge.score import Score
from mbcacq.challenge.table import markdown, row, summary
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
Share of cells in which the diagnosis names the effect at its location (or as one of two that it cannot tell apart). In brackets are the
shares in which two likelihood-ratio tests (level 1 %) find it on the same recordings. Both tests know name and location and estimate the
noise; one knows order and moment too, and the other estimates them with the other parameters. Strengths are multiples of that at which a
test that knew the noise as well would find nine in ten. Further columns say where each finds nine in ten (the most likely cumulative
normal), and the ratio to either test (95 % interval by drawing cells again). The last two are the ratio to the first test that the best
test needs which knows nothing (median of the cells). It has 2 % or 0.5 % false alarms, shared by all places of all effects and there by
orders and moments.""".splitlines()


RATES = (0.02, 0.005)  # false alarms of the best search
E_VALUE_TEXT = """
False alarms and power by the same recordings, for other least e-values. The columns are the clean cells above it, and the multiple of the
strength for the informed test at which nine in ten effects are reported. Below the e-value in use, the effects counted are those in the
most probable set.""".splitlines()


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


def score_page(kept: list[dict]) -> str:
    lines = list[str]()
    for part, (title, seed, effects, *_rest) in PARTS.items():
        mine = [r for r in kept if r["part"] == part]
        if not mine:
            continue
        scores = [Score(**r["score"]) for r in mine]
        rows = [each for each in summary(scores) if each["kind"] == NONE or each["kind"].startswith("all")]
        seconds = np.array([r["seconds"] for r in mine])
        took = f"a diagnosis took {np.median(seconds):.1f} s in the median, {seconds.max():.1f} s at most, beside other work"
        commits = ", ".join(dict.fromkeys(r.get("code", "unknown") for r in mine))
        lines += [f"## {title}", "", f"{len(mine)} challenges, seed {seed}, {effects}, code {commits}; {took}.", "", markdown(rows), ""]
        lines += bounds(part, scores)
        lines += failures(mine, scores)
        lines += against_itself([r["contradictions"] for r in mine if "contradictions" in r])
    return "\n".join(lines + power_lines(kept))


def bounds(part: str, scores: list[Score]) -> list[str]:
    """95 % bounds (Wilson) of the rate that matters in this part."""
    count = [s for s in scores if s.counts]
    clean = [s.detected for s in scores if not s.truth]
    right = ("named and placed", [s.placed for s in count])
    name, yes = {"clean": ("false alarms", clean), "outside": ("located", [s.located for s in count])}.get(part, right)
    if not yes:
        return []
    low, high = wilson(sum(yes), len(yes))
    share = f"{100 * np.mean(yes):.1f} %, 95 % interval {low:.1f} to {high:.1f} %"
    return [f"{name.capitalize()}: {sum(yes)} of {len(yes)} ({share}).", ""]


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
    if not bad:
        return []
    wrong = [
        f"- number {r['number']}: {', '.join(s.truth) or 'nothing'} ({100 * s.achievable:.0f} % to gain) was reported as "
        f"{', '.join(s.reported) or 'nothing'}, {s.verdict}"
        for r, s in bad
    ]
    return ["Not right:", "", *wrong, ""]


def power_lines(kept: list[dict]) -> list[str]:
    mine = [r for r in kept if r["part"] == "power"]
    if not mine:
        return []
    lines = [
        "## Power",
        *POWER_TEXT,
        "",
        "| effect | cells | " + " | ".join(f"{m:g}" for m in MULTIPLES) + " | 90 % at | all known | "
        "ratio | name and place known | ratio | " + " | ".join(f"best search, {100 * rate:g} %" for rate in RATES) + " |",
        "|---|--:|" + "--:|" * (len(MULTIPLES) + 5 + len(RATES)),
    ]
    for name in POWER:
        cells = [r for r in mine if r["effect"] == name]
        if not cells:
            continue
        found, *known = (np.array([r[which] for r in cells], dtype=bool) for which in ("found", "informed", "estimating"))
        rates = zip(*(100 * each.mean(axis=0) for each in (found, *known)), strict=True)
        shown = " | ".join(f"{a:.0f} % ({b:.0f}, {c:.0f})" for a, b, c in rates)
        ratios = " | ".join(against(found, each) for each in known)
        limits = (np.median([search_multiple(r["coefficients"], r["share"], rate) for r in cells]) for rate in RATES)
        best = " | ".join(f"{m:.2f}" for m in limits)
        lines.append(f"| {name} | {len(cells)} | {shown} | {ninety_percent_point(MULTIPLES, found):.2f} | {ratios} | {best} |")
    return [*lines, "", *e_value_lines(kept, mine)]


def e_value_lines(kept: list[dict], power: list[dict]) -> list[str]:
    """What another least e-value would have given."""
    clean = np.array([r["log_e_value"] for r in kept if r["part"] == "e-values"])
    if not len(clean):
        return []
    names = [name for name in POWER if any(r["effect"] == name for r in power)]
    lines = [*E_VALUE_TEXT, "", f"| e-value above | of {len(clean)} clean | {' | '.join(names)} |", "|---|--:|" + "--:|" * len(names)]
    for least in np.log(LEAST):
        found = [np.array([r["log_e_values"] for r in power if r["effect"] == name]) > least for name in names]
        points = " | ".join(f"{ninety_percent_point(MULTIPLES, each):.2f}" for each in found)
        lines.append(f"| {np.exp(least):g} | {np.sum(clean > least)} | {points} |")
    return [*lines, ""]


def against(found: np.ndarray, known: np.ndarray) -> str:
    """Where a test that knows more finds nine in ten, and the ratio to it."""
    # who must estimate the noise cannot need less than who knows it
    ratio, low, high = with_interval(
        lambda cells: ninety_percent_point(MULTIPLES, found[cells]) / max(ninety_percent_point(MULTIPLES, known[cells]), 1.0), len(found)
    )
    return f"{max(ninety_percent_point(MULTIPLES, known), 1.0):.2f} | {ratio:.2f} ({low:.2f} to {high:.2f})"


OTHERS = {"power": measure_power, "e-values": measure_e_values}


def score(given: argparse.Namespace) -> None:
    """Score table of the diagnosis: effects injected in simulated cells, diagnosed without knowledge of them.

    Hours in two processes; --share 0.3 takes a third of it.
    """
    kept = Kept(given.kept)
    for part in given.only:
        OTHERS.get(part, partial(measure_part, part))(given.share, given.jobs, kept)
        put(given.out, f"\n{score_page(kept.rows)}")
    print(row("all", [Score(**r["score"]) for r in kept.rows if "score" in r]))

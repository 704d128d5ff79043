"""Effects injected in simulated cells and diagnosed without knowledge of them: the score table, and formulas for those outside it.

    OMP_NUM_THREADS=1 python benchmarks/challenge.py score                   everything, in two processes (hours)
    OMP_NUM_THREADS=1 python benchmarks/challenge.py score --share 0.3       a third of it
    OMP_NUM_THREADS=1 python benchmarks/challenge.py score --only clean      one part
    OMP_NUM_THREADS=1 python benchmarks/challenge.py formulas --write
    OMP_NUM_THREADS=1 python benchmarks/challenge.py formulas --only hose_twist

Each command says more with --help.
"""

from __future__ import annotations

import argparse
import re
import subprocess
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import bench
import numpy as np
from bench import HERE, PLANS, Kept, keeps, option, put, wilson, writes
from detection_power import PowerCell, evidence_of, ninety_percent_point, search_multiple, try_cell, with_interval

from mbcacq.challenge import simulated_cells
from mbcacq.challenge.run import Challenger, _begin, _take
from mbcacq.challenge.scenarios import Scenario, draw, kinds
from mbcacq.challenge.score import Score
from mbcacq.challenge.simulated_cells import observe
from mbcacq.challenge.table import markdown, row, summary
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.effects.catalogue import with_added
from mbcacq.model.observations import Observations
from mbcacq.workflow.effect_draft import write_draft

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
Share of cells in which the diagnosis, proof included, names the effect at its location (or as one of two that it cannot tell apart), and
in brackets the shares in which two likelihood-ratio tests (level 1 %) find it on the same recordings, which know name and location and
estimate the noise: one that knows order and moment too, and one that estimates them with the other parameters. Strengths are multiples
of that at which a test that knew the noise as well would find nine in ten. Then where each finds nine in ten (the most likely cumulative
normal), the ratio to either test (95 % interval by drawing cells again), and the ratio to the first that the best test needs which knows
nothing, with 2 % or 0.5 % false alarms, shared by all places of all effects and there by orders and moments (median of the
cells).""".splitlines()


RATES = (0.02, 0.005)  # false alarms of the best search
E_VALUE_TEXT = """
False alarms and power by the same recordings, were the least e-value another one: the clean cells above it, and the multiple of the
strength for the informed test at which nine in ten effects are reported (below that in use: are in the most probable set).""".splitlines()


def measure_part(part: str, share: float, jobs: int, kept: Kept) -> None:
    _, seed, effects, count, outliers, missing = PARTS[part]
    done = {r["number"] for r in kept.rows if r["part"] == part}
    names = kinds(effects, missing)
    wanted = max(int(round(share * count)), 1)
    todo = [e for e in draw(seed, wanted, names, outliers, missing) if e.number not in done]
    with ProcessPoolExecutor(jobs, initializer=_begin, initargs=(PLANS / "seeing.yaml", False, None)) as pool:
        for outcome in pool.map(_take, todo):
            kept.add(
                {
                    "part": part,
                    "number": outcome.scenario.number,
                    "seconds": outcome.seconds,
                    "score": outcome.score.to_dict(),
                    "code": CODE,
                }
            )


def measure_power(share: float, jobs: int, kept: Kept) -> None:
    done = {(r["effect"], r["cell"]) for r in kept.rows if r["part"] == "power"}
    cells = [91000 + 17 * i for i in range(max(int(round(share * CELLS)), 1))]
    todo = [(name, cell) for cell in cells for name in POWER if (name, cell) not in done]
    with ProcessPoolExecutor(jobs, initializer=_begin, initargs=(PLANS / "seeing.yaml", False, None)) as pool:
        for (name, cell), one in zip(todo, pool.map(_power, todo), strict=True):
            kept.add({"part": "power", "effect": name, "cell": cell, **asdict(one), "code": CODE})


def _power(job: tuple[str, int]) -> PowerCell:
    from mbcacq.challenge import run

    return try_cell(run._challenger, *job, MULTIPLES)


def measure_e_values(share: float, jobs: int, kept: Kept) -> None:
    """Rates of the clean cells."""
    _, seed, effects, count, *_ = PARTS["clean"]
    done = {r["number"] for r in kept.rows if r["part"] == "e-values"}
    todo = [s for s in draw(seed, max(int(round(share * count)), 1), kinds(effects)) if s.number not in done]
    with ProcessPoolExecutor(jobs, initializer=_begin, initargs=(PLANS / "seeing.yaml", False, None)) as pool:
        for scenario, value in zip(todo, pool.map(_log_e_value, todo), strict=True):
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
        rows = summary(scores)
        seconds = np.array([r["seconds"] for r in mine])
        took = f"a diagnosis took {np.median(seconds):.1f} s in the median, {seconds.max():.1f} s at most, beside other work"
        commits = ", ".join(dict.fromkeys(r.get("code", "unknown") for r in mine))
        lines += [f"## {title}", "", f"{len(mine)} challenges, seed {seed}, {effects}, code {commits}; {took}.", "", markdown(rows), ""]
        lines += bounds(part, scores)
        lines += failures(mine, scores)
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


EXCESS = 3.0  # by which the effect raises chi2 per degree of freedom: plainly there, and no larger than others of an arm
SEEDS = (61001, 61002)
INTRODUCTION = [
    """# Formulas for effects outside the catalogue

Made by `python benchmarks/challenge.py formulas --write` on the poses of `plans/seeing.yaml` (128 poses, the fast path of
`mbcacq challenge`).
Each effect is concealed by the fake cell, which computes it by its physics, so strong that it raises chi2 per degree of freedom by 3
once geometry has absorbed what it can; the catalogue has none of these. `mbcacq diagnose --propose` sees the recording alone."""
]


# Kinds whose form (tanh, exp of a travel) no sum of terms of the dictionary is: a formula of them is right where all its terms are
# functions of the true covariates.
OF_COVARIATES = {"axis_wobble": "q", "cable_drag": "q", "link_bending": "gravity", "loose_anchor": "gravity", "short_memory": "direction"}


def right_terms(kind: str, truth: dict[str, Any], terms: tuple[str, ...]) -> bool:
    """Whether a formula is the true one, or, of those forms, of the true covariates alone."""
    if kind not in OF_COVARIATES:
        return terms in accepted(kind, truth)
    factors = [re.sub(r"^linear |^\d+(?=q)|\^\d$", "", factor) for term in terms for factor in term.split("*")]
    if OF_COVARIATES[kind] == "gravity":  # of which the fake states no joint
        return all(factor.startswith("gravity") for factor in factors)
    return all(factor in truth["depends_on"] for factor in factors)


def accepted(kind: str, truth: dict[str, Any]) -> list[tuple[str, ...]]:
    """What the injected effect is a function of, as ``Proposal.terms`` writes it. The centre of a ball that is seen through a tilting depth
    moves along the field as well, by time alone.
    """
    main = true_term(kind, truth)
    return [(main,), tuple(sorted((main, "time")))] if kind == "tilting_camera" else [(main,)]


def true_term(kind: str, truth: dict[str, Any]) -> str:
    """Its main term."""
    on = truth.get("depends_on", [""])
    if kind in OF_COVARIATES:
        return f"of {'+'.join(on)}"
    return {
        "floor_heave": "air_C",
        "fringe_ripple": f"wave {on[0]}",
        "hose_twist": "*".join(sorted(on)),
        "warm_gearbox": f"{on[0]}*robot_C",
        "uneven_ring": f"{truth.get('lobes')}q1",
        "cable_at_mount": f"2{on[0]}",
        "tilting_camera": f"time*{on[-1]}",
        "progressive_gear": f"{on[0]}^3",
        "sinking_pedestal": "time",
    }[kind]


KINDS = (
    "floor_heave",
    "fringe_ripple",
    "hose_twist",
    "warm_gearbox",
    "uneven_ring",
    "cable_at_mount",
    "tilting_camera",
    "progressive_gear",
    "sinking_pedestal",
    *OF_COVARIATES,
)


def proposed(challenger: Challenger, kind: str, seed: int) -> dict[str, Any]:
    """One cell: concealed, recorded, diagnosed with formulas."""
    scenario = Scenario(0, kind, seed, (kind,), seed + 7, EXCESS)
    injected = challenger.gauge.inject(scenario)
    observations, stated = observe(challenger.loaded, challenger.poses, scenario, injected)
    truth = stated["effects"][0]
    start = perf_counter()
    found = diagnose(observations, workers=1, formulas=True)
    seconds = perf_counter() - start
    right = [right_terms(kind, truth, p.terms) and right_place(found, p.where, truth) for p in found.proposals[:3]]
    rank = right.index(True) + 1 if any(right) else None
    return {
        "kind": kind,
        "seed": seed,
        "strength": injected[0]["strength"],
        "where": truth["where"],
        "terms": true_term(kind, truth),
        "verdict": found.verdict,
        "effects": [f"{e.name} at {'+'.join(e.where)}" for e in found.effects],
        "rank": rank,
        "with_draft": with_draft(observations, found),
        "proposals": [
            {
                "formula": p.formula,
                "terms": list(p.terms),
                "where": list(p.where),
                "odds": p.odds,
                "log_bayes_factor": p.log_bayes_factor,
                "before": p.held_out_before_chi2_dof,
                "after": p.held_out_chi2_dof,
                "smooth": p.smooth_chi2_dof,
                "found_in": p.found_in,
                "parts": p.parts,
            }
            for p in found.proposals
        ],
        "seconds": seconds,
    }


def with_draft(observations: Observations, found: Diagnosis) -> str:
    """Verdict and effects of the same recording once the draft of the best formula is in the catalogue."""
    if not found.proposals:
        return ""
    with TemporaryDirectory() as folder:
        draft = write_draft(found.proposals, Path(folder) / "draft")
        with with_added(draft[1:]):
            again = diagnose(observations, workers=1, folds=2)
    names = {file.stem.removeprefix("mbcacq_effect_") for file in draft[1:]}
    return f"{again.verdict}: {', '.join('the draft' if e.name in names else e.name for e in again.effects)}"


def right_place(found: Diagnosis, where: tuple[str, ...], truth: dict[str, Any]) -> bool:
    """Whether a formula acts where the effect does, or where these data cannot tell it from."""
    alike = {w for e in (*found.effects, *found.mismatch) for w in e.equivalent if set(truth["where"]) & {w, *_places(e)}}
    return bool(set(where) & (set(truth["where"]) | alike))


def _places(entry: Any) -> tuple[str, ...]:
    return entry.where if hasattr(entry, "where") else (entry.at,)


def formulas_page(rows: list[dict[str, Any]]) -> str:
    """The page."""
    right = sum(r["rank"] is not None for r in rows)
    first = sum(r["rank"] == 1 for r in rows)
    lines = [
        *INTRODUCTION,
        f"""
The true formula (its covariates and functions, at its location or one that acts alike; of {", ".join(OF_COVARIATES)}, whose forms
are not in the dictionary, its covariates alone) is first in {first} of {len(rows)} cells, and
among the first three in **{right} of {len(rows)}**.
""",
    ]
    heads = ("effect", "cell", "true", "rank", "verdict", "best formula", "held-out chi2/dof: before, with it, smooth model")
    heads = (*heads, "again in", "with the draft in the catalogue", "s")
    lines += [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    for r in rows:
        best = r["proposals"][0] if r["proposals"] else None
        shown = best["formula"].replace("|", "&#124;") if best else "none"
        scores = f"{best['before']:.2f}, {best['after']:.2f}, {best['smooth']:.2f} | {best['found_in']}/{best['parts']}" if best else "|"
        true = f"{r['terms']} at {'+'.join(r['where'])}"
        lines.append(
            f"| {r['kind']} | {r['seed']} | {true} | {r['rank'] or '-'} | {r['verdict']} | {shown} | {scores} | {r['with_draft']} "
            f"| {r['seconds']:.0f} |"
        )
    return "\n".join([*lines, ""])


def formulas(given: argparse.Namespace) -> None:
    """Formulas proposed for effects outside the catalogue, in computed cells: fourteen kinds, two cells each (some ten minutes)."""
    kept = Kept(given.kept)
    done = {(r["kind"], r["seed"]) for r in kept.rows}
    challenger = Challenger.of(PLANS / "seeing.yaml")
    for seed in SEEDS[: given.seeds]:
        for kind in given.only or KINDS:
            if (kind, seed) in done:
                continue
            found = proposed(challenger, kind, seed)
            kept.add(found)
            print(f"{kind} {seed}: rank {found['rank']}, {found['verdict']}, {found['seconds']:.0f} s", flush=True)
            for p in found["proposals"]:
                print(f"   {p['formula']}  odds {p['odds']:.3g}, {p['before']:.2f} -> {p['after']:.2f}", flush=True)
    if given.write:
        order = {kind: j for j, kind in enumerate(KINDS)}
        page = formulas_page(sorted(kept.rows, key=lambda r: (order[r["kind"]], r["seed"])))
        (HERE / "formulas.md").write_text(page, encoding="utf-8")


if __name__ == "__main__":
    SHARE = option("--share", type=float, default=1.0, help="of the full number of challenges")
    PARTS_ASKED = option("--only", nargs="*", choices=[*PARTS, *OTHERS], default=[*PARTS, *OTHERS])
    JOBS, OUT = option("--jobs", type=int, default=2), option("--out", type=Path, default=HERE / "challenge.md")
    KINDS_ASKED = option("--only", action="append", choices=KINDS, help="these kinds alone")
    CELLS_ASKED = option("--seeds", type=int, default=len(SEEDS), help="cells of each kind")
    bench.main(
        __doc__,
        {
            "score": (score, [SHARE, PARTS_ASKED, JOBS, OUT, keeps("challenge.jsonl")]),
            "formulas": (formulas, [KINDS_ASKED, CELLS_ASKED, keeps("formulas.jsonl"), writes("benchmarks/formulas.md")]),
        },
    )

"""Formulas that the diagnosis proposes for effects outside the catalogue: is the true one among them?"""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from bench import HERE, PLANS, Kept, table

from mbcacq.challenge.run import Challenger
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.effects.catalogue import with_added
from mbcacq.model.observations import Observations
from mbcacq.workflow.effect_draft import write_draft

# part: title, seed, effects, how many, share of outliers, missing columns

EXCESS = 3.0  # by which the effect raises chi2 per degree of freedom: plainly there, and no larger than others of an arm
SEEDS = (61001, 61002)
INTRODUCTION = """# Formulas for effects outside the catalogue

**Question.** Is the true formula among those that `mbcacq diagnose --propose` proposes?

`python benchmarks/challenge.py formulas --write`: poses of `plans/seeing.yaml` (128, the fast path of `mbcacq challenge`). The fake cell
conceals each effect and computes it by its physics, so strong that it raises chi2 per degree of freedom by 3 once geometry has absorbed
what it can. The catalogue has none of these effects, and the diagnosis sees the recording alone.
"""


# Kinds whose form (tanh, exp of a travel) no sum of terms of the dictionary is: a formula of them is right where all its terms are
# functions of the true covariates.
OF_COVARIATES = {"axis_wobble": "q", "cable_drag": "q", "link_bending": "gravity", "loose_anchor": "gravity", "short_memory": "direction"}


def right_terms(kind: str, truth: dict[str, Any], terms: tuple[str, ...]) -> bool:
    """Whether a formula is the true one. For the forms outside of the dictionary, the true covariates alone suffice."""
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
    explained = sum(r["with_draft"] == "explained: the draft" for r in rows)
    said = f"""Of {len(rows)} cells the true formula (covariates, functions, location) is first in {first}, among the first three in
**{right}**, and {explained} are explained by the draft once it is in the catalogue. The forms of {", ".join(OF_COVARIATES)}
are not in the dictionary; a formula of their true covariates alone counts for them.
"""
    heads = ("effect", "true", "ranks", "verdicts", "held-out chi2/dof: before, with it")
    by_kind = {kind: [r for r in rows if r["kind"] == kind] for kind in dict.fromkeys(r["kind"] for r in rows)}
    lines = []
    for kind, cells in by_kind.items():
        best = [r["proposals"][0] for r in cells if r["proposals"]]
        verdicts = ", ".join(dict.fromkeys(r["verdict"] for r in cells))
        ranks = ", ".join(str(r["rank"] or "-") for r in cells)
        scores = "; ".join(f"{p['before']:.2f}, {p['after']:.2f}" for p in best)
        true = ", ".join(dict.fromkeys(f"{r['terms']} at {'+'.join(r['where'])}" for r in cells))
        lines.append((kind, true, ranks, verdicts, scores))
    return "\n".join([INTRODUCTION, said, *table(heads, lines), ""])


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

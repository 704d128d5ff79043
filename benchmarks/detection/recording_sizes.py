"""False alarms and right names over sizes of recordings, instruments and statements of the noise."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import product
from time import perf_counter, process_time
from zlib import crc32

import numpy as np
import simulated
from bench import Kept
from detection_power import likelihood_ratio
from scipy.stats import beta

from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.problem import prepare
from mbcacq.diagnosis.result import Diagnosis
from mbcacq.diagnosis.search.effect_set import EffectSet, Member
from mbcacq.effects import catalogue
from mbcacq.effects.context import Context
from mbcacq.effects.covariates import Covariates
from mbcacq.effects.described import parts_of
from mbcacq.estimation import forward_model
from mbcacq.estimation.forward_model import CellState, Displacements
from mbcacq.estimation.terms import accumulate, term
from mbcacq.geometry import se3
from mbcacq.model.cell import TARGET_IN_BASE, Artefact, Cell, Station
from mbcacq.model.observations import Observations

POSES = (12, 20, 28, 50, 128, 200)
INSTRUMENTS = ("artefact", "bar", "tracker", "tracker6")  # tracker6: with a measured orientation
STATED = (1.0, 0.2, 5.0)  # times the true noise
EFFECTS = (None, ("joint_compliance", ("A2",), (3e-6,)), ("backlash", ("A1",), (6e-5,)), ("joint_scale", ("A5",), (2e-4,)))
TRACKER_MM, TRACKER_RAD = 0.015, 5e-5
MOUNT = se3.transform(se3.rotation_exp(np.array([0.2, 0.1, 0.3])), np.array([30.0, 20.0, 180.0]))
TRACKER = se3.transform(se3.rotation_exp(np.array([0.0, 0.0, 0.3])), np.array([2500.0, 300.0, 400.0]))


@cache
def template(instrument: str, poses: int) -> Observations:
    """Poses of a recording, measured without noise in the nominal cell."""
    if instrument == "artefact":
        stations = max(3, min(poses // 7, 12))
        plan = simulated.plan(stations, 0, int(np.ceil(poses / stations)))
        return plan.select(np.arange(plan.n_poses) < poses)
    if instrument == "bar":
        stations, bars = max(2, poses // 12), max(2, poses // 16)
        plan = simulated.plan(stations, bars, 2 * int(np.ceil(poses / (stations + bars) / 2)))
        return plan.select(np.isin(np.arange(plan.n_poses), np.linspace(0, plan.n_poses - 1, poses).round()))
    return tracked(poses, instrument == "tracker6")


def tracked(poses: int, oriented: bool) -> Observations:
    """A tracker that stands next to the arm and measures a target on its flange."""
    rng, arm = np.random.default_rng(3), simulated.robot()
    target = Artefact("target", "target", (1,), np.zeros((1, 3)), np.zeros(1))
    noise = np.full(3, TRACKER_MM)
    cell = Cell(arm, MOUNT, (target,), (Station("1", "target"),), "tracker", noise, measurement=TARGET_IN_BASE)
    q = np.clip(rng.uniform(0.5 * arm.limits[:, 0], 0.5 * arm.limits[:, 1], (poses, arm.n)), -2.2, 2.2)
    time, pose = np.cumsum(rng.uniform(12, 28, poses)), np.arange(poses)
    obs = Observations(
        cell,
        pose,
        np.zeros(poses, int),
        q,
        pose,
        np.zeros(poses, int),
        np.zeros((poses, 3)),
        time_s=time,
        direction=np.sign(np.diff(q, axis=0, prepend=q[:1] - 1)),
        temperatures={"robot_C": 24 + 6 * (1 - np.exp(-time / 1200)) + rng.normal(0, 0.02, poses)},
        rotation=np.tile(np.eye(3), (poses, 1, 1)) if oriented else None,
    )
    seen = forward_model.predict(obs, CellState(arm.chain, MOUNT, TRACKER[None], np.zeros((1, 3))))
    return replace(obs, xyz=seen.xyz, rotation=seen.rotation)


def recorded(instrument: str, poses: int, seed: int, effect: tuple | None, stated: float) -> Observations:
    """A recording of another cell at these poses, with noise, with an effect or none, and with that statement of the noise."""
    plan = template(instrument, poses)
    effects = [] if effect is None else [(effect[0], effect[1], list(effect[2]), None)]
    obs = tracked_again(plan, seed, effects) if instrument.startswith("tracker") else simulated.observe(plan, seed, effects)
    return replace(obs, cell=replace(obs.cell, noise_mm=obs.cell.noise_mm * stated))


def tracked_again(plan: Observations, seed: int, effects: list) -> Observations:
    rng = np.random.default_rng(seed)
    chain = plan.cell.robot.chain.with_errors(simulated.geometry(rng, plan.cell))
    mount = MOUNT @ se3.exp(rng.normal(0, [1, 1, 1, 0.01, 0.01, 0.01]))
    state = CellState(chain, mount, TRACKER[None], np.zeros((1, 3)))
    candidates = catalogue.candidates(Context(plan, state, forward_model.predict(plan, state)))[0]
    chosen = [next(c for c in candidates if c.name == name and c.where == tuple(where)) for name, where, *_ in effects]
    moved = accumulate(plan, [term(c.name, parts_of(c, Covariates(plan))) for c in chosen], [np.array(e[2]) for e in effects])
    moved = simulated.add(moved, Displacements(joint=rng.normal(0, simulated.JOINT_NOISE, plan.q.shape)))
    seen = forward_model.predict(plan, state, moved)
    rotation = None if seen.rotation is None else se3.rotation_exp(rng.normal(0, TRACKER_RAD, (plan.n_poses, 3))) @ seen.rotation
    return replace(plan, xyz=seen.xyz + rng.normal(0, TRACKER_MM, seen.xyz.shape), rotation=rotation)


def outcome(job: tuple[str, int, float, int, int]) -> dict:
    """One cell: verdict, effects, seconds of processor time."""
    instrument, poses, stated, which, number = job
    start = process_time()
    effect = EFFECTS[which]
    observed = recorded(instrument, poses, crc32(repr(job).encode()), effect, stated)
    found = diagnose(observed)
    seconds = process_time() - start
    unseen = effect is not None and found.verdict == "none"
    return {
        "job": list(job),
        "verdict": found.verdict,
        "effects": [f"{e.name}:{'+'.join(e.where)}" for e in found.effects],
        "seconds": seconds,
        **({"said_possible": said_possible(found, effect), "informed_chi2": informed_chi2(observed, effect)} if unseen else {}),
    }


def informed_chi2(observed: Observations, effect: tuple[str, tuple[str, ...], tuple[float, ...]]) -> float:
    """What a likelihood-ratio test says that knows the effect and its place: chi2 of one degree of freedom where it is not there."""
    problem = prepare(observed)
    known = next(c for c in problem.candidates if (c.name, c.where) == effect[:2])
    return likelihood_ratio(problem, EffectSet((Member(known, None),)))


def said_possible(found: Diagnosis, effect: tuple[str, tuple[str, ...], tuple[float, ...]]) -> bool:
    """Whether the exclusion limits leave room for an effect as large as the one that was injected."""
    name, where, (value,) = effect
    limits = [e for e in found.exclusion_limits if e.name == name and e.where == where]
    sizes = [None if e.value is None else np.radians(e.value) if e.parameter.endswith("_deg") else e.value for e in limits]
    return any(size is None or size >= value for size in sizes)


def judged(record: dict) -> str:
    """'right', 'none' or 'cannot_tell' of an effect that is there, or 'wrong'."""
    effect = EFFECTS[record["job"][3]]
    if effect is None:
        return "right" if record["verdict"] in ("none", "cannot_tell") and not record["effects"] else "wrong"
    if record["verdict"] in ("none", "cannot_tell"):
        return record["verdict"]
    return "right" if record["effects"] == [f"{effect[0]}:{'+'.join(effect[1])}"] else "wrong"


def upper_limit(events: int, cells: int) -> float:
    """Limits of a rate, at 95 % (Clopper and Pearson)."""
    return 1.0 if events >= cells else float(beta.ppf(0.95, events + 1, cells - events))


def counts(records: list[dict]) -> str:
    """Columns of the tables: nothing injected, then one effect."""
    clean, with_effect = ([r for r in records if (r["job"][3] == 0) is none] for none in (True, False))
    alarms, judgements = sum(judged(r) == "wrong" for r in clean), [judged(r) for r in with_effect]
    found = " | ".join(str(judgements.count(what)) for what in ("right", "cannot_tell", "none"))
    limit = f"{100 * upper_limit(alarms, len(clean)):.1f} %" if clean else ""
    return f"{len(clean)} | {alarms} | {limit} | {len(judgements)} | {found}"


def sizes_page(records: list[dict]) -> str:
    def grouped(name: Callable[[dict], str], key: Callable[[dict], object]) -> list[str]:
        by_value = {key(r): name(r) for r in sorted(records, key=key)}
        return [f"| {said} | {counts([r for r in records if key(r) == value])} |" for value, said in by_value.items()]

    effects = "; ".join(f"{e[0]} {e[1][0]}, {e[2][0]:g}" for e in EFFECTS if e is not None)
    wrong = [r for r in records if judged(r) == "wrong"]
    names = [", ".join(r["effects"]).split(":")[0] or "no effect" for r in wrong]
    unseen = [r for r in records if judged(r) == "none"]
    possible = sum(r.get("said_possible", False) for r in unseen)
    chi2 = [r["informed_chi2"] for r in unseen]
    known = f"A test that knows the effect and its place has a chi2 of {np.median(chi2):.1f} in the median of these." if chi2 else ""
    missed = sum(judged(r) == "wrong" for r in records if r["job"][3])
    lines = [
        "# Recording sizes",
        "",
        "**Question.** How often is a diagnosis wrong, by size of the recording, instrument and statement of the noise?",
        "",
        f"`python benchmarks/detection.py sizes`: a sample of {len(records)} simulated cells. False alarms: an effect, or another verdict",
        "than `none` and `cannot_tell`, where nothing was injected (limits of Clopper and Pearson).",
        f"With one effect ({effects}) right means that effect and no other.",
        f"Another effect was reported in {missed}. The verdict is `none` for {len(unseen)} with an effect; the exclusion limits of",
        f"{possible} of them leave room for it. {known}",
        "",
        "| recordings | cells | false alarms | at most (95 %) | with an effect | right | cannot_tell | none |",
        "|---|" + "--:|" * 7,
        *grouped(lambda r: "all", lambda r: 0),
        *grouped(lambda r: f"{r['job'][1]} poses", lambda r: r["job"][1]),
        *grouped(lambda r: r["job"][0], lambda r: r["job"][0]),
        *grouped(lambda r: f"noise stated {r['job'][2]:g} times", lambda r: r["job"][2]),
        "",
        f"Wrong ones by what they report: {', '.join(f'{name} {n}' for name, n in Counter(names).most_common())}."
        if wrong
        else "None is wrong.",
    ]
    return "\n".join(lines) + "\n"


def jobs(options: argparse.Namespace) -> list[tuple[str, int, float, int, int]]:
    """Round by round over all rows: first cells with nothing injected, then half as many with an effect."""
    rows = list(product(options.instruments, options.poses, options.stated))
    numbers = range(options.first, options.first + options.cells)
    rounds = [(0, n) for n in numbers] + [(1 + j % (len(EFFECTS) - 1), n) for j, n in enumerate(numbers[::2])]
    return [(*row, *which) for which in rounds for row in rows]


def sizes(given: argparse.Namespace) -> None:
    """False alarms and right names of the diagnosis by recording size, instrument and noise statement.

    Cells are simulated: an arm with the geometry errors of a new one, joint repeatability 5 urad, instrument noise 0.005 to 0.009 mm
    (scanner) or 0.015 mm (tracker). Every cell is drawn anew (no two share their noise). 200 cells a row, half as many with an
    effect, take four hours; with --minutes every row grows evenly for so long.
    """
    start = perf_counter()
    kept = Kept(given.kept[0])
    rows = kept.rows + [row for file in given.kept[1:] for row in Kept(file).rows]
    done = {tuple(r["job"]) for r in rows}
    for job in (j for j in jobs(given) if j not in done):
        if perf_counter() - start > 60 * given.minutes:
            break
        rows.append(outcome(job))
        kept.add(rows[-1])
    given.out.write_text(sizes_page(rows), encoding="utf-8")

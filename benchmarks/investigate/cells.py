"""Concealed cells that investigate themselves, clean recordings that grow, and the tables of both."""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import bench
import numpy as np
from detection.recording_sizes import INSTRUMENTS, recorded
from threadpoolctl import threadpool_limits

import mbcacq
from mbcacq.calibration.held_out_poses import about_best_station
from mbcacq.challenge.run import with_observable_locations
from mbcacq.challenge.scenarios import NONE, OUTSIDE, TWO, Scenario, catalogued, draw
from mbcacq.challenge.score import companions_of
from mbcacq.challenge.simulated_cells import observe
from mbcacq.challenge.strength import Gauge
from mbcacq.design.adaptive.investigation import Budget, decisions, effort, sure
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.diagnosis.interim import InterimEvidence, weigh
from mbcacq.effects.catalogue import declaration
from mbcacq.model import yaml12
from mbcacq.model.json_text import plain
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, expand, load
from mbcacq.plan.expansion import expand_reachable

PLAN = bench.PLANS / "seeing.yaml"
VIEWS = 16  # of an artefact, of a bar four for each ball
PLACES = (
    ("n1", "mbc", [680, 60, 60], [10, 5, 0]),
    ("n2", "mbc", [560, -260, 180], [-25, 0, 10]),
    ("n3", "bar", [560, 125, 230], [0, 0, 0]),
    ("n4", "bar", [600, 0, 180], [60, 0, 0]),
)
KEPT = Path("runs") / "investigate-benchmark"
OF_THE_PLAN = "scanner of the plan"
LOOKS = tuple(range(24, 24 + 10 * 6, 6))  # poses at each of ten looks: a first block, and visits of six
SIZES = (32, 64, 128)  # poses of the fixed plan after which it is looked at
ALARM = float(np.log(100))
UNSEEN = 9.0  # information of three standard deviations: what shows by less cannot be found
PROTOCOLS = 9  # one cell of so many goes through the protocols as well, of every kind in turn
COMPARED = 4  # one cell of so many is compared at new places as well: two diagnoses and two calibrations more


class RecordedCell:
    """A concealed cell that remembers what was measured of it, and stays the same: the first block is what its effects choose by."""

    def __init__(self, scenario: Scenario, injected: list):
        self.scenario, self.injected, self.measured, self.planned = scenario, injected, None, None

    @property
    def information(self) -> float:
        """Squared length, in noises and beyond the geometry, of what the effects displace at the measured poses; 20 to 30 decide."""
        return Gauge(self.plan, expand(self.plan)).gain(self.scenario, self.injected)

    def measure(self, grown: LoadedPlan) -> Observations:
        self.plan, poses = grown, expand(grown)
        self.planned = self.planned or poses
        new, truth = observe(grown, poses, self.scenario, self.injected, planned=self.planned)
        self.truth, old = truth, self.measured
        if old is not None:
            P, M = old.n_poses, old.n_centres
            later = old.time_s[-1] - new.time_s[P - 1] if old.time_s is not None and new.time_s is not None else 0.0
            new = replace(
                new,
                q=np.concatenate([old.q, new.q[P:]]),
                xyz=np.concatenate([old.xyz, new.xyz[M:]]),
                time_s=np.concatenate([old.time_s, new.time_s[P:] + later]),
                temperatures={name: np.concatenate([old.temperatures[name], T[P:]]) for name, T in new.temperatures.items()},
            )
        self.measured = new
        return new


class NewPlaces:
    """Places where no station of the plan stands."""

    def __init__(self):
        plan = yaml12.load(PLAN.read_text())
        plan["stations"] = [
            {"id": name, "artefact": artefact, "pose_in_base": {"translation_mm": xyz, "abc_deg": abc}}
            for name, artefact, xyz, abc in PLACES
        ]
        rng = np.random.default_rng(3)
        views = [
            {"tilt_deg": round(float(rng.uniform(3, 24)), 1), "azimuth_deg": round(float(rng.uniform(0, 360)), 1)} for _ in range(VIEWS)
        ]
        look = {"phase": "position", "do": "look", "views": views}
        plan["steps"] = [
            {"name": "artefact", "stations": [p[0] for p in PLACES if p[1] == "mbc"], **look},
            {"name": "bar", "stations": [p[0] for p in PLACES if p[1] == "bar"], "balls": "each", **look, "views": views[::4]},
        ]
        self.loaded = load(PLAN, yaml12.dump(plan))
        self.poses = expand_reachable(self.loaded)[0]

    def error_mm(self, measured: Observations, cell: RecordedCell) -> float:
        """Root mean square of the distances of centres there from where the cell that was diagnosed and calibrated from a recording
        has them, stations at their best places. Noise of the measurement is in it."""
        there, _ = observe(self.loaded, self.poses, cell.scenario, cell.injected, planned=cell.planned)
        geometry, found = mbcacq.calibrate(measured), diagnose(measured, folds=2)
        calibrated = geometry.with_effects(found) if found.model else geometry
        return float(np.sqrt(np.mean(about_best_station(there, calibrated)[0] ** 2)))


def names_of(labels: str) -> set[str]:
    """Names of a set of effects in words."""
    return set() if labels == "no effect" else {label.split(" at ")[0] for label in labels.split(" and ") if " at " in label}


def outcome(verdict: str, found: set[str], true: set[str]) -> str:
    """What a verdict is worth: 'right', 'in part' (a pair of which one is named), 'open', 'missed', 'wrong name' or 'false alarm'."""
    companions = {c for name in true for c in companions_of(name)}
    outside = bool(true & set(OUTSIDE))
    if not true:
        return {"none": "right", "cannot_tell": "open"}.get(verdict, "false alarm")
    if verdict in ("none", "cannot_tell"):
        return "missed" if verdict == "none" else "open"
    if verdict == "explained" and found - true - companions:
        return "wrong name"
    if outside:
        return "right"
    if verdict != "explained":
        return "open"
    return "right" if true <= found else "in part"


def investigated(loaded: LoadedPlan, scenario: Scenario, injected: list) -> tuple[dict, RecordedCell]:
    """The row of a cell that investigates itself, and the cell with what it measured."""
    cell = RecordedCell(scenario, injected)
    made = list(decisions(loaded, cell.measure, Budget(poses=96)))
    last, true = made[-1], [with_observable_locations(plain(e)) for e in cell.truth["effects"]]
    row = {
        "poses": last.poses,
        "moves": last.moves,
        "verdict": last.verdict,
        "found": last.sets[0][0],
        "end": last.end,
        "truth": [f"{e['name']}:{'+'.join(e['where'])}" for e in true],
        "outcome": outcome(last.verdict, names_of(last.sets[0][0]), {e["name"] for e in true}),
        "log_e_values": [d.log_e_value for d in made],
        "information": cell.information if true else 0.0,
        "at_poses": [d.poses for d in made],
    }
    return row, cell


def fixed(loaded: LoadedPlan, obs: Observations, true: set[str], seed: int) -> dict:
    """The plan's poses in random order, looked at after some numbers of them, stopped by the rule of an investigation."""
    order = np.random.default_rng(seed).permutation(obs.n_poses)
    for n in SIZES:
        look = weigh(obs.select(first_of(order, n)))
        if sure(look) or n == SIZES[-1]:
            break
    said = look.verdict if sure(look) else "cannot_tell"
    return {"fixed_poses": n, "fixed_moves": effort(loaded, obs)[0], "fixed_outcome": outcome(said, names_found(look), true)}


def names_found(look: InterimEvidence) -> set[str]:
    """Names of the set that would be reported."""
    return {label.partition(":")[0] for label in look.reported.labels}


def first_of(order: np.ndarray, n: int) -> np.ndarray:
    """(P,) bool of the first n poses of an order."""
    keep = np.zeros(len(order), dtype=bool)
    keep[order[:n]] = True
    return keep


@threadpool_limits.wrap(limits=1)
def cells(given: argparse.Namespace) -> None:
    """Investigate the cells from number ``first`` on that are not in the table yet."""
    loaded, table, places = load(PLAN), Table(f"cells-{given.seed}"), NewPlaces()
    gauge = Gauge(loaded, expand(loaded))
    for scenario in draw(given.seed, given.count, mixed(given.count))[given.first :]:
        if scenario.number in table.done:
            continue
        began, injected = time.process_time(), gauge.inject(scenario)
        row, cell = investigated(loaded, scenario, injected)
        whole, _ = observe(loaded, expand(loaded), scenario, injected, planned=cell.planned)
        row |= {"kind": scenario.kind, "excess": scenario.excess}
        row |= fixed(loaded, whole, set(scenario.names), scenario.seed) if scenario.names else {}
        if scenario.number % COMPARED == 0:
            subset = first_of(np.random.default_rng(scenario.seed).permutation(whole.n_poses), min(row["poses"], whole.n_poses))
            row["error_mm"] = places.error_mm(cell.measured, cell)
            row["fixed_error_mm"] = places.error_mm(whole.select(subset), cell)
        table.add_numbered(scenario.number, row | {"processor_s": time.process_time() - began})


@threadpool_limits.wrap(limits=1)
def protocols(given: argparse.Namespace) -> None:
    """The same cells through the fakes of robot, scanner and thermometers: runner, checks, recordings and all."""
    loaded, table, drawn = load(PLAN), Table(f"protocols-{given.seed}"), PROTOCOLS * given.count
    gauge = Gauge(loaded, expand(loaded))
    for scenario in draw(given.seed, drawn, mixed(drawn))[::PROTOCOLS]:
        if scenario.number in table.done:
            continue
        with tempfile.TemporaryDirectory() as made:
            plan = yaml12.load(PLAN.read_text())
            plan["robot"]["model"] = str(PLAN.parent / plan["robot"]["model"])
            plan["artefacts"] = [str(PLAN.parent / name) for name in plan["artefacts"]]
            plan["fake"]["hidden"] = gauge.inject(scenario)
            path = Path(made) / "plan.yaml"
            path.write_text(yaml12.dump(plan))
            began, used = time.monotonic(), processor_s()
            made_of = mbcacq.investigate(path, Budget(poses=96), out=Path(made) / "run", dry_run=True, seed=scenario.seed)
            last = list(made_of)[-1]
        row = {"kind": scenario.kind, "poses": last.poses, "moves": last.moves, "verdict": last.verdict, "found": last.sets[0][0]}
        row |= {"outcome": outcome(last.verdict, names_of(last.sets[0][0]), set(scenario.names)), "end": last.end}
        table.add_numbered(scenario.number, row | {"seconds": time.monotonic() - began, "processor_s": processor_s() - used})


def processor_s() -> float:
    """Processor time of this process and of those that it started and that have ended."""
    return sum(r.ru_utime + r.ru_stime for r in map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)))


def mixed(count: int) -> list[str]:
    """Ten cells hold four effects of the catalogue, two outside of it, one pair and three of nothing, each name equally often."""
    inside, outside = cycle(catalogued()), cycle(OUTSIDE)
    pattern = (inside, NONE, outside, inside, NONE, TWO, inside, outside, NONE, inside)
    return [one if isinstance(one := pattern[k % len(pattern)], str) else next(one) for k in range(count)]


class Table(bench.Kept):
    """Rows by number, those of earlier calls among them."""

    def __init__(self, name: str):
        KEPT.mkdir(parents=True, exist_ok=True)
        super().__init__(KEPT / f"{name}.jsonl")
        self.done = {row["number"] for row in self.rows}

    def add_numbered(self, number: int, row: dict) -> None:
        self.add({"number": number, **row})
        self.done.add(number)


@threadpool_limits.wrap(limits=1)
def looks(given: argparse.Namespace) -> None:
    """Log e-values of clean recordings that grow, poses in random order: a look after the first block of an investigation, and after each
    of nine visits. Instruments in turn: the scanner in the fake cell of the plan, and those of ``detection.py sizes``.
    """
    loaded, table = load(PLAN), Table(f"looks-{given.seed}")
    poses = expand(loaded)
    for scenario in draw(given.seed, given.count, [NONE]):
        if scenario.number in table.done:
            continue
        instrument, began = (OF_THE_PLAN, *INSTRUMENTS)[scenario.number % (1 + len(INSTRUMENTS))], time.process_time()
        if instrument == OF_THE_PLAN:
            obs, _ = observe(loaded, poses, scenario, [])
        else:
            obs = recorded(instrument, LOOKS[-1], scenario.seed, None, 1.0)
        order = np.random.default_rng(scenario.seed).permutation(obs.n_poses)
        log_e = [weigh(obs.select(first_of(order, n))).full.evidence.log_e_value for n in LOOKS]
        table.add_numbered(scenario.number, {"instrument": instrument, "log_e_values": log_e, "processor_s": time.process_time() - began})


GROUPS = ("of the catalogue, at rest", "of the catalogue, in time", "two", "outside of the catalogue", "nothing")
OUTCOMES = ("right", "in part", "open", "missed", "wrong name", "false alarm")


def group_of(row: dict) -> str:
    """Which kind of cell a row is of."""
    kind = row["kind"]
    if kind in (NONE, TWO) or kind in OUTSIDE:
        return {NONE: GROUPS[4], TWO: GROUPS[2]}.get(kind, GROUPS[3])
    return GROUPS[1] if declaration(kind).acts_in_time else GROUPS[0]


def page(given: argparse.Namespace) -> None:
    """Tables on stdout, as they stand in benchmarks/investigate.md."""
    cells_page(Table(f"cells-{given.seed}").rows)
    looks_page(Table(f"looks-{given.seed}").rows)


def cells_page(rows: list[dict]) -> None:
    """Tables of the cells that investigated themselves."""
    print(f"| concealed | cells | {' | '.join(OUTCOMES)} | missed, shown by less than 9 | poses | moves |\n|---|{'--:|' * 10}")
    for group in (*GROUPS, "all"):
        some = [r for r in rows if group in ("all", group_of(r))]
        if some:
            counts = [sum(r["outcome"] == one for r in some) for one in OUTCOMES]
            unseen = sum(r["outcome"] == "missed" and r["information"] < UNSEEN for r in some)
            median = [f"{np.median([r[key] for r in some]):.0f}" for key in ("poses", "moves")]
            print(f"| {group} | {len(some)} | {' | '.join(map(str, counts))} | {unseen} | {' | '.join(median)} |")
    some = [r for r in rows if "fixed_outcome" in r]
    right = np.array([r["poses"] if r["outcome"] == "right" else np.inf for r in some])
    there = np.array([r["fixed_poses"] if r["fixed_outcome"] == "right" else np.inf for r in some])
    print("\n| cells with an effect: decided right after at most | 24 | 32 | 48 | 64 | 96 | 128 |\n|---|--:|--:|--:|--:|--:|--:|")
    for title, poses in (("investigated", right), ("the plan's poses in random order", there)):
        print(f"| {title} | {' | '.join(str(int((poses <= n).sum())) for n in (24, 32, 48, 64, 96, 128))} |")
    wrong = [sum(r[key] == "wrong name" for r in some) for key in ("outcome", "fixed_outcome")]
    alarms = sum(max(r["log_e_values"]) > ALARM for r in rows if r["kind"] == NONE)
    print(f"\nwrong names {wrong[0]}, of the plan {wrong[1]}, of {len(some)}; alarms {alarms} of {len(rows) - len(some)}")
    error = np.array([(r["error_mm"], r["fixed_error_mm"]) for r in rows if "error_mm" in r]) * 1e3
    if len(error):
        ratio = error[:, 0] / error[:, 1]
        spread = np.quantile(ratio, (0.1, 0.5, 0.9)).round(2)
        print(f"at new places / um: {np.median(error, axis=0).round(1)}, ratio {spread}, {len(error)} cells")


def looks_page(rows: list[dict]) -> None:
    """Table of the clean sequences."""
    if not rows:
        return
    heads = ("instrument", "sequences", "looks", "alarms", "sequences with E above 2", "mean of the last E", "largest E of any look")
    lines = []
    for title in (*dict.fromkeys(r["instrument"] for r in rows), "all"):
        log_e = np.array([r["log_e_values"] for r in rows if title in ("all", r["instrument"])])
        largest = log_e.max(axis=1)
        counts = [int((largest > level).sum()) for level in (ALARM, np.log(2))]
        lines.append([title, len(log_e), log_e.size, *counts, f"{np.exp(log_e[:, -1]).mean():.2f}", f"{np.exp(largest.max()):.2g}"])
    print("\n" + "\n".join(bench.table(heads, lines)))

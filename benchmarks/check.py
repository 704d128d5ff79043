"""Interim checks over simulated years: false alarms, and the power for each change that the fake cell can make.

    python benchmarks/check.py nothing [--years 1000]     years in which nothing changes but what does from day to day
    python benchmarks/check.py daily [--years 300]        the same with a look on every day of the year
    python benchmarks/check.py first [--years 100]        so many other cells, each checked once after its calibration
    python benchmarks/check.py power [--years 20]         years with a change, for each change that the fakes can make
    python benchmarks/check.py year [--years 3]           the rest of the year for those that are not noticed within a month
    python benchmarks/check.py page                       the figures of all as benchmarks/check.md

A cell is calibrated from a recording of plans/seeing.yaml by the array path (the fake cell's world without protocols), and its twelve poses
are chosen. Days of these are recorded by the same path. There is a pool of days as they are, and a trace for each change and each of its
sizes, the difference of two days of one noise with and without it. The days of a year are put together of poses of the pool, with a random
sign of their noise, and the changes from day to day are added to them. A change stands from day 30 on. Years without a change are looked at
daily until day 60 and every tenth day from then on, or on all days (``daily``). Years with a change are looked at daily from the change for
a month, and the rest of the year in steps that grow by a tenth (``year``). For changes more than twenty checks back the simulation takes
every fifth with the weight of five. Figures are kept in runs/check-benchmark, so that a call goes on where another ended.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from bench import PLANS, main, option
from mbcacq_fakes.effects import CATALOGUED, UNCATALOGUED
from threadpoolctl import threadpool_limits

import mbcacq
from mbcacq.calibration.calibrated_cell import CalibratedCell
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.simulated_cells import observe
from mbcacq.interim_check.e_process import EProcess
from mbcacq.interim_check.measured_day import fit_stations, residuals_of
from mbcacq.interim_check.options import OPTIONS, UsualChanges
from mbcacq.interim_check.planned_check import PlannedCheck, choose_poses, planned_check
from mbcacq.interim_check.verdict import Evidence, verdict_by
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose, expand

KEPT = Path("runs") / "check-benchmark"
CLEAN = Scenario(0, "none", 5, (), 1, 1.0)
POOL = 500  # days as they are
ONSET, LAST = 30, 60  # a change stands from this day on, and is waited for until that one
YEAR = 365
LOOKS = (*range(2, 61), *range(70, YEAR + 1, 10))  # of a year in which nothing changes
DAILY = range(2, YEAR + 1)
WITHIN_A_RUN = ("joint_step", "mount_shift")  # begin in the middle of a run, and stand at its first pose here
SIZES = (0.1, 0.3, 1.0)  # of what a plan that can see shows plainly
THRESHOLD = np.log(2 / OPTIONS.false_alarms)


@dataclass(frozen=True)
class Change:
    """What differs in the fake cell. hidden: its injected effects; fake: further options."""

    name: str
    hidden: tuple[Mapping[str, Any], ...] = ()
    fake: Mapping[str, Any] | None = None


def changes(size: float) -> list[Change]:
    """Every injected effect, and of those within a run the lasting form."""
    out = []
    for number, name in enumerate((*CATALOGUED, *UNCATALOGUED)):
        where = {"at_pose": 0} if name in WITHIN_A_RUN else {}
        out.append(Change(name, ({"name": name, "strength": size, "seed": 11 + number, **where},)))
    elastic = {"name": "payload", "mass_kg": 2.3, "com_mm": [-6, 4, 62], "seed": 1}
    heavier = elastic | {"mass_kg": 2.3 + 2.0 * size}
    return [*out, Change("tool (mass, on an elastic arm)", (heavier,), {"before": [elastic]})]


class Bench:
    """A calibrated cell with its check and the days of its pool."""

    def __init__(self) -> None:
        self.loaded: LoadedPlan = mbcacq.load_plan(PLANS / "seeing.yaml")
        poses = expand(self.loaded)
        recorded, _ = observe(self.loaded, poses, CLEAN, [])
        with threadpool_limits(1):
            cell = calibrated(recorded)
            everything = planned_check(self.loaded, [p for p in poses if len(p.balls) > 2], cell, True, UsualChanges())
            numbers = choose_poses(everything)
            self.poses: list[PlannedPose] = [p for p in poses if p.number in numbers]
            self.check: PlannedCheck = planned_check(self.loaded, self.poses, cell, True, UsualChanges())
        self.stations = fit_stations(self.check, self.recorded(10_000))
        self.pool = np.array([self.rows(self.recorded(day)) for day in range(POOL)])
        changes = self.check.changes
        self.process = EProcess(self.check.rows, [r.columns for r in changes], np.array([r.weight for r in changes]))

    def recorded(self, day: int, hidden=()):
        return observe(self.loaded, self.poses, CLEAN, list(hidden), noise_seed=20_000 + day)[0]

    def rows(self, obs) -> np.ndarray:
        residual = residuals_of(self.check, obs, self.stations)
        return np.concatenate([residual[key] for key in self.check.keys])

    def trace(self, change: Change) -> np.ndarray:
        """(R,) what a change does to the rows: without noise, for both recordings draw the same."""
        before = (change.fake or {}).get("before", ())
        day = 30_000 + len(change.name)
        return self.rows(self.recorded(day, change.hidden)) - self.rows(self.recorded(day, before))

    def year(self, days: int, rng: np.random.Generator, usual: float) -> np.ndarray:
        """(days, R), with ``usual`` times what changes from day to day. Each pose of a day is one of the pool with a sign of its noise, for
        days that were drawn twice would have the same noise twice, which is what a change looks like."""
        daily, mean = self.check.rows.daily, self.pool.mean(axis=0)
        pose = np.repeat(self.check.obs.pose, 3)
        poses = len(self.poses)
        drawn = rng.integers(0, len(self.pool), (days, poses))[:, pose]
        sign = rng.choice([-1.0, 1.0], (days, poses))[:, pose]
        noise = self.pool[drawn, np.arange(len(pose))] - mean
        return mean + sign * noise + usual * rng.standard_normal((days, daily.shape[1])) @ daily.T

    def changed(self, days: int, number: int, trace: np.ndarray) -> np.ndarray:
        """(days, R): the year of this number, with a change from its day on."""
        out = self.year(days, np.random.default_rng([2, number]), 1.0)
        out[ONSET:] += trace
        return out

    def log_e(self, days: np.ndarray, looks: Iterable[int]) -> np.ndarray:
        """log E after each of these numbers of days."""
        followed, out = self.process.follow(days - days.mean(axis=0)), []
        for t in looks:
            near = np.arange(max(1, t - 20), t)
            far = np.arange(3, near[0], 5)
            after = np.concatenate([far, near])
            onsets = self.process.log_onsets(after.astype(float)) + np.where(after < near[0], np.log(5.0), 0.0)
            out.append(followed.log_e(t, after, onsets))
        return np.array(out)


def calibrated(recorded: Observations) -> CalibratedCell:
    """The cell of a recording, as it is read back from its file."""
    return CalibratedCell.from_dict(json.loads(json.dumps(mbcacq.calibrate(recorded).to_dict())))


def kept(name: str) -> dict[str, Any]:
    """Figures of earlier calls."""
    path = KEPT / f"{name}.json"
    return json.loads(path.read_text()) if path.exists() else {}


def keep(name: str, content: Mapping[str, Any]) -> None:
    KEPT.mkdir(parents=True, exist_ok=True)
    (KEPT / f"{name}.json").write_text(json.dumps(content))


def note(kind: str, found: dict[str, Any], change: Change, size: float, trace: np.ndarray, **figures: list) -> None:
    """Keep and print what came of a change."""
    moved = float(np.sqrt(np.mean(np.sum(trace.reshape(-1, 3) ** 2, axis=1))))
    found[f"{change.name} {size}"] = {"name": change.name, "size": size, "moved_mm": moved, **figures}
    keep(kind, found)
    print(f"{change.name} {size}", f"{1e3 * moved:.1f} um", *figures.values(), flush=True)


def nothing(bench: Bench, years: int, seconds: float, looks: Iterable[int] = LOOKS, name: str = "nothing", stream: int = 1) -> None:
    """Years without a change, at three sizes of what changes from day to day."""
    found, until = kept(name), time.monotonic() + seconds
    for year in range(years):
        usual = (0.0, 1.0, 2.0)[year % 3]
        if str(year) in found:
            continue
        if time.monotonic() > until:
            break
        days = bench.year(YEAR, np.random.default_rng([stream, year]), usual)
        log_e = bench.log_e(days, looks)
        found[str(year)] = {"usual": usual, "largest": float(log_e.max()), "last": float(log_e[-1])}
        keep(name, found)
    print(len(found), "years, largest log E", max(v["largest"] for v in found.values()))


def first(bench: Bench, cells: int, seconds: float) -> None:
    """Other cells of the kind, each calibrated and checked once with nothing changed: the e-value since the calibration."""
    found, until = kept("first"), time.monotonic() + seconds
    for number in range(cells):
        if str(number) in found:
            continue
        if time.monotonic() > until:
            break
        scenario = replace(CLEAN, seed=1000 + number)
        recorded, _ = observe(bench.loaded, expand(bench.loaded), scenario, [])
        check = planned_check(bench.loaded, bench.poses, calibrated(recorded), True, UsualChanges())
        again, _ = observe(bench.loaded, bench.poses, scenario, [], noise_seed=50_000 + number)
        residual = residuals_of(check, again, fit_stations(check, again))
        day = np.concatenate([residual[key] for key in check.keys])[None]
        process = EProcess(check.rows, [r.columns for r in check.changes], np.array([r.weight for r in check.changes]))
        verdict = verdict_by(Evidence(process, check.changes, day, np.ones(day.shape[1], bool)), check)
        found[str(number)] = verdict.log_e_calibration
        keep("first", found)
    print(len(found), "cells, largest log E since the calibration", max(found.values()))


def power(bench: Bench, years: int, seconds: float) -> None:
    """For each change and size: the day of the alarm after the change, and whether the name is right."""
    found, until = kept("power"), time.monotonic() + seconds
    for size in SIZES:
        for change in changes(size):
            key = f"{change.name} {size}"
            if key in found:
                continue
            if time.monotonic() > until:
                return
            trace = bench.trace(change)
            after, named = [], []
            for year in range(years):
                days = bench.changed(LAST, year, trace)
                log_e = bench.log_e(days, range(ONSET + 1, LAST + 1))
                alarm = np.flatnonzero(log_e >= THRESHOLD)
                after.append(int(alarm[0]) + 1 if len(alarm) else None)
                if len(alarm) and not named:
                    named.append(names(bench, days[: min(ONSET + alarm[0] + 7, LAST)]))
            note("power", found, change, size, trace, after=after, named=named)


def year(bench: Bench, years: int, seconds: float) -> None:
    """The rest of the year for changes of which some were not noticed within a month: after how many checks the alarm comes."""
    month, found, until = kept("power"), kept("year"), time.monotonic() + seconds
    looks = rest_of_the_year()
    for size in SIZES:
        for change in changes(size):
            key = f"{change.name} {size}"
            missed = key not in month or None in month[key]["after"]
            if key in found or not missed:
                continue
            trace, after = bench.trace(change), []
            for number in range(years):
                if time.monotonic() > until:
                    return
                alarm = np.flatnonzero(bench.log_e(bench.changed(YEAR, number, trace), looks) >= THRESHOLD)
                after.append(looks[int(alarm[0])] - ONSET if len(alarm) else None)
            note("year", found, change, size, trace, after=after)


def rest_of_the_year() -> list[int]:
    """Days of looks after the first month with a change, in steps that grow by a tenth of what has passed since; the last day is one."""
    days = [LAST]
    while days[-1] < YEAR:
        days.append(min(days[-1] + max((days[-1] - ONSET) // 10, 1), YEAR))
    return days


def names(bench: Bench, days: np.ndarray) -> list[str]:
    """The suspects a week after the alarm."""
    keep = np.ones(days.shape[1], bool)
    verdict = verdict_by(Evidence(bench.process, bench.check.changes, days, keep), bench.check)
    return [f"{s.name} ({s.explains:.2f})" if s.explains < 0.995 else s.name for s in verdict.suspects[:3]]


def page(given: argparse.Namespace) -> None:
    """Tables on stdout, as they stand in benchmarks/check.md."""
    print("| changes from day to day | years | looks | alarms | largest E ever |\n|--:|--:|--:|--:|--:|")
    for name, looks in (("nothing", len(LOOKS)), ("daily", len(DAILY))):
        years = list(kept(name).values())
        for usual in sorted({y["usual"] for y in years}):
            largest = np.array([y["largest"] for y in years if y["usual"] == usual])
            alarms = int((largest >= THRESHOLD).sum())
            print(f"| {usual:g} x usual | {len(largest)} | {len(largest) * looks} | {alarms} | {np.exp(largest.max()):.2g} |")
    since = np.array(list(kept("first").values()))
    if len(since):
        above = int((since >= THRESHOLD).sum())
        print(f"\n{len(since)} cells checked once after their calibration: {above} alarms, largest E {np.exp(since.max()):.2g}")
    if rest := kept("year"):
        print("\n| change | size | moves the balls by / µm | alarms within the year | after checks |\n|---|--:|--:|--:|---|")
        for one in rest.values():
            after = [a for a in one["after"] if a is not None]
            when = ", ".join(map(str, sorted(after))) or "–"
            print(f"| {one['name']} | {one['size']:g} | {1e3 * one['moved_mm']:.1f} | {len(after)} of {len(one['after'])} | {when} |")
    print("\n| change | size | moves the balls by / µm | alarms | after checks (median, 90 %) | named a week later |")
    print("|---|--:|--:|--:|--:|---|")
    for one in kept("power").values():
        after = [a for a in one["after"] if a is not None]
        when = f"{np.median(after):.0f}, {np.quantile(after, 0.9):.0f}" if after else "–"
        said = "; ".join(dict.fromkeys(", ".join(n) for n in one["named"]))
        print(f"| {one['name']} | {one['size']:g} | {1e3 * one['moved_mm']:.1f} | {len(after)} of {len(one['after'])} | {when} | {said} |")


def studied(study: Callable[..., None], **more: Any) -> Callable[[argparse.Namespace], None]:
    """A study of so many years as a command."""

    def command(given: argparse.Namespace) -> None:
        bench = Bench()
        with threadpool_limits(1):
            study(bench, given.years, given.seconds, **more)

    command.__doc__ = study.__doc__
    return command


if __name__ == "__main__":
    SECONDS = option("--seconds", type=float, default=240.0, help="after which the call ends; the next goes on")
    every_day = {"looks": DAILY, "name": "daily", "stream": 5}
    studies = {"nothing": (nothing, 1000, {}), "daily": (nothing, 300, every_day), "first": (first, 100, {})}
    studies |= {"power": (power, 4, {}), "year": (year, 3, {})}
    commands = {
        name: (studied(study, **more), [option("--years", type=int, default=years, help="or cells"), SECONDS])
        for name, (study, years, more) in studies.items()
    }
    main(__doc__, {**commands, "page": (page, [])})

"""A fleet of 500 made recordings: throughput of two workers over one, kill -9 and resume, a corrupted recording, drift, a learnt prior.

    python benchmarks/fleet.py [--arms 50] [--days 10] [--write]

Fifty arms of one type, ten days each; the arms' errors are 0.3 of an arm's usual ones about a mean of the type. One arm drifts, one has
a crash after 0.6 of the days, one has a link of the wrong length, one recording is cut in the middle of a row. Prints a page;
--write keeps it as benchmarks/fleet.md.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import bench  # noqa: F401  # before the simulated cells of the tests
import cells
import numpy as np
from bench import HERE, MBCACQ

from mbcacq.calibration.calibrate import calibrate
from mbcacq.estimation.forward_model import CellState
from mbcacq.estimation.options import ArmPrior, CalibrationOptions
from mbcacq.fleet.arm_prior import population, read_priors
from mbcacq.fleet.control_chart import arm_types, outliers
from mbcacq.fleet.evaluation import FleetTask, evaluate_recording
from mbcacq.fleet.recordings import find_recordings
from mbcacq.fleet.store import FleetStore, read_table, stored_result
from mbcacq.geometry import se3
from mbcacq.model.observations import Observations
from mbcacq.recording.datasets.observation_set import write_observation_set

NOISE, JOINT = (0.005, 0.005, 0.009), 8e-6
SPREAD = 0.3
DRIFTING, CRASHED, ODD, CORRUPTED = 3, 17, 18, (8, 4)
THETA_2, THETA_3, A_2 = (1, 0), (2, 0), (1, 2)
POSTURES = 200
ROUNDS = 5
STATIONS = (2, 3, 4, 5, 6, 8, 11, 16)


def arm_errors(arm: int, day: int, days: int, mean: np.ndarray) -> np.ndarray:
    """(6, 5) true errors of an arm on a day."""
    errors = mean + cells.random_errors(cells.kr10(), np.random.default_rng(1000 + arm), SPREAD)
    if arm == DRIFTING:
        errors[THETA_2] += 6e-4 * day / (days - 1)
    if arm == CRASHED and day >= 0.6 * days:
        errors[THETA_3] += 5e-4
    if arm == ODD:
        errors[A_2] += 2.0
    return errors


def measured(design: cells.Simulated, errors: np.ndarray, seed: int) -> tuple[Observations, CellState]:
    """The poses of a design, measured with an arm of these errors."""
    truth = CellState(cells.kr10().with_errors(errors), design.truth.T_flange_scanner, design.truth.T_base_station, design.truth.balls)
    return cells.measure(design.observations, truth, np.random.default_rng(seed), NOISE, JOINT), truth


def made(folder: Path, arms: int, days: int) -> None:
    """The recordings, one corrupted."""
    rng = np.random.default_rng(1)
    design = cells.scanner_cell(rng, stations=6, per_station=5, bars=1, errors=np.zeros((6, 5)))
    mean = cells.random_errors(cells.kr10(), np.random.default_rng(7))
    for arm in range(arms):
        for day in range(days):
            place = folder / f"arm-{arm + 1:02d}" / f"2026-03-{day + 1:02d}"
            if not (place / "centres.csv").exists():  # in a folder that was kept
                write_observation_set(measured(design, arm_errors(arm, day, days, mean), 100 * arm + day)[0], place)
    arm, day = min(CORRUPTED[0], arms), min(CORRUPTED[1], days)
    file = folder / f"arm-{arm:02d}" / f"2026-03-{day:02d}" / "centres.csv"
    file.write_bytes(file.read_bytes()[:2001] + b"\xff\x00,,")


def watched(folder: Path, out: Path, workers: int, stop_at: int | None = None) -> tuple[float, float, int]:
    """Run the command; (seconds until the first result, results a second after it, results that were there in the end).

    stop_at: number of results at which it is killed with -9.
    """
    start, before = time.monotonic(), results(out)
    process = subprocess.Popen([MBCACQ, "fleet", folder, "--out", out, "--workers", str(workers)], stdout=subprocess.DEVNULL)
    first, count, last = None, before, start
    while process.poll() is None:
        now = results(out)
        if now > count:
            count, last = now, time.monotonic()
            first = first or (last, count)
        if stop_at is not None and count >= stop_at:
            process.send_signal(signal.SIGKILL)
            process.wait()
        time.sleep(0.05)
    if first is None:
        return 0.0, 0.0, count
    return first[0] - start, (count - first[1]) / max(last - first[0], 1e-9), results(out)


def results(out: Path) -> int:
    """How many are there; by their names alone, since who counts shares the cores."""
    folder = out / "recordings"
    return sum(name.endswith(".json") for name in os.listdir(folder)) if folder.exists() else 0


def independent(folder: Path, out: Path, processes: int) -> float:
    """Results a second, from the first on, of plain processes that share the recordings and know nothing of each other: what the
    computer allows, without a cluster.
    """
    command = [sys.executable, __file__, "--plain", folder, "--keep", out, "--share"]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}  # as a worker has it
    running = [subprocess.Popen([*command, f"{k}/{processes}"], stdout=subprocess.PIPE, env=environment) for k in range(processes)]
    times = np.sort(np.concatenate([np.array(process.communicate()[0].split(), dtype=float) for process in running]))
    return (len(times) - 1) / (times[-1] - times[0])


def ranged(values: np.ndarray) -> str:
    """The median of the rounds, and the lowest and the highest."""
    return f"{np.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def plain(folder: Path, out: Path, share: str) -> None:
    """Evaluate and store a share of the recordings, as a worker does; prints when each result was there."""
    first, step = map(int, share.split("/"))
    store, task, times = FleetStore(out, FleetTask()), FleetTask(), []
    for one in find_recordings([folder])[first::step]:
        store.keep(one, stored_result(*evaluate_recording(one, task), store.stamp(one)))
        times.append(time.monotonic())
    print(*times)


def workspace_error(found: CellState, truth: CellState) -> float:
    """rms (mm) over postures of the misplacement of a measured point, a rigid motion of everything aside."""
    q = np.random.default_rng(5).uniform(-2, 2, (POSTURES, 6))
    at = np.array([0.0, 0.0, 250.0])
    a, b = (se3.apply(state.chain.flange(q) @ state.T_flange_scanner, at) for state in (found, truth))
    u, _, vt = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    R = (u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt).T
    return float(np.sqrt(np.mean(np.sum(((a - a.mean(0)) @ R.T - (b - b.mean(0))) ** 2, axis=1))))


def prior_of(spread: float, mean: np.ndarray, design: cells.Simulated, arms: int) -> ArmPrior:
    """The prior that calibrations of so many arms of this spread give."""
    value, information = [], []
    chain = cells.kr10()
    names = [f"{p}_{i + 1}" for i in range(6) for p in ("theta", "d", "a", "alpha", "beta")]
    for arm in range(arms):
        fit = calibrate(measured(design, mean + cells.random_errors(chain, np.random.default_rng(3000 + arm), spread), 4000 + arm)[0])
        place = [fit.names.index(name) if name in fit.names else -1 for name in names]
        here = np.array([k for k, p in enumerate(place) if p >= 0])
        own = np.zeros((30, 30))
        own[np.ix_(here, here)] = np.linalg.inv(fit.covariance[np.ix_([place[k] for k in here], [place[k] for k in here])])
        value.append(fit.errors.reshape(-1))
        information.append(own)
    middle, sigma = population(np.array(value), np.array(information))
    return ArmPrior("test arm", chain.rows, middle.reshape(6, 5), sigma.reshape(6, 5), arms)


def study(priors: dict[float, ArmPrior], mean: np.ndarray, arms: int) -> list[str]:
    """Error against number of poses, without and with a prior."""
    design = cells.scanner_cell(np.random.default_rng(2), stations=max(STATIONS), per_station=5, errors=np.zeros((6, 5)))
    lines = []
    for stations in STATIONS:
        keep = design.observations.station < stations
        row = [f"{stations}", f"{int(keep.sum())}"]
        for spread, prior in priors.items():
            for used in ((), (prior,)):
                square = []
                for arm in range(arms):
                    errors = mean + cells.random_errors(cells.kr10(), np.random.default_rng(9000 + arm), spread)
                    obs, truth = measured(design, errors, 9500 + arm)
                    fit = calibrate(obs.select(keep), CalibrationOptions(refuse=False, priors=used))
                    square.append(workspace_error(fit.state, truth) ** 2)
                row.append(f"{np.sqrt(np.mean(square)):.4f}")
        lines.append("| " + " | ".join(row) + " |")
        print(lines[-1], flush=True)
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", type=int, default=50)
    parser.add_argument("--days", type=int, default=10)
    parser.add_argument("--study-arms", type=int, default=12)
    parser.add_argument("--keep", type=Path, help="Folder in which recordings and results stay.")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--plain", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--share", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.plain:
        plain(options.plain, options.keep, options.share)
        return
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as temporary:
        work = options.keep or Path(temporary)
        recordings, total = work / "recordings", options.arms * options.days
        made(recordings, options.arms, options.days)
        print("made", flush=True)
        half = watched(recordings, work / "two", 2, total // 2)
        print("killed", half, flush=True)
        files = {path: path.stat().st_mtime_ns for path in (work / "two" / "recordings").glob("*.json")}
        rest = watched(recordings, work / "two", 2)
        repeated = sum(path.stat().st_mtime_ns != then for path, then in files.items())
        print("resumed", rest, repeated, flush=True)
        rounds = []  # the speed of the computer itself varies over minutes: what is compared is measured in turns
        for k in range(ROUNDS):
            one, two = (watched(recordings, work / f"{k}-{n}", n) for n in (1, 2))
            rounds.append((one[1], two[1], *(independent(recordings, work / f"{k}-alone-{n}", n) for n in (1, 2)), one[0], two[0]))
            print("round", rounds[-1], flush=True)
        rows = read_table(work / "two")
        broken = [row for row in rows if row.status != "evaluated"]
        found = outliers(arm_types(rows))
        by_arm = sorted({(o.arm, o.name) for o in found if o.recording})
        odd = sorted({(o.arm, o.name) for o in found if o.recording is None and not o.drift})
        moving = sorted((o.arm, o.name, o.value) for o in found if o.drift)
        outside = len({o.recording for o in found if o.recording and o.arm not in (f"arm-{DRIFTING + 1:02d}", f"arm-{CRASHED + 1:02d}")})
        processor = float(np.mean([row.processor_s or 0.0 for row in rows]))
        mean = cells.random_errors(cells.kr10(), np.random.default_rng(7))
        design = cells.scanner_cell(np.random.default_rng(1), stations=6, per_station=5, bars=1, errors=np.zeros((6, 5)))
        priors = {SPREAD: read_priors(work / "two")[0], 1.0: prior_of(1.0, mean, design, 30)}
        table = study(priors, mean, options.study_arms)
    *rates, one_first, two_first = np.array(rounds).T
    first = (one_first, two_first)
    reasons = "; ".join((row.reason or "").replace(f"{recordings}/", "") for row in broken)
    named, unlike = (", ".join(f"{arm} {name}" for arm, name in each) or "none" for each in (by_arm, odd))
    drifting = (
        ", ".join(f"{arm} {name} ({1e3 * change:+.2f} {'um' if name.startswith(('a_', 'd_')) else 'mrad'})" for arm, name, change in moving)
        or "none"
    )
    size = f" --arms {options.arms} --days {options.days} --study-arms {options.study_arms}"
    page = f"""# Fleet

**Question.** How fast does a fleet go, what does it find, and how many poses does a prior save?

`python benchmarks/fleet.py{size} --write`: {total} made recordings ({options.arms} arms, {options.days} days, a small plan of
{rows[0].poses} poses each) through `mbcacq fleet`, on a two-core machine (load {load:.1f} at the start).

| | results a second | first result after |
|---|--:|--:|
| one worker | {ranged(rates[0])} | {np.median(first[0]):.1f} s |
| two workers | {ranged(rates[1])} | {np.median(first[1]):.1f} s |
| one plain process, no cluster | {ranged(rates[2])} | |
| two plain processes, half of the recordings each | {ranged(rates[3])} | |
| two workers, until killed with -9 at {half[2]} results | {half[1]:.2f} | {half[0]:.1f} s |
| two workers, resumed | {rest[1]:.2f} | {rest[0]:.1f} s |

Two workers over one: {ranged(rates[1] / rates[0])} (1.8 asked). What the computer allows, two plain processes over one:
{ranged(rates[3] / rates[2])}. Two workers reach {ranged(rates[1] / rates[3])} of the rate of two plain processes.
Medians of {ROUNDS} rounds (lowest to highest). A recording takes
{1e3 * processor:.0f} ms of processor time.

{repeated} of the {half[2]} results that were there after the kill were made again.

Without a result: {len(broken)} recording, the one that was cut in the middle of a row: {reasons}.

Concealed: arm-{DRIFTING + 1:02d} drifts by 0.6 mrad in theta_2, theta_3 of arm-{CRASHED + 1:02d} is 0.5 mrad off after 0.6 of the days,
link 2 of arm-{ODD + 1:02d} is 2 mm too long. Outside their control limits: {named}.
Unlike the other arms: {unlike}. Drifting from their first recording to their last: {drifting}.
False alarms: {outside} of {total} recordings (about {total * 0.0027:.1f} are expected).

## What a prior saves

rms misplacement (mm) of a measured point over the workspace, {options.study_arms} arms that are not in the fleet. Spread: of the arms
about the mean of their type, in usual errors of an arm (theta 0.5 mrad, a and d 0.2 mm, alpha and beta 0.2 mrad).

| stations | poses | spread 0.3: no prior | prior | spread 1: no prior | prior |
|--:|--:|--:|--:|--:|--:|
{chr(10).join(table)}
"""
    print(page)
    if options.write:
        (HERE / "fleet.md").write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()

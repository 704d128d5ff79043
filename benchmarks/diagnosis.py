"""Diagnoses of whole recordings: time and memory, one arm on two days, heavy arms where everything elastic acts at once.

    python benchmarks/diagnosis.py time [--tracker ../shared/data/ur10-tracker-a]
    python benchmarks/diagnosis.py two-days [--pairs 30] [--write]
    OMP_NUM_THREADS=1 python benchmarks/diagnosis.py heavy-arms [--cells 2] [--out benchmarks/heavy_arms.md]

Each command says more with --help.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import bench
import numpy as np
from bench import END, HERE, MBCACQ, option, put, writes
from cells import inverse_kinematics
from mbcacq_fakes.cell import computed_run
from mbcacq_fakes.cell.build_world import make_world
from mbcacq_fakes.world.description import from_cell
from mbcacq_fakes.world.options import parse

import mbcacq
from mbcacq.challenge.run import with_observable_locations
from mbcacq.challenge.scenarios import Scenario
from mbcacq.challenge.score import Score, score
from mbcacq.challenge.simulated_cells import observe
from mbcacq.challenge.strength import Gauge
from mbcacq.diagnosis.diagnose import diagnose
from mbcacq.geometry import se3
from mbcacq.model import shipped
from mbcacq.model.cell import TARGET_IN_BASE, Artefact, Cell, RobotModel, Station
from mbcacq.model.observations import Observations
from mbcacq.plan import LoadedPlan, PlannedPose, expand

CASES = (
    ("nothing concealed", "none", 41),
    ("an elastic joint", "joint_compliance", 42),
    ("two effects", "two", 43),
    ("an effect without a name", "link_bending", 44),
)


LIMITS = {"made": (8.0, 2.0), "tracker": (25.0, 2.0)}
ELASTIC = ("joint_compliance", ("A2",), [2.5e-6], None)
SLIPPED = ("mount_shift", ("mount",), [0.02, 0.01, -0.02, 1e-4, -5e-5, 5e-5], 60.0)
TIMES = """# Diagnosis: time and memory

Made by `python benchmarks/diagnosis.py time --tracker ../shared/data/ur10-tracker-a`: whole processes with the full catalogue and the
validation on data left out, on two cores. The process itself and one more share the validation, each with one thread of linear algebra.
Memory is that of the larger one. How right it is: [challenge.md](challenge.md). What stands below the table was written by hand.

| recording | poses | centres | wall, s | processor, s | memory, GiB | asked: wall, memory |
|---|--:|--:|--:|--:|--:|---|"""


def made(effect: str, seed: int, folder: Path) -> Path:
    """An observation set of a challenge."""
    subprocess.run(
        [MBCACQ, "challenge", "--fast", "--effects", effect, "--seed", str(seed), "--count", "1", "--out", folder],
        check=True,
        capture_output=True,
    )
    return next(folder.rglob("observations"))


def twist(s):
    """Torsion of link 2 about its length, under the moment about it, until it saturates: no effect of the catalogue."""
    from mbcacq.estimation.forward_model import Displacements

    moment = s.gravity_moment(2)[:, 0]
    frame = np.zeros((s.obs.n_poses, s.n + 1, 6))
    frame[:, 2, 3] = 6e-4 * np.tanh(moment / (2 * moment.std()))
    return Displacements(frame=frame)


ALL_SEEN = (("nothing", []), ("an elastic joint", [ELASTIC]), ("two effects", [ELASTIC, SLIPPED]), ("an effect without a name", [twist]))


def all_seen(effects: list, folder: Path) -> Path:
    """An observation set of 128 poses that see eight balls each."""
    import simulated as cells

    from mbcacq.recording.datasets.observation_set import write_observation_set

    write_observation_set(cells.observe(cells.plan(stations=16, bars=0, each=8), 300, effects), folder)
    return folder


def timed(data: Path) -> tuple[float, float, float]:
    """Wall s, processor s, largest resident memory in GiB."""
    start = time.perf_counter()
    process = subprocess.Popen([MBCACQ, "diagnose", data], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    if os.waitstatus_to_exitcode(status):
        raise SystemExit(f"diagnose {data} ended with {os.waitstatus_to_exitcode(status)}")
    return wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20


def time_row(name: str, data: Path, kind: str) -> str:
    poses, centres = (sum(1 for _ in (data / name).open()) - 1 for name in ("poses.csv", "centres.csv"))
    wall, processor, memory = timed(data)
    limit, most = LIMITS[kind]
    return f"| {name} | {poses} | {centres} | {wall:.1f} | {processor:.1f} | {memory:.2f} | {limit:g} s, {most:g} GiB |"


def times(given: argparse.Namespace) -> None:
    """Time and memory of ``mbcacq diagnose`` as whole processes, start of the interpreter included.

    Made recordings: ``plans/seeing.yaml``, 128 poses before balls and bar (605 centres), and 128 poses at 16 stations that see all eight
    balls (1024 centres). They conceal nothing, one and two effects, and one without a name. --tracker: a long recording besides.
    """
    recordings = [(name, partial(made, effect, seed)) for name, effect, seed in CASES]
    recordings += [(f"all balls seen, {name}", partial(all_seen, effects)) for name, effects in ALL_SEEN]
    lines = [TIMES]
    for name, make in recordings:
        with tempfile.TemporaryDirectory() as folder:
            lines.append(time_row(name, make(Path(folder)), "made"))
        print(lines[-1], flush=True)
    if given.tracker is not None:
        lines.append(time_row(given.tracker.name, given.tracker, "tracker"))
        print(lines[-1])
    below = given.out.read_text(encoding="utf-8").partition(END)[2] if given.out.exists() else ""
    given.out.write_text("\n".join(lines) + f"\n\n{END}{below}", encoding="utf-8")


KINDS = ("joint_compliance", "none", "gear_transmission_error", "joint_scale", "none", "wrist_coupling")
CLIMATES = ({"air_C": 19.0, "warmup_K": 6.0}, {"air_C": 26.0, "warmup_K": 11.0})
WEAKEST, STRONGEST = 0.03, 0.5  # excess of chi2 per degree of freedom on one day: about where power rises from none to all
WAYS = ("first day", "second day", "both")


def day(loaded: LoadedPlan, poses: list[PlannedPose], injected: list, seed: int, climate: dict) -> tuple[Observations, list]:
    """One day's recording, and the true effects."""
    observations, truth = observe(loaded, poses, Scenario(0, "day", seed, (), 0, 0.0), injected, climate)
    return observations, [with_observable_locations(dict(effect)) for effect in truth["effects"]]


def pair(loaded: LoadedPlan, poses: list[PlannedPose], gauge: Gauge, number: int) -> tuple[str, list[Score]]:
    """The kind of effect, and the scores of the first day, the second and both."""
    rng = np.random.default_rng([41, number])
    kind = KINDS[number % len(KINDS)]
    seeds = [int(s) for s in rng.integers(1, 2**31 - 1, 3)]
    excess = float(np.exp(rng.uniform(np.log(WEAKEST), np.log(STRONGEST))))
    names = () if kind == "none" else (kind,)
    injected = gauge.inject(Scenario(number, kind, seeds[0], names, seeds[2], excess))
    days = [day(loaded, poses, injected, seed, climate) for seed, climate in zip(seeds[:2], CLIMATES, strict=True)]
    truth = days[0][1]
    recordings = [observations for observations, _ in days]
    found = [mbcacq.diagnose(data, workers=1) for data in (*recordings, recordings)]
    return kind, [score(kind, truth, one.main.to_json(), 1.0) for one in found]


def days_table(results: list[tuple[str, list[Score]]]) -> list[str]:
    """The figures of all pairs as a table."""
    present = sum(kind != "none" for kind, _ in results)
    out = [
        f"{present} pairs with an effect, {len(results) - present} without.",
        "",
        "| diagnosed | named at its location | false names, with an effect | anything named without one | parameters within 3 sigma |",
        "|---|---|---|---|---|",
    ]
    for way, label in enumerate(WAYS):
        with_effect = [scores[way] for kind, scores in results if kind != "none"]
        without = [scores[way] for kind, scores in results if kind == "none"]
        sigmas = np.array([abs(v) for s in with_effect for v in s.sigmas.values()])
        right = f"{int((sigmas < 3).sum())} of {len(sigmas)}" if len(sigmas) else "none reported"
        named = sum(s.placed for s in with_effect)
        false = sum(bool(s.extra) for s in with_effect)
        alarms = sum(bool(s.reported) for s in without)
        out.append(f"| {label} | {named} of {len(with_effect)} | {false} | {alarms} of {len(without)} | {right} |")
    lost = Counter(kind for kind, s in results if kind != "none" and (s[0].placed or s[1].placed) and not s[2].placed)
    gained = Counter(kind for kind, s in results if kind != "none" and not (s[0].placed or s[1].placed) and s[2].placed)
    return [
        *out,
        "",
        f"Found by both together and by neither alone: {_listed(gained)}. Found by one alone and not by both: {_listed(lost)}.",
    ]


def _listed(counted: Counter) -> str:
    return ", ".join(f"{n} {kind}" for kind, n in sorted(counted.items())) or "none"


def two_days(given: argparse.Namespace) -> None:
    """Joint diagnosis of one arm on two days against that of each day alone.

    A fake cell conceals one effect of the arm, or none. It is recorded on two days (by arrays): another tool mount and other placements,
    other temperatures, other noise, the same arm and the same effect. Each day is diagnosed alone, and both together. Printed are how
    often the effect is named at its location, how often something is named that is not there, and how many of the parameters lie
    within three stated standard deviations.
    """
    loaded = mbcacq.load_plan(given.plan)
    every = [p for p in expand(loaded) if p.phase != "verification"]
    keep = set(np.linspace(0, len(every) - 1, given.poses).astype(int).tolist())
    poses = [p for i, p in enumerate(every) if i in keep]
    gauge = Gauge(loaded, poses)
    results = []
    for number in range(given.pairs):
        results.append(pair(loaded, poses, gauge, number))
        kind, scores = results[-1]
        print(number, kind, *("; ".join(s.reported) or "-" for s in scores), sep=" | ", flush=True)
        if given.write:
            put(HERE / "joint_diagnosis.md", "\n".join(days_table(results)))
    print(*days_table(results), sep="\n")


ROBOTS = ("kr210_r2700_2", "kr300_r2700_2")
CONCEALED: list[dict[str, Any]] = [
    {"name": "joint_compliance", "where": "A3", "compliance_rad_per_Nm": 4e-7},
    {"name": "joint_compliance", "where": "A5", "compliance_rad_per_Nm": 1.5e-6},
    {"name": "gravity_compensator", "share": 0.6, "lever_ratio": 0.25, "compliance_rad_per_Nm": 2.5e-7},
    {"name": "lost_motion", "where": "A3", "lost_motion_deg": 0.012, "breakpoint_Nm": 700.0, "compliance_rad_per_Nm": 0.0},
    {"name": "hysteresis", "where": "A2", "half_width_rad_per_Nm": 8e-9},
    {"name": "base_compliance", "compliance_rad_per_Nm": 1.5e-8},
    {"name": "gear_transmission_error", "where": "A1", "order": 2, "amplitude_deg": 0.004, "phase_deg": 70},
]


FAKE = {"repeatability_urad": 8.0, "errors": "paper", "hidden": CONCEALED}
TARGET = np.array([40.0, 30.0, 180.0])  # mm in the flange frame
TRACKER_MM, TRACKER = 0.015, se3.transform(se3.rotation_exp(np.array([0.0, 0.0, 0.3])), np.array([4500.0, 600.0, 900.0]))
MBC = np.array([[-30.0, 8, 1], [10, 24, 4], [6, -13, 2], [-10, -28, -3], [25, -3, -7], [31, 16, -10], [-9, 6, 7], [-23, -10, 6]])
HAND_EYE = se3.transform(np.array([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]]), np.array([1.0, -1.0, 265.0]))
TURNS = [0.5 * np.array([np.cos(0.9 * k), np.sin(0.9 * k), 1.8 * (-1) ** k]) for k in range(7)]
TILTS = [np.zeros(3), *TURNS]  # rotation vectors, rad


@dataclass(frozen=True)
class Pose:
    """A planned pose, as the fake cell takes it."""

    q: tuple[float, ...]
    station: str
    balls: tuple[int, ...] = ()
    exposures: int = 1


def arm(name: str) -> RobotModel:
    """With 150 kg at the flange."""
    return replace(shipped.robot(name), payload_mass=150.0, payload_com=np.array([30.0, -20.0, 180.0]))


def postures(robot: RobotModel, rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, n) rad: the flange in front of the arm, above the floor, more than 0.9 m from the first axis."""
    low, high = np.radians([-70, -120, 40, -150, -80, -150]), np.radians([70, -20, 140, 150, 80, 150])
    out: list[np.ndarray] = []
    while len(out) < count:
        q = rng.uniform(low, high)
        x, y, z = robot.chain.flange(q[None])[0, :3, 3]
        if 300 < z < 2600 and np.hypot(x, y) > 900:
            out.append(q)
    return np.array(out)


def with_tracker(name: str, seed: int, poses: int = 160) -> Observations:
    """A target on the flange, measured from beside the arm."""
    robot, rng = arm(name), np.random.default_rng(seed)
    q = postures(robot, rng, poses)
    target = Artefact("target", "target", (1,), np.zeros((1, 3)), np.zeros(1))
    tool = se3.transform(np.eye(3), TARGET)
    cell = Cell(robot, tool, (target,), (Station("1", "target"),), "tracker", np.full(3, TRACKER_MM), measurement=TARGET_IN_BASE)
    facts = replace(from_cell(cell), planned_q=q, pace_s=20.0)
    world = make_world(facts, parse({**FAKE, "hand_eye_error": {"mm": 0.0, "deg": 0.0}}), seed)
    direction = np.sign(np.diff(q, axis=0, prepend=q[:1] - rng.choice([-1, 1], 6)))
    time = np.cumsum(rng.uniform(12, 28, poses))
    at = world.moments(q, np.zeros_like(q), direction, np.arange(poses), time, np.zeros(poses, int), np.zeros(poses, int))
    seen = se3.apply(se3.inverse(TRACKER), world.scanner_pose(at, world.displaced(at))[:, :3, 3])
    return Observations(
        cell,
        np.arange(poses),
        np.zeros(poses, int),
        q,
        np.arange(poses),
        np.zeros(poses, int),
        seen + rng.normal(0, TRACKER_MM, seen.shape),
        time_s=time,
        direction=direction.astype(int),
    )


def with_scanner(name: str, seed: int, stations: int = 12) -> Observations:
    """An eight-ball artefact at places all over the reach, seen from eight sides at each."""
    robot, rng = arm(name), np.random.default_rng(seed)
    places, poses = [], []
    for first in postures(robot, rng, 20 * stations):
        T_base_scanner = robot.chain.flange(first[None])[0] @ HAND_EYE
        found = []
        for turn in TILTS:
            moved = T_base_scanner @ se3.transform(se3.rotation_exp(turn), rng.uniform(-20, 20, 3))
            q = inverse_kinematics(robot.chain, moved @ se3.inverse(HAND_EYE), first)
            if q is None or np.any(q < robot.limits[:, 0]) or np.any(q > robot.limits[:, 1]):
                break
            found.append(q)
        if len(found) == len(TILTS):
            poses += [Pose(tuple(q), str(len(places) + 1)) for q in found]
            places.append(T_base_scanner)
        if len(places) == stations:
            break
    artefact = Artefact("mbc", "eight balls", tuple(range(1, 9)), MBC - MBC.mean(axis=0), np.full(8, 12.0), uncertainty_mm=0.001)
    there = tuple(Station(str(k + 1), "mbc", T) for k, T in enumerate(places))
    cell = Cell(robot, HAND_EYE, (artefact,), there, "scanner", np.array([0.005, 0.005, 0.009]))
    got = computed_run.observe(cell, poses, CONCEALED, seed, fake={k: v for k, v in FAKE.items() if k != "hidden"})
    blank = replace(cell, stations=tuple(replace(s, T_base_station=None) for s in there))
    return Observations(
        blank,
        np.arange(len(poses)),
        got.station,
        got.q,
        got.pose,
        got.ball,
        got.xyz,
        time_s=got.time_s,
        direction=got.direction.astype(int),
        temperatures={"robot_C": got.robot_C},
    )


def heavy_arms(given: argparse.Namespace) -> None:
    """Heavy arms at rest: how much of the kinematic model's error the diagnosis removes where everything elastic acts at once.

    Cells of the fake world, which shares no code with the diagnosis: a KR 210 and a KR 300 with their published masses and 150 kg at the
    flange. They have soft gearboxes at A2, A3 and A5, one with lost motion, friction under load, a gas balancer, a base that tilts, and a
    gear error. Measured by a tracker (a target on the flange, 15 um) and by a scanner (an eight-ball artefact at ten places, 5 to 9 um).
    Errors are those on held-out stations or blocks of poses. For comparison: 54.9 % is published for an arm of this class.
    """
    rows, shares = [], []
    for robot in ROBOTS:
        for instrument, record in (("tracker", with_tracker), ("scanner", with_scanner)):
            for seed in range(1, given.cells + 1):
                found = diagnose(record(robot, seed))
                held = found.fit.held_out
                share = 1 - held.after_rms_mm / held.before_rms_mm
                shares.append(share)
                named = "; ".join(f"{e.name} {'+'.join(e.where)}" for e in found.effects)
                rows.append(
                    f"| {robot} | {instrument} | {seed} | {held.before_rms_mm:.3f} | {held.after_rms_mm:.3f} | "
                    f"{found.fit.repeatability_floor_mm:.3f} | {100 * share:.0f} % | {found.verdict} | {named} |"
                )
                print(rows[-1], flush=True)
    head = "| arm | instrument | seed | kinematic model, mm | with effects, mm | noise alone, mm | removed | verdict | reported |"
    text = [
        "# Heavy arms at rest",
        "",
        "**Question.** How much of a heavy arm's error does a diagnosis remove?",
        "",
        f"`python benchmarks/diagnosis.py heavy-arms --cells {given.cells}`: {len(rows)} cells of the fake world. rms errors (3D)",
        "on held-out stations or blocks of poses.",
        "",
        f"Removed: {100 * min(shares):.0f} % at least, {100 * float(np.median(shares)):.0f} % in the median (published for an arm of this",
        "class: 54.9 %).",
        "",
        "Concealed in each: " + "; ".join(f"{h['name']} {h.get('where', '')}".strip() for h in CONCEALED) + ". The payload is as declared.",
        "",
        head,
        "|---|---|--:|--:|--:|--:|--:|---|---|",
        *rows,
    ]
    given.out.write_text("\n".join(text) + "\n", encoding="utf-8")


if __name__ == "__main__":
    PLAN = option("--plan", type=Path, default=Path("plans/kuka-effects.yaml"))
    DAYS = [PLAN, option("--poses", type=int, default=70), option("--pairs", type=int, default=30)]
    CELLS = option("--cells", type=int, default=2, help="of each robot and instrument")
    bench.main(
        __doc__,
        {
            "time": (times, [option("--tracker", type=Path), option("--out", type=Path, default=HERE / "diagnosis.md")]),
            "two-days": (two_days, [*DAYS, writes("benchmarks/joint_diagnosis.md")]),
            "heavy-arms": (heavy_arms, [CELLS, option("--out", type=Path, default=HERE / "heavy_arms.md")]),
        },
    )

"""Results of many small recordings as numbers, kept before a change of the program and compared after it.

    OMP_NUM_THREADS=1 python benchmarks/kept_results.py record before.jsonl --quick
    OMP_NUM_THREADS=1 python benchmarks/kept_results.py record after.jsonl --quick
    python benchmarks/kept_results.py compare before.jsonl after.jsonl

``record`` calibrates and diagnoses made recordings of fixed seeds, and measured ones, in one process: parameters, uncertainties, e-values,
odds, held-out figures, verdicts, names. A recording that the file has already is not repeated. ``compare`` names every figure that differs
by more than one part in a million of the largest number in its array. Sentences are not compared; ``same_figures.py`` compares what
the commands print.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from itertools import count, islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import bench
import cells
import hand_eye_data
import numpy as np
import simulated
from bench import DATA, Kept, option
from concealed_run import chosen_poses, faults, observed_poses, recorded_moves
from mbcacq_fakes.dynamics.recorded import recorded
from motion.run_and_motion import FEW, NARROW, SHORT_KG, concealed_plan
from motion_challenge import draw, recordings

import mbcacq
from mbcacq.challenge import scenarios, simulated_cells
from mbcacq.challenge.run import Challenger
from mbcacq.errors import MbcacqError
from mbcacq.model import shipped
from mbcacq.model.json_text import plain
from mbcacq.model.observations import Observations
from mbcacq.plan import expand, load
from mbcacq.recording.datasets.uncertified import with_estimated_centres
from mbcacq.workflow.diagnose_recordings import Question, diagnose_motion, diagnose_poses, with_motion

EVEN_IF_UNDETERMINED = mbcacq.CalibrationOptions(refuse=False)
RELATIVE, ABSOLUTE = 1e-6, 1e-12
CHANGING = {"provenance", "created", "diagnosis_s", "sha256", "checksum", "version", "workers"}
ELASTIC = ("joint_compliance", ("A2",), [2.5e-6], None)
QUICK_POSE_SETS = ("ur5-tracker", "panda-sockets", "iiwa14-sockets")
POSE_SETS = (*QUICK_POSE_SETS, "ur10-tracker-c", "ur10-tracker-a")
HAND_EYE = ("target", "sphere", "certified", "uncertified")
SMALL_SETS = ("example-none", "example-compliance")
TRAJECTORIES = ("kr300-trajectory-a", "kr300-trajectory-b")

Figures = dict[str, Any]
Made = tuple[str, Callable[[], Any]]


@cache
def challenger() -> Challenger:
    return Challenger.of(shipped.folder() / "seeing.yaml")


@cache
def challenged(kind: str, seed: int) -> Observations:
    """The recording of a challenge."""
    one = challenger()
    kinds = list(scenarios.OUTSIDE) if kind == "outside" else scenarios.kinds(kind)
    drawn = scenarios.draw(seed, seed % len(kinds) + 1, kinds)[-1]
    return simulated_cells.observe(one.loaded, one.poses, drawn, one.gauge.inject(drawn))[0]


def diagnosed(data: Any) -> Any:
    return mbcacq.diagnose(data, workers=1, minutes=None).to_dict()


def calibrated(data: Any) -> Any:
    return mbcacq.calibrate(data).to_dict()


def of_challenge(kind: str, seed: int) -> Any:
    return diagnosed(challenged(kind, seed))


def interrupted(kind: str, seed: int) -> Any:
    """The first half of a recording's poses."""
    data = challenged(kind, seed)
    return diagnosed(data.select(np.arange(data.n_poses) < data.n_poses // 2))


def with_what_was_found(kind: str, seed: int) -> Any:
    data = challenged(kind, seed)
    return mbcacq.calibrate(data, effects=mbcacq.diagnose(data, workers=1, minutes=None)).to_dict()


def motion(number: int) -> Any:
    challenge = draw(number)
    return diagnosed(recordings(challenge, shipped.robot("kr10_r1100_2"), recorded, challenge.effects)[0])


def poses_and_motion(seed: int) -> Any:
    """A run of a heavy arm at few poses whose controller recorded the motion between them."""
    with TemporaryDirectory() as folder:
        loaded = load(concealed_plan(Path(folder), SHORT_KG))
    poses, narrow = chosen_poses(expand(loaded), seed, FEW[0], NARROW)
    at_rest, moving = faults(loaded.cell.robot, SHORT_KG)
    how = Question(workers=1, minutes=None)
    found = diagnose_poses(observed_poses(loaded, poses, at_rest, seed), how)
    return with_motion(found, diagnose_motion(recorded_moves(loaded, narrow, moving, seed), how).main, how).to_dict()


def days(seed: int) -> list[Observations]:
    """Two days of one arm with an elastic joint."""
    template = simulated.plan()
    return [simulated.observe(template, seed + day, [ELASTIC], arm=seed) for day in (0, 1)]


def together(seed: int) -> Any:
    return [cell.to_dict() for cell in mbcacq.calibrate_together(days(seed), EVEN_IF_UNDETERMINED)]


def scanned(seed: int, **how: Any) -> Observations:
    return cells.scanner_cell(np.random.default_rng(seed), **how).observations


def plainly(seed: int, **how: Any) -> Any:
    return calibrated(scanned(seed, **how))


def verified(seed: int) -> Any:
    data = scanned(seed, bars=2)
    return mbcacq.verify(data, mbcacq.calibrate(data)).to_dict()


def compared(seed: int) -> Any:
    rows = mbcacq.compare(scanned(seed, stations=4)).rows
    return [replace(row, time_s=None).__dict__ for row in rows]


def elsewhere(seed: int) -> Any:
    first, second = days(seed)
    return mbcacq.verify_elsewhere(second, mbcacq.calibrate(first, EVEN_IF_UNDETERMINED)).to_dict()


def hand_eye(kind: str, seed: int) -> Any:
    data = with_estimated_centres(hand_eye_data.recording(np.random.default_rng(seed), kind).observations, "kept")
    return mbcacq.calibrate(data, mbcacq.CalibrationOptions(kinematics=False)).to_dict()


def measured(of: Callable[[Any], Any], *data: Path) -> Any:
    several = [mbcacq.load_observations(one) if (one / "poses.csv").exists() else mbcacq.load_trajectories(one) for one in data]
    return of(several[0] if len(several) == 1 else [one for some in several for one in (some if isinstance(some, list) else [some])])


def seeds_of(makes: Callable[[int], list[Made]]) -> Iterator[Made]:
    for seed in count(1):
        yield from makes(seed)


def all_recordings(quick: bool, shared: Path) -> list[Made]:
    """What is recorded, by name: about 40, or 400."""
    groups: list[tuple[int, int, Callable[[int], list[Made]]]] = [
        (8, 120, lambda s: [(f"catalogue {s}", partial(of_challenge, "catalogue", s))]),
        (2, 30, lambda s: [(f"outside {s}", partial(of_challenge, "outside", s))]),
        (2, 30, lambda s: [(f"none {s}", partial(of_challenge, "none", s))]),
        (1, 20, lambda s: [(f"two {s}", partial(of_challenge, "two", s))]),
        (1, 20, lambda s: [(f"interrupted {s}", partial(interrupted, "catalogue", s))]),
        (2, 20, lambda s: [(f"calibrated with effects {s}", partial(with_what_was_found, "catalogue", s))]),
        (3, 40, lambda s: [(f"motion {s}", partial(motion, s))]),
        (0, 10, lambda s: [(f"poses and motion {s}", partial(poses_and_motion, s))]),
        (1, 10, lambda s: [(f"two days {s}", lambda s=s: diagnosed(days(s)))]),
        (1, 10, lambda s: [(f"calibrated together {s}", partial(together, s))]),
        (4, 30, lambda s: [(f"scanner cell {s}", partial(plainly, s, bars=s % 3, stated=s % 2 == 0))]),
        (1, 10, lambda s: [(f"seven joints {s}", partial(plainly, s, chain=cells.iiwa(), stations=6))]),
        (2, 10, lambda s: [(f"verified {s}", partial(verified, s))]),
        (1, 4, lambda s: [(f"compared {s}", partial(compared, s))]),
        (1, 10, lambda s: [(f"elsewhere {s}", partial(elsewhere, s))]),
        (4, 40, lambda s: [(f"hand-eye {kind} {s}", partial(hand_eye, kind, s)) for kind in HAND_EYE]),
    ]
    made = [one for few, many, make in groups for one in islice(seeds_of(make), few if quick else many)]
    sets = QUICK_POSE_SETS if quick else POSE_SETS
    made += [(f"measured {name}", partial(measured, calibrated, shared / name)) for name in (*SMALL_SETS, *sets)]
    made += [(f"diagnosed {name}", partial(measured, diagnosed, shared / name)) for name in (*SMALL_SETS, *(() if quick else sets))]
    if not quick:
        made.append(("diagnosed kr300", partial(measured, diagnosed, *(shared / name for name in TRAJECTORIES))))
    return made


def figures(content: Any, path: str = "") -> Figures:
    """The numbers (an array is one figure), truth values and single words of a JSON content, by their path."""
    if isinstance(content, dict):
        parts = [(f"{path}.{key}", value) for key, value in content.items() if key not in CHANGING]
    elif isinstance(content, list) and numbers(content) is None:
        parts = [(f"{path}[{i}]", value) for i, value in enumerate(content)]
    else:
        sentence = isinstance(content, str) and (" " in content or len(content) > 40)
        return {} if content is None or sentence else {path: content}
    return {key: value for name, part in parts for key, value in figures(part, name).items()}


def numbers(content: Any) -> np.ndarray | None:
    """Numbers as an array, or None."""
    try:
        found = np.asarray(content)
    except ValueError:
        return None
    return found.astype(float) if found.dtype.kind in "iuf" and found.size else None


def record(given: argparse.Namespace) -> None:
    """Calibrate and diagnose, and add the figures of each recording to the file."""
    kept = Kept(given.file)
    there = {row["name"] for row in kept.rows}
    for name, make in all_recordings(given.quick, given.data):
        if name in there or given.only not in name:
            continue
        start = time.process_time()
        try:
            found = figures(plain(make()))
        except MbcacqError as error:
            found = {"error": type(error).__name__}
        kept.add({"name": name, "processor_s": time.process_time() - start, "figures": found})
        print(f"{name}: {len(found)} figures, {time.process_time() - start:.1f} s", flush=True)


def same(one: Any, other: Any) -> bool:
    a, b = numbers(one), numbers(other)
    if a is None or b is None:
        return one == other
    return a.shape == b.shape and bool(np.abs(a - b).max() <= RELATIVE * max(np.abs(a).max(), np.abs(b).max()) + ABSOLUTE)


def compare(given: argparse.Namespace) -> int:
    """Name each figure that differs. Only recordings that both files have are compared."""
    before, after = ({row["name"]: row for row in Kept(file).rows} for file in (given.before, given.after))
    both = [name for name in before if name in after]
    compared, different = 0, 0
    for name in both:
        a, b = before[name]["figures"], after[name]["figures"]
        for key in sorted(a.keys() | b.keys()):
            compared += 1
            if key not in a or key not in b or not same(a[key], b[key]):
                different += 1
                print(f"{name} {key}: {str(a.get(key, 'absent'))[:150]} | {str(b.get(key, 'absent'))[:150]}")
    seconds = [sum(rows[name]["processor_s"] for name in both) for rows in (before, after)]
    print(f"{len(both)} recordings, {compared} figures: {different} differ; processor {seconds[0]:.0f} s before, {seconds[1]:.0f} s after")
    return 1 if different or not both else 0


if __name__ == "__main__":
    quick = option("--quick", action="store_true", help="about 40 recordings that take less than 3 minutes")
    only = option("--only", default="", help="only recordings whose name contains this")
    commands = {
        "record": (record, [option("file", type=Path), quick, only, DATA]),
        "compare": (compare, [option("before", type=Path), option("after", type=Path)]),
    }
    raise SystemExit(bench.main(__doc__, commands))

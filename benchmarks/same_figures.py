"""Every figure that the tool prints, recorded and compared digit for digit.

    python benchmarks/same_figures.py record FOLDER [--shared ../shared/data] [--only TEXT]
    python benchmarks/same_figures.py compare BEFORE AFTER

``record`` runs the commands below and keeps what they print, one file a command. ``compare`` takes the numbers out of two such folders, in
their order, and names every command of which one differs. Times, dates, paths and process ids are left out of the comparison; words are
too, so that a sentence may change but a figure may not. The traffic on the wire of a dry run is compared to one part in ten million. The
arm's position at the exposure depends on the cycle in which it arrived, and that on the machine.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

POSE_SETS = ("ur5-tracker", "ur10-tracker-c", "ur10-tracker-a", "panda-sockets", "iiwa14-sockets")
SMALL_SETS = ("example-none", "example-compliance")
TRAJECTORIES = ("kr300-trajectory-a", "kr300-trajectory-b")
NUMBER = re.compile(r"[-+]?(?:\d+\.\d*|\.\d+|\d+)(?:[eE][-+]?\d+)?")
NOT_A_FIGURE = re.compile(
    r"[0-9a-f]{8}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{4}-[0-9a-f]{12}"  # an identifier
    r"|\d{4}-\d\d-\d\d[T ]\d\d[:-]\d\d[:-]\d\d(?:[.,]\d+)?(?:Z|[+-]\d\d:?\d\d)?"  # a date with its time
    r"|\S*/\S*"  # a path
    r"|\"(?:diagnosis_s|time|duration|seconds|wall|elapsed|created|cpu|rss|version)[a-z_]*\": *[^,}\n]+"
    r"|\b\d+(?:\.\d+)? ?(?:s|min|ms|MB|GB|MiB|GiB|%)(?= |,|;|\)|$)(?<!%)"  # durations and sizes; a percentage is a figure
    r"|localhost:\d+|127\.0\.0\.1(?::\d+)?|pid \d+",
    re.MULTILINE,
)


def commands(shared: Path) -> dict[str, list[str]]:
    """The commands by the name of the file that keeps their output."""
    found: dict[str, list[str]] = {}
    for name in (*SMALL_SETS, *POSE_SETS):
        data = str(shared / name)
        found[f"calibrate-{name}"] = ["calibrate", data, "--json", "--even-if-undetermined"]
        found[f"compare-{name}"] = ["compare", data, "--no-held-out"]
        found[f"diagnose-{name}"] = ["diagnose", data]
        found[f"diagnose-json-{name}"] = ["diagnose", data, "--json"]
    found["held-out-example-compliance"] = ["calibrate", str(shared / "example-compliance"), "--held-out", "station"]
    found["paper-example-none"] = ["calibrate", str(shared / "example-none"), "--method", "paper"]
    found["diagnose-kr300"] = ["diagnose", *(str(shared / name) for name in TRAJECTORIES)]
    found["diagnose-json-kr300"] = ["diagnose", *(str(shared / name) for name in TRAJECTORIES), "--json"]
    for plan in ("kuka", "quick", "seeing", "kuka-effects"):
        found[f"plan-show-{plan}"] = ["plan", "show", f"plans/{plan}.yaml"]
        found[f"plan-check-{plan}"] = ["plan", "check", f"plans/{plan}.yaml"]
    for kind in ("catalogue", "outside", "none", "two"):
        found[f"challenge-{kind}"] = ["challenge", "--fast", "--count", "6", "--seed", "11", "--effects", kind, "--json"]
    found["simulate-quick"] = ["simulate", "plans/quick.yaml", "--noise", "--seed", "3", "--out", "{out}/twin"]
    found["run-quick"] = ["run", "plans/quick.yaml", "--dry-run", "--seed", "5", "--out", "{out}/quick", "--json"]
    found["run-kuka"] = ["run", "plans/kuka.yaml", "--dry-run", "--seed", "5", "--out", "{out}/kuka"]
    found["diagnose-run-kuka"] = ["diagnose", "{out}/kuka"]
    found["export-run-kuka"] = ["export", "{out}/kuka", "--results", "{out}/export", "--simulated-anyway"]
    return found


def record(folder: Path, shared: Path, only: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    program = Path(sys.executable).with_name("mbcacq")
    with tempfile.TemporaryDirectory() as out:
        for name, arguments in commands(shared).items():
            if only not in name:
                continue
            line = [str(program), *(a.format(out=out) for a in arguments)]
            done = subprocess.run(line, capture_output=True, text=True, env={**os.environ, "COLUMNS": "160"}, check=False)
            (folder / f"{name}.txt").write_text(f"exit {done.returncode}\n{done.stdout}\n{done.stderr if done.returncode else ''}")
            print(f"{name}: exit {done.returncode}", flush=True)
        for written in [p for p in Path(out).rglob("*") if p.suffix in (".csv", ".json", ".urdf", ".yaml", ".dmo", ".src", ".dat")]:
            if written.name in ("plan.files.json", "recording.json"):
                continue
            shutil.copy(written, folder / ("file-" + "-".join(written.relative_to(out).parts)))


def figures(path: Path) -> list[tuple[str, str]]:
    """The numbers of a kept output, each with its line."""
    found = []
    for line in path.read_text(errors="replace").splitlines():
        numbers = NUMBER.findall(NOT_A_FIGURE.sub(" ", line))
        if path.name.startswith("compare-") and line.startswith("│"):
            numbers = numbers[:-1]  # the last column is the time that a method took
        found += [(number, line.strip()) for number in numbers]
    return found


def same(name: str, old: str, new: str) -> bool:
    """Whether two numbers of an output agree: digit for digit, or within 1e-7 where they came over the wire of a dry run."""
    if old == new:
        return True
    return ("kuka" in name or "quick" in name) and math.isclose(float(old), float(new), rel_tol=1e-7, abs_tol=1e-10)


def compare(before: Path, after: Path) -> int:
    different = 0
    names = sorted({p.name for p in before.iterdir()} | {p.name for p in after.iterdir()})
    count = 0
    for name in names:
        if not ((before / name).exists() and (after / name).exists()):
            print(f"{name}: only in {before if (before / name).exists() else after}")
            different += 1
            continue
        old, new = figures(before / name), figures(after / name)
        count += len(old)
        if len(old) == len(new) and all(same(name, a, b) for (a, _), (b, _) in zip(old, new, strict=True)):
            continue
        different += 1
        first = next((i for i, (a, b) in enumerate(zip(old, new, strict=False)) if not same(name, a[0], b[0])), min(len(old), len(new)))
        print(f"{name}: {len(old)} figures before, {len(new)} after; the first that differs:")
        for title, side in (("before", old), ("after", new)):
            print(f"  {title}: " + (f"{side[first][0]} in: {side[first][1][:200]}" if first < len(side) else "nothing more"))
    print(f"{len(names)} outputs, {count} figures: " + (f"{different} differ" if different else "all equal, digit for digit"))
    return 1 if different else 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    sub = parser.add_subparsers(dest="what", required=True)
    run = sub.add_parser("record")
    run.add_argument("folder", type=Path)
    run.add_argument("--shared", type=Path, default=Path("../shared/data"))
    run.add_argument("--only", default="", help="only commands whose name contains this")
    both = sub.add_parser("compare")
    both.add_argument("before", type=Path)
    both.add_argument("after", type=Path)
    given = parser.parse_args()
    if given.what == "record":
        record(given.folder, given.shared, given.only)
        return 0
    return compare(given.before, given.after)


if __name__ == "__main__":
    raise SystemExit(main())

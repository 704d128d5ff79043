"""Simulated trajectories with injected effects, of a fake arm in motion: what is found, what is measured, what is claimed wrongly.

    python benchmarks/trajectories.py --challenges 100 --jobs 2 --json trajectories.json

Each challenge is one arm (KR 10 R1100-2) with no, one, two or three effects, recorded in two motions. The figures stand in
benchmarks/trajectories.md.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from mbcacq_fakes.dynamics.recorded import recorded

from mbcacq.challenge.motion import MotionChallengeResult, draw, run_challenge
from mbcacq.model import shipped
from mbcacq.model.cell_schema import RobotSpec
from mbcacq.recording.datasets.yaml_text import load_yaml, read_yaml_text

WITHIN = 3.0


def robot(name: str = "kr10_r1100_2"):
    path = shipped.robot_file(name)
    return RobotSpec.model_validate(load_yaml(read_yaml_text(path), str(path))[0]).model()


def one(number: int) -> MotionChallengeResult:
    return run_challenge(draw(number), robot(), recorded)


def summary(results: list[MotionChallengeResult]) -> dict:
    detectable = [r for r in results if any(r.detectable)]
    clean = [r for r in results if not r.truth]
    sigmas = [v for r in results for v in r.score.sigmas.values()]
    by_name: dict[str, list[int]] = {}
    for r in results:
        for t, m in zip(r.truth, r.detectable, strict=True):
            if m:
                row = by_name.setdefault(t["name"], [0, 0])
                row[0] += f"{t['name']}:{'+'.join(t['where'])}" in r.score.reported
                row[1] += 1
    return {
        "challenges": len(results),
        "with_detectable_effects": len(detectable),
        "clean": len(clean),
        "detected": sum(r.verdict != "none" for r in detectable),
        "named_and_located_first": sum(r.score.identified for r in detectable),
        "with_a_false_name": sum(bool(r.score.false_names) for r in results),
        "clean_with_a_false_name": sum(bool(r.score.false_names) for r in clean),
        "parameters": len(sigmas),
        "parameters_within_3_sigma": sum(s <= WITHIN for s in sigmas),
        "found_by_name": by_name,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--challenges", type=int, default=100)
    parser.add_argument("--first", type=int, default=1000, help="seed of the first challenge")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    results = []
    with ProcessPoolExecutor(given.jobs) as pool:
        for r in pool.map(one, range(given.first, given.first + given.challenges)):
            results.append(r)
            truth = ", ".join(
                f"{t['name']}:{'+'.join(t['where'])}{'' if m else ' (small)'}" for t, m in zip(r.truth, r.detectable, strict=True)
            )
            far = {k: round(v, 1) for k, v in r.score.sigmas.items() if v > WITHIN}
            ending = f"{r.verdict:<17} {truth or 'nothing'} | extra {r.score.false_names} | far {far}"
            print(f"{r.challenge.number} {'ok ' if r.score.identified else 'MISS'} {ending}", flush=True)
    print(json.dumps(summary(results), indent=1))
    if given.json is not None:
        given.json.write_text(json.dumps([r.to_dict() for r in results], indent=1, default=float), encoding="utf-8")


if __name__ == "__main__":
    main()

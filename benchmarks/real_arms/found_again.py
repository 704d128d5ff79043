"""Real arms diagnosed as a whole and in halves: which names, and which values, a second measurement would give again."""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from bench import HERE, put

import mbcacq
from mbcacq.diagnosis.validation.folds import blocks
from mbcacq.model.observations import Observations
from mbcacq.quantities import K

POSES = ("ur5-tracker", "ur10-tracker-a", "ur10-tracker-c", "panda-sockets", "iiwa14-sockets")
CAMPAIGNS = ("ur10-tracker-a", "ur10-tracker-c")  # with one arm
MOTIONS = ("kr300-trajectory-a", "kr300-trajectory-b")  # of one arm
MOST_POSES = 3000  # of a campaign, at random
ANGLES = ("phase_deg", "zero_deg")
ALIASES = 2.0  # orders within which two lines are the same
HEADER = "| recording | poses | named in a half | and in the other | share | figures in both | within U | held out mm: whole; halves |"


def parts_of(name: str, data: Path) -> dict[str, Observations]:
    """A recording as a whole, and its halves by blocks."""
    obs = mbcacq.load_observations(data / name)
    if obs.n_poses > MOST_POSES:
        keep = np.zeros(obs.n_poses, bool)
        keep[np.random.default_rng(0).permutation(obs.n_poses)[:MOST_POSES]] = True
        obs = obs.select(keep)
    half = blocks(obs, 2)
    return {"whole": obs, "first": obs.select(half == 0), "second": obs.select(half == 1)}


def found_in(content: dict, trends: bool = False) -> dict[str, dict]:
    """The findings of a diagnosis by ``name:location``, with figures and standard deviations; with its trends, which have no figures."""
    out: dict[str, dict] = {}
    for effect in content["effects"]:
        if effect.get("trend") and not trends:
            continue
        if effect["name"] == "unknown":  # of a long recording at all locations: each is named by its size
            for key, value in effect["parameters"].items():
                out.setdefault(f"unknown:{key.partition('(')[0]}", {})[key] = value
            for at in effect["where"] if "channel" in effect else ():
                out.setdefault(f"unknown:{at}", {})
            continue
        for at in effect["where"]:
            mine = {key: value for key, value in effect["parameters"].items() if key.startswith(f"{at}.")}
            out[f"{effect['name']}:{at}"] = mine or (effect["parameters"] if len(effect["where"]) == 1 else {})
    return out


def agreement(a: dict, b: dict) -> Iterator[bool]:
    """Whether each component that two parts state of one effect agrees within U of both (k = 2)."""
    for key in a.keys() & b.keys():
        one, other = (np.atleast_2d(np.array([np.atleast_1d(e[key]["value"]), np.atleast_1d(e[key]["std"])], float)) for e in (a, b))
        nearest = nearest_lines(key, a, b)
        for j, k in nearest if nearest is not None else zip(range(one.shape[1]), range(other.shape[1]), strict=False):
            apart = one[0, j] - other[0, k]
            apart = (apart + 180) % 360 - 180 if key.endswith(ANGLES) else apart
            yield bool(abs(apart) <= K * np.hypot(one[1, j], other[1, k]))


def nearest_lines(key: str, a: dict, b: dict) -> list[tuple[int, int]] | None:
    """Lines of a joint's periodic error go by their order; None for every other parameter."""
    orders = f"{key.rpartition('.')[0]}.order"
    if not key.endswith(("order", "amplitude_deg", "phase_deg")) or orders not in a or orders not in b:
        return None
    mine, theirs = (np.atleast_1d(e[orders]["value"]) for e in (a, b))
    nearest = [(j, int(np.argmin(np.abs(theirs - order)))) for j, order in enumerate(mine)]
    return [(j, k) for j, k in nearest if abs(theirs[k] - mine[j]) <= ALIASES]  # the other half says that the rest is not determined


def row_of(name: str, poses: object, first: dict, second: dict, held: str, campaigns: bool = False) -> str:
    """The figures of two halves of a recording, or of two campaigns with one arm."""
    own = of_the_arm if campaigns else dict
    one, two = own(found_in(first)), own(found_in(second))
    once = [*(one.keys() - found_in(second, True).keys()), *(two.keys() - found_in(first, True).keys())]
    print(*(f"{label} in one half" for label in sorted(once)), sep="\n", flush=True)
    named = len(one) + len(two)
    within = list[bool]()
    for label in sorted(one.keys() & two.keys()):
        same = list(agreement(one[label], two[label]))
        within += same
        if not all(same):
            print(f"{label}: {same.count(False)} of {len(same)} figures beyond U", flush=True)
    share = f"{1 - len(once) / named:.0%}" if named else "-"
    agree = f"{np.mean(within):.0%}" if within else "-"
    return f"| {name} | {poses} | {named} | {named - len(once)} | {share} | {len(within)} | {agree} | {held} |"


def of_the_arm(found: dict[str, dict]) -> dict[str, dict]:
    """What another campaign with the same arm must show again: effects of joints and links. Of something unmodelled that is the place, as
    its size is over the poses of its recording.
    """
    arm = {label: own for label, own in found.items() if label.partition(":")[2].startswith(("A", "link"))}
    return {label: {} if label.startswith("unknown") else own for label, own in arm.items()}


def diagnosed(data: Observations | Path, file: Path) -> dict:
    """The diagnosis of poses, or of a folder with a motion, as JSON content, kept in a file."""
    if not file.exists():
        file.parent.mkdir(parents=True, exist_ok=True)
        found = mbcacq.diagnose(data)
        file.write_text(json.dumps((found.poses or found.motion).to_json()), encoding="utf-8")
    return json.loads(file.read_text(encoding="utf-8"))


def found_again(given: argparse.Namespace) -> None:
    """Each open recording of poses diagnosed as a whole and in two halves by blocks; two campaigns and two motions of one arm.

    --kept: diagnoses so far; go on with them.
    """
    rows = []
    for name in [name for name in given.sets or POSES if name in POSES]:
        parts = parts_of(name, given.data)
        whole, first, second = (diagnosed(obs, given.kept / f"{name}-{part}.json") for part, obs in parts.items())
        held = "; ".join(f"{c['fit']['held_out']['after_rms_mm']:.3f}" for c in (whole, first, second))
        rows.append(row_of(name, parts["whole"].n_poses, first, second, held))
        print(rows[-1], flush=True)
    if not given.sets or MOTIONS[0] in given.sets:
        first, second = (diagnosed(given.data / name, given.kept / f"{name}.json") for name in MOTIONS)
        rows.append(row_of(" against ".join(MOTIONS), "", first, second, ""))
        print(rows[-1], flush=True)
    files = [given.kept / f"{name}-whole.json" for name in CAMPAIGNS]
    if all(file.exists() for file in files):
        first, second = (json.loads(file.read_text(encoding="utf-8")) for file in files)
        rows.append(row_of(" against ".join(CAMPAIGNS), "", first, second, "", campaigns=True))
        print(rows[-1], flush=True)
    if given.write:
        put(HERE / "found_again.md", "\n".join([HEADER, "|---|--:|--:|--:|--:|--:|--:|---|", *rows]))

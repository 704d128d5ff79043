"""Accidents while a recording is made: is the calibration silent about one that leaves its hand-eye transform beyond three stated sigma?

    python benchmarks/strikes.py struck [--sets 600] [--seed 0] [--kept FILE]
    python benchmarks/strikes.py undisturbed [--sets 1000] [--seed 0] [--kept FILE]
    python benchmarks/strikes.py page --kept FILE ..

The arm is a product of rotations and translations written here, and each accident changes one of its numbers from a pose on: nothing of the
forward model, its derivatives or the test of change takes part. Each set is one of 19 accidents with a size of 0.5 to 30 times the arm's
repeatability (0.02 mm), log-uniform, at a moment drawn at random.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import bench
import numpy as np
from bench import Kept, option, table, wilson
from cells import scanner_cell
from scipy.spatial.transform import Rotation

from mbcacq.calibration.calibrate import calibrate
from mbcacq.errors import MbcacqError
from mbcacq.estimation.options import CalibrationOptions
from mbcacq.model.observations import Observations

SIGMA = 0.02  # mm
NOISE, JOINT = (0.004, 0.004, 0.006), 8e-6
MANY = 100  # sets of which a rate is stated
LEVER, WRIST = 700.0, 80.0  # mm by which a turn of a joint, and of the scanner, is given its size
FORMS = ("one station, hand-eye alone", "8 stations, hand-eye alone", "whole run", "collected")
SPLIT = (0.3, 0.35, 0.15, 0.2)


@dataclass
class World:
    """The cell at each of P poses, (P, ..) each: mm and rad.

    mount: T_flange_scanner. place: T_base_station of the pose's station. rows: (P, 6, 5) theta, d, a, alpha, beta. joint: (P, 6) added
    to the angles. read: (P, 3) added to what the scanner reads. scale: (P,) of its coordinates. ball: (P, K, 3) added to the centres.
    load: (P,) mm by which a horizontal upper arm sinks. base: (P, 4, 4) motion of everything that stands beside the arm. noise: (P,)
    factor of the joints' noise. backlash: (P,) rad of A3, or empty.
    """

    mount: np.ndarray
    place: np.ndarray
    rows: np.ndarray
    joint: np.ndarray
    read: np.ndarray
    scale: np.ndarray
    ball: np.ndarray
    load: np.ndarray
    base: np.ndarray
    noise: np.ndarray
    backlash: np.ndarray = field(default_factory=lambda: np.zeros(0))


def rigid(v=(0.0, 0.0, 0.0), w=(0.0, 0.0, 0.0)) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(w).as_matrix(), v
    return T


def about(axis: str, angle: np.ndarray) -> np.ndarray:
    T = np.tile(np.eye(4), (len(angle), 1, 1))
    T[:, :3, :3] = Rotation.from_euler(axis, angle[:, None]).as_matrix()
    return T


def along(axis: int, distance: np.ndarray) -> np.ndarray:
    T = np.tile(np.eye(4), (len(distance), 1, 1))
    T[:, axis, 3] = distance
    return T


def read(obs: Observations, world: World, rng: np.random.Generator) -> np.ndarray:
    """Centres (M, 3) in the scanner frame as they are read."""
    chain, q = obs.cell.robot.chain, obs.q + world.joint
    q = q + rng.normal(size=q.shape) * JOINT * world.noise[:, None]
    if len(world.backlash):
        q[:, 2] += world.backlash * np.sign(np.diff(obs.q[:, 2], prepend=0.0))
    upper = chain.sign[1] * obs.q[:, 1]
    q[:, 1] += chain.sign[1] * world.load / LEVER * np.cos(upper)
    T = world.base
    for i in range(6):
        theta, d, a, alpha, beta = world.rows[:, i].T
        T = T @ about("z", chain.sign[i] * q[:, i] + theta) @ along(2, d) @ along(0, a) @ about("x", alpha) @ about("y", beta)
    T_scanner_place = np.linalg.inv(T @ world.mount) @ world.place
    p = obs.pose
    ball = obs.cell.ball_centres[obs.ball] + world.ball[p, obs.ball]
    seen = np.einsum("mij,mj->mi", T_scanner_place[p, :3, :3], ball) + T_scanner_place[p, :3, 3]
    return seen * (1 + world.scale[p])[:, None] + world.read[p] + rng.normal(size=seen.shape) * NOISE


def direction(rng) -> np.ndarray:
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


Accident = Callable[[World, Observations, int, float, np.random.Generator], None]


def _mounted(shift: bool, turn: bool) -> Accident:
    def accident(w, obs, t, mm, rng):
        w.mount[t:] = w.mount[t:] @ rigid(mm * direction(rng) * shift, mm / WRIST * direction(rng) * turn)

    return accident


def _readings(axes: tuple[int, ...]) -> Accident:
    def accident(w, obs, t, mm, rng):
        part = rng.normal(size=len(axes))
        w.read[t:, axes] += mm * part / np.linalg.norm(part)

    return accident


def _encoder(joints: range) -> Accident:
    def accident(w, obs, t, mm, rng):
        w.joint[t:, rng.choice(list(joints))] += rng.choice((-1, 1)) * mm / LEVER

    return accident


def _station(turn: bool) -> Accident:
    def accident(w, obs, t, mm, rng):
        here = (np.arange(obs.n_poses) >= t) & (obs.station == obs.station[t])
        w.place[here] = w.place[here] @ (rigid(w=mm / 40 * direction(rng)) if turn else rigid(mm * direction(rng)))

    return accident


def _ball(w, obs, t, mm, rng):
    w.ball[t:, rng.integers(w.ball.shape[1])] += mm * direction(rng)


def _load(w, obs, t, mm, rng):
    w.load[t:] += mm


def _base(w, obs, t, mm, rng):
    w.base[t:] = w.base[t:] @ rigid(mm * direction(rng), mm / 1000 * direction(rng))


def _warm(w, obs, t, mm, rng):
    w.rows[t:, :, 1:3] *= 1 + mm / 1000


def _bump(w, obs, t, mm, rng):
    before = w.mount.copy()
    _mounted(True, True)(w, obs, t, mm, rng)
    back = min(t + int(rng.integers(4, 15)), obs.n_poses)
    w.mount[back:] = before[back:]


def _creep(w, obs, t, mm, rng):
    share = np.clip((np.arange(obs.n_poses) - t + 1) / 10, 0, 1)
    w.mount[:, :3, 3] += mm * share[:, None] * direction(rng)


def _loose(w, obs, t, mm, rng):
    w.noise[t:] = 1 + mm / SIGMA / 2


def _backlash(w, obs, t, mm, rng):
    w.backlash = np.where(np.arange(obs.n_poses) >= t, mm / 2 / LEVER, 0.0)


ACCIDENTS: dict[str, Accident] = {
    "scanner slipped": _mounted(True, False),
    "scanner turned": _mounted(False, True),
    "mount re-screwed between stations": _mounted(True, True),
    "scanner z jumps": _readings((2,)),
    "scanner x, y jump": _readings((0, 1)),
    "scanner's coordinates jump": _readings((0, 1, 2)),
    "scanner's scale jumps": lambda w, obs, t, mm, rng: w.scale.__setitem__(slice(t, None), mm / 40),
    "encoder of A1 to A3 jumps": _encoder(range(3)),
    "encoder of A4 to A6 jumps": _encoder(range(3, 6)),
    "artefact pushed": _station(False),
    "artefact turned": _station(True),
    "ball moved": _ball,
    "load picked up": _load,
    "arm's foot pushed": _base,
    "links grow": _warm,
    "scanner bumped and put back": _bump,
    "mount creeps over 10 poses": _creep,
    "brake or gear loose: joints scatter": _loose,
    "backlash of A3 begins": _backlash,
}
NO_MOMENT = {"brake or gear loose: joints scatter", "backlash of A3 begins", "mount creeps over 10 poses"}
BETWEEN = {"mount re-screwed between stations"}


def made(form: str, kind: str | None, mm: float, rng: np.random.Generator) -> tuple[Observations, list[np.ndarray], int]:
    """Observations, the true hand-eye transforms before and after the accident, and the number of the first pose after it."""
    stations, each = (1, 76) if form == FORMS[0] else (8, 10) if form != FORMS[3] else (6, 16)
    errors = np.zeros((6, 5))
    if form == FORMS[2] or rng.random() < 0.5:
        size = np.array([np.radians(0.03), 0.15, 0.15, np.radians(0.03), np.radians(0.03)])
        errors = rng.normal(size=(6, 5)) * size
        errors[[0, 2, 3, 4], 4] = 0
        errors[1, 1] = errors[0, 0] = errors[0, 1] = 0
        errors[-1] = 0
    cell = scanner_cell(rng, stations=stations, per_station=each, errors=errors, noise=NOISE, joint_rad=JOINT)
    obs, n = cell.observations, cell.observations.n_poses
    if form == FORMS[3]:  # the stations are visited in three turns
        turn = np.argsort(np.arange(n) % each // 6, kind="stable")
        place = np.argsort(turn)
        obs = replace(obs, time_s=3.0 * place)
    order = np.arange(n) if obs.time_s is None else np.argsort(obs.time_s)
    rank = np.argsort(order)
    inside = np.arange(6, n - 5)
    if kind in BETWEEN and stations > 1:
        inside = inside[np.diff(obs.station[order], prepend=-1)[inside] != 0]
    elif kind is not None and kind.startswith("artefact"):
        at = [np.flatnonzero(obs.station[order] == s) for s in range(stations)]
        inside = np.concatenate([one[3:-3] for one in at])
    t = int(rng.choice(inside))
    ordered = replace(obs, q=obs.q[order], station=obs.station[order])
    rows = np.tile(obs.cell.robot.chain.rows + errors, (n, 1, 1))
    world = World(
        np.tile(cell.truth.T_flange_scanner, (n, 1, 1)),
        cell.truth.T_base_station[ordered.station],
        rows,
        *(np.zeros((n, k)) for k in (6, 3)),
        np.zeros(n),
        np.zeros((n, len(obs.cell.ball_centres), 3)),
        np.zeros(n),
        np.tile(np.eye(4), (n, 1, 1)),
        np.ones(n),
    )
    if kind is not None:
        ACCIDENTS[kind](world, ordered, t, mm, rng)
    turned = replace(ordered, pose=rank[obs.pose])
    true = [world.mount[0], world.mount[-1], world.mount[-1] @ rigid(-world.read[-1])]
    return replace(obs, xyz=read(turned, world, rng)), true, t


def judged(form: str, kind: str | None, mm: float, rng: np.random.Generator) -> dict:
    obs, true, t = made(form, kind, mm, rng)
    row = {"form": form, "kind": kind, "mm": mm, "t": t}
    begin = time.process_time()
    try:
        found = calibrate(obs, CalibrationOptions(kinematics=form == FORMS[2]))
    except MbcacqError as error:
        return {**row, "said": "refused", "text": str(error)[:200], "z": 0.0}
    change, warnings = found.extra.get("change"), list(found.extra.get("warnings", ()))
    index = [found.names.index(f"hand_eye.{c}") for c in ("x", "y", "z", "rx", "ry", "rz")]
    std = np.sqrt(np.diag(found.covariance)[index])
    off = [np.linalg.inv(found.state.T_flange_scanner) @ T for T in true]
    z = [np.abs(np.r_[D[:3, 3], Rotation.from_matrix(D[:3, :3]).as_rotvec()]) / std for D in off]
    said = "change" if change else "warned" if warnings else "rejected" if found.fit.rejected else "nothing"
    row |= {"said": said, "z": float(min(one.max() for one in z)), "text": warnings[0][:200] if warnings else ""}
    row |= {"s": time.process_time() - begin, "std_um": float(1e3 * std[0]), "evidence": found.extra.get("change_probability")}
    return row | ({"found": f"{change['kind']} {change['where']}", "nth": change["nth"] - 1} if change else {})


def draws(seed: int, sets: int, disturbed: bool) -> Iterator[tuple[int, str, str | None, float, np.random.Generator]]:
    for k in range(sets):
        rng = np.random.default_rng([seed, k, disturbed])
        form = FORMS[int(rng.choice(4, p=SPLIT))]
        kind = list(ACCIDENTS)[int(rng.integers(len(ACCIDENTS)))] if disturbed else None
        yield k, form, kind, float(SIGMA * np.exp(rng.uniform(np.log(0.5), np.log(30.0)))), rng


def run(given: argparse.Namespace, disturbed: bool) -> None:
    kept = Kept(given.kept)
    there = {(row["seed"], row["k"]) for row in kept.rows if (row["kind"] is not None) == disturbed}
    end = time.monotonic() + 60 * given.minutes
    for k, form, kind, mm, rng in draws(given.seed, given.sets, disturbed):
        if (given.seed, k) not in there and time.monotonic() < end:
            try:
                kept.add({"seed": given.seed, "k": k, **judged(form, kind, mm, rng)})
            except AssertionError:
                continue  # a place that this arm cannot look at from all sides
    for line in lines(kept.rows):
        print(line)


def struck(given: argparse.Namespace) -> None:
    """Sets with one accident each."""
    run(given, True)


def undisturbed(given: argparse.Namespace) -> None:
    """Sets in which nothing happens."""
    run(given, False)


def page(given: argparse.Namespace) -> None:
    """Put the tables of kept outcomes into strikes.md."""
    bench.put(Path(__file__).with_suffix(".md"), "\n".join(lines(Kept(given.kept).rows)))


def share(yes: int, n: int) -> str:
    """With the 95 % interval where there are enough to say so."""
    if n < MANY:
        return f"{yes}/{n}" if n else "-"
    return f"{yes}/{n} ({wilson(yes, n)[0]:.1f} to {wilson(yes, n)[1]:.1f} %)"


def lines(rows: list[dict]) -> list[str]:
    """Tables: by the thing that an accident strikes (the first word of its name), and of undisturbed sets."""
    hit, still = [row for row in rows if row["kind"]], [row for row in rows if not row["kind"]]
    out = []
    heads = ("sets", "a change is named", "refused or warned", "silent", "silent beyond 3 sigma", "moment within 2 poses")
    struck_things = dict.fromkeys(name.split()[0].removesuffix("'s") for name in ACCIDENTS)
    groups = [(thing, [row for row in hit if row["kind"].startswith(thing)]) for thing in struck_things]
    out += [*table(("struck", *heads), [(name, *_counts(some)) for name, some in (*groups, ("**all**", hit)) if some]), ""]
    if still:
        said = [sum(row["said"] == way for row in still) for way in ("change", "warned", "refused")]
        beyond = sum(row["z"] > 3 for row in still)
        heads = ("undisturbed", "said to have changed", "otherwise warned", "refused", "one of six beyond 3 sigma")
        out += table(heads, [(len(still), share(said[0], len(still)), *said[1:], share(beyond, len(still)))])
    return out


def _counts(rows: list[dict]) -> tuple[object, ...]:
    named = [row for row in rows if row["said"] == "change"]
    silent = [row for row in rows if row["said"] in ("nothing", "rejected")]
    dated = [row for row in named if row["kind"] not in NO_MOMENT]
    told = sum(row["said"] in ("refused", "warned") for row in rows)
    right = sum(abs(row["nth"] - row["t"]) <= 2 for row in dated)
    return len(rows), len(named), told, len(silent), share(sum(row["z"] > 3 for row in silent), len(rows)), share(right, len(dated))


if __name__ == "__main__":
    MORE = [option("--seed", type=int, default=0), option("--minutes", type=float, default=1e6), option("--kept", type=Path)]
    sys.exit(
        bench.main(
            __doc__,
            {
                "struck": (struck, [option("--sets", type=int, default=600), *MORE]),
                "undisturbed": (undisturbed, [option("--sets", type=int, default=1000), *MORE]),
                "page": (page, [option("--kept", type=Path, required=True)]),
            },
        )
    )

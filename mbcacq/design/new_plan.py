"""A plan from nothing: a home, stations and views that this arm reaches, this scanner sees and the calibration learns from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.design.candidate_views import CandidateView, candidates
from mbcacq.design.optimal_design import design
from mbcacq.design.options import DesignOptions
from mbcacq.design.plan_rewriter import flow, look_step, seen_from, step_lines, view_mapping
from mbcacq.design.station_repair import without_lines
from mbcacq.errors import ConfigError
from mbcacq.files.atomic_write import write_file
from mbcacq.geometry import se3
from mbcacq.model import shipped, yaml12
from mbcacq.model.cell_schema import ArtefactSpec, PoseSpec, RobotSpec
from mbcacq.model.yaml_source import read
from mbcacq.plan import LoadedPlan
from mbcacq.plan.clearance import clearance_of
from mbcacq.plan.expansion import expand_reachable
from mbcacq.plan.feasibility import check
from mbcacq.plan.inverse_kinematics import inverse_kinematics
from mbcacq.plan.loader import load
from mbcacq.quantities import DEGREE, from_degrees, in_degrees

# Places tried, as shares of the arm's reach from its shoulder, and deg about axis 1; a joint's error shows itself at all distances.
DISTANCES, HEIGHTS, AZIMUTHS_DEG = (0.45, 0.6, 0.75), (-0.35, -0.1, 0.15, 0.4), (-60, -25, 0, 25, 60)
ROBOT_SOURCES = (".urdf", ".xacro", ".mjcf", ".xml", ".csv")
CERTIFICATES = (".csv", ".dmo", ".dmi", ".dms", ".pdf")
LEAN_DEG = 20.0  # of the artefact towards the arm, at every other place: a station with another orientation tells more
TRACK_PLACES = 7  # along a track, one after the other
TRACK_MM_S = 1000.0
VIEWS_TRIED = 24  # per place
LEAST_SHARE = 0.2  # of them that must be possible at a place
ORIENTATION_VIEWS = 6
VERIFICATION_VIEWS = 2
ROUNDS = 8  # of leaving out what the checks of a plan refuse


@dataclass(frozen=True)
class NewPlanOptions:
    """Options of a new plan.

    Attributes
    ----------
    driver
        Driver of the robot; None is ``kuka_rsi`` for a KUKA KR, ``kuka_eki`` on a track, else ``simulated``.
    stations, poses
        Numbers of stations and poses to calibrate with.
    seed
        Seed of the views to choose from.
    track
        Ends (mm) of a track under the arm, along its x axis; None without one.
    """

    driver: str | None = None
    stations: int = 6
    poses: int = 36
    seed: int = 0
    track: tuple[float, float] | None = None


@dataclass(frozen=True)
class NewPlan:
    """The files that a plan is to be made of, and the file that it is written to."""

    robot: Path
    scanner: Path
    artefact: Path
    out: Path
    options: NewPlanOptions = NewPlanOptions()


def write_new_plan(request: NewPlan, progress: Callable[[str], None] = lambda text: None) -> Iterator[str]:
    """Writes the plan, beside it the tool's own files that it names, and yields sentences about it.

    Raises ConfigError where the files do not fit, or the arm serves too few places with this scanner.
    """
    _refuse_sources(request)
    spec = read(request.robot, "robot").validate(RobotSpec)
    artefact = read(request.artefact, "artefact").validate(ArtefactSpec)
    if len(artefact.balls) < 3:
        raise ConfigError(f"{request.artefact}: {len(artefact.balls)} balls leave its orientation open; three at least are needed")
    names = {p: _beside(p, request.out) for p in (request.robot, request.artefact)}
    for file in names.values():
        if (request.out.parent / file).resolve() == request.out.resolve():
            raise ConfigError(f"{request.out} is the name of a file that the plan itself needs beside it; give another --out")
    head = _head(request, spec, artefact, names)
    progress("looking for places that the arm reaches and the scanner sees")
    draft = load(
        request.out,
        _text(head, _places(spec, request.options.track), artefact.id, [look_step("positions", "position", ["c1"], [{"tilt_deg": 10}])]),
    )
    found = candidates(draft, [s.id for s in draft.cell.stations], 38.0, request.options.seed, DesignOptions(views_per_station=VIEWS_TRIED))
    chosen = _spread(draft, found, request.options.stations + VERIFICATION_VIEWS)
    if len(chosen) < 2:
        raise ConfigError(
            f"only {len(chosen)} of {len(draft.cell.stations)} places tried can be seen well enough by {request.robot}; give an artefact "
            f"that fits into the scanner's view ({request.artefact}), or check hand_eye, the scanner's housing (body_mm) and the arm's "
            "limits"
        )
    kept, apart = chosen[: request.options.stations], chosen[request.options.stations :] or chosen[-1:]
    if request.options.track is not None and len(chosen) > VERIFICATION_VIEWS:  # lengths are checked at both ends
        along = sorted(chosen, key=lambda s: next(k.planned_pose[0, 3] for k in draft.cell.stations if k.id == s))
        apart = [along[0], along[-1]]
        kept = [s for s in chosen if s not in apart]
    places = [replace_id(draft, station, f"p{k}") for k, station in enumerate(kept, 1)]
    places += [replace_id(draft, station, f"v{k}") for k, station in enumerate(apart, 1)]
    steps = _steps([v for v in found if v.station == kept[0]], [f"p{k + 1}" for k in range(len(kept))], len(apart))
    loaded = load(request.out, _text(head, places, artefact.id, steps))
    progress(f"choosing {request.options.poses} views at {len(kept)} stations by what the calibration learns from them")
    result = design(loaded, request.options.poses, criterion="A", steepest_deg=38.0, seed=request.options.seed)
    loaded, left_out = _without_errors(load(request.out, result.text), progress)
    write_file(request.out, loaded.text)
    poses = expand_reachable(loaded)[0]
    yield f"{request.out}: {len(poses)} poses at {len(places)} stations, chosen from {result.tried} views that can be taken"
    if left_out:
        yield f"{left_out} views were left out again, because no free path leads to them"
    yield "put your own numbers in: hand_eye from a drawing, obstacles, workspace, payload"


def _refuse_sources(request: NewPlan) -> None:
    """Raises ConfigError where a description of an arm or a certificate is given for the file that is made of it."""
    if request.robot.suffix.lower() in ROBOT_SOURCES:
        raise ConfigError(
            f"{request.robot}: a plan names a robot file (YAML), not such a description; make one: mbcacq robot import {request.robot}"
        )
    if request.artefact.suffix.lower() in CERTIFICATES:
        raise ConfigError(
            f"{request.artefact}: a plan names an artefact file (YAML), not a certificate; "
            f"make one: mbcacq export {request.artefact} --artefact {request.artefact.stem}"
        )


def _beside(path: Path, out: Path) -> str:
    """How the plan names a file: the tool's own ones are copied beside it."""
    if path.resolve().is_relative_to(shipped.folder().resolve()):
        return path.name
    return seen_from(out.parent, path)


def _head(request: NewPlan, spec: RobotSpec, artefact: ArtefactSpec, names: dict[Path, str]) -> dict[str, Any]:
    """Everything of the plan but stations and steps."""
    scanner = read(request.scanner, "scanner").data
    if not {"scanner", "hand_eye"} <= set(scanner):
        raise ConfigError(f"{request.scanner}: a scanner file has the keys scanner and hand_eye, as they stand in a plan")
    request.out.parent.mkdir(parents=True, exist_ok=True)  # a name with '..' leads nowhere from a folder that is not there
    for path, name in names.items():
        target = request.out.parent / name
        if not target.exists():
            write_file(target, path.read_bytes(), folder=request.out.parent)
        elif target.read_bytes() != path.read_bytes():
            raise ConfigError(
                f"{target} exists and differs from the tool's own {path.name}; rename it, or give it by --robot or --artefact"
            )
    kuka = spec.name.startswith("KUKA KR ")
    track = request.options.track
    driver = request.options.driver or (("kuka_rsi" if track is None else "kuka_eki") if kuka else "simulated")
    robot: dict[str, Any] = {"driver": driver, "model": names[request.robot]}
    if driver == "kuka_rsi":
        robot["options"] = {"bind": "127.0.0.1", "port": 49152}
    if driver == "kuka_eki":
        robot["options"] = {"address": "127.0.0.1", "port": 54610}
    home = _home(spec, PoseSpec.model_validate(scanner["hand_eye"]).transform())
    robot |= {"speed": 0.3, "settle_s": 0.3, "home_deg": [float(v) for v in home]}
    if spec.name.startswith("FANUC "):  # J3 of their controllers is counted from the horizontal
        robot["controller_joints"] = {"couplings": [{"axis": 3, "of": 2, "factor": -1}]}
    if track is not None:
        axis = {"name": "E1", "type": "prismatic", "carries": "arm", "direction": [1, 0, 0]}
        axis |= {"limits_mm": list(track), "speed_mm_s": TRACK_MM_S}
        robot |= {"external_axes": [axis], "home_external": [sum(track) / 2]}
    named = {"format": "mbcacq-plan/1", "name": f"{spec.name} with {artefact.name or artefact.id}", "robot": robot}
    devices = {"scanner": scanner["scanner"], "positioner": {"driver": "manual"}, "hand_eye": scanner["hand_eye"]}
    return {**named, **devices, "artefacts": [names[request.artefact]]}


def _reach(spec: RobotSpec) -> tuple[float, np.ndarray]:
    """mm from the shoulder to the flange at most, and the shoulder (3,)."""
    chain = spec.model().chain
    return float(np.hypot(chain.a, chain.d)[1:].sum()), np.array([0.0, 0.0, chain.d[0]])


def _home(spec: RobotSpec, T_flange_scanner: np.ndarray) -> np.ndarray:
    """Joint angles (n,) deg, whole: the scanner in front of the arm, looking down, far from limits and with a bent wrist."""
    robot = spec.model()
    reach, shoulder = _reach(spec)
    solver, best, most = inverse_kinematics(robot, sampled=True), None, -np.inf
    up = -robot.gravity
    for share, height in ((0.5, 0.0), (0.45, 0.15), (0.55, -0.15), (0.6, 0.1), (0.4, 0.0)):
        for turn in range(0, 360, 45):
            x = np.array([np.cos(from_degrees(turn)), np.sin(from_degrees(turn)), 0.0])
            x = x - (x @ up) * up
            x /= np.linalg.norm(x)
            T = se3.transform(np.stack([x, np.cross(up, x), up], axis=1), shoulder + reach * np.array([share, 0.0, height]))
            for q in solver.solutions((T @ se3.inverse(T_flange_scanner))[None])[0]:
                room = np.minimum(q - robot.limits[:, 0], robot.limits[:, 1] - q).min()
                merit = min(room, 60 * DEGREE) - 0.2 * np.abs(q).max() + 0.5 * min(abs(np.sin(q[-2])), 0.5)
                if merit > most:
                    best, most = q, merit
        if best is not None and most > 0:
            break
    if best is None:
        raise ConfigError(f"robot '{spec.name}': no posture in front of the arm looks down with this hand_eye; check the scanner file")
    return np.round(in_degrees(best))


def _places(spec: RobotSpec, track: tuple[float, float] | None) -> list[dict[str, Any]]:
    """Stations to try, in front of the arm; those of an arm on a track all along it."""
    reach, shoulder = _reach(spec)
    out: list[dict[str, Any]] = []
    for distance in DISTANCES:
        for height in HEIGHTS:
            for azimuth in AZIMUTHS_DEG:
                a = from_degrees(azimuth)
                place = shoulder + reach * np.array([distance * np.cos(a), distance * np.sin(a), height])
                if track is not None:
                    place[0] = np.interp(len(out) % TRACK_PLACES, [0, TRACK_PLACES - 1], track) + place[0]
                lean = -LEAN_DEG if len(out) % 2 else 0.0
                pose = {"translation_mm": [round(float(v)) for v in place], "abc_deg": [azimuth, lean, 0]}
                out.append({"id": f"c{len(out) + 1}", "pose_in_base": pose})
    return out


def replace_id(draft: LoadedPlan, station: str, name: str) -> dict[str, Any]:
    """The station of a draft under another name."""
    spec = next(s for s in draft.plan.stations if str(s.id) == station).pose_in_base
    pose = {"translation_mm": [int(v) for v in spec.translation_mm], "abc_deg": [int(v) for v in spec.abc_deg or (0, 0, 0)]}
    return {"id": name, "pose_in_base": pose}


def _spread(draft: LoadedPlan, found: list[CandidateView], count: int) -> list[str]:
    """Stations with many possible views, as far from each other as can be: the best first, then always the one farthest from all taken."""
    share = {s.id: sum(v.station == s.id for v in found) / VIEWS_TRIED for s in draft.cell.stations}
    good = [s for s in draft.cell.stations if share[s.id] >= LEAST_SHARE]
    if not good:
        return []
    at = {s.id: s.planned_pose[:3, 3] for s in good}
    taken = [max(good, key=lambda s: share[s.id]).id]
    while len(taken) < min(count, len(good)):
        left = [s.id for s in good if s.id not in taken]
        taken.append(max(left, key=lambda s: min(np.linalg.norm(at[s] - at[t]) for t in taken) * (0.5 + share[s])))
    return taken


def _steps(first: list[CandidateView], stations: list[str], apart: int) -> list[dict[str, Any]]:
    """Orientations at the first station, positions everywhere (to be designed), verification at stations of its own."""
    around = sorted(first, key=lambda v: v.view.azimuth_deg)
    picked = [around[int(k)] for k in np.linspace(0, len(around) - 1, min(ORIENTATION_VIEWS, len(around)))]
    around_first = (
        [look_step("orientations", "orientation", stations[:1], [view_mapping(v.view) for v in picked])] if len(picked) >= 3 else []
    )
    positions = look_step("positions", "position", stations, [{"tilt_deg": 10}])
    views = [{"tilt_deg": 12, "azimuth_deg": 180}, {"tilt_deg": 12, "azimuth_deg": 60, "roll_deg": 40}]
    lengths = (look_step(f"verification v{k}", "verification", [f"v{k}"], views, "each") for k in range(1, apart + 1))
    return [*around_first, positions, *lengths]


def _text(head: dict[str, Any], places: list[dict[str, Any]], artefact: str, steps: list[dict[str, Any]]) -> str:
    lines = [
        "# Made by `mbcacq plan new`. Lengths mm, angles deg, in the arm's base frame. What differs in your cell is yours to change:",
        "# driver and options of the robot, hand_eye (a drawing is good enough), obstacles, workspace; then `mbcacq plan check`.",
        yaml12.dump(head, allow_unicode=True, width=120).rstrip(),
        "stations:",
        *(f"  - {flow({'id': p['id'], 'artefact': artefact, 'pose_in_base': p['pose_in_base']})}" for p in places),
        "exposures: 3",
        "steps:",
        *(f"  {line}" for step in steps for line in step_lines(step)),
    ]
    return "\n".join(lines) + "\n"


def _without_errors(loaded: LoadedPlan, progress: Callable[[str], None]) -> tuple[LoadedPlan, int]:
    """The plan without the views that its checks refuse, and how many those were. Raises ConfigError where a step would lose all."""
    left_out = 0
    clearance = clearance_of(loaded)
    near = clearance.at(loaded.plan.robot.home, None)
    if near.distance < loaded.plan.clearance_mm:
        raise ConfigError(
            f"at home {near.a} comes within {near.distance:.0f} mm of {near.b}; give other --scanner numbers (body_mm, hand_eye)"
        )
    for _ in range(ROUNDS):
        progress("checking every pose and every path between them")
        poses, unreachable = expand_reachable(loaded)
        by_number = {p.number: p.line for p in poses}
        errors = [f for f in check(loaded, poses) if f.level == "error"]
        lines = {by_number[n] for f in errors for n in f.poses} | {loaded.lines[t.where] for t in unreachable}
        if not lines:
            if errors:
                raise ConfigError(str(errors[0]))
            return loaded, left_out
        text = without_lines(loaded, lines)
        if text is None:
            text = _without_steps(loaded, lines)
        left_out += len(lines)
        loaded = replace(load(loaded.path, text), planning=loaded.planning)
    raise ConfigError(f"{loaded.path}: no set of views without errors was found; ask for fewer --stations, or another --seed")


def _without_steps(loaded: LoadedPlan, lines: set[int]) -> str:
    """The text without the steps that would lose their last view, and without these lines in the others."""
    data = yaml12.load(loaded.text)
    steps = []
    for index, step in enumerate(data["steps"]):
        views = [v for i, v in enumerate(step["views"]) if loaded.lines[("steps", index, "views", i)] not in lines]
        if views:
            steps.append({**step, "views": views})
    if not any(s["phase"] == "position" for s in steps):
        raise ConfigError(f"{loaded.path}: no free path leads to any of the views; check hand_eye and body_mm of the scanner")
    used = {str(s) for step in steps for s in step["stations"]}
    places = [p for p in data["stations"] if str(p["id"]) in used]
    artefact = places[0]["artefact"]
    head = {k: v for k, v in data.items() if k not in ("stations", "steps", "exposures")}
    return _text(head, places, artefact, steps)

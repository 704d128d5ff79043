"""A plan file and the files it names, read and checked as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mbcacq.files.atomic_write import finish_set
from mbcacq.files.mesh_file import read_mesh
from mbcacq.model import cell, shipped
from mbcacq.model.cell_schema import ArtefactSpec, PoseSpec, RobotSpec, joint_key
from mbcacq.model.formats import newer_format
from mbcacq.model.yaml_source import Path_, YamlFile, parse, read
from mbcacq.plan.planned import LoadedPlan
from mbcacq.plan.plausibility import SMALLEST_DISTANCE_MM, SMALLEST_MOUNT_MM, implausible_artefact, looks_like_metres, looks_like_radians
from mbcacq.plan.schema import Look, Plan, RobotUse, ScanPart, Sweep, Taught

PLAN_FORMAT = "mbcacq-plan/1"
SMALLEST_PART_MM = 5.0
ROTATION_TOLERANCE = 0.02  # of the format: published matrices carry two to four digits


def load(path: str | Path, text: str | None = None) -> LoadedPlan:
    """Read a plan, its robot and its artefacts. Raises ConfigError 'file:line: sentence' for the first thing that is wrong.

    path: also the name of one of the tool's own plans, where there is no file of that name. text: the plan's YAML, where it is not written
    to ``path`` yet.
    """
    finish_set(Path(path).parent)  # of a copied plan and its robot
    file = read(shipped.plan_file(Path(path)), "plan") if text is None else parse(text, Path(path))
    if "format" not in file.data:
        raise file.error((), "this is no plan, which begins with 'format: mbcacq-plan/1'; give a plan, or add that line")
    if sentence := newer_format(file.data["format"], PLAN_FORMAT):
        raise file.error(("format",), f"this plan {sentence}")
    plan = file.validate(Plan)
    robot = _robot(file, plan)
    artefacts = _artefacts(file, plan)
    _check_frames(file, plan)
    _check_stations(file, plan, artefacts)
    _check_steps(file, plan, robot, artefacts)
    scanner = plan.scanner
    described = cell.Cell(
        robot=robot,
        T_flange_scanner=plan.hand_eye.transform(),
        artefacts=artefacts,
        stations=tuple(cell.Station(str(s.id), s.artefact, s.pose_in_base.transform(), s.pose_in_base.sigma_mm) for s in plan.stations),
        scanner_name=scanner.model or scanner.driver,
        noise_mm=None if scanner.noise_mm is None else np.array(scanner.noise_mm),
        room_temperature_C=plan.room_temperature_C,
    )
    named = (plan.robot.model, *plan.artefacts)
    return LoadedPlan(file.path, plan, described, file.text, file.lines, {name: read(file.path.parent / name).text for name in named})


def _named_file(file: YamlFile, where: Path_, name: str, role: str) -> YamlFile:
    """A file that the plan names, relative to the plan."""
    target = file.path.parent / name
    if not target.is_file():
        raise file.error(where, f"there is no {role} file {target}; correct the path (it is relative to the plan)")
    return read(target, role)


def _robot(file: YamlFile, plan: Plan) -> cell.RobotModel:
    use = plan.robot
    source = _named_file(file, ("robot", "model"), use.model, "robot")
    if use.urdf is not None and not (urdf := file.path.parent / use.urdf).is_file():
        raise file.error(("robot", "urdf"), f"there is no URDF {urdf}; correct the path (it is relative to the plan)")
    spec = source.validate(RobotSpec)
    if slides := [i for i, link in enumerate(spec.links) if link.slides or link.follows]:
        raise source.error(
            ("links", slides[0]),
            "a plan moves links that turn, and external axes that turn or slide; give sliding ones as external_axes under robot",
        )
    for index, link in enumerate(spec.links):
        if link.limits_deg[0] >= link.limits_deg[1]:
            raise source.error(("links", index, "limits_deg"), f"limits of A{index + 1}: the lower one must come first; exchange them")
    _check_motion_limits(source, spec)
    if not np.any(spec.base_to_gravity) or (use.base_to_gravity is not None and not np.any(use.base_to_gravity)):
        raise file.error(
            ("robot", "base_to_gravity"),
            "base_to_gravity is a direction and cannot be zero; give the direction in which things fall, in the base frame",
        )
    if spec.external_axes:
        raise source.error(("external_axes",), "a plan has the external axes itself; move them to robot: external_axes of the plan")
    _check_external_axes(file, use)
    model = spec.model(use.external_axes)
    if use.payload is not None:
        model = replace(model, payload_mass=use.payload.mass_kg, payload_com=np.array(use.payload.com_mm))
    if use.base_to_gravity is not None:
        down = np.array(use.base_to_gravity)
        model = replace(model, gravity=down / np.linalg.norm(down))
    _check_joints(file, ("robot", "home_deg"), use.home_deg, model)
    home = use.home
    outside = np.flatnonzero((home < model.limits[:, 0]) | (home > model.limits[:, 1]))
    if len(outside):
        raise file.error(("robot", "home_deg"), f"the home position exceeds the limits of {model.axes[outside[0]]}; choose another")
    return model


def _check_external_axes(file: YamlFile, use: RobotUse) -> None:
    """Each external axis has a name, a speed and a place at home."""
    names = [axis.name for axis in use.external_axes]
    for index, axis in enumerate(use.external_axes):
        where = ("robot", "external_axes", index)
        if axis.name is None or names.count(axis.name) > 1:
            raise file.error(where, "an external axis needs a name of its own, E1 to E9; add it")
        if not (axis.quantity("speed") or 0) > 0:
            raise file.error(where, f"{axis.name} has no {joint_key('speed', axis.type)} above 0; an axis that is to move needs it")
        if not np.any(axis.direction):
            raise file.error(where, f"{axis.name} has a direction of length zero; correct it")
    if use.home_external and len(use.home_external) != len(names):
        raise file.error(("robot", "home_external"), f"{len(use.home_external)} positions are given for {len(names)} external axes")
    for key, named in (("fixed_axes", use.fixed_axes), ("spread_axes", use.spread_axes)):
        if wrong := set(named) - set(names):
            raise file.error(("robot", key), f"there is no external axis '{min(wrong)}'; give one of {', '.join(map(str, names))}")


def _check_motion_limits(source: YamlFile, spec: RobotSpec) -> None:
    """A moving arm has joint and speed limits on every axis; accelerations and jerks, which may follow from speeds, on every axis or
    none."""
    stated = {name for link in spec.links for name in ("acceleration_deg_s2", "jerk_deg_s3") if getattr(link, name) is not None}
    for index, link in enumerate(spec.links):
        if "limits_deg" not in link.model_fields_set:
            raise source.error(("links", index), f"A{index + 1} has no limits_deg; an arm that is to move needs them for every axis")
        for name in sorted({"speed_deg_s"} | stated, reverse=True):
            value = getattr(link, name)
            if value is None or value <= 0:
                raise source.error(
                    ("links", index), f"A{index + 1} has no {name} above 0; give it for every axis of an arm that is to move"
                )


def _artefacts(file: YamlFile, plan: Plan) -> tuple[cell.Artefact, ...]:
    models: list[cell.Artefact] = []
    owner: dict[int, str] = {}
    for index, name in enumerate(plan.artefacts):
        where = ("artefacts", index)
        source = _named_file(file, where, name, "artefact")
        spec = source.validate(ArtefactSpec)
        if any(spec.id == m.id for m in models):
            raise file.error(where, f"artefact '{spec.id}' is named twice; give each artefact an id of its own")
        for ball_index, ball in enumerate(spec.balls):
            if ball.id in owner:
                other = "this artefact" if owner[ball.id] == spec.id else f"artefact '{owner[ball.id]}'"
                sentence = f"ball {ball.id} exists already in {other}; number the balls of a cell once"
                raise source.error(("balls", ball_index, "id"), sentence)
            owner[ball.id] = spec.id
        if (found := implausible_artefact(spec)) is not None:
            raise source.error(*found)
        models.append(_with_surface(source, spec))
    return tuple(models)


def _with_surface(source: YamlFile, spec: ArtefactSpec) -> cell.Artefact:
    """The artefact; a part with its mesh, and the box that holds this."""
    model = spec.model()
    if spec.mesh is None:
        return model

    mesh = read_mesh(source.path.parent / spec.mesh)
    box = np.stack([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])
    if np.ptp(box, axis=0).max() < SMALLEST_PART_MM:
        raise source.error(("mesh",), f"{spec.mesh} spans {np.ptp(box, axis=0).max():.3g}, which looks like metres; export it in mm")
    return replace(model, mesh=mesh, box=box)


def _check_frames(file: YamlFile, plan: Plan) -> None:
    _check_frame(file, ("hand_eye",), plan.hand_eye, SMALLEST_MOUNT_MM)
    for index, station in enumerate(plan.stations):
        _check_frame(file, ("stations", index, "pose_in_base"), station.pose_in_base, SMALLEST_DISTANCE_MM)
    view = plan.scanner.field_of_view
    if view.near_z_mm <= view.far_z_mm:
        raise file.error(
            ("scanner", "field_of_view", "near_z_mm"), "near_z_mm must exceed far_z_mm, since z points to the scanner; exchange them"
        )
    if min(*view.near_half_mm, *view.far_half_mm) <= 0:
        raise file.error(
            ("scanner", "field_of_view"), "the half widths of the field of view must be positive; give half the widths of the data sheet"
        )
    for index, box in enumerate(plan.obstacles):
        if any(low >= high for low, high in zip(box.min_mm, box.max_mm, strict=True)):
            raise file.error(
                ("obstacles", index),
                f"obstacle '{box.name}': each number of min_mm must be below that of max_mm; exchange those that are not",
            )
    space = plan.workspace
    if space is not None and any(low >= high for low, high in zip(space.min_mm, space.max_mm, strict=True)):
        raise file.error(("workspace",), "workspace: each number of min_mm must be below that of max_mm; exchange those that are not")


def _check_frame(file: YamlFile, where: Path_, pose: PoseSpec, smallest_mm: float) -> None:
    if sentence := looks_like_metres(pose.translation_mm, smallest_mm):
        raise file.error((*where, "translation_mm"), sentence)
    if pose.rotation is None:
        return
    if pose.abc_deg is not None:
        raise file.error(where, "a frame has either 'rotation' or 'abc_deg', not both; remove one")
    R = np.array(pose.rotation)
    if np.abs(R @ R.T - np.eye(3)).max() > ROTATION_TOLERANCE or np.linalg.det(R) < 0:
        raise file.error((*where, "rotation"), "this is no rotation (rows of length 1, perpendicular, right-handed); correct it")


def _check_stations(file: YamlFile, plan: Plan, artefacts: tuple[cell.Artefact, ...]) -> None:
    known = [a.id for a in artefacts]
    ids: set[str] = set()
    for index, station in enumerate(plan.stations):
        if str(station.id) in ids:
            raise file.error(("stations", index, "id"), f"station '{station.id}' exists already; give each station an id of its own")
        ids.add(str(station.id))
        if station.artefact not in known:
            sentence = f"station '{station.id}' names an artefact '{station.artefact}' that the plan does not have"
            raise file.error(
                ("stations", index, "artefact"), f"{sentence} (it has {', '.join(known)}); name one of these, or add its file to artefacts"
            )


def _check_steps(file: YamlFile, plan: Plan, robot: cell.RobotModel, artefacts: tuple[cell.Artefact, ...]) -> None:
    artefact_of = {str(s.id): next(a for a in artefacts if a.id == s.artefact) for s in plan.stations}
    names: set[str] = set()
    for index, step in enumerate(plan.steps):
        where = ("steps", index)
        if step.name in names:
            raise file.error((*where, "name"), f"step '{step.name}' exists already; give each step a name of its own")
        names.add(step.name)
        several = isinstance(step, Look | Sweep | ScanPart)
        wanted = {("stations", i): s for i, s in enumerate(step.stations)} if several else {("station",): step.station}
        for place, station in wanted.items():
            if str(station) not in artefact_of:
                sentence = f"step '{step.name}' names a station '{station}' that the plan does not have (it has {', '.join(artefact_of)})"
                raise file.error((*where, *place), f"{sentence}; name one of these, or add the station")
            if artefact_of[str(station)].is_part != isinstance(step, ScanPart):
                what = (
                    "is a part, which only 'do: scan' takes"
                    if artefact_of[str(station)].is_part
                    else "has balls, and 'do: scan' takes parts"
                )
                raise file.error((*where, *place), f"step '{step.name}': what stands at station '{station}' {what}; name another station")
        if isinstance(step, Look | Sweep) and isinstance(step.balls, tuple):
            for station in step.stations:
                _check_balls(file, where, step.name, step.balls, artefact_of[str(station)], station)
        if isinstance(step, Taught):
            for i, pose in enumerate(step.poses_deg):
                _check_joints(file, (*where, "poses_deg", i), pose, robot)
            _check_balls(file, where, step.name, step.balls or (), artefact_of[str(step.station)], step.station)


def _check_balls(file: YamlFile, where: Path_, step: str, balls: tuple[int, ...], artefact: cell.Artefact, station: str | int) -> None:
    if missing := set(balls) - set(artefact.ball_ids):
        sentence = f"step '{step}' expects ball {min(missing)}, which the artefact at station '{station}' does not have"
        sentence += f" (it has {', '.join(map(str, artefact.ball_ids))}); expect others, or correct the artefact file"
        raise file.error((*where, "balls"), sentence)


def _check_joints(file: YamlFile, where: Path_, angles_deg: Sequence[float], robot: cell.RobotModel) -> None:
    own = [not name.startswith("E") for name in robot.axes]
    if len(angles_deg) != sum(own):
        raise file.error(where, f"{len(angles_deg)} joint angles are given, but the robot has {sum(own)} axes; give one for each axis")
    if sentence := looks_like_radians(angles_deg, robot.limits[own]):
        raise file.error(where, sentence)

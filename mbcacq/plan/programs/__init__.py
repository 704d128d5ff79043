"""A plan's poses as programs of robot controllers, for arms that this program does not drive.

The programs are written from the templates in ``languages``, one for each file: KRL, RAPID, KAREL, URScript, V+ and INFORM read there as
they do on the controller.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.files.template import filled
from mbcacq.plan.controller_joints import pulses
from mbcacq.plan.planned import LoadedPlan
from mbcacq.plan.programs.motion_program import ExposeAt, MotionProgram, MoveTo, plain
from mbcacq.plan.programs.motion_program import PlaceArtefact as PlaceArtefact
from mbcacq.plan.programs.motion_program import Trigger as Trigger
from mbcacq.plan.programs.motion_program import motion_program as motion_program

LANGUAGES = Path(__file__).parent / "languages"


@dataclass(frozen=True)
class ControllerLanguage:
    """maker: whose controllers read it. axes: how many such a program can have, or () for any. files: names, NAME in place of the
    program's, with the template of each. joints: where the angles that the controller measured are found afterwards. load: how the program
    gets onto the controller and is started. weight: what knows the scanner's weight. slow: the mode for the first run. counts: how the
    controller counts joints, where that differs from most robot files; the plan then has to say how. external: whether programs
    move external axes."""

    maker: str
    axes: tuple[int, ...]
    files: dict[str, str]
    joints: str
    load: str
    weight: str = "Set tool and load data: the scanner with its bracket. The moves are in joint angles; no tool or base is used"
    slow: str = "manual mode at reduced speed"
    counts: str = ""
    external: bool = False
    line_end: str = "\n"


DIALECTS = {
    "krl": ControllerLanguage(
        maker="KUKA (KSS)",
        axes=(6,),
        files={"NAME.src": "krl.src.j2", "NAME.dat": "krl.dat.j2"},
        joints="in NAME.dat, copied back from the controller",
        load="copy both files to KRC:\\R1\\Program; select NAME in T1",
        slow="T1",
        external=True,
    ),
    "rapid": ControllerLanguage(
        maker="ABB",
        axes=(6,),
        files={"NAME.mod": "rapid.mod.j2"},
        joints="in HOME:/NAME.csv",
        load="load NAME.mod into T_ROB1, PP to Routine: mbcacq_run; define the digital output do_mbcacq_OUTPUT",
        weight="Check mass and centre of gravity in tooldata mb_scanner, which all moves use: the scanner with its bracket",
    ),
    "karel": ControllerLanguage(
        maker="FANUC",
        axes=(6,),
        files={"NAME.kl": "karel.kl.j2", "mbc_move.ls": "karel.ls.j2"},
        joints="in UD1:\\NAME.csv",
        load="translate NAME.kl (ktrans), load both, set $KAREL_ENB to 1, select NAME; position register 90 and group 1 are used",
        slow="T1",
        counts="J3 from the horizontal: couplings: [{axis: 3, of: 2, factor: -1}]",
    ),
    "urscript": ControllerLanguage(
        maker="Universal Robots",
        axes=(6,),
        files={"NAME.script": "urscript.j2"},
        joints="in the log, as text messages 'mbcacq joints'",
        load="load NAME.script in a Script node of a program",
    ),
    "vplus": ControllerLanguage(
        maker="Adept, Staubli (V+)",
        axes=(4, 5, 6),
        files={"NAME.pg": "vplus.pg.j2"},
        joints="on the terminal, lines 'mbcacq pose'",
        load="LOAD NAME.pg, then EXECUTE NAME",
        line_end="\r\n",
    ),
    "inform": ControllerLanguage(
        maker="Yaskawa Motoman",
        axes=(6, 7),
        files={"JOB.JBI": "inform.jbi.j2"},
        joints="nowhere; write them down where they are wanted",
        load="load the job from a USB stick",
        slow="TEACH",
        line_end="\r\n",
    ),
    "csv": ControllerLanguage(
        "any other", (), {}, "wherever the controller writes them", "read it by a program of your own", external=True
    ),
}


def written(loaded: LoadedPlan, program: MotionProgram, dialect: str) -> dict[str, str]:
    """Files by name, README.txt and poses.csv among them. Raises ConfigError for a language that there is none of, or that this arm does
    not fit."""
    language = DIALECTS.get(dialect)
    if language is None:
        raise ConfigError(f"there is no language '{dialect}' of robot programs; choose one of {', '.join(DIALECTS)}")
    if program.external and not language.external:
        raise ConfigError(f"programs of {language.maker} are written without external axes, which this plan has; take --for krl or csv")
    if language.axes and program.n - program.external not in language.axes:
        raise ConfigError(
            f"{loaded.cell.robot.name} has {program.n} axes, and programs of {language.maker} are written for "
            f"{' or '.join(map(str, language.axes))}; take --for csv"
        )
    if language.counts and loaded.plan.robot.controller_joints is None:
        raise ConfigError(
            f"{loaded.path}: controllers of {language.maker} count {language.counts}; write that under robot: controller_joints, "
            "or {} there if the robot file counts as the controller does"
        )
    job = program.name.upper().replace("_", "-")[:8]
    values: dict[str, Any] = {"program": program, "trigger": program.trigger, "job": job, "plain": plain}
    robot = loaded.cell.robot
    com = robot.payload_com if robot.payload_com.any() else [0, 0, 0.001]  # RAPID refuses a load without mass or place
    values |= {"mass_kg": max(robot.payload_mass, 0.001), "com_mm": list(com)}
    if dialect == "inform":
        values["pulses"] = pulses(loaded, np.array([step.angles for step in program.steps if isinstance(step, MoveTo)])).tolist()
    files = {f"{program.name}.csv": _table(program)} if dialect == "csv" else {}
    for name, template in language.files.items():
        text = filled(LANGUAGES / template, **values).replace("\n", language.line_end)
        files[name.replace("NAME", program.name).replace("JOB", job)] = text
    readme = filled(LANGUAGES / "readme.txt.j2", language=language, files=list(files), **values)
    return {**files, "poses.csv": poses_table(program), "README.txt": readme}


def poses_table(program: MotionProgram) -> str:
    """One row a cloud: its running number, its pose, and the joint angles that it is to be taken at."""
    rows, angles = [], list[str]()
    for step in program.steps:
        if isinstance(step, MoveTo):
            angles = step.written
        elif isinstance(step, ExposeAt):
            rows += [[cloud, step.pose, k, step.station, program.digest, *angles] for k, cloud in enumerate(step.clouds)]
    return _csv(program, ("cloud", "pose", "exposure", "station", "plan"), rows)


def _table(program: MotionProgram) -> str:
    """One row a step."""
    rows, nowhere = [], [""] * program.n
    for number, step in enumerate(program.steps, 1):
        if isinstance(step, MoveTo):
            duration = "" if step.duration_s is None else f"{step.duration_s:.3f}"
            rows.append([number, "move", "", "", "", duration, *step.written])
        elif isinstance(step, ExposeAt):
            rows.append([number, "expose", step.pose, step.station, len(step.clouds), "", *nowhere])
        else:
            rows.append([number, "place", "", step.station, "", "", *nowhere])
    return _csv(program, ("step", "do", "pose", "station", "clouds", "duration_s"), rows)


def _csv(program: MotionProgram, headings: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*headings, *program.headings])
    writer.writerows(rows)
    return out.getvalue()

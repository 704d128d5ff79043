"""A plan's poses as programs of robot controllers, for arms that this program does not drive."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq.plan.controller_joints import pulses
from mbcacq.plan.planned import LoadedPlan
from mbcacq.plan.programs import inform, karel, krl, rapid, urscript, vplus
from mbcacq.plan.programs.motion_program import ExposeAt, MotionProgram, MoveTo, PlaceArtefact, Trigger, motion_program

__all__ = ["DIALECTS", "ExposeAt", "MotionProgram", "MoveTo", "PlaceArtefact", "Trigger", "motion_program", "written"]


@dataclass(frozen=True)
class ControllerLanguage:
    """maker: whose controllers read it. axes: how many such a program can have, or () for any. joints: where the angles that the controller
    measured are found afterwards. load: how the program gets onto the controller."""

    maker: str
    axes: tuple[int, ...]
    joints: str
    load: str


DIALECTS = {
    "krl": ControllerLanguage(
        "KUKA (KSS)", (6,), "in NAME.dat, copied back from the controller", "copy both files to KRC:\\R1\\Program; select NAME in T1"
    ),
    "rapid": ControllerLanguage(
        "ABB", (6,), "in HOME:/NAME.csv", "load NAME.mod into T_ROB1, move the pointer to mbcacq_run; the output is do_mbcacq_N"
    ),
    "karel": ControllerLanguage(
        "FANUC", (6,), "in UD1:\\NAME.csv", "translate NAME.kl (ktrans), load both; position register 90 and group 1 are used"
    ),
    "urscript": ControllerLanguage(
        "Universal Robots", (6,), "in the log, as text messages 'mbcacq joints'", "load NAME.script in a Script node of a program"
    ),
    "vplus": ControllerLanguage(
        "Adept, Staubli (V+)", (4, 5, 6), "on the terminal, lines 'mbcacq pose'", "LOAD NAME.pg, then EXECUTE NAME"
    ),
    "inform": ControllerLanguage(
        "Yaskawa Motoman", (6, 7), "nowhere; write them down where they are wanted", "load the job from a USB stick"
    ),
    "csv": ControllerLanguage("any other", (), "wherever the controller writes them", "read it by a program of your own"),
}


def written(loaded: LoadedPlan, program: MotionProgram, dialect: str) -> dict[str, str]:
    """Files by name, README.txt and poses.csv among them. Raises ConfigError for a language that there is none of, or that this arm does
    not fit."""
    about = DIALECTS.get(dialect)
    if about is None:
        raise ConfigError(f"there is no language '{dialect}' of robot programs; choose one of {', '.join(DIALECTS)}")
    if about.axes and program.n not in about.axes:
        raise ConfigError(
            f"{loaded.cell.robot.name} has {program.n} axes, and programs of {about.maker} are written for "
            f"{' or '.join(map(str, about.axes))}; take --for csv"
        )
    plain_writers = {"krl": krl.write, "rapid": rapid.write, "karel": karel.write, "urscript": urscript.write, "vplus": vplus.write}
    if dialect == "inform":
        files = inform.write(program, pulses(loaded, np.array([move.angles for move in program.moves])))
    elif dialect == "csv":
        files = {f"{program.name}.csv": _table(program)}
    else:
        files = plain_writers[dialect](program)
    return {**files, "poses.csv": poses_table(program), "README.txt": _readme(program, about, list(files))}


def poses_table(program: MotionProgram) -> str:
    """One row a cloud: its running number, its pose, and the joint angles that it is to be taken at."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["cloud", "pose", "exposure", "station", "plan", *(f"q{k}_deg" for k in range(1, program.n + 1))])
    angles: tuple[float, ...] = ()
    for step in program.steps:
        if isinstance(step, MoveTo):
            angles = step.angles
        elif isinstance(step, ExposeAt):
            for exposure, cloud in enumerate(step.clouds):
                writer.writerow([cloud, step.pose, exposure, step.station, program.digest, *(f"{a + 0.0:.6f}" for a in angles)])
    return out.getvalue()


def _table(program: MotionProgram) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["step", "do", "pose", "station", "clouds", "duration_s", *(f"q{k}_deg" for k in range(1, program.n + 1))])
    for number, step in enumerate(program.steps, 1):
        if isinstance(step, MoveTo):
            writer.writerow(
                [
                    number,
                    "move",
                    "",
                    "",
                    "",
                    "" if step.duration_s is None else f"{step.duration_s:.3f}",
                    *(f"{a + 0.0:.6f}" for a in step.angles),
                ]
            )
        elif isinstance(step, ExposeAt):
            writer.writerow([number, "expose", step.pose, step.station, len(step.clouds), "", *[""] * program.n])
        else:
            writer.writerow([number, "place", "", step.station, "", "", *[""] * program.n])
    return out.getvalue()


def _readme(program: MotionProgram, about: ControllerLanguage, files: list[str]) -> str:
    trigger = program.trigger
    asked = {
        "output": f"digital output {trigger.output} is set for {trigger.pulse_s:g} s, then the arm waits {trigger.exposure_s:g} s",
        "pause": f"the arm waits {trigger.exposure_s:g} s",
        "key": "the program waits until you start it again",
    }[trigger.kind]
    load = about.load.replace("NAME", program.name)
    joints = about.joints.replace("NAME", program.name)
    return f"""Plan {program.plan} ({program.digest}) for {program.robot}: {", ".join(files)}

NOBODY HAS RUN THIS PROGRAM. Its moves are those of the plan's checked routes; what stands in the cell and is not
in the plan, it does not know. Run it in T1 or at reduced speed first, step by step, a hand on the enabling switch.

1. {load}.
2. Set tool and load data: the scanner with its bracket. The moves are in joint angles; no tool or base is used.
3. Compare the first target, home, with what the pendant shows when the arm stands there. Where the controller counts
   its joints otherwise than the robot file, say so in the plan (robot: controller_joints) and write the program anew.
4. Start the scanner's program, its folder empty. At each exposure {asked}.
   One cloud an exposure; poses.csv says which number belongs to which pose.
5. Where the program stops for an artefact, put it to the station and start again.
6. The joint angles that the controller measured are {joints}.

Then, on this computer:  mbcacq collect PLAN --clouds FOLDER [--joints FILE]
"""

"""KRL of KUKA controllers: a program, and a data list in which the controller keeps the joint angles that it measured at each pose."""

from __future__ import annotations

from collections.abc import Iterator

from mbcacq.plan.programs.motion_program import ExposeAt, ExposureLines, MotionProgram, MoveTo, plain, title

HEAD = "&ACCESS RVP\n&PARAM EDITMASK = *\n&PARAM TEMPLATE = C:\\KRC\\Roboter\\Template\\vorgabe\n"
EXPOSURE = ExposureLines(
    key=("; take one cloud now, then start again", "HALT"),
    wait=lambda seconds: f"WAIT SEC {seconds:.2f}",
    on="$OUT[{}]=TRUE",
    off="$OUT[{}]=FALSE",
)


def write(program: MotionProgram) -> dict[str, str]:
    """NAME.src and NAME.dat."""
    name = program.name
    return {f"{name}.src": HEAD + "\n".join(_source(program)) + "\n", f"{name}.dat": "\n".join(_data(program)) + "\n"}


def axis(angles: tuple[float, ...]) -> str:
    """An aggregate of joint angles, deg."""
    return "{" + ",".join(f"A{k} {angle + 0.0:.5f}" for k, angle in enumerate(angles, 1)) + "}"


def _data(program: MotionProgram) -> Iterator[str]:
    yield "&ACCESS RVP"
    yield f"DEFDAT {program.name}"
    yield "   ; mb_at holds what $AXIS_ACT_MEAS said at each exposure: mbcacq collect --joints reads this file"
    yield "   DECL INT mb_pose=-1"
    yield f"   DECL E6AXIS mb_at[{len(program.exposures)}]"
    for k in range(len(program.exposures)):
        yield f"   mb_at[{k + 1}]={axis((0.0,) * program.n)}"
    yield "ENDDAT"


def _source(program: MotionProgram) -> Iterator[str]:
    yield f"DEF {program.name}()"
    yield from (f"   ; {line}" for line in title(program))
    yield "   DECL INT k"
    yield "   ;FOLD INI"
    yield "      ;FOLD BASISTECH INI"
    yield "         GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )"
    yield "         INTERRUPT ON 3"
    yield "         BAS (#INITMOV,0 )"
    yield "      ;ENDFOLD (BASISTECH INI)"
    yield "   ;ENDFOLD (INI)"
    yield "   $ADVANCE=0"
    yield f"   FOR k=1 TO {program.n}"
    yield f"      $VEL_AXIS[k]={program.speed_percent}"
    yield f"      $ACC_AXIS[k]={program.acceleration_percent}"
    yield "   ENDFOR"
    number = 0
    for step in program.steps:
        if isinstance(step, MoveTo):
            yield f"   ; {step.note}"
            yield f"   PTP {axis(step.angles)}"
        elif isinstance(step, ExposeAt):
            number += 1
            yield f"   mb_pose={step.pose}"
            yield f"   WAIT SEC {program.settle_s:.2f}"
            yield f"   mb_at[{number}]=$AXIS_ACT_MEAS"
            yield f"   mb_expose({len(step.clouds)})"
        else:
            yield f"   ; place {plain(step.artefact)} at station {plain(step.station)}, then start again"
            yield "   HALT"
    yield "END"
    yield ""
    yield "DEF mb_expose(n:IN)"
    yield "   DECL INT n"
    yield "   DECL INT k"
    yield "   FOR k=1 TO n"
    yield from (f"      {line}" for line in EXPOSURE.of(program.trigger))
    yield "   ENDFOR"
    yield "END"

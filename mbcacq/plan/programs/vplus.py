"""V+ of Adept and Staubli controllers: a program of precision points; joint angles of each pose go onto the terminal."""

from __future__ import annotations

from collections.abc import Iterator

from mbcacq.plan.programs.motion_program import ExposeAt, ExposureLines, MotionProgram, MoveTo, plain, title

EXPOSURE = ExposureLines(
    key=('PROMPT "Take one cloud, then RETURN ", $answer',),
    wait=lambda seconds: f"WAIT.EVENT , {seconds:.2f}",
    on="SIGNAL {}",
    off="SIGNAL -{}",
)


def write(program: MotionProgram) -> dict[str, str]:
    """NAME.pg."""
    return {f"{program.name}.pg": "\r\n".join([*_program(program), *_exposing(program)]) + "\r\n"}


def _program(program: MotionProgram) -> Iterator[str]:
    yield f".PROGRAM {program.name}()"
    yield from (f"  ; {line}" for line in title(program))
    yield f"  SPEED {program.speed_percent} ALWAYS"
    yield f"  ACCEL {program.acceleration_percent}, {program.acceleration_percent}"
    yield "  FINE 100 ALWAYS"
    yield "  CPOFF ALWAYS"
    for step in program.steps:
        if isinstance(step, MoveTo):
            angles = ", ".join(f"{angle + 0.0:.5f}" for angle in step.angles)
            yield f"  ; {step.note}"
            yield f"  MOVE #PPOINT({angles})"
            yield "  BREAK"
        elif isinstance(step, ExposeAt):
            yield f"  CALL mb_expose({step.pose}, {len(step.clouds)})"
        else:
            yield f'  PROMPT "Place {plain(step.artefact)} at station {plain(step.station)}, then RETURN ", $answer'
    yield ".END"


def _exposing(program: MotionProgram) -> Iterator[str]:
    yield ".PROGRAM mb_expose(pose, clouds)"
    yield "  LOCAL k, joint[]"
    yield f"  WAIT.EVENT , {program.settle_s:.2f}"
    yield "  HERE #mb_at"
    yield "  DECOMPOSE joint[1] = #mb_at"
    values = ", ".join(f'",", /F12.5, joint[{k}]' for k in range(1, program.n + 1))
    yield f'  TYPE "mbcacq pose ", /I0, pose, {values}'
    yield "  FOR k = 1 TO clouds"
    yield from (f"    {line}" for line in EXPOSURE.of(program.trigger))
    yield "  END"
    yield ".END"

"""KAREL of FANUC controllers. KAREL itself moves no arm any more: a TP program, which it calls, goes to a position register."""

from __future__ import annotations

from collections.abc import Iterator

from mbcacq.plan.programs.motion_program import ExposeAt, ExposureLines, MotionProgram, MoveTo, plain, title

REGISTER = 90  # position register that the program uses
MOVER = "MBC_MOVE"
EXPOSURE = ExposureLines(
    key=("WRITE('Take one cloud of pose ', mb_pose, ', then ENTER', CR)", "READ(answer)"),
    wait=lambda seconds: f"DELAY {_ms(seconds)}",
    on="DOUT[{}] = ON",
    off="DOUT[{}] = OFF",
)


def write(program: MotionProgram) -> dict[str, str]:
    """NAME.kl and MBC_MOVE.ls."""
    return {f"{program.name}.kl": "\n".join(_source(program)) + "\n", f"{MOVER.lower()}.ls": "\n".join(_mover(program)) + "\n"}


def _mover(program: MotionProgram) -> Iterator[str]:
    yield f"/PROG  {MOVER}"
    yield "/ATTR"
    yield f'COMMENT = "{plain(program.plan)[:16]}";'
    yield "DEFAULT_GROUP = 1,*,*,*,*;"
    yield "/MN"
    yield f"   1:J PR[{REGISTER}] {program.speed_percent}% FINE ACC{program.acceleration_percent} ;"
    yield "/POS"
    yield "/END"


def _source(program: MotionProgram) -> Iterator[str]:
    yield f"PROGRAM {program.name}"
    yield from (f"-- {line}" for line in title(program))
    yield "%NOLOCKGROUP"
    yield "%NOPAUSE=ERROR+COMMAND+TPENABLE"
    yield "VAR"
    yield "  mb_pose  : INTEGER"
    yield "  status   : INTEGER"
    yield "  index    : INTEGER"
    yield "  answer   : STRING[8]"
    yield "  log      : FILE"
    yield "  angle    : ARRAY[9] OF REAL"
    yield f"  target   : JOINTPOS{program.n}"
    yield ""
    yield f"ROUTINE go({'; '.join(f'j{k}: REAL' for k in range(1, program.n + 1))})"
    yield "BEGIN"
    yield from (f"  angle[{k}] = j{k}" for k in range(1, program.n + 1))
    yield "  CNV_REL_JPOS(angle, target, status)"
    yield f"  SET_JPOS_REG({REGISTER}, target, status)"
    yield f"  CALL_PROG('{MOVER}', index)"
    yield "END go"
    yield ""
    yield "ROUTINE expose(pose: INTEGER; clouds: INTEGER)"
    yield "VAR"
    yield "  k : INTEGER"
    yield "BEGIN"
    yield "  mb_pose = pose"
    yield f"  DELAY {_ms(program.settle_s)}"
    yield "  CNV_JPOS_REL(CURJPOS(0, 0), angle, status)"
    yield "  WRITE log(pose)"
    yield from (f"  WRITE log(',', angle[{k}]::12::5)" for k in range(1, program.n + 1))
    yield "  WRITE log(CR)"
    yield "  FOR k = 1 TO clouds DO"
    yield from (f"    {line}" for line in EXPOSURE.of(program.trigger))
    yield "  ENDFOR"
    yield "END expose"
    yield ""
    yield "BEGIN"
    yield f"  OPEN FILE log('RW', 'UD1:\\{program.name}.csv')"
    yield f"  WRITE log('pose,{','.join(f'q{k}_deg' for k in range(1, program.n + 1))}', CR)"
    for step in program.steps:
        if isinstance(step, MoveTo):
            yield f"  -- {step.note}"
            yield f"  go({', '.join(f'{angle + 0.0:.5f}' for angle in step.angles)})"
        elif isinstance(step, ExposeAt):
            yield f"  expose({step.pose}, {len(step.clouds)})"
        else:
            yield f"  WRITE('Place {plain(step.artefact)[:24]} at {plain(step.station)[:12]}, then ENTER', CR)"
            yield "  READ(answer)"
    yield "  CLOSE FILE log"
    yield f"END {program.name}"


def _ms(seconds: float) -> int:
    return round(1000 * seconds)

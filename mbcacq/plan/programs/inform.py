"""INFORM of Yaskawa controllers: a job (JBI) whose positions are encoder pulses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbcacq.plan.programs.motion_program import ExposeAt, ExposureLines, MotionProgram, MoveTo, plain, title

EXPOSURE = ExposureLines(
    key=("'TAKE ONE CLOUD, THEN START", "PAUSE"),
    wait=lambda seconds: f"TIMER T={seconds:.2f}",
    on="DOUT OT#({}) ON",
    off="DOUT OT#({}) OFF",
)


def write(program: MotionProgram, pulses: np.ndarray) -> dict[str, str]:
    """NAME.JBI. pulses: (M, n) of the program's moves."""
    name = program.name.upper().replace("_", "-")[:8]
    return {f"{name}.JBI": "\r\n".join(_job(program, name, pulses)) + "\r\n"}


def _job(program: MotionProgram, name: str, pulses: np.ndarray) -> Iterator[str]:
    yield "/JOB"
    yield f"//NAME {name}"
    yield "//POS"
    yield f"///NPOS {len(pulses)},0,0,0,0,0"
    yield "///TOOL 0"
    yield "///POSTYPE PULSE"
    yield "///PULSE"
    yield from (f"C{k:05d}={','.join(str(p) for p in row.tolist())}" for k, row in enumerate(pulses))
    yield "//INST"
    yield "///DATE 2000/01/01 00:00"
    yield "///ATTR SC,RW"
    yield "///GROUP1 RB1"
    yield "NOP"
    yield from (f"'{line}"[:33] for text in title(program) for line in _lines(text))
    number = 0
    for step in program.steps:
        if isinstance(step, MoveTo):
            yield f"'{step.note}"
            yield f"MOVJ C{number:05d} VJ={float(program.speed_percent):.2f} PL=0"
            number += 1
        elif isinstance(step, ExposeAt):
            yield f"TIMER T={program.settle_s:.2f}"
            yield f"SET I000 {step.pose}"
            for _ in step.clouds:
                yield from EXPOSURE.of(program.trigger)
        else:
            yield f"'PLACE {plain(step.artefact)[:12]} AT {plain(step.station)[:10]}"
            yield "PAUSE"
    yield "END"


def _lines(text: str) -> Iterator[str]:
    """In pieces of 32 characters, the longest comment of a job."""
    words, line = text.split(), ""
    for word in words:
        if line and len(line) + 1 + len(word) > 32:
            yield line
            line = ""
        line = f"{line} {word}".strip()
    yield line

"""RAPID of ABB controllers: a module whose moves take the plan's time, and which writes the joint angles of each pose into a file."""

from __future__ import annotations

from collections.abc import Iterator

from mbcacq.plan.programs.motion_program import ExposeAt, ExposureLines, MotionProgram, MoveTo, plain, title

SHORTEST_S = 0.1  # of a move that hardly goes anywhere
FIRST = "v50"  # mm/s, from wherever the arm stands
EXPOSURE = ExposureLines(
    key=('TPWrite "Take one cloud of pose " \\Num:=mb_pose;', "Stop;"),
    wait=lambda seconds: f"WaitTime {seconds:.2f};",
    on="SetDO do_mbcacq_{}, 1;",
    off="SetDO do_mbcacq_{}, 0;",
)


def write(program: MotionProgram) -> dict[str, str]:
    """NAME.mod."""
    return {f"{program.name}.mod": "\n".join(_module(program)) + "\n"}


def _module(program: MotionProgram) -> Iterator[str]:
    yield f"MODULE {program.name}"
    yield from (f"  ! {line}" for line in title(program))
    yield "  VAR iodev mb_file;"
    yield "  VAR num mb_pose := -1;"
    yield ""
    yield "  PROC mbcacq_run()"
    yield f"    AccSet {max(20, program.acceleration_percent)}, {max(10, program.acceleration_percent)};"
    yield f'    Open "HOME:" \\File:="{program.name}.csv", mb_file \\Write;'
    joints = ",".join(f"q{k}_deg" for k in range(1, 7))
    yield f'    Write mb_file, "pose,time,{joints}";'
    for step in program.steps:
        if isinstance(step, MoveTo):
            angles = ",".join(f"{angle + 0.0:.5f}" for angle in step.angles)
            yield f"    ! {step.note}"
            speed = FIRST if step.duration_s is None else f"v100 \\T:={max(SHORTEST_S, step.duration_s):.3f}"
            yield f"    MoveAbsJ [[{angles}],[9E9,9E9,9E9,9E9,9E9,9E9]] \\NoEOffs, {speed}, fine, tool0;"
        elif isinstance(step, ExposeAt):
            yield f"    mb_expose {step.pose}, {len(step.clouds)};"
        else:
            yield f'    TPWrite "Place {plain(step.artefact)[:24]} at {plain(step.station)[:12]}, then start";'
            yield "    Stop;"
    yield "    Close mb_file;"
    yield "  ENDPROC"
    yield ""
    yield "  PROC mb_expose(num pose, num clouds)"
    yield "    VAR jointtarget at;"
    yield "    mb_pose := pose;"
    yield f"    WaitTime \\InPos, {program.settle_s:.2f};"
    yield "    at := CJointT();"
    yield '    Write mb_file, NumToStr(pose,0) + "," \\NoNewLine;'
    yield '    Write mb_file, CDate() + "T" + CTime() + "," \\NoNewLine;'
    for k in range(1, 7):
        end = ";" if k == 6 else ' + "," \\NoNewLine;'
        yield f"    Write mb_file, NumToStr(at.robax.rax_{k},5){end}"
    yield "    FOR k FROM 1 TO clouds DO"
    yield from (f"      {line}" for line in EXPOSURE.of(program.trigger))
    yield "    ENDFOR"
    yield "  ENDPROC"
    yield "ENDMODULE"

"""URScript of Universal Robots: one function; joint angles of each pose go into the controller's log."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mbcacq.plan.programs.motion_program import ExposeAt, ExposureLines, MotionProgram, MoveTo, plain, title

EXPOSURE = ExposureLines(
    key=('popup("Take one cloud, then go on", title="mbcacq", blocking=True)',),
    wait=lambda seconds: f"sleep({seconds:.2f})",
    on="set_standard_digital_out({}, True)",
    off="set_standard_digital_out({}, False)",
)


def write(program: MotionProgram) -> dict[str, str]:
    """NAME.script."""
    return {f"{program.name}.script": "\n".join(_script(program)) + "\n"}


def _script(program: MotionProgram) -> Iterator[str]:
    yield f"def {program.name}():"
    yield from (f"  # {line}" for line in title(program))
    yield f"  mb_v = {program.speed_rad_s:.6f}"
    yield f"  mb_a = {program.acceleration_rad_s2:.6f}"
    yield ""
    yield "  def mb_expose(pose, clouds):"
    yield f"    sleep({program.settle_s:.2f})"
    yield '    textmsg("mbcacq pose ", pose)'
    yield '    textmsg("mbcacq joints ", get_actual_joint_positions())'
    yield "    k = 0"
    yield "    while k < clouds:"
    yield from (f"      {line}" for line in EXPOSURE.of(program.trigger))
    yield "      k = k + 1"
    yield "    end"
    yield "  end"
    yield ""
    for step in program.steps:
        if isinstance(step, MoveTo):
            angles = ", ".join(f"{angle + 0.0:.8f}" for angle in np.radians(step.angles))
            yield f"  # {step.note}"
            yield f"  movej([{angles}], a=mb_a, v=mb_v)"
        elif isinstance(step, ExposeAt):
            yield f"  mb_expose({step.pose}, {len(step.clouds)})"
        else:
            text = f"Place {plain(step.artefact)} at station {plain(step.station)}, then go on"
            yield f'  popup("{text}", title="mbcacq", blocking=True)'
    yield "end"

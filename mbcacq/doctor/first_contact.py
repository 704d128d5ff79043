"""The protocol of a first contact with real devices: what to look at, in which order, to be ticked by whoever stands at the arm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from mbcacq.devices import load_driver

if TYPE_CHECKING:
    from mbcacq.plan import LoadedPlan

BEFORE = (
    "Operating mode T1 (or the arm's reduced speed), a hand on the enabling switch, nobody else in reach of the arm.",
    "Payload, tool and emergency stop were checked as the arm's manual asks for, with this computer unplugged.",
    "`mbcacq plan check {plan}` ends without errors; every warning is understood.",
    "`mbcacq run {plan} --dry-run` ends with a report; note how long it took and the length error.",
)
RUN = (
    "`mbcacq doctor {plan} --arm` names every device as it is; write down what differs from the type plates.",
    "`mbcacq run {plan} --arm --step`: at the first question, compare the pose that is announced with where the arm may go. Then a key a "
    "pose.",
    "Press the emergency stop once while the arm moves: it stands at once, and the program ends with one sentence that names the stop.",
    "Press Ctrl-C once while the arm moves: it brakes on its path, and the program says how to go on; go on with that command.",
    "Pull the robot's network cable once while the arm moves: it stands within a second, and the program names the lost connection.",
    "In the viewer (`mbcacq view latest`): the drawn arm stands as the real one, and the balls are found where they are.",
)
FOLLOWED = (
    "`mbcacq doctor {plan} --arm` names every device as it is; write down what differs from the type plates.",
    "`mbcacq run {plan}`: bring the arm to the first target by hand; the angles on the terminal agree with the pendant's.",
    "Leave the arm away from a target for half a minute: the program says how far and which axis; nothing moves by itself.",
    "In the viewer (`mbcacq view latest`): the drawn arm stands as the real one, and the balls are found where they are.",
)
AFTER = (
    "`mbcacq doctor --evidence latest --out evidence.json` writes what the devices said into one file; `--anonymous` leaves addresses and "
    "serial numbers out.",
    "Send that file with this protocol: it shows what differs from the fakes that the drivers were written against.",
)


def protocol(loaded: LoadedPlan) -> str:
    """A page of Markdown for this plan. Each driver's own steps are its class attribute ``first_contact``, in order."""
    return "\n".join(_lines(loaded)) + "\n"


def _lines(loaded: LoadedPlan) -> Iterator[str]:
    plan = loaded.plan
    yield f"# First contact: {plan.name}"
    yield ""
    yield "Perhaps nobody has tried these drivers on hardware yet. Go through it from top to bottom; stop at the first step that fails."
    yield "Behind each step stands what was seen."
    sections: list[tuple[str, Sequence[str]]] = [("Before anything is connected", BEFORE)]
    used = [("robots", "robot", plan.robot), ("scanners", "scanner", plan.scanner), ("positioners", "positioner", plan.positioner)]
    used += [("sensors", f"sensor {k}", sensor) for k, sensor in enumerate(plan.sensors, 1)]
    for kind, role, use in used:
        steps = getattr(load_driver(kind, use.driver), "first_contact", ())
        sections.append((f"The {role} alone (driver {use.driver})", steps or ("Its driver names no steps; look at its documentation.",)))
    sections += [("The first run", RUN if plan.robot.follow is None else FOLLOWED), ("Afterwards", AFTER)]
    number = 0
    for title, steps in sections:
        yield ""
        yield f"## {title}"
        yield ""
        for step in steps:
            number += 1
            yield f"- [ ] {number}. {step.replace('{plan}', loaded.path.name)}  "
            yield "      seen: "

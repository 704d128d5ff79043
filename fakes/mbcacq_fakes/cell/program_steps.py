"""What a written robot program does: its text read back as moves and exposures, KRL by running it. Shares no code with the writers."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from mbcacq.errors import ConfigError
from mbcacq_fakes.protocols.krc.krl import Interpreter, KrlError, Program, Struct

Step = tuple[str, Any]  # ('move', positions deg, mm) or ('expose', number of the pose): one exposure
_NUMBER = r"[-+]?\d+(?:\.\d+)?"
_LIST = rf"({_NUMBER}(?:\s*,\s*{_NUMBER})*)"
_FORMS = {  # move, exposures (pose, how many), whether angles are in rad
    ".mod": (rf"MoveAbsJ \[\[{_LIST}\]", r"^ *mb_expose (\d+), (\d+);", False),
    ".kl": (rf"^ *go\({_LIST}\)", r"^ *expose\((\d+), (\d+)\)", False),
    ".script": (rf"movej\(\[{_LIST}\]", r"^ *mb_expose\((\d+), (\d+)\)", True),
    ".pg": (rf"MOVE #PPOINT\({_LIST}\)", r"CALL mb_expose\((\d+), (\d+)\)", False),
}
TICKS = 1_000_000
ARM = tuple(f"A{k}" for k in range(1, 7))


def steps_of(folder: Path, pulses_per_deg: Any = None, axes: tuple[str, ...] = ARM) -> list[Step]:
    """The steps of the program in a folder. pulses_per_deg: of the plan, for a job of pulses; axes: in the order of the positions.

    Raises ConfigError if there is none, or one that cannot be read.
    """
    for path in sorted(folder.glob("*")):
        suffix = path.suffix.lower()
        if suffix == ".src":
            return _krl(folder, axes)
        if suffix == ".jbi":
            return list(_inform(path, pulses_per_deg))
        if suffix in _FORMS:
            return list(_by_form(path))
    for path in sorted(folder.glob("*.csv")):
        if path.name != "poses.csv":
            return list(_table(path))
    raise ConfigError(f"{folder}: holds no robot program; write one: mbcacq plan program")


def _by_form(path: Path) -> Iterator[Step]:
    move, expose, radians = _FORMS[path.suffix.lower()]
    for line in path.read_text(encoding="ascii").splitlines():
        if found := re.search(move, line):
            angles = np.array([float(v) for v in found[1].split(",")])
            yield "move", np.degrees(angles) if radians else angles
        elif (found := re.search(expose, line)) and not line.lstrip().startswith(("PROC", "ROUTINE", "def", ".PROGRAM")):
            for _ in range(int(found[2])):
                yield "expose", int(found[1])


def _inform(path: Path, pulses_per_deg: Any) -> Iterator[Step]:
    text = path.read_text(encoding="ascii")
    place = {m[1]: np.array([float(v) for v in m[2].split(",")]) for m in re.finditer(rf"(?m)^(C\d+)={_LIST}", text)}
    pose = -1
    for line in text.split("NOP", 1)[1].splitlines():
        if found := re.match(r"MOVJ (C\d+) ", line):
            yield "move", place[found[1]] / np.array(pulses_per_deg, dtype=float)
        elif found := re.match(r"SET I000 (\d+)", line):
            pose = int(found[1])
        elif re.match(r"DOUT OT#\(\d+\) ON", line):
            yield "expose", pose


def _table(path: Path) -> Iterator[Step]:
    with path.open(encoding="ascii", newline="") as file:
        for row in csv.DictReader(file):
            if row["do"] == "move":
                yield "move", np.array([float(v) for name, v in row.items() if re.fullmatch(r"[qe]\d+_(deg|mm)", name)])
            elif row["do"] == "expose":
                for _ in range(int(row["clouds"])):
                    yield "expose", int(row["pose"])


class _Moves:
    """An arm that is at once where a KRL program sends it."""

    moving = False

    def __init__(self, steps: list[Step], system: Any, axes: tuple[str, ...]) -> None:
        self._steps, self._system, self._axes = steps, system, tuple(name.lower() for name in axes)

    def begin(self, target: Any) -> None:
        at = {name: float(getattr(target, name)) for name in self._axes}
        self._steps.append(("move", np.array(list(at.values()))))
        self._system.axis_act_meas = Struct(**at)

    def brake(self) -> None:
        return

    def abandon(self) -> None:
        return


class _Outputs(list):
    """$OUT: a rising edge is an exposure."""

    def __init__(self, raised: Any) -> None:
        super().__init__([False] * 4097)
        self._raised = raised

    def __setitem__(self, index: Any, value: Any) -> None:
        if value is True and not self[index]:
            self._raised()
        super().__setitem__(index, value)


def _krl(folder: Path, axes: tuple[str, ...]) -> list[Step]:
    """Runs the program; where it halts, it is started again."""
    steps: list[Step] = []

    system: Any = SimpleNamespace()
    sources = {p.name: p.read_text(encoding="ascii") for p in folder.iterdir() if p.suffix.lower() in (".src", ".dat")}
    system.vel_axis, system.acc_axis, system.vel_extax, system.acc_extax, system.advance = *([0] * 7 for _ in range(4)), 3
    system.axis_act_meas, system.stopmess = Struct(), False

    def built_in(*_: Any) -> Iterator[Any]:
        return
        yield

    try:
        program = Program({k: v.replace("#INITMOV", "0") for k, v in sources.items()}, system, {"bas": built_in, "ir_stopm": built_in})
        system.out = _Outputs(lambda: steps.append(("expose", program.globals.mb_pose)))
        name = next(Path(name).stem for name in sources if name.lower().endswith(".src"))
        running = Interpreter(program, name.lower(), _Moves(steps, system, axes))
        now = 0.0
        for _ in range(TICKS):
            running.tick(now)
            now += 0.1
            if running.halted:
                if not running._stack:
                    return steps
                running.halted = False
    except KrlError as error:
        raise ConfigError(f"{folder}: a controller would not run this program: {error}") from error
    raise ConfigError(f"{folder}: the program does not end")

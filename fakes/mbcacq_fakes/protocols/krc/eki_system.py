"""The $ variables of the fake controller, and the arm that its robot interpreter drives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from mbcacq_fakes.dynamics.ideal_arm import IdealArm, Kinematics
from mbcacq_fakes.protocols.krc.eki_settings import EkiSettings
from mbcacq_fakes.protocols.krc.encoders import Encoders
from mbcacq_fakes.protocols.krc.krl.values import Cells, KrlError, Struct
from mbcacq_fakes.protocols.krc.motion import Path, angles, frame, ptp, tool_in_base

TICK_S = 0.004
_MODES = ("", "#T1", "#T2", "#AUT", "#EX")
_POSE = ("x", "y", "z", "a", "b", "c")
REAL = 1e-5  # deg or mm: resolution of a REAL of 32 bits, by which a target at a limit may be beyond it
LED_PERCENT = 20.0  # of the axes' speeds, by hand


class _Timers(Cells):
    """$TIMER: counts ms while its $TIMER_STOP is FALSE."""

    def __init__(self, system: System) -> None:
        super().__init__(64, 0)
        self._system, self.running = system, set()

    def __getitem__(self, index: Any) -> int:
        value = super().__getitem__(index)
        return value + self._system.rob_timer if index in self.running else value

    def __setitem__(self, index: Any, value: Any) -> None:
        super().__setitem__(index, round(value) - (self._system.rob_timer if index in self.running else 0))

    def hold(self, index: int, stop: bool) -> None:
        value = self[index]
        (self.running.discard if stop else self.running.add)(index)
        self[index] = value


class _Holds(Cells):
    def __init__(self, timers: _Timers) -> None:
        super().__init__(64, True)
        self._timers = timers

    def __setitem__(self, index: Any, value: Any) -> None:
        super().__setitem__(index, value)
        self._timers.hold(index, value)


class Outputs(Cells):
    """$OUT. changed: gets number and value of one that changes."""

    def __init__(self) -> None:
        super().__init__(4096, False)
        self.changed: Callable[[int, bool], None] | None = None
        self.stuck = False

    def __setitem__(self, index: Any, value: Any) -> None:
        if self.stuck or self[index] == value:
            return
        super().__setitem__(index, value)
        if self.changed is not None:
            self.changed(index, value)


class System:
    """Attributes are system variables in lower case, without the $: what KRL asks for and is not here does not exist."""

    num_ax = 6

    def __init__(self, settings: EkiSettings) -> None:
        self.rob_timer = settings.clock_ms
        self.flag, self.out = Cells(1024, False), Outputs()
        self.timer = _Timers(self)
        self.timer_stop = _Holds(self.timer)
        self.robtrafo, self.v_r1mada = settings.model, settings.machine_data
        self.ov_pro, self.mode_op = settings.override, settings.mode
        self.peri_rdy = self.alarm_stop = self.user_saf = True
        self.stopmess = self.pro_act = False
        self.vel_axis, self.acc_axis = Cells(6, 100), Cells(6, 100)
        self.vel_extax, self.acc_extax, self.ex_ax_num = Cells(6, 100), Cells(6, 100), len(settings.external)
        self.advance, self.act_tool, self.act_base = 3, -1, -1
        self.robroot = _struct(settings.robroot)
        self.tool = self.base = _struct((0.0,) * 6)
        self.load = Struct(m=-1.0, cm=_struct((0.0,) * 6))
        self.machine = Machine(self, settings)
        self._encoders = Encoders(settings.encoder_noise_deg, settings.encoder_step_deg, seed=0, axes=len(settings.axes))

    @property
    def axis_act_meas(self) -> Struct:
        shown = self._encoders.read(self.machine.arm.q, self.rob_timer // round(TICK_S * 1e3))
        return Struct(**dict(zip(self.machine.axes, shown, strict=True)))

    @property
    def pos_act(self) -> Struct:
        flange = frame(self.machine.kinematics.pose(self.machine.arm.q[:6]))
        return _struct(angles(tool_in_base(flange, frame(_row(self.tool)), frame(_row(self.base)), frame(_row(self.robroot)))))

    @property
    def curr_act(self) -> Cells:
        cells = Cells(6)
        for k, value in enumerate(self.machine.arm.currents()):
            cells[k + 1] = value
        return cells

    @property
    def rob_stopped(self) -> bool:
        return self.machine.arm.standstill and not self.machine.driving

    def set_mode(self, number: int) -> None:
        self.mode_op = _MODES[number]


class Machine:
    """The arm with one path at a time. Implements krl.interpreter.Motion."""

    def __init__(self, system: System, settings: EkiSettings) -> None:
        self._system, self._settings = system, settings
        start = (*settings.start_deg, *(float(axis["start"]) for axis in settings.behind))
        self.axes, self.arm = settings.axes, IdealArm(start, TICK_S, settings.lag_s)
        self._limits = (*settings.limits_deg, *(axis["limits"] for axis in settings.behind))
        self._speed = (*settings.speed_deg_s, *(axis["speed"] for axis in settings.behind))
        self.kinematics = Kinematics(settings.dh)
        self._set_point: tuple[float, ...] = start
        self._path: Path | None = None
        self.ignore, self.short_deg = False, 0.0
        self.message = ""
        self._stuck = self.led = False

    @property
    def driving(self) -> bool:
        return self._path is not None

    @property
    def moving(self) -> bool:
        """A motion instruction is not finished."""
        return self._path is not None or self._stuck

    def begin(self, target: Any) -> None:
        if self._system.advance != 0 and not self._here(target):
            raise KrlError("this controller drives only with $ADVANCE=0")
        self._stuck = self.ignore
        if self.ignore:
            return
        goal = [getattr(target, a, now) for a, now in zip(self.axes, self._set_point, strict=True)]  # what is not given stays
        if any(not low - REAL <= v <= high + REAL for v, (low, high) in zip(goal, self._limits, strict=True)):
            self.fail("software limit switch")
            return
        goal[0] -= self.short_deg
        system, behind = self._system, [int(a[1:]) for a in self.axes[6:]]
        percent = (
            [system.vel_axis[k] for k in range(1, 7)] + [system.vel_extax[k] for k in behind],
            [system.acc_axis[k] for k in range(1, 7)] + [system.acc_extax[k] for k in behind],
        )
        self._path = ptp(self._set_point, goal, self._speed, percent)

    def lead(self, target_deg: Sequence[float]) -> None:
        """A person jogs the arm to ``target_deg`` (n,) in the plan's order, while no program moves it."""
        self.led, by_hand = True, (LED_PERCENT,) * len(self.axes)
        self._path = ptp(self._set_point, self._settings.as_counted(target_deg), self._speed, (by_hand, by_hand))

    def brake(self) -> None:
        self._stuck = self.led = False
        if self._path is not None:
            self._path.brake()

    def abandon(self) -> None:
        self._path, self._stuck = None, False

    def fail(self, message: str) -> None:
        """A message that stops the program."""
        self.message, self._system.pro_act, self._system.stopmess = message, False, True
        self.brake()

    def tick(self) -> bool:
        """One cycle of 4 ms. True if the arm moved."""
        if self._path is not None:
            self._set_point = self._path.step(TICK_S, self._system.ov_pro / 100.0)
            if self._path.done:
                self._path = None
        return self.arm.step(self._set_point)

    def radians(self) -> tuple[list[float], list[float]]:
        """Joints and their speeds, rad and rad/s."""
        return self._settings.as_the_plan(self.arm.q), self._settings.as_the_plan(self.arm.qd)

    def directions(self) -> list[float]:
        """Direction of each axis' last motion, in the plan's order."""
        own = dict(zip(self.axes, self.arm.direction, strict=True))
        return [*(own[axis["name"].lower()] for axis in self._settings.external), *self.arm.direction[:6]]

    def _here(self, target: Any) -> bool:
        return all(abs(getattr(target, a, 1e9) - v) < 1e-6 for a, v in zip(self.axes, self.arm.q, strict=True))


def _struct(values: Sequence[float]) -> Struct:
    return Struct(**dict(zip(_POSE, map(float, values), strict=True)))


def _row(value: Struct) -> list[float]:
    return [getattr(value, a) for a in _POSE]


def built_in(system: System, settings: EkiSettings) -> dict[str, Any]:
    """BAS and the message interrupt of the base program."""

    def bas(_: Any, command: str, number: Any) -> Any:
        if command == "#INITMOV":
            system.advance = 3
            for k in range(1, 7):
                system.vel_axis[k] = system.acc_axis[k] = system.vel_extax[k] = system.acc_extax[k] = 100
        elif command == "#TOOL":
            system.tool, system.act_tool = _struct(settings.tools.get(str(number), (0.0,) * 6)), number
            system.load = Struct(m=float(settings.loads.get(str(number), 0.0)), cm=_struct((0.0,) * 6))
        elif command == "#BASE":
            system.base, system.act_base = _struct(settings.bases.get(str(number), (0.0,) * 6)), number
        else:
            raise KrlError(f"BAS({command}) is not played here")
        return
        yield

    def ir_stopm(_: Any) -> Any:
        return
        yield

    return {"bas": bas, "ir_stopm": ir_stopm}

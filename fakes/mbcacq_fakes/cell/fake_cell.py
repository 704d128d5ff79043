"""The whole fake cell: controller, scanner, positioner and sensors at the wire, one world behind them."""

from __future__ import annotations

import pickle
import threading
from dataclasses import replace
from typing import Any, Literal, Self

import numpy as np

from mbcacq.devices import ChildEnded, ChildProcess, signals_deferred
from mbcacq.errors import ConfigError, ConnectError
from mbcacq_fakes.cell.build_world import check, make_world
from mbcacq_fakes.cell.controller import (
    CLOCK_START_MS,
    OWN,
    SIMULATED,
    Controller,
    StartedController,
    check_options,
    kind_of,
    normal,
    start_controller,
)
from mbcacq_fakes.cell.faults import CellFaults
from mbcacq_fakes.cell.ports import FOLDER, NEUTRAL, POSITIONERS, SCANNERS, scanner_address
from mbcacq_fakes.protocols.krc.arm_state import MOST_AXES, ArmState
from mbcacq_fakes.protocols.started import Started
from mbcacq_fakes.world import options as fake_options
from mbcacq_fakes.world.description import CellFacts, from_cell
from mbcacq_fakes.world.frame import ScannerFrame

LED_DEG = 0.3  # by so much a person misses the angle of an axis, at most
PACE_S = 4.0  # robot time from one pose to the next, roughly


class FakeCell(Started):
    """Context manager. loaded, poses: the plan and its expansion (mbcacq.plan.LoadedPlan, list of PlannedPose; read only by name).

    realtime: the controller's 4 ms by the clock; else lock-step, as fast as the client answers. ports: 'free' takes free ports on
    127.0.0.1, which ``overrides()`` gives to the drivers; 'plan' listens where the plan's drivers will look. Everything the
    world draws follows from ``seed``. first_poses: how many of the poses the plan of the run had at first, where it has grown since: the
    cell stays the one that it was made for. resumed_at_s: what the robot's clock showed at the last pose of a run that goes on: time and
    warmth of the cell go on from there; poses_before: how many poses were measured, whose draws are not drawn again. The plan's
    ``fake:`` section says which effects are injected (docs/fakes.md).
    """

    def __init__(
        self,
        loaded: Any,
        poses: list[Any],
        *,
        realtime: bool = False,
        seed: int = 0,
        ports: Literal["free", "plan"] = "free",
        first_poses: int | None = None,
        resumed_at_s: float | None = None,
        poses_before: int = 0,
    ) -> None:
        plan = loaded.plan
        self._scanner = normal(plan.scanner.driver) if normal(plan.scanner.driver) in (*SCANNERS, FOLDER) else NEUTRAL
        if self._scanner in (NEUTRAL, FOLDER) and ports == "plan":
            raise ConfigError(
                f"there is no fake of a scanner '{plan.scanner.driver}' at the wire, only a simulated one inside a dry run: "
                f"mbcacq run {loaded.path} --dry-run"
            )
        if loaded.cell.robot.n > MOST_AXES:
            raise ConfigError(f"the fake cell plays arms of up to {MOST_AXES} axes, this one has {loaded.cell.robot.n}")
        self._loaded, self._plan, self._realtime, self._ports = loaded, plan, realtime, ports
        self._options = fake_options.parse(fake_options.of_scanner(plan.scanner, plan.fake))
        self._elapsed_s = 0.0 if resumed_at_s is None else max(resumed_at_s - CLOCK_START_MS * 1e-3, 0.0)
        self._poses_before = poses_before
        self._seed = seed if self._options.seed is None else self._options.seed
        self._planned_q = np.array([p.q for p in poses], dtype=float).reshape(-1, loaded.cell.robot.n)
        pace_s = PACE_S * self._options.climate.time_scale
        self._facts: CellFacts = replace(
            from_cell(loaded.cell, plan.scanner.field_of_view), planned_q=self._planned_q[:first_poses], pace_s=pace_s
        )
        check(self._options, self._facts)
        check_options(plan.robot.driver, self._options.robot)
        make_world(self._facts, self._options, self._seed)  # says now, in one sentence, what it would not accept later
        self._planned_station = np.array([self._facts.station_ids.index(str(p.station)) for p in poses], dtype=int)
        self._state: ArmState | None = None
        self._krc: Controller | None = None
        self._process: ChildProcess | None = None
        self._hand = np.random.default_rng([self._seed, 39])
        self._lock = threading.Lock()
        self._overrides: dict[str, dict[str, Any]] = {}
        self.faults = CellFaults(self)

    def start(self) -> Self:
        """Returns when every server listens. Raises ConfigError, ConnectError (an address cannot be taken)."""
        if self._process is not None:
            return self
        home = tuple(map(float, self._plan.robot.home))
        try:
            with signals_deferred():
                self._state = ArmState.create(home)
            self._process = ChildProcess("-m", "mbcacq_fakes.cell.process", dump=pickle.dump, load=pickle.load)
            self._send(self._job())
            robot = self._start_controller()
            addresses = self._receive()
            self._state.forget()
        except BaseException:
            self.stop()
            raise
        self._overrides = {"robot": robot.options, **addresses}
        drivers = {} if robot.driver is None else {"robot": robot.driver}
        if self._scanner == NEUTRAL:
            drivers["scanner"] = SIMULATED
            self._overrides["scanner"] = {
                "expose": self._expose,
                "clock": robot.options.get("clock"),
                "scan_time_s": float(self._plan.scanner.scan_time_s),
            }
        if normal(self._plan.positioner.driver) not in POSITIONERS:
            drivers["positioner"] = "manual"
        if drivers:
            self._overrides["drivers"] = drivers
        if self._plan.robot.follow is not None:
            self._overrides["person"] = {"lead": self._lead}
        return self

    def _lead(self, target: np.ndarray) -> None:
        """A person brings the arm near ``target`` (n,) rad, as well as people do."""
        assert self._krc is not None, "the fake cell is started"
        limits = self._loaded.cell.robot.limits
        share = min(1.0, 0.5 * self._plan.robot.follow.tolerance_deg / LED_DEG)
        missed = np.radians(share * self._hand.uniform(-LED_DEG, LED_DEG, len(target)))
        self._krc.lead(np.clip(np.asarray(target) + missed, limits[:, 0], limits[:, 1]))

    def _expose(self, exposure_us: float) -> ScannerFrame:
        return self.ask("expose", exposure_us=exposure_us)

    def stop(self) -> None:
        """Idempotent; no process and no shared memory stays behind."""
        process, self._process = self._process, None
        if process is not None:
            process.end(5.0)
        krc, self._krc = self._krc, None
        if krc is not None:
            krc.stop()
        state, self._state = self._state, None
        if state is not None:
            state.close()

    def overrides(self) -> dict[str, dict[str, Any]]:
        """Options by role ('robot', 'scanner', 'positioner', 'sensor 1'...) that lead the plan's drivers here; under 'drivers', those that
        take the place of the plan's."""
        return {role: dict(values) for role, values in self._overrides.items()}

    def truth(self) -> dict[str, Any]:
        """True errors (n, 5) rad and mm, T_flange_scanner, T_base_station by id, balls by id, effects; also before ``start``."""
        if self._process is None:
            return make_world(self._facts, self._options, self._seed).truth()
        return self.ask("truth")

    def alive(self) -> bool:
        """The world's process still runs."""
        return self._process is not None and self._process.exit_code is None

    @property
    def process_id(self) -> int:
        """Number of the world's process."""
        assert self._process is not None, "the fake cell is not started"
        return self._process.pid

    @property
    def arm(self) -> ArmState:
        """What the arm does right now."""
        assert self._state is not None, "the fake cell is not started"
        return self._state

    @property
    def krc(self) -> Any:
        """The fake controller."""
        assert self._krc is not None, "the fake cell is not started"
        return self._krc

    def ask(self, command: str, **arguments: Any) -> Any:
        """Ask the world's process; see cell_process.Servers."""
        with self._lock:
            self._send((command, arguments))
            return self._receive()

    def _job(self) -> dict[str, Any]:
        plan = self._plan
        assert self._state is not None
        return {
            "facts": self._facts,
            "options": self._options.model_dump(),
            "seed": self._seed,
            "state": self._state.name,
            "planned_q": self._planned_q,
            "planned_station": self._planned_station,
            # The clock of a fake that a driver's package brings begins where it always does; the world's goes on all the same.
            "clock_start_s": CLOCK_START_MS * 1e-3 - (self._elapsed_s if kind_of(plan.robot.driver) == OWN else 0.0),
            "poses_before": self._poses_before,
            "exposure_us": plan.scanner.exposure_us,
            "model": plan.scanner.model,
            "ports": self._ports,
            "realtime": self._realtime,
            "scanner_options": dict(plan.scanner.options),
            "scanner_driver": self._scanner,
            "outputs": kind_of(plan.robot.driver) != SIMULATED,  # the controller shows those that it switches
            "scanner": {} if self._scanner in (NEUTRAL, FOLDER) else scanner_address(self._scanner, plan.scanner.options, self._ports),
            "positioner": (plan.positioner.driver, dict(plan.positioner.options)),
            "sensors": [(s.driver, dict(s.options)) for s in plan.sensors],
        }

    def _start_controller(self) -> StartedController:
        assert self._state is not None, "the arm's state is made before its controller"
        started = start_controller(
            self._loaded,
            self._state,
            self._nominal_rows(),
            self._options.robot,
            realtime=self._realtime,
            ports=self._ports,
            seed=self._seed,
            clock_ms=CLOCK_START_MS + 4 * round(250 * self._elapsed_s),  # cycles of 4 ms
        )
        self._krc = started.controller
        return started

    def _nominal_rows(self) -> tuple[tuple[float, ...], ...]:
        """What the controller believes of its arm: sign, theta_deg, d_mm, a_mm, alpha_deg, beta_deg."""
        rows = self._facts.rows.copy()
        rows[:, [0, 3, 4]] = np.degrees(rows[:, [0, 3, 4]])
        return tuple(map(tuple, np.column_stack([self._facts.sign, rows]).tolist()))

    def _send(self, message: Any) -> None:
        try:
            self._running().send(message)
        except ChildEnded as error:
            raise ConnectError("the fake cell's process has ended; start the cell again") from error

    def _receive(self) -> Any:
        try:
            kind, value = self._running().receive()
        except ChildEnded as error:
            raise ConnectError("the fake cell's process has ended; its last messages are above") from error
        if kind == "error":
            raise value
        return value

    def _running(self) -> ChildProcess:
        if self._process is None:
            raise ConnectError("the fake cell's process has ended; start the cell again")
        return self._process

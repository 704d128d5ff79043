"""The process of the world: scanner, positioner and sensors, fed by one camera. Started by cell.FakeCell, ends with it.

Messages are pickled on standard input and output: first the job, answered by the addresses; then (command, arguments), answered
by ('ok', value) or ('error', exception). The end of the input, also by the parent's death, is the sign to end.
"""

from __future__ import annotations

import pickle
import signal
import sys
import tempfile
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from mbcacq.devices import parse_options
from mbcacq.errors import ConfigError, ConnectError
from mbcacq.spheres.cloud_files import read_points
from mbcacq_fakes.cell.build_world import check, make_camera, make_world
from mbcacq_fakes.cell.ports import FOLDER, NEUTRAL, line_address
from mbcacq_fakes.protocols.bus.line_for import fill, names, template
from mbcacq_fakes.protocols.bus.serial_line import SerialLine
from mbcacq_fakes.protocols.folder import FakeScannerProgram
from mbcacq_fakes.protocols.gocator import FakeGocator, FakeGocatorOptions
from mbcacq_fakes.protocols.gopxl import FakeGoPxL, FakeGoPxLOptions
from mbcacq_fakes.protocols.krc.arm_state import ArmState
from mbcacq_fakes.protocols.stall import HANGING_S
from mbcacq_fakes.world.camera import Camera
from mbcacq_fakes.world.description import ScannerView
from mbcacq_fakes.world.frame import ScannerFrame
from mbcacq_fakes.world.operator import NOBODY
from mbcacq_fakes.world.options import FakeOptions, Mishap
from mbcacq_fakes.world.scanner import Optics


class Servers:
    """The world's servers, and the commands a parent may send: the methods without underscore."""

    def __init__(self, job: dict[str, Any], stack: ExitStack) -> None:
        self._job, self._stack, self._positioner, self._bus = job, stack, None, None
        self._sensors: dict[int, Any] = {}
        options = FakeOptions.model_validate(job["options"])
        state = self._state = ArmState.attach(job["state"])
        stack.callback(state.close)
        world = make_world(job["facts"], options, job["seed"])
        self._camera: Camera = make_camera(
            world=world,
            arm=state,
            options=options,
            planned_q=job["planned_q"],
            planned_station=job["planned_station"],
            right_exposure_us=job["exposure_us"],
            clock_start_s=job["clock_start_s"],
            optics=Optics.above(world.facts.view) if job["scanner_driver"] in (NEUTRAL, FOLDER) else None,
            poses_before=job["poses_before"],
        )
        self._sensor: Any = None
        self.addresses: dict[str, dict[str, Any]] = {"scanner": self._start_scanner(options)}
        self.addresses["positioner"] = self._start_positioner()
        for k, (driver, given) in enumerate(job["sensors"]):
            self.addresses[f"sensor {k + 1}"] = self._start_sensor(k, driver, given)

    def truth(self) -> dict[str, Any]:
        return self._camera.world.truth()

    def temperatures(self) -> dict[str, float]:
        return self._camera.temperatures()

    def mishap(self, **details: Any) -> None:
        mishap = Mishap(**details)
        check(FakeOptions(mishaps=(mishap,)), self._camera.world.facts)
        self._camera.mishap(mishap)

    def expose(self, exposure_us: float) -> ScannerFrame:
        return self._camera(exposure_us)

    def scanner_fault(self, fault: str, value: Any, times: int | None) -> None:
        self._wire_sensor().faults.set(fault, value, times)

    def clear_scanner_fault(self, fault: str | None) -> None:
        self._wire_sensor().faults.clear(fault)

    def _wire_sensor(self) -> Any:
        if self._sensor is None:
            raise ConfigError("the plan's scanner is not one the fake cell plays at the wire")
        return self._sensor

    def positioner_fault(self, **values: Any) -> None:
        if self._positioner is None:
            raise ConfigError("the plan's positioner is not one the fake cell plays at the wire")
        for name, value in values.items():
            setattr(self._bus if name == "silent" else self._positioner, name, value)

    def sensor_fault(self, number: int, **values: Any) -> None:
        for name, value in values.items():
            setattr(self._sensors[number], name, value)

    def _start_scanner(self, options: FakeOptions) -> dict[str, Any]:
        if self._job["scanner_driver"] in (NEUTRAL, FOLDER):
            if options.scanner:
                raise ConfigError(
                    f"fake.scanner: the simulated scanner has no option {', '.join(sorted(options.scanner))}; remove the section"
                )
            return self._start_program() if self._job["scanner_driver"] == FOLDER else {}
        place, given = self._job["scanner"], self._job["scanner_options"]
        default = "3504" if self._job["scanner_driver"] == "gopxl" else "3210"
        settings = {
            "model": self._job["model"] or default,
            "jobs": tuple(filter(None, (given.get("job", ""),))) + ("bench.job", "other.job"),
            "scan_time_s": 0.15 if self._job["realtime"] else 0.0,
            "volume": _volume(self._job["facts"].view),
            "profiles": given.get("mode") == "profile",
            **place,
            **options.scanner,
        }
        self._sensor = self._make_sensor(settings, options.scanner)
        try:
            self._sensor.start()
        except OSError as error:
            raise ConnectError(f"the fake sensor cannot listen on {place['host']}: {error}; is another one running?") from error
        self._stack.callback(self._sensor.stop)
        timed = self._job["realtime"] or self._job["ports"] == "plan"  # in lock-step a busy computer is slow, and no sensor is silent
        slow = () if timed else (("reply_limit_s", "grace_s"), ("timeout_s", "timeout_s"))
        waits = {option: HANGING_S for said, option in slow if said not in given}
        return {"address": place["host"], **{f"{name}_port": port for name, port in self._sensor.ports._asdict().items()}, **waits}

    def _start_program(self) -> dict[str, Any]:
        """The scanner's own program, with a folder of its own."""
        folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="mbcacq-clouds-")))
        given = self._job["scanner_options"].get("trigger") or {}
        output, state = given.get("output") if self._job["outputs"] else None, self._state
        rises = None if output is None else lambda: state.output(output)[1]
        self._sensor = self._stack.enter_context(FakeScannerProgram(self._camera, folder, rises))
        network = {"tcp": f"127.0.0.1:{self._sensor.port}", "send": "trigger\n", "reply": "OK"}
        trigger = network if output is None else {"output": output, "pulse_s": 0.02}
        plain = {"pattern": "*.ply", "unit": None, "axes": "x y z", "range_map": None}
        return {"folder": str(folder), "trigger": trigger, "quiet_s": 0.02, **plain, "read_cloud": read_points}

    def _make_sensor(self, settings: dict[str, Any], given: Mapping[str, Any]) -> Any:
        """The fake of the plan's scanner driver. given: what the plan says of it. Raises ConfigError."""
        line = None
        if settings["profiles"]:
            from mbcacq_fakes.world.line_camera import LineCamera

            line = LineCamera(self._camera, self._state)
        if self._job["scanner_driver"] == "gopxl":
            _refuse_unknown(given, FakeGoPxLOptions)
            return FakeGoPxL(self._camera, FakeGoPxLOptions(**settings), lambda: 0.0, line)
        _refuse_unknown(given, FakeGocatorOptions)
        return FakeGocator(self._camera, FakeGocatorOptions(**settings), line)

    def _start_positioner(self) -> dict[str, Any]:
        driver, given = self._job["positioner"]
        if driver == "manual":
            return {"assume_yes": True} if self._job["ports"] == "free" else {}
        if driver == "modbus":
            return self._start_modbus_positioner(given)
        if driver == "serial":
            return self._start_serial_positioner(given)
        if self._job["ports"] == "plan":
            raise ConfigError(f"the fake cell plays no positioner '{driver}' at the wire; use manual, modbus or serial")
        return {"assume_yes": True}  # a person who follows the plan, in its place

    def _start_modbus_positioner(self, given: dict[str, Any]) -> dict[str, Any]:
        from mbcacq_bus.modbus import PositionerOptions

        from mbcacq_fakes.protocols.bus.modbus import FakeModbus, FakePositioner

        options = parse_options(PositionerOptions, "the Modbus positioner", given)
        stations = {str(k): v for k, v in options.stations.items()}
        self._positioner = FakePositioner(
            stations, options.position, options.in_position, options.actual, options.fault, travel_s=self._travel_s()
        )
        self._stand_on(self._positioner)
        bus = FakeModbus(self._positioner)
        if options.ready is not None:
            bus.values.append((options.ready, lambda: 1.0))
        return self._serve(bus, options)

    def _start_serial_positioner(self, given: dict[str, Any]) -> dict[str, Any]:
        from mbcacq_bus.serial_positioner import SerialPositionerOptions

        from mbcacq_fakes.protocols.bus.serial_positioner import FakeSerialPositioner

        options = parse_options(SerialPositionerOptions, "the serial positioner", given)
        try:
            line = FakeSerialPositioner(options, travel_s=self._travel_s(), **self._line_address(options.port))
        except ValueError as error:
            raise ConfigError(f"the fake serial positioner cannot play these patterns: {error}; simplify them for the dry run") from error
        self._positioner, self._bus = line.motion, line
        self._stand_on(line.motion)
        self._stack.enter_context(line)
        return {"port": line.url}

    def _travel_s(self) -> float:
        return 1.0 if self._job["realtime"] else 0.02

    def _stand_on(self, positioner: Any) -> None:
        ids = self._camera.world.facts.station_ids

        def stand() -> int:
            station = positioner.station
            return ids.index(station) if station in ids else NOBODY

        self._camera.follow(stand)

    def _line_address(self, port: str) -> dict[str, Any]:
        """Where a serial fake stands: on a pseudo-terminal (a port of this computer where there are none), or at the plan's own place."""
        if self._job["ports"] == "plan":
            return line_address(port)
        return {"pty": sys.platform != "win32"}

    def _start_sensor(self, number: int, driver: str, given: dict[str, Any]) -> dict[str, Any]:
        if driver == "modbus":
            from mbcacq_bus.modbus import SensorOptions

            from mbcacq_fakes.protocols.bus.modbus import FakeModbus

            options = parse_options(SensorOptions, "the Modbus sensor", given)
            bus = self._sensors[number] = FakeModbus(values=[(r, self._value(name)) for name, r in options.values.items()])
            return self._serve(bus, options)
        if driver == "serial":
            return self._start_serial(number, given)
        return {}  # one the cell does not play is read where the plan says: reading moves nothing

    def _start_serial(self, number: int, given: dict[str, Any]) -> dict[str, Any]:
        from mbcacq_bus.serial import SerialOptions

        options = parse_options(SerialOptions, "the serial sensor", given)
        answers = {}
        try:
            line = template(options.line)
            if options.identity is not None:
                answers[options.identity.ask.strip()] = template(options.identity.expect)
        except ValueError as error:
            raise ConfigError(f"the fake serial sensor cannot play this pattern: {error}; simplify it for the dry run") from error

        def say() -> str:
            now = self._camera.temperatures()
            return fill(
                line, {name: (now.get(name, 20.0) - options.offset.get(name, 0.0)) / options.scale.get(name, 1.0) for name in names(line)}
            )

        asked = options.ask.strip() if options.ask else None
        sensor = SerialLine(
            lambda heard: say() if heard == asked else answers.get(heard), None if asked else say, **self._line_address(options.port)
        )
        self._sensors[number] = sensor
        self._stack.enter_context(sensor)
        return {"port": sensor.url}

    def _serve(self, bus: Any, options: Any) -> dict[str, Any]:
        """Start a Modbus server at the plan's port or a free one; RTU as behind a serial server."""
        bus.rtu = options.serial is not None and self._job["ports"] == "free"
        if self._job["ports"] == "plan":
            if options.host not in ("127.0.0.1", "localhost"):
                raise ConfigError(f"the fake Modbus device cannot listen at the plan's address {options.address}; use 127.0.0.1 to try it")
            bus.port = options.port
        if options.identity is not None:
            equals = options.identity.equals
            bus.values.append((options.identity.where, lambda: equals))
        try:
            bus.start()
        except OSError as error:
            raise ConnectError(str(error)) from error
        self._stack.callback(bus.stop)
        if bus.positioner is not None:
            self._bus = bus
        if bus.rtu:
            return {"host": None, "serial": f"socket://{bus.host}:{bus.port}"}  # as behind a serial server
        return {"host": bus.host, "port": bus.port, "serial": None}

    def _value(self, name: str) -> Any:
        return lambda: self._camera.temperatures().get(name, 20.0)


def _refuse_unknown(given: Mapping[str, Any], options: Any) -> None:
    """Raises ConfigError for an option of ``fake.scanner`` that the fake does not have."""
    known = [f.name for f in fields(options)]
    if unknown := sorted(set(given) - set(known)):
        raise ConfigError(f"fake.scanner: unknown option {', '.join(unknown)}; known are {', '.join(known)}; correct the plan")


def _volume(view: ScannerView) -> Any:
    half = np.maximum(view.near_half, view.far_half)
    return np.array([-half[0], -half[1], view.far_z]), np.array([half[0], half[1], view.near_z])


def main() -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    source, sink = sys.stdin.buffer, sys.stdout.buffer
    sys.stdout = sys.stderr

    def reply(kind: str, value: Any) -> None:
        pickle.dump((kind, value), sink)
        sink.flush()

    with ExitStack() as stack:
        try:
            servers = Servers(pickle.load(source), stack)
        except EOFError:
            return 0  # whoever started this was interrupted
        except Exception as error:
            reply("error", error)
            return 1
        reply("ok", servers.addresses)
        while True:
            try:
                command, arguments = pickle.load(source)
            except EOFError:
                return 0
            try:
                reply("ok", getattr(servers, command)(**arguments))
            except BrokenPipeError:
                return 0
            except Exception as error:
                reply("error", error)


if __name__ == "__main__":
    sys.exit(main())

"""The fake cell's controller: an RSI or an EKI controller, the fake that the package of the plan's driver registers, or a robot that is
only simulated, for any other driver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np

from mbcacq.acquisition.cell_devices import robot_options
from mbcacq.devices import available, load_driver
from mbcacq.errors import ConfigError
from mbcacq.workflow import controller_files
from mbcacq_fakes.cell.ports import LOOPBACK, free_port, ipv4, refuse_foreign
from mbcacq_fakes.cell.simulated_clock import SimulatedClock
from mbcacq_fakes.cell.simulated_robot import LedTarget
from mbcacq_fakes.protocols.krc.arm_state import ArmState
from mbcacq_fakes.protocols.krc.eki_settings import EkiSettings
from mbcacq_fakes.protocols.krc.server import FakeEkiController, FakeKrc
from mbcacq_fakes.protocols.krc.settings import KrcSettings
from mbcacq_fakes.protocols.stall import HANGING_S

CLOCK_START_MS = 1_000_000
FASTEST_START_S = 0.05  # to full speed: no arm whose accelerations are not stated is faster
RSI, EKI, OWN, SIMULATED = "kuka_rsi", "kuka_eki", "own", "simulated"
MODES = {"T1": "#T1", "T2": "#T2", "AUT": "#AUT", "EXT": "#EX"}


class Controller(Protocol):
    """What plays the robot's controller."""

    def lead(self, target: np.ndarray) -> None:
        """A person, or the arm's own program, brings the arm to ``target`` (n,) rad."""
        ...

    def stop(self) -> None: ...


@dataclass(frozen=True)
class StartedController:
    """options: lead the plan's driver to it. driver: one to take in the plan's place, or None."""

    controller: Controller
    options: dict[str, Any]
    driver: str | None = None


def normal(driver: str) -> str:
    """kuka-eki is kuka_eki."""
    return driver.replace("-", "_")


def start_controller(
    loaded: Any,
    state: ArmState,
    rows: tuple[tuple[float, ...], ...],
    given: Mapping[str, Any],
    *,
    realtime: bool,
    ports: str,
    seed: int,
    clock_ms: int = CLOCK_START_MS,
) -> StartedController:
    """A running controller. rows: its nominal kinematics; given: the plan's ``fake.robot``; clock_ms: what its clock shows at first, but
    for one that a driver's package brings. Raises ConfigError, ConnectError.
    """
    robot, use = loaded.cell.robot, loaded.plan.robot
    check_options(use.driver, given)
    kind = kind_of(use.driver)
    first = robot.external if kind == EKI else 0
    settings: dict[str, Any] = {
        "realtime": realtime,
        "start_deg": tuple(map(float, use.home_deg)),
        "dh": rows[first:],
        "limits_deg": tuple(map(tuple, np.degrees(robot.limits[first:]).tolist())),
    }
    if robot.speed is not None:
        settings["speed_deg_s"] = tuple(np.degrees(robot.speed[first:]).tolist())
    if kind == OWN:
        controller, options = load_driver("fakes", use.driver)(state, **settings, ports=ports, plan_options=dict(use.options), **given)
        return StartedController(controller, options)
    if kind == SIMULATED:
        if ports == "plan":
            raise ConfigError(
                f"there is no fake controller for the driver '{use.driver}', only a simulated arm inside a dry run: "
                f"mbcacq run {loaded.path} --dry-run"
            )
        led = LedTarget()
        given_by_us = {"state": state, "clock_start_s": clock_ms * 1e-3, "clock": SimulatedClock(), "led": led}
        return StartedController(led, given_by_us, SIMULATED)
    if "moving" in given:
        from mbcacq_fakes.dynamics.online import description

        given = {"layout": "motion", **given, "moving": description(robot, given["moving"], seed)}
    if first:
        at_home = robot.shown(use.home)
        settings["external"] = tuple({**axis, "start": float(at_home[i])} for i, axis in enumerate(robot_options(loaded)["external_axes"]))
    if kind == EKI and use.follow is not None:
        settings["running"] = False  # a person jogs it, beside the link program
    given = {("clock_ms" if kind == EKI else "ipoc"): clock_ms, **given}
    if not realtime and ports == "free" and kind == RSI:
        given = {"answer_wait_s": (HANGING_S, KrcSettings.answer_wait_s[1]), **given}
    krc, address = (_eki if kind == EKI else _rsi)(loaded, state, settings, given, ports, seed)
    if not realtime and ports == "free" and "silence_s" not in use.options:
        address["silence_s"] = HANGING_S  # in lock-step a busy computer is slow, and no controller is silent
    return StartedController(krc, address)


def kind_of(driver: str) -> str:
    """RSI, EKI, OWN where the driver's package registers a fake of its name, or SIMULATED."""
    if normal(driver) in (RSI, EKI):
        return normal(driver)
    return OWN if normal(driver) in map(normal, available("fakes")) else SIMULATED


def check_options(driver: str, given: Mapping[str, Any]) -> None:
    """Raises ConfigError where ``fake.robot`` names something that the controller of this driver does not have."""
    kind = kind_of(driver)
    if kind == OWN:
        return  # the fake says itself what it takes
    if kind == SIMULATED:
        if given:
            raise ConfigError(f"fake.robot: the simulated arm has no option {', '.join(sorted(given))}; remove the section")
        return
    known = [f.name for f in fields(EkiSettings if kind == EKI else KrcSettings)]
    if "moving" in given and "moving" not in known:
        raise ConfigError(
            "fake.robot.moving is of an arm driven by kuka_rsi, whose telegrams carry torques: those of kuka_eki do not; correct the plan"
        )
    if unknown := sorted(set(given) - set(known)):
        raise ConfigError(f"fake.robot: unknown option {', '.join(unknown)}; known are {', '.join(known)}; correct the plan")
    if not isinstance(given.get("moving", []), list | tuple):
        raise ConfigError("fake.robot.moving must be a list of faults (name, where, sizes), [] for none; correct the plan")


def _rsi(loaded: Any, state: ArmState, settings: dict[str, Any], given: Mapping[str, Any], ports: str, seed: int) -> Any:
    options = dict(loaded.plan.robot.options)
    if ports == "plan":
        client = (ipv4(str(options.get("bind", LOOPBACK))), int(options.get("port", 49152)))
    else:
        client = (LOOPBACK, free_port())
    same = {k: options[k] for k in ("sen_type", "correction", "stop_element", "cycle_ms", "digital_outputs") if k in options}
    same["load_kg"] = float(loaded.cell.robot.payload_mass)
    speed, acceleration = loaded.cell.robot.speed, loaded.cell.robot.acceleration
    if speed is not None:
        settings["acceleration_deg_s2"] = tuple(np.degrees(speed / FASTEST_START_S if acceleration is None else acceleration).tolist())
    try:
        krc = FakeKrc(state, **{**settings, "client": client, "seed": seed, **same, **given})
    except (TypeError, ValueError) as error:
        raise ConfigError(f"fake.robot: {error}; correct the plan") from error
    krc.start()
    return krc, {"bind": client[0], "port": client[1], "controller_ip": ""}


def _eki(loaded: Any, state: ArmState, settings: dict[str, Any], given: Mapping[str, Any], ports: str, seed: int) -> Any:
    """Runs the very programs that would be copied onto the real controller, in the cell that the plan expects."""
    files, facts, options = controller_files.make(loaded), controller_files.facts(loaded), dict(loaded.plan.robot.options)
    host, port = (LOOPBACK, 0) if ports == "free" else (str(options.get("address", LOOPBACK)), int(options.get("port", 54610)))
    tool, base = str(options.get("tool", 1)), str(options.get("base", 0))
    mode = options.get("mode", "any")
    mode = mode[0] if isinstance(mode, list | tuple) and mode else mode
    name = loaded.cell.robot.name.upper().replace("KUKA", "").replace(" ", "").replace("-", "_")
    ours = {
        "sources": {n.rsplit("/", 1)[1]: text for n, text in files.items() if n.startswith("kss/Program/")},
        "channel": files["kss/EthernetKRL/mbcacq_eki.xml"],
        "host": host,
        "port": port,
        "model": f"#{name} C4 FLR",
        "tools": {tool: tuple(options.get("tool_frame") or facts["tool_frame"])},
        "mode": MODES.get(str(mode), "#EX"),
        "bases": {base: tuple(options.get("base_frame") or (0.0,) * 6)},
        "override": options.get("override") or 100,
        "loads": {tool: float(options.get("load_kg") or facts["load_kg"])},
    }
    refuse_foreign("controller", "robot", host, port)
    try:
        krc = FakeEkiController(state, **{**settings, **ours, **given})
    except (TypeError, ValueError) as error:
        raise ConfigError(f"fake.robot: {error}; correct the plan") from error
    try:
        krc.start()
    except RuntimeError as error:
        raise ConfigError(f"{error}") from error
    return krc, {"address": host, "port": krc.port}

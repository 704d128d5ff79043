"""The devices of a plan: created, connected all at once, closed all together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from mbcacq.devices import ConfigError, ConnectError, Device, Positioner, Robot, Scanner, Sensor, SystemRefused, create, load_driver
from mbcacq.model.cell import RobotModel
from mbcacq.plan import LoadedPlan
from mbcacq.plan.controller_joints import matrix
from mbcacq.plan.motion_limits import axis_limits
from mbcacq.plan.schema import DeviceUse
from mbcacq.quantities import in_degrees
from mbcacq.spheres.cloud_files import CloudFormat, read_points

Overrides = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class CellDevices:
    """The devices of one cell, in the order of their plan. lead: brings a fake arm that is only followed near a target (n,) rad, in the
    place of a person."""

    robot: Robot
    scanner: Scanner
    positioner: Positioner
    sensors: tuple[Sensor, ...] = ()
    lead: Callable[[np.ndarray], None] | None = None

    @property
    def asks_a_person(self) -> bool:
        """Whether a person moves the artefact, who can be asked again."""
        return bool(getattr(self.positioner, "asks", False))

    @property
    def all(self) -> dict[str, Device]:
        """Every device by its role."""
        named: dict[str, Device] = {"robot": self.robot, "scanner": self.scanner, "positioner": self.positioner}
        return named | {f"sensor {i + 1}": s for i, s in enumerate(self.sensors)}

    def connect(self) -> None:
        """Connect every device at the same time. Raises ConnectError that names every device that failed, not only the first; a wrong
        setting (ConfigError) of one ends the wait for the others at once."""
        failures: dict[str, BaseException] = {}
        devices = self.all
        with ThreadPoolExecutor(len(devices)) as pool:
            try:
                futures = {pool.submit(device.connect): name for name, device in devices.items()}
                for future in as_completed(futures):
                    error = future.exception()
                    if isinstance(error, ConfigError | SystemRefused):
                        raise error
                    if error is not None:
                        failures[futures[future]] = error
            except BaseException:  # Ctrl-C as well: closing ends the wait of those that still connect
                self.close()
                raise
        if not failures:
            return
        self.close()
        if len(failures) == 1:
            raise next(iter(failures.values()))
        named = [(name, str(failures[name])) for name in devices if name in failures]
        raise ConnectError("; ".join(text if text.startswith(name) else f"{name}: {text}" for name, text in named))

    def close(self) -> None:
        """Stop and release everything, the robot first; every device is closed even if another one fails to."""
        with ExitStack() as stack:
            for device in reversed(self.all.values()):
                stack.callback(device.close)
            for device in self.all.values():
                device.stop()


def create_devices(loaded: LoadedPlan, overrides: Overrides | None = None) -> CellDevices:
    """Construct the drivers a plan names; nothing is opened. ``overrides`` (by 'robot', 'scanner', 'positioner') win over the plan's
    options, and those under 'drivers' (by the same roles) over its drivers, whose options are then those of ``overrides`` alone."""
    made = {role: make() for role, make in device_makers(loaded, overrides).items()}
    sensors = tuple(device for role, device in made.items() if role.startswith("sensor "))
    refuse_equal_names(sensors)
    hand_on_outputs(made["robot"], made["scanner"])
    return CellDevices(made["robot"], made["scanner"], made["positioner"], sensors, (overrides or {}).get("person", {}).get("lead"))


def hand_on_outputs(robot: Robot, scanner: Scanner) -> None:
    """Give a scanner that can be triggered by a digital output of the robot (``use_outputs``) what switches one (``set_output``), and the
    numbers of those that the plan allows (``digital_outputs``). Raises ConfigError if the scanner needs one that the robot has not."""
    if (use_outputs := getattr(scanner, "use_outputs", None)) is not None:
        use_outputs(getattr(robot, "set_output", None), tuple(getattr(robot, "digital_outputs", ())))


def device_makers(loaded: LoadedPlan, overrides: Overrides | None = None) -> dict[str, Callable[[], Any]]:
    """By role ('robot', 'scanner', 'positioner', 'sensor 1'..), what constructs the driver: it raises ConfigError where there is no such
    driver, or where that refuses its options. overrides: as of ``create_devices``."""
    overrides = overrides or {}
    plan, robot = loaded.plan, loaded.cell.robot
    replaced = overrides.get("drivers", {})
    arm_driver = str(replaced.get("robot", plan.robot.driver))

    def device(kind: str, role: str, driver: str, model: str, options: Callable[[], Mapping[str, Any]]) -> Callable[[], Any]:
        if role != "robot" and role in replaced:
            return lambda: create(kind, str(replaced[role]), model, dict(overrides.get(role, {})))
        return lambda: create(kind, driver, model, {**options(), **overrides.get(role, {})})

    def given(use: DeviceUse) -> Callable[[], Mapping[str, Any]]:
        return lambda: use.options

    seen = partial(scanner_options, loaded, replaced)
    makers = {
        "robot": device("robots", "robot", arm_driver, robot.name, lambda: robot_options(loaded, arm_driver)),
        "scanner": device("scanners", "scanner", plan.scanner.driver, plan.scanner.model, seen),
        "positioner": device("positioners", "positioner", plan.positioner.driver, plan.positioner.model, given(plan.positioner)),
    }
    for number, sensor in enumerate(plan.sensors, 1):
        makers[f"sensor {number}"] = device("sensors", f"sensor {number}", sensor.driver, sensor.model, given(sensor))
    return makers


def robot_options(loaded: LoadedPlan, driver: str | None = None) -> dict[str, Any]:
    """The options that the robot's driver (default: the plan's) gets: limits_deg (n, 2), speed_deg_s (n,) where known, and the plan's own,
    which win over them.

    The driver names further facts of the model that it needs in ``plan_facts``. 'kinematics' gives rows (sign, theta_deg, d_mm, a_mm,
    alpha_deg, beta_deg). 'dynamics' gives acceleration_deg_s2 and jerk_deg_s3 (6,), which follow from the speeds where the model does not
    state them. 'controller_joints' gives controller_matrix (n, n) and controller_offset_deg (n,) of ``controller_joints.matrix``, where the
    plan has them. 'external_axes' gives these (name, slides, carries_arm, limits, speed, in deg or mm), and all else of
    the arm alone. 'follow' gives follow: True where the plan says so; the driver then never moves the arm. Raises ConfigError if the
    plan asks the driver to follow and it cannot, or to move and it only follows (``only_follows``).
    """
    robot, use = loaded.cell.robot, loaded.plan.robot
    found = load_driver("robots", driver or use.driver)
    wanted = getattr(found, "plan_facts", ())
    first = robot.external if "external_axes" in wanted else 0
    facts: dict[str, Any] = {"limits_deg": in_degrees(robot.limits[first:]).tolist()}
    if robot.speed is not None:
        facts["speed_deg_s"] = in_degrees(robot.speed[first:]).tolist()
    if first:
        facts["external_axes"] = _external_axes(robot)
    if use.follow is None and getattr(found, "only_follows", False):
        raise ConfigError(
            f"driver '{use.driver}' reads the arm and moves nothing: a person, or its own program, moves it; add follow: {{}} to robot, or "
            "take a driver that moves it"
        )
    if use.follow is not None:
        if "follow" not in wanted:
            raise ConfigError(
                f"driver '{use.driver}' cannot follow an arm that others move; remove follow from robot, or take another driver"
            )
        facts["follow"] = True
    if "controller_joints" in wanted and use.controller_joints is not None:
        facts["controller_matrix"], facts["controller_offset_deg"] = (part.tolist() for part in matrix(loaded))
    if "dynamics" in wanted and robot.speed is not None:
        limits = axis_limits(loaded)
        facts["acceleration_deg_s2"] = in_degrees(limits.acceleration).tolist()
        facts["jerk_deg_s3"] = in_degrees(limits.jerk).tolist()
    if "kinematics" in wanted:
        rows = robot.chain.rows[first:].copy()
        rows[:, [0, 3, 4]] = in_degrees(rows[:, [0, 3, 4]])
        facts["kinematics"] = np.column_stack([robot.chain.sign[first:], rows]).tolist()
    return {**facts, **use.options}


def _external_axes(robot: RobotModel) -> list[dict[str, Any]]:
    assert robot.speed is not None, "an external axis of a plan has a speed"
    limits, speed = robot.shown(robot.limits.T).T, robot.shown(robot.speed)
    return [
        {
            "name": robot.axes[i],
            "slides": i in robot.chain.sliding,
            "carries_arm": i >= robot.chain.floor,
            "limits": limits[i].tolist(),
            "speed": float(speed[i]),
        }
        for i in range(robot.external)
    ]


def scanner_options(loaded: LoadedPlan, replaced: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The options that the scanner's driver gets: the plan's own and, where it names 'cloud_reader' in ``plan_facts``, read_cloud, which
    reads a file as points (N, 3) mm in the scanner frame."""
    use = loaded.plan.scanner
    if "scanner" in (replaced or {}) or "cloud_reader" not in getattr(load_driver("scanners", use.driver), "plan_facts", ()):
        return dict(use.options)
    given = use.options
    form = CloudFormat(given.get("unit"), str(given.get("axes", "x y z")), given.get("range_map"))
    form.matrix()  # says now, in one sentence, what it would not accept later
    return {**given, "read_cloud": partial(read_points, form=form)}


def refuse_equal_names(sensors: Sequence[Sensor]) -> None:
    """Raises ConfigError if two sensors deliver a value of one name."""
    owner: dict[str, int] = {}
    for number, sensor in enumerate(sensors, 1):
        for field in sensor.describe().fields:
            if other := owner.get(field.name):
                raise ConfigError(
                    f"sensor {number} and sensor {other} both deliver '{field.name}', one would overwrite the other; "
                    "give every value of a cell a name of its own"
                )
            owner[field.name] = number

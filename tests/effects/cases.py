"""Every effect at standstill, as physics says what happens in the cell, with the parameters that the tool has to report for it."""

from collections.abc import Callable
from dataclasses import dataclass, field

import independent_cell as plain
import numpy as np
from independent_cell import Errors, World, pose, rotation
from recorded import FIRST_POSE

Physics = Callable[[World], Errors]
MOMENT = 15  # rank in time of the first pose after a sudden change
TAU = 200.0  # s


@dataclass(frozen=True)
class Case:
    """parameters: as the tool has to report them. before: errors that are there without the effect (compliance, under a wrong payload)."""

    name: str
    where: tuple[str, ...]
    physics: Physics
    parameters: dict[str, float | list[float]]
    hyper: float | None = None
    variant: str = ""
    depends_on: str = ""
    before: Physics = field(default=lambda world: Errors())
    temperature_recorded: bool = True


def at_joint(i: int, amount: np.ndarray) -> np.ndarray:
    """(P, 6) from the amount (P,) at joint i."""
    return amount[:, None] * np.eye(6)[i]


def torque(world: World, payload: float = plain.PAYLOAD, com: np.ndarray = plain.PAYLOAD_COM) -> np.ndarray:
    return np.array([plain.gravity_torque(q, payload, com) for q in world.q])


def joint_compliance(world: World) -> Errors:
    return Errors(joint=at_joint(2, 2e-8 * torque(world)[:, 2]))


def base_compliance(world: World) -> Errors:
    return Errors(base=1e-9 * np.array([plain.overturning_moment(q) for q in world.q]))


def bracket(tilt: float, shift: float) -> Physics:
    """A bracket behind the flange that turns by ``tilt`` rad/(N m) about the flange's origin, and shifts by ``shift`` mm/N."""

    def physics(world: World) -> Errors:
        weight = [plain.tool_weight(q) for q in world.q]
        moment = [np.cross(plain.PAYLOAD_COM * 1e-3, w) for w in weight]
        return Errors(mount=np.array([pose(rotation(tilt * m), shift * w) for m, w in zip(moment, weight, strict=True)]))

    return physics


def gear_transmission_error(world: World) -> Errors:
    return Errors(joint=at_joint(3, np.radians(2e-4) * np.sin(7.3 * world.q[:, 3] + np.radians(40))))


def backlash(world: World) -> Errors:
    """The joint stays behind its motion, by half the width."""
    return Errors(joint=at_joint(4, -0.5 * np.radians(3e-4) * world.direction[:, 4]))


def backlash_under_load(world: World) -> Errors:
    """Gravity pushes the joint to one side of its backlash."""
    return Errors(joint=at_joint(3, 0.5 * np.radians(3e-4) * np.sign(torque(world)[:, 3])))


def lost_motion(world: World) -> Errors:
    """Slope 1/K1 up to 30 N m, nothing beyond: the arm of a joint between two stops of a soft spring."""
    load = torque(world)[:, 2]
    return Errors(joint=at_joint(2, np.where(np.abs(load) < 30.0, load / 30.0, np.sign(load)) * 0.5 * np.radians(3e-4)))


def hysteresis(world: World) -> Errors:
    """The joint stays behind its motion by 2e-9 rad for each N m that it carries."""
    return Errors(joint=at_joint(1, -2e-9 * np.abs(torque(world)[:, 1]) * world.direction[:, 1]))


BALANCER = {"preload": 2e-6, "stretched": 1e-6, "upright": np.radians(-106.3), "ratio": 0.25}  # rad of wind-up


def gravity_compensator(world: World) -> Errors:
    """A rod between (0, 1) and a point a quarter as far from the axis, which turns with the link: it pulls the link upright."""
    angle = world.q[:, 1] - BALANCER["upright"]
    end = BALANCER["ratio"] * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    rod = np.array([0.0, 1.0]) - end
    length = np.linalg.norm(rod, axis=1)
    lever = (end[:, 0] * rod[:, 1] - end[:, 1] * rod[:, 0]) / length / BALANCER["ratio"]
    longer = (length - (1 - BALANCER["ratio"])) / (2 * BALANCER["ratio"])
    return Errors(joint=at_joint(1, -lever * (BALANCER["preload"] + BALANCER["stretched"] * longer)))


def leaning(depth: float, side: float) -> Physics:
    """Too deep by the squared sine of the incidence, and aside along the lean."""

    def physics(world: World) -> Errors:
        up = np.array(
            [
                (plain.frames(q)[-1] @ plain.T_FLANGE_SCANNER)[:3, :3].T @ world.stations[s][:3, 2]
                for q, s in zip(world.q, world.station, strict=True)
            ]
        )
        sine2 = up[:, 0] ** 2 + up[:, 1] ** 2
        bias = sine2[:, None] * (side * up * [1, 1, 0] + depth * np.array([0, 0, 1.0]))
        return Errors(reading=lambda points, of: points + bias[of])

    return physics


def joint_scale(world: World) -> Errors:
    return Errors(joint=at_joint(1, 3e-7 * world.q[:, 1]))


def wrist_coupling(world: World) -> Errors:
    """Axis 4 turns axis 5."""
    return Errors(joint=at_joint(4, -4e-7 * world.q[:, 3]))


def joint_step(world: World) -> Errors:
    return Errors(joint=at_joint(5, np.radians(2e-4) * (world.order >= MOMENT)))


def thermal_growth(world: World) -> Errors:
    warmer = world.temperature - world.temperature[np.argmin(world.order)]
    return Errors(growth={3: 1e-4 * warmer})


def thermal_zero_shift(world: World) -> Errors:
    return Errors(joint=at_joint(2, 3e-7 * (world.temperature - world.temperature[np.argmin(world.order)])))


def thermal_growth_over_time(world: World) -> Errors:
    return Errors(growth={1: 4e-4 * (1 - np.exp(-world.time / TAU))})


def mount_shift(world: World) -> Errors:
    moved = pose(rotation(np.radians([1e-4, -2e-4, 3e-4])), np.array([1e-3, 2e-3, -3e-3]))
    return Errors(mount=np.array([moved if rank >= MOMENT else np.eye(4) for rank in world.order]))


def misread(bias: Callable[[np.ndarray], np.ndarray]) -> Physics:
    """A scanner that adds a bias (M, 3) to the true points."""
    return lambda world: Errors(reading=lambda points, of: points + bias(points))


def scanner_warmup(world: World) -> Errors:
    offset = np.array([0.01, -0.02, 0.03])
    return Errors(reading=lambda points, of: points + np.exp(-world.time / TAU)[of, None] * offset)


def ball_shift(world: World) -> Errors:
    return Errors(balls=np.eye(8)[2][:, None] * [0.001, -0.002, 0.003])


def artefact_expansion(world: World) -> Errors:
    return Errors(balls=50e-6 * plain.BALLS)


def station_drift(world: World) -> Errors:
    """The tripod of the second station creeps evenly from its first pose to its last."""
    time = world.time[world.station == 1]
    progress = np.where(world.station == 1, (world.time - time.min()) / (time.max() - time.min()), 0.0)
    return Errors(station=progress[:, None] * [0.002, -0.004, 0.006])


SOFT = {1: 1.5e-8, 2: 2.5e-8}  # rad/(N m) of the joints through which a wrong payload shows


def wound_up(payload: float, com: list[float] | np.ndarray) -> Physics:
    softness = np.array([SOFT.get(i, 0.0) for i in range(6)])
    return lambda world: Errors(joint=softness * torque(world, payload, np.array(com)))


def sagging(world: World) -> Errors:
    """A joint hangs in the slack of its brakes where the arm stood for two minutes before."""
    stood = np.diff(np.sort(world.time), prepend=-np.inf)[world.order] > 120.0
    return Errors(joint=at_joint(1, np.radians(4e-4) * stood))


def loose(world: World) -> Errors:
    """A scanner that slides by 2e-4 mm along the flange's x and tips by 1e-6 rad about its y as gravity along x changes its sign."""
    seats = [pose(rotation(side * np.array([0, 5e-7, 0])), side * np.array([1e-4, 0, 0])) for side in (-1.0, 1.0)]
    return Errors(mount=np.array([seats[int(plain.tool_weight(q)[0] > 0)] for q in world.q]))


def exposure_latency(world: World) -> Errors:
    """The arm is exposed after its angles were reported."""
    return Errors(joint=5e-7 * world.velocity)


def field_shape(name: str, value: float, depends_on: str, bias: Callable[[np.ndarray], np.ndarray]) -> Case:
    return Case("scanner_distortion", ("scanner",), misread(bias), {name: value}, variant=name, depends_on=depends_on)


def radial(points: np.ndarray) -> np.ndarray:
    """Squared distance from the optical axis, (M,) mm2."""
    return points[:, 0] ** 2 + points[:, 1] ** 2


ALONG = np.eye(3)

CASES = (
    Case("joint_compliance", ("A3",), joint_compliance, {"A3.compliance_rad_per_Nm": 2e-8}, depends_on="gravity_torque_3"),
    Case("base_compliance", ("base",), base_compliance, {"compliance_rad_per_Nm": 1e-9}, depends_on="gravity_torque_2"),
    Case("mount_compliance", ("mount",), bracket(3e-8, 0.0), {"compliance_rad_per_Nm": 3e-8}, variant="tilt"),
    Case("mount_compliance", ("mount",), bracket(0.0, 2e-6), {"compliance_mm_per_N": 2e-6}, variant="shift"),
    Case(
        "gear_transmission_error",
        ("A4",),
        gear_transmission_error,
        {"A4.order": 7.3, "A4.amplitude_deg": 2e-4, "A4.phase_deg": 40.0},
        hyper=7.3,
        depends_on="q4",
    ),
    Case("backlash", ("A5",), backlash, {"A5.width_deg": 3e-4}, depends_on="direction_5"),
    Case("backlash", ("A4",), backlash_under_load, {"A4.width_deg": 3e-4}, hyper=0.0, depends_on="gravity_torque_4"),
    Case(
        "lost_motion",
        ("A3",),
        lost_motion,
        {"A3.lost_motion_deg": 3e-4, "A3.excess_compliance_rad_per_Nm": 0.5 * np.radians(3e-4) / 30.0, "A3.breakpoint_Nm": 30.0},
        hyper=30.0,
        depends_on="gravity_torque_3",
    ),
    Case("hysteresis", ("A2",), hysteresis, {"A2.hysteresis_deg": np.nan, "A2.half_width_rad_per_Nm": 2e-9}, depends_on="direction_2"),
    Case(
        "gravity_compensator",
        ("A2",),
        gravity_compensator,
        {"A2.preload_deg": -np.degrees(2e-6), "A2.stretched_deg": -np.degrees(1e-6), "A2.zero_deg": -106.3},
        hyper=0.25,
    ),
    Case("incidence_bias", ("scanner",), leaning(1e-5, 0.0), {"depth_mm": 1e-5}, variant="depth"),
    Case("incidence_bias", ("scanner",), leaning(1e-5, -6e-6), {"depth_mm": 1e-5, "side_mm": -6e-6}, variant=""),
    Case(
        "joint_settling", ("A2",), sagging, {"A2.sag_deg": 4e-4, "A2.least_pause_s": 60.0}, hyper=60.0, depends_on="pause", variant="pause"
    ),
    Case(
        "mount_clearance",
        ("mount",),
        loose,
        {"shift_mm": [2e-4, 0.0, 0.0], "turn_deg": [0.0, np.degrees(1e-6), 0.0]},
        hyper=0.0,
        depends_on="gravity_along_6_0_0",
        variant="gravity_along_6_0_0",
    ),
    Case("joint_scale", ("A2",), joint_scale, {"A2.ratio": 3e-7}, depends_on="q2"),
    Case("wrist_coupling", ("A4", "A5"), wrist_coupling, {"ratio": -4e-7}, depends_on="q4"),
    Case("joint_step", ("A6",), joint_step, {"A6.at_pose": np.nan, "A6.step_deg": 2e-4}, hyper=float(MOMENT), depends_on="pose"),
    Case("thermal_zero_shift", ("A3",), thermal_zero_shift, {"A3.zero_rad_per_K": 3e-7}, depends_on="robot_C"),
    Case("thermal_growth", ("link4",), thermal_growth, {"link4.growth_mm_per_K": 1e-4}, depends_on="robot_C"),
    Case(
        "thermal_growth",
        ("link2",),
        thermal_growth_over_time,
        {"link2.growth_mm": 4e-4, "link2.time_constant_s": TAU},
        hyper=TAU,
        depends_on="time",
        temperature_recorded=False,
    ),
    Case(
        "mount_shift",
        ("mount",),
        mount_shift,
        {"at_pose": np.nan, "translation_mm": [1e-3, 2e-3, -3e-3], "rotation_deg": [1e-4, -2e-4, 3e-4]},
        hyper=float(MOMENT),
        depends_on="pose",
    ),
    Case("scanner_scale", ("scanner",), misread(lambda p: 40e-6 * p), {"scale_ppm": 40.0}, depends_on="z"),
    Case("scanner_scale", ("scanner",), misread(lambda p: p * [1e-5, -2e-5, 3e-5]), {"scale_ppm": [10, -20, 30]}, variant="axes"),
    Case("scanner_scale", ("scanner",), misread(lambda p: 4e-5 * p * ALONG[0]), {"scale_ppm": [40, 0, 0]}, variant="x"),
    Case("scanner_scale", ("scanner",), misread(lambda p: 4e-5 * p * ALONG[1]), {"scale_ppm": [0, 40, 0]}, variant="y"),
    Case("scanner_scale", ("scanner",), misread(lambda p: 4e-5 * p * ALONG[2]), {"scale_ppm": [0, 0, 40]}, variant="z"),
    field_shape("field_curvature_per_mm", 1e-6, "x", lambda p: 1e-6 * radial(p)[:, None] * ALONG[2]),
    field_shape("radial_per_mm2", 1e-9, "x", lambda p: 1e-9 * radial(p)[:, None] * p * [1, 1, 0]),
    field_shape("depth_scale_per_mm", 1e-6, "z", lambda p: 1e-6 * p[:, 2:] * p * [1, 1, 0]),
    field_shape("depth_quadratic_per_mm", 1e-6, "z", lambda p: 1e-6 * p[:, 2:] ** 2 * ALONG[2]),
    field_shape("astigmatism_per_mm", 1e-6, "x", lambda p: 1e-6 * (p[:, :1] ** 2 - p[:, 1:2] ** 2) * ALONG[2]),
    field_shape("saddle_per_mm", 1e-6, "x", lambda p: 1e-6 * p[:, :1] * p[:, 1:2] * ALONG[2]),
    Case(
        "scanner_distortion",
        ("scanner",),
        misread(lambda p: 1e-6 * p[:, 2:] * p * [1, 1, 0] + p * [2e-5, 2e-5, -3e-5]),
        {"depth_scale_per_mm": 1e-6, "magnification": 2e-5, "depth_gain": -3e-5},
        variant="depth_scale_per_mm+magnification+depth_gain",
    ),
    Case(
        "scanner_warmup",
        ("scanner",),
        scanner_warmup,
        {"offset_mm": [0.01, -0.02, 0.03], "time_constant_s": TAU},
        hyper=TAU,
        depends_on="time",
    ),
    Case("ball_shift", ("ball3",), ball_shift, {"shift_mm": [0.001, -0.002, 0.003]}),
    Case("artefact_expansion", ("mbc",), artefact_expansion, {"scale_ppm": 50.0}),
    Case("station_drift", ("station2",), station_drift, {"drift_mm": [0.002, -0.004, 0.006]}, depends_on="time"),
    Case(
        "payload",
        ("mount",),
        wound_up(4.2, [10.0, -25.0, 140.0]),
        {"mass_kg": 4.2, "com_mm": [10.0, -25.0, 140.0]},
        before=wound_up(plain.PAYLOAD, plain.PAYLOAD_COM),
    ),
    Case("exposure_latency", ("scanner",), exposure_latency, {"latency_s": 5e-7}),
)


def expected(case: Case, world: World) -> dict[str, float | list[float]]:
    """The parameters, with the number of the pose at which a sudden change happens."""
    at = float(FIRST_POSE + np.flatnonzero(world.order == MOMENT)[0])
    width = float(np.degrees(2 * 2e-9 * np.abs(torque(world)[:, 1]).max()))
    found = {"at_pose": at, "hysteresis_deg": width}
    return {k: found.get(k.rpartition(".")[2], v) for k, v in case.parameters.items()}

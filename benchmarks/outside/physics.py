"""Physics outside the catalogue, in plain numpy: kinematics, weight and each error where it happens, without any code of the effects.

Units are mm, rad, s, kg and N m. A kind says what it displaces, where that is, and which names would be right.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from simulated import plan

from mbcacq.model.observations import Observations

STANDARD_GRAVITY = 9.80665
POINT_NOISE, JOINT_NOISE = np.array([0.005, 0.005, 0.009]), 6e-6
POSE_S, PAUSE_S = (14.0, 30.0), (240.0, 280.0)
UP = np.array([0.0, 0.0, 1.0])


def turns(vectors: np.ndarray) -> np.ndarray:
    """Rodrigues' formula: rotations (P, 3, 3) by rotation vectors (P, 3)."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = (vectors / np.maximum(angle[:, :, 0], 1e-300)).T
    o = np.zeros(len(vectors))
    K = np.stack([np.stack([o, -z, y]), np.stack([z, o, -x]), np.stack([-y, x, o])]).transpose(2, 0, 1)
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def twisted(twist: np.ndarray) -> np.ndarray:
    """(P, 4, 4) of a shift and a rotation vector (P, 6)."""
    T = np.tile(np.eye(4), (len(twist), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = turns(twist[:, 3:]), twist[:, :3]
    return T


@dataclass
class World:
    """A cell as it is. q: (P, n) reported angles; joint (P, n) rad, base and mount (P, 6) and air (P,) are displaced by the physics, and
    ``behind`` (P, n, 3) mm moves the frame behind each link in its own axes; ``reach`` (P,) is added to a distance, in shares of it, and
    ``loose`` is a ball with the clearance (mm) in which it lies on the lower side of its seat."""

    obs: Observations
    rng: np.random.Generator
    joint: np.ndarray = field(init=False)
    base: np.ndarray = field(init=False)
    mount: np.ndarray = field(init=False)
    behind: np.ndarray = field(init=False)
    reach: np.ndarray = field(init=False)
    loose: tuple[int, float] = field(init=False, default=(-1, 0.0))
    air: np.ndarray = field(init=False)  # 1/mm, curvature of a ray across its way, towards the zenith

    def __post_init__(self) -> None:
        P, n = self.obs.q.shape
        self.joint, self.base, self.mount, self.air = np.zeros((P, n)), np.zeros((P, 6)), np.zeros((P, 6)), np.zeros(P)
        self.reach = np.zeros(P)
        self.behind = np.zeros((P, n, 3))

    @property
    def q(self) -> np.ndarray:
        return self.obs.q

    def since_before(self, values: np.ndarray, at_first: float) -> np.ndarray:
        """(P,) by how much a value (P,) differs from that at the pose measured before; at the first pose as given."""
        listed, out = np.argsort(self.obs.time_s), np.empty(len(values))
        out[listed] = np.r_[at_first, np.diff(values[listed])]
        return out

    @cached_property
    def gap_s(self) -> np.ndarray:
        """(P,) s since the pose before; the arm stood before the first one."""
        return self.since_before(self.obs.time_s, PAUSE_S[1])

    @cached_property
    def since_pause_s(self) -> np.ndarray:
        """(P,) s since the last pause."""
        begun = np.sort(self.obs.time_s[self.gap_s > PAUSE_S[0] / 2])
        return self.obs.time_s - begun[np.searchsorted(begun, self.obs.time_s, side="right") - 1]

    def frames(self, q: np.ndarray, rows: np.ndarray | None = None, behind: np.ndarray | None = None) -> np.ndarray:
        """(P, n + 1, 4, 4) from the base to the frame behind each link. rows: (n, 5) theta, d, a, alpha, beta; behind: as the field."""
        chain = self.obs.cell.robot.chain
        out = [np.tile(np.eye(4), (len(q), 1, 1))]
        for i, (theta, d, a, alpha, beta) in enumerate(chain.rows if rows is None else rows):
            turn = np.zeros((len(q), 3))
            turn[:, 2] = chain.sign[i] * q[:, i] + theta
            bend = turns(np.array([[alpha, 0.0, 0.0]]))[0] @ turns(np.array([[0.0, beta, 0.0]]))[0]
            T = np.tile(np.eye(4), (len(q), 1, 1))
            R = turns(turn)
            T[:, :3, :3], T[:, :3, 3] = R @ bend, R @ np.array([a, 0.0, 0.0]) + np.array([0.0, 0.0, d])
            if behind is not None:
                T[:, :3, 3] += np.einsum("pij,pj->pi", T[:, :3, :3], behind[:, i])
            out.append(out[-1] @ T)
        return np.stack(out, axis=1)

    def weights(self, q: np.ndarray) -> list[tuple[float, np.ndarray]]:
        """Each mass (kg) with its centre (P, 3) in the base."""
        robot, at = self.obs.cell.robot, self.frames(q)
        links = [(m, at[:, i + 1, :3, :3] @ c + at[:, i + 1, :3, 3]) for i, (m, c) in enumerate(zip(robot.mass, robot.com, strict=True))]
        return [*links, (robot.payload_mass, at[:, -1, :3, :3] @ robot.payload_com + at[:, -1, :3, 3])]

    @cached_property
    def torque(self) -> np.ndarray:
        """(P, n) N m: by how much the weight's energy falls with each angle."""
        step, out = 1e-5, []
        for e in np.eye(self.q.shape[1]):
            high, low = (sum(m * STANDARD_GRAVITY * r[:, 2] * 1e-3 for m, r in self.weights(self.q + s * step * e)) for s in (1, -1))
            out.append(-(high - low) / (2 * step))
        return np.stack(out, axis=1)

    @cached_property
    def overturning(self) -> np.ndarray:
        """(P, 3) N m about the origin of the base."""
        return sum(np.cross(r, -m * STANDARD_GRAVITY * UP) * 1e-3 for m, r in self.weights(self.q))

    @cached_property
    def down_in_flange(self) -> np.ndarray:
        """(P, 3) direction of gravity in the axes of the flange."""
        return np.einsum("pji,j->pi", self.frames(self.q)[:, -1, :3, :3], -UP)

    def measured(self) -> Observations:
        """The centres as this cell shows them: an arm that deviates from its rows, a mounted scanner, noise of joints and centres."""
        obs, rng, cell = self.obs, self.rng, self.obs.cell
        rows = cell.robot.chain.rows
        deviating = rows + rng.normal(0, 1, rows.shape) * [3e-4, 0.15, 0.15, 3e-4, 0.0]
        hand_eye = cell.T_flange_scanner @ twisted(rng.normal(0, 1, (1, 6)) * [0.5, 0.5, 0.5, 2e-3, 2e-3, 2e-3])[0]
        q = self.q + self.joint + rng.normal(0, JOINT_NOISE, self.q.shape)
        T = twisted(self.base) @ self.frames(q, deviating, self.behind)[:, -1] @ twisted(self.mount) @ hand_eye
        nominal = self.frames(self.q)[:, -1] @ cell.T_flange_scanner
        stations = np.zeros((len(cell.stations), 4, 4))
        for s in range(len(stations)):  # where the nominal arm sees the artefact: a tripod that was put up
            (row, *_) = np.flatnonzero(obs.station[obs.pose] == s)
            stations[s] = nominal[obs.pose[row]] @ self._seen(obs.pose[row])
        lies = (obs.ball == self.loose[0])[:, None] * self.loose[1]
        balls = cell.ball_centres[obs.ball] + lies * np.einsum("mji,j->mi", stations[obs.station[obs.pose], :3, :3], -UP)
        seen = np.einsum("mij,mj->mi", stations[obs.station[obs.pose], :3, :3], balls) + stations[obs.station[obs.pose], :3, 3]
        R, t = T[obs.pose, :3, :3], T[obs.pose, :3, 3]
        xyz = np.einsum("mji,mj->mi", R, seen - t)
        length = np.linalg.norm(xyz, axis=1, keepdims=True)
        up = np.einsum("mji,j->mi", R, UP)
        across = up - xyz * np.sum(up * xyz, axis=1, keepdims=True) / length**2
        xyz = xyz * (1 + self.reach[obs.pose] * length[:, 0] / 260)[:, None]
        xyz = xyz + 0.5 * self.air[obs.pose][:, None] * length**2 * across
        return replace(obs, xyz=xyz + rng.normal(0, 1, xyz.shape) * POINT_NOISE)

    def _seen(self, pose: int) -> np.ndarray:
        """(4, 4) of the artefact in the scanner at a pose of the plan, from its centres (Kabsch); about a bar any roll is as good."""
        here = self.obs.pose == pose
        known, seen = self.obs.cell.ball_centres[self.obs.ball[here]], self.obs.xyz[here]
        if len(known) < 3:  # one end of a bar: the rest of the plan's own placing
            other = self.obs.station[self.obs.pose] == self.obs.station[pose]
            nominal = self.frames(self.q)[:, -1] @ self.obs.cell.T_flange_scanner
            in_base = np.einsum("mij,mj->mi", nominal[self.obs.pose, :3, :3], self.obs.xyz) + nominal[self.obs.pose, :3, 3]
            ends = [in_base[other & (self.obs.ball == b)].mean(axis=0) for b in np.unique(self.obs.ball[other])]
            x = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
            y = np.cross(UP if abs(x[2]) < 0.9 else np.array([1.0, 0.0, 0.0]), x)
            T = np.eye(4)
            T[:3, :3] = np.stack([x, y / np.linalg.norm(y), np.cross(x, y / np.linalg.norm(y))], axis=1)
            T[:3, 3] = (ends[0] + ends[1]) / 2
            return np.linalg.inv(nominal[pose]) @ T
        U, _, V = np.linalg.svd((seen - seen.mean(axis=0)).T @ (known - known.mean(axis=0)))
        T = np.eye(4)
        T[:3, :3] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V
        T[:3, 3] = seen.mean(axis=0) - T[:3, :3] @ known.mean(axis=0)
        return T


def run(seed: int) -> World:
    """A plan measured station after station in two rounds, with a pause before each station; one of eight plans."""
    rng = np.random.default_rng(seed)
    obs = plan(seed=100 + seed % 8)
    listed = np.lexsort((obs.station, np.arange(obs.n_poses) % 2))
    first = np.r_[True, np.diff(obs.station[listed]) != 0]
    time = np.empty(obs.n_poses)
    time[listed] = np.cumsum(np.where(first, rng.uniform(*PAUSE_S, len(first)), rng.uniform(*POSE_S, len(first))))
    arrived = np.empty(obs.q.shape)
    arrived[listed] = np.sign(np.diff(obs.q[listed], axis=0, prepend=obs.q[listed[:1]] - 0.1))
    warmed = 24.0 + 9.0 * (1 - np.exp(-time / 2500.0)) + rng.normal(0, 0.05, len(time))
    return World(replace(obs, time_s=time, direction=arrived.astype(int), temperatures={"robot_C": warmed}), rng)


@dataclass(frozen=True)
class Kind:
    """displace: (world, size) -> locations of which one is right. right: sets of names that would be."""

    displace: Callable[[World, float], tuple[str, ...]]
    right: tuple[frozenset[str], ...] = ()


def two_angles(w: World, size: float) -> tuple[str, ...]:
    """A parallelogram, or a cable over two axes: a joint turns with the sum or the difference of two angles."""
    a, b = w.rng.choice([(1, 2), (2, 4), (3, 5), (0, 1)])
    i = int(w.rng.choice([1, 2, 3]))
    w.joint[:, i] += 1.5e-4 * size * np.sin(w.q[:, a] + w.rng.choice([-1, 1]) * w.q[:, b] + w.rng.uniform(0, 6.28))
    return (f"A{i + 1}",)


def product_of_angles(w: World, size: float) -> tuple[str, ...]:
    """A dress pack pulls at an axis as another one opens its loop."""
    i, a, b = w.rng.choice([(2, 2, 4), (4, 4, 5), (1, 1, 2), (3, 3, 4)])
    w.joint[:, i] += (3.5e-4 if i > 2 else 1.8e-4) * size * np.sin(w.q[:, a]) * np.cos(2 * w.q[:, b] + w.rng.uniform(0, 6.28))
    return (f"A{i + 1}",)


def loose_mount(w: World, size: float) -> tuple[str, ...]:
    """A scanner that is loose in its mount falls from one seat to the other."""
    axis = w.rng.normal(0, 1, 3)
    axis /= np.linalg.norm(axis)
    across = np.cross(axis, w.rng.normal(0, 1, 3))
    seat = np.sign(w.down_in_flange @ axis + w.rng.uniform(-0.15, 0.15))[:, None]
    w.mount += size * seat * np.r_[0.03 * axis, 1.5e-4 * across / np.linalg.norm(across)]
    return ("mount",)


def sag_after_pause(w: World, size: float) -> tuple[str, ...]:
    """The arm sags through its brakes; the first pose after a pause begins there."""
    first = w.gap_s > PAUSE_S[0] / 2
    i = int(w.rng.choice([1, 2]))
    w.joint[:, i] += 1.1e-4 * size * first * np.sign(w.torque[:, i])
    return (f"A{i + 1}",)


def creep_after_pause(w: World, size: float) -> tuple[str, ...]:
    """A gear that has stood creeps back as it is moved, in a minute or two."""
    i = int(w.rng.choice([1, 2, 4]))
    w.joint[:, i] += (3e-4 if i > 2 else 1.4e-4) * size * np.exp(-w.since_pause_s / w.rng.uniform(40, 90))
    return (f"A{i + 1}",)


def warm_air(w: World, size: float) -> tuple[str, ...]:
    """Air that is warmer below bends every ray upwards, more as the cell warms up."""
    w.air += 2 * 0.05 * size / 260.0**2 * (w.obs.temperatures["robot_C"] - 20.0) / 12.0
    return "scanner", "mount", "base"  # all that is seen rises


def rocking_base(w: World, size: float) -> tuple[str, ...]:
    """A base on two bolts tips about their line where the weight passes it."""
    axis = turns(np.array([[0.0, 0.0, w.rng.uniform(0, 3.14)]]))[0] @ np.array([1.0, 0.0, 0.0])
    moment = w.overturning @ axis
    w.base[:, 3:] += 4e-5 * size * np.tanh(moment / (0.15 * np.abs(moment).max()))[:, None] * axis
    return ("base",)


def stiffening_gear(w: World, size: float) -> tuple[str, ...]:
    """Teeth that touch over more of their width with the load: the wind-up grows as its power of one third."""
    i = int(w.rng.choice([1, 2]))
    tau = w.torque[:, i]
    w.joint[:, i] += 2e-4 * size * np.cbrt(tau / np.abs(tau).max())
    return (f"A{i + 1}",)


def softening_gear(w: World, size: float) -> tuple[str, ...]:
    """A gear that yields beyond half its load, as teeth that lift off."""
    i = int(w.rng.choice([1, 2]))
    tau = w.torque[:, i] / np.abs(w.torque[:, i]).max()
    w.joint[:, i] += 1e-4 * size * (tau + 4.0 * np.sign(tau) * np.maximum(np.abs(tau) - 0.5, 0.0))
    return (f"A{i + 1}",)


def warm_zero(w: World, size: float) -> tuple[str, ...]:
    """The zero of a joint moves as its encoder warms up."""
    i = int(w.rng.choice([1, 2, 4]))
    w.joint[:, i] += (4e-4 if i > 2 else 2e-4) * size * (w.obs.temperatures["robot_C"] - 24.0) / 9.0
    return (f"A{i + 1}",)


def hose_at_mount(w: World, size: float) -> tuple[str, ...]:
    """A hose bends the mount with the product of two wrist angles."""
    w.mount[:, 3:] += 3e-4 * size * (np.sin(w.q[:, 4]) * np.sin(w.q[:, 5] + 1.0))[:, None] * np.array([0.6, 0.8, 0.0])
    return ("mount",)


def last_way(w: World, size: float) -> tuple[str, ...]:
    """Grease and wind-up leave a joint behind by the length of its last way."""
    i = int(w.rng.choice([0, 1, 2]))
    moved = w.since_before(w.q[:, i], 0.1)
    w.joint[:, i] -= 1.2e-4 * size * np.sign(moved) * (1 - np.exp(-np.abs(moved) / 0.15))
    return (f"A{i + 1}",)


def bearing_run_out(w: World, size: float) -> tuple[str, ...]:
    """An oval bearing lifts what it carries along its axis twice a turn, more on the side to which the load presses it."""
    i = int(w.rng.choice([1, 2, 3]))
    pressed = 1.0 + 0.5 * np.tanh(3.0 * w.torque[:, i] / np.abs(w.torque[:, i]).max())
    lift = 0.2 * size * pressed * np.cos(2 * w.q[:, i] + w.rng.uniform(0, 6.28))
    bend = w.obs.cell.robot.chain.rows[i, 3]
    w.behind[:, i] += lift[:, None] * (turns(np.array([[-bend, 0.0, 0.0]]))[0] @ UP)
    return f"link{i}", f"link{i + 1}"  # on both sides of the bearing


def cable_at_wrist(w: World, size: float) -> tuple[str, ...]:
    """A cable over the wrist drags its three axes; it slips along its guides, so that its pull depends on the way of the arm (play)."""
    wound, hold = w.q[:, 3] + w.q[:, 4] + w.q[:, 5], 1.5
    listed, slack, at = np.argsort(w.obs.time_s), np.zeros(len(wound)), float(wound.min())
    for pose in listed:
        at = float(np.clip(at, wound[pose] - hold, wound[pose] + hold))
        slack[pose] = wound[pose] - at
    w.joint[:, 3:6] -= 1.2e-3 * size * (slack / hold)[:, None] * np.array([0.6, 1.0, 0.8])
    return "A4", "A5", "A6"


def loaded_strain_wave(w: World, size: float) -> tuple[str, ...]:
    """A strain wave gear that was bent: the error of its oval, four times a turn of the joint, grows with the torque and turns with it."""
    i = int(w.rng.choice([1, 2]))
    w.joint[:, i] += 2.5e-4 * size * w.torque[:, i] / np.abs(w.torque[:, i]).max() * np.sin(4 * w.q[:, i] + w.rng.uniform(0, 6.28))
    return (f"A{i + 1}",)


def warming_link(w: World, size: float) -> tuple[str, ...]:
    """A link grows along itself as the motor in it warms up; the temperature that is recorded follows it."""
    rows = w.obs.cell.robot.chain.rows
    i = int(np.argmax(rows[:, 2])) if w.rng.uniform() < 0.5 else 3
    _, d, a, alpha, _ = rows[i]
    along = turns(np.array([[-alpha, 0.0, 0.0]]))[0] @ np.array([a, 0.0, d]) / np.hypot(a, d)
    w.behind[:, i] += 0.12 * size * ((w.obs.temperatures["robot_C"] - 24.0) / 9.0)[:, None] * along
    return (f"link{i + 1}",)


def duty_warms_gear(w: World, size: float) -> tuple[str, ...]:
    """A worm gear turns its joint away as it warms up with its own duty, and back as it cools."""
    i, heat, at = int(w.rng.choice([1, 2, 4])), np.zeros(len(w.q)), 0.0
    moved = np.abs(w.since_before(w.q[:, i], 0.0))
    for pose in np.argsort(w.obs.time_s):
        at = at * np.exp(-w.gap_s[pose] / 400.0) + moved[pose]
        heat[pose] = at
    w.joint[:, i] += (5e-4 if i > 2 else 2.5e-4) * size * heat / heat.max()
    return (f"A{i + 1}",)


def tilting_bearings(w: World, size: float) -> tuple[str, ...]:
    """Two bearings of a joint yield apart: what they carry shifts along the axis with the load across it, more beyond a preload."""
    i = int(w.rng.choice([2, 3]))
    load = w.torque[:, i - 1] / np.abs(w.torque[:, i - 1]).max()
    bend = w.obs.cell.robot.chain.rows[i, 3]
    shift = 0.2 * size * np.sign(load) * np.maximum(np.abs(load) - 0.3, 0.0) / 0.7
    w.behind[:, i] += shift[:, None] * (turns(np.array([[-bend, 0.0, 0.0]]))[0] @ UP)
    return f"link{i}", f"link{i + 1}"


def warming_range(w: World, size: float) -> tuple[str, ...]:
    """A scanner measures far points the longer, the warmer it is."""
    w.reach += 2.5e-4 * size * (1 - np.exp(-w.obs.time_s / 1500.0))
    return ("scanner",)


def loose_ball(w: World, size: float) -> tuple[str, ...]:
    """A ball lies on the lower side of its seat, whichever way the artefact stands."""
    w.loose = int(w.rng.integers(8)), 0.08 * size
    return (f"ball{w.obs.cell.ball_ids[w.loose[0]]}",)


SETTLING, SLACK = frozenset({"joint_settling"}), frozenset({"lost_motion"})
KINDS = {
    "two_angles": Kind(two_angles),
    "product_of_angles": Kind(product_of_angles),
    "loose_mount": Kind(loose_mount, (frozenset({"mount_clearance"}),)),
    "sag_after_pause": Kind(sag_after_pause, (SETTLING,)),
    "creep_after_pause": Kind(creep_after_pause, (SETTLING,)),
    "warm_air": Kind(warm_air),
    "rocking_base": Kind(rocking_base),
    "stiffening_gear": Kind(stiffening_gear, (SLACK, SLACK | {"joint_compliance"})),
    "softening_gear": Kind(softening_gear),
    "warm_zero": Kind(warm_zero, (frozenset({"thermal_zero_shift"}),)),
    "hose_at_mount": Kind(hose_at_mount),
    "last_way": Kind(last_way),
    "bearing_run_out": Kind(bearing_run_out),
    "cable_at_wrist": Kind(cable_at_wrist),
    "loaded_strain_wave": Kind(loaded_strain_wave),
    "duty_warms_gear": Kind(duty_warms_gear),
    "tilting_bearings": Kind(tilting_bearings),
    "warming_range": Kind(warming_range),
    "loose_ball": Kind(loose_ball, (frozenset({"ball_shift"}),)),
    "warming_link": Kind(warming_link, (frozenset({"thermal_growth"}),)),
}

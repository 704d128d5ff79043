"""Recordings of ROS: rosbag2 folders (SQLite or MCAP) and .mcap files as observations or trajectories.

``cell.yaml`` says under ``bag`` which topic is what. Joint angles are those of sensor_msgs/JointState; a target is a geometry_msgs
PoseStamped, PointStamped or TransformStamped, or one frame of a tf2_msgs/TFMessage; a cloud is a sensor_msgs/PointCloud2. Needs the
package rosbags: ``pip install mbcacq[ros]``.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import Field

from mbcacq.errors import ConfigError, DeviceFault
from mbcacq.model.cell import Cell
from mbcacq.model.cell_schema import Strict
from mbcacq.model.yaml_source import LARGE, parse
from mbcacq.quantities import from_degrees
from mbcacq.recording.datasets import quaternions
from mbcacq.recording.datasets.open_format import validate
from mbcacq.spheres.extract import find_spheres

MM_IN_M = 1e3  # ROS says lengths in metres
NS = 1e-9
FASTEST_RAD_S = 15.0  # of a joint: above the wrists of the fastest small arms (about 12 rad/s)
UR_JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
FARTHEST_M = 1e3  # of a target: laser trackers reach 160 m
SHORTEST_S = 1e-3  # between messages, for stamps are not exact
T = TypeVar("T")
FLOATS = {7: "f4", 8: "f8"}  # PointField.FLOAT32, FLOAT64


class StandstillSpec(Strict):
    """An arm stands still where every joint is slower than ``speed_deg_s`` for ``seconds``."""

    speed_deg_s: float = Field(default=0.2, gt=0)
    seconds: float = Field(default=0.5, gt=0)


class BagSpec(Strict):
    """Where a bag holds angles and targets.

    Attributes
    ----------
    file : str
        A rosbag2 folder or an .mcap file, beside cell.yaml.
    joints : tuple[str, ...]
        Names in the order of the axes; if not given, that which the names tell, or that of the message.
    target_frame : str or None
        Child frame of the target, where its topic is /tf.
    """

    file: str
    joint_states: str = "/joint_states"
    joints: tuple[str, ...] = ()
    set_points: str | None = None
    target: str | None = None
    target_frame: str | None = None
    point_cloud: str | None = None
    standstill: StandstillSpec = StandstillSpec()


@dataclass(frozen=True)
class JointStates:
    """time_s: (T,); position, effort: (T, n) rad and N m, effort None if the messages have none."""

    time_s: np.ndarray
    position: np.ndarray
    effort: np.ndarray | None


def bag_of(text: str, folder: Path) -> BagSpec | None:
    """What the text of the cell.yaml of a folder says under ``bag``; None if it says nothing. Raises ConfigError."""
    path = folder / "cell.yaml"
    if "bag" not in text:
        return None
    file = parse(text, path, limits=LARGE)
    return validate(BagSpec, file.part("bag")) if isinstance(file.data.get("bag"), dict) else None


class Bag:
    """The messages of one bag, by topic. Raises ConfigError if the bag cannot be read, or a topic is missing or of another type."""

    def __init__(self, folder: Path, spec: BagSpec) -> None:
        try:
            from rosbags.highlevel import AnyReader
            from rosbags.typesys import Stores, get_typestore
        except ImportError:
            raise ConfigError(f"{folder / spec.file}: reading bags needs the package rosbags: pip install 'mbcacq[ros]'") from None
        self.path = folder / spec.file
        if not self.path.exists():
            raise ConfigError(f"{folder / 'cell.yaml'}: bag: {self.path} does not exist; correct file")
        self._open: Callable[[], Any] = lambda: AnyReader([self.path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))

    def messages(self, topic: str, types: tuple[str, ...], read: Callable[[float, Any], T]) -> Iterator[T]:
        """What ``read`` makes of time in s (of the message's stamp) and message, of each message of a topic in the order of recording.

        A message is what the definition in the bag says: a damaged one may lack any field, and fails in ``read``.
        """
        try:
            with self._open() as reader:
                connections = [c for c in reader.connections if c.topic == topic]
                self._check(topic, types, {c.msgtype for c in connections}, sorted({c.topic for c in reader.connections}))
                for connection, stamp, raw in reader.messages(connections):
                    message = reader.deserialize(raw, connection.msgtype)
                    yield read(_stamp(message, stamp * NS), message)
        except (ConfigError, GeneratorExit):
            raise
        except Exception as error:  # readers of damaged bytes fail in many ways: of SQLite, struct, zstd, a size that no memory has
            reason = str(error) or type(error).__name__
            raise ConfigError(f"{self.path}: the bag cannot be read, it is damaged ({reason}); check it with `ros2 bag info`") from None

    def _check(self, topic: str, types: tuple[str, ...], found: set[str], known: list[str]) -> None:
        if not found:
            raise ConfigError(f"{self.path}: the topic {topic} is not in the bag (there: {', '.join(known) or 'none'}); correct cell.yaml")
        wrong = sorted(kind for kind in found if kind not in types)
        if wrong:
            raise ConfigError(f"{self.path}: the topic {topic} holds {wrong[0]}, not {' or '.join(types)}; correct cell.yaml")

    def joint_states(self, topic: str, names: tuple[str, ...], n: int) -> JointStates:
        def read(time: float, message: Any) -> tuple[float, list[str], np.ndarray, np.ndarray]:
            named = [str(name) for name in message.name]
            return time, named, np.asarray(message.position, dtype=float).ravel(), np.asarray(message.effort, dtype=float).ravel()

        times, positions, efforts, others = [], [], [], list[list[str]]()
        for time, present, position, effort in self.messages(topic, ("sensor_msgs/msg/JointState",), read):
            if not set(names) & set(present) if names else len(present) < n:
                others.append(present)
                continue  # of another publisher, such as a gripper's
            at = self._columns(topic, present, names, n)
            if len(position) and np.isnan(position).all():
                continue  # drivers publish before they have read the arm
            times.append(time)
            if len(position) != len(present):
                raise ConfigError(
                    f"{self.path}: the topic {topic} has a message at {time:.6f} s with {len(present)} names and "
                    f"{len(position)} positions; it is damaged, remove it from the bag"
                )
            positions.append(position[at])
            efforts.append(effort[at] if len(effort) == len(position) else np.full(n, np.nan))
        if not times and others:
            self._columns(topic, others[0], names, n)  # raises
        if not times:
            raise ConfigError(f"{self.path}: the topic {topic} holds no message; record it, or correct cell.yaml")
        time_s, effort = np.array(times), np.array(efforts)
        self._refuse_jumps(topic, time_s, np.array(positions).reshape(len(time_s), n))
        rising = np.r_[True, np.diff(time_s) > 0]
        measured = effort[rising] if np.isfinite(effort).all() and np.any(effort) else None
        return JointStates(time_s[rising], np.array(positions)[rising], measured)

    def _refuse_jumps(self, topic: str, time_s: np.ndarray, q: np.ndarray) -> None:
        """Raise ConfigError where a joint leaves both of its neighbours in time faster than any arm moves, while these agree: a flipped
        bit."""
        if not np.isfinite(q).all():
            row = int(np.argmin(np.isfinite(q).all(axis=1)))
            raise ConfigError(f"{self.path}: the topic {topic} has an angle that is no number at {time_s[row]:.6f} s; remove the message")
        if len(q) < 3:
            return
        step = np.diff(time_s)
        reach = FASTEST_RAD_S * np.maximum(np.maximum(step[:-1], step[1:]), SHORTEST_S)[:, None]
        there, back, across = np.abs(q[1:-1] - q[:-2]), np.abs(q[2:] - q[1:-1]), np.abs(q[2:] - q[:-2])
        jumps = (np.minimum(there, back) > reach) & (across < 0.5 * np.minimum(there, back))
        if jumps.any():
            row, joint = np.argwhere(jumps)[0]
            raise ConfigError(
                f"{self.path}: the topic {topic} has joint {joint + 1} at {q[row + 1, joint]:.6g} rad at {time_s[row + 1]:.6f} s, between "
                f"{q[row, joint]:.6g} and {q[row + 2, joint]:.6g} rad: no arm moves so; the message is damaged, remove it from the bag"
            )

    def _columns(self, topic: str, present: list[str], names: tuple[str, ...], n: int) -> list[int]:
        wanted = list(names) or axes_among(present, n)
        missing = [name for name in wanted if name not in present]
        if missing and names:
            raise ConfigError(
                f"{self.path}: the topic {topic} has no joint {', '.join(missing)} (there: {', '.join(present)}); correct bag: joints"
            )
        if len(wanted) != n:
            raise ConfigError(
                f"{self.path}: the topic {topic} has the joints {', '.join(present)}, the robot {n} axes; "
                "list the joints in the order of the axes under bag: joints"
            )
        return [present.index(name) for name in (wanted if names else in_order_of_axes(wanted))]


def in_order_of_axes(names: list[str]) -> list[str]:
    """Names of joints from the base on, where they tell: those of UR, or with the same words and one number each; else as they are.

    Drivers send them in any order, often by the alphabet, in which UR's elbow comes first.
    """
    ends = [next((k for k, end in enumerate(UR_JOINTS) if name.endswith(end)), None) for name in names]
    if None not in ends and len(set(ends)) == len(names):
        return [name for _, name in sorted(zip(ends, names, strict=True), key=lambda pair: pair[0] or 0)]
    apart = [re.fullmatch(r"(.*?)(\d+)(\D*)", name) for name in names]
    if all(apart) and len({(m[1], m[3]) for m in apart if m}) == 1:
        return sorted(names, key=lambda name: int(re.findall(r"\d+", name)[-1]))
    return names


def axes_among(names: list[str], n: int) -> list[str]:
    """The n of more names that are the axes of one arm by UR's names or by numbers 1 .. n in the same words; else all of them."""
    if len(names) <= n:
        return names
    of_ur = [name for name in names if name.endswith(UR_JOINTS)]
    if n == len(UR_JOINTS) == len(of_ur):
        return of_ur
    alike: dict[tuple[str, str], list[str]] = {}
    for name in names:
        if m := re.fullmatch(r"(.*?)(\d+)(\D*)", name):
            alike.setdefault((m[1], m[3]), []).append(name)
    whole = [group for group in alike.values() if len(group) == n]
    return whole[0] if len(whole) == 1 else names


def trajectory_columns(folder: Path, spec: BagSpec, n: int) -> dict[str, Any]:
    """time_s, q, q_set and torque of ``Trajectory`` from a bag. Set points are those last sent at each time."""
    bag = Bag(folder, spec)
    actual = bag.joint_states(spec.joint_states, spec.joints, n)
    if len(actual.time_s) < 2:
        raise ConfigError(f"{bag.path}: the topic {spec.joint_states} holds fewer than two messages")
    out: dict[str, Any] = {"time_s": actual.time_s - actual.time_s[0], "q": actual.position, "torque": actual.effort}
    if spec.set_points is not None:
        sent = bag.joint_states(spec.set_points, spec.joints, n)
        out["q_set"] = np.stack([np.interp(actual.time_s, sent.time_s, column) for column in sent.position.T], axis=1)
    return out


def observation_columns(folder: Path, spec: BagSpec, cell: Cell) -> dict[str, Any]:
    """Columns of ``Observations`` from a bag: one pose for each standstill of the arm at which something was measured."""
    if len(cell.stations) != 1:
        raise ConfigError(f"{folder / 'cell.yaml'}: a bag is read as one station, cell.yaml has {len(cell.stations)}; make a set of each")
    bag = Bag(folder, spec)
    states = bag.joint_states(spec.joint_states, spec.joints, cell.robot.n)
    windows = standstills(states, spec.standstill) if len(states.time_s) > 1 else []
    if not windows:
        raise ConfigError(f"{bag.path}: the arm never stands still for {spec.standstill.seconds:g} s; change bag: standstill")
    measured = _targets(bag, spec, states, windows) if spec.target is not None else _clouds(bag, spec, cell, states, windows)
    seen = np.unique(measured["pose"])
    if not len(seen):
        raise ConfigError(f"{bag.path}: nothing was measured while the arm stood still; check the topics under bag:")
    q = np.stack([states.position[w].mean(axis=0) for w in windows])[seen]
    time_s = np.array([states.time_s[w].mean() for w in windows])[seen]
    measured["pose"] = np.searchsorted(seen, measured["pose"])
    return {"pose_id": np.arange(1, len(seen) + 1), "station": np.zeros(len(seen), dtype=np.int64), "q": q, "time_s": time_s, **measured}


def standstills(states: JointStates, spec: StandstillSpec) -> list[slice]:
    """The stretches of samples over which no joint moves."""
    speed = np.abs(np.gradient(states.position, states.time_s, axis=0)).max(axis=1)
    still = np.r_[0, (speed < from_degrees(spec.speed_deg_s)).astype(int), 0]
    edges = np.flatnonzero(np.diff(still))
    stretches = [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [s for s in stretches if states.time_s[s.stop - 1] - states.time_s[s.start] >= spec.seconds]


def _window_of(time: float, states: JointStates, windows: list[slice]) -> int | None:
    for i, w in enumerate(windows):
        if states.time_s[w.start] <= time <= states.time_s[w.stop - 1]:
            return i
    return None


def _targets(bag: Bag, spec: BagSpec, states: JointStates, windows: list[slice]) -> dict[str, Any]:
    """Mean position, and orientation where there is one, of the target over each standstill."""
    points: dict[int, list[np.ndarray]] = {}
    turns: dict[int, list[np.ndarray]] = {}
    others = set[str]()
    for time, (point, turn) in _measured_targets(bag, spec, others):
        at = _window_of(time, states, windows)
        if at is not None:
            _refuse_strange(bag, str(spec.target), time, point, turn)
            points.setdefault(at, []).append(point)
            if turn is not None:
                turns.setdefault(at, []).append(turn)
    if others and not points:
        asked = f"has no frame '{spec.target_frame}' while the arm stands still" if spec.target_frame else "holds several frames"
        raise ConfigError(
            f"{bag.path}: the topic {spec.target} {asked} (there: {', '.join(sorted(others))}); name the target's under bag: target_frame"
        )
    pose = np.array(sorted(points), dtype=np.int64)
    out: dict[str, Any] = {"pose": pose, "ball": np.zeros(len(pose), dtype=np.int64)}
    out["xyz"] = MM_IN_M * np.array([np.mean(points[p], axis=0) for p in pose.tolist()]).reshape(-1, 3)
    still = len(turns) > 1 and all(abs(q[0]) == 1.0 and not q[1:].any() for each in turns.values() for q in each)  # measures places only
    if len(turns) == len(points) and turns and not still:
        alike = ([q if q @ turns[p][0] >= 0 else -q for q in turns[p]] for p in pose.tolist())  # the sign of a quaternion is arbitrary
        out["rotation"] = quaternions.to_matrix(np.array([np.mean(each, axis=0) for each in alike]))
    return out


def _refuse_strange(bag: Bag, topic: str, time: float, point: np.ndarray, turn: np.ndarray | None) -> None:
    """Raise ConfigError where a message gives no place that a target may have, or no orientation."""
    if not (np.abs(point) < FARTHEST_M).all():
        what = f"a target at {', '.join(f'{v:.4g}' for v in point)} m"
    elif turn is not None and not ((np.abs(turn) < 2).all() and abs(np.linalg.norm(turn) - 1) <= quaternions.UNIT):
        what = f"a target whose quaternion (w, x, y, z) is {', '.join(f'{v:.4g}' for v in turn)}, of a length that is not 1,"
    else:
        return
    raise ConfigError(f"{bag.path}: the topic {topic} has {what} at {time:.6f} s; it is damaged, remove the message from the bag")


def _measured_targets(bag: Bag, spec: BagSpec, others: set[str]) -> Iterator[tuple[float, tuple[np.ndarray, np.ndarray | None]]]:
    """Time and place of each target. others: takes up the frames of /tf that are not the target's."""
    kinds = (*(f"geometry_msgs/msg/{kind}" for kind in ("PoseStamped", "PointStamped", "TransformStamped")), "tf2_msgs/msg/TFMessage")

    def read(time: float, message: Any) -> list[tuple[float, tuple[np.ndarray, np.ndarray | None]]]:
        if not hasattr(message, "transforms"):
            return [(time, _target(message))]
        out = []
        for one in message.transforms:
            if one.child_frame_id == spec.target_frame:
                out.append((_stamp(one, time), _target(one)))
            else:
                others.add(str(one.child_frame_id))
        return out

    for found in bag.messages(str(spec.target), kinds, read):
        yield from found


def _target(message: Any) -> tuple[np.ndarray, np.ndarray | None]:
    """Position (3,) m and quaternion (4,) w, x, y, z of a stamped point, pose or transform."""
    if hasattr(message, "point"):
        return _array(message.point, "xyz"), None
    if hasattr(message, "pose"):
        return _array(message.pose.position, "xyz"), _array(message.pose.orientation, "wxyz")
    return _array(message.transform.translation, "xyz"), _array(message.transform.rotation, "wxyz")


def _array(message: Any, names: str) -> np.ndarray:
    return np.array([getattr(message, name) for name in names], dtype=float)


def _clouds(bag: Bag, spec: BagSpec, cell: Cell, states: JointStates, windows: list[slice]) -> dict[str, Any]:
    """Centres of the balls in the last cloud of each standstill."""
    if spec.point_cloud is None:
        raise ConfigError(f"{bag.path}: cell.yaml names neither a target nor a point_cloud under bag:; add the topic that was measured")
    last: dict[int, np.ndarray] = {}
    topic = spec.point_cloud

    def read(time: float, message: Any) -> tuple[int | None, np.ndarray]:
        at = _window_of(time, states, windows)
        return at, np.zeros((0, 3)) if at is None else MM_IN_M * _points(bag, topic, message)

    for at, points in bag.messages(topic, ("sensor_msgs/msg/PointCloud2",), read):
        if at is not None:
            last[at] = points
    index = {ball: i for i, ball in enumerate(cell.ball_ids)}
    artefact = cell.artefact(cell.stations[0].artefact)
    pose, ball, xyz = [], [], []
    for at in sorted(last):
        try:
            found = find_spheres(last[at], artefact)
        except DeviceFault as error:
            time_s = states.time_s[windows[at].start]
            raise ConfigError(f"{bag.path}: cloud of the standstill at {time_s:.3f} s: {error}") from None
        pose += [at] * len(found.ball)
        ball += [index[b] for b in found.ball.tolist()]
        xyz.append(found.xyz)
    centres = np.concatenate(xyz) if xyz else np.zeros((0, 3))
    return {"pose": np.array(pose, dtype=np.int64), "ball": np.array(ball, dtype=np.int64), "xyz": centres}


def _points(bag: Bag, topic: str, message: Any) -> np.ndarray:
    """(N, 3) m, the finite points of a cloud."""
    fields = {f.name: f for f in message.fields}
    if not all(axis in fields and fields[axis].datatype in FLOATS for axis in "xyz"):
        raise ConfigError(f"{bag.path}: the clouds of {topic} have no x, y, z of floating point; record them as such")
    order = ">" if message.is_bigendian else "<"
    formats = [np.dtype(order + FLOATS[fields[a].datatype]) for a in "xyz"]
    step, count, data = message.point_step, message.width * message.height, np.asarray(message.data, dtype=np.uint8).tobytes()
    if any(fields[a].offset + f.itemsize > step for a, f in zip("xyz", formats, strict=True)) or step * count > len(data):
        raise ConfigError(
            f"{bag.path}: a cloud of {topic} announces {count} points of {step} bytes and holds {len(data)} bytes; it is damaged, "
            "remove it from the bag"
        )
    dtype = np.dtype({"names": list("xyz"), "formats": formats, "offsets": [fields[a].offset for a in "xyz"], "itemsize": step})
    cloud = np.frombuffer(data, dtype=dtype, count=count)
    points = np.stack([cloud[a].astype(float) for a in "xyz"], axis=1)
    return points[np.isfinite(points).all(axis=1)]


def _stamp(message: Any, received: float) -> float:
    """Time (s) at which it was measured; that of its recording where the sender gave none."""
    if not hasattr(message, "header"):  # of /tf each transform has its own
        return received
    stamp = message.header.stamp
    sent = stamp.sec + NS * stamp.nanosec
    return sent if sent > 0 else received

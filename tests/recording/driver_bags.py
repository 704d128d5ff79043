"""Bags as drivers of real arms fill them: topics of several publishers, types that only the bag defines, targets among the frames of /tf."""

from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mbcacq.recording.datasets import quaternions

# ur_robot_driver publishes the joints in the order of its hardware interfaces, kuka_lbr_fri (lbr_fri_ros2_stack) with numbers.
UR_ORDER = ("shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint", "shoulder_pan_joint")
UR_AXIS = (1, 2, 3, 4, 5, 0)
TAG, CAMERA = "tag36h11:0", "camera_color_optical_frame"
EPOCH = 1_764_000_000


class _BagWriter:
    def __init__(self, writer: Writer) -> None:
        self.writer, self.store = writer, get_typestore(Stores.ROS2_HUMBLE)
        self.kind = self.store.types
        self._topics = {}

    def define(self, text: str, name: str) -> None:
        self.store.register(get_types_from_msg(text, name))

    def write(self, topic: str, t: float, message) -> None:
        if topic not in self._topics:
            self._topics[topic] = self.writer.add_connection(topic, message.__msgtype__, typestore=self.store)
        stamp = int(1e9 * EPOCH) + int(round(1e9 * t))
        self.writer.write(self._topics[topic], stamp, self.store.serialize_cdr(message, message.__msgtype__))

    def header(self, t: float, frame: str):
        seconds = int(np.floor(t))
        return self.kind["std_msgs/msg/Header"](self.kind["builtin_interfaces/msg/Time"](EPOCH + seconds, int(1e9 * (t - seconds))), frame)

    def joint_state(self, t, names, position, effort):
        kind = self.kind["sensor_msgs/msg/JointState"]
        return kind(self.header(t, "base_link"), list(names), np.array(position, float), np.zeros(len(names)), np.array(effort, float))

    def transform(self, t, parent, child, T):
        """T: (4, 4) mm."""
        w, x, y, z = quaternions.from_matrix(T[None, :3, :3])[0]
        place = self.kind["geometry_msgs/msg/Vector3"](*(1e-3 * T[:3, 3]))
        turn = self.kind["geometry_msgs/msg/Quaternion"](x, y, z, w)
        inner = self.kind["geometry_msgs/msg/Transform"](place, turn)
        return self.kind["geometry_msgs/msg/TransformStamped"](self.header(t, parent), child, inner)


def write_ur_bag(path: Path, plugin: StoragePlugin, t: np.ndarray, q: np.ndarray, seen_t: np.ndarray, T_camera_tag: np.ndarray) -> None:
    """t (T,) s, q (T, 6) rad; seen_t (K,) and T_camera_tag (K, 4, 4) mm: a marker that apriltag_ros puts among the frames of the arm."""
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        bag = _BagWriter(writer)
        bag.define("uint8 pin\nbool state\n", "ur_msgs/msg/Digital")
        bag.write("/joint_states", t[0] - 0.01, bag.joint_state(t[0] - 0.01, UR_ORDER, np.full(6, np.nan), np.full(6, np.nan)))
        marks = iter(zip(seen_t.tolist(), T_camera_tag, strict=True))
        mark = next(marks, None)
        for k, (time, angles) in enumerate(zip(t.tolist(), q, strict=True)):
            bag.write("/joint_states", time, bag.joint_state(time, UR_ORDER, angles[list(UR_AXIS)], np.linspace(-2, 2, 6)))
            if k % 5 == 0:
                bag.write("/joint_states", time, bag.joint_state(time, ["finger_joint"], [0.3], [0.0]))
                bag.write("/speed_scaling_state_broadcaster/speed_scaling", time, bag.kind["std_msgs/msg/Float64"](100.0))
                bag.write("/io_and_status_controller/pin", time, bag.kind["ur_msgs/msg/Digital"](3, True))
                arm = [bag.transform(time, "base_link", "shoulder_link", np.eye(4))]
                bag.write("/tf", time, bag.kind["tf2_msgs/msg/TFMessage"](arm))
            while mark is not None and mark[0] <= time:
                bag.write("/tf", mark[0], bag.kind["tf2_msgs/msg/TFMessage"]([bag.transform(mark[0], CAMERA, TAG, mark[1])]))
                mark = next(marks, None)


def write_lbr_bag(path: Path, plugin: StoragePlugin, t: np.ndarray, q: np.ndarray, seen_t: np.ndarray, xyz: np.ndarray) -> None:
    """t (T,) s, q (T, 7) rad; seen_t (K,) and xyz (K, 3) mm: a reflector that a tracker publishes as PointStamped."""
    names = [f"lbr_A{i}" for i in range(1, 8)]
    shuffled = [3, 0, 6, 1, 5, 2, 4]
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        bag = _BagWriter(writer)
        bag.define("int8 session_state\nfloat64 sample_time\nfloat64[7] measured_joint_position\n", "lbr_fri_idl/msg/LBRState")
        for time, angles in zip(t.tolist(), q, strict=True):
            bag.write("/lbr/joint_states", time, bag.joint_state(time, [names[i] for i in shuffled], angles[shuffled], np.full(7, np.nan)))
            bag.write("/lbr/state", time, bag.kind["lbr_fri_idl/msg/LBRState"](4, 0.01, angles))
        for time, point in zip(seen_t.tolist(), 1e-3 * xyz, strict=True):
            place = bag.kind["geometry_msgs/msg/Point"](*point)
            bag.write("/tracker/point", time, bag.kind["geometry_msgs/msg/PointStamped"](bag.header(time, "tracker"), place))


def stops_and_goes(stops: np.ndarray, rest_s: float, move_s: float, rate: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    """t (T,) s and q (T, n) of an arm that rests at each row of ``stops`` and moves smoothly between them, ever faster or slower."""
    rng = np.random.default_rng(3)
    q = [np.repeat(stops[:1], int(rate * rest_s), axis=0)]
    for before, after in zip(stops[:-1], stops[1:], strict=True):
        s = np.linspace(0, 1, int(rate * move_s * rng.uniform(0.5, 1.7)))[:, None]
        q += [before + (3 * s**2 - 2 * s**3) * (after - before), np.repeat(after[None], int(rate * rest_s), axis=0)]
    out = np.concatenate(q)
    return np.arange(len(out)) / rate, out


def at_times(t: np.ndarray, q: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(K, n) angles at other times."""
    return np.stack([np.interp(times, t, column) for column in q.T], axis=1)

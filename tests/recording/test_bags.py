"""Recordings of ROS: what was written into a bag message by message comes back as poses and as a motion."""

import struct

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from mbcacq.errors import ConfigError
from mbcacq.recording import load_observations, load_whole_trajectories
from mbcacq.recording.datasets.bag import Bag, BagSpec, _points

ROBOT = """
robot:
  name: two axes
  links:
    - {theta_deg: 0, d_mm: 100, a_mm: 0, alpha_deg: 90, mass_kg: 5}
    - {theta_deg: 0, d_mm: 0, a_mm: 300, alpha_deg: 0, mass_kg: 3}
"""
TRACKER = f"""format: mbcacq-observation-set/1
measurement: target_in_base
{ROBOT}
artefacts: [{{id: target, balls: [{{id: 1, centre_mm: [0, 0, 0]}}]}}]
stations: [{{id: tracker, artefact: target}}]
bag: {{file: run, joints: [shoulder, elbow], target: /tracker/pose}}
"""
MOTION = f"""format: mbcacq-trajectory-set/1
{ROBOT}
bag: {{file: run, joints: [shoulder, elbow]}}
"""
STEP, STILL, MOVE = 0.01, 100, 50  # s, samples at rest and on the way
POSES = np.array([[0.1, -0.4], [0.5, 0.2], [-0.3, 0.7]])
PLACES = np.array([[0.5, 0.25, 1.0], [0.4, 0.1, 0.9], [0.6, -0.2, 1.1]])  # m


def path():
    """Angles (T, 2) that rest at each pose, and the number of the pose at rest, -1 on the way."""
    q, at = [], []
    for i, pose in enumerate(POSES):
        if i:
            s = np.linspace(0, 1, MOVE)[:, None]
            q.append(POSES[i - 1] * (1 - s) + pose * s)
            at.append(np.full(MOVE, -1))
        q.append(np.tile(pose, (STILL, 1)))
        at.append(np.full(STILL, i))
    return np.concatenate(q), np.concatenate(at)


@pytest.fixture(params=[StoragePlugin.SQLITE3, StoragePlugin.MCAP], ids=["sqlite", "mcap"])
def bag(request, tmp_path):
    return write_bag(tmp_path, request.param)


def write_bag(folder, plugin, quaternion=(0.0, 0.0, 0.6, 0.8)):
    """A bag of the path in ``folder``. quaternion: x, y, z, w of the target in every message, with both signs."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = store.types
    header = lambda t: kind["std_msgs/msg/Header"](kind["builtin_interfaces/msg/Time"](int(t), int(round(t % 1 * 1e9))), "base")  # noqa: E731
    q, at = path()
    with Writer(folder / "run", version=9, storage_plugin=plugin) as writer:
        states = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        poses = writer.add_connection("/tracker/pose", "geometry_msgs/msg/PoseStamped", typestore=store)
        for k, (angles, i) in enumerate(zip(q, at, strict=True)):
            t = 1000.0 + STEP * k
            message = kind["sensor_msgs/msg/JointState"](
                header(t), ["elbow", "shoulder"], angles[::-1].copy(), np.zeros(2), np.array([7.0, 5.0])
            )
            writer.write(states, int(t * 1e9), store.serialize_cdr(message, message.__msgtype__))
            if i >= 0:
                turn = 1.0 if k % 2 else -1.0  # both quaternions of one rotation
                pose = kind["geometry_msgs/msg/Pose"](
                    kind["geometry_msgs/msg/Point"](*PLACES[i]), kind["geometry_msgs/msg/Quaternion"](*(turn * c for c in quaternion))
                )
                message = kind["geometry_msgs/msg/PoseStamped"](header(t), pose)
                writer.write(poses, int(t * 1e9), store.serialize_cdr(message, message.__msgtype__))
    return folder


def test_damaged_bags_are_refused_in_words(bag):
    (bag / "cell.yaml").write_text(MOTION)
    file = next(p for p in (bag / "run").iterdir() if p.suffix in (".db3", ".mcap"))
    whole, rng = file.read_bytes(), np.random.default_rng(7)
    refused = 0
    for _ in range(25):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), 40):
            data[at] ^= 1 << rng.integers(8)
        file.write_bytes(data[: rng.integers(len(data) // 2, len(data))])
        try:
            load_whole_trajectories(bag)
        except ConfigError:
            refused += 1
    assert refused > 15


def test_a_chunk_that_is_not_what_its_checksum_says_is_damaged(tmp_path):
    """The ordinary damage of an MCAP file whose writer adds checksums."""
    write_bag(tmp_path, StoragePlugin.MCAP)
    (tmp_path / "cell.yaml").write_text(MOTION)
    file = next(p for p in (tmp_path / "run").iterdir() if p.suffix == ".mcap")
    data, at = bytearray(file.read_bytes()), 8
    while at < len(data) - 8:
        kind, length = struct.unpack_from("<BQ", data, at)
        if kind == 6:  # a chunk: two times and a size of 8 bytes each, then the CRC, 0 where there is none
            struct.pack_into("<I", data, at + 9 + 24, 0xDEADBEEF)
        at += 9 + length
    file.write_bytes(data)
    with pytest.raises(ConfigError, match="the bag cannot be read, it is damaged .*hecksum mismatch"):
        load_whole_trajectories(tmp_path)


def test_a_flipped_bit_in_an_angle_is_seen_by_the_speed_it_would_need(tmp_path):
    write_bag(tmp_path, StoragePlugin.SQLITE3)
    (tmp_path / "cell.yaml").write_text(MOTION)
    file = next(p for p in (tmp_path / "run").iterdir() if p.suffix == ".db3")
    data = bytearray(file.read_bytes())
    angle = np.array([-0.4, 0.1]).tobytes()
    at = [i for i in range(len(data)) if data.startswith(angle, i)]
    data[at[len(at) // 2] + 6] ^= 0x10  # exponent of the elbow: -0.4 becomes -0.2, 20 rad/s away
    file.write_bytes(data)
    with pytest.raises(ConfigError, match="no arm moves so; the message is damaged"):
        load_whole_trajectories(tmp_path)


def test_each_standstill_is_a_pose_with_its_target(bag):
    (bag / "cell.yaml").write_text(TRACKER)
    obs = load_observations(bag)
    assert obs.rotation is not None
    assert obs.time_s is not None
    np.testing.assert_allclose(obs.q, POSES, atol=1e-12)
    np.testing.assert_allclose(obs.xyz, 1e3 * PLACES)
    np.testing.assert_allclose(obs.rotation[0][:2, :2], [[0.28, -0.96], [0.96, 0.28]], atol=1e-12)
    assert obs.time_s[1] - obs.time_s[0] == pytest.approx(STEP * (STILL + MOVE), abs=1e-3)


def test_an_orientation_that_was_never_measured_is_none(tmp_path):
    """Instruments of positions publish the identity with every pose."""
    write_bag(tmp_path, StoragePlugin.SQLITE3, (0.0, 0.0, 0.0, 1.0))
    (tmp_path / "cell.yaml").write_text(TRACKER)
    obs = load_observations(tmp_path)
    assert obs.rotation is None
    np.testing.assert_allclose(obs.xyz, 1e3 * PLACES)


def test_the_joint_states_of_a_bag_are_a_motion(bag):
    (bag / "cell.yaml").write_text(MOTION)
    (motion,) = load_whole_trajectories(bag)
    assert motion.torque is not None
    np.testing.assert_allclose(motion.q, path()[0])
    assert motion.torque[:, 0].tolist() == [5.0] * len(motion.q)
    assert motion.time_s[-1] == pytest.approx(STEP * (len(motion.q) - 1))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "/tracker/pose",
            "/tracker/position",
            r"^[^:]*run: the topic /tracker/position is not in the bag \(there: /joint_states, /tracker/pose\)",
        ),
        ("/tracker/pose", "/joint_states", r"holds sensor_msgs/msg/JointState, not geometry_msgs"),
        ("[shoulder, elbow]", "[shoulder, wrist]", r"^[^:]*run: the topic /joint_states has no joint wrist \(there: elbow, shoulder\)"),
        ("file: run", "file: walk", r"walk does not exist"),
        ("target: /tracker/pose", "standstill: {seconds: 5}, target: /tracker/pose", r"never stands still for 5 s"),
    ],
)
def test_a_bag_that_is_not_as_described_is_refused_with_the_reason(bag, old, new, message):
    (bag / "cell.yaml").write_text(TRACKER.replace(old, new))
    with pytest.raises(ConfigError, match=message):
        load_observations(bag)


def test_a_topic_without_a_message_is_named(tmp_path):
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
    (tmp_path / "cell.yaml").write_text(MOTION)
    with pytest.raises(ConfigError, match="the topic /joint_states holds no message"):
        load_whole_trajectories(tmp_path)


@pytest.mark.parametrize(("step", "offset"), [(12, 8), (16, 8), (12, 10)])
def test_a_cloud_that_announces_more_than_it_holds_is_damaged(tmp_path, step, offset):
    """Three points of 12 bytes: there are not enough bytes for points of 16, and a field that begins at 10 ends beyond its point."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = store.types
    with Writer(tmp_path / "run", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topic = writer.add_connection("/cloud", "sensor_msgs/msg/PointCloud2", typestore=store)
        header = kind["std_msgs/msg/Header"](kind["builtin_interfaces/msg/Time"](1, 0), "scanner")
        fields = [kind["sensor_msgs/msg/PointField"](axis, at, 7, 1) for axis, at in (("x", 0), ("y", 4), ("z", offset))]
        data = np.arange(9, dtype="<f4").view(np.uint8)
        message = kind["sensor_msgs/msg/PointCloud2"](header, 1, 3, fields, False, step, 3 * step, data, True)
        writer.write(topic, 10**9, store.serialize_cdr(message, message.__msgtype__))
    found = Bag(tmp_path, BagSpec(file="run"))
    read = found.messages("/cloud", ("sensor_msgs/msg/PointCloud2",), lambda _, m: _points(found, "/cloud", m))
    if (step, offset) == (12, 8):
        assert [points.tolist() for points in read] == [[[0, 1, 2], [3, 4, 5], [6, 7, 8]]]
    else:
        with pytest.raises(ConfigError, match="a cloud of /cloud announces 3 points of .* bytes and holds 36 bytes"):
            list(read)

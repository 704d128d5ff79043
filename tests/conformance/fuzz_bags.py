"""Parsers of ROS recordings: MCAP and SQLite bags as motions and as observations."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from copy import deepcopy
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from fuzz_target import Target, in_file

from mbcacq.model.trajectory import Trajectory
from mbcacq.recording.datasets.bag import Bag, BagSpec, _points, bag_of, trajectory_columns
from mbcacq.recording.datasets.cell_yaml import parse_cell
from mbcacq.recording.datasets.observation_set import read_observations
from mbcacq.recording.datasets.trajectory_set import read_trajectory_set

ROBOT = """robot:
  name: two axes
  links:
    - {theta_deg: 0, d_mm: 100, a_mm: 0, alpha_deg: 90}
    - {theta_deg: 0, d_mm: 0, a_mm: 300, alpha_deg: 0}
"""
MOTION = f"format: mbcacq-trajectory-set/1\n{ROBOT}bag: {{file: RUN}}\n"
TRACKER = f"""format: mbcacq-observation-set/1
measurement: target_in_base
{ROBOT}artefacts: [{{id: target, balls: [{{id: 1, centre_mm: [0, 0, 0]}}]}}]
stations: [{{id: tracker, artefact: target}}]
bag: {{file: RUN, target: /pose, standstill: {{speed_deg_s: 30, seconds: 0.01}}}}
"""
MESSAGES = 8  # of each topic


@cache
def bag_files(plugin: str, messages: int = MESSAGES, x_m: float = 0.5, qw: float = 0.8) -> dict[str, bytes]:
    """The files of a small bag of joint states and poses. plugin: 'MCAP' or 'SQLITE3'; x_m, qw: of the target."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = store.types
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "run"
        with Writer(folder, version=9, storage_plugin=StoragePlugin[plugin]) as writer:
            states = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
            poses = writer.add_connection("/pose", "geometry_msgs/msg/PoseStamped", typestore=store)
            for k in range(messages):
                stamp = 10_000_000 * (k + 100)
                header = kind["std_msgs/msg/Header"](kind["builtin_interfaces/msg/Time"](1, 10_000_000 * k), "base")
                state = kind["sensor_msgs/msg/JointState"](header, ["a", "b"], np.array([0.1, -0.4]), np.zeros(2), np.array([7.0, 5.0]))
                writer.write(states, stamp, store.serialize_cdr(state, state.__msgtype__))
                turned = kind["geometry_msgs/msg/Pose"](
                    kind["geometry_msgs/msg/Point"](x_m, 0.25, 1.0), kind["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.6, qw)
                )
                pose = kind["geometry_msgs/msg/PoseStamped"](header, turned)
                writer.write(poses, stamp, store.serialize_cdr(pose, pose.__msgtype__))
        return {path.name: path.read_bytes() for path in folder.iterdir()}


@cache
def cloud_bag() -> bytes:
    """An MCAP file of one cloud of three points."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kind = store.types
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "run"
        with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            topic = writer.add_connection("/cloud", "sensor_msgs/msg/PointCloud2", typestore=store)
            header = kind["std_msgs/msg/Header"](kind["builtin_interfaces/msg/Time"](1, 0), "scanner")
            fields = [kind["sensor_msgs/msg/PointField"](axis, 4 * i, 7, 1) for i, axis in enumerate("xyz")]
            data = np.arange(9, dtype="<f4").view(np.uint8)
            cloud = kind["sensor_msgs/msg/PointCloud2"](header, 1, 3, fields, False, 12, 36, data, True)
            writer.write(topic, 10**9, store.serialize_cdr(cloud, cloud.__msgtype__))
        return (folder / "run.mcap").read_bytes()


def clouds(path: Path) -> object:
    """Points of every cloud of a bag."""
    found = Bag(path.parent, BagSpec(file=path.name))
    return list(found.messages("/cloud", ("sensor_msgs/msg/PointCloud2",), lambda _, message: _points(found, "/cloud", message)))


def remember_what_is_unchanged() -> None:
    """The definitions of messages and ``metadata.yaml`` take the library more time than the bytes behind them, and stay as they are in
    most of the inputs."""
    from rosbags.highlevel import anyreader
    from rosbags.rosbag2 import metadata, reader
    from ruamel.yaml import YAML

    anyreader.get_types_from_msg = lru_cache(maxsize=64)(anyreader.get_types_from_msg)  # type: ignore[attr-defined]
    parsed = lru_cache(maxsize=64)(lambda text: YAML(typ="safe").load(text))

    class Remembering:
        def __init__(self, typ: str) -> None:
            pass

        def load(self, text: str) -> object:
            return deepcopy(parsed(text))

    reader.YAML = metadata.YAML = Remembering  # type: ignore[attr-defined, assignment, misc]


def bag_targets() -> list[Target]:
    """All of them."""
    mcap, sqlite = bag_files("MCAP"), bag_files("SQLITE3")
    remember_what_is_unchanged()

    def motion(name: str) -> Callable[[Path], object]:
        robot = parse_cell(TRACKER.replace("RUN", name)).robot
        spec = bag_of(MOTION.replace("RUN", name), Path())
        return lambda folder: Trajectory(robot, **trajectory_columns(folder, spec, robot.n))

    def observations(folder: Path) -> object:
        return read_observations(folder, cell, text)

    of_mcap, text = motion("run.mcap"), TRACKER.replace("RUN", "run.mcap")
    cell = parse_cell(text)
    beside = {f"run/{name}": data for name, data in sqlite.items()}
    whole = {"cell.yaml": MOTION.replace("RUN", "run").encode()}

    def in_sqlite(name: str, read: Callable[[Path], object]) -> Callable[[bytes], object]:
        others = {other: data for other, data in beside.items() if other != f"run/{name}"}
        return in_file(f"run/{name}", lambda path: read(path.parents[1]), whole | others)

    return [
        Target("bag MCAP, motion", (mcap["run.mcap"],), in_file("run.mcap", lambda path: of_mcap(path.parent))),
        Target("bag MCAP, observations", (mcap["run.mcap"],), in_file("run.mcap", lambda path: observations(path.parent))),
        Target("bag SQLite, motion", (sqlite["run.db3"],), in_sqlite("run.db3", motion("run"))),
        Target("bag metadata.yaml", (sqlite["metadata.yaml"],), in_sqlite("metadata.yaml", read_trajectory_set)),
        Target("bag MCAP, clouds", (cloud_bag(),), in_file("clouds.mcap", clouds)),
    ]

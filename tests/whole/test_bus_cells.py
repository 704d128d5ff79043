"""Whole runs with motorised positioners and sensors that the plan describes, on the wire: Modbus TCP and RTU, serial terminals."""

import csv

import pytest
from dry_runs import plan_file, recorded
from typed_command import mbcacq

from mbcacq.recording.run_folder.gaps import find_gaps

SERIAL = {
    "driver": "serial",
    "options": {
        "port": "/dev/ttyUSB7",
        "stations": {"p1": 0.0, "p2": 152.5},
        "scale": 0.01,
        "move": {"send": "MA {raw:.0f}\r\n", "reply": "OK"},
        "position": {"send": "?P\r\n", "reply": r"P=(?P<raw>[-+]?\d+)"},
        "fault": {"send": "?E\r\n", "reply": r"E=(?P<code>[1-9]\d*)"},
    },
}
MODBUS = {
    "driver": "modbus",
    "options": {
        "serial": "/dev/ttyUSB8",
        "stations": {"p1": 0.0, "p2": 152.5},
        "position": {"address": 10, "type": "float32"},
        "actual": {"address": 20, "table": "input", "type": "float32"},
        "in_position": {"address": 3, "table": "discrete"},
        "ready": {"address": 4, "table": "discrete"},
    },
}
PROBES = [
    {
        "driver": "modbus",
        "options": {
            "host": "127.0.0.1",
            "port": 5020,
            "values": {"robot_C": {"address": 0, "table": "input", "type": "int16", "scale": 0.1, "unit": "C", "valid": [-20, 80]}},
        },
    },
    {
        "driver": "serial",
        "options": {
            "port": "/dev/ttyUSB9",
            "ask": "READ?\r\n",
            "line": r"T=(?P<air_C>[-+0-9.]+)",
            "scale": {"air_C": 0.5},
            "identity": {"ask": "*IDN?\r\n", "expect": "PROBE 1"},
        },
    },
]


@pytest.mark.parametrize("positioner", [SERIAL, MODBUS], ids=["serial", "modbus-rtu"])
def test_temperatures_and_a_motorised_stand_reach_the_observation_set(tmp_path, positioner):
    def change(plan):
        plan["positioner"], plan["sensors"] = positioner, PROBES
        plan["stations"].append({"id": "p2", "artefact": "mbc", "pose_in_base": {"translation_mm": [560, 160, 120], "abc_deg": [20, 0, 0]}})
        plan["steps"] = [plan["steps"][1] | {"stations": ["p1", "p2"], "views": plan["steps"][1]["views"][:3]}]
        plan["exposures"] = 1
        plan["fake"] = {"climate": {"time_scale": 200.0}}

    run = tmp_path / "run"
    recorded(plan_file(tmp_path, change), run)
    assert find_gaps(run) == []
    assert mbcacq("export", run, "--observations", tmp_path / "set").returncode == 0
    with (tmp_path / "set" / "poses.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["station"] for row in rows] == ["p1"] * 3 + ["p2"] * 3
    robot, air = [float(r["robot_C"]) for r in rows], [float(r["air_C"]) for r in rows]
    assert all(18 < t < 25 for t in air)
    assert robot == sorted(robot)
    assert robot[-1] > robot[0] + 0.5  # the arm warms up

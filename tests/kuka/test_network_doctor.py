"""What ``mbcacq doctor`` says of the robot's options."""

from dataclasses import replace
from pathlib import Path

from mbcacq.doctor import devices
from mbcacq.plan import load

PLAN = Path(__file__).parents[2] / "plans" / "kuka.yaml"


def test_the_doctor_asks_for_the_controllers_address_on_a_network():
    loaded = load(PLAN)
    robot = loaded.plan.robot.model_copy(update={"options": {"bind": "172.31.1.100", "port": 49152}})
    lines = list(devices.lines(replace(loaded, plan=loaded.plan.model_copy(update={"robot": robot})), arm=False))
    assert [line.level for line in lines] == ["error"]
    assert "controller_ip is missing" in f"{lines[0]}"

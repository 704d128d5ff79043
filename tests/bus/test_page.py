"""Every description in docs/positioners-and-sensors.md is one that the drivers take and the fake cell can play."""

import re
from pathlib import Path

import pytest
import yaml
from mbcacq_bus.serial_positioner import SerialPositionerOptions
from mbcacq_fakes.protocols.bus.line_for import template
from mbcacq_fakes.protocols.bus.serial_positioner import FakeSerialPositioner

from mbcacq.devices import create, parse_options

PAGE = (Path(__file__).parents[2] / "docs" / "positioners-and-sensors.md").read_text()
BLOCKS = [yaml.safe_load(text) for text in re.findall(r"^```yaml\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)]
USES = [("positioners", b["positioner"]) for b in BLOCKS if "positioner" in b] + [
    ("sensors", s) for b in BLOCKS for s in b.get("sensors", ())
]


@pytest.mark.parametrize(("kind", "use"), USES, ids=[f"{kind} {use['driver']}" for kind, use in USES])
def test_the_page_can_be_copied(kind, use):
    device = create(kind, use["driver"], use.get("model", ""), use.get("options", {}))
    assert device.describe().fields
    options = use.get("options", {})
    if (kind, use["driver"]) == ("positioners", "serial"):
        FakeSerialPositioner(parse_options(SerialPositionerOptions, "x", options)).stop()
    if (kind, use["driver"]) == ("sensors", "serial"):
        assert template(options["line"])


def test_it_shows_each_driver():
    assert {(kind, use["driver"]) for kind, use in USES} == {
        ("positioners", "manual"),
        ("positioners", "modbus"),
        ("positioners", "serial"),
        ("sensors", "modbus"),
        ("sensors", "serial"),
    }

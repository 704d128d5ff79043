"""The example package for Universal Robots: literal bytes of RTDE, the suite every driver must pass, a dry run with its own fake."""

import sys
from pathlib import Path

import numpy as np
import pytest
from dry_runs import plan_file, recorded, ur10
from installed_package import install

from mbcacq.conformance import CHECKS, check
from mbcacq.devices import ConfigError, ConnectError, MotionLimits, SafetyStop

PACKAGE = Path(__file__).parents[2] / "examples" / "ur_rtde_driver"
HOME_DEG = np.array([0.0, -90, 90, -90, -90, 0])
LIMITS = MotionLimits(*(np.radians(np.full(6, v)) for v in (60.0, 200.0, 2000.0)), settle_s=0.05)


@pytest.fixture(autouse=True)
def _installed(tmp_path_factory, monkeypatch):
    site = tmp_path_factory.mktemp("ur")
    install(site, PACKAGE)
    monkeypatch.syspath_prepend(str(site))
    yield
    for name in [name for name in sys.modules if name.split(".")[0] == "mbcacq_ur_rtde"]:
        del sys.modules[name]


def test_packages_are_the_guide_s_bytes():
    from mbcacq_ur_rtde import protocol

    assert protocol.package(protocol.REQUEST_PROTOCOL_VERSION, b"\x00\x02") == bytes.fromhex("00 05 56 00 02")
    assert protocol.package(protocol.START) == bytes.fromhex("00 03 53")
    assert (
        protocol.setup_outputs(("timestamp", "actual_q"), 125.0)
        == bytes.fromhex("00 1d 4f 40 5f 40 00 00 00 00 00") + b"timestamp,actual_q"
    )
    assert protocol.setup_inputs(("input_int_register_0",)) == bytes.fromhex("00 17 49") + b"input_int_register_0"


def test_a_data_package_is_read_by_its_recipe():
    from mbcacq_ur_rtde import protocol

    recipe = protocol.recipe(("timestamp", "runtime_state"), b"\x01DOUBLE,UINT32")
    assert recipe.unpack(bytes.fromhex("01 40 5e dd 2f 1a 9f be 77 00 00 00 02")) == {"timestamp": 123.456, "runtime_state": 2}
    assert recipe.pack((123.456, 2)) == bytes.fromhex("01 40 5e dd 2f 1a 9f be 77 00 00 00 02")
    with pytest.raises(protocol.Malformed):
        recipe.unpack(b"\x02" + bytes(12))
    with pytest.raises(protocol.Malformed, match="speed is NOT_FOUND"):
        protocol.recipe(("speed",), b"\x00NOT_FOUND")


def test_packages_are_cut_where_their_length_says():
    from mbcacq_ur_rtde import protocol

    packages, stream = protocol.Packages(), bytes.fromhex("00 04 53 01 00 05 56 00 02")
    assert packages.feed(stream[:6]) == [(83, b"\x01")]
    assert packages.feed(stream[6:]) == [(86, b"\x00\x02")]
    with pytest.raises(protocol.Malformed, match="a package of 1 bytes"):
        packages.feed(b"\x00\x01\x53")


@pytest.fixture
def opened():
    from mbcacq_ur_rtde import conformance

    return conformance.opened


@pytest.mark.parametrize("each", CHECKS, ids=lambda each: each.__name__)
def test_it_passes_the_suite_every_driver_must_pass(each):
    from mbcacq_ur_rtde.conformance import BENCH, EXCUSED

    result = check(BENCH, each)
    assert result.status == ("skipped" if each.__name__ in EXCUSED else "passed"), str(result)


def test_a_target_beyond_the_limits_moves_nothing(opened):
    with opened() as stand, stand.make(limits_deg=[[-100, 100]] * 6) as robot:
        with pytest.raises(SafetyStop, match=r"A2 would go to -101.000°, beyond its limits -100..100°; nothing was moved"):
            robot.move_to(np.radians([0, -101, 90, -90, -90, 0]), LIMITS)
        assert np.degrees(robot.state().q) == pytest.approx(HOME_DEG)


def test_without_limits_it_is_not_even_constructed(opened):
    with opened() as stand, pytest.raises(ConfigError, match="limits_deg of six axes are needed"):
        stand.make(limits_deg=None)


def test_a_controller_without_its_program_says_what_to_load():
    from mbcacq_ur_rtde.driver import UrRtde
    from mbcacq_ur_rtde.fake import FakeUr

    with FakeUr() as fake:
        fake.running = False
        robot = UrRtde("arm", "", {"address": "127.0.0.1", "port": fake.port, "limits_deg": [[-360, 360]] * 6, "connect_timeout_s": 0.3})
        with pytest.raises(ConnectError, match="no program runs; load mbcacq_ur.script"):
            robot.connect()


def test_a_dry_run_drives_it_through_its_own_fake(tmp_path):
    from mbcacq.acquisition.cell_devices import create_devices
    from mbcacq.plan import load

    path = plan_file(tmp_path, ur10("ur_rtde_example", {"address": "192.168.0.10"}))
    assert type(create_devices(load(path)).robot).__name__ == "UrRtde"
    assert recorded(path, tmp_path / "run").n_poses == 4

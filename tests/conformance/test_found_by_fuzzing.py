"""Inputs of the kinds that mutation found to end in a foreign error: each is refused by name, or read as what it says."""

from __future__ import annotations

import re
import tracemalloc

import pytest
from fuzz_bags import bag_files
from fuzz_descriptions import CALIBRATION, MJCF, URDF
from fuzz_instruments import easy_handeye_samples
from fuzz_programs import LS, MOD, SCRIPT, SRC
from fuzz_tables import DH, FLEET, fleet_parquet, joint_dat, joint_messages
from fuzz_targets import targets

from mbcacq.files.bounded_read import read_bounded


def mcap_bag(**what: float) -> bytes:
    """The small bag, with one thing about its messages changed."""
    return bag_files("MCAP", **what)["run.mcap"]


ENDLESS = b"9" * 400
REFUSED = {
    "an exponent without digits": ("log of joints, KRL", joint_dat().replace(b"A1 0.0467", b"A1 0.0467e")),
    "an angle without bound": ("log of joints, KRL", joint_dat().replace(b"A1 0.0467", b"A1 1e999")),
    "a message with a word": ("log of joints, messages", joint_messages().replace(b"[0.000814", b"[left")),
    "a message with a nan": ("log of joints, messages", joint_messages().replace(b"[0.000814", b"[nan")),
    "a unit to the power of zero": ("DH rows CSV", DH.replace(b"0,400", b"0,400mm^0")),
    "a whole number that is no float": ("robot UR calibration", CALIBRATION.replace(b"z: 0.18083", b"z: " + ENDLESS)),
    "an entry that is no number": ("robot UR calibration", CALIBRATION.replace(b"z: 0.18083", b"z: .nan")),
    "a name that is not UTF-8": ("robot MJCF", MJCF.replace(b"upper", b"up\xb2er")),
    "a place without bound": ("robot MJCF", MJCF.replace(b'pos="0.1 0 0.5"', b'pos="1e300 0 0.5"')),
    "a joint a light year away": ("robot URDF", URDF.replace(b'xyz="0.1 0 0.4"', b'xyz="9e15 0 0.4"')),
    "a recording whose name no system takes": ("table of recordings", FLEET.replace(b"b/c.rrd", b"x" * 300)),
    "a KRL angle of 400 digits": ("program KRL", SRC.replace(b"A1 10", b"A1 " + ENDLESS)),
    "a URScript angle of 400 digits": ("program URScript", SCRIPT.replace(b"[0.1,", b"[" + ENDLESS + b",")),
    "an LS angle of 400 digits": ("program LS", LS.replace(b"J1=     0.000", b"J1=  " + ENDLESS + b".0")),
    "a fleet without times": ("fleet Parquet", fleet_parquet(without=("time",))),
    "an error without its uncertainty": ("fleet Parquet", fleet_parquet(without=("std.theta_1",))),
    "a sample that is none": ("hand-eye samples", easy_handeye_samples().replace(b"  tracking: {", b"  tracking:\n  other: {", 1)),
    "a sample's quaternion of zeros": ("hand-eye samples", re.sub(rb"rotation: {[^}]*}", b"rotation: {x: 0, y: 0, z: 0, w: 0}", easy_handeye_samples())),
    "a target that no tracker reaches": ("bag MCAP, observations", mcap_bag(x_m=1e300)),
    "a quaternion of no unit length": ("bag MCAP, observations", mcap_bag(qw=1e200)),
    "a single message of the joints": ("bag MCAP, observations", mcap_bag(messages=1)),
}  # fmt: skip


@pytest.mark.parametrize(("name", "data"), REFUSED.values(), ids=REFUSED)
def test_is_refused_by_name(name, data, capfd):
    assert data not in targets()[name].seeds
    assert not targets()[name].run(data)


READ = {
    "a motion without a target": ("program RAPID", MOD.replace(b"MoveAbsJ jp10", b"MoveAbsJ ,jp10;MoveAbsJ jp10")),
    "a heading with the end of a line that YAML knows": ("DH rows CSV", DH.replace(b"mass_kg", "ma\u2028ss".encode())),
    "a heading with a control character": ("DH rows CSV", DH.replace(b"mass_kg", b"ma\x19ss")),
}


@pytest.mark.parametrize(("name", "data"), READ.values(), ids=READ)
def test_is_read_as_what_it_says(name, data):
    assert data not in targets()[name].seeds
    assert targets()[name].run(data)


def test_a_limit_of_a_gigabyte_takes_no_gigabyte(tmp_path):
    (tmp_path / "small.csv").write_bytes(b"a,b\n1,2\n")
    tracemalloc.start()
    assert read_bounded(tmp_path / "small.csv", 1 << 30) == b"a,b\n1,2\n"
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 << 20
    assert len(read_bounded(tmp_path / "small.csv", 3)) == 4

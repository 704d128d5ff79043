"""The live configuration: a client sends back values only, and the sensor merges them."""

from __future__ import annotations

from importlib.resources import files
from xml.etree import ElementTree

import pytest
from mbcacq_fakes.protocols.gocator.files import Files
from mbcacq_fakes.protocols.gocator.replies import CommandRefused
from mbcacq_gocator.configuration import Configuration

from mbcacq.devices import ConfigError, ProtocolError

TEMPLATE = files("mbcacq_fakes.protocols.gocator").joinpath("live.cfg").read_bytes()
# As a vendor's client writes: no limits, no options, no effective values, CRLF.
UPLOAD = (
    b'<?xml version="1.0" encoding="UTF-8"?>\r\n<Configuration version="101">\r\n  <Setup>\r\n'
    b'    <UniformSpacingEnabled>1</UniformSpacingEnabled>\r\n    <Devices>\r\n      <Device role="0" index="0">\r\n'
    b"        <Exposure>2250.000000</Exposure>\r\n      </Device>\r\n    </Devices>\r\n  </Setup>\r\n</Configuration>\r\n"
)


def shape(data: bytes) -> list[tuple[str, tuple[str, ...]]]:
    return [(node.tag, tuple(sorted(node.attrib))) for node in ElementTree.fromstring(data).iter()]


def test_untouched_template_is_served_byte_for_byte():
    assert Files(("a.job",), {}).read("_live.cfg") == TEMPLATE


def test_upload_of_values_keeps_limits_and_every_other_element():
    store = Files(("a.job",), {})
    store.write("_live.cfg", UPLOAD)
    served = store.read("_live.cfg")
    assert shape(served) == shape(TEMPLATE)
    root = ElementTree.fromstring(served)
    exposure = root.find("Setup/Devices/Device/Exposure")
    assert (exposure.text, exposure.get("max")) == ("2250.000000", "100000")
    spacing = root.find("Setup/UniformSpacingEnabled")
    assert (spacing.text, spacing.get("value"), spacing.get("used")) == ("1", "1", "1")
    assert root.findtext("Setup/ScanMode") == "3"
    assert store.modified


def test_stored_jobs_always_have_their_suffix():
    assert Files(("spheres", "spheres.job", "bar"), {}).names() == ["bar.job", "spheres.job"]


def test_loading_a_job_restores_its_settings():
    store = Files(("a.job", "b.job"), {})
    store.write("_live.cfg", UPLOAD)
    store.copy("_live.job", "c.job")
    store.copy("b.job", "_live.job")
    assert (store.loaded_job, store.modified) == ("b.job", False)
    assert store.number("Setup/Devices/Device/Exposure") == 1500
    store.copy("c.job", "_live.job")
    assert store.number("Setup/Devices/Device/Exposure") == 2250


@pytest.mark.parametrize(
    "upload",
    [
        b"not xml",
        b"<Other/>",
        b'<!DOCTYPE x [<!ENTITY a "b">]><Configuration version="101">&a;</Configuration>',
        b'<!DOCTYPE Configuration SYSTEM "file:///etc/passwd"><Configuration/>',
    ],
)
def test_harmful_uploads_are_refused_and_change_nothing(upload):
    store = Files(("a.job",), {})
    with pytest.raises(CommandRefused) as refused:
        store.write("_live.cfg", upload)
    assert refused.value.status == -984
    assert store.read("_live.cfg") == TEMPLATE
    with pytest.raises(ProtocolError):
        Configuration(upload)


def test_driver_writes_values_only_and_changes_nothing_but_the_exposure():
    configuration = Configuration(TEMPLATE)
    assert configuration.exposure_us == 1500
    configuration.set_exposure(3200)
    written = configuration.values_only()
    for told_by_sensor in (b"min=", b"max=", b"options=", b"used=", b"value="):
        assert told_by_sensor not in written
    assert b'<Device role="0" index="0">' in written
    before = [(n.tag, (n.text or "").strip()) for n in ElementTree.fromstring(TEMPLATE).iter()]
    after = [(n.tag, (n.text or "").strip()) for n in ElementTree.fromstring(written).iter()]
    assert [(b, a) for b, a in zip(before, after, strict=True) if b != a] == [(("Exposure", "1500"), ("Exposure", "3200.000000"))]


def test_exposure_outside_the_sensors_limits_is_refused_in_words():
    with pytest.raises(ConfigError, match=r"200000 us is outside the 0 to 100000 us"):
        Configuration(TEMPLATE).set_exposure(200000)


def test_exposure_of_a_job_that_chooses_its_own_is_not_overridden_in_silence():
    dynamic = TEMPLATE.replace(b'<ExposureMode options="0">0<', b'<ExposureMode options="0">2<')
    with pytest.raises(ConfigError, match="uses dynamic exposure, so 900 us cannot be set"):
        Configuration(dynamic).set_exposure(900)


def test_configuration_without_an_exposure_is_named_only_when_one_is_wanted():
    bare = Configuration(b'<Configuration version="101"/>')
    assert bare.exposure_us is None
    with pytest.raises(ProtocolError, match="Exposure"):
        bare.set_exposure(1500)

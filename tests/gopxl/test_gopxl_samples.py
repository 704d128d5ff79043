"""The fake sensor answers the requests of the vendor's sample programs, in their order and by their paths. They are free run by the time
trigger, a recording and its replay, the paths of a laser line sensor, subscriptions and streams."""

import socket
import struct

import msgpack
import numpy as np
import pytest
from gopxl_scene import tilted_plane
from mbcacq_gocator.gopxl import frames, gdp

SCANNER = "/scan/engines/LMILaserLineProfiler/scanners/scanner-0"
SENSOR = f"{SCANNER}/sensors/sensor-0"
SURFACE, PROFILE = (f"scan:LMILaserLineProfiler:scanner-0:top{kind}" for kind in ("UniformSurface", "UniformProfile"))


class Client:
    """Requests, and what comes between their replies."""

    def __init__(self, port):
        self.sock = socket.create_connection(("127.0.0.1", port), 30.0)
        self.stream = self.sock.makefile("rb")
        self.between = []

    def message(self):
        _, _, status, count = struct.unpack("<IHiI", self.stream.read(14))
        found = msgpack.unpackb(self.stream.read(count))
        assert status == found["status"] if "status" in found else status == 1
        return found

    def ask(self, method, path, payload=None, **args):
        self.sock.sendall(frames.request(method, path, payload, args))
        while (found := self.message())["type"] != "response":
            self.between.append(found)
        assert (found["status"], found["path"]) == (1, path)
        return found["payload"]

    def next_between(self):
        """The next message that nobody asked for."""
        return self.between.pop(0) if self.between else self.message()

    def close(self):
        self.stream.close()
        self.sock.close()


@pytest.fixture
def client(sensor):
    one = Client(sensor.ports.control)
    assert one.ask("read", "/version")["apiVersion"]
    assert one.ask("read", "/environ/info")["applicationType"] == 0
    assert one.ask("read", "/environ/remoteController")["remoteConnected"] is False
    yield one
    one.close()


def received(client, source, key):
    """One data set of ``source``, as the samples get it: {type: message}."""
    client.ask("update", "/controls/gocator", {"enabled": True})
    assert not [o for o in client.ask("read", "/controls/gocator/outputs")["map"] if o["source"].endswith(key)]
    client.ask("call", "/controls/gocator/outputs/commands/add", {"source": source, "outputId": 0, "autoShift": True})
    found = {}
    with socket.create_connection(("127.0.0.1", client.ask("read", "/controls/gocator")["serverPort"]), 30.0) as sock:
        if client.ask("read", "/system")["runState"] == 0:
            client.ask("call", "/system/commands/start", {})
        with sock.makefile("rb") as data:
            last = False
            while not last:
                size = data.read(4)
                whole = size + data.read(struct.unpack("<I", size)[0] - 4)
                common = gdp.parse_common(memoryview(whole))
                found[common.source], last = whole, common.last
    client.ask("call", "/system/commands/stop", {})
    return found


def test_receive_surface_gets_a_surface_in_free_run(client, sensor):
    assert client.ask("read", "/replay/playback")["enabled"] is False
    assert client.ask("read", SCANNER)["parameters"]["scanModeSettings"]["scanMode"] == 3
    message = received(client, SURFACE, "UniformSurface")[SURFACE]
    collected = gdp.GdpSet()
    gdp.add(collected, memoryview(message), gdp.parse_common(memoryview(message)))
    assert message[4] == 14
    assert collected.surface.raw.size > 200
    assert not sensor.resources.running


def test_replay_data_records_for_a_while_and_shows_the_same_frames_again(client, sensor):
    client.ask("update", "/replay/recording", {"enabled": True})
    trigger = {"source": 0, "maxFrameRateEnabled": False, "frameRate": 50}
    client.ask("update", SCANNER, {"parameters": {"triggerSettings": trigger}})
    client.ask("call", "/system/commands/start", {})
    while len(sensor.resources.recorded) < 2:
        client.ask("read", "/replay/playback")
    client.ask("call", "/system/commands/stop", {})
    first = sensor.resources.recorded[0]
    client.ask("update", "/replay/playback", {"enabled": True})
    client.ask("call", "/replay/commands/seek", {"index": 0})
    taken = len(sensor.asked)
    message = received(client, PROFILE, "topUniformProfile")[PROFILE]
    assert message[4] == 12  # a uniform profile
    width = struct.unpack_from("<I", message, gdp.parse_common(memoryview(message)).body + 2)[0]
    assert 10 < width < 60
    assert len(sensor.asked) - taken <= 1  # one exposure may have been under way; what is shown is what was recorded
    assert sensor.resources.recorded[0] is first


def test_a_subscriber_hears_of_the_start_and_of_the_stop_and_then_no_more(client):
    client.ask("sub", "/system")
    for command, state in (("start", 1), ("stop", 0)):
        client.ask("call", f"/system/commands/{command}", {})
        notified = client.next_between()
        assert (notified["type"], notified["eventType"], notified["path"]) == ("notification", "updated", "/system")
        assert notified["payload"] == {"runState": state}
    client.ask("unSub", "/system")
    client.ask("call", "/system/commands/start", {})
    client.ask("call", "/system/commands/stop", {})
    assert client.ask("read", "/system")["runState"] == 0
    assert client.between == []


@pytest.mark.parametrize("path", ["/system/metrics", f"{SCANNER}/metrics", f"{SENSOR}/metrics"])
def test_metrics_are_streamed_until_the_stream_is_cancelled(client, path):
    client.ask("stream", path)
    came = [client.next_between() for _ in range(2)]
    for message in came:
        assert (message["type"], message["path"]) == ("stream", path)
        assert message["payload"] == client.ask("read", path)
    assert came[0]["streamId"] == came[1]["streamId"]
    client.ask("cancelStream", path)


@pytest.mark.parametrize(
    ("path", "keys"),
    [
        ("/system/metrics", "appUpTime cpuCoresUsedAvg memCapacity memUsed"),
        (f"{SCANNER}/metrics", "currentSyncTime frameCount processingLatencyAvg processingLatencyMax scanCount"),
        (f"{SENSOR}/metrics", "cameraTemp0 cpuTemp"),
        (f"{SCANNER}/transform", "transform encoderResolution speed"),
        (f"{SCANNER}/alignment", "alignState"),
    ],
)
def test_what_the_samples_print_is_there(client, path, keys):
    assert set(keys.split()) <= set(client.ask("read", path))


def test_the_tree_is_found_by_walking_as_for_the_vendors_resources(client):
    href = "/scan/engines"
    for part in ("", "/scanners", "/sensors"):
        children = client.ask("read", href + part, expandLevel=1)["_embedded"]["item"]
        href = children[0]["_links"]["self"]["href"]
    assert client.ask("read", href)["serialNumber"] == client.ask("read", SENSOR)["serialNumber"] == "12345"
    assert client.ask("read", "/system/info")["appId"]


def test_configure_sensor_writes_what_it_reads_back(client):
    client.ask("update", "/system", {"quickEditEnabled": True})
    assert client.ask("read", "/system")["quickEditEnabled"] is True
    client.ask("update", SCANNER, {"parameters": {"triggerSettings": {"source": 3}}})
    client.ask("call", "/system/commands/start", {})
    client.ask("call", f"{SCANNER}/actions/trigger", {})
    client.ask("call", "/system/commands/stop", {})
    exposures = {"exposureMode": 1, "multipleExposures": [1080, 2010, 5040]}
    client.ask("update", SENSOR, {"parameters": {"exposureSettings": exposures}})
    client.ask("update", SENSOR, {"displayName": "Main-Sensor-Change"})
    client.ask("update", SENSOR, {"parameters": {"activeAreaSettings": {"activeArea": {"width": 3.5}}}})
    found = client.ask("read", SENSOR)
    assert found["displayName"] == "Main-Sensor-Change"
    assert found["parameters"]["exposureSettings"] == {**exposures, "singleExposure": 1200}
    assert found["parameters"]["activeAreaSettings"]["activeArea"]["width"] == 3.5
    assert client.ask("read", "/environ/ipConfig")["interfaces"][0]["ipAddress"]


def test_a_job_is_saved_renamed_fetched_brought_and_deleted(client):
    def names():
        items = client.ask("read", "/jobs/files", None, expandLevel=1)["_embedded"]["item"]
        return [item["jobName"] for item in items]

    client.ask("call", "/jobs/commands/save", {"name": "demo"})
    client.ask("call", "/jobs/commands/rename", {"sourceName": "demo", "destName": "other"})
    assert "other" in names()
    assert "demo" not in names()
    assert isinstance(client.ask("read", "/jobs/files/other/data")["content"], bytes)
    client.ask("create", "/jobs/files", {"fromLive": False, "name": "brought", "content": b"\x01\x02"})
    assert client.ask("read", "/jobs/files/brought/data")["content"] == b"\x01\x02"
    client.ask("call", "/jobs/commands/load", {"name": "brought"})
    assert client.ask("read", "/jobs")["loadedJob"] == "brought"
    client.ask("delete", "/jobs/files/other")
    assert "other" not in names()


def test_configure_sensor_switches_a_digital_output(client, sensor):
    outputs = "/controls/digitalOutput"
    client.ask("update", f"{outputs}/", {"enabled": True})
    assert "_embedded" not in client.ask("read", f"{outputs}/devices")
    device = client.ask("read", f"{outputs}/availableDevices")["devices"][0]
    client.ask("create", f"{outputs}/devices", device)
    (item,) = client.ask("read", f"{outputs}/devices")["_embedded"]["item"]
    port = item["_links"]["self"]["href"] + "/ports/port-0"
    client.ask("update", port, {"parameters": {"triggerEvent": 2}})
    assert client.ask("read", port)["parameters"]["triggerEvent"] == 2
    client.ask("call", f"{port}/commands/trigger", {"parameter": {"target": 0, "value": True}})
    assert sensor.resources.digital_output.pulses == [(port, {"parameter": {"target": 0, "value": True}})]


def test_align_sensor_reads_the_transform_behind_the_sensor(client):
    client.ask("call", f"{SCANNER}/commands/align", {})
    assert client.ask("read", f"{SCANNER}/alignment")["alignState"] == 1
    assert set(client.ask("read", f"{SENSOR}/transform")["transform"]) == {"x", "y", "z", "xAngle", "yAngle", "zAngle"}


def test_discover_backup_layout_and_subscriptions_find_their_keys(client):
    (seen,) = client.ask("read", "/scan/visibleSensors/")["sensors"]
    assert seen["isLocal"] is True
    assert client.ask("call", "/system/commands/archive", {"contents": ["global", "allJobs"]})["content"]
    (scanner,) = client.ask("read", "/scan/engines/LMILaserLineProfiler", expandLevel=1)["_embedded"]["go:scanner"]
    assert scanner["_links"]["self"]["href"].endswith("/scanners/scanner-0")
    assert client.ask("read", f"{SCANNER}/layout")["grid"]["sensors"][0]["sensorId"] == "sensor-0"


def test_resource_schema_says_types_and_limits(client):
    schema = client.ask("read", SENSOR, includeSchema=True)["_schema"]
    exposure = schema["properties"]["parameters"]["properties"]["exposureSettings"]["properties"]["singleExposure"]
    assert (schema["type"], exposure["type"], exposure["minimum"], exposure["maximum"]) == ("object", "integer", 100.0, 100_000.0)
    state = client.ask("read", "/system", includeSchema=True)["_schema"]["properties"]["runState"]
    assert (state["readOnly"], state["enum"]) == (True, [0, 1, 2])


def test_receive_measurement_gets_the_output_of_a_tool(client):
    tool = "tools:ProfileBoundingBox-0:outputs:X"
    message = received(client, tool, tool)[tool]
    assert message[4] == 19  # a measurement
    body = gdp.parse_common(memoryview(message)).body
    value, decision = struct.unpack_from("<dB", message, body)
    xyz = tilted_plane().xyz
    x = -xyz[len(xyz) // 2, :, 0]  # the sensor's x runs the other way
    assert (value, decision) == (pytest.approx((np.nanmin(x) + np.nanmax(x)) / 2), 1)


def test_a_refusal_carries_what_the_samples_print(client):
    client.sock.sendall(frames.request("read", f"{SCANNER}/nothing", None, {}))
    refused = client.message()
    assert refused["status"] == -999
    assert refused["payload"]["errors"][0] == {"status": -999, "description": "not found"}

"""What the pages say of a folder of runs, and whom they answer."""

import json
import re
import time
from datetime import datetime

import pytest

pytest.importorskip("flask")

from result_page import make_result

from mbcacq.serve.application import create_application

HERE = "http://127.0.0.1:8765"


@pytest.fixture
def client(runs):
    return create_application(runs, 8765).test_client()


def get(client, path, **kwargs):
    return client.get(path, base_url=HERE, buffered=True, **kwargs)


def page_of(client, name):
    """Address of the page of a run, from the list."""
    return re.search(rf'href="(/run/\w+)">{re.escape(name)}<', get(client, "/").text)[1]


def test_the_list_has_the_verdict_and_the_figures_of_a_run(client):
    text = get(client, "/").text
    assert "monday" in text
    assert "Passed: every place is within the limit" in text
    assert "largest sphere spacing error" in text


def test_a_verdict_follows_its_file(client, runs):
    get(client, "/")
    (runs / "monday" / "result.json").write_text(json.dumps(make_result(limit=1e-4)))
    assert "Not passed: the limit is exceeded" in get(client, "/").text


@pytest.mark.parametrize("text", ["", '{"format": "mbcacq-res', "[]", '{"format": "mbcacq-result/1"}', "[" * 100_000])
def test_a_damaged_result_is_named_and_the_others_are_shown(client, runs, text):
    (runs / "torn").mkdir()
    (runs / "torn" / "result.json").write_text(text)
    shown = get(client, "/")
    assert shown.status_code == 200
    assert "damaged" in shown.text
    assert "Passed: every place" in shown.text
    one = get(client, page_of(client, "torn"))
    assert one.status_code == 200
    assert "Damaged" in one.text


def test_a_damaged_diagnosis_is_named(client, runs):
    (runs / "monday" / "diagnosis.json").write_text('{"format": "mbcacq-diagnosis/2", "verd')
    assert "diagnosis.json is not JSON" in get(client, "/").text


def test_the_diagnosis_stands_beside_the_verdict(client, runs):
    from made_up import diagnosis

    (runs / "monday" / "diagnosis.json").write_text(json.dumps(diagnosis()))
    for path in ("/", page_of(client, "monday")):
        assert "Joint compliance at A2" in get(client, path).text


def test_names_from_files_are_text(client, runs):
    result = make_result()
    result["robot"]["name"] = "<script>alert(1)</script>"
    folder = runs / "<img src=x onerror=alert(2)>"
    folder.mkdir()
    (folder / "result.json").write_text(json.dumps(result))
    keys = re.findall(r'href="(/run/\w+)"', get(client, "/").text)
    for path in ("/", *keys):
        text = get(client, path).text
        assert "<script>alert" not in text
        assert "<img" not in text
        assert "&lt;img src=x onerror=alert(2)&gt;" in text or path != "/"


@pytest.mark.parametrize("host", ["evil.example:8765", "127.0.0.1:9999", "127.0.0.1.evil.example:8765", "127.0.0.1", "[::1]:8765", ""])
def test_a_foreign_host_is_refused(client, host):
    answer = get(client, "/", headers={"Host": host})
    assert answer.status_code == 403
    assert "monday" not in answer.text


def test_localhost_is_the_same_computer(client):
    assert client.get("/", base_url="http://localhost:8765").status_code == 200


@pytest.mark.parametrize(
    "path",
    [
        "/run/../../etc",
        "/run/..%2f..%2fetc",
        "/run/%2e%2e",
        "/report/..%2fmonday",
        "/run/monday",
        "/download/{key}/..%2fresult.json",
        "/download/{key}/secret.txt",
        "/download/{key}/%2e%2e%2fsecret.txt",
        "/static/..%2fguard.py",
        "/static/%2e%2e/guard.py",
    ],
)
def test_no_path_leads_out_of_the_folder(client, runs, path):
    (runs / "secret.txt").write_text("the secret")
    (runs / "monday" / "secret.txt").write_text("the secret")
    key = page_of(client, "monday").removeprefix("/run/")
    answer = get(client, path.format(key=key))
    assert answer.status_code == 404
    assert "the secret" not in answer.text


def test_links_to_elsewhere_are_not_followed(client, runs, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "result.json").write_text(json.dumps(make_result()))
    (runs / "linked").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "private.html").write_text("private")
    (runs / "monday" / "report.html").symlink_to(tmp_path / "private.html")
    assert "linked" not in get(client, "/").text
    assert get(client, page_of(client, "monday").replace("/run/", "/report/")).status_code == 404


def test_a_report_gets_an_origin_of_its_own_and_our_pages_no_inline_script(client, runs):
    (runs / "monday" / "report.html").write_text("<script>1</script>")
    address = page_of(client, "monday")
    report = get(client, address.replace("/run/", "/report/"))
    assert report.data == b"<script>1</script>"
    policy = report.headers["Content-Security-Policy"]
    assert "sandbox allow-scripts;" in policy
    assert "default-src 'none'" in policy
    assert "allow-same-origin" not in policy
    assert "connect-src" not in policy
    own = get(client, address)
    assert "unsafe" not in own.headers["Content-Security-Policy"]
    assert re.search(r"<script(?! src=)|<style|\sstyle=|\son\w+=", own.text) is None


def test_two_runs_side_by_side_say_what_changed(client, runs):
    later = make_result()
    later["parameters"][1] |= {"value": 25.943, "error": 0.943}  # a_1, 100 times its uncertainty
    (runs / "tuesday").mkdir()
    (runs / "tuesday" / "result.json").write_text(json.dumps(later))
    keys = [page_of(client, name).removeprefix("/run/") for name in ("monday", "tuesday")]
    text = get(client, f"/compare?run={keys[0]}&run={keys[1]}").text
    assert "Changed beyond chance: a_1" in text
    assert "0.80" in text
    assert get(client, f"/compare?run={keys[0]}").status_code == 400
    assert get(client, f"/compare?run={keys[0]}&run=0").status_code == 404


def test_a_fleet_is_listed_with_its_page(client, runs):
    (runs / "all").mkdir()
    (runs / "all" / "fleet.html").write_text("<h1>the drift of each arm</h1>")
    address = re.search(r'href="(/fleet/\w+)">all<', get(client, "/").text)[1]
    shown = get(client, address)
    inside = re.search(r'<iframe[^>]* src="([^"]+)"', shown.text)[1]
    assert get(client, inside).text == "<h1>the drift of each arm</h1>"


def test_a_run_that_broke_off_says_how_to_go_on(client, runs, measuring):
    assert "3 of 10 poses" in get(client, "/").text
    text = get(client, page_of(client, "now")).text
    assert f"mbcacq run --resume {measuring}" in text
    assert "Stop this run" not in text
    assert "artefact at &lt;b&gt;p1&lt;/b&gt;" in text


def test_reading_writes_nothing(client, runs, measuring):
    before = {path: path.stat().st_mtime_ns for path in runs.rglob("*")}
    for path in ("/", page_of(client, "monday"), page_of(client, "now"), page_of(client, "now").replace("/run/", "/scene/")):
        assert get(client, path).status_code == 200
    assert {path: path.stat().st_mtime_ns for path in runs.rglob("*")} == before


def test_each_pose_of_a_plan_sees_the_balls_that_lie_wholly_in_its_field_of_view():
    import numpy as np

    from mbcacq.plan import load
    from mbcacq.serve.plan_scene import plan_scene

    loaded = load("quick")
    scene = plan_scene(loaded)
    assert len(scene["poses"]) == 10
    assert scene["unreachable"] == 0
    planned = {tuple(point) for group in scene["groups"] for point in group["points"]}
    radius = loaded.cell.artefacts[0].diameters[0] / 2
    for pose in scene["poses"]:
        corners = np.array(pose["view"])
        room = []
        for face in ([0, 1, 2], [4, 5, 6], [0, 1, 5], [1, 2, 6], [2, 3, 7], [3, 0, 4]):
            a, b, c = corners[face]
            normal = np.cross(b - a, c - a) / np.linalg.norm(np.cross(b - a, c - a))
            normal *= np.sign(normal @ (corners.mean(axis=0) - a))
            room.append([normal @ (np.array(ball) - a) for ball in sorted(planned)])
        inside = {ball for ball, least in zip(sorted(planned), np.min(room, axis=0), strict=True) if least > radius}
        assert {tuple(ball) for ball in pose["seen"]} == inside
        assert len(inside) >= 7


def test_any_other_address_than_loopback_is_refused(runs):
    from click.testing import CliRunner

    from mbcacq.cli.app import app

    for host in ("0.0.0.0", "192.168.1.5", "::", "example.org"):
        outcome = CliRunner().invoke(app, ["serve", str(runs), "--host", host])
        assert outcome.exit_code == 2
        assert "served at 127.0.0.1 only" in outcome.output
        assert "ssh -L" in outcome.output


def test_a_folder_that_is_missing_and_libraries_that_are(runs, monkeypatch):
    import sys

    from click.testing import CliRunner

    from mbcacq.cli.app import app

    outcome = CliRunner().invoke(app, ["serve", str(runs / "nowhere"), "--port", "0"])
    assert outcome.exit_code == 2
    assert "cannot be read as a folder of runs" in outcome.output
    monkeypatch.setitem(sys.modules, "waitress.server", None)
    outcome = CliRunner().invoke(app, ["serve", str(runs)])
    assert outcome.exit_code == 2
    assert "pip install 'mbcacq[serve]'" in outcome.output


@pytest.mark.parametrize("zone", ["Etc/GMT-14", "Etc/GMT+12"])
def test_today_is_the_day_of_the_lab_as_in_the_names_of_its_runs(client, runs, monkeypatch, zone):
    monkeypatch.setenv("TZ", zone)
    time.tzset()
    try:
        today = f"{datetime.now():%Y-%m-%d}"
        (runs / "unnamed").mkdir()
        (runs / "unnamed" / "result.json").write_bytes((runs / "monday" / "result.json").read_bytes())
        link = re.search(r'href="([^"]+)">Measured today', get(client, "/").text)[1]
        assert today in link
        assert "unnamed" in get(client, link).text
    finally:
        monkeypatch.undo()
        time.tzset()


def test_of_many_runs_a_page_is_shown_with_search_kind_and_history(client, runs):
    for day in range(1, 29):
        for hour in (6, 18):
            folder = runs / f"2026-02-{day:02d}T{hour:02d}-00-00_{'check-' if hour == 18 else ''}cell-b"
            folder.mkdir()
            (folder / "result.json").write_bytes((runs / "monday" / "result.json").read_bytes())
    text = get(client, "/").text
    assert text.count('type="checkbox"') == 50
    assert "page 1 of 2" in text
    assert "History of cell-b" in text
    assert get(client, "/?page=2").text.count('type="checkbox"') == 57 - 50
    assert get(client, "/?q=2026-02-07").text.count('type="checkbox"') == 2
    assert get(client, "/?kind=check").text.count('type="checkbox"') == 28
    history = get(client, "/?cell=cell-b").text
    assert history.count("<circle") == 50
    assert "56 recordings of cell-b" in history
    assert "no run here that fits" in get(client, "/?q=nowhere").text
    assert get(client, "/?page=-1&kind=<b>&q=%00").status_code == 200

"""The stop button ends the run of a folder as Ctrl-C does, and never another process."""

import json
import re
import subprocess
import sys

import pytest

pytest.importorskip("flask")

from chromium import PATIENCE_S, Browser, program

from mbcacq.errors import ConfigError
from mbcacq.recording.run_folder.stop import stop_run
from mbcacq.serve.application import create_application
from mbcacq.serve.live import progress_of

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux can prove which process runs a folder")
HERE = "http://127.0.0.1:8765"
SLEEPER = "import sys; file = open(sys.argv[1], 'a'); print('up', flush=True); sys.stdin.read()"


@pytest.fixture
def client(runs):
    return create_application(runs, 8765).test_client()


def address_of(client, name):
    return re.search(rf'href="(/run/\w+)">{re.escape(name)}<', client.get("/", base_url=HERE).text)[1]


def token_in(text):
    return re.search(r'name="token" value="([^"]+)"', text)[1]


@pytest.mark.parametrize(("how", "code"), [("hearing", 130), ("deaf", 5)])
def test_the_button_ends_a_run_in_order(client, measuring, stand_in, how, code):
    process = stand_in(measuring, how)
    address = address_of(client, "now")
    page = client.get(address, base_url=HERE).text
    assert f"process {process.pid}" in page
    answer = client.post(address.replace("/run/", "/stop/"), data={"token": token_in(page)}, base_url=HERE)
    assert answer.status_code == 303
    assert process.wait(timeout=900) == code
    assert progress_of(measuring).state == "broken off"  # the stand-in writes no journal; its lock is free again
    assert not (measuring / ".run.lock.json").exists()


def test_a_run_that_goes_on_says_how_far_it_is(client, measuring, stand_in):
    process = stand_in(measuring)
    live = client.get(address_of(client, "now").replace("/run/", "/live/"), base_url=HERE).json
    assert (live["state"], live["pid"], live["done"], live["total"]) == ("running", process.pid, 3, 10)
    assert live["left_s"] == pytest.approx(14.0)  # seven poses of two seconds each
    assert live["log"] == [["14:17:13", "info", "mbcacq: artefact at <b>p1</b>"]]


@pytest.mark.parametrize("data", [{}, {"token": ""}, {"token": "guessed"}, {"token": "ü"}])
def test_without_the_token_of_the_page_nothing_is_stopped(client, measuring, stand_in, data):
    process = stand_in(measuring)
    answer = client.post(address_of(client, "now").replace("/run/", "/stop/"), data=data, base_url=HERE)
    assert answer.status_code == 403
    assert process.poll() is None
    assert progress_of(measuring).state == "running"


def test_another_site_stops_nothing_even_with_the_token(client, measuring, stand_in):
    process = stand_in(measuring)
    address = address_of(client, "now")
    data = {"token": token_in(client.get(address, base_url=HERE).text)}
    stop = address.replace("/run/", "/stop/")
    assert client.post(stop, data=data, base_url=HERE, headers={"Origin": "http://evil.example"}).status_code == 403
    assert client.post(stop, data=data, base_url=HERE, headers={"Host": "evil.example:8765"}).status_code == 403
    assert client.get(stop, query_string=data, base_url=HERE).status_code == 405
    assert process.poll() is None


def test_a_process_that_only_has_the_number_or_the_file_is_never_signalled(measuring):
    """As after a crash: the name of the run's process is left behind, and its number belongs to another program."""
    lock = measuring / ".run.lock"
    process = subprocess.Popen([sys.executable, "-c", SLEEPER, lock], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == "up\n"
        (measuring / ".run.lock.json").write_text(json.dumps({"pid": process.pid, "command": "run"}))
        with pytest.raises(ConfigError, match="another program"):
            stop_run(measuring)
        assert progress_of(measuring).state == "broken off"
        assert process.communicate("", timeout=900)[1] is None
        assert process.returncode == 0  # it ended by itself, not by a signal
    finally:
        process.kill()


@pytest.mark.parametrize("owner", ["", "{", "[]", '{"pid": -1, "command": "run"}', '{"pid": 0, "command": "run"}', '{"pid": 1e300}'])
def test_a_damaged_name_of_an_owner_is_nobody(measuring, owner):
    (measuring / ".run.lock.json").write_text(owner)
    with pytest.raises(ConfigError, match="nothing runs"):
        stop_run(measuring)


@pytest.mark.skipif(program() is None, reason="no Chromium is installed (apt-get install chromium)")
def test_in_a_browser_the_button_stops_the_run_and_the_page_says_so(runs, measuring, stand_in):
    process = stand_in(measuring)
    command = [sys.executable, "-m", "mbcacq", "serve", runs, "--port", "0"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        home = re.search(r"http://127\.0\.0\.1:\d+/", server.stdout.readline())[0]
        with Browser(390, 844, mobile=True) as browser:

            def wait_for(script):
                browser.run(f"""new Promise((done, failed) => {{ const end = Date.now() + {PATIENCE_S * 1000:.0f};
                    const look = () => {script} ? done(true) : Date.now() > end ? failed('waited in vain') : setTimeout(look, 50); look(); }})""")

            def until(script):
                """Across pages: a promise ends with the page that made it."""
                for _ in range(2000):
                    try:
                        return wait_for(script)
                    except RuntimeError:
                        continue

            browser.call("Page.navigate", url=home)
            until("document.readyState === 'complete' && document.querySelector('table.runs')")
            assert browser.run("document.documentElement.scrollWidth <= 390")
            browser.run("Array.from(document.querySelectorAll('a')).find(a => a.textContent === 'now').click()")
            until("document.readyState === 'complete' && document.getElementById('stop')")
            assert browser.run("document.documentElement.scrollWidth <= 390")
            browser.run("document.getElementById('stop').click()")
            assert process.wait(timeout=PATIENCE_S) == 130
            until(
                "document.readyState === 'complete' && !document.getElementById('live') && document.body.innerText.includes('run --resume')"
            )
            assert browser.console == []
            assert all(url.startswith(home) for url in browser.requests)
    finally:
        server.terminate()
        server.communicate(timeout=900)
    assert server.returncode == 0

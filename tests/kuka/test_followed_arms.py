"""Arms that are only followed, at the wire: the driver reads where they are, and sends nothing that moves them."""

import numpy as np
import pytest
from eki_bench import DH, EKI_LIMITS_DEG, SPEED_DEG_S, START_DEG, settings
from kuka_bench import HOME_DEG, LIMITS_DEG, motion_limits, wait
from mbcacq_fakes.cell.ports import free_port
from mbcacq_fakes.protocols.krc.server import FakeEkiController, FakeKrc
from mbcacq_fakes.protocols.rtde import FakeUrController
from mbcacq_kuka.eki.driver import KukaEki
from mbcacq_kuka.rsi.driver import KukaRsi
from mbcacq_ur.driver import UrRtdeRobot

from mbcacq.acquisition.cell_devices import robot_options
from mbcacq.conformance import Channel, TcpProxy, counted, ended
from mbcacq.devices import ConfigError, SafetyStop
from mbcacq.model import shipped
from mbcacq.plan import load


def refuses_to_move(robot, q):
    with pytest.raises(SafetyStop, match="only followed.*nothing was moved"):
        robot.move_to(q, motion_limits())


def test_rsi_answers_with_corrections_of_zero_while_another_program_moves_the_arm():
    port, target = free_port(), np.radians(HOME_DEG + [6, -4, 5, 0, 3, 0])
    options = {"limits_deg": LIMITS_DEG, "port": port, "follow": True, "silence_s": 20.0, "connect_timeout_s": 20.0}
    with FakeKrc(client=("127.0.0.1", port), realtime=False, limits_deg=LIMITS_DEG, start_deg=tuple(HOME_DEG), log=True) as krc:
        with KukaRsi("arm", "test", options) as robot:
            refuses_to_move(robot, target)
            krc.lead(target)
            wait(lambda: np.abs(robot.state().q - target).max() < 2e-5)
            robot.stop()
            wait(lambda: len(robot.cycles()) > 0)
            before = krc.report()
        assert before["ended"] == 0
        assert before["active"] == 1  # nor does it end the session that another program needs
        log = krc.log()
    assert log["accepted"].sum() > 20
    assert np.abs(log["correction"]).max() == 0.0


def test_eki_needs_the_link_program_alone_and_sends_signs_of_life_only():
    start = np.array(START_DEG, dtype=float)
    target = np.radians(start + [1, 0.5, 0, 0, 1, 0])
    sent = []
    note = lambda link, sender, data: sent.append(data) if sender == "driver" else None  # noqa: E731
    controller = FakeEkiController(**settings("kss", start_deg=START_DEG, realtime=False, running=False).to_json())
    with (
        controller as krc,
        TcpProxy(Channel("eki", note), ("127.0.0.1", krc.port), cut=ended(b"</Robot>"), cut_driver=ended(b"</Command>")) as proxy,
    ):
        options = {"address": "127.0.0.1", "port": proxy.port, "limits_deg": EKI_LIMITS_DEG, "speed_deg_s": SPEED_DEG_S, "kinematics": DH}
        with KukaEki("arm", "KR 10 R1100-2", {**options, "follow": True, "silence_s": 20.0, "connect_timeout_s": 20.0}) as robot:
            refuses_to_move(robot, target)
            krc.lead(target)
            wait(lambda: np.abs(robot.state().q - target).max() < 2e-5)
            robot.stop()
    assert sent
    assert all(telegram.startswith(b'<Command Kind="0"') for telegram in sent)  # BEAT


def test_rtde_agrees_on_no_registers_and_is_silent_after_the_start():
    start = np.array([0.0, -90, 90, -90, -90, 0])
    target, sent = np.radians(start + [3, 2, 1, 0, 0, -5]), []
    note = lambda link, sender, data: sent.append(data) if sender == "driver" else None  # noqa: E731
    cut = counted(size=2, order="big")
    with FakeUrController(start_deg=start, runtime_state=1) as fake:  # stopped: no program of ours runs on it
        with TcpProxy(Channel("rtde", note), ("127.0.0.1", fake.port), cut=cut, cut_driver=cut) as proxy:
            options = {"address": "127.0.0.1", "port": proxy.port, "limits_deg": [[-360, 360]] * 6, "silence_s": 20.0, "follow": True}
            with UrRtdeRobot("arm", "UR10e", options) as robot:
                refuses_to_move(robot, target)
                fake.inject(runtime_state=2)  # a program of its own, or a person
                fake.lead(target)
                wait(lambda: np.abs(robot.state().q - target).max() < 1e-9)
                robot.stop()
    assert [telegram[2:3] for telegram in sent] == [b"V", b"v", b"O", b"S"]


def plan_with(tmp_path, old, new):
    text = (shipped.folder() / "quick.yaml").read_text(encoding="utf-8").replace(old, new)
    for name in ("robots/kr10_r1100_2.yaml", "artefacts/mbc-8.yaml"):
        text = text.replace(name, str(shipped.folder() / name))
    path = tmp_path / "plan.yaml"
    path.write_text(text, encoding="utf-8")
    return load(path)


def test_a_plan_that_would_move_an_arm_by_a_driver_that_only_reads_is_refused(tmp_path):
    loaded = plan_with(tmp_path, "driver: kuka_rsi", "driver: opcua")
    with pytest.raises(ConfigError, match="reads the arm and moves nothing.*add follow: {} to robot"):
        robot_options(loaded)


def test_a_driver_that_cannot_follow_is_refused(tmp_path, monkeypatch):
    loaded = plan_with(tmp_path, "  speed: 0.25\n", "  speed: 0.25\n  follow: {}\n")
    assert robot_options(loaded)["follow"] is True
    monkeypatch.setattr(KukaRsi, "plan_facts", ("dynamics",))
    with pytest.raises(ConfigError, match="cannot follow an arm that others move"):
        robot_options(loaded)

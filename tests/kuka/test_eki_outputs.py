"""Digital outputs over EKI: the shipped program switches those of the plan, says so, and switches them off by itself where it stops the
arm."""

import pytest
from eki_arm import FAR, SLOW, on_the_way
from eki_bench import SYSTEMS, Bench, sources
from kuka_bench import wait
from mbcacq_kuka.eki import telegrams

from mbcacq.devices import ConfigError, DeviceFault, DeviceTimeout, IdentityError, SafetyStop


def with_outputs(system, *numbers, **replaced):
    """The shipped programs with the numbers of a plan; replaced: name of a file -> (text, other text)."""
    files = sources(system)
    for k, number in enumerate(numbers, 1):
        files["mbcacq_eki.dat"] = files["mbcacq_eki.dat"].replace(f"mb_out[{k}]=0", f"mb_out[{k}]={number}")
    for name, (before, after) in replaced.items():
        assert before in files[f"{name}.src"]
        files[f"{name}.src"] = files[f"{name}.src"].replace(before, after)
    return files


@pytest.fixture(params=SYSTEMS)
def bench(request):
    one = Bench(request.param, sources=with_outputs(request.param, 3, 12))
    one.dial()
    yield one
    one.close()


def switch(one, number, output, value, ticks=6):
    one.say(kind=4, number=number, speed=float(value), accel=output, ticks=ticks)


def out(one):
    return {n for n in range(1, 4097) if one.controller.system.out[n]}


def test_the_bytes_that_switch_an_output():
    assert telegrams.switch(7, 12, True, 5060) == (
        b'<Command Kind="4" Id="7" Beat="5060" Speed="1.000000" Accel="12"><Axis A1="0.000000" A2="0.000000" A3="0.000000" A4="0.000000" '
        b'A5="0.000000" A6="0.000000"></Axis>'
        b"</Command>"
    )
    assert b'Speed="0.000000" Accel="3"' in telegrams.switch(8, 3, False, 0)


def test_outputs_of_the_plan_are_switched_and_acknowledged(bench):
    switch(bench, 1, 12, True)
    assert (out(bench), bench.last("Switched"), bench.last("SwitchCode")) == ({12}, 1, 0)
    switch(bench, 2, 3, True)
    switch(bench, 3, 12, False)
    assert (out(bench), bench.last("Switched")) == ({3}, 3)
    assert bench.last("Refused") == bench.last("Last") == 0  # no move


@pytest.mark.parametrize("output", [4, 0, -3])
def test_an_output_that_the_plan_does_not_name_is_not_switched(bench, output):
    switch(bench, 1, output, True)
    assert (out(bench), bench.last("Switched"), bench.last("SwitchCode")) == (set(), 1, 16)


def test_one_that_does_not_change_is_said(bench):
    bench.controller.faults.inject({"stuck": 1.0})
    bench.ticks(1)
    switch(bench, 1, 3, True)
    assert (bench.last("Switched"), bench.last("SwitchCode")) == (1, 17)


@pytest.mark.parametrize("end", ["stop", "silence", "lost", "guard", "emergency stop", "submit interpreter started again"])
def test_whatever_stops_the_arm_switches_it_off(bench, end):
    switch(bench, 1, 3, True)
    bench.controller.system.out[5] = True  # another program's
    if end == "stop":
        bench.say(kind=3, number=0)
    elif end == "silence":
        bench.ticks(300)
    elif end == "lost":
        bench.socket.close()
        bench.ticks(60)
    elif end == "submit interpreter started again":
        from mbcacq_fakes.protocols.krc.krl import Interpreter

        Interpreter(bench.controller.program, "mbcacq_link_init").tick(0.0)
    else:
        bench.controller.system.user_saf = end != "guard"
        bench.controller.faults.inject({"emergency_stop": float(end == "emergency stop")})
        bench.ticks(6)
        assert out(bench) == {5}
        switch(bench, 2, 3, True)
        assert bench.last("SwitchCode") == 18
    assert out(bench) == {5}


@pytest.mark.parametrize("system", SYSTEMS)
def test_the_driver_switches_while_the_arm_moves_and_stop_ends_both(eki_cell, system):
    fake, robot = eki_cell(system, controller={"sources": with_outputs(system, 3)}, robot={"digital_outputs": [3]})
    on_the_way(fake, robot)
    robot.set_output(3, True)
    assert fake.state.output(3) == (True, 1)
    robot.stop()
    wait(lambda: not fake.state.output(3)[0] and fake.state.read().standstill)
    robot.set_output(3, True)
    robot.set_output(3, False)
    assert fake.state.output(3) == (False, 2)
    robot.set_output(3, True)
    robot.stop()  # there is no move to stop
    wait(lambda: not fake.state.output(3)[0])
    robot.move_to(FAR, SLOW)


def test_what_is_not_switched_is_named(eki_cell):
    fake, robot = eki_cell(controller={"sources": with_outputs("kss", 3)}, robot={"digital_outputs": [3, 12]})
    with pytest.raises(ConfigError, match="output 4 may not be switched from here"):
        robot.set_output(4, True)
    with pytest.raises(DeviceFault, match="did not switch output 12: its program may not switch it .*controller-files"):
        robot.set_output(12, True)
    fake.inject(stuck=1)
    with pytest.raises(DeviceFault, match="did not switch output 3: it does not change; is it write-protected"):
        robot.set_output(3, True)
    fake.inject(stuck=0, drop=2)
    robot.set_output(3, True)  # states that are lost on their way are made good by the next
    assert fake.state.output(3) == (True, 1)
    fake.inject(emergency_stop=1)
    wait(lambda: not fake.state.output(3)[0])
    with pytest.raises((SafetyStop, DeviceFault), match="emergency stop"):
        robot.set_output(3, True)


def test_a_controller_that_does_not_acknowledge_is_stopped(eki_cell):
    mute = {"mbcacq_link": ("mb_switched=id", "mb_swcode=0")}
    fake, robot = eki_cell(
        controller={"sources": with_outputs("kss", 3, **mute)}, robot={"digital_outputs": [3], "silence_s": 1.0, "reconnect_s": 0}
    )
    with pytest.raises(DeviceTimeout, match="did not acknowledge the switching of output 3"):
        robot.set_output(3, True)
    wait(lambda: fake.state.output(3) == (False, 1))


def test_a_connection_that_is_lost_in_a_pulse_leaves_it_off(eki_cell):
    fake, robot = eki_cell(controller={"sources": with_outputs("kss", 3)}, robot={"digital_outputs": [3]})
    robot.set_output(3, True)
    fake.inject(reset=1)
    wait(lambda: not fake.state.output(3)[0])
    wait(lambda: robot._session._connections >= 2 and robot._session._link is not None)  # taken up again
    robot.set_output(3, True)
    assert fake.state.output(3) == (True, 2)


def test_programs_from_before_are_refused(eki_cell):
    given = {"sources": with_outputs("kss", mbcacq_link=('"mbcacq 3")', '"mbcacq 2")'))}
    with pytest.raises(IdentityError, match="runs programs for 'mbcacq 2', .* copy the files that `mbcacq controller-files` writes"):
        eki_cell(controller=given)

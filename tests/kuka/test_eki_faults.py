"""Whatever goes wrong on the wire, in the program or at the arm: it stands, and the error says what happened."""

import numpy as np
import pytest
from eki_arm import FAR, HOME, on_the_way, stands
from eki_bench import SYSTEMS
from kuka_bench import arrive, motion_limits, until_error, wait
from mbcacq_kuka.eki.record import Record
from mbcacq_kuka.eki.session import EkiSession

from mbcacq.devices import DeviceFault, DeviceTimeout, IdentityError, ProtocolError, SafetyStop

SURVIVED = [{"split": 1}, {"merge": 1}, {"garbage": 3}, {"duplicate": 3}, {"drop": 3}, {"delay_ms": 2}, {"merge": 1, "garbage": 5}]


@pytest.mark.parametrize("fault", SURVIVED)
def test_faults_of_the_wire_that_are_none(eki_cell, fault):
    fake, robot = eki_cell()
    fake.inject(**fault)
    robot.move_to(FAR, motion_limits())
    arrive(robot)
    np.testing.assert_allclose(fake.state.read().q, FAR, atol=2e-4)


@pytest.mark.parametrize(
    ("fault", "kind", "says"),
    [
        ({"silence": 1}, DeviceTimeout, "reported no state for"),
        ({"close": 1}, DeviceTimeout, "the controller brakes the arm by itself"),
        ({"close_inside": 1}, DeviceTimeout, "the controller brakes the arm by itself"),
        ({"reset": 1}, DeviceTimeout, "the controller brakes the arm by itself"),
        ({"truncate": 1}, ProtocolError, "useless telegram"),
        ({"malformed": 1}, ProtocolError, "no XML"),
        ({"no_number": 1}, ProtocolError, "Axis/@A1 is 'x"),
        ({"program_stop": 1}, DeviceFault, "program on the controller has stopped"),
        ({"emergency_stop": 1}, SafetyStop, "emergency stop"),
        ({"mode": 1}, SafetyStop, "operating mode changed from EXT to T1"),
        ({"tool": 5}, SafetyStop, "tool changed from 1 to 4"),
    ],
)
def test_a_fault_on_the_way_stops_the_arm(eki_cell, fault, kind, says):
    fake, robot = eki_cell(robot={"silence_s": 2.0} if "silence" in fault else {})
    on_the_way(fake, robot)
    fake.inject(**fault)
    error = until_error(robot)
    assert type(error) is kind
    assert says in str(error)
    assert stands(fake)
    assert np.degrees(fake.state.read().q[0]) < 4.85
    with pytest.raises(kind):
        robot.move_to(HOME, motion_limits())
    assert len(robot.cycles()) > 0
    robot.stop()
    robot.close()


def test_a_program_started_again_ends_the_run(eki_cell):
    fake, robot = eki_cell()
    on_the_way(fake, robot)
    fake.inject(restart=1)
    error = until_error(robot)
    assert isinstance(error, DeviceFault)  # which of the two is seen first is chance
    assert "was started again during the run" in str(error) or "program on the controller has stopped" in str(error)
    assert stands(fake)


@pytest.mark.parametrize(
    ("fault", "says"), [({"ignore": 1}, "does not begin it"), ({"short_deg": 0.5}, "times the tolerance away"), ({"deaf": 1}, None)]
)
def test_an_arm_that_does_not_do_it(eki_cell, fault, says):
    fake, robot = eki_cell(**{"controller": {"realtime": True}, "robot": {"silence_s": 2.0}} if "deaf" in fault else {})
    fake.inject(**fault)
    robot.move_to(FAR, motion_limits())
    error = until_error(robot)
    assert isinstance(error, DeviceTimeout | SafetyStop)
    assert says is None or says in str(error)
    assert stands(fake)


@pytest.mark.parametrize("fault", [{"reset": 1}, {"close": 1}, {"close_inside": 1}])
@pytest.mark.parametrize("system", SYSTEMS)
def test_a_connection_lost_at_rest_is_taken_up_again(eki_cell, system, fault):
    """The controller does Clear, Init, Open; the recording shows a new connection."""
    fake, robot = eki_cell(system)
    robot.move_to(FAR, motion_limits())
    arrive(robot)
    seen = []

    def on_the_new_connection():
        seen.extend(robot.cycles().columns.get("connection", ()))  # none where nothing came since
        return 2.0 in seen

    fake.inject(**fault)
    # A move sent before the driver has noticed the loss would end with a named error: the arm may have begun it.
    wait(on_the_new_connection)
    robot.move_to(HOME, motion_limits())
    np.testing.assert_allclose(arrive(robot).q, HOME, atol=2e-4)
    assert set(seen) == {1.0, 2.0}
    assert (np.diff(seen) >= 0).all()


def test_a_controller_that_does_not_come_back(eki_cell):
    fake, robot = eki_cell(robot={"reconnect_s": 0.5})
    fake.inject(refuse=1, close=1)
    error = until_error(robot)
    assert type(error) is DeviceTimeout
    assert "the controller closed the connection" in str(error)


def test_who_answers_is_asked_again_on_a_connection_that_replaces_another_during_connect(eki_cell):
    fake, robot = eki_cell(connect=False)
    options, asked = robot._options, []

    def check(hello, state):
        asked.append(hello)
        if len(asked) == 1:
            fake.inject(close=1, refuse=1)
            wait(lambda: session.hello is not hello)
            fake.inject(refuse=0)

    session = EkiSession("arm", options, Record(options), check)
    try:
        session.open()
        assert len(asked) == 2
        assert session.hello is asked[1]
    finally:
        session.close(0.0)


def test_a_cell_that_was_changed_meanwhile_is_not_taken_up_again(eki_cell):
    fake, robot = eki_cell()
    fake.inject(tool=4, close=1)
    error = until_error(robot)
    assert type(error) in (IdentityError, SafetyStop)
    assert "tool" in str(error)

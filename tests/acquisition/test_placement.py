"""After the artefact was moved, the first scan must show it where the plan says."""

from dataclasses import replace

import numpy as np
import pytest
from stand_ins import Finder, Placer
from test_runner import make, world  # noqa: F401 world is a fixture

from mbcacq import devices
from mbcacq.acquisition import events
from mbcacq.geometry import se3


class Person(Placer):
    """Forgets to move the artefact, the first ``forgets`` times at station b."""

    asks = True

    def __init__(self, forgets):
        super().__init__()
        self.forgets, self.at = forgets, None

    def go_to(self, station, prompt):
        super().go_to(station, prompt)
        if station == "b" and self.forgets > 0:
            self.forgets -= 1
        else:
            self.at = station


class Seeing(Finder):
    """Sees the balls where they are: at the station where the person left them, off by ``shift_mm`` there."""

    def __init__(self, person, loaded, shift_mm=0.0):
        super().__init__()
        self.person, self.shift = person, shift_mm
        self.place = {s.id: s.T_base_station for s in loaded.cell.stations}

    def __call__(self, points, artefact, *, expected, predicted):
        found = super().__call__(points, artefact, expected=expected, predicted=predicted)
        wanted = "b" if self.person.log[-1] == "station b" else "a"
        # stations differ by a pure translation along z; the identity mount leaves its length, wherever the flange looks
        away = self.place[self.person.at][:3, 3] - self.place[wanted][:3, 3]
        R = self.turn
        return replace(found, xyz=found.xyz + R.T @ (away + [self.shift, 0, 0]))

    turn = np.eye(3)


def looking(world, person, shift_mm=0.0):  # noqa: F811
    loaded, poses = world
    finder = Seeing(person, loaded, shift_mm)
    runner, seen, parts = make(world, positioner=person, finder=finder)
    robot = parts["robot"]

    def turned(*args, **kwargs):
        finder.turn = loaded.cell.robot.chain.flange(robot.q[None])[0][:3, :3]
        return finder(*args, **kwargs)

    runner.find_balls = turned
    return runner, seen


def test_a_person_who_forgot_is_asked_again_and_the_run_goes_on(world):  # noqa: F811
    person = Person(forgets=1)
    runner, seen = looking(world, person)
    runner.run()
    assert person.log.count("station b") == 2
    words = [e.text for e in seen.of(events.Message) if e.level == "warning"]
    assert len(words) == 1
    assert "'mbc' at station 'b' was not moved: it still stands where station 'a' was" in words[0]
    assert [e.pose for e in seen.of(events.PoseDone)] == [0, 1, 2, 3]


def test_after_three_times_the_run_ends_with_the_same_sentence(world):  # noqa: F811
    runner, seen = looking(world, Person(forgets=9))
    with pytest.raises(devices.DeviceFault, match="was not moved"):
        runner.run()
    assert [e.pose for e in seen.of(events.PoseDone)] == [0, 1]


def test_a_machine_is_not_asked_again(world):  # noqa: F811
    person = Person(forgets=9)
    person.asks = False
    runner, _ = looking(world, person)
    with pytest.raises(devices.DeviceFault, match="was not moved"):
        runner.run()
    assert person.log.count("station b") == 1


@pytest.mark.parametrize(("shift", "refused"), [(28.0, False), (35.0, True)])
def test_a_placement_within_the_tolerance_is_accepted(world, shift, refused):  # noqa: F811
    runner, seen = looking(world, Person(forgets=0), shift)
    if refused:
        with pytest.raises(devices.DeviceFault, match="stands 35 mm from where the plan puts it"):
            runner.run()
    else:
        runner.run()
        assert len(seen.of(events.PoseDone)) == 4


@pytest.mark.parametrize(("moved", "refused"), [(3.0, False), (8.0, True)])
def test_an_artefact_touched_during_an_interruption_is_noticed(world, moved, refused):  # noqa: F811
    loaded, poses = world
    person = Person(forgets=0)
    runner, _ = looking((loaded, poses), person, moved)
    place = loaded.cell.stations[0].T_base_station
    centres = loaded.cell.artefact("mbc").centres
    runner.known = {"a": dict(zip((1, 2, 3, 4), se3.apply(place, centres), strict=True))}
    if refused:
        with pytest.raises(devices.DeviceFault, match=r"(7\.9|8\.\d) mm from where it stood before the run was interrupted.*--again"):
            runner.run()
    else:
        runner.run()

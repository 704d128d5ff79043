"""A diagnosis of motion that is out of time ends with what it has compared, and says so."""

from test_diagnose_trajectories import recording

from mbcacq.diagnosis import executor
from mbcacq.diagnosis.motion.diagnose import diagnose_trajectories


class NoTime:
    """A clock on which an hour passes between two looks."""

    now = 0.0

    def monotonic(self) -> float:
        self.now += 3600.0
        return self.now


def test_motion_that_is_out_of_time_is_not_decided(monkeypatch):
    monkeypatch.setattr(executor, "time", NoTime())

    found = diagnose_trajectories([recording(1, coulomb=5.0)], cross_validation=False, minutes=10.0)

    assert found.verdict == "cannot_tell"
    assert "time ran out" in found.suspicions[0]

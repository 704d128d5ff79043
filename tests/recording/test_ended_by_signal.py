"""A signal that arrives just while an event is being recorded ends the run, not the recording."""

import synthetic

from mbcacq.acquisition import events
from mbcacq.errors import Aborted
from mbcacq.recording.rrd.reader import Recording
from mbcacq.recording.rrd.writer import Recorder


def test_the_end_of_a_run_is_recorded_though_a_signal_came_while_writing(tmp_path, monkeypatch):
    stream = list(synthetic.run())
    writing = vars(Recorder)["_write"]  # dispatches by the kind of event

    def interrupted(self, event):
        if isinstance(event, events.PoseDone) and event.pose == 1:
            raise Aborted("the run was ended by SIGHUP")
        return writing.__get__(self, Recorder)(event)

    monkeypatch.setattr(Recorder, "_write", interrupted)
    with Recorder(tmp_path) as recorder:
        for event in stream[:-1]:
            try:
                recorder(event)
            except Aborted as error:
                recorder(events.RunStopped(event.time_s, "abort", str(error)))
                break

    about = Recording(tmp_path / "run.rrd").about()
    assert (about["exit_status"], about["reason"]) == ("abort", "the run was ended by SIGHUP")

"""Progress of a run on the terminal: a bar where there is one, plain lines otherwise; always on stderr."""

from __future__ import annotations

from collections.abc import Callable

from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from mbcacq.acquisition import events
from mbcacq.cli.terminal import console as terminal_console
from mbcacq.model.cell import SIMULATED


class RunProgress:
    """Subscriber that shows step, pose k of n, station, balls found and remaining time. begin: gets what is waited for where there is no
    bar, and an empty text at the end of that."""

    def __init__(self, begin: Callable[[str], None] = lambda text: None) -> None:
        self._console, self._begin = terminal_console(stderr=True), begin
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.completed:.0f} of {task.total:.0f} poses"),
            TextColumn("station {task.fields[station]}  balls {task.fields[balls]}", markup=False),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._task: TaskID | None = None
        self._step, self._station, self._balls, self._stepped = "", "-", 0, False
        self._before = self._done = self._total = 0  # poses measured before this call, in it, and planned
        self._since: float | None = None  # when the first pose of this call was done

    def __call__(self, event: events.Event) -> None:
        if isinstance(event, events.RunStarted | events.RunStopped | events.StateChanged):
            self._frame(event)
        elif isinstance(event, events.Message) and event.source == events.OPERATOR:
            self._say(event.text)
        elif isinstance(event, events.Message) and event.level in ("warning", "error"):
            self._say(f"{event.level}: {event.text}")
        else:
            self._count(event)

    def _frame(self, event: events.RunStarted | events.RunStopped | events.StateChanged) -> None:
        """Begin and end of the bar; it rests while a question stands on the terminal."""
        waiting = isinstance(event, events.StateChanged) and event.state == "connecting" and not self._console.is_terminal
        self._begin("connecting to the devices" if waiting else "")
        match event:
            case events.RunStarted():
                self._total, self._before = event.n_poses, event.n_poses - len(event.route) if event.route else 0
                self._done, self._since = 0, None  # an investigation is several runs
                if event.simulated:
                    self._say(f"*** {SIMULATED} ***")
                if self._task is not None:
                    self._bar.remove_task(self._task)
                self._task = self._bar.add_task("connecting", total=event.n_poses, completed=self._before, station="-", balls="-")
                self._bar.start()
            case events.StateChanged(state="waiting" | "paused"):
                self._bar.stop()  # it would write over the question
            case events.StateChanged(state="moving"):
                if self._task is not None:
                    self._bar.start()
            case events.RunStopped():
                self._bar.stop()
                end = (
                    event.reason
                    if event.exit_status == "success"
                    else f"run ended after {self._before + self._done} of {self._total} poses"
                )
                self._say(end)  # why, the command says itself

    def _count(self, event: events.Event) -> None:
        """Step, station, balls and poses done."""
        match event:
            case events.StepStarted():
                self._step, self._stepped = event.name, True
            case events.StationReached():
                self._station = event.station
            case events.PoseReached():
                self._balls = 0
            case events.CentresFound():
                self._balls = max(self._balls, len(event.ball))
            case events.PoseDone():
                self._done += 1
                self._line(event.time_s)
        if self._task is not None and isinstance(event, events.PoseDone | events.StepStarted | events.StationReached | events.CentresFound):
            done, step = self._before + self._done, self._step or "connecting"
            self._bar.update(self._task, completed=done, description=step, station=self._station, balls=str(self._balls))

    def _line(self, elapsed: float) -> None:
        if self._console.is_terminal:
            return
        done = self._before + self._done
        left = self._left(elapsed, self._total - done)
        if self._stepped or done % 10 == 0 or done == self._total:
            self._stepped = False
            balls = f", {self._balls} ball{'s' * (self._balls != 1)}" if self._balls else ""  # a part, or a scan read later
            self._say(f"{self._step}: {done} of {self._total} poses, station {self._station}{balls}{left}")

    def _say(self, text: str) -> None:
        """A line that stays: broken between words on a terminal, whole elsewhere."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=not self._console.is_terminal)

    def _left(self, now: float, poses: int) -> str:
        """The time left, from the poses between the first one of this call and now; nothing is known of it before the second."""
        if self._since is None:
            self._since = now
        if self._done < 2 or not poses:
            return ""
        return f", about {(now - self._since) / (self._done - 1) * poses:.0f} s left"

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
            TextColumn("pose {task.completed:.0f} of {task.total:.0f}"),
            TextColumn("station {task.fields[station]}  balls {task.fields[balls]}", markup=False),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._task: TaskID | None = None
        self._step, self._station, self._balls, self._done, self._total, self._stepped = "", "-", 0, 0, 0, False

    def __call__(self, event: events.Event) -> None:
        if isinstance(event, events.RunStarted | events.RunStopped | events.StateChanged):
            self._frame(event)
        elif isinstance(event, events.Message) and event.level in ("warning", "error"):
            self._console.print(f"{event.level}: {event.text}", markup=False, soft_wrap=True)
        else:
            self._count(event)

    def _frame(self, event: events.RunStarted | events.RunStopped | events.StateChanged) -> None:
        """Begin and end of the bar; it rests while a question stands on the terminal."""
        waiting = isinstance(event, events.StateChanged) and event.state == "connecting" and not self._console.is_terminal
        self._begin("connecting to the devices" if waiting else "")
        match event:
            case events.RunStarted():
                self._total = event.n_poses
                if event.simulated:
                    self._console.print(f"*** {SIMULATED} ***", markup=False, soft_wrap=True)
                self._task = self._bar.add_task("connecting", total=event.n_poses, station="-", balls="-")
                self._bar.start()
            case events.StateChanged(state="waiting" | "paused"):
                self._bar.stop()  # it would write over the question
            case events.StateChanged(state="moving"):
                if self._task is not None:
                    self._bar.start()
            case events.RunStopped():
                self._bar.stop()
                end = event.reason if event.exit_status == "success" else f"run ended after {self._done} of {self._total} poses"
                self._console.print(end, markup=False, soft_wrap=True)  # why, the command says itself

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
            self._bar.update(
                self._task, completed=self._done, description=self._step or "connecting", station=self._station, balls=str(self._balls)
            )

    def _line(self, elapsed: float) -> None:
        if self._console.is_terminal:
            return
        remaining = elapsed / self._done * (self._total - self._done)
        if self._stepped or self._done % 10 == 0 or self._done == self._total:
            self._stepped = False
            self._console.print(
                f"{self._step}: pose {self._done} of {self._total}, station {self._station}, {self._balls} balls, {remaining:.0f} s left",
                markup=False,
                soft_wrap=True,
            )

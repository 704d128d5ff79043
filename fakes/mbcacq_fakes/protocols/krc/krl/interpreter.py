"""One interpreter of the controller (robot or submit): runs a program, tick by tick, with interrupts."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, Protocol

from mbcacq_fakes.protocols.krc.krl.program import Program, Resume
from mbcacq_fakes.protocols.krc.krl.values import KrlError

_MAX_TURNS = 10_000  # of loops, without waiting


class KrlMotion(Protocol):
    """What a robot interpreter drives."""

    def begin(self, target: Any) -> None: ...
    def brake(self) -> None: ...
    def abandon(self) -> None: ...
    @property
    def moving(self) -> bool: ...


class Interpreter:
    """``tick(now)`` runs the program up to its next wait. Without ``motion`` (submit) a program may not move.

    Interrupts fire on the rising edge of their condition only, as on a controller.
    """

    def __init__(self, program: Program, name: str, motion: KrlMotion | None = None) -> None:
        self._program, self._name, self._motion = program, name, motion
        self._interrupts: dict[int, tuple[Callable[[], Any], Any]] = {}
        self._on: dict[int, bool] = {}
        self.halted = False
        self._main: Generator[Any, Any, Any] = program.start(name, self)
        self._stack: list[tuple[Generator[Any, Any, Any], tuple[str, Any]]] = [(self._main, ("idle", None))]
        self._turns = 0

    # what translated programs call

    def declare(self, number: int, condition: Callable[[], Any], handler: Any) -> None:
        self._interrupts[number] = (condition, handler)

    def enable(self, number: int, on: bool) -> None:
        if number not in self._interrupts:
            raise KrlError(f"interrupt {number} is not declared")
        if on:
            self._on[number] = bool(self._interrupts[number][0]())
        else:
            self._on.pop(number, None)

    def turn(self) -> None:
        """Once a turn of every loop."""
        self._turns += 1
        if self._turns > _MAX_TURNS:
            raise KrlError(f"{self._name} runs in a circle without waiting")

    # what the controller calls

    def tick(self, now: float) -> None:
        """``now``: s, robot clock."""
        if self.halted:
            return
        self._fire()
        self._turns = 0
        while not self.halted and not self._waiting(now):
            self._advance(now)

    def _fire(self) -> None:
        for number, before in list(self._on.items()):
            condition, handler = self._interrupts[number]
            now_true = bool(condition())
            self._on[number] = now_true
            if now_true and not before:
                self._stack.append((handler(self), ("go", None)))

    def _waiting(self, now: float) -> bool:
        kind, value = self._stack[-1][1]
        if kind == "wait":
            return now < value - 1e-9
        if kind in ("ptp", "brake"):
            return self._motion is not None and self._motion.moving
        if kind == "idle" and value != now:
            self._stack[-1] = (self._stack[-1][0], ("go", None))
            return False
        return kind == "idle"

    def _advance(self, now: float) -> None:
        try:
            self._go_on(next, now)
        except Resume:
            self._resume(now)

    def _go_on(self, step: Callable[[Generator[Any, Any, Any]], tuple[str, Any]], now: float) -> None:
        running, _ = self._stack[-1]
        try:
            request, value = step(running)
        except StopIteration:
            self._stack.pop()
            self.halted = not self._stack
            return
        self._take(running, request, value, now)

    def _resume(self, now: float) -> None:
        """Leave the interrupt and, in the program below it, everything under the DEF that declared it."""
        self._stack.pop()
        if not self._stack:
            raise KrlError("RESUME outside of an interrupt")
        if self._motion is not None:
            self._motion.abandon()
        try:
            self._go_on(lambda running: running.throw(Resume()), now)
        except Resume as error:
            raise KrlError("RESUME needs a program below the one that declared the interrupt") from error

    def _take(self, running: Generator[Any, Any, Any], request: str, value: Any, now: float) -> None:
        if request == "wait":
            value = now + value
        elif request == "idle":
            value = now
        elif request == "halt":
            self.halted = True
        elif self._motion is None:
            raise KrlError("a submit program cannot move the arm")
        elif request == "brake":
            self._motion.brake()
        else:
            self._motion.begin(value)
        self._stack[-1] = (running, (request, value))

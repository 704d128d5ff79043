"""Set points of one arm, one a controller cycle: jerk-limited, joint-straight from rest, braking within the same limits. deg, s."""

from __future__ import annotations

from collections.abc import Sequence

from ruckig import ControlInterface, InputParameter, Result, Ruckig, RuckigError, Synchronization, Trajectory

from mbcacq_kuka.rsi.shared import RsiCommand

_SHARES = (1.0, 0.999, 0.99, 0.97)


class MotionRefused(ValueError):
    """A motion that cannot be made within its limits."""


class RsiMotion:
    """The commanded joint angles. ``step`` gives the next ones; without a motion they stay."""

    def __init__(self, start: Sequence[float], cycle_s: float, joint_limits: Sequence[tuple[float, float]]) -> None:
        n = len(start)
        self._otg, self._trajectory, self._n = Ruckig(n), Trajectory(n), n
        self._cycle_s, self._joint_limits = cycle_s, joint_limits
        self._elapsed = self._duration = 0.0
        self._dynamics: tuple[list[float], list[float], list[float]] | None = None
        self._velocity = self._acceleration = [0.0] * n
        self._target: list[float] | None = None
        self._pending = False  # the way to the target is to be planned again
        self._before = (tuple(start), [0.0] * n, [0.0] * n)
        self.position: tuple[float, ...] = tuple(start)
        self.moving = False

    def move(self, command: RsiCommand) -> None:
        """Turn towards a target from whatever the arm is doing now. Raises MotionRefused; then the present motion goes on."""
        self._plan(list(command.target), (list(command.speed), list(command.acceleration), list(command.jerk)))

    def stop(self) -> None:
        """Brake every axis as fast as the last motion's limits allow, then hold."""
        if not self.moving or self._dynamics is None:
            return
        self._target = None
        if self._pending:
            self.freeze(self.position)
            return
        ask = self._ask(self._dynamics)
        ask.control_interface = ControlInterface.Velocity
        ask.synchronization = Synchronization.No
        trajectory = Trajectory(self._n)
        try:
            self._calculate(ask, trajectory)
        except MotionRefused:
            return  # the motion under way ends at rest in any case
        self._begin(trajectory)

    def hold(self, position: Sequence[float]) -> None:
        """The controller held the set point ``position`` for a cycle or more, so the motion goes on from there, from rest."""
        target = self._target
        self.freeze(position)
        if target is not None and tuple(target) != self.position:
            self._target, self._pending, self.moving = target, True, True

    def reaches(self, position: Sequence[float], other: Sequence[float], jerk: bool = True) -> bool:
        """Whether an arm that stands at one place may be at the other in the next cycle, within the limits of the last motion; jerk: that
        of the jerk too."""
        limits = (self._dynamics or ([0.0] * self._n,) * 3)[: 3 if jerk else 2]
        most = [min(limit * self._cycle_s**order for order, limit in enumerate(axis, 1)) for axis in zip(*limits, strict=True)]
        return all(abs(b - a) <= near for a, b, near in zip(position, other, most, strict=True))

    def freeze(self, position: Sequence[float]) -> None:
        """Stay at ``position``: no set point changes any more."""
        self.position, self.moving, self._pending, self._target = tuple(position), False, False, None
        self._velocity = self._acceleration = [0.0] * self._n

    def step(self) -> tuple[float, ...]:
        """The set point of the next cycle, (n,) deg. Raises MotionRefused where a motion that was held cannot go on: it is given up."""
        if self._pending:
            self._plan_again()
        self._before = self.position, self._velocity, self._acceleration
        if self.moving:
            self._elapsed += self._cycle_s
            position, self._velocity, self._acceleration = self._trajectory.at_time(self._elapsed)
            if self._elapsed >= self._duration:
                self.moving = False
                self._velocity = self._acceleration = [0.0] * self._n
            self.position = tuple(position)
        return self.position

    def _plan_again(self) -> None:
        target, dynamics = self._target, self._dynamics
        self.freeze(self.position)
        if target is not None and dynamics is not None:
            self._plan(target, dynamics)

    def brake_instead(self, limits: tuple[list[float], list[float], list[float]]) -> None:
        """The last step must not be made: brake from where the motion was before it, within these limits."""
        self.position, self._velocity, self._acceleration = self._before
        self.moving, self._pending, self._dynamics = True, False, limits
        self.stop()

    def _plan(self, target: list[float], limits: tuple[list[float], list[float], list[float]]) -> None:
        ask = self._ask(limits)
        ask.target_position = target
        ask.synchronization = Synchronization.Phase  # a straight line in joint space, as the path was checked for collisions
        trajectory = Trajectory(self._n)
        self._calculate(ask, trajectory)
        for axis, (extrema, (low, high)) in enumerate(zip(trajectory.position_extrema, self._joint_limits, strict=True)):
            if self.moving and (extrema.min < low - 1e-9 or extrema.max > high + 1e-9):
                reach = f"{extrema.min:.2f}..{extrema.max:.2f}°"
                raise MotionRefused(f"A{axis + 1} would swing to {reach}, outside its limits {low:g}..{high:g}°")
        self._dynamics, self._target = limits, target
        self._begin(trajectory)

    def _ask(self, limits: tuple[list[float], list[float], list[float]]) -> InputParameter:
        ask = InputParameter(self._n)
        ask.current_position, ask.current_velocity, ask.current_acceleration = list(self.position), self._velocity, self._acceleration
        ask.target_velocity = ask.target_acceleration = [0.0] * self._n
        ask.max_velocity, ask.max_acceleration, ask.max_jerk = limits
        return ask

    def _calculate(self, ask: InputParameter, trajectory: Trajectory) -> None:
        jerk = ask.max_jerk
        for share in _SHARES:  # ruckig misses a rare case where two profiles meet to the last digit; a little less jerk avoids it
            ask.max_jerk = [share * v for v in jerk]
            try:
                if self._otg.calculate(ask, trajectory) in (Result.Working, Result.Finished):
                    return
            except (RuckigError, ValueError):  # a result that its Python bindings do not know, of a duration that is too long
                continue
        raise MotionRefused("no motion to this target exists within the limits of speed, acceleration and jerk, or it would take hours")

    def _begin(self, trajectory: Trajectory) -> None:
        self._trajectory, self._duration, self._elapsed = trajectory, trajectory.duration, 0.0
        self.moving, self._pending = True, False

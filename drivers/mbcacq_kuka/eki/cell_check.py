"""Is the cell at the other end the one the plan was made for? Raises IdentityError with one sentence that says what differs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from mbcacq.devices import DeviceFault, IdentityError, same_model
from mbcacq_kuka.eki.options import EkiOptions, mode_name
from mbcacq_kuka.eki.telegrams import AXES, Hello, State, interface

_FRAME_MM, _FRAME_DEG = 0.01, 0.01
_LEVER_MM = 1000.0


def check_cell(name: str, model: str, options: EkiOptions, hello: Hello, state: State) -> None:
    """Everything that is known after connecting. Raises IdentityError, DeviceFault (stopped)."""
    where = f"robot '{name}': the controller at {options.address}"
    check_robot(where, model, options, hello)
    check_tool(where, options, hello, state)
    check_mode(where, options, state)
    slides = {axis.name for axis in options.external_axes if axis.slides}
    for axis, value, (low, high) in zip(options.axes, state.axis, options.limits.tolist(), strict=True):
        unit = " mm" if axis in slides else "°"
        if not low - 1.0 <= value <= high + 1.0:
            raise IdentityError(
                f"{where} shows {axis} at {round(value, 2) + 0.0:.2f}{unit}, outside the plan's limits {low:g}..{high:g}{unit}; "
                "jog it inside or correct the robot model"
            )
    check_flange(where, options, hello, state)
    check_stops(where, state)


def check_robot(where: str, model: str, options: EkiOptions, hello: Hello) -> None:
    wanted = interface(options.axes)
    if hello.interface != wanted:
        raise IdentityError(
            f"{where} runs programs for '{hello.interface}', this plan needs '{wanted}'; "
            "copy the files that `mbcacq controller-files` writes"
        )
    if hello.axes != 6:
        raise IdentityError(f"{where} drives {hello.axes} axes, this driver is for 6")
    if model and not same_model(model, hello.model):
        raise IdentityError(f"{where} drives a '{hello.model}', the plan is for '{model}'; correct the plan's robot model or the address")


def check_tool(where: str, options: EkiOptions, hello: Hello, state: State) -> None:
    for what, got, wanted in (("tool", state.tool, options.tool), ("base", state.base, options.base)):
        if got != wanted:
            raise IdentityError(
                f"{where} works with {what} {got}, the plan expects {what} {wanted}; "
                "write the controller files again or correct the plan's options"
            )
    for what, got, wanted in (("tool", hello.tool_frame, options.tool_frame), ("base", hello.base_frame, options.base_frame)):
        if wanted is not None and (away := frame_distance(got, wanted)) is not None:
            raise IdentityError(f"{where} has {away} between its {what} data and the plan's {what}_frame; correct one of them")
    if options.load_kg is not None and abs(hello.load_kg - options.load_kg) > 0.05 + 0.05 * options.load_kg:
        raise IdentityError(
            f"{where} counts with a load of {hello.load_kg:g} kg, the plan says {options.load_kg:g} kg; correct the load data of its tool"
        )


def check_mode(where: str, options: EkiOptions, state: State) -> None:
    if state.mode not in options.modes:
        raise IdentityError(
            f"{where} is in mode {mode_name(state.mode)}, the plan expects {' or '.join(options.mode)}; turn the mode selector"
        )
    if options.override is not None and state.override != options.override:
        raise IdentityError(
            f"{where} has an override of {state.override} %, the plan expects {options.override} %; "
            "set it on the smartPAD or set option override"
        )


def check_flange(where: str, options: EkiOptions, hello: Hello, state: State) -> None:
    """The controller's own forward kinematics must agree with the plan's robot: finds wrong machine data and wrong models."""
    if options.kinematics is None:
        return
    robroot, tool = np.linalg.inv(_frame(hello.robroot)), np.linalg.inv(_frame(hello.tool_frame))
    reported = robroot @ _frame(hello.base_frame) @ _frame(state.cart) @ tool
    own = flange(options.kinematics, state.axis[: len(AXES)])
    away = float(np.linalg.norm(reported[:3, 3] - own[:3, 3]))
    carried = [axis for axis in options.external_axes if axis.carries_arm]
    if carried:  # the controller may count a track to the arm or not: what slides turns nothing
        turn = float(Rotation.from_matrix(own[:3, :3].T @ reported[:3, :3]).magnitude())
        away = turn * _LEVER_MM if all(axis.slides for axis in carried) else 0.0
    if not away <= options.flange_tolerance_mm:
        raise IdentityError(
            f"{where} places its flange {away:.1f} mm from where the plan's robot model does at the same joint angles; "
            "the robot model, the machine data (MADA) or $ROBROOT is another one"
        )


def check_stops(where: str, state: State) -> None:
    """Raises DeviceFault for what keeps an arm from moving."""
    if state.emergency_stop:
        raise DeviceFault(f"{where} is in emergency stop; release and acknowledge it")
    if state.guard_stop:
        raise DeviceFault(f"{where} is in operator safety (guard) stop; close the guard and acknowledge it")


def frame_distance(a: Sequence[float], b: Sequence[float]) -> str | None:
    """How far two frames are apart, in words; None if they agree."""
    A, B = _frame(a), _frame(b)
    shift = float(np.linalg.norm(A[:3, 3] - B[:3, 3]))
    turn = float(np.degrees(Rotation.from_matrix(A[:3, :3].T @ B[:3, :3]).magnitude()))
    return None if shift <= _FRAME_MM and turn <= _FRAME_DEG else f"{shift:.2f} mm and {turn:.2f}°"


def flange(rows: Sequence[Sequence[float]], axis_deg: Sequence[float]) -> np.ndarray:
    """T_base_flange (4, 4), mm: product of Rz(sign q + theta) Tz(d) Tx(a) Rx(alpha) Ry(beta) over the rows (modified DH, angles deg)."""
    T = np.eye(4)
    for angle, (sign, theta, d, a, alpha, beta) in zip(axis_deg, rows, strict=True):
        T = T @ _frame((0.0, 0.0, d, sign * angle + theta, 0.0, 0.0)) @ _frame((a, 0.0, 0.0, 0.0, 0.0, alpha))
        T = T @ _frame((0.0, 0.0, 0.0, 0.0, beta, 0.0))
    return T


def _frame(pose: Sequence[float]) -> np.ndarray:
    """X, Y, Z, A, B, C -> (4, 4): A about z, then B about the new y, then C about the new x."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_euler("ZYX", pose[3:], degrees=True).as_matrix(), pose[:3]
    return T

"""Periodic error of a joint in its own angle; the orders are found by a spectral scan, not assumed.

An error is called periodic only if the travel covers a period, or half of one for an order that the gear has by its construction. Slower
errors are unmodelled functions of the angle, which hold where the angle was.
"""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration, PeriodicInMotion
from mbcacq.effects.effect import ORDER, Candidate, Hyperparameter, Report, StandstillRows, Support, angle, number
from mbcacq.effects.functions import LEAST_PERIODS, DescribedPart, cosine, periods_covered, sine
from mbcacq.quantities import in_degrees

NAME = "gear_transmission_error"
DECLARED = Declaration(
    periodic_in_motion=PeriodicInMotion(channel="q_joint", lowest_order=0.0, amplitude="amplitude_deg", scale=float(in_degrees(1))),
    challenge=Challenge(number=4, in_motion=6),
)
# Data sheets state 0.3 to 1 mrad of transmission error; a disc of an encoder 40 mm wide that sits off by 0.1 mm makes 5 mrad.
LARGEST = Support(5e-3, "no gear or encoder has a periodic error of more than 5 mrad")
LOWEST_ORDER, HIGHEST_ORDER = 1.0, 260.0  # periods a turn of the joint
LEAST_OF_PREFERRED = 0.5  # periods of an order that the gear has by its construction


def candidates(context: Context) -> list[Candidate]:
    """For each joint that moves, sine and cosine (rad) of an order to be found, at four values a period of the range of its angle."""
    gear = context.obs.cell.robot.gear_ratio
    out = []
    for i in range(context.n):
        q = context.obs.q[:, i]
        span = np.ptp(q)
        if span < 0.05:
            continue
        ratio = None if gear is None else abs(float(gear[i]))
        highest = HIGHEST_ORDER if ratio is None else max(HIGHEST_ORDER, 2.1 * ratio)
        step = 0.25 * 2 * np.pi / span
        orders = np.arange(max(LOWEST_ORDER, LEAST_PERIODS * 2 * np.pi / span), highest, min(step, 0.5))
        built = (1.0, 2.0, 3.0, 4.0) + (() if ratio is None else (ratio, 2 * ratio))
        preferred = tuple(order for order in built if periods_covered(q, order) >= LEAST_OF_PREFERRED)
        if not len(orders) + len(preferred):
            continue
        values, independent = np.unique(np.concatenate([orders, preferred])), max(highest * span / (2 * np.pi), 2.0)
        hyper = Hyperparameter("order", values, independent, preferred=preferred, kind=ORDER)
        rows, report = rows_of(i, context.position(i)), report_of(context.axes[i], q)
        out.append(Candidate(NAME, (context.axes[i],), f"q{context.tags[i]}", rows, report, hyper, several=True, support=LARGEST))
    return out


def rows_of(i: int, on: str) -> StandstillRows:
    """Sine and cosine of joint i by its position."""
    return StandstillRows(lambda order: [DescribedPart("joint", i, 0, (sine(on, order), cosine(on, order)))], np.array([3e-5, 3e-5]))


def report_of(joint: str, q: np.ndarray) -> Report:
    """Order, amplitude and phase of ``amplitude * sin(order * q + phase)``.

    The order is as uncertain as a change of phase over the spread of the angle allows, and the phase at q = 0 with it.
    """
    spread, middle = max(float(q.std()), 1e-9), float(q.mean())

    def report(c, v, order):
        amplitude = max(float(np.hypot(c[0], c[1])), 1e-30)
        along = np.array([c[0], c[1]]) / amplitude
        across = np.array([-c[1], c[0]]) / amplitude**2
        phase_std = float(np.sqrt(across @ v @ across))
        order_std = phase_std / spread
        return {
            f"{joint}.order": number(order.value, order_std),
            f"{joint}.amplitude_deg": angle(amplitude, np.sqrt(along @ v @ along)),
            f"{joint}.phase_deg": angle(np.arctan2(c[1], c[0]), np.hypot(phase_std, order_std * middle)),
        }

    return report

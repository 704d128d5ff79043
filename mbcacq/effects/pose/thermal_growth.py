"""A link that grows with a recorded temperature or, where none is recorded, with the time since the first pose."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Missing, Part, number
from mbcacq.effects.pose import warm_up

NAME = "thermal_growth"


def candidates(context: Context) -> list[Candidate]:
    """For each link longer than 30 mm, its growth along itself with each temperature, or with time."""
    recorded = {k: v for k, v in context.obs.temperatures.items() if np.ptp(v) > 0.2}
    if not recorded and context.obs.time_s is None:
        raise Missing("neither temperatures nor times recorded")
    links = [i for i in range(context.n) if np.hypot(context.state.chain.a[i], context.state.chain.d[i]) > 30]
    out = [with_temperature(context, i, column, values) for i in links for column, values in recorded.items()]
    if not recorded:
        out += [with_warm_up(context, i) for i in links]
    return out


def direction(context: Context, i: int) -> np.ndarray:
    """Unit vector (3,) from the frame before link i to the one behind it, in the axes of the latter; it is the same at every angle."""
    chain = context.obs.cell.robot.chain
    one = chain.link_transforms(np.zeros((1, context.n)))[0, i]
    along = one[:3, :3].T @ one[:3, 3]
    return along / max(float(np.linalg.norm(along)), 1e-12)


def with_temperature(context: Context, i: int, column: str, temperature: np.ndarray) -> Candidate:
    along = direction(context, i)
    change = (temperature - temperature[np.argmin(context.order)])[:, None]
    parts = [Part("frame", i + 1, c, change * along[c]) for c in range(3) if abs(along[c]) > 1e-6]

    def report(c, v, _):
        return {f"link{i + 1}.growth_mm_per_K": number(c[0], np.sqrt(v[0, 0]))}

    return Candidate(NAME, (f"link{i + 1}",), column, lambda _: parts, report, np.array([0.01]))


def with_warm_up(context: Context, i: int) -> Candidate:
    along, hyper, fade = direction(context, i), warm_up.time_constant(context), warm_up.fading(context)
    used = [c for c in range(3) if abs(along[c]) > 1e-6]

    def build(tau):
        grown = 1 - fade(np.array([tau]))[0]
        return [Part("frame", i + 1, c, grown * along[c]) for c in used]

    def report(c, v, tau):
        return {
            f"link{i + 1}.growth_mm": number(c[0], np.sqrt(v[0, 0])),
            f"link{i + 1}.time_constant_s": number(tau, warm_up.time_constant_std(tau, c, v)),
        }

    return Candidate(NAME, (f"link{i + 1}",), "time", build, report, np.array([0.1]), hyper)

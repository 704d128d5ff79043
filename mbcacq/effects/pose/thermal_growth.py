"""A link growing with a recorded temperature or, where none is recorded, with warm-up time."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Missing, Part, number
from mbcacq.effects.pose import warm_up

NAME = "thermal_growth"


def candidates(s: Context) -> list[Candidate]:
    recorded = {k: v for k, v in s.obs.temperatures.items() if np.ptp(v) > 0.2}
    if not recorded and s.obs.time_s is None:
        raise Missing("neither temperatures nor times recorded")
    links = [i for i in range(s.n) if np.hypot(s.state.chain.a[i], s.state.chain.d[i]) > 30]
    out = [make(s, i, column, values) for i in links for column, values in recorded.items()]
    if not recorded:
        out += [make_warmup(s, i) for i in links]
    return out


def direction(s: Context, i: int) -> np.ndarray:
    """(3,) unit vector along link i in the frame behind it: d along the joint's axis and a along x, as seen after the MD-H rotation."""
    chain = s.obs.cell.robot.chain
    one = chain.link_transforms(np.zeros((1, s.n)))[0, i]
    along = one[:3, :3].T @ one[:3, 3]
    return along / max(float(np.linalg.norm(along)), 1e-12)


def make(s: Context, i: int, column: str, temperature: np.ndarray) -> Candidate:
    along = direction(s, i)
    change = (temperature - temperature[np.argmin(s.order)])[:, None]
    parts = [Part("frame", i + 1, c, change * along[c]) for c in range(3) if abs(along[c]) > 1e-6]

    def report(c, v, _):
        return {f"link{i + 1}.growth_mm_per_K": number(c[0], np.sqrt(v[0, 0]))}

    return Candidate(NAME, (f"link{i + 1}",), column, lambda _: parts, report, np.array([0.01]))


def make_warmup(s: Context, i: int) -> Candidate:
    along, hyper, fade = direction(s, i), warm_up.time_constant(s), warm_up.fading(s)
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

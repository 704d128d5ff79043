"""An error of the scanner's unit of length, the same along all axes or different along each."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Missing, Part, Report, number, vector

NAME = "scanner_scale"


def candidates(context: Context) -> list[Candidate]:
    """One scale, three scales, and the scale of each axis alone, in parts per million."""
    if not context.scanner_on_flange or np.ptp(context.obs.xyz, axis=0).max() == 0:
        raise Missing("no field of view: the measured points are all at one place, or not a scanner's")
    ppm, xyz = 1e-6, context.obs.xyz
    one = [Part("point", 0, c, ppm * xyz[:, c : c + 1]) for c in range(3)]
    three = [Part("point", 0, c, ppm * xyz[:, c : c + 1] * np.eye(3)[c]) for c in range(3)]

    def report_one(c, v, _):
        return {"scale_ppm": number(c[0], np.sqrt(v[0, 0]))}

    def report_three(c, v, _):
        return {"scale_ppm": vector(c, v)}

    def report_axis(axis: int) -> Report:
        only = np.eye(3)[axis]
        return lambda c, v, _: {"scale_ppm": vector(c[0] * only, v[0, 0] * np.diag(only))}

    single = [
        Candidate(
            NAME,
            ("scanner",),
            "xyz"[a],
            lambda _, a=a: [Part("point", 0, a, ppm * xyz[:, a : a + 1])],
            report_axis(a),
            np.array([200.0]),
            variant="xyz"[a],
        )
        for a in range(3)
    ]
    return [
        Candidate(NAME, ("scanner",), "z", lambda _: one, report_one, np.array([200.0])),
        Candidate(NAME, ("scanner",), "x", lambda _: three, report_three, np.full(3, 200.0), variant="axes"),
        *single,
    ]

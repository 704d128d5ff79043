"""An encoder or a mastering that jumped between two poses of the run."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Part, number
from mbcacq.effects.pose import steps

NAME = "joint_step"


def candidates(s: Context) -> list[Candidate]:
    functions, hyper = steps.step_functions(s), steps.moment(s)

    def make(i: int) -> Candidate:
        def report(c, v, rank):
            return {
                f"A{i + 1}.at_pose": number(steps.pose_at(s, rank), 0.5),
                f"A{i + 1}.step_deg": number(np.degrees(c[0]), np.degrees(np.sqrt(v[0, 0]))),
            }

        return Candidate(
            NAME,
            (f"A{i + 1}",),
            "pose",
            lambda h: [Part("joint", i, 0, functions(np.array([h]))[0])],
            report,
            np.array([1e-4]),
            hyper,
            (("joint", i, 0),),
            functions,
        )

    return [make(i) for i in range(s.n)]

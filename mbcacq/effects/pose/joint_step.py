"""An encoder or a mastering that jumps between two poses: from ``at_pose`` on, the joint is at its reported angle plus the step."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Part, number
from mbcacq.effects.functions import DescribedPart, of
from mbcacq.effects.pose import steps

NAME = "joint_step"


def candidates(context: Context) -> list[Candidate]:
    """For each joint a step, in rad, at a moment to be found."""
    functions, hyper = steps.step_functions(context), steps.moment(context)

    def of_joint(i: int) -> Candidate:
        def report(c, v, rank):
            return {
                f"A{i + 1}.at_pose": number(steps.pose_at(context, rank), 0.5),
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
            described=lambda h: [DescribedPart("joint", i, 0, (of("pose", "step", float(h or 0.0)),))],
        )

    return [of_joint(i) for i in range(context.n)]

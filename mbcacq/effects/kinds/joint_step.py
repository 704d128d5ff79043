"""An encoder or a mastering that jumps between two poses: from ``at_pose`` on, the joint is at its reported angle plus the step."""

import numpy as np

from mbcacq.effects import over_time
from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import ANY_SIZE, Candidate, StandstillRows, Support, angle, number
from mbcacq.effects.functions import DescribedPart, of

NAME = "joint_step"
# A hub or a key slips by the play of its fit (ISO 286, H8/h9 at a diameter of 20 mm: 0.085 mm, some mrad). A belt skips a tooth,
# which is degrees; where a gear has lost as much, the arm was mastered anew, and both parts are two recordings.
LARGEST = Support(5e-3, "a joint that jumps by more than 5 mrad was mastered anew, and both parts are two recordings")
SKIPPING = ("belt", "friction_wheel")
DECLARED = Declaration(acts_in_time=True, challenge=Challenge(number=8))


def candidates(context: Context) -> list[Candidate]:
    """For each joint a step, in rad, at a moment to be found."""
    hyper = over_time.moment(context)

    def of_joint(i: int) -> Candidate:
        def report(c, v, rank):
            return {
                f"{context.axes[i]}.at_pose": number(over_time.pose_at(context, rank.value), 0.5),
                f"{context.axes[i]}.step_deg": angle(c[0], np.sqrt(v[0, 0])),
            }

        support = ANY_SIZE if context.obs.cell.robot.drive(i) in SKIPPING else LARGEST
        rows = StandstillRows(lambda rank: [DescribedPart("joint", i, 0, (of("pose", "step", rank),))], np.array([1e-4]))
        return Candidate(NAME, (context.axes[i],), "pose", rows, report, hyper, support=support)

    return [of_joint(i) for i in range(context.n)]

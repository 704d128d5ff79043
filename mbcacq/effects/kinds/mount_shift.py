"""A scanner that moves on its bracket between two poses of the run; translation and rotation are in flange axes."""

import numpy as np

from mbcacq.effects import over_time
from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Missing, StandstillRows, angles, number, vector
from mbcacq.effects.functions import ZERO, DescribedPart, of

NAME = "mount_shift"
DECLARED = Declaration(acts_in_time=True, challenge=Challenge(number=10))


def candidates(context: Context) -> list[Candidate]:
    """One candidate: three translations (mm) and, where the measurement shows them, three rotations (rad), at a moment to be found."""
    if not context.scanner_on_flange and context.obs.rotation is None:
        components = (0, 1, 2)
    else:
        components = (0, 1, 2, 3, 4, 5)
    if context.obs.n_poses < 12:
        raise Missing("fewer than 12 poses")
    hyper = over_time.moment(context)
    k = len(components)

    def described(h):
        step = of("pose", "step", h)
        return [DescribedPart("frame", context.n, c, (ZERO,) * j + (step,) + (ZERO,) * (k - 1 - j)) for j, c in enumerate(components)]

    def report(c, v, rank):
        out = {"at_pose": number(over_time.pose_at(context, rank.value), 0.5), "translation_mm": vector(c[:3], v[:3, :3])}
        if k == 6:
            out["rotation_deg"] = angles(c[3:], v[3:, 3:])
        return out

    return [Candidate(NAME, ("mount",), "pose", StandstillRows(described, np.array([0.03] * 3 + [1e-4] * 3)[:k]), report, hyper)]

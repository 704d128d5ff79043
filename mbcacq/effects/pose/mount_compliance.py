"""A scanner bracket that sags with its attitude to gravity: it tilts under the moment of the tool and shifts under its weight."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.effect import Candidate, Part, number
from mbcacq.geometry.gravity import STANDARD_GRAVITY

NAME = "mount_compliance"


def candidates(context: Context) -> list[Candidate]:
    """The tilt, the shift, and both, in flange axes; where no masses are given, of one kilogram halfway to the scanner."""
    mass = context.payload_mass if np.all(context.payload_mass > 0) else np.ones(context.obs.n_poses)
    com = context.obs.cell.robot.payload_com
    if not np.any(com):
        com = context.state.T_flange_scanner.reshape(-1, 4, 4)[0, :3, 3] * 0.5
    force = mass[:, None] * STANDARD_GRAVITY * context.flange_gravity
    moment = np.cross(com[None], force) * 1e-3
    none = np.zeros(len(force))
    tilt = [Part("frame", context.n, 3 + c, moment[:, c : c + 1]) for c in range(3)]
    shift = [Part("frame", context.n, c, force[:, c : c + 1]) for c in range(3)]
    both = [Part("frame", context.n, 3 + c, np.stack([moment[:, c], none], 1)) for c in range(3)]
    both += [Part("frame", context.n, c, np.stack([none, force[:, c]], 1)) for c in range(3)]

    def report(c, v, _):
        return {"compliance_rad_per_Nm": number(c[0], np.sqrt(v[0, 0])), "compliance_mm_per_N": number(c[1], np.sqrt(v[1, 1]))}

    def report_tilt(c, v, _):
        return {"compliance_rad_per_Nm": number(c[0], np.sqrt(v[0, 0]))}

    def report_shift(c, v, _):
        return {"compliance_mm_per_N": number(c[0], np.sqrt(v[0, 0]))}

    where, cause = ("mount",), f"gravity_torque_{context.n}"
    typical_tilt, typical_shift = 2e-5, 1e-3
    return [
        Candidate(NAME, where, cause, lambda _: tilt, report_tilt, np.array([typical_tilt]), variant="tilt"),
        Candidate(NAME, where, cause, lambda _: shift, report_shift, np.array([typical_shift]), variant="shift"),
        Candidate(NAME, where, cause, lambda _: both, report, np.array([typical_tilt, typical_shift])),
    ]

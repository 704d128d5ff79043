"""A scanner bracket that sags with its attitude to gravity: it tilts under the moment of the tool and shifts under its weight."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, number
from mbcacq.effects.functions import ZERO, Column, DescribedPart, linear, scaled

NAME = "mount_compliance"
DECLARED = Declaration(challenge=Challenge(number=3))


def candidates(context: Context) -> list[Candidate]:
    """The tilt, the shift, and both, in flange axes; where no masses are given, of one kilogram halfway to the scanner."""
    com = context.obs.cell.robot.payload_com
    if not np.any(com):
        com = context.state.T_flange_scanner.reshape(-1, 4, 4)[0, :3, 3] * 0.5
    force = [linear(f"payload_force_{axis}") for axis in "xyz"]
    moment = [moment_about(c, com * 1e-3) for c in range(3)]
    tilt = [DescribedPart("frame", context.n, 3 + c, (moment[c],)) for c in range(3)]
    shift = [DescribedPart("frame", context.n, c, (force[c],)) for c in range(3)]
    both = [DescribedPart("frame", context.n, 3 + c, (moment[c], ZERO)) for c in range(3)]
    both += [DescribedPart("frame", context.n, c, (ZERO, force[c])) for c in range(3)]

    def report(c, v, _):
        return {"compliance_rad_per_Nm": number(c[0], np.sqrt(v[0, 0])), "compliance_mm_per_N": number(c[1], np.sqrt(v[1, 1]))}

    def report_tilt(c, v, _):
        return {"compliance_rad_per_Nm": number(c[0], np.sqrt(v[0, 0]))}

    def report_shift(c, v, _):
        return {"compliance_mm_per_N": number(c[0], np.sqrt(v[0, 0]))}

    where, cause = ("mount",), f"gravity_torque_{context.n}"
    typical_tilt, typical_shift = 2e-5, 1e-3
    return [
        Candidate(NAME, where, cause, parts, reported, np.array(typical), variant=variant)
        for parts, reported, typical, variant in (
            (tilt, report_tilt, [typical_tilt], "tilt"),
            (shift, report_shift, [typical_shift], "shift"),
            (both, report, [typical_tilt, typical_shift], ""),
        )
    ]


def moment_about(c: int, lever: np.ndarray) -> Column:
    """Component c of the moment of the tool's weight at a lever (3,) m, as a function of the weight."""
    a, b = (c + 1) % 3, (c + 2) % 3
    return scaled(linear(f"payload_force_{'xyz'[b]}"), lever[a]) + scaled(linear(f"payload_force_{'xyz'[a]}"), -lever[b])

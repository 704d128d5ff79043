"""A scanner bracket that sags with its attitude to gravity: it tilts under the moment of the tool and shifts under its weight."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, plain_effect
from mbcacq.effects.functions import Column, DescribedPart, linear, scaled

NAME = "mount_compliance"
DECLARED = Declaration(challenge=Challenge(number=3))
TYPICAL_TILT, TYPICAL_SHIFT = 2e-5, 1e-3  # rad/(N m), mm/N of a bracket of sheet metal


def candidates(context: Context) -> list[Candidate]:
    """The tilt and the shift, each of which can be there by itself or with the other, in flange axes; where no masses are given, of one
    kilogram halfway to the scanner. A bracket gives way to its load and never against it.
    """
    com = context.obs.cell.robot.payload_com
    if not np.any(com):
        com = context.state.T_flange_scanner.reshape(-1, 4, 4)[0, :3, 3] * 0.5
    moment = [moment_about(c, com * 1e-3) for c in range(3)]
    tilt = [DescribedPart("frame", context.n, 3 + c, (moment[c],)) for c in range(3)]
    shift = [DescribedPart("frame", context.n, c, (linear(f"payload_force_{axis}"),)) for c, axis in enumerate("xyz")]
    cause = f"gravity_torque_{context.n}"
    return [
        plain_effect(NAME, ["mount"], cause, parts, {name: size}, positive=True, several=True, variant=variant)
        for parts, name, size, variant in (
            (tilt, "compliance_rad_per_Nm", TYPICAL_TILT, "tilt"),
            (shift, "compliance_mm_per_N", TYPICAL_SHIFT, "shift"),
        )
    ]


def moment_about(c: int, lever: np.ndarray) -> Column:
    """Component c of the moment of the tool's weight at a lever (3,) m, as a function of the weight."""
    a, b = (c + 1) % 3, (c + 2) % 3
    return scaled(linear(f"payload_force_{'xyz'[b]}"), lever[a]) + scaled(linear(f"payload_force_{'xyz'[a]}"), -lever[b])

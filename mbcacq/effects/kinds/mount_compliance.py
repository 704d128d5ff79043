"""A scanner bracket that sags with its attitude to gravity: it tilts under the moment of the tool and shifts under its weight."""

import numpy as np

from mbcacq.effects.context import Context
from mbcacq.effects.declaration import Challenge, Declaration
from mbcacq.effects.effect import Candidate, Support, plain_effect
from mbcacq.effects.functions import Column, DescribedPart, linear, scaled

NAME = "mount_compliance"
DECLARED = Declaration(challenge=Challenge(number=3))
# A bracket of steel, 200 mm long and 10 mm thick, yields (250 MPa) when its end has sunk by 3 mm and turned by 24 mrad.
LARGEST_TILT, LARGEST_SHIFT = 0.02, 2.0  # rad, mm under the weight of the tool
LIMIT = "no bracket gives way by more under its own weight and stays elastic"
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
    cause = f"gravity_torque_{context.tags[-1]}"
    weight = float(np.linalg.norm(context.payload_force, axis=1).max())
    lever = max(float(np.linalg.norm(com)) * 1e-3, 1e-9)
    return [
        plain_effect(NAME, ["mount"], cause, parts, {name: size}, positive=True, several=True, variant=variant, support=support)
        for parts, name, size, variant, support in (
            (tilt, "compliance_rad_per_Nm", TYPICAL_TILT, "tilt", Support(LARGEST_TILT / (weight * lever), LIMIT)),
            (shift, "compliance_mm_per_N", TYPICAL_SHIFT, "shift", Support(LARGEST_SHIFT / weight, LIMIT)),
        )
    ]


def moment_about(c: int, lever: np.ndarray) -> Column:
    """Component c of the moment of the tool's weight at a lever (3,) m, as a function of the weight."""
    a, b = (c + 1) % 3, (c + 2) % 3
    return scaled(linear(f"payload_force_{'xyz'[b]}"), lever[a]) + scaled(linear(f"payload_force_{'xyz'[a]}"), -lever[b])

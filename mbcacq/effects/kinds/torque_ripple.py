"""Torque ripple of a motor or a gear: a periodic component of the torque in a joint's own angle.

Its order (periods per turn of the joint) is found in the spectrum of the mismatch, never assumed.
"""

from mbcacq.effects.declaration import Challenge, Declaration, PeriodicInMotion

NAME = "torque_ripple"
DECLARED = Declaration(
    # Lower orders of a torque are those of gravity.
    periodic_in_motion=PeriodicInMotion(channel="tau", lowest_order=6.0, amplitude="amplitude_Nm", scale=1.0),
    motor_side=True,
    challenge=Challenge(in_motion=7),
)

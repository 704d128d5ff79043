"""Effects that show in time: in the joint-side encoder, in following the set point, in the torque. One small file an effect.

Each module has NAME and ``candidates(channel, runs)``. A channel is one recorded signal of one joint (or of all joints, for what
they share); its mismatch is recorded minus simulated.
"""

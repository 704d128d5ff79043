"""Effects that act during motion: in the joint-side encoder, in following the set point, in the torque. One small file an effect.

Each module has NAME and ``candidates(group, runs)``. A group is one kind of recorded signal of all joints that have it; its mismatch is
recorded minus simulated.
"""

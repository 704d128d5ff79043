"""Diagnosis of recordings of motion: joint-side against motor-side angle, set point against actual, torque against rigid body."""

from mbcacq.diagnosis.motion.diagnose import base_alone, diagnose_trajectories, explain_trajectories

__all__ = ["base_alone", "diagnose_trajectories", "explain_trajectories"]

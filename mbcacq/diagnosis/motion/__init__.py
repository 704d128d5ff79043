"""Diagnosis of recordings of motion: joint-side against motor-side angle, set point against actual, torque against rigid body."""

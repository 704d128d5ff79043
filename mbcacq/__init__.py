"""Acquire with a robot-mounted 3D scanner, calibrate the cell, explain what is left.

Lengths are mm, angles rad, time s, mass kg inside the program; degrees appear only in YAML, CSV and on the KUKA wire.
A transform ``T_base_flange`` takes coordinates in the flange frame to coordinates in the base frame.
"""

__version__ = "0.1.0"

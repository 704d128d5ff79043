"""The physical truth behind the fake devices: arm, artefacts, scanner, and whatever effects are injected.

It shares no code with the model that is fitted to it: the kinematics are products of exponentials, gravity acts through the
potential energy, and the scanner casts rays. Lengths mm, angles rad, masses kg, times s; transforms read T_base_flange.
"""

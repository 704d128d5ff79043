"""Parts of ``speed.py``: calibration, balls, inverse kinematics, decoding of scans, each beside its peers."""

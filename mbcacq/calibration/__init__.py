"""From observations to a calibrated cell, and how far to trust it."""

from mbcacq.calibration.calibrated_cell import CalibratedCell, verify
from mbcacq.calibration.maximum_likelihood import calibrate, calibrate_with_effects
from mbcacq.calibration.result_io import state_from_dict
from mbcacq.calibration.verification import Verification
from mbcacq.estimation.options import CalibrationOptions, Noise

__all__ = [
    "CalibratedCell",
    "CalibrationOptions",
    "Noise",
    "Verification",
    "calibrate",
    "calibrate_with_effects",
    "state_from_dict",
    "verify",
]

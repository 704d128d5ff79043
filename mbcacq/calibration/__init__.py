"""From observations to a calibrated cell: one forward model, its derivatives, the estimators, what they could see."""

from mbcacq.calibration.maximum_likelihood import calibrate
from mbcacq.calibration.result import Calibration
from mbcacq.calibration.result_io import state_from_dict
from mbcacq.calibration.verification import Verification, verify
from mbcacq.estimation.options import CalibrationOptions, Noise

__all__ = ["Calibration", "Noise", "CalibrationOptions", "Verification", "calibrate", "state_from_dict", "verify"]

"""From observations to a calibrated cell: one forward model, its derivatives, the estimators, what they could see."""

from mbcacq.calibration.estimate import calibrate
from mbcacq.calibration.options import Noise, Options
from mbcacq.calibration.result import Calibration
from mbcacq.calibration.result_file import state_from_dict
from mbcacq.calibration.verification import Verification, verify

__all__ = ["Calibration", "Noise", "Options", "Verification", "calibrate", "state_from_dict", "verify"]

"""What an arm misses its places by, against a general least-squares solver."""

from dataclasses import replace

import numpy as np
from cells import scanner_cell
from scipy.optimize import least_squares

from mbcacq.calibration.place_errors import missed_mm
from mbcacq.estimation import forward_model
from mbcacq.geometry import se3


def test_no_other_hand_eye_and_stations_leave_less_of_it():
    """Stations with eight balls, and two where each pose shows one ball of a bar, which leaves a rotation of the bar open."""
    cell = scanner_cell(np.random.default_rng(11), stations=3, per_station=5, bars=2)
    obs = cell.observations
    state = replace(cell.truth, chain=obs.cell.robot.chain)

    def residual(step):
        twists = step.reshape(-1, 6) * np.array([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])
        moved = replace(
            state, T_flange_scanner=state.T_flange_scanner @ se3.exp(twists[0]), T_base_station=state.T_base_station @ se3.exp(twists[1:])
        )
        return (obs.xyz - forward_model.predict(obs, moved).xyz).reshape(-1)

    least = least_squares(residual, np.zeros(6 * (1 + len(obs.cell.stations))), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    by_pose = np.bincount(obs.pose, minlength=obs.n_poses) * missed_mm(obs) ** 2
    assert 0.05 < by_pose.sum() / obs.n_centres
    assert 0.999 < by_pose.sum() / (2 * least.cost) < 1 + 1e-6

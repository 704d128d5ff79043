"""Tables of flange and target that are wrong in one way each: none becomes a calibration without a word."""

import numpy as np
import pytest
from test_hand_eye_tables import ALONE, BOTH, poses, rotations, write

import mbcacq
from mbcacq.errors import CalibrationError, ConfigError
from mbcacq.geometry import se3

N = 18
F, C = poses(N)
RNG = np.random.default_rng(6)
C = C @ se3.exp(RNG.normal(0, [0.1, 0.1, 0.1, 3e-4, 3e-4, 3e-4], (N, 6)))
MIXED = RNG.permutation(N)


def scaled(T, factor):
    return se3.transform(T[:, :3, :3], factor * T[:, :3, 3])


def reordered(T, order):
    return se3.transform(T[:, :3, :3], T[:, order, 3])


def requaternion(T):
    """The rotations of quaternions that stand as w, x, y, z under headings x, y, z, w."""
    return se3.transform(rotations(T).from_quat(np.roll(rotations(T).as_quat(), 1, axis=1)).as_matrix(), T[:, :3, 3])


def transposed(T):
    return se3.transform(np.swapaxes(T[:, :3, :3], 1, 2), T[:, :3, 3])


def mirrored(T):
    D = np.diag([1.0, -1, 1])
    return se3.transform(D @ T[:, :3, :3] @ D, T[:, :3, 3] * [1, -1, 1])


UNRELATED = "no reading fits better than"
EITHER = "no reading fits better than|say which it is|the residual falls from"
WRONG = {
    **{f"rows shifted by {k}": (F, np.roll(C, k, axis=0), "each measurement belonging to the") for k in (-3, 5)},
    "rows shifted by 7": (F, np.roll(C, 7, axis=0), UNRELATED),
    "rows reversed": (F, C[::-1], "the rows of the measurements in reverse order"),
    "rows mixed": (F, C[MIXED], UNRELATED),
    "half of the rows shifted": (F, np.concatenate([C[:9], np.roll(C[9:], 1, axis=0)]), UNRELATED),
    "another recording's target": (F, poses(N, 77)[1], UNRELATED),
    "target never changes": (F, np.repeat(C[:1], N, axis=0), "the same to the last digit"),
    "target frozen at the end": (F, np.concatenate([C[:9], np.repeat(C[8:9], 9, axis=0)]), EITHER),
    "target kept for two poses": (F, C[np.arange(N) // 2 * 2], UNRELATED),
    "flange kept for two poses": (F[np.arange(N) // 2 * 2], C, UNRELATED),
    "target in m": (F, scaled(C, 1e-3), "the measured points read as metres"),
    "target in inches": (F, scaled(C, 1 / 25.4), "the measured points read as inches"),
    "target left-handed": (F, mirrored(C), "of the measured points reversed, in the orientation too"),
    "x and y of the target exchanged": (F, reordered(C, [1, 0, 2]), "the columns of the measured points read as y, x, z"),
    "x and y of the flange exchanged": (reordered(F, [1, 0, 2]), C, UNRELATED),
    "quaternion of the target": (F, requaternion(C), EITHER),
    "quaternion of the flange": (requaternion(F), C, EITHER),
    "rotation of the target transposed": (F, transposed(C), "the orientation inverted"),
    "rotation of the flange transposed": (transposed(F), C, "the measurements miss each other by"),
    "both rotations transposed": (transposed(F), transposed(C), UNRELATED),
}


@pytest.mark.parametrize("mistake", WRONG)
def test_a_table_that_is_wrong_in_one_way_is_refused_with_what_it_is(mistake, tmp_path):
    hand, eye, words = WRONG[mistake]
    columns = [part for T in (hand, eye) for part in (T[:, :3, 3], rotations(T).as_quat())]
    path = write(tmp_path / "a.csv", BOTH, *columns)
    with pytest.raises((ConfigError, CalibrationError), match=words):
        mbcacq.calibrate(path, ALONE)

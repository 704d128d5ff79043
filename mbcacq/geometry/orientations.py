"""Orientations as controllers and instruments write them: Euler angles of any order, rotation vectors, quaternions, matrices.

A convention is a word. 'ZYX' names Euler angles about axes that turn along (capital letters, first to last), 'xyz' about axes that stay
(small letters). 'vector' is a rotation vector, 'wxyz' and 'xyzw' are quaternions, and 'matrix' is nine numbers row by row.
"""

from __future__ import annotations

import numpy as np

from mbcacq.geometry import se3

# What makers call theirs, in the order in which their pendants show the numbers.
MAKERS = {
    "kuka": "ZYX",  # A about Z, B about Y, C about X, axes turning along
    "fanuc": "xyz",  # W about X, P about Y, R about Z, axes fixed
    "yaskawa": "xyz",  # Rx, Ry, Rz
    "mitsubishi": "xyz",  # A, B, C
    "epson": "ZYX",  # U about Z, V about Y, W about X
    "ur": "vector",  # RX, RY, RZ
    "abb": "wxyz",  # q1 .. q4
    "staubli": "XYZ",  # RX, RY, RZ
    "kawasaki": "ZYZ",  # O, A, T
    "comau": "ZYZ",  # A, E, R
    "nachi": "ZYX",  # roll about Z, pitch about Y, yaw about X
    "ros": "xyzw",
}
QUATERNIONS = ("wxyz", "xyzw")


def size(convention: str) -> int:
    """How many numbers an orientation has in a convention."""
    return {"matrix": 9, "wxyz": 4, "xyzw": 4}.get(convention, 3)


def is_convention(word: str) -> bool:
    """Whether a word names a convention."""
    if word in ("vector", "matrix", *QUATERNIONS):
        return True
    whole = word.upper()
    one_case = word in (whole, word.lower())
    return one_case and len(word) == 3 and set(whole) <= set("XYZ") and whole[0] != whole[1] != whole[2]


def to_matrices(values: np.ndarray, convention: str) -> np.ndarray:
    """Rotation matrices (P, 3, 3) of numbers (P, k): rad for Euler angles and vectors; quaternions and matrices nearly normalised.

    Raises ValueError for a word that is no convention, or numbers that are no rotation (a mirror, a quaternion of length zero).
    """
    if not is_convention(convention):
        raise ValueError(f"'{convention}' is no convention of orientations")
    if values.shape[1:] != (size(convention),):
        raise ValueError(f"{values.shape[1]} numbers are no {in_words(convention)}")
    if convention == "vector":
        return se3.rotation_exp(values)
    if convention == "matrix":
        R = values.reshape(-1, 3, 3)
        if np.any(np.linalg.det(R) < 0.5) or np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(initial=0.0) > 0.02:
            raise ValueError("the matrix is not orthonormal and right-handed")
        return se3.nearest_rotation(R)
    from scipy.spatial.transform import Rotation

    if convention in QUATERNIONS:
        length = np.linalg.norm(values, axis=1)
        if np.any(np.abs(length - 1) > 0.01):
            raise ValueError(f"the quaternion has length {length[np.argmax(np.abs(length - 1))]:.4g}, not 1")
        return Rotation.from_quat(values if convention == "xyzw" else np.roll(values, -1, axis=1)).as_matrix()
    return Rotation.from_euler(convention, values).as_matrix()


def to_numbers(R: np.ndarray, convention: str) -> np.ndarray:
    """The three angles or the rotation vector (P, 3) rad of rotation matrices (P, 3, 3)."""
    if convention == "vector":
        return se3.rotation_log(R)
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(R).as_euler(convention)


def in_words(convention: str) -> str:
    """What a convention means."""
    if convention in ("vector", "matrix"):
        return {"vector": "rotation vector", "matrix": "rotation matrix, row by row"}[convention]
    if convention in QUATERNIONS:
        return f"quaternion {', '.join(convention)}"
    axes = f"{', '.join(convention.lower())}"
    makers = ", ".join(name for name, word in MAKERS.items() if word == convention)
    return f"angles about {axes}, axes {'turning along' if convention.isupper() else 'fixed'}" + (f" ({makers})" if makers else "")

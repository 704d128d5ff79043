"""One pattern of error in several joints: the joints' own periodic errors are the same function, turned by an offset, perhaps mirrored.

Absolute encoders of one make carry the same scale. Its errors then repeat in every joint, from another zero and, where an encoder is
mounted the other way round, in the other direction. Angles that one joint never visited are known from another.

Joints are compared by their evidence in the normal equations of the recording. Each order of a joint's own error is a random effect. The
Bayes factor, for every offset and direction, compares two models of that error: the pattern plus a small deviation, and an error of its
own. Explanations by other joints, the geometry and gravity are integrated out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mbcacq.estimation.random_effect_sizes import eliminated
from mbcacq.quantities import DEGREE, from_degrees

STEPS = 180  # offsets over a turn that are compared: 2 deg, a seventh of a period at order 25
OFFSETS = 2 * np.pi * np.arange(STEPS) / STEPS  # rad
FINE = from_degrees(np.arange(-1.0, 1.01, 0.25))  # rad, about the best of them: as far as half of the way to its neighbours
NEAR = 4.0 * DEGREE  # offsets that far apart are one
LEAST_LOG_BAYES_FACTOR = 3.0  # strong evidence (Kass, Raftery 1995); offsets and directions that were tried are averaged over
LEAST_CERTAIN = 0.5  # probability p of the offset: at angles never visited, a pattern at it leaves 2 (1 - p) of the mean square
LEAST_JOINTS = 3
AT_ONCE = 4  # offsets: their matrices stay in the caches
MOST_STARTS = 2  # joints from which a pattern is sought
ROUNDS = 4  # in which every joint is compared anew: on two campaigns of a UR10 the third no longer changes an offset


@dataclass(frozen=True)
class CommonPattern:
    """joints: indices; offset: rad, direction: +1 or -1 of each. Joint i errs by direction_i f(direction_i q - offset_i).
    log_bayes_factor: of this against an error of its own in each joint."""

    joints: tuple[int, ...]
    offset: tuple[float, ...]
    direction: tuple[int, ...]
    log_bayes_factor: float


@dataclass(frozen=True)
class OwnErrors:
    """The joints' own errors in the normal equations of a recording.

    information (g, g), right (g,): with the priors of everything but the own errors. index: joint -> (2 K,) columns of its sines
    and cosines of orders 1 to K; sigma: joint -> (2 K,) prior of an error of its own. pattern, deviation: (2 K,) prior of a common
    pattern and of what a joint differs from it by; both are the same for the sine and the cosine of an order.
    """

    information: np.ndarray
    right: np.ndarray
    index: Mapping[int, np.ndarray]
    sigma: Mapping[int, np.ndarray]
    pattern: np.ndarray
    deviation: np.ndarray

    def determined(self, joint: int) -> float:
        """How much the recording says of a joint's own error: the logarithm by which its uncertainty shrinks."""
        own, sigma = self.index[joint], self.sigma[joint]
        return float(np.linalg.slogdet(np.eye(len(own)) + sigma[:, None] * self.information[np.ix_(own, own)] * sigma)[1])


@dataclass(frozen=True)
class JointAlignment:
    """Where a joint lies under the pattern. log_bayes_factor: averaged over all offsets and directions; certain: probability of this."""

    offset: float
    direction: int
    log_bayes_factor: float
    certain: float


def find_common_pattern(errors: OwnErrors) -> CommonPattern | None:
    """The pattern that most joints share; None where fewer than LEAST_JOINTS do."""
    if len(errors.index) < LEAST_JOINTS:
        return None
    for anchor in sorted(errors.index, key=errors.determined, reverse=True)[:MOST_STARTS]:
        found = _grown(errors, anchor)
        if len(found) >= LEAST_JOINTS:
            joints = tuple(sorted(found))
            offsets = tuple(float(np.mod(found[i].offset, 2 * np.pi)) for i in joints)
            directions = tuple(found[i].direction for i in joints)
            return CommonPattern(joints, offsets, directions, _total(errors, found))
    return None


def _grown(errors: OwnErrors, anchor: int) -> dict[int, JointAlignment]:
    """Joints that follow the pattern of ``anchor``: the most probable one at a time, then each anew beside all others.

    A joint is compared with a pattern that has grown only where it promised more than the best of those that were: what it lacks then it
    is compared with before none is left.
    """
    found = {anchor: JointAlignment(0.0, 1, 0.0, 1.0)}
    promised = {j: np.inf for j in errors.index if j != anchor}
    compared: dict[int, JointAlignment] = {}
    while True:
        good = {j: a for j, a in compared.items() if _follows(a, len(found))}
        best = max(good, key=lambda j: good[j].log_bayes_factor, default=None)
        waiting = [j for j in promised if j not in compared]
        first = max(waiting, key=lambda j: promised[j], default=None)
        if best is not None and (first is None or good[best].log_bayes_factor >= promised[first]):
            found[best] = good[best]
            del promised[best]
            compared = {}
        elif first is not None:
            compared[first] = best_alignment(errors, found, first)
            promised[first] = compared[first].log_bayes_factor
        else:
            break
    return _aligned_anew(errors, found, anchor) if len(found) >= LEAST_JOINTS else found


def _aligned_anew(errors: OwnErrors, found: Mapping[int, JointAlignment], anchor: int) -> dict[int, JointAlignment]:
    """The joints that follow the pattern, each compared with that of all others, until none changes.

    A joint that was added early was compared with a pattern that few joints had shown, at few angles. Its offset may be another one where
    more of the pattern is known, and a joint that did not fit may fit then.
    """
    found = dict(found)
    for _ in range(ROUNDS):
        before = {j: (a.offset, a.direction) for j, a in found.items()}
        for j in [j for j in errors.index if j != anchor]:
            found.pop(j, None)
            anew = best_alignment(errors, found, j)
            if _follows(anew, len(found)):
                found[j] = anew
        if {j: (a.offset, a.direction) for j, a in found.items()} == before:
            break
    return found


def _follows(alignment: JointAlignment, joints: int) -> bool:
    """Whether a joint follows the pattern of so many others."""
    # Once some joints share a pattern, the odds that another one does are those of Laplace's rule of succession.
    least = LEAST_LOG_BAYES_FACTOR if joints < LEAST_JOINTS else -np.log(joints + 1.0)
    return bool(alignment.log_bayes_factor > least and alignment.certain > LEAST_CERTAIN)


def _total(errors: OwnErrors, found: Mapping[int, JointAlignment]) -> float:
    """Log Bayes factor of joints that share a pattern at these offsets against errors of their own, offsets and directions equally
    probable: the product of what each joint adds to those before it.
    """
    first, *rest = found
    total, there = 0.0, {first: found[first]}
    for j in rest:
        at = PatternComparison.of(errors, there, j).log_bayes_factors(np.array([found[j].offset]), found[j].direction)
        total += float(at[0]) - float(np.log(2 * STEPS))
        there[j] = found[j]
    return total


def best_alignment(errors: OwnErrors, found: Mapping[int, JointAlignment], joint: int) -> JointAlignment:
    """The most probable offset and direction of a joint under the pattern of others, averaged over all of them."""
    compared = PatternComparison.of(errors, found, joint)
    coarse = np.stack([compared.log_bayes_factors(OFFSETS, direction) for direction in (1, -1)])
    which, at = (int(i) for i in np.unravel_index(int(np.argmax(coarse)), coarse.shape))
    fine = compared.log_bayes_factors(OFFSETS[at] + FINE, (1, -1)[which])
    top = float(max(coarse.max(), fine.max()))
    # About the best of the coarse offsets the fine ones stand for it and for half of the way to its neighbours.
    weight = np.exp(coarse - top)
    weight[which, at] = np.exp(fine - top).mean()
    near = np.abs(np.angle(np.exp(1j * (OFFSETS - OFFSETS[at])))) < NEAR
    best = int(np.argmax(fine))
    return JointAlignment(
        float(OFFSETS[at] + FINE[best]), (1, -1)[which], top + float(np.log(weight.mean())), float(weight[which][near].sum() / weight.sum())
    )


@dataclass(frozen=True, kw_only=True)
class PatternComparison:
    """A joint's own error beside the pattern of others, everything else and the joint's deviation from a pattern integrated out.

    A (2 K, 2 K) and hp (2 K,) belong to the pattern, C and hv to the joint, B to both, all in units of the pattern's prior; constant: what
    the logarithm of the Bayes factor has whatever the offset.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    hp: np.ndarray
    hv: np.ndarray
    constant: float

    @classmethod
    def of(cls, errors: OwnErrors, found: Mapping[int, JointAlignment], joint: int) -> PatternComparison:
        S, b, keep = _with_pattern(errors, found, joint)
        k2 = len(errors.pattern)
        J, h = eliminated(S, b, keep)
        own = J.copy()
        own[k2:, k2:] += np.diag(errors.sigma[joint] ** -2.0)
        size = np.concatenate([errors.pattern, errors.sigma[joint]])
        separate = log_evidence((size[:, None] * own * size)[None], (size * h)[None])[0]
        # The prior of the deviation is the same for sine and cosine, and does not turn with them: it is integrated out for all offsets.
        # That of the pattern is so too, and its size can be a unit of both.
        size = np.tile(errors.pattern, 2)
        J, h, deviation = size[:, None] * J * size, size * h, errors.deviation / errors.pattern
        A, B, C, hp, hv = J[:k2, :k2], J[:k2, k2:], J[k2:, k2:], h[:k2], h[k2:]
        D = np.linalg.inv(C + np.diag(deviation**-2.0))
        constant = 0.5 * hv @ D @ hv + 0.5 * np.linalg.slogdet(D)[1] - np.log(deviation).sum() - separate
        CD, BD = C @ D, B @ D
        return cls(A=A - BD @ B.T, B=B - BD @ C, C=C - CD @ C, hp=hp - BD @ hv, hv=hv - CD @ hv, constant=float(constant))

    def log_bayes_factors(self, offsets: np.ndarray, direction: int) -> np.ndarray:
        """(G,) logarithm of the Bayes factor of following the pattern at each offset (G,) rad, against an error of its own."""
        logs = []
        for some in np.array_split(offsets, -(-len(offsets) // AT_ONCE)):
            across, right = turned(self.B, some, direction), turned(self.hv[None], some, direction)[:, 0]
            own = turned(np.swapaxes(turned(self.C, some, direction), 1, 2), some, direction)
            logs.append(log_evidence(self.A + across + np.swapaxes(across, 1, 2) + own, self.hp + right))
        return np.concatenate(logs) + self.constant


def turned(rows: np.ndarray, offsets: np.ndarray, direction: int) -> np.ndarray:
    """(G, r, 2 K): rows (r, 2 K), or (G, r, 2 K), of a joint's sines and cosines as rows of those of the pattern, at offsets (G,) rad."""
    K = rows.shape[-1] // 2
    phase = np.arange(1, K + 1) * offsets[:, None, None]
    c, s, sine, cosine = np.cos(phase), np.sin(phase), rows[..., :K], direction * rows[..., K:]
    return np.concatenate([sine * c - cosine * s, sine * s + cosine * c], axis=-1)


def log_evidence(information: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(G,) logarithm of the integral over k coefficients, by their normal equations (G, k, k), (G, k) in units of their priors, which are
    in them.
    """
    k = right.shape[1]
    bordered = np.empty((len(right), k + 1, k + 1))
    # The last row of the root of a matrix that is bordered by a right-hand side is the solution of the triangular system. The corner is
    # large enough: with the prior in it, the matrix is at least the identity.
    bordered[:, :k, :k], bordered[:, k, :k], bordered[:, k, k] = information, right, np.sum(right**2, axis=1) + 1.0
    root = np.linalg.cholesky(bordered)
    return 0.5 * np.sum(root[:, k, :k] ** 2, axis=1) - np.log(np.diagonal(root, axis1=1, axis2=2)[:, :k]).sum(axis=1)


def _with_pattern(errors: OwnErrors, found: Mapping[int, JointAlignment], joint: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal equations with a pattern as further columns, priors included but that of ``joint``; and the columns of pattern and joint."""
    g, k2 = len(errors.right), len(errors.pattern)
    P = np.zeros((g, k2))
    weight = np.concatenate([np.zeros(g), errors.pattern**-2.0])
    for i, index in errors.index.items():
        if i in found:
            P[index] = turned(np.eye(k2), np.array([found[i].offset]), found[i].direction)[0]
        if i != joint:
            weight[index] = (errors.deviation if i in found else errors.sigma[i]) ** -2.0
    SP = errors.information @ P
    S = np.block([[errors.information, SP], [SP.T, P.T @ SP]]) + np.diag(weight)
    return S, np.concatenate([errors.right, P.T @ errors.right]), np.concatenate([np.arange(g, g + k2), errors.index[joint]])

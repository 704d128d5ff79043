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
    comparisons = _Comparisons(errors)
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
            compared[first] = comparisons.best_alignment(found, first)
            promised[first] = compared[first].log_bayes_factor
        else:
            break
    return _aligned_anew(comparisons, found, anchor) if len(found) >= LEAST_JOINTS else found


def _aligned_anew(comparisons: _Comparisons, found: Mapping[int, JointAlignment], anchor: int) -> dict[int, JointAlignment]:
    """The joints that follow the pattern, each compared with that of all others, until none changes.

    A joint that was added early was compared with a pattern that few joints had shown, at few angles. Its offset may be another one where
    more of the pattern is known, and a joint that did not fit may fit then.
    """
    found = dict(found)
    for _ in range(ROUNDS):
        before = {j: (a.offset, a.direction) for j, a in found.items()}
        for j in [j for j in comparisons.errors.index if j != anchor]:
            found.pop(j, None)
            anew = comparisons.best_alignment(found, j)
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


class _Comparisons:
    """Comparisons of joints with the pattern of others, each made once."""

    def __init__(self, errors: OwnErrors):
        self.errors = errors
        self._known: dict[tuple, JointAlignment] = {}

    def best_alignment(self, found: Mapping[int, JointAlignment], joint: int) -> JointAlignment:
        """The most probable offset and direction of a joint under the pattern of the joints found."""
        key = joint, *sorted((i, a.offset, a.direction) for i, a in found.items())
        if key not in self._known:
            self._known[key] = best_alignment(self.errors, found, joint)
        return self._known[key]


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
        separate = log_evidence(_bordered(size[:, None] * own * size, size * h)[None])[0]
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
        turned = _TurnedPattern(self, direction)
        some = np.array_split(offsets, -(-len(offsets) // AT_ONCE))
        return np.concatenate([log_evidence(turned.bordered(each)) for each in some]) + self.constant


class _TurnedPattern:
    """The normal equations of the pattern, the joint following it at an offset.

    A sine and a cosine of an order are one complex coefficient x + i y, which an offset multiplies by exp(-i k offset). A bilinear form of
    two of them is the real part of p^H P q + p^T Q q, P Hermitian and Q symmetric where the form is.
    """

    def __init__(self, compared: PatternComparison, direction: int):
        K = len(compared.hp) // 2
        mirror = np.repeat([1.0, direction], K)  # of the joint's sines and cosines
        self._A, self._B = _complex_forms(compared.A), _complex_forms(compared.B * mirror)
        self._C = _complex_forms(mirror[:, None] * compared.C * mirror)
        self._hp, hv = compared.hp, mirror * compared.hv
        self._hv = hv[:K] + 1j * hv[K:]

    def bordered(self, offsets: np.ndarray) -> np.ndarray:
        """(G, 2 K + 1, 2 K + 1) of offsets (G,) rad, as ``log_evidence`` takes them."""
        K, G = len(self._hv), len(offsets)
        e = np.exp(-1j * np.outer(offsets, np.arange(1, K + 1)))
        rows, columns = e[:, :, None], e[:, None, :]
        (AP, AQ), (BP, BQ), (CP, CQ) = self._A, self._B, self._C
        P: np.ndarray = AP + BP * columns + rows.conj() * (CP * columns + BP.conj().T)
        Q: np.ndarray = AQ + BQ * columns + rows * (CQ * columns + BQ.T)
        out = np.empty((G, 2 * K + 1, 2 * K + 1))
        np.add(np.real(P), np.real(Q), out=out[:, :K, :K])
        np.subtract(np.imag(P), np.imag(Q), out=out[:, K:-1, :K])
        np.subtract(np.real(P), np.real(Q), out=out[:, K:-1, K:-1])
        turned = e.conj() * self._hv
        out[:, -1, :K], out[:, -1, K:-1] = self._hp[:K] + turned.real, self._hp[K:] + turned.imag
        out[:, -1, -1] = np.sum(out[:, -1, :-1] ** 2, axis=1) + 1.0
        return out


def _complex_forms(M: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """P and Q (K, K) of a bilinear form M (2 K, 2 K)."""
    K = len(M) // 2
    xx, xy, yx, yy = M[:K, :K], M[:K, K:], M[K:, :K], M[K:, K:]
    return 0.5 * (xx + yy + 1j * (yx - xy)), 0.5 * (xx - yy - 1j * (xy + yx))


def _bordered(information: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(k + 1, k + 1) normal equations of k coefficients in units of their priors, which are in them, the right-hand side as last row.

    The corner is large enough: with the prior in it, the matrix is at least the identity.
    """
    return np.block([[information, right[:, None]], [right, right @ right + 1.0]])


def log_evidence(bordered: np.ndarray) -> np.ndarray:
    """(G,) logarithm of the integral over k coefficients; bordered (G, k + 1, k + 1): their normal equations, of which the lower triangle
    is read.
    """
    # The last row of the root of a matrix that is bordered by a right-hand side is the solution of the triangular system.
    root = np.linalg.cholesky(bordered)
    return 0.5 * np.sum(root[:, -1, :-1] ** 2, axis=1) - np.log(np.diagonal(root, axis1=1, axis2=2)[:, :-1]).sum(axis=1)


def turning(order: np.ndarray, offset: float, direction: int) -> np.ndarray:
    """(2 K, 2 K) the sines and cosines of a joint from those of the pattern at orders (K,)."""
    c, s = np.diag(np.cos(order * offset)), np.diag(np.sin(order * offset))
    return np.block([[c, s], [-direction * s, direction * c]])


def _with_pattern(errors: OwnErrors, found: Mapping[int, JointAlignment], joint: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal equations with a pattern as further columns, priors included but that of ``joint``; and the columns of pattern and joint."""
    g, k2 = len(errors.right), len(errors.pattern)
    order = np.arange(1, k2 // 2 + 1)
    P = np.zeros((g, k2))
    weight = np.concatenate([np.zeros(g), errors.pattern**-2.0])
    for i, index in errors.index.items():
        if i in found:
            P[index] = turning(order, found[i].offset, found[i].direction)
        if i != joint:
            weight[index] = (errors.deviation if i in found else errors.sigma[i]) ** -2.0
    SP = errors.information @ P
    S = np.block([[errors.information, SP], [SP.T, P.T @ SP]]) + np.diag(weight)
    return S, np.concatenate([errors.right, P.T @ errors.right]), np.concatenate([np.arange(g, g + k2), errors.index[joint]])

"""Sizes of groups of random effects by MacKay's fixed point.

The coefficients of a group are u ~ N(0, size^2). The size that maximises the marginal likelihood fulfils size^2 = |u|^2 / (k - trace of
their posterior covariance / size^2) (MacKay 1992, Bayesian interpolation): the groups that the data do not ask for shrink to nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from mbcacq.estimation.normal_equations import Normal, Prior, inverse_of_lower

CONVERGED = 0.05  # change of a logarithm of a variance
# Rise of the log marginal likelihood in a round after which the sizes stay: it decides nothing, while groups that shrink to nothing do so
# for forty rounds more, in which no other moves.
LEAST_RISE = 0.01
# Coefficients of other specimens that a usual size stands for: the size is then uncertain by half of itself before anything was measured.
OTHERS = 3.0
LEAST_DETERMINED = 1e-4  # coefficients of a group that the data determine: fewer are none


def sizes_by_marginal_likelihood(
    S: np.ndarray,
    b: np.ndarray,
    slices: Sequence[slice],
    start: np.ndarray,
    limits: tuple[float | np.ndarray, float],
    ending: tuple[int, float],
    fixed: np.ndarray | None = None,
    expected: np.ndarray | None = None,
) -> np.ndarray:
    """(G,) size of each group, zero where the data do not ask for it.

    S (k, k), b (k,): normal equations without the priors, in units in which the coefficients of a group are alike; slices: the
    coefficients of each group; start: (G,) sizes to begin with. limits: smallest size, below which a group is dropped, and largest.
    ending: number of rounds after which sizes stay, and rise of the log marginal likelihood in one below which they stay after it.
    fixed: (G,) bool of the groups whose size is kept. expected: (G,) size that such groups usually have, as OTHERS coefficients elsewhere
    would show it; zero where nothing is known of it.
    """
    least, most = limits
    kept = np.zeros(len(slices), bool) if fixed is None else fixed
    variance, floor = start**2, np.broadcast_to(least, len(slices)) ** 2
    usual = np.zeros(len(slices)) if expected is None else expected
    others = np.where(usual > 0, OTHERS, 0.0)
    others_square = others * usual**2
    alive = np.flatnonzero(variance > 0)
    normal, right, count = _equations_of(S, b, slices, alive)
    reached = -np.inf
    for _ in range(ending[0]):
        if not len(alive):
            break
        before, first = variance[alive], np.cumsum(count) - count
        mean, half = posterior_of(normal, right, np.repeat(before, count))
        likelihood = 0.5 * float(right @ mean) + float(np.log(np.diag(half)).sum()) - 0.5 * float(count @ np.log(before))
        rise, reached = likelihood - reached, likelihood
        determined = count - np.add.reduceat(np.einsum("ij,ij->j", half, half), first) / before + others[alive]
        asked = (np.add.reduceat(mean**2, first) + others_square[alive]) / np.maximum(determined, 1e-3)
        after = np.where(determined > LEAST_DETERMINED, np.minimum(asked, most**2), 0.0)
        after = np.where(kept[alive], before, np.where(after > floor[alive], after, 0.0))
        variance[alive] = after
        if 0 <= rise < ending[1] or np.all(np.abs(np.log(after[after > 0] / before[after > 0])) < CONVERGED):
            break
        if not after.all():
            alive = alive[after > 0]
            normal, right, count = _equations_of(S, b, slices, alive)
    return np.sqrt(variance)


def _equations_of(S: np.ndarray, b: np.ndarray, slices: Sequence[slice], groups: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The normal equations of the coefficients of some groups (indices), and how many coefficients each has."""
    own = [slices[int(g)] for g in groups]
    index = joined(own)
    return S[np.ix_(index, index)], b[index], np.array([p.stop - p.start for p in own], dtype=int)


def sizes_of_groups(
    normal: Normal,
    prior: Prior,
    groups: Mapping[str, np.ndarray],
    limits: tuple[float, float],
    rounds: int,
    expected: Mapping[str, float] | None = None,
) -> dict[str, float]:
    """The size of each group in its present size, by the linear problem of a solution under fixed noise.

    groups: (k,) indices of each group's coefficients among the parameters, whose prior has mean zero; limits: smallest and largest size;
    expected: sigma that the coefficients of a group usually have.
    """
    S, b, slices = _conditioned(normal, prior, groups)
    usual = np.array([(expected or {}).get(name, 0.0) / prior.sigma[index[0]] for name, index in groups.items()])
    found = sizes_by_marginal_likelihood(S, b, slices, np.ones(len(slices)), (1e-9, limits[1]), (rounds, LEAST_RISE), expected=usual)
    return {name: max(float(size), limits[0]) for name, size in zip(groups, found, strict=True)}


def gain_of_groups(
    normal: Normal, prior: Prior, groups: Mapping[str, np.ndarray], limits: tuple[float, float], rounds: int
) -> tuple[float, dict[str, float]]:
    """Log marginal likelihood that groups add, under fixed noise, at the sizes that maximise it; and these, in their present size, zero of
    groups smaller than the first of the limits."""
    S, b, slices = _conditioned(normal, prior, groups)
    found = sizes_by_marginal_likelihood(S, b, slices, np.ones(len(slices)), limits, (rounds, LEAST_RISE))
    size = np.concatenate([np.full(p.stop - p.start, s) for p, s in zip(slices, found, strict=True)])
    alive, by_name = size > 0, dict(zip(groups, found.tolist(), strict=True))
    if not alive.any():
        return 0.0, by_name
    root = size[alive]
    factor = np.linalg.cholesky(root[:, None] * S[np.ix_(alive, alive)] * root + np.eye(len(root)))
    explained = inverse_of_lower(factor) @ (root * b[alive])
    return float(0.5 * explained @ explained - np.sum(np.log(np.diag(factor)))), by_name


def supported_groups(normal: Normal, prior: Prior, groups: Mapping[str, np.ndarray], doubtful: Collection[str], least: float) -> set[str]:
    """Names of the groups that are left when the weakest of the doubtful ones is taken out, again and again, until the log Bayes factor of
    each against none is at least ``least``; at the sizes that they have, under fixed noise.

    The factor of a group is the ratio of its densities at zero before and after (Dickey 1971): 1/2 log|C| + 1/2 m' C^-1 m with its
    posterior mean m and covariance C in units of its prior sigma.
    """
    if not groups:
        return set()
    S, b, slices = _conditioned(normal, prior, groups)
    alive = dict(zip(groups, slices, strict=True))
    while alive:
        index, first = joined(list(alive.values())), 0
        mean, half = posterior_of(S[np.ix_(index, index)], b[index], np.ones(len(index)))
        weakest, weight = "", least
        for name, own in alive.items():
            here = slice(first, first + own.stop - own.start)
            first = here.stop
            if name in doubtful:
                covariance = half[:, here].T @ half[:, here]
                factor = 0.5 * (np.linalg.slogdet(covariance)[1] + mean[here] @ np.linalg.solve(covariance, mean[here]))
                weakest, weight = (name, factor) if factor < weight else (weakest, weight)
        if not weakest:
            break
        del alive[weakest]
    return set(alive)


def _conditioned(normal: Normal, prior: Prior, groups: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray, list[slice]]:
    """Normal equations S (k, k), b (k,) of the groups' coefficients, without their priors and in units of their present sigma, the other
    parameters eliminated; and the slice of each group."""
    index = np.concatenate(list(groups.values()))
    S, b = eliminated(*without_prior(normal, prior, index), index)
    sigma = prior.sigma[index]
    return sigma[:, None] * S * sigma, sigma * b, list(consecutive(len(i) for i in groups.values()))


def without_prior(normal: Normal, prior: Prior, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Information (g, g) and right-hand side (g,) without the prior of the parameters at index (k,). The unknowns are the coefficients
    of these, from zero, and the change of all others.
    """
    now, weight = np.zeros(normal.size), np.zeros(normal.size)
    now[index], weight[index] = prior.offset[index], prior.sigma[index] ** -2.0
    information = normal.information - np.diag(weight)
    return information, normal.gradient + weight * now + information @ now


def eliminated(information: np.ndarray, right: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations S (k, k), b (k,) of the parameters at index (k,), all others of these (g, g), (g,) at their best values."""
    rest = np.delete(np.arange(len(right)), index)
    scale = 1 / np.sqrt(np.maximum(np.diag(information)[rest], 1e-300))
    factor = np.linalg.cholesky(scale[:, None] * information[np.ix_(rest, rest)] * scale + 1e-12 * np.eye(len(rest)))
    root = inverse_of_lower(factor) * scale
    taken = root @ information[np.ix_(rest, index)]
    return information[np.ix_(index, index)] - taken.T @ taken, right[index] - taken.T @ (root @ right[rest])


def posterior_of(S: np.ndarray, b: np.ndarray, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Posterior mean (k,) of coefficients with normal equations S (k, k), b (k,) and prior variance (k,), and a root L (k, k) of their
    covariance L'L.
    """
    root = np.sqrt(prior)  # in units of their prior sigma the coefficients' normal matrix is never worse than the identity
    normal, diagonal = S * np.outer(root, root), np.arange(len(S))
    normal[diagonal, diagonal] += 1.0
    half = inverse_of_lower(np.linalg.cholesky(normal))
    return root * (half.T @ (half @ (root * b))), half * root


def consecutive(counts: Iterable[int]) -> tuple[slice, ...]:
    """Slices of so many entries, one after the other."""
    ends = np.cumsum([0, *counts]).tolist()
    return tuple(slice(a, b) for a, b in zip(ends[:-1], ends[1:], strict=True))


def joined(slices: Sequence[slice]) -> np.ndarray:
    """Indices of some slices, one after the other."""
    return np.concatenate([np.arange(p.start, p.stop) for p in slices]) if slices else np.zeros(0, int)

"""How far coefficients may be off: what is left after a fit is coloured, and samples that go together are not so many witnesses.

Three estimates of what the noise does to the normal equations. White: by how much is left alone. Spectral: by how what is left goes
together within a second, which few data tell well. Pieces (sandwich): however it goes together within half a second, and louder in
some places than in others; but with few pieces to a coefficient it comes out too small. None may be undercut. What is known of a
coefficient beforehand is known only so well: the prior's own spread is part of all three.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cho_solve

if TYPE_CHECKING:
    from mbcacq.diagnosis.motion.normal_store import NormalStore

TOGETHER_S = 1.0  # what is left further apart than that counts as independent


def covariance(ledger: NormalStore, weights: np.ndarray, chosen: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(c, c) of the coefficients x of the columns ``chosen``; weights: (J,) one over the mean square left."""
    factor, scale = ledger.factor(ledger.normal(weights), chosen)
    inverse = cho_solve(factor, np.eye(len(chosen)), check_finite=False) * np.outer(scale, scale)
    known = np.diag(1.0 / np.array(ledger.prior)[chosen] ** 2)
    white = inverse * max(float((ledger.errors(chosen, x) @ weights).sum()) / max(ledger.count.sum() - len(chosen), 1.0), 1.0)
    scores = ledger.scores(weights, chosen, x)
    n = len(scores)
    pieces = inverse @ (scores.T @ scores * n / max(n - 1, 1) + known) @ inverse
    coloured = inverse @ (_spectral(ledger, weights, chosen, x) + known) @ inverse
    least = np.maximum(np.maximum(np.diag(white), np.diag(pieces)), np.diag(coloured))
    grow = np.sqrt(least / np.maximum(np.diag(coloured), 1e-300))
    return coloured * np.outer(grow, grow)


def _spectral(ledger: NormalStore, weights: np.ndarray, chosen: np.ndarray, x: np.ndarray) -> np.ndarray:
    """(c, c) spread of the scores, from the autocovariance of what is left of each joint (Bartlett's window)."""
    out = np.zeros((len(chosen), len(chosen)))
    longest = max(int(TOGETHER_S / ledger.runs[0].step_s), 1)
    window = 1.0 - np.arange(longest + 1) / (longest + 1)
    length = 2 ** int(np.ceil(np.log2(max(len(r.q) for r in ledger.runs) + longest + 1)))
    for place in range(len(ledger.Z)):
        columns, at = ledger.taking_part(place, chosen)
        left = ledger.residual(place, chosen, x) * ledger.training
        present = ledger.present(place)
        power, pairs, spectra = np.zeros(length // 2 + 1), np.zeros(length // 2 + 1), []
        for k in range(len(ledger.runs)):
            here = ledger.slices(k)
            power += np.abs(np.fft.rfft(left[here], length)) ** 2
            pairs += np.abs(np.fft.rfft(present[here], length)) ** 2
            spectra.append(np.fft.rfft(columns[here], length, axis=0))
        together = np.fft.irfft(power, length)[: longest + 1] / np.maximum(np.fft.irfft(pairs, length)[: longest + 1], 1.0)
        lags = np.zeros(length)
        lags[: longest + 1] = window * together
        lags[length - longest :] = lags[longest:0:-1]
        density = np.maximum(np.fft.rfft(lags).real, 0.0) * weights[place] ** 2
        density[1:-1] *= 2.0  # the other half of the frequencies
        root = np.sqrt(density / length)[:, None]
        for s in spectra:
            both = np.concatenate([s.real * root, s.imag * root])
            out[np.ix_(at, at)] += both.T @ both
    return out

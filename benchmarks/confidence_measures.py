"""How well a confidence predicts errors: sparsification, AUROC, reliability, ranks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
WRONG = 0.1
"""Error above which a pixel is wrong: mean difference of its channels, colours in [0, 1]."""
_STEPS = 100
_BINS = 10


def sparsification(errors: Floats, order: NDArray[np.int64], *, squared: bool = False) -> Floats:
    """Return the error of the pixels that remain as more and more are removed, relative to that of all.

    Args:
        errors: `[P]`, at least one above 0.
        order: Indices `[P]` of the pixels, the first removed first.
        squared: If True, the error is the root mean square, else the mean.

    Returns:
        `[100]`, for 0 to 99 % removed.
    """
    values = (errors**2 if squared else errors)[order]
    remaining = np.cumsum(values[::-1])[::-1] / np.arange(len(values), 0, -1)
    curve = remaining[(np.arange(_STEPS) / _STEPS * len(values)).astype(int)]
    return np.asarray(
        (np.sqrt(curve) if squared else curve) / (remaining[0] ** (0.5 if squared else 1))
    )


def ause(errors: Floats, confidence: Floats, *, squared: bool = False) -> float:
    """Return the area between the sparsification curves by confidence and by the errors; 0 is perfect.

    Ilg et al. 2018. Pixels of equal confidence are removed in random order.
    """
    ties = np.random.default_rng(0).random(len(errors))
    by_confidence = sparsification(errors, np.lexsort((ties, confidence)), squared=squared)
    best = sparsification(errors, np.argsort(-errors, kind="stable"), squared=squared)
    return float((by_confidence - best).mean())


def auroc(errors: Floats, confidence: Floats) -> float | None:
    """Return the probability that a wrong pixel has less confidence than a right one; None without either."""
    wrong = errors > WRONG
    count = int(wrong.sum())
    if count in (0, len(wrong)):
        return None
    ranks = ranked(-confidence)
    above = ranks[wrong].sum() - count * (count + 1) / 2
    return float(above / (count * (len(wrong) - count)))


def ranked(values: Floats) -> Floats:
    """Return ranks from 1, equal values with their mean rank."""
    from scipy.stats import rankdata

    return np.asarray(rankdata(values), np.float64)


def rank_correlation(one: Sequence[float], other: Sequence[float]) -> float:
    """Return Spearman's rank correlation."""
    return float(np.corrcoef(ranked(np.array(one)), ranked(np.array(other)))[0, 1])


def reliability(errors: Floats, confidence: Floats) -> list[tuple[int, float, float]]:
    """Return for each tenth of the confidence: pixels, mean confidence, share of right pixels."""
    bins = np.minimum((confidence * _BINS).astype(int), _BINS - 1)
    rows = []
    for index in range(_BINS):
        inside = bins == index
        count = int(inside.sum())
        mean = float(confidence[inside].mean()) if count else 0.0
        right = float((errors[inside] <= WRONG).mean()) if count else 0.0
        rows.append((count, round(mean, 4), round(right, 4)))
    return rows

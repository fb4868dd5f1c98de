"""What opacity and size copies of a Gaussian have, so that together they look as it did alone."""

from __future__ import annotations

import torch
from torch import Tensor

_LARGEST_LOGIT = 16.0
"""Logits are taken as at most this: the opacity is then 1 to seven digits, and the sum below, which
alternates, keeps nine."""


def shared_among_copies(opacity_logits: Tensor, copies: Tensor) -> tuple[Tensor, Tensor]:
    """Opacities and scales of n Gaussians at one place that stand for one (3DGS-MCMC, equation 9).

    Kheradmand et al. 2024: the opacity becomes o' = 1 - (1 - o)^(1/n), and all scales are multiplied by
    o / sum over i = 1..n and k = 0..i-1 of C(i-1, k) (-1)^k o'^(k+1) / sqrt(k + 1).

    Args:
        opacity_logits: `[M]`, of the one.
        copies: `[M]` int64, n, at least 1: itself and its copies.

    Returns:
        The logit of o' `[M]`, and the logarithm of the factor of the scales `[M]`; both float64.
    """
    n = copies.double()
    logits = opacity_logits.double().clamp(-_LARGEST_LOGIT, _LARGEST_LOGIT)
    # ln(1 - o'), which keeps its digits where o is next to 0 or to 1.
    transparency = torch.nn.functional.logsigmoid(-logits) / n
    opacity = -torch.expm1(transparency)
    # The sum over i is a binomial coefficient: C(0, k) + ... + C(n-1, k) = C(n, k+1). With m = k + 1
    # one sum is left; its terms are 0 from m = n + 1 on.
    term, total = -torch.ones_like(n), torch.zeros_like(n)
    for m in range(1, int(copies.max()) + 1 if len(copies) else 1):
        term = term * -opacity * (n - m + 1) / m
        total = total + term / m**0.5
        if (term.abs() <= 1e-17 * total.abs()).all():
            break
    return opacity.log() - transparency, torch.log(torch.sigmoid(logits) / total)

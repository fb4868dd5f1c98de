from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

from registry import Step
from stereogs_plugins.samplers.coarse_to_fine import CoarseToFine
from tests.stereogs_plugins.building import build, some_gaussians, step_with


def step_at(iteration: int) -> Step:
    """Of 1,000."""
    return step_with(some_gaussians([0.1], [0.5]), iteration=iteration)


@pytest.mark.parametrize(("views", "until"), [(3, 0.9), (6, 0.7), (9, 0.5)])
def test_the_ramp_ends_where_freenerf_ends_it(views: int, until: float) -> None:
    sampler = build(CoarseToFine, until=until)
    end = int(1000 * until)
    before, at_end, after = (step_at(i) for i in (end - 100, end, end + 50))
    assert not torch.equal(sampler.sample(before, before.sample).target, before.sample.target)
    for step in (at_end, after):
        assert torch.equal(sampler.sample(step, step.sample).target, step.sample.target)


def test_bands_come_by_fractions_as_freenerfs_do() -> None:
    class Third:  # what the sampler asks of a model of SH degree 3
        sh_degree = 3

    step = step_at(300)
    model: Any = Third()
    step = replace(step, model=model)
    # FreeNeRF: pointer (L / 3) t / T of L bands in thirds; a third of the way shows a third of them.
    degree = build(CoarseToFine, until=0.9).sample(step, step.sample).sh_degree
    assert degree == pytest.approx(1.0)
    kept = build(CoarseToFine, until=0.9, bands=False).sample(step, step.sample).sh_degree
    assert kept == step.sample.sh_degree


def test_the_blur_shrinks_linearly() -> None:
    """A Gaussian of deviation s damps a wave of length l by exp(-2 (pi s / l)^2)."""
    step = step_at(450)  # half of the way to 0.9
    wave = 0.5 + 0.5 * torch.cos(2 * torch.pi * (torch.arange(64) + 0.5) / 16)
    image = wave[None, :, None].expand(48, 64, 3).contiguous()
    step = replace(step, sample=replace(step.sample, target=image))
    seen = build(CoarseToFine, blur=4.0).sample(step, step.sample).target
    damped = float((seen - 0.5).abs().max() / (image - 0.5).abs().max())
    assert damped == pytest.approx(
        float(torch.exp(torch.tensor(-2 * (torch.pi * 2 / 16) ** 2))), rel=0.02
    )

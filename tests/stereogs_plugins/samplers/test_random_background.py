from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from registry import Sample, Step
from registry.testing import check
from stereogs_plugins.samplers.random_background import RandomBackground
from stereogs_plugins.samplers.resolution_schedule import ResolutionSchedule
from tests.stereogs_plugins.building import build, some_gaussians, step_with


def some_step() -> Step:
    return step_with(some_gaussians([0.1], [0.5]))


def test_colours_differ_and_photographs_without_alpha_stay() -> None:
    step, sampler = some_step(), build(RandomBackground)
    samples = [sampler.sample(step, step.sample) for _ in range(50)]
    colors = torch.tensor([sample.background for sample in samples])
    assert (colors.amin(dim=0) < 0.15).all()
    assert (colors.amax(dim=0) > 0.85).all()
    assert all(torch.equal(sample.target, step.sample.target) for sample in samples)


def test_only_photographs_with_alpha_need_have_one() -> None:
    step, sampler = some_step(), build(RandomBackground, opaque=False)
    opaque = replace(step.sample, view=replace(step.view, alpha=torch.ones(48, 64)))
    for covered in (step.sample, opaque):
        assert sampler.sample(step, covered) is covered
    sample, _, _ = with_alpha(step)
    first = build(RandomBackground).sample(step, sample)
    assert sampler.sample(step, sample).background == first.background  # nothing was drawn before
    check(RandomBackground, opaque=False)


def with_alpha(step: Step) -> tuple[Sample, Tensor, Tensor]:
    """A photograph before yellow, its alpha `[48, 64, 1]` and the colour of what stands there."""
    rows = torch.linspace(0, 1, 48)[:, None].expand(48, 64)
    behind, front = torch.tensor([1.0, 1.0, 0.0]), torch.tensor([0.2, 0.4, 0.6])
    image = rows[..., None] * front + (1 - rows[..., None]) * behind
    view = replace(step.view, image=image, alpha=rows)
    sample = replace(step.sample, view=view, target=image, background=(1.0, 1.0, 0.0))
    return sample, rows[..., None], front


def test_a_photograph_with_alpha_is_put_on_the_same_colour() -> None:
    step = some_step()
    sample, alpha, front = with_alpha(step)
    answer = build(RandomBackground).sample(step, sample)
    wanted = alpha * front + (1 - alpha) * torch.tensor(answer.background)
    torch.testing.assert_close(answer.target, wanted)


def test_it_works_on_photographs_that_were_made_smaller_and_before_they_are() -> None:
    step = some_step()
    sample, _, _ = with_alpha(step)
    smaller = build(ResolutionSchedule, shrink=5)
    after = build(RandomBackground).sample(step, smaller.sample(step, sample))
    before = smaller.sample(step, build(RandomBackground).sample(step, sample))
    assert after.background == before.background
    torch.testing.assert_close(after.target, before.target)

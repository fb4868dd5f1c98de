from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from core_rasterizer import GaussianModel, open_device
from registry import Sample, Step
from stereogs_plugins.samplers.resolution_schedule import ResolutionSchedule
from tests.host import check_sample
from tests.stereogs_plugins.building import build, some_gaussians, step_with


def some_step() -> Step:
    """Its photograph has 48 rows of 64 pixels."""
    return step_with(some_gaussians([0.1], [0.5]))


def shrunk(step: Step, image: torch.Tensor, shrink: int) -> Sample:
    """The answer for a photograph of any size."""
    height, width = image.shape[:2]
    camera = step.sample.camera.resized(width, height)
    sample = replace(step.sample, camera=camera, target=image)
    return check_sample(build(ResolutionSchedule, shrink=shrink).sample(step, sample), step, sample)


def test_a_pixel_is_the_mean_of_those_that_it_covers() -> None:
    image = torch.rand(48, 64, 3, generator=torch.Generator().manual_seed(0))
    blocks = image.reshape(12, 4, 16, 4, 3)
    torch.testing.assert_close(shrunk(some_step(), image, 4).target, blocks.mean(dim=(1, 3)))


def test_one_changes_nothing() -> None:
    step = some_step()
    answer = build(ResolutionSchedule, shrink=1).sample(step, step.sample)
    assert torch.equal(answer.target, step.sample.target)
    assert vars(answer.camera).keys() == vars(step.sample.camera).keys()
    assert (answer.camera.width, answer.camera.fx) == (64, step.sample.camera.fx)


def test_a_view_is_made_small_once_and_what_others_changed_each_time() -> None:
    step, sampler = some_step(), build(ResolutionSchedule)
    first, again = (sampler.sample(step, step.sample) for _ in range(2))
    assert again.target is first.target
    assert again.camera is first.camera
    darker = replace(step.sample, target=step.sample.target / 2)
    torch.testing.assert_close(sampler.sample(step, darker).target, first.target / 2)
    moved = replace(step.sample, camera=step.sample.camera.shifted_right(1.0))
    pose = sampler.sample(step, moved).camera.world_to_camera
    torch.testing.assert_close(pose, moved.camera.world_to_camera)


def test_sizes_that_do_not_divide_are_rounded_up() -> None:
    answer = shrunk(some_step(), torch.full((5, 7, 3), 0.25), 2)
    assert answer.target.shape == (3, 4, 3)
    torch.testing.assert_close(answer.target, torch.full((3, 4, 3), 0.25))


@pytest.mark.parametrize("shrink", [2, 4])
def test_the_camera_sees_what_the_photograph_shows(shrink: int) -> None:
    """Large Gaussians off the middle: their small picture is the whole one's mean."""
    step = some_step()
    gaussians = some_gaussians([0.4, 0.3, 0.5], [0.9, 0.5, 0.7])
    gaussians.means[:, 1] = torch.tensor([0.3, -0.5, 0.6])
    model = GaussianModel(gaussians, open_device())
    with torch.no_grad():
        whole = model.render(step.sample.camera).rgb.clamp(0, 1)
        answer = shrunk(step, whole, shrink)
        small = model.render(answer.camera).rgb
    assert float(whole.max()) > 0.3
    assert float((small - answer.target).abs().max()) < 0.03

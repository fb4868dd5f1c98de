"""The prior `dis_flow`: a known shift is found; occluded pixels are unknown."""

from __future__ import annotations

import pytest
import torch
from scipy.ndimage import gaussian_filter  # type: ignore[attr-defined]
from torch import Tensor

from registry.testing import check
from stereogs_plugins.priors.dis_flow import DisFlow, stereogs_register_priors
from tests.stereogs_plugins.building import build, offered


def textured(height: int, width: int) -> Tensor:
    """Smooth coloured noise."""
    noise = torch.rand(height, width, 3, generator=torch.Generator().manual_seed(3))
    smooth = torch.from_numpy(gaussian_filter(noise.numpy(), (2, 2, 0)))
    return (smooth - smooth.min()) / (smooth.max() - smooth.min())


def test_it_is_registered_and_keeps_the_contract() -> None:
    assert offered(stereogs_register_priors) == {"dis_flow": DisFlow}
    check(DisFlow)
    check(DisFlow, max_cycle_error=None)


def test_a_shift_is_found_and_is_unknown_outside_the_image() -> None:
    scene = textured(70, 120)
    first, second = scene[4:68, 10:106], scene[1:65, 3:99]  # content moves by (+7, +3)
    found = build(DisFlow).flow(first.contiguous(), second.contiguous())
    inner = found.vectors[8:-8, 8:-16]
    assert found.valid[8:-8, 8:-16].float().mean() > 0.95
    wrong = (inner - torch.tensor([7.0, 3.0])).norm(dim=2)[found.valid[8:-8, 8:-16]]
    assert wrong.median() < 0.1
    assert not found.valid[:, -6:].any()


def test_white_is_brighter_than_nearly_white() -> None:
    scene = (textured(70, 120) > 0.5).float()
    first, second = scene[4:68, 10:106], 0.998 * scene[1:65, 3:99]
    found = build(DisFlow).flow(first.contiguous(), second.contiguous())
    wrong = (found.vectors[8:-8, 8:-16] - torch.tensor([7.0, 3.0])).norm(dim=2)
    assert wrong.median() < 0.1


def test_without_a_cycle_check_every_pixel_has_a_vector() -> None:
    first, second = textured(48, 64), textured(48, 64).flip(1).contiguous()
    assert build(DisFlow, max_cycle_error=None).flow(first, second).valid.all()
    assert not build(DisFlow).flow(first, second).valid.all()


def test_images_of_two_sizes_have_flow_in_their_own_pixels() -> None:
    first = textured(64, 96)
    second = first.repeat_interleave(2, dim=0).repeat_interleave(2, dim=1)
    found = build(DisFlow).flow(first, second)
    v, u = torch.meshgrid(torch.arange(64) + 0.5, torch.arange(96) + 0.5, indexing="ij")
    wanted = torch.stack([u, v], dim=2)  # from (u, v) to (2u, 2v)
    assert (found.vectors - wanted)[found.valid].norm(dim=1).median() < 0.2


@pytest.mark.parametrize("size", [(1, 1), (15, 64), (64, 15)])
def test_images_too_small_for_a_pyramid_have_no_flow(size: tuple[int, int]) -> None:
    image = torch.zeros(*size, 3)
    assert not build(DisFlow).flow(image, image).valid.any()


def test_the_number_of_opencv_threads_does_not_matter() -> None:
    import cv2

    first, second = textured(200, 300), textured(200, 310)[:, 10:].contiguous()
    threads, answers = cv2.getNumThreads(), []
    try:
        for number in (1, 3):
            cv2.setNumThreads(number)
            answers.append(build(DisFlow).estimate(first, second))
            assert cv2.getNumThreads() == number
    finally:
        cv2.setNumThreads(threads)
    assert torch.equal(answers[0].nan_to_num(), answers[1].nan_to_num())

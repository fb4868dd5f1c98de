"""Threads may share a device without effect on their results."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch
from torch import Tensor

from core_rasterizer import Device, photometric_loss, rasterize
from tests.core_rasterizer.scenes import gradient, random_camera, random_scene, weighted_loss

THREADS, ROUNDS = 2, 25


@pytest.fixture(autouse=True)
def impatient_threads() -> Iterator[None]:
    """Python switches threads after a step or two, not after 5 ms."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(interval)


def same_in_threads(work: Callable[[int], list[Tensor]]) -> None:
    """Each thread repeats its own work; results equal those of a single thread."""
    alone = [work(number) for number in range(THREADS)]

    def differing(number: int) -> int:
        results = (work(number) for _ in range(ROUNDS))
        return sum(
            not all(torch.equal(a, b) for a, b in zip(result, alone[number], strict=True))
            for result in results
        )

    with ThreadPoolExecutor(THREADS) as pool:
        assert list(pool.map(differing, range(THREADS))) == [0] * THREADS


def test_renders_in_threads_do_not_disturb_each_other(device: Device) -> None:
    generator = torch.Generator().manual_seed(0)
    scenes = [random_scene(generator, 30 + 60 * number) for number in range(THREADS)]
    cameras = [random_camera(generator, 40 + 30 * number, 36) for number in range(THREADS)]

    def work(number: int) -> list[Tensor]:
        leaves = scenes[number].tensors(torch.float32)
        rendering = rasterize(*leaves, cameras[number], device=device)
        weighted_loss(rendering, number).backward()
        return [rendering.rgb.detach(), rendering.depth.detach(), *map(gradient, leaves)]

    same_in_threads(work)


def test_losses_in_threads_do_not_disturb_each_other(device: Device) -> None:
    images = torch.rand(THREADS, 2, 30, 40, 3, generator=torch.Generator().manual_seed(1))

    def work(number: int) -> list[Tensor]:
        rgb = images[number, 0].clone().requires_grad_()
        loss = photometric_loss(rgb, images[number, 1], device=device)
        loss.backward()
        return [loss.detach(), gradient(rgb)]

    same_in_threads(work)

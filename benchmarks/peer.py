"""Compare the engine with gsplat (Ye et al. 2024), which `make gpu` installs.

gsplat has plain torch versions of its CUDA kernels. Projection and colours run without CUDA; in double
precision `core_rasterizer.reference`, an independent implementation, is compared with them. Its CUDA kernels
are timed on a card.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import torch
from torch import Tensor
from torch.profiler import ProfilerActivity, profile

from benchmarks.surfaces import surfaces
from benchmarks.yardsticks import milliseconds
from core_rasterizer import Camera, Gaussians, reference

Parts = dict[str, Tensor]
"""Results of a projection for all Gaussians: centres, ellipses and colours."""


def gsplat_projection(peer: Any, parameters: Parts, camera: Camera) -> Parts:
    """Project by gsplat's plain torch functions.

    Args:
        peer: The module `gsplat.cuda._torch_impl`.
        parameters: Parameters as in `Gaussians`.
        camera: Camera without rotation or translation.
    """
    means = parameters["means"]
    covariances, _ = peer._quat_scale_to_covar_preci(
        parameters["quaternions"], parameters["log_scales"].exp(), compute_preci=False
    )
    intrinsics = means.new_tensor([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    _, places, _, conics, _ = peer._fully_fused_projection(
        means,
        covariances,
        torch.eye(4, dtype=means.dtype)[None],
        intrinsics[None],
        camera.width,
        camera.height,
        near_plane=reference.NEAR,
    )
    colours = peer._spherical_harmonics(3, means, parameters["sh"]) + 0.5
    return {"places": places[0], "conics": conics[0], "colours": colours.clamp_min(0)}


def reference_projection(parameters: Parts, camera: Camera) -> tuple[Parts, Tensor]:
    """Project by the reference implementation; return also the indices of visible Gaussians."""
    seen = reference.project(
        parameters["means"],
        parameters["quaternions"],
        parameters["log_scales"].exp(),
        parameters["opacity_logits"].sigmoid(),
        parameters["sh"],
        camera,
    )
    inverse = torch.linalg.inv(seen.covariances)
    conics = torch.stack([inverse[:, 0, 0], inverse[:, 0, 1], inverse[:, 1, 1]], 1)
    return {"places": seen.centers, "conics": conics, "colours": seen.colors}, seen.indices


def leaves(gaussians: Gaussians, dtype: torch.dtype) -> Parts:
    """Return the parameters as leaves of autograd."""
    names = ("means", "quaternions", "log_scales", "opacity_logits", "sh")
    return {name: getattr(gaussians, name).to(dtype).requires_grad_() for name in names}


def disagreement(peer: Any, count: int) -> dict[str, float]:
    """Return the largest differences of values and gradients between gsplat and the reference, in double.

    Values over the largest of their kind; gradients of one fixed random weighting of all values, over the
    largest gradient of the parameter.
    """
    gaussians, camera = surfaces(count)
    theirs, ours = leaves(gaussians, torch.float64), leaves(gaussians, torch.float64)
    made, indices = reference_projection(ours, camera)
    peers = {
        name: value[indices] for name, value in gsplat_projection(peer, theirs, camera).items()
    }
    generator = torch.Generator().manual_seed(0)
    found, weights = {}, []
    for name, value in made.items():
        found[name] = _distance(value.detach(), peers[name].detach())
        weights.append(torch.rand(value.shape, dtype=torch.float64, generator=generator))
    torch.autograd.backward(list(made.values()), weights)
    torch.autograd.backward(list(peers.values()), weights)
    for name, leaf in ours.items():
        mine, other = leaf.grad, theirs[name].grad
        if mine is not None and other is not None:
            found[f"gradient of {name}"] = _distance(mine, other)
    return found


def _distance(mine: Tensor, other: Tensor) -> float:
    return float((mine - other).abs().max() / mine.abs().max())


def cuda_times(count: int, size: Sequence[int], repeats: int) -> dict[str, float]:
    """Return milliseconds of gsplat's CUDA kernels on the scene of `engine.Workload`, without a loss.

    gsplat is compiled on first use, which takes minutes. Its image has colours only, ours also depth. Adam is
    torch's fused one.

    Returns:
        Kernels of the steps "forward", "backward" and "Adam" by torch's profiler, and "wall" of all three
        with a wait at the end.

    Raises:
        Exception: of any kind: gsplat, CUDA or a compiler is missing, or a build fails.
    """
    gsplat = import_module("gsplat")
    gaussians, camera = surfaces(count, *size)
    values = {
        name: leaf.detach().cuda().requires_grad_()
        for name, leaf in leaves(gaussians, torch.float32).items()
    }
    groups = [{"params": [value]} for value in values.values()]
    optimizer = torch.optim.Adam(groups, lr=1e-6, eps=1e-15, fused=True)
    lens = [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]
    pose, lenses = torch.eye(4).cuda()[None], torch.tensor([lens]).cuda()
    weights = torch.rand(1, size[1], size[0], 3, generator=torch.Generator().manual_seed(0)).cuda()

    def forward() -> Tensor:
        image: Tensor = gsplat.rasterization(
            values["means"],
            values["quaternions"],
            values["log_scales"].exp(),
            values["opacity_logits"].sigmoid(),
            values["sh"],
            pose,
            lenses,
            *size,
            near_plane=reference.NEAR,
            sh_degree=3,
            packed=False,
        )[0]
        return image

    def gradients() -> None:
        optimizer.zero_grad()
        forward().backward(weights)

    def iteration() -> None:
        gradients()
        optimizer.step()
        torch.cuda.synchronize()

    wall = milliseconds(iteration, repeats)
    sums = [_kernel_ms(work, repeats) for work in (forward, gradients, iteration)]
    steps = (sums[0], sums[1] - sums[0], sums[2] - sums[1])
    return dict(zip(("forward", "backward", "Adam"), steps, strict=True)) | {"wall": wall}


def _kernel_ms(work: Callable[[], object], repeats: int) -> float:
    """Return milliseconds of CUDA kernels and copies of some work."""
    with profile(activities=[ProfilerActivity.CUDA], acc_events=True) as measured:
        for _ in range(repeats):
            work()
        torch.cuda.synchronize()
    found = [one for one in measured.key_averages() if one.device_type.name == "CUDA"]
    return 1e-3 * sum(float(one.self_device_time_total) for one in found) / repeats

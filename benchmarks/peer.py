"""Compare the engine's projection with gsplat's in plain torch: `make bench-peer`, which installs gsplat.

gsplat (Ye et al. 2024) has plain torch versions of its CUDA kernels. Projection and colours run without CUDA,
rasterization does not. Times are compared on the same scene, in one run, forward and backward (the engine's
kernels also cull and find extents). In double precision `core_rasterizer.reference`, an independent
implementation, is compared with gsplat.
"""

from __future__ import annotations

import argparse
import sys
import time
from importlib import import_module
from statistics import median
from typing import Any

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from benchmarks.engine import Workload, stages
from benchmarks.surfaces import HEIGHT, WIDTH, surfaces
from benchmarks.yardsticks import all_torch_threads
from core_rasterizer import Camera, Gaussians, open_device, reference

COUNTS = (10_000, 126_000)
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


def peer_ms(peer: Any, count: int, repeats: int) -> tuple[float, float]:
    """Return median milliseconds of gsplat's projection, forward and backward, torch on all cores."""
    gaussians, camera = surfaces(count)
    parameters = leaves(gaussians, torch.float32)
    times = []
    with all_torch_threads():
        for _ in range(repeats + 2):
            begin = time.perf_counter()
            made = gsplat_projection(peer, parameters, camera)
            middle = time.perf_counter()
            torch.autograd.backward(
                list(made.values()), [torch.ones_like(value) for value in made.values()]
            )
            times.append((middle - begin, time.perf_counter() - middle))
    forward, backward = (1e3 * median(column) for column in zip(*times[2:], strict=True))
    return forward, backward


def _gradients(workload: Workload) -> None:
    """Compute gradients, which wait until something reads them."""
    workload.forward_backward()
    workload.model.gradient("means")


def compare(peer: Any, device: str | None, repeats: int) -> Table:
    """Return milliseconds of both and their ratio, by number of Gaussians."""
    table = Table("", *(f"N = {count:,}" for count in COUNTS))
    rows: dict[str, list[str]] = {}
    opened = open_device(device)
    kernels = {}
    for count in COUNTS:  # before gsplat: torch's threads spin for a while after their work
        taken = stages(count, opened, repeats, _gradients)
        kernels[count] = (taken["project"], taken["project_backward"])
    for count in COUNTS:
        theirs = peer_ms(peer, count, repeats)
        for step, their_ms, our_ms in zip(
            ("forward", "backward"), theirs, kernels[count], strict=True
        ):
            rows.setdefault(step, []).append(
                f"{their_ms:.1f} / {our_ms:.2f} ms = {their_ms / our_ms:.1f}"
            )
    for name, cells in rows.items():
        table.add_row(f"projection and colours, {name}: gsplat's torch / ours", *cells)
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", help="part of a device's name")
    parser.add_argument("--repeats", type=int, default=15)
    arguments = parser.parse_args()
    torch.set_num_threads(1)  # as `stereogs` does, next to the OpenCL device's threads
    try:
        peer = import_module("gsplat.cuda._torch_impl")
    except ImportError as error:
        sys.exit(f"peer: gsplat is missing ({error}); `make bench-peer` installs it")
    console = Console(soft_wrap=True)
    version = import_module("gsplat.version").__version__
    device = open_device(arguments.device).name
    console.print(f"gsplat {version} in plain torch, {device}, {WIDTH}x{HEIGHT}, medians")
    console.print(compare(peer, arguments.device, arguments.repeats))
    table = Table("gsplat against core_rasterizer.reference, double precision", "largest / largest")
    for name, value in disagreement(peer, COUNTS[0]).items():
        table.add_row(name, f"{value:.1e}")
    console.print(table)


if __name__ == "__main__":
    main()

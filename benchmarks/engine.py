"""Time and memory of the engine: `python -m benchmarks.engine`, which `make bench-engine` runs.

Prints tables and writes `benchmarks/out/engine.json`. Figures are medians of one run on one machine. Only
ratios are comparable between machines: to named baselines, and to plain work on the same number of bytes
(`benchmarks.yardsticks`).
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from statistics import median
from typing import Any
from unittest.mock import patch

import pyopencl as cl
import torch
from rich.console import Console
from torch import Tensor
from torch.nn.functional import conv2d

from benchmarks.surfaces import HEIGHT, WIDTH, surfaces
from benchmarks.yardsticks import Yardsticks, all_torch_threads, milliseconds, yardsticks
from core_rasterizer import (
    Adam,
    Device,
    GaussianModel,
    Rendering,
    open_device,
    photometric_loss,
)
from core_rasterizer.device import Program
from stereogs.experiments.showing.score_table import markdown

OUT = Path(__file__).parent / "out" / "engine.json"
COUNTS = (10_000, 50_000, 126_000)
UNSEEN_COUNT = 1000
"""Gaussians behind the camera, to measure the fixed costs of an iteration."""
MORE_COUNTS = (10_000, 50_000, 126_000, 300_000, 1_000_000)
SIZES = ((252, 189), (504, 378), (1008, 756), (2016, 1512), (4032, 3024))
"""The last is a photograph of 12 megapixels."""
RATES = dict.fromkeys(
    ("means", "log_scales", "quaternions", "opacity_logits", "sh_constant", "sh_rest"), 1e-6
)


class Workload:
    """One scene on one device, with the steps of a training iteration as methods."""

    def __init__(self, count: int, device: Device, width: int = WIDTH, height: int = HEIGHT):
        gaussians, self.camera = surfaces(count, width, height)
        self.model = GaussianModel(gaussians, device)
        self.optimizer = Adam(self.model)
        generator = torch.Generator().manual_seed(0)
        self.target = torch.rand(height, width, 3, generator=generator)
        self.weights = torch.rand(height, width, 3, generator=generator)

    def forward(self) -> None:
        with torch.no_grad():
            self.model.render(self.camera)
        self.model.device.finish()

    def forward_backward(self) -> None:
        self.model.zero_gradients()
        torch.autograd.backward([self.model.render(self.camera).rgb], [self.weights])
        self.model.device.finish()

    def iteration(self) -> None:
        self.model.zero_gradients()
        photometric_loss(self.model.render(self.camera), self.target).backward()
        self.optimizer.step(RATES, active_sh_degree=3, keep_gradients=False)
        self.model.device.finish()


def fixed_costs(device: Device, repeats: int = 45) -> dict[str, float]:
    """Return median milliseconds of the steps of an iteration without visible Gaussians."""
    workload = Workload(UNSEEN_COUNT, device)
    around = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0], dtype=torch.float64))
    camera = workload.camera
    camera = replace(camera, world_to_camera=around @ camera.world_to_camera)
    model, times = workload.model, []
    for _ in range(repeats + 2):
        begin = time.perf_counter()
        model.zero_gradients()
        rendering = model.render(camera)
        device.finish()
        rendered = time.perf_counter()
        loss = photometric_loss(rendering, workload.target)
        compared = time.perf_counter()
        loss.backward()
        device.finish()
        returned = time.perf_counter()
        workload.optimizer.step(RATES, active_sh_degree=3, keep_gradients=False)
        device.finish()
        times.append((begin, rendered, compared, returned, time.perf_counter()))
    steps = {
        name: 1e3 * median(stamps[number + 1] - stamps[number] for stamps in times[2:])
        for number, name in enumerate(("forward", "loss", "backward", "Adam"))
    }
    return steps | {"iteration": 1e3 * median(stamps[-1] - stamps[0] for stamps in times[2:])}


def stages(
    count: int,
    device: Device,
    repeats: int = 9,
    work: Callable[[Workload], None] = Workload.iteration,
    size: tuple[int, int] = (WIDTH, HEIGHT),
) -> dict[str, float]:
    """Return milliseconds of each kernel in some work, by default an iteration, measured by the driver."""
    device = device.as_variant(device.variant)
    events: list[tuple[str, cl.Event]] = []
    profiling = cl.command_queue_properties.PROFILING_ENABLE
    device.queue = cl.CommandQueue(device.context, properties=profiling)
    workload, run = Workload(count, device, *size), Program.run
    enqueue = cl.enqueue_nd_range_kernel
    work(workload)

    def kept(program: Program, kernel: str, *size: Any, **arguments: Any) -> None:
        events.append((kernel, run(program, kernel, *size, **arguments)))

    def kept_of_plan(queue: Any, kernel: cl.Kernel, *size: Any) -> None:
        events.append((kernel.function_name, enqueue(queue, kernel, *size)))

    planned = patch.object(cl, "enqueue_nd_range_kernel", kept_of_plan)
    with patch.object(Program, "run", kept), planned:
        for _ in range(repeats):
            work(workload)
    totals: dict[str, float] = {}
    for kernel, event in events:
        nanoseconds = event.profile.end - event.profile.start
        totals[kernel] = totals.get(kernel, 0.0) + 1e-6 * nanoseconds / repeats
    return totals


def torch_photometric(rgb: Tensor, target: Tensor) -> Tensor:
    """Return the same loss in plain torch, the baseline of the fused one."""
    offsets = torch.arange(11) - 5.0
    window = torch.exp(-offsets.square() / (2 * 1.5**2))
    window = (window / window.sum())[:, None] @ (window / window.sum())[None]
    weight = window.expand(3, 1, 11, 11).contiguous()
    x, y = (image.permute(2, 0, 1)[None] for image in (rgb, target))

    def blur(image: Tensor) -> Tensor:
        return conv2d(image, weight, padding=5, groups=3)

    mean_x, mean_y = blur(x), blur(y)
    var_x, var_y = blur(x * x) - mean_x**2, blur(y * y) - mean_y**2
    covariance = blur(x * y) - mean_x * mean_y
    top = (2 * mean_x * mean_y + 1e-4) * (2 * covariance + 9e-4)
    ssim = top / ((mean_x**2 + mean_y**2 + 1e-4) * (var_x + var_y + 9e-4))
    return 0.8 * (rgb - target).abs().mean() + 0.2 * (1 - ssim.mean())


def ratios(device: Device) -> dict[str, float]:
    """Return ratios of the engine to named baselines, in this run."""
    count = COUNTS[-1]
    workload = Workload(count, device)
    other = Workload(count, device.as_variant("gpu"))
    rgb = torch.rand(HEIGHT, WIDTH, 3, requires_grad=True)

    def loss(function: Callable[..., Tensor], **arguments: Any) -> Callable[[], None]:
        return lambda: function(rgb, workload.target, **arguments).backward()

    def engine_adam() -> None:
        workload.optimizer.step(RATES, active_sh_degree=3)
        device.finish()

    with all_torch_threads():
        torch_ssim_ms = milliseconds(loss(torch_photometric))
    return {
        "gpu_variant_over_cpu_variant": milliseconds(other.forward_backward, 3)
        / milliseconds(workload.forward_backward),
        "torch_ssim_over_fused": torch_ssim_ms
        / milliseconds(loss(photometric_loss, device=device)),
        "torch_fused_adam_over_ours": yardsticks(count).adam / milliseconds(engine_adam),
    }


def options(device: Device, rounds: int = 45) -> dict[str, float]:
    """Return times of renders with options over that of a plain one, in turns, medians over rounds."""
    workload = Workload(COUNTS[-1], device)
    camera, gaussians = workload.camera, workload.model.gaussians()
    compensated = GaussianModel(gaussians, device, compensate_dilation=True)
    pose = camera.world_to_camera.clone().requires_grad_()
    posed = replace(camera, world_to_camera=pose)
    smoothing = torch.full((len(gaussians),), 1e-3)
    renders: dict[str, Callable[[], Rendering]] = {
        "plain": lambda: workload.model.render(camera),
        "pose gradient": lambda: workload.model.render(posed),
        "dilation compensated": lambda: compensated.render(camera),
        "smoothing": lambda: workload.model.render(camera, smoothing=smoothing),
        "half of band 3": lambda: workload.model.render(camera, sh_degree=2.5),
    }
    times: dict[tuple[str, str], list[float]] = {}
    for number in range(rounds + 2):
        for name, render in renders.items():
            for model in (workload.model, compensated):
                model.zero_gradients()
            begin = time.perf_counter()
            rendering = render()
            device.finish()
            middle = time.perf_counter()
            torch.autograd.backward([rendering.rgb], [workload.weights])
            device.finish()
            if number >= 2:
                times.setdefault((name, "forward"), []).append(middle - begin)
                times.setdefault((name, "backward"), []).append(time.perf_counter() - middle)
    return {
        f"{name}, {part}": median(
            one / plain for one, plain in zip(values, times["plain", part], strict=True)
        )
        for (name, part), values in times.items()
        if name != "plain"
    }


def peak_memory_mb(count: int, width: int = WIDTH, height: int = HEIGHT) -> float:
    """Return peak memory in a new process, above that of an interpreter with torch and a device."""
    code = (
        "import sys; from benchmarks.engine import Workload, open_device\n"
        "from registry.system.memory import peak_memory_mb as peak\n"
        "count, *size = map(int, sys.argv[1:])\n"
        "d = open_device(); Workload(16, d).iteration(); base = peak()\n"
        "w = Workload(count, d, *size); [w.iteration() for _ in range(3)]\n"
        "print(peak() - base)"
    )
    output = subprocess.run(
        [sys.executable, "-c", code, *map(str, (count, width, height))],
        capture_output=True,
        text=True,
        check=True,
    )
    return float(output.stdout)


def growth_with_pixels(device: Device) -> dict[str, dict[str, float]]:
    """Return milliseconds of an iteration and peak memory for each size of image."""
    result: dict[str, dict[str, float]] = {"ms": {}, "ms_per_megapixel": {}, "peak_memory_mb": {}}
    for width, height in SIZES:
        name = f"{width}x{height}"
        workload = Workload(COUNTS[-1], device, width, height)
        result["ms"][name] = milliseconds(workload.iteration, 7)
        result["ms_per_megapixel"][name] = result["ms"][name] / (width * height / 1e6)
        del workload
        result["peak_memory_mb"][name] = peak_memory_mb(COUNTS[-1], width, height)
    return result


def measure(device: Device) -> dict[str, Any]:
    """Return all figures, in the layout of `engine.json`."""
    result: dict[str, Any] = {
        "device": f"{device.name} ({device.platform}, {device.compute_units} compute units)",
        "size": [WIDTH, HEIGHT],
    }
    for name in ("forward", "forward_backward", "iteration"):
        result[f"{name}_ms"] = {}
    result["yardsticks_ms"] = {}
    for count in COUNTS:
        result["yardsticks_ms"][str(count)] = asdict(yardsticks(count))
        workload = Workload(count, device)
        for name in ("forward", "forward_backward", "iteration"):
            result[f"{name}_ms"][str(count)] = milliseconds(getattr(workload, name))
    result["fixed_cost_ms"] = fixed_costs(device)
    result["stages_ms"] = stages(COUNTS[-1], device)
    result["ratios"] = ratios(device)
    result["options_over_plain"] = options(device)
    result["growth_with_count_ms"] = {
        str(count): milliseconds(Workload(count, device).iteration, 7) for count in MORE_COUNTS
    }
    result |= {
        f"growth_with_pixels_{unit}": row for unit, row in growth_with_pixels(device).items()
    }
    result["peak_memory_mb"] = {str(count): peak_memory_mb(count) for count in (126_000, 1_000_000)}
    return result


def show(result: dict[str, Any]) -> None:
    """Print the figures as tables."""
    print(f"{result['device']}, {WIDTH}x{HEIGHT}, SH degree 3, medians in ms\n")
    known = {count: Yardsticks(**ms) for count, ms in result["yardsticks_ms"].items()}
    rows, shown = [], ["device", "size", "yardsticks_ms"]
    for name in ("forward", "forward_backward", "iteration"):
        shown.append(f"{name}_ms")
        times = result[f"{name}_ms"]
        rows.append([name, *(f"{value:.1f}" for value in times.values())])
        ratios = [known[count].ratios(value) for count, value in times.items()]
        for unit, cells in zip(("copies", "Adam steps"), zip(*ratios, strict=True), strict=True):
            rows.append([f"in {unit}", *cells])
    print(markdown(["", *(f"N = {int(count):,}" for count in known)], rows))
    for name, figures in result.items():
        if name not in shown:
            print(markdown([name, ""], [[key, f"{x:.2f}"] for key, x in figures.items()]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", help="part of a device's name")
    arguments = parser.parse_args()
    # As `stereogs` does: torch's threads would spin next to the OpenCL device's.
    torch.set_num_threads(1)
    result = measure(open_device(arguments.device))
    show(result)
    OUT.parent.mkdir(parents=True, exist_ok=True)
    OUT.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    Console().print(f"written to {OUT}")


if __name__ == "__main__":
    main()

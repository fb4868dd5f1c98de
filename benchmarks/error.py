"""Run time against error: `python -m benchmarks.error`, which `make bench-error` runs.

Switches each approximation and each skip alone and measures its time and its error. Prints tables and writes
`benchmarks/out/error.json`; with `--write-docs` also `benchmarks/tables/error.md` and the summary and
picture of `docs/run_time.md`. Default and variant take turns, so a busy machine slows both.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import torch
from rich.console import Console
from torch import Tensor

from benchmarks.error_report import tables, write_docs
from benchmarks.garden import garden
from benchmarks.surfaces import surfaces
from benchmarks.switches import EXACT, Overrides, Setting, Switch, build, switches
from core_rasterizer import Camera, Device, GaussianModel, open_device
from core_rasterizer.layout import PARAMETERS

OUT = Path(__file__).parent / "out" / "error.json"
SECONDS_A_SETTING = 2.5
LAPS = (3, 25)
"""Fewest and most laps of a comparison."""
RACES_WITH_ITSELF = 4

Lap = tuple[float, float]
"""Seconds of a forward and of a backward pass."""


@dataclass(frozen=True)
class Rendered:
    """The colour image and the gradients of a fixed loss with a setting, in double."""

    rgb: Tensor
    gradients: Mapping[str, Tensor]


@dataclass(frozen=True)
class SwitchRow:
    """One setting: time relative to the default's, and errors relative to the switch's baseline."""

    switch: str
    setting: str
    default: bool
    forward_ratio: float
    backward_ratio: float
    time_ratio: float
    """Forward and backward together, over the default's."""
    image_max: float
    """Largest error of a colour, over the largest colour."""
    image_999: float
    """The same for the 99.9th percentile of the errors."""
    image_psnr: float
    gradient: float
    """|error| / |gradient| (L2), of the parameter with the largest ratio."""
    total_psnr: float
    """The image against the truth: double, no approximation."""


class Subject:
    """Gaussians and a camera with one setting."""

    def __init__(self, model: GaussianModel, camera: Camera, setting: Setting) -> None:
        self.model = build(model, setting)
        self.camera = camera
        self.setting = setting
        size = (camera.height, camera.width)
        generator = torch.Generator().manual_seed(1)
        weights = torch.randn(*size, 3, generator=generator, dtype=torch.float64)
        self.weights = weights.to(setting.dtype)
        self.no_depth = torch.zeros(size, dtype=setting.dtype)

    def lap(self) -> Lap:
        """One forward and one backward pass, until the device is done."""
        self.model.zero_gradients()
        begin = time.perf_counter()
        rendering = self.model.render(self.camera, sh_degree=self.setting.sh_degree)
        self.model.device.finish()
        middle = time.perf_counter()
        images, gradients = [rendering.rgb], [self.weights]
        if self.setting.depth_gradient:
            images.append(rendering.depth)
            gradients.append(self.no_depth)
        torch.autograd.backward(images, gradients)
        self.model.device.finish()
        self.rgb = rendering.rgb.detach()
        return middle - begin, time.perf_counter() - middle

    def outcome(self) -> Rendered:
        self.lap()
        return Rendered(
            self.rgb.double(), {name: self.model.gradient(name).double() for name in PARAMETERS}
        )


def psnr(image: Tensor, truth: Tensor) -> float:
    """In dB, white being 1; infinite for equal images."""
    return float(-10 * torch.log10((image - truth).square().mean()))


def relative(values: Tensor, truth: Tensor) -> float:
    """|values - truth| / |truth|; zero for equal ones."""
    return float((values - truth).norm() / truth.norm().clamp(min=1e-300))


def compare(outcome: Rendered, baseline: Rendered, truth: Rendered) -> dict[str, float]:
    """The errors of a row."""
    errors = (outcome.rgb - baseline.rgb).abs().flatten() / baseline.rgb.abs().max()
    return {
        "image_max": float(errors.max()),
        "image_999": float(errors.sort().values[int(0.999 * len(errors))]),
        "image_psnr": psnr(outcome.rgb, baseline.rgb),
        "gradient": max(
            relative(outcome.gradients[name], baseline.gradients[name]) for name in PARAMETERS
        ),
        "total_psnr": psnr(outcome.rgb, truth.rgb),
    }


class SceneBenchmark:
    """All switches on one scene."""

    def __init__(self, model: GaussianModel, camera: Camera) -> None:
        self.model, self.camera = model, camera
        self.default = Subject(model, camera, Setting("default"))
        self.default_outcome = self.default.outcome()
        self.default_laps: list[Lap] = []
        self._double: dict[tuple[tuple[str, float], ...], Rendered] = {}
        self.truth = self.double(EXACT)

    def double(self, overrides: Overrides) -> Rendered:
        """Return the outcome of double-precision kernels."""
        key = tuple(sorted(overrides.items()))
        if key not in self._double:
            setting = Setting("double", overrides, dtype=torch.float64)
            self._double[key] = Subject(self.model, self.camera, setting).outcome()
        return self._double[key]

    def race(self, other: Subject) -> tuple[float, float, float]:
        """Median ratios to the default's time: forward, backward, both together."""
        self.default.lap()
        other.lap()
        laps: list[tuple[Lap, Lap]] = []
        end = time.perf_counter() + SECONDS_A_SETTING
        while len(laps) < LAPS[0] or (len(laps) < LAPS[1] and time.perf_counter() < end):
            laps.append((self.default.lap(), other.lap()))
        self.default_laps += [ours for ours, _ in laps]
        return (
            median(theirs[0] / ours[0] for ours, theirs in laps),
            median(theirs[1] / ours[1] for ours, theirs in laps),
            median(sum(theirs) / sum(ours) for ours, theirs in laps),
        )

    def row(self, switch: Switch, setting: Setting) -> SwitchRow:
        """Measure one setting; the default is not timed against itself."""
        subject = Subject(self.model, self.camera, setting)
        outcome = subject.outcome()
        baseline = (
            self.default_outcome if switch.baseline == "default" else self.double(switch.exact)
        )
        times = (1.0, 1.0, 1.0) if setting.default else self.race(subject)
        errors = compare(outcome, baseline, self.truth)
        return SwitchRow(switch.name, setting.label, setting.default, *times, **errors)

    def measure(self) -> dict[str, Any]:
        """Return rows of all settings, the default's milliseconds, and ratios of the default to itself."""
        rows = []
        for switch in switches(self.model.device):
            Console(stderr=True).print(f"  {switch.name}", style="dim")
            rows += [asdict(self.row(switch, setting)) for setting in switch.settings]
        twin = Subject(self.model, self.camera, Setting("default"))
        return {
            "gaussians": self.model.count,
            "size": [self.camera.width, self.camera.height],
            "ratios_to_itself": [self.race(twin)[2] for _ in range(RACES_WITH_ITSELF)],
            "default_forward_ms": 1e3 * median(lap[0] for lap in self.default_laps),
            "default_backward_ms": 1e3 * median(lap[1] for lap in self.default_laps),
            "rows": rows,
        }


def measure(device: Device) -> dict[str, Any]:
    """Return all figures, in the layout of `error.json`."""
    discs, camera = surfaces(50_000)
    scenes = {"surfaces": (discs, [camera, camera.shifted_right(1.0)])}
    if (real := garden()) is not None:
        scenes["garden"] = real
    result: dict[str, Any] = {
        "device": f"{device.name} ({device.platform}, {device.compute_units} compute units)",
        "scenes": {},
    }
    for name, (gaussians, cameras) in scenes.items():
        Console(stderr=True).print(name, style="dim")
        model = GaussianModel(gaussians, device)
        result["scenes"][name] = SceneBenchmark(model, cameras[0]).measure()
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", help="part of a device's name")
    parser.add_argument(
        "--write-docs", action="store_true", help="rewrite tables, summary and picture"
    )
    arguments = parser.parse_args()
    result = measure(open_device(arguments.device))
    print(tables(result))
    OUT.parent.mkdir(parents=True, exist_ok=True)
    OUT.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    Console().print(f"written to {OUT}")
    if arguments.write_docs:
        for path in write_docs(result):
            Console().print(f"written to {path}")


if __name__ == "__main__":
    main()

"""Compare a device with the reference renderer, and time it, as `stereogs doctor` does.

`python -m core_rasterizer.self_test` prints the devices, with a number the result for one of them, as JSON.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict, dataclass

import torch
from torch import Tensor

from . import reference
from .camera import Camera
from .device import Device, Trial, list_devices
from .errors import ExplainedError
from .gaussians import Gaussians
from .layout import PARAMETER_GROUPS, PARAMETERS
from .optimization import Adam, GaussianModel, photometric_loss

__all__ = ["Verdict", "iteration_seconds", "self_test", "trial"]

TOLERANCE = 1e-3
"""Largest difference of a colour in [0, 1] due to rounding; a visible difference is 1/255."""
GRADIENT_TOLERANCE = 1e-2
"""Largest relative difference of a gradient, by norm."""
_SEED = 3
"""No pixel is within 1e-4 of a threshold, where rounding would decide and errors reach 1/255."""


@dataclass(frozen=True)
class Verdict:
    """Difference between a device and the reference.

    Args:
        image_error: largest difference of a colour; colours are about 0 to 1.
        gradient_error: norm of the difference over norm of the reference, of the worst parameter.
        depth_error: largest difference over the largest value, of the depth images.
    """

    image_error: float
    gradient_error: float
    depth_error: float = 0.0

    @property
    def passed(self) -> bool:
        """Whether all errors are small; False if one is not a number."""
        return (
            self.image_error <= TOLERANCE
            and self.gradient_error <= GRADIENT_TOLERANCE
            and self.depth_error <= TOLERANCE
        )


def self_test(device: Device) -> Verdict:
    """Render three scenes and differentiate the images, on the device and by the reference.

    Raises:
        DeviceError: the device could not be opened, or the kernels could not be built.
    """
    verdicts = [_compare(device, gaussians, camera) for gaussians, camera in _scenes()]
    # A maximum would drop values that are not numbers.
    errors = torch.tensor([[v.image_error, v.gradient_error, v.depth_error] for v in verdicts])
    return Verdict(*errors.amax(dim=0).tolist())


def iteration_seconds(device: Device) -> float:
    """Time one training iteration: render, loss, backward and Adam's step, 20,000 Gaussians at 320x240.

    Returns:
        The least measurement of about a second, seconds: other processes may disturb most of them.
        Kernels are built before.
    """
    model = GaussianModel(_gaussians(20_000, -5.0, -3.0), device)
    optimizer, rates = Adam(model), dict.fromkeys(PARAMETER_GROUPS, 1e-4)
    camera = Camera(torch.eye(4), 300.0, 300.0, 160.0, 120.0, width=320, height=240)
    target = torch.full((240, 320, 3), 0.5)

    def iteration() -> float:
        start = time.perf_counter()
        model.zero_gradients()
        photometric_loss(model.render(camera), target).backward()
        optimizer.step(rates, model.sh_degree)
        optimizer.check_parameters()  # waits for the step
        return time.perf_counter() - start

    iteration()
    times = [iteration()]
    while sum(times) < 1:
        times.append(iteration())
    return min(times)


def trial(device: Device) -> Trial:
    """Test a device and time it. Errors become the failure of the result."""
    try:
        verdict = self_test(device)
        failure = None if verdict.passed else "it computes wrongly"
        return Trial(
            failure,
            **({"seconds": iteration_seconds(device)} if verdict.passed else {}),
            **asdict(verdict),
        )
    except ExplainedError as error:
        return Trial(failure="; ".join(filter(None, (error.what, error.fix))))
    except Exception as error:  # broken drivers raise anything
        return Trial(failure=f"{type(error).__name__}: {error}")


def main() -> None:
    """Print the answer that `device.trial` reads."""
    torch.set_num_threads(1)  # beside the device's threads, torch's would wait in a spin
    devices = list_devices()
    if len(sys.argv) > 1:
        answer = asdict(trial(devices[int(sys.argv[1])]))
    else:
        answer = {"devices": [asdict(device.describe(i)) for i, device in enumerate(devices)]}
    print(json.dumps(answer))


def _scenes() -> tuple[tuple[Gaussians, Camera], ...]:
    pose = torch.tensor(
        [
            [0.96, 0.0, -0.28, 0.1],
            [0.0, 1.0, 0.0, -0.05],
            [0.28, 0.0, 0.96, 0.2],
            [0.0, 0.0, 0.0, 1.0],
        ],
        dtype=torch.float64,
    )
    straight = torch.eye(4, dtype=torch.float64)
    return (
        (_gaussians(300, -3.5, -1.5), Camera(pose, 90.0, 95.0, 27.0, 34.0, width=96, height=66)),
        (_many_behind(), Camera(straight, 90.0, 90.0, 48.0, 32.0, width=96, height=64)),
        # One Gaussian covers more than 64 tiles (each at most 64x32 pixels), too many for a tile mask.
        (_with_giant(), Camera(straight, 550.0, 550.0, 288.0, 128.0, width=576, height=256)),
    )


def _compare(device: Device, gaussians: Gaussians, camera: Camera) -> Verdict:
    generator = torch.Generator().manual_seed(_SEED)
    weights = torch.rand(camera.height, camera.width, 4, generator=generator)

    def loss(rgb: Tensor, depth: Tensor) -> Tensor:
        factors = weights.to(rgb.dtype)
        return (rgb * factors[..., :3]).sum() + (depth * factors[..., 3]).sum()

    model = GaussianModel(gaussians, device)
    rendering = model.render(camera)
    loss(rendering.rgb, rendering.depth).backward()
    leaves = {name: getattr(gaussians, name).double().requires_grad_() for name in PARAMETERS}
    expected = reference.render(
        leaves["means"],
        leaves["quaternions"],
        leaves["log_scales"].exp(),
        leaves["opacity_logits"].sigmoid(),
        leaves["sh"],
        camera,
    )
    loss(expected.rgb, expected.depth).backward()
    gradients = [(model.gradient(name).double(), leaf.grad) for name, leaf in leaves.items()]
    errors = [(own - true).norm() / true.norm() for own, true in gradients if true is not None]
    depth_difference = (rendering.depth.detach().double() - expected.depth.detach()).abs().max()
    return Verdict(
        image_error=float((rendering.rgb.detach().double() - expected.rgb.detach()).abs().max()),
        gradient_error=float(torch.stack(errors).amax()),
        depth_error=float(depth_difference / expected.depth.detach().max()),
    )


def _gaussians(count: int, smallest: float, largest: float) -> Gaussians:
    """Gaussians in a box in front of the camera.

    Args:
        smallest, largest: range of the logarithm of the scales.
    """
    generator = torch.Generator().manual_seed(_SEED)

    def uniform(*shape: int, low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(*shape, generator=generator)

    means = uniform(count, 3, low=-1.5, high=1.5)
    means[:, 2] += 4.0
    return Gaussians(
        means=means,
        log_scales=uniform(count, 3, low=smallest, high=largest),
        quaternions=torch.randn(count, 4, generator=generator),
        opacity_logits=uniform(count, low=-1.5, high=1.5),
        sh=0.3 * torch.randn(count, 16, 3, generator=generator),
    )


def _many_behind() -> Gaussians:
    """More Gaussians than a CPU sorts in one chunk (2^14), with equal depths; most are behind the camera."""
    gaussians = _gaussians(17_000, -5.0, -3.0)
    gaussians.means[:, 2] = (gaussians.means[:, 2] * 64).round() / 64
    hidden = torch.arange(17_000) % 16 != 0
    gaussians.means[hidden, 2] *= -1
    return gaussians


def _with_giant() -> Gaussians:
    """A dozen Gaussians; the first is in the middle of them and covers the whole image."""
    gaussians = _gaussians(12, -3.0, -1.5)
    gaussians.means[0] = torch.tensor([0.0, 0.0, 4.0])
    gaussians.log_scales[0] = 1.0
    return gaussians


if __name__ == "__main__":
    main()

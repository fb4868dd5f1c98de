"""Compare a device with the reference renderer, as `stereogs doctor` does."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from . import reference
from .camera import Camera
from .device import Device
from .gaussians import Gaussians
from .optimization.model import GaussianModel

__all__ = ["Verdict", "self_test"]

TOLERANCE = 1e-3
"""Largest difference of a colour in [0, 1] due to rounding; a visible difference is 1/255."""
GRADIENT_TOLERANCE = 1e-2
"""Largest relative difference of a gradient, by norm."""
_SEED = 20240229


@dataclass(frozen=True)
class Verdict:
    """Difference between a device and the reference.

    Args:
        image_error: largest difference of a colour; colours are about 0 to 1.
        gradient_error: norm of the difference over norm of the reference, of the worst parameter.
    """

    image_error: float
    gradient_error: float

    @property
    def passed(self) -> bool:
        """Whether both errors are small; False if one is not a number."""
        return self.image_error <= TOLERANCE and self.gradient_error <= GRADIENT_TOLERANCE


def self_test(device: Device) -> Verdict:
    """Render 300 Gaussians and differentiate the image, on the device and by the reference.

    Raises:
        DeviceError: the device could not be opened, or the kernels could not be built.
    """
    gaussians = _gaussians()
    camera = Camera(torch.eye(4), fx=90.0, fy=95.0, cx=47.0, cy=34.0, width=96, height=66)
    generator = torch.Generator().manual_seed(_SEED)
    weights = torch.rand(camera.height, camera.width, 3, generator=generator)
    model = GaussianModel(gaussians, device)
    rendering = model.render(camera)
    (rendering.rgb * weights).sum().backward()
    leaves = {
        name: getattr(gaussians, name).double().requires_grad_()
        for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh")
    }
    expected = reference.render(
        leaves["means"],
        leaves["quaternions"],
        leaves["log_scales"].exp(),
        leaves["opacity_logits"].sigmoid(),
        leaves["sh"],
        camera,
    )
    (expected.rgb * weights.double()).sum().backward()
    image_error = float((rendering.rgb.detach().double() - expected.rgb.detach()).abs().max())
    gradients = [(model.gradient(name).double(), leaf.grad) for name, leaf in leaves.items()]
    errors = [
        float((own - true).norm() / true.norm()) for own, true in gradients if true is not None
    ]
    return Verdict(image_error, max(errors))


def _gaussians() -> Gaussians:
    count, generator = 300, torch.Generator().manual_seed(_SEED)

    def uniform(*shape: int, low: float, high: float) -> torch.Tensor:
        return low + (high - low) * torch.rand(*shape, generator=generator)

    means = uniform(count, 3, low=-1.5, high=1.5)
    means[:, 2] += 4.0
    return Gaussians(
        means=means,
        log_scales=uniform(count, 3, low=-3.5, high=-1.5),
        quaternions=torch.randn(count, 4, generator=generator),
        opacity_logits=uniform(count, low=-1.5, high=1.5),
        sh=0.3 * torch.randn(count, 16, 3, generator=generator),
    )

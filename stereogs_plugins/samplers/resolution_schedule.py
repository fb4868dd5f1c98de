"""`resolution_schedule`: train on reduced photographs first, on full resolution later.

The cost of an iteration is proportional to its pixels, and early iterations move Gaussians by whole pixels.
DashGaussian (Chen et al., CVPR 2025) chooses the resolution from the frequencies in the photographs; here
it is constant until the component's `stop`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pydantic import Field

from registry import Context, Register, Sample, Sampler, Settings, Step, hookimpl

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera


class ResolutionScheduleSettings(Settings):
    shrink: int = Field(2, ge=1)
    """Divisor of width and height, which are rounded up; 1 keeps the size."""


class ResolutionSchedule(Sampler[ResolutionScheduleSettings]):
    """The same view with fewer pixels, each the mean of the pixels that it covers.

    A regularizer that uses a map of the photograph must resize it to the render's size
    (`registry.toolkit.networks.image_fitting.at_size`).
    """

    def __init__(self, settings: ResolutionScheduleSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._known: dict[str, tuple[Camera, Tensor]] = {}

    def sample(self, step: Step, sample: Sample) -> Sample:
        """Return the sample with target and weights of `[ceil(H / shrink), ceil(W / shrink)]` pixels."""
        camera, target = sample.camera, sample.target
        if camera is sample.view.camera and target is sample.view.image:
            if sample.view.name not in self._known:
                self._known[sample.view.name] = self._smaller(camera, target)
            camera, target = self._known[sample.view.name]
        else:  # changed by another sampler, maybe differently in each iteration
            camera, target = self._smaller(camera, target)
        weights = sample.weights
        if weights is not None:
            weights = _means(weights[..., None], camera)[..., 0]
        return replace(sample, camera=camera, target=target, weights=weights)

    def _smaller(self, camera: Camera, image: Tensor) -> tuple[Camera, Tensor]:
        shrink = self.settings.shrink
        smaller = camera.resized(-(-camera.width // shrink), -(-camera.height // shrink))
        return smaller, _means(image, smaller)


def _means(image: Tensor, camera: Camera) -> Tensor:
    """Reduce an image `[H, W, C]` to a camera's size; each pixel is the mean of those that it covers."""
    from torch.nn.functional import interpolate

    channels = image.permute(2, 0, 1)[None]
    means = interpolate(channels, size=(camera.height, camera.width), mode="area")
    return means[0].permute(1, 2, 0).contiguous()


@hookimpl
def stereogs_register_samplers(register: Register[ResolutionSchedule]) -> None:
    register("resolution_schedule", ResolutionSchedule)

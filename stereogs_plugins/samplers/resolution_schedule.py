"""`resolution_schedule`: small photographs first, whole ones later (coarse to fine in pixels).

What an iteration costs follows the pixels. Early iterations move Gaussians by whole pixels and need no
fine ones: the idea of DashGaussian (Chen et al., CVPR 2025), which ties the size to the frequencies in
the photographs; here it is one size until the host's `stop`.
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
    """Width and height are divided by this, rounded up; 1 changes nothing."""


class ResolutionSchedule(Sampler[ResolutionScheduleSettings]):
    """The same view through a camera of fewer pixels; each is the mean of those that it covers.

    A term that compares with a map of the photograph takes its pixels at the render's size
    (`registry.toolkit.networks.image_fitting.at_size`), as those of this package do.
    """

    def __init__(self, settings: ResolutionScheduleSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._known: dict[str, tuple[Camera, Tensor]] = {}

    def sample(self, step: Step, sample: Sample) -> Sample:
        """Return the sample with a smaller camera and target, `[ceil(H / shrink), ceil(W / shrink), 3]`."""
        camera, target = sample.camera, sample.target
        if camera is sample.view.camera and target is sample.view.image:
            if sample.view.name not in self._known:
                self._known[sample.view.name] = self._smaller(camera, target)
            camera, target = self._known[sample.view.name]
        else:  # another sampler has changed it, and may change it anew each time
            camera, target = self._smaller(camera, target)
        return replace(sample, camera=camera, target=target)

    def _smaller(self, camera: Camera, image: Tensor) -> tuple[Camera, Tensor]:
        from torch.nn.functional import interpolate

        shrink = self.settings.shrink
        smaller = camera.resized(-(-camera.width // shrink), -(-camera.height // shrink))
        channels = image.permute(2, 0, 1)[None]
        means = interpolate(channels, size=(smaller.height, smaller.width), mode="area")
        return smaller, means[0].permute(1, 2, 0).contiguous()


@hookimpl
def stereogs_register_samplers(register: Register[ResolutionSchedule]) -> None:
    register("resolution_schedule", ResolutionSchedule)

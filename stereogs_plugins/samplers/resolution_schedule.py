"""`resolution_schedule`: small photographs first, whole ones later (coarse to fine in pixels).

What an iteration costs follows the pixels. Early iterations move Gaussians by whole pixels and need no
fine ones: the idea of DashGaussian (Chen et al., CVPR 2025), which ties the size to the frequencies in
the photographs; here it is one size until the host's `stop`.
"""

from __future__ import annotations

from dataclasses import replace

from pydantic import Field

from registry import Register, Sample, Sampler, Settings, Step, hookimpl


class ResolutionScheduleSettings(Settings):
    shrink: int = Field(2, ge=1)
    """Width and height are divided by this, rounded up; 1 changes nothing."""


class ResolutionSchedule(Sampler[ResolutionScheduleSettings]):
    """The same view through a camera of fewer pixels; each is the mean of those that it covers.

    For losses on colours: a term that compares with a map of the photograph's own size does not fit.
    """

    def sample(self, step: Step, sample: Sample) -> Sample:
        """Return the sample with a smaller camera and target, `[ceil(H / shrink), ceil(W / shrink), 3]`."""
        from torch.nn.functional import interpolate

        shrink = self.settings.shrink
        camera = sample.camera
        smaller = camera.resized(-(-camera.width // shrink), -(-camera.height // shrink))
        channels = sample.target.permute(2, 0, 1)[None]
        means = interpolate(channels, size=(smaller.height, smaller.width), mode="area")
        return replace(sample, camera=smaller, target=means[0].permute(1, 2, 0).contiguous())


@hookimpl
def stereogs_register_samplers(register: Register[ResolutionSchedule]) -> None:
    register("resolution_schedule", ResolutionSchedule)

"""`gradient_threshold`: clone, split and prune as in 3D Gaussian Splatting (Kerbl et al. 2023).

A large screen-space gradient of the position indicates missing detail: a small Gaussian is cloned, a large
one split. Faint Gaussians are pruned, and later also oversized ones.

Opposite gradients of different pixels cancel, so that large blurry Gaussians are never split.
AbsGS (Ye et al. 2024) splits by the sum of absolute per-pixel gradients: `absolute_threshold`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Densification, HostDefaults, Percent, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from core_rasterizer import Edit
    from registry import Rendered


class GradientThresholdSettings(Settings):
    gradient_threshold: float = Field(2e-4, gt=0)
    """Minimum mean norm of the screen-space gradient, in normalised device coordinates, to clone or
    split a Gaussian."""
    absolute_threshold: float | None = Field(None, gt=0)
    """Minimum mean norm of the absolute screen-space gradient to split a Gaussian (AbsGS: 0.0004);
    null splits by `gradient_threshold`."""
    percent_dense: float = Field(0.01, gt=0)
    """Largest scale, relative to the scene's extent, of a Gaussian that is cloned instead of split."""
    split_into: int = Field(2, ge=2, le=100)
    """Number of children of a split Gaussian; their scales are divided by 0.8 times this (3DGS)."""
    min_opacity: float = Field(0.005, ge=0, lt=1)
    """Gaussians fainter than this are pruned."""
    size_prune_from: int | None = Field(3000, ge=0)
    """Iteration after which Gaussians larger than `max_size` are pruned; null: never."""
    max_size: float = Field(0.1, gt=0)
    """Largest scale that is kept, relative to the scene's extent."""
    min_gaussians: int = Field(1, ge=1)
    """Pruning is skipped if it would keep fewer Gaussians than this."""
    most_per_pixel: float | None = Field(None, gt=0)
    """Densification is skipped at this number of Gaussians per pixel of the training photographs;
    null: never skipped."""


class GradientThreshold(Densification[GradientThresholdSettings]):
    """The rules of 3DGS for which Gaussians to clone, split and prune; the pipeline sets the schedule."""

    host_defaults = HostDefaults(start=Percent(2), stop=Percent(49.9), every=100, phase=0)

    @classmethod
    def needs_rendered(cls, settings: GradientThresholdSettings) -> tuple[Rendered, ...]:
        """Return the screen gradients that decide."""
        if settings.absolute_threshold is None:
            return ("screen_gradient",)
        return ("screen_gradient", "absolute_screen_gradient")

    def refine(self, step: Step) -> Edit | None:
        """Return the edit, even if empty, which resets the statistics; None if skipped."""
        from core_rasterizer import Edit

        settings, model = self.settings, step.model
        if settings.most_per_pixel is not None:
            pixels = sum(view.camera.width * view.camera.height for view in step.scene.train)
            if model.count >= settings.most_per_pixel * pixels:
                return None
        size = model.scales().amax(dim=1)
        high = high_for_split = model.screen_gradient() >= settings.gradient_threshold
        large = size > settings.percent_dense * step.extent
        if settings.absolute_threshold is not None:
            high_for_split = model.absolute_screen_gradient() >= settings.absolute_threshold
        clone, split = high & ~large, high_for_split & large
        children, shrink = settings.split_into, 0.8 * settings.split_into
        prune = model.opacities() < settings.min_opacity
        if settings.size_prune_from is not None and step.iteration > settings.size_prune_from:
            size_after = size.where(~split, size / shrink)
            prune = prune | (size_after > settings.max_size * step.extent)
        survivors = ~prune
        added = int((survivors & clone).sum()) + (children - 1) * int((survivors & split).sum())
        kept = None if int(survivors.sum()) + added < settings.min_gaussians else prune
        return Edit(clone=clone, split=split, prune=kept, split_into=children, shrink=shrink)


@hookimpl
def stereogs_register_densifications(register: Register[GradientThreshold]) -> None:
    register("gradient_threshold", GradientThreshold)

"""`gradient_threshold`: clone, split and prune as 3D Gaussian Splatting does (Kerbl et al. 2023).

Where the image pulls hard at a Gaussian's place on the screen, detail is missing: a small Gaussian is
cloned, a large one split. Faint Gaussians go, and later also those that have grown out of proportion.

Pixels that pull a large Gaussian in opposite directions cancel, so that the blurry ones are never split.
AbsGS (Ye et al. 2024) splits by the absolute values of what pixels pull: `absolute_threshold`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from pydantic import Field

from registry import Densification, Register, Settings, Step, hookimpl

if TYPE_CHECKING:
    from core_rasterizer import Edit


class GradientThresholdSettings(Settings):
    gradient_threshold: float = Field(2e-4, gt=0)
    """Mean norm of the screen-space gradient, in normalised device coordinates, from which on a
    Gaussian is cloned or split."""
    absolute_threshold: float | None = Field(None, gt=0)
    """Split by the screen gradient without cancellation, from this mean norm on (AbsGS: 0.0004);
    null splits by the same gradient as it clones."""
    percent_dense: float = Field(0.01, gt=0)
    """Largest scale, as a part of the scene's extent, of a Gaussian that is cloned instead of split."""
    split_into: int = Field(2, ge=2)
    """How many children a split Gaussian has; their scales are divided by 0.8 times as many (3DGS)."""
    min_opacity: float = Field(0.005, ge=0, lt=1)
    """Gaussians fainter than this are removed."""
    size_prune_from: int | None = Field(3000, ge=0)
    """After this iteration, Gaussians larger than `max_size` are removed; null never does."""
    max_size: float = Field(0.1, gt=0)
    """Largest scale that is kept, as a part of the scene's extent."""
    min_gaussians: int = Field(1, ge=1)
    """Nothing is removed if fewer Gaussians than this would be left."""
    most_per_pixel: float | None = Field(None, gt=0)
    """Nothing is done where there are so many Gaussians already for each pixel of the training
    photographs; null: it is always done."""


class GradientThreshold(Densification[GradientThresholdSettings]):
    """The rules of 3DGS for when to clone, split and prune; when it is due, the pipeline says."""

    @property
    def absolute_gradients(self) -> bool:
        """Whether splits go by absolute gradients."""
        return self.settings.absolute_threshold is not None

    def refine(self, step: Step) -> Edit | None:
        """Return the edit, empty masks included, so that statistics start anew; None where all are there."""
        from core_rasterizer import Edit

        settings, model = self.settings, step.model
        if settings.most_per_pixel is not None:
            pixels = sum(view.camera.width * view.camera.height for view in step.scene.train)
            if model.count >= settings.most_per_pixel * pixels:
                return None
        size = model.scales().amax(dim=1)
        pulled = model.screen_gradient() >= settings.gradient_threshold
        large = size > settings.percent_dense * step.extent
        torn = pulled
        if settings.absolute_threshold is not None:
            torn = model.absolute_screen_gradient() >= settings.absolute_threshold
        clone, split = pulled & ~large, torn & large
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

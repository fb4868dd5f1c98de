"""`stereo_depth`: depth by stereo matching of a photograph and a rendered right view (StereoGS).

A stereo model matches the training photograph with a render from a virtual camera to its right. Where the
left and right disparities agree, f_x d / D_l is a depth, and the loss is the difference of inverse depths.
Gradients flow into the depth rendered at the left camera only, not into the right view or the model.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from registry import (
    Context,
    HostDefaults,
    Percent,
    Register,
    Regularizer,
    Settings,
    Step,
    TrainingView,
    hookimpl,
)
from registry.priors import Disparity, StereoPrior
from registry.toolkit.images import at_size, dark_background

from .baseline import BaselineSettings, choose_baseline

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

MIN_DISPARITY = 0.1
"""Pixels; at smaller disparities the depth diverges."""
MIN_ALPHA = 0.05
"""Pixels with a lower alpha have no valid depth."""
MIN_DEPTH = 1e-3
"""In units of the scene's near bound; at smaller depths 1 / depth diverges."""

DARK_LEVEL = 30
"""With `background: intensity` a pixel is dark if all its channels are below this 8-bit value."""


class StereoDepthSettings(Settings):
    removed: ClassVar = {"background_level": DARK_LEVEL}
    prior: str | None = None
    """Name of the stereo prior; null uses the only one."""
    baseline: BaselineSettings = BaselineSettings()
    """Distance between the two cameras; computed at the first call, then constant."""
    tau: float = Field(2.0, ge=0, allow_inf_nan=False)
    """Largest difference between the disparities of the two images, pixels."""
    validity_mask: bool = True
    """If False, all pixels with a disparity are used (the paper's ablation)."""
    background: Literal["alpha", "intensity", "none"] = "alpha"
    """Excluded pixels: those not `solid` in a photograph with alpha (Blender); dark ones, all channels
    below 30 of 255, with a dark run to their left (DTU); or none. Depth of a backdrop would produce fog."""
    depth: Literal["accumulated", "expected"] = "accumulated"
    """Rendered depth: as blended (the paper), or divided by alpha, which has no gradient to opacities."""
    normalize: Literal["none", "zref", "disparity"] = "none"
    """Unit of the difference: 1 / world unit (the paper), relative to the median depth, or pixels."""
    reduction: Literal["mean_valid", "mean_all", "sum"] = "mean_valid"
    """Reduction over the valid pixels: their mean, their sum over the number of all pixels, or their sum."""
    refresh_threshold: float = Field(0.01, ge=0, allow_inf_nan=False)
    """Run the prior again only if the right view has changed by more than this (mean absolute
    difference of 4x4-pixel means, colours in [0, 1]) since the last call; 0 always runs it."""


class StereoDepth(Regularizer[StereoDepthSettings]):
    """mean |1 / Z - 1 / Z_stereo| over the pixels that pass a left-right check.

    The rendered depth is that of the training render, including dropout; the right view is rendered without
    dropout. The loss is 0 if no pixel is valid.

    Logs, prefixed by the component's name: `_valid` (share of pixels in the loss), `_occluded` (share that
    fails the check, if the prior runs), `_seconds` (in the prior, this iteration), `_baseline` (in training),
    and as totals of the run `_inferences`, `_reused` and `_skipped` (calls without a valid pixel).
    """

    needs_priors = ("stereo_disparity",)
    host_defaults = HostDefaults(start=Percent(66.67))

    def __init__(self, settings: StereoDepthSettings, context: Context) -> None:
        from .lazy_refresh import LazyRefresh

        super().__init__(settings, context)
        self._baseline: float | None = None
        self._refresh = LazyRefresh(settings.refresh_threshold)
        self._skipped = 0

    def loss(self, step: Step) -> Tensor:
        """Return the loss for this iteration's view; 0 if no pixel is valid.

        Raises:
            PluginError: the prior is missing, or the baseline is too long.
        """
        prior = StereoPrior.choose(step.priors, self.settings.prior)
        if self._baseline is None:
            self._baseline = choose_baseline(self.settings.baseline, step, prior.max_disparity)
        camera = step.view.camera.shifted_right(self._baseline)
        # Use the photograph's background, even if a sampler replaced it in this iteration.
        behind = step.scene.background
        right = step.render(camera, gradient=False, background=behind).rgb.clamp(0, 1)
        disparity = self._refresh.find(step.view.name, right)
        seconds = 0.0
        if disparity is None:
            begin = time.perf_counter()
            both = prior.both(step.view.image, right)
            seconds = time.perf_counter() - begin
            disparity = self._trusted(step, *both)
            self._refresh.keep(step.view.name, right, disparity)
        loss = self._difference(step, disparity, self._baseline)
        self._log(step, "seconds", seconds)
        self._log(step, "baseline", self._baseline)
        self._log(step, "inferences", self._refresh.asked)
        self._log(step, "reused", self._refresh.reused)
        self._log(step, "skipped", self._skipped)
        return loss

    def _trusted(self, step: Step, left: Disparity, right: Disparity) -> Tensor:
        """Return the left disparity `[H, W]`, 0 where it is invalid."""
        import torch

        from .left_right_check import agreeing

        trusted = left.valid & (left.values >= MIN_DISPARITY)
        if step.view.trained is not None:
            trusted &= step.view.trained
        agree = agreeing(left, right, self.settings.tau)
        self._log(step, "occluded", 1 - float(agree.float().mean()))
        if self.settings.validity_mask:
            trusted &= agree & ~self._background(step.view)
        return torch.where(trusted, left.values, 0.0)

    def _background(self, view: TrainingView) -> Tensor:
        import torch

        if self.settings.background == "intensity":
            return dark_background(view.image, DARK_LEVEL)
        if self.settings.background == "alpha" and view.solid is not None:
            return ~view.solid
        return torch.zeros(view.image.shape[:2], dtype=torch.bool)

    def _difference(self, step: Step, disparity: Tensor, baseline: float) -> Tensor:
        """Return the loss. Pixels are selected before any division, since 0 * inf is NaN."""
        depth, alpha = step.rendering.depth, step.rendering.alpha
        disparity = at_size(disparity, *depth.shape)
        used = (disparity > 0) & (alpha >= MIN_ALPHA)
        used &= depth >= MIN_DEPTH * step.scene.bounds[0]
        count = int(used.sum())
        self._log(step, "valid", count / used.numel())
        if count == 0:
            self._skipped += 1
            return depth.new_zeros(())
        focal_baseline = step.view.camera.fx * baseline
        rendered = depth[used]
        if self.settings.depth == "expected":
            rendered = rendered / alpha[used]
        difference = (1 / rendered - disparity[used] / focal_baseline).abs()
        if self.settings.normalize == "disparity":
            difference = difference * focal_baseline
        elif self.settings.normalize == "zref":
            difference = difference * (focal_baseline / disparity[used].median())
        pixels = {"mean_valid": count, "mean_all": used.numel(), "sum": 1}
        return difference.sum() / pixels[self.settings.reduction]

    def _log(self, step: Step, name: str, value: float) -> None:
        step.log(f"{self.context.name}_{name}", value)

    def state(self) -> dict[str, Tensor]:
        """Return the baseline, if known, and the last disparities."""
        import torch

        state = {f"refresh/{key}": value for key, value in self._refresh.state().items()}
        state["skipped"] = torch.tensor(self._skipped)
        if self._baseline is not None:
            state["baseline"] = torch.tensor(self._baseline, dtype=torch.float64)
        return state

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned."""
        self._skipped = int(state["skipped"])
        self._baseline = float(state["baseline"]) if "baseline" in state else None
        refresh = "refresh/"
        self._refresh.restore(
            {k.removeprefix(refresh): v for k, v in state.items() if k.startswith(refresh)}
        )


@hookimpl
def stereogs_register_regularizers(register: Register[StereoDepth]) -> None:
    register("stereo_depth", StereoDepth)

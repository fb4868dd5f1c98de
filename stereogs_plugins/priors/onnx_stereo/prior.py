"""`onnx_stereo`: disparity from a stereo network in an ONNX file."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field

from registry import Context, PluginError, Register, hookimpl
from registry.priors import StereoPrior
from registry.toolkit.networks import OnnxModel, OnnxModelSettings, Sha256
from registry.toolkit.networks.image_fitting import Padding, ValueRange

from .families import FAMILIES, FamilyName, StereoFamily, guesses

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

    from .networks import StereoNetwork


class OnnxStereoSettings(OnnxModelSettings):
    family: FamilyName = "generic"
    """Network family; gives the values of settings below that are null (docs/prior_models.md)."""
    second_model: Path | None = None
    """Path of the second ONNX file of a family that has two (fast_foundation_stereo)."""
    second_sha256: Sha256 | None = None
    """Required hash of the second file; null accepts any file."""
    left: str | None = None
    """Input for the left image."""
    right: str | None = None
    """Input for the right image."""
    output: str | None = None
    """Output with the disparity."""
    confidences: tuple[str, ...] | None = None
    """Names of outputs in [0, 1] with the reliability of the disparity."""
    min_confidence: float = Field(0.5, ge=0, le=1)
    """Disparities are unknown where one of the confidences is lower."""
    value_range: ValueRange | None = None
    """Range of the graph's pixel values, from black to white."""
    negated: bool | None = None
    """If true, the graph returns minus the disparity."""
    stacked: bool | None = None
    """If true, the graph has one input for both images: channels of the left one, then of the right one."""
    max_disparity: float | None = Field(None, gt=0)
    """Largest disparity of the network, in its own pixels."""
    multiple: int | None = Field(None, ge=1)
    """Both sides of an input must be a multiple of this, if the graph's size is dynamic."""
    size: tuple[int, int] | None = None
    """[width, height] of the graph's input; null: the graph's size, or the image's."""
    resize: bool = False
    """Stretch images to the input's size instead of padding them; disparities are scaled back."""
    padding: Padding = "replicate"
    """Values around an image that is too small."""
    groups: int = Field(8, ge=1)
    """Groups of the correlation volume between two graphs, if dynamic in the second."""
    normalize_groups: bool = True
    """Scale each group of features to unit length before the correlation."""


class OnnxStereo(StereoPrior[OnnxStereoSettings]):
    """Disparity of a stereo network; images are padded or resized to the graph's size.

    Raises:
        PluginError: see `OnnxModel`; or the graph does not have the family's form.
    """

    def __init__(self, settings: OnnxStereoSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._family = _family(settings)
        self._network = _network(settings, self._family)
        self._output = self._network.last.output(self._family.output).name
        for name in self._family.confidences:
            self._network.last.output(name)

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """The family whose names the graph has, otherwise each value range and sign."""
        return [{**OnnxStereoSettings.naming(model), **guess} for guess in guesses(model)]

    @property
    def max_disparity(self) -> float | None:
        """Limit of the family or of the pair of graphs, in the network's pixels.

        The limit in image pixels is larger if images are shrunk for the network, smaller if enlarged.
        """
        return self._network.max_disparity

    def estimate(self, left: Tensor, right: Tensor) -> Tensor:
        """Disparity `[H, W]` of the left image; NaN where unknown."""
        return self._infer(left[None], right[None])[0]

    def estimate_both(self, left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
        """Disparities of both images, in one call if the graph takes two pairs."""
        import torch

        of_left, mirrored = self._infer(
            torch.stack([left, right.flip(1)]), torch.stack([right, left.flip(1)])
        )
        return of_left, mirrored.flip(1)

    def _infer(self, lefts: Tensor, rights: Tensor) -> Tensor:
        """Disparities `[N, H, W]` of pairs `[N, H, W, 3]`."""
        import torch

        from registry.toolkit.networks.image_fitting import in_range, padded, stretched

        settings, network = self.settings, self._network
        height, width = int(lefts.shape[1]), int(lefts.shape[2])
        frozen = network.frozen if settings.size is None else settings.size[::-1]
        choose = stretched if settings.resize else padded
        fit = choose((height, width), frozen, self._family.multiple)
        images = [
            in_range(
                fit.apply(batch.permute(0, 3, 1, 2), padding=settings.padding),
                self._family.value_range,
            )
            for batch in (lefts, rights)
        ]
        at_once = len(lefts) if network.batchable else 1
        answers = [
            self._clean(network(left, right), (len(left), *fit.target))
            for left, right in zip(*(batch.split(at_once) for batch in images), strict=True)
        ]
        return fit.undo(torch.cat(answers)) * fit.width_factor

    def _clean(self, answers: dict[str, Tensor], shape: tuple[int, int, int]) -> Tensor:
        """Positive disparity; NaN where unknown or not confident."""
        import torch

        from registry.toolkit.networks.image_fitting import full_size_maps

        path = self._network.last.path
        disparity = full_size_maps(self._output, answers, shape, path)
        if self._family.negated:
            disparity = -disparity
        known = torch.isfinite(disparity) & (disparity > 0)
        for confidence in self._family.confidences:
            reliable = full_size_maps(confidence, answers, shape, path)
            known &= reliable >= self.settings.min_confidence
        return torch.where(known, disparity, torch.nan)


def _family(settings: OnnxStereoSettings) -> StereoFamily:
    """The family, overridden by the settings that are not null."""
    overrides = {
        field.name: value
        for field in fields(StereoFamily)
        if field.name in OnnxStereoSettings.model_fields
        and (value := getattr(settings, field.name)) is not None
    }
    return replace(FAMILIES[settings.family], **overrides)


def _network(settings: OnnxStereoSettings, family: StereoFamily) -> StereoNetwork:
    from .networks import OneGraph, StackedGraph, TwoGraphs

    pair = settings.family == "fast_foundation_stereo"
    if pair != (settings.second_model is not None):
        raise PluginError(
            f"the family {settings.family!r} has {'two model files' if pair else 'one model file'}",
            where=str(settings.model),
            fix="set `second_model`" if pair else "remove `second_model`",
        )
    model = settings.open(FAMILIES[settings.family].published)
    if settings.second_model is None:
        return StackedGraph(model, family) if family.stacked else OneGraph(model, family)
    second = settings.open_another(settings.second_model, settings.second_sha256)
    return TwoGraphs(
        model, second, family, groups=settings.groups, normalized=settings.normalize_groups
    )


@hookimpl
def stereogs_register_priors(register: Register[OnnxStereo]) -> None:
    register("onnx_stereo", OnnxStereo)

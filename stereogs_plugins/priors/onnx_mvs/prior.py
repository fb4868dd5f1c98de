"""`onnx_mvs`: depth of each view from a multi-view network in an ONNX file."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from registry import Context, PluginError, Register, TrainingView, hookimpl
from registry.priors import DepthMap, MultiViewDepthPrior
from registry.toolkit.networks import OnnxModel, OnnxModelSettings
from registry.toolkit.networks.image_fitting import ValueRange

from .families import FAMILIES, FamilyName

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

    from registry.toolkit.networks.image_fitting import Fit

_log = logging.getLogger("stereogs.onnx_mvs")


class OnnxMvsSettings(OnnxModelSettings):
    family: FamilyName = "mvsanywhere"
    """What the graph's inputs and outputs are (docs/prior_models.md)."""
    value_range: ValueRange | None = None
    """The numbers for black and white that the graph takes; null: the family's."""
    multiple: int | None = Field(None, ge=1)
    """Both sides must be a multiple of this where the graph leaves them open; null: the family's."""
    size: tuple[int, int] | None = None
    """[width, height] given to a graph that leaves both open; null: the images' own, rounded."""
    max_side: int = Field(1024, ge=1)
    """Images whose longer side has more pixels are shrunk, where neither the graph nor `size` says how
    large they are: memory and time grow with the pixels (docs/prior_models.md)."""
    intrinsics: Literal["full", "quarter"] = "full"
    """The grid that the graph's intrinsics belong to: the images', or a quarter of their width."""
    max_sources: int = Field(7, ge=1)
    """At most this many other views, the nearest, help each view; a graph may insist on its number."""
    min_overlap: float = Field(0.2, ge=0, le=1)
    """Only views help that may show at least this share of what a view does, as far as the cameras tell."""
    min_confidence: float = Field(0.0, ge=0, le=1)
    """Where the graph's confidence is below this, the depth counts as unknown (IterMVS: 0.3)."""


class OnnxMvs(MultiViewDepthPrior[OnnxMvsSettings]):
    """A multi-view network's depth, asked once for each view with those near it that show the same.

    Raises:
        PluginError: see `OnnxModel`; or a graph that does not have the family's form.
    """

    def __init__(self, settings: OnnxMvsSettings, context: Context) -> None:
        super().__init__(settings, context)
        family = FAMILIES[settings.family]
        self._family = replace(
            family,
            multiple=settings.multiple or family.multiple,
            value_range=settings.value_range or family.value_range,
        )
        self._model = settings.open()
        images = self._model.input(family.images)
        if len(images.shape) != 5:
            raise PluginError(
                f"the input {images} takes no set of images; expected [1, V, 3, H, W]",
                where=str(self._model.path),
                fix="choose the `family` that the file belongs to",
            )
        self._views, self._frozen = images.shape[1], (images.shape[3], images.shape[4])
        self._model.output(family.depth)
        if settings.min_confidence > 0:
            self._model.output(family.confidence)

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """The family that the graph has the names of, with both grids for intrinsics."""
        inputs, outputs = ([spec.name for spec in specs] for specs in (model.inputs, model.outputs))
        return [
            {**OnnxMvsSettings.naming(model), "family": name, "intrinsics": grid}
            for name, family in FAMILIES.items()
            if {family.images, *family.camera_inputs} <= set(inputs) and family.depth in outputs
            for grid in ("full", "quarter")
        ]

    def fingerprint(self) -> str:
        """The model file's hash and what runs it."""
        return self._model.fingerprint

    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        """One depth map for each view.

        Not valid where the network's depth is not finite or not above 0, or its confidence too low;
        nowhere in a view that no other overlaps.

        Raises:
            PluginError: fewer views than the graph insists on, or an answer of the wrong shape.
        """
        if self._views is not None and len(views) < self._views:
            raise PluginError(
                f"the graph takes {self._views} views at once, there are {len(views)}",
                where=str(self._model.path),
                fix="use more training views, or export the graph with an open number of views",
            )
        return [self.depth_of(view, views, bounds) for view in views]

    def depth_of(
        self, view: TrainingView, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> DepthMap:
        """The depth of one view, with the help of those among `views` that overlap it; see `estimate`."""
        import torch

        from .sources import sorted_by_use

        helping, others = sorted_by_use(view, views, bounds, self.settings.min_overlap)
        if self._views is not None:
            return self._depth([view, *[*helping, *others][: self._views - 1]], bounds)
        if helping:
            return self._depth([view, *helping[: self.settings.max_sources]], bounds)
        _log.warning("no other view shows what %s does: it has no depth", view.name)
        nothing = torch.zeros(view.image.shape[:2])
        return DepthMap(nothing, nothing > 0, nothing)

    def _depth(self, views: Sequence[TrainingView], bounds: tuple[float, float]) -> DepthMap:
        """The depth of the first view."""
        import torch

        from registry.toolkit.networks.image_fitting import in_range

        family = self._family
        fit = self._fit(views[0])
        height, width = fit.target
        images = torch.cat([self._fit(view, fit.target).apply(_batch(view)) for view in views])
        cameras = [view.camera.resized(width, height) for view in views]
        scale = 0.25 if self.settings.intrinsics == "quarter" else 1.0
        answers = self._model.run(
            {
                family.images: in_range(images, family.value_range)[None],
                **family.cameras(self._model, cameras, bounds, scale),
            }
        )
        found = self._map(family.depth, answers, fit)
        known, confidence = found > 0, torch.ones_like(found)
        if family.confidence in answers:
            confidence = self._map(family.confidence, answers, fit)
            known &= confidence >= self.settings.min_confidence
        depth = fit.undo(torch.where(known, found, torch.nan))[0]
        valid = torch.isfinite(depth)
        confidence = torch.where(valid, fit.undo(confidence)[0], 0.0)
        return DepthMap(torch.where(valid, depth, 0.0), valid, confidence)

    def _fit(self, view: TrainingView, target: tuple[int, int] | None = None) -> Fit:
        from registry.toolkit.networks.image_fitting import stretched

        image = (view.camera.height, view.camera.width)
        multiple = self._family.multiple
        wanted = target or (self.settings.size and self.settings.size[::-1]) or self._frozen
        if wanted == (None, None):
            factor = min(1.0, self.settings.max_side / max(image))
            small = (max(1, round(image[0] * factor)), max(1, round(image[1] * factor)))
            wanted = stretched(small, wanted, multiple).target
        return stretched(image, wanted, multiple)

    def _map(self, name: str, answers: Mapping[str, Tensor], fit: Fit) -> Tensor:
        from registry.toolkit.networks.image_fitting import full_size_maps

        return full_size_maps(name, answers, (1, *fit.target), self._model.path)


def _batch(view: TrainingView) -> Tensor:
    return view.image.permute(2, 0, 1)[None]


@hookimpl
def stereogs_register_priors(register: Register[OnnxMvs]) -> None:
    register("onnx_mvs", OnnxMvs)

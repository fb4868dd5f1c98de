"""`onnx_mvs`: depth of each view from a multi-view network in an ONNX file."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

from pydantic import Field

from registry import (
    Context,
    DepthMap,
    MultiViewDepthPrior,
    OnnxModelSettings,
    PluginError,
    Register,
    TrainingView,
    hookimpl,
)
from registry.image_fitting import ValueRange

from .families import FAMILIES, FamilyName

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from torch import Tensor

    from registry.image_fitting import Fit


class OnnxMvsSettings(OnnxModelSettings):
    family: FamilyName = "mvsanywhere"
    """What the graph's inputs and outputs are (docs/prior_models.md)."""
    value_range: ValueRange | None = None
    """The numbers for black and white that the graph takes; null: the family's."""
    multiple: int | None = Field(None, ge=1)
    """Both sides must be a multiple of this where the graph leaves them open; null: the family's."""
    size: tuple[int, int] | None = None
    """[width, height] given to a graph that leaves both open; null: the images' own, rounded."""
    intrinsics: Literal["full", "quarter"] = "full"
    """The grid that the graph's intrinsics belong to: the images', or a quarter of their width."""
    max_sources: int = Field(7, ge=1)
    """At most this many other views, the nearest, help each view; a graph may insist on its number."""


class OnnxMvs(MultiViewDepthPrior[OnnxMvsSettings]):
    """A multi-view network's depth, asked once for each view with its nearest neighbours.

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

    def fingerprint(self) -> str:
        """The model file's hash and what runs it."""
        return self._model.fingerprint

    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        """One depth map for each view; not valid where the network's depth is not finite or <= 0.

        Raises:
            PluginError: fewer views than the graph insists on, or an answer of the wrong shape.
        """
        sources = self.settings.max_sources if self._views is None else self._views - 1
        if self._views is not None and len(views) < self._views:
            raise PluginError(
                f"the graph takes {self._views} views at once, there are {len(views)}",
                where=str(self._model.path),
                fix="use more training views, or export the graph with an open number of views",
            )
        return [
            self._depth([view, *nearest_views(view, views)[:sources]], bounds) for view in views
        ]

    def _depth(self, views: Sequence[TrainingView], bounds: tuple[float, float]) -> DepthMap:
        """The depth of the first view."""
        import torch

        from registry.image_fitting import in_range

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
        depth = fit.undo(torch.where(found > 0, found, torch.nan))[0]
        valid = torch.isfinite(depth)
        confidence = valid.float()
        if family.confidence in answers:
            confidence = fit.undo(self._map(family.confidence, answers, fit))[0]
        return DepthMap(torch.where(valid, depth, 0.0), valid, confidence)

    def _fit(self, view: TrainingView, target: tuple[int, int] | None = None) -> Fit:
        from registry.image_fitting import stretched

        image = (view.camera.height, view.camera.width)
        wanted = target or (self.settings.size and self.settings.size[::-1]) or self._frozen
        return stretched(image, wanted, self._family.multiple)

    def _map(self, name: str, answers: Mapping[str, Tensor], fit: Fit) -> Tensor:
        from registry.image_fitting import full_size_maps

        return full_size_maps(name, answers, (1, *fit.target), self._model.path)


def nearest_views(view: TrainingView, views: Sequence[TrainingView]) -> list[TrainingView]:
    """The other views, those whose cameras stand nearest first."""
    center = view.camera.center
    others = [other for other in views if other is not view]
    return sorted(others, key=lambda other: float((other.camera.center - center).norm()))


def _batch(view: TrainingView) -> Tensor:
    return view.image.permute(2, 0, 1)[None]


@hookimpl
def stereogs_register_priors(register: Register[OnnxMvs]) -> None:
    register("onnx_mvs", OnnxMvs)

"""`onnx_mvs`: depth of each view from a multi-view network in an ONNX file."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from pydantic import Field

from registry import Context, PluginError, Register, TrainingView, hookimpl
from registry.priors import DepthMap, MultiViewDepthPrior
from registry.toolkit.networks import OnnxModel, OnnxModelSettings
from registry.toolkit.networks.image_fitting import ValueRange
from registry.toolkit.progress import tracked
from registry.toolkit.views import sources_by_overlap

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

    from core_rasterizer import Camera
    from registry.toolkit.networks.image_fitting import Fit

_log = logging.getLogger("stereogs.onnx_mvs")

FamilyName = Literal["mvsanywhere", "mvsformer"]
Cameras: TypeAlias = "Sequence[Camera]"
Bounds = tuple[float, float]

_MVSFORMER_STAGES = {"stage1": 1 / 8, "stage2": 1 / 4, "stage3": 1 / 2, "stage4": 1.0}
_MVSFORMER_DEPTHS = 192


@dataclass(frozen=True)
class MvsFamily:
    """One family; view 0 is the reference view.

    Args:
        images: name of the input `[1, V, 3, H, W]`.
        depth: name of the output `[1, 1, H, W]` or `[1, H, W]`, z-depth in the cameras' units.
        confidence: name of an output of the same shape in [0, 1], used if the graph has it.
        camera_inputs: names of inputs that every graph of the family has.
        multiple: H and W must be a multiple of this if the graph's size is dynamic.
        cameras: function that returns the other inputs by name, from the graph, cameras of the images'
            size, (near, far) z-depth, and the factor from the images' intrinsics to the network's.
        published: the network and the address of its weights.
    """

    images: str
    depth: str
    confidence: str
    camera_inputs: tuple[str, ...]
    multiple: int
    cameras: Callable[[OnnxModel, Cameras, Bounds, float], dict[str, Tensor]]
    published: str
    value_range: ValueRange = "imagenet"


def _posed(
    model: OnnxModel, cameras: Cameras, bounds: Bounds, intrinsics_scale: float
) -> dict[str, Tensor]:
    """`K` `[1, V, 3, 3]`, `cam_T_world` `[1, V, 4, 4]` and, if an input, `depth_range` `[1, 2]`."""
    import torch

    inputs = {
        "K": _intrinsics(cameras, intrinsics_scale)[None],
        "cam_T_world": _poses(cameras)[None],
    }
    if any(spec.name == "depth_range" for spec in model.inputs):
        inputs["depth_range"] = torch.tensor([bounds])
    return inputs


def _staged(
    model: OnnxModel, cameras: Cameras, bounds: Bounds, intrinsics_scale: float
) -> dict[str, Tensor]:
    """`stage1` to `stage4` `[1, V, 2, 4, 4]`, pose and intrinsics; `depth_values` `[1, D]`.

    The stages have 1/8, 1/4, 1/2 and the full size of the images.
    """
    import torch

    inputs = {}
    for name, factor in _MVSFORMER_STAGES.items():
        matrices = torch.zeros(len(cameras), 2, 4, 4)
        matrices[:, 0] = _poses(cameras)
        matrices[:, 1, :3, :3] = _intrinsics(cameras, factor * intrinsics_scale)
        inputs[name] = matrices[None]
    count = model.input("depth_values").shape[-1] or _MVSFORMER_DEPTHS
    inputs["depth_values"] = torch.linspace(*bounds, count)[None]
    return inputs


def _intrinsics(cameras: Cameras, factor: float) -> Tensor:
    """`[V, 3, 3]` for images scaled by `factor`."""
    import torch

    matrices = torch.stack([camera.intrinsics for camera in cameras])
    matrices[:, :2] *= factor
    return matrices.float()


def _poses(cameras: Cameras) -> Tensor:
    """World-to-camera matrices, `[V, 4, 4]`."""
    import torch

    return torch.stack([camera.world_to_camera for camera in cameras]).float()


FAMILIES: dict[FamilyName, MvsFamily] = {
    "mvsanywhere": MvsFamily(
        "images",
        "depth",
        "conf",
        ("K", "cam_T_world"),
        32,
        _posed,
        "MVSAnywhere (https://github.com/nianticlabs/mvsanywhere)",
    ),
    "mvsformer": MvsFamily(
        "imgs",
        "refined_depth",
        "photometric_confidence",
        (*_MVSFORMER_STAGES, "depth_values"),
        64,
        _staged,
        "MVSFormer (https://github.com/ewrfcas/MVSFormer)",
    ),
}


class OnnxMvsSettings(OnnxModelSettings):
    family: FamilyName = "mvsanywhere"
    """Network family; defines the graph's inputs and outputs (docs/prior_models.md)."""
    value_range: ValueRange | None = None
    """Range of the graph's pixel values, from black to white; null: the family's."""
    multiple: int | None = Field(None, ge=1)
    """Both sides are rounded to a multiple of this, if the graph's size is dynamic; null: the family's."""
    size: tuple[int, int] | None = None
    """[width, height] of the input of a graph with dynamic size; null: the image's own, rounded."""
    max_side: int = Field(1024, ge=1)
    """Shrink images whose longer side has more pixels, if neither the graph nor `size` gives a size; memory
    and time grow with the pixels (docs/prior_models.md)."""
    intrinsics: Literal["full", "quarter"] = "full"
    """Scale of the graph's intrinsics: for the full image, or for a quarter of its width."""
    max_sources: int = Field(7, ge=1)
    """Largest number of source views per view, nearest first; a graph may have a fixed number."""
    min_overlap: float = Field(0.2, ge=0, le=1)
    """Least share of a view's pixels that a source view may see, computed from the cameras alone."""
    min_confidence: float = Field(0.0, ge=0, le=1)
    """Depths with a lower confidence of the graph are unknown (IterMVS: 0.3)."""


class OnnxMvs(MultiViewDepthPrior[OnnxMvsSettings]):
    """Depth of a multi-view network, run once per view with nearby overlapping views.

    Raises:
        PluginError: see `OnnxModel`; or the graph does not have the family's form.
    """

    def __init__(self, settings: OnnxMvsSettings, context: Context) -> None:
        super().__init__(settings, context)
        family = FAMILIES[settings.family]
        self._family = replace(
            family,
            multiple=settings.multiple or family.multiple,
            value_range=settings.value_range or family.value_range,
        )
        self._model = settings.open(FAMILIES[settings.family].published)
        images = self._model.input(family.images)
        if len(images.shape) != 5:
            raise PluginError(
                f"the input {images} is not a set of images; expected [1, V, 3, H, W]",
                where=str(self._model.path),
                fix="set `family` to the family of the file",
            )
        self._views, self._frozen = images.shape[1], (images.shape[3], images.shape[4])
        self._model.output(family.depth)
        if settings.min_confidence > 0:
            self._model.output(family.confidence)

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """Families whose names the graph has, with both scales of intrinsics."""
        inputs, outputs = ([spec.name for spec in specs] for specs in (model.inputs, model.outputs))
        return [
            {**OnnxMvsSettings.naming(model), "family": name, "intrinsics": grid}
            for name, family in FAMILIES.items()
            if {family.images, *family.camera_inputs} <= set(inputs) and family.depth in outputs
            for grid in ("full", "quarter")
        ]

    def fingerprint(self) -> str:
        """Hash of the model file, and its execution provider."""
        return self._model.fingerprint

    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        """Return one depth map for each view.

        Depths are invalid where they are not finite, not above 0, or of low confidence, and in views
        without overlap.

        Raises:
            PluginError: fewer views than the graph's fixed number, or an output of the wrong shape.
        """
        if self._views is not None and len(views) < self._views:
            raise PluginError(
                f"the graph takes {self._views} views, but there are {len(views)}",
                where=str(self._model.path),
                fix="use more training views, or export the graph with a dynamic number of views",
            )
        return [self.depth_of(view, views, bounds) for view in tracked(views, "depth")]

    def depth_of(
        self, view: TrainingView, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> DepthMap:
        """Depth of one view from those among `views` that overlap it; see `estimate`."""
        import torch

        sources, others = sources_by_overlap(view, views, bounds, self.settings.min_overlap)
        if self._views is not None:
            return self._depth([view, *[*sources, *others][: self._views - 1]], bounds)
        if sources:
            return self._depth([view, *sources[: self.settings.max_sources]], bounds)
        _log.warning("no other view overlaps %s: it has no depth", view.name)
        nothing = torch.zeros(view.image.shape[:2])
        return DepthMap(nothing, nothing > 0, nothing)

    def _depth(self, views: Sequence[TrainingView], bounds: tuple[float, float]) -> DepthMap:
        """Depth of the first view."""
        import torch

        from registry.toolkit.networks.image_fitting import depth_map, in_range

        family = self._family
        fit = self._fit(views[0])
        height, width = fit.target
        batches = [(view, view.image.permute(2, 0, 1)[None]) for view in views]
        images = torch.cat([self._fit(view, fit.target).apply(batch) for view, batch in batches])
        cameras = [view.camera.resized(width, height) for view in views]
        scale = 0.25 if self.settings.intrinsics == "quarter" else 1.0
        answers = self._model.run(
            {
                family.images: in_range(images, family.value_range)[None],
                **family.cameras(self._model, cameras, bounds, scale),
            }
        )
        least = self.settings.min_confidence
        return depth_map(family.depth, family.confidence, answers, fit, self._model.path, least)

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


@hookimpl
def stereogs_register_priors(register: Register[OnnxMvs]) -> None:
    register("onnx_mvs", OnnxMvs)

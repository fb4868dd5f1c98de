"""`torch_module`: depth of each view from a multi-view network in a TorchScript file."""

from __future__ import annotations

import io
import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import Field

from registry import Context, PluginError, Register, Settings, TrainingView, hookimpl
from registry.priors import DepthMap, MultiViewDepthPrior
from registry.toolkit.networks import Sha256, first_line, read_model_file
from registry.toolkit.networks.image_fitting import ValueRange
from registry.toolkit.progress import tracked
from registry.toolkit.views import sources_by_overlap

if TYPE_CHECKING:
    import torch
    from torch import Tensor

    from registry.toolkit.networks.image_fitting import Fit

_log = logging.getLogger("stereogs.torch_module")

ARGUMENTS = (
    *("images", "intrinsics", "K", "extrinsics", "cam_T_world"),
    *("depth_min", "depth_max", "depth_range"),
)
"""Names that the parameters of `forward` may have (docs/prior_models.md)."""
DEPTH, CONFIDENCE = "depth", "confidence"


class TorchModuleSettings(Settings):
    model: Path
    """Path of the TorchScript file. Loading it runs code of the file: use only files that you trust."""
    sha256: Sha256 | None = None
    """Required SHA-256 of the file; null accepts any file."""
    value_range: ValueRange = "0..1"
    """Range of the module's pixel values, from black to white."""
    pixel_centers: Literal["integers", "half_integers"] = "integers"
    """Coordinate of the first pixel's center in the module's intrinsics: 0 or 0.5."""
    multiple: int = Field(32, ge=1)
    """Both sides are rounded to a multiple of this."""
    size: tuple[int, int] | None = None
    """[width, height] of the module's images; null: the image's own, rounded."""
    max_side: int = Field(1024, ge=1)
    """Shrink images whose longer side has more pixels, without `size`."""
    max_sources: int = Field(4, ge=1)
    """Largest number of source views per view, nearest first."""
    min_overlap: float = Field(0.2, ge=0, le=1)
    """Least share of a view's pixels that a source view may see, computed from the cameras alone."""
    min_confidence: float = Field(0.0, ge=0, le=1)
    """Depths with a lower confidence of the module are unknown."""


class TorchModule(MultiViewDepthPrior[TorchModuleSettings]):
    """Depth of a multi-view network, run once per view with nearby overlapping views.

    Raises:
        PluginError: the file is missing, has another hash, is not TorchScript, or has other parameters.
    """

    def __init__(self, settings: TorchModuleSettings, context: Context) -> None:
        super().__init__(settings, context)
        self._path = settings.model.expanduser()
        file = read_model_file(self._path, settings.sha256)
        self._sha256 = file.sha256
        self._module, self._types = _loaded(file.content, self._path)
        unknown = [name for name in self._types if name not in ARGUMENTS]
        if unknown or "images" not in self._types:
            raise PluginError(
                f"the module takes {', '.join(self._types) or 'nothing'}; known are {', '.join(ARGUMENTS)}",
                where=str(self._path),
                fix="save a module whose `forward` takes `images` and any others of these",
            )

    @classmethod
    def settings_for_script(cls, path: Path) -> Sequence[Mapping[str, Any]]:
        """Each range of pixel values, if the module's parameters are known."""
        file = read_model_file(path, None)
        _, types = _loaded(file.content, path)
        if "images" not in types or not set(types) <= set(ARGUMENTS):
            return []
        naming = {"model": str(path), "sha256": file.sha256}
        return [
            {**naming, "value_range": values} for values in ("0..1", "imagenet", "-1..1", "0..255")
        ]

    def fingerprint(self) -> str:
        """Hash of the file, and version of torch."""
        import torch

        return f"{self._sha256} torch {torch.__version__}"

    def estimate(
        self, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> list[DepthMap]:
        """Return one depth map for each view.

        Depths are invalid where they are not finite, not above 0, or of low confidence, and in views
        without overlap.

        Raises:
            PluginError: the module fails, or its answer is not a depth map.
        """
        return [self._depth_of(view, views, bounds) for view in tracked(views, "depth")]

    def _depth_of(
        self, view: TrainingView, views: Sequence[TrainingView], bounds: tuple[float, float]
    ) -> DepthMap:
        import torch

        sources, _ = sources_by_overlap(view, views, bounds, self.settings.min_overlap)
        if sources:
            return self._depth([view, *sources[: self.settings.max_sources]], bounds)
        _log.warning("no other view overlaps %s: it has no depth", view.name)
        nothing = torch.zeros(view.image.shape[:2])
        return DepthMap(nothing, nothing > 0, nothing)

    def _depth(self, views: Sequence[TrainingView], bounds: tuple[float, float]) -> DepthMap:
        """Depth of the first view."""
        from registry.toolkit.networks.image_fitting import depth_map

        fit = self._fit(views[0])
        inputs = self._inputs(views, fit.target, bounds)
        answers = self._answers([inputs[name] for name in self._types])
        least = self.settings.min_confidence
        return depth_map(DEPTH, CONFIDENCE, answers, fit, self._path, least)

    def _inputs(
        self, views: Sequence[TrainingView], target: tuple[int, int], bounds: tuple[float, float]
    ) -> dict[str, Any]:
        """All arguments by name; images as a list if the module takes one, else `[1, V, 3, H, W]`."""
        import torch

        from registry.toolkit.networks.image_fitting import in_range

        planes = [
            self._fit(view, target).apply(view.image.permute(2, 0, 1)[None]) for view in views
        ]
        images = [in_range(plane, self.settings.value_range) for plane in planes]
        cameras = [view.camera.resized(target[1], target[0]) for view in views]
        intrinsics = torch.stack([camera.intrinsics for camera in cameras]).float()
        if self.settings.pixel_centers == "integers":
            intrinsics[:, :2, 2] -= 0.5
        poses = torch.stack([camera.world_to_camera for camera in cameras]).float()
        near, far = (torch.tensor([bound], dtype=torch.float32) for bound in bounds)
        return {
            "images": images if "List" in self._types["images"] else torch.stack(images, dim=1),
            **dict.fromkeys(("intrinsics", "K"), intrinsics[None]),
            **dict.fromkeys(("extrinsics", "cam_T_world"), poses[None]),
            "depth_min": near,
            "depth_max": far,
            "depth_range": torch.stack([near, far], dim=1),
        }

    def _answers(self, arguments: list[Any]) -> dict[str, Tensor]:
        """Call the module; its random numbers are the same in every call."""
        import torch

        try:
            with torch.no_grad(), torch.random.fork_rng(devices=[]):
                torch.manual_seed(0)
                answer: Any = self._module(*arguments)
        except (RuntimeError, torch.jit.Error) as error:
            reason = str(error).strip().rpartition("\n")[2]  # after the script's own traceback
            raise PluginError(
                f"the module failed: {reason}",
                where=str(self._path),
                fix="check that it takes these images: set `multiple` or `size`",
            ) from error
        if isinstance(answer, torch.Tensor):
            answer = [answer]
        if not isinstance(answer, dict):
            answer = dict(zip((DEPTH, CONFIDENCE), answer, strict=False))
        found = {name: answer[name] for name in (DEPTH, CONFIDENCE) if name in answer}
        if DEPTH not in found or not all(isinstance(x, torch.Tensor) for x in found.values()):
            raise PluginError(
                "the module's answer has no depth",
                where=str(self._path),
                fix="return the depth, (depth, confidence, ...), or a dictionary with these names",
            )
        return {name: tensor.float() for name, tensor in found.items()}

    def _fit(self, view: TrainingView, target: tuple[int, int] | None = None) -> Fit:
        from registry.toolkit.networks.image_fitting import stretched

        settings, image = self.settings, (view.camera.height, view.camera.width)
        wanted = target or (settings.size and settings.size[::-1])
        if wanted is None:
            factor = min(1.0, settings.max_side / max(image))
            small = (max(1, round(image[0] * factor)), max(1, round(image[1] * factor)))
            wanted = stretched(small, (None, None), settings.multiple).target
        return stretched(image, wanted, settings.multiple)


def _loaded(content: bytes, path: Path) -> tuple[torch.jit.ScriptModule, dict[str, str]]:
    """Load a module; also return the types of the parameters of `forward`, by name."""
    import torch

    try:
        module = torch.jit.load(io.BytesIO(content), map_location="cpu").eval()
        parameters = module.forward.schema.arguments[1:]  # without the module itself
    except (RuntimeError, ValueError) as error:
        raise PluginError(
            f"the file is not a TorchScript module: {first_line(error)}",
            where=str(path),
            fix="write it with torch.jit.save",
        ) from error
    return module, {parameter.name: str(parameter.type) for parameter in parameters}


@hookimpl
def stereogs_register_priors(register: Register[TorchModule]) -> None:
    register("torch_module", TorchModule)

"""`onnx_posed`: cameras and depth of photographs from Depth Anything 3 or VGGT in an ONNX file.

VGGT (Wang et al., CVPR 2025) encodes a camera as nine numbers: translation and quaternion (x, y, z, w) from
the world to the camera, and the vertical and horizontal field of view. Depth Anything 3 (2025) returns
matrices. Both return a confidence of 1 + exp(x) for a logit x, so that the probability is 1 - 1 / confidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from pydantic import Field

from registry import Context, PluginError, Register, hookimpl
from registry.priors import PosedDepth, PosedDepthPrior
from registry.toolkit.networks import OnnxModel, OnnxModelSettings
from registry.toolkit.networks.image_fitting import Fit, Padding, ValueRange

if TYPE_CHECKING:
    from torch import Tensor

Outputs: TypeAlias = "Mapping[str, Tensor]"
Shape = tuple[int, int]
PATCH = 14
"""Sides of images are a multiple of this, in pixels."""


@dataclass(frozen=True)
class Family:
    """Names and conventions of one network; of several names, exports use one.

    Args:
        images: input `[1, V, 3, H, W]` or `[V, 3, H, W]`.
        depth: output with z-depth, `[V, H, W]` with any axes of size 1.
        confidence: output of the same shape, 1 or larger; used if the graph has it.
        cameras: outputs that `read` takes.
        read: returns `[V, 3, 4]` world to camera and `[V, 3, 3]` intrinsics in pixels of the input, from the
            outputs without the axis of the batch, and (H, W).
        value_ranges: ranges of pixel values that exports expect, the usual one first.
        long_side: longer side of images in pixels, if the graph's size is dynamic.
        padding: what surrounds images of other proportions.
        published: the network and the address of its weights.
    """

    images: tuple[str, ...]
    depth: tuple[str, ...]
    confidence: tuple[str, ...]
    cameras: tuple[str, ...]
    read: Callable[[Outputs, Shape], tuple[Tensor, Tensor]]
    value_ranges: tuple[ValueRange, ...]
    long_side: int
    padding: Padding
    published: str


def _matrices(outputs: Outputs, size: Shape) -> tuple[Tensor, Tensor]:
    return outputs["extrinsics"][:, :3], outputs["intrinsics"]


def _encoded(outputs: Outputs, size: Shape) -> tuple[Tensor, Tensor]:
    """Decode `pose_enc` `[V, 9]`; the principal point is in the middle."""
    import torch
    from scipy.spatial.transform import Rotation

    codes = outputs["pose_enc"].double()
    turns = torch.from_numpy(Rotation.from_quat(codes[:, 3:7].numpy()).as_matrix())
    poses = torch.cat([turns, codes[:, :3, None]], dim=2)
    height, width = size
    lenses = torch.eye(3, dtype=torch.float64).repeat(len(codes), 1, 1)
    lenses[:, 0, 0] = width / 2 / torch.tan(codes[:, 8] / 2)
    lenses[:, 1, 1] = height / 2 / torch.tan(codes[:, 7] / 2)
    lenses[:, 0, 2], lenses[:, 1, 2] = width / 2, height / 2
    return poses, lenses


FAMILIES = {
    "depth_anything_3": Family(
        images=("images", "image", "pixel_values"),
        depth=("depth", "predicted_depth"),
        confidence=("depth_conf", "confidence", "conf"),
        cameras=("extrinsics", "intrinsics"),
        read=_matrices,
        value_ranges=("imagenet", "0..1"),
        long_side=504,
        padding="replicate",
        published="Depth Anything 3 (https://github.com/ByteDance-Seed/Depth-Anything-3)",
    ),
    "vggt": Family(
        images=("input_images", "images"),
        depth=("depth",),
        confidence=("depth_conf",),
        cameras=("pose_enc",),
        read=_encoded,
        value_ranges=("0..1",),
        long_side=518,
        padding="white",
        published="VGGT (https://github.com/akretz/vggt-onnx)",
    ),
}


class OnnxPosedSettings(OnnxModelSettings):
    value_range: ValueRange | None = None
    """Range of the graph's pixel values; null: that of the network, which the graph's names tell."""
    long_side: int | None = Field(None, ge=PATCH)
    """Longer side of images in pixels, if the graph's size is dynamic; null: that of the network."""


class OnnxPosed(PosedDepthPrior[OnnxPosedSettings]):
    """Cameras, depth and confidence of photographs, up to one unknown scale of all.

    Raises:
        PluginError: see `OnnxModel`; or the graph has other inputs or outputs, or takes one image only.
    """

    def __init__(self, settings: OnnxPosedSettings, context: Context) -> None:
        super().__init__(settings, context)
        published = " or ".join(family.published for family in FAMILIES.values())
        self._model = settings.open(published)
        family = _family_of(self._model)
        if family is None:
            raise PluginError(
                f"the graph is neither that of {published.replace(' or ', ' nor of ')}",
                where=str(self._model.path),
                fix="docs/prior_models.md lists inputs and outputs; a graph for one image is for `onnx_mono`",
            )
        self._family = family
        views = _view_count(self._model)
        if views is not None:
            self.accepted_views = (views, views)

    @classmethod
    def settings_for(cls, model: OnnxModel) -> Sequence[Mapping[str, Any]]:
        """One candidate for each value range of exports, if the graph has the names of a network."""
        family = _family_of(model)
        usual = OnnxPosedSettings.naming(model)
        if family is None:
            return []
        return [usual, *({**usual, "value_range": other} for other in family.value_ranges[1:])]

    def fingerprint(self) -> str:
        """Hash of the model file, and its execution provider."""
        return self._model.fingerprint

    def estimate(
        self, images: Sequence[Tensor], intrinsics: Sequence[Tensor | None]
    ) -> list[PosedDepth]:
        """Return camera and depth of each photograph; known intrinsics are not used.

        Raises:
            PluginError: an output has another shape.
        """
        import torch

        from registry.toolkit.networks.image_fitting import full_size_maps

        fits = self._fits([(int(image.shape[0]), int(image.shape[1])) for image in images])
        outputs = self._run(images, fits)
        family, target = self._family, fits[0].target
        poses, lenses = family.read(outputs, target)
        shape = (len(images), *target)
        depth = full_size_maps(_one(family.depth, outputs), outputs, shape, self._model.path)
        depth = torch.where(depth > 0, depth, torch.nan)
        certain = torch.ones_like(depth)
        if any(name in outputs for name in family.confidence):
            name = _one(family.confidence, outputs)
            certain = 1 - 1 / full_size_maps(name, outputs, shape, self._model.path).clamp(min=1)
        return [
            PosedDepth(
                poses[k],
                fit.undo_intrinsics(lenses[k]),
                *fit.undo(torch.stack([depth[k], certain[k]])),
            )
            for k, fit in enumerate(fits)
        ]

    def _run(self, images: Sequence[Tensor], fits: Sequence[Fit]) -> dict[str, Tensor]:
        """All outputs, without the axis of the batch."""
        import torch

        from registry.toolkit.networks.image_fitting import in_range

        family = self._family
        spec = self._model.input()
        planes = [
            fit.apply(image.permute(2, 0, 1)[None], padding=family.padding)
            for image, fit in zip(images, fits, strict=True)
        ]
        batch = in_range(torch.cat(planes), self.settings.value_range or family.value_ranges[0])
        outputs = self._model.run({spec.name: batch[None] if len(spec.shape) == 5 else batch})
        expected = (family.depth, family.confidence, *((name,) for name in family.cameras))
        found = {name: outputs[name] for names in expected for name in names if name in outputs}
        for name, answer in found.items():
            if answer.ndim > 2 and len(answer) == 1:
                answer = answer[0]
            if len(answer) != len(images):
                raise PluginError(
                    f"the output {name!r} has the shape {list(outputs[name].shape)} for {len(images)} images",
                    where=str(self._model.path),
                    fix="export the graph with an open number of views, or give it as many as then",
                )
            found[name] = answer
        return found

    def _fits(self, sizes: Sequence[Shape]) -> list[Fit]:
        """Images as large as fit into the graph's size, or into one with its longer side."""
        from registry.toolkit.networks.image_fitting import contained

        longest = self.settings.long_side or self._family.long_side
        open_size = (
            max(math.ceil(size[axis] * longest / max(size) / PATCH) * PATCH for size in sizes)
            for axis in (0, 1)
        )
        frozen = self._model.input().shape[-2:]
        height, width = (side or wanted for side, wanted in zip(frozen, open_size, strict=True))
        return [contained(size, (height, width)) for size in sizes]


def _family_of(model: OnnxModel) -> Family | None:
    """The network whose names a graph of several images has, or None."""
    (image, *others), outputs = model.inputs, {spec.name for spec in model.outputs}
    if others or len(image.shape) not in (4, 5) or _view_count(model) == 1:
        return None
    fitting = (
        family
        for family in FAMILIES.values()
        if image.name in family.images
        and outputs.issuperset(family.cameras)
        and outputs.intersection(family.depth)
    )
    return next(fitting, None)


def _view_count(model: OnnxModel) -> int | None:
    return model.inputs[0].shape[-4]


def _one(names: Sequence[str], outputs: Outputs) -> str:
    return next(name for name in names if name in outputs)


@hookimpl
def stereogs_register_priors(register: Register[OnnxPosed]) -> None:
    register("onnx_posed", OnnxPosed)

"""Multi-view depth networks: names of each family's inputs and outputs, and format of its cameras."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera
    from registry import OnnxModel
    from registry.image_fitting import ValueRange

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
    """

    images: str
    depth: str
    confidence: str
    camera_inputs: tuple[str, ...]
    multiple: int
    cameras: Callable[[OnnxModel, Cameras, Bounds, float], dict[str, Tensor]]
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
    "mvsanywhere": MvsFamily("images", "depth", "conf", ("K", "cam_T_world"), 32, _posed),
    "mvsformer": MvsFamily(
        "imgs",
        "refined_depth",
        "photometric_confidence",
        (*_MVSFORMER_STAGES, "depth_values"),
        64,
        _staged,
    ),
}

"""Multi-view depth networks: what each family's ONNX file is called inside, and its cameras' form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera
    from registry.toolkit.networks import OnnxModel
    from registry.toolkit.networks.image_fitting import ValueRange

FamilyName = Literal["mvsanywhere", "mvsformer"]
Cameras: TypeAlias = "Sequence[Camera]"
Bounds = tuple[float, float]

_MVSFORMER_STAGES = {"stage1": 1 / 8, "stage2": 1 / 4, "stage3": 1 / 2, "stage4": 1.0}
_MVSFORMER_DEPTHS = 192


@dataclass(frozen=True)
class MvsFamily:
    """One family; view 0 is the one whose depth is asked.

    Args:
        images: name of the input `[1, V, 3, H, W]`.
        depth: name of the output `[1, 1, H, W]` or `[1, H, W]`, z-depth in the cameras' units.
        confidence: name of an output like it in [0, 1], used if the graph has it.
        camera_inputs: names of inputs that every graph of the family has.
        multiple: H and W must be a multiple of this where the graph leaves them open.
        cameras: the other inputs by name: of a graph, for cameras of the size of the images, near and
            far z-depth and the factor from the images' intrinsics to the network's.
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
    """`K` `[1, V, 3, 3]`, `cam_T_world` `[1, V, 4, 4]` and, if wanted, `depth_range` `[1, 2]`."""
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

    The stages work at 1/8, 1/4, 1/2 and the full size of the images.
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
    """`[V, 3, 3]` on a grid whose sides are `factor` times the images'."""
    import torch

    matrices = torch.stack([camera.intrinsics for camera in cameras])
    matrices[:, :2] *= factor
    return matrices.float()


def _poses(cameras: Cameras) -> Tensor:
    """World to camera, `[V, 4, 4]`."""
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

"""A differentiable rasterizer of 3D Gaussians in OpenCL, for any CPU or GPU.

`rasterize` renders torch tensors. `GaussianModel` stores Gaussians on the device for training with
`photometric_loss`, `Adam` and `apply_edit`.
"""

from typing import TYPE_CHECKING

from .first_use import names_on_first_use

if TYPE_CHECKING:
    from .camera import Camera
    from .device import Device, list_devices, open_device
    from .errors import (
        CameraError,
        DeviceError,
        ExplainedError,
        GaussianError,
        MemoryBudgetError,
        PlyError,
    )
    from .functional import rasterize
    from .gaussians import Gaussians
    from .optimization import (
        Adam,
        Carried,
        Edit,
        Engine,
        GaussianModel,
        Model,
        OpenCLEngine,
        Relocation,
        apply_edit,
        photometric_loss,
    )
    from .optimization import ModelReader as GaussianReader
    from .ply import load_ply, load_points, save_ply
    from .rendering import Rendering
else:
    __getattr__, __dir__ = names_on_first_use(__name__)

__all__ = [
    "Adam",
    "Camera",
    "CameraError",
    "Carried",
    "Device",
    "DeviceError",
    "Edit",
    "Engine",
    "ExplainedError",
    "GaussianError",
    "GaussianModel",
    "GaussianReader",
    "Gaussians",
    "MemoryBudgetError",
    "Model",
    "OpenCLEngine",
    "PlyError",
    "Relocation",
    "Rendering",
    "apply_edit",
    "list_devices",
    "load_ply",
    "load_points",
    "open_device",
    "photometric_loss",
    "rasterize",
    "save_ply",
]

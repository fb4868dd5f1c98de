"""A differentiable rasterizer of 3D Gaussians in OpenCL, for any CPU or GPU.

`rasterize` renders plain torch tensors. `GaussianModel` keeps the Gaussians on the device for
training, with `photometric_loss`, `Adam` and `apply_edit` beside it.
"""

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
from .gaussians import Gaussians
from .optimization import (
    Adam,
    Carried,
    Edit,
    GaussianModel,
    Relocation,
    apply_edit,
    photometric_loss,
    shared_among_copies,
)
from .optimization import ModelReader as GaussianReader
from .ply import load_ply, load_points, save_ply
from .rasterize import rasterize
from .rendering import Rendering

__all__ = [
    "Adam",
    "Camera",
    "CameraError",
    "Carried",
    "Device",
    "DeviceError",
    "Edit",
    "ExplainedError",
    "GaussianError",
    "GaussianModel",
    "GaussianReader",
    "Gaussians",
    "MemoryBudgetError",
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
    "shared_among_copies",
]

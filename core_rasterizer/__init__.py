"""A differentiable rasterizer of 3D Gaussians in OpenCL, for any CPU or GPU.

`rasterize` renders torch tensors. `GaussianModel` stores Gaussians on the device for training with
`photometric_loss`, `Adam` and `apply_edit`.
"""

from typing import TYPE_CHECKING

from .first_use import names_on_first_use

if TYPE_CHECKING:
    from .camera import Camera as Camera
    from .custom import PixelTerm as PixelTerm
    from .device import Device as Device, list_devices as list_devices, open_device as open_device
    from .errors import (
        CameraError as CameraError,
        DeviceError as DeviceError,
        ExplainedError as ExplainedError,
        GaussianError as GaussianError,
        MemoryBudgetError as MemoryBudgetError,
        PlyError as PlyError,
    )
    from .functional import rasterize as rasterize
    from .gaussians import SH_C0 as SH_C0, Gaussians as Gaussians
    from .optimization import (
        Adam as Adam,
        Carried as Carried,
        Edit as Edit,
        Engine as Engine,
        GaussianModel as GaussianModel,
        GaussianReader as GaussianReader,
        Model as Model,
        OpenCLEngine as OpenCLEngine,
        Relocation as Relocation,
        apply_edit as apply_edit,
        photometric_loss as photometric_loss,
    )
    from .ply import (
        holds_gaussians as holds_gaussians,
        load_ply as load_ply,
        load_points as load_points,
        save_ply as save_ply,
    )
    from .rendering import Rendering as Rendering
else:
    __all__, __dir__, __getattr__ = names_on_first_use(__name__)

"""The OpenCL engine: Gaussians that are trained on a device, and a read-only view of them."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ..camera import Camera
from ..device import Device, open_device
from ..errors import GaussianError
from ..gaussians import Gaussians
from ..layout import PARAMETER_GROUPS, PARAMETERS, padded
from ..raster import DILATION, NEAR_PLANE, Footprint, Renderer, RenderRequest, pack
from ..rendering import Rendering
from .adam import Adam
from .autograd import ACTIVATED, ParameterFunction, RenderFunction
from .edit import Carried, Edit
from .engine import Model
from .photometric import photometric_loss
from .storage import GaussianStorage
from .topology import apply_edit


class GaussianModel(GaussianStorage):
    """N Gaussians on a device that render differentiable images.

    Args:
        gaussians: initial parameters; must be finite.
        device: where they are stored; None chooses (`open_device`).
        dtype: torch.float32, or torch.float64 for tests.
        dilation: added to the variances of every ellipse on the image, square pixels, >= 0.
        compensate_dilation: If True, lower the opacity as dilation widens the ellipse, like the 2D filter
            of Mip-Splatting (Yu et al. 2024, eq. 10). Both settings hold for every render of the model,
            so that Gaussians are viewed as they were trained.

    Attributes:
        anchor: a scalar leaf that every render and parameter in autograd is computed from.

    Raises:
        GaussianError: a parameter or the dilation is not finite, or the dilation is negative.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        device: Device | None = None,
        *,
        dtype: torch.dtype = torch.float32,
        dilation: float = DILATION,
        compensate_dilation: bool = False,
    ) -> None:
        gaussians.check_finite()
        count, device = len(gaussians), device or open_device()
        self.footprint = Footprint(dilation, compensate_dilation)
        self.renderer = Renderer(device, dtype, footprint=self.footprint)
        self.anchor = torch.zeros((), requires_grad=True)
        rows = pack(gaussians, dtype, padded(count))
        super().__init__(device, dtype, gaussians.sh_degree, rows, count)

    @property
    def engine(self) -> OpenCLEngine:
        """The engine that this model belongs to."""
        return OpenCLEngine(self.device)

    @property
    def backward_passes(self) -> int:
        """Number of backward passes that have written gradients."""
        return self.gradients.passes

    def gradient_of_renders(self, group: str) -> Tensor:
        """The gradient of a group of `PARAMETER_GROUPS` from renders only, `[rows, N]`."""
        return self.gradients.of_renders(*PARAMETER_GROUPS[group])[:, : self.count]

    def opacities(self) -> Tensor:
        """Activated opacities `[N]` in (0, 1)."""
        return ACTIVATED["opacities"].activate(self.read("opacity_logits"))

    def scales(self) -> Tensor:
        """Activated scales `[N, 3]`: standard deviations, world units."""
        return ACTIVATED["scales"].activate(self.read("log_scales"))

    def parameter(self, name: str) -> Tensor:
        """One parameter in autograd, for losses on parameters.

        `loss.backward()` adds to `gradient` and so to the optimizer's next step. It raises a
        GaussianError if a gradient is not finite, or if Gaussians were added or removed in between.

        Args:
            name: as in `read`; or "opacities" `[N]` or "scales" `[N, 3]`, activated.

        Returns:
            A new tensor in the shape that `read` returns.

        Raises:
            GaussianError: unknown name.
        """
        values: Tensor = ParameterFunction.apply(self.anchor, self, name)
        return values

    def gaussians(self) -> Gaussians:
        """A copy on the host."""
        return Gaussians(**{name: self.read(name).clone().contiguous() for name in PARAMETERS})

    def digest(self) -> str:
        """SHA-256 of all parameters, hexadecimal; equal digests mean equal bits."""
        digest = hashlib.sha256()
        for name in PARAMETERS:
            digest.update(self.read(name).contiguous().numpy().tobytes())
        return digest.hexdigest()

    def reader(self, attributes: Mapping[str, Tensor] | None = None) -> GaussianReader:
        """A read-only view of this model.

        Args:
            attributes: further numbers of each Gaussian, `[N]` by name, for files that can hold them.
        """
        return GaussianReader(self, attributes)

    def render(
        self,
        camera: Camera,
        *,
        background: Sequence[float] = (0.0, 0.0, 0.0),
        sh_degree: float | None = None,
        opacity_scale: Tensor | None = None,
        smoothing: Tensor | None = None,
        collect_statistics: bool = False,
        collect_absolute: bool = False,
        near: float = NEAR_PLANE,
        detach: Collection[str] = (),
    ) -> Rendering:
        """Render one camera.

        The images take part in autograd: `loss.backward()` adds to the gradients on the device, and to
        that of `camera.world_to_camera` if it requires one (see `rasterize`). Under `torch.no_grad()`
        nothing is kept for a backward pass.

        Args:
            camera: the view.
            background: three numbers, the colour behind the scene.
            sh_degree: bands to use, 0 to the stored degree; a fraction weights the last band: 1.5 is
                bands 0 and 1 and half of band 2. None uses all.
            opacity_scale: `[N]` factors >= 0 of the activated opacities, without gradient.
            smoothing: `[N]` standard deviations >= 0, world units, of the 3D filter of Mip-Splatting (Yu
                et al. 2024, eq. 9), without gradient: scales become sqrt(s^2 + f^2), and the opacity is
                multiplied by s / sqrt(s^2 + f^2) for each axis.
            collect_statistics: If True, the backward pass adds to `statistics`.
            collect_absolute: If True, statistics include absolute gradients.
            near: z-depth below which Gaussians are culled, world units, > 0.
            detach: names of parameters, as in `read`, whose gradient this render leaves unchanged.
                Statistics are still collected.

        Raises:
            GaussianError: invalid opacity factors, smoothing, background, degree or parameter name.
            CameraError: the image is too large to address, or `near` is not positive.
            MemoryBudgetError: the image or the lists of Gaussians per tile exceed the budget.
        """
        degree = self.sh_degree if sh_degree is None else min(sh_degree, self.sh_degree)
        if opacity_scale is not None and tuple(opacity_scale.shape) != (self.count,):
            raise GaussianError(
                f"the shape is {tuple(opacity_scale.shape)}, expected ({self.count},)",
                field="opacity_scale",
            )
        for name in detach:
            self.rows_of(name)
        request = RenderRequest(camera, tuple(background), degree, near, opacity_scale, smoothing)
        return Rendering.on_device(
            *RenderFunction.apply(
                self.anchor,
                camera.world_to_camera,
                self,
                self.renderer,
                request,
                (collect_statistics, collect_statistics and collect_absolute),
                frozenset(detach),
            )
        )


@dataclass(frozen=True)
class OpenCLEngine:
    """Implements `Engine` on one OpenCL device."""

    device: Device

    @property
    def name(self) -> str:
        """Name in provenance.json."""
        return "opencl"

    @property
    def absolute_gradients(self) -> bool:
        """See `Engine`."""
        return True

    def model(
        self,
        gaussians: Gaussians,
        *,
        dilation: float = DILATION,
        compensate_dilation: bool = False,
    ) -> GaussianModel:
        """Store Gaussians on the device; see `GaussianModel`."""
        return GaussianModel(
            gaussians, self.device, dilation=dilation, compensate_dilation=compensate_dilation
        )

    def optimizer(self, model: GaussianModel) -> Adam:
        """Adam for a model."""
        return Adam(model)

    def loss(
        self,
        image: Tensor | Rendering,
        target: Tensor,
        ssim_weight: float,
        l1_weight: float | None = None,
    ) -> Tensor:
        """See `photometric_loss`."""
        return photometric_loss(image, target, ssim_weight, l1_weight=l1_weight, device=self.device)

    def edit(
        self, model: GaussianModel, optimizer: Adam, edit: Edit, generator: torch.Generator
    ) -> Carried:
        """See `apply_edit`."""
        return apply_edit(model, optimizer, edit, generator)


class GaussianReader:
    """A read-only view of a model of any engine.

    It follows the model: each call returns the current state. Returned tensors are copies.

    Attributes:
        attributes: further numbers of each Gaussian, `[N]` by name; usually empty.
    """

    def __init__(self, model: Model, attributes: Mapping[str, Tensor] | None = None) -> None:
        self._model = model
        self.attributes = dict(attributes or {})

    @property
    def count(self) -> int:
        """Number of Gaussians, N."""
        return self._model.count

    @property
    def device(self) -> Device:
        """OpenCL device of the engine."""
        return self._model.engine.device

    @property
    def sh_degree(self) -> int:
        """Degree of the stored spherical harmonics, 0 to 3."""
        return self._model.sh_degree

    @property
    def dilation(self) -> float:
        """Added to the variances of every ellipse on the image, square pixels."""
        return self._model.footprint.dilation

    @property
    def compensate_dilation(self) -> bool:
        """Whether the opacity falls as dilation widens the ellipse; see `GaussianModel`."""
        return self._model.footprint.compensated

    def read(self, name: str) -> Tensor:
        """One parameter.

        Args:
            name: "means" `[N, 3]`, "log_scales" `[N, 3]`, "quaternions" `[N, 4]`, "opacity_logits"
                `[N]` or "sh" `[N, K, 3]`.

        Raises:
            GaussianError: unknown name.
        """
        return self._model.read(name).clone()

    def gradient(self, name: str) -> Tensor:
        """The gradient of one parameter, in the shape of `read`, until the optimizer's step in a run.

        Raises:
            GaussianError: unknown name, or the step has used the gradients.
        """
        return self._model.gradient(name).clone()

    def parameter(self, name: str) -> Tensor:
        """One parameter in autograd, for losses on parameters; see `GaussianModel.parameter`."""
        return self._model.parameter(name)

    def opacities(self) -> Tensor:
        """Activated opacities `[N]` in (0, 1)."""
        return self._model.opacities()

    def scales(self) -> Tensor:
        """Activated scales `[N, 3]`: standard deviations, world units."""
        return self._model.scales()

    def screen_gradient(self) -> Tensor:
        """Mean NDC norm of the screen-space gradient `[N]`; see `ScreenStatistics.screen_gradient`."""
        return self._model.statistics.screen_gradient()

    def absolute_screen_gradient(self) -> Tensor:
        """The same without cancellation between pixels, `[N]` (AbsGS).

        Raises:
            GaussianError: no render has collected it; see `ScreenStatistics`.
        """
        return self._model.statistics.absolute_screen_gradient()

    def touched(self) -> Tensor:
        """Which Gaussians contributed to a pixel, bool `[N]`; see `GaussianModel.touched`."""
        return self._model.touched()

    def render(self, camera: Camera, *, background: Sequence[float] = (0.0, 0.0, 0.0)) -> Rendering:
        """Render a camera as for evaluation: without gradients, colours clamped to [0, 1].

        Args:
            background: three numbers in [0, 1], the colour behind the Gaussians.
        """
        with torch.no_grad():
            rendering = self._model.render(camera, background=background)

        def image(name: str) -> Tensor:
            return rendering.rgb.clamp(0, 1) if name == "rgb" else getattr(rendering, name)

        return Rendering.lazy(image)

    def gaussians(self) -> Gaussians:
        """A copy of all Gaussians on the host."""
        return self._model.gaussians()

    def digest(self) -> str:
        """SHA-256 of all parameters, hexadecimal; equal digests mean equal bits."""
        return self._model.digest()

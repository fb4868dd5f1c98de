"""Gaussians that live on an OpenCL device; images cross to torch and take part in autograd."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence

import torch
from torch import Tensor

from ..camera import Camera
from ..device import Device, DeviceArray, open_device
from ..errors import GaussianError
from ..finite import undefined_places
from ..gaussians import Gaussians
from ..layout import PARAMETER_GROUPS, PARAMETERS, padded, row_count, rows_of
from ..raster import (
    DILATION,
    NEAR_PLANE,
    Block,
    Footprint,
    Frame,
    Renderer,
    RenderRequest,
    pack,
    unpack,
)
from ..rendering import Rendering
from .gradients import Gradients
from .model_reader import ModelReader
from .parameter import ACTIVATED, stored_name, values_in_autograd
from .render_function import RenderFunction
from .screen_statistics import ScreenStatistics


class GaussianModel:
    """N Gaussians on a device: parameters, gradients, and what densification counts.

    Args:
        gaussians: the starting parameters; must be finite.
        device: where they live; None chooses (`open_device`).
        dtype: torch.float32, or torch.float64 for tests.
        dilation: added to the variances of every ellipse on the image, square pixels, >= 0.
        compensate_dilation: let the opacity fall as dilation widens the ellipse, as the 2D filter of
            Mip-Splatting does (Yu et al. 2024, eq. 10). Both hold for every render, so that Gaussians are
            looked at as they were trained.

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
        self.device = device or open_device()
        self.dtype = dtype
        self.sh_degree = gaussians.sh_degree
        footprint = Footprint(dilation, compensate_dilation)
        self.renderer = Renderer(self.device, dtype, footprint=footprint)
        self._anchor = torch.zeros((), requires_grad=True)
        self.adopt(pack(gaussians, dtype, padded(len(gaussians))), len(gaussians))

    @property
    def rows(self) -> int:
        """Scalar parameters of one Gaussian."""
        return row_count(self.sh_degree)

    @property
    def capacity(self) -> int:
        """Columns of `parameters`: `count`, padded."""
        return self.parameters.shape[1]

    @property
    def block(self) -> Block:
        """The parameters as the rasterizer takes them."""
        return Block(self.parameters, self.count, activated=False)

    def adopt(self, parameters: Tensor | DeviceArray, count: int) -> None:
        """Take new parameters `[rows, capacity]`, of which `count` columns are Gaussians.

        Gradients and statistics start anew.
        """
        if isinstance(parameters, Tensor):
            array = DeviceArray(self.device, tuple(parameters.shape), self.dtype)
            array.write(parameters)
            parameters = array
        gradients = Gradients(self.device, parameters.shape, self.dtype)
        self._statistics = ScreenStatistics(self.device, count, parameters.shape[1], self.dtype)
        self._gradients = gradients
        self.parameters = parameters
        self.count = count

    @property
    def gradients(self) -> DeviceArray:
        """Gradient rows on the device, in the layout of `parameters`; see `settle_gradients`."""
        return self._gradients.rows

    def read(self, name: str) -> Tensor:
        """A snapshot of one parameter.

        Args:
            name: "means" `[N, 3]`, "log_scales" `[N, 3]`, "quaternions" `[N, 4]`, "opacity_logits"
                `[N]` or "sh" `[N, K, 3]`.
        """
        return self._unpack(self.parameters.read(*self._rows_of(name)), name)

    def write(self, name: str, values: Tensor) -> None:
        """Replace one parameter; `values` has the shape that `read` returns.

        Raises:
            GaussianError: the shape differs, or a value is not finite.
        """
        first, last = self._rows_of(name)
        expected = tuple(self._unpack(torch.empty(last - first, self.count), name).shape)
        if tuple(values.shape) != expected:
            raise GaussianError(
                f"the shape is {tuple(values.shape)}, expected {expected}", field=name
            )
        values = values.to(self.dtype).reshape(self.count, last - first)
        undefined = undefined_places(values)
        if len(undefined):
            raise GaussianError("a value is not finite", field=name, index=int(undefined[0, 0]))
        updated = torch.zeros(last - first, self.capacity, dtype=self.dtype)
        # numpy, because torch takes twenty times as long to copy what is transposed.
        updated.numpy()[:, : self.count] = values.detach().numpy().T
        self.parameters.hand_over(updated, first)

    def gradient(self, name: str) -> Tensor:
        """The gradient of one parameter, summed over the backward passes since `zero_gradients`."""
        return self._unpack(self._gradients.total(*self._rows_of(name)), name)

    def touched(self) -> Tensor:
        """Which Gaussians touched a pixel in the renders since `zero_gradients`, bool `[N]`.

        Known from the backward pass to the optimizer's step: those with a gradient of position, opacity
        or constant colour that is not zero. Opacity alone would miss Gaussians as opaque as the
        rasterizer lets them be. A render that detaches all three counts for nothing, and so do losses
        on parameters.
        """
        groups = [PARAMETER_GROUPS[name] for name in ("means", "opacity_logits", "sh_constant")]
        gradients = torch.cat([self._gradients.of_renders(*rows) for rows in groups])
        return (gradients[:, : self.count] != 0).any(dim=0)

    def settle_gradients(self) -> None:
        """Bring `gradients` up to date: promised zeros, and the gradients of losses on parameters."""
        self._gradients.settle()

    def opacities(self) -> Tensor:
        """Activated opacities `[N]` in (0, 1)."""
        return ACTIVATED["opacities"].activate(self.read("opacity_logits"))

    def scales(self) -> Tensor:
        """Activated scales `[N, 3]`: standard deviations, world units."""
        return ACTIVATED["scales"].activate(self.read("log_scales"))

    def parameter(self, name: str) -> Tensor:
        """The values of one parameter, in autograd, for losses on parameters.

        After `loss.backward()` their gradient is part of `gradient` and of the optimizer's next step.

        Args:
            name: one that `read` knows; or "opacities" `[N]` or "scales" `[N, 3]`, activated.

        Returns:
            A tensor of its own, in the shape that `read` returns. The backward pass raises a
            GaussianError where the loss has a gradient that is not finite, or where Gaussians came or
            went in between.

        Raises:
            GaussianError: there is no such parameter.
        """
        if name not in ACTIVATED:
            self._rows_of(name)
        return values_in_autograd(self, self._anchor, name)

    def add_gradient(self, name: str, gradient: Tensor) -> None:
        """Add to the gradient of one parameter.

        Args:
            name: as in `parameter`.
            gradient: of the stored values (`stored_name`), in the shape that `read` returns for them.

        Raises:
            GaussianError: a value is not finite; nothing is added then.
        """
        first, _ = self._rows_of(stored_name(name))
        rows = gradient.to(self.dtype).reshape(self.count, -1).T
        self._gradients.add(name, first, rows)

    def reader(self) -> ModelReader:
        """These Gaussians for those who may look and not touch."""
        return ModelReader(self)

    def zero_gradients(self) -> None:
        """Forget the gradients. Costs nothing: the next backward pass overwrites them."""
        self._gradients.forget()

    def screen_gradient(self) -> Tensor:
        """Mean NDC norm of the screen-space mean gradient over the renders that saw a Gaussian, `[N]`.

        Counted in renders made with `collect_statistics`, since `reset_statistics`; 0 if never seen.
        NDC gradients are pixel gradients times half the image width and height (3DGS), so published
        thresholds hold.
        """
        return self._statistics.mean()

    def absolute_screen_gradient(self) -> Tensor:
        """`screen_gradient` without cancellation between pixels, `[N]` (AbsGS, Ye et al. 2024).

        The absolute values of what each pixel contributes to the two components are summed before the
        norm is taken. Counted in renders made with `collect_absolute`, and a mean over the same renders
        as `screen_gradient`.

        Raises:
            GaussianError: no render has collected it since the Gaussians were made or edited.
        """
        return self._statistics.absolute_mean()

    def reset_statistics(self) -> None:
        """Start counting screen gradients anew."""
        self._statistics.reset()

    def statistics(self) -> Tensor:
        """What screen gradients are made of, for checkpoints.

        Returns:
            `[2, N]`: summed norms, and times seen; where absolute gradients are collected `[3, N]`, their
            summed norms last.
        """
        return self._statistics.sums()

    def restore_statistics(self, statistics: Tensor) -> None:
        """Take back what `statistics` returned."""
        self._statistics.restore(statistics)

    def gaussians(self) -> Gaussians:
        """A copy on the host."""
        return Gaussians(**{name: self.read(name).clone().contiguous() for name in PARAMETERS})

    def digest(self) -> str:
        """SHA-256 of all parameters, as hexadecimal: equal digests mean equal bits."""
        digest = hashlib.sha256()
        for name in PARAMETERS:
            digest.update(self.read(name).contiguous().numpy().tobytes())
        return digest.hexdigest()

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

        The images take part in autograd: `loss.backward()` adds to the parameters' gradients on the
        device, and gives `camera.world_to_camera` its own where that requires one (`rasterize`). Under
        `torch.no_grad()` nothing is kept for a backward pass.

        Args:
            camera: what to look through.
            background: colour behind the scene, three numbers.
            sh_degree: bands to use, 0 to the stored degree, the last by a fraction: 1.5 is bands 0 and 1
                and half of band 2. None uses all.
            opacity_scale: `[N]` factors >= 0 of the activated opacities. No gradient flows to them.
            smoothing: `[N]` standard deviations >= 0, world units, of the 3D filter of Mip-Splatting (Yu
                et al. 2024, eq. 9): scales become sqrt(s^2 + f^2) and the opacity shrinks by the product
                of s / sqrt(s^2 + f^2). No gradient flows to them.
            collect_statistics: let the backward pass of this render count for `screen_gradient`.
            collect_absolute: where statistics are collected, count for `absolute_screen_gradient` too.
            near: z-depth below which Gaussians are culled, world units, > 0.
            detach: names of parameters, as in `read`, to whose gradient this render adds nothing.
                Statistics are collected all the same.

        Raises:
            GaussianError: opacity factors, smoothing, a background, a degree or a name that do not fit.
            CameraError: the image is too large to address, or `near` is not positive.
            MemoryBudgetError: the image or the tiles that the Gaussians cover would not fit.
        """
        degree = self.sh_degree if sh_degree is None else min(sh_degree, self.sh_degree)
        if opacity_scale is not None and tuple(opacity_scale.shape) != (self.count,):
            raise GaussianError(
                f"the shape is {tuple(opacity_scale.shape)}, expected ({self.count},)",
                field="opacity_scale",
            )
        for name in detach:
            self._rows_of(name)
        request = RenderRequest(camera, tuple(background), degree, near, opacity_scale, smoothing)
        return Rendering.on_device(
            *RenderFunction.apply(
                self._anchor,
                camera.world_to_camera,
                self,
                request,
                (collect_statistics, collect_statistics and collect_absolute),
                frozenset(detach),
            )
        )

    def add_gradients(
        self,
        frame: Frame,
        image_gradients: tuple[Tensor | DeviceArray | None, Tensor | None, Tensor | None],
        collect: tuple[bool, bool],
        detach: frozenset[str],
    ) -> Tensor | None:
        """Run the backward pass of one render into `gradients`.

        Args:
            collect: whether to collect screen gradients, and absolute ones.

        Returns:
            The gradient of the camera's pose, `[4, 4]` float64, if it requires one.
        """
        degree = frame.request.bands
        wanted, absolute = collect
        pose_gradient = self.renderer.backward(
            frame,
            self.block,
            image_gradients,
            self.gradients,
            accumulate=self._gradients.make_ready(degree),
            statistics=self._statistics.rows(absolute) if wanted else None,
            detach=detach,
        )
        self._gradients.written(degree)
        return pose_gradient

    def check_unedited(self, parameters: DeviceArray) -> None:
        """Refuse a backward pass for Gaussians that are no more.

        Args:
            parameters: those of the model when the forward pass ran.

        Raises:
            GaussianError: they were replaced since.
        """
        if parameters is not self.parameters:
            raise GaussianError(
                "the Gaussians were added to or removed between a render and its backward pass",
                field="means",
                fix="call backward before editing the Gaussians",
            )

    def _rows_of(self, name: str) -> tuple[int, int]:
        if name not in PARAMETERS:
            raise GaussianError(
                f"there is no parameter {name!r}",
                field=name,
                fix=f"use one of {', '.join(PARAMETERS)}",
            )
        return rows_of(name, self.sh_degree)

    def _unpack(self, rows: Tensor, name: str) -> Tensor:
        return unpack(rows, name, self.count)

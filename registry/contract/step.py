"""Data of one training iteration for components."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from ..errors import PluginError
from .rendered import Access

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, GaussianReader, Rendering

    from .prior import Prior
    from .scene import DepthMap, TrainingScene, TrainingView


@dataclass(frozen=True, eq=False)
class Sample:
    """The training sample of one iteration; samplers may replace any of it (`dataclasses.replace`).

    Args:
        view: the training view.
        camera: camera of the render: the view's, unless a sampler refines it.
        target: `[H, W, 3]` float32 in [0, 1] of the camera's size, compared with the render: the view's
            image, unless a sampler changes it.
        weights: `[H, W]` float32 in [0, 1] of the target's size, weight of each pixel in the photometric
            loss, its gradient, and in losses that compare with the target; None: 1. A sampler that changes
            the view or the size of the target changes them as well.
        background: colour behind the render, three numbers.
        sh_degree: spherical-harmonic bands in use; a fraction is the weight of the next band.
        smoothing: `[N]` standard deviations in world units, >= 0, of the 3D smoothing filter of each
            Gaussian (Mip-Splatting, Yu et al. 2024, eq. 9); None: no filter.
    """

    view: TrainingView
    camera: Camera
    target: Tensor
    background: tuple[float, float, float]
    sh_degree: float
    smoothing: Tensor | None = None
    weights: Tensor | None = None

    @property
    def trained(self) -> Tensor | None:
        """`[H, W]` bool, pixels of full weight; None where all are."""
        return None if self.weights is None else self.weights == 1


class Render(Protocol):
    """Renders a camera at the current parameters, without modifiers."""

    def __call__(
        self,
        camera: Camera,
        *,
        gradient: bool = True,
        background: Sequence[float] | None = None,
        opacity_scale: Tensor | None = None,
        detach: Collection[str] = (),
        sh_degree: float | None = None,
    ) -> Rendering:
        """Render a camera.

        Args:
            gradient: let gradients flow to the Gaussians, and to the camera's pose if it requires one.
            background: colour behind the scene; None: the iteration's.
            opacity_scale: `[N]` factors >= 0 of the activated opacities.
            detach: parameter groups without gradients from this render: any of "means", "log_scales",
                "quaternions", "opacity_logits" and "sh".
            sh_degree: bands to use; None: the iteration's.
        """


@dataclass(frozen=True, eq=False)
class OtherField:
    """Another field of Gaussians that is trained in parallel (`training.fields`), read only.

    Args:
        index: number of the field; field 0 is scored.
        model: the field's Gaussians.
        rendering: render of this iteration's view, without gradients.
        render: renders other cameras, without gradients.
    """

    index: int
    model: GaussianReader
    rendering: Rendering
    render: Render


@dataclass(eq=False)
class _Rendered:
    """The part of a `Step` that exists only after the render.

    Attributes:
        made: outputs of this iteration, by name.
    """

    rendering: Callable[[], Rendering] | None = None
    others: tuple[OtherField, ...] = ()
    made: dict[str, Tensor] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Step:
    """One training iteration.

    Args:
        iteration: 1-based.
        iterations: the total number of iterations.
        scene: the scene without test views and true depth.
        sample: training sample of this iteration.
        model: the Gaussians; `model.read(name)` returns a parameter, `model.gradient(name)` its gradient
            between the backward pass and the optimizer's step.
        extent: the scene's extent in world units (`Scene.extent`).
        priors: the pipeline's prior models by name.
        render: renders other cameras; see `Render`.
        log: records a number under a name in the run's metrics.
        maps: depth of each training view from the initializer, by the view's name.
        learning_rates: Adam's step size of each parameter group in this iteration.
        kinds: `[N]` bool by the kind's name, the Gaussians that descend from initial points of a kind
            (`PointCloud.kinds`). The host updates them when the number of Gaussians changes.
        features: `[N, C]` by name, in autograd, the components' numbers per Gaussian
            (`Component.features`); `registry.toolkit.views.blended` renders them.
        makers: for the host, makes `normals` and `contributions`.
        access: for the host, the outputs that the component may use.
    """

    iteration: int
    iterations: int
    scene: TrainingScene
    sample: Sample
    model: GaussianReader
    extent: float
    priors: Mapping[str, Prior[Any]]
    render: Render
    log: Callable[[str, float], None]
    maps: Mapping[str, DepthMap] = field(default_factory=dict)
    learning_rates: Mapping[str, float] = field(default_factory=dict)
    kinds: Mapping[str, Tensor] = field(default_factory=dict)
    features: Mapping[str, Tensor] = field(default_factory=dict)
    makers: Mapping[str, Callable[[Step], Tensor]] = field(default_factory=dict)
    access: Access = field(default_factory=Access)
    _rendered: _Rendered = field(default_factory=_Rendered)

    @property
    def view(self) -> TrainingView:
        """The training view of this iteration."""
        return self.sample.view

    @property
    def rendering(self) -> Rendering:
        """The render of that view: `rgb [H, W, 3]`, `depth [H, W]`, `alpha [H, W]`; in autograd.

        Raises:
            PluginError: it does not exist yet: samplers and modifiers run before the render.
        """
        if self._rendered.rendering is None:
            raise PluginError(
                "the render of this iteration was read before it exists",
                fix="samplers and modifiers run before the render; read it in a regularizer",
            )
        return self._rendered.rendering()

    @property
    def others(self) -> tuple[OtherField, ...]:
        """The other fields, after the render; for components that declare "other_fields"."""
        self.access.refuse_undeclared("other_fields")
        return self._rendered.others

    @property
    def normals(self) -> Tensor:
        """`[H, W, 3]`, the blended normals of the Gaussians (`axis_normals`), in autograd.

        For components that declare "normals". From the sample's camera, without modifiers.
        """
        return self.output("normals")

    @property
    def contributions(self) -> Tensor:
        """`[N]`, the sum over the pixels of each Gaussian's share of their light, alpha_i * T_i.

        For components that declare "contributions". From the sample's camera before this iteration's edits,
        without modifiers; after an edit, of the Gaussian that each descends from.
        """
        return self.output("contributions")

    def output(self, name: str) -> Tensor:
        """For the host: return an output of this iteration, made on first use."""
        rendered = self._rendered
        self.access.refuse_undeclared(name)
        if name not in rendered.made:
            rendered.made[name] = self.makers[name](self)
        return rendered.made[name]

    def rendered(
        self, rendering: Callable[[], Rendering] | None, others: tuple[OtherField, ...] = ()
    ) -> None:
        """For the host: set the render and the other fields; None removes them, and `made` outputs."""
        self._rendered.rendering, self._rendered.others = rendering, others
        if rendering is None:
            self._rendered.made.clear()

    def carry_outputs(self, source: Tensor) -> None:
        """For the host: give each new Gaussian the contribution of the one that it descends from."""
        made = self._rendered.made
        if "contributions" in made:
            made["contributions"] = made["contributions"][source]

    @property
    def made(self) -> Mapping[str, Tensor]:
        """For the host: outputs of this iteration that exist, by name."""
        return self._rendered.made

    def parameter(self, name: str) -> Tensor:
        """Return one parameter of all Gaussians, in autograd.

        Args:
            name: as for `model.read`, or an activated one: "opacities" `[N]`, "scales" `[N, 3]`.
        """
        return self.model.parameter(name)

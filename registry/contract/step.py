"""One training iteration, as components see it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from ..errors import PluginError

if TYPE_CHECKING:
    from torch import Tensor

    from core_rasterizer import Camera, GaussianReader, Rendering

    from .maps import DepthMap
    from .prior import Prior
    from .scene import TrainingScene, TrainingView


@dataclass(frozen=True, eq=False)
class Sample:
    """What one iteration learns from; samplers may replace any of it (`dataclasses.replace`).

    Args:
        view: the training view.
        camera: what the render looks through; the view's camera, unless a sampler refines it.
        target: `[H, W, 3]` float32 in [0, 1], what the render is compared with: the view's image,
            unless a sampler changes it. Its size is the camera's.
        background: colour behind the render, three numbers.
        sh_degree: spherical-harmonic bands in use; with a fraction, the band above takes part by it.
        smoothing: `[N]` standard deviations in world units, >= 0, of a filter in space that each
            Gaussian is rendered with (Mip-Splatting, Yu et al. 2024, eq. 9); None for none.
    """

    view: TrainingView
    camera: Camera
    target: Tensor
    background: tuple[float, float, float]
    sh_degree: float
    smoothing: Tensor | None = None


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
        """Render.

        Args:
            camera: what to look through.
            gradient: let gradients flow to the Gaussians, and to the camera's pose if it wants one.
            background: colour behind the scene; None takes the iteration's.
            opacity_scale: `[N]` factors >= 0 of the activated opacities.
            detach: parameter groups that no gradient of this render reaches: of "means",
                "log_scales", "quaternions", "opacity_logits" and "sh".
            sh_degree: bands to use; None takes the iteration's.
        """


@dataclass(frozen=True, eq=False)
class OtherField:
    """Another field of Gaussians in lock-step (`training.fields`), to be looked at only.

    Args:
        index: its number; 0 is the one that is scored.
        model: its Gaussians.
        rendering: its render of this iteration's view, without gradients.
        render: renders it through other cameras, without gradients.
    """

    index: int
    model: GaussianReader
    rendering: Rendering
    render: Render


@dataclass(frozen=True, eq=False)
class Step:
    """One training iteration, as the components see it.

    Args:
        iteration: 1-based.
        iterations: the total number of iterations.
        scene: the whole scene, without test views and true depth.
        sample: what this iteration learns from.
        model: the Gaussians; read what is needed with `model.read(name)`, after the backward pass
            also `model.gradient(name)`.
        extent: the scene's extent in world units (`Scene.extent`).
        priors: the pipeline's prior models by name.
        render: renders other cameras; see `Render`.
        log: records a number under a name in the run's metrics.
        maps: what the initializer knows of each training view's depth, by the view's name.
        learning_rates: Adam's step size of each parameter group in this iteration.
        kinds: which Gaussians descend from initial points of a kind, `[N]` bool by its name
            (`PointCloud.kinds`); empty if the initializer tells none apart. Whoever changes the number
            of Gaussians changes these too, before the next component is asked.
        others: the other fields, from the render on; empty with a single field.
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
    others: tuple[OtherField, ...] = ()
    _rendering: Callable[[], Rendering] | None = None

    @property
    def view(self) -> TrainingView:
        """The training view of this iteration."""
        return self.sample.view

    @property
    def rendering(self) -> Rendering:
        """The render of that view: `rgb [H, W, 3]`, `depth [H, W]`, `alpha [H, W]`; in autograd.

        Raises:
            PluginError: it is not made yet: samplers and modifiers are asked before.
        """
        if self._rendering is None:
            raise PluginError(
                "the render of this iteration was asked for before it is made",
                fix="samplers and modifiers come before the render; look at it in a regularizer",
            )
        return self._rendering()

    def rendered(
        self, rendering: Callable[[], Rendering] | None, others: tuple[OtherField, ...] = ()
    ) -> None:
        """For the host: from now on there is a render, and other fields' are, or there is none."""
        object.__setattr__(self, "_rendering", rendering)
        object.__setattr__(self, "others", others)

    def parameter(self, name: str) -> Tensor:
        """One parameter of all Gaussians, in autograd: a loss on it reaches the Gaussians.

        Args:
            name: as for `model.read`, or an activated one: "opacities" `[N]`, "scales" `[N, 3]`.
        """
        return self.model.parameter(name)
